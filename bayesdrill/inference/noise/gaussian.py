"""Independent Gaussian noise, one standard deviation per channel, known or unknown."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Gaussian:
    """`known`: sigma of channels (by index) that are given; the rest come as unknowns.

    Normalised: `-T/2 log(2 pi sigma^2) - SS / (2 sigma^2)` per channel, with SS the misfit.
    """

    n_samples: int
    known: Mapping[int, float]
    n_channels: int

    @property
    def unknown(self) -> tuple[int, ...]:
        return tuple(k for k in range(self.n_channels) if k not in self.known)

    def sigmas(self, unknown: Array) -> Array:
        """`(W, K)` from the unknown sigmas `(W, len(self.unknown))`, SI."""
        out = np.empty((len(unknown), self.n_channels))
        for k, sigma in self.known.items():
            out[:, k] = sigma
        for column, k in enumerate(self.unknown):
            out[:, k] = unknown[:, column]
        return out

    def log_likelihood(self, misfit: Array, unknown: Array) -> Array:
        """`(W, K)` per channel, from sums of squared residuals `(W, K)`."""
        sigma = self.sigmas(unknown)
        constant = -0.5 * self.n_samples * math.log(2 * math.pi)
        return constant - self.n_samples * np.log(sigma) - 0.5 * misfit / sigma**2

    def pointwise(self, residuals: Array, unknown: Array) -> Array:
        """`(W, T, K)` log densities of single samples."""
        sigma = self.sigmas(unknown)[:, None, :]
        return -0.5 * math.log(2 * math.pi) - np.log(sigma) - 0.5 * (residuals / sigma) ** 2

    def draw(self, signals: Array, unknown: Array, rng: np.random.Generator) -> Array:
        """Signals `(W, T, K)` with fresh noise."""
        return signals + self.sigmas(unknown)[:, None, :] * rng.standard_normal(signals.shape)
