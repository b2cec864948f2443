"""Search for the maximum of the posterior (MAP), and for other maxima.

A simplex (Nelder-Mead) comes near a maximum, and damped Gauss-Newton with exact slopes converges to
it.  For other maxima, Gauss-Newton also starts at draws from the prior and at aliases of the MAP:
points where the poles differ but the samples are nearly the same.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.basics.findings import Finding
from bayesdrill.inference import inverse_dynamics, laplace, step_error
from bayesdrill.inference.laplace import LogDensity
from bayesdrill.inference.likelihood import Observation
from bayesdrill.inference.posterior import Posterior
from bayesdrill.inference.step_error import StepSizes
from bayesdrill.sampling import multiple_modes
from bayesdrill.sampling.gauss_newton import GaussNewtonResult, gauss_newton, newton_gain
from bayesdrill.sampling.optimisers.contract import Optimiser, Optimum, Task

SAME_LOG_DENSITY = 1e-2  # two searches have the same height if log densities differ by less
SAME_POINT = 0.01  # two searches have the same end if no unknown's relative difference is larger
RELATIVE_ROUNDING = 1e-12  # relative rounding error of a log posterior
CANDIDATES_PER_START = 4096  # number of prior draws; a search starts at the draw of highest density
LOWEST_LOG_DENSITY = -1e300  # log density of a search that ended outside the support
SDS_FROM_ZERO = 3.0  # an unknown that is more conditional sds from zero than this is not at zero
MAX_MAXIMA = 64  # largest number of kept maxima, those with the most posterior mass
NEGLIGIBLE_MASS = 1e-5  # total posterior mass of the maxima that are dropped
MAX_MISSED_MASS = 0.02  # more posterior mass in maxima that were not followed raises a doubt
MAX_STEPPED_STARTS = 32  # largest number of starts for a rig integrated in steps, which is slow
MULTI_STARTS = 24  # prior draws from which Gauss-Newton climbs without a simplex
SEARCH_ROUNDS, MAX_CENTRES = 2, 8  # searches around maxima: number of rounds, of maxima per round
POLISH_STEPS, NEWTON_STEPS = 40, 8  # steps of Gauss-Newton, then of Newton, that end a search


@dataclass(frozen=True, slots=True, kw_only=True)
class Search:
    """A search for the maximum has a start and an end in SI; `settled` means that it converged."""

    start: Mapping[str, float]
    end: Mapping[str, float]
    log_posterior: float
    evaluations: int
    settled: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class LocalMaximum:
    """A local maximum has values in SI, and no ridge joins it to another maximum."""

    values: Mapping[str, float]
    log_posterior: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Mode:
    """A mode is the highest maximum of the posterior; `others` are lower maxima with some mass.

    `slope` is the change of the log posterior per conditional standard deviation of each unknown,
    which is well below 1 at a maximum inside the prior.  One more Newton step would gain `gain`.
    `at_bound` names unknowns within 0.1 % of an end of their prior.  Near zero, these have less than
    0.1 % of the prior's mass below them, and few sds.  `steps` are scales of unknowns that may be
    negative, and `pieces` the step sizes of rigs integrated in steps.  `left_out` estimates other
    maxima's mass.
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
    def doubts(self) -> tuple[Finding, ...]:
        """Return the reasons why a posterior about these maxima must not be believed."""
        if self.left_out < MAX_MISSED_MASS:
            return ()
        numbers = {"maxima": len(self.maxima), "missed": self.left_out}
        return (Finding("more maxima than were followed", {}, numbers),)

    @property
    def maxima(self) -> tuple[LocalMaximum, ...]:
        """Return all maxima, the highest first."""
        return (LocalMaximum(values=self.values, log_posterior=self.log_posterior), *self.others)

    @property
    def tolerance(self) -> float:
        """Return the difference of log posteriors below which two maxima have the same height."""
        return max(SAME_LOG_DENSITY, RELATIVE_ROUNDING * abs(self.log_posterior))

    @property
    def highest(self) -> tuple[Search, ...]:
        """Return the searches that reached the height of the best search."""
        lowest = self.log_posterior - self.tolerance
        return tuple(s for s in self.searches if s.log_posterior > lowest)

    @property
    def wandering(self) -> tuple[str, ...]:
        """Return the unknowns in which searches of the same height ended at different points."""
        ends = [s.end for s in self.highest]
        ends = [end for end in ends if all(self._apart(end, other.values) for other in self.others)]
        wandering = {name for end in ends for name in self._apart(end, self.values)}
        return tuple(name for name in self.values if name in wandering)

    def _apart(self, end: Mapping[str, float], values: Mapping[str, float]) -> list[str]:
        """Return the unknowns in which `end` differs from `values`."""
        scale = {name: self.steps.get(name, abs(x)) for name, x in values.items()}
        return [n for n, x in values.items() if abs(end[n] - x) > SAME_POINT * scale[n]]


