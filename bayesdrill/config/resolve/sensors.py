"""Channels and sensors of a config: what each measures, its noise, and sensor numbers in SI.

The start and a latent torque have numbers of the same kind.  The steps raise `ValueError` with a
message for the user.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

import numpy as np

from bayesdrill.basics import symbols, units
from bayesdrill.basics.errors import did_you_mean
from bayesdrill.basics.formulas import linear_combination
from bayesdrill.basics.registry import lookup
from bayesdrill.basics.symbols import Symbol
from bayesdrill.config.resolve import quantities
from bayesdrill.config.resolve.quantities import ParsedNumber, prior_in_si
from bayesdrill.config.schema.config import Config
from bayesdrill.config.schema.numbers import Quantity, SensorPrior
from bayesdrill.config.schema.records import ChannelSpec, InputColumn, InputQuantity
from bayesdrill.config.schema.vocabulary import Vocabulary, vocabulary_of
from bayesdrill.config.yaml_source import Location
from bayesdrill.inference.likelihood import Observation
from bayesdrill.inference.noise import NOISES
from bayesdrill.inference.noise.contract import Noise, NoisyChannel
from bayesdrill.inference.noise.mixed import ChannelNoise as ChannelNoise
from bayesdrill.inference.noise.mixed import Mixed
from bayesdrill.inference.priors import Prior
from bayesdrill.inference.state_space import LatentTorqueObservation
from bayesdrill.inference.unknowns import Role, Unknown
from bayesdrill.record.experiment import Channel
from bayesdrill.rig.models.latent_torque import SIZE, TIME, MissingTorque, torque_gain
from bayesdrill.rig.models.linear import Model, with_named
from bayesdrill.rig.simulators.contract import Simulator
from bayesdrill.rig.simulators.kalman import KalmanFilter, step_lengths
from bayesdrill.rig.simulators.sensors import ObservationModel, signal_names, state_weights


def torque_symbols(vocabulary: Vocabulary) -> tuple[Symbol, Symbol]:
    """Return the symbols of size and time of a missing torque; along a line it is a force."""
    turns = all(symbol.unit != "m" for symbol in vocabulary.states.values())
    what, unit = ("torque", "N*m") if turns else ("force", "N")
    about = f"size of the missing {what}: its standard deviation"
    return (
        Symbol(SIZE, unit, "s_d", symbols.latex_unit(unit), about),
        Symbol(TIME, "s", r"\tau_d", "s", f"time after which the missing {what} is forgotten"),
    )


TORQUE_ENTRIES: Mapping[str, str] = MappingProxyType({SIZE: "size", TIME: "time"})


def latent_torque(config: Config) -> MissingTorque | None:
    """Return the missing torque of a config, if it has one."""
    spec = config.missing_torque
    return None if spec is None else MissingTorque(at=spec.at, smoothness=spec.smoothness)


def latent_torque_number(config: Config, entry: str) -> float | Unknown:
    """Return the torque's `size` or `time`."""
    symbol = next(
        candidate
        for candidate in torque_symbols(config.vocabulary)
        if TORQUE_ENTRIES[candidate.name] == entry
    )
    spec = getattr(config.missing_torque, entry)
    if isinstance(spec, float | int):
        return float(spec)
    if spec.relative:
        raise ValueError(f"it has no nominal value; write its prior in {symbol.plain_unit}")
    built, begin = prior_in_si(spec, 1.0)
    return Unknown(symbol=symbol, role="noise", prior=built, start=begin)


def build_observation(
    acts: MissingTorque | None,
    process: Mapping[str, float | Unknown],
    response: Simulator,
    noise: Noise,
    label: str = "",
) -> Observation:
    """Return an observation, with a missing torque and the numbers of its process or without.

    Parameters and unknowns are named as in an experiment that has no others beside it.  Raises
    `ValueError` where torque and sensors do not go together.
    """
    parameters = response.parameters
    noise_names = [unknown.name for unknown in noise.unknowns]
    if acts is None:
        return Observation(
            response=response,
            noise=noise,
            parameters=parameters,
            noise_names=noise_names,
            label=label,
        )
    if not noise.white:
        raise ValueError(
            "beside a missing torque the noise of every channel has to be white: they could hardly be "
            "told apart; remove `noise:` of the channels, or this entry"
        )
    if refusal := refuse_latent_torque(response.model, acts, response.sensing):
        raise ValueError(refusal)
    step_lengths(response.experiment)
    return LatentTorqueObservation(
        response=response,
        noise=noise,
        kalman_filter=KalmanFilter(response.model, acts, response.experiment),
        process=process,
        parameters=parameters,
        noise_names=[
            *noise_names,
            *(unknown.name for unknown in process.values() if isinstance(unknown, Unknown)),
        ],
        label=label,
    )


