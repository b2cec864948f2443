"""Gaussian noise that remembers: an autoregression of the first order in each channel, at any
spacing of samples.

A sample is `rho` times the one before it, and something new; all have the sd sigma.  `rho` is the
correlation of samples one usual interval of the channel apart, so that over a gap of g of these it is
rho to the power of g: what is missing, and uneven times, are allowed for exactly.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from bayesdrill.basics.arrays import Array, Flags, Indices
from bayesdrill.basics.symbols import Symbol
from bayesdrill.inference.noise.contract import Noisy, Numbers, Residuals, of_pairs
from bayesdrill.inference.noise.white import White
from bayesdrill.inference.priors import Uniform
from bayesdrill.inference.unknowns import Unknown

NEAR = 1e-3  # of an interval: times are rounded


@dataclass(frozen=True, slots=True)
class Apart:
    """Of one channel.  `rows`: its samples among all; `gaps (n - 1,)`: from one to the next, in its
    usual interval, and `every (T - 1,)`: of all samples; None where all of them are one.

    Residuals come as `(W, n)`, over sigma or not, with `rho (W,)`.
    """

    rows: slice | Indices
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
    seen: Flags

    @property
    def even(self) -> bool:
        return all(item.gaps is None for item in self.each)

    @classmethod
    def of(cls, t: Array, seen: Flags) -> Spacing:
        return cls(tuple(_apart(t, column) for column in seen.T), seen)


@lru_cache(maxsize=8)
def evenly(n_samples: int, n_channels: int) -> Spacing:
    """Of samples that are evenly spaced and all there."""
    seen = np.ones((n_samples, n_channels), dtype=bool)
    return Spacing((Apart(slice(None), n_samples, None, None),) * n_channels, seen)


def _apart(t: Array, seen: Flags) -> Apart:
    rows = np.flatnonzero(seen)
    steps = np.diff(t[rows])
    usual = float(np.median(steps)) if len(steps) else 1.0
    place = slice(None) if seen.all() else rows
    return Apart(place, len(rows), _gaps(steps / usual), _gaps(np.diff(t) / usual))


def _gaps(gaps: Array) -> Array | None:
    whole = np.round(gaps)
    spacing = np.where((np.abs(gaps - whole) < NEAR) & (whole > 0), whole, gaps)
    return None if (spacing == 1.0).all() else spacing


def _less(samples: Array, left: Array) -> Array:
    out = samples.copy()
    out[:, 1:] -= left[:, 1:] * samples[:, :-1]
    return out


START = 0.3  # of a search
MOST = 0.9999  # that what is left may tell: the end of the prior is no place to go on from


_SAID = "Correlation of samples one usual interval apart; default: unknown"


@dataclass(frozen=True, slots=True)
class Entries:
    rho: Annotated[float, Field(ge=0, lt=1, description=_SAID)] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class AR1:
    """Its unknowns are the sizes of all channels, then the correlations.  `spacing`: of the samples of
    each channel; None where they are evenly spaced and all there.
    """

    levels: White
    memory: Numbers
    unknowns: tuple[Unknown, ...]
    spacing: Spacing | None = field(default=None, repr=False, compare=False)

    white: ClassVar[bool] = False
    Entries: ClassVar[type] = Entries

    @classmethod
    def of(cls, channels: Sequence[Noisy], n_samples: int) -> AR1:
        levels = White.of(channels, n_samples)
        memory = Numbers(tuple(c.entries.get("rho") for c in channels), len(levels.unknowns))
        noise_symbols = [correlation(channels[k]) for k in memory.free]
        return cls(levels=levels, memory=memory, unknowns=(*levels.unknowns, *noise_symbols))

    @property
    def n_channels(self) -> int:
        return self.levels.n_channels

    def for_length(self, n_samples: int) -> AR1:
        return dataclasses.replace(self, levels=self.levels.for_length(n_samples), spacing=None)

    def on(self, t: Array, seen: Flags) -> AR1:
        levels = self.levels.for_length(len(t)).seeing(tuple(int(n) for n in seen.sum(axis=0)))
        return dataclasses.replace(self, levels=levels, spacing=Spacing.of(t, seen))

    def held(self) -> Mapping[int, object]:
        return self.memory.beside(self.levels.known)

    def scales(self, noise_values: Array) -> Array:
        return self.levels.scales(noise_values)

    def log_likelihood(self, residuals: Residuals, noise_values: Array) -> Array:
        if self.spacing is not None and not self.spacing.even:
            terms = self.pointwise(residuals.samples, noise_values)
            return np.asarray(np.where(self.spacing.seen, terms, 0.0).sum(axis=1))
        squares, products, last, first = np.moveaxis(residuals.neighbours, -1, 0)
        sigma, rho, n = self.scales(noise_values), self.memory.at(noise_values), self.levels.sizes
        inner = (1.0 - rho) * (1.0 + rho)
        fresh = squares - 2.0 * rho * products + rho**2 * (squares - first**2 - last**2)
        constant = -0.5 * n * math.log(2 * math.pi) - n * np.log(sigma)
        return np.asarray(
            constant - 0.5 * (n - 1.0) * np.log(inner) - 0.5 * fresh / inner / sigma**2
        )

    def pointwise(self, samples: Array, noise_values: Array) -> Array:
        sigma, rho, out = (
            self.scales(noise_values),
            self.memory.at(noise_values),
            np.full(samples.shape, np.nan),
        )
        for k, sample in enumerate(self._spacing(samples).each):
            _, share = sample.memory(rho[:, k])
            fresh = sample.fresh(samples[:, sample.rows, k], rho[:, k]) / sigma[:, k, None]
            out[:, sample.rows, k] = -0.5 * fresh**2 - np.log(sigma[:, k, None] * share)
        return out - 0.5 * math.log(2 * math.pi)

    def whiten(self, samples: Array, noise_values: Array) -> Array:
        sigma, rho, out = (
            self.scales(noise_values),
            self.memory.at(noise_values),
            np.full(samples.shape, np.nan),
        )
        for k, sample in enumerate(self._spacing(samples).each):
            out[:, sample.rows, k] = (
                sample.fresh(samples[:, sample.rows, k], rho[:, k]) / sigma[:, k, None]
            )
        return out

    def innovations(self, samples: Array, noise_values: Array) -> Array:
        rho, out = self.memory.at(noise_values), np.full(samples.shape, np.nan)
        for k, sample in enumerate(self._spacing(samples).each):
            out[:, sample.rows, k] = _less(samples[:, sample.rows, k], sample.memory(rho[:, k])[0])
        return out

    def inform(self, shifts: Array, noise_values: Array) -> Array:
        return np.nan_to_num(self.whiten(shifts, noise_values))

    def pull(self, samples: Array, noise_values: Array) -> Array:
        sigma, rho, out = (
            self.scales(noise_values),
            self.memory.at(noise_values),
            np.full(samples.shape, np.nan),
        )
        for k, sample in enumerate(self._spacing(samples).each):
            mine = samples[:, sample.rows, k]
            out[:, sample.rows, k] = sample.pulled(mine, rho[:, k]) / sigma[:, k, None] ** 2
        return out

    def bend(self, residuals: Residuals, noise_values: Array) -> tuple[Array, Array]:
        """The expected curvature, times what is left over the noise where that is more."""
        samples, sigma, rho = (
            residuals.samples,
            self.scales(noise_values),
            self.memory.at(noise_values),
        )
        slopes = np.empty((2, *sigma.shape))
        for k, sample in enumerate(self._spacing(samples).each):
            mine = samples[:, sample.rows, k] / sigma[:, k, None]
            slopes[0, :, k] = (sample.fresh(mine, rho[:, k]) ** 2).sum(axis=1) - sample.count
            slopes[1, :, k] = sample.by_rho(mine, rho[:, k])
        left = np.maximum(1.0, 1.0 + slopes[0] / self.levels.sizes)
        pairs = self._pairs(rho) * left[..., None, None]
        slope = np.hstack([slopes[0][:, self._free[0]], slopes[1][:, self._free[1]]])
        return slope, of_pairs(pairs, self._free)

    def expected(self, noise_values: Array) -> Array:
        return np.asarray(of_pairs(self._pairs(self.memory.at(noise_values[None])), self._free)[0])

    def fitted(self, samples: Array, noise_values: Array) -> Array:
        each = self._spacing(samples[None]).each
        told = [item.told(samples[item.rows, k]) for k, item in enumerate(each)]
        rho = np.clip(told, 1.0 - MOST, MOST)
        return np.append(self.levels.fitted(samples, noise_values), rho[self.memory.free])

    def draw(self, signals: Array, noise_values: Array, rng: np.random.Generator) -> Array:
        sigma, rho = self.scales(noise_values), self.memory.at(noise_values)
        out = rng.standard_normal(signals.shape)
        for k, signal in enumerate(self._spacing(signals).each):
            signal.remember(out[:, :, k], rho[:, k])
        return signals + sigma[:, None, :] * out

    @property
    def _free(self) -> tuple[list[int], list[int]]:
        return list(self.levels.unknown), self.memory.free

    def _spacing(self, samples: Array) -> Spacing:
        return self.spacing or evenly(samples.shape[1], self.n_channels)

    def _pairs(self, rho: Array) -> Array:
        """Information `(W, K, 2, 2)` about the log of sigma, and rho."""
        spacing = self.spacing or evenly(self.levels.n_samples, self.n_channels)
        each = [item.information(rho[:, k]) for k, item in enumerate(spacing.each)]
        return np.stack(each, axis=1)


def correlation(noisy: Noisy) -> Unknown:
    """The unknown correlation of neighbours in a channel's noise, `rho_<channel>`."""
    channel = noisy.channel
    meaning = f"correlation of neighbours in the noise of channel {channel.name}"
    return Unknown(
        symbol=Symbol(f"rho_{channel.name}", "1", rf"\rho_{{{channel.latex}}}", "", meaning),
        role="noise",
        prior=Uniform(0.0, 1.0),
        start=START,
        transform=(0.0, 1.0),
    )
