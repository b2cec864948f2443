"""The contract of a simulator, and what follows from its sums, signals and slopes."""

from __future__ import annotations

import dataclasses
import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np

from bayesdrill.basics.arrays import Array, Flags
from bayesdrill.record.experiment import Experiment, frozen
from bayesdrill.rig.kernels.lanes import LANES
from bayesdrill.rig.kernels.sums import INTERVALS, LOGS, NEIGHBOURS, SQUARES, ResidualSums
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.simulators.sensors import ObservationModel, SensorParameters


@dataclass(frozen=True, slots=True)
class Motion:
    """What rigs do at sample times: `states (W, T, X)` and `efforts (W, T, E)` of frictions.

    Efforts are those in the step that begins there, positive against a positive speed.  What sticks
    has no speed at all.
    """

    states: Array
    efforts: Array


REVERSAL_SUBSTEPS = 4  # 2 leave several times the error, 8 hardly less


class Stepping(NamedTuple):
    """How a simulator steps.

    `pieces`: steps to a sample; `turns`: parts of a step with a reversal; `chosen`: both were, for
    the noise.
    """

    pieces: int
    turns: int
    chosen: bool


class Simulator(ABC):
    """Computes the channels of an experiment; a frozen dataclass.

    Parameters are `full (W, P)`, columns in the order of `parameters`, SI: those of the `model`,
    then those of sensors and start.  All is batch-first, and a walker whose numbers overflow gets
    NaN in its own row alone.
    """

    model: Model
    experiment: Experiment
    sensing: ObservationModel  # what it is told beside the rig's parameters
    exact: ClassVar[bool] = False  # whether slopes come as sums from one kernel, no sample kept

    @cached_property
    def parameters(self) -> tuple[str, ...]:
        """Names of the columns of `full`."""
        return (*self.model.parameters, *self.sensing.names)

    @cached_property
    def sensors(self) -> SensorParameters:
        """What its parameters say of sensors and start."""
        return SensorParameters(self.model, self.experiment, self.sensing)

    @property
    def record(self) -> Mapping[str, int] | None:
        """Addresses of channels `y (T, K)` and of inputs `u (T + 1, S)`, for a kernel."""
        return None

    @property
    def by_samples(self) -> Simulator:
        """The simulator that has all samples: itself, unless its record is compressed."""
        return self

    @property
    def functions(self) -> int:
        """How many functions its record has become; zero where it is not compressed."""
        return 0

    def exceeds_bound(self, full: Array) -> Flags:
        """Tell which walkers `(W,)` of a compressed record are simulated by all samples."""
        return np.zeros(len(full), dtype=np.bool_)

    @property
    def unbounded(self) -> Simulator:
        """The same, but all walkers of a compressed record are simulated by that, however wrong."""
        return self

    @property
    def stepping(self) -> Stepping | None:
        """How it steps; None where there is no step whose size matters."""
        return None

    def with_substeps(
        self, substeps: int, reversal_substeps: int = REVERSAL_SUBSTEPS, *, adaptive: bool = False
    ) -> Self:
        """Return a simulator with other steps, where it has some."""
        return self

    @abstractmethod
    def motion(self, full: Array) -> Motion:
        """Return the motion of the rig, whatever sensors make of it."""

    @abstractmethod
    def signals(self, full: Array) -> Array:
        """Return the channels without noise, `(W, T, K)`."""

    @abstractmethod
    def course(self, full: Array, along: Array) -> tuple[Array, Array]:
        """Return signals and sensitivities at once; q at least 1."""

    @abstractmethod
    def sums(self, full: Array, tally: ResidualSums, weights: Array | None = None) -> Array:
        """Return sums of residuals `(W, K, n)`: the n registers of a `tally` of `kernels.sums`.

        `weights (W, K, m)`: the m numbers of each channel that the tally asks for, None for m = 0.
        """

    def squares(self, full: Array) -> Array:
        """Return sums of squared residuals `(W, K)`, without storing samples."""
        return self.sums(full, SQUARES)[..., 0]

    def neighbours(self, full: Array) -> Array:
        """Return sums of squares of residuals, of steps between them, and of both ends: `(W, K, 3)`.

        Steps are from a residual to the next that was observed; the ends are the first and the last.
        """
        sums = self.sums(full, NEIGHBOURS)  # squares, steps, the last, the first
        sums[..., 2] = sums[..., 2] ** 2 + sums[..., 3] ** 2
        return sums[..., :3]

    def logs(self, full: Array, weights: Array) -> Array:
        """Return sums `(W, K)` of log(1 + weight times squared residual), with `weights (W, K)`."""
        return log_sums(self.sums(full, LOGS, weights[..., None]))

    def intervals(self, full: Array, over: Array, half: Array) -> Array:
        """Return sums `(W, K)` of logs of the probabilities of intervals.

        Each is the probability that a standard normal number is within `half (W, K)` of the
        residual times `over (W, K)`; `half` is at least 0.2.
        """
        totals = self.sums(full, INTERVALS, np.stack([over, half], axis=-1))
        return np.asarray(log_sums(totals[..., :3]) + totals[..., 3])

    def sensitivities(self, full: Array, along: Array) -> Array:
        """Return slopes of signals along q directions `(W, q, P)` of parameters: `(W, q, T, K)`."""
        return self.course(full, along)[1]

    def normal(self, full: Array, along: Array, weights: Array) -> tuple[Array, Array, Array]:
        """Return the normal equations of least squares, as sums.

        They are squares of residuals `(W, K)`, their products with sensitivities `(W, q)`, and
        those of sensitivities with each other `(W, q, q)`, all with `weights (W, K, n)`: of squares
        alone, or of the three sums of `neighbours`.
        """
        n, q, _ = along.shape
        y, observed = self.experiment.y, self.experiment.seen
        squares, slopes, products = np.empty((n, y.shape[1])), np.empty((n, q)), np.empty((n, q, q))
        scales = whitening_scales(weights)
        chunk = max(1, int(MAX_SENSITIVITY_BYTES / (8 * q * max(observed.size, 1))))
        for rows in (slice(k, k + chunk) for k in range(0, n, chunk)):
            signals, shown = self.course(full[rows], along[rows])
            missing, here = y - signals, scales[rows]
            if not observed.all():
                missing, shown = np.where(observed, missing, 0.0), np.where(observed, shown, 0.0)
            shown = whitened(shown, observed, here)
            residuals = whitened(missing[:, None], observed, here)[:, 0]
            flat = shown.reshape(*shown.shape[:2], -1)
            products[rows] = flat @ flat.swapaxes(1, 2)
            slopes[rows] = (flat @ residuals.reshape(len(flat), -1, 1))[..., 0]
            squares[rows] = (residuals**2).sum(axis=1)
        return squares, slopes, products

    def __getstate__(self) -> dict[str, Any]:
        """Without what is compiled."""
        return {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}  # type: ignore[arg-type]

    def of(self, experiment: Experiment) -> Simulator:
        """Return the simulator of another experiment with the same sensors.

        It may have further channels.
        """
        return dataclasses.replace(self, experiment=experiment)  # type: ignore[type-var]

    def with_record(self, y: Array) -> Simulator:
        """Return the simulator of the same experiment with another record `(T, K)`.

        What was not measured stays so.  Raises `ValueError` for a record of another shape.
        """
        if y.shape != self.experiment.y.shape:
            raise ValueError(f"the record has shape {self.experiment.y.shape}, not {y.shape}")
        record = frozen(np.where(self.experiment.seen, y, np.nan))
        return self.of(dataclasses.replace(self.experiment, y=record))


