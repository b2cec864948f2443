"""The ridge of a maximum, found from the log density itself: no formula of any rig is in it.

At the maximum the curvature, in units of what the priors know, splits the unknowns into directions
that the record knows far better (tight) and the rest (loose).  Then points are sent out along the
loose directions, a little further each time, Gauss and Newton bring each back to the ridge, and
polynomials are fitted to where they arrive.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesdrill.samplers import ridge
from bayesdrill.samplers.ridge import Frame, Ridge
from bayesdrill.surface import Expansion, Surface

Array = NDArray[np.float64]
Expand = Callable[[Array, Array], Expansion]

TIGHT = 100.0  # a direction whose variance the record makes smaller than the prior's by as much
OUTWARD = (0.15, 0.3, 0.5, 0.75, 1.0)  # of the way from the maximum to where the ridge is wanted
DOUBT = 9.0  # what the record knows of the loose directions at the maximum need not hold elsewhere
EXTRAPOLATED = 2.0  # how far beyond its points a fit is trusted to guide the next ones
ITERATIONS = 6  # of Gauss and Newton, for each point
ARRIVED = 0.03  # of a standard deviation: a smaller step is the last
MOST_STEP = 0.5  # of the priors' spreads
MOST_DEGREE, MOST_ROOT_DEGREE = 6, 2
GOOD_ENOUGH = 0.05  # of a standard deviation, on points held out: no higher degree is tried
POINTS_PER_TERM = 2.5
LEAST_POINTS, MOST_POINTS = 24, 450
HELD_OUT = 4  # every fourth point
MARGIN = 0.9  # points are wanted a little beyond the prior's ends too


@dataclass(frozen=True, slots=True)
class Traced:
    """`ridge`, and how far held-out points of it are from its polynomial, in standard deviations.

    `psi (l,)`, `spread (l, l)`: mean and covariance root of the loose directions, to begin with.
    """

    ridge: Ridge
    off: float
    psi: Array
    spread: Array


def split(surface: Surface, centre: Array, curvature: Array) -> tuple[Frame, Array]:
    """The basis at the maximum `centre (D,)`, and the record's knowledge of its loose part `(l,)`."""
    scale = surface.spread
    values, vectors = np.linalg.eigh(curvature * np.outer(scale, scale))
    n_loose = int((values < TIGHT).sum())
    columns = scale[:, None] * vectors
    return ridge.frame(centre, columns, n_loose), np.maximum(values[:n_loose], 0.0)


def trace(
    surface: Surface, expand: Expand, centre: Array, rng: np.random.Generator
) -> Traced:
    """The ridge through the maximum `centre (D,)`; `expand` may share the points among processes."""
    here = expand(centre[None], np.eye(len(centre)))
    base, known = split(surface, centre, here.curvature[0])
    n_loose = len(known)
    # What the priors and the record say of psi, both taken as Gaussian.
    towards = base.split(surface.middle[None])[0][0]
    doubted = known / DOUBT
    psi, spread = towards / (1.0 + doubted), np.diag(1.0 / np.sqrt(1.0 + doubted))
    found = _arrive(expand, base, np.zeros((1, n_loose)), np.zeros((1, base.tight.shape[1])))
    at = ridge.fit(base, *found, 0, 0)
    if n_loose == 0 or base.tight.shape[1] == 0:
        return Traced(at, 0.0, psi, spread)
    gathered = [found]
    off = 0.0
    for share in OUTWARD:
        n = _wanted(n_loose, share)
        wanted = share * _scattered(surface, at, n, psi, spread, share, rng)
        gathered.append(_arrive(expand, base, wanted, at.at(wanted)))
        points = [np.concatenate(parts) for parts in zip(*gathered, strict=True)]
        at, off = _best_fit(base, *points, last=share == OUTWARD[-1])
        gathered = [tuple(points)]
    return Traced(at, off, psi, spread)


def _wanted(n_loose: int, share: float) -> int:
    """Points for a polynomial of degree 2 near by, and of degree 4 in the end."""
    degree = 2 if share < 0.4 else 3 if share < 1.0 else 4
    terms = math.comb(n_loose + degree, degree)
    return int(np.clip(POINTS_PER_TERM * terms, LEAST_POINTS, MOST_POINTS))


