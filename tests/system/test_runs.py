"""Whole runs: what they leave behind, what they repeat to the bit, and how they end."""

from __future__ import annotations

import itertools
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import h5py
import numpy as np
import pytest
import xarray
from emcee.backends import HDFBackend
from support import command_line, finished_runs
from support.case_tables import run_cases

from bayesdrill.output_files import POSTERIOR, dumps_checksummed, loads_checksummed
from bayesdrill.results.run_folder import Folder, seal
from bayesdrill.sampling.proposal import learning
from bayesdrill.tasks import pipeline

ALL_FIGURES = ("figures: []", "figures: null")  # to draw takes longer than all else of a small run
# Targets that cannot be met, so that a run goes on to the end of its steps.
ENDLESS = ("ess: 100, max_steps: 500", "ess: 1000000, max_steps: 700")
FIGURES = {
    f"figures/{stem}.{ending}"
    for stem in ("corner", "fit", "invariants", "prior_posterior", "trace")
    for ending in ("pdf", "png")
}
FILES = {
    ".lock",
    "chain.h5",
    "config.resolved.yaml",
    "config.yaml",
    "derived.csv",
    "map.json",
    "posterior.nc",
    "report.html",
    "run.json",
    "summary.csv",
    "summary.md",
    "table.tex",
    "verdict.csv",
    "figures",
    *FIGURES,
}


@dataclass(frozen=True)
class Done:
    config: Path
    folder: Path
    ran: command_line.CommandResult


def posterior(
    config: Path, folder: Path, *options: str, processes: int = 1
) -> command_line.CommandResult:
    return command_line.cli(
        "posterior", config, "-o", folder, "--processes", str(processes), *options
    )


def fresh(folder: Path, *changes: tuple[str, str], processes: int = 1) -> Done:
    config = command_line.small_config(folder, *changes)
    ran = posterior(config, folder / "out", processes=processes)
    return Done(config, folder / "out", ran)


def chains(folder: Path) -> dict[str, np.ndarray]:
    """Everything that the four ensembles hold."""
    found = {}
    for k in range(4):
        backend = HDFBackend(str(folder / "chain.h5"), name=f"ensemble_{k}", read_only=True)
        found[f"z {k}"] = backend.get_chain()
        found[f"log p {k}"] = backend.get_log_prob()
        found[f"accepted {k}"] = backend.accepted
        found[f"random {k}"] = backend.random_state[1]
    return found


def assert_same_chains(one: Path, other: Path) -> None:
    first, second = chains(one), chains(other)
    for name, values in first.items():
        assert np.array_equal(values, second[name]), name


def run_of(folder: Path) -> dict[str, Any]:
    return dict(json.loads((folder / "run.json").read_text()))


def pieces(folder: Path) -> list[Path]:
    return sorted((folder / ".pieces").glob("ensemble_*.npz"))


def assert_refused(ran: command_line.CommandResult, *fragments: str) -> None:
    assert ran.status == 2, ran.text
    assert "Traceback" not in ran.text
    assert len(ran.err.splitlines()) <= 24
    for fragment in fragments:
        assert fragment in ran.err


def shared(factory: pytest.TempPathFactory, name: str, *changes: tuple[str, str]) -> Done:
    """A run that other tests may use too."""
    place = factory.mktemp(name)
    ran = finished_runs.posterior(factory, place, "out", *changes)
    return Done((place / "out.yaml").rename(place / "small.yaml"), place / "out", ran)


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Done:
    """A converged run; tests copy it, or leave it as it is."""
    state = np.random.get_state()  # noqa: NPY002
    found = fresh(tmp_path_factory.mktemp("done"), ALL_FIGURES)
    after = np.random.get_state()  # noqa: NPY002
    assert state[2:] == after[2:]
    assert np.array_equal(state[1], after[1])
    return found


@pytest.fixture(scope="module")
def endless(tmp_path_factory: pytest.TempPathFactory) -> Done:
    """A run that used all of its steps, never interrupted."""
    return shared(tmp_path_factory, "endless", ENDLESS)


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Done:
    """The same run, without figures."""
    return shared(tmp_path_factory, "plain")


def copied(found: Done, folder: Path) -> Done:
    shutil.copytree(found.config.parent, folder)
    return Done(folder / "small.yaml", folder / "out", found.ran)


def copied_plain(plain: Done, tmp_path: Path) -> Done:
    """The converged run without figures, to be changed."""
    return copied(plain, tmp_path / "copy")


copy = pytest.fixture(copied_plain, name="copy")


@pytest.fixture
def drawn(done: Done, tmp_path: Path) -> Done:
    """The converged run with its figures, to be changed."""
    return copied(done, tmp_path / "drawn")


def change(path: Path, old: str, new: str) -> None:
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")


# --- what a run leaves behind --------------------------------------------------------------------


def test_what_the_fit_leaves_is_said_everywhere(done: Done) -> None:
    lines = [x for x in done.ran.out.splitlines() if x.startswith("fit: ")]
    assert lines[0].startswith("fit: the MAP leaves unexplained ")
    assert lines[1].startswith("fit: the residuals look like the noise")
    assert "".join(f"- {line}\n" for line in lines) in (done.folder / "summary.md").read_text()
    data = run_of(done.folder)["analysis"]["fit"]
    assert [one["channel"] for one in data] == ["theta_1", "w_1"]


