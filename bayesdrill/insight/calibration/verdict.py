"""One verdict on all ranks, wrong with at most `FALSE_ALARM` where the posterior is right.

Half of that chance goes to the rank bands, shared equally by the quantities, and half to the
credible intervals, shared equally by unknowns and levels: a union bound, as the ranks of one refit
depend on each other.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayesdrill.insight.calibration.bands import Band, Counts, count_band, ecdf_band
from bayesdrill.insight.calibration.ranks import shape, shape_of_fit
from bayesdrill.insight.calibration.refit import Refit

FALSE_ALARM = 0.01  # of the whole verdict
LEVELS = (0.5, 0.8, 0.94)  # of the credible intervals
MOST_NOT_CONVERGED = 0.05  # of the refits; with more there is no verdict


@dataclass(frozen=True, slots=True, kw_only=True)
class Interval:
    """How many truths lay in the central interval of probability `share`; `low` to `high` is chance."""

    share: float
    inside: int
    low: int
    high: int

    @property
    def holds(self) -> bool:
        return self.low <= self.inside <= self.high


@dataclass(frozen=True, slots=True, kw_only=True)
class Quantity:
    """One unknown, or the log likelihood (which has no `intervals`); `ranks (N,)`.

    `shape`: what is wrong, where it can be told; None for uniform ranks.
    """

    name: str
    ranks: Counts
    reach: float
    holds: bool
    shape: str | None
    intervals: tuple[Interval, ...]


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """`not_converged`: indices of refits that missed their targets, `lost`: of those without ranks."""

    n_draws: int
    band: Band
    quantities: tuple[Quantity, ...]
    refits: int
    not_converged: tuple[int, ...]
    lost: tuple[int, ...]

    @property
    def calibrated(self) -> bool:
        return not self.faults and not self.doubts

    @cached_property
    def faults(self) -> tuple[str, ...]:
        """What chance does not explain, worst first."""
        found = []
        for quantity in sorted(self.quantities, key=lambda q: -q.reach):
            if not quantity.holds:
                why = f" ({quantity.shape})" if quantity.shape else ""
                found.append(f"ranks of {quantity.name} leave the band{why}")
        for quantity in self.quantities:
            for interval in quantity.intervals:
                if not interval.holds:
                    found.append(
                        f"{100 * interval.share:.3g} % intervals of {quantity.name} hold the truth in "
                        f"{100 * interval.inside / self.band.n:.0f} % of the refits"
                    )
        return tuple(found)

    @cached_property
    def doubts(self) -> tuple[str, ...]:
        """Why nothing can be said, however good the ranks look."""
        found = []
        if len(self.not_converged) > MOST_NOT_CONVERGED * self.refits:
            found.append(
                f"{len(self.not_converged)} of {self.refits} refits did not converge (at most "
                f"{100 * MOST_NOT_CONVERGED:g} % may)"
            )
        if self.lost:
            found.append(f"{len(self.lost)} of {self.refits} refits gave no draws at all")
        return tuple(found)


def judge(names: Sequence[str], refits: Sequence[Refit], n_draws: int) -> Verdict:
    """`names` of the quantities, the log likelihood last; `refits` in the order of their index."""
    ranked = [refit for refit in refits if refit.ranks]
    table = np.array([refit.ranks for refit in ranked], dtype=np.int64).reshape(-1, len(names))
    band = ecdf_band(len(ranked), n_draws, 0.5 * FALSE_ALARM / len(names))
    n_unknown = len(names) - 1
    quantities = []
    for column, name in enumerate(names):
        ranks, unknown = table[:, column], column < n_unknown
        told = (shape if unknown else shape_of_fit)(ranks, n_draws) if len(ranks) else None
        holds = band.holds(ranks)
        quantities.append(
            Quantity(
                name=name,
                ranks=ranks,
                reach=band.reach(ranks),
                holds=holds,
                shape=None if holds else told,
                intervals=_intervals(ranks, n_draws, n_unknown) if unknown else (),
            )
        )
    return Verdict(
        n_draws=n_draws,
        band=band,
        quantities=tuple(quantities),
        refits=len(refits),
        not_converged=tuple(refit.index for refit in refits if not refit.converged),
        lost=tuple(refit.index for refit in refits if not refit.ranks),
    )


def _intervals(ranks: Counts, n_draws: int, n_unknown: int) -> tuple[Interval, ...]:
    """Between two of the sorted draws, so that their probability is exact: 25/100 ... 75/100."""
    found = []
    for level in LEVELS:
        out = math.floor(0.5 * (1.0 - level) * (n_draws + 1) + 0.5)
        share = 1.0 - 2 * out / (n_draws + 1)
        inside = int(((ranks >= out) & (ranks <= n_draws - out)).sum())
        alarm = 0.5 * FALSE_ALARM / (n_unknown * len(LEVELS))
        low, high = count_band(len(ranks), share, alarm)
        found.append(Interval(share=share, inside=inside, low=low, high=high))
    return tuple(found)
