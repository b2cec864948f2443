"""Build the channels of a record, each with the measured signals and the noise."""

from __future__ import annotations

from collections.abc import Sequence

from bayesdrill.basics import symbols, units
from bayesdrill.basics.entries import unknown_keys
from bayesdrill.basics.errors import did_you_mean
from bayesdrill.basics.formulas import linear_combination
from bayesdrill.basics.registry import lookup
from bayesdrill.config.building.parsed_numbers import number_in_si
from bayesdrill.config.building.record import check_series
from bayesdrill.config.schema.config import Config
from bayesdrill.config.schema.records import ChannelSpec
from bayesdrill.config.schema.vocabulary import vocabulary_of
from bayesdrill.config.yaml_source import IssueCollector, Location
from bayesdrill.inference.noise import NOISES
from bayesdrill.inference.noise.contract import Noise, NoisyChannel
from bayesdrill.inference.noise.mixed import ChannelNoise, Mixed
from bayesdrill.record.experiment import Channel
from bayesdrill.rig.models.linear import Model, with_named
from bayesdrill.rig.simulators.sensors import signal_names, state_weights


def check_channels(
    errors: IssueCollector, config: Config, model: Model
) -> dict[str, NoisyChannel | None]:
    """Return the channels that are not derived; None stands for a channel with a mistake."""
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
        errors.expect(at, source, others, f"'{source}' is not another channel")
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
        surplus = unknown_keys(("name", "noise"), kinds, kinds[spec.noise.name], spec.noise)
        errors.add_all((*location, "noise"), surplus)
    if len(errors.issues) > before:
        return None
    if (channel := errors.run(location, build_channel, name, spec, model)) is None:
        return None
    measured = errors.run((*location, "sigma"), noisy_channel, channel, spec)
    noise = measured and errors.run((*location, "noise"), build_noise, [measured], 1)
    return measured if noise else None


def build_channel(name: str, spec: ChannelSpec, model: Model) -> Channel:
    """Return a channel with the signals of the rig that it measures, and the unit of its column."""
    signals, words = signal_names(model), vocabulary_of(model)
    if not name.isidentifier():
        raise ValueError(f"'{name}' cannot name a channel; use letters, digits and `_`")
    if name not in signals and name in {*words.inputs, *symbols.AXES}:
        raise ValueError(f"{name} is a reserved name; choose another one")
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
    """Return a channel with its noise and the start of the search for sigma, in SI."""
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
    """Return the joint noise of all channels, which may have different kinds of noise."""
    kinds: dict[str, list[int]] = {}
    for k, channel in enumerate(channels):
        kinds.setdefault(channel.kind, []).append(k)
    parts: list[ChannelNoise] = []
    for kind, columns in kinds.items():
        same_kind = [channels[k] for k in columns]
        noise = lookup(NOISES, kind, "noise").from_channels(same_kind, n_samples)
        parts.append(ChannelNoise(noise, (*columns,)))
    return parts[0].noise if len(parts) == 1 else Mixed(tuple(parts))
