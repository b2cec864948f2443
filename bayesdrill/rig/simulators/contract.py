"""Define the contract of a simulator, and derive results from its sums, signals and sensitivities."""

from __future__ import annotations

import dataclasses
import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np

from bayesdrill.basics.arrays import Array, Flags, Indices
from bayesdrill.record.experiment import Experiment, frozen
from bayesdrill.rig.kernels.compiling import address
from bayesdrill.rig.kernels.lanes import LANES
from bayesdrill.rig.kernels.sums import INTERVALS, LOGS, NEIGHBOURS, SQUARES, ResidualSums
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.simulators.sensors import ObservationModel, SensorParameters


@dataclass(frozen=True, slots=True)
class Motion:
    """The motion has `states (W, T, X)` at samples, and `efforts (W, T, E)` of frictions.

    Each effort acts in the step that begins at the sample; it is positive if it opposes a positive
    speed. While a friction sticks, the speed that it opposes is exactly zero.
    """

    states: Array
    efforts: Array


REVERSAL_SUBSTEPS = 4  # parts of a step with an event; 2 have a far larger error, 8 a similar one


class Stepping(NamedTuple):
    """These settings define the time steps of a simulator.

    `pieces` is the number of steps from one sample to the next, and `turns` the number of parts of a
    step with an event, such as a reversal. `chosen` says that both were adapted to the noise.
    """

    pieces: int
    turns: int
    chosen: bool


class Simulator(ABC):
    """A simulator computes the channels of an experiment; it is a frozen dataclass.

    Parameters are `full (W, P)` in SI: a row for each walker (set of parameters), with columns in
    the order of `parameters`: those of the `model`, then those of sensors and start. All results
    are batch-first. If the numbers of a walker overflow, only its own row is NaN.
    """

    model: Model
    experiment: Experiment
    sensing: ObservationModel  # sensors and start
    # True if a kernel computes the normal equations without storing samples.
    exact: ClassVar[bool] = False

    @cached_property
    def parameters(self) -> tuple[str, ...]:
        """Return the names of the columns of `full`."""
        return (*self.model.parameters, *self.sensing.names)

    @cached_property
    def sensors(self) -> SensorParameters:
        """Return the parameters of sensors and start, by which the rig is observed."""
        return SensorParameters(self.model, self.experiment, self.sensing)

    @property
    def record(self) -> Mapping[str, Array] | None:
        """Return `record_blocks` for the steady Kalman filter, or None if it cannot be used."""
        return None

    @property
    def by_samples(self) -> Simulator:
        """Return the simulator that uses every sample: itself, unless its record is compressed."""
        return self

    @property
    def functions(self) -> int:
        """Return the number of basis functions of a compressed record; otherwise zero."""
        return 0

    def exceeds_bound(self, full: Array) -> Flags:
        """Return for which walkers `(W,)` the error of a compressed record is too large."""
        return np.zeros(len(full), dtype=np.bool_)

    @property
    def unbounded(self) -> Simulator:
        """Return a simulator that uses a compressed record for all walkers, however large its error."""
        return self

    @property
    def stepping(self) -> Stepping | None:
        """Return the step sizes; None if the result does not depend on any step size."""
        return None

    def with_substeps(
        self, substeps: int, reversal_substeps: int = REVERSAL_SUBSTEPS, *, adaptive: bool = False
    ) -> Self:
        """Return the simulator with other step sizes, or unchanged if it has none."""
        return self

    def motion(self, full: Array) -> Motion:
        """Return the motion of a rig with friction, before any sensor."""
        raise NotImplementedError(f"{self.model.name} has no friction")

    @abstractmethod
    def signals(self, full: Array) -> Array:
        """Return the channels without noise, `(W, T, K)`."""

    @abstractmethod
    def course(self, full: Array, directions: Array) -> tuple[Array, Array]:
        """Return `signals` and `sensitivities` from one call, for q >= 1 directions."""

    @abstractmethod
    def sums(self, full: Array, tally: ResidualSums, weights: Array | None = None) -> Array:
        """Return the n sums over residuals that `tally` (see `kernels.sums`) defines, `(W, K, n)`.

        `weights (W, K, m)` are the m numbers that the tally needs for each channel; None if m is 0.
        """

    def squares(self, full: Array) -> Array:
        """Return sums of squared residuals `(W, K)`, without storing samples."""
        return self.sums(full, SQUARES)[..., 0]

    def neighbours(self, full: Array) -> Array:
        """Return sums of squares `(W, K, 3)`: of residuals, of their increments, and of two residuals.

        An increment is the difference between residuals of successive observed samples. The two
        residuals are the first and the last.
        """
        sums = self.sums(full, NEIGHBOURS)  # squares, squared increments, last and first residual
        sums[..., 2] = sums[..., 2] ** 2 + sums[..., 3] ** 2
        return sums[..., :3]

    def logs(self, full: Array, weights: Array) -> Array:
        """Return sums `(W, K)` of log(1 + weight * residual^2), with `weights (W, K)`."""
        return log_sums(self.sums(full, LOGS, weights[..., None]))

    def intervals(self, full: Array, inverse_sds: Array, half: Array) -> Array:
        """Return sums `(W, K)` of log P(|z - residual / sd| < `half`) for a standard normal z.

        `inverse_sds (W, K)` is 1 / sd. `half (W, K)` is half the width of the interval divided by sd,
        at least 0.2.
        """
        totals = self.sums(full, INTERVALS, np.stack([inverse_sds, half], axis=-1))
        return np.asarray(log_sums(totals[..., :3]) + totals[..., 3])

    def sensitivities(self, full: Array, directions: Array) -> Array:
        """Return derivatives `(W, q, T, K)` of signals in `directions (W, q, P)`."""
        return self.course(full, directions)[1]

    def normal(self, full: Array, directions: Array, weights: Array) -> tuple[Array, Array, Array]:
        """Return the normal equations of least squares.

        They are weighted sums of squared residuals `(W, K)`, of products of residuals and
        sensitivities `(W, q)`, and of products of sensitivities `(W, q, q)`. `weights (W, K, n)`
        are weights of the squares (n = 1), or of the three sums of `neighbours` (n = 3).
        """
        n, q, _ = directions.shape
        y, observed = self.experiment.y, self.experiment.is_measured
        squares, slopes, products = np.empty((n, y.shape[1])), np.empty((n, q)), np.empty((n, q, q))
        scales, measured = whitening_scales(weights), observed.any(axis=1)
        used = slice(None) if measured.all() else measured
        chunk = max(1, int(MAX_SENSITIVITY_BYTES / (8 * q * max(observed.size, 1))))
        y, observed = y[used], observed[used]
        for rows in (slice(k, k + chunk) for k in range(0, n, chunk)):
            signals, shown = self.course(full[rows], directions[rows])
            missing, shown, here = y - signals[:, used], shown[:, :, used], scales[rows]
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
        """Return the fields without compiled kernels, for pickling."""
        return {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}  # type: ignore[arg-type]

    def of(self, experiment: Experiment) -> Simulator:
        """Return the simulator of another experiment with these sensors, and maybe further channels."""
        return dataclasses.replace(self, experiment=experiment)  # type: ignore[type-var]

    def with_record(self, y: Array) -> Simulator:
        """Return the simulator of the same experiment with another record `(T, K)`.

        Samples that were not measured stay missing. Raises `ValueError` for a record of another shape.
        """
        if y.shape != self.experiment.y.shape:
            raise ValueError(f"the record has shape {self.experiment.y.shape}, not {y.shape}")
        record = frozen(np.where(self.experiment.is_measured, y, np.nan))
        return self.of(dataclasses.replace(self.experiment, y=record))


