"""All unknowns at once from many starts, the paper's pairwise heuristic, its control, and Table 2.

An exact symmetry leaves the misfit as it is, so that a search may end anywhere along it.  An end is
as far from the truth as the logs of its unknowns; that distance has a part along each symmetry,
which no misfit can show, and the rest.

Table 2, with what it leaves out: how good an estimate can be.  Records of the nominal rig with noise
of several sizes, and two ways to the least misfit: Nelder-Mead as fminsearch runs it, and scaled.
Estimates are free, as the paper's are: no prior holds them, not even above zero.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace

import numpy as np

from bayesdrill.analysis import Exponents
from bayesdrill.basics import Array, Silent, seeds
from bayesdrill.inference import Coordinates, Posterior, laplace
from bayesdrill.sampling import (
    MemoryBackend,
    Optimum,
    Plan,
    Task,
    WorkerPool,
    mode_search,
    sample,
)
from studies.paper import forward, precision
from studies.paper.optimisers import TracedOptimum
from studies.paper.precision import SCALED, WAYS, bounds
from studies.paper.printed import Row

EVALUATIONS = 8000
SAME = 4.0  # of the paper's misfit: ends nearer to the least one are equally good
WITHIN = 0.5  # starts are drawn from 1 - this to 1 + this of the configured one


@dataclass(frozen=True, slots=True)
class MisfitSearch[R: Optimum]:
    """A search for the least misfit; `stepped`: in that which the paper's integrator has."""

    optimiser: Callable[[Task, Array, int], Sequence[R]]
    evaluations: int
    stepped: bool = False

    def __call__(self, posterior: Posterior, point: Array) -> R:
        """Search from `point (D,)`."""
        task = precision.misfit_task(posterior)
        if self.stepped:
            task = forward.stepped_task(task, posterior.likelihood)
        return self.optimiser(task, point[None], self.evaluations)[0]


def _of_record(
    posterior: Posterior,
    search: MisfitSearch[Optimum],
    truth: Array,
    sigma: float,
    seed: int,
    index: int,
) -> Array:
    """The estimate `(D,)` from a record that is made at `truth`, where the search begins too."""
    target = precision.made_record(precision.with_sigma(posterior, sigma), truth, seed, index)
    return search(target, truth).theta


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchEnd:
    """The end of one search; `misfit`: per measured number (1: the noise)."""

    way: str
    misfit: float
    reached: bool
    best: bool
    settled: bool
    scales: tuple[float, ...]
    rest: float
    distance: float


def many_searches(
    pool: WorkerPool,
    posterior: Posterior,
    reference: Array,
    symmetries: Sequence[Exponents],
    starts: int,
    seed: int,
) -> tuple[SearchEnd, ...]:
    """Search from the configured start and others around it; distances are from `reference (D,)`."""
    centre = posterior.space.vector(posterior.space.start)
    rng = seeds.stream(seed, "starts")
    around = rng.uniform(1 - WITHIN, 1 + WITHIN, (starts - 1, len(centre)))
    points = np.vstack([centre, centre * around])
    tasks = [
        (way, pool.submit(MisfitSearch(optimiser, EVALUATIONS), point))
        for way, optimiser in precision.WAYS.items()
        for point in points
    ]
    results = [(way, task.result()) for way, task in tasks]
    likelihood = posterior.likelihood
    misfits = likelihood.mean_square(np.array([end.theta for _, end in results]))
    _, floor = precision.expected_misfit(likelihood.n_measured)
    least = misfits.min() + SAME / likelihood.n_measured

    def ended(way: str, end: Optimum, misfit: float) -> SearchEnd:
        scales, remainder, distance = distinct_ends(end.theta, reference, symmetries)
        return SearchEnd(
            way=way,
            misfit=misfit,
            reached=bool(misfit < floor),
            best=bool(misfit < least),
            settled=end.settled,
            scales=scales,
            rest=remainder,
            distance=distance,
        )

    return tuple(ended(*each, x) for each, x in zip(results, misfits.tolist(), strict=True))


def distinct_ends(
    theta: Array, reference: Array, symmetries: Sequence[Exponents]
) -> tuple[tuple[float, ...], float, float]:
    """Return log distances along each symmetry, off them all, and of everything (rms)."""
    logs = np.log(theta / reference)
    rows = np.zeros((len(symmetries), len(theta)))
    for row, exponents in zip(rows, symmetries, strict=True):
        row[: len(exponents)] = exponents  # noise levels have no part in them
    scales = np.linalg.lstsq(rows.T, logs, rcond=None)[0]
    rest = float(np.sqrt(np.mean((logs - scales @ rows) ** 2)))
    return tuple(map(float, scales)), rest, float(np.sqrt(np.mean(logs**2)))


