"""Trace the ridge of a maximum from the log density itself; no formula of any rig is in it.

At the maximum the curvature, in units of what the priors know, splits the unknowns into directions
that the record knows far better (tight) and the rest (loose).  Then points are sent out along the
loose directions, a little further each time, Gauss and Newton bring each back to the ridge, and
polynomials are fitted to where they arrive.

On a Newton ridge Gauss and Newton bring every point home, as the check of what a proposal misses
needs it: a draw, with its density, costs some hundred times as much as a response.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayesdrill.basics.arrays import Array, Flags, Indices
from bayesdrill.inference.laplace import LogDensity, QuadraticModel
from bayesdrill.sampling.samplers import ridge
from bayesdrill.sampling.samplers.independence import Mixture
from bayesdrill.sampling.samplers.ridge import LocalBasis, RidgeMap

Expand = Callable[[Array, Array], QuadraticModel]

# A direction is tight if the record makes its variance so many times smaller than the prior's, ...
TIGHT_RATIO = 100.0
# ... and by as many times the root of that of the tightest, which else bends along it.
STRAIGHT_RATIO = 0.003
NEAR_END = 1e-6  # of the prior's spread
MIN_NEW_SHARE = 1e-6  # of an unknown, beside what is set apart already: less is rounding
MAX_SDS_BEYOND_END = 0.5  # standard deviations that a maximum may lie beyond an end of a prior
PROBES = 12  # points all over the prior
NEGLIGIBLE_CURVATURE = 1e-12  # of the largest knowledge: what is less is rounding
KNOWLEDGE_DISCOUNT = 9.0  # what is known of loose directions at a maximum need not hold elsewhere
BEYOND_ENDS = 0.1  # of the priors' ranges, beyond which no point is of use
SCATTER_WIDTH = 1.4  # how much wider than the posterior is thought to be points are scattered
TRUSTED_EXTRAPOLATION = 2.0  # how far beyond its points a fit is trusted to guide the next ones
MAX_CORNER_GROWTH = 2.0  # of the highest power, in corners where no point happened to lie
ITERATIONS = 6  # of Gauss and Newton, for each point
CONVERGED_SDS = 0.03  # of a standard deviation: a smaller step is the last
MAX_STEP = 0.5  # of the priors' spreads
MAX_SDS = 1e100  # standard deviations from the ridge: no slope of a response that is a number
MAX_DEGREE = 14
ERROR_QUANTILE = 0.98  # quantile of the points held out
MIN_IMPROVEMENT = 0.8  # a higher degree has to be as much better
GOOD_ERROR = 0.1  # of a standard deviation, on points held out: no higher degree is tried
FAIR_ERROR = 0.3  # of a standard deviation: what is further off is given more points
POINTS_PER_TERM = 2.5
MAX_DEPTH = 100.0  # of the log density below the highest point: not on the ridge
HELD_OUT_EVERY = 4  # every fourth point
PRIOR_MARGIN = 0.9  # points are wanted a little beyond the prior's ends too
NEAR_SDS = 0.5  # standard deviations: from there another step leads to the ridge, or as good as
NEWTON_ITERATIONS = 9  # where polynomials are far astray, half of them are spent on the way


def split_directions(
    surface: LogDensity, centre: Array, here: QuadraticModel, still: Array | None = None
) -> tuple[LocalBasis, Array]:
    """Return the basis at the maximum `centre (D,)` and the knowledge of its loose part `(l,)`.

    `here`: the expansion there; `still (D, f)`: directions along which nothing changes, which come
    first.  An unknown that the end of its prior keeps from going further is no part of a tight
    direction, whose maximum would lie where there is no density: it is loose by itself.
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
        near = NEAR_END * scale
        pressed = (centre <= surface.low + near) & (slope < 0)
        pressed |= (centre >= surface.high - near) & (slope > 0)
        separate, separate_unknowns = _orthogonal(separate, np.flatnonzero(pressed))
        knowledge = np.diag(curvature) + slope**2
        known = np.concatenate([known, knowledge[separate_unknowns]])
        values, vectors = _directions(curvature, separate)
    n_loose = int((values < tight_from).sum())
    columns = scale[:, None] * np.concatenate([separate, vectors], axis=1)
    base = ridge.local_basis(centre, columns, len(known) + n_loose)
    return base, np.concatenate([known, np.maximum(values[:n_loose], 0.0)])


