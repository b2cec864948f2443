"""What records say of the unknowns: simulators and noises, put together."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesdrill.inference.noise.contract import Noise
from bayesdrill.inference.noise.shaken import Shaken
from bayesdrill.inference.unknowns import ParameterSpace
from bayesdrill.record.experiment import Experiment
from bayesdrill.rig.simulator import Simulator

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Observation:
    """A record, what simulates it, and how it scatters.

    `own`: columns of its noise's unknowns among `theta (W, D)`; `columns`: of its simulator's parameters
    among `full (W, P)`, None for all of them.  `label`: its name among several.  `space`: of all,
    where its noise wants to know the rig.
    """

    response: Simulator
    noise: Noise
    own: slice | list[int]
    columns: list[int] | None = None
    label: str = ""
    space: ParameterSpace | None = None

    @property
    def experiment(self) -> Experiment:
        return self.response.experiment

    def with_record(self, y: Array) -> Observation:
        """Of another record `(T, K)` of the same experiment."""
        return dataclasses.replace(self, response=self.response.with_record(y))

    def told(self, full: Array) -> Array:
        """What its simulator takes of parameters `(..., P)`."""
        return full if self.columns is None else full[..., self.columns]

    def scatter(self, theta: Array) -> Array:
        """What its noise is told at `theta (W, D)`: its unknowns and, if it wants them, the
        parameters that its simulator is told.
        """
        if self.space is None:
            return theta[:, self.own]
        return np.concatenate([theta[:, self.own], self.told(self.space.full(theta))], axis=1)

    def named(self, own: Sequence[str], every: Sequence[str]) -> dict[str, str]:
        """What the first parameters of its simulator are called among those of all."""
        columns = range(len(every)) if self.columns is None else self.columns
        return {name: every[column] for name, column in zip(own, columns, strict=False)}

    def residuals(self, full: Array) -> Remains:
        """At the parameters `full (W, P)`."""
        return Remains(self.response, self.told(full))

    def signals(self, full: Array) -> Array:
        """The channels without noise, `(W, T, K)`."""
        return self.response.signals(self.told(full))

    def followed(self, full: Array, theta: Array) -> Array:
        """The channels without noise, `(W, T, K)`, with what a missing torque moves of them."""
        signals, noise = self.signals(full), self.noise
        if not isinstance(noise, Shaken):
            return signals
        return signals + noise.moved(self.experiment.y - signals, self.scatter(theta))

    def again(self, signals: Array, theta: Array, rng: np.random.Generator) -> Array:
        """The record once more `(W, T, K)`: `signals` with fresh noise, and the torque that it had."""
        noise, own = self.noise, self.scatter(theta)
        if not isinstance(noise, Shaken):
            return noise.draw(signals, own, rng)
        return noise.again(signals, self.experiment.y - signals, own, rng)

    def sensitivities(self, full: Array, along: Array) -> Array:
        """See `Simulator.sensitivities`; `along (W, q, P)`."""
        return self.response.sensitivities(self.told(full), self.told(along))

    def by_channel(self, full: Array, theta: Array) -> Array:
        """Log likelihood `(W, K)`."""
        return self.noise.log_likelihood(self.residuals(full), self.scatter(theta))

    def scales(self, theta: Array) -> Array:
        """Standard deviations of single samples `(W, K)`, SI."""
        return self.noise.scales(self.scatter(theta))

    def left(self, full: Array, theta: Array) -> Array:
        """Sums of squares `(W, K)` of what is left, over the noise."""
        if self.noise.white:
            return np.asarray(self.response.squares(self.told(full)) / self.scales(theta) ** 2)
        samples = self.noise.whiten(self.residuals(full).samples, self.scatter(theta))
        return np.asarray(np.nansum(samples**2, axis=1))

    def informed(self, shifts: Array, theta: Array) -> Array:
        """`shifts (n, T, K)` of the signals over the noise at `theta (D,)`, zero where nothing was seen.

        Their squares sum to what the record knows of them.
        """
        mine = np.where(self.experiment.seen, shifts, 0.0)
        if self.noise.white:
            return np.asarray(mine / self.scales(theta[None]))
        return self.noise.inform(mine, np.repeat(self.scatter(theta[None]), len(mine), axis=0))

    def levels(self, space: ParameterSpace) -> list[str]:
        """Names of its noise's unknowns."""
        return [space.free[column] for column in np.arange(len(space.free))[self.own]]

    def entitled(self, what: str) -> str:
        """`record of slow`, where there are several."""
        return f"{what} of {self.label}" if self.label else what

    def pinned(self, theta: Array) -> Observation:
        """With the covariance that its noise has at `theta (D,)`, where that follows from the rig."""
        noise = self.noise
        if self.space is None or not isinstance(noise, Shaken):
            return self
        own = self.told(self.space.full(theta[None]))[0]
        return dataclasses.replace(self, noise=noise.pin(own))

    @property
    def numbers(self) -> int:
        """How many were measured."""
        return sum(self.experiment.counts)


