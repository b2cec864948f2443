"""The contract of a noise: the distribution of the residuals of some channels, and its unknowns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.basics.symbols import Symbol
from bayesdrill.inference.priors import Prior
from bayesdrill.inference.unknowns import Unknown
from bayesdrill.record.experiment import Channel
from bayesdrill.rig.simulators.contract import Simulator


@dataclass(frozen=True, slots=True, kw_only=True)
class NoisyChannel:
    """A channel and what its config says of the noise.

    `sigma`: in SI or its prior, with the `start` of a search; `entries`: those that the `kind` of
    noise brings, None where they are not given.  `factor`: how many SI one unit of the column is.
    """

    channel: Channel
    sigma: float | Prior
    start: float
    kind: str = "white"
    entries: Mapping[str, Any] = field(default_factory=dict)
    factor: float = 1.0


class Residuals(Protocol):
    """Measured minus model at W points of K channels; sums of these are as `Simulator` has them.

    No sample is kept for a sum.
    """

    @property
    def neighbours(self) -> Array:
        """Return sums over neighbouring samples `(W, K, 3)`."""

    def logs(self, weights: Array) -> Array:
        """Return sums of logs `(W, K)`."""

    def intervals(self, over: Array, half: Array) -> Array:
        """Return sums over intervals `(W, K)`."""

    def weighted_squares(self, weights: Array) -> Array:
        """Return sums of squares of the residuals times the noise's own `weights (W, K)`."""

    @property
    def squares(self) -> Array:
        """Return sums of squares `(W, K)`."""

    @property
    def samples(self) -> Array:
        """Return all residuals `(W, T, K)`."""


@dataclass(frozen=True)
class SimulatorResiduals:
    """Measured minus model, each sum as it is first asked for.

    `full (W, P)`: parameters of this simulator alone.  Samples are NaN where nothing was measured.
    `over_scales (W, K)`: sums of squares over the noise's scales, where a kernel has given them.
    """

    response: Simulator
    full: Array
    over_scales: Array | None = None

    @cached_property
    def squares(self) -> Array:
        """Return sums of squares `(W, K)`."""
        return self.response.squares(self.full)

    @cached_property
    def samples(self) -> Array:
        """Return all residuals `(W, T, K)`."""
        return np.asarray(self.response.experiment.y - self.response.signals(self.full))

    def weighted_squares(self, weights: Array) -> Array:
        """Return sums of squares `(W, K)` of the residuals times `weights`."""
        return self.squares * weights**2 if self.over_scales is None else self.over_scales

    @cached_property
    def neighbours(self) -> Array:
        """Return sums over neighbouring samples, see `Simulator.neighbours`."""
        return self.response.neighbours(self.full)

    def logs(self, weights: Array) -> Array:
        """Return sums of logs, see `Simulator.logs`."""
        return self.response.logs(self.full, weights)

    def intervals(self, over: Array, half: Array) -> Array:
        """Return sums over intervals, see `Simulator.intervals`."""
        return self.response.intervals(self.full, over, half)


class Noise(Protocol):
    """The noise of K channels, at its unknowns `theta (W, n)` in the order of `unknowns`.

    `white`: independent samples of the sd `scales`, so that nothing but sums of squares is asked
    for.  The slopes and `whitened_jacobian` are not asked for where there are `square_weights`.
    """

    @property
    def unknowns(self) -> tuple[Unknown, ...]:
        """Return its unknowns."""

    @property
    def white(self) -> bool:
        """Whether samples are independent and normal."""

    def for_length(self, n_samples: int) -> Noise:
        """Return the same noise for a record of another length.

        A noise that can do without some samples also has `with_counts(counts)`: the same where
        channels have so many each; or, if it matters when they were, `at_times(t, seen)`: the same
        at times `t (T,)`, where channels were seen `(T, K)`.  Residuals are NaN elsewhere, and stay
        so when they are whitened.
        """

    def fixed_values(self) -> Mapping[int, object]:
        """Return what is fixed of each channel (by index), which a resumed run must share."""

    def log_likelihood(self, residuals: Residuals, theta: Array) -> Array:
        """Return the normalised log likelihood of each channel: `(W, K)`."""

    def pointwise(self, samples: Any, theta: Any) -> Any:
        """Return the terms `(W, T, K)` of `log_likelihood`: of each sample given those before it.

        Samples and unknowns are arrays, or both `duals.Dual`: then so are the terms.
        """

    def scales(self, theta: Array) -> Array:
        """Return the standard deviation of a single sample `(W, K)`, SI."""

    def square_weights(self, theta: Array) -> Array | None:
        """Return weights `(W, K, n)` of sums of squares, of which minus half is the log likelihood.

        But for a constant: n is 1 for the sum of squares, or 3 for the sums `Residuals.neighbours`.
        It is None where these sums are not all that is asked for.
        """

    def whiten(self, samples: Array, theta: Array) -> Array:
        """Return whitened residuals `(W, T, K)`, independent and standard normal."""

    def innovations(self, samples: Array, theta: Array) -> Array:
        """Return samples minus their prediction from those before them, if any: `(W, T, K)`, SI."""

    def whitened_jacobian(self, shifts: Array, theta: Array) -> Array:
        """Return `shifts` of signals over the noise, `(W, T, K)`.

        It is linear in `shifts`, and its squares sum to their Fisher information.
        """

    def score(self, samples: Array, theta: Array) -> Array:
        """Return d log likelihood / d model signal: `(W, T, K)`."""

    def noise_score(self, residuals: Residuals, theta: Array) -> tuple[Array, Array]:
        """Return slope and curvature of the log likelihood by each of its unknowns.

        Those that are positive count by their log.  The curvature is minus the second derivative,
        at least the expected one, as a safe step wants.  Both are `(W, n)`, or of the curvature the
        whole matrix `(W, n, n)`.
        """

    def expected(self, theta: Array) -> Array:
        """Return the expected curvature, `(n,)` or `(n, n)`, at `theta (n,)`."""

    def draw(self, signals: Array, theta: Array, rng: np.random.Generator) -> Array:
        """Draw signals `(W, T, K)` with fresh noise."""


