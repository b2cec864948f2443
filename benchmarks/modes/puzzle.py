"""A record that several places of the prior explain: how it is made, and how it is read."""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

import bayesdrill as bd
from bayesdrill.config.records import simulation
from bayesdrill.inference.posterior import Posterior
from benchmarks.modes import grid
from benchmarks.modes.grid import Modes
from benchmarks.zoo.row import Entry
from benchmarks.zoo.texts import as_csv, as_yaml, changed, parsed

Array = NDArray[np.float64]
TIME = {"column": "t", "unit": "s"}
Kind = Literal["gap", "delay", "aliases", "friction", "signs", "mixed"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Puzzle:
    """A simulated record at times `t (T,)` [s], and the config that reads it.

    `config` makes the record, without name, seed and `record.file`; its inputs are measured where
    `series` has them, `(T,)` each.  `read`: changes of entries at dotted places, under which the record
    is read: windows, held out samples, masks.  `dropped` samples are blank in the record.
    `cells`: of the coarsest grid, for each unknown; it must have some eight for each swing of the log
    density.  `split`: a number at which two branches part without a valley between them, for example
    of friction that holds and friction that does not.  `quick`: one of those that `make test` runs.
    """

    name: str
    kind: Kind
    shows: str
    config: Entry
    t: Array
    cells: tuple[int, ...]
    series: Mapping[str, Array] = field(default_factory=dict)
    dropped: slice | None = None
    read: Entry = field(default_factory=dict)
    split: tuple[str, float] | None = None
    quick: bool = False
    own_seed: int | None = None

    @property
    def seed(self) -> int:
        """By the name unless given, so that no two records share their noise."""
        return zlib.crc32(self.name.encode()) % 100_000 if self.own_seed is None else self.own_seed

    @property
    def entries(self) -> Entry:
        """The config that reads the record, without name, seed and `record.file`."""
        return changed(self._making, self.read)

    @property
    def _making(self) -> Entry:
        return {**self.config, "record": {"time": TIME, **self.config["record"]}}

    def record(self, path: Path) -> str:
        """The text of the record, which will stand at `path`."""
        case = parsed(path.with_suffix(".yaml"), self._text(self._making, path))
        empty = {
            spec.column: np.arange(len(self.t)) for spec in case.config.record.channels.values()
        }
        path.write_text(as_csv({"t": self.t, **empty, **self.series}), encoding="utf-8")
        return self._with_blanks(simulation.simulate(case, self.seed))

    def load(self, folder: Path) -> bd.Case:
        """Writes record and config to `folder`, and reads them as a user would."""
        record, path = folder / f"{self.name}.csv", folder / f"{self.name}.yaml"
        record.write_text(self.record(record), encoding="utf-8")
        path.write_text(self._text(self.entries, record), encoding="utf-8")
        return bd.load(path)

    def modes(self, posterior: Posterior, finer: int = 1) -> Modes:
        """By a grid; `finer`: so many times as many cells to begin with, for each unknown."""
        return grid.modes(posterior, tuple(finer * n for n in self.cells), self.split)

    def _text(self, entries: Entry, record: Path) -> str:
        own = {"name": self.name, "seed": self.seed}
        return as_yaml({**own, **entries, "record": {"file": record.name, **entries["record"]}})

    def _with_blanks(self, text: str) -> str:
        if self.dropped is None:
            return text
        head, *rows = text.splitlines()
        keys = head.split(",")
        for k in range(len(rows))[self.dropped]:
            cells = rows[k].split(",")
            kept = [
                c if n == "t" or n in self.series else "" for n, c in zip(keys, cells, strict=True)
            ]
            rows[k] = ",".join(kept)
        return "\n".join([head, *rows]) + "\n"
