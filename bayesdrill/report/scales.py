"""Format numbers, symbols and axes: round numbers, LaTeX names, plain or logarithmic scales."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from html.entities import name2codepoint
from itertools import pairwise
from types import MappingProxyType

import numpy as np
from markupsafe import Markup

from bayesdrill.basics.arrays import Array
from bayesdrill.basics.symbols import INPUTS, PARAMETERS, STATES, Symbol
from bayesdrill.basics.units import Unit
from bayesdrill.inference.priors import Prior
from bayesdrill.record.experiment import Channel

TIME = Symbol("t", "s", "t", "s", "time")


def time_symbol(clock: Unit) -> Symbol:
    """Return the symbol of times in the unit of a clock."""
    return dataclasses.replace(TIME, latex_unit=clock.latex)


SINGLE, DOUBLE = 3.4, 7.0  # widths of figures in inches: one and two columns of text
DPI = 220  # resolution of PNG figures
WIDTHS: Mapping[str, float] = MappingProxyType({"single": SINGLE, "double": DOUBLE})
# Mantissas of the numbers on a logarithmic axis, from many in each decade to few.
SERIES: tuple[tuple[float, ...], ...] = ((1.0, 2.0, 5.0), (1.0, 3.0), (1.0,))
CURVED_RATIO = 4.0  # ratio of a logarithmic axis's ends below which its numbers are evenly spaced


def even_numbers(low: float, high: float, max_count: int) -> tuple[list[float], list[str]]:
    """Return at most `max_count` multiples of a round step from `low` to `high`, and their texts."""
    exponent = math.floor(math.log10((high - low) / max_count)) - 1
    while True:
        for factor, decimals in ((1.0, 0), (2.0, 0), (2.5, 1), (5.0, 0)):
            step = factor * 10.0**exponent
            first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
            if last - first < max_count:
                places = max(0, decimals - exponent)
                values = [round(k * step, places) for k in range(first, last + 1)]
                texts = (f"{value + 0.0:.{places}f}" for value in values)
                return values, [text.replace("-", "\N{MINUS SIGN}") for text in texts]
        exponent += 1


def in_ratios(low: float, high: float, max_count: int) -> tuple[list[float], list[str]]:
    """Return two to `max_count` (at least 3) numbers of a logarithmic axis, and their texts."""
    if high / low < CURVED_RATIO:
        return even_numbers(low, high, max_count)
    first, last = math.floor(math.log10(low)), math.ceil(math.log10(high))
    for series in SERIES:
        candidates = [m * 10.0**k for k in range(first, last + 1) for m in series]
        values = [value for value in candidates if low <= value <= high]
        if len(values) <= max_count:
            break
    else:
        step = -(-(len(values) - 1) // (max_count - 1))
        values = values[::step]
    if len(values) < 2:
        return even_numbers(low, high, max_count)
    if values[0] > 0.9e-3 and values[-1] < 1.1e4:
        return values, [f"{value:.6g}" for value in values]
    texts = []
    for value in values:
        mantissa, exponent = f"{value:.0e}".split("e")
        times = "" if mantissa == "1" else rf"{mantissa}{{\cdot}}"
        texts.append(f"${times}10^{{{int(exponent)}}}$")
    return values, texts


def latex_number(x: float) -> str:
    """Return a number with all its digits, as LaTeX."""
    mantissa, exponent = f"{x:.15e}".split("e")
    digits = repr(float(mantissa)).removesuffix(".0")
    if -2 <= int(exponent) <= 2:
        return repr(x).removesuffix(".0")
    return rf"{digits}{{\cdot}}10^{{{int(exponent)}}}"


def with_spread(x: float, low: float, high: float) -> str:
    """Return LaTeX of x and its interval, with two digits of the interval's shorter side."""
    shorter = min(x - low, high - x)
    places = max(0, 1 - math.floor(math.log10(shorter))) if shorter > 0 else 3
    return f"{x:.{places}f}^{{+{high - x:.{places}f}}}_{{-{x - low:.{places}f}}}"


_DOT, _ABOVE = r"\dot", Markup("&#775;")
_INDEXED = re.compile(r"\\?(?P<letter>[A-Za-z]+)(_(\{(?P<inside>.+)\}|(?P<index>[A-Za-z0-9])))?")
_WORD = r"(?<![\w\\.])({})(?![\w(])(?!\.\w)"
_POWER = re.compile(r"\^(-?\d+)")
_CODE = re.compile(r"`([^`]+)`")
_STRONG = re.compile(r"\*\*([^*]+)\*\*")
_EMPHASIS = re.compile(r"(?<![\w*)])\*([A-Za-z][^*]*)\*(?!\w)")


