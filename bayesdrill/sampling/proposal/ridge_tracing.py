"""Trace the ridge through a maximum of a log density, without knowledge of the rig.

The curvature at the maximum, in units of the priors' precision, splits the unknowns into tight
directions, which the record determines far better than the priors do, and loose directions.  In
stages of growing length, points are placed along the loose directions.  Gauss-Newton moves each of
these points back to the ridge.  Polynomials are then fitted to the points on the ridge.

A Newton ridge moves every point from the polynomials to the exact ridge by Gauss-Newton.  Each draw
then costs about a hundred evaluations, so only the check for missed mass uses a Newton ridge.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields

import numpy as np

from bayesdrill.basics.arrays import Array, Flags, Indices
from bayesdrill.inference.laplace import LogDensity, QuadraticModel
from bayesdrill.sampling.samplers import ridge
from bayesdrill.sampling.samplers.ridge import LocalBasis, RidgeMap

Expand = Callable[[Array, Array], QuadraticModel]

# A direction is tight if the ratio of its precision to the prior's is at least `TIGHT_RATIO`, and
# at least `STRAIGHT_RATIO` times the square root of the largest ratio. A direction that fails only the
# second condition is loose, because along it the tightest direction would bend too much.
TIGHT_RATIO, STRAIGHT_RATIO = 100.0, 0.003
NEAR_END = 1e-6  # an unknown this near to an end of its prior, in prior spreads, is at the end
MIN_NEW_SHARE = 1e-6  # an axis is new if its part orthogonal to other axes is longer than this
MAX_SDS_BEYOND_END = 0.5  # standard deviations that a maximum may lie beyond an end of a prior
PROBES = 12  # number of random prior points at which a flat direction must be flat
NEGLIGIBLE_CURVATURE = 1e-12  # curvature / largest curvature; a smaller ratio is a rounding error
KNOWLEDGE_DISCOUNT = 9.0  # divisor of loose directions' precisions: far away they may be lower
BEYOND_ENDS = 0.1  # points are used up to this distance beyond the priors, in ranges of the priors
SCATTER_WIDTH = 1.4  # ratio of the width of the points to the expected width of the posterior
TRUSTED_EXTRAPOLATION = 2.0  # the next stage uses the fit up to this multiple of its points' radius
MAX_CORNER_GROWTH = 2.0  # limit of a coordinate's highest power, which is <= 1 at fitted points
ITERATIONS = 6  # largest number of Gauss-Newton steps for each point
CONVERGED_SDS = 0.03  # in standard deviations: Gauss-Newton ends after a shorter step
MAX_STEP = 0.5  # longest step, in priors' spreads
MAX_SDS = 1e100  # standard deviations from the ridge; a larger number comes from overflow
MAX_DEGREE = 14  # highest degree of the polynomials
ERROR_QUANTILE = 0.98  # quantile of the errors at held-out points, by which degrees are compared
MIN_IMPROVEMENT = 0.8  # a higher degree is preferred if its error / the least error is below this
GOOD_ERROR = 0.1  # in standard deviations: below this error, no higher degree is tried
FAIR_ERROR = 0.3  # in standard deviations: above this error, points are added
POINTS_PER_TERM = 2.5  # number of points for each term of a polynomial
MAX_DEPTH = 100.0  # a point this far below the highest log density is not on the ridge
HELD_OUT_EVERY = 4  # every fourth point is held out of the fit
PRIOR_MARGIN = 0.9  # the ridge must be within the priors at this fraction of the way to a point
NEAR_SDS = 0.5  # in standard deviations: after a shorter step, a point is on the Newton ridge
NEWTON_ITERATIONS = 9  # largest number of steps to a Newton ridge, twice what bad polynomials need


def split_directions(
    surface: LogDensity, centre: Array, here: QuadraticModel, still: Array | None = None
) -> tuple[LocalBasis, Array]:
    """Return the basis at the maximum `centre (D,)`, and the precision of its loose part `(l,)`.

    `here` is the quadratic model at `centre`.  Flat directions `still (D, f)` come first in the
    basis.  An unknown pressed against an end of its prior becomes a loose direction of its own.  As
    part of a tight direction, it would move the quadratic model's maximum out of the prior.
    """
    scale = surface.spread
    slope, curvature = here.slope[0] * scale, here.curvature[0] * np.outer(scale, scale)
    separate = np.zeros((len(centre), 0)) if still is None else still
    values, vectors = _directions(curvature, separate)
    tight_from = max(TIGHT_RATIO, STRAIGHT_RATIO * float(np.sqrt(max(values[-1], 0.0))))
    tight = values >= tight_from
    known = np.zeros(separate.shape[1])
    sds_beyond = np.linalg.norm((slope @ vectors[:, tight]) / np.sqrt(values[tight]))
    if sds_beyond > MAX_SDS_BEYOND_END:
        margin = NEAR_END * scale
        pressed = (centre <= surface.low + margin) & (slope < 0)
        pressed |= (centre >= surface.high - margin) & (slope > 0)
        separate, separate_unknowns = _orthogonal(separate, np.flatnonzero(pressed))
        knowledge = np.diag(curvature) + slope**2
        known = np.concatenate([known, knowledge[separate_unknowns]])
        values, vectors = _directions(curvature, separate)
    n_loose = int((values < tight_from).sum())
    columns = scale[:, None] * np.concatenate([separate, vectors], axis=1)
    base = ridge.local_basis(centre, columns, len(known) + n_loose)
    return base, np.concatenate([known, np.maximum(values[:n_loose], 0.0)])


def _orthogonal(separate: Array, unknowns: Indices) -> tuple[Array, list[int]]:
    """Append orthonormal axes of `unknowns` to `separate (D, n)`; also return appended unknowns."""
    added: list[int] = []
    for d in map(int, unknowns):
        axis = np.eye(len(separate))[d] - separate @ separate[d]
        if (length := float(np.linalg.norm(axis))) > MIN_NEW_SHARE:
            separate, added = np.column_stack([separate, axis / length]), [*added, d]
    return separate, added


def _directions(curvature: Array, without: Array) -> tuple[Array, Array]:
    """Return ascending eigenvalues, and eigenvectors `(D, n)` orthogonal to columns `without`."""
    whole = np.linalg.qr(without, mode="complete")[0]
    complement = whole[:, without.shape[1] :]
    values, vectors = np.linalg.eigh(complement.T @ curvature @ complement)
    return values, complement @ vectors


def flat_directions(surface: LogDensity, rng: np.random.Generator) -> Array:
    """Return directions `(D, f)`, in priors' spreads, along which the likelihood never changes.

    A direction may be flat at one point by chance, so points all over the prior are examined.
    """
    d = len(surface.middle)
    scattered = surface.middle + surface.spread * rng.standard_normal((PROBES, d))
    here = surface.quadratic_model(np.clip(scattered, surface.low, surface.high), np.eye(d))
    whitened = here.curvature * np.outer(surface.spread, surface.spread)
    largest = np.linalg.eigvalsh(whitened)[:, -1]
    informed = largest > 0
    if not informed.any():
        return np.zeros((d, 0))
    mean_curvature = (whitened[informed] / largest[informed, None, None]).mean(axis=0)
    values, vectors = np.linalg.eigh(mean_curvature)
    return np.asarray(vectors[:, values < NEGLIGIBLE_CURVATURE])


# The size of a box is divided by ten up to `MAX_SHRINKINGS` times; each size is tested by draws.
MAX_SHRINKINGS, SHRINKING_DRAWS = 14, 200
STAGES = (0.15, 0.3, 0.5, 0.75, 1.0)  # lengths of the traced part, as fractions of the whole ridge
# Smallest number of points in a stage and in the last stage, and largest number of points in all.
MIN_POINTS, LAST_POINTS, MAX_POINTS = 40, 300, 1600
MAX_HALVINGS = 4  # number of tried lengths of a ridge, each half of the previous one
USELESS_ERROR = 5.0  # error in standard deviations, above which a shorter length is tried


@dataclass(frozen=True, slots=True)
class TracedRidge:
    """A traced ridge has an `error` at held-out points, in standard deviations.

    `psi (l,)` and `psi_root (l, l)` are the initial mean and covariance root of the loose directions.
    """

    ridge: RidgeMap
    error: float
    psi: Array
    psi_root: Array


def trace(
    surface: LogDensity,
    centre: Array,
    rng: np.random.Generator,
    weighted_draws: tuple[Array, Array] | None = None,
) -> TracedRidge:
    """Trace the ridge through the maximum `centre (D,)`.

    If there are `weighted_draws`, draws of the posterior `(N, D)` and their weights `(N,)`, the
    ridge is followed as far as these draws reach.  Otherwise priors and the curvature at the
    maximum determine the length of the ridge.
    """
    here = surface.quadratic_model(centre[None], np.eye(len(centre)))
    still = flat_directions(surface, rng)
    base, known = split_directions(surface, centre, here, still)
    if len(known) == len(centre) and (known > TIGHT_RATIO).any():
        # If unknowns at ends leave no tight direction, each unknown becomes a loose direction.
        scale = surface.spread
        base = ridge.local_basis(centre, np.diag(scale), len(centre))
        known = np.diag(here.curvature[0]) * scale**2 + (here.slope[0] * scale) ** 2
    if weighted_draws is None:
        cloud = None
        psi, spread = _expected(surface, base, known)
    else:
        drawn, weights = base.split(weighted_draws[0])[0], weighted_draws[1]
        psi, spread = moments(drawn, weights)
        # Square roots of the weights put more points into the tails.
        p = np.sqrt(weights) / np.sqrt(weights).sum()
        cloud = drawn[rng.choice(len(drawn), size=len(drawn), p=p)]

    def scattered_psi(n: int) -> Array:
        """Draw psi `(n, l)` from a widened cloud of draws or, without draws, a normal distribution."""
        if cloud is None:
            return psi + SCATTER_WIDTH * rng.standard_normal((n, len(psi))) @ spread.T
        return psi + SCATTER_WIDTH * (cloud[rng.integers(len(cloud), size=n)] - psi)

    at_maximum = _ridge_at_maximum(base, here)
    if len(known) == 0 or base.tight.shape[1] == 0:
        return TracedRidge(at_maximum, 0.0, psi, spread)
    bent = np.arange(still.shape[1], len(known))
    for halvings in range(MAX_HALVINGS):
        length = 0.5**halvings  # a short piece of the ridge is better than none
        followed, error = _follow(surface, at_maximum, bent, scattered_psi, length)
        if error < USELESS_ERROR:
            break
    return TracedRidge(followed, error, length * psi, length * spread)


def _expected(surface: LogDensity, base: LocalBasis, known: Array) -> tuple[Array, Array]:
    """Return mean `(l,)` and covariance root `(l, l)` of psi for Gaussian prior and likelihood."""
    precision = known / KNOWLEDGE_DISCOUNT
    towards = base.split(surface.middle[None])[0][0]
    psi, sd = towards / (1.0 + precision), 1.0 / np.sqrt(1.0 + precision)
    # An unknown that is pressed against an end of its prior can only move inwards.
    return psi + np.where(known > TIGHT_RATIO, np.sign(towards) * sd, 0.0), np.diag(sd)


def _follow(
    surface: LogDensity,
    fitted: RidgeMap,
    bent: Indices,
    scattered_psi: Callable[[int], Array],
    length: float,
) -> tuple[RidgeMap, float]:
    """Follow a ridge outwards from the maximum in stages, each guided by the previous fit.

    The last stage uses the points of `scattered_psi` times `length`.  Returns the ridge, and its
    error at held-out points in standard deviations.
    """
    base = fitted.frame
    points: list[Array] = []
    error = 0.0
    for stage in STAGES:
        # There are enough points for degree 2 in the first stages, then 3, and 4 in the last one.
        degree = 2 if stage < 0.4 else 3 if stage < 1.0 else 4
        least = MIN_POINTS if stage < 1.0 else LAST_POINTS
        n = int(np.clip(POINTS_PER_TERM * _terms(len(bent), degree), least, MAX_POINTS))
        psi = stage * _within_priors(surface, fitted, length * scattered_psi(4 * n), stage)
        points = _arrivals(surface, fitted, psi, points)
        if len(points[0]) > 2 * (fitted.n_loose + 1):
            fitted, error = _best_fit(base, bent, *points[:3], last=stage == STAGES[-1])
    while error > FAIR_ERROR and 2 * len(points[0]) < MAX_POINTS:
        psi = _within_priors(surface, fitted, length * scattered_psi(4 * len(points[0])), 1.0)
        points = _arrivals(surface, fitted, psi, points)
        previous, (fitted, error) = error, _best_fit(base, bent, *points[:3], last=True)
        if error > 0.7 * previous:
            break
    return fitted, error


def trace_box(surface: LogDensity, centre: Array, rng: np.random.Generator) -> TracedRidge:
    """Return a box with a corner at `centre (D,)`, so small that it is mostly in the support."""
    inward = np.where(centre - surface.low < surface.high - centre, 1.0, -1.0)
    size = surface.spread
    for _ in range(MAX_SHRINKINGS):
        size = 0.1 * size
        u = centre + inward * size * np.abs(rng.standard_normal((SHRINKING_DRAWS, len(centre))))
        if np.isfinite(surface.value(u)).mean() > 0.5:
            break
    base = ridge.local_basis(centre, np.diag(size), len(centre))
    points = np.zeros((1, len(centre))), np.zeros((1, 0)), np.zeros((1, 0, 0))
    box = ridge.fit_ridge(base, *points, 0, 0)
    return TracedRidge(box, 0.0, inward, 0.7 * np.eye(len(centre)))


def moments(points: Array, weights: Array) -> tuple[Array, Array]:
    """Return mean and covariance root of weighted `points (N, n)`."""
    weights = weights / weights.sum()
    centre = weights @ points
    deviations = points - centre
    covariance = (deviations * weights[:, None]).T @ deviations
    floor = np.diag(1e-9 * np.diag(covariance) + 1e-12)
    return centre, np.linalg.cholesky(covariance + floor)


def distances(points: Array, weights: Array) -> Array:
    """Return Mahalanobis distances `(N,)` of `points (N, n)` from their weighted mean."""
    middle, root = moments(points, weights)
    return np.asarray(np.linalg.norm(np.linalg.solve(root, (points - middle).T), axis=0))


def _ridge_at_maximum(base: LocalBasis, here: QuadraticModel) -> RidgeMap:
    """Return the ridge map of degree zero: a point at the maximum, with the local covariance."""
    curvature = base.tight.T @ here.curvature[0] @ base.tight
    n_loose, n_tight = base.loose.shape[1], base.tight.shape[1]
    slope = base.tight.T @ here.slope[0]
    roots = covariance_roots(curvature[None]) if n_tight else np.zeros((1, 0, 0))
    step = roots[0] @ (roots[0].T @ slope)
    return ridge.fit_ridge(base, np.zeros((1, n_loose)), step[None], roots, 0, 0)


def _within_priors(surface: LogDensity, fitted: RidgeMap, psi: Array, stage: float) -> Array:
    """Select n of the 4 n points `psi (4 n, l)`, and return them as `(n, l)`.

    Points at which the ridge leaves the priors are first moved towards the maximum.
    """
    n, scale = len(psi) // 4, np.ones(len(psi))
    for _ in range(12):
        points = min(stage, PRIOR_MARGIN) * scale[:, None] * psi
        outside = ~surface.in_support(fitted.frame.join(points, fitted.at(points)))
        if not outside.any():
            break
        scale[outside] *= 0.85
    unchanged = np.flatnonzero(scale == 1.0)
    moved = np.flatnonzero(scale < 1.0)
    most = (3 * n) // 4
    selected = np.concatenate([unchanged[:most], moved, unchanged[most:]])[:n]
    return np.asarray(scale[selected, None] * psi[selected])


def _arrivals(
    surface: LogDensity, fitted: RidgeMap, psi: Array, previous: list[Array]
) -> list[Array]:
    """Move points to the ridge, and append the points that reach it to the `previous` points.

    Return psi, tau, covariance roots and log densities.  Points a little beyond the ends of the
    priors are kept, since polynomials are least accurate at their outermost points.  Points of much
    lower density are dropped, because they have reached another, lower maximum.
    """
    tau, roots, value, arrived = return_to_ridge(
        surface.quadratic_model, fitted.frame, psi, fitted.at(psi)
    )
    u, margin = fitted.frame.join(psi, tau), BEYOND_ENDS * (surface.high - surface.low)
    usable = (u > surface.low - margin) & (u < surface.high + margin)
    arrived &= np.isfinite(value) | usable.all(axis=1)
    new = [values[arrived] for values in (psi, tau, roots, value)]
    points = [np.concatenate(pair) for pair in zip(previous or new, new, strict=True)]
    value = points[3]
    on_ridge = (value > value.max(initial=-np.inf) - MAX_DEPTH) | (value == -np.inf)
    return [values[on_ridge] for values in points]


def return_to_ridge(
    expand: Expand,
    base: LocalBasis,
    psi: Array,
    tau: Array,
    tolerance: float = CONVERGED_SDS,
    iterations: int = ITERATIONS,
) -> tuple[Array, Array, Array, Flags]:
    """Move points from `tau (N, t)` to the ridge at `psi (N, l)` by Gauss-Newton.

    Returns `tau (N, t)`; covariance roots `(N, t, t)` and log densities `(N,)` before the last
    step; and flags `(N,)` of points that arrived.  A point has arrived if its last step was shorter
    than `tolerance`, in standard deviations.
    """
    tau = tau.copy()
    n_tight = tau.shape[1]
    roots = np.zeros((len(psi), n_tight, n_tight))
    value = np.full(len(psi), -np.inf)
    under_way = np.full(len(psi), n_tight > 0)
    arrived = ~under_way
    for _ in range(iterations):
        now = np.flatnonzero(under_way)
        if len(now) == 0:
            break
        here = expand(base.join(psi[now], tau[now]), base.tight)
        good = np.einsum("nii->n", here.curvature) > 0
        under_way[now[~good]] = False  # the response overflows there
        now, slope, curvature = now[good], here.slope[good], here.curvature[good]
        value[now] = here.value[good]
        roots[now] = covariance_roots(curvature)
        white = np.einsum("nij,ni->nj", roots[now], slope)
        usable = np.abs(white).max(axis=1) < MAX_SDS
        under_way[now[~usable]] = False
        now, white = now[usable], white[usable]
        step = np.einsum("nij,nj->ni", roots[now], white)
        longest = np.abs(step).max(axis=1, keepdims=True)
        tau[now] += step * np.minimum(1.0, MAX_STEP / np.maximum(longest, 1e-300))
        arrived[now] = np.linalg.norm(white, axis=1) < tolerance
        under_way[now] = ~arrived[now]
    return tau, roots, value, arrived


def covariance_roots(curvature: Array) -> Array:
    """Return lower triangular R `(N, t, t)` such that R R' is the inverse of each curvature."""
    n = curvature.shape[1]
    scale = 1.0 / np.sqrt(np.maximum(np.einsum("nii->ni", curvature), 1e-300))
    scaled = curvature * scale[:, :, None] * scale[:, None, :] + 1e-12 * np.eye(n)
    # Reversed rows and columns give an upper factor, whose transposed inverse is lower triangular.
    upper = np.linalg.cholesky(scaled[:, ::-1, ::-1])[:, ::-1, ::-1]
    return np.asarray(scale[:, :, None] * np.linalg.inv(upper).swapaxes(1, 2))


