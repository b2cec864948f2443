"""Define the observation model: gains, offsets and delays of sensors, and the start.

    y_k(t) = gain_k c_k . x(t - lag_k - delay) + offset_k        x' = A x + B (gain_u u + offset_u) + c

The delay applies to all inputs and their offsets: before it has passed, channels show the start.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.basics.duals import Dual, dual, linear_map
from bayesdrill.record.experiment import Experiment
from bayesdrill.rig import steady_state
from bayesdrill.rig.models.friction import Named
from bayesdrill.rig.models.linear import Linear, Model, WrappedModel, constant_forcing, dynamics
from bayesdrill.rig.models.servo import Saturation
from bayesdrill.rig.simulators.time_grid import Grid, build_grid


def signal_names(model: Model) -> tuple[str, ...]:
    """Return the signals that a sensor may measure: states, and combinations of states."""
    combined = [n for n, of in model.combinations.items() if {*of} <= {*model.outer}]
    return (*model.outer, *combined)


def state_weights(model: Model, combines: Mapping[str, float]) -> dict[str, float]:
    """Convert weights of signals, see `signal_names`, to weights of states."""
    weights: dict[str, float] = {}
    for name, factor in combines.items():
        for state, weight in model.combinations.get(name, {name: 1.0}).items():
            weights[state] = weights.get(state, 0.0) + factor * weight
    return weights


@dataclass(frozen=True, slots=True, kw_only=True)
class ObservationModel:
    """An observation model names the parameters of sensors and start, by channel, input or state.

    `input_lags` are the lags of single inputs: the rig receives such an input later than recorded.
    `delay` is common to all inputs, and also the time at which constant inputs are switched on.
    `states` are the unknown start values. If the start is `steady`, all other start values are those
    of the steady state under the first inputs.
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
        """Return all names of parameters, each once."""
        every = [name for _, named in self._kinds for name in named.values()]
        every += [] if self.delay is None else [self.delay]
        return tuple(dict.fromkeys([*every, *self.states.values()]))

    @property
    def shifts(self) -> bool:
        """Return whether channels may be delayed relative to the inputs."""
        return bool(self.lags) or self.delay is not None

    def may_move(self, start: Mapping[str, float], angles: Collection[str]) -> bool:
        """Return whether a rig with this `start` may turn, or carry a current, before the record.

        `angles` are the names of its states that are angles, or positions.
        """
        rates = [x for name, x in start.items() if name not in angles]
        return self.steady or bool(self.states) or any(rates)

    @property
    def summary(self) -> str:
        """Return the parameters of sensors as text, such as `twist: gain, lag; inputs: delay`."""
        kinds_of: dict[str, list[str]] = {}
        for kind, named in self._kinds:
            for name in named:
                kinds_of.setdefault(name, []).append(kind)
        if self.delay is not None:
            kinds_of["inputs"] = ["delay"]
        return "; ".join(f"{name}: {', '.join(has)}" for name, has in kinds_of.items())

    @property
    def start_summary(self) -> str:
        """Return as text whether the start is steady, and which of its states are unknown."""
        unknown = f"{', '.join(self.states)} unknown" if self.states else ""
        return ", ".join(filter(None, ["steady" if self.steady else "", unknown]))

    @property
    def empty(self) -> bool:
        """Return whether sensors are perfect and the start is known."""
        return not self.names and not self.steady


@dataclass(frozen=True, slots=True)
class ObservedModel(WrappedModel):
    """The observed model is a `rig` whose input sensors have gains and offsets as parameters."""

    input_gains: tuple[tuple[str, str], ...]
    input_offsets: tuple[tuple[str, str], ...]

    @property
    def parameters(self) -> tuple[str, ...]:
        """Return the rig's parameters, then those of its input sensors."""
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

    def acting(self, p: Named, inputs: Mapping[str, Any]) -> Mapping[str, Any]:
        """See `Model.acting`."""
        acting = dict(inputs)
        for name, gain in self.input_gains:
            acting[name] = acting[name] * p[gain]
        for name, offset in self.input_offsets:
            acting[name] = acting[name] + p[offset]
        return acting

    @property
    def saturation(self) -> Saturation | None:
        """See `Model.saturation`."""
        servo, gains = self.rig.saturation, dict(self.input_gains)
        return servo and replace(servo, goal_gain=gains.get(servo.goal, ""))


