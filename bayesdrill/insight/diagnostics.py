"""What the draws say of each unknown, in numbers and in a word."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bayesdrill.engines.convergence import Convergence
from bayesdrill.engines.mode import Mode
from bayesdrill.inference.priors import Prior, spread
from bayesdrill.inference.problem import Problem
from bayesdrill.insight.derived import HDI_PROBABILITY as HDI_PROBABILITY
from bayesdrill.insight.derived import hdi

Array = NDArray[np.float64]


Word = Literal["determined", "weak", "through others", "prior only"]

PRIOR_ONLY_SHRINKAGE = 0.1  # below it, and ...
PRIOR_ONLY_DISTANCE = 0.1  # ... nearer to the prior than this: the record says nothing
DETERMINED_SHRINKAGE = 0.5

END_MASS = 0.05  # of the prior, at an end of it; half of the draws there is a crowd
RISING = 0.25  # of the draws are nearer than half the median where their density is flat

MEANING: dict[Word, str] = {
    "determined": "the record, with what is believed of the others, narrows the prior to less than half",
    "weak": "the record narrows the prior, but to no less than half",
    "through others": "narrower than the prior only by the priors of others: the record knows ratios",
    "prior only": "the posterior is just the prior: this record does not determine it",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One unknown, SI. `deviation` is of the mean from the nominal value, relative.

    `shrinkage`: 1 - sd / sd of the prior.  `nominal` and `deviation` are None for noise levels.
    `pressed_against`: the end of the prior that the draws crowd at, or None.
    """

    name: str
    unit: str
    nominal: float | None
    map: float
    mean: float
    sd: float
    hdi_low: float
    hdi_high: float
    deviation: float | None
    r_hat: float
    ess_bulk: float
    ess_tail: float
    shrinkage: float
    word: Word
    pressed_against: float | None


def summarise(
    problem: Problem, draws: Array, mode: Mode, convergence: Convergence
) -> tuple[Row, ...]:
    """A row for each unknown, from nearly independent physical draws `(E, N, D)`."""
    rows = []
    for d, symbol in enumerate(problem.symbols):
        x = draws[..., d].ravel()
        nominal = problem.nominal.get(symbol.name)
        mean, sd = float(x.mean()), float(x.std(ddof=1))
        low, high = hdi(x)
        prior = problem.posterior.space.priors[symbol.name]
        shrinkage = 1.0 - sd / spread(prior)
        rows.append(
            Row(
                name=symbol.name,
                unit=symbol.unit,
                nominal=nominal,
                map=mode.values[symbol.name],
                mean=mean,
                sd=sd,
                hdi_low=low,
                hdi_high=high,
                deviation=None if nominal is None else mean / nominal - 1.0,
                r_hat=float(convergence.r_hat[d]),
                ess_bulk=float(convergence.ess_bulk[d]),
                ess_tail=float(convergence.ess_tail[d]),
                shrinkage=shrinkage,
                word=_word(shrinkage, distance_to_prior(x, prior)),
                pressed_against=pressed_against(x, prior),
            )
        )
    return tuple(rows)


def distance_to_prior(x: Array, prior: Prior) -> float:
    """Kolmogorov distance between draws `(N,)` and the prior."""
    shares = np.linspace(0.0, 1.0, 201)[1:-1]
    below = np.searchsorted(np.sort(x), prior.quantile(shares)) / len(x)
    return float(np.max(np.abs(below - shares)))


def pressed_against(x: Array, prior: Prior) -> float | None:
    """The end of `prior` that draws `(N,)` crowd at, as if they wanted past it, or None.

    Half of them lie in the last `END_MASS` of the prior's mass, and they get denser towards the end
    both along x and relative to the prior.  What the corners of a box of priors do alone is weaker:
    where all nine parameters share one scale, a marginal rises like its eighth power, and 37 % of it
    lie in the last twentieth.
    """
    if prior.vanishes_at_ends:
        return None
    middle = float(np.median(x))
    for end, sign in ((prior.low, 1.0), (prior.high, -1.0)):
        if not math.isfinite(end):
            continue

        def at(mass: float, sign: float = sign) -> float:
            """The point that has this mass of the prior between itself and the end."""
            return float(prior.quantile(np.array(mass if sign > 0 else 1.0 - mass)))

        if sign * (middle - at(END_MASS)) > 0:
            continue
        halves = (0.5 * (end + middle), at(0.5 * _mass_between(at, middle, sign)))
        if all(np.mean(sign * (half - x) > 0) > RISING for half in halves):
            return end
    return None


def _mass_between(at: Callable[[float], float], x: float, sign: float) -> float:
    """The mass of the prior between its end and `x`, by bisection of its logarithm."""
    low, high = -40.0, 0.0
    for _ in range(60):
        mid = 0.5 * (low + high)
        low, high = (mid, high) if sign * (at(math.exp(mid)) - x) < 0 else (low, mid)
    return math.exp(high)


def _word(shrinkage: float, distance: float) -> Word:
    if shrinkage < PRIOR_ONLY_SHRINKAGE and distance < PRIOR_ONLY_DISTANCE:
        return "prior only"
    return "determined" if shrinkage > DETERMINED_SHRINKAGE else "weak"
