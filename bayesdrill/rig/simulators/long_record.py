"""Compute the inputs of a long record and the response of a rig to them, part by part.

A response in extended precision (80 bits if the platform has them) is the reference for responses at
other parameters. In double precision, the same code replaces a kernel that would need too much memory.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesdrill.basics.arrays import PART, Array
from bayesdrill.record.experiment import Experiment
from bayesdrill.rig.kernels.exponential import Layout, present
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.simulators.sensors import ObservedWalkers, SensorParameters
from bayesdrill.rig.simulators.time_grid import Whole

Long = np.longdouble
LongArray = NDArray[Any]  # extended or double precision
SERIES, HALVINGS = 22, 12  # terms of the exponential's series, and smallest number of halvings
STRETCHES = 1024  # number of segments of a part that are stepped simultaneously


@dataclass(frozen=True, slots=True)
class LongRecord:
    """A long record has evenly spaced knots, and a rig with `sensors`.

    `n_knots` knots are `step` [s] apart. `sample_knots (n,)` are samples; None if all are.
    """

    sensors: SensorParameters
    step: float
    n_knots: int
    sample_knots: Whole | None = None

    @property
    def layout(self) -> Layout:
        """Return the layout of the rig's matrix."""
        return input_layout(self.sensors.observed_model, self.sensors.experiment)

    @property
    def first_inputs(self) -> Array:
        """Return the first value `(S,)` of each linearly interpolated series, zero for held ones."""
        return self.sensors.first_inputs * self.sensors.experiment.first_order

    def inputs(self, first: int, last: int) -> Array:
        """Return the sampled inputs at knots `first` to `last`, `(last - first, S)`."""
        knots = np.minimum(np.arange(first, last), self.n_knots - 1)
        columns = []
        for u in self.sensors.knots[1].values():
            if self.sample_knots is None:
                columns.append(u[knots])
            elif self.sensors.experiment.first_order:
                columns.append(np.interp(knots, self.sample_knots, u))
            else:
                columns.append(u[np.searchsorted(self.sample_knots, knots, side="right") - 1])
        return np.array(columns).reshape(len(columns), len(knots)).T

    def responses(self, full: Array, kind: type = Long) -> Iterator[tuple[Array, LongArray]]:
        """Yield inputs `(m, S)` and channels `(m, K)` at parameters `full (P,)`, part by part."""
        layout, experiment = self.layout, self.sensors.experiment
        x, p, series = layout.n_states, layout.n_parameters, layout.n_series
        numbers = ObservedWalkers(self.sensors, full[None]).numbers[0]
        matrix = np.zeros((layout.size, layout.size), dtype=Long)
        constants = present(experiment.constant).values()
        long = [Long(number) for number in (*numbers[:p], *constants)]
        for row, column, value in layout.entries(long):
            matrix[row, column] += value if row >= x else value * Long(self.step)
        step: LongArray = long_exponential(matrix).astype(kind)
        # Columns for constant forcing and inputs, then for increments of interpolated inputs.
        fall, columns = step[:x, :x], step[:x, x:].T
        rows = numbers[p + x :].reshape(-1, x + 1).astype(kind)
        state = numbers[p : p + x].astype(kind)
        for first in range(0, self.n_knots, PART):
            inputs = self.inputs(first, min(first + PART, self.n_knots) + 1)
            u: LongArray = inputs.astype(kind)
            drive = columns[0] + u[:-1] @ columns[1 : 1 + series]
            if layout.first_order:
                drive = drive + np.diff(u, axis=0) @ columns[1 + series :]
            states = long_states(fall, drive, state)
            state = states[-1]
            yield inputs[:-1], states[:-1] @ rows[:, :x].T + rows[:, x]

    @property
    def alike(self) -> list[slice]:
        """Return slices of channels observed at the same times: all channels, or each by itself."""
        seen = ~np.isnan(self._at_knots())
        k_count = seen.shape[1]
        size = k_count if (seen == seen[:, :1]).all() else 1
        return [slice(k, k + size) for k in range(0, k_count, size)]

    def residuals(self, full: Array) -> Iterator[tuple[Array, Array]]:
        """Yield inputs `(m, S)` and residuals `(m, K)`, part by part; NaN where nothing was observed."""
        y, first = self._at_knots(), 0
        for inputs, shown in self.responses(full):
            last = first + len(inputs)
            yield inputs, np.asarray(y[first:last] - shown, dtype=np.float64)
            first = last

    def _at_knots(self) -> Array:
        """Return the record at all knots `(T, K)`."""
        y = self.sensors.padded
        if self.sample_knots is not None:
            y = np.full((self.n_knots, y.shape[1]), np.nan)
            y[self.sample_knots] = self.sensors.padded
        return y

    def signals(self, full: Array) -> Array:
        """Return the channels `(T, K)` at the knots."""
        parts = [shown for _, shown in self.responses(full, np.float64)]
        return np.concatenate(parts)


