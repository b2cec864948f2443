"""The record and the experiment: channels, time, inputs, noise, sensors and the initial state,
with their units.
"""

from __future__ import annotations

import itertools

from bayesdrill.basics import symbols, units
from bayesdrill.basics.entries import strange
from bayesdrill.basics.formulas import linear_combination
from bayesdrill.basics.registry import lookup
from bayesdrill.basics.symbols import INPUTS, noise_name
from bayesdrill.config.resolve import channel_noise, quantities, sensors
from bayesdrill.config.schema import numbers
from bayesdrill.config.schema.config import Config
from bayesdrill.config.schema.numbers import Sensed
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
from bayesdrill.rig.models.composed import lacking, with_named
from bayesdrill.rig.models.linear import Model


def check_sensors(found: Collector, config: Config, model: Model) -> None:
    for entry in sensors.sensor_entries(config, model):
        if entry.kind != "offset" or getattr(entry.spec, "unit", None) or _fits(entry):
            found.run(entry.place, sensors.sensor_specs, entry)
    found.run(("inputs",), sensors.sensing, config, model)
    names = [entry.name for entry in sensors.sensor_entries(config, model)]
    names += [sensors.state_name(name) for name in sensors.free_states(config, model)]
    for name in config.quantities:
        if name in names:
            found.add(("quantities", name), "a sensor's number has this name; choose another one")
    _check_derived_channels(found, config)
    _check_constant(found, config)
    if config.initial.state == "steady":
        _check_steady(found, config, model)


def _fits(entry: sensors.Entry) -> bool:
    """Whether its column has a unit that can be; else that is said of the column."""
    try:
        units.factor(entry.unit, entry.si)
    except ValueError:
        return False
    return True


def _check_derived_channels(found: Collector, config: Config) -> None:
    for name, spec in config.record.channels.items():
        for kind in Sensed.model_fields if spec.derived_from is not None else ():
            if getattr(spec, kind) is not None:
                message = (
                    f"{name} is derived from {spec.derived_from}, and no evidence; remove this"
                )
                found.add(("record", "channels", name, kind), message)


def _check_constant(found: Collector, config: Config) -> None:
    for name in INPUTS:
        spec = getattr(config.inputs, name)
        if isinstance(spec, InputQuantity) and spec.gain is not None and spec.value == 0:
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


def in_vain(spec: ChannelSpec) -> dict[str, str]:
    """Entries that mean nothing to the kind of noise, and what to do about each."""
    kinds = {name: one.Entries for name, one in NOISES.usable().items()}
    if spec.noise.name not in kinds:
        return {}
    return strange(("name", "noise"), kinds, kinds[spec.noise.name], spec.noise)


def scatter(config: Config, model: Model) -> dict[str, Unknown | None]:
    """Unknowns of the noise by name.  Of a channel with a mistake, which is said elsewhere, only what is
    given, as None: what a kind has unless it is told otherwise may be what its entry was to hold.
    """
    found: dict[str, Unknown | None] = {}
    for name, spec in config.record.channels.items():
        if spec.derived_from is not None:
            continue
        own = _of_channel(name, spec, model)
        if own is not None:
            found |= own
        elif isinstance(spec.sigma, numbers.ParameterPrior):
            found[noise_name(name)] = None
    return found | _of_torque(config)


def _of_torque(config: Config) -> dict[str, Unknown | None]:
    try:
        return {unknown.name: unknown for unknown in sensors.latent_torque_unknowns(config)}
    except ValueError:  # said of its entry
        return {}


def _of_channel(name: str, spec: ChannelSpec, model: Model) -> dict[str, Unknown | None] | None:
    """None where something is wrong with it."""
    if in_vain(spec):
        return None
    try:
        noise = channel_noise.noise([channel_noise.measured(name, spec, model.outer)], n_samples=1)
    except ValueError:
        return None
    return {unknown.name: unknown for unknown in noise.unknowns}


def check_channels(found: Collector, config: Config, model: Model) -> None:
    for name, spec in config.record.channels.items():
        place: Place = ("record", "channels", name)
        _check_measured(found, place, spec, model)
        check_series(found, place, spec)
        if spec.derived_from is not None:
            _check_derived(found, config, place, spec.derived_from)


def _check_measured(found: Collector, place: Place, spec: ChannelSpec, model: Model) -> None:
    """Entry by entry, so that each mistake has the line where it stands."""
    before = len(found.problems)
    combines = {str(place[-1]): 1.0}
    if spec.measures is not None:
        text, at = spec.measures, (*place, "measures")
        combines = found.run(at, linear_combination, text, model.outer) or {}
    states = [models.STATES[state] for state in combines if state in model.outer]
    if states:
        found.run((*place, "unit"), units.factor, spec.unit, states[0].unit)
    found.run((*place, "noise"), lookup, NOISES, spec.noise.name, "noise")
    for entry, message in in_vain(spec).items():
        found.add((*place, "noise", entry), message)
    known = spec.model_copy(update={"sigma": 1.0})
    if len(found.problems) == before:
        found.run(place, channel_noise.measured, place[-1], known, model.outer)
    if len(found.problems) == before:
        one = found.run((*place, "sigma"), channel_noise.measured, place[-1], spec, model.outer)
        if one is not None:
            found.run((*place, "noise"), channel_noise.noise, [one], 1)


def _check_derived(found: Collector, config: Config, place: Place, of: str) -> None:
    name, at, every = str(place[-1]), (*place, "derived_from"), config.record.channels
    others = [one for one in every if one != name]
    found.expect(at, of, others, f"'{of}' is no other channel")
    if of in others and every[of].derived_from is not None:
        found.add(at, f"'{of}' is itself derived from {every[of].derived_from}; name that channel")


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
        value = getattr(config.initial, name)
        check_quantity(found, ("initial", name), value, models.STATES[name].unit)


def check_quantity(
    found: Collector, place: Place, value: float | numbers.Quantity, unit: str
) -> None:
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
    if model is not None and not lacking(model):
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
            with_more = _with_more(model, entry)
            also = f", or name {with_more}, with which it has it" if with_more else ""
            message = f"the model {model.name} has no such input; remove it (its own: {own}){also}"
            found.add(("inputs", entry), message)
    for name in model.inputs:
        angle = ("inputs", quantities.IMPOSED.get(name, name))
        none = getattr(config.inputs, quantities.input_entry(config, name)) is None
        if none and not found.spoilt(angle):
            found.add(("inputs", name), _missing(config, name))


def _with_more(model: Model, entry: str) -> str:
    """Parameters that give it such an input."""
    for name, needs in model.offers.items():
        if entry in with_named(model, (name, *needs)).inputs:
            return " and ".join((name, *needs))
    return ""


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
        for kind in Sensed.model_fields:
            if getattr(spec, kind) is not None:
                message = (
                    f"all else is measured against the angle that is imposed; remove this, or give "
                    f"`{name}:`, its speed"
                )
                found.add(("inputs", entry, kind), message)


def _check_holds(found: Collector, config: Config) -> None:
    every = quantities.measured_input(config).values()
    holds = {"zero" if isinstance(spec, AngleColumn) else spec.hold for spec in every}
    if len(holds) > 1:
        also = (
            "; the speed of an imposed angle is held (zero)"
            if any(isinstance(spec, AngleColumn) for spec in every)
            else ""
        )
        found.add(("inputs",), f"all measured inputs need the same `hold:`{also}")
