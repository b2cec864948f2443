"""Student's t noise is independent and has heavy tails; scale and degrees may be unknown.

Outliers are possible, and larger residuals have less weight in a fit.  `sigma` is the scale of the
distribution; the standard deviation is larger.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import numpy as np
import scipy
from pydantic import Field

from bayesdrill.basics.arrays import Array
from bayesdrill.basics.duals import Dual, affine_map, elementwise, log
from bayesdrill.basics.entries import LARGEST
from bayesdrill.inference.noise.contract import ChannelNumbers, NoisyChannel, Residuals, pair_matrix
from bayesdrill.inference.noise.white import IndependentNoise, White
from bayesdrill.inference.priors import LogUniform
from bayesdrill.inference.unknowns import Unknown

# Degrees of freedom: below 2 the sd is infinite, and at 100 the distribution is nearly normal.
MIN_DEGREES, MAX_DEGREES = 2.1, 100.0
START_DEGREES = 5.0  # start value of a search
_DESCRIPTION = "Degrees of freedom; inferred if not given"


Degrees = Annotated[float, Field(ge=MIN_DEGREES, le=LARGEST, description=_DESCRIPTION)]


@dataclass(frozen=True, slots=True)
class StudentTEntries:
    """The entry `noise:` of this kind may set `degrees`."""

    degrees: Degrees | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class StudentT(IndependentNoise):
    """The unknowns are the scales of all channels, then their degrees of freedom."""

    levels: White
    degrees: ChannelNumbers
    unknowns: tuple[Unknown, ...]

    white: ClassVar[bool] = False
    Entries: ClassVar[type] = StudentTEntries

    @classmethod
    def from_channels(cls, channels: Sequence[NoisyChannel], n_samples: int) -> StudentT:
        levels = White.from_channels(channels, n_samples)
        fixed = tuple(c.entries.get("degrees") for c in channels)
        degrees = ChannelNumbers(fixed, len(levels.unknowns))
        prior = LogUniform(MIN_DEGREES, MAX_DEGREES)
        meaning = "degrees of freedom of"
        own = degrees.unknowns(channels, "nu", meaning, prior=prior, start=START_DEGREES)
        return cls(levels=levels, degrees=degrees, unknowns=(*levels.unknowns, *own))

    @property
    def normal(self) -> White:
        """Return normal noise with the same scales."""
        return self.levels

    def fixed_values(self) -> Mapping[int, object]:
        return self.degrees.with_sizes(self.levels.known)

    def scales(self, theta: Array) -> Array:
        nu = self.degrees.values(theta)
        return np.asarray(self.levels.scales(theta) * np.sqrt(nu / (nu - 2.0)))

    def log_likelihood(self, residuals: Residuals, theta: Array) -> Array:
        scale, nu = self.levels.scales(theta), self.degrees.values(theta)
        logs = residuals.logs(1.0 / (nu * scale**2))
        return np.asarray(self.levels.sizes * _constant(scale, nu) - 0.5 * (nu + 1.0) * logs)

    def pointwise(self, samples: Any, theta: Any) -> Any:
        return _log_density(samples, *self._each(theta))

    def whiten(self, samples: Array, theta: Array) -> Array:
        """Map samples to standard normal scores `(W, T, K)`, by their tail probability."""
        scale, nu = self._each(theta)
        tail = scipy.special.stdtr(nu, -np.abs(samples) / scale)
        return np.asarray(-np.sign(samples) * scipy.special.ndtri(tail))

    def whitened_jacobian(self, shifts: Array, theta: Array) -> Array:
        scale, nu = self._each(theta)
        return np.asarray(shifts / scale * np.sqrt((nu + 1.0) / (nu + 3.0)))

    def noise_score(self, residuals: Residuals, theta: Array) -> tuple[Array, Array]:
        """Return slopes and the expected curvature, increased if residuals are above their scale."""
        scale, nu = self._each(theta)
        samples, n = residuals.samples, self.levels.sizes
        zeros = np.zeros_like(scale)
        # The slopes `(2, W, T, K)` are derivatives with respect to log scale and log degrees.
        duals = Dual(scale, np.stack([scale, zeros])), Dual(nu, np.stack([zeros, nu]))
        by_scale, by_nu = np.nansum(_log_density(samples, *duals).slope, axis=2)
        inflation = np.maximum(1.0, 1.0 + by_scale / n)
        pairs = self._pairs(nu[:, 0]) * inflation[..., None, None]
        slope = np.hstack([by_scale[:, self._free[0]], by_nu[:, self._free[1]]])
        return slope, pair_matrix(pairs, self._free)

    def expected(self, theta: Array) -> Array:
        return np.asarray(pair_matrix(self._pairs(self.degrees.values(theta[None])), self._free)[0])

    def draw(self, signals: Array, theta: Array, rng: np.random.Generator) -> Array:
        scale, nu = self._each(theta)
        return np.asarray(signals + scale * rng.standard_t(np.broadcast_to(nu, signals.shape)))

    @property
    def _free(self) -> tuple[list[int], list[int]]:
        return list(self.levels.unknown), self.degrees.free

    def _each(self, theta: Any) -> tuple[Any, Any]:
        """Return scales and degrees, `(W, 1, K)` each."""
        scale, nu = affine_map(self.levels.scales, theta), affine_map(self.degrees.values, theta)
        return scale[:, None], nu[:, None]

    def _pairs(self, nu: Array) -> Array:
        """Return information `(W, K, 2, 2)` on the logs of scale and degrees (Lange and others 1989)."""
        out = np.empty((*nu.shape, 2, 2))
        out[..., 0, 0] = 2.0 * nu / (nu + 3.0)
        out[..., 0, 1] = out[..., 1, 0] = -2.0 * nu / ((nu + 1.0) * (nu + 3.0))
        turn = scipy.special.polygamma(1, 0.5 * nu) - scipy.special.polygamma(1, 0.5 * (nu + 1.0))
        out[..., 1, 1] = turn - 2.0 * (nu + 5.0) / (nu * (nu + 1.0) * (nu + 3.0))
        out[..., 1, 1] *= 0.25 * nu**2
        return np.asarray(out * self.levels.sizes[:, None, None])


def _log_density(samples: Any, scale: Any, nu: Any) -> Any:
    """Return the log density of samples; arguments are arrays or dual numbers."""
    ratio = samples**2 / (nu * scale**2)
    logs = elementwise(np.log1p, lambda x: 1.0 / (1.0 + x), ratio)
    return _constant(scale, nu) - 0.5 * (nu + 1.0) * logs


def _constant(scale: Any, nu: Any) -> Any:
    """Return the log density of a residual of zero."""
    gammaln, digamma = scipy.special.gammaln, scipy.special.digamma
    upper, lower = (elementwise(gammaln, digamma, 0.5 * degrees) for degrees in (nu + 1.0, nu))
    return upper - lower - 0.5 * log(math.pi * nu) - log(scale)
