"""Search the maximum of the posterior (MAP), and other maxima.

Nelder and Mead find the way; damped Gauss-Newton with exact slopes goes the rest of it.  Plain
draws from the prior are sent up the same way, and unknowns whose poles the samples cannot tell from
those of the MAP: a maximum that no search has looked for is not found by many searches for another.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.inference import inverse_dynamics, laplace, step_error
from bayesdrill.inference.laplace import LogDensity
from bayesdrill.inference.posterior import Posterior
from bayesdrill.inference.step_error import StepSizes
from bayesdrill.sampling import multiple_modes
from bayesdrill.sampling.gauss_newton import GaussNewtonResult, gauss_newton, newton_gain
from bayesdrill.sampling.optimisers.contract import Optimiser, Optimum, Task

SAME_LOG_DENSITY = 1e-2  # searches that end nearer than this have found the same height
SAME_POINT = 0.01  # ... and the same place, when no unknown differs by more than 1 %
RELATIVE_ROUNDING = 1e-12  # of the log posterior: no two agree better than its own digits
CANDIDATES_PER_START = 4096  # prior draws of which a search starts at the best
LOWEST_LOG_DENSITY = -1e300  # log density of a search that has led nowhere
MAX_MAXIMA = 64  # maxima that are kept, those that hold most
NEGLIGIBLE_MASS = 1e-5  # of the posterior: maxima that hold no more together are none
MAX_MISSED_MASS = 0.02  # of the posterior: with more it is not believed
MAX_STEPPED_STARTS = 32  # the highest, of a rig that is stepped: each climb of it takes seconds
MULTI_STARTS = 24  # plain draws from the prior that are sent uphill without a simplex
SEARCH_ROUNDS, MAX_CENTRES = 2, 8  # of looking around maxima, and around how many at a time
POLISH_STEPS, NEWTON_STEPS = 40, 8  # of Gauss and Newton, and of Newton, at the end of a search


@dataclass(frozen=True, slots=True, kw_only=True)
class Search:
    """A search for the maximum: where it began and ended (physical), and how."""

    start: Mapping[str, float]
    end: Mapping[str, float]
    log_posterior: float
    evaluations: int
    settled: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class LocalMaximum:
    """Another maximum, which no ridge joins to the highest."""

    values: Mapping[str, float]
    log_posterior: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Mode:
    """The best of the searches, and `others`: lower maxima that may hold some of the posterior.

    `slope`: change of the log posterior per conditional standard deviation of each unknown, well
    below 1 at a maximum inside the prior; `gain`: what a Newton step would still gain.
    `at_bound`: unknowns within 0.1 % of an end of their prior, or with 0.1 % of it between them and
    zero.  `steps`: by which unknowns that may be negative are compared.  `pieces`: of rigs that are
    stepped, as `step_error.chosen_steps` tells them, where they were chosen here.  `left_out`: about
    how much of the posterior maxima hold that were not followed, as there are too many.
    """

    values: Mapping[str, float]
    log_posterior: float
    slope: Mapping[str, float]
    gain: float
    at_bound: tuple[str, ...]
    searches: tuple[Search, ...]
    others: tuple[LocalMaximum, ...] = ()
    steps: Mapping[str, float] = field(default_factory=dict)
    pieces: Mapping[str, StepSizes] = field(default_factory=dict)
    left_out: float = 0.0

    @property
    def doubts(self) -> tuple[str, ...]:
        """Reasons why a posterior about these maxima must not be believed."""
        if self.left_out < MAX_MISSED_MASS:
            return ()
        return (
            f"the search for maxima stopped at {len(self.maxima)} of them: others, which the record "
            f"cannot tell from these, may hold about {self.left_out:.0%} of the posterior; give the "
            "priors nearer ends, or hold an unknown",
        )

    @property
    def maxima(self) -> tuple[LocalMaximum, ...]:
        """All maxima, the highest first."""
        return (LocalMaximum(values=self.values, log_posterior=self.log_posterior), *self.others)

    @property
    def tolerance(self) -> float:
        """How much two heights may differ and still be the same."""
        return max(SAME_LOG_DENSITY, RELATIVE_ROUNDING * abs(self.log_posterior))

    @property
    def highest(self) -> tuple[Search, ...]:
        """The searches that reached the height of the best."""
        lowest = self.log_posterior - self.tolerance
        return tuple(s for s in self.searches if s.log_posterior > lowest)

    @property
    def wandering(self) -> tuple[str, ...]:
        """Unknowns in which searches of the same height ended at different places."""
        ends = [s.end for s in self.highest]
        ends = [end for end in ends if all(self._apart(end, other.values) for other in self.others)]
        wandering = {name for end in ends for name in self._apart(end, self.values)}
        return tuple(name for name in self.values if name in wandering)

    def _apart(self, end: Mapping[str, float], values: Mapping[str, float]) -> list[str]:
        """Return the unknowns in which `end` is not at these `values`."""
        near = {name: SAME_POINT * self.steps.get(name, abs(x)) for name, x in values.items()}
        return [name for name, x in values.items() if abs(end[name] - x) > near[name]]


def starts(posterior: Posterior, n: int, rng: np.random.Generator) -> Array:
    """Return physical starts of searches, `(n, D)`.

    The first is the configured start, or that of inverse dynamics where it is better. Each other is
    the best of some prior draws.
    """
    first = inverse_dynamics.regression_start(posterior)
    if first is None:
        first = posterior.space.vector(posterior.space.start)
    others = []
    for _ in range(n - 1):
        candidates = posterior.space.draw(CANDIDATES_PER_START, rng)
        others.append(candidates[int(np.argmax(posterior.density(candidates)))])
    return np.array([first, *others])


def task(posterior: Posterior) -> Task:
    """Pose the posterior density as an optimiser's task."""
    return Task(
        names=posterior.space.free,
        density=posterior.density,
        coordinates=posterior.coordinates,
        covariance=lambda theta: laplace.covariance(posterior, theta),
    )