def refuse_latent_torque(model: Model, acts: MissingTorque, sensing: ObservationModel) -> str:
    """Return why a rig can have no missing torque; empty where it can."""
    unsupported = [*sensing.gains, *sensing.lags]
    if unsupported:
        return (
            "a missing torque allows for no gain and no lag of a sensor "
            f"({', '.join(unsupported)}); mend the column, or remove this entry"
        )
    try:
        ones = dict.fromkeys(model.parameters, 1.0)
        torque_gain(model, acts, ones, model.linear(ones))
    except ValueError as error:
        return str(error)
    return ""


SensorKind = Literal["gain", "offset", "lag", "delay", "state"]
SensorNumber = float | Quantity | SensorPrior


@dataclass(frozen=True, slots=True)
class SensorEntry:
    """One entry of the config, of the channel, input or state `target`.

    `unit` is its own, in SI `si`.  A delay is that of all inputs; the lag of an input is its own.
    """

    location: Location
    kind: SensorKind
    target: str
    name: str
    spec: SensorNumber
    unit: str
    si: str
    latex: str


def sensor_entries(config: Config, model: Model) -> Iterator[SensorEntry]:
    """Yield the entries in the order in which they are unknown: channels, inputs, the start."""
    for name, spec in config.record.channels.items():
        if spec.derived_from is not None:
            continue
        location: Location = ("record", "channels", name)
        signals = (*model.states, *model.combinations)
        meant = (s for s in signals if s == name or s in (spec.measures or ""))
        si = next((model.symbols[signal].unit for signal in meant), "1")  # none, if it is misspelt
        yield from _column_entries(location, name, spec, spec.unit, si, _latex(config, name))
    for name, symbol in config.vocabulary.inputs.items():
        input_spec = getattr(config.inputs, name)
        if isinstance(input_spec, InputColumn | InputQuantity):
            alone = len(quantities.measured_inputs(config)) == 1
            entries = _column_entries(
                ("inputs", name), name, input_spec, input_spec.unit, symbol.unit, symbol.latex
            )
            for entry in entries:
                late = entry.kind == "lag" and alone
                yield dataclasses.replace(entry, kind="delay") if late else entry
    if config.inputs.t_0 is not None:
        location = ("inputs", "t_0")
        yield SensorEntry(location, "delay", "", "t_0", config.inputs.t_0, "s", "s", "t_0")
    yield from _state_entries(config, model)


def _column_entries(
    location: Location, name: str, spec: object, unit: str, si: str, latex: str
) -> Iterator[SensorEntry]:
    kinds: tuple[tuple[SensorKind, str, str, str], ...] = (
        ("gain", "1", "1", "g"),
        ("offset", unit, si, "b"),
        ("lag", "s", "s", r"\tau"),
    )
    for kind, kind_unit, kind_si, sign in kinds:
        entry = getattr(spec, kind, None)
        if entry is not None:
            label, symbol = f"{kind}_{name}", rf"{sign}_{{{latex}}}"
            yield SensorEntry(
                (*location, kind), kind, name, label, entry, kind_unit, kind_si, symbol
            )


def _state_entries(config: Config, model: Model) -> Iterator[SensorEntry]:
    """Those with a prior; what is held or `free` is said elsewhere."""
    for name in model.outer:
        entry, symbol = getattr(config.initial, name), symbol_of_state(model, name)
        if isinstance(entry, SensorPrior):
            location, unit = ("initial", name), symbol.unit
            yield SensorEntry(location, "state", name, symbol.name, entry, unit, unit, symbol.latex)


def state_name(state: str) -> str:
    """Return the name of a state's initial value."""
    return f"{state}_0"


def free_states(config: Config, model: Model) -> tuple[str, ...]:
    """Return states of the start whose priors the record gives; an imposed angle has none."""
    initial = config.initial
    states = [name for name in model.outer if name not in quantities.imposed_inputs(config)]
    words = [name for name in states if getattr(initial, name) == "free"]
    if initial.state == "free":
        words += [name for name in states if name not in initial.model_fields_set]
    return tuple(dict.fromkeys(name for name in states if name in words))


def parse_sensor_number(entry: SensorEntry) -> ParsedNumber:
    """Return the number of an entry in SI."""
    unit = getattr(entry.spec, "unit", None) or entry.unit
    factor = 1.0 if entry.kind == "gain" else units.factor(unit, entry.si)
    value, start = _value(entry.spec, factor)
    quantiles = [value] if isinstance(value, float) else value.quantile(np.array([1e-6, 1 - 1e-6]))
    if entry.kind == "gain" and min(quantiles) <= 0 <= max(quantiles):
        raise ValueError(
            "a gain of zero shows nothing; keep its prior on one side of zero, such as `prior: "
            "log_normal, median: 1, sd_log: 0.02`"
        )
    symbol = Symbol(
        entry.name, entry.si, entry.latex, symbols.latex_unit(entry.si), _meaning(entry)
    )
    role: Role = "start" if entry.kind == "state" else "sensor"
    return ParsedNumber(
        symbol=symbol, role=role, value=value, start=start, factor=factor, unit=unit
    )