AROUND = 0.2  # other starts are from 1 - this to 1 + this of the configured one


@dataclass(frozen=True, slots=True, kw_only=True)
class Heuristic:
    """The paper's pairwise heuristic on one record.

    `guess`, `estimate` `(D,)` physical; `misfits`: per measured number, at the guess and then after
    each iteration; `others (S, D)`: from other starts; `stepped (D,)` with the paper's integrator and
    its misfit, None with a measured input.
    """

    guess: Array
    estimate: Array
    misfits: Array
    others: Array
    others_misfits: Array
    stepped: Array | None
    stepped_misfit: float | None


def run_heuristic(
    pool: WorkerPool,
    posterior: Posterior,
    search: MisfitSearch[TracedOptimum],
    starts: int,
    seed: int,
) -> Heuristic:
    """Run the heuristic from the configured start, and from `starts` others around it."""
    guess = posterior.space.vector(posterior.space.start)
    rng = seeds.stream(seed, "around")
    around = rng.uniform(1 - AROUND, 1 + AROUND, (starts, len(guess)))
    by_integrator = None
    # All inputs are constant in the paper.  First, because it takes longest.
    if not posterior.likelihood.only_observation.experiment.series:
        by_integrator = pool.submit(replace(search, stepped=True), guess)
    tasks = [pool.submit(search, point) for point in (guess, *(guess * around))]
    first_result, *other_results = [task.result() for task in tasks]
    first = precision.misfit_per_number(posterior, guess)
    # The misfit is -2 log likelihood but for a constant, which the first point tells.
    density = posterior.likelihood(guess[None])[0]
    gains = np.array(first_result.history) - density
    path = first - 2.0 * gains / posterior.likelihood.n_measured
    others = np.array([other.theta for other in other_results]).reshape(starts, len(guess))
    end = None if by_integrator is None else by_integrator.result().theta
    return Heuristic(
        guess=guess,
        estimate=first_result.theta,
        misfits=np.array([first, *path]),
        others=others,
        others_misfits=posterior.likelihood.mean_square(others),
        stepped=end,
        stepped_misfit=None if end is None else forward.stepped_misfit(posterior.likelihood, end),
    )


def control(
    pool: WorkerPool,
    posterior: Posterior,
    search: MisfitSearch[Optimum],
    sigmas: Sequence[float],
    records: int,
    seed: int,
) -> list[Row]:
    """Control the search on records made at the configured start, where it begins too.

    Of each parameter the largest distance of the estimates from its true value; 0: it never moved.
    """
    truth = posterior.space.vector(posterior.space.start)
    tasks = {
        sigma: [pool.submit(_of_record, search, truth, sigma, seed, k) for k in range(records)]
        for sigma in sigmas
    }
    controls: list[Row] = []
    for sigma, futures in tasks.items():
        estimates = np.array([task.result() for task in futures])
        largest = 100 * np.abs(estimates / truth - 1).max(axis=0)
        controls += [
            {"sigma": sigma, "parameter": name, "largest_percent": float(off), "records": records}
            for name, off in zip(posterior.space.free, largest, strict=True)
        ]
    return controls


VERIFICATION_EVALUATIONS = 4000  # of one search, at most
BATCHES = 8  # in which the records of one sigma are shared out


@dataclass(frozen=True, slots=True, kw_only=True)
class Verification:
    """The two-parameter verification of the paper, repeated.

    `values` by sigma and name, `(D,)` of the unknowns `names`, SI; `estimates` by way and sigma:
    `(R, D)`, one row for each record.  Of the first record: `fminsearch`, `scaled`, `posterior` and
    `posterior_sd`; by fminsearch with the paper's integrator, `trapezoid_both` where that made the
    record too, `trapezoid_fit` where the exact response did; without noise, where sigma is but a
    weight, `weights_only` (`weights_only_trapezoid`: the integrator for both).  `bound`: Cramer-Rao,
    of the standard deviation; `sd_*`: of the estimates from all records.
    """

    names: tuple[str, ...]
    records: int
    values: Mapping[float, Mapping[str, Array]]
    estimates: Mapping[str, Mapping[float, Array]]
    converged: bool