def searches(
    posterior: Posterior, optimiser: Optimiser, evaluations: int, starts: Array
) -> list[Search]:
    """Search from each of the physical `starts (S, D)`, and then by slopes to the very maximum."""
    optima = optimiser(task(posterior), starts, evaluations)
    pairs = zip(starts, optima, strict=True)
    return [_finished_search(posterior, *pair) for pair in pairs]


def _finished_search(posterior: Posterior, start: Array, optimum: Optimum) -> Search:
    surface, settled = LogDensity(posterior, physical=True), optimum.settled
    # A simplex may go on for ever towards an end that has none.
    z = posterior.coordinates.from_physical(optimum.theta[None])
    u = np.clip(z, surface.low, surface.high)
    value = float(surface.value(u)[0])
    top = _polished(surface, u)
    if top.value[0] > value:
        u, value, settled = top.u, float(top.value[0]), bool(top.converged[0])
    return Search(
        start=_named(posterior, start),
        end=_named(posterior, posterior.coordinates.to_physical(u)[0]),
        log_posterior=value,
        evaluations=optimum.evaluations,
        settled=settled,
    )


def search(posterior: Posterior, optimiser: Optimiser, evaluations: int, start: Array) -> Search:
    """Search from the physical point `start (D,)`."""
    return searches(posterior, optimiser, evaluations, start[None])[0]


def multi_start(posterior: Posterior, starts: Array) -> tuple[Array, Array]:
    """Climb from physical `starts (n, D)`: the ends `(m, D)` and their log densities `(m,)`."""
    surface = LogDensity(posterior, physical=True)
    u, value = multiple_modes.best_ends(surface, posterior.coordinates.from_physical(starts))
    return posterior.coordinates.to_physical(u), value


def summarise(
    posterior: Posterior,
    searches: tuple[Search, ...],
    scouted: Sequence[tuple[Array, Array]] = (),
    *,
    around: bool = True,
) -> Mode:
    """Sum up all searches: the highest maximum, and the others.

    `scouted`: further points that were reached, physical `(n, D)`, and their log densities `(n,)`.
    `around`: whether others are searched for around those that were reached.
    """
    scouted = [some for some in scouted if len(some[0])]
    if steps := step_error.chosen_steps(posterior):
        best = max(searches, key=lambda search: search.log_posterior)
        posterior = step_error.choose_steps(posterior, posterior.space.vector(best.end))
        # Heights are compared, and were those of other steps.
        if step_error.chosen_steps(posterior) != steps:
            searches = tuple(polished_again(posterior, searches))
            scouted = [(theta, posterior.density(theta)) for theta, _ in scouted]
    surface = LogDensity(posterior, physical=True)
    to, back = posterior.coordinates.from_physical, posterior.coordinates.to_physical
    searched = np.array([posterior.space.vector(s.end) for s in searches])
    points = np.concatenate([to(theta) for theta in (searched, *(some[0] for some in scouted))])
    values = np.concatenate([[s.log_posterior for s in searches], *(some[1] for some in scouted)])
    ends, heights = _distinct_maxima(surface, points, values)
    ends, heights, left_out = _search_around(surface, ends, heights, SEARCH_ROUNDS * around)
    theta = back(ends)
    here = surface.quadratic_model(ends[:1], np.eye(ends.shape[1]))
    conditional = np.sqrt(np.maximum(np.einsum("wdd->wd", here.curvature)[0], 1e-300))
    inward = np.where(
        ((ends[0] <= surface.low) & (here.slope[0] < 0))
        | ((ends[0] >= surface.high) & (here.slope[0] > 0)),
        0.0,
        here.slope[0],
    )
    return Mode(
        values=_named(posterior, theta[0]),
        log_posterior=float(heights[0]),
        slope=_named(posterior, inward / conditional),
        gain=float(newton_gain(surface, ends[:1], here)[0]),
        at_bound=_at_bound(posterior, _named(posterior, theta[0])),
        searches=searches,
        others=tuple(
            LocalMaximum(values=_named(posterior, at), log_posterior=float(height))
            for at, height in zip(theta[1:], heights[1:], strict=True)
        ),
        steps={u.name: u.scale for u in posterior.space.unknowns if u.signed},
        pieces=step_error.chosen_steps(posterior),
        left_out=left_out,
    )


