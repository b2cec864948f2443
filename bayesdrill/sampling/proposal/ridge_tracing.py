"""The ridge of a maximum, traced from the log density itself: no formula of any rig is in it.

At the maximum the curvature, in units of what the priors know, splits the unknowns into directions
that the record knows far better (tight) and the rest (loose).  Then points are sent out along the
loose directions, a little further each time, Gauss and Newton bring each back to the ridge, and
polynomials are fitted to where they arrive.

Where polynomials are no match for a ridge: Gauss and Newton bring every point of it home.

A draw, with its density on the way there and back, costs some hundred times as much as a response.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayesdrill.basics.arrays import Array, Flags, Indices
from bayesdrill.inference.laplace import LogDensity, PosteriorLogDensity, QuadraticModel
from bayesdrill.inference.posterior import Posterior
from bayesdrill.sampling.samplers import ridge
from bayesdrill.sampling.samplers.independence import Mixture, Proposal
from bayesdrill.sampling.samplers.ridge import Frame, Ridge, Sheet

Expand = Callable[[Array, Array], QuadraticModel]

# A direction is tight if the record makes its variance so many times smaller than the prior's, ...
TIGHT = 100.0
# ... and by as many times the root of that of the tightest, which else bends along it.
STRAIGHT = 0.003
NEAR_END = 1e-6  # of the prior's spread
OWN = 1e-6  # share of an unknown that is not among what is set apart already: less is rounding
PRESSED = 0.5  # standard deviations that a maximum may lie beyond an end of a prior
PROBES = 12  # points all over the prior
STILL = 1e-12  # of the largest knowledge: what is less is rounding


def split(
    surface: LogDensity, centre: Array, here: QuadraticModel, still: Array | None = None
) -> tuple[Frame, Array]:
    """The basis at the maximum `centre (D,)`, and the record's knowledge of its loose part `(l,)`.

    `here`: the expansion there; `still (D, f)`: directions along which nothing changes, which come
    first.  An unknown that the end of its prior keeps from going further is no part of a tight
    direction, whose maximum would lie where there is no density: it is loose by itself.
    """
    scale = surface.spread
    slope, curvature = here.slope[0] * scale, here.curvature[0] * np.outer(scale, scale)
    apart = np.zeros((len(centre), 0)) if still is None else still
    values, vectors = _directions(curvature, apart)
    tight_from = max(TIGHT, STRAIGHT * float(np.sqrt(max(values[-1], 0.0))))
    tight = values >= tight_from
    known = np.zeros(apart.shape[1])
    if np.linalg.norm((slope @ vectors[:, tight]) / np.sqrt(values[tight])) > PRESSED:
        near = NEAR_END * scale
        pressed = (centre <= surface.low + near) & (slope < 0)
        pressed |= (centre >= surface.high - near) & (slope > 0)
        apart, own = _beside(apart, np.flatnonzero(pressed))
        known = np.concatenate([known, np.diag(curvature)[own] + slope[own] ** 2])
        values, vectors = _directions(curvature, apart)
    n_loose = int((values < tight_from).sum())
    columns = scale[:, None] * np.concatenate([apart, vectors], axis=1)
    return (
        ridge.frame(centre, columns, len(known) + n_loose),
        np.concatenate([known, np.maximum(values[:n_loose], 0.0)]),
    )


def _beside(apart: Array, unknowns: Indices) -> tuple[Array, list[int]]:
    """Columns at right angles: those `apart`, then what `unknowns` add to them, and which these are."""
    own: list[int] = []
    for d in map(int, unknowns):
        axis = np.eye(len(apart))[d] - apart @ apart[d]
        if (length := float(np.linalg.norm(axis))) > OWN:
            apart, own = np.column_stack([apart, axis / length]), [*own, d]
    return apart, own


def _directions(curvature: Array, without: Array) -> tuple[Array, Array]:
    """Eigenvalues, the smallest first, and vectors `(D, n)`, at right angles to those `without`."""
    whole = np.linalg.qr(without, mode="complete")[0]
    rest = whole[:, without.shape[1] :]
    values, vectors = np.linalg.eigh(rest.T @ curvature @ rest)
    return values, rest @ vectors


def unmoved(surface: LogDensity, expand: Expand, rng: np.random.Generator) -> Array:
    """Directions `(D, f)` in units of the spreads along which the density changes nowhere at all.

    Looked for at points all over the prior: what is flat at one of them may bend elsewhere.
    """
    d = len(surface.middle)
    scattered = surface.middle + surface.spread * rng.standard_normal((PROBES, d))
    here = expand(np.clip(scattered, surface.low, surface.high), np.eye(d))
    whitened = here.curvature * np.outer(surface.spread, surface.spread)
    largest = np.linalg.eigvalsh(whitened)[:, -1]
    seen = largest > 0
    if not seen.any():
        return np.zeros((d, 0))
    values, vectors = np.linalg.eigh((whitened[seen] / largest[seen, None, None]).mean(axis=0))
    return np.asarray(vectors[:, values < STILL])


NARROWEST, FEELERS = 14, 200  # tenths of tenths of a prior's spread, and draws that feel for room
OUTWARD = (0.15, 0.3, 0.5, 0.75, 1.0)  # of the way from the maximum to where the ridge is wanted
DOUBT = 9.0  # what the record knows of the loose directions at the maximum need not hold elsewhere
BEYOND_ENDS = 0.1  # of the priors' ranges, beyond which no point is of use
BEYOND = 1.4  # how much wider than the posterior is thought to be points are scattered
EXTRAPOLATED = 2.0  # how far beyond its points a fit is trusted to guide the next ones
CORNERS = 2.0  # times that the highest power may grow, in corners where no point happened to lie
ITERATIONS = 6  # of Gauss and Newton, for each point
ARRIVED = 0.03  # of a standard deviation: a smaller step is the last
MOST_STEP = 0.5  # of the priors' spreads
OVERFLOWS = 1e100  # standard deviations from the ridge: no slope of a response that is a number
MOST_DEGREE = 14
NEARLY_ALL = 0.98  # quantile of the points held out
WORTHWHILE = 0.8  # a higher degree has to be as much better
GOOD_ENOUGH = 0.1  # of a standard deviation, on points held out: no higher degree is tried
FAIR = 0.3  # of a standard deviation: what is further off is given more points
POINTS_PER_TERM = 2.5
LEAST_POINTS, LAST_POINTS, MOST_POINTS = 40, 300, 1600  # of a stage, of the last, and of all
SHORTER = 4  # times that half of the length is tried, where a polynomial is ...
ASTRAY = 5.0  # ... as many standard deviations off: of no use
DEEP = 100.0  # of the log density below the highest point: not on the ridge
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


def trace(
    surface: LogDensity,
    expand: Expand,
    centre: Array,
    rng: np.random.Generator,
    seen: tuple[Array, Array] | None = None,
) -> Traced:
    """The ridge through the maximum `centre (D,)`; `expand` may share the points among processes.

    `seen`: draws of the posterior `(N, D)` and their weights `(N,)`, which say where the ridge is
    wanted; else the priors do, with what the record knows at the maximum.
    """
    here = expand(centre[None], np.eye(len(centre)))
    still = unmoved(surface, expand, rng)
    base, known = split(surface, centre, here, still)
    if len(known) == len(centre) and (known > TIGHT).any():
        # The unknowns themselves, where the ends of the priors hold nearly all of them.
        scale = surface.spread
        base = ridge.frame(centre, np.diag(scale), len(centre))
        known = np.diag(here.curvature[0]) * scale**2 + (here.slope[0] * scale) ** 2
    if seen is None:
        cloud = None
        psi, spread = _foreseen(surface, base, known)
    else:
        drawn, weights = base.split(seen[0])[0], seen[1]
        psi, spread = moments(drawn, weights)
        # As many again, the rare ones more often than their weights say.
        share = np.sqrt(weights)
        cloud = drawn[rng.choice(len(drawn), size=len(drawn), p=share / share.sum())]
    at = _at_centre(base, here)
    if len(known) == 0 or base.tight.shape[1] == 0:
        return Traced(at, 0.0, psi, spread)
    bent = np.arange(still.shape[1], len(known))
    for _ in range(SHORTER):
        found = _followed(surface, expand, at, bent, psi, spread, cloud, rng)
        if found.off < ASTRAY:
            break
        psi, spread = 0.5 * psi, 0.5 * spread  # a shorter piece of it is better than none
        cloud = None if cloud is None else 0.5 * cloud
    return found


def _foreseen(surface: LogDensity, base: Frame, known: Array) -> tuple[Array, Array]:
    """What the priors and the record say of psi, both taken as Gaussian: `(l,)`, root `(l, l)`."""
    doubted = known / DOUBT
    towards = base.split(surface.middle[None])[0][0]
    psi, sd = towards / (1.0 + doubted), 1.0 / np.sqrt(1.0 + doubted)
    # At an end of a prior that the record presses against, begin on the side where it goes on.
    return psi + np.where(known > TIGHT, np.sign(towards) * sd, 0.0), np.diag(sd)


def _followed(
    surface: LogDensity,
    expand: Expand,
    at: Ridge,
    bent: Indices,
    psi: Array,
    spread: Array,
    cloud: Array | None,
    rng: np.random.Generator,
) -> Traced:
    """Outward from where the maximum is, with polynomials of what has been found so far."""
    base = at.frame
    points: list[Array] = []
    off = 0.0
    for share in OUTWARD:
        # Points for a polynomial of degree 2 near by, and of degree 4 in the end.
        degree = 2 if share < 0.4 else 3 if share < 1.0 else 4
        least = LEAST_POINTS if share < 1.0 else LAST_POINTS
        n = int(np.clip(POINTS_PER_TERM * _terms(len(bent), degree), least, MOST_POINTS))
        wanted = share * _scattered(surface, at, n, psi, spread, cloud, share, rng)
        points = _arrived(surface, expand, at, wanted, points)
        if len(points[0]) > 2 * (len(psi) + 1):
            at, off = _best_fit(base, bent, *points[:3], last=share == OUTWARD[-1])
    while off > FAIR and 2 * len(points[0]) < MOST_POINTS:
        wanted = _scattered(surface, at, len(points[0]), psi, spread, cloud, 1.0, rng)
        points = _arrived(surface, expand, at, wanted, points)
        before, (at, off) = off, _best_fit(base, bent, *points[:3], last=True)
        if off > 0.7 * before:
            break
    return Traced(at, off, psi, spread)


def beside(surface: LogDensity, centre: Array, rng: np.random.Generator) -> Traced:
    """No ridge, but as much of the room on the inner side of `centre (D,)` as has a density."""
    inward = np.where(centre - surface.low < surface.high - centre, 1.0, -1.0)
    size = surface.spread
    for _ in range(NARROWEST):
        size = 0.1 * size
        u = centre + inward * size * np.abs(rng.standard_normal((FEELERS, len(centre))))
        if np.isfinite(surface.value(u)).mean() > 0.5:
            break
    base = ridge.frame(centre, np.diag(size), len(centre))
    nothing = np.zeros((1, len(centre))), np.zeros((1, 0)), np.zeros((1, 0, 0))
    return Traced(ridge.fit(base, *nothing, 0, 0), 0.0, inward, np.diag(np.full(len(centre), 0.7)))


def moments(points: Array, weights: Array) -> tuple[Array, Array]:
    """Mean and root of the covariance of weighted `points (N, n)`."""
    share = weights / weights.sum()
    centre = share @ points
    off = points - centre
    covariance = (off * share[:, None]).T @ off
    floor = np.diag(1e-9 * np.diag(covariance) + 1e-12)
    return centre, np.linalg.cholesky(covariance + floor)


def distances(points: Array, weights: Array) -> Array:
    """Of `points (N, n)` from their weighted middle, in standard deviations: `(N,)`."""
    middle, root = moments(points, weights)
    return np.asarray(np.linalg.norm(np.linalg.solve(root, (points - middle).T), axis=0))


def _at_centre(base: Frame, here: QuadraticModel) -> Ridge:
    """Where nothing but the maximum itself is known yet."""
    curvature = base.tight.T @ here.curvature[0] @ base.tight
    n_loose, n_tight = base.loose.shape[1], base.tight.shape[1]
    slope = base.tight.T @ here.slope[0]
    roots = covariance_roots(curvature[None]) if n_tight else np.zeros((1, 0, 0))
    step = roots[0] @ (roots[0].T @ slope)
    return ridge.fit(base, np.zeros((1, n_loose)), step[None], roots, 0, 0)


def _scattered(
    surface: LogDensity,
    at: Ridge,
    n: int,
    psi: Array,
    spread: Array,
    cloud: Array | None,
    share: float,
    rng: np.random.Generator,
) -> Array:
    """Places `(n, l)` where the prior has a density, as far as the ridge is known by now.

    As psi of draws, the `cloud (N, l)`, lie, or normally, and wider.  Those beyond its ends are drawn
    in towards the maximum until they are not.
    """
    if cloud is None:
        wanted = psi + BEYOND * rng.standard_normal((4 * n, len(psi))) @ spread.T
    else:
        wanted = psi + BEYOND * (cloud[rng.integers(len(cloud), size=4 * n)] - psi)
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


def _arrived(
    surface: LogDensity, expand: Expand, at: Ridge, psi: Array, before: list[Array]
) -> list[Array]:
    """`psi (N, l)`, `tau (N, t)`, covariance roots `(N, t, t)` and log densities of what arrived, behind
    those `before`.

    A little beyond the ends of the priors, too: without such points polynomials are at their worst
    at the ends.  But not far below the ridge: at a lesser maximum, where nothing is.
    """
    found, roots, value, arrived = led_back(expand, at.frame, psi, at.at(psi))
    u, beyond = at.frame.join(psi, found), BEYOND_ENDS * (surface.high - surface.low)
    near = (u > surface.low - beyond) & (u < surface.high + beyond)
    arrived &= np.isfinite(value) | near.all(axis=1)
    new = [some[arrived] for some in (psi, found, roots, value)]
    points = [np.concatenate(pair) for pair in zip(before or new, new, strict=True)]
    value = points[3]
    kept = (value > value.max(initial=-np.inf) - DEEP) | (value == -np.inf)
    return [some[kept] for some in points]


def led_back(
    expand: Expand,
    base: Frame,
    psi: Array,
    tau: Array,
    near: float = ARRIVED,
    iterations: int = ITERATIONS,
) -> tuple[Array, Array, Array, Flags]:
    """To the ridge at `psi (N, l)`: `tau (N, t)`, covariance roots `(N, t, t)`, the log density
    `(N,)` about there, and whether they arrived: by a last step from where they were `near`, in
    standard deviations.
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
        known = np.abs(white).max(axis=1) < OVERFLOWS
        under_way[now[~known]] = False
        now, white = now[known], white[known]
        step = np.einsum("nij,nj->ni", roots[now], white)
        longest = np.abs(step).max(axis=1, keepdims=True)
        tau[now] += step * np.minimum(1.0, MOST_STEP / np.maximum(longest, 1e-300))
        off = np.linalg.norm(white, axis=1)
        arrived[now] = off < near
        under_way[now] = ~arrived[now]
    return tau, roots, value, arrived