def _orthogonal(separate: Array, unknowns: Indices) -> tuple[Array, list[int]]:
    """Orthonormal columns: those `separate`, then what `unknowns` add, and which of them do."""
    added: list[int] = []
    for d in map(int, unknowns):
        axis = np.eye(len(separate))[d] - separate @ separate[d]
        if (length := float(np.linalg.norm(axis))) > MIN_NEW_SHARE:
            separate, added = np.column_stack([separate, axis / length]), [*added, d]
    return separate, added


def _directions(curvature: Array, without: Array) -> tuple[Array, Array]:
    """Eigenvalues, the smallest first, and vectors `(D, n)`, at right angles to those `without`."""
    whole = np.linalg.qr(without, mode="complete")[0]
    complement = whole[:, without.shape[1] :]
    values, vectors = np.linalg.eigh(complement.T @ curvature @ complement)
    return values, complement @ vectors


def flat_directions(surface: LogDensity, rng: np.random.Generator) -> Array:
    """Return directions `(D, f)`, in units of the spreads, along which the density never changes.

    Looked for at points all over the prior: what is flat at one of them may bend elsewhere.
    """
    d = len(surface.middle)
    scattered = surface.middle + surface.spread * rng.standard_normal((PROBES, d))
    here = surface.quadratic_model(np.clip(scattered, surface.low, surface.high), np.eye(d))
    whitened = here.curvature * np.outer(surface.spread, surface.spread)
    largest = np.linalg.eigvalsh(whitened)[:, -1]
    informed = largest > 0
    if not informed.any():
        return np.zeros((d, 0))
    usual = (whitened[informed] / largest[informed, None, None]).mean(axis=0)
    values, vectors = np.linalg.eigh(usual)
    return np.asarray(vectors[:, values < NEGLIGIBLE_CURVATURE])


# tenths of tenths of a prior's spread, and draws that feel for room
MAX_SHRINKINGS, SHRINKING_DRAWS = 14, 200
STAGES = (0.15, 0.3, 0.5, 0.75, 1.0)  # of the way from the maximum to where the ridge is wanted
MIN_POINTS, LAST_POINTS, MAX_POINTS = 40, 300, 1600  # of a stage, of the last, and of all
MAX_HALVINGS = 4  # times that half of the length is tried, where a polynomial is ...
USELESS_ERROR = 5.0  # ... as many standard deviations off: of no use


@dataclass(frozen=True, slots=True)
class TracedRidge:
    """A ridge, and how far held-out points of it are `off` its polynomial, in standard deviations.

    `psi (l,)`, `spread (l, l)`: mean and covariance root of the loose directions, to begin with.
    """

    ridge: RidgeMap
    off: float
    psi: Array
    spread: Array


