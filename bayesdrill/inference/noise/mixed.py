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

    def log_likelihood(self, residuals: Residuals, own: Array) -> Array:
        return self._each(
            lambda noise, columns, own: noise.log_likelihood(
                _Some(residuals, columns, self.n_channels), own
            ),
            own,
        )

    def pointwise(self, samples: Array, own: Array) -> Array:
        return self._each(lambda n, columns, own: n.pointwise(samples[..., columns], own), own)

    def scales(self, own: Array) -> Array:
        return self._each(lambda n, _, own: n.scales(own), own)

    def whiten(self, samples: Array, own: Array) -> Array:
        return self._each(lambda n, columns, own: n.whiten(samples[..., columns], own), own)

    def innovations(self, samples: Array, own: Array) -> Array:
        return self._each(lambda n, columns, own: n.innovations(samples[..., columns], own), own)

    def inform(self, shifts: Array, own: Array) -> Array:
        return self._each(lambda n, columns, own: n.inform(shifts[..., columns], own), own)

    def pull(self, samples: Array, own: Array) -> Array:
        return self._each(lambda n, columns, own: n.pull(samples[..., columns], own), own)

    def draw(self, signals: Array, own: Array, rng: np.random.Generator) -> Array:
        return self._each(lambda n, columns, own: n.draw(signals[..., columns], own, rng), own)

    def bend(self, residuals: Residuals, own: Array) -> tuple[Array, Array]:
        found = [
            part.noise.bend(_Some(residuals, list(part.columns), self.n_channels), some)
            for part, some in self._split(own)
        ]
        slopes, curvatures = zip(*found, strict=True)
        return np.concatenate(slopes, axis=-1), self._apart(curvatures, own)

    def expected(self, own: Array) -> Array:
        return self._apart([part.noise.expected(some) for part, some in self._split(own)], own)

    def _apart(self, curvatures: Sequence[Array], own: Array) -> Array:
        """What the parts know of their own unknowns, `(..., n, n)`."""
        out = np.zeros((*own.shape, own.shape[-1]))
        first = 0
        for curvature, (_, some) in zip(curvatures, self._split(own), strict=True):
            mine = slice(first, first + some.shape[-1])
            out[..., mine, mine] = square(curvature, some)
            first = mine.stop
        return out

    def fitted(self, samples: Array, own: Array) -> Array:
        return np.concatenate(
            [p.noise.fitted(samples[:, list(p.columns)], some) for p, some in self._split(own)]
        )

    def _split(self, own: Array) -> Iterator[tuple[Part, Array]]:
        first = 0
        for part in self.parts:
            n = len(part.noise.unknowns)
            yield part, own[..., first : first + n]
            first += n

    def _each(self, what: Callable[[Noise, list[int], Array], Array], own: Array) -> Array:
        """Of every part, its channels in their places."""
        found = [
            (part.columns, what(part.noise, list(part.columns), some))
            for part, some in self._split(own)
        ]
        out = np.empty((*found[0][1].shape[:-1], self.n_channels))
        for columns, values in found:
            out[..., list(columns)] = values
        return out