def starts(posterior: Posterior, n: int, rng: np.random.Generator) -> Array:
    """Return starts of searches in SI, `(n, D)`.

    The first start is that of inverse dynamics if there is one, else the configured start.  Each
    further start is the best of `CANDIDATES_PER_START` prior draws.  If noise has heavy tails, each
    start is then improved with normal noise.
    """
    first = inverse_dynamics.regression_start(posterior)
    if first is None:
        first = posterior.space.vector(posterior.space.start)
    others = []
    for _ in range(n - 1):
        candidates = posterior.space.draw(CANDIDATES_PER_START, rng)
        others.append(candidates[int(np.argmax(posterior.density(candidates)))])
    return _improved(posterior, np.array([first, *others]))


def _improved(posterior: Posterior, starts: Array) -> Array:
    """Climb from `starts (S, D)` with normal noise if the noise has heavy tails; keep better starts.

    With heavy tails, samples far from the response of a bad start count as outliers.  So the density
    has maxima at which the response ignores a part of the record.
    """
    if all(each.with_normal_noise() is each for each in posterior.likelihood.observations):
        return starts
    normal = posterior.edit(convert=Observation.with_normal_noise)
    u = posterior.coordinates.from_physical(starts)
    climbed = gauss_newton(LogDensity(normal, physical=True), u, POLISH_STEPS).u
    ends = posterior.coordinates.to_physical(climbed)
    is_better = posterior.density(ends) > posterior.density(starts)
    return np.where(is_better[:, None], ends, starts)


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
    """Search from each of `starts (S, D)` in SI by the optimiser, then by Gauss-Newton."""
    pairs = zip(starts, optimiser(task(posterior), starts, evaluations), strict=True)
    return [_finished_search(posterior, *pair) for pair in pairs]


def _finished_search(posterior: Posterior, start: Array, optimum: Optimum) -> Search:
    surface, settled = LogDensity(posterior, physical=True), optimum.settled
    # A simplex may run away to infinity, where the coordinates have no finite value.
    z = posterior.coordinates.from_physical(optimum.theta[None])
    u = np.clip(z, surface.low, surface.high)
    value = float(surface.value(u)[0])
    polished = _polished(surface, u)
    if polished.value[0] > value:
        u, value, settled = polished.u, float(polished.value[0]), bool(polished.converged[0])
    return Search(
        start=_by_name(posterior, start),
        end=_by_name(posterior, posterior.coordinates.to_physical(u)[0]),
        log_posterior=value,
        evaluations=optimum.evaluations,
        settled=settled,
    )


def multi_start(posterior: Posterior, starts: Array) -> tuple[Array, Array]:
    """Climb from `starts (n, D)` in SI; return ends `(m, D)` and their log densities `(m,)`."""
    surface = LogDensity(posterior, physical=True)
    u, value = multiple_modes.best_ends(surface, posterior.coordinates.from_physical(starts))
    return posterior.coordinates.to_physical(u), value


