"""Simulate a linear rig in a time that does not depend on the length of the record.

`CompressedSimulator` computes sums of squares and their normal equations from the triangle R of a QR
decomposition of basis functions and record (`basis`). It does so for each walker (set of parameters)
for which the finite number of functions has a small enough error. In all other cases it calls the
exact simulator.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from bayesdrill.basics.arrays import Array, Counts, Flags
from bayesdrill.basics.duals import Dual
from bayesdrill.record.experiment import Experiment
from bayesdrill.rig.compression.basis import (
    BLOCK,
    Basis,
    Columns,
    CompressionError,
    Triangle,
    choose_basis,
    triangle,
)
from bayesdrill.rig.compression.basis_kernel import BasisShape
from bayesdrill.rig.compression.sums_kernel import write_sums
from bayesdrill.rig.kernels.compiling import compile_kernel
from bayesdrill.rig.kernels.exponential import present
from bayesdrill.rig.kernels.lanes import LANES
from bayesdrill.rig.kernels.sums import SQUARES, ResidualSums
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.simulators import exact_reason
from bayesdrill.rig.simulators.contract import Simulator, in_groups
from bayesdrill.rig.simulators.long_record import LongRecord
from bayesdrill.rig.simulators.sensors import ObservationModel, ObservedWalkers

TOLERANCE = 1e-7  # admissible error of the log likelihood
MAX_BEYOND = 0.02  # largest fraction of points that may need the exact simulator
LEAST = 1e-300  # smallest weight of a sum, to avoid division by zero
# Numbers of digits with which the basis must represent a mode's response, tried in this order.
RESPONSE_DIGITS = range(12, 26, 2)


@dataclass(frozen=True, eq=False, kw_only=True)
class Compression:
    """The compression is the projection of a record of any length on a few basis functions.

    `shape`, `orders` and `frame` define the functions. `reference (n, K)` are the coefficients of
    a reference rig, which are subtracted from those of walkers. `numbers` are the time step and
    constant inputs. `tolerance (K, sums)` is the admissible error of each sum.
    """

    shape: BasisShape
    numbers: Array
    orders: Counts
    frame: Array
    record: Triangle
    reference: Array
    tolerance: Array

    @classmethod
    def of_nothing(
        cls, basis: Basis, record: LongRecord, sizes: Array, tolerance: Array, **settings: Any
    ) -> Compression:
        """Return the compression of an empty record; all coefficients of its reference are zero.

        `sizes` are norms of input series. `settings` are further fields of the shape.
        """
        poles = tuple(pole.size for pole in basis.poles)
        shape = BasisShape(poles=poles, integrators=basis.integrators, **settings)
        orders = np.array([pole.order for pole in basis.poles], dtype=np.int64)
        still = [1.0] * shape.impulse + [math.sqrt(record.n_knots)] * shape.constant
        empty = triangle((), shape.columns(orders), shape.sums, [slice(0, shape.channels)])
        return cls(
            shape=shape,
            orders=orders,
            frame=basis.frame([*still, *sizes], record.first_inputs),
            record=empty,
            reference=np.zeros((empty.matrix.shape[-1], shape.channels)),
            numbers=np.array([record.step, *present(record.sensors.experiment.constant).values()]),
            tolerance=tolerance,
        )

    @property
    def blocks(self) -> dict[str, Array | Counts]:
        """Return the arguments of the kernel that are the same for all walkers."""
        return {
            "numbers": self.numbers, "frame": self.frame, "orders": self.orders,
            "reference": self.reference, "triangles": self.record.matrix,
            "projected": self.record.projected,
        }  # fmt: skip

    def applied(self, simulator: Simulator) -> CompressedSimulator:
        """Return a simulator with this compression in place of any that `simulator` has."""
        whole = simulator.by_samples
        return CompressedSimulator(whole.model, whole.experiment, whole.sensing, whole, self)


@dataclass(frozen=True, eq=False)
class CompressedSimulator(Simulator):
    """The simulator uses the record's triangle or, if errors may be too large, `uncompressed`."""

    model: Model
    experiment: Experiment
    sensing: ObservationModel
    uncompressed: Simulator
    compression: Compression

    exact: ClassVar[bool] = True

    # Results of the exact simulator alone.

    @property
    def by_samples(self) -> Simulator:
        """See `Simulator.by_samples`."""
        return self.uncompressed

    def signals(self, full: Array) -> Array:
        """See `Simulator.signals`."""
        return self.uncompressed.signals(full)

    def course(self, full: Array, directions: Array) -> tuple[Array, Array]:
        """See `Simulator.course`."""
        return self.uncompressed.course(full, directions)

    def of(self, experiment: Experiment) -> Simulator:
        """Return the exact simulator of another experiment."""
        return self.uncompressed.of(experiment)

    # Results of the triangle.

    def sums(self, full: Array, tally: ResidualSums, weights: Array | None = None) -> Array:
        """See `Simulator.sums`."""
        if tally is not SQUARES:
            return self.uncompressed.sums(full, tally, weights)
        return self._mended(full)[..., :1]

    def neighbours(self, full: Array) -> Array:
        """See `Simulator.neighbours`."""
        return self._mended(full) if self._shape.sums > 1 else self.uncompressed.neighbours(full)

    def expanded(self, full: Array) -> tuple[Array, Array]:
        """Return sums `(W, K, sums)` from the triangles, and bounds of their errors."""
        return self._with_bounds(self._run({"walkers": self._walkers(full)})[0])

    def _with_bounds(self, numbers: Array) -> tuple[Array, Array]:
        """Return sums `(W, K, sums)`, and bounds of their errors, from the `numbers` of a kernel."""
        sums, sizes = np.split(numbers, [self._k * self._shape.sums], axis=1)
        sums = sums.reshape(-1, self._k, self._shape.sums)
        with np.errstate(all="ignore"):
            # The second sum is of squared increments, and an increment has the errors of two samples.
            sizes = sizes[..., None] * np.array([1.0, 2.0, 1.0])[: self._shape.sums]
            return sums, 2.0 * np.sqrt(sums) * sizes + sizes**2

    def coefficients(self, full: Array) -> Array:
        """Return the coefficients `(n, K)` of one rig minus those of the reference."""
        first, n = self._shape.coefficients_at, self.functions
        scratch = self._run({"walkers": self._walkers(full)})[1][first : first + n * self._k, 0]
        return np.ascontiguousarray(scratch.reshape(n, self._k))

    def normal(self, full: Array, directions: Array, weights: Array) -> tuple[Array, Array, Array]:
        """See `Simulator.normal`."""
        n, q, _ = directions.shape
        if weights.shape[2] != self._shape.sums:
            return self.uncompressed.normal(full, directions, weights)
        repeated = Dual(np.repeat(full, q, axis=0), directions.reshape(n * q, -1))
        slopes = ObservedWalkers(self.sensors, repeated).numbers.slope.reshape(n, q, -1)
        blocks = {"walkers": self._walkers(full), "directions": slopes, "weights": weights}
        rows, first = self._run(blocks, q)[0], self._k * (self._shape.sums + 1)
        numbers, slope, lower = np.split(rows, [first, first + q], axis=1)
        products = np.tril(lower.reshape(n, q, q))
        products = products + np.tril(products, -1).swapaxes(1, 2)
        sums, errors = self._with_bounds(numbers)
        squares = np.asarray((weights * sums).sum(axis=2))
        if (far := np.flatnonzero(self.exceeds_limit(sums, errors))).size:
            exact = self.uncompressed.normal(full[far], directions[far], weights[far])
            squares[far], slope[far], products[far] = exact
        return squares, slope, products

    def exceeds_limit(self, sums: Array, errors: Array) -> Flags:
        """Return for which walkers `(W,)` the errors of sums `(W, K, sums)` may be too large.

        A sum may have an error of `tolerance` + `TOLERANCE` * |sum - reference's sum|.
        """
        projected = self.compression.record.projected
        least = (projected[..., :-1] ** 2).sum(axis=-1) + projected[..., -1]
        tolerance = self.compression.tolerance
        within = errors <= tolerance + TOLERANCE * np.abs(sums - least)
        return np.asarray(~(within | (tolerance == np.inf)).all(axis=(1, 2)))

    def _mended(self, full: Array) -> Array:
        """Return the sums, replaced by the exact ones wherever errors may be too large."""
        sums, errors = self.expanded(full)
        far = np.flatnonzero(self.exceeds_limit(sums, errors))
        if len(far):
            sums = sums.copy()
            exact = (
                self.uncompressed.neighbours if self._shape.sums > 1 else self.uncompressed.squares
            )
            sums[far] = exact(full[far]).reshape(len(far), *sums.shape[1:])
        return sums

    def exceeds_bound(self, full: Array) -> Flags:
        """See `Simulator.exceeds_bound`."""
        return self.exceeds_limit(*self.expanded(full))

    @property
    def unbounded(self) -> CompressedSimulator:
        """See `Simulator.unbounded`."""
        anything = np.full_like(self.compression.tolerance, np.inf)
        unbounded = dataclasses.replace(self.compression, tolerance=anything)
        return dataclasses.replace(self, compression=unbounded)

    @property
    def functions(self) -> int:
        """See `Simulator.functions`."""
        return int(self.compression.record.matrix.shape[-1])

    @property
    def _k(self) -> int:
        return len(self.experiment.channels)

    @property
    def _shape(self) -> BasisShape:
        return self.compression.shape

    @cached_property
    def _slopes_shape(self) -> BasisShape:
        return dataclasses.replace(self._shape, slopes=True)

    def _walkers(self, full: Array) -> Array:
        return np.asarray(ObservedWalkers(self.sensors, full).numbers)

    def _run(self, blocks: dict[str, Array], q: int = 0) -> tuple[Array, Array]:
        """Run the kernel on blocks `(W, ...)`; returns its numbers `(W, n)`, and scratch."""
        known, n = self.compression, len(blocks["walkers"])
        _, n_triangles, columns, _ = known.record.matrix.shape
        shape, size = self._slopes_shape if q else self._shape, columns**2
        grouped = {name: in_groups(block) for name, block in blocks.items()}
        scratch = np.empty((shape.scratch_size(columns, q), LANES))
        channel, width = size if n_triangles > 1 else 0, self._k * (shape.sums + 1) + q + q * q
        function = compile_kernel(write_sums, shape).bind("sums", columns=columns, **known.blocks)
        counts = {"channel": channel, "sum": n_triangles * size, "q": q}
        return function.run(n, (width,), scratch=scratch, **counts, **grouped), scratch


