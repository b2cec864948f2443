"""What records say of the unknowns: simulators and noises, put together."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol, Self

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.inference.noise.contract import Noise
from bayesdrill.inference.noise.mixed import of_record
from bayesdrill.inference.unknowns import ParameterSpace, Unknown
from bayesdrill.record.experiment import Experiment, frozen
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.simulators import simulator
from bayesdrill.rig.simulators.contract import Simulator
from bayesdrill.rig.simulators.kalman import KalmanFilter
from bayesdrill.rig.simulators.sensors import ObservationModel


@dataclass(frozen=True)
class Remains:
    """Measured minus model, `noise.contract.Residuals`: each as it is first asked for.

    `full (W, P)`: of this simulator alone.  Samples are NaN where nothing was measured.
    `over_scales (W, K)`: sums of squares over the noise's scales, where a kernel has told them already.
    """

    response: Simulator
    full: Array
    over_scales: Array | None = None

    @cached_property
    def squares(self) -> Array:
        return self.response.squares(self.full)

    @cached_property
    def samples(self) -> Array:
        return np.asarray(self.response.experiment.y - self.response.signals(self.full))

    def weighed(self, weights: Array) -> Array:
        return self.squares * weights**2 if self.over_scales is None else self.over_scales

    @cached_property
    def neighbours(self) -> Array:
        return self.response.neighbours(self.full)

    def logs(self, weights: Array) -> Array:
        return self.response.logs(self.full, weights)

    def intervals(self, over: Array, half: Array) -> Array:
        return self.response.intervals(self.full, over, half)


@dataclass(frozen=True, slots=True, kw_only=True)
class Directions:
    """At unknowns `theta (W, D)` and their parameters `full (W, P)`: `columns (D, q)`, of coordinates,
    along which slopes are wanted; of parameters `along (W, q, P)`, None where none moves.  `slopes (W,
    D)`: d unknown / d coordinate; `by_log`: of its log, or of itself where it need not be positive.
    """

    theta: Array
    full: Array
    columns: Array
    along: Array | None
    slopes: Array
    by_log: Array


class Torque(Protocol):
    """What an observation knows of a torque that its rig's equations are without; `theta (W, D)`."""

    @property
    def filtered(self) -> KalmanFilter: ...

    def sizes(self, theta: Array) -> Array:
        """Size and time of the torque, `(W, 2)`."""
        ...

    def smooth(self, samples: Array, theta: Array) -> Array:
        """States of the rig, as far as the torque moves them, and of the torque over its size `(W, T,
        n)`, as all residuals `samples (W, T, K)` say them.
        """
        ...

    def known(self, samples: Array, theta: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """States drawn with all samples known `(W, T, n)`, as `smooth` has them, and what channels
        show of them `(W, T, K)`, without noise.
        """
        ...

    def times(self, factor: float) -> Observation:
        """With a torque so many times as large, where its size is known."""
        ...

    def showing(self, response: Simulator, sigma: float) -> Observation:
        """By a simulator that has one channel more, with white noise of this size."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Observation:
    """A record and its density, given the unknowns `theta (W, D)` and parameters `full (W, P)` of all:
    what simulates it, and the `noise` of what that leaves.  Other kinds have other densities, and the
    same members: nobody asks which kind it is.

    `parameters`, `levels`: what its simulator's parameters and its noise's unknowns are called among
    those of all; `columns`, `own`: where these stand in `full`, None for all of it, and in `theta`, once
    it is `placed`.  `label`: its name among several.
    """

    response: Simulator
    noise: Noise
    parameters: Sequence[str]
    levels: Sequence[str]
    label: str = ""
    columns: list[int] | None = None
    noise_columns: slice | list[int] = slice(0)

    def placed(self, space: ParameterSpace) -> Self:
        """Among the parameters and unknowns of all."""
        columns: list[int] | None = [space.model.index(name) for name in self.parameters]
        if columns == list(range(len(space.model))):
            columns = None
        noise_columns = _places([space.free.index(name) for name in self.levels], len(space.free))
        return dataclasses.replace(self, columns=columns, noise_columns=noise_columns)

    @property
    def experiment(self) -> Experiment:
        return self.response.experiment

    def with_record(self, y: Array) -> Self:
        """Of another record `(T, K)` of the same experiment."""
        return dataclasses.replace(self, response=self.response.with_record(y))

    def told(self, full: Array) -> Array:
        """What its simulator takes of parameters `(..., P)`."""
        return full if self.columns is None else full[..., self.columns]

    def named(self, texts: Sequence[str]) -> dict[str, str]:
        """What the first parameters of its simulator are called among those of all."""
        return dict(zip(texts, self.parameters, strict=False))

    def residuals(self, full: Array) -> Remains:
        return Remains(self.response, self.told(full))

    def signals(self, full: Array) -> Array:
        """The channels without noise, and what no equation of the rig has, `(W, T, K)`."""
        return self.response.signals(self.told(full))

    def sensitivities(self, full: Array, along: Array) -> Array:
        """See `Simulator.sensitivities`; `along (W, q, P)`."""
        return self.response.sensitivities(self.told(full), self.told(along))

    def entitled(self, what: str) -> str:
        """`record of slow`, where there are several."""
        return f"{what} of {self.label}" if self.label else what

    @property
    def numbers(self) -> int:
        """How many were measured."""
        return sum(self.experiment.counts)

    def left(self, full: Array, theta: Array) -> Array:
        """Sums of squares `(W, K)` of what is left, over the noise."""
        if self.white:
            return np.asarray(self.response.squares(self.told(full)) / self.scales(theta) ** 2)
        samples = self.whiten(self.residuals(full).samples, theta)
        return np.asarray(np.nansum(samples**2, axis=1))

    def informed(self, shifts: Array, theta: Array) -> Array:
        """`shifts (n, T, K)` of the signals over the noise at `theta (D,)`, zero where nothing was seen.

        Their squares sum to what the record knows of them.
        """
        mine = np.where(self.experiment.seen, shifts, 0.0)
        if self.white:
            return np.asarray(mine / self.scales(theta[None]))
        return self.inform(mine, np.repeat(theta[None], len(mine), axis=0))

    def simulated(self, response: Simulator, parameters: Sequence[str]) -> Self:
        """By another simulator, whose parameters have these names; to be `placed`."""
        return dataclasses.replace(self, response=response, parameters=parameters)

    def of_rig(self, model: Model, sensing: ObservationModel) -> Self:
        """Return it for another rig and other sensors, in the same steps; to be `placed`.

        New parameters are called among those of all as they are in rig and sensors.
        """
        old = self.response
        response = simulator(model, self.experiment, sensing, *(old.stepping or ()))
        told = self.named(old.parameters)
        return self.simulated(response, [told.get(name, name) for name in response.parameters])

    def on(self, y: Array) -> Self:
        """Of a record `(T, K)` at the same times, with other samples missing; raises `ValueError` where
        the noise has to see all.
        """
        experiment = dataclasses.replace(self.experiment, y=frozen(y))
        noise = of_record(self.noise.for_length(len(y)), experiment.t, experiment.seen)
        made = self.simulated(self.response.of(experiment), self.parameters)
        return dataclasses.replace(made, noise=noise)

    def held(self) -> Mapping[int, object]:
        """See `Noise.held`."""
        return self.noise.held()

    # What another kind has in its own way.

    @property
    def unknowns(self) -> tuple[Unknown, ...]:
        """All but those of the simulator."""
        return self.noise.unknowns

    @property
    def white(self) -> bool:
        """Whether sums of squared residuals over `scales` are enough; nothing is informed then."""
        return self.noise.white

    @property
    def kind(self) -> str:
        """What results know its density by, beside what is `held`; empty where it is white."""
        return "" if self.noise.white else repr(self.noise)

    @property
    def torque(self) -> Torque | None:
        """None where the rig's equations lack none."""
        return None

    def pinned(self, theta: Array) -> Self:
        """With the covariance of its residuals as it is at `theta (D,)`, where that follows from the
        rig; else the very same.
        """
        return self

    def by_channel(self, full: Array, theta: Array) -> Array:
        """Log likelihood `(W, K)`."""
        return self.noise.log_likelihood(self.residuals(full), theta[:, self.noise_columns])

    def pointwise(self, samples: Array, theta: Array) -> Array:
        """`(W, T, K)`, of residuals: log density of each given those before it."""
        return self.noise.pointwise(samples, theta[:, self.noise_columns])

    def scales(self, theta: Array) -> Array:
        """Standard deviations of single samples `(W, K)`, SI."""
        return self.noise.scales(theta[:, self.noise_columns])

    def whiten(self, samples: Array, theta: Array) -> Array:
        """`(W, T, K)`: independent and standard normal, where residuals are as it says."""
        return self.noise.whiten(samples, theta[:, self.noise_columns])

    def innovations(self, samples: Array, theta: Array) -> Array:
        """`(W, T, K)`, SI: errors of one-step-ahead predictions."""
        return self.noise.innovations(samples, theta[:, self.noise_columns])

    def inform(self, shifts: Array, theta: Array) -> Array:
        """`(W, T, K)`: see `Noise.inform`."""
        return self.noise.inform(shifts, theta[:, self.noise_columns])

    def expand(self, at: Directions) -> Iterator[tuple[Array, Array]]:
        """Slopes `(W, q)` and curvatures `(W, q, q)` of the log likelihood, which add up."""
        left, noise_columns = self.residuals(at.full), at.theta[:, self.noise_columns]
        if at.along is not None:
            left, slope, curvature = self._slopes_of_signals(at.full, at.along, noise_columns)
            yield slope, curvature
        if self.noise.unknowns:
            levels, owned = at.by_log[:, self.noise_columns], at.columns[self.noise_columns]
            pulled, bent = self.noise.bend(left, noise_columns)
            if bent.ndim == levels.ndim:
                curvature = weighted(owned, bent * levels**2)
            else:
                curvature = owned.T @ (levels[:, :, None] * bent * levels[:, None, :]) @ owned
            yield along(levels * pulled, owned), curvature

    def _slopes_of_signals(
        self, full: Array, along: Array, noise_values: Array
    ) -> tuple[Remains, Array, Array]:
        """Residuals; slope `(W, q)` and curvature `(W, q, q)` along `along (W, q, P)`."""
        left = self.residuals(full)
        if self.noise.white:
            turned, scales = self.told(along), 1.0 / self.noise.scales(noise_values)
            squares, slope, curvature = self.response.normal(left.full, turned, scales)
            return Remains(self.response, left.full, squares), slope, curvature
        seen = self.experiment.seen
        shifts = np.where(seen, self.sensitivities(full, along), 0.0)  # (W, q, T, K)
        pull = np.where(seen, self.noise.pull(left.samples, noise_values), 0.0)
        slope = np.einsum("wqtk,wtk->wq", shifts, pull)
        rows = [self.noise.inform(shifts[:, q], noise_values) for q in range(along.shape[1])]
        flat = np.stack(rows, axis=1).reshape(*shifts.shape[:2], -1)
        return left, slope, flat @ flat.swapaxes(1, 2)

    def expected(self, theta: Array) -> Array:
        """See `Noise.expected`; `theta (D,)`."""
        return self.noise.expected(theta[self.noise_columns])

    def fitted(self, samples: Array, theta: Array) -> Array:
        """See `Noise.fitted`; residuals `samples (T, K)`, `theta (D,)`."""
        return self.noise.fitted(samples, theta[self.noise_columns])

    def followed(self, full: Array, theta: Array) -> Array:
        """The channels without noise, `(W, T, K)`, with what a missing torque moves of them."""
        return self.signals(full)

    def draw(self, signals: Array, theta: Array, rng: np.random.Generator) -> Array:
        """Another record `(W, T, K)` of these signals."""
        return self.noise.draw(signals, theta[:, self.noise_columns], rng)

    def again(self, signals: Array, theta: Array, rng: np.random.Generator) -> Array:
        """This record once more `(W, T, K)`: with fresh noise, and the torque that it had."""
        return self.draw(signals, theta, rng)


@dataclass(frozen=True, slots=True)
class Likelihood:
    """Of unknowns `theta (W, D)`: a sum over observations, which share them.

    `apart`: others, which are no evidence, and only to be predicted.
    """

    observations: tuple[Observation, ...]
    space: ParameterSpace
    apart: tuple[Observation, ...] = ()

    @classmethod
    def joint(cls, space: ParameterSpace, parts: Sequence[Observation]) -> Likelihood:
        """Of several experiments; their names stand in `space`."""
        return cls(tuple(part.placed(space) for part in parts), space)

    def without(self, labels: Collection[str]) -> Likelihood:
        """With these experiments `apart`."""
        kept = [observation for observation in self.observations if observation.label not in labels]
        apart = [observation for observation in self.observations if observation.label in labels]
        return Likelihood(tuple(kept), self.space, tuple(apart))

    def __call__(self, theta: Array) -> Array:
        """Log likelihood `(W,)`; NaN where a response overflows."""
        with np.errstate(all="ignore"):
            return self.by_channel(theta).sum(axis=-1)

    def by_channel(self, theta: Array) -> Array:
        """`(W, K)`, of the channels of all observations."""
        full = self.space.full(theta)
        return _joined([observation.by_channel(full, theta) for observation in self.observations])

    @property
    def numbers(self) -> int:
        """How many were measured."""
        return sum(observation.numbers for observation in self.observations)

    def per_number(self, theta: Array) -> Array:
        """Squared residuals over the noise variance, their mean `(W,)`: 1 where only noise is left."""
        full = self.space.full(theta)
        left = _joined([observation.left(full, theta) for observation in self.observations])
        return np.asarray(left.sum(axis=-1) / self.numbers)

    # Of the only observation, where there is no other.

    def every_signal(self, theta: Array) -> list[Array]:
        """Of each observation, `(W, T, K)`."""
        full = self.space.full(theta)
        return [observation.signals(full) for observation in self.observations]

    def pinned(self, theta: Array) -> Likelihood:
        """With covariances as they are at `theta (D,)`; the very same where no rig decides one."""
        held = tuple(observation.pinned(theta) for observation in self.observations)
        if all(
            observation is old for observation, old in zip(held, self.observations, strict=True)
        ):
            return self
        return dataclasses.replace(self, observations=held)

    def whitened(self, theta: Array) -> Array:
        """Model minus measured over the noise at `theta (D,)`; zero where nothing was seen: `(n,)`."""
        full, parts = self.space.full(theta[None]), []
        for observation in self.observations:
            parts.append(observation.informed(-observation.residuals(full).samples, theta).ravel())
        return np.concatenate(parts)

    def rig(self, theta: Array) -> Array:
        """Parameters of the rig `(W, P)`, in the model's order, as the first observation has them."""
        first = self.observations[0]
        told = first.told(self.space.full(theta))
        return told[:, : len(first.response.model.parameters)]

    @property
    def alone(self) -> Observation:
        """Raises `ValueError` where there are more."""
        (only,) = self.observations
        return only

    @property
    def response(self) -> Simulator:
        return self.alone.response

    @property
    def noise(self) -> Any:
        return self.alone.noise

    def with_alone(self, **changes: Any) -> Likelihood:
        """With another `response` or `noise`."""
        return dataclasses.replace(self, observations=(dataclasses.replace(self.alone, **changes),))

    def signals(self, theta: Array) -> Array:
        """The channels without noise, `(W, T, K)`."""
        return self.alone.signals(self.space.full(theta))


def _places(columns: list[int], last: int) -> slice | list[int]:
    """A slice where they stand in a row: it copies nothing."""
    first = columns[0] if columns else last
    in_a_row = columns == list(range(first, first + len(columns)))
    return slice(first, first + len(columns)) if in_a_row else columns


def _joined(parts: list[Array]) -> Array:
    return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=-1)


def along(slope: Array, directions: Array) -> Array:
    """Of `slope (W, D)`, along `directions (D, q)`: `(W, q)`.

    Point by point: one product of all of them rounds as their number has it.
    """
    return np.asarray((slope[:, None, :] @ directions)[:, 0])


def weighted(directions: Array, curvature: Array) -> Array:
    """Of the diagonal `curvature (W, D)`, along `directions (D, q)`: `(W, q, q)`."""
    return np.asarray((curvature[:, None, :] * directions.T) @ directions)
