"""Quantised noise is Gaussian and rounded to known steps, as encoders and converters do.

A sample only tells in which interval the unrounded value was.  The likelihood of the sample is the
probability of this interval divided by the step.  The noise may be much smaller than a step.
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
from bayesdrill.basics.duals import Dual, affine_map, dual
from bayesdrill.basics.entries import LARGEST, SMALLEST
from bayesdrill.inference.noise.contract import NoisyChannel, Residuals
from bayesdrill.inference.noise.white import IndependentNoise, White
from bayesdrill.inference.unknowns import Unknown

MIN_KERNEL_HALF_STEP = 0.2  # least step / (2 sigma) at which the kernels' sums keep their digits
MAX_DISTANCE = 9.0  # end of integrals, in sigmas from a step's end; beyond, information is zero
NODES, WEIGHTS = np.polynomial.legendre.leggauss(160)
_LOG_SQRT_2PI = 0.5 * math.log(2 * math.pi)
_DESCRIPTION = "Step to which samples were rounded, in the unit of the column"


@dataclass(frozen=True, slots=True)
class QuantisedEntries:
    """The entry `noise:` of this kind needs a `step`."""

    step: Annotated[float, Field(ge=SMALLEST, le=LARGEST, description=_DESCRIPTION)] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Quantised(IndependentNoise):
    """Samples are rounded to `steps (K,)`, SI; the unknowns are sigmas before rounding."""

    levels: White
    steps: tuple[float, ...]

    white: ClassVar[bool] = False
    Entries: ClassVar[type] = QuantisedEntries

    @classmethod
    def from_channels(cls, channels: Sequence[NoisyChannel], n_samples: int) -> Quantised:
        """Build the noise of these channels; raise `ValueError` if a step is missing."""
        missing = [c.channel.name for c in channels if c.entries.get("step") is None]
        if missing:
            raise ValueError(
                f"a quantised channel needs a known step ({', '.join(missing)}); write "
                "{name: quantised, step: ...}, in the unit of the column"
            )
        steps = tuple(float(c.entries["step"]) * c.factor for c in channels)
        return cls(levels=White.from_channels(channels, n_samples), steps=steps)

    @property
    def unknowns(self) -> tuple[Unknown, ...]:
        return self.levels.unknowns

    def fixed_values(self) -> Mapping[int, object]:
        return {k: (self.levels.known.get(k), step) for k, step in enumerate(self.steps)}

    def scales(self, theta: Array) -> Array:
        variances = self.levels.scales(theta) ** 2 + np.array(self.steps) ** 2 / 12.0
        return np.asarray(np.sqrt(variances))

    def log_likelihood(self, residuals: Residuals, theta: Array) -> Array:
        """Return the log likelihood `(W, K)`, by kernels unless steps are small.

        If a step is small compared with sigma, the kernels' difference of tails would lose digits.
        """
        sigma, steps, n = self.levels.scales(theta), np.array(self.steps), self.levels.sizes
        half = 0.5 * steps / sigma
        log_mass = residuals.intervals(1.0 / sigma, np.maximum(half, MIN_KERNEL_HALF_STEP))
        log_mass = log_mass - n * np.log(steps)
        fine = (half < MIN_KERNEL_HALF_STEP).any(axis=1)
        if fine.any():
            terms = self.pointwise(residuals.samples[fine], theta[fine])
            failed = np.isnan(terms).sum(axis=1) != terms.shape[1] - n  # not only missing samples
            exact = np.where(failed, np.nan, np.nansum(terms, axis=1))
            log_mass[fine] = np.where(half[fine] < MIN_KERNEL_HALF_STEP, exact, log_mass[fine])
        return np.asarray(log_mass)

    def pointwise(self, samples: Any, theta: Any) -> Any:
        scales = affine_map(self.levels.scales, theta)
        return self._log_mass(samples, scales) - np.log(self.steps)

    def whiten(self, samples: Array, theta: Array) -> Array:
        """Return randomised quantile residuals; their uniform draws are the same at all W points."""
        uniform = np.random.default_rng(0).random(samples.shape[1:])
        sigma, half = self.levels.scales(theta)[:, None], 0.5 * np.array(self.steps)
        return _Interval((samples - half) / sigma, (samples + half) / sigma).quantile(uniform)

    def whitened_jacobian(self, shifts: Array, theta: Array) -> Array:
        """Return whitened shifts `(W, T, K)`, averaged over the position of a signal between steps."""
        sigma = self.levels.scales(theta)
        by_signal, _ = _information(np.array(self.steps) / sigma)
        return np.asarray(shifts * (np.sqrt(by_signal) / sigma)[:, None])

    def noise_score(self, residuals: Residuals, theta: Array) -> tuple[Array, Array]:
        """Return slopes and the expected curvature, increased if residuals are too large."""
        sigma = self.levels.scales(theta)
        slope = np.nansum(self._log_mass(residuals.samples, Dual(sigma, sigma)).slope, axis=1)
        _, size = _information(np.array(self.steps) / sigma)
        curvature = self.levels.sizes * size * np.maximum(1.0, 1.0 + slope / self.levels.sizes)
        free = list(self.levels.unknown)
        return slope[:, free], curvature[:, free]

    def expected(self, theta: Array) -> Array:
        _, size = _information(np.array(self.steps) / self.levels.scales(theta[None])[0])
        return np.asarray(self.levels.sizes * size)[list(self.levels.unknown)]

    def draw(self, signals: Array, theta: Array, rng: np.random.Generator) -> Array:
        """Draw signals with fresh noise, rounded to whole steps."""
        sigma, steps = self.levels.scales(theta)[:, None], np.array(self.steps)
        noisy = signals + sigma * rng.standard_normal(signals.shape)
        return np.asarray(steps * np.round(noisy / steps))

    def _log_mass(self, samples: Any, sigma: Any) -> Any:
        """Return log probabilities of the intervals about `samples (W, T, K)`, for sigma `(W, K)`."""
        half = 0.5 * np.array(self.steps)
        low, high = (dual((samples + end) / sigma[:, None]) for end in (-half, half))
        interval = _Interval(low.value, high.value)
        log_mass = interval.log_mass
        if not isinstance(samples, Dual) and not isinstance(sigma, Dual):
            return log_mass
        at_low, at_high = interval.densities(log_mass)
        return Dual(log_mass, at_high * high.slope - at_low * low.slope)


@dataclass(frozen=True, slots=True)
class _Interval:
    """An interval of a standard normal number is from `low` to `high`, arrays of any shape."""

    low: Array
    high: Array

    @property
    def _in_lower_tail(self) -> tuple[Array, Array]:
        """Return both ends, the nearer to zero first, mirrored into the lower tail to keep digits."""
        right = self.low + self.high > 0
        return np.where(right, -self.low, self.high), np.where(right, -self.high, self.low)

    @property
    def log_mass(self) -> Array:
        near, far = self._in_lower_tail
        below = scipy.special.log_ndtr(near)
        with np.errstate(divide="ignore"):
            return np.asarray(below + _log_one_minus_exp(scipy.special.log_ndtr(far) - below))

    def densities(self, log_mass: Array) -> tuple[Array, Array]:
        """Return the densities at both ends, divided by the probability between the ends."""
        low, high = (np.exp(-0.5 * x**2 - _LOG_SQRT_2PI - log_mass) for x in (self.low, self.high))
        return low, high

    def quantile(self, uniform: Array) -> Array:
        """Return quantiles of a normal number in the interval, at the probabilities `uniform`."""
        right = self.low + self.high > 0
        near, far = self._in_lower_tail
        log_tails = scipy.special.log_ndtr(near), scipy.special.log_ndtr(far)
        part = np.where(right, 1.0 - uniform, uniform)
        # A response that is not finite has no quantile, and the result is NaN there.
        with np.errstate(divide="ignore", invalid="ignore"):
            quantile = scipy.special.ndtri_exp(
                np.logaddexp(np.log(part) + log_tails[0], np.log1p(-part) + log_tails[1])
            )
        return np.asarray(np.where(right, -quantile, quantile))


def _log_one_minus_exp(log_ratio: Array) -> Array:
    """Return log(1 - exp(x)) for x below zero."""
    small = log_ratio > -math.log(2.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        near = np.log(-np.expm1(np.where(small, log_ratio, -1.0)))
    return np.asarray(np.where(small, near, np.log1p(-np.exp(np.where(small, -1.0, log_ratio)))))


def _information(ratio: Array) -> tuple[Array, Array]:
    """Return the information of one sample on signal / sigma, and on the log of sigma.

    `ratio (...,)` is step / sigma.  Both are means over the position of the signal in a step.
    """
    half = 0.5 * ratio[..., None]
    first = np.maximum(half - MAX_DISTANCE, 0.0)  # by symmetry one side suffices
    reach = half + MAX_DISTANCE - first
    x = first + 0.5 * reach * (NODES + 1.0)
    interval = _Interval(x - half, x + half)
    low, high = interval.densities(log_mass := interval.log_mass)
    weight = reach * WEIGHTS * np.exp(log_mass) / ratio[..., None]
    by_signal = (weight * (low - high) ** 2).sum(axis=-1)
    size = (weight * (interval.low * low - interval.high * high) ** 2).sum(axis=-1)
    return np.asarray(by_signal), np.asarray(size)