MAX_SENSITIVITY_BYTES = 6e7  # memory of the sensitivities that are computed at once [bytes]
MAX_SQUARES = 1e200  # above this sum of squares, the products for the logs may have overflowed


def whitening_scales(weights: Array) -> Array:
    """Return scales `(W, K, n)` of samples from `weights` of sums, see `Simulator.normal`.

    With scales s, a whitened sample is s_0 y if n is 1. If n is 3 (first-order autoregressive noise),
    it is s_0 y - s_1 p, where p is the previous observed sample. The first observed sample becomes
    s_2 y.
    """
    if weights.shape[2] == 1:
        return np.sqrt(weights)
    squares, steps, ends = np.moveaxis(weights, -1, 0)
    scale = np.sqrt(squares + steps + ends)
    before = steps / scale
    return np.stack([scale, before, np.sqrt((scale - before) * (scale + before))], axis=-1)


def whitened(values: Array, observed: Flags, scales: Array) -> Array:
    """Whiten `values (W, q, T, K)`, zero where nothing was observed, with `scales (W, K, n)`."""
    out = values * scales[:, None, None, :, 0]
    for k in range(values.shape[3] if scales.shape[2] > 1 else 0):
        rows = np.flatnonzero(observed[:, k])
        last, later = (slice(-1), slice(1, None)) if observed[:, k].all() else (rows[:-1], rows[1:])
        out[:, :, later, k] -= values[:, :, last, k] * scales[:, None, k, 1, None]
        out[:, :, rows[:1], k] = values[:, :, rows[:1], k] * scales[:, None, k, 2, None]
    return out


def log_sums(tally: Array) -> Array:
    """Return logs `(W, K)` of products in registers `tally (W, K, 3)`, NaN if squares may overflow."""
    squares, product, powers = np.moveaxis(tally, -1, 0)
    whole = np.ascontiguousarray(powers).view(np.int64)
    logs = np.log(product) + math.log(2.0) * whole
    return np.asarray(np.where(squares < MAX_SQUARES, logs, np.nan))


def first_observed(y: Array) -> Indices:
    """Return for each channel the index `(K,)` of the first sample that is not NaN."""
    return np.isnan(y).argmin(axis=0).astype(np.int64)


def aligned(scratch: Array) -> int:
    """Return the first address in `scratch` that begins a cache line: vectors in two lines are slow."""
    start = address(scratch)
    return start + -start % 64


def in_groups(*parts: Array) -> Array:
    """Join parts `(W, ...)`, or `(1, ...)` that walkers share, in groups of walkers `(G, n, LANES)`.

    Copies of the last walker fill the last group.
    """
    flats = [part.reshape(len(part), -1) for part in parts]
    groups, missing = -(-max(map(len, flats)) // LANES), -max(map(len, flats)) % LANES
    out, start = np.empty((groups, sum(flat.shape[1] for flat in flats), LANES)), 0
    for flat in flats:
        here = out[:, start : start + flat.shape[1]]
        start += flat.shape[1]
        if len(flat) == 1:
            here[:] = flat.T
            continue
        if missing:
            flat = np.concatenate([flat, flat[-1:].repeat(missing, axis=0)])
        here[:] = flat.reshape(groups, LANES, -1).transpose(0, 2, 1)
    return out
