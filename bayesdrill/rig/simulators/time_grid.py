"""Divide the times of a record into steps that are equal or have few distinct lengths.

Steps of too many distinct lengths are assigned to cells.  Cell k has the lengths from k to k + 1
times a width.  A step in this cell uses the exponential over k widths, then covers the rest of the step.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from bayesdrill.basics.arrays import Array

Whole = NDArray[np.int64]

STEP_TOLERANCE = 1e-12  # relative to the median step: smaller differences count as zero
# Relative to the latest time: smaller differences are hidden by the rounding of times.
CLOCK_ROUNDING = 4 * np.finfo(float).eps
# Largest ratio of knots to samples at which missing samples are filled in to make steps equal.
MAX_FILL_RATIO = 1.5
# Largest number of distinct steps with an exponential each: 4 + n_samples / 100.
MIN_DISTINCT_STEPS, SAMPLES_PER_STEP = 4, 100
# Largest `_cost` of `_cells`, in matrix products: n_samples / 12, within 24 to 64.
CELLS, SAMPLES_PER_CELL = (24, 64), 12
WIDTH_RATIO = 1.25  # ratio of successive cell widths in the search
BELOW_ONE = 1.0 - 2.0**-53
EXPONENTIAL_COST = 10  # cost of an exponential, in matrix products
LONG_STEP = 2.0  # in median steps: a grid with cells divides longer steps into pieces


@dataclass(frozen=True, slots=True)
class Grid:
    """The knots of a grid are the samples, and further knots within long steps.

    `t (T + 1,)` are the times since the first knot, then infinity; `samples (n,)` are the indices of
    samples among knots. Step j has the length `spans[node[j]]`, plus `excess[j] * width` unless
    `excess[j]` is -1. `is_chained[k]` is 1 if `spans[k]` is `spans[k - 1] + width`. Times that differ by
    less than `tolerance` are equal. `uniform` says that all steps are equal.
    """

    t: Array
    samples: Whole
    node: Whole
    excess: Array
    spans: Array
    is_chained: Whole
    width: float
    median_step: float
    tolerance: float
    uniform: bool


def build_grid(times: Array) -> Grid:
    """Build the grid of samples at increasing `times (n,)`, in s."""
    t = times - times[0]
    if len(t) == 1:
        return _grid(t, np.zeros(1, np.int64), np.zeros(0, np.int64), np.ones(1), 1.0, 0.0)
    steps = np.diff(t)
    median = float(np.median(steps))
    tolerance = CLOCK_ROUNDING * float(np.abs(times).max()) + STEP_TOLERANCE * median
    if t[-1] < MAX_FILL_RATIO * len(t) * steps.min():
        at = np.concatenate([[0], np.cumsum(np.round(steps / steps.min()).astype(np.int64))])
        step = float(t[-1] / at[-1])
        if np.abs(t - step * at).max() <= tolerance:
            filled = step * np.arange(at[-1] + 1)
            filled[at] = t
            return _grid(
                filled, at, np.zeros(at[-1], np.int64), np.array([step]), median, tolerance
            )
    cluster, spans = _merged(steps, tolerance)
    at = np.arange(len(t))
    if len(spans) <= min(MIN_DISTINCT_STEPS + len(t) // SAMPLES_PER_STEP, CELLS[1]):
        return _grid(t, at, cluster, spans, median, tolerance)
    t, at, pieces = _in_pieces(t, steps, median)
    return _in_cells(t, at, pieces, median, tolerance)


def _merged(steps: Array, tolerance: float) -> tuple[Whole, Array]:
    """Return the index of each step's cluster of nearly equal steps, and the clusters' means."""
    order = np.argsort(steps, kind="stable")
    edges = np.diff(steps[order]) > tolerance
    cluster = np.concatenate([[0], np.cumsum(edges)])
    cluster_of_step = np.empty(len(steps), np.int64)
    cluster_of_step[order] = cluster
    sizes = np.bincount(cluster_of_step)
    return cluster_of_step, np.bincount(cluster_of_step, weights=steps) / sizes


def _grid(t: Array, at: Whole, node: Whole, spans: Array, median: float, tolerance: float) -> Grid:
    """Return a grid whose step j has the length `spans[node[j]]`; no step follows the last knot."""
    uniform = len(t) > 1 and len(spans) == 1
    return Grid(
        t=np.append(t, np.inf), samples=at, node=np.append(node, 0), excess=np.full(len(t), -1.0),
        spans=spans, is_chained=np.zeros(len(spans), np.int64), width=0.0, median_step=median,
        tolerance=tolerance, uniform=uniform,
    )  # fmt: skip


def _in_pieces(t: Array, steps: Array, median: float) -> tuple[Array, Whole, Whole]:
    """Divide steps longer than `LONG_STEP` median steps into pieces of 1, 2, 4, ... median steps.

    Returns the knots, the indices of samples among them, and each piece's number of median steps. This
    number is 0 for other steps, and for the remainder of a long step.
    """
    long = np.flatnonzero(steps > LONG_STEP * median)
    counts = (steps[long] / median).astype(np.int64) - 1
    sizes = [[1 << k for k in range(int(n).bit_length()) if n >> k & 1] for n in counts]
    inner = [
        t[j] + median * np.cumsum(step_sizes) for j, step_sizes in zip(long, sizes, strict=True)
    ]
    after = np.repeat(long + 1, [len(step_sizes) for step_sizes in sizes])
    knots = np.insert(t, after, np.concatenate([*inner, np.zeros(0)]))
    extra = np.zeros(len(t), np.int64)
    extra[long + 1] = [len(step_sizes) for step_sizes in sizes]
    at = np.arange(len(t)) + np.cumsum(extra)
    pieces = np.zeros(len(knots) - 1, np.int64)
    for j, step_sizes in zip(long, sizes, strict=True):
        pieces[at[j] : at[j] + len(step_sizes)] = step_sizes
    return knots, at, pieces


def _in_cells(t: Array, at: Whole, pieces: Whole, median: float, tolerance: float) -> Grid:
    """Return the grid with the narrowest cells of acceptable cost; `spans` ends with the pieces."""
    steps, free = np.diff(t), pieces == 0
    most = int(np.clip(len(t) // SAMPLES_PER_CELL, *CELLS))
    width = float(steps[free].max())
    while _cost(_cells(steps[free], width / WIDTH_RATIO)) <= most:
        width /= WIDTH_RATIO
    cells, sizes = _cells(steps[free], width), np.unique(pieces[~free])
    excess, node = np.full(len(t), -1.0), np.zeros(len(steps), np.int64)
    inside = np.floor(steps[free] / width).astype(np.int64)
    node[free] = np.searchsorted(cells, inside)
    excess[:-1][free] = np.clip(steps[free] / width - inside, 0.0, BELOW_ONE)
    node[~free] = len(cells) + np.searchsorted(sizes, pieces[~free])
    none = np.zeros(len(sizes))
    return replace(
        _grid(t, at, node, np.concatenate([cells * width, sizes * median]), median, tolerance),
        excess=excess, width=width, uniform=False,
        is_chained=np.concatenate([[0], np.diff(cells) == 1, none]).astype(np.int64),
    )  # fmt: skip


def _cells(steps: Array, width: float) -> Whole:
    """Return the indices k of the cells that contain steps, in increasing order."""
    return np.unique(np.floor(steps / width).astype(np.int64))


def _cost(cells: Whole) -> int:
    """Return the cost of cells in matrix products: a cell after a gap needs an exponential."""
    return len(cells) + EXPONENTIAL_COST * int(np.sum(np.diff(cells) != 1))


def inputs_at_knots(
    g: Grid, series: Mapping[str, Array], *, first_order: bool
) -> tuple[Array, Array]:
    """Return sampled inputs `(T, S)` at all knots, and their time slopes in the steps that follow."""
    inputs = np.array([*series.values()]).reshape(len(series), len(g.samples)).T
    n_knots = len(g.t) - 1
    before = np.searchsorted(g.samples, np.arange(n_knots), side="right") - 1
    since = (g.t[:-1] - g.t[g.samples][before])[:, None]
    slopes = np.zeros_like(inputs)
    if first_order:
        slopes[:-1] = np.diff(inputs, axis=0) / np.diff(g.t[g.samples])[:, None]
    slopes = slopes[before]
    return inputs[before] + slopes * since, slopes


NODE_TOLERANCE = 1e-9  # in steps: a lag this close to a whole number of steps is that number


class UniformGrid:
    """The grid points (nodes) begin at the first of `t (T,)`, and are `span` apart: a step / `pieces`.

    The step is that of uniform times, or else the median. Inputs `series`, each `(T,)`, are interpolated
    between samples (`first_order`) or held. For each step, an interpolated input has its value at the
    beginning and a slope, a held input its mean.
    """

    def __init__(
        self,
        t: Array,
        series: Mapping[str, Array],
        first_order: bool,
        pieces: int,
        *,
        every_node: bool = False,
    ) -> None:
        """Build the nodes; `every_node` puts a sample at each node, whatever the times `t`."""
        self._t, self._first_order = t, first_order
        self._series = [np.asarray(u, dtype=float) for u in series.values()]
        g = build_grid(t)
        self.aligned = g.uniform or len(t) == 1
        whole = float(g.spans[0]) if g.uniform else g.median_step
        self.span = whole / pieces
        if self.aligned:
            at = g.samples * pieces
            self.counts: Whole = np.append(np.diff(at), 1).astype(np.int64)
            self.nodes = int(at[-1]) + 1
            self.places: Array = at.astype(float)
        else:
            self.counts = np.zeros(len(t), np.int64)
            self.places = (t - t[0]) / self.span
            self.nodes = int(np.ceil(self.places[-1])) + 1
        self.samples = len(t)
        if every_node:
            self.aligned, self.nodes = True, self.nodes + 1
            self.samples = self.nodes
            self.counts = np.ones(self.nodes, np.int64)
            self.places = np.arange(self.samples, dtype=float)
        self.spans = np.array([self.span, whole])
        self._substeps = pieces

    @cached_property
    def usual(self) -> Whole:
        """Return 1 for samples `pieces` steps before the next, else 0; 0 for all if `pieces` is 1."""
        return np.asarray((self.counts == self._substeps) & (self.counts > 1)).astype(np.int64)

    def locate(self, t: Array) -> tuple[Whole, Array]:
        """Return the node before each time, and the fraction of a step from this node to the time."""
        places = (t - self._t[0]) / self.span
        rounded = np.round(places)
        places = np.where(np.abs(places - rounded) < 1e-6, rounded, places)
        last = np.clip(np.floor(places), 0, self.nodes - 1).astype(np.int64)
        return last, places - last

    def steps_after(self, shift: Array) -> int:
        """Return the number of steps after the last sample that channels with a `shift (W, K)` need."""
        ahead = -np.nanmin(shift, initial=0.0)
        return int(np.ceil(ahead / self.span)) + 1 if np.isfinite(ahead) else 1

    def margin(self, lag: Array) -> int:
        """Return the number of steps outside the record that inputs with `lag (W, S)` need."""
        if not lag.size:
            return 0
        return int(np.ceil(np.nanmax(np.abs(lag), initial=0.0) / self.span)) + 2

    def delays(self, lags: Sequence[Array]) -> tuple[Array, ...]:
        """Return lags in whole steps, the remaining fractions of a step, and derivatives in steps.

        `lags` has the lags and, if there are any, their derivatives.
        """
        ratio = lags[0] / self.span
        whole = np.floor(ratio + NODE_TOLERANCE)
        fractions = [np.clip(ratio - whole, 0.0, None), *(lag / self.span for lag in lags[1:])]
        return (np.nan_to_num(whole), *fractions)

    def inputs(self, margin: int, after: int) -> Array:
        """Return inputs over steps, `(N + 1 + after, S)` or, with time slopes, `(N + 1 + after, 2 S)`.

        In memory, `margin` further rows lie before and after. Outside the record, inputs are constant.
        """
        # Round the sizes up to powers of two, so that only a few results have to be kept.
        margin, after = (1 << n.bit_length() if n else 0 for n in (margin, after))
        if (margin, after) not in self._kept:
            at = np.arange(1 - margin, len(self._rows) - 1 + after + margin)
            known = np.ascontiguousarray(self._rows[np.clip(at, 0, len(self._rows) - 1)])
            self._kept[margin, after] = known[margin:]
        return self._kept[margin, after]

    @cached_property
    def _kept(self) -> dict[tuple[int, int], Array]:
        return {}

    @cached_property
    def _rows(self) -> Array:
        """Return inputs and time slopes in rows: before the record, in each step, after the record."""
        still = [0.0] * self._slopes
        first, last = ([u[end] for u in self._series] + still for end in (0, -1))
        return np.concatenate([[first], self._over_steps(), [last]])

    def _over_steps(self) -> Array:
        t, nodes = self._t - self._t[0], np.asarray(np.arange(self.nodes + 2) * self.span)
        if not self._series:
            return np.zeros((len(nodes) - 1, 0))
        if self._first_order:
            at = np.array([np.interp(nodes, t, u) for u in self._series]).T
            return np.concatenate([at[:-1], np.diff(at, axis=0) / self.span], axis=1)
        if self.aligned:
            sample = np.searchsorted(t, nodes[:-1] + 0.5 * self.span, side="right") - 1
            return np.array([u[sample] for u in self._series]).T
        return np.array([_means(nodes, t, u) for u in self._series]).T

    @property
    def _slopes(self) -> int:
        return len(self._series) if self._first_order else 0


def _means(nodes: Array, t: Array, inputs: Array) -> Array:
    """Return the means over steps of inputs that are held from sample to sample."""
    whole = np.concatenate([[0.0], np.cumsum(inputs[:-1] * np.diff(t))])
    beyond = np.clip(nodes - t[-1], 0.0, None) * inputs[-1]
    return np.asarray(np.diff(np.interp(nodes, t, whole) + beyond) / np.diff(nodes))
