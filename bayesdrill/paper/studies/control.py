"""The control of the heuristic: records of the rig that is searched from, and what it makes of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesdrill.engines import Crew, Optimiser
from bayesdrill.inference import Posterior
from bayesdrill.paper.studies import made, misfit

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Control:
    """Largest distance of the estimates of a parameter from its true value; 0: it never moved."""

    sigma: float
    parameter: str
    largest_percent: float
    records: int


def control(
    crew: Crew,
    posterior: Posterior,
    optimiser: Optimiser,
    evaluations: int,
    sigmas: Sequence[float],
    records: int,
    seed: int,
) -> tuple[Control, ...]:
    """Of records made at the configured start, which the search begins at too, by noise."""
    truth = posterior.space.vector(posterior.space.start)
    tasks = {
        sigma: [
            crew.submit(_estimate, optimiser, evaluations, truth, sigma, seed, k)
            for k in range(records)
        ]
        for sigma in sigmas
    }
    found = []
    for sigma, own in tasks.items():
        estimates = np.array([task.result() for task in own])
        largest = 100 * np.abs(estimates / truth - 1).max(axis=0)
        found += [
            Control(sigma=sigma, parameter=name, largest_percent=float(off), records=records)
            for name, off in zip(posterior.space.free, largest, strict=True)
        ]
    return tuple(found)


def _estimate(
    posterior: Posterior,
    optimiser: Optimiser,
    evaluations: int,
    truth: Array,
    sigma: float,
    seed: int,
    index: int,
) -> Array:
    target = made.record(made.with_sigma(posterior, sigma), truth, seed, index)
    return optimiser(misfit.task(target), truth, evaluations).theta
