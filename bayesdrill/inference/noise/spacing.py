"""How far samples of a channel are apart, and what a noise that remembers makes of that."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

NEAR = 1e-3  # of an interval: times are rounded


@dataclass(frozen=True, slots=True)
class Apart:
    """Of one channel.  `rows`: its samples among all; `gaps (n - 1,)`: from one to the next, in its
    usual interval, and `every (T - 1,)`: of all samples; None where all of them are one.

    Residuals come as `(W, n)`, over sigma or not, with `rho (W,)`.
    """

    rows: slice | NDArray[np.intp]
    count: int
    gaps: Array | None
    every: Array | None

    def memory(self, rho: Array, *, every: bool = False) -> tuple[Array, Array]:
        """Share of the sample before that is left `(W, n)`, and sd of what is new, over sigma; of the
        first sample zero, and one.
        """
        gaps = self.every if every else self.gaps
        if gaps is None:
            wide = np.array(
                [[np.inf, *np.ones(min(self.count, 2) - 1)]]
            )  # the first, and all others
        else:
            wide = np.concatenate([[np.inf], gaps])[None]
        with np.errstate(divide="ignore"):
            logs = np.log(rho)[:, None] * wide
        left, new = np.exp(logs), np.sqrt(-np.expm1(2.0 * logs))
        if gaps is None:
            places = np.minimum(np.arange(self.count), 1)
            return left[:, places], new[:, places]
        return left, new

    def fresh(self, samples: Array, rho: Array) -> Array:
        """What is new in each, all of one sd: that of the samples."""
        left, new = self.memory(rho)
        return _less(samples, left) / new

    def pulled(self, samples: Array, rho: Array) -> Array:
        """Minus half the slopes of the sum of squares of `fresh`, by each sample; its sign turned."""
        left, new = self.memory(rho)
        over = _less(samples, left) / new**2
        out = over.copy()
        out[:, :-1] -= left[:, 1:] * over[:, 1:]
        return out

    def by_rho(self, samples: Array, rho: Array) -> Array:
        """Slope of the log density `(W,)` by rho, of samples over sigma."""
        left, new = self.memory(rho)
        fresh = _less(samples, left) / new
        by_left = left * (1.0 - fresh**2) / new**2
        by_left[:, 1:] += fresh[:, 1:] * samples[:, :-1] / new[:, 1:]
        return np.asarray((by_left * self._by_rho(left, rho)).sum(axis=1))

    def information(self, rho: Array) -> Array:
        """`(W, 2, 2)` of the log of sigma and rho, as it is expected."""
        left, new = self.memory(rho)
        turn = self._by_rho(left, rho)
        out = np.empty((len(rho), 2, 2))
        out[:, 0, 0] = 2.0 * self.count
        out[:, 0, 1] = out[:, 1, 0] = -2.0 * (left * turn / new**2).sum(axis=1)
        out[:, 1, 1] = (turn**2 * (1.0 + left**2) / new**4).sum(axis=1)
        return out

    def _by_rho(self, left: Array, rho: Array) -> Array:
        """d left / d rho; of the first sample zero."""
        gaps = np.ones(self.count - 1) if self.gaps is None else self.gaps
        out = np.zeros_like(left)
        out[:, 1:] = gaps * rho[:, None] ** (gaps - 1.0)
        return out

    def told(self, samples: Array) -> float:
        """rho by samples `(n,)` about an interval apart."""
        near = np.ones(self.count - 1, bool) if self.gaps is None else np.abs(self.gaps - 1.0) < 0.5
        before, after = samples[:-1][near], samples[1:][near]
        squares = 0.5 * float(before @ before + after @ after)
        return float(before @ after) / squares if squares > 0 else 0.0

    def remember(self, fresh: Array, rho: Array) -> None:
        """Turns `fresh (W, T)`, independent and of sd 1, into noise of all samples, in place."""
        whole = Apart(slice(None), fresh.shape[1], self.every, None)
        left, new = whole.memory(rho)
        fresh *= new
        for k in range(1, fresh.shape[1]):
            fresh[:, k] += left[:, k] * fresh[:, k - 1]


@dataclass(frozen=True, slots=True)
class Spacing:
    """Of all channels; `seen (T, K)`.  `even`: each channel's own samples are one interval apart."""

    each: tuple[Apart, ...]
    seen: Mask

    @property
    def even(self) -> bool:
        return all(one.gaps is None for one in self.each)

    @classmethod
    def of(cls, t: Array, seen: Mask) -> Spacing:
        return cls(tuple(_apart(t, column) for column in seen.T), seen)

    @classmethod
    def evenly(cls, n_samples: int, n_channels: int) -> Spacing:
        return _evenly(n_samples, n_channels)


@lru_cache(maxsize=8)
def _evenly(n_samples: int, n_channels: int) -> Spacing:
    seen = np.ones((n_samples, n_channels), dtype=bool)
    return Spacing((Apart(slice(None), n_samples, None, None),) * n_channels, seen)


def _apart(t: Array, seen: Mask) -> Apart:
    rows = np.flatnonzero(seen)
    steps = np.diff(t[rows])
    usual = float(np.median(steps)) if len(steps) else 1.0
    place = slice(None) if seen.all() else rows
    return Apart(place, len(rows), _gaps(steps / usual), _gaps(np.diff(t) / usual))


def _gaps(gaps: Array) -> Array | None:
    whole = np.round(gaps)
    found = np.where((np.abs(gaps - whole) < NEAR) & (whole > 0), whole, gaps)
    return None if (found == 1.0).all() else found


def _less(samples: Array, left: Array) -> Array:
    out = samples.copy()
    out[:, 1:] -= left[:, 1:] * samples[:, :-1]
    return out
