"""A linear rig's record in a few hundred numbers: sums of squares that do not know its length.

The second implementation of a simulator.  Sums of squares and their normal equations come from the
record's triangle (`rational_basis`) wherever the bound of what is left is small enough, walker by
walker; everything else, and all other walkers, from the exact simulator.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from bayesdrill.basics.arrays import Array, Flags
from bayesdrill.record.experiment import Experiment
from bayesdrill.rig.kernels.compiling import compile_kernel
from bayesdrill.rig.kernels.compressed_sums import (
    BLOCKS,
    NORMAL_BLOCKS,
    write_normal,
    write_squares,
)
from bayesdrill.rig.kernels.lanes import LANES
from bayesdrill.rig.kernels.rational_basis import ROWS, BasisShape
from bayesdrill.rig.kernels.sums import SQUARES, ResidualSums
from bayesdrill.rig.models.linear import Tangent
from bayesdrill.rig.simulators.contract import Motion, Simulator, Steps, in_groups
from bayesdrill.rig.simulators.delays import Delays, RecordHead
from bayesdrill.rig.simulators.long_record import (
    LongRecord,
    input_layout,
    starts,
    walker_numbers,
    walker_slopes,
)
from bayesdrill.rig.simulators.rational_basis import (
    BLOCK,
    Basis,
    Columns,
    CompressionError,
    Triangle,
    choose_basis,
    impulse_columns,
    triangle,
)
from bayesdrill.rig.simulators.sensors import ObservationModel, SensorParameters
from bayesdrill.rig.simulators.time_grid import build_grid

TOLERANCE = 1e-7  # of the log likelihood
MAX_BEYOND = 0.02  # of points: walkers whose bound is larger have the exact simulator
LEAST = 1e-300  # weight of a sum that does not count
DIGITS = (12, 26, 2)  # of a response that functions are to have: first, last, and steps between


@dataclass(frozen=True, eq=False)
class Compression:
    """A record along the functions of a `basis`, which is small whatever the record's length.

    `reference (n, K)`: coefficients of the reference, from which all is a difference.  `tolerance
    (K, sums)`: what sums of squares may be wrong by.  `step`: of the record [s]; `sizes`: of what
    drives the rig, each the root of its sum of squares; `first`: of each series, from which it counts
    where it changes straight, else zero.  `delays`: of channels, None where none is late.
    """

    basis: Basis
    record: Triangle
    reference: Array
    tolerance: Array
    step: float
    sizes: tuple[float, ...]
    first: tuple[float, ...]
    delays: Delays | None = None

    def applied(self, simulator: Simulator) -> CompressedSimulator:
        """Return a simulator that has this compression, in the place of another where it has one."""
        return CompressedSimulator(simulator.by_samples, self)


@dataclass(frozen=True, eq=False)
class CompressedSimulator(Simulator):
    """Simulates by the record's triangle, and by the `whole` simulator where that is not enough."""

    whole: Simulator
    compression: Compression

    @property
    def model(self) -> Any:  # type: ignore[override]
        """The model of the exact simulator."""
        return self.whole.model

    @property
    def experiment(self) -> Experiment:  # type: ignore[override]
        """The experiment of the exact simulator."""
        return self.whole.experiment

    @property
    def sensing(self) -> ObservationModel:  # type: ignore[override]
        """The sensors of the exact simulator."""
        return self.whole.sensing

    @property
    def by_samples(self) -> Simulator:
        """See `Simulator.by_samples`."""
        return self.whole

    @property
    def exact(self) -> bool:  # type: ignore[override]
        """See `Simulator.exact`."""
        return True

    # What only the exact simulator can do.

    def motion(self, full: Array) -> Motion:
        """See `Simulator.motion`."""
        return self.whole.motion(full)

    def steps(self, full: Array) -> Steps:
        """See `Simulator.steps`."""
        return self.whole.steps(full)

    def signals(self, full: Array) -> Array:
        """See `Simulator.signals`."""
        return self.whole.signals(full)

    def course(self, full: Array, along: Array) -> tuple[Array, Array]:
        """See `Simulator.course`."""
        return self.whole.course(full, along)

    def sensitivities(self, full: Array, along: Array) -> Array:
        """See `Simulator.sensitivities`."""
        return self.whole.sensitivities(full, along)

    def of(self, experiment: Experiment) -> Simulator:
        """Return the exact simulator of another experiment."""
        return self.whole.of(experiment)

    # What the triangle can do.

    def sums(self, full: Array, tally: ResidualSums, weights: Array | None = None) -> Array:
        """See `Simulator.sums`."""
        if tally is not SQUARES:
            return self.whole.sums(full, tally, weights)
        return self._mended(full)[..., :1]

    def neighbours(self, full: Array) -> Array:
        """See `Simulator.neighbours`."""
        return self._mended(full) if self._shape.sums > 1 else self.whole.neighbours(full)

    def expanded(self, full: Array) -> tuple[Array, Array]:
        """Return sums `(W, K, sums)` by the triangles, and bounds of what they are wrong by."""
        blocks = in_groups(self._walkers(full))
        out = np.empty((len(blocks), self._k * (self._shape.sums + 1), LANES))
        self._run("squares", self._shape, len(blocks), {"walkers": blocks, "out": out})
        return self._with_bounds(out.transpose(0, 2, 1).reshape(-1, out.shape[1])[: len(full)])

    def _with_bounds(self, numbers: Array) -> tuple[Array, Array]:
        """Return sums `(W, K, sums)`, and what they may be wrong by; `numbers`: of a kernel."""
        sums, sizes = np.split(numbers, [self._k * self._shape.sums], axis=1)
        sums = sums.reshape(-1, self._k, self._shape.sums)
        with np.errstate(all="ignore"):
            # A step has what two samples have.
            sizes = sizes[..., None] * np.array([1.0, 2.0, 1.0])[: self._shape.sums]
            return sums, 2.0 * np.sqrt(sums) * sizes + sizes**2

    def coefficients(self, full: Array, *, late: bool = True) -> Array:
        """Return the coefficients `(n, K)` of one rig, less the reference's: the kernel's own.

        `late=False`: of channels that are late by whole steps.
        """
        walkers = self._walkers(full)
        if self.compression.delays is not None and not late:
            walkers[:, -2 * self._k :] = 0.0
        blocks = {
            "walkers": in_groups(walkers),
            "out": np.empty((1, self._k * (self._shape.sums + 1), LANES)),
        }
        scratch = self._run("squares", self._shape, 1, blocks)
        first, n = self._shape.coefficients_at, self.functions
        return np.ascontiguousarray(scratch[first : first + n * self._k, 0].reshape(n, self._k))

    def normal(self, full: Array, along: Array, weights: Array) -> tuple[Array, Array, Array]:
        """See `Simulator.normal`."""
        n, q, _ = along.shape
        if weights.shape[2] != self._shape.sums:
            return self.whole.normal(full, along, weights)
        with np.errstate(all="ignore"):
            walkers = self._walkers(full)
            slopes = self._walker_slopes(full, along)
        blocks = {
            "walkers": in_groups(walkers),
            "directions": in_groups(slopes.reshape(n, -1)),
            "weights": in_groups(weights.reshape(n, -1)),
        }
        first, groups = self._k * (self._shape.sums + 1), len(blocks["walkers"])
        blocks["out"] = np.empty((groups, first + q + q * q, LANES))
        self._run("normal", self._tangent_shape, groups, blocks, q)
        rows = blocks["out"].transpose(0, 2, 1).reshape(-1, first + q + q * q)[:n]
        numbers, slope, lower = np.split(rows, [first, first + q], axis=1)
        products = np.tril(lower.reshape(n, q, q))
        products = products + np.tril(products, -1).swapaxes(1, 2)
        sums, errors = self._with_bounds(numbers)
        squares = (weights * sums).sum(axis=2)
        if self._head is not None:
            further = self._head.normal(full, along, weights)
            squares, slope, products = (
                squares + further[0],
                slope + further[1],
                products + further[2],
            )
        if (far := np.flatnonzero(self.beyond(sums, errors))).size:
            squares[far], slope[far], products[far] = self.whole.normal(
                full[far], along[far], weights[far]
            )
        return squares, slope, products

    def beyond(self, sums: Array, errors: Array) -> Flags:
        """Tell of which walkers sums `(W, K, sums)` may be wrong by too much: `(W,)`.

        That is by `TOLERANCE` of the log likelihood, or of how far it is below the reference's.
        """
        projected = self.compression.record.projected
        least = (projected[..., :-1] ** 2).sum(axis=-1) + projected[..., -1]
        allowed = self.compression.tolerance + TOLERANCE * np.abs(sums - least)
        return np.asarray(~(errors <= allowed).all(axis=(1, 2)))

    def _mended(self, full: Array) -> Array:
        """Return the sums, those of the exact simulator where errors may be too large."""
        sums, errors = self.expanded(full)
        far = np.flatnonzero(self.beyond(sums, errors))
        if self._head is not None:
            sums = sums + self._head.sums(full, self._shape.sums)
        if len(far):
            sums = sums.copy()
            exact = self.whole.neighbours if self._shape.sums > 1 else self.whole.squares
            sums[far] = exact(full[far]).reshape(len(far), *sums.shape[1:])
        return sums

    def exceeds_bound(self, full: Array) -> Flags:
        """See `Simulator.exceeds_bound`."""
        return self.beyond(*self.expanded(full))

    @property
    def functions(self) -> int:
        """See `Simulator.functions`."""
        return int(self.compression.record.matrix.shape[-1])

    @property
    def _k(self) -> int:
        return len(self.experiment.channels)

    @cached_property
    def _sensors(self) -> SensorParameters:
        return SensorParameters(self.model, self.experiment, self.sensing)

    @cached_property
    def _shape(self) -> BasisShape:
        sums, delays = len(self.compression.record.matrix), self.compression.delays
        return basis_shape(self._sensors, self.compression.basis, sums, delays)

    @cached_property
    def _tangent_shape(self) -> BasisShape:
        tangent = Tangent(self._sensors.observed_model)
        layout = input_layout(tangent, self.experiment)
        return dataclasses.replace(self._shape, layout=layout, tangent=True)

    @cached_property
    def _head(self) -> RecordHead | None:
        delays = self.compression.delays
        record = None if delays is None else even_record(self.whole)
        if record is None or delays is None:
            return None
        return delays.head(self.whole, record.at, lead=self._sensors.lead)

    def _walkers(self, full: Array) -> Array:
        numbers, delays = walker_numbers(self._sensors, full), self.compression.delays
        if delays is None:
            return numbers
        late = delays.numbers(self._sensors, full, self.compression.step)
        return np.concatenate([numbers, late], axis=1)

    def _walker_slopes(self, full: Array, along: Array) -> Array:
        """Return the slopes `(W q, n)` of what walkers have."""
        n, q, _ = along.shape
        along, delays = along.reshape(n * q, -1), self.compression.delays
        slopes = walker_slopes(self._sensors, np.repeat(full, q, axis=0), along)
        if delays is None:
            return slopes
        late = delays.slopes(self._sensors, along, self.compression.step)
        return np.concatenate([slopes, late], axis=1)

    @cached_property
    def _shared(self) -> dict[str, Any]:
        inputs = [value for value in self.experiment.constant.values() if value != 0.0]
        return {
            "numbers": np.array([self.compression.step, *inputs]),
            "frame": self.compression.basis.frame(self.compression.sizes, self.compression.first),
            "orders": np.array(self.compression.basis.orders, dtype=np.int64),
            "reference": self.compression.reference,
            "triangles": np.ascontiguousarray(self.compression.record.matrix),
            "projected": np.ascontiguousarray(self.compression.record.projected),
        }

    def _run(
        self, name: str, shape: BasisShape, groups: int, blocks: dict[str, Array], q: int = 0
    ) -> Array:
        """Run a kernel; returns its scratch."""
        _, alike, columns, _ = self.compression.record.matrix.shape
        scratch = np.empty((shape.scratch_size(columns, q), LANES))
        every = {**self._shared, **blocks, "scratch": scratch}
        size = columns**2
        counts = [groups, columns, size if alike > 1 else 0, alike * size, *([q] if q else [])]
        names = NORMAL_BLOCKS if q else BLOCKS
        kernel = compile_kernel(write_normal if q else write_squares, shape)
        kernel[name](*counts, *(every[block].ctypes.data for block in names))
        return scratch

    def __getstate__(self) -> dict[str, Any]:
        return {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}

    def with_record(self, y: Array) -> Simulator:
        """See `Simulator.with_record`: the exact simulator of another record."""
        return self.whole.with_record(y)


