"""Which rows of a file are used, and the even times at which its columns are looked at."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayesdrill.setup.guessing.columns import LEAST, Array, Seen
from bayesdrill.setup.guessing.timing import Timing, possible

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


def numbers(one: Seen, of: Part) -> Array:
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
