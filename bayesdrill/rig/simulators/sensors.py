"""The observation model: gains, offsets and delays of sensors, and the start, walker by walker.

    y_k(t) = gain_k c_k . x(t - lag_k - delay) + offset_k        x' = A x + B (gain_u u + offset_u) + c

A delay is one of all that drives the rig, offsets of inputs among it: until then it is at its
start.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.record.experiment import Experiment
from bayesdrill.rig import steady_state
from bayesdrill.rig.models.friction import Named
from bayesdrill.rig.models.linear import (
    Linear,
    Model,
    Tangent,
    WrappedModel,
    constant_forcing,
    dynamics,
)
from bayesdrill.rig.simulators.time_grid import Grid, build_grid


def signal_names(model: Model) -> tuple[str, ...]:
    """Return what a sensor may see: states, and what else turns with them."""
    combined = [n for n, of in model.combinations.items() if {*of} <= {*model.outer}]
    return (*model.outer, *combined)


def state_weights(model: Model, combines: Mapping[str, float]) -> dict[str, float]:
    """Return the weights of states in a sum of `signal_names`."""
    weights: dict[str, float] = {}
    for name, factor in combines.items():
        for state, weight in model.combinations.get(name, {name: 1.0}).items():
            weights[state] = weights.get(state, 0.0) + factor * weight
    return weights


@dataclass(frozen=True, slots=True, kw_only=True)
class ObservationModel:
    """Names of parameters of sensors and start, by what they belong to: channels, inputs, states.

    `input_lags`: by how much later than its record the rig feels an input, each by itself. `delay`:
    of all inputs, or of the moment at which constant ones are switched on.  `states`: of the start;
    `steady`: the rest of it is the steady state under the first inputs.
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
    def _kinds(self) -> list[tuple[str, Mapping[str, str]]]:
        sensors = (self.gains, self.offsets, self.lags)
        inputs = (self.input_gains, self.input_offsets, self.input_lags)
        return [*zip(("gain", "offset", "lag") * 2, (*sensors, *inputs), strict=True)]

    @property
    def names(self) -> tuple[str, ...]:
        """All names, each once."""
        every = [name for _, named in self._kinds for name in named.values()]
        every += [] if self.delay is None else [self.delay]
        return tuple(dict.fromkeys([*every, *self.states.values()]))

    @property
    def shifts(self) -> bool:
        """Whether any channel is seen at other times than those of the inputs."""
        return bool(self.lags) or self.delay is not None

    def moves(self, start: Mapping[str, float], angles: Collection[str]) -> bool:
        """Tell whether a rig with this `start` may turn, or carry a current, before the record.

        `angles`: names of its states that are angles, or positions.
        """
        rates = [x for name, x in start.items() if name not in angles]
        return self.steady or bool(self.states) or any(rates)

    @property
    def summary(self) -> str:
        """What each of them has, such as `twist: gain, lag; v: offset; inputs: delay`."""
        kinds_of: dict[str, list[str]] = {}
        for kind, named in self._kinds:
            for name in named:
                kinds_of.setdefault(name, []).append(kind)
        if self.delay is not None:
            kinds_of["inputs"] = ["delay"]
        return "; ".join(f"{name}: {', '.join(has)}" for name, has in kinds_of.items())

    @property
    def start_summary(self) -> str:
        """Whether the start is steady, and which states of it are unknown."""
        unknown = f"{', '.join(self.states)} unknown" if self.states else ""
        return ", ".join(filter(None, ["steady" if self.steady else "", unknown]))

    @property
    def empty(self) -> bool:
        """Whether sensors are perfect and the start is known."""
        return not self.names and not self.steady


@dataclass(frozen=True, slots=True)
class ObservedModel(WrappedModel):
    """A `rig` behind the sensors of its inputs: their gains and offsets are parameters of it."""

    input_gains: tuple[tuple[str, str], ...]
    input_offsets: tuple[tuple[str, str], ...]

    @property
    def parameters(self) -> tuple[str, ...]:
        """The rig's, then those of its inputs' sensors."""
        sensor_names = [name for _, name in (*self.input_gains, *self.input_offsets)]
        return (*self.rig.parameters, *dict.fromkeys(sensor_names))

    def linear(self, p: Named) -> Linear:
        """See `Model.linear`."""
        linear = self.rig.linear(p)
        gains, offsets = dict(self.input_gains), dict(self.input_offsets)
        b, c = dict(linear.B), dict(linear.c)
        for (row, name), value in linear.B.items():
            if name in gains:
                b[row, name] = value * p[gains[name]]
            if name in offsets:
                c[row] = c.get(row, 0.0) + value * p[offsets[name]]
        return Linear(A=linear.A, B=b, c=c)


