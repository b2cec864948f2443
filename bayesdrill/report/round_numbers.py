"""Numbers as axes show them: round ones, few, and as texts."""

from __future__ import annotations

import math
from itertools import pairwise

# Of each decade of a logarithmic axis, from many numbers to few.
SERIES: tuple[tuple[float, ...], ...] = ((1.0, 2.0, 5.0), (1.0, 3.0), (1.0,))
CURVED = 4.0  # the ratio of its ends from which on a logarithmic axis has numbers of a series


def near(x: float, width: float) -> float:
    """The number of fewest digits that is within `width` of x."""
    return next(
        rounded
        for rounded in (float(f"{x:.{digits}e}") for digits in range(18))
        if abs(rounded - x) <= width
    )


def even(low: float, high: float, most: int) -> tuple[list[float], list[str]]:
    """The multiples of the finest step that gives at most `most`, and their texts."""
    exponent = math.floor(math.log10((high - low) / most)) - 1
    while True:
        for factor, decimals in ((1.0, 0), (2.0, 0), (2.5, 1), (5.0, 0)):
            step = factor * 10.0**exponent
            first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
            if last - first < most:
                places = max(0, decimals - exponent)
                values = [round(k * step, places) for k in range(first, last + 1)]
                return values, [fixed(value, places) for value in values]
        exponent += 1


def in_ratios(low: float, high: float, most: int) -> tuple[list[float], list[str]]:
    """Two to `most` (3 or more) numbers of an axis that is logarithmic from `low` to `high`."""
    if high / low < CURVED:
        return even(low, high, most)
    first, last = math.floor(math.log10(low)), math.ceil(math.log10(high))
    for series in SERIES:
        found = [m * 10.0**k for k in range(first, last + 1) for m in series]
        values = [value for value in found if low <= value <= high]
        if len(values) <= most:
            break
    else:
        step = -(-(len(values) - 1) // (most - 1))
        values = values[::step]
    if len(values) < 2:
        return even(low, high, most)
    plain = values[0] > 0.9e-3 and values[-1] < 1.1e4
    return values, [_plainly(value) if plain else _in_powers(value) for value in values]


def _plainly(value: float) -> str:
    return f"{value:.6g}"


def _in_powers(value: float) -> str:
    mantissa, exponent = f"{value:.0e}".split("e")
    ten = rf"10^{{{int(exponent)}}}"
    return f"${ten}$" if mantissa == "1" else rf"${mantissa}{{\cdot}}{ten}$"


def fixed(value: float, places: int) -> str:
    return f"{value + 0.0:.{places}f}".replace("-", "\N{MINUS SIGN}")


def short(x: float) -> str:
    """Three digits."""
    return f"{x:.3g}".replace("-", "\N{MINUS SIGN}")


def latex(x: float) -> str:
    """All its digits."""
    mantissa, exponent = f"{x:.15e}".split("e")
    digits = repr(float(mantissa)).removesuffix(".0")
    if -2 <= int(exponent) <= 2:
        return repr(x).removesuffix(".0")
    return rf"{digits}{{\cdot}}10^{{{int(exponent)}}}"


def with_spread(x: float, low: float, high: float) -> str:
    """LaTeX of x and its interval, with two digits of the interval's shorter side."""
    shorter = min(x - low, high - x)
    places = max(0, 1 - math.floor(math.log10(shorter))) if shorter > 0 else 3
    return f"{x:.{places}f}^{{+{high - x:.{places}f}}}_{{-{x - low:.{places}f}}}"


def apart(places: list[float]) -> float:
    """The least distance of two neighbours."""
    return min((b - a for a, b in pairwise(places)), default=math.inf)
