"""Independent Gaussian noise, one standard deviation per channel, known or unknown."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.basics.entries import NoEntries
from bayesdrill.basics.symbols import noise_symbol
from bayesdrill.inference.noise.contract import Noisy, Residuals
from bayesdrill.inference.unknowns import Unknown


@dataclass(frozen=True, slots=True, kw_only=True)
class White:
    """`known`: sigma of channels (by index) that are given; the rest come as unknowns.  `counts (K,)`:
    samples of each channel, where some are missing.

    Normalised: `-T/2 log(2 pi sigma^2) - SS / (2 sigma^2)` per channel, with SS the misfit.
    """

    n_samples: int
    known: Mapping[int, float]
    n_channels: int
    unknowns: tuple[Unknown, ...] = ()
    counts: tuple[int, ...] | None = None

    white: ClassVar[bool] = True
    Entries: ClassVar[type] = NoEntries

    @classmethod
    def of(cls, channels: Sequence[Noisy], n_samples: int) -> White:
        known = {k: c.sigma for k, c in enumerate(channels) if isinstance(c.sigma, float)}
        unknowns = tuple(level(c) for c in channels if not isinstance(c.sigma, float))
        return cls(n_samples=n_samples, known=known, n_channels=len(channels), unknowns=unknowns)

    @property
    def unknown(self) -> tuple[int, ...]:
        return tuple(k for k in range(self.n_channels) if k not in self.known)

    def for_length(self, n_samples: int) -> White:
        return dataclasses.replace(self, n_samples=n_samples, counts=None)

    def seeing(self, counts: tuple[int, ...]) -> White:
        return dataclasses.replace(self, counts=counts)

    @property
    def sizes(self) -> Array:
        """Samples of each channel `(K,)`."""
        return np.array(self.counts or (self.n_samples,) * self.n_channels, dtype=np.float64)

    def held(self) -> Mapping[int, object]:
        return self.known

    def scales(self, noise_values: Array) -> Array:
        out = np.empty((len(noise_values), self.n_channels))
        for k, sigma in self.known.items():
            out[:, k] = sigma
        for column, k in enumerate(self.unknown):
            out[:, k] = noise_values[:, column]
        return out

    def log_likelihood(self, residuals: Residuals, noise_values: Array) -> Array:
        sigma = self.scales(noise_values)
        constant = -0.5 * self.sizes * math.log(2 * math.pi)
        return constant - self.sizes * np.log(sigma) - 0.5 * residuals.squares / sigma**2

    def pointwise(self, samples: Array, noise_values: Array) -> Array:
        sigma = self.scales(noise_values)[:, None, :]
        return -0.5 * math.log(2 * math.pi) - np.log(sigma) - 0.5 * (samples / sigma) ** 2

    def whiten(self, samples: Array, noise_values: Array) -> Array:
        return samples / self.scales(noise_values)[:, None, :]

    def innovations(self, samples: Array, noise_values: Array) -> Array:
        return samples

    def inform(self, shifts: Array, noise_values: Array) -> Array:
        return shifts / self.scales(noise_values)[:, None, :]

    def pull(self, samples: Array, noise_values: Array) -> Array:
        return samples / self.scales(noise_values)[:, None, :] ** 2

    def bend(self, residuals: Residuals, noise_values: Array) -> tuple[Array, Array]:
        """Far from the level that fits, the larger of the two curvatures keeps a step in bounds."""
        if not self.unknown:
            return np.zeros_like(noise_values), np.zeros_like(noise_values)
        left = residuals.weighed(1.0 / self.scales(noise_values))[:, list(self.unknown)]
        n = self.sizes[list(self.unknown)]
        return left - n, 2.0 * np.maximum(left, n)

    def expected(self, noise_values: Array) -> Array:
        return 2.0 * self.sizes[list(self.unknown)]

    def fitted(self, samples: Array, noise_values: Array) -> Array:
        return np.sqrt(np.nanmean(samples**2, axis=0))[list(self.unknown)]

    def draw(self, signals: Array, noise_values: Array, rng: np.random.Generator) -> Array:
        return signals + self.scales(noise_values)[:, None, :] * rng.standard_normal(signals.shape)


def level(noisy: Noisy) -> Unknown:
    """The unknown standard deviation of a channel's noise, `sigma_<channel>`."""
    channel = noisy.channel
    assert not isinstance(noisy.sigma, float)
    return Unknown(
        symbol=noise_symbol(channel.name, channel.unit, channel.latex, channel.latex_unit),
        role="noise",
        prior=noisy.sigma,
        start=noisy.start,
    )
