"""The paper's heuristic: Nelder-Mead on two unknowns at a time, pair after pair, round and round.

Sandoval, Cunha Jr and Sampaio (ENIEF 2013), section 5.2: ten iterations on (t_f, j_m), ten on
(j_m, c_m), and so on to (j_1, t_f), each from where the last one ended; again, until the misfit is
steady.  Where parameters can stand in for each other it ends at a low misfit and at values that
depend on its start: use it to repeat the paper, not to find the MAP.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from bayesdrill.engines.optimisers.contract import Optimum, Task
from bayesdrill.engines.optimisers.fminsearch import TOLERANCE, misfit
from bayesdrill.engines.optimisers.simplex import Run, descend

Array = NDArray[np.float64]
Pairs = tuple[tuple[str, str], ...]

ORDER = ("t_f", "j_m", "c_m", "k_e", "k_T", "r_m", "l_m", "k_s", "j_1")  # the paper's


def circle(names: Sequence[str]) -> Pairs:
    """The paper's pairs of those unknowns: each with the next, and the last with the first."""
    rest = [name for name in names if name not in ORDER]
    chain = [*(name for name in ORDER if name in names), *rest]
    if len(chain) < 2:
        raise ValueError("pairs need two unknowns; there is only one, so use nelder_mead")
    return tuple(zip(chain, [*chain[1:], chain[0]], strict=True))[
        : len(chain) if len(chain) > 2 else 1
    ]


def maximise(
    task: Task,
    start: Array,
    evaluations: int,
    *,
    pairs: Pairs,
    iterations: int,
    steady: float,
) -> Optimum:
    """See `optimisers.contract.Optimiser`.

    `iterations` of each pair; a cycle that lowers the misfit by less than `steady` is the last.
    """
    theta, spent, settled = start.copy(), 0, False
    columns = [[task.names.index(name) for name in pair] for pair in pairs]
    history: list[float] = []
    while not settled and spent < evaluations:
        cycle: list[Run] = []
        for pair in columns:
            if spent == evaluations:
                break
            run = descend(
                partial(_misfit, task, theta, pair),
                theta[pair],
                xatol=TOLERANCE,
                fatol=TOLERANCE,
                maxiter=iterations,
                maxfev=evaluations - spent,
            )
            theta = _with(theta, pair, run.x)
            spent += run.evaluations
            history += run.history
            cycle.append(run)
        settled = spent < evaluations and cycle[0].first - cycle[-1].lowest < steady
    return Optimum(
        theta=theta,
        value=-0.5 * cycle[-1].lowest,
        evaluations=spent,
        settled=settled,
        history=tuple(-0.5 * low for low in history),
    )


def _misfit(task: Task, theta: Array, pair: list[int], values: Array) -> float:
    return misfit(task, _with(theta, pair, values))


def _with(theta: Array, pair: list[int], values: Array) -> Array:
    changed = theta.copy()
    changed[pair] = values
    return changed
