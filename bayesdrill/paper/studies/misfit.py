"""The paper's misfit: what its searches lower, in which ways, and how much of it noise leaves."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from bayesdrill.engines import THOROUGH, Optimiser, Task, mode
from bayesdrill.inference import Posterior
from bayesdrill.paper.searches.fminsearch import Fminsearch

Array = NDArray[np.float64]

WAYS: Mapping[str, Optimiser] = {
    "fminsearch": Fminsearch(),
    "scaled": THOROUGH,
}
SHARE = 0.95  # of records have a misfit within `expected` at their truth


def task(posterior: Posterior) -> Task:
    """The likelihood alone, where the priors have a density: they bound a search, no more."""
    whole = mode.task(posterior)

    def density(theta: Array) -> Array:
        both = whole.density(theta)
        inside = both > -np.inf
        both[inside] -= posterior.space.log_prior(theta)[inside]
        return both

    return dataclasses.replace(whole, density=density)


def per_number(posterior: Posterior, theta: Array) -> float:
    """The misfit at `theta (D,)` over the count of what was measured: 1 where only noise is left."""
    return float(posterior.likelihood.per_number(theta[None])[0])


def expected(numbers: int) -> tuple[float, float]:
    """Where the misfit per number is at the truth, in all but one of twenty records."""
    low, high = chi2.ppf([0.5 - 0.5 * SHARE, 0.5 + 0.5 * SHARE], numbers) / numbers
    return float(low), float(high)
