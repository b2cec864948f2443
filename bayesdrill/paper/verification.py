"""The paper's verification study (Table 2), with what it leaves out: how good an estimate can be.

A few unknowns, records of the nominal rig with noise of several sizes, and two ways to the least
misfit: Nelder-Mead as fminsearch runs it, and scaled.  Estimates are free, as the paper's are: no
prior holds them, not even above zero.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass

import numpy as np

from bayesdrill.basics import Array, Silent
from bayesdrill.inference import Coordinates, Posterior, laplace
from bayesdrill.paper import forward, precision
from bayesdrill.paper.plugins import Fminsearch
from bayesdrill.paper.precision import WAYS, bounds
from bayesdrill.sampling import THOROUGH, Crew, Memory, Plan, Task, mode_search, sample

EVALUATIONS = 4000  # of one search, at most
BATCHES = 8  # in which the records of one sigma are shared out


@dataclass(frozen=True, slots=True, kw_only=True)
class Cell:
    """One unknown at one sigma, SI.  `bound`: Cramer-Rao, of the standard deviation.

    Of the first record: `fminsearch`, `scaled`; by fminsearch with the paper's integrator for the
    model, `trapezoid_both` where the integrator made the record too, `trapezoid_fit` where the exact
    response did.  `weights_only`: by fminsearch from a record without noise, where sigma is but a
    weight (`weights_only_trapezoid`: with the integrator for both).  `posterior`, `posterior_sd`: of
    the first record, with the priors.  `sd_*`: of the estimates from all records.
    """

    sigma: float
    name: str
    truth: float
    fminsearch: float
    scaled: float
    trapezoid_both: float
    trapezoid_fit: float
    weights_only: float
    weights_only_trapezoid: float
    posterior: float
    posterior_sd: float
    bound: float
    sd_fminsearch: float
    sd_scaled: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Verification:
    """`estimates` by way and sigma: `(R, D)`, one row for each record."""

    names: tuple[str, ...]
    truth: Array
    start: Array
    sigmas: tuple[float, ...]
    records: int
    cells: tuple[Cell, ...]
    estimates: Mapping[str, Mapping[float, Array]]
    converged: bool

    def cell(self, sigma: float, name: str) -> Cell:
        return next(c for c in self.cells if c.sigma == sigma and c.name == name)


def verify(
    crew: Crew,
    posterior: Posterior,
    truth: Array,
    sigmas: Sequence[float],
    records: int,
    plan: Plan,
) -> Verification:
    """`truth (D,)` physical makes the records; the search begins at the start of the space.

    `plan`: how posteriors are sampled; its seed is that of the records too.
    """
    seed = plan.seed
    space = posterior.space
    start = space.vector(space.start)
    tasks: dict[tuple[str, float], list[Future[Array]]] = {
        (way, sigma): [
            crew.submit(estimates, way, sigma, truth, start, seed, tuple(map(int, batch)))
            for batch in np.array_split(np.arange(records), min(BATCHES, records))
        ]
        for sigma in sigmas
        for way in WAYS
    }
    posteriors = {s: crew.submit(_posterior, s, truth, plan) for s in sigmas}
    by_trapezoid = {
        (name, s): crew.submit(_by_trapezoid, s, truth, start, seed, **how)
        for s in sigmas
        for name, how in _STEPPED.items()
    }
    found: dict[str, dict[float, Array]] = {
        way: {s: np.concatenate([t.result() for t in tasks[way, s]]) for s in sigmas}
        for way in WAYS
    }
    one = bounds(posterior.likelihood, truth)
    cells: list[Cell] = []
    for sigma in sigmas:
        clean = precision.clean_record(precision.with_sigma(posterior, sigma), truth)
        mean, sd, _ = posteriors[sigma].result()
        single = {
            **{way: found[way][sigma][0] for way in WAYS},
            **{name: by_trapezoid[name, sigma].result() for name in _STEPPED},
            "weights_only": _search("fminsearch", clean, start),
            "posterior": mean,
            "posterior_sd": sd,
            "bound": sigma * one,
            "truth": truth,
        }
        spread = {f"sd_{way}": found[way][sigma].std(axis=0, ddof=1) for way in WAYS}
        both = {**single, **spread}
        cells += [
            Cell(sigma=sigma, name=name, **{what: float(x[k]) for what, x in both.items()})
            for k, name in enumerate(space.free)
        ]
    return Verification(
        names=space.free,
        truth=truth,
        start=start,
        sigmas=tuple(sigmas),
        records=records,
        cells=tuple(cells),
        estimates=found,
        converged=all(posteriors[sigma].result()[2] for sigma in sigmas),
    )


_STEPPED: Mapping[str, Mapping[str, bool]] = {
    "trapezoid_both": {"own": True, "noisy": True},
    "trapezoid_fit": {"own": False, "noisy": True},
    "weights_only_trapezoid": {"own": True, "noisy": False},
}


def estimates(
    posterior: Posterior,
    way: str,
    sigma: float,
    truth: Array,
    start: Array,
    seed: int,
    indices: tuple[int, ...],
) -> Array:
    """Of the records with these numbers: `(R, D)`."""
    target = precision.with_sigma(posterior, sigma)
    return np.array(
        [_search(way, precision.made_record(target, truth, seed, k), start) for k in indices]
    )


def _search(way: str, target: Posterior, start: Array) -> Array:
    return WAYS[way](_free(target), start, EVALUATIONS).theta


def _free(target: Posterior) -> Task:
    """The likelihood alone, whatever the signs of the unknowns."""
    plain = dataclasses.replace(target, coordinates=Coordinates((False,) * len(target.space.free)))

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
    found = mode_search.search(target, THOROUGH, EVALUATIONS, truth)
    with Crew(target, 1) as alone:
        start = target.space.vector(found.end)
        sampled = sample(alone, target, start[None], plan, Memory(), Silent())
    draws = sampled.draws.reshape(-1, len(truth))
    return draws.mean(axis=0), draws.std(axis=0, ddof=1), sampled.convergence.converged


def _by_trapezoid(
    posterior: Posterior,
    sigma: float,
    truth: Array,
    start: Array,
    seed: int,
    *,
    own: bool,
    noisy: bool,
) -> Array:
    """The estimate from record 0 as the paper integrates: `(D,)`.

    `own`: the record is what that integrator gives; `noisy`: with noise.
    """
    sized = precision.with_sigma(posterior, sigma)
    exact = precision.clean_record(sized, truth)
    target = precision.made_record(sized, truth, seed, 0) if noisy else exact
    if own:
        y = target.likelihood.response.experiment.y - exact.likelihood.response.experiment.y
        stepped = forward.stepped_signals(target.likelihood, truth)
        target = target.edit(records=[y + stepped])
    task = forward.stepped_task(_free(target), target.likelihood)
    return Fminsearch()(task, start, EVALUATIONS).theta