def input_layout(model: Model, experiment: Experiment) -> Layout:
    """Return the layout of a rig under the inputs of an experiment."""
    series, constant = tuple(experiment.series), tuple(present(experiment.constant))
    return Layout.from_model(model, series, constant, first_order=experiment.first_order)


def record_blocks(experiment: Experiment) -> dict[str, Array]:
    """Return record and inputs `(T, S)` at even times; `(T, 2 S)` with time slopes if interpolated."""
    series = [*experiment.series.values()]
    if experiment.first_order:
        series += [np.append(np.diff(u), 0.0) / experiment.dt for u in series]
    u = np.array(series, dtype=np.float64).reshape(len(series), len(experiment.t)).T
    return {"y": np.ascontiguousarray(experiment.y), "u": np.ascontiguousarray(u)}


def long_exponential(matrix: LongArray) -> LongArray:
    """Return exp(M) - 1 by scaling and squaring, in the precision of M."""
    _, size = np.frexp(np.abs(matrix).sum(axis=1).max(initial=0.0))
    halvings = max(HALVINGS, int(size))  # a stiff rig needs more
    scaled = np.ldexp(matrix, -halvings)
    total, term = scaled.copy(), scaled.copy()
    for k in range(2, SERIES):
        term = term @ scaled / Long(k)
        total = total + term
    for _ in range(halvings):
        total = 2 * total + total @ total
    return total


def long_states(fall: LongArray, drive: LongArray, start: LongArray) -> LongArray:
    """Return states `(T + 1, X)` of x(t + 1) = x(t) + fall x(t) + drive(t), in the given precision.

    `fall` is `(X, X)`, `drive` `(T, X)` and `start` `(X,)`. Segments of the record are stepped
    simultaneously: first from rest, to find the state at the beginning of each segment, and then
    from this state.
    """
    t_count, x = drive.shape
    length = -(-t_count // STRETCHES)
    n = -(-t_count // length)
    padded = np.zeros((n * length, x), dtype=fall.dtype)
    padded[:t_count] = drive
    padded = padded.reshape(n, length, x).swapaxes(0, 1)
    state, power = np.zeros((n, x), fall.dtype), np.zeros((x, x), fall.dtype)
    for driven in padded:
        state = state + (state @ fall.T + driven)
        power = power + fall + fall @ power  # (1 + fall)^j - 1
    out = np.empty((length + 1, n, x), dtype=fall.dtype)
    out[0, 0] = start
    for k in range(1, n):
        out[0, k] = out[0, k - 1] + power @ out[0, k - 1] + state[k - 1]
    for j, driven in enumerate(padded):
        out[j + 1] = out[j] + (out[j] @ fall.T + driven)
    states = out[:-1].swapaxes(0, 1).reshape(-1, x)
    return np.concatenate([states, out[-1, -1:]])[: t_count + 1]
