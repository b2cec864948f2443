"""Independent noise with heavy tails: Student's t, known or unknown scale and degrees of freedom.

Now and then a sample is far off, and counts for less the farther it is.  `sigma` is the scale of the
distribution, which most samples keep to; its standard deviation is larger.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
import scipy
from pydantic import Field

from bayesdrill.basics.arrays import Array
from bayesdrill.basics.entries import LARGEST
from bayesdrill.basics.symbols import Symbol
from bayesdrill.inference.noise.contract import Noisy, Numbers, Residuals, of_pairs
from bayesdrill.inference.noise.white import White
from bayesdrill.inference.priors import LogUniform
from bayesdrill.inference.unknowns import Unknown

LEAST, MOST = 2.1, 100.0  # degrees of freedom: below 2 there is no sd, and far above it is Gauss's
START = 5.0  # of a search
GRID, ROUNDS = 64, 200  # of degrees that are tried on what is left, and to find the scale of each


_SAID = "Degrees of freedom; default: unknown"


@dataclass(frozen=True, slots=True)
class Entries:
    degrees: Annotated[float, Field(ge=LEAST, le=LARGEST, description=_SAID)] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class StudentT:
    """Its unknowns are the scales of all channels, then the degrees of freedom."""

    levels: White
    degrees: Numbers
    unknowns: tuple[Unknown, ...]

    white: ClassVar[bool] = False
    Entries: ClassVar[type] = Entries

    @classmethod
    def of(cls, channels: Sequence[Noisy], n_samples: int) -> StudentT:
        levels = White.of(channels, n_samples)
        degrees = Numbers(tuple(c.entries.get("degrees") for c in channels), len(levels.unknowns))
        noise_symbols = [freedom(channels[k]) for k in degrees.free]
        return cls(levels=levels, degrees=degrees, unknowns=(*levels.unknowns, *noise_symbols))

    @property
    def n_channels(self) -> int:
        return self.levels.n_channels

    def for_length(self, n_samples: int) -> StudentT:
        return dataclasses.replace(self, levels=self.levels.for_length(n_samples))

    def seeing(self, counts: tuple[int, ...]) -> StudentT:
        return dataclasses.replace(self, levels=self.levels.seeing(counts))

    def held(self) -> Mapping[int, object]:
        return self.degrees.beside(self.levels.known)

    def scales(self, noise_values: Array) -> Array:
        nu = self.degrees.at(noise_values)
        return np.asarray(self.levels.scales(noise_values) * np.sqrt(nu / (nu - 2.0)))

    def log_likelihood(self, residuals: Residuals, noise_values: Array) -> Array:
        scale, nu = self.levels.scales(noise_values), self.degrees.at(noise_values)
        logs = residuals.logs(1.0 / (nu * scale**2))
        return np.asarray(self.levels.sizes * _constant(scale, nu) - 0.5 * (nu + 1.0) * logs)

    def pointwise(self, samples: Array, noise_values: Array) -> Array:
        scale, nu = self._each(noise_values)
        logs = np.log1p(samples**2 / (nu * scale**2))
        return np.asarray(_constant(scale, nu) - 0.5 * (nu + 1.0) * logs)

    def whiten(self, samples: Array, noise_values: Array) -> Array:
        """By their places in the distribution, in the tail that is nearer."""
        scale, nu = self._each(noise_values)
        return np.asarray(
            -np.sign(samples)
            * scipy.special.ndtri(scipy.special.stdtr(nu, -np.abs(samples) / scale))
        )

    def innovations(self, samples: Array, noise_values: Array) -> Array:
        return samples

    def inform(self, shifts: Array, noise_values: Array) -> Array:
        scale, nu = self._each(noise_values)
        return np.asarray(shifts / scale * np.sqrt((nu + 1.0) / (nu + 3.0)))

    def pull(self, samples: Array, noise_values: Array) -> Array:
        scale, nu = self._each(noise_values)
        return np.asarray((nu + 1.0) * samples / (nu * scale**2 + samples**2))

    def bend(self, residuals: Residuals, noise_values: Array) -> tuple[Array, Array]:
        """The expected curvature, times what is left over the noise where that is more."""
        scale, nu = self._each(noise_values)
        ratio = residuals.samples**2 / (nu * scale**2)
        nu, n = nu[:, 0], self.levels.sizes
        left = np.nansum((nu[:, None] + 1.0) * ratio / (1.0 + ratio), axis=1)
        by_nu = scipy.special.digamma(0.5 * (nu + 1.0)) - scipy.special.digamma(0.5 * nu) - 1.0 / nu
        by_nu = 0.5 * nu * (n * by_nu - np.nansum(np.log1p(ratio), axis=1)) + 0.5 * left
        pairs = self._pairs(nu) * np.maximum(1.0, left / n)[..., None, None]
        slope = np.hstack([(left - n)[:, self._free[0]], by_nu[:, self._free[1]]])
        return slope, of_pairs(pairs, self._free)

    def expected(self, noise_values: Array) -> Array:
        return np.asarray(of_pairs(self._pairs(self.degrees.at(noise_values[None])), self._free)[0])

    def fitted(self, samples: Array, noise_values: Array) -> Array:
        each = [
            _most_likely(samples[~np.isnan(samples[:, k]), k], self.levels.known.get(k), held)
            for k, held in enumerate(self.degrees.held)
        ]
        scale, nu = np.array(each).T
        return np.append(scale[self._free[0]], nu[self._free[1]])

    def draw(self, signals: Array, noise_values: Array, rng: np.random.Generator) -> Array:
        scale, nu = self._each(noise_values)
        return np.asarray(signals + scale * rng.standard_t(np.broadcast_to(nu, signals.shape)))

    @property
    def _free(self) -> tuple[list[int], list[int]]:
        return list(self.levels.unknown), self.degrees.free

    def _each(self, noise_values: Array) -> tuple[Array, Array]:
        """Scales and degrees `(W, 1, K)`."""
        return self.levels.scales(noise_values)[:, None], self.degrees.at(noise_values)[:, None]

    def _pairs(self, nu: Array) -> Array:
        """Information `(W, K, 2, 2)` about the logs of scale and degrees (Lange and others 1989)."""
        out = np.empty((*nu.shape, 2, 2))
        out[..., 0, 0] = 2.0 * nu / (nu + 3.0)
        out[..., 0, 1] = out[..., 1, 0] = -2.0 * nu / ((nu + 1.0) * (nu + 3.0))
        turn = scipy.special.polygamma(1, 0.5 * nu) - scipy.special.polygamma(1, 0.5 * (nu + 1.0))
        out[..., 1, 1] = turn - 2.0 * (nu + 5.0) / (nu * (nu + 1.0) * (nu + 3.0))
        out[..., 1, 1] *= 0.25 * nu**2
        return np.asarray(out * self.levels.sizes[:, None, None])


def _constant(scale: Array, nu: Array) -> Array:
    """Log density of what is not off at all."""
    gammas = scipy.special.gammaln(0.5 * (nu + 1.0)) - scipy.special.gammaln(0.5 * nu)
    return np.asarray(gammas - 0.5 * np.log(math.pi * nu) - np.log(scale))


def _most_likely(left: Array, scale: float | None, degrees: float | None) -> tuple[float, float]:
    """Scale and degrees of what is `left (n,)`, of each what is not given."""
    nu = np.geomspace(LEAST, MOST, GRID) if degrees is None else np.array([degrees])
    scales = np.full(len(nu), math.sqrt(float(np.median(left**2))) if scale is None else scale)
    for _ in range(ROUNDS if scale is None else 0):  # those that are far off count for less
        weights = (nu + 1.0) / (nu + left[:, None] ** 2 / scales**2)
        scales = np.sqrt((weights * left[:, None] ** 2).mean(axis=0))
    logs = np.log1p(left[:, None] ** 2 / (nu * scales**2)).mean(axis=0)
    best = int(np.argmax(_constant(scales, nu) - 0.5 * (nu + 1.0) * logs))
    return float(scales[best]), float(nu[best])


def freedom(noisy: Noisy) -> Unknown:
    """The unknown degrees of freedom of a channel's noise, `nu_<channel>`."""
    channel = noisy.channel
    meaning = f"degrees of freedom of the noise of channel {channel.name}"
    return Unknown(
        symbol=Symbol(f"nu_{channel.name}", "1", rf"\nu_{{{channel.latex}}}", "", meaning),
        role="noise",
        prior=LogUniform(LEAST, MOST),
        start=START,
    )
