"""The exact response of a linear model to constant and sampled inputs, to rounding.

One matrix exponential per parameter vector, then a recurrence over the samples.  A sampled input
is held between samples (zero order) or interpolated linearly (first order); for either the
discrete system is exact (Van Loan 1978).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesdrill.experiment import Experiment
from bayesdrill.kernels import (
    LANES,
    TAYLOR_NORM,
    Kernels,
    Layout,
    compile_kernels,
    reach_of,
)
from bayesdrill.models.linear import Linear, Model

Array = NDArray[np.float64]

MOST_HALVINGS = 60.0


class Response:
    """Response of `model` in `experiment`; kernels are compiled at construction (and unpickling).

    Parameters come as `(W, P)`, columns in the order of `model.parameters`, SI.  A lane whose
    numbers overflow gives NaN in that walker's row alone.
    """

    def __init__(self, model: Model, experiment: Experiment) -> None:
        self.model = model
        self.experiment = experiment
        self._states = {name: k for k, name in enumerate(model.states)}
        self._series = tuple(experiment.series)
        self._y = np.ascontiguousarray(experiment.y)
        last = {name: np.append(u, u[-1]) for name, u in experiment.series.items()}
        self._u = np.array([last[name] for name in self._series]).reshape(-1, len(self._y) + 1).T
        self._u = np.ascontiguousarray(self._u)
        self._x0 = np.array([experiment.start.get(name, 0.0) for name in model.states])
        self._layout = self._make_layout()
        self._kernels: Kernels = compile_kernels(self._layout)

    def __getstate__(self) -> dict[str, Any]:
        return {"model": self.model, "experiment": self.experiment}

    def __setstate__(self, state: Mapping[str, Any]) -> None:
        self.__init__(state["model"], state["experiment"])  # type: ignore[misc]

    def misfit(self, theta: Array) -> Array:
        """Sum of squared residuals of each channel: `(W, P) -> (W, K)`, SI units squared."""
        n_groups, exponential, start = self._discretise(theta)
        out = np.empty((n_groups, len(self._layout.channels), LANES))
        self._run(self._kernels.misfit, n_groups, exponential, start, out)
        return out.transpose(0, 2, 1).reshape(-1, out.shape[1])[: len(theta)]

    def signals(self, theta: Array) -> Array:
        """The channels themselves: `(W, P) -> (W, T, K)`, SI."""
        n_groups, exponential, start = self._discretise(theta)
        out = np.empty((n_groups, len(self._y), len(self._layout.channels), LANES))
        self._run(self._kernels.signals, n_groups, exponential, start, out)
        return np.ascontiguousarray(
            out.transpose(0, 3, 1, 2).reshape(-1, *out.shape[1:3])[: len(theta)]
        )

    def _run(self, kernel: Any, n_groups: int, e: Array, start: Array, out: Array) -> None:
        address = (block.ctypes.data for block in (e, start, self._y, self._u, out))
        kernel(n_groups, len(self._y), *address)

    def _discretise(self, theta: Array) -> tuple[int, Array, Array]:
        """Groups, `(G, N, N, LANES)` exponentials over one step, `(G, X, LANES)` first states."""
        linear, shape = self._dynamics(theta)
        exponential = self._exponential(linear, shape, self.experiment.dt)
        start = np.broadcast_to(self._x0[:, None], (shape[0], len(self._x0), LANES))
        lead = float(self.experiment.t[0] - self.experiment.t_start)
        if lead > 0.0:
            start = self._advance(self._exponential(linear, shape, lead), start)
        return shape[0], exponential, np.ascontiguousarray(start)

    def _dynamics(self, theta: Array) -> tuple[Linear, tuple[int, int]]:
        n_groups = -(-len(theta) // LANES)
        lanes = np.empty((theta.shape[1], n_groups * LANES))
        lanes[:, : len(theta)] = theta.T
        lanes[:, len(theta) :] = lanes[:, len(theta) - 1 : len(theta)]
        blocks = lanes.reshape(-1, n_groups, LANES)
        with np.errstate(all="ignore"):
            linear = self.model.linear(dict(zip(self.model.parameters, blocks, strict=True)))
        return linear, (n_groups, LANES)

    def _exponential(self, linear: Linear, shape: tuple[int, int], dt: float) -> Array:
        """exp of the augmented matrix over `dt`, whose columns `Layout` describes."""
        n_groups = shape[0]
        n, x = self._layout.size, self._layout.n_states
        matrix = np.zeros((n_groups, n, n, LANES))
        with np.errstate(all="ignore"):
            for row, column, value in self._entries(linear):
                matrix[:, row, column] += value
            matrix[:, :x] *= dt
            # The size of the inputs' columns does not matter: the series in A alone converges.
            norm = np.abs(matrix[:, :x, :x]).sum(axis=2).max(axis=1)
            halvings = np.ceil(np.log2(norm / TAYLOR_NORM))
        halvings = np.where(norm > TAYLOR_NORM, np.fmin(halvings, MOST_HALVINGS), 0.0)
        matrix *= np.ldexp(1.0, -halvings.astype(np.int32))[:, None, None]
        most = halvings.max(axis=1).astype(np.int64)
        result = np.empty_like(matrix)
        blocks = (matrix, halvings, most, result)
        self._kernels.exponential(n_groups, *(block.ctypes.data for block in blocks))
        return result

    def _entries(self, linear: Linear) -> list[tuple[int, int, Any]]:
        """(row, column, value) of the augmented matrix; a place may come more than once."""
        x, s = len(self._states), len(self._series)
        index = self._states
        entries = [(index[row], index[column], value) for (row, column), value in linear.A.items()]
        entries += [(index[row], x, value) for row, value in linear.c.items()]
        for (row, name), value in linear.B.items():
            if name in self._series:
                entries.append((index[row], x + 1 + self._series.index(name), value))
            elif self.experiment.constant.get(name, 0.0) != 0.0:
                entries.append((index[row], x, value * self.experiment.constant[name]))
        if self.experiment.first_order:
            # A held input rises by its increment over one step; rows below the states are not
            # multiplied by dt.
            entries += [(x + 1 + k, x + 1 + s + k, 1.0) for k in range(s)]
        return entries

    def _advance(self, exponential: Array, start: Array) -> Array:
        """The states after a lead-in with constant inputs: `(G, X, LANES)`."""
        x = self._layout.n_states
        moved = np.einsum("gijl,gjl->gil", exponential[:, :x, :x], start)
        return np.asarray(moved + exponential[:, :x, x])

    def _make_layout(self) -> Layout:
        x, s = len(self._states), len(self._series)
        first_order = self.experiment.first_order and s > 0
        size = x + 1 + s * (2 if first_order else 1)
        pattern = np.zeros((size, size), dtype=bool)
        for row, column, _ in self._entries(
            self.model.linear(dict.fromkeys(self.model.parameters, 1.0))
        ):
            pattern[row, column] = True
        weights = tuple(
            tuple(float(channel.weights.get(name, 0.0)) for name in self.model.states)
            for channel in self.experiment.channels
        )
        return Layout(x, s, first_order, weights, reach_of(pattern))
