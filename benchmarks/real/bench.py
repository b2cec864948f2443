"""What a bench is: its files, what was published of them, and what a run has to find."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

HERE = Path(__file__).parent
DATA = HERE / "data"  # no part of the repository

Values = Mapping[str, float]


@dataclass(frozen=True, slots=True)
class File:
    """A file below the folder of its bench: its path in the repository, and its SHA-256."""

    name: str
    path: str
    digest: str


@dataclass(frozen=True, slots=True)
class Criterion:
    """A figure of the maximum, and the range in which it has to be."""

    name: str
    unit: str
    figure: Callable[[Values], float]
    low: float
    high: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Bench:
    """A rig, its config, and its files at a `commit` of a `repository` on GitHub.

    `left`: the largest share of its spread that may be left of a channel that is fitted.
    `disagrees`: nominal values that the verdict of a sampled posterior has to call wrong.  `prepare`
    makes what the config reads of files that the package does not read.
    """

    name: str
    folder: str
    repository: str
    commit: str
    licence: str
    published: str
    files: tuple[File, ...]
    criteria: tuple[Criterion, ...]
    left: float = math.inf
    prepare: Callable[[Bench], None] | None = None
    disagrees: tuple[str, ...] = ()

    @property
    def config(self) -> Path:
        return HERE / f"{self.name}.yaml"

    def place(self, file: File) -> Path:
        return DATA / self.folder / file.name

    def address(self, file: File) -> str:
        path = file.path.replace(" ", "%20")
        return f"https://raw.githubusercontent.com/{self.repository}/{self.commit}/{path}"

    @property
    def absent(self) -> tuple[File, ...]:
        return tuple(file for file in self.files if not self.place(file).exists())