def summarise(
    posterior: Posterior,
    searches: tuple[Search, ...],
    climbs: Sequence[tuple[Array, Array]] = (),
    *,
    around: bool = True,
) -> Mode:
    """Return the highest maximum of all searches, and the others.

    `climbs` has further ends of climbs, `(n, D)` in SI, with their log densities `(n,)`.  With
    `around`, the neighbourhood of these maxima is searched for further maxima.
    """
    climbs = [ends for ends in climbs if len(ends[0])]
    if steps := step_error.chosen_steps(posterior):
        best = max(searches, key=lambda search: search.log_posterior)
        posterior = step_error.choose_steps(posterior, posterior.space.vector(best.end))
        # Heights are compared below, so all are computed with the new step sizes.
        if step_error.chosen_steps(posterior) != steps:
            searches = tuple(polished_again(posterior, searches))
            climbs = [(theta, posterior.density(theta)) for theta, _ in climbs]
    surface, coordinates = LogDensity(posterior, physical=True), posterior.coordinates
    searched = np.array([posterior.space.vector(s.end) for s in searches])
    theta = np.concatenate([searched, *(ends[0] for ends in climbs)])
    values = np.concatenate([[s.log_posterior for s in searches], *(ends[1] for ends in climbs)])
    ends, heights = _distinct_maxima(surface, coordinates.from_physical(theta), values)
    ends, heights, left_out = _search_around(surface, ends, heights, SEARCH_ROUNDS * around)
    theta = coordinates.to_physical(ends)
    here = surface.quadratic_model(ends[:1], np.eye(ends.shape[1]))
    conditional = np.sqrt(np.maximum(np.einsum("wdd->wd", here.curvature)[0], 1e-300))
    inward = np.where(
        ((ends[0] <= surface.low) & (here.slope[0] < 0))
        | ((ends[0] >= surface.high) & (here.slope[0] > 0)),
        0.0,
        here.slope[0],
    )
    return Mode(
        values=_by_name(posterior, theta[0]),
        log_posterior=float(heights[0]),
        slope=_by_name(posterior, inward / conditional),
        gain=float(newton_gain(surface, ends[:1], here)[0]),
        at_bound=_at_bound(posterior, theta[0], coordinates.slopes(theta[:1])[0] / conditional),
        searches=searches,
        others=tuple(
            LocalMaximum(values=_by_name(posterior, point), log_posterior=float(height))
            for point, height in zip(theta[1:], heights[1:], strict=True)
        ),
        steps={u.name: u.scale for u in posterior.space.unknowns if u.signed},
        pieces=step_error.chosen_steps(posterior),
        left_out=left_out,
    )


def _distinct_maxima(
    surface: LogDensity, points: Array, values: Array, n_known: int = 0
) -> tuple[Array, Array]:
    """Climb from `points (n, D)`, and return distinct maxima `(M, D)` and their heights `(M,)`.

    The highest maximum comes first.  The first `n_known` points are maxima already.
    """
    distinct = multiple_modes.distinct_modes(surface, points, values, n_known)
    fresh = [k for k in distinct if k >= n_known]
    ends, heights = points.copy(), values.copy()
    polished = gauss_newton(surface, points[fresh], POLISH_STEPS, exact=True)
    better = polished.value > values[fresh]
    ends[fresh] = np.where(better[:, None], polished.u, points[fresh])
    heights[fresh] = np.where(better, polished.value, values[fresh])
    ends, heights = ends[sorted(distinct)], heights[sorted(distinct)]
    n_known = len(distinct) - len(fresh)
    # Two of the points may have climbed to the same maximum.
    order = multiple_modes.distinct_modes(surface, ends, heights, n_known)
    return ends[order], heights[order]