MAX_SENSITIVITY_BYTES = 6e7  # of sensitivities at a time
MAX_SQUARES = 1e200  # beyond which a product of their logs may have overflown


def whitening_scales(weights: Array) -> Array:
    """Return scales `(W, K, n)` of samples from `weights` of sums, see `Simulator.normal`.

    They are of a sample; and where n is 3, of the sample before, which is taken from it, and of the
    first sample.  The squares of what results have these weights in noise of first order.
    """
    if weights.shape[2] == 1:
        return np.sqrt(weights)
    squares, steps, ends = np.moveaxis(weights, -1, 0)
    scale = np.sqrt(squares + steps + ends)
    before = steps / scale
    return np.stack([scale, before, np.sqrt((scale - before) * (scale + before))], axis=-1)


def whitened(values: Array, observed: Flags, scales: Array) -> Array:
    """Return `values (W, q, T, K)` with the `scales (W, K, n)`; they are zero where not observed."""
    out = values * scales[:, None, None, :, 0]
    for k in range(values.shape[3] if scales.shape[2] > 1 else 0):
        rows = np.flatnonzero(observed[:, k])
        before = values[:, :, rows[:-1], k] * scales[:, None, k, 1, None]
        out[:, :, rows[1:], k] -= before
        out[:, :, rows[:1], k] = values[:, :, rows[:1], k] * scales[:, None, k, 2, None]
    return out


def log_sums(tally: Array) -> Array:
    """Return the logs `(W, K)` of products `(W, K, 3)`, see `kernels.sums`.

    They are NaN where squares overflow.
    """
    squares, product, powers = np.moveaxis(tally, -1, 0)
    whole = np.ascontiguousarray(powers).view(np.int64)
    logs = np.log(product) + math.log(2.0) * whole
    return np.asarray(np.where(squares < MAX_SQUARES, logs, np.nan))


# A block that a kernel does not read, and its address: asking for that takes as long as some samples.
NO_BLOCK = np.zeros(0)
NO_ADDRESS = NO_BLOCK.ctypes.data


def aligned(scratch: Array) -> int:
    """Return an address in `scratch`: vectors that cross lines of the cache take twice as long."""
    start = scratch.ctypes.data
    return int(start + -start % 64)


def in_groups(*parts: Array) -> Array:
    """Put blocks `(W, ...)` side by side: `(G, n, LANES)`; the last walker fills the last group."""
    count = len(parts[0])
    groups = -(-count // LANES)
    if missing := groups * LANES - count:
        parts = tuple(np.concatenate([p, p[-1:].repeat(missing, axis=0)]) for p in parts)
    turned = [part.reshape(groups, LANES, -1).transpose(0, 2, 1) for part in parts]
    if len(turned) == 1:
        return np.ascontiguousarray(turned[0])
    groups_out = np.empty((groups, sum(part.shape[1] for part in turned), LANES))
    return np.concatenate(turned, axis=1, out=groups_out)
