"""Define the contract of a noise, which is the distribution of residuals of some channels.

Methods in the modules of the kinds of noise are described here, in `Noise`.
"""

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
    """A noisy channel has the noise that its config declares.

    `sigma` is a number, SI, or a prior, for which a search begins at `start`.  The `kind` of noise
    defines the `entries`, each None if not given.  `factor` is SI units per unit of the column.
    """

    channel: Channel
    sigma: float | Prior
    start: float
    kind: str = "white"
    entries: Mapping[str, Any] = field(default_factory=dict)
    factor: float = 1.0


@dataclass(frozen=True)
class SimulatorResiduals:
    """Residuals are measured minus modelled values at W points, evaluated when they are first used.

    `full (W, P)` has the parameters of this simulator alone.  Samples are NaN where nothing was
    measured.  Sums are computed without storing samples.  `over_scales (W, K)` are
    weighted sums of squares, if a kernel has computed them.
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
        """Return sums of squares `(W, K)` of the residuals times `weights (W, K)`."""
        return self.squares * weights**2 if self.over_scales is None else self.over_scales

    @cached_property
    def neighbours(self) -> Array:
        """Return sums over neighbouring samples `(W, K, 3)`, see `Simulator.neighbours`."""
        return self.response.neighbours(self.full)

    def logs(self, weights: Array) -> Array:
        """Return sums of logs `(W, K)`, see `Simulator.logs`."""
        return self.response.logs(self.full, weights)

    def intervals(self, inverse_sds: Array, half: Array) -> Array:
        """Return sums over intervals `(W, K)`, see `Simulator.intervals`."""
        return self.response.intervals(self.full, inverse_sds, half)


UNBOUNDED_HALF = 1e3  # half-width, in sds, of an interval with probability one


@dataclass(frozen=True, slots=True)
class ChannelResiduals:
    """Residuals of a record are restricted to the channels `columns`, out of `n_channels`."""

    residuals: Residuals
    columns: tuple[int, ...]
    n_channels: int

    @property
    def squares(self) -> Array:
        """Return sums of squares `(W, K)`."""
        return self.residuals.squares[..., self.columns]

    @property
    def samples(self) -> Array:
        """Return all residuals of these channels `(W, T, K)`."""
        return self.residuals.samples[..., self.columns]

    @property
    def neighbours(self) -> Array:
        """Return sums over neighbouring samples `(W, K, 3)`."""
        return self.residuals.neighbours[:, self.columns]

    def weighted_squares(self, weights: Array) -> Array:
        """Return sums of squares `(W, K)` of the residuals times `weights (W, K)`."""
        return self.squares * weights**2

    def logs(self, weights: Array) -> Array:
        """Return sums of logs `(W, K)`."""
        return self.residuals.logs(self._all_channels(weights, 0.0))[:, self.columns]

    def intervals(self, inverse_sds: Array, half: Array) -> Array:
        """Return sums over intervals `(W, K)`."""
        scaled = self._all_channels(inverse_sds, 0.0), self._all_channels(half, UNBOUNDED_HALF)
        return self.residuals.intervals(*scaled)[:, self.columns]

    def _all_channels(self, numbers: Array, fill: float) -> Array:
        """Return `numbers` in the columns of these channels among all, and `fill` elsewhere."""
        out = np.full((len(numbers), self.n_channels), fill)
        out[:, self.columns] = numbers
        return out


Residuals = SimulatorResiduals | ChannelResiduals


class Noise(Protocol):
    """A noise is a density of K channels; `theta (W, n)` has the values of its `unknowns`.

    Samples of a `white` noise are independent with the sd `scales`, so sums of squares suffice.
    `score` and `whitened_jacobian` are not used if there are `square_weights`.  A noise with heavy
    tails also has `normal`: normal noise with the same scales, whose unknowns are some of its own.
    """

    @property
    def unknowns(self) -> tuple[Unknown, ...]:
        """Return the unknowns, in the order of the columns of `theta`."""

    @property
    def white(self) -> bool:
        """Return whether samples are independent and normal."""

    def for_length(self, n_samples: int) -> Noise:
        """Return the same noise for a record of another length.

        A noise that allows missing samples also has one of two methods.  `with_counts(counts)` gives
        the noise for these numbers of samples of each channel.  If times matter, `at_times(t,
        is_measured)` gives the noise for times `t (T,)`, at which `is_measured (T, K)` flags the
        channels with a sample.  Missing residuals are NaN, and remain NaN when they are whitened.
        """

    def fixed_values(self) -> Mapping[int, object]:
        """Return fixed values, which a resumed run must not change, by index of the channel.

        Results also identify a noise by its `key` of plain data, or else by its class.
        """

    def log_likelihood(self, residuals: Residuals, theta: Array) -> Array:
        """Return the normalised log likelihood of each channel: `(W, K)`."""

    def pointwise(self, samples: Any, theta: Any) -> Any:
        """Return the log density `(W, T, K)` of each sample given earlier samples.

        If samples and unknowns are `duals.Dual` instead of arrays, so is the result.
        """

    def scales(self, theta: Array) -> Array:
        """Return the standard deviation of a single sample `(W, K)`, SI."""

    def square_weights(self, theta: Array) -> Array | None:
        """Return weights `(W, K, n)` of sums of squares, or None if such sums do not suffice.

        Minus half the weighted sum is the log likelihood, up to a constant.  There are n = 1 sums of
        squares, or the n = 3 sums of `Residuals.neighbours`.
        """

    def whiten(self, samples: Array, theta: Array) -> Array:
        """Return whitened residuals `(W, T, K)`, independent and standard normal."""

    def innovations(self, samples: Array, theta: Array) -> Array:
        """Return samples minus their predictions from earlier samples, `(W, T, K)`, SI."""

    def whitened_jacobian(self, shifts: Array, theta: Array) -> Array:
        """Return whitened `shifts` of signals, `(W, T, K)`.

        The result is linear in `shifts`, and its squares sum to the Fisher information along `shifts`.
        """

    def score(self, samples: Array, theta: Array) -> Array:
        """Return d log likelihood / d signal of the model, `(W, T, K)`."""

    def noise_score(self, residuals: Residuals, theta: Array) -> tuple[Array, Array]:
        """Return slope and curvature of the log likelihood by the unknowns of the noise.

        Derivatives are by the log of positive unknowns.  The curvature is minus the second derivative,
        and at least its expected value, so that Newton steps are safe.  Both are `(W, n)`, but
        the curvature may also be a matrix `(W, n, n)`.
        """

    def expected(self, theta: Array) -> Array:
        """Return the expected curvature, `(n,)` or `(n, n)`, at `theta (n,)`."""

    def draw(self, signals: Array, theta: Array, rng: np.random.Generator) -> Array:
        """Draw signals `(W, T, K)` with fresh noise."""


class NoiseKind(Protocol):
    """Each member of the registry `NOISES` is a class of this kind, which builds noises."""

    @property
    def Entries(self) -> type:  # noqa: N802
        """Return the dataclass whose annotated fields are entries of a channel's `noise:`."""

    def from_channels(self, channels: Sequence[NoisyChannel], n_samples: int) -> Noise:
        """Build the noise of all channels that name it; raise `ValueError` for wrong entries."""


