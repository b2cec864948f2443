"""Where one begins: the bundled configs and records, in a folder of one's own."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path

from bayesdrill.basics.checked import checked


@dataclass(frozen=True, slots=True)
class Example:
    """What `example` wrote, and what to try with it."""

    folder: Path
    files: tuple[Path, ...]

    def __str__(self) -> str:
        return (
            f"{self.folder}/: configs with their records, to run and to copy; try\n"
            f"  bayesdrill check {shlex.quote(str(self.files[0]))}"
        )

    __repr__ = __str__


@checked
def example(folder: str | Path = "configs") -> Example:
    """Writes the bundled configs and records into a folder, and overwrites nothing.

    Raises `InputError` with each of them that is there already.
    """
    from bayesdrill.setup import examples

    place = Path(folder).expanduser()
    return Example(place, examples.write(place))
