"""The likelihood of records given the unknowns: simulators and noises, put together."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol, Self

import numpy as np

from bayesdrill.basics.arrays import Array, Flags
from bayesdrill.inference.noise.contract import Noise
from bayesdrill.inference.noise.mixed import noise_for_record
from bayesdrill.inference.unknowns import ParameterSpace, Unknown
from bayesdrill.record.experiment import Experiment
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.simulators import simulator
from bayesdrill.rig.simulators.compressed import compress, obstacle
from bayesdrill.rig.simulators.contract import Simulator
from bayesdrill.rig.simulators.kalman import KalmanFilter
from bayesdrill.rig.simulators.sensors import ObservationModel


@dataclass(frozen=True)
class SimulatorResiduals:
    """Measured minus model, each sum as it is first asked for.

    It is a `noise.contract.Residuals`.  `full (W, P)`: parameters of this simulator alone.  Samples
    are NaN where nothing was measured.  `over_scales (W, K)`: sums of squares over the noise's
    scales, where a kernel has given them already.
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Directions:
    """Directions along which slopes are wanted, at unknowns `theta (W, D)`.

    `full (W, P)`: their parameters; `columns (D, q)`: directions of coordinates, and
    `parameter_directions (W, q, P)` of parameters, None where none moves.  `slopes (W, D)`: d
    unknown / d coordinate; `by_log`: of its log, or of itself where it need not be positive.
    """

    theta: Array
    full: Array
    columns: Array
    parameter_directions: Array | None
    slopes: Array
    by_log: Array


