"""Where the records of the zoo come from: the package's own rig, friction that it has not, files."""

from __future__ import annotations

import io
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bayesdrill.config.building.case import ResolvedCase
from bayesdrill.config.records import simulation
from bayesdrill.record.experiment import times
from benchmarks.zoo.friction import DryFriction
from benchmarks.zoo.plant import Plant
from benchmarks.zoo.row import Entry
from benchmarks.zoo.signals import Signal
from benchmarks.zoo.texts import as_csv, as_yaml, changed, parsed

Array = NDArray[np.float64]

DATA = "BAYESDRILL_DATA"  # the folder of records that are no part of the project
ROOT = Path(__file__).parents[2]


def data() -> Path:
    return Path(os.environ.get(DATA, ROOT.parent / "shared" / "data"))


@dataclass(frozen=True, slots=True)
class Steady:
    """By `bayesdrill simulate`: constant inputs, the grid stands in the config."""

    available = True

    def record(self, case: ResolvedCase, path: Path) -> str:
        return simulation.simulate(case, case.config.seed)


@dataclass(frozen=True, slots=True, kw_only=True)
class Driven:
    """By `bayesdrill simulate`, under inputs that are measured: the `series`, for `duration` [s].

    `late`: so many samples are the columns of the inputs behind what drove the rig.
    """

    duration: float
    rate: float
    series: Mapping[str, Signal]
    late: int = 0
    available = True

    def record(self, case: ResolvedCase, path: Path) -> str:
        t = times(self.duration, self.rate)
        plant = Plant.of(case, 1.0 / self.rate)
        inputs = {name: signal.series(t, plant) for name, signal in self.series.items()}
        # Channels are filled in by the simulation, which reads times and inputs from the record.
        empty = {spec.column: np.arange(len(t)) for spec in case.config.record.channels.values()}
        path.write_text(as_csv({"t": t, **empty, **inputs}), encoding="utf-8")
        text = simulation.simulate(case, case.config.seed)
        return _later(text, tuple(inputs), self.late) if self.late else text


def _later(text: str, names: tuple[str, ...], samples: int) -> str:
    head, _, body = text.partition("\n")
    columns = dict(
        zip(head.split(","), np.loadtxt(io.StringIO(body), delimiter=",").T, strict=True)
    )
    for name in names:
        first = np.full(samples, columns[name][0])
        columns[name] = np.concatenate([first, columns[name][:-samples]])
    return as_csv(columns)


@dataclass(frozen=True, slots=True, kw_only=True)
class Otherwise:
    """By another config than the row's own: `changes` of whole entries, by their dotted names."""

    changes: Entry
    maker: Steady | Driven = field(default_factory=Steady)
    available = True

    def record(self, case: ResolvedCase, path: Path) -> str:
        source = case.source
        other = parsed(source.path, as_yaml(changed(source.data, self.changes)))
        return self.maker.record(other, path)


@dataclass(frozen=True, slots=True, kw_only=True)
class Rubbing:
    """By a small integrator of its own, with dry friction that changes its sign."""

    duration: float
    rate: float
    voltage: Signal
    friction: DryFriction
    available = True

    def record(self, case: ResolvedCase, path: Path) -> str:
        t = times(self.duration, self.rate)
        v = self.voltage.series(t, Plant.of(case, 1.0 / self.rate))
        rng = np.random.default_rng(case.config.seed)
        measured = self.friction.measured(case, t, v, rng)
        return as_csv({"t": t, **measured, "v": v})


@dataclass(frozen=True, slots=True)
class Taken:
    """From a file below the folder of data, as it is."""

    file: str

    @property
    def available(self) -> bool:
        return (data() / self.file).exists()

    def record(self, case: ResolvedCase, path: Path) -> str:
        return (data() / self.file).read_text(encoding="utf-8")