def _search_around(
    surface: LogDensity, maxima: Array, heights: Array, rounds: int
) -> tuple[Array, Array, float]:
    """Search around `maxima (M, D)` and, in further `rounds`, around newly found maxima.

    Returns the maxima with the most mass, their heights, and the mass of all dropped maxima.
    """
    visited, left_out = np.empty((0, maxima.shape[1])), 0.0
    for _ in range(rounds):
        fresh = [u for u in maxima if not (visited == u).all(axis=1).any()][:MAX_CENTRES]
        visited = np.concatenate([visited, *(u[None] for u in fresh)])
        around = [starts for u in fresh for starts in multiple_modes.nearby_starts(surface, u)]
        left_out = max([left_out, *(nearby.missed_share for nearby in around)])
        if not any(len(nearby.u) for nearby in around):
            break
        starts = np.concatenate([nearby.u for nearby in around])
        if surface.posterior.likelihood.observations[0].response.stepping is not None:
            highest = np.argsort(-surface.value(starts), kind="stable")
            starts = starts[highest[:MAX_STEPPED_STARTS]]
        more, values = multiple_modes.best_ends(surface, starts, multiple_modes.MAX_NEARBY_STARTS)
        candidates = np.concatenate([maxima, more]), np.concatenate([heights, values])
        maxima, heights = _distinct_maxima(surface, *candidates, n_known=len(maxima))
    shares = multiple_modes.shares_held(surface.posterior, maxima)
    order = np.argsort(-shares, kind="stable")
    n_kept = int(np.searchsorted(np.cumsum(shares[order]), 1.0 - NEGLIGIBLE_MASS)) + 1
    selected = np.union1d(order[: min(n_kept, MAX_MAXIMA)], 0)  # the highest is always kept
    left_out = 1.0 - (1.0 - left_out) * float(shares[selected].sum())
    return maxima[selected], heights[selected], left_out


def _polished(surface: LogDensity, u: Array) -> GaussNewtonResult:
    """Climb from `u (W, D)` to the maximum by Gauss-Newton, and then by Newton."""
    return gauss_newton(surface, gauss_newton(surface, u, POLISH_STEPS).u, NEWTON_STEPS, exact=True)


def polished_again(posterior: Posterior, searches: Sequence[Search]) -> list[Search]:
    """Continue `searches` on a `posterior` that differs a little from the previous posterior."""
    surface, space = LogDensity(posterior, physical=True), posterior.space
    ends = np.array([space.vector(search.end) for search in searches])
    polished = _polished(surface, posterior.coordinates.from_physical(ends))
    values = np.nan_to_num(polished.value, neginf=LOWEST_LOG_DENSITY)
    ends = posterior.coordinates.to_physical(polished.u)
    return [
        replace(search, end=_by_name(posterior, theta), log_posterior=float(value))
        for search, theta, value in zip(searches, ends, values, strict=True)
    ]


def modes(posterior: Posterior, mode: Mode) -> Array:
    """Return all maxima in SI, `(M, D)`, the highest first."""
    return np.array([posterior.space.vector(maximum.values) for maximum in mode.maxima])


def _at_bound(posterior: Posterior, theta: Array, sds: Array) -> tuple[str, ...]:
    """Return the unknowns at an end of their prior, for `theta (D,)` with conditional `sds (D,)`."""
    close = []
    for unknown, value, sd in zip(posterior.space.unknowns, theta, sds, strict=True):
        name, prior = unknown.name, unknown.prior
        if unknown.signed:
            if min(value - prior.low, prior.high - value) < 1e-3 * unknown.scale:
                close.append(name)
            continue
        ends = [end for end in (prior.low, prior.high) if np.isfinite(end) and end > 0]
        ends_at_zero = prior.low == 0 and not prior.vanishes_at_ends
        is_small = value < min(prior.quantile(np.array(1e-3)), SDS_FROM_ZERO * sd)
        if (ends_at_zero and is_small) or any(abs(value / end - 1) < 1e-3 for end in ends):
            close.append(name)
    return tuple(close)


def _by_name(posterior: Posterior, theta: Array) -> dict[str, float]:
    return {name: float(x) for name, x in zip(posterior.space.free, theta, strict=True)}
