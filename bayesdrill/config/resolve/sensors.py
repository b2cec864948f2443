"""Resolve channels and sensors: what each channel measures, its noise, and sensor numbers in SI.

The start and a latent torque have numbers of the same kind. The steps raise `ValueError` with a
message for the user.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from bayesdrill.basics import symbols, units
from bayesdrill.basics.errors import did_you_mean
from bayesdrill.basics.formulas import linear_combination
from bayesdrill.basics.registry import lookup
from bayesdrill.basics.symbols import Symbol
from bayesdrill.config.resolve import quantities
from bayesdrill.config.resolve.quantities import ParsedNumber, number_in_si
from bayesdrill.config.schema.config import Config
from bayesdrill.config.schema.numbers import Quantity, SensorPrior
from bayesdrill.config.schema.records import DELAY, ChannelSpec, InputColumn, InputQuantity
from bayesdrill.config.schema.vocabulary import vocabulary_of
from bayesdrill.config.yaml_source import Location
from bayesdrill.inference.noise import NOISES
from bayesdrill.inference.noise.contract import Noise, NoisyChannel
from bayesdrill.inference.noise.mixed import ChannelNoise as ChannelNoise
from bayesdrill.inference.noise.mixed import Mixed
from bayesdrill.inference.unknowns import Role, Unknown
from bayesdrill.record.experiment import Channel
from bayesdrill.rig.models.latent_torque import SIZE, TIME, MissingTorque, torque_gain
from bayesdrill.rig.models.linear import Model, with_named
from bayesdrill.rig.simulators.sensors import ObservationModel, signal_names, state_weights

TORQUE_ENTRIES: Mapping[str, str] = {SIZE: "size", TIME: "time"}


def latent_torque(config: Config) -> MissingTorque | None:
    """Return the missing torque of a config; None without one."""
    spec = config.missing_torque
    return None if spec is None else MissingTorque(at=spec.at, smoothness=spec.smoothness)


def latent_torque_number(config: Config, name: str) -> float | Unknown:
    """Return size or time, by its `name`, of the missing torque; a linear rig misses a force."""
    rotary = all(symbol.unit != "m" for symbol in config.vocabulary.states.values())
    noun, unit = ("torque", "N*m") if rotary else ("force", "N")
    about = f"size of the missing {noun}: its standard deviation"
    symbol = Symbol(SIZE, unit, "s_d", symbols.latex_unit(unit), about)
    if name == TIME:
        about = f"time after which the missing {noun} is forgotten"
        symbol = Symbol(TIME, "s", r"\tau_d", "s", about)
    spec = getattr(config.missing_torque, TORQUE_ENTRIES[name])
    value, begin = number_in_si(spec, 1.0, unit=symbol.plain_unit)
    if isinstance(value, float):
        return value
    return Unknown(symbol=symbol, role="noise", prior=value, start=begin)


def check_latent_torque(model: Model, acts: MissingTorque, sensing: ObservationModel) -> None:
    """Raise `ValueError` if a rig with these sensors can have no missing torque."""
    if unsupported := ", ".join([*sensing.gains, *sensing.lags]):
        refusal = f"a missing torque allows for no gain and no lag of a sensor ({unsupported})"
        raise ValueError(f"{refusal}; mend the column, or remove this entry")
    ones = dict.fromkeys(model.parameters, 1.0)
    torque_gain(model, acts, ones, model.linear(ones))


SensorKind = Literal["gain", "offset", "lag", "delay", "state"]
SensorNumber = float | Quantity | SensorPrior


@dataclass(frozen=True, slots=True)
class SensorEntry:
    """A sensor entry gives one number of the channel, input or state `target`, in `unit`."""

    location: Location
    kind: SensorKind  # all inputs have one delay, or each its own lag
    target: str
    symbol: Symbol
    spec: SensorNumber
    unit: str


def sensor_entries(config: Config, model: Model) -> Iterator[SensorEntry]:
    """Yield the entries in the order of their unknowns: channels, inputs, the start."""
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
            late: SensorKind = "delay" if len(quantities.measured_inputs(config)) == 1 else "lag"
            at: Location = ("inputs", name)
            yield from _column_entries(at, late, input_spec, symbol.unit, symbol.latex)
    if (shift := config.inputs.get(DELAY)) is not None:
        delay = Symbol(DELAY, "s", "t_0", "s", "delay of the inputs")
        yield SensorEntry(("inputs", DELAY), "delay", "", delay, shift, "s")
    for name in model.outer:
        start = config.initial.get(name)
        if isinstance(start, SensorPrior):  # fixed and `free` states have no entry
            symbol = symbol_of_state(model, name)
            yield SensorEntry(("initial", name), "state", name, symbol, start, symbol.unit)


def _column_entries(
    location: Location, late: SensorKind, spec: Any, si: str, latex: str
) -> Iterator[SensorEntry]:
    """Yield the entries of a column, whose lag is its own or, by `late`, the delay of all inputs."""
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


def state_name(state: str) -> str:
    """Return the name of the initial value of a state."""
    return f"{state}_0"


def free_states(config: Config, model: Model) -> tuple[str, ...]:
    """Return the states whose initial values have priors from the record; imposed angles have none."""
    initial, angles = config.initial, config.vocabulary.imposed.values()
    imposed = [angle for angle in angles if config.inputs.get(angle) is not None]
    silent = {*model.outer} - initial.model_fields_set if initial.state == "free" else set()
    free = [name for name in model.outer if initial.get(name) == "free" or name in silent]
    return tuple(name for name in free if name not in imposed)


def parse_sensor_number(entry: SensorEntry) -> ParsedNumber:
    """Return the number of an entry in SI."""
    unit = getattr(entry.spec, "unit", None) or entry.unit
    factor = 1.0 if entry.kind == "gain" else units.factor(unit, entry.symbol.unit)
    value, start = number_in_si(entry.spec, factor)
    if not isinstance(value, float) and getattr(entry.spec, "start", None) is None:
        start = float(value.quantile(np.array([0.5]))[0])
    low, high = quantities.ends_of(value, 1e-6)
    if entry.kind == "gain" and low <= 0 <= high:
        raise ValueError(
            "a gain of zero shows nothing; keep its prior on one side of zero, such as `prior: "
            "log_normal, median: 1, sd_log: 0.02`"
        )
    role: Role = "start" if entry.kind == "state" else "sensor"
    return ParsedNumber(
        symbol=entry.symbol, role=role, value=value, start=start, factor=factor, unit=unit
    )


def build_sensing(
    config: Config, entries: Sequence[SensorEntry], free: Sequence[str]
) -> ObservationModel:
    """Return the observation model of an experiment: its sensor `entries` and `free` states."""
    names: dict[tuple[SensorKind, bool], dict[str, str]] = defaultdict(dict)
    for entry in entries:
        names[entry.kind, entry.location[0] == "inputs"][entry.target] = entry.symbol.name
    delays = [*names["delay", True].values()]
    if len(delays) > 1 or (delays and names["lag", True]):
        raise ValueError(
            "all inputs have one delay, `t_0:`, or each that is measured its own, `lag:`; give one of "
            "the two"
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


def symbol_of_state(model: Model, name: str) -> Symbol:
    """Return the symbol of the initial value of a state."""
    state = model.symbols[name]
    latex, about = rf"{state.latex}(0)", f"{name} at the start"
    return Symbol(state_name(name), state.unit, latex, state.latex_unit, about)


def build_channel(name: str, spec: ChannelSpec, model: Model) -> Channel:
    """Return a channel: which signals of the rig it measures, and the unit of its column."""
    signals, words = signal_names(model), vocabulary_of(model)
    if not name.isidentifier():
        raise ValueError(f"'{name}' cannot name a channel; use letters, digits and `_`")
    if name not in signals and name in {*words.inputs, *symbols.AXES}:
        raise ValueError(f"{name} has a meaning of its own here; choose another name")
    if spec.measures is None and name not in signals:
        for added in model.offers:
            if name in with_named(model, [added]).states:
                raise ValueError(f"{name} is a state only with {added}; name it in `parameters:`")
        angles = [n for n, symbol in words.states.items() if symbol.unit in symbols.SPEED_UNITS]
        example = " - ".join(angles[:2])
        way_out = f"name the states it combines, for example `measures: {example}`"
        raise ValueError(f"'{name}' is not a state{did_you_mean(name, signals)}; {way_out}")
    combines = linear_combination(spec.measures or name, signals)
    measured = [model.symbols[signal] for signal in combines]
    if len({symbol.unit for symbol in measured}) > 1:
        listed = ", ".join(f"{symbol.name} [{symbol.unit}]" for symbol in measured)
        raise ValueError(f"'{spec.measures}' adds different units: {listed}")
    first = measured[0]
    factor = units.factor(spec.unit, first.unit)
    latex = first.latex if name in signals else rf"\mathrm{{{name.replace('_', chr(92) + '_')}}}"
    return Channel(
        name=name,
        weights=state_weights(model, combines),
        unit=first.unit,
        latex=latex,
        latex_unit=first.latex_unit,
        column=units.display_unit(spec.unit, first.unit, first.latex_unit),
        factor=factor,
    )


def noisy_channel(channel: Channel, spec: ChannelSpec) -> NoisyChannel:
    """Return a channel with its noise, in SI, and where the search for sigma begins."""
    factor = channel.factor
    sigma, begin = number_in_si(spec.sigma, factor, "sigma", "the unit of the column")
    return NoisyChannel(
        channel=channel,
        sigma=sigma,
        start=begin,
        kind=spec.noise.name,
        entries=spec.noise.model_dump(exclude={"name"}),
        factor=factor,
    )


def build_noise(channels: Sequence[NoisyChannel], n_samples: int) -> Noise:
    """Return the noise of all channels: of one kind, or a mixture of kinds."""
    kinds: dict[str, list[int]] = {}
    for k, channel in enumerate(channels):
        kinds.setdefault(channel.kind, []).append(k)
    parts: list[ChannelNoise] = []
    for kind, columns in kinds.items():
        same_kind = [channels[k] for k in columns]
        noise = lookup(NOISES, kind, "noise").from_channels(same_kind, n_samples)
        parts.append(ChannelNoise(noise, (*columns,)))
    return parts[0].noise if len(parts) == 1 else Mixed(tuple(parts))
