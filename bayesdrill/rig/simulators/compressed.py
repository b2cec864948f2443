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
from bayesdrill.rig.kernels.exponential import Layout, present
from bayesdrill.rig.kernels.lanes import LANES
from bayesdrill.rig.kernels.rational_basis import ROWS, BasisShape
from bayesdrill.rig.kernels.sums import SQUARES, ResidualSums
from bayesdrill.rig.models.linear import Tangent
from bayesdrill.rig.simulators.contract import Motion, Simulator, Steps, in_groups
from bayesdrill.rig.simulators.rational_basis import (
    BLOCK,
    Basis,
    Columns,
    Long,
    NoBasisError,
    Triangle,
    choose_basis,
    impulse_columns,
    long_exponential,
    long_states,
    triangle,
)
from bayesdrill.rig.simulators.sensors import ObservationModel, SensorParameters
from bayesdrill.rig.simulators.time_grid import Grid, build_grid

PART = 1 << 18  # samples that are looked at together
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
        return self.whole.model

    @property
    def experiment(self) -> Experiment:  # type: ignore[override]
        return self.whole.experiment

    @property
    def sensing(self) -> ObservationModel:  # type: ignore[override]
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
    ) -> None:
        alike, columns, _ = self.compression.record.matrix.shape
        scratch = np.empty((shape.scratch_size(columns, q), LANES))
        every = {**self._shared, **blocks, "scratch": scratch}
        counts = [groups, columns, columns**2 if alike > 1 else 0, *([q] if q else [])]
        names = NORMAL_BLOCKS if q else BLOCKS
        kernel = compile_kernel(write_normal if q else write_squares, shape)
        kernel[name](*counts, *(every[block].ctypes.data for block in names))

    def __getstate__(self) -> dict[str, Any]:
        return {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}

    def with_record(self, y: Array) -> Simulator:
        """See `Simulator.with_record`: the exact simulator of another record."""
        return self.whole.with_record(y)


def _with_bounds(squares: Array, sizes: Array) -> tuple[Array, Array]:
    """Return squares `(W, K)`, and what they may be wrong by, where so much is left of residuals."""
    with np.errstate(all="ignore"):
        return squares, 2.0 * np.sqrt(squares) * sizes + sizes**2


def uniform_grid(simulator: Simulator) -> Grid | None:
    """Return the grid of a record that has one step, None of others."""
    sensors = SensorParameters(simulator.model, simulator.experiment, simulator.sensing)
    experiment = simulator.experiment
    if simulator.stepping is not None or simulator.sensing.shifts or len(experiment.t) < 2:
        return None
    if simulator.exact:  # steps that are nearly one are one
        if sensors.lead:
            return None
        return build_grid(np.asarray(experiment.dt * np.arange(len(experiment.t))))
    grid = build_grid(sensors.knots[0])
    return grid if grid.uniform else None


def basis_shape(sensors: SensorParameters, basis: Basis, *, tangent: bool) -> BasisShape:
    """Return what kernels are specialised for."""
    experiment, model = sensors.experiment, sensors.observed_model
    series, constant = tuple(experiment.series), present(experiment.constant)
    return BasisShape(
        layout=Layout.from_model(
            Tangent(model) if tangent else model, series, constant,
            first_order=experiment.first_order,
        ),
        poles=basis.kinds,
        integrators=basis.integrators,
        channels=len(experiment.channels),
        impulse=starts(sensors),
        tangent=tangent,
    )  # fmt: skip


def starts(sensors: SensorParameters) -> bool:
    """Tell whether the start moves the rig, or may."""
    sensing, start = sensors.sensing, sensors.experiment.start
    return sensing.steady or bool(sensing.states) or any(start.values())


def walker_numbers(sensors: SensorParameters, full: Array) -> Array:
    """Return what walkers `full (W, P)` have: parameters, start, rows `(W, P' + X + K (X + 1))`."""
    n = len(full)
    system = sensors.linear_system(full) if sensors.sensing.steady else None
    start = sensors.initial_state(system, full)
    rows = sensors.rows(sensors.gains(full), full)
    return np.concatenate([sensors.simulator_parameters(full), start, rows.reshape(n, -1)], axis=1)


def walker_slopes(sensors: SensorParameters, full: Array, along: Array) -> Array:
    """Return the slopes of `walker_numbers` at `full (n, P)` along `along (n, P)`."""
    n = len(full)
    system = sensors.tangent_system(full, along) if sensors.sensing.steady else None
    start = sensors.initial_state_slope(system, along)
    gains = sensors.channel_values(sensors.sensing.gains, along)
    rows = sensors.rows(gains, along)
    return np.concatenate([sensors.simulator_parameters(along), start, rows.reshape(n, -1)], axis=1)


