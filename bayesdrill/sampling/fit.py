"""Fit a posterior: find its maxima, sample ensembles about them, and estimate the evidence.

Jobs, notebooks, remote workers and refits of a calibration all use these functions, with the same
streams of random numbers for the same purposes.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bayesdrill.basics import seeds
from bayesdrill.basics.arrays import Array
from bayesdrill.basics.progress import SILENT, Reporter
from bayesdrill.inference import compression, laplace
from bayesdrill.inference.posterior import Posterior
from bayesdrill.rig.simulators import COMPRESSED_FROM
from bayesdrill.sampling import mode_search
from bayesdrill.sampling.ensembles import (
    Backend,
    MemoryBackend,
    Plan,
    SamplingResult,
    sample,
    with_evidence,
)
from bayesdrill.sampling.mode_search import Mode, Search
from bayesdrill.sampling.optimisers.contract import Optimiser
from bayesdrill.sampling.workers import WorkerPool

SEARCHING = "searching the MAP"
CHECKED_DRAWS = 500  # draws at which a compressed likelihood is compared with the exact one
TASKS_PER_SEARCH = 2  # tasks that share the starts: few, as a batch costs hardly more than a start
BATCHES_PER_START = 2000  # number of batches of random points that take as long as one search
WORKERS_START = 1.5  # seconds until workers begin to compute


@dataclass(frozen=True, slots=True, kw_only=True)
class FitPlan:
    """A plan says how a posterior is fitted.

    The `optimiser` searches for the MAP from `starts`, with at most `evaluations` each.  `chains` are
    the settings of the ensembles.  Records with more than `max_exact` samples are compressed; if it
    is None, no record is.  A `brief` fit stops after one converged search, without evidence.
    """

    optimiser: Optimiser
    starts: int
    evaluations: int
    chains: Plan
    brief: bool = False
    max_exact: int | None = COMPRESSED_FROM


@dataclass(frozen=True, slots=True)
class PendingSearches:
    """Searches for the MAP and for other maxima are running.

    `excerpt` is the posterior of the first samples of long records, if the searches use it.
    """

    searches: list[Future[list[Search]]]
    multi_starts: list[Future[tuple[Array, Array]]]
    excerpt: Posterior | None = None


def fit(posterior: Posterior, plan: FitPlan) -> tuple[Mode, SamplingResult]:
    """Fit a posterior in this process; raise `NoSupportError` if it cannot be sampled."""
    with WorkerPool(posterior, 1) as pool:
        mode = end_searches(pool, begin_searches(pool, plan, SILENT), SILENT)
        pool.set_steps(mode.pieces)
        sampled = sample_maxima(pool, mode, plan, MemoryBackend(), SILENT)
        return mode, sampled if plan.brief else weigh(pool, sampled, plan, SILENT)


def searching_processes(posterior: Posterior, plan: FitPlan, processes: int) -> int:
    """Return 1 if searches end before workers could help, otherwise `processes`.

    The duration of the searches is estimated from the time that a batch of densities takes.
    """
    if processes == 1:
        return 1
    searched = _excerpt(posterior, plan) or posterior
    points = searched.space.draw(mode_search.MULTI_STARTS, seeds.stream(plan.chains.seed, "scout"))
    searched.density(points)  # loads the kernels, or compiles them
    begun = time.perf_counter()
    searched.density(points)
    seconds = (time.perf_counter() - begun) * BATCHES_PER_START * plan.starts
    return processes if seconds * (1 - 1 / processes) > WORKERS_START else 1


def _excerpt(posterior: Posterior, plan: FitPlan) -> Posterior | None:
    """Return the posterior of the first samples of long records, or None to search all samples."""
    return None if plan.max_exact is None else compression.excerpt(posterior)


def begin_searches(pool: WorkerPool, plan: FitPlan, report: Reporter) -> PendingSearches:
    """Submit all searches; a pool without workers runs them immediately."""
    seed = plan.chains.seed
    excerpt = _excerpt(pool.posterior, plan)
    posterior = pool.posterior if excerpt is None else excerpt

    def submit(function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        if excerpt is None:
            return pool.submit(function, *arguments)
        return pool.submit_function(function, excerpt, *arguments)

    draws = posterior.space.draw(mode_search.MULTI_STARTS, seeds.stream(seed, "scout"))
    if plan.brief:
        search, scout = submit(_first_converged, plan), submit(mode_search.multi_start, draws)
        return PendingSearches([search], [scout], excerpt)
    points = mode_search.starts(posterior, plan.starts, seeds.stream(seed, "map"))
    report.update(0.0, SEARCHING)
    searches = [
        submit(mode_search.searches, plan.optimiser, plan.evaluations, part)
        for part in np.array_split(points, TASKS_PER_SEARCH)
        if len(part)
    ]
    scouts = [
        submit(mode_search.multi_start, part) for part in np.array_split(draws, TASKS_PER_SEARCH)
    ]
    return PendingSearches(searches, scouts, excerpt)


def end_searches(pool: WorkerPool, under_way: PendingSearches, report: Reporter) -> Mode:
    """Wait for all searches, and summarise the maxima that they have reached."""
    searches: list[Search] = []
    for done, task in enumerate(under_way.searches, 1):
        searches += task.result()
        report.update(done / (len(under_way.searches) + 1), SEARCHING)
    report.update(0.0, "looking for other maxima")
    scouted = [task.result() for task in under_way.multi_starts]
    if under_way.excerpt is not None:
        mode = _searched_on(pool, under_way.excerpt, searches, scouted)
    else:
        mode = pool.submit(mode_search.summarise, tuple(searches), scouted).result()
    report.update(1.0, "")
    return mode


def _searched_on(
    pool: WorkerPool, excerpt: Posterior, searches: list[Search], scouted: list[tuple[Array, Array]]
) -> Mode:
    """Climb from the maxima of an `excerpt` to those of whole records; search for no others.

    A longer excerpt is searched first if a record cannot be compressed about these maxima.
    """
    first = pool.submit_function(mode_search.summarise, excerpt, tuple(searches), scouted).result()
    maxima, heights = mode_search.modes(excerpt, first), [m.log_posterior for m in first.maxima]
    relevant = maxima[np.array(heights) > heights[0] - compression.DEPTH]
    points = compression.points_about(excerpt, relevant)
    known = compression.compressions(pool.posterior, points)
    longer = compression.longer_excerpt(pool.posterior, excerpt, known)
    if longer is not None:
        ends = pool.submit_function(mode_search.polished_again, longer, searches)
        around = pool.submit_function(mode_search.multi_start, longer, relevant)
        return _searched_on(pool, longer, ends.result(), [around.result()])
    pool.compress(known)
    searches = pool.submit(mode_search.polished_again, searches).result()
    others = pool.submit(mode_search.multi_start, relevant).result()
    mode = pool.submit(mode_search.summarise, tuple(searches), [others], around=False).result()
    return replace(mode, left_out=first.left_out)


def compress_about(pool: WorkerPool, mode: Mode, max_exact: int | None) -> None:
    """Compress records with more than `max_exact` samples, for parameters near the maximum.

    If `max_exact` is zero, a record that cannot be compressed raises `CompressionError`.
    """
    posterior = pool.posterior
    observations = posterior.likelihood.observations
    if max_exact is not None and any(compression.is_long(o, max_exact) for o in observations):
        # Uncompressed records are used, so that a resumed run has the same basis functions.
        exact = compression.uncompressed(posterior)
        points = compression.points_about(exact, posterior.space.vector(mode.values)[None])
        strict = max_exact == 0
        pool.compress(compression.compressions(posterior, points, max_exact, strict=strict))


def sample_maxima(
    pool: WorkerPool, mode: Mode, plan: FitPlan, backend: Backend, report: Reporter
) -> SamplingResult:
    """Sample ensembles about all maxima of `mode`.

    Workers already use the step sizes `mode.pieces`.  Raises `NoSupportError` if no walker can start.
    """
    compress_about(pool, mode, plan.max_exact)
    maxima = mode_search.modes(pool.posterior, mode)
    return sample(pool, maxima, plan.chains, backend, report).with_reasons(mode.doubts)


def weigh(
    pool: WorkerPool, sampled: SamplingResult, plan: FitPlan, report: Reporter
) -> SamplingResult:
    """Return a copy with the evidence, and with the check of a compressed likelihood."""
    posterior = pool.posterior
    report.update(0.0, "computing the evidence")
    sampled = with_evidence(posterior, sampled, plan.chains.seed)
    draws = sampled.draws.reshape(-1, sampled.draws.shape[-1])
    thinned = draws[:: max(1, len(draws) // CHECKED_DRAWS)][:CHECKED_DRAWS]
    sampled = replace(sampled, compression=compression.check_draws(posterior, thinned))
    report.update(1.0, "")
    return sampled


def _first_converged(posterior: Posterior, plan: FitPlan) -> list[Search]:
    """Search from the most promising starts, until one search has converged.

    It has converged if a second search is as high, or if known noise explains the residuals.
    """
    points = mode_search.starts(posterior, plan.starts, seeds.stream(plan.chains.seed, "map"))
    points = points[np.argsort(-posterior.density(points), kind="stable")]
    likelihood = posterior.likelihood
    known = not any(observation.unknowns for observation in likelihood.observations)
    noise_alone = 1.0 + np.sqrt(2.0 / likelihood.n_measured)  # limit of mean square / variance
    searches: list[Search] = []
    for point in points:
        settings = plan.optimiser, plan.evaluations
        searches += mode_search.searches(posterior, *settings, point[None])
        best = max(searches, key=lambda search: search.log_posterior)
        lowest = best.log_posterior - mode_search.SAME_LOG_DENSITY
        if sum(search.log_posterior > lowest for search in searches) >= 2:
            break
        end = posterior.space.vector(best.end)
        if known and laplace.residual_excess(posterior, end) <= noise_alone:
            break
    return [best]