def _best_fit(
    base: LocalBasis, bent: Indices, psi: Array, tau: Array, roots: Array, *, last: bool
) -> tuple[RidgeMap, float]:
    """Fit polynomials of the degree with least error at held-out points; return ridge and error."""
    held_out = np.arange(len(psi)) % HELD_OUT_EVERY == HELD_OUT_EVERY - 1
    fitting = psi[~held_out], tau[~held_out], roots[~held_out]
    # Held-out points outside the ball of fitted points are ignored: polynomials do not extrapolate.
    within = held_out & ridge.fit_ridge(base, *fitting, 0, 0, bent).is_covered(psi)
    held_out = within if within.any() else held_out
    testing = psi[held_out], tau[held_out], roots[held_out]
    n = len(fitting[0])

    def fit(degree: int, root_degree: int) -> RidgeMap:
        return ridge.fit_ridge(base, *fitting, degree, root_degree, bent)

    upwards = range(1, MAX_DEGREE + 1)
    degrees = [d for d in upwards if d == 1 or _terms(len(bent), d) < 0.7 * n]
    degree, error = _best_degree(degrees, lambda d: ridge.residuals(fit(d, 0), *testing))
    if not last:
        reach = TRUSTED_EXTRAPOLATION
        return ridge.fit_ridge(base, psi, tau, roots, degree, 0, bent, reach), error
    lower = [d for d in range(degree + 1) if d <= 1 or _terms(len(bent), d) < n / 5]
    root_degree, _ = _best_degree(lower, lambda d: ridge.root_residuals(fit(degree, d), *testing))
    reach = MAX_CORNER_GROWTH ** (1.0 / max(degree, 1))
    return ridge.fit_ridge(base, psi, tau, roots, degree, root_degree, bent, reach), error


