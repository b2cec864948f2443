"""`bayesdrill posterior CONFIG`: what a run leaves and prints, what it repeats, when it is believed."""

import itertools
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import xarray
from support import command_line, finished_runs
from support.finished_runs import FIGURES, FILES, FinishedRun

from bayesdrill.output_files import POSTERIOR, dumps_checksummed, loads_checksummed
from bayesdrill.sampling.proposal import learning
from bayesdrill.tasks import pipeline


def fresh(folder: Path, *changes: tuple[str, str], processes: int = 1) -> FinishedRun:
    """A run that is made here and now."""
    config = command_line.small_config(folder, *changes)
    result = command_line.posterior(config, folder / "out", processes=processes)
    return FinishedRun(config, folder / "out", result)


def test_a_run_leaves_a_complete_folder_and_nothing_else(drawn: FinishedRun) -> None:
    assert drawn.result.status == 0, drawn.result.text
    assert set(command_line.listing(drawn.folder)) == FILES | FIGURES
    assert {name for name in FILES if not POSTERIOR.is_output(name)} == {".lock", "figures"}
    assert (drawn.folder / "config.yaml").read_bytes() == drawn.config.read_bytes()
    for name in FIGURES:
        magic = b"%PDF" if name.endswith("pdf") else b"\x89PNG"
        assert (drawn.folder / name).read_bytes().startswith(magic)
    run = drawn.json
    assert (run["status"], run["converged"], run["seed"]) == ("finished", True, 7)
    assert "sampling: converged after " in drawn.result.out
    assert f"results: {drawn.folder}/" in drawn.result.out
    rows = (drawn.folder / "summary.csv").read_text().splitlines()[1:]
    assert [row.split(",")[0] for row in rows] == ["k_e", "j_1"]
    assert "converged: all targets are met" in (drawn.folder / "summary.md").read_text()


def test_the_tree_has_the_groups_and_units_of_arviz(converged: FinishedRun) -> None:
    with xarray.open_datatree(converged.folder / "posterior.nc", engine="h5netcdf") as tree:
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


def test_the_chain_does_not_depend_on_the_processes(converged: FinishedRun, tmp_path: Path) -> None:
    """And config and record are left as they were."""
    other = fresh(tmp_path, processes=2)
    assert other.result.status == 0, other.result.text
    converged.assert_same_chains(other)
    for name in ("summary.csv", "map.json"):
        assert (converged.folder / name).read_bytes() == (other.folder / name).read_bytes()
    assert other.config.read_text() == command_line.SMALL
    assert (tmp_path / "small.csv").read_text() == command_line.small_record()


def test_a_report_made_again_says_the_same_times_and_doubts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The run's own report rounds as `run.json` does; the global generator of NumPy is not used.

    Here the proposal does not cover an eighth of the posterior; of 2 % there is only a note.
    """
    state = np.random.get_state()  # noqa: NPY002
    clock = (k * 0.04996 for k in itertools.count())
    with monkeypatch.context() as patch:
        patch.setattr(pipeline, "time", SimpleNamespace(perf_counter=lambda: next(clock)))
        patch.setattr(learning, "missed_mass", lambda *_: 0.125)
        run = fresh(tmp_path)
    after = np.random.get_state()  # noqa: NPY002
    assert state[2:] == after[2:]
    assert np.array_equal(state[1], after[1])
    assert run.json["seconds"] == {"map": 0.05, "sampling": 0.05, "report": 0.05}
    page, report = run.folder / "report.html", ("report", run.folder, "--processes", "1")
    before = page.read_bytes()
    words = "about 12 % of the posterior lies where the proposal hardly ever"
    for result in (run.result, command_line.cli(*report)):
        assert result.status == 3, result.text
        assert f"coverage: {words}" in result.out
    assert page.read_bytes() == before
    assert (run.json["missed"], run.json["verdict"]["agrees"]) == (0.125, None)
    assert "ROUGH" in (run.folder / "summary.md").read_text()
    data = loads_checksummed((run.folder / "run.json").read_bytes())
    (run.folder / "run.json").write_text(dumps_checksummed({**data, "missed": 0.02}))
    result = command_line.cli(*report)
    assert result.status == 0, result.text
    words = "note: coverage: about 2 % of the posterior lies where the proposal hardly ever draws,"
    assert f"{words} so the ends of intervals are rough" in result.out
    assert run.json["missed"] == 0.02


def test_a_run_that_did_not_converge_says_so(unconverged: FinishedRun) -> None:
    result = unconverged.result
    assert result.status == 3
    assert set(command_line.listing(unconverged.folder)) == FILES
    for words in ("NOT CONVERGED", "effective draws of", "sampler.max_steps", "--resume"):
        assert words in result.out
    assert "NOT CONVERGED" in (unconverged.folder / "summary.md").read_text()
    run = unconverged.json
    assert (run["status"], run["converged"], run["steps"]) == ("finished", False, 700)
    assert command_line.cli("report", unconverged.folder, "--processes", "1").status == 3


def test_python_without_docstrings_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """ArviZ needs them, and fails as it is loaded, after minutes of sampling."""
    command_line.small_config(tmp_path)
    monkeypatch.setenv("PYTHONOPTIMIZE", "2")
    result = command_line.run_process("posterior", "small.yaml", cwd=tmp_path)
    assert result.status == 2
    assert result.err.splitlines() == [
        "python -OO removes docstrings that ArviZ needs; start Python without -OO"
    ]


@pytest.mark.slow
def test_a_nominal_value_at_an_end_of_its_prior_is_not_judged(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    """The end is named with the way out; a file of an older version is removed by the report."""
    ends = ("k_e: {prior: uniform, low: 0.5", "k_e: {prior: uniform, low: 1.0")
    run = finished_runs.run(tmp_path_factory, ends)
    assert run.result.status == 0, run.result.text
    words = "Cannot judge: k_e. The prior of k_e ends at 0.06016; widen it."
    assert words in run.result.out
    verdict = run.json["verdict"]
    assert verdict["ends"] == {"k_e": 0.06016}
    assert verdict["quantities"]["k_e"]["says"] == "cannot judge"
    (run.folder / "opened.npz").write_text("of an older version")
    report = command_line.cli("report", run.folder, "--processes", "1")
    assert report.status == 0, report.text
    assert words in report.out
    assert not (run.folder / "opened.npz").exists()
