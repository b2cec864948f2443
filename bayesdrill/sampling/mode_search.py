"""The maximum of the posterior (MAP): several searches, whether they agree, and other maxima.

Nelder and Mead find the way; damped Gauss-Newton with exact slopes goes the rest of it.  Plain draws
from the prior are sent up the same way, and unknowns whose poles the samples cannot tell from
those of the MAP: a maximum that no search has looked for is not found by many searches for another.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.inference import inverse_dynamics, laplace, step_error
from bayesdrill.inference.laplace import LogDensity, PosteriorLogDensity
from bayesdrill.inference.posterior import Posterior
from bayesdrill.inference.step_error import StepSizes
from bayesdrill.sampling import multiple_modes
from bayesdrill.sampling.gauss_newton import Climbed, climb, gain_left
from bayesdrill.sampling.optimisers.contract import Optimiser, Optimum, Task

SAME_LOG_DENSITY = 1e-3  # searches that end nearer than this have found the same height
ROUNDING = 1e-12  # of the log posterior: nor can two searches agree better than its own digits
SAME_PLACE = 0.01  # ... and the same place, when no unknown differs by more than 1 %
CANDIDATES = 4096  # prior draws of which a search starts at the best
SCOUTS = 24  # plain draws from the prior that are sent uphill without a simplex
LOWEST = -1e300  # log density of a search that has led nowhere
MOST = 64  # maxima that are kept, those that hold most
NOTHING = 1e-5  # of the posterior: maxima that hold no more together are none
MOST_LEFT_OUT = 0.02  # of the posterior: with more it is not believed
ROUNDS, MOST_CENTRES = 2, 8  # of looking for maxima around others, and around how many at a time
POLISH, EXACT = 40, 8  # steps of Gauss and Newton, and of Newton, at the end of a search


@dataclass(frozen=True, slots=True, kw_only=True)
class Search:
    """One search: where it began and ended (physical), and how."""

    start: Mapping[str, float]
    end: Mapping[str, float]
    log_posterior: float
    evaluations: int
    settled: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Other:
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
    stepped, as `inference.step_error.taken` tells them, where they were chosen here.  `left_out`: about
    how much of the posterior maxima hold that were not followed, as there are too many.
    """

    values: Mapping[str, float]
    log_posterior: float
    slope: Mapping[str, float]
    gain: float
    at_bound: tuple[str, ...]
    searches: tuple[Search, ...]
    others: tuple[Other, ...] = ()
    steps: Mapping[str, float] = field(default_factory=dict)
    pieces: Mapping[str, StepSizes] = field(default_factory=dict)
    left_out: float = 0.0

    @property
    def doubts(self) -> tuple[str, ...]:
        """Why a posterior about these maxima must not be believed."""
        if self.left_out < MOST_LEFT_OUT:
            return ()
        return (
            f"the search for maxima stopped at {len(self.maxima)} of them: others, which the record "
            f"cannot tell from these, may hold about {self.left_out:.0%} of the posterior; give the "
            "priors nearer ends, or hold an unknown",
        )

    @property
    def maxima(self) -> tuple[Other, ...]:
        """All of them, the highest first."""
        return (Other(values=self.values, log_posterior=self.log_posterior), *self.others)

    @property
    def tolerance(self) -> float:
        """How much two heights may differ and still be the same."""
        return max(SAME_LOG_DENSITY, ROUNDING * abs(self.log_posterior))

    @property
    def highest(self) -> tuple[Search, ...]:
        """The searches that reached the height of the best."""
        lowest = self.log_posterior - self.tolerance
        return tuple(s for s in self.searches if s.log_posterior > lowest)

    @property
    def same_height(self) -> int:
        return len(self.highest)

    @property
    def wandering(self) -> tuple[str, ...]:
        """Unknowns in which searches of the same height ended at different places."""
        return tuple(
            name
            for name, value in self.values.items()
            if any(
                self._differ(name, s.end[name], value) and not self._is_other(s.end)
                for s in self.highest
            )
        )

    def _is_other(self, end: Mapping[str, float]) -> bool:
        return any(
            not any(self._differ(name, end[name], x) for name, x in other.values.items())
            for other in self.others
        )

    def _differ(self, name: str, one: float, other: float) -> bool:
        return abs(one - other) > SAME_PLACE * self.steps.get(name, abs(other))