@dataclass(frozen=True)
class Remains:
    """Measured minus model, `noise.contract.Residuals`: each as it is first asked for.

    `full (W, P)`: of this simulator alone.  Samples are NaN where nothing was measured.
    """

    response: Simulator
    full: Array

    @cached_property
    def squares(self) -> Array:
        return self.response.squares(self.full)

    @cached_property
    def samples(self) -> Array:
        return np.asarray(self.response.experiment.y - self.response.signals(self.full))

    def weighed(self, weights: Array) -> Array:
        return self.squares * weights**2

    @cached_property
    def neighbours(self) -> Array:
        return self.response.neighbours(self.full)

    def logs(self, weights: Array) -> Array:
        return self.response.logs(self.full, weights)

    def intervals(self, over: Array, half: Array) -> Array:
        return self.response.intervals(self.full, over, half)


@dataclass(frozen=True, slots=True, kw_only=True)
class Part:
    """One of several experiments: `told`, `levels`: what its simulator's parameters and its noise's
    unknowns are called among those of all.
    """

    response: Simulator
    noise: Noise
    told: Sequence[str]
    levels: Sequence[str]
    label: str


@dataclass(frozen=True, slots=True)
class Likelihood:
    """Of unknowns `theta (W, D)`: a sum over observations, which share them.

    `apart`: others, which are no evidence, and only to be predicted.
    """

    observations: tuple[Observation, ...]
    space: ParameterSpace
    apart: tuple[Observation, ...] = ()

    @classmethod
    def of(cls, space: ParameterSpace, *pairs: tuple[Simulator, Noise]) -> Likelihood:
        """Of simulators with their noises, whose unknowns stand in `space` in this order."""
        levels = iter([space.free[column] for column in space.columns("noise")])
        parts = [
            Part(
                response=response,
                noise=noise,
                told=space.model,
                levels=[*islice(levels, len(noise.unknowns))],
                label="",
            )
            for response, noise in pairs
        ]
        return cls.joint(space, parts)

    @classmethod
    def joint(cls, space: ParameterSpace, parts: Sequence[Part]) -> Likelihood:
        """Of several experiments; their names stand in `space`."""
        made = []
        for one in parts:
            columns: list[int] | None = [space.model.index(name) for name in one.told]
            if columns == list(range(len(space.model))):
                columns = None
            own = _places([space.free.index(name) for name in one.levels], len(space.free))
            noise, wants = one.noise, isinstance(one.noise, Shaken)
            made.append(
                Observation(
                    one.response,
                    noise.of_rig(one.response) if isinstance(noise, Shaken) else noise,
                    own,
                    columns,
                    one.label,
                    space if wants else None,
                )
            )
        return cls(tuple(made), space)

    def without(self, labels: Collection[str]) -> Likelihood:
        """With these experiments `apart`."""
        kept = [one for one in self.observations if one.label not in labels]
        apart = [one for one in self.observations if one.label in labels]
        return Likelihood(tuple(kept), self.space, tuple(apart))

    def __call__(self, theta: Array) -> Array:
        """Log likelihood `(W,)`; NaN where a response overflows."""
        with np.errstate(all="ignore"):
            return self.by_channel(theta).sum(axis=-1)

    def by_channel(self, theta: Array) -> Array:
        """`(W, K)`, of the channels of all observations."""
        full = self.space.full(theta)
        return _joined([one.by_channel(full, theta) for one in self.observations])

    @property
    def numbers(self) -> int:
        """How many were measured."""
        return sum(one.numbers for one in self.observations)

    def per_number(self, theta: Array) -> Array:
        """Squared residuals over the noise variance, their mean `(W,)`: 1 where only noise is left."""
        full = self.space.full(theta)
        left = _joined([one.left(full, theta) for one in self.observations])
        return np.asarray(left.sum(axis=-1) / self.numbers)

    # Of the only observation, where there is no other.

    def every_signal(self, theta: Array) -> list[Array]:
        """Of each observation, `(W, T, K)`."""
        full = self.space.full(theta)
        return [one.signals(full) for one in self.observations]

    def pinned(self, theta: Array) -> Likelihood:
        """With covariances as they are at `theta (D,)`."""
        held = tuple(one.pinned(theta) for one in self.observations)
        return dataclasses.replace(self, observations=held)

    def whitened(self, theta: Array) -> Array:
        """Model minus measured over the noise at `theta (D,)`; zero where nothing was seen: `(n,)`."""
        full, parts = self.space.full(theta[None]), []
        for one in self.observations:
            parts.append(one.informed(-one.residuals(full).samples, theta).ravel())
        return np.concatenate(parts)

    def rig(self, theta: Array) -> Array:
        """Parameters of the rig `(W, P)`, in the model's order, as the first observation has them."""
        one = self.observations[0]
        told = one.told(self.space.full(theta))
        return told[:, : len(one.response.model.parameters)]

    @property
    def alone(self) -> Observation:
        """Raises `ValueError` where there are more."""
        (one,) = self.observations
        return one

    @property
    def response(self) -> Simulator:
        return self.alone.response

    @property
    def noise(self) -> Any:
        return self.alone.noise

    def with_alone(self, **changes: Any) -> Likelihood:
        """With another `response` or `noise`."""
        return dataclasses.replace(self, observations=(dataclasses.replace(self.alone, **changes),))

    def own(self, theta: Array) -> Array:
        """The noise's unknowns among `theta`, `(W, n)`."""
        return theta[:, self.alone.own]

    def sigmas(self, theta: Array) -> Array:
        """Of every channel, known or not: `(W, K)`, SI."""
        return self.alone.scales(theta)

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
