"""Which column is the time and in which unit, which rows are used, and the even times columns are
looked at.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesdrill.basics import units
from bayesdrill.basics.arrays import Array
from bayesdrill.drafting.columns import LARGEST, LEAST, Seen
from bayesdrill.record.experiment import STEP_TOLERANCE

USUAL_RATE = 300.0  # Hz; rates of rigs lie around it, by their logarithm


@dataclass(frozen=True, slots=True, eq=False)
class Timing:
    """`t (T,)` in s; `column`: None where a rate has to do; `why` it is so, `doubt` what to look at."""

    t: Array
    column: Seen | None
    unit: str
    why: str
    doubt: str = ""

    @property
    def dt(self) -> float:
        return float(np.nanmedian(np.diff(self.t)))

    @property
    def rate(self) -> float:
        return 1 / self.dt


def find_time(columns: Sequence[Seen], rate: float = 0.0) -> Timing:
    """The time among the columns; else `rate` [Hz], or 100 to be reviewed."""
    named = [one for one in columns if one.says.kind == "time" and _steps(one.values)]
    if named:
        one = named[0]
        return _of(one, "by its name")
    even = [one for one in columns if not one.says.kind and _even(one.values)]
    if even:
        doubt = "no column is named as a time; this one grows in equal steps"
        return _of(even[0], "", doubt)
    length = len(columns[0].values)
    t = np.arange(length) / (rate or 100.0)
    if rate:
        return Timing(t, None, "s", "found from an angle and its speed", "found, not read")
    doubt = "no column is a time; 100 samples a second are a guess: write your own rate [Hz]"
    return Timing(t, None, "s", "", doubt)


def timing_of(one: Seen, like: Timing) -> Timing:
    """The same column of another file."""
    return dataclasses.replace(
        like, t=np.asarray(one.values * units.factor(like.unit, "s")), column=one
    )


def counted(length: int, like: Timing) -> Timing:
    """Of another file without times, as many samples a second."""
    return dataclasses.replace(like, t=np.asarray(np.arange(length) * like.dt, dtype=np.float64))


def _of(one: Seen, why: str, doubt: str = "") -> Timing:
    unit = one.says.unit
    step = float(np.nanmedian(np.diff(one.values)))
    if not unit:
        unit = min(("s", "ms", "us"), key=lambda u: _unusual(step * units.factor(u, "s")))
        said = f"no unit is said; steps of {step:.6g} {unit} make a usual sampling rate"
        doubt = f"{doubt}; {said}" if doubt else said
    return Timing(one.values * units.factor(unit, "s"), one, unit, why, doubt)


def _unusual(dt: float) -> float:
    return abs(math.log(1 / dt / USUAL_RATE))


def _steps(values: Array) -> bool:
    """Whether most of it increases; what breaks off is cut later."""
    steps = np.diff(values[np.isfinite(values)])
    return len(steps) > 0 and float(np.mean(possible(steps))) > 0.9


def possible(steps: Array) -> NDArray[np.bool_]:
    """Of a time, in any unit."""
    return np.asarray((steps > 1 / LARGEST) & (steps < LARGEST))


def _even(values: Array) -> bool:
    if not np.all(np.isfinite(values)):
        return False
    steps = np.diff(values)
    usual = np.asarray(np.median(steps))
    near = np.abs(steps - usual) <= max(STEP_TOLERANCE, 0.01) * usual
    return bool(possible(usual) and np.all(near))


LONG = 10.0  # usual steps: over a longer gap nothing is told
EVEN = 0.01  # of a step
SLACK = 1e-9  # of its times, by which a window is wider than it says


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """Used are `rows` with times `t (T,)` s; looked at is a `grid (n,)` s, even, without long gaps."""

    rows: slice
    t: Array
    grid: Array
    cut: bool

    @property
    def dt(self) -> float:
        return float(self.grid[1] - self.grid[0])


def part(time: Timing, used: Sequence[Seen]) -> Part | None:
    """The longest one in which times increase and no number of `used` is infinite; None: too short."""
    sound = np.isfinite(time.t)
    for one in used:
        sound &= ~np.isinf(one.values)
    steps = np.diff(time.t)
    rows = _alone(time.t, _longest(sound[1:] & sound[:-1] & possible(steps)))
    if rows.stop - rows.start < LEAST:
        return None
    t = time.t[rows]
    steps = np.diff(t)
    usual = float(np.median(steps))
    calm = t[_longest(steps <= LONG * usual)]
    even = np.all(np.abs(np.diff(calm) - usual) <= EVEN * usual)
    grid = calm if even else calm[0] + usual * np.arange(int((calm[-1] - calm[0]) / usual) + 1)
    return None if len(grid) < LEAST else Part(rows, t, grid, len(t) < len(time.t))


def numbers_of_part(one: Seen, of: Part) -> Array:
    """Those of its used rows that are numbers."""
    values = one.values[of.rows]
    return values[np.isfinite(values)]


def _alone(t: Array, rows: slice) -> slice:
    """Of `rows` the longest stretch among whose times no other row is: a window tells them apart."""
    own, others = t[rows], np.sort(np.delete(t, np.arange(len(t))[rows]))
    slack = SLACK * float(np.abs(own).max(initial=0.0))
    before, after = (
        np.searchsorted(others, own - slack),
        np.searchsorted(others, own + slack, "right"),
    )
    free = after == before  # NaN sorts to the end
    stretch = _longest(free[1:] & free[:-1] & (before[1:] == before[:-1]))
    return slice(rows.start + stretch.start, rows.start + stretch.stop)


def _longest(joined: np.ndarray) -> slice:
    """Of rows, each `joined (T - 1,)` to the next."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], joined, [False]]).astype(int)))
    if len(edges) == 0:
        return slice(0, 0)
    begins, ends = edges[::2], edges[1::2]
    best = int(np.argmax(ends - begins))
    return slice(int(begins[best]), int(ends[best]) + 1)
