"""The exact response of a linear model to constant and sampled inputs, to rounding.

One matrix exponential per parameter vector, then a recurrence over the samples.  A sampled input
is held between samples (zero order) or interpolated linearly (first order); for either the
discrete system is exact (Van Loan 1978).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from bayesdrill.record.experiment import Experiment, frozen
from bayesdrill.rig.kernels.compiling import Kernel, Layout, compile_kernel
from bayesdrill.rig.kernels.lanes import LANES
from bayesdrill.rig.kernels.recurrence import scratch_size, write_response
from bayesdrill.rig.kernels.sums import TALLIES
from bayesdrill.rig.models.linear import DOT, Model, Tangent
from bayesdrill.rig.simulators.contract import in_groups, interval_sums, log_sums
from bayesdrill.rig.simulators.sensors import Sensing
from bayesdrill.rig.simulators.stepped import Unstepped

Array = NDArray[np.float64]


class Response(Unstepped):
    """Response of `model` in `experiment`; kernels are compiled when they are first asked for.

    Parameters come as `(W, P)`, columns in the order of `model.parameters`, SI.  A walker whose
    numbers overflow gets NaN in its own row alone.
    """

    def __init__(self, model: Model, experiment: Experiment, kernels: Kernel | None = None) -> None:
        self.model = model
        self.experiment = experiment
        series = list(experiment.series.values())
        self._y = np.ascontiguousarray(experiment.y)
        # The last increment drives nothing that is measured any more.
        self._u = np.zeros((len(self._y) + 1, len(series)))
        for column, u in enumerate(series):
            self._u[:, column] = np.append(u, u[-1])
        # Asking an array for its address takes as long as some samples of a group.
        self._places = (self._y.ctypes.data, self._u.ctypes.data)
        # Made when they are first asked for, the tangent's in any case.
        self._made = kernels
        self._tallies: dict[str, Kernel] = {}
        self._normal: list[tuple[Layout, Kernel]] = []
        self._slopes: list[Response] = []
        self._course: list[Response] = []

    def __getstate__(self) -> dict[str, Any]:
        return {"model": self.model, "experiment": self.experiment}

    def __setstate__(self, state: Mapping[str, Any]) -> None:
        self.__init__(state["model"], state["experiment"])  # type: ignore[misc]

    sensing: ClassVar = Sensing()  # perfect sensors, and a start that is known
    exact: ClassVar[bool] = True

    @property
    def parameters(self) -> tuple[str, ...]:
        return self.model.parameters

    @property
    def record(self) -> tuple[int, int]:
        return self._places

    @property
    def _kernels(self) -> Kernel:
        if self._made is None:
            own = layout(self.model, self.experiment)
            self._made = compile_kernel(write_response, own, "misfit", "signals")
        return self._made

    def of(self, experiment: Experiment) -> Response:
        """Of the same rig in another experiment."""
        return Response(self.model, experiment)

    def with_record(self, y: Array) -> Response:
        """The same experiment with another record `y (T, K)`; nothing is compiled again."""
        if y.shape != self.experiment.y.shape:
            raise ValueError(f"the record has shape {self.experiment.y.shape}, not {y.shape}")
        experiment = dataclasses.replace(self.experiment, y=frozen(y))
        made = Response(self.model, experiment, self._kernels)
        made._normal, made._slopes = self._normal, self._slopes  # which no record has a part in
        made._tallies = self._tallies
        made._course = self._course
        return made

    def with_series(self, series: Mapping[str, Array]) -> Response:
        """The same experiment under other measured inputs; nothing is compiled again."""
        if set(series) != set(self.experiment.series):
            raise ValueError(f"series of {sorted(self.experiment.series)} are wanted")
        ordered = {name: series[name] for name in self.experiment.series}
        experiment = dataclasses.replace(self.experiment, series=ordered)
        made = Response(self.model, experiment, self._made)
        made._tallies = self._tallies
        made._course = [one.with_series(series) for one in self._course]
        return made

    def squares(self, theta: Array) -> Array:
        """Sum of squared residuals of each channel: `(W, P) -> (W, K)`, SI units squared."""
        return self._tallied("misfit", self._kernels, theta)[..., 0]

    def neighbours(self, theta: Array) -> Array:
        return self._tallied("neighbours", self._made_for("neighbours"), theta)

    def logs(self, theta: Array, weights: Array) -> Array:
        told = np.concatenate([theta, weights], axis=1)
        return log_sums(self._tallied("logs", self._made_for("logs"), told))

    def intervals(self, theta: Array, over: Array, half: Array) -> Array:
        own = np.stack([over, half], axis=-1).reshape(len(theta), -1)
        told = np.concatenate([theta, own], axis=1)
        return interval_sums(self._tallied("intervals", self._made_for("intervals"), told))

    def _made_for(self, name: str) -> Kernel:
        """A tally's, made when it is first asked for."""
        if name not in self._tallies:
            own = layout(self.model, self.experiment)
            self._tallies[name] = compile_kernel(write_response, own, name)
        return self._tallies[name]

    def _tallied(self, name: str, kernels: Kernel, told: Array) -> Array:
        """`(W, K, n)`."""
        blocks, k_count = in_groups(told), self._y.shape[1]
        out = np.empty((len(blocks), k_count * TALLIES[name].count, LANES))
        self._run(name, blocks, out, kernels)
        return out.transpose(0, 2, 1).reshape(-1, k_count, TALLIES[name].count)[: len(told)]

    def signals(self, theta: Array) -> Array:
        """The channels themselves: `(W, P) -> (W, T, K)`, SI."""
        blocks = in_groups(theta)
        out = np.empty((len(blocks), *self._y.shape, LANES))
        self._run("signals", blocks, out, self._kernels)
        rows = out.transpose(0, 3, 1, 2).reshape(-1, *self._y.shape)
        return np.ascontiguousarray(rows[: len(theta)])

    def normal(self, theta: Array, directions: Array, scales: Array) -> tuple[Array, Array, Array]:
        """Least squares: sums `(W, K)`, `(W, q)` and `(W, q, q)` over samples (and channels).

        Of r r, r s and s s, with r what is left of the record and s its derivatives in the
        `directions (W, q, P)` at `theta (W, P)`, both times `scales (W, K)`, q at least 1.
        """
        if not self._normal:
            own = layout(Tangent(self.model), _in_slopes(self.experiment))
            self._normal.append((own, compile_kernel(write_response, own, "normal")))
        own, kernels = self._normal[0]
        n, q, _ = directions.shape
        k_count = self._y.shape[1]
        blocks, scaled = in_groups(theta), in_groups(scales)
        along = in_groups(directions.reshape(n, -1))
        scratch = np.empty((scratch_size(own, q) + 8, LANES))
        out = np.empty((len(blocks), k_count + q + q * q, LANES))
        told = (blocks.ctypes.data, along.ctypes.data, scaled.ctypes.data)
        addresses = (*told, *self._places, scratch.ctypes.data, out.ctypes.data)
        kernels["normal"](len(blocks), len(self._y), q, *addresses)
        rows = out.transpose(0, 2, 1).reshape(-1, out.shape[1])[:n]
        squares, slopes, lower = np.split(rows, [k_count, k_count + q], axis=1)
        products = np.tril(lower.reshape(n, q, q))
        return squares, slopes, products + np.tril(products, -1).swapaxes(1, 2)

    def sensitivities(self, theta: Array, directions: Array) -> Array:
        """d channel in the `directions (W, q, P)` at `theta (W, P)`: `(W, q, T, K)`."""
        if not self._slopes:
            self._slopes.append(slopes_of(self.model, _in_slopes(self.experiment)))
        n, q, p = directions.shape
        points = np.repeat(theta, q, axis=0)
        along = np.concatenate([points, directions.reshape(n * q, p)], axis=1)
        return self._slopes[0].signals(along).reshape(n, q, *self._y.shape)

    def course(self, theta: Array, directions: Array) -> tuple[Array, Array]:
        """Signals `(W, T, K)` and sensitivities `(W, q, T, K)`, in one run."""
        if not self._course:
            slopes = _in_slopes(self.experiment).channels
            both = dataclasses.replace(
                self.experiment,
                channels=(*slopes, *self.experiment.channels),
                y=np.zeros((len(self._y), 2 * self._y.shape[1])),
            )
            self._course.append(slopes_of(self.model, both))
        n, q, p = directions.shape
        along = np.concatenate([np.repeat(theta, q, axis=0), directions.reshape(n * q, p)], axis=1)
        found = self._course[0].signals(along).reshape(n, q, len(self._y), -1)
        k = self._y.shape[1]
        return found[:, 0, :, k:], found[..., :k]

    def _run(self, name: str, blocks: Array, out: Array, kernels: Kernel) -> None:
        addresses = (blocks.ctypes.data, *self._places, out.ctypes.data)
        kernels[name](len(blocks), len(self._y), *addresses)


