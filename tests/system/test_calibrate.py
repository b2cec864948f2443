"""Calibrations: the same ranks wherever and however they are computed, and how they end."""

from __future__ import annotations

import csv
import dataclasses
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from support import command_line
from support.case_tables import run_cases

from bayesdrill import output_files
from bayesdrill.analysis.calibration import CalibrationStudy, refit
from bayesdrill.basics.errors import InputError, Interrupted
from bayesdrill.basics.progress import Silent
from bayesdrill.output_files import dumps_checksummed, loads_checksummed
from bayesdrill.rig.simulators.linear import Response
from bayesdrill.tasks import calibrate, remote

TINY = (
    (
        "output: {",
        "calibration: {refits: 10, draws: 19, n_tau: 5, ess: 50, max_steps: 600}\noutput: {",
    ),
)
FILES = {
    *(".lock", "config.resolved.yaml", "config.yaml", "ranks.csv", "run.json"),
    *("summary.md", "report.html"),
    *("figures", "figures/calibration.pdf", "figures/calibration.png", ".refits"),
    *(f".refits/{k:06d}.json" for k in range(10)),
}


@dataclass
class Stopping:
    """A reporter by which Ctrl-C comes when the work is at `share`."""

    share: float
    said: list[str] = field(default_factory=list)

    def say(self, text: str) -> None:
        self.said.append(text)

    def update(self, fraction: float, text: str) -> None:
        if self.share <= fraction < 1:
            raise KeyboardInterrupt


def here(config: Path, folder: Path, how: str = "fresh", report: object = None) -> object:
    """A calibration in this process."""
    with ThreadPoolExecutor(1) as pool:
        crew = remote.RefitExecutor(pool)
        try:
            job = calibrate.prepare(config)
            return calibrate.calibrate(job, folder, how, crew, report or Silent())  # type: ignore[arg-type]
        finally:
            pool.shutdown(cancel_futures=True)


def command(config: Path, folder: Path, *options: str) -> command_line.CommandResult:
    return command_line.cli("calibrate", config, "-o", folder, "--processes", "1", *options)


def run_of(folder: Path) -> dict[str, object]:
    return dict(json.loads((folder / "run.json").read_text()))


def change(path: Path, old: str, new: str) -> None:
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")


@dataclass(frozen=True)
class Done:
    config: Path
    folder: Path

    @property
    def ranks(self) -> bytes:
        return (self.folder / "ranks.csv").read_bytes()


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Done:
    """A finished calibration of a tiny config; tests copy it, or leave it as it is."""
    place = tmp_path_factory.mktemp("done")
    config = command_line.small_config(place, *TINY)
    here(config, place / "out")
    return Done(config, place / "out")


@pytest.fixture
def copy(done: Done, tmp_path: Path) -> Done:
    shutil.copytree(done.config.parent, tmp_path / "copy")
    return Done(tmp_path / "copy" / "small.yaml", tmp_path / "copy" / "out")


@pytest.fixture
def study(done: Done) -> CalibrationStudy:
    return calibrate.study(calibrate.prepare(done.config))


# --- one refit -----------------------------------------------------------------------------------


def test_a_refit_depends_on_the_study_and_its_index_alone(
    done: Done, study: CalibrationStudy
) -> None:
    """Computed again, in another order; kills a random stream that is shared by refits."""
    again = [refit(study, index) for index in (3, 1)]
    kept = {each.index: each for each in calibrate.saved(done.folder / ".refits", study)}
    assert again == [kept[3], kept[1]]
    assert len({each.truth for each in kept.values()}) == 10


def test_another_record_shares_the_compiled_code(study: CalibrationStudy) -> None:
    response = study.posterior.likelihood.only_observation.response
    y = np.random.default_rng(1).standard_normal(response.experiment.y.shape)
    theta = study.posterior.space.full(study.posterior.space.draw(9, np.random.default_rng(2)))
    other = response.with_record(y)
    assert other._kernel("misfit") is response._kernel("misfit")
    anew = Response(response.model, dataclasses.replace(response.experiment, y=y))
    assert np.array_equal(other.squares(theta), anew.squares(theta))
    assert not np.array_equal(other.squares(theta), response.squares(theta))
    with pytest.raises(ValueError, match="shape"):
        response.with_record(y[:-1])


def test_the_record_that_was_measured_plays_no_part(copy: Done) -> None:
    before = copy.ranks
    record = copy.config.parent / "small.csv"
    lines = record.read_text().splitlines()
    record.write_text("\n".join([*lines[:5], *reversed(lines[5:6]), *lines[6:]]) + "\n")
    change(record, lines[9], ",".join([lines[9].split(",")[0], "0.1", "0.2"]))
    assert command(copy.config, copy.folder, "--resume").status in (0, 3)
    record.unlink()  # the grid is in `simulation:` too
    assert command(copy.config, copy.folder, "--resume").status in (0, 3)
    assert copy.ranks == before


# --- what it leaves, and how it goes on ----------------------------------------------------------


