"""Nelder-Mead on scaled unknowns, restarted with a fresh simplex until that no longer helps.

Unscaled, the simplex stops where it likes: a damping of 1e-4 equals the usual absolute tolerance
on the parameters.  Here a step is a tenth of each unknown as long as much is gained, and then one
standard deviation of the local Gaussian approximation, which misleads far from the optimum; the
tolerances are in units of the step.

Searches from several starts go in lock-step: the points that they ask for are evaluated as one batch,
which costs hardly more than one of them.
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

# Yields points `(n, D)`, is sent the values there `(n,)`, and returns what it has found.
type AskTell[T] = Generator[Array, Array, T]


@dataclass(slots=True)
class SimplexRun:
    """The progress of a simplex, whose `x (D,)` stands for the point `place(x)`.

    `evaluations`: at most `most`; `first`: the value at the start; `lowest`: at `x`, of all that
    were asked for; `stopped`: by its tolerances.
    """

    most: int
    x: Array
    place: Callable[[Array], Array]
    first: float = math.inf
    lowest: float = math.inf
    evaluations: int = 0
    stopped: bool = False

    def ask(self, points: Array) -> AskTell[Array]:
        """Ask for the values at `points (n, D)`; inf at those that are too many."""
        values = np.full(len(points), np.inf)
        asked = points[: self.most - self.evaluations]
        if len(asked):
            values[: len(asked)] = yield np.array([self.place(x) for x in asked])
        if self.evaluations == 0:
            self.first = float(values[0])
        self.evaluations += len(asked)
        best = int(np.argmin(values))
        if values[best] < self.lowest:
            self.x, self.lowest = points[best], float(values[best])
        return values


def nelder_mead(
    simplex: Array,
    most: int,
    x_tolerance: float,
    tolerance: float,
    place: Callable[[Array], Array],
) -> AskTell[SimplexRun]:
    """Minimise from `simplex (D + 1, D)` until it and its values are as small as the tolerances.

    The points are those of `scipy.optimize.minimize`: Nelder and Mead (1965), with the coefficients
    of Gao and Han (2012) for more than two unknowns.
    """
    run, n = SimplexRun(most, simplex[0], place), simplex.shape[1]
    away, near, shrink = (1 + 2 / n, 0.75 - 1 / (2 * n), 1 - 1 / n) if n > 2 else (2.0, 0.5, 0.5)
    values = yield from run.ask(simplex)
    order = np.argsort(values)
    simplex, values = simplex[order], values[order]
    while run.evaluations < most:
        with np.errstate(invalid="ignore"):  # where all of a simplex is impossible
            height = np.abs(values[0] - values[1:]).max()
        if np.abs(simplex[1:] - simplex[0]).max() <= x_tolerance and height <= tolerance:
            run.stopped = True
            break
        centre, worst = np.add.reduce(simplex[:-1], 0) / n, simplex[-1]
        point = 2 * centre - worst
        (value,) = yield from run.ask(point[None])
        accepted = value < values[-2]
        if value < values[0]:
            farther = (1 + away) * centre - away * worst
            (beyond,) = yield from run.ask(farther[None])
            if beyond < value:
                point, value = farther, beyond
        elif not accepted:
            outside = value < values[-1]
            sign = 1.0 if outside else -1.0
            bar = value if outside else values[-1]
            point = (1 + sign * near) * centre - sign * near * worst
            (value,) = yield from run.ask(point[None])
            accepted = value <= bar if outside else value < bar
        if accepted:
            simplex[-1], values[-1] = point, value
        else:
            simplex[1:] = simplex[0] + shrink * (simplex[1:] - simplex[0])
            values[1:] = yield from run.ask(simplex[1:])
        order = np.argsort(values)
        simplex, values = simplex[order], values[order]
    return run


def in_lock_step[T](searches: Sequence[AskTell[T]], function: Callable[[Array], Array]) -> list[T]:
    """Run searches in lock-step; `function((W, D)) -> (W,)` sees the points of all of them at once."""
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


MAX_STEP = 0.3  # of a standard deviation, in a log: where the record says little it is long
FAR_GAIN = 100.0  # of the log density: a run that gained more was far from the optimum ...
LOG_STEP = 0.1  # ... and there first steps of the simplex are this, in a log of each unknown


@dataclass(frozen=True, slots=True)
class NelderMead:
    """Nelder-Mead with restarts.

    A restart that gains less than `enough` of the log density is the last; `per_unknown`: the most
    evaluations for each unknown. The defaults go as far as a simplex is good for, where slopes go
    the rest of the way.
    """

    enough: float = 1.0
    per_unknown: float = 200.0

    def check(self, unknown: Sequence[str]) -> None:
        """Accept whatever is unknown."""

    def __call__(self, task: Task, starts: Array, evaluations: int) -> list[Optimum]:
        """Search from each of the physical `starts (S, D)`."""
        most = int(min(evaluations, self.per_unknown * len(task.names)))

        def lost(z: Array) -> Array:
            return -task.density(task.coordinates.to_physical(z))

        return in_lock_step([_search(task, start, most, self.enough) for start in starts], lost)


def _search(task: Task, start: Array, evaluations: int, enough: float) -> AskTell[Optimum]:
    """In the coordinates of the task."""
    physical = task.coordinates.to_physical
    z, spent = task.coordinates.from_physical(start[None])[0], 0
    corners = np.vstack([np.zeros(len(z)), np.eye(len(z))])
    gain, done = np.inf, False
    while not done and spent < evaluations:
        root = _steps(task, physical(z[None])[0], far=gain > FAR_GAIN)
        most = min(evaluations - spent, 400 * len(z))
        run = yield from nelder_mead(corners, most, 1e-2, 0.1 * enough, partial(_placed, z, root))
        spent += run.evaluations
        gain = run.first - run.lowest
        if gain > 0:
            z = z + root @ run.x
        done = gain < enough
    return Optimum(
        theta=physical(z[None])[0],
        value=-run.lowest,
        evaluations=spent,
        settled=done and run.stopped,
    )


def _placed(z: Array, root: Array, x: Array) -> Array:
    """Around `z (D,)` in units of the columns of `root (D, D)`."""
    return np.asarray(z + root @ x)


def _steps(task: Task, theta: Array, *, far: bool) -> Array:
    """Columns: first steps of the simplex, in the coordinates of the search."""
    if far:
        return np.diag(LOG_STEP * task.coordinates.slopes_by_natural(theta[None])[0])
    columns = laplace.matrix_root(task.covariance(theta))
    longest = np.abs(columns).max(axis=0)
    return np.asarray(columns * np.minimum(1.0, MAX_STEP / longest))