def first_inputs(sensors: SensorParameters) -> tuple[float, ...]:
    """Return the first of each series that changes straight, zero for those that are held."""
    straight = sensors.experiment.first_order
    return tuple(float(u[0]) if straight else 0.0 for u in sensors.knots[1].values())


def source_sizes(shape: BasisShape, sensors: SensorParameters, grid: Grid) -> list[float]:
    """Return the root of the sum of squares of what drives the rig, of each source."""
    samples = len(grid.t) - 1
    known = {"impulse": 1.0, "constant": float(np.sqrt(samples))}
    series = [
        float(np.linalg.norm(u - first))
        for u, first in zip(sensors.knots[1].values(), first_inputs(sensors), strict=True)
    ]
    ratio = samples / max(1, len(sensors.knots[0]))
    each = {f"series {s}": float(size * np.sqrt(ratio) * 1.01) for s, size in enumerate(series)}
    return [(known | each)[source] for source in shape.sources]


def compress(simulator: Simulator, points: Array, variances: Array) -> Compression | str:
    """Compress a record for rigs near `points (n, P)`; the first is the reference.

    `variances (K,)`: of the noise, of which sums of squares may be wrong by `TOLERANCE`.  Returns why it
    cannot be done, in words, for a rig with friction, steps of many lengths, delays, modes that do not
    decay, or poles that are known too little.
    """
    if reason := obstacle(simulator):
        return reason
    grid = uniform_grid(simulator)
    assert grid is not None
    sensors = SensorParameters(simulator.model, simulator.experiment, simulator.sensing)
    with np.errstate(all="ignore"):
        rates = sensors.linear_system(points)[0]
    try:
        basis = _sufficient_basis(simulator, rates, grid, points, variances)
    except NoBasisError as error:
        return str(error)
    shape = basis_shape(sensors, basis, tangent=False)
    columns = shape.columns(basis.orders)
    blocks = _record_blocks(_LongRecord(sensors, shape, grid), basis, points[0])
    record = triangle(blocks, columns)
    made = _without_reference(simulator, basis, record, variances, grid)
    coefficients = _coefficients(made, points[:1])
    return dataclasses.replace(made.compression, reference=coefficients)


def obstacle(simulator: Simulator) -> str:
    """Say in words why a record cannot be compressed whatever the parameters; empty where it can."""
    if simulator.stepping is not None:
        return "the rig has dry friction or inputs with lags, and is stepped"
    if simulator.sensing.shifts:
        return "channels or inputs have an unknown delay"
    return "" if uniform_grid(simulator) is not None else "its samples are not evenly spaced"


def _sufficient_basis(
    simulator: Simulator, rates: Array, grid: Grid, points: Array, variances: Array
) -> Basis:
    """Return the fewest functions whose bound is small enough at nearly all points."""
    sensors = SensorParameters(simulator.model, simulator.experiment, simulator.sensing)
    for digits in range(*DIGITS):
        basis = choose_basis(rates, float(grid.spans[0]), 10.0**-digits)
        columns = basis_shape(sensors, basis, tangent=False).columns(basis.orders)
        padded = columns + -columns % ROWS
        empty = Triangle(np.zeros((1, padded, padded)), np.zeros((len(variances), padded + 1)))
        empty.projected[:, -1] = variances * simulator.experiment.counts
        made = _without_reference(simulator, basis, empty, variances, grid)
        if np.mean(made.beyond(*made.expanded(points))) <= MAX_BEYOND:
            return basis
    raise NoBasisError("the bound of what functions leave stays too large")


def _without_reference(
    simulator: Simulator, basis: Basis, record: Triangle, variances: Array, grid: Grid
) -> CompressedSimulator:
    sensors = SensorParameters(simulator.model, simulator.experiment, simulator.sensing)
    sizes = source_sizes(basis_shape(sensors, basis, tangent=False), sensors, grid)
    reference = np.zeros((record.matrix.shape[1], len(variances)))
    tolerance = 2.0 * TOLERANCE * variances / len(variances)
    compression = Compression(
        basis,
        record,
        reference,
        tolerance,
        float(grid.spans[0]),
        tuple(sizes),
        first_inputs(sensors),
    )
    return CompressedSimulator(simulator, compression)


