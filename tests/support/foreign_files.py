"""Files of others in the places of results, and what stands there instead of files."""

import os
from collections.abc import Callable, Mapping
from pathlib import Path


def put(folder: Path, name: str, text: str = "mine") -> None:
    """Write a file, or make an empty folder where the name ends in a slash."""
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    if name.endswith("/"):
        path.mkdir()
    else:
        path.write_text(text)


def linked(path: Path) -> None:
    """Link to something of the same sort elsewhere, which is not to be touched."""
    elsewhere = path.parent.parent / "elsewhere"
    path.rename(elsewhere)
    path.symlink_to(elsewhere)


def dangling(path: Path) -> None:
    """Link to nothing."""
    path.unlink()
    path.symlink_to("nowhere")


def folder_instead(path: Path) -> None:
    """Make a folder of that name, with a file in it."""
    path.unlink()
    put(path, "mine")


def pipe(path: Path) -> None:
    """Make a pipe of that name."""
    path.unlink()
    os.mkfifo(path)


def file_instead(path: Path) -> None:
    """Make a file in the place of a folder."""
    path.rename(path.with_name("figures.old"))
    path.write_text("mine")


SPOIL: Mapping[str, Callable[[Path], None]] = {
    "linked": linked,
    "dangling": dangling,
    "folder": folder_instead,
    "pipe": pipe,
    "file": file_instead,
}
