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
from bayesdrill.setup import simulating
from benchmarks.zoo.row import Entry
from benchmarks.zoo.texts import as_csv, as_yaml, changed, parsed

Array = NDArray[np.float64]
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

    def load(self, folder: Path) -> bd.Case:
        """Writes record and config to `folder`, and reads them as a user would."""
        record, path = folder / f"{self.name}.csv", folder / f"{self.name}.yaml"
        time = {"column": "t", "unit": "s"}
        entries = {"name": self.name, "seed": self.seed, **self.config}
        entries["record"] = {"file": record.name, "time": time, **self.config["record"]}
        config, source = parsed(path, as_yaml(entries))
        empty = {spec.column: np.arange(len(self.t)) for spec in config.record.channels.values()}
        record.write_text(as_csv({"t": self.t, **empty, **self.series}), encoding="utf-8")
        text = simulating.simulate(config, source, self.seed)
        record.write_text(self._with_blanks(text, len(empty)), encoding="utf-8")
        path.write_text(as_yaml(changed(entries, self.read)), encoding="utf-8")
        return bd.load(path)

    def _with_blanks(self, text: str, channels: int) -> str:
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
