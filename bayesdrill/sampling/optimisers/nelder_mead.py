"""Nelder-Mead on scaled unknowns, restarted with a fresh simplex until that no longer helps.

Unscaled, the simplex stops where it likes: a damping of 1e-4 equals the usual absolute tolerance
on the parameters.  Here a step is a tenth of each unknown as long as much is gained, and then one
standard deviation of the local Gaussian approximation, which misleads far from the optimum; the
tolerances are in units of the step.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.inference import laplace
from bayesdrill.sampling.optimisers.contract import Optimum, Task


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """`first`: the value at the start; `history`: the lowest value after each iteration; `stopped`: by
    its tolerances.
    """

    x: Array
    first: float
    lowest: float
    evaluations: int
    stopped: bool
    history: tuple[float, ...]


def descend(function: Callable[[Array], float], start: Array, **options: Any) -> Run:
    """Minimise `function` from `start (D,)`; `options` are those of SciPy's Nelder-Mead.

    SciPy's own first simplex is that of MATLAB's fminsearch, each coordinate 5 % larger by turns, and
    to set it up counts as the first iteration in both.
    """
    from scipy.optimize import OptimizeResult, minimize  # late: 0.3 s, and few commands optimise

    values: list[float] = []
    history: list[float] = []
    best, lowest = start, np.inf

    # SciPy may forget the best point, if it finds that in an iteration that `maxfev` cuts.
    def noted(x: Array) -> float:
        nonlocal best, lowest
        values.append(function(x))
        if values[-1] < lowest:
            best, lowest = x, values[-1]
        return values[-1]

    def note(intermediate_result: OptimizeResult) -> None:
        history.append(lowest)

    with np.errstate(invalid="ignore"):  # where all of a simplex is impossible
        found = minimize(noted, start, method="Nelder-Mead", callback=note, options=options)
    return Run(
        x=best if lowest < found.fun else np.asarray(found.x),
        first=values[0],
        lowest=lowest,
        evaluations=len(values),
        stopped=bool(found.status == 0),
        history=tuple(history),
    )


SIMPLEX = 200.0  # evaluations of a simplex for each unknown; more do not help it far from the top
ROUGHLY = 1.0  # of the log density: how near a simplex has to come, where slopes do the rest
LOG_TOLERANCE = 1e-3  # ... and where they do not: what a restart gains that another follows
MOST_STEP = 0.3  # of a standard deviation, in a log: where the record says little it is long
FAR = 100.0  # of the log density: a run that gained more was far from the optimum ...
TENTH = 0.1  # ... and there first steps of the simplex are this, in a log of each unknown


@dataclass(frozen=True, slots=True)
class NelderMead:
    """A restart that gains less than `enough` of the log density is the last; `per_unknown` evaluations
    at most.

    By default as far as it is good for, where slopes go the rest of the way.
    """

    enough: float = ROUGHLY
    per_unknown: float = SIMPLEX
    polished: bool = True

    def check(self, unknown: Sequence[str]) -> None:
        """It searches whatever is unknown."""

    def __call__(self, task: Task, start: Array, evaluations: int) -> Optimum:
        most = min(evaluations, self.per_unknown * len(task.names))
        return _maximise(task, start, int(most), self.enough)


THOROUGH = NelderMead(enough=LOG_TOLERANCE, per_unknown=math.inf)


def _maximise(task: Task, start: Array, evaluations: int, enough: float) -> Optimum:
    physical = task.coordinates.to_physical
    z, spent = task.coordinates.from_physical(start[None])[0], 0
    history: list[float] = []
    gain, done = np.inf, False
    while not done and spent < evaluations:
        root = _steps(task, physical(z[None])[0], far=gain > FAR)

        def lost(steps: Array, z: Array = z, root: Array = root) -> float:
            return -task.at(physical((z + root @ steps)[None])[0])

        run = descend(
            lost,
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


def _steps(task: Task, theta: Array, *, far: bool) -> Array:
    """Columns: first steps of the simplex, in the coordinates of the search."""
    if far:
        return TENTH * laplace.slopes_by_logs(task.coordinates, theta)
    columns = laplace.root(task.covariance(theta))
    longest = np.abs(columns).max(axis=0)
    return np.asarray(columns * np.minimum(1.0, MOST_STEP / longest))