def covariance_roots(curvature: Array) -> Array:
    """Lower triangles R `(N, t, t)` with R R' the inverse of each curvature."""
    n = curvature.shape[1]
    scale = 1.0 / np.sqrt(np.maximum(np.einsum("nii->ni", curvature), 1e-300))
    scaled = curvature * scale[:, :, None] * scale[:, None, :] + 1e-12 * np.eye(n)
    # From the factor of the matrix turned round: its inverse is lower triangular again.
    turned = np.linalg.cholesky(scaled[:, ::-1, ::-1])[:, ::-1, ::-1]
    return np.asarray(scale[:, :, None] * np.linalg.inv(turned).swapaxes(1, 2))


def _best_fit(
    base: Frame, bent: Indices, psi: Array, tau: Array, roots: Array, *, last: bool
) -> tuple[Ridge, float]:
    """The polynomials of the degree that points held out ask for, and how far off those are."""
    held = np.arange(len(psi)) % HELD_OUT == HELD_OUT - 1
    some = psi[~held], tau[~held], roots[~held]
    within = held & ridge.fit(base, *some, 0, 0, bent).within(psi)  # no fit knows what lies beyond
    held = within if within.any() else held
    others = psi[held], tau[held], roots[held]
    n = len(some[0])

    def tried(degree: int, root_degree: int) -> Ridge:
        return ridge.fit(base, *some, degree, root_degree, bent)

    degrees = [d for d in range(1, MOST_DEGREE + 1) if d == 1 or _terms(len(bent), d) < 0.7 * n]
    degree, off = _least(degrees, lambda d: ridge.residuals(tried(d, 0), *others))
    if not last:
        made = ridge.fit(base, psi, tau, roots, degree, 0, bent)
        return ridge.further(made, EXTRAPOLATED), off
    lower = [d for d in range(degree + 1) if d <= 1 or _terms(len(bent), d) < n / 5]
    root_degree, _ = _least(lower, lambda d: ridge.root_residuals(tried(degree, d), *others))
    made = ridge.fit(base, psi, tau, roots, degree, root_degree, bent)
    return ridge.further(made, CORNERS ** (1.0 / max(degree, 1))), off


