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
