"""Steps between times that are not uniform, as few distinct ones as possible: nodes of kernels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Whole = NDArray[np.int64]

SAME = 1e-12  # of a step: steps nearer to each other are one
CLOCK = 4 * np.finfo(float).eps  # of the latest time: nor can its digits tell steps apart
FILLED = 1.5  # times the samples: so many knots make equal steps of those between samples left out
FEW, FEW_PER = 4, 100  # distinct steps that get an exponential each: 4, and one for 100 samples
CELLS, CELLS_PER = (24, 192), 12  # cells of all others, one for 12 samples between these ends
NARROWER = 1.25  # width by width
BELOW_ONE = 1.0 - 2.0**-53
FRESH = 10  # an exponential costs as much as so many products
LONG = 2.0  # usual steps: longer ones are taken in pieces where steps are in cells


@dataclass(frozen=True, slots=True)
class Grid:
    """Knots are the samples, and others within long steps.

    `t (T + 1,)` of knots from the first on, infinity at the end; `at (n,)`: the samples' knots.
    Step j is over `spans[node[j]]` and, where `share[j]` is not -1, that share of a `width` more.
    `chained (N,)`: 1 where a node's span is that of the one before and a width.  `inside (N,)`: 1
    where shares follow.  `usual`: the median step; `near`: times nearer to each other are one;
    `uniform`: one step between all knots.
    """

    t: Array
    at: Whole
    node: Whole
    share: Array
    spans: Array
    inside: Array
    chained: Whole
    width: float
    usual: float
    near: float
    uniform: bool


def grid(times: Array) -> Grid:
    """Of samples at increasing `times (n,)`."""
    t = times - times[0]
    if len(t) == 1:
        return _made(t, np.zeros(1, np.int64), np.zeros(0, np.int64), np.zeros(1), 1.0, 0.0)
    steps = np.diff(t)
    usual = float(np.median(steps))
    near = CLOCK * float(np.abs(times).max()) + SAME * usual
    if t[-1] < FILLED * len(t) * steps.min():
        at = np.concatenate([[0], np.cumsum(np.round(steps / steps.min()).astype(np.int64))])
        step = float(t[-1] / at[-1])
        if np.abs(t - step * at).max() <= near:
            filled = step * np.arange(at[-1] + 1)
            filled[at] = t
            return _made(filled, at, np.zeros(at[-1], np.int64), np.array([step]), usual, near)
    one, spans = _merged(steps, near)
    at = np.arange(len(t))
    if len(spans) <= min(FEW + len(t) // FEW_PER, CELLS[1]):
        return _made(t, at, one, spans, usual, near)
    t, at, pieces = _in_pieces(t, steps, usual)
    return _in_cells(t, at, pieces, usual, near)


def _merged(steps: Array, near: float) -> tuple[Whole, Array]:
    """The cluster of each step, and their means."""
    order = np.argsort(steps, kind="stable")
    edges = np.diff(steps[order]) > near
    cluster = np.concatenate([[0], np.cumsum(edges)])
    one = np.empty(len(steps), np.int64)
    one[order] = cluster
    return one, np.bincount(one, weights=steps) / np.bincount(one)


def _made(t: Array, at: Whole, node: Whole, spans: Array, usual: float, near: float) -> Grid:
    none = np.zeros(len(spans))
    return Grid(
        t=np.append(t, np.inf),
        at=at,
        node=np.append(node, 0),  # the last knot leads nowhere
        share=np.full(len(t), -1.0),
        spans=spans,
        inside=none,
        chained=none.astype(np.int64),
        width=0.0,
        usual=usual,
        near=near,
        uniform=len(t) > 1 and len(spans) == 1,
    )


def _in_pieces(t: Array, steps: Array, usual: float) -> tuple[Array, Whole, Whole]:
    """Knots within steps that are longer than `LONG` usual ones: pieces of 1, 2, 4, ... of these.

    With the samples' knots, and for each step its piece, 0 where it is none.
    """
    long = np.flatnonzero(steps > LONG * usual)
    counts = (steps[long] / usual).astype(np.int64) - 1
    sizes = [[1 << k for k in range(int(n).bit_length()) if n >> k & 1] for n in counts]
    inner = [t[j] + usual * np.cumsum(own) for j, own in zip(long, sizes, strict=True)]
    after = np.repeat(long + 1, [len(own) for own in sizes])
    knots = np.insert(t, after, np.concatenate([*inner, np.zeros(0)]))
    extra = np.zeros(len(t), np.int64)
    extra[long + 1] = [len(own) for own in sizes]
    at = np.arange(len(t)) + np.cumsum(extra)
    pieces = np.zeros(len(knots) - 1, np.int64)
    for j, own in zip(long, sizes, strict=True):
        pieces[at[j] : at[j] + len(own)] = own
    return knots, at, pieces


def _in_cells(t: Array, at: Whole, pieces: Whole, usual: float, near: float) -> Grid:
    """The narrowest cells of which not too many are met; pieces have nodes of their own."""
    steps, free = np.diff(t), pieces == 0
    most = int(np.clip(len(t) // CELLS_PER, *CELLS))
    width = float(steps[free].max())
    while _cost(_cells(steps[free], width / NARROWER)) <= most:
        width /= NARROWER
    cells, sizes = _cells(steps[free], width), np.unique(pieces[~free])
    share = np.full(len(t), -1.0)
    node = np.zeros(len(t), np.int64)
    inside = np.floor(steps[free] / width).astype(np.int64)
    node[:-1][free] = np.searchsorted(cells, inside)
    share[:-1][free] = np.clip(steps[free] / width - inside, 0.0, BELOW_ONE)
    node[:-1][~free] = len(cells) + np.searchsorted(sizes, pieces[~free])
    return Grid(
        t=np.append(t, np.inf),
        at=at,
        node=node,
        share=share,
        spans=np.concatenate([cells * width, sizes * usual]),
        inside=np.concatenate([np.ones(len(cells)), np.zeros(len(sizes))]),
        chained=np.concatenate([[0], np.diff(cells) == 1, np.zeros(len(sizes))]).astype(np.int64),
        width=width,
        usual=usual,
        near=near,
        uniform=False,
    )


def _cells(steps: Array, width: float) -> Whole:
    """Those met."""
    return np.unique(np.floor(steps / width).astype(np.int64))


def _cost(cells: Whole) -> int:
    """In products: the first of a row of neighbours wants an exponential."""
    return len(cells) + FRESH * int(np.sum(np.diff(cells) != 1))


def runs(g: Grid) -> tuple[Whole, Whole, Array]:
    """Steps that follow each other and have one node and no share: node, length and share of each."""
    first = np.ones(len(g.node), dtype=bool)
    first[1:] = (np.diff(g.node) != 0) | (g.share[1:] >= 0.0) | (g.share[:-1] >= 0.0)
    begin = np.flatnonzero(first)
    return g.node[begin], np.diff(np.append(begin, len(g.node))), g.share[begin]
