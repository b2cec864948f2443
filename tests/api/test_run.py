"""Runs: what they say, save and draw; in other processes they are the same, and threads may save."""

import dataclasses
import pickle
import re
import shutil
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pytest
import xarray
from matplotlib.figure import Figure
from support import command_line
from support.array_cases import T, noisy, results, run, two
from support.case_tables import run_cases

import bayesdrill as bd
from bayesdrill import output_files
from bayesdrill.basics.equality import equal_content
from bayesdrill.report import scales, style
from bayesdrill.rig.kernels.compiling import compile_kernel


def fresh() -> bd.Run:
    """Return a run that has computed nothing yet but its draws."""
    return dataclasses.replace(run())


def test_a_run_says_what_it_estimates() -> None:
    judged = run().judge()
    rows = {row["name"]: row for row in judged.rows}
    assert rows["k_s"]["mean"] == pytest.approx(0.31, abs=4 * rows["k_s"]["sd"])
    assert judged.verdict is not None
    assert not judged.verdict.agrees
    assert "| k_s |" in judged._repr_markdown_()
    assert re.search(r"verdict: .*disagree", str(run()))
    assert set(run().draws) == {"k_s", "t_f"}
    assert all("k_s" in str(results()[name]) for name in ("RunReport", "Findings", "Best"))


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a saved run, not to be changed."""
    return fresh().save(tmp_path_factory.mktemp("run") / "mine")


def test_a_saved_run_opens_as_it_was(saved: Path, tmp_path: Path) -> None:
    """It is one of `bayesdrill posterior`, whose report makes the same tables again."""
    folder = shutil.copytree(saved, tmp_path / "mine")
    opened = bd.open(folder)
    assert np.array_equal(opened.draws["t_f"], run().draws["t_f"])
    assert opened.judge().rows == run().judge().rows
    assert opened.converged == run().converged
    with xarray.open_datatree(folder / "posterior.nc", engine="h5netcdf") as tree:
        assert {*tree["derived"].data_vars} == {*run().to_arviz()["derived"].data_vars}
    before = (folder / "summary.csv").read_bytes()
    (folder / "summary.csv").unlink()
    assert command_line.cli("report", folder, "--processes", "1").status == 0
    assert (folder / "summary.csv").read_bytes() == before
    with pytest.raises(bd.InputError, match="results exist already"):
        run().save(folder)
    with pytest.raises(bd.InputError, match="holds the record of this run"):
        opened.save(folder, force=True)
    assert bd.open(folder).converged == run().converged
    with pytest.raises(bd.InputError, match="no results here"):
        bd.open(tmp_path / "nowhere")


def test_a_run_draws_figures_and_gives_a_tree_of_arviz() -> None:
    assert isinstance(run().plot_corner(), Figure)
    figure = run().plot("fit")
    assert isinstance(figure, Figure)
    assert figure._repr_png_().startswith(b"\x89PNG")  # what a notebook shows, without pyplot
    with pytest.raises(bd.InputError, match="did you mean corner"):
        run().plot("cornor")
    tree = run().to_arviz()
    assert tree["posterior"]["k_s"].shape == run().draws["k_s"].shape
    assert tree["posterior"].attrs["seed"] == 4


def test_a_figure_that_fails_is_named_when_a_run_is_saved(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise ValueError("cannot do this")

    with monkeypatch.context() as patch:
        patch.setattr("bayesdrill.report.sections.corner.derived_shown", fail)
        reason = r"figures/corner \(ValueError: cannot do this\)"
        with pytest.warns(UserWarning, match=reason) as warnings:
            folder = run().save(tmp_path / "mine")
    assert warnings[0].filename == __file__
    assert (folder / "summary.csv").exists()
    assert run().save(tmp_path / "again").exists()  # what could be made this time is not missing


def test_results_are_equal_after_pickling() -> None:
    """Twice over, for what they compute meanwhile is no part of them; nothing is compiled for that."""
    columns = {"channel": noisy("w_1", 1.0, 0.1), "input": bd.Input([1.0, float("nan")], "V")}
    for name, result in (results() | columns).items():
        packed, compilations = pickle.dumps(result), compile_kernel.cache_info().misses
        back = pickle.loads(packed)
        assert compile_kernel.cache_info().misses == compilations, name
        assert back is not result, name
        assert back == result, name
        assert hash(back) == hash(result), name
        if name in ("Case", "Best", "RunReport"):
            assert str(back) == str(result), name
        assert pickle.loads(pickle.dumps(back)) == result, name


def test_computed_results_are_not_pickled_with_a_run() -> None:
    judged = fresh()
    assert judged.judge().text
    assert len(pickle.dumps(judged)) == len(pickle.dumps(fresh()))


def test_cases_and_runs_differ_if_one_number_does() -> None:
    """A sample, a seed, a start or a draw."""
    w_1 = noisy("w_1", 1.0, 0.1)
    moved = dataclasses.replace(w_1, values=np.where(T[7] == T, 1e-9, 0.0) + w_1.values)
    channels = {"theta_2": noisy("theta_2", np.pi / 180, 0.05), "w_1": moved}
    assert two() == two()
    for other in (two(seed=5), two(initial={"w_1": 1e-9}), two(channels=channels), 3):
        assert two() != other
    draws = np.copy(run().sampled.theta)
    draws[0, 0, 0, 0] = np.nextafter(draws[0, 0, 0, 0], 1.0)
    sampled = dataclasses.replace(run().sampled, theta=draws)
    assert dataclasses.replace(run(), sampled=sampled) != run()
    assert fresh() == run() != run().judge()


@run_cases(
    "one, other, equal",
    [
        ({"a": [np.array([1.0, np.nan])]}, {"a": [np.array([1.0, np.nan])]}, True),
        (float("nan"), -float("nan"), True),
        (np.zeros(2), np.zeros(2, int), False),
        (np.zeros(2), np.zeros((2, 1)), False),
        ([1, 2], (1, 2), False),
        ({"a": 1}, {"a": 1, "b": 2}, False),
        ([1], [1, 2], False),
        (len, max, False),
        (int, float, False),
    ],
)
def test_equality_looks_into_arrays_and_containers(one: Any, other: Any, equal: bool) -> None:
    assert equal_content(one, other) == equal


def test_an_error_is_the_same_after_pickling() -> None:
    with pytest.raises(bd.InputError) as error:
        bd.case(T, {}, {"v": "x"}, {})
    back = pickle.loads(pickle.dumps(error.value))
    assert str(back) == str(error.value)
    assert back.problems == error.value.problems


THREADS = 2
TIMED = ("run.json", "posterior.nc")  # the time at which they were made stands in them


def digests(folder: Path) -> dict[str, str]:
    files = [path for path in folder.rglob("*") if path.is_file()]
    return {str(path.relative_to(folder)): output_files.digest(path) for path in files}


def save_at_once(folders: list[Path]) -> list[Path | bd.InputError]:
    """Save runs that each judge their draws, each by its own thread."""
    barrier = threading.Barrier(len(folders))

    def save(folder: Path) -> Path | bd.InputError:
        barrier.wait()
        try:
            return fresh().save(folder)
        except bd.InputError as error:
            return error

    with ThreadPoolExecutor(len(folders)) as pool:
        return [*pool.map(save, folders)]


def test_threads_that_save_at_once_write_the_same_files_as_one(saved: Path, tmp_path: Path) -> None:
    """To the byte, figures too; and the style of the caller's figures is as it was."""
    before, alone = dict(matplotlib.rcParams), digests(saved)
    folders = [tmp_path / f"of_{k}" for k in range(THREADS)]
    assert save_at_once(folders) == folders
    assert dict(matplotlib.rcParams) == before
    for folder in folders:
        files = digests(folder)
        assert files.keys() == alone.keys()
        assert {name for name in alone if files[name] != alone[name]} <= {*TIMED}
    assert bd.verify(folders[0]).together


def test_one_thread_draws_at_a_time() -> None:
    """The style belongs to the process; what the second thread draws has its own."""
    sizes = []

    def draw() -> None:
        with style.styled(scales.SINGLE):
            sizes.append(matplotlib.rcParams["font.size"])

    with ThreadPoolExecutor(1) as pool:
        with style.styled():
            other = pool.submit(draw)
            with pytest.raises(TimeoutError):
                other.result(timeout=0.1)
        other.result(timeout=30)
    assert sizes == [style.SMALL * style.RC["font.size"]]
