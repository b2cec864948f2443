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
    NoBasisError,
    Triangle,
    choose_basis,
    impulse_columns,
    triangle,
)
from bayesdrill.rig.simulators.sensors import ObservationModel, SensorParameters
from bayesdrill.rig.simulators.time_grid import build_grid

TOLERANCE = 1e-7  # of the log likelihood
MAX_BEYOND = 0.02  # of points: walkers whose bound is larger have the exact simulator
DIGITS = (12, 26, 2)  # of a response that functions are to have: first, last, and steps between


@dataclass(frozen=True, eq=False)
class Compression:
    """A record along the functions of a `basis`, which is small whatever the record's length.

    `reference (n, K)`: coefficients of the reference, from which all is a difference.  `tolerance
    (K,)`: what sums of squares may be wrong by.  `step`: of the record [s]; `sizes`: of what drives the
    rig, each the root of its sum of squares; `first`: of each series, from which it counts where it
    changes straight, else zero.
    """

    basis: Basis
    record: Triangle
    reference: Array
    tolerance: Array
    step: float
    sizes: tuple[float, ...]
    first: tuple[float, ...]

    def applied(self, simulator: Simulator) -> CompressedSimulator:
        """Return a simulator that has this compression, in the place of another where it has one."""
        whole = simulator.whole if isinstance(simulator, CompressedSimulator) else simulator
        return CompressedSimulator(whole, self)


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
        squares, errors = self.expanded(full)
        return self._mended(full, squares, errors)[..., None]

    def expanded(self, full: Array) -> tuple[Array, Array]:
        """Return sums of squares `(W, K)` by the triangle, and bounds of what they are wrong by."""
        blocks = in_groups(self._walkers(full))
        out = np.empty((len(blocks), 2 * self._k, LANES))
        self._run("squares", self._shape, len(blocks), {"walkers": blocks, "out": out})
        numbers = out.transpose(0, 2, 1).reshape(-1, self._k, 2)[: len(full)]
        return _with_bounds(numbers[..., 0], numbers[..., 1])

    def coefficients(self, full: Array) -> Array:
        """Return the coefficients `(n, K)` of one rig, less the reference's: the kernel's own."""
        blocks = {
            "walkers": in_groups(self._walkers(full)),
            "out": np.empty((1, 2 * self._k, LANES)),
        }
        scratch = self._run("squares", self._shape, 1, blocks)
        first, n = self._shape.coefficients_at, self.functions
        return np.ascontiguousarray(scratch[first : first + n * self._k, 0].reshape(n, self._k))

    def normal(self, full: Array, along: Array, scales: Array) -> tuple[Array, Array, Array]:
        """See `Simulator.normal`."""
        n, q, _ = along.shape
        with np.errstate(all="ignore"):
            walkers = self._walkers(full)
            slopes = self._walker_slopes(full, along)
        blocks = {
            "walkers": in_groups(walkers),
            "directions": in_groups(slopes.reshape(n, -1)),
            "scales": in_groups(scales),
        }
        k, groups = self._k, len(blocks["walkers"])
        blocks["out"] = np.empty((groups, 2 * k + q + q * q, LANES))
        self._run("normal", self._tangent_shape, groups, blocks, q)
        rows = blocks["out"].transpose(0, 2, 1).reshape(-1, 2 * k + q + q * q)[:n]
        numbers, slope, lower = np.split(rows, [2 * k, 2 * k + q], axis=1)
        squares, bounds = numbers[:, ::2], numbers[:, 1::2]
        products = np.tril(lower.reshape(n, q, q))
        products = products + np.tril(products, -1).swapaxes(1, 2)
        errors = _with_bounds(squares / scales**2, bounds)
        squares = squares.copy()
        if (far := np.flatnonzero(self.beyond(*errors))).size:
            squares[far], slope[far], products[far] = self.whole.normal(
                full[far], along[far], scales[far]
            )
        return squares, slope, products

    def beyond(self, squares: Array, errors: Array) -> Flags:
        """Tell of which walkers squares `(W, K)` may be wrong by too much: `(W,)`.

        That is by `TOLERANCE` of the log likelihood, or of how far it is below the reference's.
        """
        projected = self.compression.record.projected
        least = (projected[:, :-1] ** 2).sum(axis=1) + projected[:, -1]
        allowed = self.compression.tolerance + TOLERANCE * np.abs(squares - least)
        return np.asarray(~(errors <= allowed).all(axis=1))

    def _mended(self, full: Array, squares: Array, errors: Array) -> Array:
        """Return the squares, those of the exact simulator where errors may be too large."""
        far = np.flatnonzero(self.beyond(squares, errors))
        if len(far):
            squares = squares.copy()
            squares[far] = self.whole.squares(full[far])
        return squares

    @property
    def functions(self) -> int:
        """How many functions the record has become."""
        return int(self.compression.record.matrix.shape[1])

    @property
    def _k(self) -> int:
        return len(self.experiment.channels)

    @cached_property
    def _sensors(self) -> SensorParameters:
        return SensorParameters(self.model, self.experiment, self.sensing)

    @cached_property
    def _shape(self) -> BasisShape:
        return basis_shape(self._sensors, self.compression.basis, tangent=False)

    @cached_property
    def _tangent_shape(self) -> BasisShape:
        return basis_shape(self._sensors, self.compression.basis, tangent=True)

    def _walkers(self, full: Array) -> Array:
        return walker_numbers(self._sensors, full)

    def _walker_slopes(self, full: Array, along: Array) -> Array:
        """Return the slopes `(W q, n)` of what walkers have."""
        n, q, _ = along.shape
        return walker_slopes(self._sensors, np.repeat(full, q, axis=0), along.reshape(n * q, -1))

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
        alike, columns, _ = self.compression.record.matrix.shape
        scratch = np.empty((shape.scratch_size(columns, q), LANES))
        every = {**self._shared, **blocks, "scratch": scratch}
        counts = [groups, columns, columns**2 if alike > 1 else 0, *([q] if q else [])]
        names = NORMAL_BLOCKS if q else BLOCKS
        kernel = compile_kernel(write_normal if q else write_squares, shape)
        kernel[name](*counts, *(every[block].ctypes.data for block in names))
        return scratch

    def __getstate__(self) -> dict[str, Any]:
        return {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}

    def with_record(self, y: Array) -> Simulator:
        """See `Simulator.with_record`: the exact simulator of another record."""
        return self.whole.with_record(y)