def verify(
    pool: WorkerPool,
    posterior: Posterior,
    truth: Array,
    sigmas: Sequence[float],
    records: int,
    plan: Plan,
) -> Verification:
    """Verify estimates on records of `truth (D,)`, physical; the seed of `plan` is theirs too."""
    seed = plan.seed
    tasks: dict[tuple[str, float], list[Future[Array]]] = {
        (way, sigma): [
            pool.submit(estimates, way, sigma, truth, seed, tuple(map(int, batch)))
            for batch in np.array_split(np.arange(records), min(BATCHES, records))
        ]
        for sigma in sigmas
        for way in WAYS
    }
    posteriors = {s: pool.submit(_posterior, s, truth, plan) for s in sigmas}
    by_trapezoid = {
        (name, s): pool.submit(_by_trapezoid, s, truth, seed, **how)
        for s in sigmas
        for name, how in _STEPPED.items()
    }
    estimates_by_way: dict[str, dict[float, Array]] = {
        way: {s: np.concatenate([t.result() for t in tasks[way, s]]) for s in sigmas}
        for way in WAYS
    }
    bound = bounds(posterior.likelihood, truth)
    values: dict[float, dict[str, Array]] = {}
    for sigma in sigmas:
        clean = precision.clean_record(precision.with_sigma(posterior, sigma), truth)
        mean, sd, _ = posteriors[sigma].result()
        values[sigma] = {
            **{way: estimates_by_way[way][sigma][0] for way in WAYS},
            **{name: by_trapezoid[name, sigma].result() for name in _STEPPED},
            "weights_only": _search("fminsearch", clean),
            "posterior": mean,
            "posterior_sd": sd,
            "bound": sigma * bound,
            "truth": truth,
            **{f"sd_{way}": estimates_by_way[way][sigma].std(axis=0, ddof=1) for way in WAYS},
        }
    return Verification(
        names=posterior.space.free,
        records=records,
        values=values,
        estimates=estimates_by_way,
        converged=all(posteriors[sigma].result()[2] for sigma in sigmas),
    )


_STEPPED: Mapping[str, Mapping[str, bool]] = {
    "trapezoid_both": {"from_integrator": True, "noisy": True},
    "trapezoid_fit": {"from_integrator": False, "noisy": True},
    "weights_only_trapezoid": {"from_integrator": True, "noisy": False},
}


def estimates(
    posterior: Posterior, way: str, sigma: float, truth: Array, seed: int, indices: tuple[int, ...]
) -> Array:
    """Return the estimates of the records with these numbers: `(R, D)`."""
    target = precision.with_sigma(posterior, sigma)
    return np.array([_search(way, precision.made_record(target, truth, seed, k)) for k in indices])


def _search(way: str, target: Posterior, *, stepped: bool = False) -> Array:
    """From the start of the space; `stepped`: with the misfit that the paper's integrator has."""
    task, start = _free(target), target.space.vector(target.space.start)
    if stepped:
        task = forward.stepped_task(task, target.likelihood)
    return WAYS[way](task, start[None], VERIFICATION_EVALUATIONS)[0].theta


def _free(target: Posterior) -> Task:
    """The likelihood alone, whatever the signs of the unknowns."""
    plain = replace(target, coordinates=Coordinates((False,) * len(target.space.free)))

    def density(theta: Array) -> Array:
        return np.nan_to_num(target.likelihood(theta), nan=-np.inf, neginf=-np.inf)

    return Task(
        names=target.space.free,
        density=density,
        coordinates=plain.coordinates,
        covariance=lambda theta: laplace.covariance(plain, theta),
    )


def _posterior(
    posterior: Posterior, sigma: float, truth: Array, plan: Plan
) -> tuple[Array, Array, bool]:
    """Mean and standard deviation `(D,)` from record 0, and whether the ensembles converged."""
    target = precision.made_record(precision.with_sigma(posterior, sigma), truth, plan.seed, 0)
    (search,) = mode_search.searches(target, SCALED, VERIFICATION_EVALUATIONS, truth[None])
    with WorkerPool(target, 1) as alone:
        start = target.space.vector(search.end)
        sampled = sample(alone, start[None], plan, MemoryBackend(), Silent())
    draws = sampled.draws.reshape(-1, len(truth))
    return draws.mean(axis=0), draws.std(axis=0, ddof=1), sampled.convergence.converged


def _by_trapezoid(
    posterior: Posterior, sigma: float, truth: Array, seed: int, from_integrator: bool, noisy: bool
) -> Array:
    """The estimate `(D,)` as the paper integrates, from record 0, which it may have made as well."""
    sized = precision.with_sigma(posterior, sigma)
    exact = precision.clean_record(sized, truth)
    target = precision.made_record(sized, truth, seed, 0) if noisy else exact
    if from_integrator:
        drawn, clean = (x.likelihood.only_observation.experiment.y for x in (target, exact))
        stepped = forward.stepped_signals(target.likelihood, truth)
        target = target.edit(records=[drawn - clean + stepped])
    return _search("fminsearch", target, stepped=True)