class NoiseKind(Protocol):
    """A member of the registry."""

    @property
    def Entries(self) -> type:  # noqa: N802
        """Return the dataclass whose annotated fields are entries of a channel's `noise:`."""

    def from_channels(self, channels: Sequence[NoisyChannel], n_samples: int) -> Noise:
        """Build the noise of all channels that name it; raises `ValueError`."""


@dataclass(frozen=True, slots=True)
class ChannelNumbers:
    """A number for each channel, `fixed` or None: a column of the noise's unknowns from `first` on."""

    fixed: tuple[float | None, ...]
    first: int

    def __repr__(self) -> str:
        """Return the text by which results of earlier versions know it."""
        return f"Numbers(held={self.fixed!r}, first={self.first!r})"

    @property
    def free(self) -> list[int]:
        """Return the channels where it is unknown."""
        return [k for k, value in enumerate(self.fixed) if value is None]

    def unknowns(
        self, channels: Sequence[NoisyChannel], letter: str, meaning: str, **declared: Any
    ) -> tuple[Unknown, ...]:
        """Return the unknown numbers, `<letter>_<channel>`, with what else is `declared` of them."""
        unknowns = []
        for channel in (channels[k].channel for k in self.free):
            latex = rf"\{letter}_{{{channel.latex}}}"
            about = f"{meaning} the noise of channel {channel.name}"
            symbol = Symbol(f"{letter}_{channel.name}", "1", latex, "", about)
            unknowns.append(Unknown(symbol=symbol, role="noise", **declared))
        return tuple(unknowns)

    def values(self, theta: Array) -> Array:
        """Return the numbers of all channels `(W, K)`."""
        out = np.empty((len(theta), len(self.fixed)))
        column = self.first
        for k, value in enumerate(self.fixed):
            out[:, k] = theta[:, column] if value is None else value
            column += value is None
        return out

    def with_sizes(self, sizes: Mapping[int, float]) -> dict[int, object]:
        """Return what is fixed of each channel, with the sizes that are known."""
        return {k: (sizes.get(k), value) for k, value in enumerate(self.fixed)}


SCORING_STEPS, SMALL_STEP = 100, 1e-4  # of a fit: at most, and one after which it has arrived
LARGEST_STEP = 1.0  # of a log, or of a number between two ends
END_MARGIN = 1e-4  # of the distance of two ends: nearer to an end nothing is to be told


def fit_noise(noise: Noise, residuals: Residuals, theta: Array) -> Array:
    """Return the unknowns of a noise `(n,)` fitted to residuals of one walker.

    By scoring of each unknown by itself from `theta (n,)` on, with steps that are halved until the
    likelihood rises; within priors and between ends.
    """
    plain = np.array([unknown.between is not None for unknown in noise.unknowns], dtype=bool)
    ends = np.array([(u.prior.low, u.prior.high) for u in noise.unknowns]).reshape(-1, 2).T
    inset = np.where(plain, END_MARGIN * (ends[1] - ends[0]), 0.0)

    def moved(step: Array) -> Array:
        with np.errstate(all="ignore"):
            new = np.where(plain, fitted + step, fitted * np.exp(step))
        return np.clip(new, ends[0] + inset, ends[1] - inset)

    def value(unknowns: Array) -> float:
        return float(noise.log_likelihood(residuals, unknowns[None]).sum())

    fitted = theta
    for _ in range(SCORING_STEPS if len(theta) else 0):
        slope, curvature = noise.noise_score(residuals, fitted[None])
        step = slope[0] / np.diagonal(as_matrix(curvature, fitted[None])[0])
        step, before = np.clip(step, -LARGEST_STEP, LARGEST_STEP), value(fitted)
        while not value(moved(step)) >= before and np.abs(step).max() > SMALL_STEP:
            step *= 0.5
        if np.abs(step).max() <= SMALL_STEP:
            break
        fitted = moved(step)
    return fitted


def as_matrix(curvature: Array, theta: Array) -> Array:
    """Return a curvature by `theta (..., n)` as a matrix, of which the diagonal may be given alone."""
    if curvature.ndim > theta.ndim:
        return curvature
    return np.asarray(curvature[..., None] * np.eye(theta.shape[-1]))


def pair_matrix(pairs: Array, channel_indices: tuple[list[int], list[int]]) -> Array:
    """Return the matrix `(..., n, n)` of `pairs (..., K, 2, 2)` of two numbers of each channel.

    `channel_indices` are the channels in which the first, and in which the second is unknown; all
    first ones come before all second ones.
    """
    unknowns = [(k, which) for which, channels in enumerate(channel_indices) for k in channels]
    out = np.zeros((*pairs.shape[:-3], len(unknowns), len(unknowns)))
    for i, (k, first_index) in enumerate(unknowns):
        for j, (other, second_index) in enumerate(unknowns):
            if k == other:
                out[..., i, j] = pairs[..., k, first_index, second_index]
    return out
