"""AR(1) noise is a Gaussian first-order autoregression in each channel.

A sample is `rho` times the previous sample plus an innovation, and all samples have the sd sigma.
`rho` is the correlation of samples that are one typical interval of the channel apart.  Over a gap
of g such intervals the correlation is rho^g, so missing samples and uneven times are exact.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import Field

from bayesdrill.basics.arrays import Array, Flags, Indices
from bayesdrill.basics.duals import Dual, affine_map, dual, linear_map, log
from bayesdrill.inference.noise.contract import ChannelNumbers, NoisyChannel, Residuals, pair_matrix
from bayesdrill.inference.noise.white import White
from bayesdrill.inference.priors import Uniform
from bayesdrill.inference.unknowns import Unknown

GAP_TOLERANCE = 1e-3  # a gap this near to a whole number is rounded, as times are inexact


@dataclass(frozen=True, slots=True)
class ChannelSpacing:
    """A channel has `count` samples, at `rows` of the record, with gaps between them.

    `gaps (n - 1,)` of the channel's samples and `all_gaps (T - 1,)` of all rows are in typical
    intervals, or None if all gaps are one.  Methods take residuals `(W, n)` and `rho (W,)`.
    """

    rows: slice | Indices
    count: int
    gaps: Array | None
    all_gaps: Array | None

    def conditional(self, rho: Any) -> tuple[Any, Any]:
        """Return the weight of the previous sample in the conditional mean, and the conditional sd.

        Both are `(W, n)`, and the sd is divided by sigma.  For the first sample they are 0 and 1.
        """

        def with_first(weights: Array) -> Array:
            out = np.zeros((len(weights), self.count))
            out[:, 1:] = weights
            return out

        intervals = np.ones(1) if self.gaps is None else self.gaps
        weight = linear_map(with_first, rho[:, None] ** intervals)
        return weight, ((1.0 - weight) * (1.0 + weight)) ** 0.5

    def predicted(self, samples: Array, rho: Array) -> Array:
        """Return errors `(W, n)` of the prediction of each sample from the previous one."""
        return np.asarray(_without_memory(samples, self.conditional(rho)[0]))

    def innovations(self, samples: Array, rho: Array) -> Array:
        """Return innovations `(W, n)`, scaled to the sd of the samples."""
        weight, sd = self.conditional(rho)
        return np.asarray(_without_memory(samples, weight) / sd)

    def log_density(self, samples: Any, rho: Any) -> Any:
        """Return the log density of samples / sigma, without the terms of sigma and 2 pi."""
        weight, sd = self.conditional(rho)
        return -0.5 * (_without_memory(samples, weight) / sd) ** 2 - log(sd)

    def score(self, samples: Array, rho: Array) -> Array:
        """Return half the slopes `(W, n)` of the sum of squared innovations by each sample."""
        weight, sd = self.conditional(rho)
        over = _without_memory(samples, weight) / sd**2
        out = np.array(over)
        out[:, :-1] -= weight[:, 1:] * over[:, 1:]
        return out

    def information(self, rho: Array) -> Array:
        """Return the expected information `(W, 2, 2)` on the log of sigma, and on rho."""
        out = np.empty((len(rho), 2, 2))
        out[:, 0, 0] = 2.0 * self.count
        if self.gaps is None:
            inner, pairs = (1.0 - rho) * (1.0 + rho), self.count - 1.0
            out[:, 0, 1] = out[:, 1, 0] = -2.0 * pairs * rho / inner
            out[:, 1, 1] = pairs * (1.0 + rho**2) / inner**2
            return out
        weights, sds = self.conditional(Dual(rho, np.ones_like(rho)))
        weight, turn, sd = weights.value, weights.slope, sds.value
        out[:, 0, 1] = out[:, 1, 0] = -2.0 * (weight * turn / sd**2).sum(axis=1)
        out[:, 1, 1] = (turn**2 * (1.0 + weight**2) / sd**4).sum(axis=1)
        return out

    def correlate(self, noise: Array, rho: Array) -> None:
        """Turn white `noise (W, T)` of sd 1 into an AR(1) of sd 1, in place."""
        from scipy.signal import lfilter  # imported here, as loading takes long

        if self.all_gaps is None:
            noise[:, 1:] *= np.sqrt((1.0 - rho) * (1.0 + rho))[:, None]
            for row, r in zip(noise, rho, strict=True):
                row[:] = lfilter([1.0], [1.0, -r], row)
            return
        all_samples = ChannelSpacing(slice(None), noise.shape[1], self.all_gaps, None)
        weight, sd = all_samples.conditional(rho)
        noise *= sd
        for k in range(1, noise.shape[1]):
            noise[:, k] += weight[:, k] * noise[:, k - 1]


@dataclass(frozen=True, slots=True)
class Spacing:
    """A record's spacing has that of each channel; `is_measured (T, K)` flags measured samples."""

    channels: tuple[ChannelSpacing, ...]
    is_measured: Flags


