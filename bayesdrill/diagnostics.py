"""What the draws say of each unknown, in numbers and in a word."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from arviz_stats.base import array_stats
from numpy.typing import NDArray

from bayesdrill.build import Problem
from bayesdrill.convergence import Convergence
from bayesdrill.mode import Mode
from bayesdrill.priors import Prior, spread

Array = NDArray[np.float64]

HDI_PROBABILITY = 0.94

Word = Literal["determined", "weak", "prior only"]

PRIOR_ONLY_SHRINKAGE = 0.1  # below it, and ...
PRIOR_ONLY_DISTANCE = 0.1  # ... nearer to the prior than this: the record says nothing
DETERMINED_SHRINKAGE = 0.5

MEANING: dict[Word, str] = {
    "determined": "the record narrows the prior to less than half",
    "weak": "the record narrows the prior, but to no less than half",
    "prior only": "the posterior is just the prior: this record does not determine it",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One unknown, SI. `deviation` is of the mean from the nominal value, relative.

    `shrinkage`: 1 - sd / sd of the prior.  `nominal` and `deviation` are None for noise levels.
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
            )
        )
    return tuple(rows)


def hdi(x: Array) -> tuple[float, float]:
    """The narrowest interval that holds `HDI_PROBABILITY` of the draws `(N,)`."""
    low, high = array_stats.hdi(x, prob=HDI_PROBABILITY, axis=0)  # type: ignore[no-untyped-call]
    return float(low), float(high)


def distance_to_prior(x: Array, prior: Prior) -> float:
    """Kolmogorov distance between draws `(N,)` and the prior."""
    shares = np.linspace(0.0, 1.0, 201)[1:-1]
    below = np.searchsorted(np.sort(x), prior.quantile(shares)) / len(x)
    return float(np.max(np.abs(below - shares)))


def _word(shrinkage: float, distance: float) -> Word:
    if shrinkage < PRIOR_ONLY_SHRINKAGE and distance < PRIOR_ONLY_DISTANCE:
        return "prior only"
    return "determined" if shrinkage > DETERMINED_SHRINKAGE else "weak"
