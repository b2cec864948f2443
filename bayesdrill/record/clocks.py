"""Times of records: even and uneven, several clocks as one, and zero-phase decimation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayesdrill.basics.arrays import Array, Counts, Indices
from bayesdrill.record.experiment import STEP_TOLERANCE, is_even

SAME_TIME = 1e-9  # of a step: times nearer than this are one
MAX_SPARSITY = 10  # times as many places as samples, and a grid explains nothing


@dataclass(frozen=True, slots=True)
class SampleGrid:
    """Times `begin + step * place`; `place (T,)` are whole numbers from 0 that increase."""

    begin: float
    step: float
    indices: Counts

    @property
    def times(self) -> Array:
        """The times `(T,)`, in the unit of `step`."""
        return np.asarray(self.begin + self.step * self.indices, dtype=np.float64)


def grid(t: Array) -> SampleGrid | None:
    """The even grid on which each of `t (T,)` lies to `STEP_TOLERANCE` of its step, if there is one."""
    if len(t) < 3:
        return None
    steps, centre = np.diff(t), t.mean()
    for step in (float(np.median(steps)), float(steps.min())):
        near = steps[np.abs(steps - step) < step / 4]  # a mean, as times may have few digits
        indices = np.concatenate([[0.0], np.cumsum(np.round(steps / near.mean()))])
        if not np.all(np.diff(indices) > 0) or indices[-1] > MAX_SPARSITY * len(t):
            continue
        middle = indices.mean()
        away = indices - middle
        fitted = float(away @ (t - centre) / (away @ away))
        result = SampleGrid(float(centre - fitted * middle), fitted, indices.astype(np.int64))
        if np.all(np.abs(result.times - t) <= STEP_TOLERANCE * fitted):
            return result
    return None


def on_grid(t: Array) -> Array:
    """Return `t (T,)` itself where its steps are equal or have no grid, else the times of the grid."""
    nearest = None if is_even(t) else grid(t)
    return t if nearest is None else nearest.times


def describe_times(t: Array) -> str:
    """Describe the times `t (T,)` [s] in words."""
    if len(t) < 2:
        return f"one sample, at {t[0]:.6g} s"
    if is_even(t):
        step = (t[-1] - t[0]) / (len(t) - 1)
        return f"a sample every {step:.6g} s ({1 / step:.6g} Hz), the first at {t[0]:.6g} s"
    on_grid = grid(t)
    if on_grid is not None:
        return _gaps(t, on_grid)
    steps = np.diff(t)
    return (
        f"{len(t)} times at unequal steps, usually {np.median(steps):.6g} s, from {steps.min():.6g} to "
        f"{steps.max():.6g} s with a relative sd of {steps.std() / steps.mean():.2g}; the first at "
        f"{t[0]:.6g} s"
    )


def _gaps(t: Array, grid: SampleGrid) -> str:
    gaps = np.diff(grid.indices)
    longest, count, missing = int(np.argmax(gaps)), int(np.sum(gaps > 1)), int(np.sum(gaps - 1))
    named = "1 gap" if count == 1 else f"{count} gaps, the longest"
    return (
        f"a sample every {grid.step:.6g} s ({1 / grid.step:.6g} Hz), the first at {t[0]:.6g} s; "
        f"{missing} missing in {named}{'' if count > 1 else ','} of {gaps[longest] - 1} between "
        f"{t[longest]:.6g} and {t[longest + 1]:.6g} s"
    )


def union(clocks: Sequence[Array]) -> Array:
    """Merge the times of all `clocks`, each increasing; a time that several share stands once."""
    t = np.sort(np.concatenate(clocks))
    step = min(map(median_step, clocks))
    near = max(SAME_TIME * step if step < math.inf else 0.0, _rounding(t))
    return np.asarray(t[np.r_[True, np.diff(t) > near]], dtype=np.float64)


def crowded_time(t: Array, clocks: Sequence[Array]) -> float:
    """Return a time of the `union` `t` that another follows after far less than a step, or NaN."""
    close = np.flatnonzero(np.diff(t) < STEP_TOLERANCE * min(map(median_step, clocks)))
    return float(t[close[0]]) if len(close) else math.nan


def median_step(clock: Array) -> float:
    """Return the median step; infinite for a single time, which is as good as any."""
    return float(np.median(np.diff(clock))) if len(clock) > 1 else math.inf


def _rounding(t: Array) -> float:
    return 4 * float(np.spacing(np.abs(t).max()))


def indices_in(t: Array, clock: Array) -> Indices:
    """Return the index of each time of `clock`, one of those of the `union` `t`, in it."""
    if len(t) < 2:
        return np.zeros(len(clock), dtype=np.intp)
    after = np.clip(np.searchsorted(t, clock), 1, len(t) - 1)
    return np.asarray(after - (clock - t[after - 1] < t[after] - clock), dtype=np.intp)


def hold_input(t: Array, clock: Array, values: Array, *, first_order: bool) -> Array:
    """Hold an input known at `clock (n,)` at times `t (T,)`, first or zero order; ends go on beyond."""
    if first_order:
        return np.interp(t, clock, values)
    step = median_step(clock)
    slack = (SAME_TIME * step if step < math.inf else 0.0) + _rounding(clock)
    last = np.searchsorted(clock, t + slack, side="right") - 1
    return np.asarray(values[np.maximum(last, 0)], dtype=np.float64)


TAPS_PER_FACTOR = 20  # times the factor, and one: the length of the filter
CUTOFF_SHARE = 0.8  # of the new Nyquist frequency: half of the amplitude passes there
# Of the window: 1 to 1e-5 up to half the new Nyquist frequency, below 1e-4 from 1.2 on.
KAISER_BETA = 8.0


@dataclass(frozen=True, slots=True)
class DecimatedSignals:
    """`y (n, K)` at samples `kept (n,)` of the record; `taken (K,)`: sd of what the filter took away."""

    y: Array
    samples: Indices
    removed: Array


def filter_length(factor: int) -> int:
    """Return how many samples the filter has, an odd number."""
    return TAPS_PER_FACTOR * factor + 1


def cutoff(factor: int, dt: float) -> float:
    """Return the cutoff frequency [Hz], where half of the amplitude passes."""
    return CUTOFF_SHARE / (2 * factor * dt)


def decimated(y: Array, factor: int) -> DecimatedSignals:
    """Filter `y (T, K)`, at equal steps and without NaN, by a Kaiser-window FIR, and decimate it.

    Within half the filter of an end nothing is left.
    """
    from scipy.signal import firwin, oaconvolve

    filter_ = firwin(filter_length(factor), CUTOFF_SHARE / factor, window=("kaiser", KAISER_BETA))
    smooth = oaconvolve(y, filter_[:, None], mode="valid", axes=0)
    first = filter_length(factor) // 2
    samples = np.arange(first, len(y) - first, factor)
    filtered = smooth[samples - first]
    return DecimatedSignals(filtered, samples, np.std(y[samples] - filtered, axis=0))