def even_record(simulator: Simulator) -> LongRecord | None:
    """Return the record of a linear rig that has one step; None of others."""
    experiment, sensing = simulator.experiment, simulator.sensing
    sensors = SensorParameters(simulator.model, experiment, sensing)
    if simulator.stepping is not None or len(experiment.t) < 2:
        return None
    if not simulator.exact:
        grid = build_grid(sensors.knots[0])
        record = LongRecord(sensors, float(grid.spans[0]), len(grid.t) - 1, grid.at)
        return record if grid.uniform else None
    if sensors.lead:
        return None
    # Steps that are nearly one are one.
    return LongRecord(sensors, experiment.dt, len(experiment.t))


def obstacle(simulator: Simulator) -> str:
    """Say in words why a record cannot be compressed whatever the parameters; empty where it can."""
    if simulator.stepping is not None:
        return "the rig has dry friction or inputs with lags, and is stepped"
    return "its samples are not evenly spaced" if even_record(simulator) is None else ""


def compress(simulator: Simulator, points: Array, variances: Array, weights: Array) -> Compression:
    """Compress a record for rigs near `points (n, P)`; the first is the reference.

    `variances (K,)`: of the noise.  `weights (K, sums)`: of sums of squares in minus twice the log
    likelihood, which may be wrong by `TOLERANCE`; see `Noise.square_weights`.  Raises
    `CompressionError` where it cannot be done: see `obstacle`, and where modes do not decay, or poles
    are too far apart.
    """
    record = even_record(simulator)
    if record is None:
        raise CompressionError(obstacle(simulator))
    delays = Delays.near(record.sensors, points, record.step)
    shifted = record if delays is None else dataclasses.replace(record, shifts=delays.shifts)
    return _Compressor(simulator, shifted, variances, weights, delays).compression(points)


