"""The paper's pairwise heuristic on one record: its path, its estimate, and what its start decides."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesdrill import seeds
from bayesdrill.crew import Crew
from bayesdrill.optimisers.contract import Optimiser
from bayesdrill.posterior import Posterior
from bayesdrill.reproduction import misfit

Array = NDArray[np.float64]

AROUND = 0.2  # other starts are from 1 - this to 1 + this of the configured one


@dataclass(frozen=True, slots=True, kw_only=True)
class Heuristic:
    """`guess`, `estimate` `(D,)` physical; `misfits`: per measured number, at the guess and then after
    each iteration; `others (S, D)`: estimates from other starts, `others_misfits (S,)` theirs.
    """

    guess: Array
    estimate: Array
    misfits: Array
    evaluations: int
    settled: bool
    others: Array
    others_misfits: Array


def run(
    crew: Crew, posterior: Posterior, optimiser: Optimiser, evaluations: int, starts: int, seed: int
) -> Heuristic:
    """From the configured start, and from `starts` others around it."""
    guess = posterior.space.vector(posterior.space.start)
    rng = seeds.stream(seed, "reproduce", 1)
    around = rng.uniform(1 - AROUND, 1 + AROUND, (starts, len(guess)))
    points = [guess, *(guess * around)]
    tasks = [crew.submit(_search, optimiser, evaluations, point) for point in points]
    (estimate, history, spent, settled), *rest = [task.result() for task in tasks]
    first = misfit.per_number(posterior, guess)
    # The misfit is -2 log likelihood but for a constant, which the first point tells.
    density = posterior.likelihood(guess[None])[0]
    numbers = posterior.likelihood.noise.n_samples * posterior.likelihood.noise.n_channels
    path = first - 2.0 * (np.array(history) - density) / numbers
    return Heuristic(
        guess=guess,
        estimate=estimate,
        misfits=np.array([first, *path]),
        evaluations=spent,
        settled=settled,
        others=np.array([found[0] for found in rest]),
        others_misfits=np.array([misfit.per_number(posterior, found[0]) for found in rest]),
    )


def _search(
    posterior: Posterior, optimiser: Optimiser, evaluations: int, point: Array
) -> tuple[Array, tuple[float, ...], int, bool]:
    found = optimiser(misfit.task(posterior), point, evaluations)
    return found.theta, found.history, found.evaluations, found.settled
