"""A noise that remembers: each residual is `correlation` times the one before, and something new."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from bayesdrill.basics import Symbol
from bayesdrill.basics.duals import affine_map, linear_map, log
from bayesdrill.inference import NoisyChannel, Residuals, Uniform, Unknown, White

Array = NDArray[np.float64]
MOST = 0.99


@dataclass(frozen=True, slots=True)
class Entries:
    correlation: (
        Annotated[float, Field(ge=-MOST, le=MOST, description="Unknown by default")] | None
    ) = None


@dataclass(frozen=True, slots=True)
class Memory:
    """Stationary: all samples have the sd `sigma`.  Its unknowns are sigmas, then correlations."""

    levels: White
    held_: tuple[float | None, ...]
    unknowns: tuple[Unknown, ...]

    white: ClassVar[bool] = False
    Entries: ClassVar[type] = Entries

    @classmethod
    def from_channels(cls, channels: Sequence[NoisyChannel], n_samples: int) -> Memory:
        levels = White.from_channels(channels, n_samples)
        held = tuple(c.entries.get("correlation") for c in channels)
        own = [_unknown(c) for c, value in zip(channels, held, strict=True) if value is None]
        return cls(levels, held, (*levels.unknowns, *own))

    def for_length(self, n_samples: int) -> Memory:
        return dataclasses.replace(self, levels=self.levels.for_length(n_samples))

    def fixed_values(self) -> Mapping[int, object]:
        return {
            k: (self.levels.known.get(k), correlation) for k, correlation in enumerate(self.held_)
        }

    def scales(self, own: Array) -> Array:
        return self.levels.scales(own[:, : len(self.levels.unknowns)])

    def _correlations(self, own: Array) -> Array:
        out, column = np.empty((len(own), self.levels.n_channels)), len(self.levels.unknowns)
        for k, value in enumerate(self.held_):
            out[:, k] = own[:, column] if value is None else value
            column += value is None
        return out

    def pointwise(self, samples: Any, own: Any) -> Any:
        """Numbers may have slopes here: all is written with what `bayesdrill.basics.duals` has."""
        sigma, rho = (affine_map(f, own)[:, None] for f in (self.scales, self._correlations))
        weight = rho * (np.arange(self.levels.n_samples) > 0)[:, None]  # of the sample before
        before = linear_map(lambda x: np.roll(x, 1, axis=1), samples)
        sd = sigma * (1.0 - weight**2) ** 0.5
        left = (samples - weight * before) / sd
        return -0.5 * math.log(2 * math.pi) - log(sd) - 0.5 * left**2

    def square_weights(self, own: Array) -> None:
        """What it is asked for are samples."""

    def log_likelihood(self, residuals: Residuals, own: Array) -> Array:
        return self.pointwise(residuals.samples, own).sum(axis=1)

    def whiten(self, samples: Array, own: Array) -> Array:
        sigma, rho = self.scales(own)[:, None], self._correlations(own)[:, None]
        out = samples / sigma
        out[:, 1:] = (out[:, 1:] - rho * samples[:, :-1] / sigma) / np.sqrt(1.0 - rho**2)
        return out

    def innovations(self, samples: Array, own: Array) -> Array:
        out = samples.copy()
        out[:, 1:] -= self._correlations(own)[:, None] * samples[:, :-1]
        return out

    def whitened_jacobian(self, shifts: Array, own: Array) -> Array:
        return self.whiten(shifts, own)

    def score(self, samples: Array, own: Array) -> Array:
        sigma, rho = self.scales(own)[:, None], self._correlations(own)[:, None]
        left, root = self.whiten(samples, own), np.sqrt(1.0 - rho**2)
        out = left / sigma
        out[:, 1:] /= root
        out[:, :-1] -= rho * left[:, 1:] / (sigma * root)
        return out

    def noise_score(self, residuals: Residuals, own: Array) -> tuple[Array, Array]:
        left, rho = self.whiten(residuals.samples, own), self._correlations(own)
        n = left.shape[1]
        squares = (left**2).sum(axis=1)
        by_level = (squares - n)[:, list(self.levels.unknown)]
        before = residuals.samples[:, :-1] / self.scales(own)[:, None]
        inner = 1.0 - rho**2
        by_rho = ((n - 1) * rho - (left[:, 1:] ** 2).sum(axis=1) * rho) / inner
        by_rho += (left[:, 1:] * before).sum(axis=1) / np.sqrt(inner)
        free = [k for k, value in enumerate(self.held_) if value is None]
        curved = np.maximum((before**2).sum(axis=1), n) / inner + 2 * n * rho**2 / inner**2
        levels = 2.0 * np.maximum(squares, n)[:, list(self.levels.unknown)]
        return np.hstack([by_level, by_rho[:, free]]), np.hstack([levels, curved[:, free]])

    def expected(self, own: Array) -> Array:
        n, rho = self.levels.n_samples, self._correlations(own[None])[0]
        curved = (n - 1) * (1.0 + rho**2) / (1.0 - rho**2) ** 2
        mixed = -2.0 * (n - 1) * rho / (1.0 - rho**2)  # of the log of sigma and rho
        levels = list(self.levels.unknown)
        free = [k for k, value in enumerate(self.held_) if value is None]
        both = np.equal.outer(levels, free) * mixed[free]
        return np.block(
            [[np.diag(np.full(len(levels), 2.0 * n)), both], [both.T, np.diag(curved[free])]]
        )

    def draw(self, signals: Array, own: Array, rng: np.random.Generator) -> Array:
        sigma, rho = self.scales(own), self._correlations(own)
        fresh = rng.standard_normal(signals.shape)
        fresh[:, 1:] *= np.sqrt(1.0 - rho**2)[:, None]
        for k in range(1, fresh.shape[1]):
            fresh[:, k] += rho * fresh[:, k - 1]
        return signals + sigma[:, None] * fresh


def _unknown(noisy: NoisyChannel) -> Unknown:
    name = noisy.channel.name
    latex = rf"\rho_{{{noisy.channel.latex}}}"
    symbol = Symbol(f"rho_{name}", "1", latex, "", f"correlation of neighbours in {name}")
    prior = Uniform(-MOST, MOST)
    return Unknown(symbol=symbol, role="noise", prior=prior, start=0.1, transform=(-1.0, 1.0))
