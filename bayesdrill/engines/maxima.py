"""Different maxima of a density: found from many starts, told apart by walking between them.

Two points of one ridge are joined by it, however far apart they are; two maxima are not.  So one
walks from one to the other along the loose directions of the first, led back to the ridge by its
tight ones at each step, and looks where one arrives.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bayesdrill.engines.climb import climb
from bayesdrill.engines.learning import directions, ridges
from bayesdrill.inference.posterior import Posterior
from bayesdrill.inference.surface import PosteriorSurface, Surface

Array = NDArray[np.float64]

FIRST_STEPS = 8  # of all starts, and then ...
BEST_STARTS = 10  # ... as many of those spread over the prior go on, ...
AROUND = 128  # ... or of those that are likely to lead to other maxima, for ...
MORE_STEPS = 25  # ... as many steps
LOWER = 25.0  # of the log density: a maximum lower than the highest by more holds nothing
PATH = 10  # steps between two points
NEAR = 1e-3  # of the priors' spreads: the same point
CLOSE = 1e-4  # of the priors' spreads: points that are likely to end at the same maximum
SAME = 3.0  # standard deviations of the tight directions
VALLEY = 0.5  # of the log density: what is no deeper parts no maxima, but ripples of one
ALONG = 24  # places between two points, at which one looks for a valley
KNOWN = 1e-6  # of the log density: a point that is higher by less is no better than a known one


def scout(surface: Surface, starts: Array, most: int = BEST_STARTS) -> tuple[Array, Array]:
    """Where `starts (n, D)` lead: the `most` promising ones, `(m, D)`, and their log densities."""
    first = climb(surface, starts, FIRST_STEPS)
    order = np.argsort(-first.value, kind="stable")
    cells = np.rint((first.u[order] - surface.low) / (CLOSE * surface.spread))
    best = order[np.sort(np.unique(cells, axis=0, return_index=True)[1])][:most]
    found = climb(surface, first.u[best], MORE_STEPS)
    good = np.isfinite(found.value)
    return found.u[good], found.value[good]


def apart(surface: Surface, points: Array, values: Array, known: int = 0) -> list[int]:
    """Which of `points (n, D)` are maxima of their own, the highest first.

    The first `known` of them are so already, and stay what stands for their maximum.
    """
    rank = values + np.where(np.arange(len(values)) < known, KNOWN, 0.0)
    left = [int(k) for k in np.argsort(-rank, kind="stable")]
    left = [k for k in left if values[k] >= values[left[0]] - LOWER]
    chosen: list[int] = []
    while left:
        highest, *rest = left
        chosen.append(highest)
        fresh = [k for k in rest if k >= known]
        if not fresh:
            return [*chosen, *rest]
        others = points[fresh]
        same = (np.abs(others - points[highest]) < NEAR * surface.spread).all(axis=1)
        same[~same] = joined(surface, points[highest], others[~same])
        same[~same] = ~valleys(surface, points[highest], others[~same])
        dropped = {k for k, one in zip(fresh, same, strict=True) if one}
        left = [k for k in rest if k not in dropped]
    return chosen


def valleys(surface: Surface, start: Array, others: Array) -> NDArray[np.bool_]:
    """Whether the density falls by `VALLEY` on the straight ways from `start (D,)` to `others (n, D)`.

    It does not between corners of a plateau, nor where one maximum has ripples.
    """
    share = np.linspace(0.0, 1.0, ALONG + 2)[:, None, None]
    ways = start + share * (others - start)
    value = surface.value(ways.reshape(-1, len(start))).reshape(ways.shape[:2])
    lower = np.minimum(value[0], value[-1])
    return np.asarray((value.min(axis=0) < lower - VALLEY) | ~np.isfinite(lower))


def joined(surface: Surface, start: Array, others: Array) -> NDArray[np.bool_]:
    """Whether the ridge through `start (D,)` leads to each of `others (n, D)`: `(n,)`."""
    here = surface.expand(start[None], np.eye(len(start)))
    base, _ = directions.split(surface, start, here)
    psi, tau = base.split(others)
    if tau.shape[1] == 0:
        return np.ones(len(others), dtype=bool)
    at = np.zeros_like(tau)
    before = np.zeros_like(tau)
    arrived = np.zeros(len(others), dtype=bool)
    roots = np.zeros((len(others), tau.shape[1], tau.shape[1]))
    steps = PATH if psi.shape[1] else 1
    for k in range(1, steps + 1):
        ahead = 2.0 * at - before if k > 1 else at  # straight on from the last two
        found, roots, _, arrived = ridges.led_back(surface.expand, base, psi * (k / steps), ahead)
        before, at = at, found
    roots[~arrived] = np.eye(tau.shape[1])  # of no use, where there is no density
    off = np.linalg.solve(roots, (tau - at)[..., None])[..., 0]
    return np.asarray(arrived & (np.linalg.norm(off, axis=1) < SAME))


def held(posterior: Posterior, ends: Array) -> Array:
    """How much of the posterior each of the maxima `ends (M, D)` holds, by Laplace: `(M,)`, sum 1."""
    if len(ends) == 1:
        return np.ones(1)
    over = PosteriorSurface(posterior)
    here = over.expand(ends, np.eye(ends.shape[1]))
    scaled = here.curvature * np.outer(over.spread, over.spread) + np.eye(ends.shape[1])
    log_mass = here.value - 0.5 * np.linalg.slogdet(scaled)[1]
    log_mass = np.where(np.isfinite(log_mass), log_mass, -np.inf)
    mass = np.exp(log_mass - log_mass.max()) if np.isfinite(log_mass).any() else np.ones(len(ends))
    return np.asarray(mass / mass.sum())


def together(parts: Sequence[tuple[Array, Array]]) -> tuple[Array, Array]:
    """Points and values of several searches."""
    points, values = zip(*parts, strict=True)
    return np.concatenate(points), np.concatenate(values)