def test_a_calibration_leaves_a_complete_folder_and_nothing_else(done: Done) -> None:
    assert set(command_line.listing(done.folder)) == FILES
    assert {name for name in FILES if not output_files.CALIBRATE.is_output(name)} == {
        *(".lock", "figures", ".refits"),
    }
    run = run_of(done.folder)
    assert (run["status"], run["refits"], run["seed"]) == ("finished", 10, 7)
    rows = list(csv.DictReader((done.folder / "ranks.csv").read_text().splitlines()))
    assert [int(row["refit"]) for row in rows] == list(range(10))
    assert all(0 <= int(row["rank_log_likelihood"]) <= 19 for row in rows)
    summary = (done.folder / "summary.md").read_text()
    assert str(run["verdict"])[1:] in summary
    assert "at most 1 %" in summary


@run_cases(
    "change",
    [
        {"ranks": [0, 0, 20]},  # of 19 draws
        {"ranks": [0, 0, -1]},
        {"ranks": [0, 0]},
        {"ranks": []},  # and converged
        {"ranks": ["0", "0", "0"]},
        {"truth": [1.0]},
        {"truth": [1.0, float("nan"), 0.0]},
        {"truth": "abc"},
        {"index": 2},
        {"steps": 10**400},
        {"reasons": 0},
        {"seconds": None},
    ],
    ids=str,
)
def test_a_refit_of_another_study_is_not_believed(
    change: dict[str, object], done: Done, study: CalibrationStudy, tmp_path: Path
) -> None:
    """Sealed as the house does it, with other types, or ranks that cannot be."""
    data = loads_checksummed((done.folder / ".refits" / "000001.json").read_bytes())
    (tmp_path / "000001.json").write_text(dumps_checksummed(data))
    assert [each.index for each in calibrate.saved(tmp_path, study)] == [1]
    (tmp_path / "000001.json").write_text(dumps_checksummed({**data, **change}))
    with pytest.raises(InputError, match=r"000001.json: is damaged; delete it"):
        calibrate.saved(tmp_path, study)


def test_ctrl_c_keeps_the_refits_that_are_done(
    done: Done, study: CalibrationStudy, tmp_path: Path
) -> None:
    folder = tmp_path / "out"
    with pytest.raises(Interrupted, match="saved"):
        here(done.config, folder, report=Stopping(0.05))
    assert run_of(folder)["status"] == "interrupted"
    kept = calibrate.saved(folder / ".refits", study)
    assert 1 <= len(kept) < 10
    assert set(kept) <= set(calibrate.saved(done.folder / ".refits", study))
    assert not (folder / "ranks.csv").exists()


def test_resumed_is_the_same_as_uninterrupted(done: Done, copy: Done) -> None:
    """Some refits were done, others not, when the run before was killed."""
    for name in ("ranks.csv", "summary.md", ".refits/000002.json", ".refits/000009.json"):
        (copy.folder / name).unlink()
    here(copy.config, copy.folder, "resume")
    assert copy.ranks == done.ranks
    assert (copy.folder / "summary.md").read_bytes() == (done.folder / "summary.md").read_bytes()


def test_results_are_neither_overwritten_nor_mixed(copy: Done) -> None:
    before = command_line.listing(copy.folder)
    ran = command(copy.config, copy.folder)
    assert (ran.status, "results exist already" in ran.err) == (2, True)
    change(copy.config, "draws: 19", "draws: 20")
    ran = command(copy.config, copy.folder, "--resume")
    assert (ran.status, "calibration.draws" in ran.err) == (2, True)
    change(copy.config, "draws: 20", "draws: 19")
    change(copy.config, "rad/s, sigma: 0.05", "rad/s, sigma: 0.06")
    ran = command(copy.config, copy.folder, "--resume")
    assert (ran.status, "the noise" in ran.err) == (2, True)
    assert command_line.listing(copy.folder) == before


@run_cases(
    "changes, told",
    [
        ([("ess: 50,", "ess: 18,")], "18 effective draws do not hold 19 independent ones"),
        ([("max_steps: 600", "max_steps: 99")], "calibration.max_steps: 99"),
        ([("refits: 10", "refits: 9")], "calibration.refits"),
    ],
)
def test_a_calibration_that_cannot_be_is_refused(
    changes: list[tuple[str, str]], told: str, tmp_path: Path
) -> None:
    config = command_line.small_config(tmp_path, *TINY)
    for old, new in (*changes, ("max_steps: 500", "max_steps: 5000")):
        change(config, old, new)
    ran = command(config, tmp_path / "out")
    assert (ran.status, told in ran.err) == (2, True), ran.text
    assert not (tmp_path / "out").exists()


def test_a_damaged_refit_is_named(copy: Done) -> None:
    path = copy.folder / ".refits" / "000007.json"
    digit = path.read_text().replace('"index": 7', '"index": 6')
    for damage in ("{", "[1, 2]", '{"index": 7}', digit):
        path.write_text(damage)
        before = command_line.listing(copy.folder)
        ran = command(copy.config, copy.folder, "--resume")
        assert (ran.status, "000007.json" in ran.err, "Traceback" in ran.text) == (2, True, False)
        assert command_line.listing(copy.folder) == before