@lru_cache(maxsize=8)
def even_spacing(n_samples: int, n_channels: int) -> Spacing:
    """Return the spacing of evenly spaced samples, none of which is missing."""
    seen = np.ones((n_samples, n_channels), dtype=bool)
    return Spacing((ChannelSpacing(slice(None), n_samples, None, None),) * n_channels, seen)


def _channel_spacing(t: Array, is_measured: Flags) -> ChannelSpacing:
    rows = np.flatnonzero(is_measured)
    steps = np.diff(t[rows])
    typical = float(np.median(steps)) if len(steps) else 1.0
    gaps, all_gaps = _gaps(steps / typical), _gaps(np.diff(t) / typical)
    return ChannelSpacing(slice(None) if is_measured.all() else rows, len(rows), gaps, all_gaps)


def _gaps(gaps: Array) -> Array | None:
    nearest = np.round(gaps)
    rounded = np.where((np.abs(gaps - nearest) < GAP_TOLERANCE) & (nearest > 0), nearest, gaps)
    return None if (rounded == 1.0).all() else rounded


def _without_memory(samples: Any, weight: Any) -> Any:
    """Return samples minus `weight` times the previous sample; zero precedes the first sample."""

    def delayed(x: Array) -> Array:
        return np.concatenate([np.zeros_like(x[:, :1]), x[:, :-1]], axis=1)

    return samples - weight * linear_map(delayed, samples)


def _sum_weights(rho: Any) -> list[Any]:
    """Return the three weights of `Residuals.neighbours` for even samples and sigma 1.

    Let S, D and E be sums of squares: of samples, of their differences, of both end samples.
    The sum of innovation^2 / variance is ((1 - rho)^2 S + rho D + rho (1 - rho) E) / (1 - rho^2).
    """
    over = 1.0 / (1.0 + rho)
    return [(1.0 - rho) * over, rho * over / (1.0 - rho), rho * over]


def _squared_innovations(rho: Any, sums: Array) -> Any:
    """Return the sum of squared innovations for sigma 1, from `Residuals.neighbours`."""
    return sum(weight * sums[..., n] for n, weight in enumerate(_sum_weights(rho)))


START_RHO = 0.3  # start value of a search
_DESCRIPTION = "Correlation of samples one usual interval apart; default: unknown"


