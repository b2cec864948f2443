"""A job: a config that has been read or given in memory, checked against its record, and built.

The units of the user: in which people are shown channels, inputs, time and unknowns.

Files for machines are SI, each number with its unit.
"""

from __future__ import annotations

import dataclasses
import io
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from bayesdrill.basics import symbols, units
from bayesdrill.basics.entries import entries_of
from bayesdrill.basics.errors import InputError, Issue, of_each
from bayesdrill.basics.errors import Issue as Wrong
from bayesdrill.basics.symbols import Symbol, plain
from bayesdrill.basics.units import Unit
from bayesdrill.config import loading
from bayesdrill.config.records import reading
from bayesdrill.config.resolve import assembly, experiments, sensors
from bayesdrill.config.resolve.experiments import View, views
from bayesdrill.config.schema.config import Asked, Config
from bayesdrill.config.schema.numbers import Quantity, QuantityPrior
from bayesdrill.config.schema.records import Column, TimeColumn
from bayesdrill.config.yaml_source import Source, parse
from bayesdrill.inference import derived, step_error
from bayesdrill.inference.likelihood import Observation
from bayesdrill.inference.posterior import Problem
from bayesdrill.inference.priors import Prior
from bayesdrill.output_files import RECORD
from bayesdrill.record.experiment import Channel, raise_if_any
from bayesdrill.record.formats.table import Table
from bayesdrill.rig.models.composed import constants
from bayesdrill.rig.models.linear import Model
from bayesdrill.sampling.mode_search import Mode

Array = NDArray[np.float64]

SECOND = Unit("s", 1.0, "s")
MANY = 1e4  # of the units of a record: nobody reads so many milliseconds


def time_unit(config: Config) -> Unit:
    spec = config.record.time
    return units.shown(spec.unit if isinstance(spec, TimeColumn) else "s", "s")


def clock_unit(config: Config, problem: Problem) -> Unit:
    """That of the time column, unless times in it are very many; of several experiments, the first's."""
    unit, last = time_unit(config), max(one.experiment.t[-1] for one in problem.observations)
    return SECOND if last / unit.factor >= MANY else unit


def channel_unit(config: Config, one: Channel) -> Unit:
    spec = config.record.channels[one.name]
    return units.shown(spec.unit, one.unit, one.latex_unit)


def given_unit(config: Config, name: str) -> Unit:
    """Of an input; SI of a speed that was given as an angle."""
    spec, symbol = getattr(config.inputs, name), symbols.INPUTS[name]
    unit = spec.unit if isinstance(spec, Column | Quantity) else symbol.unit
    return units.shown(unit, symbol.unit, symbol.latex_unit)


class Told(Protocol):
    """A row of a table, with the values of an unknown in its `unit` under names of `_VALUES`."""

    @property
    def name(self) -> str: ...

    @property
    def unit(self) -> str: ...


_VALUES = ("nominal", "map", "mean", "sd", "hdi_low", "hdi_high", "pressed_against")


