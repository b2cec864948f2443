"""Convert unknowns, fixed values and derived quantities from SI to the units of the user.

Machine-readable files are in SI.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.basics.symbols import Symbol, plain
from bayesdrill.basics.units import Unit
from bayesdrill.inference.priors import Prior

# Fields of table rows that hold values of an unknown or a derived quantity.
_VALUES = ("nominal", "map", "mean", "sd", "hdi_low", "hdi_high", "pressed_against")


@dataclass(frozen=True, slots=True)
class DisplayUnits:
    """Display units map names of quantities to `units`; other quantities are shown in SI."""

    units: Mapping[str, Unit]

    def factor(self, name: str) -> float:
        """Return the SI units per display unit."""
        return self.units[name].factor if name in self.units else 1.0

    def factors(self, symbols: Iterable[Symbol]) -> Array:
        """Return the factors of several symbols, `(D,)`."""
        return np.array([self.factor(symbol.name) for symbol in symbols])

    def symbol(self, si: Symbol) -> Symbol:
        """Return the symbol with its display unit, as plain text and in LaTeX."""
        if (unit := self.units.get(si.name)) is None:
            return si
        return dataclasses.replace(si, unit=unit.name, latex_unit=unit.latex)

    def symbols(self, si: Iterable[Symbol]) -> tuple[Symbol, ...]:
        """Return the symbols with their display units."""
        return tuple(map(self.symbol, si))

    def values(self, si: Mapping[str, float]) -> dict[str, float]:
        """Return values by name in display units."""
        return {name: value / self.factor(name) for name, value in si.items()}

    def format_value(self, name: str, si: float, digits: int = 4) -> str:
        """Return a value for a sentence, with the user's unit if there is one: `0.1 deg`."""
        number, unit = f"{si / self.factor(name):.{digits}g}", self._plain_unit(name)
        return f"{number} {unit}" if unit else number

    def describe_prior(self, name: str, si: Prior) -> str:
        """Return a prior in words, with the user's unit if there is one."""
        text, unit = self.prior(name, si).describe(), self._plain_unit(name)
        return f"{text}, in {unit}" if unit else text

    def _plain_unit(self, name: str) -> str:
        """Return the user's unit as plain text, or an empty string."""
        unit = self.units[name].name if name in self.units else ""
        return plain(unit) if unit not in ("", "1") else ""

    def rows[R](self, si: Sequence[R]) -> tuple[R, ...]:
        """Return table rows in display units; each row has a `name`, a `unit` and values."""
        return tuple(map(self._row, si))

    def _row(self, si: Any) -> Any:
        unit = self.units.get(si.name)
        if unit is None:
            return si
        si_values = {key: getattr(si, key, None) for key in _VALUES}
        values = {key: x / unit.factor for key, x in si_values.items() if x is not None}
        return dataclasses.replace(si, unit=unit.name, **values)

    def prior(self, name: str, si: Prior) -> Prior:
        """Return a prior in its display unit."""
        return si if (factor := self.factor(name)) == 1.0 else si.scaled(1 / factor)

    def priors(self, si: Mapping[str, Prior]) -> dict[str, Prior]:
        """Return priors by name in display units."""
        return {name: self.prior(name, prior) for name, prior in si.items()}


SI = DisplayUnits({})


@dataclass(frozen=True, slots=True, kw_only=True)
class DisplayedUnknowns:
    """Unknowns or derived quantities are shown with all numbers in the units of `symbols`.

    `columns` are the indices of the shown unknowns in arrays of draws; an empty tuple shows all.
    `factors (D,)` are SI units per display unit.
    """

    symbols: tuple[Symbol, ...]
    columns: tuple[int, ...] = ()
    factors: Array = field(default_factory=lambda: np.ones(1))
    priors: Mapping[str, Prior] = field(default_factory=dict)
    nominal: Mapping[str, float] = field(default_factory=dict)
    mode: Mapping[str, float] = field(default_factory=dict)

    def select(self, si: Array) -> Array:
        """Return values `si (..., D)` of all unknowns in display units, shown columns only."""
        selected = si if len(self.columns) in (0, si.shape[-1]) else si[..., self.columns]
        return selected if (self.factors == 1.0).all() else selected / self.factors
