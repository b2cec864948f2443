"""Whether experiments with one rig tell the same of it: their spread, against what each knows.

At the joint maximum each experiment alone would move the unknowns by its own slope over its own
information, nuisances taken out.  The spread beyond that is DerSimonian and Laird's (1986).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from bayesdrill.insight.identifiability.information import BLIND, RANK_TOLERANCE
from bayesdrill.insight.identifiability.scenes import Scenery
from bayesdrill.insight.identifiability.structure import Exponents

Array = NDArray[np.float64]

FALSE_ALARM = 0.01  # of sets of repeats of one rig, any product at all


@dataclass(frozen=True, slots=True, kw_only=True)
class Repeat:
    """A product: how far each experiment (by name) puts its log from the joint one, and each one's sd.

    `p`: of a spread as large by chance; `spread`: sd of the log between experiments, beyond that.
    """

    exponents: Exponents
    labels: tuple[str, ...]
    apart: tuple[float, ...]
    sds: tuple[float, ...]
    p: float
    spread: float
    differs: bool


def repeats(scenery: Scenery, theta: Array, products: Sequence[Exponents]) -> tuple[Repeat, ...]:
    """Of products that more than one experiment determines; at `theta (D,)`, the joint maximum."""
    every = scenery.likelihood.observations
    if len(every) < 2 or not products:
        return ()
    full = scenery.likelihood.space.full(theta[None])
    rests = [one.informed(one.residuals(full).samples, theta).ravel() for one in every]
    alone = [scenery.alone(*pair) for pair in zip(scenery.each(theta), rests, strict=True)]
    found = []
    for exponents in products:
        powers = np.array(exponents, dtype=float)
        told = [(one.label, *_of(a, powers)) for one, a in zip(every, alone, strict=True)]
        known = [(label, x, sd) for label, x, sd in told if np.isfinite(sd)]
        if len(known) > 1:
            found.append((exponents, known))
    return tuple(_compared(exponents, known, len(found)) for exponents, known in found)


def _compared(
    exponents: Exponents, known: Sequence[tuple[str, float, float]], looks: int
) -> Repeat:
    labels, x, sds = zip(*known, strict=True)
    at, weights = np.array(x), 1.0 / np.array(sds) ** 2
    mean = weights @ at / weights.sum()
    q, freedom = float(weights @ (at - mean) ** 2), len(at) - 1
    c = weights.sum() - (weights**2).sum() / weights.sum()
    p = float(chi2.sf(q, freedom))
    return Repeat(
        exponents=exponents,
        labels=labels,
        apart=tuple(map(float, at - mean)),
        sds=sds,
        p=p,
        spread=float(np.sqrt(max(0.0, (q - freedom) / c))),
        differs=p < FALSE_ALARM / looks,
    )


def _of(alone: tuple[Array, Array], powers: Array) -> tuple[float, float]:
    """The log of a product and its sd, of one experiment; infinite where it says nothing of it."""
    left, values, rows = np.linalg.svd(alone[0])
    seen = values > RANK_TOLERANCE * values[0]
    along = rows @ powers
    if np.linalg.norm(along[~seen]) > BLIND * np.linalg.norm(powers):
        return 0.0, np.inf
    weights = along[seen] / values[seen]
    return float(weights @ (left[:, seen].T @ alone[1])), float(np.linalg.norm(weights))