def slopes_of(model: Model, experiment: Experiment) -> Response:
    """The response of the tangent of `model`, whose states `experiment` names; it has no record."""
    tangent = Tangent(model)
    kernels = compile_kernel(write_response, layout(tangent, experiment), "signals")
    return Response(tangent, experiment, kernels)


def _in_slopes(experiment: Experiment) -> Experiment:
    """With the derivatives of its channels for channels."""
    channels = tuple(
        dataclasses.replace(channel, weights={name + DOT: w for name, w in channel.weights.items()})
        for channel in experiment.channels
    )
    return dataclasses.replace(experiment, channels=channels)


def layout(model: Model, experiment: Experiment) -> Layout:
    """What the kernels have to know of a rig and its experiment."""
    return Layout(
        n_parameters=len(model.parameters),
        n_states=len(model.states),
        n_series=len(experiment.series),
        first_order=experiment.first_order and bool(experiment.series),
        entries=Matrix(
            model,
            tuple(experiment.series),
            tuple(experiment.constant.items()),
            experiment.first_order,
        ),
        dt=experiment.dt,
        lead=float(experiment.t[0] - experiment.t_start),
        x0=tuple(float(experiment.start.get(name, 0.0)) for name in model.states),
        channels=tuple(
            tuple(float(channel.weights.get(name, 0.0)) for name in model.states)
            for channel in experiment.channels
        ),
    )


@dataclass(frozen=True, slots=True)
class Matrix:
    """Entries of the augmented matrix, see `Layout`, of a rig with these inputs."""

    model: Model
    series: tuple[str, ...]
    constant: tuple[tuple[str, float], ...]
    first_order: bool

    def __call__(self, parameters: Sequence[Any]) -> list[tuple[int, int, Any]]:
        """(row, column, value)."""
        linear = self.model.linear(dict(zip(self.model.parameters, parameters, strict=True)))
        constant, index = dict(self.constant), {n: k for k, n in enumerate(self.model.states)}
        x, s = len(index), len(self.series)
        entries = [(index[row], index[column], value) for (row, column), value in linear.A.items()]
        entries += [(index[row], x, value) for row, value in linear.c.items()]
        for (row, name), value in linear.B.items():
            if name in self.series:
                entries.append((index[row], x + 1 + self.series.index(name), value))
            if constant.get(name, 0.0) != 0.0:
                entries.append((index[row], x, value * constant[name]))
        if self.first_order:
            # A held input rises by its increment over one step.
            entries += [(x + 1 + k, x + 1 + s + k, 1.0) for k in range(s)]
        return entries
