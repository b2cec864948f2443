"""The contract of a noise: how the residuals of some channels are distributed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from bayesdrill.inference.priors import Prior
from bayesdrill.inference.unknowns import Unknown
from bayesdrill.record.experiment import Channel

Array = NDArray[np.float64]


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

    def log_likelihood(self, residuals: Residuals, own: Array) -> Array:
        """Normalised, per channel: `(W, K)`."""
        ...

    def pointwise(self, samples: Array, own: Array) -> Array:
        """`(W, T, K)`: log density of each sample given those before it; their sum is the above."""
        ...

    def scales(self, own: Array) -> Array:
        """Standard deviation of a single sample `(W, K)`, SI."""
        ...

    def whiten(self, samples: Array, own: Array) -> Array:
        """`(W, T, K)`: independent and standard normal, where residuals are as the noise says."""
        ...

    def inform(self, shifts: Array, own: Array) -> Array:
        """`(W, T, K)`, linear in `shifts` of signals: its squares sum to their Fisher information."""
        ...

    def pull(self, samples: Array, own: Array) -> Array:
        """d log likelihood / d model signal: `(W, T, K)`."""
        ...

    def bend(self, residuals: Residuals, own: Array) -> tuple[Array, Array]:
        """Slope and curvature (minus the second derivative, at least the expected one, as a safe step
        wants) by each of its unknowns, by the log of those that are positive: `(W, n)` each, or of the
        curvature the whole matrix `(W, n, n)`.
        """
        ...

    def expected(self, own: Array) -> Array:
        """The curvature, `(n,)` or `(n, n)`, that is expected where the noise is as said; `own (n,)`."""
        ...

    def fitted(self, samples: Array, own: Array) -> Array:
        """Its unknowns `(n,)` by what is left, `samples (T, K)`; as good as `own (n,)` to begin with."""
        ...

    def draw(self, signals: Array, own: Array, rng: np.random.Generator) -> Array:
        """Signals `(W, T, K)` with fresh noise."""
        ...


class NoiseKind(Protocol):
    """A member of the registry: annotated fields of its dataclass `Entries` are entries of a channel's
    `noise:`; `of` makes the noise of all channels that name it, and raises `ValueError`.
    """

    @property
    def Entries(self) -> type: ...  # noqa: N802

    def of(self, channels: Sequence[Noisy], n_samples: int) -> Noise: ...
