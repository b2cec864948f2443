"""Check an experiment's channels, time, inputs, sensors and start, with their units."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

from bayesdrill.basics import units
from bayesdrill.basics.entries import unknown_keys
from bayesdrill.basics.formulas import linear_combination
from bayesdrill.basics.registry import lookup
from bayesdrill.basics.symbols import SPEED_UNITS, noise_name
from bayesdrill.config.resolve import quantities, sensors
from bayesdrill.config.resolve.case import LocalNumbers
from bayesdrill.config.resolve.quantities import ParsedNumber
from bayesdrill.config.resolve.sensors import SensorEntry
from bayesdrill.config.schema import numbers
from bayesdrill.config.schema.config import Config
from bayesdrill.config.schema.records import (
    AngleColumn,
    ChannelSpec,
    ColumnSpec,
    FileSpec,
    InputColumn,
    InputQuantity,
    Series,
    TimeColumn,
    window_spans,
)
from bayesdrill.config.yaml_source import IssueCollector, Location
from bayesdrill.inference.noise import NOISES
from bayesdrill.inference.noise.contract import NoisyChannel
from bayesdrill.inference.priors import Prior
from bayesdrill.inference.unknowns import Unknown
from bayesdrill.record.formats import FORMATS
from bayesdrill.rig.models.linear import Model, missing_requirements, with_named
from bayesdrill.rig.simulators.sensors import ObservationModel, signal_names

SensorNumbers = Mapping[SensorEntry, ParsedNumber | None]  # None for a number with a mistake


def check_sensors(
    errors: IssueCollector, config: Config, model: Model, free: Sequence[str]
) -> tuple[SensorNumbers, ObservationModel | None]:
    """Return the numbers of sensors and initial state, and the observation model with `free` states."""
    for name in model.outer:
        start, unit = getattr(config.initial, name), model.symbols[name].unit
        check_quantity(errors, ("initial", name), start, unit)
    checked = {e: _sensor_number(errors, e) for e in sensors.sensor_entries(config, model)}
    sensing = errors.run(("inputs",), sensors.build_sensing, config, [*checked], free)
    _check_ineffective(errors, config)
    if config.initial.state == "steady":
        _check_steady(errors, config, model)
    return checked, sensing


def local_numbers(
    config: Config,
    channels: Mapping[str, NoisyChannel | None],
    sensor_numbers: SensorNumbers,
    free: Sequence[str],
    torque: Mapping[str, float | Unknown | None],
) -> LocalNumbers:
    """Return the numbers that the experiment has beside those of the rig.

    A channel with a mistake, which is reported elsewhere, has only the unknowns that its entry names.
    """
    numbers_: dict[str, float | Prior | Unknown | None]
    numbers_ = {e.symbol.name: None if x is None else x.value for e, x in sensor_numbers.items()}
    numbers_ |= dict.fromkeys(map(sensors.state_name, free))
    for name, channel in channels.items():
        if channel is not None:
            noise = sensors.build_noise([channel], n_samples=1)
            numbers_ |= {unknown.name: unknown for unknown in noise.unknowns}
        elif isinstance(config.record.channels[name].sigma, numbers.ParameterPrior):
            numbers_[noise_name(name)] = None
    if None not in torque.values():
        numbers_ |= {n: number for n, number in torque.items() if isinstance(number, Unknown)}
    return LocalNumbers(numbers=numbers_, channels=tuple(config.record.channels))


def _sensor_number(errors: IssueCollector, entry: SensorEntry) -> ParsedNumber | None:
    """Return the number of an entry; None if it, or the column whose unit it takes, has a mistake."""
    if entry.kind == "offset" and not getattr(entry.spec, "unit", None):
        try:
            units.factor(entry.unit, entry.symbol.unit)
        except ValueError:
            return None
    return errors.run(entry.location, sensors.parse_sensor_number, entry)


def _check_ineffective(errors: IssueCollector, config: Config) -> None:
    """Add an issue for each number of a sensor that has no effect."""
    for name, spec in config.record.channels.items():
        for kind in numbers.SensorFields.model_fields if spec.derived_from is not None else ():
            if getattr(spec, kind) is not None:
                evidence = f"{name} is derived from {spec.derived_from}, and no evidence"
                errors.add(("record", "channels", name, kind), f"{evidence}; remove this")
    for name in config.vocabulary.inputs:
        input_spec = getattr(config.inputs, name)
        is_zero = isinstance(input_spec, InputQuantity) and input_spec.value == 0
        if is_zero and input_spec.gain is not None:
            message = "a gain of nothing changes nothing; give `offset:`, or another value"
            errors.add(("inputs", name, "gain"), message)


def _check_steady(errors: IssueCollector, config: Config, model: Model) -> None:
    """Check a steady start: inputs determine it, but for a single angle that may be named."""
    if not model.smooth:
        how = "rubs turns steadily, or sticks" if model.frictions else "swings comes to rest"
        how = how if model.frictions or model.gravities else "may saturate comes to rest"
        where = f"where a rig that {how}, is not worked out"
        errors.add(("initial",), f"{where}; write `initial: free`, or the states there")
        return
    named = [name for name in model.states if name in config.initial.model_fields_set]
    angles = [name for name in named if name in model.angles]
    for name in named:
        if name not in angles:
            message = "the steady state gives it; remove this entry, or `state: steady`"
            errors.add(("initial", name), message)
    for name in angles[1:]:
        both = f"the steady state gives the twist, and {angles[0]} the rest"
        errors.add(("initial", name), f"{both}; remove one of the two")


def check_channels(
    errors: IssueCollector, config: Config, model: Model
) -> dict[str, NoisyChannel | None]:
    """Return channels that are evidence and not derived from others; None for each with a mistake."""
    measured, channels = dict[str, NoisyChannel | None](), config.record.channels
    for name, spec in channels.items():
        location: Location = ("record", "channels", name)
        channel = _check_measured(errors, location, spec, model)
        check_series(errors, location, spec)
        if (source := spec.derived_from) is None:
            measured[name] = channel
            continue
        others = {other: spec for other, spec in channels.items() if other != name}
        at = (*location, "derived_from")
        errors.expect(at, source, others, f"'{source}' is no other channel")
        if source in others and (first := others[source].derived_from) is not None:
            errors.add(at, f"'{source}' is itself derived from {first}; name that channel")
    return measured


def _check_measured(
    errors: IssueCollector, location: Location, spec: ChannelSpec, model: Model
) -> NoisyChannel | None:
    """Check the entries of a channel one by one, so that each mistake is reported at its line."""
    before, name = len(errors.issues), str(location[-1])
    weights = {name: 1.0}
    if spec.measures is not None:
        text, at = spec.measures, (*location, "measures")
        weights = errors.run(at, linear_combination, text, signal_names(model)) or {}
    signals = [model.symbols[signal] for signal in weights if signal in signal_names(model)]
    if signals:
        errors.run((*location, "unit"), units.factor, spec.unit, signals[0].unit)
    if errors.run((*location, "noise"), lookup, NOISES, spec.noise.name, "noise") is not None:
        kinds = {name: kind.Entries for name, kind in NOISES.usable().items()}
        vain = unknown_keys(("name", "noise"), kinds, kinds[spec.noise.name], spec.noise)
        errors.add_all((*location, "noise"), vain)
    if len(errors.issues) > before:
        return None
    if (channel := errors.run(location, sensors.build_channel, name, spec, model)) is None:
        return None
    measured = errors.run((*location, "sigma"), sensors.noisy_channel, channel, spec)
    noise = measured and errors.run((*location, "noise"), sensors.build_noise, [measured], 1)
    return measured if noise else None


def check_series(errors: IssueCollector, location: Location, spec: Series) -> None:
    """Check the address, the time and the file of a column."""
    _check_address(errors, location, spec)
    _check_time(errors, (*location, "time"), spec.time)
    if isinstance(spec.file, FileSpec) and spec.file.format is not None:
        errors.run((*location, "file", "format"), lookup, FORMATS, spec.file.format, "format")


def _check_time(errors: IssueCollector, location: Location, time: object) -> None:
    if isinstance(time, TimeColumn):
        errors.run((*location, "unit"), units.factor, time.unit, "s")
        _check_address(errors, location, time)


def _check_address(errors: IssueCollector, location: Location, spec: ColumnSpec) -> None:
    if spec.column is None and spec.variable is None:
        errors.add(location, "neither `column:` nor `variable:` says where the numbers stand")


def check_record(errors: IssueCollector, config: Config) -> None:
    """Check time, format and windows of the record."""
    _check_time(errors, ("record", "time"), config.record.time)
    if config.record.format is not None:
        errors.run(("record", "format"), lookup, FORMATS, config.record.format, "format")
    spans = window_spans(config.record.window)
    for name, windows in (("window", spans), ("held_out", window_spans(config.record.held_out))):
        for begin, end in windows:
            if not begin < end:
                errors.add(("record", name), f"{begin:g} s is not before {end:g} s")
    for (_, end), (begin, _) in itertools.pairwise(spans):
        if not end < begin:
            message = f"a window that begins at {begin:g} s stands after one that ends at {end:g} s"
            errors.add(("record", "window"), f"{message}; put them in order, apart from each other")


def check_quantity(errors: IssueCollector, location: Location, value: object, unit: str) -> None:
    """Check the unit of a value, if it has one."""
    if isinstance(value, numbers.Quantity):
        errors.run((*location, "unit"), units.factor, value.unit, unit)


def check_inputs(errors: IssueCollector, config: Config, model: Model | None) -> None:
    """Check the inputs: their units, and that the model has them."""
    for entry, symbol in config.vocabulary.entries.items():
        spec = getattr(config.inputs, entry)
        location: Location = ("inputs", entry)
        if isinstance(spec, InputColumn):
            errors.run((*location, "unit"), units.factor, spec.unit, symbol.unit)
            check_series(errors, location, spec)
        elif spec is not None:
            check_quantity(errors, location, spec, symbol.unit)
    if model is not None and not missing_requirements(model):
        _check_required(errors, config, model)
    _check_angles(errors, config)
    _check_holds(errors, config)
    if quantities.measured_inputs(config) and config.initial.time is not None:
        message = "with measured inputs the initial state is that of the first sample"
        errors.add(("initial", "time"), f"{message}; remove this entry")


def _check_required(errors: IssueCollector, config: Config, model: Model) -> None:
    """Check that the inputs are those of the model."""
    words, inputs = config.vocabulary, config.inputs
    given_entries = {n for n in inputs.model_fields_set if getattr(inputs, n) is not None}
    entries = [e for name in model.inputs for e in (name, words.imposed.get(name, name))]
    for entry in [e for e in words.entries if e in given_entries]:
        if entry not in entries:
            input_names = ", ".join(dict.fromkeys(entries)) or "none"
            having = ((name, *needs) for name, needs in model.offers.items())
            needed = next((n for n in having if entry in with_named(model, n).inputs), ())
            also = f", or name {' and '.join(needed)}, with which it has it" if needed else ""
            also = f"remove it (its own: {input_names}){also}"
            errors.add(("inputs", entry), f"the model {model.name} has no such input; {also}")
    for name in model.inputs:
        angle = ("inputs", words.imposed.get(name, name))
        none = getattr(config.inputs, quantities.input_entry(config, name)) is None
        if none and not errors.is_reported(angle):
            errors.add(("inputs", name), _missing_message(config, name))


def _missing_message(config: Config, name: str) -> str:
    if name in config.inputs.model_fields_set:
        return "nothing is not a number; write the value itself"
    if name == "v":
        return "this entry is missing; see `bayesdrill schema` or configs/nominal_step.yaml"
    symbol, angle = config.vocabulary.inputs[name], config.vocabulary.imposed.get(name)
    what = "angle" if symbol.unit == SPEED_UNITS["rad"] else "position"
    other = f" (or `{angle}:`, the {what})" if angle else ""
    way_out = f"give a number in {symbol.plain_unit}, or `{{column: ..., unit: ...}}`{other}"
    return f"missing: the model wants the {symbol.meaning}; {way_out}"


def _check_angles(errors: IssueCollector, config: Config) -> None:
    """Check that no entry contradicts an imposed angle, which gives its speed and its start."""
    for name, entry in config.vocabulary.imposed.items():
        spec = getattr(config.inputs, entry)
        if spec is None:
            continue
        if getattr(config.inputs, name) is not None:
            message = f"{name} is what it says as well; remove one of the two"
            errors.add(("inputs", entry), message)
        if entry in config.initial.model_fields_set:
            message = "the angle that is imposed begins at its first sample; remove this entry"
            errors.add(("initial", entry), message)
        for kind in numbers.SensorFields.model_fields:
            if getattr(spec, kind) is not None:
                message = "all else is measured against the angle that is imposed; remove this"
                errors.add(("inputs", entry, kind), f"{message}, or give `{name}:`, its speed")


def _check_holds(errors: IssueCollector, config: Config) -> None:
    specs = quantities.measured_inputs(config).values()
    angle = any(isinstance(spec, AngleColumn) for spec in specs)
    if len({"zero" if isinstance(spec, AngleColumn) else spec.hold for spec in specs}) > 1:
        also = "; the speed of an imposed angle is held (zero)" if angle else ""
        errors.add(("inputs",), f"all measured inputs need the same `hold:`{also}")
