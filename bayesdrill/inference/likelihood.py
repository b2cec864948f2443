"""Combine a simulator and a noise into the likelihood of a record, given the unknowns.

If a latent torque moves the rig, the simulator's residuals are a Gaussian process whose covariance
follows from the rig.  A Kalman filter then evaluates the likelihood in state space.  Slopes of the
likelihood are exact.  Its curvature is the Gauss-Newton approximation for whitened residuals and
their standard deviations; on average it is the Fisher information.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.basics.duals import Dual, affine_map
from bayesdrill.inference.noise.contract import Noise, SimulatorResiduals, fit_noise
from bayesdrill.inference.noise.mixed import noise_for_record, noise_key, normal_noise
from bayesdrill.inference.unknowns import (
    Directions,
    ParameterSpace,
    Unknown,
    directional_curvature,
    directional_slope,
)
from bayesdrill.record.experiment import Experiment, with_states
from bayesdrill.rig.models.latent_torque import SIZE, TIME, MissingTorque
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.simulators import exact_reason, simulator
from bayesdrill.rig.simulators.contract import Simulator
from bayesdrill.rig.simulators.kalman import KalmanFilter, step_lengths
from bayesdrill.rig.simulators.sensors import ObservationModel

MAX_SLOPE_BYTES = 6e7  # upper limit [bytes] of the memory for slopes that are computed together


@dataclass(frozen=True, slots=True, kw_only=True)
class Observation:
    """An observation is a record with its density, given unknowns `theta` and parameters `full`.

    `theta (W, D)` and `full (W, P)` are physical, in SI, and include those of all observations.
    `response` simulates the record, and `noise` is the density of the residuals.

    `parameters` and `noise_names` name the parameters of this simulator and the unknowns of this
    noise.  `bind` sets their column indices: `columns` in `full` (None for all) and `noise_columns`
    in `theta`.  `label` is empty if there is only one experiment.
    """

    response: Simulator
    noise: Noise
    parameters: Sequence[str]
    noise_names: Sequence[str]
    label: str = ""
    columns: list[int] | None = None
    noise_columns: slice | list[int] = slice(0)
    space: ParameterSpace | None = None

    def bind(self, space: ParameterSpace) -> Self:
        """Return the observation with its columns in the parameters and unknowns of `space`."""
        columns: list[int] | None = [space.model.index(name) for name in self.parameters]
        if columns == list(range(len(space.model))):
            columns = None
        indices = [space.free.index(name) for name in self.noise_names]
        first = indices[0] if indices else len(space.free)
        noise = slice(first, first + len(indices))  # a slice copies no data
        in_a_row = indices == list(range(noise.start, noise.stop))
        noise_columns = noise if in_a_row else indices
        return dataclasses.replace(self, columns=columns, noise_columns=noise_columns, space=space)

    @property
    def experiment(self) -> Experiment:
        """Return the record."""
        return self.response.experiment

    def with_record(self, y: Array) -> Self:
        """Return the observation of another record `y (T, K)` of the same experiment."""
        return dataclasses.replace(self, response=self.response.with_record(y))

    def with_normal_noise(self) -> Self:
        """Return the observation with normal noise, or itself if no noise has heavy tails."""
        noise = normal_noise(self.noise)
        if noise is self.noise:
            return self
        known = {unknown.name for unknown in noise.unknowns}
        pairs = zip(self.noise.unknowns, self.noise_names, strict=True)
        names = [name for unknown, name in pairs if unknown.name in known]
        return dataclasses.replace(self, noise=noise, noise_names=names)

    def simulator_parameters(self, full: Array) -> Array:
        """Select the columns of `full (..., P)` that the simulator takes."""
        return full if self.columns is None else full[..., self.columns]

    def named(self, names: Sequence[str]) -> dict[str, str]:
        """Map `names` of the simulator's first parameters to their names in the space."""
        return dict(zip(names, self.parameters, strict=False))

    def rig_parameters(self, full: Array) -> dict[str, Array]:
        """Return the rig's parameters, each `(W,)`, by name."""
        columns = self.simulator_parameters(full).T
        return dict(zip(self.response.model.parameters, columns, strict=False))

    def states(self, full: Array) -> Array:
        """Return all states of the rig at the samples, without a missing torque, `(W, T, X)`."""
        shown = with_states(self.experiment, self.response.model.states, alone=True)
        return self.response.of(shown).signals(self.simulator_parameters(full))

    def residuals(self, full: Array) -> SimulatorResiduals:
        """Return the residuals at parameters `full`."""
        return SimulatorResiduals(self.response, self.simulator_parameters(full))

    def signals(self, full: Array) -> Array:
        """Return the channels without noise and without a missing torque, `(W, T, K)`."""
        return self.response.signals(self.simulator_parameters(full))

    def title(self, quantity: str) -> str:
        """Return a phrase such as `record of slow`; the quantity alone if there is one experiment."""
        return f"{quantity} of {self.label}" if self.label else quantity

    @property
    def n_measured(self) -> int:
        """Return the number of measured values."""
        return sum(self.experiment.counts)

    def weighted_squares(self, full: Array, theta: Array) -> Array:
        """Return the sums `(W, K)` of squared whitened residuals."""
        if self.white:
            return np.asarray(self.residuals(full).squares / self.scales(theta) ** 2)
        samples = self.whiten(self.residuals(full).samples, theta)
        return np.asarray(np.nansum(samples**2, axis=1))

    def signal_slopes(self, directions: Directions) -> Array:
        """Return slopes `(q, T, K)` of the signals along the directions, at one point."""
        if directions.parameter_directions is None:
            return np.zeros((directions.columns.shape[1], *self.experiment.y.shape))
        along = self.simulator_parameters(directions.parameter_directions)
        return np.asarray(
            self.response.sensitivities(self.simulator_parameters(directions.full), along)[0]
        )

    def scores(self, directions: Directions, slopes: Array) -> Array:
        """Return slopes `(q, T, K)` of `pointwise` along the directions, at one point.

        The argument `slopes (q, T, K)` has the slopes of the signals.
        """
        count = len(slopes)
        unknowns = Dual(
            directions.theta.repeat(count, axis=0), directions.slopes * directions.columns.T
        )
        residuals = Dual(self.residuals(directions.full).samples.repeat(count, axis=0), -slopes)
        return np.asarray(self.pointwise(residuals, unknowns).slope)

    def whitened_jacobian_at(self, shifts: Array, theta: Array) -> Array:
        """Return whitened `shifts (n, T, K)` of the signals at `theta (D,)`.

        They are zero where nothing was measured, and their squares sum to the Fisher information.
        """
        measured_shifts = np.where(self.experiment.is_measured, shifts, 0.0)
        return self.whitened_jacobian(measured_shifts, np.repeat(theta[None], len(shifts), axis=0))

    def with_simulator(self, response: Simulator, parameters: Sequence[str]) -> Self:
        """Return an unbound observation with another simulator and the names of its parameters."""
        return dataclasses.replace(self, response=response, parameters=parameters)

    def for_rig(self, model: Model, sensing: ObservationModel) -> Self:
        """Return an unbound observation of another rig and other sensors, with the same time steps.

        A new parameter has the same name in the rig (or its sensors) and in the space.
        """
        old = self.response
        response = simulator(model, self.experiment, sensing, *(old.stepping or ()))
        names = self.named(old.parameters)
        parameters = [names.get(name, name) for name in response.parameters]
        return self.with_simulator(response, parameters)

    def for_record(self, experiment: Experiment) -> Self:
        """Return an unbound observation of a shorter record, or of one with other missing samples.

        Raises `ValueError` if the noise needs every sample.
        """
        t = experiment.t
        noise = noise_for_record(self.noise.for_length(len(t)), t, experiment.is_measured)
        other = dataclasses.replace(self, noise=noise)
        return other.with_simulator(self.response.of(experiment), self.parameters)

    # Subclasses override the following members.

    @property
    def unknowns(self) -> tuple[Unknown, ...]:
        """Return the unknowns that are not parameters of the simulator."""
        return self.noise.unknowns

    @property
    def white(self) -> bool:
        """Return whether the density follows from sums of squared residuals and `scales`."""
        return self.noise.white

    @property
    def key(self) -> object:
        """Return plain data by which results identify the density; None for white noise."""
        return None if self.noise.white else noise_key(self.noise)

    @property
    def torque(self) -> LatentTorqueObservation | None:
        """Return the observation itself if it has a latent torque, and else None."""
        return None

    def with_fixed_covariance(self, theta: Array) -> Self:
        """Return the observation with a rig-dependent covariance fixed at `theta (D,)`."""
        return self

    def by_channel(self, full: Array, theta: Array) -> Array:
        """Return the log likelihood of each channel, `(W, K)`."""
        return self.noise.log_likelihood(self.residuals(full), theta[:, self.noise_columns])

    def pointwise(self, samples: Any, theta: Any) -> Any:
        """Return the log density `(W, T, K)` of each residual given earlier residuals."""
        return self.noise.pointwise(samples, theta[:, self.noise_columns])

    def scales(self, theta: Array) -> Array:
        """Return standard deviations of single samples `(W, K)`, SI."""
        return self.noise.scales(theta[:, self.noise_columns])

    def square_weights(self, theta: Array) -> Array | None:
        """Return weights of sums of squares `(W, K, n)`; see `Noise.square_weights`."""
        return self.noise.square_weights(theta[:, self.noise_columns])

    @property
    def exact_reason(self) -> str:
        """Return why the record cannot be compressed at any parameters; empty if it can."""
        weights = self.noise.square_weights(np.empty((0, len(self.noise.unknowns))))
        torque = self.torque is not None
        return exact_reason(self.response, gaussian=weights is not None, torque=torque)

    def whiten(self, samples: Array, theta: Array) -> Array:
        """Return whitened residuals `(W, T, K)`, independent and standard normal."""
        return self.noise.whiten(samples, theta[:, self.noise_columns])

    def innovations(self, samples: Array, theta: Array) -> Array:
        """Return errors of one-step-ahead predictions `(W, T, K)`, SI."""
        return self.noise.innovations(samples, theta[:, self.noise_columns])

    def whitened_jacobian(self, shifts: Array, theta: Array) -> Array:
        """Return whitened shifts `(W, T, K)`; see `Noise.whitened_jacobian`."""
        return self.noise.whitened_jacobian(shifts, theta[:, self.noise_columns])

    def quadratic_terms(self, directions: Directions) -> Iterator[tuple[Array, Array]]:
        """Yield slopes `(W, q)` and curvatures `(W, q, q)` that sum to those of log L."""
        residuals, noise_theta = (
            self.residuals(directions.full),
            directions.theta[:, self.noise_columns],
        )
        if directions.parameter_directions is not None:
            along = directions.parameter_directions
            residuals, slope, curvature = self._slopes_of_signals(
                directions.full, along, noise_theta
            )
            yield slope, curvature
        if self.noise.unknowns:
            levels, owned = (
                directions.by_log[:, self.noise_columns],
                directions.columns[self.noise_columns],
            )
            pulled, bent = self.noise.noise_score(residuals, noise_theta)
            if bent.ndim == levels.ndim:
                curvature = directional_curvature(owned, bent * levels**2)
            else:
                curvature = owned.T @ (levels[:, :, None] * bent * levels[:, None, :]) @ owned
            yield directional_slope(levels * pulled, owned), curvature

    def _slopes_of_signals(
        self, full: Array, parameter_directions: Array, noise_theta: Array
    ) -> tuple[SimulatorResiduals, Array, Array]:
        """Return residuals, slope `(W, q)` and curvature `(W, q, q)` along `parameter_directions`."""
        residuals, turned = self.residuals(full), self.simulator_parameters(parameter_directions)
        weights = self.noise.square_weights(noise_theta)
        if weights is not None:
            squares, slope, curvature = self.response.normal(residuals.full, turned, weights)
            return SimulatorResiduals(self.response, residuals.full, squares), slope, curvature
        measured = self.experiment.is_measured
        slopes = self.response.sensitivities(residuals.full, turned)
        shifts = np.where(measured, slopes, 0.0)  # (W, q, T, K)
        pull = np.where(measured, self.noise.score(residuals.samples, noise_theta), 0.0)
        slope = np.einsum("wqtk,wtk->wq", shifts, pull)
        directions = range(parameter_directions.shape[1])
        rows = [self.noise.whitened_jacobian(shifts[:, q], noise_theta) for q in directions]
        flat = np.stack(rows, axis=1).reshape(*shifts.shape[:2], -1)
        return residuals, slope, flat @ flat.swapaxes(1, 2)

    def expected(self, theta: Array) -> Array:
        """Return the expected curvature of the noise; see `Noise.expected`; `theta (D,)`."""
        return self.noise.expected(theta[self.noise_columns])

    def fitted(self, full: Array, theta: Array) -> Array:
        """Return noise unknowns fitted to the residuals at `full (1, P)`, starting from `theta (D,)`."""
        return fit_noise(self.noise, self.residuals(full), theta[self.noise_columns])

    def predict(self, full: Array, theta: Array) -> Array:
        """Return the channels `(W, T, K)` without noise, but with the motion by a latent torque."""
        return self.signals(full)

    def draw(self, signals: Array, theta: Array, rng: np.random.Generator) -> Array:
        """Draw a record `(W, T, K)` with these signals."""
        return self.noise.draw(signals, theta[:, self.noise_columns], rng)

    def replicate(self, signals: Array, theta: Array, rng: np.random.Generator) -> Array:
        """Draw the record `(W, T, K)` again, with fresh noise and the same latent torque."""
        return self.draw(signals, theta, rng)