def test_a_run_leaves_a_complete_folder_and_nothing_else(done: Done) -> None:
    assert done.ran.status == 0, done.ran.text
    assert set(command_line.listing(done.folder)) == FILES
    assert {name for name in FILES if not POSTERIOR.is_output(name)} == {".lock", "figures"}
    assert (done.folder / "config.yaml").read_bytes() == done.config.read_bytes()
    for name in FIGURES:
        magic = b"%PDF" if name.endswith("pdf") else b"\x89PNG"
        assert (done.folder / name).read_bytes().startswith(magic)
    run = run_of(done.folder)
    assert (run["status"], run["converged"], run["seed"]) == ("finished", True, 7)
    assert "sampling: converged after " in done.ran.out
    assert f"results: {done.folder}/" in done.ran.out


def test_the_record_and_the_config_are_left_alone(done: Done) -> None:
    assert done.config.read_text() == command_line.SMALL.replace(*ALL_FIGURES)
    assert (done.config.parent / "small.csv").read_text() == command_line.small_record()


def test_the_resolved_config_is_a_config(done: Done) -> None:
    ran = command_line.cli("check", done.folder / "config.resolved.yaml")
    assert (ran.status, ran.err) == (0, "")
    assert ran.out == command_line.cli("check", done.config).out


def test_the_chain_is_an_emcee_backend(done: Done) -> None:
    for k in range(4):
        backend = HDFBackend(str(done.folder / "chain.h5"), name=f"ensemble_{k}", read_only=True)
        assert backend.get_chain().shape == (run_of(done.folder)["steps"], 8, 2)
        assert backend.get_log_prob().shape == backend.get_chain().shape[:2]
        assert np.all(np.isfinite(backend.get_log_prob()))
        assert np.all(backend.accepted > 0)


def test_the_tree_has_the_groups_and_units_of_arviz(done: Done) -> None:
    with xarray.open_datatree(done.folder / "posterior.nc", engine="h5netcdf") as tree:
        groups = {"posterior", "sample_stats", "log_likelihood", "prior", "derived"}
        groups |= {"posterior_predictive", "observed_data", "constant_data"}
        assert set(tree.children) == groups
        assert set(tree["posterior"].data_vars) == {"k_e", "j_1"}
        for name in ("posterior", "sample_stats", "log_likelihood", "posterior_predictive"):
            assert tree[name].sizes["chain"] == 4
        assert tree["posterior"]["k_e"].attrs["units"] == "V*s/rad"
        assert tree["observed_data"]["w_1"].attrs["units"] == "rad/s"
        assert tree["observed_data"]["w_1"].sizes == {"time": 101}
        assert tree["log_likelihood"]["w_1"].sizes["draw"] == 10
        assert np.all(np.isfinite(tree["log_likelihood"]["w_1"].values))
        k_e = tree["posterior"]["k_e"].values
        assert np.all((k_e > 0.5 * 0.06016) & (k_e < 1.5 * 0.06016))


def test_the_summary_has_a_row_for_every_unknown(done: Done) -> None:
    lines = (done.folder / "summary.csv").read_text().splitlines()
    assert [line.split(",")[0] for line in lines[1:]] == ["k_e", "j_1"]
    assert "converged: all targets are met" in (done.folder / "summary.md").read_text()


BROKEN = {
    "figures/corner": "report.sections.physics_words.derived_shown",
    "figures/trace": "report.sections.convergence_figure.trace_figure",
    "derived.csv": "report.sections.physics_words.derived_csv",
    "verdict.csv": "report.sections.verdict_words.verdict_csv",
    "posterior.nc": "results.arviz_tree.make_tree",
    "figures/fit": "results.arviz_tree.make_tree",
}


