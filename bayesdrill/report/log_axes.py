"""Logarithmic axes with few ticks, none of them beyond the ends."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axis import Axis
from matplotlib.ticker import NullLocator
from numpy.typing import NDArray

from bayesdrill.report import style

Array = NDArray[np.float64]

MOST = 8  # ticks


def set_decades(axis: Axis, low: float, high: float) -> None:
    """From `low` to `high`, with powers of ten for ticks."""
    _set(axis, low, high, 10)


def set_factors(axis: Axis, factors: Array) -> None:
    """Shows at least 0.5 to 2 and all factors; ticks are powers of 2, or of 10 on a long axis."""
    sure = usable(factors)
    low, high = min(0.48, 0.85 * sure.min(initial=1.0)), max(2.1, 1.18 * sure.max(initial=1.0))
    _set(axis, low, high, 2 if high / low < 2**MOST else 10)


def usable(x: Array) -> Array:
    """Those that a logarithmic axis can show."""
    return x[np.isfinite(x) & (x > 0)]


def _set(axis: Axis, low: float, high: float, base: int) -> None:
    name: Any = axis.axis_name  # type: ignore[attr-defined]
    axis.axes.set(**{f"{name}scale": "log", f"{name}lim": (low, high)})
    first, last = (np.log(end) / np.log(base) for end in (low, high))
    exponents = np.arange(np.ceil(first), np.floor(last) + 1)
    exponents = exponents[exponents % -(-len(exponents) // MOST) == 0]
    places = float(base) ** exponents
    plain = places.min(initial=1.0) > 0.9e-3 and places.max(initial=1.0) < 1.1e4
    texts = [
        f"{x:g}" if plain else rf"$10^{{{round(k)}}}$"
        for k, x in zip(exponents, places, strict=True)
    ]
    style.set_ticks(axis, places, texts)
    axis.set_minor_locator(NullLocator())
