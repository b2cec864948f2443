"""What parameters say of sensors and of the start, walker by walker, as a simulator wants it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from bayesdrill.record.experiment import Experiment
from bayesdrill.rig import steady
from bayesdrill.rig.models.linear import Model, driven, dynamics
from bayesdrill.rig.models.tangent import Tangent
from bayesdrill.rig.sensing import Sensing, wired

Array = NDArray[np.float64]
Numbers = tuple[Array, Array, Array]


@dataclass(frozen=True)
class Walkers:
    """`full (W, P)`: the model's parameters, then those that `sensing` names.

    What is linear in them has its slope along `along (W, P)` by the same function.
    """

    model: Model
    experiment: Experiment
    sensing: Sensing

    @cached_property
    def parameters(self) -> tuple[str, ...]:
        return (*self.model.parameters, *self.sensing.names)

    @cached_property
    def wired(self) -> Model:
        return wired(self.model, self.sensing)

    def told(self, full: Array) -> Array:
        """The parameters of the wired rig, of all."""
        return full if self._places is None else full[:, self._places]

    @cached_property
    def _places(self) -> list[int] | None:
        """None where they are all."""
        places = [self.parameters.index(name) for name in self.wired.parameters]
        return None if places == [*range(len(self.parameters))] else places

    def column(self, name: str, full: Array) -> Array:
        return full[:, self.parameters.index(name)]

    # The record's own.

    @property
    def lead(self) -> bool:
        """Whether the start is before the first sample, and is a knot of its own."""
        return bool(self.experiment.t_start < self.experiment.t[0])

    @cached_property
    def knots(self) -> tuple[Array, dict[str, Array]]:
        one = self.experiment
        if not self.lead:
            return np.asarray(one.t), dict(one.series)
        series = {name: np.append(u[:1], u) for name, u in one.series.items()}
        return np.append(one.t_start, one.t), series

    @cached_property
    def padded(self) -> Array:
        """The record, with nothing seen at a start before it."""
        y = self.experiment.y
        return np.vstack([np.full((1, y.shape[1]), np.nan), y]) if self.lead else np.asarray(y)

    def cut(self, signals: Array) -> Array:
        """`(W, T, ...)` of samples alone."""
        return signals[:, 1:] if self.lead else signals

    @cached_property
    def inputs(self) -> tuple[str, ...]:
        return tuple(self.experiment.series)

    @cached_property
    def moves(self) -> bool:
        """Whether the rig may turn, or carry a current, before the first sample."""
        return self.sensing.moves(self.experiment.start)

    @cached_property
    def first_inputs(self) -> Array:
        return np.array([u[0] for u in self.experiment.series.values()], dtype=np.float64)

    @cached_property
    def weights(self) -> Array:
        """`(K, X)`."""
        return self.experiment.weights(self.model.states)

    # Sensors.

    def of_channels(self, named: Mapping[str, str], full: Array) -> Array:
        """`(W, K)`, zero where there is none."""
        out = np.zeros((len(full), len(self.experiment.channels)))
        for k, channel in enumerate(self.experiment.channels):
            if channel.name in named:
                out[:, k] = self.column(named[channel.name], full)
        return out

    def gains(self, full: Array) -> Array:
        out = self.of_channels(self.sensing.gains, full)
        alone = [c.name not in self.sensing.gains for c in self.experiment.channels]
        return np.asarray(out + np.array(alone, dtype=np.float64))

    def later(self, full: Array) -> Array:
        """How much later each channel shows what the inputs do: `(W, K)`."""
        out = self.of_channels(self.sensing.lags, full)
        if self.sensing.delay is not None:
            out += self.column(self.sensing.delay, full)[:, None]
        return out

    def of_inputs(self, named: Mapping[str, str], full: Array) -> Array:
        """`(W, S)`, of those that have one."""
        found = [self.column(named[name], full) for name in self.inputs if name in named]
        return np.stack(found, axis=1) if found else np.zeros((len(full), 0))

    # The start.

    @cached_property
    def angles(self) -> list[int]:
        return steady.angles_of(self.model)

    def numbers(self, full: Array) -> Numbers:
        """See `numbers`, of the wired rig."""
        return numbers(self.wired, self.experiment, self.told(full))

    def tangent_numbers(self, full: Array, along: Array) -> Numbers:
        both = np.concatenate([self.told(full), self.told(along)], axis=1)
        return numbers(Tangent(self.wired), self.experiment, both)

    def begin(self, of: Numbers | None, full: Array) -> Array:
        """The state at the start, `(W, X)`; `of` None will do where nothing `moves`."""
        names = self.model.states
        out = np.empty((len(full), len(names)))
        if self.sensing.steady:
            assert of is not None
            matrix, by_input, forcing = of
            out[:] = steady.states(matrix, forcing + by_input @ self.first_inputs, self.angles)
            return self._turned(out, full, held=self.experiment.start)
        for k, name in enumerate(names):
            own = self.sensing.states.get(name)
            out[:, k] = (
                self.experiment.start.get(name, 0.0) if own is None else self.column(own, full)
            )
        return out

    def begin_slope(self, of: Numbers | None, along: Array) -> Array:
        """Of what the tangent's numbers are `(n, 2 X, ...)`."""
        x = len(self.model.states)
        out = np.zeros((len(along), x))
        if self.sensing.steady:
            assert of is not None
            matrix, by_input, forcing = of
            drive = forcing + by_input @ self.first_inputs
            out[:] = steady.state_slopes(
                matrix[:, :x, :x], drive[:, :x], matrix[:, x:, :x], drive[:, x:], self.angles
            )
            return self._turned(out, along, held=dict.fromkeys(self.experiment.start, 0.0))
        for k, name in enumerate(self.model.states):
            if name in self.sensing.states:
                out[:, k] = self.column(self.sensing.states[name], along)
        return out

    def _turned(self, states: Array, full: Array, held: Mapping[str, float]) -> Array:
        """Steady states with all angles shifted so that one of them is what it is said to be."""
        for k in self.angles:
            name = self.model.states[k]
            own = self.sensing.states.get(name)
            if own is None and name not in held:
                continue
            at = held[name] if own is None else self.column(own, full)
            states[:, self.angles] += (at - states[:, k])[:, None]
            break
        return states

    def before(self, of: Numbers | None, start: Array) -> Array:
        """How states change before the start: not at all of a rig at rest."""
        if not self.moves:
            return np.zeros_like(start)
        assert of is not None
        matrix, by_input, forcing = of
        moved = np.einsum("nxy,ny->nx", matrix, start) + forcing
        return np.asarray(moved + by_input @ self.first_inputs)

    def before_slope(self, of: Numbers | None, begin: Array) -> Array:
        x = len(self.model.states)
        return self.before(of, begin)[:, x:]


def numbers(model: Model, experiment: Experiment, told: Array) -> Numbers:
    """`A (n, X, X)`, `B (n, X, S)` of the sampled inputs, and what is constant `(n, X)`."""
    named = dict(zip(model.parameters, told.T, strict=True))
    linear, n = model.linear(named), len(told)
    sampled = list(experiment.series)
    by_input = np.zeros((n, len(model.states), len(sampled)))
    for (row, name), value in linear.B.items():
        if name in sampled:
            by_input[:, model.states.index(row), sampled.index(name)] += value
    constant = driven(linear, model.states, n, experiment.constant)
    return dynamics(linear, model.states, n), by_input, constant
