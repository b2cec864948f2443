"""Runs that threads save, each for itself or all to one place."""

from __future__ import annotations

import dataclasses
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import matplotlib
import pytest
from support.array_cases import run

import bayesdrill as bd
from bayesdrill import output_files
from bayesdrill.report import scales, style

THREADS = 3
OF_THE_MOMENT = ("run.json", "posterior.nc")  # when it was made stands in them


def contents(folder: Path) -> dict[str, str]:
    files = [path for path in folder.rglob("*") if path.is_file()]
    return {str(path.relative_to(folder)): output_files.digest(path) for path in files}


def saved(folder: Path) -> Path | bd.InputError:
    """By a run of its own, which judges its draws once more."""
    try:
        return dataclasses.replace(run()).save(folder)
    except bd.InputError as error:
        return error


def at_once(folders: list[Path]) -> list[Path | bd.InputError]:
    together = threading.Barrier(len(folders))

    def save(folder: Path) -> Path | bd.InputError:
        together.wait()
        return saved(folder)

    with ThreadPoolExecutor(len(folders)) as pool:
        return [*pool.map(save, folders)]


def test_what_threads_save_at_once_is_what_one_saves(tmp_path: Path) -> None:
    """To the byte, figures among it; and the style of the caller's figures is as it was."""
    before = dict(matplotlib.rcParams)
    alone = contents(saved(tmp_path / "alone"))  # type: ignore[arg-type]
    folders = [tmp_path / f"of_{k}" for k in range(THREADS)]
    assert at_once(folders) == folders
    assert dict(matplotlib.rcParams) == before
    for folder in folders:
        found = contents(folder)
        assert found.keys() == alone.keys()
        changed = {name for name in alone if found[name] != alone[name]}
        assert changed <= {*OF_THE_MOMENT}
    assert bd.verify(folders[0]).together


def test_of_threads_that_save_to_one_folder_one_does(tmp_path: Path) -> None:
    """The others say that it is taken, and nothing of theirs is there."""
    answers = at_once([tmp_path / "mine"] * THREADS)
    refused = [one for one in answers if isinstance(one, bd.InputError)]
    assert len(refused) == THREADS - 1
    for one in refused:
        assert "another run is writing here" in str(one) or "results exist already" in str(one)
    assert bd.verify(tmp_path / "mine").together
    assert not [*(tmp_path / "mine").rglob("*.aside*")]


def test_files_of_two_threads_grow_apart(tmp_path: Path) -> None:
    def write() -> Path:
        with output_files.atomic_write(tmp_path / "table.csv") as aside:
            aside.write_text("theirs")
            return aside

    with ThreadPoolExecutor(1) as pool, output_files.atomic_write(tmp_path / "table.csv") as mine:
        mine.write_text("mine")
        assert pool.submit(write).result() != mine
    assert (tmp_path / "table.csv").read_text() == "mine"


def test_one_thread_draws_at_a_time() -> None:
    """For the style belongs to the process; what the second thread draws has its own."""
    seen = []

    def draw() -> None:
        with style.styled(scales.SINGLE):
            seen.append(matplotlib.rcParams["font.size"])

    with ThreadPoolExecutor(1) as pool:
        with style.styled():
            other = pool.submit(draw)
            with pytest.raises(TimeoutError):
                other.result(timeout=0.1)
        other.result(timeout=30)
    assert seen == [style.SMALL * style.RC["font.size"]]