def printed(symbols: Iterable[Symbol] = ()) -> Mapping[str, Markup]:
    """Return HTML of the package's symbols and of `symbols`, by name, if they have a simple form."""
    known = (*PARAMETERS.values(), *STATES.values(), *INPUTS.values(), *symbols)
    letters = {symbol.name: _letter(symbol.latex) for symbol in known}
    return {name: Markup("<var>{}</var>").format(html) for name, html in letters.items() if html}


def _letter(latex: str) -> Markup:
    """Return HTML of a LaTeX symbol; empty unless it is a letter, with or without an index."""
    dotted = latex.startswith(_DOT)
    matched = _INDEXED.fullmatch(latex.removeprefix(_DOT).replace(r"\mathrm", ""))
    if matched is None:
        return Markup()
    letter = matched["letter"]
    greek = letter in name2codepoint
    if len(letter) > 1 and not greek:
        return Markup()
    inside = (matched["inside"] or "").strip("{}")
    index = matched["index"] or _letter(inside) or inside
    if index and "\\" in index:
        return Markup()
    base = Markup(f"&{letter};") if greek else letter
    low = Markup("<sub>{}</sub>").format(index) if index else ""
    return Markup().join((base, _ABOVE if dotted else "", low))


def _splitting(
    pattern: re.Pattern[str], inside: Callable[[str], str], outside: Callable[[str], str]
) -> Callable[[str], Markup]:
    """Return a function that applies `inside` to matches of `pattern` and `outside` to other text.

    Results that are not `Markup` are escaped.
    """

    def typeset(text: str) -> Markup:
        parts = enumerate(pattern.split(text))
        return Markup().join(inside(part) if k % 2 else outside(part) for k, part in parts)

    return typeset


class Typesetter:
    """The typesetter converts text to escaped HTML.

    `plain` typesets symbols and powers. `prose` typesets **strong**, *emphasis* and `code` too; the
    content of `code` is not changed.
    """

    def __init__(self, names: Mapping[str, Markup]) -> None:
        code, strong, slanted, power = (
            Markup(f"<{tag}>{{}}</{tag}>").format for tag in ("code", "strong", "em", "sup")
        )
        longest = sorted(names, key=len, reverse=True)
        named = re.compile(_WORD.format("|".join(map(re.escape, longest))))
        plain = _splitting(named, names.__getitem__, _splitting(_POWER, power, str))
        emphasis = _splitting(_EMPHASIS, lambda text: slanted(plain(text)), plain)
        stressed = _splitting(_STRONG, lambda text: strong(emphasis(text)), emphasis)
        self.plain, self.prose = plain, _splitting(_CODE, code, stressed)


# Ratio of a logarithmic axis's ends above which each number has its own power of ten.
LONG_LOG_RATIO = 1e4
CROWDED_RATIO = 1e5  # ratio of an axis's ends above which minor ticks would be too many
NARROW_RATIO = 1e-3  # ratio of an axis's width to its largest value, below which `origin` is not 0


type Labelled = Symbol | Channel


