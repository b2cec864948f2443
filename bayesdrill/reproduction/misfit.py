"""The paper's misfit: what its searches lower, and how much of it is left per measured number."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from bayesdrill import mode
from bayesdrill.optimisers.contract import Task
from bayesdrill.posterior import Posterior

Array = NDArray[np.float64]


def task(posterior: Posterior) -> Task:
    """The likelihood alone, where the priors have a density: they bound a search, no more."""

    def density(theta: Array) -> Array:
        both = posterior.density(theta)
        inside = both > -np.inf
        both[inside] -= posterior.space.log_prior(theta)[inside]
        return both

    return dataclasses.replace(mode.task(posterior), density=density)


def per_number(posterior: Posterior, theta: Array) -> float:
    """The misfit at `theta (D,)` over the count of what was measured: 1 where only noise is left."""
    likelihood = posterior.likelihood
    sigma = likelihood.noise.sigmas(likelihood.sigma_columns(theta[None]))
    squares = likelihood.response.misfit(posterior.space.full(theta[None]))
    return float(np.mean(squares / sigma**2)) / likelihood.noise.n_samples
