"""One run of SciPy's Nelder-Mead, and what it found iteration by iteration."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """`history`: the lowest value after each iteration; `stopped`: by its tolerances."""

    x: Array
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

    history: list[float] = []

    def note(intermediate_result: OptimizeResult) -> None:
        history.append(float(intermediate_result.fun))

    found = minimize(function, start, method="Nelder-Mead", callback=note, options=options)
    return Run(
        x=np.asarray(found.x),
        lowest=float(found.fun),
        evaluations=int(found.nfev),
        stopped=bool(found.status == 0),
        history=tuple(history),
    )
