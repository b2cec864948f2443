"""The exact response of a linear model to constant and sampled inputs, to rounding.

One matrix exponential per parameter vector, then a recurrence over the samples.  A sampled input is
constant between samples (zero-order hold) or interpolated linearly (first-order hold); for either
the discrete system is exact (Van Loan 1978).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.record.experiment import Channel, Experiment
from bayesdrill.rig.kernels.compiling import Kernel, compile_kernel
from bayesdrill.rig.kernels.exponential import Layout, present, weight_kinds
from bayesdrill.rig.kernels.lanes import LANES
from bayesdrill.rig.kernels.recurrence import NORMALS, scratch_size, write_response
from bayesdrill.rig.kernels.sums import SQUARES, ResidualSums
from bayesdrill.rig.models.linear import DOT, Model, Tangent
from bayesdrill.rig.simulators.contract import in_groups, whitening_scales
from bayesdrill.rig.simulators.long_record import LongRecord, input_layout
from bayesdrill.rig.simulators.sensors import ObservationModel
from bayesdrill.rig.simulators.stepped import Unstepped

# Numbers of a record: of more, no memory is taken for eight walkers at once.
MAX_GROUPED = 8_000_000


@dataclass(frozen=True, eq=False)
class Response(Unstepped):
    """The response of `model` in `experiment`; `together`: kernels that are compiled at once."""

    model: Model
    experiment: Experiment
    together: tuple[str, ...] = (SQUARES.name, "signals")

    # Perfect sensors, and a start that is known.
    sensing: ClassVar[ObservationModel] = ObservationModel()  # type: ignore[misc]
    exact: ClassVar[bool] = True

    @property
    def record(self) -> Mapping[str, int]:
        """See `Simulator.record`."""
        return {name: self._addresses[name] for name in ("y", "u")}

    @cached_property
    def _blocks(self) -> dict[str, Array]:
        """Constants, record, inputs."""
        start = [self.experiment.start.get(name, 0.0) for name in self.model.states]
        weights = self.experiment.weights(self.model.states)
        constants = constant_block(self.experiment, start, weights)
        return {"constants": constants, **record_blocks(self.experiment)}

    @cached_property
    def _addresses(self) -> dict[str, int]:
        """Addresses; asking an array for its own takes as long as some samples of a group."""
        return {name: block.ctypes.data for name, block in self._blocks.items()}

    @cached_property
    def _kernels(self) -> dict[str, Kernel]:
        return {}

    @cached_property
    def _layout(self) -> Layout:
        return layout(self.model, self.experiment)

    def _kernel(self, name: str) -> Kernel:
        if name not in self._kernels:
            names = self.together if name in self.together else (name,)
            kernel = compile_kernel(write_response, self._layout, *names)
            self._kernels.update(dict.fromkeys(names, kernel))
        return self._kernels[name]

    def sums(self, full: Array, tally: ResidualSums, weights: Array | None = None) -> Array:
        """See `Simulator.sums`."""
        parts = (full,) if weights is None else (full, weights)
        return self._run(tally.name, (self.experiment.y.shape[1], tally.count), *parts)

    def signals(self, theta: Array) -> Array:
        """Return the channels: `(W, P) -> (W, T, K)`, SI."""
        shape = self.experiment.y.shape
        if self.experiment.y.size > MAX_GROUPED and not self._layout.lead:
            record = LongRecord(self.sensors, self.experiment.dt, shape[0])
            return np.array([record.signals(point) for point in theta])
        return self._run("signals", shape, theta)

    def normal(self, theta: Array, directions: Array, weights: Array) -> tuple[Array, Array, Array]:
        """See `Simulator.normal`; q is at least 1."""
        tangent, (n, q, _) = self._tangent, directions.shape
        k_count, scales = self.experiment.y.shape[1], whitening_scales(weights)
        name = NORMALS[scales.shape[2] > 1]
        rows = tangent._kernel(name).run(
            name, n, (k_count + q + q * q,), samples=len(self.experiment.t), q=q,
            parameters=in_groups(theta), directions=in_groups(directions),
            scales=in_groups(scales.swapaxes(1, 2)), constants=tangent._addresses["constants"],
            scratch=np.empty((scratch_size(tangent._layout, q) + 8, LANES)), **self.record,
        )  # fmt: skip
        squares, slopes, lower = np.split(rows, [k_count, k_count + q], axis=1)
        products = np.tril(lower.reshape(n, q, q))
        return squares, slopes, products + np.tril(products, -1).swapaxes(1, 2)

    def sensitivities(self, theta: Array, directions: Array) -> Array:
        """Return d channel in the `directions (W, q, P)` at `theta (W, P)`: `(W, q, T, K)`."""
        return self._tangent.along(theta, directions)

    def course(self, theta: Array, directions: Array) -> tuple[Array, Array]:
        """Return signals `(W, T, K)` and sensitivities `(W, q, T, K)`, in one run."""
        signals, k = self._both.along(theta, directions), self.experiment.y.shape[1]
        return signals[:, 0, :, k:], signals[..., :k]

    @cached_property
    def _tangent(self) -> Response:
        """The response whose channels are the slopes of those of the rig."""
        return self._of_tangent(())

    @cached_property
    def _both(self) -> Response:
        return self._of_tangent(self.experiment.channels)

    def _of_tangent(self, further: tuple[Channel, ...]) -> Response:
        """Return the response of the tangent, with no record: slopes of channels, and `further` ones."""
        slopes = (
            dataclasses.replace(c, weights={name + DOT: w for name, w in c.weights.items()})
            for c in self.experiment.channels
        )
        channels = (*slopes, *further)
        y = np.zeros((len(self.experiment.t), len(channels)))
        record = dataclasses.replace(self.experiment, channels=channels, y=y)
        return Response(Tangent(self.model), record, ("signals",))

    def along(self, theta: Array, directions: Array) -> Array:
        """Return the channels `(W, q, T, K)` of a tangent, in `directions (W, q, P)`."""
        n, q, p = directions.shape
        points = np.concatenate([np.repeat(theta, q, axis=0), directions.reshape(n * q, p)], axis=1)
        return self.signals(points).reshape(n, q, *self.experiment.y.shape)

    def _run(self, name: str, shape: tuple[int, ...], *walkers: Array) -> Array:
        return self._kernel(name).run(
            name, len(walkers[0]), shape, samples=len(self.experiment.t),
            parameters=in_groups(*walkers), **self._addresses,
        )  # fmt: skip


def layout(model: Model, experiment: Experiment) -> Layout:
    """Return what kernels are specialised for, of a rig and its experiment."""
    return dataclasses.replace(
        input_layout(model, experiment),
        lead=bool(experiment.t[0] > experiment.t_start),
        channels=weight_kinds(experiment.weights(model.states)),
    )


def constant_block(experiment: Experiment, start: Sequence[float], weights: Array) -> Array:
    """Return the block `recurrence.Constants` of an experiment.

    It has the start `(X,)` and the weights `(K, X)` of the states of a model.
    """
    spans = (experiment.dt, float(experiment.t[0] - experiment.t_start))
    inputs = present(experiment.constant).values()
    return np.array([*spans, *inputs, *start, *np.ravel(weights)])


def record_blocks(experiment: Experiment) -> dict[str, Array]:
    """Return record and inputs; the last increment drives nothing that is measured any more."""
    series = [np.append(u, u[-1]) for u in experiment.series.values()]
    u = np.array(series, dtype=np.float64).reshape(len(series), len(experiment.t) + 1).T
    return {"y": np.ascontiguousarray(experiment.y), "u": np.ascontiguousarray(u)}
