"""One sample of several, after a filter of zero phase that lets nothing alias."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

TAPS = 20  # times the factor, and one: the length of the filter
CUT = 0.8  # of the new Nyquist frequency: half of the amplitude passes there
BETA = 8.0  # of Kaiser's window: 1 to 1e-5 up to half the new Nyquist frequency, below 1e-4 from 1.2 on


@dataclass(frozen=True, slots=True)
class Thinned:
    """`y (n, K)` at samples `kept (n,)` of the record; `taken (K,)`: sd of what the filter took away."""

    y: Array
    kept: NDArray[np.intp]
    taken: Array


def length(factor: int) -> int:
    """Samples of the filter, an odd number."""
    return TAPS * factor + 1


def cutoff(factor: int, dt: float) -> float:
    """Hz."""
    return CUT / (2 * factor * dt)


def thinned(y: Array, factor: int) -> Thinned:
    """Of `y (T, K)` at equal steps, without NaN; within half the filter of an end nothing is left."""
    from scipy.signal import firwin, oaconvolve

    filter_ = firwin(length(factor), CUT / factor, window=("kaiser", BETA))
    smooth = oaconvolve(y, filter_[:, None], mode="valid", axes=0)
    first = length(factor) // 2
    kept = np.arange(first, len(y) - first, factor)
    own = smooth[kept - first]
    return Thinned(own, kept, np.std(y[kept] - own, axis=0))