def starts(posterior: Posterior, n: int, rng: np.random.Generator) -> Array:
    """`(n, D)` physical: the configured start, or that of inverse dynamics where it is better, then the
    best of some prior draws each.
    """
    first = inverse_dynamics.regression_start(posterior)
    if first is None:
        first = posterior.space.vector(posterior.space.start)
    rest = []
    for _ in range(n - 1):
        candidates = posterior.space.draw(CANDIDATES, rng)
        rest.append(candidates[int(np.argmax(posterior.density(candidates)))])
    return np.array([first, *rest])


def task(posterior: Posterior) -> Task:
    """The posterior density."""
    return Task(
        names=posterior.space.free,
        density=posterior.density,
        coordinates=posterior.coordinates,
        covariance=lambda theta: laplace.covariance(posterior, theta),
    )


def searches(
    posterior: Posterior, optimiser: Optimiser, evaluations: int, starts: Array
) -> list[Search]:
    """A search from each of the physical `starts (S, D)`; polished, it ends at the very maximum."""
    found = optimiser(task(posterior), starts, evaluations)
    return [_ended(posterior, optimiser, *pair) for pair in zip(starts, found, strict=True)]


def _ended(posterior: Posterior, optimiser: Optimiser, start: Array, found: Optimum) -> Search:
    theta, value, settled = found.theta, found.value, found.settled
    if optimiser.polished:
        surface = PosteriorLogDensity(posterior, physical=True)
        # A simplex may go on for ever towards an end that has none.
        u = np.clip(posterior.coordinates.from_physical(theta[None]), surface.low, surface.high)
        value = float(surface.value(u)[0])
        top = _polished(surface, u)
        if top.value[0] > value:
            u, value, settled = top.u, float(top.value[0]), bool(top.arrived[0])
        theta = posterior.coordinates.to_physical(u)[0]
    return Search(
        start=_named(posterior, start),
        end=_named(posterior, theta),
        log_posterior=value,
        evaluations=found.evaluations,
        settled=settled,
    )


def search(posterior: Posterior, optimiser: Optimiser, evaluations: int, start: Array) -> Search:
    """One search from the physical point `start (D,)`."""
    return searches(posterior, optimiser, evaluations, start[None])[0]


def scouts(posterior: Posterior, starts: Array) -> tuple[Array, Array]:
    """Where physical `starts (n, D)` lead, `(m, D)`, and how high `(m,)`; without a simplex."""
    surface = PosteriorLogDensity(posterior, physical=True)
    u, value = multiple_modes.scout(surface, posterior.coordinates.from_physical(starts))
    return posterior.coordinates.to_physical(u), value


def summarise(
    posterior: Posterior,
    searches: tuple[Search, ...],
    scouted: Sequence[tuple[Array, Array]] = (),
) -> Mode:
    """`scouted`: further points that were reached, physical `(n, D)`, and their log densities `(n,)`."""
    scouted = [some for some in scouted if len(some[0])]
    if steps := step_error.chosen_steps(posterior):
        best = max(searches, key=lambda one: one.log_posterior)
        posterior = step_error.choose_steps(posterior, posterior.space.vector(best.end))
        # Heights are compared, and were those of other steps.
        if step_error.chosen_steps(posterior) != steps:
            searches = tuple(_anew(posterior, one) for one in searches)
            scouted = [(theta, posterior.density(theta)) for theta, _ in scouted]
    surface = PosteriorLogDensity(posterior, physical=True)
    to, back = posterior.coordinates.from_physical, posterior.coordinates.to_physical
    searched = np.array([posterior.space.vector(s.end) for s in searches])
    points = np.concatenate([to(theta) for theta in (searched, *(some[0] for some in scouted))])
    values = np.concatenate([[s.log_posterior for s in searches], *(some[1] for some in scouted)])
    ends, heights, left_out = _looked_around(surface, *_tops(surface, points, values))
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
        gain=float(gain_left(surface, ends[:1], here)[0]),
        at_bound=_at_bound(posterior, _named(posterior, theta[0])),
        searches=searches,
        others=tuple(
            Other(values=_named(posterior, at), log_posterior=float(height))
            for at, height in zip(theta[1:], heights[1:], strict=True)
        ),
        steps={one.name: one.scale for one in posterior.space.unknowns if one.signed},
        pieces=step_error.chosen_steps(posterior),
        left_out=left_out,
    )