def _least(degrees: Sequence[int], errors: Callable[[int], Array]) -> tuple[int, float]:
    """The degree with the least error, or the first that is good enough.

    Of nearly all points: where the ridge ends a polynomial is at its worst, and there are few there.
    """
    best, least = degrees[0], np.inf
    for degree in degrees:
        found = float(np.quantile(errors(degree), NEARLY_ALL))
        if found < WORTHWHILE * least:
            best, least = degree, found
        if found < GOOD_ENOUGH:
            break
    return best, least


def _terms(n: int, degree: int) -> int:
    return math.comb(n + degree, degree)


NEAR = 0.5  # standard deviations: from there another step leads to the ridge, or as good as
NEWTON_ITERATIONS = 9  # where polynomials are far astray, half of them are spent on the way


@dataclass(frozen=True, slots=True)
class Settled:
    """`ridge`, from whose place and root each point is brought to where the ridge is.

    A function of psi alone, whether or not it arrives.
    """

    ridge: Sheet
    expand: Expand

    @property
    def frame(self) -> Frame:
        return self.ridge.frame

    @property
    def n_loose(self) -> int:
        return self.ridge.n_loose

    def along(self, psi: Array) -> tuple[Array, Array, Array]:
        place, root, log_det = self.ridge.along(psi)
        found, roots, _, arrived = led_back(
            self.expand, self.frame, psi, place, NEAR, NEWTON_ITERATIONS
        )
        row = np.arange(place.shape[1])
        place = np.where(arrived[:, None], found, place)
        root[:, :, arrived] = np.moveaxis(roots[arrived], 0, 2)
        log_det[arrived] = np.log(root[row, row][:, arrived]).sum(axis=0)
        return place, root, log_det

    def within(self, psi: Array) -> Flags:
        return self.ridge.within(psi)


def bound(proposal: Proposal, posterior: Posterior) -> Proposal:
    """With the ridges of its `settled` part, where it has one, brought home along the posterior."""
    own = proposal.settled
    if own is None:
        return proposal
    expand = PosteriorLogDensity(posterior).curvature_model
    return replace(proposal, settled=replace(own, mixture=settled(own.mixture, expand)))


def settled(found: Mixture, expand: Expand) -> Mixture:
    """The same mixture over settled ridges."""
    return replace(found, sheets=tuple(Settled(sheet, expand) for sheet in found.sheets))