class LatentTorque(Protocol):
    """An observation with a torque that its rig's equations are without; `theta (W, D)`."""

    @property
    def kalman_filter(self) -> KalmanFilter:
        """Return the filter of rig and torque."""

    def sizes(self, theta: Array) -> Array:
        """Return size and time of the torque, `(W, 2)`."""

    def smooth(self, samples: Array, theta: Array) -> Array:
        """Return smoothed states `(W, T, n)` given all residuals `samples (W, T, K)`.

        They are of the rig, as far as the torque moves it, and of the torque over its size.
        """

    def sample_states(
        self, samples: Array, theta: Array, rng: np.random.Generator
    ) -> tuple[Array, Array]:
        """Draw states `(W, T, n)`, and what channels show of them without noise `(W, T, K)`."""

    def scale_torque(self, factor: float) -> Observation:
        """Return it with a torque so many times as large, where its size is known."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Observation:
    """A record and its density, given unknowns `theta (W, D)` and parameters `full (W, P)`.

    `response` simulates it, and `noise` is that of the residuals.  Other kinds have other
    densities, and the same members: nobody asks which kind it is.

    `parameters`, `noise_names`: what its simulator's parameters and its noise's unknowns are called
    among those of all; `columns`, `noise_columns`: where these stand in `full`, None for all of it,
    and in `theta`, once it is bound to their `space`.  `label`: its name among several.
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
        """Return it with its columns among the parameters and unknowns of all."""
        columns: list[int] | None = [space.model.index(name) for name in self.parameters]
        if columns == list(range(len(space.model))):
            columns = None
        of_noise = [space.free.index(name) for name in self.noise_names]
        noise_columns = _column_index(of_noise, len(space.free))
        return dataclasses.replace(self, columns=columns, noise_columns=noise_columns, space=space)

    @property
    def experiment(self) -> Experiment:
        """Return the record."""
        return self.response.experiment

    def with_record(self, y: Array) -> Self:
        """Return it for another record `(T, K)` of the same experiment."""
        return dataclasses.replace(self, response=self.response.with_record(y))

    def simulator_parameters(self, full: Array) -> Array:
        """Select the columns of `full (..., P)` that its simulator takes."""
        return full if self.columns is None else full[..., self.columns]

    def named(self, names: Sequence[str]) -> dict[str, str]:
        """Map the first parameters of its simulator to their names among those of all."""
        return dict(zip(names, self.parameters, strict=False))

    def residuals(self, full: Array) -> SimulatorResiduals:
        """Return the residuals at parameters `full`."""
        return SimulatorResiduals(self.response, self.simulator_parameters(full))

    def signals(self, full: Array) -> Array:
        """Return the channels without noise and without a missing torque, `(W, T, K)`."""
        return self.response.signals(self.simulator_parameters(full))

    def entitled(self, quantity: str) -> str:
        """Return `record of slow`, where there are several experiments."""
        return f"{quantity} of {self.label}" if self.label else quantity

    @property
    def n_measured(self) -> int:
        """Return how many numbers were measured."""
        return sum(self.experiment.counts)

    def weighted_squares(self, full: Array, theta: Array) -> Array:
        """Return sums of squared residuals `(W, K)` over the noise."""
        if self.white:
            return np.asarray(self.residuals(full).squares / self.scales(theta) ** 2)
        samples = self.whiten(self.residuals(full).samples, theta)
        return np.asarray(np.nansum(samples**2, axis=1))

    def whitened_jacobian_at(self, shifts: Array, theta: Array) -> Array:
        """Return `shifts (n, T, K)` of the signals over the noise at `theta (D,)`.

        They are zero where nothing was measured; their squares sum to what the record knows of them.
        """
        measured_shifts = np.where(self.experiment.seen, shifts, 0.0)
        if self.white:
            return np.asarray(measured_shifts / self.scales(theta[None]))
        return self.whitened_jacobian(measured_shifts, np.repeat(theta[None], len(shifts), axis=0))

    def with_simulator(self, response: Simulator, parameters: Sequence[str]) -> Self:
        """Return it with another simulator, whose parameters have these names; unbound."""
        return dataclasses.replace(self, response=response, parameters=parameters)

    def for_rig(self, model: Model, sensing: ObservationModel) -> Self:
        """Return it for another rig and other sensors, in the same steps; unbound.

        New parameters are called among those of all as they are in rig and sensors.
        """
        old = self.response
        response = simulator(model, self.experiment, sensing, *(old.stepping or ()))
        names = self.named(old.parameters)
        parameters = [names.get(name, name) for name in response.parameters]
        return self.with_simulator(response, parameters)

    def for_record(self, experiment: Experiment) -> Self:
        """Return it for another record, with other samples missing, or fewer; unbound.

        Raises `ValueError` where the noise needs every sample.
        """
        t = experiment.t
        noise = noise_for_record(self.noise.for_length(len(t)), t, experiment.seen)
        copied = self.with_simulator(self.response.of(experiment), self.parameters)
        return dataclasses.replace(copied, noise=noise)

    # What another kind has in its own way.

    @property
    def unknowns(self) -> tuple[Unknown, ...]:
        """Return all unknowns but those of the simulator."""
        return self.noise.unknowns

    @property
    def white(self) -> bool:
        """Whether sums of squared residuals over `scales` are enough."""
        return self.noise.white

    @property
    def kind(self) -> str:
        """Return the key by which results know its density; empty where it is white."""
        return "" if self.noise.white else repr(self.noise)

    @property
    def torque(self) -> LatentTorque | None:
        """Return the observation of a latent torque; None where it has none."""
        return None

    def with_fixed_covariance(self, theta: Array) -> Self:
        """Return it with a covariance that follows from the rig fixed as at `theta (D,)`, or itself."""
        return self

    def by_channel(self, full: Array, theta: Array) -> Array:
        """Return the log likelihood `(W, K)`."""
        return self.noise.log_likelihood(self.residuals(full), theta[:, self.noise_columns])

    def pointwise(self, samples: Array, theta: Array) -> Array:
        """Return the log density `(W, T, K)` of each residual given those before it."""
        return self.noise.pointwise(samples, theta[:, self.noise_columns])

    def scales(self, theta: Array) -> Array:
        """Return standard deviations of single samples `(W, K)`, SI."""
        return self.noise.scales(theta[:, self.noise_columns])

    def square_weights(self, theta: Array) -> Array | None:
        """Return weights of sums of squares `(W, K, n)`; see `Noise.square_weights`."""
        return self.noise.square_weights(theta[:, self.noise_columns])

    # Long records, see `inference.compression`.

    @property
    def exact_reason(self) -> str:
        """Say why its record cannot be compressed whatever its parameters; empty where it can."""
        if self.noise.square_weights(np.empty((0, len(self.noise.unknowns)))) is None:
            return "its noise is not Gaussian and even in time"
        return obstacle(self.response)

    @property
    def functions(self) -> int:
        """How many functions its record has become; zero where it is not compressed."""
        return self.response.functions

    def exceeds_bound(self, full: Array, theta: Array) -> Flags:
        """Tell which unknowns `(W,)` of a compressed record have all samples."""
        return self.response.exceeds_bound(self.simulator_parameters(full))

    def compress(self, full: Array, theta: Array) -> Any:
        """Compress its record for these unknowns, the first of which are the reference.

        What results is for `with_compression`.  Raises `CompressionError` where it cannot be done.
        """
        variances, weights = self.scales(theta).min(axis=0) ** 2, self.square_weights(theta)
        assert weights is not None
        limits = np.abs(weights).max(axis=0)
        return compress(self.response, self.simulator_parameters(full), variances, limits)

    def with_compression(self, compression: Any) -> Self:
        """Return it with its record compressed; with all samples where `compression` is None."""
        exact = self.response.by_samples
        response = exact if compression is None else compression.applied(exact)
        return dataclasses.replace(self, response=response)

    def whiten(self, samples: Array, theta: Array) -> Array:
        """Return whitened residuals `(W, T, K)`, independent and standard normal."""
        return self.noise.whiten(samples, theta[:, self.noise_columns])

    def innovations(self, samples: Array, theta: Array) -> Array:
        """Return errors of one-step-ahead predictions `(W, T, K)`, SI."""
        return self.noise.innovations(samples, theta[:, self.noise_columns])

    def whitened_jacobian(self, shifts: Array, theta: Array) -> Array:
        """Return whitened shifts `(W, T, K)`; see `Noise.whitened_jacobian`."""
        return self.noise.whitened_jacobian(shifts, theta[:, self.noise_columns])

    def quadratic_terms(self, at: Directions) -> Iterator[tuple[Array, Array]]:
        """Yield slopes `(W, q)` and curvatures `(W, q, q)` that add up to the likelihood's."""
        residuals, noise_theta = self.residuals(at.full), at.theta[:, self.noise_columns]
        if at.parameter_directions is not None:
            along = at.parameter_directions
            residuals, slope, curvature = self._slopes_of_signals(at.full, along, noise_theta)
            yield slope, curvature
        if self.noise.unknowns:
            levels, owned = at.by_log[:, self.noise_columns], at.columns[self.noise_columns]
            pulled, bent = self.noise.noise_score(residuals, noise_theta)
            if bent.ndim == levels.ndim:
                curvature = directional_curvature(owned, bent * levels**2)
            else:
                curvature = owned.T @ (levels[:, :, None] * bent * levels[:, None, :]) @ owned
            yield directional_slope(levels * pulled, owned), curvature

    def _slopes_of_signals(
        self, full: Array, along: Array, noise_theta: Array
    ) -> tuple[SimulatorResiduals, Array, Array]:
        """Residuals; slope `(W, q)` and curvature `(W, q, q)` along `along (W, q, P)`."""
        residuals, turned = self.residuals(full), self.simulator_parameters(along)
        weights = self.noise.square_weights(noise_theta)
        if weights is not None:
            squares, slope, curvature = self.response.normal(residuals.full, turned, weights)
            return SimulatorResiduals(self.response, residuals.full, squares), slope, curvature
        measured = self.experiment.seen
        slopes = self.response.sensitivities(residuals.full, turned)
        shifts = np.where(measured, slopes, 0.0)  # (W, q, T, K)
        pull = np.where(measured, self.noise.score(residuals.samples, noise_theta), 0.0)
        slope = np.einsum("wqtk,wtk->wq", shifts, pull)
        each = range(along.shape[1])
        rows = [self.noise.whitened_jacobian(shifts[:, q], noise_theta) for q in each]
        flat = np.stack(rows, axis=1).reshape(*shifts.shape[:2], -1)
        return residuals, slope, flat @ flat.swapaxes(1, 2)

    def expected(self, theta: Array) -> Array:
        """Return the expected curvature of the noise; see `Noise.expected`; `theta (D,)`."""
        return self.noise.expected(theta[self.noise_columns])

    def fitted(self, samples: Array, theta: Array) -> Array:
        """Return noise unknowns fitted to `samples (T, K)`; see `Noise.fitted`."""
        return self.noise.fitted(samples, theta[self.noise_columns])

    def predict(self, full: Array, theta: Array) -> Array:
        """Return the noise-free channels `(W, T, K)`, with the motion by a latent torque."""
        return self.signals(full)

    def draw(self, signals: Array, theta: Array, rng: np.random.Generator) -> Array:
        """Draw another record `(W, T, K)` of these signals."""
        return self.noise.draw(signals, theta[:, self.noise_columns], rng)

    def replicate(self, signals: Array, theta: Array, rng: np.random.Generator) -> Array:
        """Draw this record once more `(W, T, K)`: with fresh noise, and the torque that it had."""
        return self.draw(signals, theta, rng)