def _value(spec: SensorNumber, factor: float) -> tuple[float | Prior, float]:
    if isinstance(spec, Quantity):
        return spec.value * factor, spec.value * factor
    if isinstance(spec, float | int):
        return float(spec) * factor, float(spec) * factor
    built, begin = prior_in_si(spec, factor)
    middle = float(built.quantile(np.array([0.5]))[0])
    return built, middle if spec.start is None else begin


def _latex(config: Config, name: str) -> str:
    signal = config.vocabulary.signals.get(name)
    return signal.latex if signal else symbols.own_symbol(name, "1", None, "").latex


def _meaning(entry: SensorEntry) -> str:
    return {
        "gain": f"gain of the sensor of {entry.target}",
        "offset": f"offset of {entry.target}",
        "lag": f"lag of the sensor of {entry.target}",
        "delay": f"delay of {entry.target or 'the inputs'}",
        "state": f"{entry.target} at the start",
    }[entry.kind]


def build_sensing(
    config: Config, entries: Sequence[SensorEntry], free: Sequence[str]
) -> ObservationModel:
    """Return the sensors that simulators allow for: those of `entries`, and `free` states.

    Names are those of single experiments.
    """
    delays = [entry for entry in entries if entry.kind == "delay"]
    single = [entry for entry in entries if entry.kind == "lag" and entry.location[0] == "inputs"]
    if len(delays) > 1 or (delays and single):
        raise ValueError(
            "all inputs have one delay, `t_0:`, or each that is measured its own, `lag:`; give one of "
            "the two"
        )

    def names(kind: SensorKind, *, inputs: bool) -> dict[str, str]:
        return {
            e.target: e.name
            for e in entries
            if e.kind == kind and (e.location[0] == "inputs") == inputs
        }

    states = {name: state_name(name) for name in free}
    return ObservationModel(
        gains=names("gain", inputs=False),
        offsets=names("offset", inputs=False),
        lags=names("lag", inputs=False),
        input_gains=names("gain", inputs=True),
        input_offsets=names("offset", inputs=True),
        input_lags=names("lag", inputs=True),
        delay=delays[0].name if delays else None,
        states=names("state", inputs=False) | states,
        steady=config.initial.state == "steady",
    )


def symbol_of_state(model: Model, name: str) -> Symbol:
    """Return the symbol of a state at the start."""
    state = model.symbols[name]
    return Symbol(
        state_name(name), state.unit, rf"{state.latex}(0)", state.latex_unit, f"{name} at the start"
    )


@dataclass(frozen=True, slots=True)
class MeasuredChannel:
    """A channel with the kind of its noise, and what that kind has to know."""

    kind: str
    noisy: NoisyChannel

    @property
    def channel(self) -> Channel:
        """Return the channel."""
        return self.noisy.channel


def build_channel(name: str, spec: ChannelSpec, model: Model) -> Channel:
    """Return what a channel of a rig measures, and the unit of its column."""
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
        raise ValueError(
            f"'{name}' is not a state{did_you_mean(name, signals)}; name the states it combines, for "
            f"example `measures: {example}`"
        )
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


def measured_channel(channel: Channel, spec: ChannelSpec) -> MeasuredChannel:
    """Return a channel with its noise, SI, and where a search for it begins."""
    factor = channel.factor
    sigma: float | Prior
    if isinstance(spec.sigma, float):
        sigma, begin = spec.sigma * factor, spec.sigma * factor
    elif spec.sigma.relative:
        raise ValueError("sigma has no nominal value; write its prior in the unit of the column")
    else:
        sigma, begin = prior_in_si(spec.sigma, factor)
    kind, entries = spec.noise.name, spec.noise.model_dump(exclude={"name"})
    noisy = NoisyChannel(channel=channel, sigma=sigma, start=begin, entries=entries, factor=factor)
    return MeasuredChannel(kind, noisy)


def build_noise(channels: Sequence[MeasuredChannel], n_samples: int) -> Noise:
    """Return the noise of all channels: of one kind, or a mixture of kinds."""
    kinds: dict[str, list[int]] = {}
    for k, channel in enumerate(channels):
        kinds.setdefault(channel.kind, []).append(k)
    parts = [
        ChannelNoise(
            lookup(NOISES, kind, "noise").from_channels(
                [channels[k].noisy for k in columns], n_samples
            ),
            (*columns,),
        )
        for kind, columns in kinds.items()
    ]
    return parts[0].noise if len(parts) == 1 else Mixed(tuple(parts))