def _with_bounds(squares: Array, sizes: Array) -> tuple[Array, Array]:
    """Return squares `(W, K)`, and what they may be wrong by, where so much is left of residuals."""
    with np.errstate(all="ignore"):
        return squares, 2.0 * np.sqrt(squares) * sizes + sizes**2


def even_record(simulator: Simulator) -> LongRecord | None:
    """Return the record of a linear rig that has one step and no delays; None of others."""
    experiment, sensing = simulator.experiment, simulator.sensing
    sensors = SensorParameters(simulator.model, experiment, sensing)
    if simulator.stepping is not None or sensing.shifts or len(experiment.t) < 2:
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
    if simulator.sensing.shifts:
        return "channels or inputs have an unknown delay"
    return "its samples are not evenly spaced" if even_record(simulator) is None else ""


def compress(simulator: Simulator, points: Array, variances: Array) -> Compression | str:
    """Compress a record for rigs near `points (n, P)`; the first is the reference.

    `variances (K,)`: of the noise, of which sums of squares may be wrong by `TOLERANCE`.  Returns why it
    cannot be done, in words: see `obstacle`, and where modes do not decay, or poles are too far apart.
    """
    record = even_record(simulator)
    if record is None:
        return obstacle(simulator)
    try:
        return _Compressor(simulator, record, variances).compression(points)
    except NoBasisError as error:
        return str(error)


