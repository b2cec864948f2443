"""The units of the user, in which figures show channels, inputs, time and unknowns; the rest is SI."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesdrill.basics import symbols, units
from bayesdrill.basics.symbols import Symbol
from bayesdrill.inference.priors import InUnits, Prior
from bayesdrill.record.experiment import Channel
from bayesdrill.setup.config import Config
from bayesdrill.setup.number_entries import PriorBase, Quantity
from bayesdrill.setup.record_entries import Column, TimeColumn

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Unit:
    """`name`: as the config has it; `factor`: how many SI one of it is; `latex` without dollars."""

    name: str
    factor: float
    latex: str


SECOND = Unit("s", 1.0, "s")


def time(config: Config) -> Unit:
    spec = config.record.time
    return _unit(spec.unit if isinstance(spec, TimeColumn) else "s", "s")


def channel(config: Config, one: Channel) -> Unit:
    spec = config.record.channels[one.name]
    return _unit(spec.unit, one.unit, one.latex_unit)


def given(config: Config, name: str) -> Unit:
    """Of an input."""
    spec, symbol = getattr(config.inputs, name), symbols.INPUTS[name]
    unit = spec.unit if isinstance(spec, Column | Quantity) else symbol.unit
    return _unit(unit, symbol.unit, symbol.latex_unit)


def _unit(own: str, si: str, latex: str = "") -> Unit:
    if own == si:
        return Unit(own, 1.0, latex or symbols.latex_unit(si))
    return Unit(own, units.factor(own, si), symbols.latex_unit(own))


@dataclass(frozen=True, slots=True)
class OwnUnits:
    """Of those unknowns and derived quantities for which the config has a unit of its own."""

    units: Mapping[str, Unit]

    @classmethod
    def of(cls, config: Config, channels: Iterable[Channel]) -> OwnUnits:
        """Noise in the unit of its column, quantities and formulas in that of their entry."""
        found = {f"sigma_{one.name}": channel(config, one) for one in channels}
        own = {
            name: spec.unit
            for name, spec in config.quantities.items()
            if isinstance(spec, PriorBase)
        }
        own |= {name: spec.unit for name, spec in config.derived.items()}
        for name, unit in own.items():
            _, factor = units.coherent(unit)
            found[name] = Unit(unit, factor, symbols.latex_unit(unit))
        return cls(found)

    def factor(self, name: str) -> float:
        return self.units[name].factor if name in self.units else 1.0

    def factors(self, shown: Iterable[Symbol]) -> Array:
        return np.array([self.factor(symbol.name) for symbol in shown])

    def symbols(self, shown: Iterable[Symbol]) -> tuple[Symbol, ...]:
        """With these units on their axes."""
        return tuple(
            dataclasses.replace(symbol, latex_unit=self.units[symbol.name].latex)
            if symbol.name in self.units
            else symbol
            for symbol in shown
        )

    def values(self, si: Mapping[str, float]) -> dict[str, float]:
        return {name: value / self.factor(name) for name, value in si.items()}

    def priors(self, si: Mapping[str, Prior]) -> dict[str, Prior]:
        return {
            name: prior if (factor := self.factor(name)) == 1.0 else InUnits(prior, factor)
            for name, prior in si.items()
        }


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