def test_the_status_is_the_verdict(copy: Done) -> None:
    """Ranks of zero everywhere: what a posterior far too high gives."""
    status = command(copy.config, copy.folder, "--resume").status
    assert status == (0 if run_of(copy.folder)["calibrated"] else 3)
    for path in (copy.folder / ".refits").glob("*.json"):
        data = loads_checksummed(path.read_bytes())
        path.write_text(dumps_checksummed({**data, "ranks": [0, 0, 0]}))
    ran = command(copy.config, copy.folder, "--resume")
    assert ran.status == 3
    assert "not calibrated: ranks of" in ran.out
    assert "(posterior too high)" in ran.out


def test_help_shows_an_example() -> None:
    ran = command_line.cli("calibrate", "--help")
    assert "Example: bayesdrill calibrate" in " ".join(ran.out.split())


# --- processes and clusters ----------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    "number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL], ids=lambda number: number.name
)
def test_processes_that_are_stopped_lose_nothing(
    number: signal.Signals, done: Done, tmp_path: Path, started: list[subprocess.Popen[str]]
) -> None:
    folder = tmp_path / "out"
    arguments = ("calibrate", done.config, "-o", folder, "--processes", "2")
    process = command_line.start_process(*arguments, cwd=tmp_path)
    started.append(process)
    end = time.monotonic() + 60
    while len(list((folder / ".refits").glob("*.json"))) < 3 and time.monotonic() < end:
        time.sleep(0.02)
    begun = time.monotonic()
    if number == signal.SIGINT:
        os.killpg(process.pid, number)
    else:
        process.send_signal(number)
    _, err = process.communicate(timeout=30)
    assert time.monotonic() - begun < 10
    assert "Traceback" not in err
    if number != signal.SIGKILL:
        assert process.returncode == 130, err
        assert "continue with --resume" in err
        assert run_of(folder)["status"] == "interrupted"
    ran = command_line.run_process(*arguments, "--resume", cwd=tmp_path)
    assert ran.status in (0, 3), ran.text
    assert (folder / "ranks.csv").read_bytes() == done.ranks


@pytest.mark.slow
def test_a_worker_of_a_cluster_that_is_killed_costs_nothing(done: Done, tmp_path: Path) -> None:
    """One of three workers gets SIGKILL in the middle: every refit once, equal to the local ones."""
    distributed = pytest.importorskip("distributed")
    folder = tmp_path / "out"
    with distributed.LocalCluster(
        n_workers=3, threads_per_worker=1, processes=True, dashboard_address=None
    ) as cluster:
        pids = [worker.pid for worker in cluster.workers.values()]
        killed = threading.Event()

        @dataclass(frozen=True)
        class Killing(Silent):
            def update(self, fraction: float, text: str) -> None:
                if fraction >= 0.25 and not killed.is_set():
                    killed.set()
                    os.kill(pids[1], signal.SIGKILL)

        job = calibrate.prepare(done.config)
        with remote.dask_executor(cluster.scheduler_address) as crew:
            found = calibrate.calibrate(job, folder, "fresh", crew, Killing())
    assert killed.is_set()
    assert [each.index for each in found.refits] == list(range(10))
    assert (folder / "ranks.csv").read_bytes() == done.ranks
    assert list(found.refits) == calibrate.saved(done.folder / ".refits", calibrate.study(job))


@pytest.mark.slow
def test_a_scheduler_that_is_not_there_is_named(done: Done, tmp_path: Path) -> None:
    begun = time.monotonic()
    for address, told in (
        ("tcp://127.0.0.1:1", "no scheduler answers at tcp://127.0.0.1:1"),
        ("nonsense://x:y", "'nonsense://x:y' is no address"),
        ("tcp://no.such.host:8786", "no scheduler answers at tcp://no.such.host:8786"),
    ):
        arguments = ("calibrate", done.config, "-o", "out", "--scheduler", address)
        ran = command_line.run_process(*arguments, cwd=tmp_path)
        assert (ran.status, "Traceback" in ran.text) == (2, False), ran.text
        assert told in ran.err
        assert len(ran.err.splitlines()) == 1, ran.err
    assert time.monotonic() - begun < 30
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_without_distributed_a_scheduler_is_refused(done: Done, tmp_path: Path) -> None:
    code = "import sys; sys.modules['distributed'] = None; from bayesdrill.cli import main; main()"
    arguments = ["calibrate", str(done.config), "--scheduler", "tcp://127.0.0.1:1"]
    ran = subprocess.run(
        [sys.executable, "-c", code, *arguments], cwd=tmp_path, capture_output=True, text=True
    )
    assert ran.returncode == 2
    assert "bayesdrill[cluster]" in ran.stderr
    assert "Traceback" not in ran.stderr
