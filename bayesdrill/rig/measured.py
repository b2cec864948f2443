"""The exact response as sensors show it: late, scaled, shifted, from an unknown start, at any times.

`Sensing` says which numbers that takes beside the rig's parameters.  Everything is linear in the
states, so that sensors are rows of weights, and their derivatives other rows (`Dense` runs both).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from bayesdrill.record.experiment import Experiment, frozen
from bayesdrill.rig import steady
from bayesdrill.rig.dense import Dense
from bayesdrill.rig.models.linear import Model, driven, dynamics
from bayesdrill.rig.models.tangent import Tangent
from bayesdrill.rig.response import Response
from bayesdrill.rig.sensing import Sensing, wired

Array = NDArray[np.float64]

MOST_BYTES = 6e7  # of sensitivities at a time


def simulator(model: Model, experiment: Experiment, sensing: Sensing) -> Response | Measured:
    """The plain response wherever it will do."""
    plain = sensing.nothing and experiment.uniform and bool(experiment.seen.all())
    return Response(model, experiment) if plain else Measured(model, experiment, sensing)


@dataclass(frozen=True)
class Measured:
    """See `simulator.Simulator`; parameters are the model's, then those that `sensing` names."""

    model: Model
    experiment: Experiment
    sensing: Sensing

    @property
    def parameters(self) -> tuple[str, ...]:
        return (*self.model.parameters, *self.sensing.names)

    def of(self, experiment: Experiment) -> Measured:
        return Measured(self.model, experiment, self.sensing)

    def with_record(self, y: Array) -> Measured:
        """What was not measured stays so."""
        if y.shape != self.experiment.y.shape:
            raise ValueError(f"the record has shape {self.experiment.y.shape}, not {y.shape}")
        kept = frozen(np.where(self.experiment.seen, y, np.nan))
        made = self.of(dataclasses.replace(self.experiment, y=kept))
        for name in ("_dense", "_tangent", "_wired"):  # which no record has a part in
            if name in self.__dict__:
                made.__dict__[name] = self.__dict__[name]
        return made

    def with_series(self, series: Mapping[str, Array]) -> Measured:
        if set(series) != set(self.experiment.series):
            raise ValueError(f"series of {sorted(self.experiment.series)} are wanted")
        ordered = {name: series[name] for name in self.experiment.series}
        return self.of(dataclasses.replace(self.experiment, series=ordered))

    def signals(self, full: Array) -> Array:
        with np.errstate(all="ignore"):
            return self._cut(self._dense.signals(*self._settings(full)))

    def squares(self, full: Array) -> Array:
        with np.errstate(all="ignore"):
            return self._dense.squares(*self._settings(full), self._padded)

    def sensitivities(self, full: Array, along: Array) -> Array:
        n, q, _ = along.shape
        points = np.repeat(full, q, axis=0)
        with np.errstate(all="ignore"):
            found = self._slopes(points, along.reshape(n * q, -1))
        return found.reshape(n, q, *self.experiment.y.shape)

    def course(self, full: Array, along: Array) -> tuple[Array, Array]:
        return self.signals(full), self.sensitivities(full, along)

    def normal(self, full: Array, along: Array, scales: Array) -> tuple[Array, Array, Array]:
        n, q, _ = along.shape
        seen = self.experiment.seen
        left = np.where(seen, self.experiment.y - self.signals(full), 0.0) * scales[:, None, :]
        slopes, products = np.empty((n, q)), np.empty((n, q, q))
        chunk = max(1, int(MOST_BYTES / (8 * q * max(seen.size, 1))))
        for rows in (slice(k, k + chunk) for k in range(0, n, chunk)):
            found = self.sensitivities(full[rows], along[rows])
            shown = np.where(seen, found, 0.0) * scales[rows, None, None, :]
            flat = shown.reshape(*shown.shape[:2], -1)
            products[rows] = flat @ flat.swapaxes(1, 2)
            slopes[rows] = (flat @ left[rows].reshape(len(flat), -1, 1))[..., 0]
        return (left**2).sum(axis=1), slopes, products

    # What `Dense` is told.

    @cached_property
    def _wired(self) -> Model:
        return wired(self.model, self.sensing)

    @property
    def _lead(self) -> bool:
        """Whether the start is before the first sample, and is a knot of its own."""
        return bool(self.experiment.t_start < self.experiment.t[0])

    @cached_property
    def _knots(self) -> tuple[Array, dict[str, Array]]:
        one = self.experiment
        if not self._lead:
            return np.asarray(one.t), dict(one.series)
        series = {name: np.append(u[:1], u) for name, u in one.series.items()}
        return np.append(one.t_start, one.t), series

    @cached_property
    def _padded(self) -> Array:
        y = self.experiment.y
        return np.vstack([np.full((1, y.shape[1]), np.nan), y]) if self._lead else np.asarray(y)

    def _cut(self, signals: Array) -> Array:
        return signals[:, 1:] if self._lead else signals

    @cached_property
    def _dense(self) -> Dense:
        return self._made(self._wired)

    @cached_property
    def _tangent(self) -> Dense:
        return self._made(Tangent(self._wired))

    def _made(self, model: Model) -> Dense:
        t, series = self._knots
        return Dense(model, t, series, self.experiment.constant, self.experiment.first_order)

    def _settings(self, full: Array) -> tuple[Array, Array, Array, Array | None, Array]:
        told = self._told(full)
        matrix, by_input, forcing = _numbers(self._wired, self.experiment, told)
        start = self._begin(matrix, by_input, forcing, full)
        before = self._before(matrix, by_input, forcing, start)
        rows = np.zeros(
            (len(full), len(self.experiment.channels), len(self._inputs) + start.shape[1] + 1)
        )
        rows[:, :, : start.shape[1]] = self._gains(full)[:, :, None] * self._weights
        rows[:, :, start.shape[1]] = self._of_channels(self.sensing.offsets, full)
        return told, start, before, self._shift(full), rows

    def _slopes(self, full: Array, along: Array) -> Array:
        """d signal along `along (n, P)` at `full (n, P)`: `(n, T, K)`."""
        told, start, before, shift, rows = self._settings(full)
        both = np.concatenate([told, self._told(along)], axis=1)
        tangent, x = Tangent(self._wired), start.shape[1]
        matrix, by_input, forcing = _numbers(tangent, self.experiment, both)
        start_slope = self._begin_slope(matrix, by_input, forcing, along)
        slopes = np.zeros((*rows.shape[:2], rows.shape[2] + x))
        gains, later = self._gains(full)[:, :, None], self._later(along)[:, :, None]
        slopes[:, :, :x] = self._of_channels(self.sensing.gains, along)[:, :, None] * self._weights
        slopes[:, :, x : 2 * x] = gains * self._weights
        slopes[:, :, 2 * x] = self._of_channels(self.sensing.offsets, along)
        ahead = later * gains * self._weights  # d signal / d lag = - gain c . x'
        slopes[:, :, :x] -= np.einsum("nkx,nxy->nky", ahead, matrix[:, :x, :x])
        slopes[:, :, 2 * x] -= np.einsum("nkx,nx->nk", ahead, forcing[:, :x])
        slopes[:, :, 2 * x + 1 :] -= np.einsum("nkx,nxs->nks", ahead, by_input[:, :x])
        begin = np.concatenate([start, start_slope], axis=1)
        earlier = np.concatenate(
            [before, self._before_slope(matrix, by_input, forcing, begin)], axis=1
        )
        found = self._cut(self._tangent.signals(both, begin, earlier, shift, slopes))
        if shift is not None:
            self._mend_before(found, shift, ahead, begin, earlier, (matrix, by_input, forcing))
        return found

    def _mend_before(
        self,
        found: Array,
        shift: Array,
        ahead: Array,
        begin: Array,
        earlier: Array,
        numbers: tuple[Array, Array, Array],
    ) -> None:
        """Before the start the states go on straight, and not as the rig moves."""
        x = self._weights.shape[1]
        when = self.experiment.t[None, :, None] - shift[:, None, :] - self.experiment.t_start
        if not (early := when < 0).any():
            return
        matrix, by_input, forcing = (part[:, :x] for part in numbers)
        n, t, k = np.nonzero(early)
        here = begin[n, :x] + when[early][:, None] * earlier[n, :x]
        moved = np.einsum("axy,ay->ax", matrix[n][:, :, :x], here) + forcing[n]
        moved += np.einsum("axs,s->ax", by_input[n], self._first_inputs)
        found[n, t, k] += np.einsum("ax,ax->a", ahead[n, k], moved - earlier[n, :x])

    # Sensors and start, by walker.

    @property
    def _inputs(self) -> tuple[str, ...]:
        return tuple(self.experiment.series)

    @cached_property
    def _first_inputs(self) -> Array:
        return np.array([u[0] for u in self.experiment.series.values()], dtype=np.float64)

    @cached_property
    def _weights(self) -> Array:
        """`(K, X)`."""
        return self.experiment.weights(self.model.states)

    def _told(self, full: Array) -> Array:
        """The parameters of the wired rig, of all."""
        return full[:, [self.parameters.index(name) for name in self._wired.parameters]]

    def _column(self, name: str, full: Array) -> Array:
        return full[:, self.parameters.index(name)]

    def _of_channels(self, named: Mapping[str, str], full: Array) -> Array:
        """`(W, K)`, zero where there is none."""
        out = np.zeros((len(full), len(self.experiment.channels)))
        for k, channel in enumerate(self.experiment.channels):
            if channel.name in named:
                out[:, k] = self._column(named[channel.name], full)
        return out

    def _gains(self, full: Array) -> Array:
        out = self._of_channels(self.sensing.gains, full)
        alone = [c.name not in self.sensing.gains for c in self.experiment.channels]
        return np.asarray(out + np.array(alone, dtype=np.float64))

    def _later(self, full: Array) -> Array:
        """How much later each channel shows what the inputs do: `(W, K)`."""
        out = self._of_channels(self.sensing.lags, full)
        if self.sensing.delay is not None:
            out += self._column(self.sensing.delay, full)[:, None]
        return out

    def _shift(self, full: Array) -> Array | None:
        return self._later(full) if self.sensing.shifts else None

    @cached_property
    def _angles(self) -> list[int]:
        return steady.angles_of(self.model)

    def _begin(self, matrix: Array, by_input: Array, forcing: Array, full: Array) -> Array:
        """The state at the start, `(W, X)`."""
        names = self.model.states
        out = np.empty((len(full), len(names)))
        if self.sensing.steady:
            out[:] = steady.states(matrix, forcing + by_input @ self._first_inputs, self._angles)
            return self._turned(out, full, held=self.experiment.start)
        for k, name in enumerate(names):
            own = self.sensing.states.get(name)
            out[:, k] = (
                self.experiment.start.get(name, 0.0) if own is None else self._column(own, full)
            )
        return out

    def _begin_slope(self, matrix: Array, by_input: Array, forcing: Array, along: Array) -> Array:
        """Of what the tangent's numbers are `(n, 2 X, ...)`."""
        x = len(self.model.states)
        out = np.zeros((len(along), x))
        if self.sensing.steady:
            drive = forcing + by_input @ self._first_inputs
            out[:] = steady.state_slopes(
                matrix[:, :x, :x], drive[:, :x], matrix[:, x:, :x], drive[:, x:], self._angles
            )
            return self._turned(out, along, held=dict.fromkeys(self.experiment.start, 0.0))
        for k, name in enumerate(self.model.states):
            if name in self.sensing.states:
                out[:, k] = self._column(self.sensing.states[name], along)
        return out

    def _turned(self, states: Array, full: Array, held: Mapping[str, float]) -> Array:
        """Steady states with all angles shifted so that one of them is what it is said to be."""
        for k in self._angles:
            name = self.model.states[k]
            own = self.sensing.states.get(name)
            if own is None and name not in held:
                continue
            at = held[name] if own is None else self._column(own, full)
            states[:, self._angles] += (at - states[:, k])[:, None]
            break
        return states

    def _before(self, matrix: Array, by_input: Array, forcing: Array, start: Array) -> Array:
        """How states change before the start: not at all of a rig at rest."""
        if not self.sensing.moves(self.experiment.start):
            return np.zeros_like(start)
        moved = np.einsum("nxy,ny->nx", matrix, start) + forcing
        return np.asarray(moved + by_input @ self._first_inputs)

    def _before_slope(self, matrix: Array, by_input: Array, forcing: Array, begin: Array) -> Array:
        x = len(self.model.states)
        return self._before(matrix, by_input, forcing, begin)[:, x:]


def _numbers(model: Model, experiment: Experiment, told: Array) -> tuple[Array, Array, Array]:
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
