"""The units of the user: in which people are shown unknowns, and what is held or follows from them.

Files for machines are SI, each number with its unit.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.basics.symbols import Symbol, plain
from bayesdrill.basics.units import Unit
from bayesdrill.inference.priors import Prior


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
        unit = self.units.get(si.name)
        return (
            si if unit is None else dataclasses.replace(si, unit=unit.name, latex_unit=unit.latex)
        )

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
        unit = self.units.get(si.name)
        if unit is None:
            return si
        known = {key: getattr(si, key, None) for key in _VALUES}
        values = {key: x / unit.factor for key, x in known.items() if x is not None}
        return dataclasses.replace(si, unit=unit.name, **values)  # type: ignore[type-var]

    def prior(self, name: str, si: Prior) -> Prior:
        return si if (factor := self.factor(name)) == 1.0 else si.scaled(1 / factor)

    def priors(self, si: Mapping[str, Prior]) -> dict[str, Prior]:
        return {name: self.prior(name, prior) for name, prior in si.items()}


SI = OwnUnits({})


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
