"""The record and the experiment: channels, time, inputs, noise, sensors and the initial state,
with their units.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass

from bayesdrill.basics import symbols, units
from bayesdrill.basics.entries import unknown_keys
from bayesdrill.basics.formulas import linear_combination
from bayesdrill.basics.registry import lookup
from bayesdrill.basics.symbols import INPUTS, noise_name
from bayesdrill.config.resolve import quantities, sensors
from bayesdrill.config.resolve.case import Beside
from bayesdrill.config.resolve.quantities import Declared
from bayesdrill.config.resolve.sensors import Entry, Measured
from bayesdrill.config.schema import numbers
from bayesdrill.config.schema.config import Config
from bayesdrill.config.schema.records import (
    AngleColumn,
    ChannelSpec,
    Column,
    FileSpec,
    InputColumn,
    InputQuantity,
    Series,
    TimeColumn,
    windows,
)
from bayesdrill.config.yaml_source import Collector, Place
from bayesdrill.inference.noise import NOISES
from bayesdrill.inference.unknowns import Unknown
from bayesdrill.record.formats import FORMATS
from bayesdrill.rig import models
from bayesdrill.rig.models.linear import Model, missing_requirements, with_named
from bayesdrill.rig.simulators.sensors import ObservationModel


@dataclass(frozen=True, slots=True)
class Sensed:
    """Of sensors and the start: entries, each as declared or None with a mistake, states of which the
    record tells, and all of it in words of simulators, where it goes together.
    """

    entries: tuple[Entry, ...]
    declared: tuple[Declared | None, ...]
    free: tuple[str, ...]
    sensing: ObservationModel | None


def check_sensors(found: Collector, config: Config, model: Model) -> Sensed:
    entries = tuple(sensors.sensor_entries(config, model))
    declared = tuple(_declared(found, entry) for entry in entries)
    free = sensors.free_states(config, model)
    sensing = found.run(("inputs",), sensors.sensing, config, entries, free)
    names = [entry.name for entry in entries] + [sensors.state_name(name) for name in free]
    for name in config.quantities:
        if name in names:
            found.add(("quantities", name), "a sensor's number has this name; choose another one")
    _check_vain(found, config)
    if config.initial.state == "steady":
        _check_steady(found, config, model)
    return Sensed(entries, declared, free, sensing)


def beside(
    config: Config,
    channels: Mapping[str, Measured | None],
    sensed: Sensed,
    torque: Mapping[str, float | Unknown | None],
) -> Beside:
    """Of a channel with a mistake, which is said elsewhere, only what is given, as None: what a kind of
    noise has unless it is told otherwise may be what its entry was to hold.
    """
    pairs = zip(sensed.entries, sensed.declared, strict=True)
    numbers_ = {entry.name: None if one is None else one.value for entry, one in pairs}
    levels: dict[str, Unknown | None] = {}
    for name, channel in channels.items():
        if channel is not None:
            found = sensors.noise([channel], n_samples=1).unknowns
            levels |= {unknown.name: unknown for unknown in found}
        elif isinstance(config.record.channels[name].sigma, numbers.ParameterPrior):
            levels[noise_name(name)] = None
    if None not in torque.values():
        levels |= {name: one for name, one in torque.items() if isinstance(one, Unknown)}
    return Beside(
        sensors=numbers_ | {sensors.state_name(name): None for name in sensed.free},
        levels=levels,
        channels=tuple(config.record.channels),
    )


def _declared(found: Collector, entry: Entry) -> Declared | None:
    """An offset without a unit of its own has that of its column, of which a mistake is told there."""
    if entry.kind == "offset" and not getattr(entry.spec, "unit", None):
        try:
            units.factor(entry.unit, entry.si)
        except ValueError:
            return None
    return found.run(entry.place, sensors.sensor_specs, entry)


def _check_vain(found: Collector, config: Config) -> None:
    """Numbers of sensors that change nothing."""
    for name, spec in config.record.channels.items():
        for kind in numbers.Sensed.model_fields if spec.derived_from is not None else ():
            if getattr(spec, kind) is not None:
                message = (
                    f"{name} is derived from {spec.derived_from}, and no evidence; remove this"
                )
                found.add(("record", "channels", name, kind), message)
    for name in INPUTS:
        given = getattr(config.inputs, name)
        if isinstance(given, InputQuantity) and given.gain is not None and given.value == 0:
            message = "a gain of nothing changes nothing; give `offset:`, or another value"
            found.add(("inputs", name, "gain"), message)


def _check_steady(found: Collector, config: Config, model: Model) -> None:
    """The inputs give all but where the angles begin."""
    if model.frictions:
        message = (
            "where a rig that rubs turns steadily, or sticks, is not worked out; write "
            "`initial: free`, or the states there"
        )
        found.add(("initial",), message)
        return
    named = [name for name in model.states if name in config.initial.model_fields_set]
    angles = [name for name in named if models.STATES[name].unit == "rad"]
    for name in named:
        if name not in angles:
            message = "the steady state gives it; remove this entry, or `state: steady`"
            found.add(("initial", name), message)
    for name in angles[1:]:
        message = (
            f"the steady state gives the twist, and {angles[0]} the rest; remove one of the two"
        )
        found.add(("initial", name), message)


def check_channels(found: Collector, config: Config, model: Model) -> dict[str, Measured | None]:
    """Those that are evidence: what is only derived from another is not.  None with a mistake."""
    measured = dict[str, Measured | None]()
    for name, spec in config.record.channels.items():
        place: Place = ("record", "channels", name)
        channel = _check_measured(found, place, spec, model)
        check_series(found, place, spec)
        if (source := spec.derived_from) is None:
            measured[name] = channel
            continue
        others = {one: other for one, other in config.record.channels.items() if one != name}
        at = (*place, "derived_from")
        found.expect(at, source, others, f"'{source}' is no other channel")
        if source in others and (first := others[source].derived_from) is not None:
            found.add(at, f"'{source}' is itself derived from {first}; name that channel")
    return measured


def _check_measured(
    found: Collector, place: Place, spec: ChannelSpec, model: Model
) -> Measured | None:
    """Entry by entry, so that each mistake has the line where it stands."""
    before, name = len(found.problems), str(place[-1])
    combines = {name: 1.0}
    if spec.measures is not None:
        text, at = spec.measures, (*place, "measures")
        combines = found.run(at, linear_combination, text, model.outer) or {}
    states = [models.STATES[state] for state in combines if state in model.outer]
    if states:
        found.run((*place, "unit"), units.factor, spec.unit, states[0].unit)
    kinds, vain = {name: kind.Entries for name, kind in NOISES.usable().items()}, dict[str, str]()
    if found.run((*place, "noise"), lookup, NOISES, spec.noise.name, "noise") is not None:
        vain = unknown_keys(("name", "noise"), kinds, kinds[spec.noise.name], spec.noise)
    for entry, message in vain.items():
        found.add((*place, "noise", entry), message)
    channel = None
    if len(found.problems) == before:
        channel = found.run(place, sensors.channel_of, name, spec, model.outer)
    if channel is None:
        return None
    measured = found.run((*place, "sigma"), sensors.measured, channel, spec)
    made = measured and found.run((*place, "noise"), sensors.noise, [measured], 1)
    return measured if made else None


def check_series(found: Collector, place: Place, spec: Series) -> None:
    _check_address(found, place, spec)
    if isinstance(spec.time, TimeColumn):
        found.run((*place, "time", "unit"), units.factor, spec.time.unit, "s")
        _check_address(found, (*place, "time"), spec.time)
    if isinstance(spec.file, FileSpec) and spec.file.format is not None:
        found.run((*place, "file", "format"), lookup, FORMATS, spec.file.format, "format")


def _check_address(found: Collector, place: Place, spec: Column) -> None:
    if spec.column is None and spec.variable is None:
        found.add(place, "neither `column:` nor `variable:` says where the numbers stand")


def check_record(found: Collector, config: Config) -> None:
    time = config.record.time
    if isinstance(time, TimeColumn):
        found.run(("record", "time", "unit"), units.factor, time.unit, "s")
        _check_address(found, ("record", "time"), time)
    if config.record.format is not None:
        found.run(("record", "format"), lookup, FORMATS, config.record.format, "format")
    spans = windows(config.record.window)
    for name, given in (("window", spans), ("held_out", windows(config.record.held_out))):
        for begin, end in given:
            if not begin < end:
                found.add(("record", name), f"{begin:g} s is not before {end:g} s")
    for (_, end), (begin, _) in itertools.pairwise(spans):
        if not end < begin:
            message = f"a window that begins at {begin:g} s stands after one that ends at {end:g} s"
            found.add(("record", "window"), f"{message}; put them in order, apart from each other")


def check_states(found: Collector, config: Config, model: Model) -> None:
    for name in model.outer:
        check_quantity(
            found, ("initial", name), getattr(config.initial, name), models.STATES[name].unit
        )


def check_quantity(found: Collector, place: Place, value: object, unit: str) -> None:
    if isinstance(value, numbers.Quantity):
        found.run((*place, "unit"), units.factor, value.unit, unit)


MISSING = "this entry is missing; see `bayesdrill schema` or configs/nominal_step.yaml"
NOTHING = "nothing is not a number; write the value itself"


def check_inputs(found: Collector, config: Config, model: Model | None) -> None:
    for entry in quantities.ENTRIES:
        spec = getattr(config.inputs, entry)
        place: Place = ("inputs", entry)
        if isinstance(spec, InputColumn):
            found.run((*place, "unit"), units.factor, spec.unit, quantities.input_unit(entry))
            check_series(found, place, spec)
        elif spec is not None:
            check_quantity(found, place, spec, quantities.input_unit(entry))
    if model is not None and not missing_requirements(model):
        _check_wanted(found, config, model)
    _check_angles(found, config)
    _check_holds(found, config)
    if quantities.measured_input(config) and config.initial.time is not None:
        found.add(
            ("initial", "time"),
            "with measured inputs the initial state is that of the first sample; remove this entry",
        )


def _check_wanted(found: Collector, config: Config, model: Model) -> None:
    """The model's own, and no other."""
    given = {
        name for name in config.inputs.model_fields_set if getattr(config.inputs, name) is not None
    }
    entries = [e for name in model.inputs for e in (name, quantities.IMPOSED.get(name, name))]
    for entry in [e for e in quantities.ENTRIES if e in given]:
        if entry not in entries:
            own = ", ".join(dict.fromkeys(entries)) or "none"
            having = ((name, *needs) for name, needs in model.offers.items())
            more = next((n for n in having if entry in with_named(model, n).inputs), ())
            also = f", or name {' and '.join(more)}, with which it has it" if more else ""
            message = f"the model {model.name} has no such input; remove it (its own: {own}){also}"
            found.add(("inputs", entry), message)
    for name in model.inputs:
        angle = ("inputs", quantities.IMPOSED.get(name, name))
        none = getattr(config.inputs, quantities.input_entry(config, name)) is None
        if none and not found.spoilt(angle):
            found.add(("inputs", name), _missing(config, name))


