"""The likelihood of a record with a latent torque: a state-space model, by a Kalman filter.

The residuals of the simulator are then a Gaussian process whose covariance follows from the rig: a
likelihood of its own kind, of a state space, and no noise of residuals.  Slopes are exact; the
curvature is that of Gauss and Newton of the whitened residuals, with what their standard deviations
change, which on average is the Fisher information.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayesdrill.basics.arrays import Array, Flags
from bayesdrill.inference.likelihood import Directions, Observation
from bayesdrill.inference.unknowns import Unknown
from bayesdrill.rig.models.latent_torque import SIZE, TIME
from bayesdrill.rig.simulators.compressed_filter import (
    CompressedFilter,
    compress_filter,
    filter_obstacle,
)
from bayesdrill.rig.simulators.contract import Simulator
from bayesdrill.rig.simulators.kalman import KalmanFilter

MAX_SLOPE_BYTES = 6e7  # of slopes at a time


@dataclass(frozen=True, slots=True, kw_only=True)
class LatentTorqueObservation(Observation):
    """An observation whose rig is moved by a latent torque.

    `noise`: of the sensors, white; `kalman_filter`: of the simulator's rig and experiment;
    `process`: of `SIZE` and `TIME` of the torque, the number or the unknown.

    Arguments of the kernels `(W, n + P)` are its unknowns, those of the noise first, and then the
    parameters of the simulator.  A noise, whose sizes are the first, takes all of them.
    `fixed (P,)`: what counts instead, where given: the covariance of one rig, whatever is left.
    """

    kalman_filter: KalmanFilter
    process: Mapping[str, float | Unknown]
    fixed: tuple[float, ...] | None = None

    def with_simulator(
        self, response: Simulator, parameters: Sequence[str]
    ) -> LatentTorqueObservation:
        """Return it with another simulator, whose parameters have these names; unbound."""
        filtered = KalmanFilter(response.model, self.kalman_filter.torque, response.experiment)
        made = Observation.with_simulator(self, response, parameters)
        return dataclasses.replace(made, kalman_filter=filtered)

    @property
    def unknowns(self) -> tuple[Unknown, ...]:
        """Return the unknowns of noise and torque."""
        of_torque = (u for u in self.process.values() if isinstance(u, Unknown))
        return (*self.noise.unknowns, *of_torque)

    @property
    def white(self) -> bool:
        """Whether samples are independent: never."""
        return False

    @property
    def exact_reason(self) -> str:
        """Say why its record cannot be compressed whatever its parameters; empty where it can."""
        return filter_obstacle(self.response)

    @property
    def functions(self) -> int:
        """How many functions its record has become; zero where it is not compressed."""
        return self.kalman_filter.functions

    def exceeds_bound(self, full: Array, theta: Array) -> Flags:
        """Tell which unknowns `(W,)` of a compressed record have all samples."""
        return self.kalman_filter.exceeds_bound(*self._filter_arguments(theta, full))

    def compress(self, full: Array, theta: Array) -> CompressedFilter:
        """Compress its record for these unknowns; see `Observation.compress`."""
        exact = self.kalman_filter.by_samples
        return compress_filter(exact, self.response, *self._filter_arguments(theta, full))

    def with_compression(self, compression: Any) -> LatentTorqueObservation:
        """Return it with its record compressed; with all samples where `compression` is None."""
        filtered = self.kalman_filter.by_samples if compression is None else compression
        return dataclasses.replace(self, kalman_filter=filtered)

    def with_record(self, y: Array) -> LatentTorqueObservation:
        """Return it for another record `(T, K)` of the same experiment, with all samples."""
        made = self.with_compression(None)
        return dataclasses.replace(made, response=self.response.with_record(y))

    @property
    def kind(self) -> str:
        """Return the key by which results know its density: the text that it had as a noise."""
        return (
            f"Shaken(within={self.noise!r}, filtered={self.kalman_filter!r}, torque={self.process!r}, "
            "pinned=None)"
        )

    @property
    def torque(self) -> LatentTorqueObservation:
        """Return itself."""
        return self

    def with_fixed_covariance(self, theta: Array) -> LatentTorqueObservation:
        """Return it with the covariance of its residuals fixed as at `theta (D,)`."""
        assert self.space is not None
        parameters = self.simulator_parameters(self.space.full(theta[None]))[0]
        return dataclasses.replace(self, fixed=tuple(map(float, parameters)))

    def scale_torque(self, factor: float) -> LatentTorqueObservation:
        """Return it with a torque so many times as large, where its size is known."""
        size = self.process[SIZE]
        if isinstance(size, Unknown):
            return self
        return dataclasses.replace(self, process={**self.process, SIZE: size * factor})

    # What it is told.

    def _kernel_arguments(self, theta: Array, full: Array | None = None) -> Array:
        assert self.space is not None
        parameters = self.simulator_parameters(self.space.full(theta) if full is None else full)
        return np.concatenate([theta[:, self.noise_columns], parameters], axis=1)

    def _filter_arguments(self, theta: Array, full: Array | None = None) -> tuple[Array, Array]:
        """Parameters of rig and torque `(W, P + 2)`, and scales of the sensors `(W, K)`."""
        kernel_arguments = self._kernel_arguments(theta, full)
        return self._of_process(kernel_arguments), self.noise.scales(kernel_arguments)

    def _of_process(self, kernel_arguments: Array) -> Array:
        """Of the rig and its torque, `(..., P + 2)`."""
        first, count = len(self.unknowns), len(self.kalman_filter.model.parameters)
        rig = kernel_arguments[..., first : first + count]
        if self.fixed is not None:
            rig = np.broadcast_to(np.array(self.fixed[:count]), rig.shape)
        return np.concatenate([rig, self._sizes(kernel_arguments)], axis=-1)

    def _sizes(self, kernel_arguments: Array) -> Array:
        """Size and time of the torque, `(..., 2)`."""
        out = np.empty((*kernel_arguments.shape[:-1], 2))
        column = len(self.noise.unknowns)
        for k, name in enumerate((SIZE, TIME)):
            value = self.process[name]
            if isinstance(value, Unknown):
                out[..., k] = kernel_arguments[..., column]
                column += 1
            else:
                out[..., k] = value
        return out

    def sizes(self, theta: Array) -> Array:
        """Return size and time of the torque, `(W, 2)`."""
        return self._sizes(theta[:, self.noise_columns])

    # Densities.

    def by_channel(self, full: Array, theta: Array) -> Array:
        """Return the log likelihood `(W, K)`."""
        record = self.response.record
        if self.fixed is None and record is not None:
            return self.kalman_filter.log_density(*self._filter_arguments(theta, full), record)
        terms = self.pointwise(self.residuals(full).samples, theta)
        return np.asarray(np.nansum(terms, axis=1))

    def pointwise(self, samples: Array, theta: Array) -> Array:
        """Return the log density `(W, T, K)` of each residual given those before it."""
        white, variances = self._whitened(samples, theta)
        return np.asarray(-0.5 * (math.log(2 * math.pi) + np.log(variances) + white**2))

    def whiten(self, samples: Array, theta: Array) -> Array:
        """Return whitened residuals `(W, T, K)`."""
        return self._whitened(samples, theta)[0]

    def innovations(self, samples: Array, theta: Array) -> Array:
        """Return errors of one-step-ahead predictions `(W, T, K)`, SI."""
        white, variances = self._whitened(samples, theta)
        return white * np.sqrt(variances)

    def whitened_jacobian(self, shifts: Array, theta: Array) -> Array:
        """Return whitened shifts of signals `(W, T, K)`."""
        return np.nan_to_num(self.whiten(shifts, theta))

    def draw(self, signals: Array, theta: Array, rng: np.random.Generator) -> Array:
        """Draw another record `(W, T, K)` of these signals, with another torque."""
        return np.asarray(signals + self._draw_process(theta, rng)[1])

    def _draw_process(self, theta: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        with np.errstate(all="ignore"):
            return self.kalman_filter.draw(*self._filter_arguments(theta), rng)

    def smooth(self, samples: Array, theta: Array) -> Array:
        """Return smoothed states `(W, T, n)` given all residuals; see `LatentTorque.smooth`."""
        with np.errstate(all="ignore"):
            states = self.kalman_filter.smooth(*self._filter_arguments(theta), samples)
        return np.asarray(states)

    def predict(self, full: Array, theta: Array) -> Array:
        """Return the noise-free channels `(W, T, K)`, with the motion by the latent torque."""
        signals = self.signals(full)
        states = self.smooth(self.experiment.y - signals, theta)
        return signals + np.asarray(states @ self.kalman_filter.output_matrix.T)

    def sample_states(
        self, samples: Array, theta: Array, rng: np.random.Generator
    ) -> tuple[Array, Array]:
        """Draw states given all samples, and what channels show of them without noise."""
        prior_states, prior_signals = self._draw_process(theta, rng)
        states = prior_states + self.smooth(samples - prior_signals, theta)
        return states, np.asarray(states @ self.kalman_filter.output_matrix.T)

    def replicate(self, signals: Array, theta: Array, rng: np.random.Generator) -> Array:
        """Draw this record once more `(W, T, K)`: with fresh noise, and the torque that it had."""
        moved = self.sample_states(self.experiment.y - signals, theta, rng)[1]
        return self.noise.draw(signals + moved, theta[:, self.noise_columns], rng)

    def _whitened(self, samples: Array, theta: Array) -> tuple[Array, Array]:
        with np.errstate(all="ignore"):
            return self.kalman_filter.whiten(*self._filter_arguments(theta), samples)

    # Slopes.

    def quadratic_terms(self, at: Directions) -> Iterator[tuple[Array, Array]]:
        """Yield slope and curvature of all unknowns together: the rig is in the covariance, too."""
        levels = (at.slopes[:, None, :] * at.columns.T)[..., self.noise_columns]
        along = at.parameter_directions
        if along is None:
            along = np.zeros((*levels.shape[:2], at.full.shape[1]))
        turned = self.simulator_parameters(along)
        signals, shifts = self.response.course(self.simulator_parameters(at.full), turned)
        residuals = np.nan_to_num(self.experiment.y - signals)
        kernel_arguments = self._kernel_arguments(at.theta, at.full)
        moved = np.concatenate([levels, turned], axis=-1)
        yield self._slopes(residuals, -shifts, kernel_arguments, moved)

    def _slopes(
        self, residuals: Array, slopes: Array, kernel_arguments: Array, along: Array
    ) -> tuple[Array, Array]:
        """Return slope `(W, q)` and curvature `(W, q, q)` of the log likelihood.

        `residuals (W, T, K)` change by `slopes (W, q, T, K)`, arguments by `along (W, q, n + P)`.
        """
        scales, (n, q) = self.noise.scales, along.shape[:2]
        slope, curvature = np.empty((n, q)), np.empty((n, q, q))
        chunk = max(1, int(MAX_SLOPE_BYTES / (64 * q * max(residuals[0].size, 1))))
        for rows in (slice(k, k + chunk) for k in range(0, n, chunk)):
            repeated = np.repeat(kernel_arguments[rows], q, axis=0)
            moved = along[rows].reshape(-1, along.shape[2])
            shifts = slopes[rows].reshape(-1, *residuals.shape[1:])
            still = np.zeros_like(moved)  # what is held does not move
            with np.errstate(all="ignore"):
                results = self.kalman_filter.slopes(
                    (self._of_process(repeated), self._of_process(moved) - self._of_process(still)),
                    (scales(repeated), scales(moved) - scales(still)),
                    (np.repeat(residuals[rows], q, axis=0), shifts),
                )
            white, change, variance, wider = (
                part.reshape(len(repeated) // q, q, -1) for part in results
            )
            ratio = 0.5 * wider / variance
            slope[rows] = -(white * change).sum(axis=-1) - ratio.sum(axis=-1)
            curvature[rows] = change @ change.swapaxes(1, 2) + ratio @ ratio.swapaxes(1, 2)
        return slope, curvature

    def expected(self, theta: Array) -> Array:
        """Return the expected curvature by the unknowns of noise and torque."""
        kernel_arguments, count = self._kernel_arguments(theta[None]), len(self.unknowns)
        along = np.zeros((1, count, kernel_arguments.shape[1]))
        along[:, range(count), range(count)] = kernel_arguments[:, :count]
        shape = self.experiment.y.shape
        residuals, slopes = np.zeros((1, *shape)), np.zeros((1, count, *shape))
        curvature = self._slopes(residuals, slopes, kernel_arguments, along)[1]
        return np.asarray(2.0 * np.diagonal(curvature[0]))

    def fitted(self, samples: Array, theta: Array) -> Array:
        """Return the unknowns as they are: of one record the levels cannot be told in a sum."""
        return theta[self.noise_columns]
