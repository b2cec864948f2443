"""Whether ensembles see the same: ranks of the draws of each among those of all.

Ranks as ArviZ plots them: where all ensembles draw from one distribution, the ranks of each are uniform
(Vehtari et al. 2021; Saeilynoja, Buerkner and Vehtari 2022).  How far chance takes them is found by
dealing the ranks out anew: tables of the same numbers of draws in all ensembles and all bins.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesdrill.engines.convergence import thinned

Array = NDArray[np.float64]
Counts = NDArray[np.int64]

BINS = 50
TABLES, BLOCK = 20_000, 2_000  # dealt out, so many at a time
FALSE_ALARM = 0.01  # of sound runs leave the band with any ensemble in any unknown, at most
APART = 2  # autocorrelation times between draws that count as independent


@dataclass(frozen=True, slots=True, kw_only=True)
class Ranks:
    """Of one unknown: `counts (E, BINS)` of each ensemble's draws, in bins of as many draws of all.

    `room (BINS - 1,)`: how far the counts below each share go from the expected by chance.
    """

    counts: Counts
    room: Array

    @property
    def draws(self) -> int:
        """Of each ensemble."""
        return int(self.counts[0].sum())

    @property
    def away(self) -> Array:
        """Counts below each share, less those expected: `(E, BINS - 1)`."""
        return np.cumsum(self.counts, axis=1)[:, :-1] - self.draws * SHARES

    @property
    def holds(self) -> NDArray[np.bool_]:
        """Of which ensembles `(E,)` chance explains the ranks."""
        return np.asarray(np.all(np.abs(self.away) <= self.room, axis=1))


SHARES = np.arange(1, BINS) / BINS


def independent(theta: Array, burn_in: int, tau: float) -> Array:
    """Of chains `(E, S, W, D)` the draws `(E, N, D)` that have forgotten each other."""
    kept = theta.shape[1] - burn_in
    return thinned(theta, burn_in, max(1, min(math.ceil(APART * tau), kept // 2)))


def ranks(draws: Array, rng: np.random.Generator) -> tuple[Ranks, ...]:
    """For each unknown, of independent draws `(E, N, D)` of two or more ensembles."""
    from arviz_stats.base import array_stats  # late: it takes half a second to load

    room = _room(draws.shape[0], draws.shape[1], FALSE_ALARM / draws.shape[2], rng)
    total, found = draws.shape[0] * draws.shape[1], []
    for d in range(draws.shape[2]):
        rank = array_stats.compute_ranks(draws[..., d], axis=None)  # type: ignore[no-untyped-call]
        bins = np.ceil(BINS * rank / total).astype(np.int64) - 1
        counts = np.stack([np.bincount(row, minlength=BINS) for row in bins])
        found.append(Ranks(counts=counts, room=room))
    return tuple(found)


def _room(n_ensembles: int, n: int, false_alarm: float, rng: np.random.Generator) -> Array:
    """Half-widths that any of the ensembles leaves with this probability."""
    from scipy.stats import random_table

    total = n_ensembles * n
    ends = np.floor(np.arange(BINS + 1) * total / BINS).astype(np.int64)
    spread = np.sqrt(n * SHARES * (1.0 - SHARES) * (total - n) / (total - 1))
    table = random_table(np.diff(ends), np.full(n_ensembles, n))
    farthest = []
    for _ in range(TABLES // BLOCK):
        dealt = np.cumsum(table.rvs(BLOCK, random_state=rng), axis=1)[:, :-1]
        away = np.abs(dealt - (n * SHARES)[:, None]) / spread[:, None]
        farthest.append(away.max(axis=(1, 2)))
    return np.asarray(spread * np.quantile(np.concatenate(farthest), 1.0 - false_alarm))