def _coefficients(made: CompressedSimulator, full: Array) -> Array:
    """Return the coefficients `(n, K)` of the reference: the kernel's own, to the last digit."""
    shape, columns = made._shape, made.compression.record.matrix.shape[1]
    blocks = in_groups(made._walkers(full))
    scratch = np.empty((shape.scratch_size(columns), LANES))
    out = np.empty((1, 2 * shape.channels, LANES))
    every = {**made._shared, "walkers": blocks, "out": out, "scratch": scratch}
    kernel = compile_kernel(write_squares, shape)
    kernel["squares"](1, columns, 0, *(every[block].ctypes.data for block in BLOCKS))
    first = shape.layout.size**2 + 3 * len(shape.poles) * shape.decaying**2
    return np.ascontiguousarray(
        scratch[first : first + columns * shape.channels, 0].reshape(columns, -1)
    )


@dataclass(frozen=True, slots=True)
class _LongRecord:
    """A record on its grid, in parts: inputs, what is measured, and what a reference leaves of it."""

    sensors: SensorParameters
    shape: BasisShape
    grid: Grid

    def inputs(self, first: int, last: int) -> Array:
        """Return the sampled inputs at knots `first` to `last`, `(last - first, S)`."""
        knots, grid = np.arange(first, min(last, len(self.grid.t) - 1)), self.grid
        columns = []
        for u in self.sensors.knots[1].values():
            if self.shape.layout.first_order:
                columns.append(np.interp(grid.t[knots], grid.t[grid.at], u))
            else:
                columns.append(u[np.searchsorted(grid.at, knots, side="right") - 1])
        inputs = np.array(columns).reshape(len(columns), len(knots)).T
        beyond = last - first - len(knots)
        return np.concatenate([inputs, np.repeat(inputs[-1:], beyond, axis=0)])

    def parts(self, full: Array) -> Iterator[tuple[Array, Array]]:
        """Yield inputs `(m, S)` and what the reference `full (P,)` leaves `(m, K)`, NaN if not seen."""
        layout, x = self.shape.layout, self.shape.states
        numbers = walker_numbers(self.sensors, full[None])[0]
        p = self.shape.parameters
        constants = [value for value in self.sensors.experiment.constant.values() if value != 0.0]
        matrix = np.zeros((layout.size, layout.size), dtype=Long)
        for row, column, value in layout.entries([*numbers[:p], *constants]):
            matrix[row, column] += value if row >= x else Long(value) * Long(self.grid.spans[0])
        step = long_exponential(matrix)
        rows = numbers[p + x :].reshape(self.shape.channels, x + 1).astype(Long)
        state, y = numbers[p : p + x].astype(Long), self.sensors.padded
        for first in range(0, len(self.grid.t) - 1, PART):
            last = min(first + PART, len(self.grid.t) - 1)
            u = self.inputs(first, last + 1).astype(Long)
            drive = step[:x, x] + u[:-1] @ step[:x, x + 1 : x + 1 + layout.n_series].T
            if layout.first_order:
                drive = drive + np.diff(u, axis=0) @ step[:x, x + 1 + layout.n_series :].T
            states = long_states(step[:x, :x], drive, state)
            left = -(states[:-1] @ rows[:, :x].T + rows[:, x])
            state, here = states[-1], slice(*np.searchsorted(self.grid.at, [first, last]))
            seen = np.full(left.shape, np.nan)
            at = self.grid.at[here] - first
            seen[at] = y[here] + left[at]
            yield u[:-1].astype(float), seen


def _record_blocks(
    record: _LongRecord, basis: Basis, reference: Array
) -> Iterator[tuple[Array, Array]]:
    """Yield columns `(m, n)` at knots with samples, and what the reference leaves of them `(m, K)`."""
    shape = record.shape
    start = impulse_columns(basis) if shape.impulse else None
    driven = Columns(basis, int(shape.constant) + shape.layout.n_series)
    begin = np.array(first_inputs(record.sensors))
    for inputs, left in record.parts(reference):
        for first in range(0, len(inputs), BLOCK):
            u = inputs[first : first + BLOCK] - begin
            ones = np.ones((len(u), 1))
            parts = [] if start is None else [start.block(np.zeros((len(u), 1)))]
            parts.append(driven.block(np.concatenate([ones, u], axis=1) if shape.constant else u))
            parts += [u] if shape.layout.first_order else []
            here = left[first : first + BLOCK]
            known = ~np.isnan(here).all(axis=1)
            yield np.concatenate([*parts, ones], axis=1)[known], here[known]
