"""Nelder-Mead on scaled unknowns, restarted with a fresh simplex until that no longer helps.

Unscaled, the simplex stops where it likes: a damping of 1e-4 equals the usual absolute tolerance
on the parameters.  Here a unit step is one standard deviation of the local Gaussian approximation,
and the tolerances are in units of it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from bayesdrill import laplace
from bayesdrill.optimisers.contract import Optimum

Array = NDArray[np.float64]

LOG_TOLERANCE = 1e-3  # of the log density: what a restart must gain to be followed by another
MOST_STEP = 0.3  # first steps of the simplex, in a log: far from the optimum the scales mislead


def maximise(
    target: Callable[[Array], Array],
    start: Array,
    scale: Callable[[Array], Array],
    evaluations: int,
) -> Optimum:
    """See `optimisers.contract.Optimiser`."""
    from scipy.optimize import minimize  # late: 0.3 s, and most commands do not optimise

    z, value, spent, settled = start, float(target(start[None])[0]), 0, False
    while not settled and spent < evaluations:
        root = _steps(scale(z))
        result = minimize(
            lambda s, z=z, root=root: -float(target((z + root @ s)[None])[0]),
            np.zeros(len(z)),
            method="Nelder-Mead",
            options={
                "initial_simplex": np.vstack([np.zeros(len(z)), np.eye(len(z))]),
                "xatol": 1e-2,
                "fatol": 0.1 * LOG_TOLERANCE,
                "maxfev": min(evaluations - spent, 400 * len(z)),
                "adaptive": len(z) > 2,
            },
        )
        spent += int(result.nfev)
        gain = -float(result.fun) - value
        if gain > 0:
            z, value = z + root @ result.x, -float(result.fun)
        settled = gain < LOG_TOLERANCE
    return Optimum(z=z, value=value, evaluations=spent, settled=settled)


def _steps(covariance: Array) -> Array:
    """Columns: the principal directions, one standard deviation long but no longer than a cap."""
    columns = laplace.root(covariance)
    longest = np.abs(columns).max(axis=0)
    return np.asarray(columns * np.minimum(1.0, MOST_STEP / longest))