def observed_model(rig: Model, sensing: ObservationModel) -> Model:
    """Return the rig behind its inputs' sensors; the rig itself where these have no unknowns."""
    if not sensing.input_gains and not sensing.input_offsets:
        return rig
    gains, offsets = sensing.input_gains.items(), sensing.input_offsets.items()
    return ObservedModel(rig, tuple(gains), tuple(offsets))


@dataclass(frozen=True)
class SensorParameters:
    """Columns of `full (W, P)`: the model's parameters, then those that `sensing` names.

    What is linear in them has its slope along `along (W, P)` by the same function.
    """

    model: Model
    experiment: Experiment
    sensing: ObservationModel

    @cached_property
    def parameters(self) -> tuple[str, ...]:
        """Names of the columns."""
        return (*self.model.parameters, *self.sensing.names)

    @cached_property
    def observed_model(self) -> Model:
        """The model behind its inputs' sensors."""
        return observed_model(self.model, self.sensing)

    def simulator_parameters(self, full: Array) -> Array:
        """Select the columns of `full` that are parameters of `observed_model`."""
        return full if self._columns is None else full[:, self._columns]

    @cached_property
    def _columns(self) -> list[int] | None:
        """Indices of these columns; None where they are all."""
        places = [self.parameters.index(name) for name in self.observed_model.parameters]
        return None if places == [*range(len(self.parameters))] else places

    def column(self, name: str, full: Array) -> Array:
        """Return the column `(W,)` of a name."""
        return full[:, self.parameters.index(name)]

    # The record's own.

    @property
    def lead(self) -> bool:
        """Whether the start is before the first sample, and is a knot of its own."""
        return bool(self.experiment.t_start < self.experiment.t[0])

    @cached_property
    def knots(self) -> tuple[Array, dict[str, Array]]:
        """Times of start and samples, and sampled inputs there."""
        experiment = self.experiment
        if not self.lead:
            return np.asarray(experiment.t), dict(experiment.series)
        series = {name: np.append(u[:1], u) for name, u in experiment.series.items()}
        return np.append(experiment.t_start, experiment.t), series

    @cached_property
    def grid(self) -> Grid:
        """The grid of these times."""
        return build_grid(self.knots[0])

    @cached_property
    def padded(self) -> Array:
        """The record, with nothing observed at a start before it."""
        y = self.experiment.y
        return np.vstack([np.full((1, y.shape[1]), np.nan), y]) if self.lead else np.asarray(y)

    def drop_start(self, signals: Array) -> Array:
        """Return `(W, T, ...)` of samples alone."""
        return signals[:, 1:] if self.lead else signals

    @cached_property
    def inputs(self) -> tuple[str, ...]:
        """Names of the sampled inputs."""
        return tuple(self.experiment.series)

    @cached_property
    def moves(self) -> bool:
        """Whether the rig may turn, or carry a current, before the first sample."""
        return self.sensing.moves(self.experiment.start, self.model.angles)

    @cached_property
    def first_inputs(self) -> Array:
        """Sampled inputs at the first sample, `(S,)`."""
        return np.array([u[0] for u in self.experiment.series.values()], dtype=np.float64)

    @cached_property
    def weights(self) -> Array:
        """Weights of states in channels, `(K, X)`."""
        return self.experiment.weights(self.model.states)

    # Sensors.

    def channel_values(self, named: Mapping[str, str], full: Array) -> Array:
        """Return a parameter of each channel, `(W, K)`, zero where there is none."""
        out = np.zeros((len(full), len(self.experiment.channels)))
        for k, channel in enumerate(self.experiment.channels):
            if channel.name in named:
                out[:, k] = self.column(named[channel.name], full)
        return out

    def gains(self, full: Array) -> Array:
        """Return the gains of channels `(W, K)`, one where they have none."""
        out = self.channel_values(self.sensing.gains, full)
        alone = [c.name not in self.sensing.gains for c in self.experiment.channels]
        return np.asarray(out + np.array(alone, dtype=np.float64))

    def rows(self, gains: Array, named: Array) -> Array:
        """Return `(W, K, X + 1)` over states and one.

        They are `gains (W, K)` times weights, and offsets among `named (W, P)`.
        """
        offsets = self.channel_values(self.sensing.offsets, named)
        return np.concatenate([gains[:, :, None] * self.weights, offsets[:, :, None]], axis=2)

    def channel_delays(self, full: Array) -> Array:
        """Return how much later each channel shows what the inputs do: `(W, K)`, in s."""
        out = self.channel_values(self.sensing.lags, full)
        if self.sensing.delay is not None:
            out += self.column(self.sensing.delay, full)[:, None]
        return out

    def input_values(self, named: Mapping[str, str], full: Array) -> Array:
        """Return a parameter of those inputs that have it, `(W, S)`."""
        columns = [self.column(named[name], full) for name in self.inputs if name in named]
        return np.stack(columns, axis=1) if columns else np.zeros((len(full), 0))

    # The start.

    @cached_property
    def angles(self) -> list[int]:
        """Indices of the angles."""
        return steady_state.angle_indices(self.model)

    def shift_angles(
        self, states: Array, free: Array | None, full: Array, known: Mapping[str, float]
    ) -> Array:
        """Turn the rig in steady states so that one of its angles is what it is known to be.

        `free`: its `free_turn`.
        """
        turn = np.ones(len(self.angles)) if free is None else free
        for k, times in zip(self.angles, turn, strict=True):
            name = self.model.states[k]
            parameter = self.sensing.states.get(name)
            if parameter is None and name not in known:
                continue
            at = known[name] if parameter is None else self.column(parameter, full)
            shift = (at - states[:, k])[:, None]
            states[:, self.angles] += shift * (turn / times)
            break
        return states