@dataclass(frozen=True, slots=True)
class AR1Entries:
    """The entry `noise:` of this kind may set `rho`."""

    rho: Annotated[float, Field(ge=0, lt=1, description=_DESCRIPTION)] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class AR1:
    """The unknowns of AR(1) noise are the sigmas of all channels, then their correlations.

    `spacing` is None if samples are evenly spaced and none is missing.
    """

    levels: White
    memory: ChannelNumbers
    unknowns: tuple[Unknown, ...]
    spacing: Spacing | None = field(default=None, repr=False, compare=False)

    white: ClassVar[bool] = False
    Entries: ClassVar[type] = AR1Entries

    @classmethod
    def from_channels(cls, channels: Sequence[NoisyChannel], n_samples: int) -> AR1:
        levels = White.from_channels(channels, n_samples)
        memory = ChannelNumbers(tuple(c.entries.get("rho") for c in channels), len(levels.unknowns))
        declared = {"prior": Uniform(0.0, 1.0), "start": START_RHO, "transform": (0.0, 1.0)}
        own = memory.unknowns(channels, "rho", "correlation of neighbours in", **declared)
        return cls(levels=levels, memory=memory, unknowns=(*levels.unknowns, *own))

    def for_length(self, n_samples: int) -> AR1:
        return dataclasses.replace(self, levels=self.levels.for_length(n_samples), spacing=None)

    def at_times(self, t: Array, is_measured: Flags) -> AR1:
        levels = self.levels.for_length(len(t)).with_counts(
            tuple(int(n) for n in is_measured.sum(axis=0))
        )
        spacing = Spacing(
            tuple(_channel_spacing(t, column) for column in is_measured.T), is_measured
        )
        return dataclasses.replace(self, levels=levels, spacing=spacing)

    def fixed_values(self) -> Mapping[int, object]:
        return self.memory.with_sizes(self.levels.known)

    def scales(self, theta: Array) -> Array:
        return self.levels.scales(theta)

    def log_likelihood(self, residuals: Residuals, theta: Array) -> Array:
        if self._uneven is not None:
            terms = self.pointwise(residuals.samples, theta)
            return np.asarray(np.where(self._uneven.is_measured, terms, 0.0).sum(axis=1))
        sigma, rho, n = self.scales(theta), self.memory.values(theta), self.levels.sizes
        inner = (1.0 - rho) * (1.0 + rho)
        constant = -0.5 * n * math.log(2 * math.pi) - n * np.log(sigma)
        squares = _squared_innovations(rho, residuals.neighbours) / sigma**2
        return np.asarray(constant - 0.5 * (n - 1.0) * np.log(inner) - 0.5 * squares)

    def square_weights(self, theta: Array) -> Array | None:
        """Return weights `(W, K, 3)`, or None if times are uneven; see `Noise.square_weights`."""
        if self._uneven is not None:
            return None
        weights = np.stack(_sum_weights(self.memory.values(theta)), axis=-1)
        return np.asarray(weights / self.scales(theta)[..., None] ** 2)

    def pointwise(self, samples: Any, theta: Any) -> Any:
        sizes = log(affine_map(self.scales, theta))[:, None] + 0.5 * math.log(2 * math.pi)
        return self._by_channel(ChannelSpacing.log_density, samples, theta) - sizes

    def whiten(self, samples: Array, theta: Array) -> Array:
        return self._by_channel(ChannelSpacing.innovations, samples, theta)

    def innovations(self, samples: Array, theta: Array) -> Array:
        predicted = self._by_channel(ChannelSpacing.predicted, samples, theta)
        return predicted * self.scales(theta)[:, None]

    def whitened_jacobian(self, shifts: Array, theta: Array) -> Array:
        return np.nan_to_num(self.whiten(shifts, theta))

    def score(self, samples: Array, theta: Array) -> Array:
        by_scaled = self._by_channel(ChannelSpacing.score, samples, theta)
        return by_scaled / self.scales(theta)[:, None]

    def _by_channel[N](
        self, function: Callable[[ChannelSpacing, Any, Any], N], samples: Any, theta: Any
    ) -> N:
        """Apply `function` to samples / sigma and rho by channel, `(W, T, K)`; NaN if missing."""
        sigma, rho = (affine_map(f, theta) for f in (self.scales, self.memory.values))
        values = dual(samples).value
        channels = [*enumerate(self._channels)]
        results = [
            function(channel, samples[:, channel.rows, k] / sigma[:, k, None], rho[:, k])
            for k, channel in channels
        ]

        def in_channels(*columns: Array) -> Array:
            out = np.full(values.shape, np.nan)
            for k, channel in channels:
                out[:, channel.rows, k] = columns[k]
            return out

        placed: N = linear_map(in_channels, *results)
        return placed

    def noise_score(self, residuals: Residuals, theta: Array) -> tuple[Array, Array]:
        """Return slopes and the expected curvature, increased if residuals are too large."""
        sigma, rho, n = self.scales(theta), self.memory.values(theta), self.levels.sizes
        slopes = np.empty((2, *sigma.shape))
        if self._uneven is None:
            sums = residuals.neighbours / sigma[..., None] ** 2
            squares = _squared_innovations(Dual(rho, np.ones_like(rho)), sums)
            slopes[0] = squares.value - n
            slopes[1] = (n - 1.0) * rho / ((1.0 - rho) * (1.0 + rho)) - 0.5 * squares.slope
        else:
            for k, channel in enumerate(self._uneven.channels):
                scaled = residuals.samples[:, channel.rows, k] / sigma[:, k, None]
                innovations = channel.innovations(scaled, rho[:, k])
                slopes[0, :, k] = (innovations**2).sum(axis=1) - channel.count
                moved = channel.log_density(scaled, Dual(rho[:, k], np.ones(len(rho))))
                slopes[1, :, k] = moved.slope.sum(axis=1)
        inflation = np.maximum(1.0, 1.0 + slopes[0] / n)
        pairs = self._pairs(rho) * inflation[..., None, None]
        slope = np.hstack([slopes[0][:, self._free[0]], slopes[1][:, self._free[1]]])
        return slope, pair_matrix(pairs, self._free)

    def expected(self, theta: Array) -> Array:
        return np.asarray(pair_matrix(self._pairs(self.memory.values(theta[None])), self._free)[0])

    def draw(self, signals: Array, theta: Array, rng: np.random.Generator) -> Array:
        sigma, rho = self.scales(theta), self.memory.values(theta)
        out = rng.standard_normal(signals.shape)
        for k, channel in enumerate(self._channels):
            channel.correlate(out[:, :, k], rho[:, k])
        return signals + sigma[:, None, :] * out

    @property
    def _free(self) -> tuple[list[int], list[int]]:
        return list(self.levels.unknown), self.memory.free

    @property
    def _uneven(self) -> Spacing | None:
        """Return the spacing if it is uneven in some channel, and else None."""
        spacing = self.spacing
        return spacing if spacing and any(c.gaps is not None for c in spacing.channels) else None

    @property
    def _channels(self) -> tuple[ChannelSpacing, ...]:
        spacing = self.spacing or even_spacing(self.levels.n_samples, self.levels.n_channels)
        return spacing.channels

    def _pairs(self, rho: Array) -> Array:
        """Return the information `(W, K, 2, 2)` on the log of sigma and on rho."""
        each = [channel.information(rho[:, k]) for k, channel in enumerate(self._channels)]
        return np.stack(each, axis=1)
