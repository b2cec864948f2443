"""Times of records: even and uneven, several clocks as one, and decimation with a filter of zero
phase.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesdrill.basics.arrays import Array
from bayesdrill.record.experiment import STEP_TOLERANCE, even

SAME = 1e-9  # of a step: times nearer than this are one
SPARSE = 10  # times as many places as samples, and a grid explains nothing


@dataclass(frozen=True, slots=True)
class Grid:
    """Times `begin + step * place`; `place (T,)` are whole numbers from 0 that increase."""

    begin: float
    step: float
    place: NDArray[np.int64]

    @property
    def times(self) -> Array:
        return np.asarray(self.begin + self.step * self.place, dtype=np.float64)

    @property
    def missing(self) -> int:
        """Samples that would fill the grid."""
        return int(self.place[-1]) + 1 - len(self.place)


def grid(t: Array) -> Grid | None:
    """The even grid on which each of `t (T,)` lies to `STEP_TOLERANCE` of its step, if there is one."""
    if len(t) < 3:
        return None
    steps, centre = np.diff(t), t.mean()
    for step in (float(np.median(steps)), float(steps.min())):
        near = steps[np.abs(steps - step) < step / 4]  # a mean, as times may have few digits
        place = np.concatenate([[0.0], np.cumsum(np.round(steps / near.mean()))])
        if not np.all(np.diff(place) > 0) or place[-1] > SPARSE * len(t):
            continue
        middle = place.mean()
        away = place - middle
        fitted = float(away @ (t - centre) / (away @ away))
        found = Grid(float(centre - fitted * middle), fitted, place.astype(np.int64))
        if np.all(np.abs(found.times - t) <= STEP_TOLERANCE * fitted):
            return found
    return None


def on_grid(t: Array) -> Array:
    """`t` itself where its steps are equal or have no grid, else the times of the grid."""
    found = None if even(t) else grid(t)
    return t if found is None else found.times


def in_words(t: Array) -> str:
    """What the times `t (T,)` are like, s."""
    if len(t) < 2:
        return f"one sample, at {t[0]:.6g} s"
    if even(t):
        step = (t[-1] - t[0]) / (len(t) - 1)
        return f"a sample every {step:.6g} s ({1 / step:.6g} Hz), the first at {t[0]:.6g} s"
    found = grid(t)
    if found is not None:
        return _gaps(t, found)
    steps = np.diff(t)
    return (
        f"{len(t)} times at unequal steps, usually {np.median(steps):.6g} s, from {steps.min():.6g} to "
        f"{steps.max():.6g} s with a relative sd of {steps.std() / steps.mean():.2g}; the first at "
        f"{t[0]:.6g} s"
    )


def _gaps(t: Array, found: Grid) -> str:
    gaps = np.diff(found.place)
    longest, count = int(np.argmax(gaps)), int(np.sum(gaps > 1))
    named = "1 gap" if count == 1 else f"{count} gaps, the longest"
    return (
        f"a sample every {found.step:.6g} s ({1 / found.step:.6g} Hz), the first at {t[0]:.6g} s; "
        f"{found.missing} missing in {named}{'' if count > 1 else ','} of {gaps[longest] - 1} between "
        f"{t[longest]:.6g} and {t[longest + 1]:.6g} s"
    )


def union(clocks: Sequence[Array]) -> Array:
    """Times of all `clocks`, each increasing; those that are the same on several stand once."""
    t = np.sort(np.concatenate(clocks))
    usual = min(map(usual_step, clocks))
    near = max(SAME * usual if usual < math.inf else 0.0, _rounding(t))
    return np.asarray(t[np.r_[True, np.diff(t) > near]], dtype=np.float64)


def crowded(t: Array, clocks: Sequence[Array]) -> float:
    """A time of the `union` `t` that is followed by another after far less than a step; NaN: none."""
    close = np.flatnonzero(np.diff(t) < STEP_TOLERANCE * min(map(usual_step, clocks)))
    return float(t[close[0]]) if len(close) else math.nan


def usual_step(clock: Array) -> float:
    """Step; of a single time there is none, and it is as good as any."""
    return float(np.median(np.diff(clock))) if len(clock) > 1 else math.inf


def _rounding(t: Array) -> float:
    return 4 * float(np.spacing(np.abs(t).max()))


def places(t: Array, clock: Array) -> NDArray[np.intp]:
    """Where each time of `clock`, one of those of the `union` `t`, stands there."""
    if len(t) < 2:
        return np.zeros(len(clock), dtype=np.intp)
    after = np.clip(np.searchsorted(t, clock), 1, len(t) - 1)
    return np.asarray(after - (clock - t[after - 1] < t[after] - clock), dtype=np.intp)


def held(t: Array, clock: Array, values: Array, *, first_order: bool) -> Array:
    """An input known at `clock (n,)`, at times `t (T,)`: straight between samples, or as the last was.

    Before the first sample it is the first, after the last the last.
    """
    if first_order:
        return np.interp(t, clock, values)
    usual = usual_step(clock)
    slack = (SAME * usual if usual < math.inf else 0.0) + _rounding(clock)
    last = np.searchsorted(clock, t + slack, side="right") - 1
    return np.asarray(values[np.maximum(last, 0)], dtype=np.float64)


TAPS = 20  # times the factor, and one: the length of the filter
CUT = 0.8  # of the new Nyquist frequency: half of the amplitude passes there
BETA = 8.0  # of Kaiser's window: 1 to 1e-5 up to half the new Nyquist frequency, below 1e-4 from 1.2 on


@dataclass(frozen=True, slots=True)
class Thinned:
    """`y (n, K)` at samples `kept (n,)` of the record; `taken (K,)`: sd of what the filter took away."""

    y: Array
    kept: NDArray[np.intp]
    taken: Array


def filter_length(factor: int) -> int:
    """Samples of the filter, an odd number."""
    return TAPS * factor + 1


def cutoff(factor: int, dt: float) -> float:
    """Hz."""
    return CUT / (2 * factor * dt)


def decimated(y: Array, factor: int) -> Thinned:
    """Of `y (T, K)` at equal steps, without NaN; within half the filter of an end nothing is left."""
    from scipy.signal import firwin, oaconvolve

    filter_ = firwin(filter_length(factor), CUT / factor, window=("kaiser", BETA))
    smooth = oaconvolve(y, filter_[:, None], mode="valid", axes=0)
    first = filter_length(factor) // 2
    kept = np.arange(first, len(y) - first, factor)
    own = smooth[kept - first]
    return Thinned(own, kept, np.std(y[kept] - own, axis=0))