@dataclass(frozen=True, slots=True)
class Scale:
    """A scale maps values to positions on an axis, which is shown from `low` to `high`.

    The position of a value x is u = (x - origin) / 10**power, or log10(x / 10**power) on a
    logarithmic axis.
    """

    origin: float
    power: int
    low: float
    high: float
    log: bool = False

    def __call__(self, x: Array | float) -> Array:
        """Return the positions of values `x` on the axis."""
        values = np.asarray(x, dtype=np.float64)
        if self.log:
            with np.errstate(divide="ignore", invalid="ignore"):
                return np.asarray(np.log10(values) - self.power)
        return self.axis_numbers(values)

    def axis_numbers(self, x: Array | float) -> Array:
        """Return the numbers that the axis shows for values `x`: (x - origin) / 10**power."""
        return np.asarray((np.asarray(x) - self.origin) / 10.0**self.power, dtype=np.float64)

    def value(self, u: Array | float) -> Array:
        """Return the value at the position `u` of the axis."""
        numbers = 10.0 ** np.asarray(u) if self.log else np.asarray(u)
        return np.asarray(self.origin + numbers * 10.0**self.power, dtype=np.float64)

    def density(self, prior: Prior, u: Array) -> Array:
        """Return the density of a prior per unit of the axis, or per decade of a logarithmic axis."""
        x = self.value(u)
        stretch = x * math.log(10.0) if self.log else 10.0**self.power
        return np.asarray(np.exp(prior.logpdf(x)) * stretch)

    def side(self, x: float | None) -> int:
        """Return -1, 0 or 1 if `x` is below, on or above the axis; 0 for None."""
        if x is None:
            return 0
        u = float(self(x))
        return int(u > self.high) - int(u < self.low)

    def ticks(
        self, max_count: int = 3, *, clear: float = 0.05, letter: float = 0.0
    ) -> tuple[Array, list[str]]:
        """Return two to `max_count` (at least 3) ticks at round values, and their texts.

        `clear` is their smallest distance from the ends, and `letter` the width of a letter, both as
        fractions of the axis.
        """
        length = self.high - self.low
        low, high = self.low + clear * length, self.high - clear * length
        if self.log:
            values, texts = in_ratios(10.0**low, 10.0**high, max_count)
            values = [math.log10(value) for value in values]
        else:
            values, texts = even_numbers(low, high, max_count)
        room = letter * max(map(len, texts)) * length
        if len(values) == 3 and room > min(b - a for a, b in pairwise(values)):
            values, texts = values[::2], texts[::2]
        return np.array(values), texts

    @property
    def minor_ticks(self) -> Array:
        """Return the minor ticks of a short logarithmic axis (1, 2, ... 9 in each decade), or none."""
        if not self.log or not CURVED_RATIO <= 10.0 ** (self.high - self.low) < CROWDED_RATIO:
            return np.empty(0)
        decades = range(math.floor(self.low), math.ceil(self.high) + 1)
        positions = np.log10([m * 10.0**k for k in decades for m in range(1, 10)])
        return np.asarray(positions[(positions >= self.low) & (positions <= self.high)])

    def label(self, what: Labelled, separator: str = " ") -> str:
        r"""Return a label with the power of ten that divides the axis values, and the unit.

        For example `$j_m$ [$10^{-4}\,\mathrm{kg\,m^2}$]`.
        """
        sign = "-" if self.origin > 0 else "+"
        off = f" {sign} {latex_number(abs(self.origin))}" if self.origin else ""
        quantity = f"${what.latex}{off}$"
        inside = unit_of(self.power, what.latex_unit)
        return f"{quantity}{separator}[{inside}]" if inside else quantity


def scale(low: float, high: float, *, log: bool = False, margin: float = 0.0) -> Scale:
    """Return a scale from `low` to `high`, with a `margin` at both ends as a fraction of the range.

    With `log` the scale is logarithmic, unless the range is so short that it would look linear.
    """
    if not high > low:
        half = 1e-9 * abs(low) or 1.0
        low, high = low - half, high + half
    if log and low > 0 and high > (1 + NARROW_RATIO) * low:
        beyond = (high / low) ** margin
        low, high = low / beyond, high * beyond
        power = _power(math.sqrt(low * high)) if high / low < LONG_LOG_RATIO else 0
        return Scale(0.0, power, math.log10(low) - power, math.log10(high) - power, log=True)
    beyond = margin * (high - low)
    low, high = low - beyond, high + beyond
    origin = 0.0
    if high - low < NARROW_RATIO * max(abs(low), abs(high)):
        middle = 0.5 * (low + high)
        rounded = (float(f"{middle:.{digits}e}") for digits in range(18))
        origin = next(x for x in rounded if abs(x - middle) <= high - low)
    farthest = max(abs(low - origin), abs(high - origin))
    power = _power(farthest) if origin == 0.0 else math.floor(math.log10(farthest))
    unit = 10.0**power
    return Scale(origin, power, (low - origin) / unit, (high - origin) / unit)


def _power(farthest: float) -> int:
    power = math.floor(math.log10(farthest))
    return 0 if -1 <= power <= 3 else power


def reaching(
    low: float, high: float, value: float | None, farthest: float = math.inf, *, log: bool = False
) -> tuple[float, float]:
    """Return the ends, moved to include `value` if it is at most `farthest` axis widths outside."""
    if value is None or (log and not (low > 0 and value > 0)):
        return low, high
    first, last, at = (math.log(x) if log else x for x in (low, high, value))
    off = max(first - at, at - last)
    if off > farthest * (last - first):
        return low, high
    return min(low, value), max(high, value)


def unit_of(power: int, latex_unit: str) -> str:
    """Return a power of ten and a unit in LaTeX; empty without either."""
    ten = rf"10^{{{power}}}" if power else ""
    unit = rf"\mathrm{{{latex_unit}}}" if latex_unit else ""
    inside = r"\,".join(part for part in (ten, unit) if part)
    return f"${inside}$" if inside else ""
