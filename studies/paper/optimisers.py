"""The paper's searches: MATLAB's fminsearch, and the heuristic that searches pairs of unknowns."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from bayesdrill.basics import Array
from bayesdrill.sampling import Optimum, Task

TOLERANCE = 1e-4  # TolX and TolFun
PER_UNKNOWN = 200  # MaxIter and MaxFunEvals, times the number of unknowns


@dataclass(frozen=True, slots=True, kw_only=True)
class TracedOptimum(Optimum):
    """An optimum with its `history`: the highest log density after each iteration of a simplex."""

    history: tuple[float, ...]


def maximise(
    density: Callable[[Array], float], start: Array, iterations: int, evaluations: int
) -> tuple[float, TracedOptimum]:
    """Search as MATLAB's fminsearch does; return the log density at `start (D,)`, and the end.

    SciPy's own first simplex is that of fminsearch, each coordinate 5 % larger by turns, and to set
    it up counts as the first iteration in both.
    """
    from scipy.optimize import OptimizeResult, minimize  # late: 0.3 s, and few commands optimise

    options = {"xatol": TOLERANCE, "fatol": TOLERANCE, "maxiter": iterations, "maxfev": evaluations}
    values: list[float] = []
    history: list[float] = []
    best, highest = start, -np.inf

    # SciPy may forget the best point, if it finds that in an iteration that `maxfev` cuts.
    def misfit(x: Array) -> float:
        """Return the paper's misfit, up to a constant; inf where the density is zero."""
        nonlocal best, highest
        values.append(density(x))
        if values[-1] > highest:
            best, highest = x, values[-1]
        return -2.0 * values[-1]

    def note(intermediate_result: OptimizeResult) -> None:
        history.append(highest)

    with np.errstate(invalid="ignore"):  # where all of a simplex is impossible
        result = minimize(misfit, start, method="Nelder-Mead", callback=note, options=options)
    return values[0], TracedOptimum(
        theta=best if -2.0 * highest < result.fun else np.asarray(result.x),
        value=highest,
        evaluations=len(values),
        settled=bool(result.status == 0),
        history=tuple(history),
    )


def fminsearch(task: Task, starts: Array, evaluations: int) -> list[TracedOptimum]:
    """Search from each of the physical `starts (S, D)` with the limits of MATLAB's defaults."""
    most = PER_UNKNOWN * len(task.names)
    return [maximise(task.at, start, most, min(most, evaluations))[1] for start in starts]


Pairs = Sequence[Sequence[str]]

ORDER = ("t_f", "j_m", "c_m", "k_e", "k_T", "r_m", "l_m", "k_s", "j_1")  # the paper's


def circle(names: Sequence[str]) -> Pairs:
    """Return the paper's pairs of those unknowns: each with the next, and the last with the first."""
    others = [name for name in names if name not in ORDER]
    chain = [*(name for name in ORDER if name in names), *others]
    return tuple(zip(chain, [*chain[1:], chain[0]], strict=True))[
        : len(chain) if len(chain) > 2 else 1
    ]


@dataclass(frozen=True, slots=True)
class Pairwise:
    """Search `iterations` of each of `pairs` in turn, by default those of `circle`.

    A cycle over all pairs that lowers the misfit by less than `steady` is the last.
    """

    pairs: Pairs | None = None
    iterations: int = 10
    steady: float = 0.01

    def __call__(self, task: Task, starts: Array, evaluations: int) -> list[TracedOptimum]:
        """Search from each of the physical `starts (S, D)`."""
        return [self._search(task, start, evaluations) for start in starts]

    def _search(self, task: Task, start: Array, evaluations: int) -> TracedOptimum:
        theta, spent, settled = start.copy(), 0, False
        pairs = self.pairs or circle(task.names)
        columns = [[task.names.index(name) for name in pair] for pair in pairs]
        history: list[float] = []
        while not settled and spent < evaluations:
            begun: list[float] = []
            for pair in columns:
                if spent == evaluations:
                    break
                density = partial(_density, task, theta, pair)
                first, end = maximise(density, theta[pair], self.iterations, evaluations - spent)
                theta = _with(theta, pair, end.theta)
                spent += end.evaluations
                history += end.history
                begun.append(first)
            lowered = 2.0 * (end.value - begun[0])  # of the misfit
            settled = spent < evaluations and lowered < self.steady
        return dataclasses.replace(
            end, theta=theta, evaluations=spent, settled=settled, history=tuple(history)
        )


def _density(task: Task, theta: Array, pair: list[int], values: Array) -> float:
    return task.at(_with(theta, pair, values))


def _with(theta: Array, pair: list[int], values: Array) -> Array:
    changed = theta.copy()
    changed[pair] = values
    return changed
