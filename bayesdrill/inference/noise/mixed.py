"""Channels of one record with noise of different kinds, each kind by itself."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bayesdrill.basics.arrays import Array, Flags
from bayesdrill.inference.noise.contract import Noise, Residuals, square
from bayesdrill.inference.unknowns import Unknown

WIDE = 1e3  # half an interval, over the sd: nothing is beyond its ends


@dataclass(frozen=True, slots=True)
class Part:
    """`columns`: which channels of all."""

    noise: Noise
    columns: tuple[int, ...]


def of_record(noise: Noise, t: Array, seen: Flags) -> Noise:
    """At times `t (T,)`, of channels that were `seen (T, K)`; raises `ValueError` where a kind must see
    every sample.
    """
    on = getattr(noise, "on", None)
    if on is not None:
        made: Noise = on(t, seen)
        return made
    if seen.all():
        return noise
    seeing = getattr(noise, "seeing", None)
    if seeing is None:
        raise ValueError(
            f"noise of the kind {type(noise).__name__} needs every sample, and this record misses some; "
            "use white noise, or cut the record where none is missing (record.window)"
        )
    counted: Noise = seeing(tuple(int(n) for n in seen.sum(axis=0)))
    return counted


@dataclass(frozen=True, slots=True)
class _Some:
    """Residuals of some channels."""

    every: Residuals
    columns: list[int]
    n_channels: int  # of all

    @property
    def squares(self) -> Array:
        return self.every.squares[..., self.columns]

    @property
    def samples(self) -> Array:
        return self.every.samples[..., self.columns]

    @property
    def neighbours(self) -> Array:
        return self.every.neighbours[:, self.columns]

    def logs(self, weights: Array) -> Array:
        return self.every.logs(self._of_all(weights, 0.0))[:, self.columns]

    def intervals(self, over: Array, half: Array) -> Array:
        told = self._of_all(over, 0.0), self._of_all(half, WIDE)
        return self.every.intervals(*told)[:, self.columns]

    def _of_all(self, numbers: Array, others: float) -> Array:
        """Of all channels, as kernels want them; of others what costs them least."""
        out = np.full((len(numbers), self.n_channels), others)
        out[:, self.columns] = numbers
        return out

    def weighed(self, weights: Array) -> Array:
        return self.squares * weights**2


@dataclass(frozen=True, slots=True)
class Mixed:
    """Its unknowns are those of the parts, one part after the other."""

    parts: tuple[Part, ...]

    white: ClassVar[bool] = False

    @property
    def unknowns(self) -> tuple[Unknown, ...]:
        return tuple(unknown for part in self.parts for unknown in part.noise.unknowns)

    @property
    def n_channels(self) -> int:
        return sum(part.noise.n_channels for part in self.parts)

    def for_length(self, n_samples: int) -> Mixed:
        return Mixed(tuple(Part(p.noise.for_length(n_samples), p.columns) for p in self.parts))

    def on(self, t: Array, seen: Flags) -> Mixed:
        return Mixed(
            tuple(
                dataclasses.replace(p, noise=of_record(p.noise, t, seen[:, list(p.columns)]))
                for p in self.parts
            )
        )

    def held(self) -> Mapping[int, object]:
        return {p.columns[k]: what for p in self.parts for k, what in p.noise.held().items()}

    def log_likelihood(self, residuals: Residuals, noise_values: Array) -> Array:
        return self._each(
            lambda noise, columns, values: noise.log_likelihood(
                _Some(residuals, columns, self.n_channels), values
            ),
            noise_values,
        )

    def pointwise(self, samples: Array, noise_values: Array) -> Array:
        return self._each(
            lambda n, columns, number: n.pointwise(samples[..., columns], number), noise_values
        )

    def scales(self, noise_values: Array) -> Array:
        return self._each(lambda n, _, values: n.scales(values), noise_values)

    def whiten(self, samples: Array, noise_values: Array) -> Array:
        return self._each(
            lambda n, columns, values: n.whiten(samples[..., columns], values), noise_values
        )

    def innovations(self, samples: Array, noise_values: Array) -> Array:
        return self._each(
            lambda n, columns, values: n.innovations(samples[..., columns], values), noise_values
        )

    def inform(self, shifts: Array, noise_values: Array) -> Array:
        return self._each(
            lambda n, columns, values: n.inform(shifts[..., columns], values), noise_values
        )

    def pull(self, samples: Array, noise_values: Array) -> Array:
        return self._each(
            lambda n, columns, values: n.pull(samples[..., columns], values), noise_values
        )

    def draw(self, signals: Array, noise_values: Array, rng: np.random.Generator) -> Array:
        return self._each(
            lambda n, columns, values: n.draw(signals[..., columns], values, rng), noise_values
        )

    def bend(self, residuals: Residuals, noise_values: Array) -> tuple[Array, Array]:
        parts = [
            part.noise.bend(_Some(residuals, list(part.columns), self.n_channels), some)
            for part, some in self._split(noise_values)
        ]
        slopes, curvatures = zip(*parts, strict=True)
        return np.concatenate(slopes, axis=-1), self._apart(curvatures, noise_values)

    def expected(self, noise_values: Array) -> Array:
        return self._apart(
            [part.noise.expected(some) for part, some in self._split(noise_values)], noise_values
        )

    def _apart(self, curvatures: Sequence[Array], noise_values: Array) -> Array:
        """What the parts know of their own unknowns, `(..., n, n)`."""
        out = np.zeros((*noise_values.shape, noise_values.shape[-1]))
        first = 0
        for curvature, (_, some) in zip(curvatures, self._split(noise_values), strict=True):
            mine = slice(first, first + some.shape[-1])
            out[..., mine, mine] = square(curvature, some)
            first = mine.stop
        return out

    def fitted(self, samples: Array, noise_values: Array) -> Array:
        return np.concatenate(
            [
                p.noise.fitted(samples[:, list(p.columns)], some)
                for p, some in self._split(noise_values)
            ]
        )

    def _split(self, noise_values: Array) -> Iterator[tuple[Part, Array]]:
        first = 0
        for part in self.parts:
            n = len(part.noise.unknowns)
            yield part, noise_values[..., first : first + n]
            first += n

    def _each(self, what: Callable[[Noise, list[int], Array], Array], noise_values: Array) -> Array:
        """Of every part, its channels in their places."""
        parts = [
            (part.columns, what(part.noise, list(part.columns), some))
            for part, some in self._split(noise_values)
        ]
        out = np.empty((*parts[0][1].shape[:-1], self.n_channels))
        for columns, values in parts:
            out[..., list(columns)] = values
        return out
