"""Axes: which number stands for a value, plain or logarithmic, with few digits and a label."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from bayesdrill.inference.priors import Prior
from bayesdrill.report import round_numbers

Array = NDArray[np.float64]

LONG = 1e4  # the ratio of its ends from which on a logarithmic axis says its powers of ten at its ticks
CROWDED = 1e5  # and that from which on small ticks would be too many
NARROW = 1e-3  # an axis narrower than this, relative to its numbers, counts from an origin


class Labelled(Protocol):
    """What a symbol and a channel have in common; LaTeX without dollars."""

    @property
    def latex(self) -> str: ...

    @property
    def latex_unit(self) -> str: ...


@dataclass(frozen=True, slots=True)
class Scale:
    """Numbers on an axis, shown from low to high: u = (x - origin) / 10**power of the value x, or
    log10(x / 10**power) where the axis is logarithmic.
    """

    origin: float
    power: int
    low: float
    high: float
    log: bool = False

    def __call__(self, x: Array | float) -> Array:
        values = np.asarray(x, dtype=np.float64)
        if self.log:
            with np.errstate(divide="ignore", invalid="ignore"):
                return np.asarray(np.log10(values) - self.power)
        return np.asarray((values - self.origin) / 10.0**self.power)

    def number(self, x: Array | float) -> Array:
        """What the texts of the axis call the value x: in its power of ten, from its origin."""
        return np.asarray((np.asarray(x) - self.origin) / 10.0**self.power, dtype=np.float64)

    def value(self, u: Array | float) -> Array:
        """The value at the number `u` of the axis."""
        numbers = 10.0 ** np.asarray(u) if self.log else np.asarray(u)
        return np.asarray(self.origin + numbers * 10.0**self.power, dtype=np.float64)

    def density(self, prior: Prior, u: Array) -> Array:
        """Of a prior of the values, along the axis: flat where the prior is flat in what it shows."""
        x = self.value(u)
        stretch = x * math.log(10.0) if self.log else 10.0**self.power
        return np.asarray(np.exp(prior.logpdf(x)) * stretch)

    def share(self, u: Array) -> Array:
        """0 at the low end of the axis, 1 at the high end, for numbers `u` on it."""
        return np.asarray((u - self.low) / (self.high - self.low), dtype=np.float64)

    @property
    def shown_ends(self) -> tuple[float, float]:
        """As texts of the axis would call its ends."""
        low, high = (float(self.number(self.value(u))) for u in (self.low, self.high))
        return low, high

    def side(self, x: float | None) -> int:
        """-1, 0 or 1: the value x is below, on or above the axis; 0 when there is none."""
        if x is None:
            return 0
        u = float(self(x))
        return int(u > self.high) - int(u < self.low)

    def ticks(
        self, most: int = 3, *, clear: float = 0.05, letter: float = 0.0
    ) -> tuple[Array, list[str]]:
        """As `ticks`, with round values where the axis is logarithmic."""
        return ticks(self.low, self.high, most, clear=clear, letter=letter, log=self.log)

    @property
    def between(self) -> Array:
        """Places of 1, 2, ... 9 of each decade, where a logarithmic axis has few of these."""
        if not self.log or not round_numbers.CURVED <= 10.0 ** (self.high - self.low) < CROWDED:
            return np.empty(0)
        decades = range(math.floor(self.low), math.ceil(self.high) + 1)
        every = np.log10([m * 10.0**k for k in decades for m in range(1, 10)])
        return np.asarray(every[(every >= self.low) & (every <= self.high)])

    def label(self, what: Labelled, separator: str = " ") -> str:
        return axis_label(what, self.power, self.origin, separator)


def scale(low: float, high: float, *, log: bool = False, margin: float = 0.0) -> Scale:
    """For the values from `low` to `high` and a `margin` in widths of the axis, with few digits.

    `log`: a logarithmic axis, unless it is so short that it would look the same.
    """
    if not high > low:
        half = 1e-9 * abs(low) or 1.0
        low, high = low - half, high + half
    if log and low > 0 and high > (1 + NARROW) * low:
        beyond = (high / low) ** margin
        low, high = low / beyond, high * beyond
        power = _power(math.sqrt(low * high)) if high / low < LONG else 0
        return Scale(0.0, power, math.log10(low) - power, math.log10(high) - power, log=True)
    beyond = margin * (high - low)
    low, high = low - beyond, high + beyond
    origin = 0.0
    if high - low < NARROW * max(abs(low), abs(high)):
        origin = round_numbers.near(0.5 * (low + high), high - low)
    farthest = max(abs(low - origin), abs(high - origin))
    power = _power(farthest) if origin == 0.0 else math.floor(math.log10(farthest))
    unit = 10.0**power
    return Scale(origin, power, (low - origin) / unit, (high - origin) / unit)


def _power(farthest: float) -> int:
    """Of ten, by which numbers up to `farthest` are divided."""
    power = math.floor(math.log10(farthest))
    return 0 if -1 <= power <= 3 else power


def reaching(
    low: float, high: float, value: float | None, farthest: float = math.inf, *, log: bool = False
) -> tuple[float, float]:
    """The ends, moved to show `value` where it is within `farthest` of them, in widths."""
    if value is None or (log and not (low > 0 and value > 0)):
        return low, high
    first, last, at = (math.log(x) if log else x for x in (low, high, value))
    off = max(first - at, at - last)
    if math.isfinite(farthest) and off > farthest * (last - first):
        return low, high
    return min(low, value), max(high, value)


def axis_label(what: Labelled, power: int, origin: float = 0.0, separator: str = " ") -> str:
    r"""For example `$j_m$ [$10^{-4}\,\mathrm{kg\,m^2}$]`: axis values are divided by the power."""
    sign = "-" if origin > 0 else "+"
    off = f" {sign} {round_numbers.latex(abs(origin))}" if origin else ""
    quantity = f"${what.latex}{off}$"
    inside = unit_of(power, what.latex_unit)
    return f"{quantity}{separator}[{inside}]" if inside else quantity


def unit_of(power: int, latex_unit: str) -> str:
    """A power of ten and a unit in LaTeX; empty where there is neither."""
    ten = rf"10^{{{power}}}" if power else ""
    unit = rf"\mathrm{{{latex_unit}}}" if latex_unit else ""
    inside = r"\,".join(part for part in (ten, unit) if part)
    return f"${inside}$" if inside else ""


def ticks(
    low: float,
    high: float,
    most: int = 3,
    *,
    clear: float = 0.05,
    letter: float = 0.0,
    log: bool = False,
) -> tuple[Array, list[str]]:
    """Two to `most` (3 or more) round numbers and their texts.

    Shares of the axis: `clear` stays free at both ends; `letter` is the room that a letter of a
    text needs, and where three texts have less, only the outer two stay.
    """
    length = high - low
    low, high = low + clear * length, high - clear * length
    if log:
        values, texts = round_numbers.in_ratios(10.0**low, 10.0**high, most)
        values = [math.log10(value) for value in values]
    else:
        values, texts = round_numbers.even(low, high, most)
    room = letter * max(map(len, texts)) * length
    if len(values) == 3 and room > round_numbers.apart(values):
        values, texts = values[::2], texts[::2]
    return np.array(values), texts