@dataclass(frozen=True, slots=True)
class _Compressor:
    """Compresses a `record`; `variances (K,)`: of its noise."""

    simulator: Simulator
    record: LongRecord
    variances: Array

    def compression(self, points: Array) -> Compression:
        with np.errstate(all="ignore"):
            rates = self.record.sensors.linear_system(points)[0]
        inputs = self.record.inputs(0, self.record.count)
        sizes = np.linalg.norm(inputs - np.array(self.record.first_inputs), axis=0)
        basis = self._sufficient(rates, points, sizes)
        columns = self._shape(basis).columns(basis.orders)
        known = triangle(self._blocks(basis, points[0]), columns)
        made = self._with(basis, known, sizes)
        return dataclasses.replace(made.compression, reference=made.coefficients(points[:1]))

    def _sufficient(self, rates: Array, points: Array, sizes: Array) -> Basis:
        """Return the fewest functions whose bound is small enough at nearly all points."""
        for digits in range(*DIGITS):
            basis = choose_basis(rates, self.record.step, 10.0**-digits)
            columns = self._shape(basis).columns(basis.orders)
            padded = columns + -columns % ROWS
            k_count = len(self.variances)
            empty = Triangle(np.zeros((1, padded, padded)), np.zeros((k_count, padded + 1)))
            empty.projected[:, -1] = self.variances * self.simulator.experiment.counts
            made = self._with(basis, empty, sizes)
            if np.mean(made.beyond(*made.expanded(points))) <= MAX_BEYOND:
                return basis
        raise NoBasisError("the bound of what functions leave stays too large")

    def _shape(self, basis: Basis) -> BasisShape:
        return basis_shape(self.record.sensors, basis, tangent=False)

    def _with(self, basis: Basis, known: Triangle, sizes: Array) -> CompressedSimulator:
        """Return a simulator whose reference is nothing yet."""
        k_count = len(self.variances)
        each = {f"series {s}": float(size) for s, size in enumerate(sizes)}
        each |= {"impulse": 1.0, "constant": float(np.sqrt(self.record.count))}
        compression = Compression(
            basis=basis,
            record=known,
            reference=np.zeros((known.matrix.shape[1], k_count)),
            tolerance=2.0 * TOLERANCE * self.variances / k_count,
            step=self.record.step,
            sizes=tuple(each[source] for source in self._shape(basis).sources),
            first=self.record.first_inputs,
        )
        return CompressedSimulator(self.simulator, compression)

    def _blocks(self, basis: Basis, reference: Array) -> Iterator[tuple[Array, Array]]:
        """Yield columns `(m, n)` at samples, and what the reference leaves of them `(m, K)`."""
        shape = self._shape(basis)
        start = impulse_columns(basis) if shape.impulse else None
        driven = Columns(basis, int(shape.constant) + shape.layout.n_series)
        begin = np.array(self.record.first_inputs)
        for inputs, left in self.record.residuals(reference):
            for first in range(0, len(inputs), BLOCK):
                u = inputs[first : first + BLOCK] - begin
                ones = np.ones((len(u), 1))
                parts = [] if start is None else [start.block(np.zeros((len(u), 1)))]
                parts.append(
                    driven.block(np.concatenate([ones, u], axis=1) if shape.constant else u)
                )
                parts += [u] if shape.layout.first_order else []
                here = left[first : first + BLOCK]
                known = ~np.isnan(here).all(axis=1)
                yield np.concatenate([*parts, ones], axis=1)[known], here[known]


def basis_shape(sensors: SensorParameters, basis: Basis, *, tangent: bool) -> BasisShape:
    """Return what kernels are specialised for."""
    experiment, model = sensors.experiment, sensors.observed_model
    return BasisShape(
        layout=input_layout(Tangent(model) if tangent else model, experiment),
        poles=basis.kinds,
        integrators=basis.integrators,
        channels=len(experiment.channels),
        impulse=starts(sensors),
        tangent=tangent,
    )