def even_record(simulator: Simulator) -> LongRecord:
    """Return the record of a linear rig; it must have equal steps, and channels without lags."""
    grid = simulator.sensors.grid
    count = len(grid.t) - 1
    at = grid.samples if len(grid.samples) < count else None
    return LongRecord(simulator.sensors, float(grid.spans[0]), count, at)


def compress(simulator: Simulator, points: Array, variances: Array, weights: Array) -> Compression:
    """Compress a record for rigs near `points (n, P)`; the reference rig is at the first point.

    `variances (K,)` are those of the noise. `weights (K, sums)` are those of sums of squares in
    -2 log likelihood, see `Noise.square_weights`. The log likelihood may be wrong by `TOLERANCE`.

    Raises `CompressionError` if `exact_reason` forbids it, if modes do not decay, or if poles
    are too far apart.
    """
    if reason := exact_reason(simulator):
        raise CompressionError(reason)
    record = even_record(simulator)
    sensors, (k_count, sums) = record.sensors, weights.shape
    with np.errstate(all="ignore"):
        rates = ObservedWalkers(sensors, points).system[0]
    sizes = np.linalg.norm(record.inputs(0, record.n_knots) - record.first_inputs, axis=0)
    n = np.array(simulator.experiment.counts, dtype=float)
    expected = np.stack([n, 4.0 * n, np.full(len(n), 2.0)], axis=1)[:, :sums]
    tolerance = 2.0 * TOLERANCE / np.maximum(np.abs(weights), LEAST) / weights.size
    for digits in RESPONSE_DIGITS:  # until the bound is small enough at nearly all points
        basis = choose_basis(rates, record.step, 10.0**-digits)
        nothing = Compression.of_nothing(
            basis, record, sizes, tolerance, layout=record.layout, channels=k_count,
            impulse=sensors.sensing.may_move(sensors.experiment.start, angles=()), sums=sums,
        )  # fmt: skip
        # The residuals of the reference are taken as noise.
        nothing.record.projected[..., -1] = variances[:, None] * expected
        made = nothing.applied(simulator)
        if np.mean(made.exceeds_bound(points)) <= MAX_BEYOND:
            break
    else:
        raise CompressionError("the bound of the truncation error stays too large")
    blocks = column_blocks(record, basis, nothing.shape, record.residuals(points[0]))
    columns = nothing.shape.columns(nothing.orders)
    known = triangle(blocks, columns, nothing.shape.sums, record.alike)
    reference = made.coefficients(points[:1])
    return dataclasses.replace(made.compression, record=known, reference=reference)


def column_blocks(
    record: LongRecord, basis: Basis, shape: BasisShape, left: Iterable[tuple[Array, Array]]
) -> Iterator[tuple[Array, Array]]:
    """Yield regressors `(m, n)`, and the reference's residuals `(m, K)`, for m samples at a time.

    `left` yields inputs `(m, S)`, and residuals of the reference.
    """
    still = np.array([[0.0] * shape.impulse + [1.0] * shape.constant])
    driven, direct = Columns(basis), shape.layout.first_order
    if shape.impulse:  # the impulse acts one sample before the first
        driven.block(np.eye(1, len(shape.sources)))
    for inputs, residuals in left:
        for first in range(0, len(inputs), BLOCK):
            u = inputs[first : first + BLOCK] - record.first_inputs
            sources = np.concatenate([still.repeat(len(u), axis=0), u], axis=1)
            parts = [driven.block(sources), u[:, : u.shape[1] * direct], np.ones((len(u), 1))]
            yield np.concatenate(parts, axis=1), residuals[first : first + BLOCK]
