"""What is not of the rig itself in an experiment: gains, offsets and delays of sensors, and the
start, walker by walker.

y_k(t) = gain_k c_k . x(t - lag_k - delay) + offset_k        x' = A x + B (gain_u u + offset_u) + c

A delay is one of all that drives the rig, offsets of inputs among it: until then it is at its start.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.record.experiment import Experiment
from bayesdrill.rig import models, steady_state
from bayesdrill.rig.models.friction import Named
from bayesdrill.rig.models.linear import Around, Linear, Model, Tangent, driven, dynamics


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensing:
    """Names of parameters by what they belong to: channels, inputs, states.

    `input_lags`: by how much later than its record the rig feels an input, each by itself.
    `delay`: of all inputs, or of the moment at which constant ones are switched on.  `states`: of the
    start; `steady`: the rest of it is the steady state under the first inputs.
    """

    gains: Mapping[str, str] = field(default_factory=dict)
    offsets: Mapping[str, str] = field(default_factory=dict)
    lags: Mapping[str, str] = field(default_factory=dict)
    input_gains: Mapping[str, str] = field(default_factory=dict)
    input_offsets: Mapping[str, str] = field(default_factory=dict)
    input_lags: Mapping[str, str] = field(default_factory=dict)
    delay: str | None = None
    states: Mapping[str, str] = field(default_factory=dict)
    steady: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        """Each once."""
        return tuple(dict.fromkeys(self._every()))

    def _every(self) -> Iterator[str]:
        inputs = (self.input_gains, self.input_offsets, self.input_lags)
        for of in (self.gains, self.offsets, self.lags, *inputs):
            yield from of.values()
        if self.delay is not None:
            yield self.delay
        yield from self.states.values()

    @property
    def shifts(self) -> bool:
        """Whether any channel is seen at other times than those of the inputs."""
        return bool(self.lags) or self.delay is not None

    def moves(self, start: Mapping[str, float]) -> bool:
        """Whether a rig with this `start` may turn, or carry a current, before the first sample."""
        held = [x for name, x in start.items() if models.STATES[name].unit != "rad"]
        return self.steady or bool(self.states) or any(held)

    @property
    def in_words(self) -> str:
        """What each of them has: `twist: gain, lag; v: offset; inputs: delay`."""
        found: dict[str, list[str]] = {}
        kinds = (("gain", self.gains), ("offset", self.offsets), ("lag", self.lags))
        inputs = (
            ("gain", self.input_gains), ("offset", self.input_offsets), ("lag", self.input_lags)
        )  # fmt: skip
        for kind, named in (*kinds, *inputs):
            for of in named:
                found.setdefault(of, []).append(kind)
        if self.delay is not None:
            found["inputs"] = ["delay"]
        return "; ".join(f"{of}: {', '.join(has)}" for of, has in found.items())

    @property
    def start_in_words(self) -> str:
        """Whether it is steady, and which states of it are unknown."""
        unknown = f"{', '.join(self.states)} unknown" if self.states else ""
        return ", ".join(filter(None, ["steady" if self.steady else "", unknown]))

    @property
    def nothing(self) -> bool:
        return not self.names and not self.steady


@dataclass(frozen=True, slots=True)
class Wired(Around):
    """`rig` behind the sensors of its inputs: their gains and offsets are parameters of it."""

    input_gains: tuple[tuple[str, str], ...]
    input_offsets: tuple[tuple[str, str], ...]

    @property
    def parameters(self) -> tuple[str, ...]:
        own = [name for _, name in (*self.input_gains, *self.input_offsets)]
        return (*self.rig.parameters, *dict.fromkeys(own))

    def linear(self, p: Named) -> Linear:
        found, gains, offsets = self.rig.linear(p), dict(self.input_gains), dict(self.input_offsets)
        b, c = dict(found.B), dict(found.c)
        for (row, name), value in found.B.items():
            if name in gains:
                b[row, name] = value * p[gains[name]]
            if name in offsets:
                c[row] = c.get(row, 0.0) + value * p[offsets[name]]
        return Linear(A=found.A, B=b, c=c)


def wired(rig: Model, sensing: Sensing) -> Model:
    """The rig itself where nothing of its inputs is to be told."""
    if not sensing.input_gains and not sensing.input_offsets:
        return rig
    gains, offsets = sensing.input_gains.items(), sensing.input_offsets.items()
    return Wired(rig, tuple(gains), tuple(offsets))


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

    def rows(self, gains: Array, named: Array) -> Array:
        """`(W, K, X + 1)` over states and one: of `gains (W, K)`, and offsets among `named (W, P)`."""
        offsets = self.of_channels(self.sensing.offsets, named)
        return np.concatenate([gains[:, :, None] * self.weights, offsets[:, :, None]], axis=2)

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
        return steady_state.angles_of(self.model)

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
            out[:] = steady_state.states(
                matrix, forcing + by_input @ self.first_inputs, self.angles
            )
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
            out[:] = steady_state.state_slopes(
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