def trace(
    surface: LogDensity,
    centre: Array,
    rng: np.random.Generator,
    weighted_draws: tuple[Array, Array] | None = None,
) -> TracedRidge:
    """Trace the ridge through the maximum `centre (D,)`.

    `weighted_draws`: draws of the posterior `(N, D)` and their weights `(N,)`, which say where the
    ridge is wanted; else the priors do, with what the record knows at the maximum.
    """
    here = surface.quadratic_model(centre[None], np.eye(len(centre)))
    still = flat_directions(surface, rng)
    base, known = split_directions(surface, centre, here, still)
    if len(known) == len(centre) and (known > TIGHT_RATIO).any():
        # The unknowns themselves, where the ends of the priors hold nearly all of them.
        scale = surface.spread
        base = ridge.local_basis(centre, np.diag(scale), len(centre))
        known = np.diag(here.curvature[0]) * scale**2 + (here.slope[0] * scale) ** 2
    if weighted_draws is None:
        cloud = None
        psi, spread = _expected(surface, base, known)
    else:
        drawn, weights = base.split(weighted_draws[0])[0], weighted_draws[1]
        psi, spread = moments(drawn, weights)
        # As many again, the rare ones more often than their weights say.
        share = np.sqrt(weights)
        cloud = drawn[rng.choice(len(drawn), size=len(drawn), p=share / share.sum())]

    def wanted(n: int) -> Array:
        """Return psi `(n, l)` as it lies in the cloud, or normally, and wider."""
        if cloud is None:
            return psi + SCATTER_WIDTH * rng.standard_normal((n, len(psi))) @ spread.T
        return psi + SCATTER_WIDTH * (cloud[rng.integers(len(cloud), size=n)] - psi)

    at = _at_centre(base, here)
    if len(known) == 0 or base.tight.shape[1] == 0:
        return TracedRidge(at, 0.0, psi, spread)
    bent = np.arange(still.shape[1], len(known))
    for halvings in range(MAX_HALVINGS):
        length = 0.5**halvings  # a shorter piece of it is better than none
        followed, off = _follow(surface, at, bent, wanted, length)
        if off < USELESS_ERROR:
            break
    return TracedRidge(followed, off, length * psi, length * spread)


def _expected(surface: LogDensity, base: LocalBasis, known: Array) -> tuple[Array, Array]:
    """What the priors and the record say of psi, both taken as Gaussian: `(l,)`, root `(l, l)`."""
    doubted = known / KNOWLEDGE_DISCOUNT
    towards = base.split(surface.middle[None])[0][0]
    psi, sd = towards / (1.0 + doubted), 1.0 / np.sqrt(1.0 + doubted)
    # At an end of a prior that the record presses against, begin on the side where it goes on.
    return psi + np.where(known > TIGHT_RATIO, np.sign(towards) * sd, 0.0), np.diag(sd)


def _follow(
    surface: LogDensity,
    at: RidgeMap,
    bent: Indices,
    wanted: Callable[[int], Array],
    length: float,
) -> tuple[RidgeMap, float]:
    """Outward from where the maximum is, with polynomials of what has been found so far.

    As far as `length` times those `wanted`; returns the ridge, and how far `off` it is.
    """
    base = at.frame
    points: list[Array] = []
    off = 0.0
    for share in STAGES:
        # Points for a polynomial of degree 2 near by, and of degree 4 in the end.
        degree = 2 if share < 0.4 else 3 if share < 1.0 else 4
        least = MIN_POINTS if share < 1.0 else LAST_POINTS
        n = int(np.clip(POINTS_PER_TERM * _terms(len(bent), degree), least, MAX_POINTS))
        psi = share * _within_priors(surface, at, length * wanted(4 * n), share)
        points = _arrivals(surface, at, psi, points)
        if len(points[0]) > 2 * (at.n_loose + 1):
            at, off = _best_fit(base, bent, *points[:3], last=share == STAGES[-1])
    while off > FAIR_ERROR and 2 * len(points[0]) < MAX_POINTS:
        psi = _within_priors(surface, at, length * wanted(4 * len(points[0])), 1.0)
        points = _arrivals(surface, at, psi, points)
        before, (at, off) = off, _best_fit(base, bent, *points[:3], last=True)
        if off > 0.7 * before:
            break
    return at, off


def trace_box(surface: LogDensity, centre: Array, rng: np.random.Generator) -> TracedRidge:
    """Return no ridge, but as much of the box on the inner side of `centre (D,)` as has a density."""
    inward = np.where(centre - surface.low < surface.high - centre, 1.0, -1.0)
    size = surface.spread
    for _ in range(MAX_SHRINKINGS):
        size = 0.1 * size
        u = centre + inward * size * np.abs(rng.standard_normal((SHRINKING_DRAWS, len(centre))))
        if np.isfinite(surface.value(u)).mean() > 0.5:
            break
    base = ridge.local_basis(centre, np.diag(size), len(centre))
    nothing = np.zeros((1, len(centre))), np.zeros((1, 0)), np.zeros((1, 0, 0))
    box = ridge.fit_ridge(base, *nothing, 0, 0)
    return TracedRidge(box, 0.0, inward, 0.7 * np.eye(len(centre)))