@dataclass(frozen=True, slots=True)
class OwnUnits:
    """How unknowns, held and derived quantities are shown, by name; what is not here is in SI."""

    units: Mapping[str, Unit]

    @classmethod
    def of(cls, config: Config, problem: Problem) -> OwnUnits:
        """Each as it was declared: noise and offsets in the unit of their column, quantities and
        formulas in that of their entry.
        """
        own = {
            name: spec.unit
            for name, spec in config.quantities.items()
            if isinstance(spec, Quantity | QuantityPrior)
        }
        own |= {name: spec.unit for name, spec in config.derived.items()}
        sensed: dict[str, Unit] = {}
        for observation in problem.observations:
            sensed |= _of_experiment(config, problem, observation)
        return cls(sensed | {name: units.shown(unit) for name, unit in own.items()})

    def over(self, others: OwnUnits) -> OwnUnits:
        """These, and those of others where these say nothing."""
        return OwnUnits({**others.units, **self.units})

    def factor(self, name: str) -> float:
        """How many SI one of what is shown is."""
        return self.units[name].factor if name in self.units else 1.0

    def factors(self, shown: Iterable[Symbol]) -> Array:
        return np.array([self.factor(symbol.name) for symbol in shown])

    def symbol(self, si: Symbol) -> Symbol:
        """With its unit in words and in LaTeX."""
        own = self.units.get(si.name)
        return si if own is None else dataclasses.replace(si, unit=own.name, latex_unit=own.latex)

    def symbols(self, si: Iterable[Symbol]) -> tuple[Symbol, ...]:
        return tuple(map(self.symbol, si))

    def values(self, si: Mapping[str, float]) -> dict[str, float]:
        return {name: value / self.factor(name) for name, value in si.items()}

    def said(self, name: str, si: float, digits: int = 4) -> str:
        """Its value in a sentence, with the unit where that is the user's own: `0.1 deg`."""
        number = f"{si / self.factor(name):.{digits}g}"
        unit = self.units[name].name if name in self.units else ""
        return f"{number} {plain(unit)}" if unit not in ("", "1") else number

    def believed(self, name: str, si: Prior) -> str:
        """Its prior in words, with the unit where that is the user's own."""
        unit = self.units[name].name if name in self.units else ""
        said = self.prior(name, si).describe()
        return f"{said}, in {plain(unit)}" if unit not in ("", "1") else said

    def rows[R: Told](self, si: Sequence[R]) -> tuple[R, ...]:
        """Of a table."""
        return tuple(map(self._row, si))

    def _row[R: Told](self, si: R) -> R:
        own = self.units.get(si.name)
        if own is None:
            return si
        known = {key: getattr(si, key, None) for key in _VALUES}
        values = {key: x / own.factor for key, x in known.items() if x is not None}
        return dataclasses.replace(si, unit=own.name, **values)  # type: ignore[type-var]

    def prior(self, name: str, si: Prior) -> Prior:
        return si if (factor := self.factor(name)) == 1.0 else si.scaled(1 / factor)

    def priors(self, si: Mapping[str, Prior]) -> dict[str, Prior]:
        return {name: self.prior(name, prior) for name, prior in si.items()}


SI = OwnUnits({})


def _of_experiment(config: Config, problem: Problem, observation: Observation) -> dict[str, Unit]:
    """Of its noise, its sensors and its start."""
    label = observation.label
    alone = experiments.experiment_configs(config, label)
    found = {
        symbols.noise_name(one.name): channel_unit(alone, one)
        for one in observation.experiment.channels
    }
    for entry in sensors.sensor_entries(alone, problem.model):
        told = sensors.sensor_specs(entry)
        if told.unit != told.symbol.unit:
            found[told.name] = units.shown(told.unit, told.symbol.unit)
    return {experiments.common_or_own(config, name, label): unit for name, unit in found.items()}


@dataclass(frozen=True, slots=True, kw_only=True)
class Shown:
    """Unknowns as figures show them: all numbers in the units of `symbols`; `columns`: of all draws."""

    columns: tuple[int, ...]
    factors: Array
    symbols: tuple[Symbol, ...]
    priors: Mapping[str, Prior]
    nominal: Mapping[str, float]
    mode: Mapping[str, float]

    def of(self, si: Array) -> Array:
        """`(..., D)` of all unknowns to those that are shown."""
        picked = si if len(self.columns) == si.shape[-1] else si[..., self.columns]
        return picked if (self.factors == 1.0).all() else picked / self.factors


FARTHEST = 1e10  # of a start from the record, in sigmas: rounding would hide any way to it


@dataclass(frozen=True, slots=True, kw_only=True)
class Job:
    config: Config
    source: Source
    problem: Problem

    def at(self, found: Mode) -> Job:
        """With the steps that are enough where its maximum is, of a rig that is stepped."""
        if not found.pieces:
            return self
        posterior = step_error.taking(self.problem.posterior, found.pieces)
        return replace(self, problem=replace(self.problem, posterior=posterior))

    @property
    def asked(self) -> Asked:
        return assembly.asked(self.config)

    @property
    def units(self) -> OwnUnits:
        """In which people are shown what is inferred."""
        return OwnUnits.of(self.config, self.problem)

    @property
    def clock(self) -> Unit:
        """In which they are told times."""
        return clock_unit(self.config, self.problem)


def prepare(path: Path) -> Job:
    """Everything that can be wrong with the input is found here; nothing is written."""
    config, source = loading.load(path)
    return assemble(config, source)