def _best_degree(degrees: Sequence[int], errors: Callable[[int], Array]) -> tuple[int, float]:
    """Return the degree with the least error, or the first that is good enough, and its error.

    The error is a quantile, so the few worst points at the ends of the ridge have no effect.
    """
    best, least = degrees[0], np.inf
    for degree in degrees:
        error = float(np.quantile(errors(degree), ERROR_QUANTILE))
        if error < MIN_IMPROVEMENT * least:
            best, least = degree, error
        if error < GOOD_ERROR:
            break
    return best, least


def _terms(n: int, degree: int) -> int:
    return math.comb(n + degree, degree)


@dataclass(frozen=True, slots=True)
class NewtonRidge(RidgeMap):
    """A Newton ridge moves points from the fitted polynomials to the ridge by Gauss-Newton.

    The moved point depends on psi alone.  A point that does not arrive stays on the polynomials.
    """

    expand: Expand

    def along(self, psi: Array) -> tuple[Array, Array, Array]:
        """Return t `(W, t)`, R `(t, t, W)` and log det R `(W,)` at psi `(W, l)`."""
        tau, root, log_det = RidgeMap.along(self, psi)
        newton_tau, roots, _, arrived = return_to_ridge(
            self.expand, self.frame, psi, tau, NEAR_SDS, NEWTON_ITERATIONS
        )
        row = np.arange(tau.shape[1])
        root[:, :, arrived] = np.moveaxis(roots[arrived], 0, 2)
        log_det[arrived] = np.log(root[row, row][:, arrived]).sum(axis=0)
        return np.where(arrived[:, None], newton_tau, tau), root, log_det


def newton_ridge(fitted: RidgeMap, expand: Expand) -> NewtonRidge:
    """Return the Newton ridge that begins at the polynomials of a fitted ridge."""
    polynomials = {field.name: getattr(fitted, field.name) for field in fields(fitted)}
    return NewtonRidge(**polynomials, expand=expand)
