"""The contract of a noise: how the residuals of some channels are distributed, and the numbers it
has of its own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.inference.priors import Prior
from bayesdrill.inference.unknowns import Unknown
from bayesdrill.record.experiment import Channel


@dataclass(frozen=True, slots=True, kw_only=True)
class Noisy:
    """A channel and what its config says of the noise: `sigma` in SI or its prior, with the `start` of a
    search; `entries`: those that the kind of noise brings, None where they are not given.  `factor`: how
    many SI one unit of the column is.
    """

    channel: Channel
    sigma: float | Prior
    start: float
    entries: Mapping[str, Any] = field(default_factory=dict)
    factor: float = 1.0


class Residuals(Protocol):
    """Measured minus model at W points of K channels, as far as a noise asks for them.

    `squares (W, K)`: their sums, without a sample kept; `weighed`: of the residuals times the noise's
    own `weights (W, K)`; `neighbours (W, K, 4)`, `logs (W, K)` and `intervals (W, K)`: as `Simulator`
    has them, without a sample kept either; `samples (W, T, K)`.
    """

    @property
    def neighbours(self) -> Array: ...

    def logs(self, weights: Array) -> Array: ...

    def intervals(self, over: Array, half: Array) -> Array: ...

    def weighed(self, weights: Array) -> Array: ...

    @property
    def squares(self) -> Array: ...

    @property
    def samples(self) -> Array: ...


class Noise(Protocol):
    """Of K channels; `own (W, n)` are its unknowns at W points, in the order of `unknowns`.

    `white`: independent samples of the sd `scales`, so that nothing but sums of squares is asked for,
    and kernels can whiten as they go.  For that the slopes and `inform` are not asked.
    """

    @property
    def unknowns(self) -> tuple[Unknown, ...]: ...

    @property
    def n_channels(self) -> int: ...

    @property
    def white(self) -> bool: ...

    def for_length(self, n_samples: int) -> Noise:
        """The same of a record of another length.

        A noise that can do without some samples also has `seeing(counts)`: the same where channels have
        so many each; or, if it matters when they were, `on(t, seen)`: the same at times `t (T,)`, where
        channels were seen `(T, K)`.  Residuals are NaN elsewhere, and stay so when they are whitened.
        """
        ...

    def held(self) -> Mapping[int, object]:
        """What is held of each channel (by index), for what a resumed run must share."""
        ...

    def log_likelihood(self, residuals: Residuals, noise_values: Array) -> Array:
        """Normalised, per channel: `(W, K)`."""
        ...

    def pointwise(self, samples: Array, noise_values: Array) -> Array:
        """`(W, T, K)`: log density of each sample given those before it; their sum is the above."""
        ...

    def scales(self, noise_values: Array) -> Array:
        """Standard deviation of a single sample `(W, K)`, SI."""
        ...

    def whiten(self, samples: Array, noise_values: Array) -> Array:
        """`(W, T, K)`: independent and standard normal, where residuals are as the noise says."""
        ...

    def innovations(self, samples: Array, noise_values: Array) -> Array:
        """`(W, T, K)`, SI: each sample minus its prediction from those before it; `samples` themselves
        where samples are independent.
        """
        ...

    def inform(self, shifts: Array, noise_values: Array) -> Array:
        """`(W, T, K)`, linear in `shifts` of signals: its squares sum to their Fisher information."""
        ...

    def pull(self, samples: Array, noise_values: Array) -> Array:
        """d log likelihood / d model signal: `(W, T, K)`."""
        ...

    def bend(self, residuals: Residuals, noise_values: Array) -> tuple[Array, Array]:
        """Slope and curvature (minus the second derivative, at least the expected one, as a safe step
        wants) by each of its unknowns, by the log of those that are positive: `(W, n)` each, or of the
        curvature the whole matrix `(W, n, n)`.
        """
        ...

    def expected(self, noise_values: Array) -> Array:
        """The curvature, `(n,)` or `(n, n)`, that is expected where the noise is as said; `own (n,)`."""
        ...

    def fitted(self, samples: Array, noise_values: Array) -> Array:
        """Its unknowns `(n,)` by what is left, `samples (T, K)`; as good as `own (n,)` to begin with."""
        ...

    def draw(self, signals: Array, noise_values: Array, rng: np.random.Generator) -> Array:
        """Signals `(W, T, K)` with fresh noise."""
        ...


class NoiseKind(Protocol):
    """A member of the registry: annotated fields of its dataclass `Entries` are entries of a channel's
    `noise:`; `of` makes the noise of all channels that name it, and raises `ValueError`.
    """

    @property
    def Entries(self) -> type: ...  # noqa: N802

    def of(self, channels: Sequence[Noisy], n_samples: int) -> Noise: ...


@dataclass(frozen=True, slots=True)
class Numbers:
    """One for each channel: what is `held`, None where it is unknown.  The unknown ones are columns of
    the noise's own unknowns, from `first` on.
    """

    held: tuple[float | None, ...]
    first: int

    @property
    def free(self) -> list[int]:
        """Channels where it is unknown."""
        return [k for k, value in enumerate(self.held) if value is None]

    def at(self, noise_values: Array) -> Array:
        """`(W, K)`."""
        out = np.empty((len(noise_values), len(self.held)))
        column = self.first
        for k, value in enumerate(self.held):
            out[:, k] = noise_values[:, column] if value is None else value
            column += value is None
        return out

    def beside(self, sizes: Mapping[int, float]) -> dict[int, object]:
        """With the sizes that are known of channels."""
        return {k: (sizes.get(k), value) for k, value in enumerate(self.held)}


def square(curvature: Array, noise_values: Array) -> Array:
    """Of unknowns `own (..., n)`: `(..., n, n)`, of which the diagonal may be given alone."""
    if curvature.ndim > noise_values.ndim:
        return curvature
    return np.asarray(curvature[..., None] * np.eye(noise_values.shape[-1]))


def of_pairs(pairs: Array, places: tuple[list[int], list[int]]) -> Array:
    """`pairs (..., K, 2, 2)` of two numbers of each channel, where `places` are the channels in which
    the first, and in which the second is unknown: `(..., n, n)`, all first before all second.
    """
    every = [(k, which) for which, channels in enumerate(places) for k in channels]
    out = np.zeros((*pairs.shape[:-3], len(every), len(every)))
    for i, (k, unknown) in enumerate(every):
        for j, (other, two) in enumerate(every):
            if k == other:
                out[..., i, j] = pairs[..., k, unknown, two]
    return out
