"""The paper's heuristic: Nelder-Mead on two unknowns at a time, pair after pair, round and round.

Sandoval, Cunha Jr and Sampaio (ENIEF 2013), section 5.2: ten iterations on (t_f, j_m), ten on
(j_m, c_m), and so on to (j_1, t_f), each from where the last one ended; again, until the misfit is
steady.  Where parameters can stand in for each other it ends at a low misfit and at values that
depend on its start: use it to repeat the paper, not to find the MAP.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from bayesdrill.basics import Count, Positive, did_you_mean
from bayesdrill.engines import Optimum, Run, Task, descend
from bayesdrill.paper.searches.fminsearch import TOLERANCE, misfit

Array = NDArray[np.float64]
Pairs = Sequence[Sequence[str]]
_Pair = Annotated[list[str], Field(min_length=2, max_length=2)]

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


@dataclass(frozen=True, slots=True)
class Pairwise:
    """`iterations` of each pair; a cycle that lowers the misfit by less than `steady` is the last."""

    pairs: (
        Annotated[
            list[_Pair],
            Field(
                min_length=1,
                max_length=1000,
                description="Unknowns that are searched together, in this order.",
            ),
        ]
        | None
    ) = None
    iterations: Annotated[Count, Field(description="Of each pair.")] = 10
    steady: Annotated[
        Positive, Field(description="Ends when a cycle lowers the misfit by less.")
    ] = 0.01

    polished: ClassVar[bool] = False

    def check(self, unknown: Sequence[str]) -> None:
        pairs = self.pairs or circle(unknown)
        for name in (name for pair in pairs for name in pair):
            if name not in unknown:
                hint = did_you_mean(name, unknown)
                raise ValueError(f"'{name}' in `pairs:` is not unknown{hint}")
        twice = [first for first, second in pairs if first == second]
        if twice:
            raise ValueError(f"`pairs:` has {twice[0]} with itself; name two different unknowns")
        idle = [name for name in unknown if not any(name in pair for pair in pairs)]
        if idle:
            raise ValueError(
                f"no pair has {', '.join(idle)}, which would stay at the start; add it"
            )

    def __call__(self, task: Task, start: Array, evaluations: int) -> Optimum:
        pairs = self.pairs or circle(task.names)
        return _maximise(task, start, evaluations, pairs, self.iterations, self.steady)


def _maximise(
    task: Task, start: Array, evaluations: int, pairs: Pairs, iterations: int, steady: float
) -> Optimum:
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
