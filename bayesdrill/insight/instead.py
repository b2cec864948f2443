"""Whether the table may be right after all: physics that the rig lacks, tried with the table's values.

What the rig is held without bends the parameters that it has, and the fit may well look like noise.  So
before a table is blamed, each thing that the rig offers and has not is tried by itself: parameters
are held at their nominal values, within their tolerances, and all else is sought again.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from bayesdrill.engines.climb import climb
from bayesdrill.inference.problem import Problem
from bayesdrill.inference.surface import PosteriorSurface
from bayesdrill.insight.widened import Widened, widened

Array = NDArray[np.float64]

STEPS = 40  # uphill
SHARES = (0.02, 0.2)  # of what it can be, from which it is sought
AS_WELL = 0.01  # of records of a rig that is so: more is lost by holding the table


@dataclass(frozen=True, slots=True, kw_only=True)
class Instead:
    """`parameter` that the rig lacks, and its `value` [SI] where all nominal values hold; `lost`: of the
    log likelihood, against the MAP, which has none of it; negative where it fits better.
    """

    parameter: str
    value: float
    lost: float


def instead(problem: Problem, theta: Array) -> Instead | None:
    """What fits the record with the table about as well as the MAP `theta (D,)` without; the best."""
    posterior = problem.posterior
    wide = widened(posterior, theta, frozenset({"rig"}))
    held = [k for k, name in enumerate(posterior.space.free) if name in problem.nominal]
    if not wide.every or not held or not _allowed(problem):
        return None
    limit = 0.5 * float(chi2.isf(AS_WELL, len(held)))
    bare = _held(problem, wide, theta, held, None)
    if bare is None or bare[1] <= limit:
        return None  # the table needs no help
    best: Instead | None = None
    for which, one in enumerate(wide.every):
        found = _held(problem, wide, theta, held, which)
        if found is not None and found[1] <= min(limit, limit if best is None else best.lost):
            best = Instead(parameter=one.of, value=found[0], lost=found[1])
    return best


def _allowed(problem: Problem) -> bool:
    """Whether the priors allow the table at all."""
    priors, off = problem.posterior.space.priors, problem.tolerance
    return all(
        prior.low <= value * (1.0 + off.get(name, 0.0))
        and value * (1.0 - off.get(name, 0.0)) <= prior.high
        for name, value in problem.nominal.items()
        for prior in [priors.get(name)]
        if prior is not None
    )


def _held(
    problem: Problem, wide: Widened, theta: Array, held: list[int], which: int | None
) -> tuple[float, float] | None:
    """With one of what is tried, or with nothing: its value, and what is lost."""
    space, wider = problem.posterior.space, wide.posterior
    m = len(theta) - len(space.columns("noise"))
    start = np.concatenate([theta[:m], [c.neutral for c in wide.every], theta[m:]])
    ends = np.stack([start, start])
    for k in held:
        name = space.free[k]
        off = problem.tolerance.get(name, 0.0)
        ends[:, k] = problem.nominal[name] * np.array([1.0 - off, 1.0 + off])
    surface = PosteriorSurface(wider, physical=True)
    fixed = np.zeros(len(start), dtype=bool)
    fixed[[*held, *range(m, m + len(wide.every))]] = True
    rows = np.repeat(start[None], len(SHARES), axis=0)
    if which is not None:
        fixed[m + which] = False
        rows[:, m + which] = [wide.every[which].prior.high * share for share in SHARES]
    low, high = np.clip(wider.coordinates.from_physical(ends), surface.low, surface.high)
    surface.low = np.where(fixed, low, surface.low)
    surface.high = np.where(fixed, high, surface.high)
    top = climb(surface, wider.coordinates.from_physical(rows), STEPS)
    there = wider.coordinates.to_physical(top.u)
    likely = wider.likelihood(there)
    if not np.isfinite(likely).any():
        return None
    k = int(np.nanargmax(likely))
    before = float(problem.posterior.likelihood(theta[None])[0])
    value = 0.0 if which is None else float(there[k, m + which])
    return value, before - float(likely[k])