def moments(points: Array, weights: Array) -> tuple[Array, Array]:
    """Return mean and covariance root of weighted `points (N, n)`."""
    share = weights / weights.sum()
    centre = share @ points
    off = points - centre
    covariance = (off * share[:, None]).T @ off
    floor = np.diag(1e-9 * np.diag(covariance) + 1e-12)
    return centre, np.linalg.cholesky(covariance + floor)


def distances(points: Array, weights: Array) -> Array:
    """Return distances of `points (N, n)` from their weighted mean, in standard deviations: `(N,)`."""
    middle, root = moments(points, weights)
    return np.asarray(np.linalg.norm(np.linalg.solve(root, (points - middle).T), axis=0))


def _at_centre(base: LocalBasis, here: QuadraticModel) -> RidgeMap:
    """Where nothing but the maximum itself is known yet."""
    curvature = base.tight.T @ here.curvature[0] @ base.tight
    n_loose, n_tight = base.loose.shape[1], base.tight.shape[1]
    slope = base.tight.T @ here.slope[0]
    roots = covariance_roots(curvature[None]) if n_tight else np.zeros((1, 0, 0))
    step = roots[0] @ (roots[0].T @ slope)
    return ridge.fit_ridge(base, np.zeros((1, n_loose)), step[None], roots, 0, 0)


def _within_priors(surface: LogDensity, at: RidgeMap, wanted: Array, share: float) -> Array:
    """A fourth of those `wanted (4 n, l)`, as far as the ridge is known by now: `(n, l)`.

    Those beyond ends of the priors are drawn in towards the maximum until they are not.
    """
    n, inwards = len(wanted) // 4, np.ones(len(wanted))
    for _ in range(12):
        points = min(share, PRIOR_MARGIN) * inwards[:, None] * wanted
        outside = ~surface.inside(at.frame.join(points, at.at(points)))
        if not outside.any():
            break
        inwards[outside] *= 0.85
    whole = np.flatnonzero(inwards == 1.0)
    drawn = np.flatnonzero(inwards < 1.0)
    most = (3 * n) // 4
    selected = np.concatenate([whole[:most], drawn, whole[most:]])[:n]
    return np.asarray(inwards[selected, None] * wanted[selected])


def _arrivals(surface: LogDensity, at: RidgeMap, psi: Array, before: list[Array]) -> list[Array]:
    """Psi, tau, covariance roots and log densities where points arrived, behind those `before`.

    A little beyond the ends of the priors, too: without such points polynomials are at their worst
    at the ends.  But not far below the ridge: at a lesser maximum, where nothing is.
    """
    tau, roots, value, arrived = return_to_ridge(surface.quadratic_model, at.frame, psi, at.at(psi))
    u, beyond = at.frame.join(psi, tau), BEYOND_ENDS * (surface.high - surface.low)
    near = (u > surface.low - beyond) & (u < surface.high + beyond)
    arrived &= np.isfinite(value) | near.all(axis=1)
    new = [some[arrived] for some in (psi, tau, roots, value)]
    points = [np.concatenate(pair) for pair in zip(before or new, new, strict=True)]
    value = points[3]
    on_ridge = (value > value.max(initial=-np.inf) - MAX_DEPTH) | (value == -np.inf)
    return [some[on_ridge] for some in points]


