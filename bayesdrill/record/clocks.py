"""Handle times of records: even and uneven grids, merged clocks, and zero-phase decimation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayesdrill.basics.arrays import Array, Counts, Indices
from bayesdrill.record.experiment import STEP_TOLERANCE, is_even

SAME_TIME = 1e-9  # in steps: times that differ by less are treated as equal
MAX_SPARSITY = 10  # largest number of grid points per sample; a finer grid would fit any times


@dataclass(frozen=True, slots=True)
class SampleGrid:
    """A sample grid has times `begin + step * indices`; `indices (T,)` increase from 0."""

    begin: float
    step: float
    indices: Counts

    @property
    def times(self) -> Array:
        """Return the times `(T,)`, in the unit of `step`."""
        return np.asarray(self.begin + self.step * self.indices, dtype=np.float64)


def grid(t: Array) -> SampleGrid | None:
    """Return the even grid that is within `STEP_TOLERANCE` steps of all times `t (T,)`, or None."""
    if len(t) < 3:
        return None
    steps, centre = np.diff(t), t.mean()
    for step in (float(np.median(steps)), float(steps.min())):
        similar = steps[np.abs(steps - step) < step / 4]  # averaged, as times may be rounded
        indices = np.concatenate([[0.0], np.cumsum(np.round(steps / similar.mean()))])
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
    """Return the times of the grid of `t (T,)`; `t` itself if it is even or has no grid."""
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
    named = "1 gap" if count == 1 else f"{count} gaps, the longest of {gaps[longest] - 1}"
    return (
        f"a sample every {grid.step:.6g} s ({1 / grid.step:.6g} Hz), the first at {t[0]:.6g} s; "
        f"{missing} missing in {named} between "
        f"{t[longest]:.6g} and {t[longest + 1]:.6g} s"
    )


def union(clocks: Sequence[Array]) -> Array:
    """Merge the increasing times of all `clocks`; a common time occurs once."""
    t = np.sort(np.concatenate(clocks))
    step = min(map(median_step, clocks))
    tolerance = max(SAME_TIME * step if step < math.inf else 0.0, _rounding(t))
    return np.asarray(t[np.r_[True, np.diff(t) > tolerance]], dtype=np.float64)


def crowded_time(t: Array, clocks: Sequence[Array]) -> float:
    """Return the first time in the union `t` that nearly equals the next time, or NaN."""
    close = np.flatnonzero(np.diff(t) < STEP_TOLERANCE * min(map(median_step, clocks)))
    return float(t[close[0]]) if len(close) else math.nan


def median_step(clock: Array) -> float:
    """Return the median step of a clock; infinite for a single time."""
    return float(np.median(np.diff(clock))) if len(clock) > 1 else math.inf


def _rounding(t: Array) -> float:
    return 4 * float(np.spacing(np.abs(t).max()))


def indices_in(t: Array, clock: Array) -> Indices:
    """Return the indices of the times of `clock` in the `union` `t`."""
    if len(t) < 2:
        return np.zeros(len(clock), dtype=np.intp)
    after = np.clip(np.searchsorted(t, clock), 1, len(t) - 1)
    return np.asarray(after - (clock - t[after - 1] < t[after] - clock), dtype=np.intp)


def hold_input(t: Array, clock: Array, values: Array, *, first_order: bool) -> Array:
    """Return an input, known at `clock (n,)`, at times `t (T,)` by a first- or zero-order hold."""
    if first_order:
        return np.interp(t, clock, values)
    step = median_step(clock)
    slack = (SAME_TIME * step if step < math.inf else 0.0) + _rounding(clock)
    last = np.searchsorted(clock, t + slack, side="right") - 1
    return np.asarray(values[np.maximum(last, 0)], dtype=np.float64)


TAPS_PER_FACTOR = 20  # (length of the filter - 1) / factor
CUTOFF_SHARE = 0.8  # (frequency at which half the amplitude passes) / (new Nyquist frequency)
KAISER_BETA = 8.0  # gain 1 (to 1e-5) below 0.5, < 1e-4 above 1.2, times the new Nyquist frequency


@dataclass(frozen=True, slots=True)
class DecimatedSignals:
    """Decimated signals are `y (n, K)` at `samples (n,)`; `removed (K,)`: sds of removed parts."""

    y: Array
    samples: Indices
    removed: Array


def filter_length(factor: int) -> int:
    """Return the length of the filter in samples, an odd number."""
    return TAPS_PER_FACTOR * factor + 1


def cutoff(factor: int, dt: float) -> float:
    """Return the cutoff frequency [Hz], at which half of the amplitude passes."""
    return CUTOFF_SHARE / (2 * factor * dt)


def decimated(y: Array, factor: int) -> DecimatedSignals:
    """Filter `y (T, K)`, with equal steps and no NaN, by a Kaiser-window FIR, and decimate it.

    Samples within half the filter length of an end are dropped.
    """
    from scipy.signal import firwin, oaconvolve

    filter_ = firwin(filter_length(factor), CUTOFF_SHARE / factor, window=("kaiser", KAISER_BETA))
    smooth = oaconvolve(y, filter_[:, None], mode="valid", axes=0)
    first = filter_length(factor) // 2
    samples = np.arange(first, len(y) - first, factor)
    filtered = smooth[samples - first]
    return DecimatedSignals(filtered, samples, np.std(y[samples] - filtered, axis=0))