class ObservedWalkers:
    """What walkers `full (W, P)` have of their own; each part is computed when it is asked for.

    `at`: None, or the walkers where all of this are slopes, along `full`.
    """

    def __init__(
        self, sensors: SensorParameters, full: Array, at: ObservedWalkers | None = None
    ) -> None:
        self.sensors, self.full, self.at = sensors, full, at

    @property
    def parameters(self) -> Array:
        """Parameters of the observed model."""
        return self.sensors.simulator_parameters(self.full)

    @cached_property
    def system(self) -> tuple[Array, Array, Array]:
        """`A (n, X, X)`, `B (n, X, S)` of the sampled inputs, and what is constant `(n, X)`.

        They are those of the observed model, or of its tangent.
        """
        experiment = self.sensors.experiment
        model, columns = self.sensors.observed_model, self.parameters
        if self.at is not None:
            model, columns = Tangent(model), np.concatenate([self.at.parameters, columns], axis=1)
        linear, n = model.linear(dict(zip(model.parameters, columns.T, strict=True))), len(columns)
        sampled = list(experiment.series)
        by_input = np.zeros((n, len(model.states), len(sampled)))
        for (row, name), value in linear.B.items():
            if name in sampled:
                by_input[:, model.states.index(row), sampled.index(name)] += value
        constant = constant_forcing(linear, model.states, n, experiment.constant)
        return dynamics(linear, model.states, n), by_input, constant

    @cached_property
    def start(self) -> Array:
        """The state at the start, `(W, X)`."""
        w, x = self.sensors, len(self.sensors.model.states)
        known = w.experiment.start if self.at is None else dict.fromkeys(w.experiment.start, 0.0)
        if w.sensing.steady:
            matrix, by_input, forcing = self.system
            drive, here = forcing + by_input @ w.first_inputs, matrix[:, :x, :x]
            turn = steady_state.free_turn(here, w.angles)
            if self.at is None:
                steady = steady_state.states(here, drive, w.angles, turn)
            else:
                steady = steady_state.state_slopes(
                    here, drive[:, :x], matrix[:, x:, :x], drive[:, x:], w.angles, turn
                )
            return w.shift_angles(steady, turn, self.full, known)
        out = np.empty((len(self.full), x))
        for k, name in enumerate(w.model.states):
            parameter = w.sensing.states.get(name)
            out[:, k] = (
                known.get(name, 0.0) if parameter is None else w.column(parameter, self.full)
            )
        return out

    @cached_property
    def before(self) -> Array:
        """How states change before the start `(W, X)`: not at all of a rig at rest."""
        w, start = self.sensors, self.start
        if not w.moves:
            return np.zeros_like(start)
        matrix, by_input, forcing = self.system
        every = start if self.at is None else np.concatenate([self.at.start, start], axis=1)
        moved = np.einsum("nxy,ny->nx", matrix, every) + forcing
        return np.asarray(moved + by_input @ w.first_inputs)[:, -start.shape[1] :]

    @cached_property
    def rows(self) -> Array:
        """The `SensorParameters.rows` of channels, `(W, K, X + 1)`."""
        w, named = self.sensors, self.sensors.sensing.gains
        gains = w.gains(self.full) if self.at is None else w.channel_values(named, self.full)
        return w.rows(gains, self.full)

    @property
    def numbers(self) -> Array:
        """Parameters, start and rows side by side: `(W, P' + X + K (X + 1))`."""
        with np.errstate(all="ignore"):
            rows = self.rows.reshape(len(self.full), -1)
            return np.concatenate([self.parameters, self.start, rows], axis=1)