def return_to_ridge(
    expand: Expand,
    base: LocalBasis,
    psi: Array,
    tau: Array,
    near: float = CONVERGED_SDS,
    iterations: int = ITERATIONS,
) -> tuple[Array, Array, Array, Flags]:
    """Lead points back to the ridge at `psi (N, l)` by Gauss-Newton.

    Returns `tau (N, t)`, covariance roots `(N, t, t)`, the log density `(N,)` about there, and
    whether they arrived: by a last step from where they were `near`, in standard deviations.
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
        known = np.abs(white).max(axis=1) < MAX_SDS
        under_way[now[~known]] = False
        now, white = now[known], white[known]
        step = np.einsum("nij,nj->ni", roots[now], white)
        longest = np.abs(step).max(axis=1, keepdims=True)
        tau[now] += step * np.minimum(1.0, MAX_STEP / np.maximum(longest, 1e-300))
        off = np.linalg.norm(white, axis=1)
        arrived[now] = off < near
        under_way[now] = ~arrived[now]
    return tau, roots, value, arrived


def covariance_roots(curvature: Array) -> Array:
    """Return lower triangles R `(N, t, t)` with R R' the inverse of each curvature."""
    n = curvature.shape[1]
    scale = 1.0 / np.sqrt(np.maximum(np.einsum("nii->ni", curvature), 1e-300))
    scaled = curvature * scale[:, :, None] * scale[:, None, :] + 1e-12 * np.eye(n)
    # From the factor of the matrix turned round: its inverse is lower triangular again.
    turned = np.linalg.cholesky(scaled[:, ::-1, ::-1])[:, ::-1, ::-1]
    return np.asarray(scale[:, :, None] * np.linalg.inv(turned).swapaxes(1, 2))


def _best_fit(
    base: LocalBasis, bent: Indices, psi: Array, tau: Array, roots: Array, *, last: bool
) -> tuple[RidgeMap, float]:
    """The polynomials of the degree that points held out ask for, and how far off those are."""
    held_out = np.arange(len(psi)) % HELD_OUT_EVERY == HELD_OUT_EVERY - 1
    some = psi[~held_out], tau[~held_out], roots[~held_out]
    # No fit knows what lies beyond.
    within = held_out & ridge.fit_ridge(base, *some, 0, 0, bent).within(psi)
    held_out = within if within.any() else held_out
    others = psi[held_out], tau[held_out], roots[held_out]
    n = len(some[0])

    def tried(degree: int, root_degree: int) -> RidgeMap:
        return ridge.fit_ridge(base, *some, degree, root_degree, bent)

    upwards = range(1, MAX_DEGREE + 1)
    degrees = [d for d in upwards if d == 1 or _terms(len(bent), d) < 0.7 * n]
    degree, off = _best_degree(degrees, lambda d: ridge.residuals(tried(d, 0), *others))
    if not last:
        reach = TRUSTED_EXTRAPOLATION
        return ridge.fit_ridge(base, psi, tau, roots, degree, 0, bent, reach), off
    lower = [d for d in range(degree + 1) if d <= 1 or _terms(len(bent), d) < n / 5]
    root_degree, _ = _best_degree(lower, lambda d: ridge.root_residuals(tried(degree, d), *others))
    reach = MAX_CORNER_GROWTH ** (1.0 / max(degree, 1))
    return ridge.fit_ridge(base, psi, tau, roots, degree, root_degree, bent, reach), off


def _best_degree(degrees: Sequence[int], errors: Callable[[int], Array]) -> tuple[int, float]:
    """The degree with the least error, or the first that is good enough.

    Of nearly all points: where the ridge ends a polynomial is at its worst, and there are few there.
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


def newton_ridge(fitted: RidgeMap, expand: Expand) -> RidgeMap:
    """Return the ridge to which Gauss-Newton leads every point back from where polynomials have it.

    A function of psi alone, whether or not it arrives.
    """

    def correction(
        base: LocalBasis, psi: Array, tau: Array, root: Array, log_det: Array
    ) -> tuple[Array, Array, Array]:
        newton_tau, roots, _, arrived = return_to_ridge(
            expand, base, psi, tau, NEAR_SDS, NEWTON_ITERATIONS
        )
        row = np.arange(tau.shape[1])
        tau = np.where(arrived[:, None], newton_tau, tau)
        root[:, :, arrived] = np.moveaxis(roots[arrived], 0, 2)
        log_det[arrived] = np.log(root[row, row][:, arrived]).sum(axis=0)
        return tau, root, log_det

    return replace(fitted, correction=correction)


def newton_mixture(mixture: Mixture, expand: Expand) -> Mixture:
    """Return the same mixture over Newton ridges."""
    return replace(mixture, sheets=tuple(newton_ridge(sheet, expand) for sheet in mixture.sheets))
