"""The posterior on a grid: where its modes are, and what each holds.

No search and no chain: cells over all of the prior, halved wherever they may hold something, until the
masses no longer change.  A mode is a basin: two of them are one where the density between them falls by
less than `DEPTH`, as walkers pass there.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from bayesdrill.inference.posterior import Posterior

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

TAIL = 1e-7  # of a prior without an end, which the grid leaves out on either side
BATCH = 4096
CUT = 16.0  # below the highest: e^-16 of its density holds nothing
DEPTH = 3.0  # of the log density, between two modes and below the lower
STABLE = (
    2e-3  # relative change of masses, when all cells are halved, at which the grid is fine enough
)
LIGHT = 5e-3  # a mode that holds less need not be stable
MOST = 4_000_000  # cells
LEVELS = 24


@dataclass(frozen=True, slots=True, kw_only=True)
class Modes:
    """`tops (M, D)`: physical, where each mode is highest, and `masses (M,)`, the largest first.

    `index (N, D)` of the cells that hold all of it, whole numbers of `steps (D,)` from `low (D,)` in the
    coordinates of the sampler, and their `labels (N,)`.  `log_z`: the log of what all of it holds.
    """

    tops: Array
    masses: Array
    index: Ints
    labels: Ints
    low: Array
    steps: Array
    evaluations: int
    log_z: float

    def above(self, share: float) -> Ints:
        return np.flatnonzero(self.masses > share)

    def shares(self, z: Array) -> Array:
        """Of points `z (n, D)`, coordinates of the sampler, in each mode: `(M,)`."""
        _, near = cKDTree(self.index).query((z - self.low) / self.steps - 0.5)
        return np.bincount(self.labels[near], minlength=len(self.masses)) / len(z)


def modes(
    posterior: Posterior, cells: tuple[int, ...], split: tuple[str, float] | None = None
) -> Modes:
    """`cells`: of the coarsest grid; `split`: an unknown and a number that parts modes in two."""
    low, high = ends(posterior)
    count = np.array(cells)
    axes = [np.arange(n) for n in cells]
    index = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(cells))
    steps = (high - low) / count
    f = _density(posterior, low + steps * (index + 0.5))
    evaluations, reach = len(f), _reach(f.reshape(cells)).ravel()
    corners = np.array(list(itertools.product((0, 1), repeat=len(cells))))
    before: Array | None = None
    for _ in range(LEVELS):
        kept = f + reach > f.max() - CUT
        index, above = index[kept], f[kept]
        if len(index) * len(corners) > MOST:
            raise ValueError(
                f"a grid of more than {MOST} cells; give fewer unknowns, or more noise"
            )
        index = (2 * index[:, None] + corners).reshape(-1, len(cells))
        steps = steps / 2
        f = _density(posterior, low + steps * (index + 0.5))
        evaluations += len(f)
        change = np.abs(f.reshape(len(above), -1) - above[:, None])
        steepest = 2.0 * np.where(np.isfinite(change), change, np.inf).max(axis=1)
        reach = np.where(np.isfinite(f), np.repeat(steepest, len(corners)), 0.0)
        resolved = np.max(reach[f > f.max() - 2.0], initial=0.0) < 4.0
        if not resolved:
            continue
        held = f > f.max() - CUT
        found = _parted(posterior, index[held], f[held], low, steps, split, evaluations)
        if before is not None and len(before) == len(found.masses[found.masses > LIGHT]):
            now = found.masses[: len(before)]
            if np.all(np.abs(now / before - 1.0) < STABLE):
                return found
        before = found.masses[found.masses > LIGHT]
    raise ValueError("the masses do not settle")


def ends(posterior: Posterior) -> tuple[Array, Array]:
    """Of the grid `(D,)`, coordinates of the sampler."""
    space, to = posterior.space, posterior.coordinates.from_physical
    tails = np.array([p.quantile(np.array([TAIL, 1.0 - TAIL])) for p in space.priors.values()]).T
    whole = np.array([[p.low, p.high] for p in space.priors.values()]).T
    low, high = (
        np.where(np.isfinite(to(w[None])), to(w[None]), to(t[None]))[0]
        for w, t in zip(whole, tails, strict=True)
    )
    return low, high


def _density(posterior: Posterior, z: Array) -> Array:
    parts = [posterior(z[k : k + BATCH]) for k in range(0, len(z), BATCH)]
    return np.concatenate(parts)


def _reach(f: Array) -> Array:
    """How much higher it may be within each cell of a whole grid, by its neighbours."""
    out = np.zeros_like(f)
    for axis in range(f.ndim):
        with np.errstate(invalid="ignore"):
            change = np.nan_to_num(np.abs(np.diff(f, axis=axis)), nan=0.0, posinf=np.inf)
        for end in (0, 1):
            pads = [(0, 0)] * f.ndim
            pads[axis] = (end, 1 - end)
            out = np.maximum(out, np.pad(change, pads))
    return np.where(np.isfinite(f), 2.0 * out, 0.0)


def _parted(
    posterior: Posterior, index: Ints, f: Array, low: Array, steps: Array,
    split: tuple[str, float] | None, evaluations: int,
) -> Modes:  # fmt: skip
    labels = basins(index, f)
    theta = posterior.coordinates.to_physical(low + steps * (index + 0.5))
    if split is not None:
        name, at = split
        labels = 2 * labels + (theta[:, posterior.space.free.index(name)] > at)
    _, labels = np.unique(labels, return_inverse=True)
    weights = np.exp(f - f.max())
    masses = np.bincount(labels, weights) / weights.sum()
    order = np.argsort(-masses, kind="stable")
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    labels = rank[labels]
    highest = [np.flatnonzero(labels == m)[np.argmax(f[labels == m])] for m in range(len(order))]
    return Modes(
        tops=theta[highest], masses=masses[order], index=index, labels=labels, low=low, steps=steps,
        evaluations=evaluations, log_z=float(np.log(weights.sum()) + f.max() + np.log(steps).sum()),
    )  # fmt: skip


def basins(index: Ints, f: Array) -> Ints:
    """Which basin each of the cells `index (N, D)` belongs to, by their heights `f (N,)`: `(N,)`.

    From the highest down: a cell joins the neighbour that was there before it, and where it has two of
    different basins, these are one unless both rise by `DEPTH` above it.
    """
    order = np.argsort(-f, kind="stable")
    index = index[order] - index.min(axis=0) + 1
    shape = index.max(axis=0) + 2
    keys = np.ravel_multi_index(tuple(index.T), tuple(shape))
    sort = np.argsort(keys)
    ways = np.array([w for w in itertools.product((-1, 0, 1), repeat=index.shape[1]) if any(w)])
    around = keys[:, None] + np.array(
        [np.ravel_multi_index(tuple(w + 1), tuple(shape)) for w in ways]
    )
    around -= np.ravel_multi_index((1,) * len(shape), tuple(shape))
    at = np.minimum(np.searchsorted(keys, around, sorter=sort), len(keys) - 1)
    neighbours = np.where(keys[sort[at]] == around, sort[at], len(keys))
    heights, parent = f[order], list(range(len(keys)))

    def root(k: int) -> int:
        while parent[k] != k:
            parent[k] = parent[parent[k]]
            k = parent[k]
        return k

    for k, near in enumerate(neighbours.tolist()):
        roots = sorted({root(n) for n in near if n < k})
        for other in roots[1:] if roots else ():
            if heights[other] - heights[k] < DEPTH:
                parent[other] = roots[0]
        if roots:
            parent[k] = roots[0]
    out = np.empty(len(keys), dtype=np.int64)
    out[order] = [root(k) for k in range(len(keys))]
    return out