def assemble(config: Config, source: Source, table: Table | None = None) -> Job:
    """The job of a config that is already validated; `source` is where its paths start.

    `table`: the record, where it is in no file.
    """
    every = views(config, source)
    records = of_each(lambda view: reading.read(view.config, view.source, table), every)
    problem = assembly.problem(config, every, records)
    posterior = problem.posterior
    start = posterior.space.vector(posterior.space.start)
    if not np.isfinite(posterior.density(start[None])[0]):
        unsteady = _unsteady(every, problem, start)
        message = "the model has no finite response at the start; check values and units"
        raise InputError(unsteady or [source.problem(("parameters",), message)])
    off = float(posterior.likelihood.per_number(start[None])[0]) ** 0.5
    if off > FARTHEST:
        message = f"the start is {off:.2g} times the noise off the record; check values and units"
        raise InputError([source.problem(("parameters",), message)])
    impossible = derived.impossible(problem)
    if impossible:
        named = [source.problem(("derived", name), text) for name, text in impossible.items()]
        raise InputError(named)
    return Job(config=config, source=source, problem=problem)


def _unsteady(every: Sequence[View], problem: Problem, start: Array) -> list[Wrong]:
    """Experiments that are said to begin steadily, of a rig that has no steady state."""
    full = problem.posterior.space.full(start[None])
    seen = {one.label: one for one in problem.observations}
    message = (
        "the rig has no steady state at the start values under the first inputs; give the start, or "
        "`free`"
    )
    return [
        view.source.problem(("initial",), message)
        for view in every
        if view.label in seen
        and view.config.initial.state == "steady"
        and not np.isfinite(seen[view.label].signals(full)[0, 0]).any()
    ]


PLACE = Path("arrays")  # begins the places of mistakes
TIME = "t"
DEEPEST = 20  # of entries within entries
LONGEST = 1000  # bits of a whole number


def job_in_memory(columns: Mapping[str, Array], entries: Mapping[str, Any]) -> Job:
    """Of `columns`, each `(T,)`, time among them as `t`, and `entries` as in YAML.

    Raises `InputError` with all that is wrong with either.
    """
    table = Table(path=Path(RECORD), variables=dict(columns))
    record = {"file": RECORD, **entries.get("record", {})}
    record.setdefault("time", {"column": TIME, "unit": "s"})
    source = parse(PLACE, _as_yaml({**entries, "record": record}))
    source = dataclasses.replace(source, lines={})  # of a text that nobody has seen
    return assemble(loading.validated(source), source, table)


def arrays_as_csv(columns: Mapping[str, Array]) -> str:
    """All digits, so that it reads back the same."""
    lines = zip(*(values.tolist() for values in columns.values()), strict=True)
    return "\n".join([",".join(columns), *(",".join(map(repr, line)) for line in lines)]) + "\n"


def model_entry(rig: Model) -> dict[str, Any]:
    """As `model:` of a config has it."""
    own = entries_of(type(rig))
    return {"name": rig.name, **{n: x for n, x in constants(rig).items() if n in own}}


def _as_yaml(entries: Mapping[str, Any]) -> str:
    from ruamel.yaml import YAML

    out = io.StringIO()
    yaml = YAML(typ="safe", pure=True)
    yaml.default_flow_style = False
    found: list[Issue] = []
    plain = _plain(entries, (), found)
    raise_if_any(found)
    yaml.dump(plain, out)
    return out.getvalue()


def _plain(value: Any, place: tuple[str, ...], found: list[Issue]) -> Any:
    """As YAML can have it, numbers of NumPy as Python has them; of the rest a problem is `found`."""
    if len(place) > DEEPEST:
        found.append(Issue(".".join(place[:4]), "is nested too deep; see docs/config.md"))
        return None
    if isinstance(value, Mapping):
        return {str(key): _plain(one, (*place, str(key)), found) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(one, (*place, str(k)), found) for k, one in enumerate(value)]
    if isinstance(value, np.generic) or (isinstance(value, np.ndarray) and value.ndim == 0):
        value = value.item()
    known = value is None or isinstance(value, bool | float | str)
    if not known and not (isinstance(value, int) and value.bit_length() < LONGEST):
        what = "a number of so many digits" if isinstance(value, int) else type(value).__name__
        message = f"no entry can be {what}; see docs/config.md for what it can be"
        found.append(Issue(".".join(place), message))
    return value
