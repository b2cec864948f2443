"""Register the paper's printed matrix, MATLAB's fminsearch, and the pairwise search."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from bayesdrill.basics import Array, Count, Positive, Symbol, did_you_mean
from bayesdrill.rig import Gear, Linear, Model, MotorShaft, Named
from bayesdrill.sampling import Optimum, Task


@dataclass(frozen=True, slots=True)
class AsPrinted(Model):
    """`i_n` None: read as `i_m`; 1/i_m is right.  `a_51`: what A(5,1) stands over; j_m is right."""

    i_m: Gear = 1 / 8
    i_n: Annotated[
        Positive | None, Field(description="The undefined factor in A(6,5); without it: i_m.")
    ] = None
    a_51: Annotated[Literal["j_1", "j_m"], Field(description="What A(5,1) stands over.")] = "j_1"

    name: ClassVar[str] = "as_printed"
    declares: ClassVar[tuple[Symbol, ...]] = ()
    parameters: ClassVar[tuple[str, ...]] = MotorShaft.parameters
    states: ClassVar[tuple[str, ...]] = MotorShaft.states
    inputs: ClassVar[tuple[str, ...]] = MotorShaft.inputs

    def linear(self, p: Named) -> Linear:
        """Return the linear model as the paper prints it."""
        right = MotorShaft(self.i_m).linear(p)
        i_n = self.i_m if self.i_n is None else self.i_n
        printed = {
            ("w_2", "theta_1"): self.i_m**2 * p["k_s"] / p[self.a_51],
            ("i", "w_2"): -i_n * p["k_e"] / p["l_m"],
        }
        return Linear(A={**right.A, **printed}, B=right.B, c=right.c)


TOLERANCE = 1e-4  # TolX and TolFun
PER_UNKNOWN = 200  # MaxIter and MaxFunEvals, times the number of unknowns


def maximise(
    density: Callable[[Array], float], start: Array, iterations: int, evaluations: int
) -> tuple[float, Optimum]:
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
    return values[0], Optimum(
        theta=best if -2.0 * highest < result.fun else np.asarray(result.x),
        value=highest,
        evaluations=len(values),
        settled=bool(result.status == 0),
        history=tuple(history),
    )


@dataclass(frozen=True, slots=True)
class Fminsearch:
    """As it stops by default: it is there to be seen, and not polished."""

    polished: ClassVar[bool] = False

    def check(self, unknown: Sequence[str]) -> None:
        """Accept whatever is unknown."""

    def __call__(self, task: Task, starts: Array, evaluations: int) -> list[Optimum]:
        """Search from each of the physical `starts (S, D)`."""
        most = PER_UNKNOWN * len(task.names)
        return [maximise(task.at, start, most, min(most, evaluations))[1] for start in starts]


Pairs = Sequence[Sequence[str]]
_Pair = Annotated[list[str], Field(min_length=2, max_length=2)]
_PAIRS = Field(
    min_length=1, max_length=1000, description="Unknowns that are searched together, in this order."
)

ORDER = ("t_f", "j_m", "c_m", "k_e", "k_T", "r_m", "l_m", "k_s", "j_1")  # the paper's


def circle(names: Sequence[str]) -> Pairs:
    """Return the paper's pairs of those unknowns: each with the next, and the last with the first."""
    others = [name for name in names if name not in ORDER]
    chain = [*(name for name in ORDER if name in names), *others]
    if len(chain) < 2:
        raise ValueError("pairs need two unknowns; there is only one, so use nelder_mead")
    return tuple(zip(chain, [*chain[1:], chain[0]], strict=True))[
        : len(chain) if len(chain) > 2 else 1
    ]


@dataclass(frozen=True, slots=True)
class Pairwise:
    """`iterations` of each pair; a cycle that lowers the misfit by less than `steady` is the last."""

    pairs: Annotated[list[_Pair], _PAIRS] | None = None
    iterations: Annotated[Count, Field(description="Of each pair.")] = 10
    steady: Annotated[
        Positive, Field(description="Ends when a cycle lowers the misfit by less.")
    ] = 0.01

    polished: ClassVar[bool] = False

    def check(self, unknown: Sequence[str]) -> None:
        """Check that pairs name all unknowns, each with another; raises `ValueError` otherwise."""
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

    def __call__(self, task: Task, starts: Array, evaluations: int) -> list[Optimum]:
        """Search from each of the physical `starts (S, D)`."""
        return [self._search(task, start, evaluations) for start in starts]

    def _search(self, task: Task, start: Array, evaluations: int) -> Optimum:
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