@dataclass(frozen=True, slots=True)
class Likelihood:
    """The likelihood of unknowns `theta (W, D)`: a sum over observations, which share them.

    `held_out`: others, which are no evidence, and only to be predicted.
    """

    observations: tuple[Observation, ...]
    space: ParameterSpace
    held_out: tuple[Observation, ...] = ()

    @classmethod
    def joint(
        cls, space: ParameterSpace, parts: Sequence[Observation], held_out: Collection[str] = ()
    ) -> Likelihood:
        """Return the likelihood of experiments, whose names stand in `space`, but for `held_out`."""
        bound = [observation.bind(space) for observation in parts]
        selected = tuple(each for each in bound if each.label not in held_out)
        return cls(selected, space, tuple(each for each in bound if each.label in held_out))

    def __call__(self, theta: Array) -> Array:
        """Log likelihood `(W,)`; NaN where a response overflows."""
        with np.errstate(all="ignore"):
            full = self.space.full(theta)
            parts = [each.by_channel(full, theta) for each in self.observations]
            return _concatenated(parts).sum(axis=-1)

    @property
    def n_measured(self) -> int:
        """Return how many numbers were measured."""
        return sum(observation.n_measured for observation in self.observations)

    def mean_square(self, theta: Array) -> Array:
        """Return the mean squared residual over the noise variance `(W,)`: 1 of noise alone."""
        full = self.space.full(theta)
        squares = _concatenated([each.weighted_squares(full, theta) for each in self.observations])
        return np.asarray(squares.sum(axis=-1) / self.n_measured)

    def all_signals(self, theta: Array) -> list[Array]:
        """Return the signals `(W, T, K)` of each observation."""
        full = self.space.full(theta)
        return [observation.signals(full) for observation in self.observations]

    def whitened_residuals(self, theta: Array) -> Array:
        """Return model minus measured over the noise at `theta (D,)`: `(n,)`, zero if not seen."""
        full, parts = self.space.full(theta[None]), []
        for observation in self.observations:
            off = -observation.residuals(full).samples
            parts.append(observation.whitened_jacobian_at(off, theta).ravel())
        return np.concatenate(parts)

    def rig_parameters(self, theta: Array) -> dict[str, Array]:
        """Return parameters of the rig by name, each `(W,)`, as the first observation has them."""
        first = self.observations[0]
        columns = first.simulator_parameters(self.space.full(theta)).T
        return dict(zip(first.response.model.parameters, columns, strict=False))

    @property
    def only_observation(self) -> Observation:
        """Return the only observation; raises `ValueError` where there are more."""
        (observation,) = self.observations
        return observation

    def signals(self, theta: Array) -> Array:
        """Return the channels of the only observation without noise, `(W, T, K)`."""
        return self.only_observation.signals(self.space.full(theta))


def _column_index(columns: list[int], last: int) -> slice | list[int]:
    """A slice where they stand in a row: it copies nothing."""
    first = columns[0] if columns else last
    in_a_row = columns == list(range(first, first + len(columns)))
    return slice(first, first + len(columns)) if in_a_row else columns


def _concatenated(parts: list[Array]) -> Array:
    return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=-1)


def directional_slope(slope: Array, directions: Array) -> Array:
    """Return `slope (W, D)` along `directions (D, q)`: `(W, q)`.

    Point by point: one product of all of them rounds as their number has it.
    """
    return np.asarray((slope[:, None, :] @ directions)[:, 0])


def directional_curvature(directions: Array, curvature: Array) -> Array:
    """Return the diagonal `curvature (W, D)` along `directions (D, q)`: `(W, q, q)`."""
    return np.asarray((curvature[:, None, :] * directions.T) @ directions)
