"""The fit of a posterior: its maxima, ensembles about them, the evidence, and what lies beyond ends of
priors that are in the way.

The main job, a notebook, a worker elsewhere and a refit of a calibration all fit like this, with the
same streams of random numbers for the same purposes.
"""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import Future
from dataclasses import dataclass, field

import numpy as np

from bayesdrill.basics import seeds
from bayesdrill.basics.arrays import Array
from bayesdrill.basics.progress import SILENT, Reporter
from bayesdrill.inference import laplace
from bayesdrill.inference.posterior import Posterior
from bayesdrill.sampling import mode_search
from bayesdrill.sampling.ensembles import Memory, Plan, Sampled, Shelf, sample, weighed
from bayesdrill.sampling.mode_search import Mode, Search
from bayesdrill.sampling.opened_ends import with_open_ends
from bayesdrill.sampling.optimisers.contract import Optimiser
from bayesdrill.sampling.workers import Crew

SEARCHING = "searching the MAP"
SPLIT = 2  # tasks of several starts each: of a batch a start costs little, and workers share them


@dataclass(frozen=True, slots=True, kw_only=True)
class FitPlan:
    """How a posterior is fitted.

    `optimiser`, `starts`, `evaluations`: of the searches for the MAP; `chains`: of the ensembles.
    `nominal`: values that ends of priors must not hide.  `brief`: one search after the other, until one
    is seen to have arrived, and no evidence: for what is fitted many times.
    """

    optimiser: Optimiser
    starts: int
    evaluations: int
    chains: Plan
    nominal: Mapping[str, float] = field(default_factory=dict)
    brief: bool = False


@dataclass(frozen=True, slots=True)
class Searches:
    """Searches for the MAP under way, and for maxima elsewhere."""

    searches: list[Future[list[Search]]]
    scouts: list[Future[tuple[Array, Array]]]


def fit(posterior: Posterior, plan: FitPlan) -> tuple[Mode, Sampled]:
    """Fit a posterior in this process alone; raises `Nowhere` where nothing can be sampled."""
    with Crew(posterior, 1) as crew:
        found = end_searches(crew, begin_searches(crew, plan, SILENT), SILENT)
        crew.step(found.pieces)
        return found, sample_maxima(crew, found, plan, Memory(), SILENT)


def begin_searches(crew: Crew, plan: FitPlan, report: Reporter) -> Searches:
    """Submit all searches; a crew that is alone has done them then."""
    posterior, seed = crew.posterior, plan.chains.seed
    plain = posterior.space.draw(mode_search.SCOUTS, seeds.stream(seed, "scout"))
    if plan.brief:
        return Searches(
            [crew.submit(_first_arrived, plan)], [crew.submit(mode_search.scouts, plain)]
        )
    points = mode_search.starts(posterior, plan.starts, seeds.stream(seed, "map"))
    report.update(0.0, SEARCHING)
    searches = [
        crew.submit(mode_search.searches, plan.optimiser, plan.evaluations, some)
        for some in np.array_split(points, SPLIT)
        if len(some)
    ]
    scouts = []
    if plan.optimiser.polished:
        scouts = [crew.submit(mode_search.scouts, some) for some in np.array_split(plain, SPLIT)]
    return Searches(searches, scouts)


def end_searches(crew: Crew, under_way: Searches, report: Reporter) -> Mode:
    """Wait for all searches, and sum up the maxima that they found."""
    searches: list[Search] = []
    for done, task in enumerate(under_way.searches, 1):
        searches += task.result()
        report.update(done / (len(under_way.searches) + 1), SEARCHING)
    report.update(0.0, "looking for other maxima")
    scouted = [task.result() for task in under_way.scouts]
    found = crew.submit(mode_search.summarise, tuple(searches), scouted).result()
    report.update(1.0, "")
    return found


def sample_maxima(
    crew: Crew, found: Mode, plan: FitPlan, shelf: Shelf, report: Reporter
) -> Sampled:
    """Sample ensembles about all maxima `found`, in whose steps the crew is, and weigh what they say.

    Raises `Nowhere` where nothing can be sampled.
    """
    posterior, chains = crew.posterior, plan.chains
    maxima = mode_search.tops(posterior, found)
    sampled = sample(crew, posterior, maxima, chains, shelf, report).doubted(found.doubts)
    if plan.brief:
        return sampled
    report.update(0.0, "computing the evidence")
    sampled = weighed(posterior, sampled, chains.seed)
    report.update(1.0, "")
    return with_open_ends(sampled, posterior, plan.nominal, maxima, chains, report)


def _first_arrived(posterior: Posterior, plan: FitPlan) -> list[Search]:
    """Search from the most promising starts, until one search is seen to have arrived.

    That is when two agree, or one leaves no more residuals than known noise explains: maxima that
    are somewhere else are for scouts to find.
    """
    points = mode_search.starts(posterior, plan.starts, seeds.stream(plan.chains.seed, "map"))
    points = points[np.argsort(-posterior.density(points), kind="stable")]
    likelihood = posterior.likelihood
    known = not any(one.unknowns for one in likelihood.observations)
    noise_alone = 1.0 + np.sqrt(2.0 / likelihood.n_measured)  # squares over the noise, on average
    found: list[Search] = []
    for point in points:
        found.append(mode_search.search(posterior, plan.optimiser, plan.evaluations, point))
        best = max(found, key=lambda search: search.log_posterior)
        near = best.log_posterior - mode_search.SAME_LOG_DENSITY
        if sum(search.log_posterior > near for search in found) >= 2:
            break
        end = posterior.space.vector(best.end)
        if known and laplace.residual_excess(posterior, end) <= noise_alone:
            break
    return [best]