def _tops(surface: LogDensity, points: Array, values: Array, known: int = 0) -> tuple[Array, Array]:
    """The very maxima `(M, D)` that `points (n, D)` lead to, and their heights, the highest first.

    Of the first `known` points it is known that they are maxima.
    """
    chosen = multiple_modes.apart(surface, points, values, known)
    fresh = [k for k in chosen if k >= known]
    ends, heights = points.copy(), values.copy()
    top = climb(surface, points[fresh], POLISH, exact=True)
    better = top.value > values[fresh]
    ends[fresh] = np.where(better[:, None], top.u, points[fresh])
    heights[fresh] = np.where(better, top.value, values[fresh])
    ends, heights = ends[sorted(chosen)], heights[sorted(chosen)]
    known = len(chosen) - len(fresh)
    order = multiple_modes.apart(surface, ends, heights, known)  # two may have ended at one place
    return ends[order], heights[order]


def _looked_around(
    surface: PosteriorLogDensity, ends: Array, heights: Array
) -> tuple[Array, Array, float]:
    """Maxima `ends (M, D)` and those that are found from them, and so on; and how much of the posterior
    is left out.
    """
    seen, left_out = np.empty((0, ends.shape[1])), 0.0
    for _ in range(ROUNDS):
        fresh = [u for u in ends if not (seen == u).all(axis=1).any()][:MOST_CENTRES]
        seen = np.concatenate([seen, *(u[None] for u in fresh)])
        around = [multiple_modes.starts(surface, u) for u in fresh]
        left_out = max([left_out, *(one.left_out for one in around)])
        if not any(len(one.u) for one in around):
            break
        starts = np.concatenate([one.u for one in around])
        more, values = multiple_modes.scout(surface, starts, multiple_modes.AROUND)
        every = np.concatenate([ends, more]), np.concatenate([heights, values])
        ends, heights = _tops(surface, *every, known=len(ends))
    held = multiple_modes.shares_held(surface.posterior, ends)
    order = np.argsort(-held, kind="stable")
    enough = int(np.searchsorted(np.cumsum(held[order]), 1.0 - NOTHING)) + 1
    kept = np.union1d(order[: min(enough, MOST)], 0)  # the highest stays
    left_out = 1.0 - (1.0 - left_out) * float(held[kept].sum())
    return ends[kept], heights[kept], left_out


def _polished(surface: LogDensity, u: Array) -> Climbed:
    """The rest of the way from `u (W, D)`."""
    return climb(surface, climb(surface, u, POLISH).u, EXACT, exact=True)


def _anew(posterior: Posterior, one: Search) -> Search:
    """From where it ended, with other steps."""
    surface = PosteriorLogDensity(posterior, physical=True)
    start = posterior.coordinates.from_physical(posterior.space.vector(one.end)[None])
    top = _polished(surface, start)
    end = _named(posterior, posterior.coordinates.to_physical(top.u)[0])
    return replace(one, end=end, log_posterior=float(np.nan_to_num(top.value[0], neginf=LOWEST)))


def tops(posterior: Posterior, found: Mode) -> Array:
    """All maxima, `(M, D)` physical, the highest first."""
    return np.array([posterior.space.vector(one.values) for one in found.maxima])


def _at_bound(posterior: Posterior, values: Mapping[str, float]) -> tuple[str, ...]:
    close = []
    for one in posterior.space.unknowns:
        name, prior = one.name, one.prior
        if one.signed:
            near = 1e-3 * one.scale
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