def observed_model(rig: Model, sensing: ObservationModel) -> Model:
    """Return the rig with its input sensors; the rig itself if these sensors have no unknowns."""
    if not sensing.input_gains and not sensing.input_offsets:
        return rig
    gains, offsets = sensing.input_gains.items(), sensing.input_offsets.items()
    return ObservedModel(rig, tuple(gains), tuple(offsets))


@dataclass(frozen=True)
class SensorParameters:
    """A walker's row of `full (W, P)` has the model's parameters, then those that `sensing` names.

    `full` may be a `Dual`; results then have derivatives too.
    """

    model: Model
    experiment: Experiment
    sensing: ObservationModel

    def acting_input(self, name: str, full: Array) -> Array:
        """Return an input with its sensor's gain and offset, without a lag, at `full (1, P)`."""
        p = dict(zip(self.parameters, full[0].tolist(), strict=True))
        recorded = {name: 0.0, **self.experiment.constant, **self.experiment.series}
        return np.asarray(self.observed_model.acting(p, recorded)[name])

    @cached_property
    def parameters(self) -> tuple[str, ...]:
        """Return the names of the columns."""
        return (*self.model.parameters, *self.sensing.names)

    @cached_property
    def observed_model(self) -> Model:
        """Return the model with its input sensors."""
        return observed_model(self.model, self.sensing)

    def simulator_parameters(self, full: Any) -> Any:
        """Select the columns of `full` that are parameters of `observed_model`."""
        places = self._columns
        return full if places is None else linear_map(lambda part: part[:, places], full)

    @cached_property
    def _columns(self) -> list[int] | None:
        """Return the indices of `simulator_parameters` in `full`; None if these are all columns."""
        places = [self.parameters.index(name) for name in self.observed_model.parameters]
        return None if places == [*range(len(self.parameters))] else places

    def column(self, name: str, full: Any) -> Any:
        """Return the column `(W,)` of a parameter."""
        place = self.parameters.index(name)
        return linear_map(lambda part: part[:, place], full)

    def placed(self, places: Mapping[int, str], count: int, full: Any) -> Any:
        """Return `(W, count)`: named columns of `full` at the indices in `places`, zeros elsewhere."""
        columns = [self.parameters.index(name) for name in places.values()]

        def spread(part: Array) -> Array:
            out = np.zeros((len(part), count))
            out[:, [*places]] = part[:, columns]
            return out

        return linear_map(spread, full)

    # Times and inputs of the record.

    @property
    def lead(self) -> bool:
        """Return whether the start is before the first sample, so that it is a knot of its own."""
        return self.experiment.lead > 0.0

    @cached_property
    def knots(self) -> tuple[Array, dict[str, Array]]:
        """Return the times of start and samples, and the sampled inputs at these times.

        Nearly equal steps become equal. Inputs at an earlier start are those at the first sample.
        """
        experiment = self.experiment
        t = np.asarray(experiment.t)
        if experiment.uniform and len(t) > 1:
            t = t[0] + experiment.dt * np.arange(len(t))
        if not self.lead:
            return t, dict(experiment.series)
        series = {name: np.append(u[:1], u) for name, u in experiment.series.items()}
        return np.append(experiment.t_start, t), series

    @cached_property
    def grid(self) -> Grid:
        """Return the grid of the times in `knots`."""
        return build_grid(self.knots[0])

    @cached_property
    def padded(self) -> Array:
        """Return the record; a row of NaN comes first if the start is before the first sample."""
        y = self.experiment.y
        return np.vstack([np.full((1, y.shape[1]), np.nan), y]) if self.lead else np.asarray(y)

    def drop_start(self, signals: Array) -> Array:
        """Return `signals (W, T, ...)` at samples only, without the row of an earlier start."""
        return signals[:, 1:] if self.lead else signals

    @cached_property
    def inputs(self) -> tuple[str, ...]:
        """Return the names of the sampled inputs."""
        return tuple(self.experiment.series)

    @cached_property
    def may_move(self) -> bool:
        """Return whether the rig may turn, or carry a current, before the first sample."""
        return self.sensing.may_move(self.experiment.start, self.model.angles)

    @cached_property
    def first_inputs(self) -> Array:
        """Return the sampled inputs at the first sample, `(S,)`."""
        return np.array([u[0] for u in self.experiment.series.values()], dtype=np.float64)

    @cached_property
    def weights(self) -> Array:
        """Return the weights of states in channels, `(K, X)`."""
        return self.experiment.weights(self.model.states)

    # Sensors.

    def channel_values(self, named: Mapping[str, str], full: Any) -> Any:
        """Return a parameter, such as the lag, of each channel `(W, K)`; zero if a channel lacks it."""
        names = [channel.name for channel in self.experiment.channels]
        places = {k: named[name] for k, name in enumerate(names) if name in named}
        return self.placed(places, len(names), full)

    def gains(self, full: Any) -> Any:
        """Return the gains of channels `(W, K)`, which are 1 unless a gain is unknown."""
        known = self.sensing.gains
        one = np.array([c.name not in known for c in self.experiment.channels], dtype=np.float64)
        return self.channel_values(known, full) + one

    def rows(self, full: Any) -> Any:
        """Return the rows of channels `(W, K, X + 1)`: gains times weights of states, then offsets."""
        gains, offsets = self.gains(full), self.channel_values(self.sensing.offsets, full)

        def row(gain: Array, offset: Array) -> Array:
            return np.concatenate([gain[:, :, None] * self.weights, offset[:, :, None]], axis=2)

        return linear_map(row, gains, offsets)

    def channel_delays(self, full: Any) -> Any:
        """Return the delay of each channel behind the inputs [s], `(W, K)`."""
        out = self.channel_values(self.sensing.lags, full)
        if self.sensing.delay is None:
            return out
        return out + linear_map(lambda d: d[:, None], self.column(self.sensing.delay, full))

    def input_values(self, named: Mapping[str, str], full: Any) -> Any:
        """Return a parameter, such as the lag, of those S inputs that have it, `(W, S)`."""
        places = dict(enumerate(named[name] for name in self.inputs if name in named))
        return self.placed(places, len(places), full)

    # The start.

    @cached_property
    def angles(self) -> list[int]:
        """Return the indices of angles among the states."""
        return steady_state.angle_indices(self.model)

    def shift_angles(self, states: Any, free: Array | None, full: Any) -> Any:
        """Turn the whole rig, in steady `states`, until the first given start angle has its value.

        `free` is the rig's `steady_state.free_turn`.
        """
        turn = np.ones(len(self.angles)) if free is None else free
        for k, times in zip(self.angles, turn, strict=True):
            name, known = self.model.states[k], self.experiment.start
            parameter = self.sensing.states.get(name)
            if parameter is None and name not in known:
                continue
            at = known[name] if parameter is None else self.column(parameter, full)
            shift = at - linear_map(lambda part, column=k: part[:, column], states)
            along = np.zeros((1, len(self.model.states)))
            along[:, self.angles] = turn / times
            return states + linear_map(lambda part, by=along: part[:, None] * by, shift)
        return states


