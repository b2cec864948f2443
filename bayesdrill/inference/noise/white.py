"""White noise is independent and Gaussian, with a known or unknown standard deviation per channel."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.basics.duals import Dual, affine_map, log
from bayesdrill.basics.entries import NoEntries
from bayesdrill.basics.symbols import noise_symbol
from bayesdrill.inference.noise.contract import NoisyChannel, Residuals
from bayesdrill.inference.unknowns import Unknown


@dataclass(frozen=True, slots=True, kw_only=True)
class White:
    """White noise has the log density `-T/2 log(2 pi sigma^2) - SS / (2 sigma^2)` per channel.

    SS is the sum of squared residuals.  `known` maps indices of channels to a given sigma in SI;
    other sigmas are unknown.  `counts (K,)` are numbers of samples, if some are missing.
    """

    n_samples: int
    known: Mapping[int, float]
    n_channels: int
    unknowns: tuple[Unknown, ...] = ()
    counts: tuple[int, ...] | None = None

    white: ClassVar[bool] = True
    Entries: ClassVar[type] = NoEntries

    @classmethod
    def from_channels(cls, channels: Sequence[NoisyChannel], n_samples: int) -> White:
        """Build the noise of these channels; a sigma with a prior becomes an unknown."""
        known, levels = dict[int, float](), []
        for k, noisy in enumerate(channels):
            if isinstance(noisy.sigma, float):
                known[k] = noisy.sigma
                continue
            c = noisy.channel
            symbol = noise_symbol(c.name, c.unit, c.latex, c.latex_unit)
            level = Unknown(symbol=symbol, role="noise", prior=noisy.sigma, start=noisy.start)
            levels.append(level)
        n, unknowns = len(channels), tuple(levels)
        return cls(n_samples=n_samples, known=known, n_channels=n, unknowns=unknowns)

    @property
    def unknown(self) -> tuple[int, ...]:
        """Return the channels whose sigma is unknown."""
        return tuple(k for k in range(self.n_channels) if k not in self.known)

    def for_length(self, n_samples: int) -> White:
        return dataclasses.replace(self, n_samples=n_samples, counts=None)

    def with_counts(self, counts: tuple[int, ...]) -> White:
        return dataclasses.replace(self, counts=counts)

    @property
    def sizes(self) -> Array:
        """Return the number of samples of each channel `(K,)`."""
        return np.array(self.counts or (self.n_samples,) * self.n_channels, dtype=np.float64)

    def fixed_values(self) -> Mapping[int, object]:
        return self.known

    def scales(self, theta: Array) -> Array:
        out = np.empty((len(theta), self.n_channels))
        for k, sigma in self.known.items():
            out[:, k] = sigma
        for column, k in enumerate(self.unknown):
            out[:, k] = theta[:, column]
        return out

    def square_weights(self, theta: Array) -> Array:
        """Return the weights `(W, K, 1)` of sums of squares; see `Noise.square_weights`."""
        return np.asarray((1.0 / self.scales(theta)[..., None]) ** 2)

    def log_likelihood(self, residuals: Residuals, theta: Array) -> Array:
        sigma = self.scales(theta)
        constant = -0.5 * self.sizes * math.log(2 * math.pi)
        return constant - self.sizes * np.log(sigma) - 0.5 * residuals.squares / sigma**2

    def pointwise(self, samples: Any, theta: Any) -> Any:
        sigma = affine_map(self.scales, theta)[:, None]
        return -0.5 * math.log(2 * math.pi) - log(sigma) - 0.5 * (samples / sigma) ** 2

    def whiten(self, samples: Array, theta: Array) -> Array:
        return samples / self.scales(theta)[:, None, :]

    def innovations(self, samples: Array, theta: Array) -> Array:
        """Return the samples, which are independent: `(W, T, K)`, SI."""
        return samples

    def whitened_jacobian(self, shifts: Array, theta: Array) -> Array:
        return shifts / self.scales(theta)[:, None, :]

    def score(self, samples: Array, theta: Array) -> Array:
        return samples / self.scales(theta)[:, None, :] ** 2

    def noise_score(self, residuals: Residuals, theta: Array) -> tuple[Array, Array]:
        """Return slopes and curvature by the logs of unknown sigmas.

        The larger of actual and expected curvature bounds a step if sigma is far from its optimum.
        """
        if not self.unknown:
            return np.zeros_like(theta), np.zeros_like(theta)
        squares = residuals.weighted_squares(1.0 / self.scales(theta))[:, list(self.unknown)]
        n = self.sizes[list(self.unknown)]
        return squares - n, 2.0 * np.maximum(squares, n)

    def expected(self, theta: Array) -> Array:
        return 2.0 * self.sizes[list(self.unknown)]

    def draw(self, signals: Array, theta: Array, rng: np.random.Generator) -> Array:
        return signals + self.scales(theta)[:, None, :] * rng.standard_normal(signals.shape)


class IndependentNoise:
    """Noises with independent samples derive from this class; `levels` holds their sigmas."""

    __slots__ = ()

    levels: White

    def for_length(self, n_samples: int) -> Self:
        return self._with(self.levels.for_length(n_samples))

    def with_counts(self, counts: tuple[int, ...]) -> Self:
        return self._with(self.levels.with_counts(counts))

    def _with(self, levels: White) -> Self:
        return dataclasses.replace(self, levels=levels)  # type: ignore[type-var]  # subclasses are

    def pointwise(self, samples: Any, theta: Any) -> Any:
        raise NotImplementedError

    def score(self, samples: Array, theta: Array) -> Array:
        moved = Dual(samples, -np.ones_like(samples))
        return np.asarray(self.pointwise(moved, Dual(theta, np.zeros_like(theta))).slope)

    def square_weights(self, theta: Array) -> None:
        """Return None, as sums of squares do not suffice; see `Noise.square_weights`."""

    def innovations(self, samples: Array, theta: Array) -> Array:
        """Return the samples, which are independent: `(W, T, K)`, SI."""
        return samples
