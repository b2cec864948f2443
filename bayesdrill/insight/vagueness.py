"""Priors that reach so far that an evidence says more of them than of the model."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesdrill.inference.priors import Prior, spread, spread_of_log
from bayesdrill.insight.diagnostics import Row

Array = NDArray[np.float64]

DECADES = 2.1  # of a log-uniform prior, or of one that is as wide: with more it is vague
TIMES = 100.0  # as wide as what was found is large, where it is no matter of factors
NARROWED = 0.5  # of its width: an unknown of which more is left costs little, however wide


@dataclass(frozen=True, slots=True, kw_only=True)
class Vague:
    """The prior of `name`: so many `decades` wide, or `times` as wide as what was found is large."""

    name: str
    decades: float | None = None
    times: float | None = None


def vague(rows: Sequence[Row], draws: Array, priors: Mapping[str, Prior]) -> tuple[Vague, ...]:
    """Of unknowns that the record narrows; `draws (N, D)` in the order of `rows`."""
    found = (_vague(row.name, x, priors[row.name]) for row, x in zip(rows, draws.T, strict=True))
    return tuple(one for one in found if one is not None)


def _vague(name: str, x: Array, prior: Prior) -> Vague | None:
    if prior.in_logs:
        wide = spread_of_log(prior)
        decades = wide * math.sqrt(12.0) / math.log(10.0)
        if decades > DECADES and float(np.log(x).std()) < NARROWED * wide:
            return Vague(name=name, decades=decades)
    wide = spread(prior)
    times = wide / math.sqrt(float(np.mean(x**2)))
    if times > TIMES and float(x.std()) < NARROWED * wide:
        return Vague(name=name, times=times)
    return None
