"""Run Nelder-Mead on scaled unknowns, and restart it with new simplexes while restarts help.

Without scaling the simplex stops too early: a damping of 1e-4 is as small as the default absolute
tolerance of most libraries.  Here, the first steps of a simplex are a tenth of each unknown as long
as runs gain much.  Near the optimum, they are one standard deviation of the local Gaussian
approximation.  The tolerances are in units of the first steps.

Searches from several starts run in lock-step: their points are evaluated as one batch, which costs
hardly more than a single point.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.inference import laplace
from bayesdrill.sampling.optimisers.contract import Optimum, Task

# A generator yields points `(n, D)`, receives their values `(n,)`, and returns a result.
type AskTell[T] = Generator[Array, Array, T]


@dataclass(slots=True)
class SimplexRun:
    """A simplex run evaluates at most `max_evaluations` points `to_point(x)`, where `x (D,)` is scaled.

    `start_value` is the value at the start, and `lowest` the lowest value so far, found at `x`.  If
    `is_converged`, the tolerances were met.
    """

    max_evaluations: int
    x: Array
    to_point: Callable[[Array], Array]
    start_value: float = math.inf
    lowest: float = math.inf
    evaluations: int = 0
    is_converged: bool = False

    def ask(self, points: Array) -> AskTell[Array]:
        """Ask for the values at `points (n, D)`, and return them; inf after `max_evaluations`."""
        values = np.full(len(points), np.inf)
        asked = points[: self.max_evaluations - self.evaluations]
        if len(asked):
            values[: len(asked)] = yield np.array([self.to_point(x) for x in asked])
        if self.evaluations == 0:
            self.start_value = float(values[0])
        self.evaluations += len(asked)
        best = int(np.argmin(values))
        if values[best] < self.lowest:
            self.x, self.lowest = points[best], float(values[best])
        return values


def nelder_mead(
    simplex: Array,
    max_evaluations: int,
    x_tolerance: float,
    tolerance: float,
    to_point: Callable[[Array], Array],
) -> AskTell[SimplexRun]:
    """Minimise from `simplex (D + 1, D)` until its size and range of values are within tolerances.

    The evaluated points are those of `scipy.optimize.minimize`: Nelder and Mead (1965), with the
    coefficients of Gao and Han (2012) for more than two unknowns.
    """
    run, n = SimplexRun(max_evaluations, simplex[0], to_point), simplex.shape[1]
    adapted = (1 + 2 / n, 0.75 - 1 / (2 * n), 1 - 1 / n)
    expansion, contraction, shrinkage = adapted if n > 2 else (2.0, 0.5, 0.5)
    values = yield from run.ask(simplex)
    order = np.argsort(values)
    simplex, values = simplex[order], values[order]
    while run.evaluations < max_evaluations:
        with np.errstate(invalid="ignore"):  # all values of a simplex may be infinite
            height = np.abs(values[0] - values[1:]).max()
        if np.abs(simplex[1:] - simplex[0]).max() <= x_tolerance and height <= tolerance:
            run.is_converged = True
            break
        centre, worst = np.add.reduce(simplex[:-1], 0) / n, simplex[-1]
        point = 2 * centre - worst
        (value,) = yield from run.ask(point[None])
        accepted = value < values[-2]
        if value < values[0]:
            expanded = (1 + expansion) * centre - expansion * worst
            (expanded_value,) = yield from run.ask(expanded[None])
            if expanded_value < value:
                point, value = expanded, expanded_value
        elif not accepted:
            outside = value < values[-1]
            sign = 1.0 if outside else -1.0
            limit = value if outside else values[-1]
            point = (1 + sign * contraction) * centre - sign * contraction * worst
            (value,) = yield from run.ask(point[None])
            accepted = value <= limit if outside else value < limit
        if accepted:
            simplex[-1], values[-1] = point, value
        else:
            simplex[1:] = simplex[0] + shrinkage * (simplex[1:] - simplex[0])
            values[1:] = yield from run.ask(simplex[1:])
        order = np.argsort(values)
        simplex, values = simplex[order], values[order]
    return run


def in_lock_step[T](searches: Sequence[AskTell[T]], function: Callable[[Array], Array]) -> list[T]:
    """Run searches in lock-step; `function` maps the points `(W, D)` of all searches to `(W,)`."""
    asked = {search: next(search) for search in searches}
    results: dict[AskTell[T], T] = {}
    while asked:
        values, first = function(np.concatenate([*asked.values()])), 0
        for search, points in tuple(asked.items()):
            last = first + len(points)
            try:
                asked[search] = search.send(values[first:last])
            except StopIteration as end:
                results[search] = end.value
                del asked[search]
            first = last
    return [results[search] for search in searches]


MAX_STEP = 0.3  # longest first step in a coordinate, as standard deviations may be large
FAR_GAIN = 100.0  # in log density: a run that gained more was far from the optimum
LOG_STEP = 0.1  # first step of a simplex that is far from the optimum, in the log of each unknown


@dataclass(frozen=True, slots=True)
class NelderMead:
    """The Nelder-Mead method is applied with restarts.

    Restarts end after a run that gains less than `enough` in log density.  The evaluations
    are at most `per_unknown` times the number of unknowns.  The defaults only come near a maximum,
    to which Gauss-Newton then converges with fewer evaluations than a simplex.
    """

    enough: float = 1.0
    per_unknown: float = 200.0

    def check(self, unknown: Sequence[str]) -> None:
        """Accept any unknowns."""

    def __call__(self, task: Task, starts: Array, evaluations: int) -> list[Optimum]:
        """Search from each of the physical `starts (S, D)`; see `Optimiser`."""
        most = int(min(evaluations, self.per_unknown * len(task.names)))

        def loss(z: Array) -> Array:
            return -task.density(task.coordinates.to_physical(z))

        return in_lock_step([_search(task, start, most, self.enough) for start in starts], loss)


def _search(task: Task, start: Array, evaluations: int, enough: float) -> AskTell[Optimum]:
    """Search from the physical point `start (D,)`, in the coordinates of the task."""
    physical = task.coordinates.to_physical
    z, spent = task.coordinates.from_physical(start[None])[0], 0
    corners = np.vstack([np.zeros(len(z)), np.eye(len(z))])
    gain, done = np.inf, False
    while not done and spent < evaluations:
        root = _steps(task, physical(z[None])[0], far=gain > FAR_GAIN)
        most = min(evaluations - spent, 400 * len(z))
        run = yield from nelder_mead(corners, most, 1e-2, 0.1 * enough, partial(_to_point, z, root))
        spent += run.evaluations
        gain = run.start_value - run.lowest
        if gain > 0:
            z = z + root @ run.x
        done = gain < enough
    return Optimum(
        theta=physical(z[None])[0],
        value=-run.lowest,
        evaluations=spent,
        settled=done and run.is_converged,
    )


def _to_point(z: Array, root: Array, x: Array) -> Array:
    """Return z + root x for `z (D,)`, `root (D, D)` and the coordinates `x (D,)` of the simplex."""
    return np.asarray(z + root @ x)


def _steps(task: Task, theta: Array, *, far: bool) -> Array:
    """Return the first steps of the simplex from `theta (D,)`, as columns `(D, D)`."""
    if far:
        return np.diag(LOG_STEP * task.coordinates.slopes_by_natural(theta[None])[0])
    columns = laplace.matrix_root(task.covariance(theta))
    longest = np.abs(columns).max(axis=0)
    return np.asarray(columns * np.minimum(1.0, MAX_STEP / longest))