class ObservedWalkers:
    """The class computes the start and the sensor rows of walkers `full (W, P)` when needed.

    `full` may be a `Dual`; all results then have derivatives too.
    """

    def __init__(self, sensors: SensorParameters, full: Array | Dual) -> None:
        self.sensors, self.full = sensors, full

    @property
    def parameters(self) -> Any:
        """Return the parameters of the observed model."""
        return self.sensors.simulator_parameters(self.full)

    @cached_property
    def system(self) -> tuple[Any, Any, Any]:
        """Return `A (n, X, X)`, `B (n, X, S)` of sampled inputs, and constant forcing `(n, X)`."""
        experiment, model = self.sensors.experiment, self.sensors.observed_model
        n, sampled, states = len(dual(self.full).value), list(experiment.series), model.states
        columns = linear_map(lambda part: part.T, self.parameters)
        named = {
            name: linear_map(lambda part, row=k: part[row], columns)
            for k, name in enumerate(model.parameters)
        }
        linear = model.linear(named)

        def arrays(part: Linear) -> tuple[Array, Array, Array]:
            by_input = np.zeros((n, len(states), len(sampled)))
            for (row, name), value in part.B.items():
                if name in sampled:
                    by_input[:, states.index(row), sampled.index(name)] += value
            constant = constant_forcing(part, states, n, experiment.constant)
            return dynamics(part, states, n), by_input, constant

        if not isinstance(self.full, Dual):
            return arrays(linear)
        values, slopes = arrays(_mapped(linear, _value)), arrays(_mapped(linear, _slope))
        matrix, by_input, constant = map(Dual, values, slopes)
        return matrix, by_input, constant

    @cached_property
    def _drive(self) -> Any:
        """Return the forcing of the states under the first inputs, `(n, X)`."""
        _, by_input, constant = self.system
        first = self.sensors.first_inputs
        return linear_map(lambda part, still: still + part @ first, by_input, constant)

    @cached_property
    def start(self) -> Any:
        """Return the state at the start, `(W, X)`."""
        w, states = self.sensors, self.sensors.model.states
        if w.sensing.steady:
            matrix = self.system[0]
            turn = steady_state.free_turn(dual(matrix).value, w.angles)
            steady = steady_state.states(matrix, self._drive, w.angles, turn)
            return w.shift_angles(steady, turn, self.full)
        names, held = w.sensing.states, w.experiment.start
        unknown = {k: names[name] for k, name in enumerate(states) if name in names}
        known = [0.0 if name in names else held.get(name, 0.0) for name in states]
        return w.placed(unknown, len(states), self.full) + np.array(known)

    @cached_property
    def before(self) -> Any:
        """Return the rates of states `(W, X)`, with which they change linearly before the start."""
        if not self.sensors.may_move:
            return linear_map(np.zeros_like, self.start)
        moved = self.system[0] * linear_map(lambda part: part[:, None, :], self.start)
        return linear_map(lambda part: part.sum(axis=2), moved) + self._drive

    @cached_property
    def rows(self) -> Any:
        """Return the `SensorParameters.rows` of channels, `(W, K, X + 1)`."""
        return self.sensors.rows(self.full)

    @property
    def numbers(self) -> Any:
        """Return parameters, start and rows side by side, `(W, P' + X + K (X + 1))`."""
        with np.errstate(all="ignore"):
            return join_flat(self.parameters, self.start, self.rows)


def _mapped(linear: Linear, part: Callable[[Any], Any]) -> Linear:
    """Apply `part`, which takes the value or the derivative of an entry, to all entries of a system."""
    return Linear(
        A={place: part(entry) for place, entry in linear.A.items()},
        B={place: part(entry) for place, entry in linear.B.items()},
        c={place: part(entry) for place, entry in linear.c.items()},
    )


def _value(entry: Any) -> Any:
    return dual(entry).value


def _slope(entry: Any) -> Any:
    return dual(entry).slope


def join_flat(*parts: Any) -> Any:
    """Flatten arrays `(W, ...)` and join them to one `(W, n)`, with any derivatives."""

    def joined(*arrays: Array) -> Array:
        return np.concatenate([array.reshape(len(array), -1) for array in arrays], axis=1)

    return linear_map(joined, *parts)
