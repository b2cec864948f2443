"""The paper's pairwise heuristic on one record: its path, its estimate, and what its start decides."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesdrill.basics import seeds
from bayesdrill.engines import Crew, Optimiser, Optimum
from bayesdrill.inference import Posterior
from bayesdrill.paper.studies import misfit, stepped

Array = NDArray[np.float64]

AROUND = 0.2  # other starts are from 1 - this to 1 + this of the configured one


@dataclass(frozen=True, slots=True, kw_only=True)
class Heuristic:
    """`guess`, `estimate` `(D,)` physical; `misfits`: per measured number, at the guess and then after
    each iteration; `others (S, D)`: estimates from other starts, `others_misfits (S,)` theirs;
    `stepped (D,)`: the estimate with the paper's integrator, whose misfit it is that `stepped_misfit`
    tells; None with a measured input, which the paper does not have.
    """

    guess: Array
    estimate: Array
    misfits: Array
    others: Array
    others_misfits: Array
    stepped: Array | None
    stepped_misfit: float | None


def run(
    crew: Crew, posterior: Posterior, optimiser: Optimiser, evaluations: int, starts: int, seed: int
) -> Heuristic:
    """From the configured start, and from `starts` others around it."""
    guess = posterior.space.vector(posterior.space.start)
    rng = seeds.stream(seed, "around")
    around = rng.uniform(1 - AROUND, 1 + AROUND, (starts, len(guess)))
    by_integrator = None
    if stepped.applies(posterior.likelihood):  # first, because it takes longest
        by_integrator = crew.submit(_search_stepped, optimiser, evaluations, guess)
    points = [guess, *(guess * around)]
    tasks = [crew.submit(_search, optimiser, evaluations, point) for point in points]
    found, *rest = [task.result() for task in tasks]
    first = misfit.per_number(posterior, guess)
    # The misfit is -2 log likelihood but for a constant, which the first point tells.
    density = posterior.likelihood(guess[None])[0]
    path = first - 2.0 * (np.array(found.history) - density) / posterior.likelihood.numbers
    others = np.array([other.theta for other in rest]).reshape(starts, len(guess))
    end = None if by_integrator is None else by_integrator.result().theta
    return Heuristic(
        guess=guess,
        estimate=found.theta,
        misfits=np.array([first, *path]),
        others=others,
        others_misfits=posterior.likelihood.per_number(others),
        stepped=end,
        stepped_misfit=None if end is None else stepped.per_number(posterior.likelihood, end),
    )


def _search(posterior: Posterior, optimiser: Optimiser, evaluations: int, point: Array) -> Optimum:
    return optimiser(misfit.task(posterior), point, evaluations)


def _search_stepped(
    posterior: Posterior, optimiser: Optimiser, evaluations: int, point: Array
) -> Optimum:
    task = stepped.task(misfit.task(posterior), posterior.likelihood)
    return optimiser(task, point, evaluations)
