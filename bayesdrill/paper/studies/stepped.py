"""The misfit as the paper computes it: with its integrator, at that one's default tolerances."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from bayesdrill.engines import Task
from bayesdrill.inference import Likelihood
from bayesdrill.paper.studies import forward

Array = NDArray[np.float64]


def applies(likelihood: Likelihood) -> bool:
    """Whether all inputs are constant, as in the paper."""
    return not likelihood.response.experiment.series


def signals(likelihood: Likelihood, theta: Array) -> Array:
    """The channels without noise, `(T, K)`, at `theta (D,)`."""
    (full,) = likelihood.space.full(theta[None])
    return forward.signals(likelihood.response.model, likelihood.response.experiment, full)[0]


def per_number(likelihood: Likelihood, theta: Array) -> float:
    """As `Likelihood.per_number`, at one point `(D,)`; for known noise."""
    sigma = likelihood.noise.scales(np.empty((1, 0)))
    off = signals(likelihood, theta) - likelihood.response.experiment.y
    return float(np.mean((off / sigma) ** 2))


def task(exact: Task, likelihood: Likelihood) -> Task:
    """The same task with the integrator's misfit; `exact` says where the density is above zero."""

    def density(theta: Array) -> Array:
        inside = exact.density(theta) > -np.inf
        half = 0.5 * likelihood.numbers
        values = [
            -half * per_number(likelihood, row) if good else -np.inf
            for row, good in zip(theta, inside, strict=True)
        ]
        return np.asarray(np.nan_to_num(values, nan=-np.inf, neginf=-np.inf))

    return dataclasses.replace(exact, density=density)
