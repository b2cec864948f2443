"""Gaussian noise that remembers: an autoregression of the first order in each channel.

A sample is `rho` times the one before it, and something new; all have the sd sigma.  `rho` is the
correlation of samples one usual interval of the channel apart, so that over a gap of g of these it is
rho to the power of g: what is missing, and uneven times, are allowed for exactly.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from bayesdrill.basics.symbols import Symbol
from bayesdrill.inference.noise.contract import Noisy, Residuals
from bayesdrill.inference.noise.numbers import Numbers, of_pairs
from bayesdrill.inference.noise.spacing import Spacing
from bayesdrill.inference.noise.white import White
from bayesdrill.inference.priors import Uniform
from bayesdrill.inference.unknowns import Unknown

Array = NDArray[np.float64]

START = 0.3  # of a search
MOST = 0.9999  # that what is left may tell: the end of the prior is no place to go on from


@dataclass(frozen=True, slots=True)
class Entries:
    rho: (
        Annotated[
            float,
            Field(
                ge=0,
                lt=1,
                description="Correlation of samples one usual interval apart; default: unknown",
            ),
        ]
        | None
    ) = None


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
        own = [correlation(channels[k]) for k in memory.free]
        return cls(levels=levels, memory=memory, unknowns=(*levels.unknowns, *own))

    @property
    def n_channels(self) -> int:
        return self.levels.n_channels

    def for_length(self, n_samples: int) -> AR1:
        return dataclasses.replace(self, levels=self.levels.for_length(n_samples), spacing=None)

    def on(self, t: Array, seen: NDArray[np.bool_]) -> AR1:
        levels = self.levels.for_length(len(t)).seeing(tuple(int(n) for n in seen.sum(axis=0)))
        return dataclasses.replace(self, levels=levels, spacing=Spacing.of(t, seen))

    def held(self) -> Mapping[int, object]:
        return self.memory.beside(self.levels.known)

    def scales(self, own: Array) -> Array:
        return self.levels.scales(own)

    def log_likelihood(self, residuals: Residuals, own: Array) -> Array:
        if self.spacing is not None and not self.spacing.even:
            terms = self.pointwise(residuals.samples, own)
            return np.asarray(np.where(self.spacing.seen, terms, 0.0).sum(axis=1))
        squares, products, last, first = np.moveaxis(residuals.neighbours, -1, 0)
        sigma, rho, n = self.scales(own), self.memory.at(own), self.levels.sizes
        inner = (1.0 - rho) * (1.0 + rho)
        fresh = squares - 2.0 * rho * products + rho**2 * (squares - first**2 - last**2)
        constant = -0.5 * n * math.log(2 * math.pi) - n * np.log(sigma)
        return np.asarray(
            constant - 0.5 * (n - 1.0) * np.log(inner) - 0.5 * fresh / inner / sigma**2
        )

    def pointwise(self, samples: Array, own: Array) -> Array:
        sigma, rho, out = self.scales(own), self.memory.at(own), np.full(samples.shape, np.nan)
        for k, one in enumerate(self._spacing(samples).each):
            _, share = one.memory(rho[:, k])
            fresh = one.fresh(samples[:, one.rows, k], rho[:, k]) / sigma[:, k, None]
            out[:, one.rows, k] = -0.5 * fresh**2 - np.log(sigma[:, k, None] * share)
        return out - 0.5 * math.log(2 * math.pi)

    def whiten(self, samples: Array, own: Array) -> Array:
        sigma, rho, out = self.scales(own), self.memory.at(own), np.full(samples.shape, np.nan)
        for k, one in enumerate(self._spacing(samples).each):
            out[:, one.rows, k] = one.fresh(samples[:, one.rows, k], rho[:, k]) / sigma[:, k, None]
        return out

    def inform(self, shifts: Array, own: Array) -> Array:
        return np.nan_to_num(self.whiten(shifts, own))

    def pull(self, samples: Array, own: Array) -> Array:
        sigma, rho, out = self.scales(own), self.memory.at(own), np.full(samples.shape, np.nan)
        for k, one in enumerate(self._spacing(samples).each):
            mine = samples[:, one.rows, k]
            out[:, one.rows, k] = one.pulled(mine, rho[:, k]) / sigma[:, k, None] ** 2
        return out

    def bend(self, residuals: Residuals, own: Array) -> tuple[Array, Array]:
        """The expected curvature, times what is left over the noise where that is more."""
        samples, sigma, rho = residuals.samples, self.scales(own), self.memory.at(own)
        slopes = np.empty((2, *sigma.shape))
        for k, one in enumerate(self._spacing(samples).each):
            mine = samples[:, one.rows, k] / sigma[:, k, None]
            slopes[0, :, k] = (one.fresh(mine, rho[:, k]) ** 2).sum(axis=1) - one.count
            slopes[1, :, k] = one.by_rho(mine, rho[:, k])
        left = np.maximum(1.0, 1.0 + slopes[0] / self.levels.sizes)
        pairs = self._pairs(rho) * left[..., None, None]
        slope = np.hstack([slopes[0][:, self._free[0]], slopes[1][:, self._free[1]]])
        return slope, of_pairs(pairs, self._free)

    def expected(self, own: Array) -> Array:
        return np.asarray(of_pairs(self._pairs(self.memory.at(own[None])), self._free)[0])

    def fitted(self, samples: Array, own: Array) -> Array:
        each = self._spacing(samples[None]).each
        told = [one.told(samples[one.rows, k]) for k, one in enumerate(each)]
        rho = np.clip(told, 1.0 - MOST, MOST)
        return np.append(self.levels.fitted(samples, own), rho[self.memory.free])

    def draw(self, signals: Array, own: Array, rng: np.random.Generator) -> Array:
        sigma, rho = self.scales(own), self.memory.at(own)
        out = rng.standard_normal(signals.shape)
        for k, one in enumerate(self._spacing(signals).each):
            one.remember(out[:, :, k], rho[:, k])
        return signals + sigma[:, None, :] * out

    @property
    def _free(self) -> tuple[list[int], list[int]]:
        return list(self.levels.unknown), self.memory.free

    def _spacing(self, samples: Array) -> Spacing:
        return self.spacing or Spacing.evenly(samples.shape[1], self.n_channels)

    def _pairs(self, rho: Array) -> Array:
        """Information `(W, K, 2, 2)` about the log of sigma, and rho."""
        spacing = self.spacing or Spacing.evenly(self.levels.n_samples, self.n_channels)
        each = [one.information(rho[:, k]) for k, one in enumerate(spacing.each)]
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