def _missing(config: Config, name: str) -> str:
    if name in config.inputs.model_fields_set:
        return NOTHING
    if name == "v":
        return MISSING
    one = symbols.INPUTS[name]
    other = f" (or `{quantities.IMPOSED[name]}:`, the angle)" if name in quantities.IMPOSED else ""
    return (
        f"missing: the model wants the {one.meaning}; give a number in {one.plain_unit}, or "
        f"`{{column: ..., unit: ...}}`{other}"
    )


def _check_angles(found: Collector, config: Config) -> None:
    """An angle that is imposed says all of its speed and of where it begins."""
    for name, entry in quantities.IMPOSED.items():
        spec = getattr(config.inputs, entry)
        if spec is None:
            continue
        if getattr(config.inputs, name) is not None:
            message = f"{name} is what it says as well; remove one of the two"
            found.add(("inputs", entry), message)
        if entry in config.initial.model_fields_set:
            message = "the angle that is imposed begins at its first sample; remove this entry"
            found.add(("initial", entry), message)
        for kind in numbers.Sensed.model_fields:
            if getattr(spec, kind) is not None:
                message = (
                    f"all else is measured against the angle that is imposed; remove this, or give "
                    f"`{name}:`, its speed"
                )
                found.add(("inputs", entry, kind), message)


def _check_holds(found: Collector, config: Config) -> None:
    every = quantities.measured_input(config).values()
    angle = any(isinstance(spec, AngleColumn) for spec in every)
    if len({"zero" if isinstance(spec, AngleColumn) else spec.hold for spec in every}) > 1:
        also = "; the speed of an imposed angle is held (zero)" if angle else ""
        found.add(("inputs",), f"all measured inputs need the same `hold:`{also}")
