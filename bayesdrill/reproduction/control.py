"""The control of the heuristic: records of the rig that is searched from, and what it makes of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesdrill.crew import Crew
from bayesdrill.optimisers.contract import Optimiser
from bayesdrill.posterior import Posterior
from bayesdrill.reproduction import misfit
from bayesdrill.reproduction.verification import record

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Control:
    """Largest distance of the estimates of a parameter from its true value."""

    parameter: str
    largest_percent: float
    records: int


def control(
    crew: Crew,
    posterior: Posterior,
    optimiser: Optimiser,
    evaluations: int,
    records: int,
    seed: int,
) -> tuple[Control, ...]:
    """Of records made at the configured start, which the search begins at too."""
    truth = posterior.space.vector(posterior.space.start)
    tasks = [crew.submit(_estimate, optimiser, evaluations, truth, seed, k) for k in range(records)]
    found = np.array([task.result() for task in tasks])
    largest = 100 * np.abs(found / truth - 1).max(axis=0)
    return tuple(
        Control(parameter=name, largest_percent=float(off), records=records)
        for name, off in zip(posterior.space.free, largest, strict=True)
    )


def _estimate(
    posterior: Posterior,
    optimiser: Optimiser,
    evaluations: int,
    truth: Array,
    seed: int,
    index: int,
) -> Array:
    target = record(posterior, truth, seed, index)
    return optimiser(misfit.task(target), truth, evaluations).theta
