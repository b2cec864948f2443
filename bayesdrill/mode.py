"""The maximum of the posterior (MAP): several searches, and whether they agree."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesdrill import laplace
from bayesdrill.optimisers.contract import Optimiser, Task
from bayesdrill.posterior import Posterior

Array = NDArray[np.float64]

SAME_LOG_DENSITY = 0.05  # searches that end nearer than this have found the same height
SAME_PLACE = 0.01  # ... and the same place, when no unknown differs by more than 1 %
CANDIDATES = 4096  # prior draws of which a search starts at the best
NOTHING = 1e-6  # of a prior that goes down to zero lies below where a search for a zero ends


@dataclass(frozen=True, slots=True, kw_only=True)
class Search:
    """One search: where it began and ended (physical), and how."""

    start: Mapping[str, float]
    end: Mapping[str, float]
    log_posterior: float
    evaluations: int
    settled: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Mode:
    """The best of the searches.

    `slope`: change of the log posterior per conditional standard deviation of each unknown, well
    below 1 at a maximum inside the prior; `gain`: what a Newton step would still gain, from the
    slopes along the principal directions of the posterior.
    `at_bound`: unknowns within 0.1 % of an end of their prior, or with 0.1 % of it between them and
    zero.
    """

    values: Mapping[str, float]
    log_posterior: float
    slope: Mapping[str, float]
    gain: float
    at_bound: tuple[str, ...]
    searches: tuple[Search, ...]

    @property
    def highest(self) -> tuple[Search, ...]:
        """The searches that reached the height of the best."""
        lowest = self.log_posterior - SAME_LOG_DENSITY
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
            if any(abs(s.end[name] / value - 1) > SAME_PLACE for s in self.highest)
        )


def starts(posterior: Posterior, n: int, rng: np.random.Generator) -> Array:
    """`(n, D)` physical: the configured start, then the best of some prior draws each."""
    first = posterior.space.vector(posterior.space.start)
    rest = []
    for _ in range(n - 1):
        candidates = posterior.space.draw(CANDIDATES, rng)
        rest.append(candidates[int(np.argmax(posterior.density(candidates)))])
    return np.array([first, *rest])


def task(posterior: Posterior) -> Task:
    """The posterior density; where a prior goes down to zero, the logs in which one searches do not."""
    priors = posterior.space.priors.values()
    floor = np.array([p.quantile(np.array(NOTHING)) if p.low == 0 else 0.0 for p in priors])

    def density(theta: Array) -> Array:
        return np.where((theta >= floor).all(axis=-1), posterior.density(theta), -np.inf)

    return Task(
        names=posterior.space.free,
        density=density,
        coordinates=posterior.coordinates,
        covariance=lambda theta: laplace.covariance(posterior, theta),
    )


def search(posterior: Posterior, optimiser: Optimiser, evaluations: int, start: Array) -> Search:
    """One search from the physical point `start (D,)`."""
    found = optimiser(task(posterior), start, evaluations)
    return Search(
        start=_named(posterior, start),
        end=_named(posterior, found.theta),
        log_posterior=found.value,
        evaluations=found.evaluations,
        settled=found.settled,
    )


def summarise(posterior: Posterior, searches: tuple[Search, ...]) -> Mode:
    best = max(searches, key=lambda s: s.log_posterior)
    theta = posterior.space.vector(best.end)
    z = posterior.coordinates.from_physical(theta[None])[0]
    information = laplace.information_root(posterior, theta)
    single = np.diag(1.0 / np.linalg.norm(information, axis=0))
    slope = _slopes(lambda logs: posterior.density(np.exp(logs)), np.log(theta), single)
    # Along the principal directions in the sampler's coordinates, where ridges are straight.
    principal = _slopes(
        lambda z: posterior.density(posterior.coordinates.to_physical(z)),
        z,
        laplace.root(laplace.covariance(posterior, theta, information)).T,
    )
    return Mode(
        values=best.end,
        log_posterior=best.log_posterior,
        slope=_named(posterior, slope),
        gain=float(0.5 * (principal**2).sum()),
        at_bound=_at_bound(posterior, best.end),
        searches=searches,
    )


def _slopes(density: Callable[[Array], Array], point: Array, steps: Array) -> Array:
    """Change of the log density at `point (D,)` over each of `steps (n, D)`: `(n,)`.

    By differences over a tenth of a step.  Where the prior ends on one side, only a rise to the
    other side counts: falling off from a bound is what a maximum there does.
    """
    here = density(point[None])[0]
    up = density(point + 0.1 * steps) - here
    down = density(point - 0.1 * steps) - here
    up = np.where(np.isfinite(up), up, np.where(down > 0, -down, 0.0))
    down = np.where(np.isfinite(down), down, np.where(up > 0, -up, 0.0))
    return np.asarray(5.0 * (up - down))


def _at_bound(posterior: Posterior, values: Mapping[str, float]) -> tuple[str, ...]:
    close = []
    for name, prior in posterior.space.priors.items():
        ends = [end for end in (prior.low, prior.high) if np.isfinite(end) and end > 0]
        at_zero = prior.low == 0 and values[name] < prior.quantile(np.array(1e-3))
        if at_zero or any(abs(values[name] / end - 1) < 1e-3 for end in ends):
            close.append(name)
    return tuple(close)


def _named(posterior: Posterior, theta: Array) -> dict[str, float]:
    return {name: float(x) for name, x in zip(posterior.space.free, theta, strict=True)}
