"""Channels of a config as objects: what each measures, its sigma, and the noise of all of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from bayesdrill.basics import symbols, units
from bayesdrill.basics.errors import did_you_mean
from bayesdrill.basics.formulas import linear_combination
from bayesdrill.basics.registry import lookup
from bayesdrill.config.resolve.quantities import prior_in_si
from bayesdrill.config.schema.records import ChannelSpec
from bayesdrill.inference.noise import NOISES
from bayesdrill.inference.noise.contract import Noise, Noisy
from bayesdrill.inference.noise.mixed import Mixed
from bayesdrill.inference.noise.mixed import Part as Kind
from bayesdrill.inference.priors import Prior
from bayesdrill.record.experiment import Channel
from bayesdrill.rig import models


@dataclass(frozen=True, slots=True)
class Measured:
    """The kind of a channel's noise, and what that has to know."""

    kind: str
    noisy: Noisy

    @property
    def channel(self) -> Channel:
        return self.noisy.channel


def measured(name: str, spec: ChannelSpec, states: tuple[str, ...]) -> Measured:
    if not name.isidentifier():
        raise ValueError(f"'{name}' cannot name a channel; use letters, digits and `_`")
    if name not in states and name in {*symbols.INPUTS, *symbols.AXES}:
        raise ValueError(f"{name} has a meaning of its own here; choose another name")
    if spec.measures is None and name not in states:
        raise ValueError(
            f"'{name}' is not a state{did_you_mean(name, states)}; name the states it combines, for "
            "example `measures: theta_1 - theta_2`"
        )
    weights = linear_combination(spec.measures or name, states)
    found = [models.STATES[state] for state in weights]
    if len({symbol.unit for symbol in found}) > 1:
        listed = ", ".join(f"{symbol.name} [{symbol.unit}]" for symbol in found)
        raise ValueError(f"'{spec.measures}' adds different units: {listed}")
    first = found[0]
    factor = units.factor(spec.unit, first.unit)
    latex = first.latex if name in states else rf"\mathrm{{{name.replace('_', chr(92) + '_')}}}"
    channel = Channel(
        name=name,
        weights=weights,
        unit=first.unit,
        latex=latex,
        latex_unit=first.latex_unit,
        column=units.shown(spec.unit, first.unit, first.latex_unit),
        factor=factor,
    )
    sigma, begin = _sigma(spec, factor)
    kind, entries = spec.noise.name, spec.noise.model_dump(exclude={"name"})
    noisy = Noisy(channel=channel, sigma=sigma, start=begin, entries=entries, factor=factor)
    return Measured(kind, noisy)


def _sigma(spec: ChannelSpec, factor: float) -> tuple[float | Prior, float]:
    """Of the noise, SI, and where a search begins."""
    if isinstance(spec.sigma, float):
        return spec.sigma * factor, spec.sigma * factor
    if spec.sigma.relative:
        raise ValueError("sigma has no nominal value; write its prior in the unit of the column")
    return prior_in_si(spec.sigma, factor)


def noise(channels: Sequence[Measured], n_samples: int) -> Noise:
    """Of all channels: one of a kind, or a mixture of kinds."""
    kinds: dict[str, list[int]] = {}
    for k, one in enumerate(channels):
        kinds.setdefault(one.kind, []).append(k)
    parts = [
        Kind(lookup(NOISES, kind, "noise").of([channels[k].noisy for k in own], n_samples), (*own,))
        for kind, own in kinds.items()
    ]
    return parts[0].noise if len(parts) == 1 else Mixed(tuple(parts))