def _distinct_maxima(
    surface: LogDensity, points: Array, values: Array, known: int = 0
) -> tuple[Array, Array]:
    """The very maxima `(M, D)` that `points (n, D)` lead to, and their heights, the highest first.

    Of the first `known` points it is known that they are maxima.
    """
    distinct = multiple_modes.distinct_modes(surface, points, values, known)
    fresh = [k for k in distinct if k >= known]
    ends, heights = points.copy(), values.copy()
    top = gauss_newton(surface, points[fresh], POLISH_STEPS, exact=True)
    better = top.value > values[fresh]
    ends[fresh] = np.where(better[:, None], top.u, points[fresh])
    heights[fresh] = np.where(better, top.value, values[fresh])
    ends, heights = ends[sorted(distinct)], heights[sorted(distinct)]
    known = len(distinct) - len(fresh)
    # Two may have ended at one place.
    order = multiple_modes.distinct_modes(surface, ends, heights, known)
    return ends[order], heights[order]


def _search_around(
    surface: LogDensity, ends: Array, heights: Array, rounds: int
) -> tuple[Array, Array, float]:
    """Search around maxima `ends (M, D)`, and around those that are reached from them, in `rounds`.

    Also returns how much of the posterior is left out.
    """
    visited, left_out = np.empty((0, ends.shape[1])), 0.0
    for _ in range(rounds):
        fresh = [u for u in ends if not (visited == u).all(axis=1).any()][:MAX_CENTRES]
        visited = np.concatenate([visited, *(u[None] for u in fresh)])
        around = [each for u in fresh for each in multiple_modes.nearby_starts(surface, u)]
        left_out = max([left_out, *(nearby.missed_share for nearby in around)])
        if not any(len(nearby.u) for nearby in around):
            break
        starts = np.concatenate([nearby.u for nearby in around])
        if surface.posterior.likelihood.observations[0].response.stepping is not None:
            highest = np.argsort(-surface.value(starts), kind="stable")
            starts = starts[highest[:MAX_STEPPED_STARTS]]
        more, values = multiple_modes.best_ends(surface, starts, multiple_modes.MAX_NEARBY_STARTS)
        candidates = np.concatenate([ends, more]), np.concatenate([heights, values])
        ends, heights = _distinct_maxima(surface, *candidates, known=len(ends))
    shares = multiple_modes.shares_held(surface.posterior, ends)
    order = np.argsort(-shares, kind="stable")
    enough = int(np.searchsorted(np.cumsum(shares[order]), 1.0 - NEGLIGIBLE_MASS)) + 1
    selected = np.union1d(order[: min(enough, MAX_MAXIMA)], 0)  # the highest stays
    left_out = 1.0 - (1.0 - left_out) * float(shares[selected].sum())
    return ends[selected], heights[selected], left_out


def _polished(surface: LogDensity, u: Array) -> GaussNewtonResult:
    """The rest of the way from `u (W, D)`."""
    return gauss_newton(surface, gauss_newton(surface, u, POLISH_STEPS).u, NEWTON_STEPS, exact=True)


def polished_again(posterior: Posterior, searches: Sequence[Search]) -> list[Search]:
    """Go on from where searches ended, of a posterior that has changed a little since."""
    surface, space = LogDensity(posterior, physical=True), posterior.space
    ends = np.array([space.vector(search.end) for search in searches])
    top = _polished(surface, posterior.coordinates.from_physical(ends))
    values = np.nan_to_num(top.value, neginf=LOWEST_LOG_DENSITY)
    ends = posterior.coordinates.to_physical(top.u)
    return [
        replace(search, end=_named(posterior, theta), log_posterior=float(value))
        for search, theta, value in zip(searches, ends, values, strict=True)
    ]


def modes(posterior: Posterior, mode: Mode) -> Array:
    """Return all maxima, `(M, D)` physical, the highest first."""
    return np.array([posterior.space.vector(maximum.values) for maximum in mode.maxima])


def _at_bound(posterior: Posterior, values: Mapping[str, float]) -> tuple[str, ...]:
    close = []
    for unknown in posterior.space.unknowns:
        name, prior = unknown.name, unknown.prior
        if unknown.signed:
            near = 1e-3 * unknown.scale
            if min(values[name] - prior.low, prior.high - values[name]) < near:
                close.append(name)
            continue
        ends = [end for end in (prior.low, prior.high) if np.isfinite(end) and end > 0]
        ends_at_zero = prior.low == 0 and not prior.vanishes_at_ends
        at_zero = ends_at_zero and values[name] < prior.quantile(np.array(1e-3))
        if at_zero or any(abs(values[name] / end - 1) < 1e-3 for end in ends):
            close.append(name)
    return tuple(close)


def _named(posterior: Posterior, theta: Array) -> dict[str, float]:
    return {name: float(x) for name, x in zip(posterior.space.free, theta, strict=True)}
