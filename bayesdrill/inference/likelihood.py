"""What records say of the unknowns: simulators and noises, put together."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesdrill.inference.noise.contract import Noise
from bayesdrill.inference.unknowns import ParameterSpace
from bayesdrill.rig.simulator import Simulator

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Observation:
    """A record, what simulates it, and how it scatters; `own`: columns of its noise's unknowns."""

    response: Simulator
    noise: Noise
    own: slice

    def residuals(self, full: Array) -> Remains:
        """At the simulator's parameters `full (W, P)`."""
        return Remains(self.response, full)

    def by_channel(self, full: Array, theta: Array) -> Array:
        """Log likelihood `(W, K)`."""
        return self.noise.log_likelihood(self.residuals(full), theta[:, self.own])

    def scales(self, theta: Array) -> Array:
        """Standard deviations of single samples `(W, K)`, SI."""
        return self.noise.scales(theta[:, self.own])

    def left(self, full: Array, theta: Array) -> Array:
        """Sums of squares `(W, K)` of what is left, over the noise."""
        if self.noise.white:
            return np.asarray(self.response.squares(full) / self.scales(theta) ** 2)
        samples = self.noise.whiten(self.residuals(full).samples, theta[:, self.own])
        return np.asarray((samples**2).sum(axis=1))

    @property
    def numbers(self) -> int:
        """How many were measured."""
        return self.response.experiment.y.size


@dataclass(frozen=True)
class Remains:
    """Measured minus model, `noise.contract.Residuals`: each as it is first asked for."""

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


@dataclass(frozen=True, slots=True)
class Likelihood:
    """Of unknowns `theta (W, D)`: a sum over observations, which share them."""

    observations: tuple[Observation, ...]
    space: ParameterSpace

    @classmethod
    def of(cls, space: ParameterSpace, *pairs: tuple[Simulator, Noise]) -> Likelihood:
        """Of simulators with their noises, whose unknowns stand in `space` in this order."""
        columns = space.columns("noise")
        first = columns[0] if columns else len(space.unknowns)
        made = []
        for response, noise in pairs:
            last = first + len(noise.unknowns)
            made.append(Observation(response, noise, slice(first, last)))
            first = last
        return cls(tuple(made), space)

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
        return self.response.signals(self.space.full(theta))


def _joined(parts: list[Array]) -> Array:
    return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=-1)