@dataclass(frozen=True, slots=True)
class ChannelNumbers:
    """Each channel has a number in `fixed_values`; None is an unknown, from `first_column` on."""

    fixed_values: tuple[float | None, ...]
    first_column: int

    @property
    def free(self) -> list[int]:
        """Return the indices of channels whose number is unknown."""
        return [k for k, value in enumerate(self.fixed_values) if value is None]

    def unknowns(
        self, channels: Sequence[NoisyChannel], letter: str, meaning: str, **declared: Any
    ) -> tuple[Unknown, ...]:
        """Return unknowns `<letter>_<channel>`; `declared` has further fields of `Unknown`."""
        unknowns = []
        for channel in (channels[k].channel for k in self.free):
            latex = rf"\{letter}_{{{channel.latex}}}"
            about = f"{meaning} the noise of channel {channel.name}"
            symbol = Symbol(f"{letter}_{channel.name}", "1", latex, "", about)
            unknowns.append(Unknown(symbol=symbol, role="noise", **declared))
        return tuple(unknowns)

    def values(self, theta: Array) -> Array:
        """Return the numbers of all channels `(W, K)`."""
        out = np.tile(np.array(self.fixed_values, dtype=np.float64), (len(theta), 1))
        out[:, self.free] = theta[:, self.first_column : self.first_column + len(self.free)]
        return out

    def with_sizes(self, sizes: Mapping[int, float]) -> dict[int, object]:
        """Return pairs (known size, fixed number), None for unknowns, by index of the channel."""
        return {k: (sizes.get(k), value) for k, value in enumerate(self.fixed_values)}


SCORING_STEPS = 100  # largest number of steps of a fit
SMALL_STEP = 1e-4  # a fit ends when no step is larger
LARGEST_STEP = 1.0  # limit of a step of the log, or of an unknown between two ends
END_MARGIN = 1e-4  # smallest distance of a fit from both ends / distance between the ends


def fit_noise(noise: Noise, residuals: Residuals, theta: Array) -> Array:
    """Return the unknowns of a noise `(n,)` fitted to the residuals of one walker.

    Scoring starts from `theta (n,)` and uses only the diagonal of the curvature.  Steps are halved
    until the likelihood rises, and stay inside the priors.
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
    """Return a curvature by `theta (..., n)`, a matrix or its diagonal, as a matrix."""
    if curvature.ndim > theta.ndim:
        return curvature
    return np.asarray(curvature[..., None] * np.eye(theta.shape[-1]))


def pair_matrix(pairs: Array, channel_indices: tuple[list[int], list[int]]) -> Array:
    """Return the matrix `(..., n, n)` by unknowns from blocks `pairs (..., K, 2, 2)` by channel.

    A channel has two numbers.  `channel_indices` lists the channels whose first number is unknown,
    then those whose second number is unknown.  The unknowns have this order.
    """
    unknowns = [(k, which) for which, channels in enumerate(channel_indices) for k in channels]
    k, which = np.array(unknowns, dtype=np.intp).reshape(-1, 2).T
    blocks = pairs[..., k[:, None], which[:, None], which]
    return np.where(k[:, None] == k, blocks, 0.0)
