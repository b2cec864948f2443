"""One refit: unknowns from the prior, a record of them, its posterior, the ranks of the truth.

`refit` is a function of the study and the index alone: it can run anywhere, and run again.
"""

from __future__ import annotations

import dataclasses
import functools
import pickle
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from bayesdrill.basics import seeds, software
from bayesdrill.basics.errors import InputError
from bayesdrill.basics.progress import SILENT
from bayesdrill.engines import mode
from bayesdrill.engines.optimisers.contract import Optimiser
from bayesdrill.engines.sampling import Plan, Sampled, sample
from bayesdrill.engines.shelf import Memory
from bayesdrill.engines.workers import Crew
from bayesdrill.inference import laplace, pieces
from bayesdrill.inference.posterior import Posterior
from bayesdrill.insight.calibration.ranks import rank

Array = NDArray[np.float64]

FIT = "log likelihood"  # the quantity that depends on the record (Modrak et al. 2023)
TRIES = 1000  # draws from the prior until the model has a finite response


@dataclass(frozen=True, slots=True, kw_only=True)
class Study:
    """What is repeated: `posterior` without its record, how its mode is sought and it is sampled.

    `draws`: L, among which the truth is ranked; `starts`: searches for the mode, at most.
    """

    posterior: Posterior
    optimiser: Optimiser
    starts: int
    evaluations: int
    plan: Plan
    draws: int
    seed: int

    @property
    def names(self) -> tuple[str, ...]:
        """Of the quantities that are ranked."""
        return (*self.posterior.space.free, FIT)


@dataclass(frozen=True, slots=True, kw_only=True)
class Refit:
    """`truth` and `ranks` in the order of `Study.names`; no ranks where nothing could be sampled.

    `reasons`: why it has not converged; `seconds` it took, which is no part of the result.
    """

    index: int
    truth: tuple[float, ...]
    ranks: tuple[int, ...]
    r_hat: float
    ess: float
    steps: int
    reasons: tuple[str, ...]
    seconds: float = field(compare=False)

    @property
    def converged(self) -> bool:
        return not self.reasons


def refit(study: Study, index: int) -> Refit:
    """Refit `index`, counted from 0; the truth is used to make the record and to be ranked."""
    begun = time.perf_counter()
    rng = seeds.stream(study.seed, "calibrate", index)
    theta, posterior = _simulated(study.posterior, rng)
    seed = int(rng.integers(2**32))
    truth = np.array([*theta, posterior.likelihood(theta[None])[0]])
    found = Refit(
        index=index,
        truth=tuple(map(float, truth)),
        ranks=(),
        r_hat=np.inf,
        ess=0.0,
        steps=0,
        reasons=(),
        seconds=0.0,
    )
    try:
        _, sampled = fitted(study, posterior, seed)
    except ValueError as error:  # numbers fail far from any reasonable record
        found = dataclasses.replace(found, reasons=(f"nothing could be sampled: {error}",))
    else:
        found = dataclasses.replace(
            found,
            ranks=_ranks(study, posterior, truth, sampled, rng),
            r_hat=float(sampled.convergence.r_hat.max()),
            ess=float(sampled.convergence.ess_bulk.min()),
            steps=sampled.convergence.steps,
            reasons=sampled.convergence.reasons,
        )
    return dataclasses.replace(found, seconds=time.perf_counter() - begun)


def _simulated(posterior: Posterior, rng: np.random.Generator) -> tuple[Array, Posterior]:
    """Unknowns `(D,)` from the prior, and the posterior of a record that they made."""
    likelihood = posterior.likelihood
    for _ in range(TRIES):
        theta = posterior.space.draw(1, rng)
        signals = likelihood.every_signal(theta)
        # Where the model overflows the posterior is zero: such unknowns are no part of the prior.
        if all(np.all(np.isfinite(each)) for each in signals):
            break
    else:
        message = f"the model has no finite response at {TRIES} draws from the priors; narrow them"
        raise InputError.one("parameters", message)
    made = [
        one.with_record(one.draw(each, theta, rng)[0])
        for one, each in zip(likelihood.observations, signals, strict=True)
    ]
    simulated = dataclasses.replace(likelihood, observations=tuple(made))
    return theta[0], dataclasses.replace(posterior, likelihood=simulated)


def fitted(study: Study, posterior: Posterior, seed: int) -> tuple[mode.Mode, Sampled]:
    """From all maxima that are found, as a posterior of its own is."""
    draws = posterior.space.draw(mode.SCOUTS, seeds.stream(seed, "scout"))
    scouted = mode.scouts(posterior, draws)
    found = mode.summarise(posterior, (_best(study, posterior, seed),), scouted)
    tops = mode.tops(posterior, found)
    posterior = pieces.taking(posterior, found.pieces)
    plan = dataclasses.replace(study.plan, seed=seed)
    with Crew(posterior, 1) as crew:
        sampled = sample(crew, posterior, tops, plan, Memory(), SILENT)
        return found, sampled.doubted(found.doubts)


def _best(study: Study, posterior: Posterior, seed: int) -> mode.Search:
    """Searches from the most promising starts, until one is seen to have arrived.

    That is when two agree, or one leaves no more residuals than known noise explains: maxima that
    are somewhere else are for scouts to find.
    """
    points = mode.starts(posterior, study.starts, seeds.stream(seed, "map"))
    points = points[np.argsort(-posterior.density(points), kind="stable")]
    found: list[mode.Search] = []
    for point in points:
        found.append(mode.search(posterior, study.optimiser, study.evaluations, point))
        best = max(found, key=lambda search: search.log_posterior)
        near = best.log_posterior - mode.SAME_LOG_DENSITY
        if sum(search.log_posterior > near for search in found) >= 2:
            break
        if _explained(posterior, posterior.space.vector(best.end)):
            break
    return best


def _explained(posterior: Posterior, theta: Array) -> bool:
    """Whether the noise, where all of it is known, explains what `theta (D,)` leaves."""
    likelihood = posterior.likelihood
    known = not any(one.unknowns for one in likelihood.observations)
    return known and laplace.excess(posterior, theta) <= 1.0 + np.sqrt(2.0 / likelihood.numbers)


def _ranks(
    study: Study, posterior: Posterior, truth: Array, sampled: Sampled, rng: np.random.Generator
) -> tuple[int, ...]:
    """Among L of the nearly independent draws, picked at random."""
    pool = sampled.draws.reshape(-1, len(truth) - 1)
    draws = pool[rng.choice(len(pool), study.draws, replace=len(pool) < study.draws)]
    values = np.column_stack([draws, posterior.likelihood(draws)])
    return tuple(rank(x, column, rng) for x, column in zip(truth, values.T, strict=True))


# A process computes one refit at a time, whoever asks: limits on threads hold for all of it.
_ONE_AT_A_TIME = threading.Lock()


def packed(study: Study) -> bytes:
    """What `work` wants: compiled code is left out, and is made once by each process."""
    return pickle.dumps(study)


_unpacked = functools.lru_cache(maxsize=1)(pickle.loads)


def same_software(versions: Mapping[str, str]) -> None:
    """Raises `InputError` where this process has another."""
    if wrong := software.unlike(software.versions(), versions):
        raise InputError.one("a worker", f"it has {', '.join(wrong)}; install the same there")


def work(packed: bytes, versions: Mapping[str, str], index: int) -> Refit:
    """A task for any process that has the same software; raises `InputError` in any other."""
    same_software(versions)
    with _ONE_AT_A_TIME, threadpool_limits(1):
        return refit(_unpacked(packed), index)