@dataclass(frozen=True, slots=True)
class _Compressor:
    """Compresses a `record`; `variances (K,)` and `weights (K, sums)` as `compress` has them."""

    simulator: Simulator
    record: LongRecord
    variances: Array
    weights: Array
    delays: Delays | None

    def compression(self, points: Array) -> Compression:
        with np.errstate(all="ignore"):
            rates = self.record.sensors.linear_system(points)[0]
        inputs = self.record.inputs(0, self.record.count)
        sizes = np.linalg.norm(inputs - np.array(self.record.first_inputs), axis=0)
        basis = self._sufficient(rates, points, sizes)
        columns = self._shape(basis).columns(basis.orders)
        known = triangle(self._blocks(basis, points[0]), columns, self._sums)
        made = self._with(basis, known, sizes)
        reference = made.coefficients(points[:1], late=False)
        return dataclasses.replace(made.compression, reference=reference)

    def _sufficient(self, rates: Array, points: Array, sizes: Array) -> Basis:
        """Return the fewest functions whose bound is small enough at nearly all points."""
        for digits in range(*DIGITS):
            basis = choose_basis(rates, self.record.step, 10.0**-digits)
            columns = self._shape(basis).columns(basis.orders)
            padded = columns + -columns % ROWS
            k_count, sums = self.weights.shape
            matrix = np.zeros((sums, 1, padded, padded))
            empty = Triangle(matrix, np.zeros((k_count, sums, padded + 1)))
            n = np.array(self.simulator.experiment.counts, dtype=float)
            usual = np.stack([n, 4.0 * n, np.full(k_count, 2.0)], axis=1)[:, :sums]
            empty.projected[..., -1] = self.variances[:, None] * usual
            made = self._with(basis, empty, sizes)
            if np.mean(made.beyond(*made.expanded(points))) <= MAX_BEYOND:
                return basis
        raise CompressionError("the bound of what functions leave stays too large")

    def _shape(self, basis: Basis) -> BasisShape:
        return basis_shape(self.record.sensors, basis, self._sums, self.delays)

    @property
    def _sums(self) -> int:
        return int(self.weights.shape[1])

    def _with(self, basis: Basis, known: Triangle, sizes: Array) -> CompressedSimulator:
        """Return a simulator whose reference is nothing yet."""
        each = {f"series {s}": float(size) for s, size in enumerate(sizes)}
        each |= {"impulse": 1.0, "constant": float(np.sqrt(self.record.count))}
        compression = Compression(
            basis=basis,
            record=known,
            reference=np.zeros((known.matrix.shape[-1], len(self.weights))),
            tolerance=2.0 * TOLERANCE / np.maximum(np.abs(self.weights), LEAST) / self.weights.size,
            step=self.record.step,
            sizes=tuple(each[source] for source in self._shape(basis).sources),
            first=self.record.first_inputs,
            delays=self.delays,
        )
        return CompressedSimulator(self.simulator, compression)

    def _blocks(self, basis: Basis, reference: Array) -> Iterator[tuple[Array, Array]]:
        """Yield columns `(m, n)` at samples, and what the reference leaves of them `(m, K)`."""
        shape = self._shape(basis)
        start = impulse_columns(basis) if shape.impulse else None
        driven = Columns(basis, int(shape.constant) + shape.layout.n_series)
        begin, knot = np.array(self.record.first_inputs), 0
        for inputs, left in self.record.residuals(reference):
            for first in range(0, len(inputs), BLOCK):
                u = inputs[first : first + BLOCK] - begin
                ones = np.ones((len(u), 1))
                parts = [] if start is None else [start.block(np.zeros((len(u), 1)))]
                parts.append(
                    driven.block(np.concatenate([ones, u], axis=1) if shape.constant else u)
                )
                parts += [u] if shape.layout.first_order else []
                for ahead in range(shape.inputs_ahead):
                    last = knot + len(u) + ahead
                    parts.append(self.record.inputs(knot + ahead, last) - begin)
                knot += len(u)
                here = left[first : first + BLOCK]
                known = ~np.isnan(here).all(axis=1)
                yield np.concatenate([*parts, ones], axis=1)[known], here[known]


def basis_shape(
    sensors: SensorParameters, basis: Basis, sums: int, delays: Delays | None
) -> BasisShape:
    """Return what kernels are specialised for."""
    experiment = sensors.experiment
    return BasisShape(
        layout=input_layout(sensors.observed_model, experiment),
        poles=basis.kinds,
        integrators=basis.integrators,
        channels=len(experiment.channels),
        impulse=starts(sensors),
        sums=sums,
        delays=0 if delays is None else delays.steps,
    )
