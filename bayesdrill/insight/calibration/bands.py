"""How far uniform ranks wander by chance: exact bands for their distribution and for counts.

With the right posterior the rank of a true value among L draws is uniform on 0 ... L (Talts et al.
2018).  The band for the empirical distribution function of N ranks is that of Saeilynoja, Buerkner
and Vehtari (2022): pointwise binomial intervals of one level, chosen so that the whole function
stays inside with the wanted probability, which their recursion gives exactly.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import bdtr, gammaln

Array = NDArray[np.float64]
Counts = NDArray[np.int64]

HALVINGS = 40  # of the interval in which the pointwise level is sought


@dataclass(frozen=True, slots=True, kw_only=True)
class Band:
    """Of `n` ranks, between `low` and `high` (both allowed) are below `(i + 1) / (L + 1)`, each `(L,)`.

    `false_alarm`: the exact probability that uniform ranks leave it somewhere.
    """

    n: int
    shares: Array
    low: Counts
    high: Counts
    false_alarm: float

    def counts(self, ranks: Counts) -> Counts:
        """How many of `ranks (n,)` are below each share: `(L,)`."""
        n_draws = len(self.shares)
        return np.cumsum(np.bincount(ranks, minlength=n_draws + 1))[:n_draws]

    def reach(self, ranks: Counts) -> float:
        """The farthest departure from uniform, in half-widths of the band: above 1 is outside."""
        expected = self.n * self.shares
        away = self.counts(ranks) - expected
        room = np.where(away > 0, self.high, self.low) - expected
        open_ended = np.where(away > 0, self.high == self.n, self.low == 0)  # none can be outside
        room = np.where(room == 0.0, np.copysign(0.5, away), room)
        return float(np.max(away / room, where=~open_ended, initial=0.0))

    def holds(self, ranks: Counts) -> bool:
        found = self.counts(ranks)
        return bool(np.all((found >= self.low) & (found <= self.high)))


@functools.cache
def ecdf_band(n: int, n_draws: int, false_alarm: float) -> Band:
    """The narrowest band that `n` uniform ranks among `n_draws` leave with at most `false_alarm`."""
    shares = np.arange(1, n_draws + 1) / (n_draws + 1)
    table = bdtr(np.arange(n + 1)[:, None], n, shares)  # (n + 1, L): P(count <= row)
    inside, outside = 0.0, 1.0  # levels: at the first the band holds often enough
    low, high = _pointwise(table, inside)
    for _ in range(HALVINGS):
        level = 0.5 * (inside + outside) if inside > 0 else 0.1 * outside
        tried = _pointwise(table, level)
        if _stays(n, shares, *tried) >= 1.0 - false_alarm:
            inside, (low, high) = level, tried
        else:
            outside = level
    held = _stays(n, shares, low, high)
    return Band(n=n, shares=shares, low=low, high=high, false_alarm=1.0 - held)


@functools.cache
def count_band(n: int, share: float, false_alarm: float) -> tuple[int, int]:
    """The counts of `n` independent events of probability `share` to be expected, ends included."""
    low, high = _pointwise(bdtr(np.arange(n + 1)[:, None], n, np.array([share])), false_alarm)
    return int(low[0]), int(high[0])


def _pointwise(table: Array, level: float) -> tuple[Counts, Counts]:
    """Binomial intervals that leave at most `level / 2` out on either side."""
    low = (table <= 0.5 * level).sum(axis=0)
    high = (table < 1.0 - 0.5 * level).sum(axis=0)
    return low, np.minimum(high, len(table) - 1)


def _stays(n: int, shares: Array, low: Counts, high: Counts) -> float:
    """The probability that the counts of `n` uniforms stay between `low` and `high` at all shares.

    Counts are a Markov chain: of those still above one share, each is below the next one
    independently.
    """
    log_factorial = gammaln(np.arange(n + 1) + 1.0)
    have, probability, before = np.array([0]), np.array([1.0]), 0.0
    for share, first, last in zip(shares, low, high, strict=True):
        if last < first:
            return 0.0
        p = (share - before) / (1.0 - before)
        now = np.arange(first, last + 1)
        more = now[None, :] - have[:, None]
        left = n - have[:, None]
        new = np.maximum(more, 0)
        log_p = (
            log_factorial[left]
            - log_factorial[new]
            - log_factorial[left - np.minimum(new, left)]
            + new * np.log(p)
            + (left - new) * np.log1p(-p)
        )
        probability = probability @ np.where(more >= 0, np.exp(log_p), 0.0)
        have, before = now, share
    return float(probability.sum())