def test_tables_and_figures_that_fail_are_named_and_take_no_other_with_them(
    drawn: Done, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And `report` makes all of them again, the same as before."""
    complete = command_line.listing(drawn.folder)
    for name in FIGURES | {"summary.md", "derived.csv", "verdict.csv", "posterior.nc"}:
        (drawn.folder / name).unlink()

    def fail(*_: object) -> None:
        raise ValueError("cannot do this\nnor that")

    with monkeypatch.context() as patch:
        for place in BROKEN.values():
            patch.setattr(f"bayesdrill.{place}", fail)
        ran = command_line.cli("report", drawn.folder, "--processes", "1")
    assert ran.status == 2, ran.text
    *said, way_out = ran.err.splitlines()
    named = [line for line in said if line.startswith("could not be made")]
    why = "(ValueError: cannot do this)"
    assert sorted(named) == sorted(f"could not be made: {what} {why}" for what in BROKEN)
    assert f"`bayesdrill report {drawn.folder}` makes it" in way_out
    assert "sampling: converged after " in ran.out
    failed = {"derived.csv", "verdict.csv", "posterior.nc"}
    failed |= {name for name in FIGURES if re.search("corner|trace|fit", name)}
    assert set(command_line.listing(drawn.folder)) == FILES - failed
    assert sorted(run_of(drawn.folder)["missing"]) == sorted(f"{what} {why}" for what in BROKEN)
    for name in ("summary.csv", "summary.md", "report.html", "table.tex"):
        (drawn.folder / name).unlink()
    shutil.rmtree(drawn.folder / "figures")
    ran = command_line.cli("report", drawn.folder, "--processes", "1")
    assert ran.status == 0, ran.text
    after = command_line.listing(drawn.folder)
    assert set(after) == FILES
    assert run_of(drawn.folder)["missing"] == []
    kept = ("chain.h5", "config.yaml", "map.json")
    for name in ("summary.csv", "summary.md", "report.html", "table.tex", *kept):
        assert after[name] == complete[name], name
    assert ran.out.splitlines()[-1].startswith(f"results: {drawn.folder}/")


@pytest.mark.slow
def test_results_behind_a_symbolic_link_are_reported(tmp_path: Path) -> None:
    config = command_line.small_config(tmp_path / "rig")
    (tmp_path / "far" / "away" / "disk").mkdir(parents=True)
    (tmp_path / "rig" / "results").symlink_to(tmp_path / "far" / "away" / "disk")
    folder = tmp_path / "rig" / "results" / "small"
    assert posterior(config, folder).status == 0
    ran = command_line.cli("report", folder)
    assert ran.status == 0, ran.text


# --- what a run repeats --------------------------------------------------------------------------


def test_the_chain_does_not_depend_on_the_processes(done: Done, tmp_path: Path) -> None:
    other = fresh(tmp_path, processes=2)
    assert other.ran.status == 0, other.ran.text
    assert_same_chains(done.folder, other.folder)
    for name in ("summary.csv", "map.json"):
        assert (done.folder / name).read_bytes() == (other.folder / name).read_bytes()


def test_a_report_made_again_says_the_same_times(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Mutant killed: the run's own report has more digits than `run.json`, and rounds otherwise."""
    clock = (k * 0.04996 for k in itertools.count())
    with monkeypatch.context() as patch:
        patch.setattr(pipeline, "time", SimpleNamespace(perf_counter=lambda: next(clock)))
        run = fresh(tmp_path)
    assert run.ran.status == 0, run.ran.text
    seconds = run_of(run.folder)["seconds"]
    assert seconds == {"map": 0.05, "sampling": 0.05, "report": 0.05}
    page = (run.folder / "report.html").read_bytes()
    ran = command_line.cli("report", run.folder, "--processes", "1")
    assert ran.status == 0, ran.text
    assert (run.folder / "report.html").read_bytes() == page


def test_another_seed_makes_another_chain(done: Done, copy: Done) -> None:
    """And --force leaves notes beside the results alone."""
    change(copy.config, "seed: 7", "seed: 8")
    (copy.folder / "notes.txt").write_text("what I saw that day")
    ran = posterior(copy.config, copy.folder, "--force")
    assert ran.status in (0, 3), ran.text
    assert (copy.folder / "notes.txt").read_text() == "what I saw that day"
    assert set(command_line.listing(copy.folder)) == {*FILES - FIGURES, "notes.txt"}
    first, second = chains(done.folder), chains(copy.folder)
    assert not np.array_equal(first["z 0"], second["z 0"][: len(first["z 0"])])
    assert run_of(copy.folder)["seed"] == 8


def test_ensembles_differ_from_each_other(done: Done) -> None:
    found = chains(done.folder)
    assert len({found[f"z {k}"].tobytes() for k in range(4)}) == 4


@pytest.mark.slow
def test_force_starts_over(done: Done, copy: Done) -> None:
    (copy.folder / "summary.csv").write_text("old")
    assert posterior(copy.config, copy.folder, "--force").status == 0
    assert set(command_line.listing(copy.folder)) == FILES - FIGURES
    assert_same_chains(done.folder, copy.folder)


def test_a_finished_run_resumed_changes_nothing(done: Done, copy: Done) -> None:
    assert posterior(copy.config, copy.folder, "--resume").status == 0
    assert set(command_line.listing(copy.folder)) == FILES - FIGURES
    assert_same_chains(done.folder, copy.folder)


def test_a_finished_run_is_extended(done: Done, copy: Done, endless: Done) -> None:
    change(copy.config, *ENDLESS)
    ran = posterior(copy.config, copy.folder, "--resume")
    assert ran.status == 3, ran.text
    assert set(command_line.listing(copy.folder)) == FILES - FIGURES
    short, long = chains(done.folder), chains(copy.folder)
    for k in range(4):
        assert long[f"z {k}"].shape == (700, 8, 2)
        assert np.array_equal(long[f"z {k}"][: len(short[f"z {k}"])], short[f"z {k}"])
    assert_same_chains(endless.folder, copy.folder)


def test_a_run_that_did_not_converge_says_so(endless: Done) -> None:
    assert endless.ran.status == 3
    assert set(command_line.listing(endless.folder)) == FILES - FIGURES
    assert "NOT CONVERGED" in endless.ran.out
    assert "effective draws of" in endless.ran.out
    assert "sampler.max_steps" in endless.ran.out
    assert "--resume" in endless.ran.out
    assert "NOT CONVERGED" in (endless.folder / "summary.md").read_text()
    run = run_of(endless.folder)
    assert (run["status"], run["converged"], run["steps"]) == ("finished", False, 700)
    assert command_line.cli("report", endless.folder, "--processes", "1").status == 3


# --- interruptions -------------------------------------------------------------------------------


def waited(process: subprocess.Popen[str], ready: Callable[[], bool], seconds: float = 60) -> None:
    """Until `ready`, as long as the process lives."""
    end = time.monotonic() + seconds
    while not ready():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < end
        time.sleep(0.002)


def soon(holds: Callable[[], bool], seconds: float = 10.0) -> bool:
    """Whether `holds` becomes true: helpers of multiprocessing end a moment after their parent."""
    end = time.monotonic() + seconds
    while not holds() and time.monotonic() < end:
        time.sleep(0.05)
    return holds()


def group(leader: int) -> list[int]:
    """The living processes of a session started by `leader`."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, number = stat.read_text().rpartition(")")[2].split()[:3]
        except OSError:
            continue
        if int(number) == leader and state != "Z":
            found.append(int(stat.parent.name))
    return found


def begun(folder: Path, processes: int, started: list[subprocess.Popen[str]]) -> Done:
    """A run in a process of its own, some of which is saved."""
    config = command_line.small_config(folder, ENDLESS)
    arguments = ("posterior", config, "-o", folder / "out", "--processes", str(processes))
    process = command_line.start_process(*arguments, cwd=folder)
    started.append(process)
    waited(process, lambda: len(pieces(folder / "out")) >= 3)
    return Done(config, folder / "out", command_line.CommandResult(0, "", ""))


def assert_resumes(
    run: Done, process: subprocess.Popen[str], number: signal.Signals, endless: Done
) -> None:
    """Interrupted by `number` and resumed is the same as uninterrupted."""
    folder = run.folder
    if number == signal.SIGINT:
        os.killpg(process.pid, number)  # as a terminal does, to parent and workers
    else:
        process.send_signal(number)
    _, err = process.communicate(timeout=30)
    assert not (folder / "chain.h5").exists()
    assert len(pieces(folder)) >= 3
    if number == signal.SIGKILL:
        assert process.returncode == -signal.SIGKILL
        assert run_of(folder)["status"] == "running"
    else:
        assert process.returncode == 130
        assert "Traceback" not in err
        assert "continue with --resume" in err
        assert run_of(folder)["status"] == "interrupted"
    assert soon(lambda: not group(process.pid)), "workers outlive the run"
    assert posterior(run.config, folder, "--resume").status == 3
    assert_same_chains(endless.folder, folder)
    assert set(command_line.listing(folder)) == FILES - FIGURES
    assert (folder / "summary.csv").read_bytes() == (endless.folder / "summary.csv").read_bytes()


def test_no_other_run_writes_into_the_folder_of_one_which_interrupted_can_be_resumed(
    endless: Done, tmp_path: Path, started: list[subprocess.Popen[str]]
) -> None:
    run = begun(tmp_path, 1, started)
    (process,) = started
    process.send_signal(signal.SIGSTOP)
    before = command_line.listing(run.folder)
    for options in (["--resume"], ["--force"]):
        refused = posterior(run.config, run.folder, *options)
        assert_refused(refused, "another run is writing here")
    assert_refused(command_line.cli("report", run.folder), "another run is writing here")
    assert command_line.listing(run.folder) == before
    process.send_signal(signal.SIGCONT)
    assert_resumes(run, process, signal.SIGINT, endless)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "processes"),
    [(signal.SIGINT, 2), (signal.SIGTERM, 1), (signal.SIGKILL, 1)],
    ids=lambda value: getattr(value, "name", value),
)
def test_interrupted_and_resumed_is_the_same_as_uninterrupted(
    number: signal.Signals,
    processes: int,
    endless: Done,
    tmp_path: Path,
    started: list[subprocess.Popen[str]],
) -> None:
    run = begun(tmp_path, processes, started)
    assert_resumes(run, started[0], number, endless)


@pytest.mark.slow
def test_workers_do_not_outlive_a_run_that_is_killed(
    tmp_path: Path, started: list[subprocess.Popen[str]]
) -> None:
    config = command_line.small_config(tmp_path, ENDLESS)
    pipes = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    arguments = ("posterior", config, "-o", tmp_path / "out", "--processes", "2")
    process = command_line.start_process(*arguments, cwd=tmp_path, **pipes)
    started.append(process)
    waited(process, lambda: len(pieces(tmp_path / "out")) >= 1)
    assert len(group(process.pid)) > 2
    process.kill()
    process.wait()
    end = time.monotonic() + 5
    while group(process.pid) and time.monotonic() < end:
        time.sleep(0.02)
    assert not group(process.pid)


@pytest.mark.slow
@pytest.mark.parametrize("seconds", [0.2, 0.5, 1.0, 1.5])
def test_ctrl_c_while_workers_start_shows_no_traceback(
    seconds: float, tmp_path: Path, started: list[subprocess.Popen[str]]
) -> None:
    config = command_line.small_config(tmp_path, ENDLESS)
    process = command_line.start_process(
        "posterior", config, "-o", "out", "--processes", "2", cwd=tmp_path
    )
    started.append(process)
    waited(process, (tmp_path / "out" / "run.json").exists)
    time.sleep(seconds)
    os.killpg(process.pid, signal.SIGINT)
    _, err = process.communicate(timeout=30)
    assert "Traceback" not in err


LARGE_RESULTS = """
import numpy as np
from bayesdrill.crew import Crew

def large(_):
    return np.zeros(4_000_000)

if __name__ == "__main__":
    with Crew(None, 2) as crew:
        tasks = [crew.submit(large) for _ in range(8)]
        tasks[0].result()
        raise KeyboardInterrupt
"""


@pytest.mark.slow
def test_ctrl_c_while_a_worker_hands_over_a_result(
    tmp_path: Path, started: list[subprocess.Popen[str]]
) -> None:
    (tmp_path / "large.py").write_text(LARGE_RESULTS)
    process = subprocess.Popen(
        [sys.executable, "large.py"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(command_line.ROOT)},
        stderr=subprocess.DEVNULL,
        text=True,
        start_new_session=True,
    )
    started.append(process)
    try:
        process.wait(timeout=15)
    except subprocess.TimeoutExpired:
        pytest.fail("hangs")


@pytest.mark.slow
def test_a_run_interrupted_before_its_first_piece_resumes(
    endless: Done, tmp_path: Path, started: list[subprocess.Popen[str]]
) -> None:
    config = command_line.small_config(tmp_path, ENDLESS)
    folder = tmp_path / "out"
    process = command_line.start_process(
        "posterior", config, "-o", folder, "--processes", "1", cwd=tmp_path
    )
    started.append(process)
    waited(process, (folder / "run.json").exists)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=30)
    assert process.returncode == 130, err
    assert "Traceback" not in err
    assert_refused(command_line.cli("report", folder), "--resume")
    assert posterior(config, folder, "--resume").status == 3
    assert_same_chains(endless.folder, folder)


@pytest.mark.slow
def test_a_run_cut_when_one_ensemble_had_just_reached_a_check_resumes(
    endless: Done, tmp_path: Path
) -> None:
    """The others had gone on, as the check was past: it must not be made again, with them longer."""
    config = command_line.small_config(tmp_path, ENDLESS)
    change(config, "max_steps: 700", "max_steps: 487")  # a check: 200, 250, 312, 390, 487
    one, other = tmp_path / "one", tmp_path / "other"
    assert posterior(config, one).status == 3
    shutil.copytree(one, other)
    change(config, "max_steps: 487", "max_steps: 500")
    assert posterior(config, other, "--resume").status == 3
    with h5py.File(one / "chain.h5") as short, h5py.File(other / "chain.h5", "r+") as long:
        del long["ensemble_2"]
        short.copy("ensemble_2", long)
    assert_refused(command_line.cli("report", other), "before its first check", "--resume")
    change(config, "max_steps: 500", "max_steps: 700")
    assert posterior(config, other, "--resume").status == 3
    assert_same_chains(endless.folder, other)


@pytest.mark.slow
@run_cases("steps", [100, 101])
def test_a_run_of_hardly_any_steps_says_that_it_is_too_short(steps: int, tmp_path: Path) -> None:
    slow = f"ess: 100, moves: {{stretch: 1}}, max_steps: {steps}"
    found = fresh(tmp_path, ("ess: 100, max_steps: 500", slow))
    assert found.ran.status == 3, found.ran.text
    assert "too short" in found.ran.out
    assert "autocorrelation times long" in found.ran.out
    run = run_of(found.folder)
    assert (run["steps"], run["burn_in"]) == (steps, steps // 2)
    assert run["burn_in_rule"].startswith("half of the run, too short for 5 autocorrelation times")


def test_a_run_cut_before_its_first_check_cannot_be_reported_yet(copy: Done) -> None:
    """Though its few steps may look converged."""
    with h5py.File(copy.folder / "chain.h5", "r+") as file:
        for group in file.values():
            for name in ("chain", "log_prob"):
                group[name].resize(150, axis=0)
            group.attrs["iteration"] = 150
            seal(group)
    before = command_line.listing(copy.folder)
    assert_refused(command_line.cli("report", copy.folder), "before its first check", "--resume")
    assert command_line.listing(copy.folder) == before


# --- what is there already -----------------------------------------------------------------------


def test_a_second_fresh_run_is_refused(copy: Done) -> None:
    before = command_line.listing(copy.folder)
    ran = posterior(copy.config, copy.folder)
    assert_refused(ran, "results exist already", "--resume", "--force")
    assert command_line.listing(copy.folder) == before


@run_cases("options", [[], ["--resume"], ["--force"]], ids=str)
def test_foreign_files_are_never_touched(options: list[str], tmp_path: Path) -> None:
    config = command_line.small_config(tmp_path / "rig")
    thesis = tmp_path / "home" / "thesis"
    thesis.mkdir(parents=True)
    (thesis / "chapter_1.tex").write_text("years of work")
    before = command_line.listing(tmp_path)
    assert_refused(posterior(config, tmp_path / "home", *options), "other files")
    assert command_line.listing(tmp_path) == before


@pytest.mark.slow
def test_force_leaves_hidden_files_of_others_alone(tmp_path: Path) -> None:
    config = command_line.small_config(tmp_path / "rig")
    head = tmp_path / "repository" / ".git" / "HEAD"
    head.parent.mkdir(parents=True)
    head.write_text("ref: refs/heads/main")
    posterior(config, tmp_path / "repository", "--force")
    assert head.read_text() == "ref: refs/heads/main"


@run_cases(
    "old, new, named",
    [
        (
            "low: 0.5, high: 1.5, relative: true}\n  k_T",
            "low: 0.6, high: 1.5, relative: true}\n  k_T",
            "the prior of k_e was Uniform(low=0.03008, high=0.09024) and is Uniform(low=0.0360959",
        ),
        ("c_m: nominal", "c_m: 2e-4", "c_m, which is held, was 0.00019 and is 0.0002"),
        (
            "j_1: {prior: uniform, low: 0.5, high: 1.5, relative: true}",
            "j_1: nominal",
            "the prior of j_1 was Uniform(low=0.01415, high=0.04245) and is not there",
        ),
        ("seed: 7", "seed: 8", "the seed was 7 and is 8"),
        ("w_1: {column: w_1, unit: rad/s, sigma: 0.05", "w_1: {column: w_1, unit: rad/s, sigma: 0.06",
         "the noise of w_1 was 0.05 and is 0.06"),
        ("walkers: 8", "walkers: 10", "sampler.walkers was 8 and is 10"),
        ("walkers: 8", "walkers: 8, moves: {stretch: 1}", "and is {'stretch': 1.0}"),
        ("walkers: 8", "walkers: 8, ensembles: 5", "sampler.ensembles was 4 and is 5"),
        ("evaluations: 500", "evaluations: 600", "map.evaluations was 500 and is 600"),
        ("v: 8.0", "v: 8.1", "the input v was 8.0 and is 8.1"),
        ("map: {", "initial: {w_1: 0.1}\nmap: {", "the initial state was "),
        ("unit: rad, sigma", "unit: rad, measures: 2 * theta_1, sigma", "the channel theta_1 was "),
        ("map: {", "model: {i_m: 0.25}\nmap: {",
         "the model was MotorShaft(i_m=0.125) and is MotorShaft(i_m=0.25)"),
    ],
    ids=lambda text: text.split(":")[0][:20], copy=copied_plain,
)  # fmt: skip
def test_resuming_something_else_names_what_changed_and_both_values(
    old: str, new: str, named: str, copy: Done
) -> None:
    before = command_line.listing(copy.folder)
    change(copy.config, old, new)
    ran = posterior(copy.config, copy.folder, "--resume")
    assert_refused(ran, "cannot resume", named, "--force", "--output")
    assert command_line.listing(copy.folder) == before


@run_cases("package", ["bayesdrill", "numpy", "scipy", "emcee", "llvmlite"], copy=copied_plain)
def test_resuming_under_another_version_of_what_decides_the_chain(package: str, copy: Done) -> None:
    """A chain is one chain: refused, with both versions. A report adds nothing, and may."""
    now = version(package)
    run = loads_checksummed((copy.folder / "run.json").read_bytes())
    run["fingerprint"][f"the version of {package}"] = "0.0.1"
    (copy.folder / "run.json").write_text(dumps_checksummed(run))
    before = command_line.listing(copy.folder)
    ran = posterior(copy.config, copy.folder, "--resume")
    assert_refused(ran, f"the version of {package} was 0.0.1 and is {now}", "--force")
    assert command_line.listing(copy.folder) == before
    if package == "numpy":
        assert command_line.cli("report", copy.folder, "--processes", "1").status == 0
        assert '"the version of numpy": "0.0.1"' in (copy.folder / "run.json").read_text()


def test_resuming_with_another_record_names_the_record(copy: Done) -> None:
    before = command_line.listing(copy.folder)
    record = copy.config.parent / "small.csv"
    lines = record.read_text().splitlines()
    time, theta_1, w_1 = map(float, lines[5].split(","))
    record.write_text("\n".join([*lines[:5], f"{time},{theta_1},{w_1 + 1e-6}", *lines[6:]]) + "\n")
    ran = posterior(copy.config, copy.folder, "--resume")
    assert_refused(ran, "cannot resume", "the record was 101 samples (")
    assert_refused(command_line.cli("report", copy.folder), "the record")
    assert command_line.listing(copy.folder) == before


@run_cases("text", ["[]", "null", '"x"', '{"fingerprint": 3}'], copy=copied_plain)
def test_a_run_json_that_is_json_but_no_run_is_named(text: str, copy: Done) -> None:
    (copy.folder / "run.json").write_text(text)
    before = command_line.listing(copy.folder)
    for option in ("--resume", "--force"):
        assert_refused(posterior(copy.config, copy.folder, option), "run.json", "another folder")
    assert command_line.listing(copy.folder) == before


def test_force_killed_as_it_cleared_leaves_a_folder_that_is_still_its_own(
    done: Done, copy: Done, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At each file taken away the folder must remain one that --force or --resume accepts."""
    reached = []

    def killed(*_: object) -> None:
        reached.append(count)
        raise SystemExit(-9)

    for count in (0, 5, 100):
        left = count

        def unlink(path: Path, missing_ok: bool = False) -> None:
            nonlocal left
            left -= 1
            if left < 0:
                killed()
            os.unlink(path)

        monkeypatch.setattr(Path, "unlink", unlink)
        if count == 100:  # all is taken away, and the new run.json is not there yet
            monkeypatch.setattr(Folder, "write_text", killed)
        with pytest.raises(SystemExit):
            Folder(copy.folder, "force", {}, POSTERIOR).__enter__().begin()
        monkeypatch.undo()
        assert (copy.folder / "run.json").exists()
        assert_refused(posterior(copy.config, copy.folder), "--resume", "--force")
    assert reached == [0, 5, 100]
    assert not (copy.folder / "figures").exists()
    assert posterior(copy.config, copy.folder, "--resume").status == 0
    assert_same_chains(done.folder, copy.folder)


@pytest.mark.slow
def test_a_run_killed_before_it_wrote_anything_may_begin_again(tmp_path: Path) -> None:
    config = command_line.small_config(tmp_path / "rig", ENDLESS)
    for name, option in (("plain", []), ("resumed", ["--resume"])):
        folder = tmp_path / name
        folder.mkdir()
        (folder / ".lock").touch()
        (folder / ".run.4711.aside.json").write_text("{")
        assert posterior(config, folder, *option).status == 3
        assert set(command_line.listing(folder)) == FILES - FIGURES


def test_a_walker_that_gets_stuck_keeps_a_run_from_being_believed(copy: Done) -> None:
    """The log density that one walker of each ensemble goes on from is spoilt, so that none of its
    proposals is accepted any more; R-hat, tau and ESS are content."""
    with h5py.File(copy.folder / "chain.h5", "r+") as file:
        for k in range(4):
            last = file[f"ensemble_{k}"]["chain"][-1]
            middle = np.argmin(np.abs(last / np.median(last, axis=0) - 1).max(axis=1))
            file[f"ensemble_{k}"]["log_prob"][-1, middle] += 1e6
            seal(file[f"ensemble_{k}"])
    change(copy.config, "ess: 100, max_steps: 500", "ess: 8000, max_steps: 1200")
    ran = posterior(copy.config, copy.folder, "--resume")
    assert ran.status == 3, ran.text
    assert "4 of 32 walkers (1 in ensemble 0, 1 in ensemble 1" in ran.out
    assert "stuck: the longest did not move for" in ran.out
    run = run_of(copy.folder)
    assert run["steps"] == 1200
    assert len(run["reasons"]) == 1
    assert "stuck" in (copy.folder / "summary.md").read_text()


def test_a_parameter_pressed_against_its_prior_is_told_and_believed(tmp_path: Path) -> None:
    """The record was made with k_e = 0.06016 V s/rad, which this prior leaves out by a little."""
    narrow = (
        "low: 0.5, high: 1.5, relative: true}\n  k_T",
        "low: 0.03, high: 0.06015, start: 0.05}\n  k_T",
    )
    found = fresh(tmp_path, narrow, ("ess: 100, max_steps: 500", "ess: 1000, max_steps: 5000"))
    assert found.ran.status == 0, found.ran.text
    assert "note: k_e is pressed against the end 0.06015 of its prior" in found.ran.out
    assert "k_e is pressed" in (found.folder / "summary.md").read_text()
    notes = run_of(found.folder)["notes"]
    assert [note for note in notes if note.startswith("note: k_e")]


def test_what_the_proposal_does_not_reach_is_said_and_ends_with_status_3(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also of a chain that is only read again; mutant killed: that is believed."""
    monkeypatch.setattr(learning, "missed_mass", lambda *_: 0.125)
    found = fresh(tmp_path)
    again = command_line.cli("report", found.folder, "--processes", "1")
    for ran in (found.ran, again):
        assert ran.status == 3, ran.text
        assert (
            "coverage: about 12 % of the posterior lies where the proposal hardly ever" in ran.out
        )
    run = run_of(found.folder)
    assert (run["missed"], run["verdict"]["agrees"]) == (0.125, None)
    assert "ROUGH" in (found.folder / "summary.md").read_text()


def test_a_little_that_the_proposal_does_not_reach_is_a_note(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Mutant killed: a run that is not believed for 2 %."""
    monkeypatch.setattr(learning, "missed_mass", lambda *_: 0.02)
    found = fresh(tmp_path)
    assert found.ran.status == 0, found.ran.text
    said = (
        "note: coverage: about 2 % of the posterior lies where the proposal hardly ever leads, so"
    )
    assert f"{said} the ends of intervals are rough" in found.ran.out
    assert run_of(found.folder)["missed"] == 0.02


def test_a_nominal_value_at_an_end_of_its_prior_is_not_judged(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    """The end is said, with the way out; a file of older versions, with draws beyond it, goes."""
    ends = ("k_e: {prior: uniform, low: 0.5", "k_e: {prior: uniform, low: 1.0")
    found = shared(tmp_path_factory, "end", ends)
    assert found.ran.status == 0, found.ran.text
    said = "Cannot judge: k_e. The prior of k_e ends at 0.06016; widen it."
    assert said in found.ran.out
    verdict = run_of(found.folder)["verdict"]
    assert verdict["ends"] == {"k_e": 0.06016}
    assert verdict["quantities"]["k_e"]["says"] == "cannot judge"
    (found.folder / "opened.npz").write_text("of an older version")
    again = command_line.cli("report", found.folder, "--processes", "1")
    assert again.status == 0, again.text
    assert said in again.out
    assert not (found.folder / "opened.npz").exists()


def digit_changed(content: bytes) -> bytes:
    """The first log posterior of `map.json`, by a hundredth."""
    return re.sub(rb"(log_posterior.*\.\d)\d", rb"\g<1>0", content, count=1)


@run_cases(
    "name, damage, way_out",
    [
        ("run.json", lambda content: content[:40], "put back a copy"),
        ("run.json", lambda content: content.replace(b"finished", b"finishes"), "put back a copy"),
        ("map.json", lambda content: content[:40], "delete it and continue with --resume"),
        ("map.json", lambda content: b"\xff" + content, "delete it and continue with --resume"),
        ("map.json", digit_changed, "delete it and continue with --resume"),
        ("chain.h5", lambda content: content[:40], "delete it and continue with --resume"),
    ],
    copy=copied_plain,
)
def test_a_damaged_result_is_named_and_nothing_is_written(
    name: str, damage: Callable[[bytes], bytes], way_out: str, copy: Done
) -> None:
    """Mutant killed: `run.json` says `running` before what is damaged was read."""
    content = (copy.folder / name).read_bytes()
    assert damage(content) != content
    (copy.folder / name).write_bytes(damage(content))
    before = command_line.listing(copy.folder)
    for ran in (
        posterior(copy.config, copy.folder, "--resume"),
        command_line.cli("report", copy.folder, "--processes", "1"),
    ):
        assert_refused(ran, name, way_out)
        assert "--force" not in ran.err
    assert command_line.listing(copy.folder) == before


def test_a_map_that_is_deleted_is_searched_again(done: Done, copy: Done) -> None:
    (copy.folder / "map.json").unlink()
    before = command_line.listing(copy.folder)
    ran = command_line.cli("report", copy.folder, "--processes", "1")
    assert_refused(ran, "map.json: is not there; continue with --resume")
    assert command_line.listing(copy.folder) == before
    assert posterior(copy.config, copy.folder, "--resume").status == 0
    for name in ("map.json", "chain.h5", "summary.csv"):
        assert (copy.folder / name).read_bytes() == (done.folder / name).read_bytes()


@pytest.mark.slow
def test_force_mends_a_damaged_folder(copy: Done) -> None:
    for name in ("map.json", "chain.h5"):
        (copy.folder / name).write_text("{")
    assert posterior(copy.config, copy.folder, "--force").status == 0


@pytest.mark.filterwarnings("ignore:unclosed file:ResourceWarning")
def test_a_damaged_piece_is_named(done: Done, tmp_path: Path) -> None:
    config = command_line.small_config(tmp_path, ENDLESS)
    shutil.copytree(done.folder, tmp_path / "out")
    (tmp_path / "out" / ".pieces").mkdir()
    first = run_of(done.folder)["steps"]
    piece = tmp_path / "out" / ".pieces" / f"ensemble_0_{first:09d}.npz"
    piece.write_bytes(b"PK\x03\x04 cut short")
    before = command_line.listing(tmp_path)
    assert_refused(posterior(config, tmp_path / "out", "--resume"), piece.name)
    assert command_line.listing(tmp_path) == before


# --- disks ---------------------------------------------------------------------------------------


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Callable[[str], Path]]:
    """A disk of its own, to be mounted and mounted again with other options."""
    place = tmp_path / "disk"
    place.mkdir()
    mounted = False

    def mount(options: str) -> Path:
        nonlocal mounted
        again = "remount," if mounted else ""
        command = ["mount", "-t", "tmpfs", "-o", again + options, "tmpfs", str(place)]
        if shutil.which("mount") is None or subprocess.run(command, capture_output=True).returncode:
            pytest.skip("nothing may be mounted here")
        mounted = True
        return place

    yield mount
    if mounted:
        subprocess.run(["umount", "-l", str(place)], check=True)


# Too little for the pieces, for the chain beside them, for what follows from it.
@pytest.mark.parametrize(
    "kilobytes",
    [
        pytest.param(150, marks=pytest.mark.slow),
        pytest.param(600, marks=pytest.mark.slow),
        pytest.param(640, marks=pytest.mark.slow),
    ],
)
def test_a_full_disk_ends_in_a_message_and_costs_nothing(
    kilobytes: int, done: Done, tmp_path: Path, small_disk: Callable[[str], Path]
) -> None:
    folder = small_disk(f"size={kilobytes}k") / "out"
    config = command_line.small_config(tmp_path / "rig")
    # In a process of its own: HDF5 may take the whole process down when it cannot write.
    arguments = ("posterior", config, "-o", folder, "--processes", "1")
    ran = command_line.run_process(*arguments, cwd=tmp_path)
    assert_refused(ran, f"{folder}", "No space left", "--resume")
    assert not [
        name for name in command_line.listing(folder) if Path(name).name.startswith(".chain")
    ]
    small_disk("size=50m")
    assert posterior(config, folder, "--resume").status == 0
    assert set(command_line.listing(folder)) == FILES - FIGURES
    assert_same_chains(done.folder, folder)


@pytest.mark.slow
def test_a_disk_that_takes_nothing_is_named(
    tmp_path: Path, small_disk: Callable[[str], Path]
) -> None:
    place = small_disk("size=50m")
    config = command_line.small_config(tmp_path / "rig")
    assert posterior(config, place / "out").status == 0
    before = command_line.listing(place)
    small_disk("ro")
    for output, *options in (["new"], ["out", "--resume"], ["out", "--force"]):
        assert_refused(posterior(config, place / output, *options), str(place), "ead-only")
    assert_refused(command_line.cli("report", place / "out"), str(place), "ead-only")
    ran = command_line.cli("simulate", config, "--output", place / "record.csv")
    assert_refused(ran, str(place), "ead-only")
    assert command_line.listing(place) == before


@pytest.mark.slow
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
def test_a_full_disk_under_the_output_of_check(tmp_path: Path) -> None:
    command_line.small_config(tmp_path)
    with Path("/dev/full").open("w") as full:
        process = command_line.start_process("check", "small.yaml", cwd=tmp_path, stdout=full)
        _, err = process.communicate(timeout=30)
    assert process.returncode == 2, err
    assert "Traceback" not in err
    assert "No space left" in err


# --- the command line ----------------------------------------------------------------------------


def test_a_pipe_closed_at_once_shows_no_traceback(tmp_path: Path) -> None:
    command_line.small_config(tmp_path)
    process = command_line.start_process("check", "small.yaml", cwd=tmp_path)
    assert process.stdout is not None
    process.stdout.close()
    process.stdout = None
    _, err = process.communicate(timeout=30)
    assert (process.returncode, err) == (0, "")


@pytest.mark.slow
def test_a_run_survives_that_nobody_reads_it_any_more(done: Done, tmp_path: Path) -> None:
    config = command_line.small_config(tmp_path)
    folder = tmp_path / "out"
    arguments = ("posterior", config, "-o", folder, "--processes", "1")
    process = command_line.start_process(*arguments, cwd=tmp_path, stderr=subprocess.STDOUT)
    assert process.stdout is not None
    process.stdout.close()
    process.stdout = None
    assert process.wait(timeout=60) == 0
    assert run_of(folder)["status"] == "finished"
    assert_same_chains(done.folder, folder)


def test_the_module_tells_its_version(tmp_path: Path) -> None:
    import bayesdrill

    ran = command_line.run_process("--version", cwd=tmp_path)
    assert (ran.status, ran.out) == (0, f"bayesdrill {bayesdrill.__version__}\n")


@run_cases("command", ["check", "map", "posterior", "report", "simulate", "schema"])
def test_help_shows_an_example(command: str) -> None:
    ran = command_line.cli(command, "--help")
    assert ran.status == 0
    assert f"Example: bayesdrill {command}" in " ".join(ran.out.split())
    assert command in command_line.cli("--help").out


@pytest.mark.slow
def test_a_column_in_another_unit_than_said_is_told_of_the_fit(tmp_path: Path) -> None:
    ran = command_line.cli("map", command_line.small_config(tmp_path), "--processes", "1")
    assert "fit: the residuals look like the noise" in ran.out
    config = command_line.small_config(tmp_path, ("w_1, unit: rad/s", "w_1, unit: rpm"))
    ran = command_line.cli("map", config, "--processes", "1")
    assert ran.status == 3
    assert "fit: the residuals are larger than the noise" in ran.out
    assert "look like" not in ran.out


def test_the_schema_is_json() -> None:
    ran = command_line.cli("schema")
    assert ran.status == 0
    assert json.loads(ran.out)["properties"]["sampler"]
