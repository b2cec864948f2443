"""Nelder-Mead as MATLAB's fminsearch runs it by default, on the unknowns as they are.

What it minimises is the paper's misfit (-2 log density, up to a constant).  Both tolerances are
absolute, 1e-4, and both must be met: those on the unknowns are coarser than a damping of 1e-4 and
finer than what a record says of a resistance.  Kept to show what follows from that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from bayesdrill.engines import Optimum, Task, descend

Array = NDArray[np.float64]

TOLERANCE = 1e-4  # TolX and TolFun
PER_UNKNOWN = 200  # MaxIter and MaxFunEvals, times the number of unknowns


@dataclass(frozen=True, slots=True)
class Fminsearch:
    """As it stops by default: it is there to be seen, and not polished."""

    polished: ClassVar[bool] = False

    def check(self, unknown: Sequence[str]) -> None:
        """It searches whatever is unknown."""

    def __call__(self, task: Task, start: Array, evaluations: int) -> Optimum:
        most = PER_UNKNOWN * len(start)
        run = descend(
            lambda theta: misfit(task, theta),
            start,
            xatol=TOLERANCE,
            fatol=TOLERANCE,
            maxiter=most,
            maxfev=min(most, evaluations),
        )
        return Optimum(
            theta=run.x,
            value=-0.5 * run.lowest,
            evaluations=run.evaluations,
            settled=run.stopped,
            history=tuple(-0.5 * low for low in run.history),
        )


def misfit(task: Task, theta: Array) -> float:
    """The paper's misfit, up to a constant; inf where the density is zero."""
    return -2.0 * task.at(theta)
