"""Nelder-Mead on scaled unknowns, restarted with a fresh simplex until that no longer helps.

Unscaled, the simplex stops where it likes: a damping of 1e-4 equals the usual absolute tolerance
on the parameters.  Here a step is a tenth of each unknown as long as much is gained, and then one
standard deviation of the local Gaussian approximation, which misleads far from the optimum; the
tolerances are in units of the step.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from bayesdrill.engines.optimisers.contract import Optimum, Task
from bayesdrill.engines.optimisers.simplex import descend
from bayesdrill.inference import laplace

Array = NDArray[np.float64]

LOG_TOLERANCE = 1e-3  # of the log density: what a restart must gain to be followed by another
MOST_STEP = 0.3  # of a standard deviation, in a log: where the record says little it is long
FAR = 100.0  # of the log density: a run that gained more was far from the optimum ...
TENTH = 0.1  # ... and there first steps of the simplex are this, in a log of each unknown


def maximise(
    task: Task, start: Array, evaluations: int, *, enough: float = LOG_TOLERANCE
) -> Optimum:
    """See `optimisers.contract.Optimiser`; a restart that gains less than `enough` is the last."""
    physical = task.coordinates.to_physical
    z, spent = task.coordinates.from_physical(start[None])[0], 0
    history: list[float] = []
    gain, done = np.inf, False
    while not done and spent < evaluations:
        root = _steps(task, physical(z[None])[0], far=gain > FAR)
        run = descend(
            partial(_lost, task, z, root),
            np.zeros(len(z)),
            initial_simplex=np.vstack([np.zeros(len(z)), np.eye(len(z))]),
            xatol=1e-2,
            fatol=0.1 * enough,
            maxfev=min(evaluations - spent, 400 * len(z)),
            adaptive=len(z) > 2,
        )
        spent += run.evaluations
        gain = run.first - run.lowest
        if gain > 0:
            z = z + root @ run.x
        done = gain < enough
        history += [-low for low in run.history]
    return Optimum(
        theta=physical(z[None])[0],
        value=-run.lowest,
        evaluations=spent,
        settled=done and run.stopped,
        history=tuple(history),
    )


def _lost(task: Task, z: Array, root: Array, steps: Array) -> float:
    return -task.at(task.coordinates.to_physical((z + root @ steps)[None])[0])


def _steps(task: Task, theta: Array, *, far: bool) -> Array:
    """Columns: first steps of the simplex, in the coordinates of the search."""
    if far:
        return TENTH * laplace.slopes_by_logs(task.coordinates, theta)
    columns = laplace.root(task.covariance(theta))
    longest = np.abs(columns).max(axis=0)
    return np.asarray(columns * np.minimum(1.0, MOST_STEP / longest))