def _scattered(
    surface: Surface,
    at: Ridge,
    n: int,
    psi: Array,
    spread: Array,
    share: float,
    rng: np.random.Generator,
) -> Array:
    """Places `(n, l)` where the prior has a density, as far as the ridge is known by now.

    Those beyond its ends are drawn in towards the maximum until they are not.
    """
    wanted = psi + 1.2 * rng.standard_normal((4 * n, len(psi))) @ spread.T
    inwards = np.ones(len(wanted))
    for _ in range(12):
        seen = min(share, MARGIN) * inwards[:, None] * wanted
        outside = ~surface.inside(at.frame.join(seen, at.at(seen)))
        if not outside.any():
            break
        inwards[outside] *= 0.85
    whole = np.flatnonzero(inwards == 1.0)
    drawn = np.flatnonzero(inwards < 1.0)
    chosen = np.concatenate([whole[: (3 * n) // 4], drawn])[:n]
    if len(chosen) < n:
        chosen = np.concatenate([chosen, whole[(3 * n) // 4 :]])[:n]
    return np.asarray(inwards[chosen, None] * wanted[chosen])


def _arrive(expand: Expand, base: Frame, psi: Array, tau: Array) -> tuple[Array, Array, Array]:
    """`psi (N, l)`, `tau (N, t)` and covariance roots `(N, t, t)` of the points that arrived."""
    found, roots, arrived = led_back(expand, base, psi, tau)
    return psi[arrived], found[arrived], roots[arrived]


def led_back(
    expand: Expand, base: Frame, psi: Array, tau: Array
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """To the ridge at `psi (N, l)`: `tau (N, t)`, covariance roots `(N, t, t)`, whether arrived."""
    tau = tau.copy()
    n_tight = tau.shape[1]
    roots = np.zeros((len(psi), n_tight, n_tight))
    under_way = np.full(len(psi), n_tight > 0)
    arrived = ~under_way
    for _ in range(ITERATIONS):
        now = np.flatnonzero(under_way)
        if len(now) == 0:
            break
        here = expand(base.join(psi[now], tau[now]), base.tight)
        good = np.abs(here.slope).sum(axis=1) > 0
        under_way[now[~good]] = False  # the response overflows there
        now, slope, curvature = now[good], here.slope[good], here.curvature[good]
        roots[now] = covariance_roots(curvature)
        white = np.einsum("nij,ni->nj", roots[now], slope)
        step = np.einsum("nij,nj->ni", roots[now], white)
        longest = np.abs(step).max(axis=1, keepdims=True)
        tau[now] += step * np.minimum(1.0, MOST_STEP / np.maximum(longest, 1e-300))
        arrived[now] = np.linalg.norm(white, axis=1) < ARRIVED
        under_way[now] = ~arrived[now]
    return tau, roots, arrived


def covariance_roots(curvature: Array) -> Array:
    """Lower triangles R `(N, t, t)` with R R' the inverse of each curvature."""
    n = curvature.shape[1]
    scale = 1.0 / np.sqrt(np.maximum(np.einsum("nii->ni", curvature), 1e-300))
    scaled = curvature * scale[:, :, None] * scale[:, None, :] + 1e-12 * np.eye(n)
    # From the factor of the matrix turned round: its inverse is lower triangular again.
    turned = np.linalg.cholesky(scaled[:, ::-1, ::-1])[:, ::-1, ::-1]
    return np.asarray(scale[:, :, None] * np.linalg.inv(turned).swapaxes(1, 2))


def _best_fit(
    base: Frame, psi: Array, tau: Array, roots: Array, *, last: bool
) -> tuple[Ridge, float]:
    """The polynomials of the degree that points held out ask for, and how far off those are."""
    held = np.arange(len(psi)) % HELD_OUT == HELD_OUT - 1
    best, least = 1, np.inf
    for degree in range(1, MOST_DEGREE + 1):
        terms = math.comb(psi.shape[1] + degree, degree)
        if degree > 1 and terms > 0.7 * (~held).sum():
            break
        tried = ridge.fit(
            base, psi[~held], tau[~held], roots[~held], degree, MOST_ROOT_DEGREE if last else 0
        )
        off = float(np.quantile(ridge.residuals(tried, psi[held], tau[held], roots[held]), 0.9))
        if off < 0.8 * least:
            best, least = degree, off
        if off < GOOD_ENOUGH:
            break
    made = ridge.fit(base, psi, tau, roots, best, MOST_ROOT_DEGREE if last else 0)
    if not last:
        made = ridge.further(made, EXTRAPOLATED)
    return made, least
