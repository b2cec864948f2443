"""Gaussian noise that was rounded to steps of known size, as encoders and converters do.

What is known of a sample is the interval that was rounded to its number; its likelihood is the
probability of that interval, over the step, so that it compares with densities.  Noise may be much
smaller than a step.
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
from bayesdrill.basics.entries import LARGEST, SMALLEST
from bayesdrill.inference.noise.contract import Noisy, Residuals
from bayesdrill.inference.noise.white import White
from bayesdrill.inference.unknowns import Unknown

WIDE = 0.2  # half a step over sigma, from which on kernels have the digits
FAR = 9.0  # sigma from the end of an interval: beyond, nothing is left to be known
NODES, WEIGHTS = np.polynomial.legendre.leggauss(160)
GRID = (0.01, 2.0, 96)  # of sigma over what is left, when it is sought
_LOG_SQRT_2PI = 0.5 * math.log(2 * math.pi)


_SAID = "What was rounded to [unit of the column]"


@dataclass(frozen=True, slots=True)
class Entries:
    step: Annotated[float, Field(ge=SMALLEST, le=LARGEST, description=_SAID)] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Quantised:
    """`steps (K,)`, SI; its unknowns are sizes of noise before it is rounded."""

    levels: White
    steps: tuple[float, ...]

    white: ClassVar[bool] = False
    Entries: ClassVar[type] = Entries

    @classmethod
    def of(cls, channels: Sequence[Noisy], n_samples: int) -> Quantised:
        missing = [c.channel.name for c in channels if c.entries.get("step") is None]
        if missing:
            raise ValueError(
                f"of what is quantised the step must be known ({', '.join(missing)}); write "
                "{name: quantised, step: ...}, in the unit of the column"
            )
        steps = tuple(float(c.entries["step"]) * c.factor for c in channels)
        return cls(levels=White.of(channels, n_samples), steps=steps)

    @property
    def unknowns(self) -> tuple[Unknown, ...]:
        return self.levels.unknowns

    @property
    def n_channels(self) -> int:
        return self.levels.n_channels

    def for_length(self, n_samples: int) -> Quantised:
        return dataclasses.replace(self, levels=self.levels.for_length(n_samples))

    def seeing(self, counts: tuple[int, ...]) -> Quantised:
        return dataclasses.replace(self, levels=self.levels.seeing(counts))

    def held(self) -> Mapping[int, object]:
        return {k: (self.levels.known.get(k), step) for k, step in enumerate(self.steps)}

    def scales(self, noise_values: Array) -> Array:
        return np.asarray(
            np.sqrt(self.levels.scales(noise_values) ** 2 + np.array(self.steps) ** 2 / 12.0)
        )

    def log_likelihood(self, residuals: Residuals, noise_values: Array) -> Array:
        """By kernels where a step is not small beside sigma; else the difference of tails is rounded."""
        sigma, steps, n = self.levels.scales(noise_values), np.array(self.steps), self.levels.sizes
        half = 0.5 * steps / sigma
        result = residuals.intervals(1.0 / sigma, np.maximum(half, WIDE)) - n * np.log(steps)
        fine = (half < WIDE).any(axis=1)
        if fine.any():
            terms = self.pointwise(residuals.samples[fine], noise_values[fine])
            lost = np.isnan(terms).sum(axis=1) != terms.shape[1] - n  # more than was not seen
            exact = np.where(lost, np.nan, np.nansum(terms, axis=1))
            result[fine] = np.where(half[fine] < WIDE, exact, result[fine])
        return np.asarray(result)

    def pointwise(self, samples: Array, noise_values: Array) -> Array:
        return np.asarray(self._interval(samples, noise_values).log_mass - np.log(self.steps))

    def whiten(self, samples: Array, noise_values: Array) -> Array:
        """What was rounded is not known: somewhere in its interval, as its distribution says.  Where is
        drawn once, alike for all walkers and whenever it is asked.
        """
        share = np.random.default_rng(0).random(samples.shape[1:])
        return self._interval(samples, noise_values).within(share)

    def innovations(self, samples: Array, noise_values: Array) -> Array:
        return samples

    def inform(self, shifts: Array, noise_values: Array) -> Array:
        """As it is on average over where in its interval a signal is."""
        sigma = self.levels.scales(noise_values)
        place, _ = _information(np.array(self.steps) / sigma)
        return np.asarray(shifts * (np.sqrt(place) / sigma)[:, None])

    def pull(self, samples: Array, noise_values: Array) -> Array:
        low, high = self._interval(samples, noise_values).densities
        return np.asarray((low - high) / self.levels.scales(noise_values)[:, None])

    def bend(self, residuals: Residuals, noise_values: Array) -> tuple[Array, Array]:
        """The expected curvature, times what is left over the noise where that is more."""
        result = self._interval(residuals.samples, noise_values)
        low, high = result.densities
        slope = np.nansum(result.low * low - result.high * high, axis=1)
        _, size = _information(np.array(self.steps) / self.levels.scales(noise_values))
        curvature = self.levels.sizes * size * np.maximum(1.0, 1.0 + slope / self.levels.sizes)
        free = list(self.levels.unknown)
        return slope[:, free], curvature[:, free]

    def expected(self, noise_values: Array) -> Array:
        _, size = _information(np.array(self.steps) / self.levels.scales(noise_values[None])[0])
        return np.asarray(self.levels.sizes * size)[list(self.levels.unknown)]

    def fitted(self, samples: Array, noise_values: Array) -> Array:
        return np.array([self._likeliest(samples[:, k], k) for k in self.levels.unknown])

    def draw(self, signals: Array, noise_values: Array, rng: np.random.Generator) -> Array:
        """On whole numbers of steps."""
        sigma, steps = self.levels.scales(noise_values)[:, None], np.array(self.steps)
        fresh = signals + sigma * rng.standard_normal(signals.shape)
        return np.asarray(steps * np.round(fresh / steps))

    def _interval(self, samples: Array, noise_values: Array) -> _Interval:
        sigma = self.levels.scales(noise_values)[:, None]
        half = 0.5 * np.array(self.steps)
        return _Interval((samples - half) / sigma, (samples + half) / sigma)

    def _likeliest(self, left: Array, k: int) -> float:
        left, half = left[~np.isnan(left)], 0.5 * self.steps[k]
        low, high, n = GRID
        sizes = np.geomspace(low, high, n) * math.hypot(float(np.sqrt(np.mean(left**2))), half)
        sums = [_Interval((left - half) / s, (left + half) / s).log_mass.sum() for s in sizes]
        return float(sizes[int(np.argmax(sums))])


@dataclass(frozen=True, slots=True)
class _Interval:
    """Of a standard normal number, from `low` to `high`, of any shape."""

    low: Array
    high: Array

    @property
    def _near(self) -> tuple[Array, Array]:
        """Turned into the lower tail, where logs keep their digits: the end next to zero, the other."""
        right = self.low + self.high > 0
        return np.where(right, -self.low, self.high), np.where(right, -self.high, self.low)

    @property
    def log_mass(self) -> Array:
        near, far = self._near
        below = scipy.special.log_ndtr(near)
        with np.errstate(divide="ignore"):
            return np.asarray(below + _log_one_less(scipy.special.log_ndtr(far) - below))

    @property
    def densities(self) -> tuple[Array, Array]:
        """At the two ends, over the probability between them."""
        mass = self.log_mass
        low, high = (np.exp(-0.5 * x**2 - _LOG_SQRT_2PI - mass) for x in (self.low, self.high))
        return low, high

    def within(self, share: Array) -> Array:
        """Where so much of the probability lies below."""
        right = self.low + self.high > 0
        near, far = self._near
        ends = scipy.special.log_ndtr(near), scipy.special.log_ndtr(far)
        part = np.where(right, 1.0 - share, share)  # of what is nearer to zero, as this is turned
        with np.errstate(divide="ignore"):
            result = scipy.special.ndtri_exp(
                np.logaddexp(np.log(part) + ends[0], np.log1p(-part) + ends[1])
            )
        return np.asarray(np.where(right, -result, result))


def _log_one_less(log_ratio: Array) -> Array:
    """log(1 - exp(x)) of x below zero."""
    small = log_ratio > -math.log(2.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        near = np.log(-np.expm1(np.where(small, log_ratio, -1.0)))
    return np.asarray(np.where(small, near, np.log1p(-np.exp(np.where(small, -1.0, log_ratio)))))


def _information(ratio: Array) -> tuple[Array, Array]:
    """Of one sample, by steps over sigma `(...,)`, averaged over where in its interval a signal is:
    about the signal over sigma, and about the log of sigma.
    """
    half = 0.5 * ratio[..., None]
    first = np.maximum(half - FAR, 0.0)  # to one side: the other is alike
    reach = half + FAR - first
    x = first + 0.5 * reach * (NODES + 1.0)
    result = _Interval(x - half, x + half)
    low, high = result.densities
    weight = reach * WEIGHTS * np.exp(result.log_mass) / ratio[..., None]
    place = (weight * (low - high) ** 2).sum(axis=-1)
    size = (weight * (result.low * low - result.high * high) ** 2).sum(axis=-1)
    return np.asarray(place), np.asarray(size)
