"""Build gains, offsets and lags of sensors in SI, and the observation model of an experiment."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from bayesdrill.basics import symbols, units
from bayesdrill.basics.symbols import Symbol
from bayesdrill.config.building.initial import state_name, symbol_of_state
from bayesdrill.config.building.parsed_numbers import (
    ParsedNumber,
    ends_of,
    number_in_si,
)
from bayesdrill.config.schema import numbers
from bayesdrill.config.schema.config import Config
from bayesdrill.config.schema.numbers import Quantity, SensorPrior
from bayesdrill.config.schema.records import DELAY, InputColumn, InputQuantity
from bayesdrill.config.yaml_source import IssueCollector, Location
from bayesdrill.inference.unknowns import Role
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.simulators.sensors import ObservationModel

SensorKind = Literal["gain", "offset", "lag", "delay", "state"]
SensorNumber = float | Quantity | SensorPrior


@dataclass(frozen=True, slots=True)
class SensorEntry:
    """A sensor entry gives one number of the channel, input or state `target`, in `unit`."""

    location: Location
    kind: SensorKind  # inputs have one common delay, or a lag each
    target: str
    symbol: Symbol
    spec: SensorNumber
    unit: str


SensorNumbers = Mapping[SensorEntry, ParsedNumber | None]  # None for a number with a mistake


def check_sensors(
    errors: IssueCollector, config: Config, model: Model, free: Sequence[str]
) -> tuple[SensorNumbers, ObservationModel | None]:
    """Return gains, offsets, lags and initial states, and the observation model."""
    checked = {e: _sensor_number(errors, e) for e in sensor_entries(config, model)}
    sensing = errors.run(("inputs",), build_sensing, config, [*checked], free)
    _check_ineffective(errors, config)
    return checked, sensing


def sensor_entries(config: Config, model: Model) -> Iterator[SensorEntry]:
    """Yield the entries in the order of the unknowns: channels, inputs, initial states."""
    for name, spec in config.record.channels.items():
        if spec.derived_from is not None:
            continue
        location: Location = ("record", "channels", name)
        signals = (*model.states, *model.combinations)
        measured = (s for s in signals if s == name or s in (spec.measures or ""))
        si = next((model.symbols[signal].unit for signal in measured), "1")  # "1" if misspelt
        signal = config.vocabulary.signals.get(name) or symbols.own_symbol(name, "1", None, "")
        yield from _column_entries(location, "lag", spec, si, signal.latex)
    for name, symbol in config.vocabulary.inputs.items():
        input_spec = config.inputs.get(name)
        if isinstance(input_spec, InputColumn | InputQuantity):
            late: SensorKind = "delay" if len(config.measured_inputs) == 1 else "lag"
            at: Location = ("inputs", name)
            yield from _column_entries(at, late, input_spec, symbol.unit, symbol.latex)
    if (shift := config.inputs.get(DELAY)) is not None:
        delay = Symbol(DELAY, "s", "t_0", "s", "delay of the inputs")
        yield SensorEntry(("inputs", DELAY), "delay", "", delay, shift, "s")
    for name in model.outer:
        start = config.initial.get(name)
        if isinstance(start, SensorPrior):  # fixed and `free` states have no `SensorEntry`
            symbol = symbol_of_state(model, name)
            yield SensorEntry(("initial", name), "state", name, symbol, start, symbol.unit)


def _column_entries(
    location: Location, late: SensorKind, spec: Any, si: str, latex: str
) -> Iterator[SensorEntry]:
    """Yield the entries of a column; `late` is `delay` for a single input, else `lag`."""
    name = str(location[-1])
    lag = f"lag of the sensor of {name}" if late == "lag" else f"delay of {name}"
    kinds: tuple[tuple[str, SensorKind, str, str, str, str], ...] = (
        ("gain", "gain", "1", "1", "g", f"gain of the sensor of {name}"),
        ("offset", "offset", spec.unit, si, "b", f"offset of {name}"),
        ("lag", late, "s", "s", r"\tau", lag),
    )
    for key, kind, unit, unit_in_si, sign, meaning in kinds:
        entry = getattr(spec, key, None)
        if entry is not None:
            drawn, shown_unit = rf"{sign}_{{{latex}}}", symbols.latex_unit(unit_in_si)
            symbol = Symbol(f"{key}_{name}", unit_in_si, drawn, shown_unit, meaning)
            yield SensorEntry((*location, key), kind, name, symbol, entry, unit)


def _sensor_number(errors: IssueCollector, entry: SensorEntry) -> ParsedNumber | None:
    """Return the number of an entry; None if the entry or its column's unit has a mistake."""
    if entry.kind == "offset" and not getattr(entry.spec, "unit", None):
        try:
            units.factor(entry.unit, entry.symbol.unit)
        except ValueError:
            return None
    return errors.run(entry.location, parse_sensor_number, entry)


def parse_sensor_number(entry: SensorEntry) -> ParsedNumber:
    """Return the number of an entry in SI."""
    unit = getattr(entry.spec, "unit", None) or entry.unit
    factor = 1.0 if entry.kind == "gain" else units.factor(unit, entry.symbol.unit)
    value, start = number_in_si(entry.spec, factor)
    if not isinstance(value, float) and getattr(entry.spec, "start", None) is None:
        start = float(value.quantile(np.array([0.5]))[0])
    low, high = ends_of(value, 1e-6)
    if entry.kind == "gain" and low <= 0 <= high:
        raise ValueError(
            "a channel with a gain of zero shows nothing; keep its prior on one side of zero, "
            "such as `prior: log_normal, median: 1, sd_log: 0.02`"
        )
    role: Role = "start" if entry.kind == "state" else "sensor"
    return ParsedNumber(
        symbol=entry.symbol, role=role, value=value, start=start, factor=factor, unit=unit
    )


def _check_ineffective(errors: IssueCollector, config: Config) -> None:
    """Add an issue for each gain, offset or lag that has no effect."""
    for name, spec in config.record.channels.items():
        for kind in numbers.SensorFields.model_fields if spec.derived_from is not None else ():
            if getattr(spec, kind) is not None:
                evidence = (
                    f"{name} is derived from {spec.derived_from}, so it is not used as evidence"
                )
                errors.add(("record", "channels", name, kind), f"{evidence}; remove this")
    for name in config.vocabulary.inputs:
        input_spec = config.inputs.get(name)
        is_zero = isinstance(input_spec, InputQuantity) and input_spec.value == 0
        if is_zero and input_spec.gain is not None:
            message = "a gain has no effect on an input of zero; give `offset:`, or another value"
            errors.add(("inputs", name, "gain"), message)


def build_sensing(
    config: Config, entries: Sequence[SensorEntry], free: Sequence[str]
) -> ObservationModel:
    """Return the observation model of an experiment with these sensor `entries` and free states."""
    names: dict[tuple[SensorKind, bool], dict[str, str]] = defaultdict(dict)
    for entry in entries:
        names[entry.kind, entry.location[0] == "inputs"][entry.target] = entry.symbol.name
    delays = [*names["delay", True].values()]
    if len(delays) > 1 or (delays and names["lag", True]):
        raise ValueError(
            "inputs have either one common delay, `t_0:`, or each measured input has a `lag:`; remove "
            "one of the two"
        )
    return ObservationModel(
        gains=names["gain", False],
        offsets=names["offset", False],
        lags=names["lag", False],
        input_gains=names["gain", True],
        input_offsets=names["offset", True],
        input_lags=names["lag", True],
        delay=delays[0] if delays else None,
        states=names["state", False] | {name: state_name(name) for name in free},
        steady=config.initial.state == "steady",
    )