@dataclass(frozen=True, slots=True, kw_only=True)
class LatentTorqueObservation(Observation):
    """An observation of this class has a rig that a latent torque moves.

    The `noise` of the sensors is white.  `process` has a number or an unknown for `SIZE` and `TIME`
    of the torque.  Arguments of the kernels `(W, n + P)` are the n unknowns of noise and torque, and
    the P parameters of the simulator.  The covariance is that at `fixed (P,)`, if not None.
    """

    kalman_filter: KalmanFilter
    process: Mapping[str, float | Unknown]
    fixed: tuple[float, ...] | None = None

    def with_simulator(self, response: Simulator, parameters: Sequence[str]) -> Self:
        filtered = KalmanFilter(response.model, self.kalman_filter.torque, response.experiment)
        made = Observation.with_simulator(self, response, parameters)
        return dataclasses.replace(made, kalman_filter=filtered)

    @property
    def unknowns(self) -> tuple[Unknown, ...]:
        """Return the unknowns of noise and torque."""
        torque_unknowns = (u for u in self.process.values() if isinstance(u, Unknown))
        return (*self.noise.unknowns, *torque_unknowns)

    @property
    def white(self) -> bool:
        """Return False: the torque correlates the samples."""
        return False

    @property
    def key(self) -> object:
        """Return where the torque acts, and its size and time as numbers or names of unknowns."""
        process = self.process.items()
        named = {entry: x.name if isinstance(x, Unknown) else x for entry, x in process}
        return dataclasses.asdict(self.kalman_filter.torque) | named

    @property
    def torque(self) -> LatentTorqueObservation:
        return self

    def with_fixed_covariance(self, theta: Array) -> Self:
        """Return the observation with the covariance fixed at its value at `theta (D,)`."""
        assert self.space is not None
        parameters = self.simulator_parameters(self.space.full(theta[None]))[0]
        return dataclasses.replace(self, fixed=tuple(map(float, parameters)))

    def scale_torque(self, factor: float) -> LatentTorqueObservation:
        """Return the observation with `factor` times a known torque size; an unknown size stays."""
        size = self.process[SIZE]
        if isinstance(size, Unknown):
            return self
        return dataclasses.replace(self, process={**self.process, SIZE: size * factor})

    # Arguments of the Kalman filter.

    def _kernel_arguments(self, theta: Array, full: Array | None = None) -> Array:
        assert self.space is not None
        parameters = self.simulator_parameters(self.space.full(theta) if full is None else full)
        return np.concatenate([theta[:, self.noise_columns], parameters], axis=1)

    def _filter_arguments(self, theta: Array, full: Array | None = None) -> tuple[Array, Array]:
        """Return parameters of rig and torque `(W, P + 2)`, and scales of the sensors `(W, K)`."""
        kernel_arguments = self._kernel_arguments(theta, full)
        return self._of_process(kernel_arguments), self.noise.scales(kernel_arguments)

    def _of_process(self, kernel_arguments: Array) -> Array:
        """Return the parameters of rig and torque, `(..., P + 2)`."""
        first, count = len(self.unknowns), len(self.kalman_filter.model.parameters)
        rig = kernel_arguments[..., first : first + count]
        if self.fixed is not None:
            rig = np.broadcast_to(np.array(self.fixed[:count]), rig.shape)
        return np.concatenate([rig, self._sizes(kernel_arguments)], axis=-1)

    def _sizes(self, kernel_arguments: Array) -> Array:
        """Return size and time of the torque, `(..., 2)`."""
        out = np.empty((*kernel_arguments.shape[:-1], 2))
        column = len(self.noise.unknowns)
        for k, value in enumerate((self.process[SIZE], self.process[TIME])):
            is_unknown = isinstance(value, Unknown)
            out[..., k] = kernel_arguments[..., column] if is_unknown else value
            column += is_unknown
        return out

    def sizes(self, theta: Array) -> Array:
        """Return size and time of the torque, `(W, 2)`."""
        return self._sizes(theta[:, self.noise_columns])

    # Densities.

    def by_channel(self, full: Array, theta: Array) -> Array:
        record = self.response.record
        if self.fixed is None and record is not None:
            return self.kalman_filter.log_density(*self._filter_arguments(theta, full), record)
        terms = self.pointwise(self.residuals(full).samples, theta)
        return np.asarray(np.nansum(terms, axis=1))

    def pointwise(self, samples: Any, theta: Any) -> Any:
        white, variances = self._whitened(samples, theta)
        return np.asarray(-0.5 * (math.log(2 * math.pi) + np.log(variances) + white**2))

    def whiten(self, samples: Array, theta: Array) -> Array:
        return self._whitened(samples, theta)[0]

    def innovations(self, samples: Array, theta: Array) -> Array:
        white, variances = self._whitened(samples, theta)
        return white * np.sqrt(variances)

    def whitened_jacobian(self, shifts: Array, theta: Array) -> Array:
        return np.nan_to_num(self.whiten(shifts, theta))

    def draw(self, signals: Array, theta: Array, rng: np.random.Generator) -> Array:
        """Draw a record `(W, T, K)` with these signals and another torque."""
        return np.asarray(signals + self._draw_process(theta, rng)[1])

    def _draw_process(self, theta: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        with np.errstate(all="ignore"):
            return self.kalman_filter.draw(*self._filter_arguments(theta), rng)

    def smooth(self, samples: Array, theta: Array) -> Array:
        """Return smoothed states `(W, T, n)` given all residuals `samples (W, T, K)`.

        The last state is torque / size; the other states are deviations that the torque causes.
        """
        with np.errstate(all="ignore"):
            states = self.kalman_filter.smooth(*self._filter_arguments(theta), samples)
        return np.asarray(states)

    def predict(self, full: Array, theta: Array) -> Array:
        """Return the channels `(W, T, K)` without noise, with the motion by the smoothed torque."""
        signals = self.signals(full)
        states = self.smooth(self.experiment.y - signals, theta)
        return signals + np.asarray(states @ self.kalman_filter.output_matrix.T)

    def sample_states(
        self, samples: Array, theta: Array, rng: np.random.Generator
    ) -> tuple[Array, Array]:
        """Draw states `(W, T, n)` given all samples, and return them with their signals `(W, T, K)`."""
        prior_states, prior_signals = self._draw_process(theta, rng)
        states = prior_states + self.smooth(samples - prior_signals, theta)
        return states, np.asarray(states @ self.kalman_filter.output_matrix.T)

    def replicate(self, signals: Array, theta: Array, rng: np.random.Generator) -> Array:
        moved = self.sample_states(self.experiment.y - signals, theta, rng)[1]
        return self.noise.draw(signals + moved, theta[:, self.noise_columns], rng)

    def _whitened(self, samples: Array, theta: Array) -> tuple[Array, Array]:
        with np.errstate(all="ignore"):
            return self.kalman_filter.whiten(*self._filter_arguments(theta), samples)

    # Slopes.

    def quadratic_terms(self, directions: Directions) -> Iterator[tuple[Array, Array]]:
        """Yield one slope and curvature of all unknowns, as the covariance depends on the rig, too."""
        moved, kernel_arguments = (
            self._argument_slopes(directions),
            self._kernel_arguments(directions.theta, directions.full),
        )
        turned = moved[..., len(self.unknowns) :]
        signals, shifts = self.response.course(self.simulator_parameters(directions.full), turned)
        residuals = np.nan_to_num(self.experiment.y - signals)
        yield self._slopes(residuals, -shifts, kernel_arguments, moved)

    def _argument_slopes(self, directions: Directions) -> Array:
        """Return slopes of the kernels' arguments `(W, q, n + P)` along the directions."""
        levels = (directions.slopes[:, None, :] * directions.columns.T)[..., self.noise_columns]
        along = directions.parameter_directions
        if along is None:
            along = np.zeros((*levels.shape[:2], directions.full.shape[1]))
        return np.concatenate([levels, self.simulator_parameters(along)], axis=-1)

    def _slopes(
        self, residuals: Array, slopes: Array, kernel_arguments: Array, directions: Array
    ) -> tuple[Array, Array]:
        """Return slope `(W, q)` and curvature `(W, q, q)` of the log likelihood.

        Residuals have the slopes `slopes (W, q, T, K)`, and arguments the slopes `directions`.
        """
        n, q = directions.shape[:2]
        slope, curvature = np.empty((n, q)), np.empty((n, q, q))
        chunk = max(1, int(MAX_SLOPE_BYTES / (64 * q * max(residuals[0].size, 1))))
        for rows in (slice(k, k + chunk) for k in range(0, n, chunk)):
            samples, arguments = (x[rows].repeat(q, axis=0) for x in (residuals, kernel_arguments))
            turned, moved = (x[rows].reshape(-1, *x.shape[2:]) for x in (slopes, directions))
            results = self._filtered(Dual(samples, turned), Dual(arguments, moved))
            parts = (part.reshape(len(slope[rows]), q, -1) for part in results)
            white, change, variance, wider = parts
            ratio = 0.5 * wider / variance
            slope[rows] = -(white * change).sum(axis=-1) - ratio.sum(axis=-1)
            curvature[rows] = change @ change.swapaxes(1, 2) + ratio @ ratio.swapaxes(1, 2)
        return slope, curvature

    def _filtered(self, residuals: Dual, kernel_arguments: Dual) -> tuple[Array, ...]:
        """Return whitened residuals and their slopes, innovation variances and their slopes."""
        arguments = (self._of_process, self.noise.scales)
        numbers = [*(affine_map(each, kernel_arguments) for each in arguments), residuals]
        with np.errstate(all="ignore"):
            return self.kalman_filter.slopes(*((each.value, each.slope) for each in numbers))

    def scores(self, directions: Directions, slopes: Array) -> Array:
        count = len(slopes)
        samples = np.nan_to_num(self.residuals(directions.full).samples).repeat(count, axis=0)
        arguments = self._kernel_arguments(directions.theta, directions.full).repeat(count, axis=0)
        moved = Dual(arguments, self._argument_slopes(directions)[0])
        white, change, variance, wider = self._filtered(Dual(samples, -slopes), moved)
        return np.asarray(-white * change - 0.5 * wider / variance)

    def expected(self, theta: Array) -> Array:
        """Return the expected curvature `(n,)` by the unknowns of noise and torque."""
        kernel_arguments, count = self._kernel_arguments(theta[None]), len(self.unknowns)
        along = np.zeros((1, count, kernel_arguments.shape[1]))
        along[:, range(count), range(count)] = kernel_arguments[:, :count]
        shape = self.experiment.y.shape
        residuals, slopes = np.zeros((1, *shape)), np.zeros((1, count, *shape))
        curvature = self._slopes(residuals, slopes, kernel_arguments, along)[1]
        return np.asarray(2.0 * np.diagonal(curvature[0]))

    def fitted(self, full: Array, theta: Array) -> Array:
        """Return the unknowns unchanged, as levels of noise and torque cannot be fitted separately."""
        return theta[self.noise_columns]


def observe(
    response: Simulator,
    noise: Noise,
    label: str = "",
    torque: MissingTorque | None = None,
    process: Mapping[str, float | Unknown] | None = None,
) -> Observation:
    """Return the observation of a record, with a missing `torque` and its `process`, if any.

    Names have no label, as in a single experiment.  With a torque, raises `ValueError` if the noise
    is not white, or if the Kalman filter cannot use the times.
    """
    names = [unknown.name for unknown in noise.unknowns]
    shared: dict[str, Any] = {
        "response": response, "noise": noise, "parameters": response.parameters, "label": label,
    }  # fmt: skip
    if torque is None or process is None:
        return Observation(noise_names=names, **shared)
    if not noise.white:
        why = "other noise resembles it; remove `noise:` of the channels, or this entry"
        white = "a missing torque needs white noise in every channel"
        raise ValueError(f"{white}: {why}")
    step_lengths(response.experiment)
    return LatentTorqueObservation(
        kalman_filter=KalmanFilter(response.model, torque, response.experiment),
        process=process,
        noise_names=[*names, *(n for n, x in process.items() if isinstance(x, Unknown))],
        **shared,
    )
