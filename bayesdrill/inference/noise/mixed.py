"""Combine independent kinds of noise, each for some channels of a record."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from bayesdrill.basics.arrays import Array, Flags
from bayesdrill.basics.duals import linear_map
from bayesdrill.inference.noise.contract import ChannelResiduals, Noise, Residuals, as_matrix
from bayesdrill.inference.unknowns import Unknown


@dataclass(frozen=True, slots=True)
class ChannelNoise:
    """A kind of noise applies to the channels with indices `columns`."""

    noise: Noise
    columns: tuple[int, ...]


def noise_key(noise: Noise) -> object:
    """Return plain data that identify a kind of noise in stored results, without its values."""
    return getattr(noise, "key", type(noise).__name__)


def normal_noise(noise: Noise) -> Noise:
    """Return the normal noise with the same scales, or `noise` itself if it has no heavy tails."""
    return getattr(noise, "normal", noise)


def noise_for_record(noise: Noise, t: Array, is_measured: Flags) -> Noise:
    """Return the noise for times `t (T,)`, at which the samples with `is_measured (T, K)` were recorded.

    Raises `ValueError` if samples are missing and the noise needs every sample.
    """
    at_times: Callable[..., Noise] | None = getattr(noise, "at_times", None)
    if at_times is not None:
        return at_times(t, is_measured)
    if is_measured.all():
        return noise
    with_counts: Callable[..., Noise] | None = getattr(noise, "with_counts", None)
    if with_counts is None:
        raise ValueError(
            f"noise of the kind {type(noise).__name__} needs every sample, and the record lacks "
            "some; use white noise, or a part of the record without gaps (record.window)"
        )
    return with_counts(tuple(int(n) for n in is_measured.sum(axis=0)))


@dataclass(frozen=True, slots=True)
class Mixed:
    """A mixed noise has several `noises`; theta lists the unknowns of each in turn."""

    noises: tuple[ChannelNoise, ...]

    white: ClassVar[bool] = False

    @property
    def key(self) -> tuple[object, ...]:
        """Return the key of each part with the indices of its channels."""
        return tuple((noise_key(part.noise), part.columns) for part in self.noises)

    @property
    def unknowns(self) -> tuple[Unknown, ...]:
        return tuple(unknown for part in self.noises for unknown in part.noise.unknowns)

    @property
    def n_channels(self) -> int:
        """Return the number of channels."""
        return sum(len(part.columns) for part in self.noises)

    @property
    def normal(self) -> Mixed:
        """Return the noise with normal parts, or itself if no part has heavy tails."""
        parts = tuple(replace(part, noise=normal_noise(part.noise)) for part in self.noises)
        pairs = zip(parts, self.noises, strict=True)
        return Mixed(parts) if any(new.noise is not old.noise for new, old in pairs) else self

    def for_length(self, n_samples: int) -> Mixed:
        parts = (ChannelNoise(p.noise.for_length(n_samples), p.columns) for p in self.noises)
        return Mixed(tuple(parts))

    def at_times(self, t: Array, is_measured: Flags) -> Mixed:
        noises = (noise_for_record(p.noise, t, is_measured[:, p.columns]) for p in self.noises)
        pairs = zip(noises, self.noises, strict=True)
        return Mixed(tuple(ChannelNoise(noise, part.columns) for noise, part in pairs))

    def fixed_values(self) -> Mapping[int, object]:
        each = ((p.columns, p.noise.fixed_values()) for p in self.noises)
        return {columns[k]: fixed for columns, values in each for k, fixed in values.items()}

    def square_weights(self, theta: Array) -> Array | None:
        """Return weights of sums of squares, or None if a part has none; see `Noise.square_weights`."""
        parts = [(p.columns, p.noise.square_weights(at)) for p, at in self._split(theta)]
        known = [(columns, weights) for columns, weights in parts if weights is not None]
        if len(known) < len(parts):
            return None
        out = np.zeros((len(theta), self.n_channels, max(w.shape[2] for _, w in known)))
        for columns, weights in known:
            out[:, columns, : weights.shape[2]] = weights
        return out

    def log_likelihood(self, residuals: Residuals, theta: Array) -> Array:
        return self._by_noise(
            lambda p, at: p.noise.log_likelihood(self._residuals(residuals, p), at), theta
        )

    def pointwise(self, samples: Any, theta: Any) -> Any:
        return self._by_noise(lambda p, at: p.noise.pointwise(samples[..., p.columns], at), theta)

    def scales(self, theta: Array) -> Array:
        return self._by_noise(lambda p, at: p.noise.scales(at), theta)

    def whiten(self, samples: Array, theta: Array) -> Array:
        return self._by_noise(lambda p, at: p.noise.whiten(samples[..., p.columns], at), theta)

    def innovations(self, samples: Array, theta: Array) -> Array:
        return self._by_noise(lambda p, at: p.noise.innovations(samples[..., p.columns], at), theta)

    def whitened_jacobian(self, shifts: Array, theta: Array) -> Array:
        return self._by_noise(
            lambda p, at: p.noise.whitened_jacobian(shifts[..., p.columns], at), theta
        )

    def score(self, samples: Array, theta: Array) -> Array:
        return self._by_noise(lambda p, at: p.noise.score(samples[..., p.columns], at), theta)

    def draw(self, signals: Array, theta: Array, rng: np.random.Generator) -> Array:
        return self._by_noise(lambda p, at: p.noise.draw(signals[..., p.columns], at, rng), theta)

    def noise_score(self, residuals: Residuals, theta: Array) -> tuple[Array, Array]:
        parts = [
            part.noise.noise_score(self._residuals(residuals, part), at)
            for part, at in self._split(theta)
        ]
        slopes, curvatures = zip(*parts, strict=True)
        return np.concatenate(slopes, axis=-1), self._block_diagonal(curvatures, theta)

    def expected(self, theta: Array) -> Array:
        curvatures = [part.noise.expected(at) for part, at in self._split(theta)]
        return self._block_diagonal(curvatures, theta)

    def _block_diagonal(self, curvatures: Sequence[Array], theta: Array) -> Array:
        """Return the matrix `(..., n, n)` whose blocks are the curvatures of the parts."""
        out = np.zeros((*theta.shape, theta.shape[-1]))
        first = 0
        for curvature, (_, part_theta) in zip(curvatures, self._split(theta), strict=True):
            block = slice(first, first + part_theta.shape[-1])
            out[..., block, block] = as_matrix(curvature, part_theta)
            first = block.stop
        return out

    def _residuals(self, residuals: Residuals, part: ChannelNoise) -> ChannelResiduals:
        return ChannelResiduals(residuals, part.columns, self.n_channels)

    def _split(self, theta: Any) -> Iterator[tuple[ChannelNoise, Any]]:
        first = 0
        for part in self.noises:
            n = len(part.noise.unknowns)
            yield part, theta[..., first : first + n]
            first += n

    def _by_noise[N](self, evaluate: Callable[[ChannelNoise, Any], N], theta: Any) -> N:
        """Evaluate every part, and return the results in the order of all channels."""

        def in_channels(*results: Array) -> Array:
            out = np.empty((*results[0].shape[:-1], self.n_channels))
            for part, values in zip(self.noises, results, strict=True):
                out[..., part.columns] = values
            return out

        placed: N = linear_map(
            in_channels, *(evaluate(part, at) for part, at in self._split(theta))
        )
        return placed
