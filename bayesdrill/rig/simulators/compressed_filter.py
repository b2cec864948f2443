"""A record with a missing torque in a few hundred numbers: its Kalman filter's sums of squares.

See `kernels.compressed_filter`; other than for rigs, channels are sources beside the inputs, and
what the record becomes are innovations.  Slopes and smoothing have all samples.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from bayesdrill.basics.arrays import PART, Array, Counts, Flags
from bayesdrill.rig.kernels.compiling import HIGH_OPT_LEVEL, Kernel, compile_kernel
from bayesdrill.rig.kernels.compressed_filter import (
    BLOCKS,
    CLOSED_BLOCKS,
    turning_angle,
    write_closed_loop,
    write_compressed_filter,
)
from bayesdrill.rig.kernels.lanes import LANES
from bayesdrill.rig.kernels.rational_basis import BasisShape
from bayesdrill.rig.simulators.compressed import (
    TOLERANCE,
    column_blocks,
    even_record,
)
from bayesdrill.rig.simulators.contract import Simulator, in_groups
from bayesdrill.rig.simulators.kalman import KalmanFilter
from bayesdrill.rig.simulators.long_record import Long, LongRecord, long_states
from bayesdrill.rig.simulators.rational_basis import (
    Basis,
    CompressionError,
    Triangle,
    basis_of,
    triangle,
)

DIGITS = (4, 26, 2)  # of a response that functions are to have: first, last, and steps between
MAX_BEYOND = 0.1  # of points, most of which are far from the reference: they have all samples


@dataclass(frozen=True, eq=False, kw_only=True)
class FilterCompression:
    """A record along functions of a filter; see `compressed.Compression`."""

    shape: BasisShape
    orders: Counts
    frame: Array
    record: Triangle
    reference: Array


@dataclass(frozen=True)
class CompressedFilter(KalmanFilter):
    """A filter by the record's triangle, and by the `whole` one where that is not enough."""

    compression: FilterCompression = field(kw_only=True, repr=False, compare=False)

    @property
    def by_samples(self) -> KalmanFilter:
        """See `KalmanFilter.by_samples`."""
        return KalmanFilter(self.model, self.torque, self.experiment)

    @property
    def functions(self) -> int:
        """See `KalmanFilter.functions`."""
        return int(self.compression.record.matrix.shape[-1])

    def log_density(self, parameters: Array, sigmas: Array, record: tuple[int, int]) -> Array:
        """See `KalmanFilter.log_density`."""
        terms, errors = self.expanded(parameters, sigmas)
        if (far := np.flatnonzero(~(errors <= TOLERANCE))).size:
            terms[far] = super().log_density(parameters[far], sigmas[far], record)
        return terms

    def exceeds_bound(self, parameters: Array, sigmas: Array) -> Flags:
        """See `KalmanFilter.exceeds_bound`."""
        return np.asarray(~(self.expanded(parameters, sigmas)[1] <= TOLERANCE))

    def expanded(self, parameters: Array, sigmas: Array) -> tuple[Array, Array]:
        """Return log-densities `(W, K)` by the triangle, and what they may be wrong by `(W,)`."""
        return self._expanded(parameters, sigmas)[:2]

    def coefficients(self, parameters: Array, sigmas: Array) -> Array:
        """Return the coefficients `(n, K)` of one walker, less the reference's."""
        shape, n = self.compression.shape, self.functions
        first = self._expanded(parameters, sigmas)[2][shape.coefficients_at :, 0]
        return np.ascontiguousarray(first[: n * shape.channels].reshape(n, -1))

    def _expanded(self, parameters: Array, sigmas: Array) -> tuple[Array, Array, Array]:
        known, k = self.compression, self.system.k
        columns, size = self.functions, self.functions**2
        walkers = in_groups(parameters, sigmas**2)
        bounds = np.empty((len(walkers), k, LANES))
        out = np.empty((2 * k + 1, len(walkers) * LANES))
        scratch = np.empty((known.shape.scratch_size(columns, 2), LANES))
        blocks = {
            "told": walkers, "constants": self.constants[0], "frame": known.frame,
            "orders": known.orders, "reference": known.reference, "bounds": bounds, "out": out,
            "triangles": known.record.matrix, "projected": known.record.projected,
            "scratch": scratch,
        }  # fmt: skip
        counts = (len(walkers), len(self.experiment.t), columns, 0, size)
        self._compressed["steadily"](*counts, *(blocks[name].ctypes.data for name in BLOCKS))
        with np.errstate(all="ignore"):
            sizes = bounds.swapaxes(0, 1).reshape(k, -1) / out[k : 2 * k]
            # The first rows are minus half the sums of squares over the variances: of each sample one.
            squares = np.fmax(np.abs(2.0 * out[:k]), len(self.experiment.t))
            errors = (np.sqrt(squares) * sizes + 0.5 * sizes**2).sum(axis=0)
            terms = self._terms(out)
        return terms[: len(parameters)], errors[: len(parameters)], scratch

    @cached_property
    def _compressed(self) -> Kernel:
        structures = (self.system, self.layout, self.compression.shape)
        return compile_kernel(write_compressed_filter, *structures, effort=HIGH_OPT_LEVEL)


@dataclass(frozen=True, slots=True)
class ClosedLoops:
    """Filters `(n, ...)`: how a state or a channel changes predictions `(K,)`, and the next state.

    `predictions (n, X + K, K)`, `following (n, X + K, X)`; `columns (n, C, X)`: after those of Phi.
    """

    predictions: Array
    following: Array
    columns: Array

    @classmethod
    def of(cls, filtered: KalmanFilter, parameters: Array, sigmas: Array) -> ClosedLoops:
        """Return those of walkers `parameters (n, P)`, `sigmas (n, K)`."""
        n, k, count = filtered.system.n, filtered.system.k, filtered.layout.size
        walkers = in_groups(parameters, sigmas**2)
        size, first = (n + k) * (k + n), len(parameters)
        blocks = {
            "told": walkers, "constants": filtered.constants[0],
            "closed": np.empty((len(walkers), size + n * (count - n), LANES)),
            "out": np.empty((2 * k + 1, len(walkers) * LANES)),
        }  # fmt: skip
        kernel = compile_kernel(write_closed_loop, filtered.system, filtered.layout)
        addresses = (blocks[name].ctypes.data for name in CLOSED_BLOCKS)
        kernel["steadily"](len(walkers), len(filtered.experiment.t), *addresses)
        rows = blocks["closed"].transpose(0, 2, 1).reshape(len(walkers) * LANES, -1)[:first]
        reactions = rows[:, :size].reshape(first, n + k, k + n)
        columns = rows[:, size:].reshape(first, count - n, n)
        return cls(reactions[..., :k], reactions[..., k:], columns)

    def falls(self) -> Array:
        """Return Phi (1 - K C) - 1, `(n, X, X)`."""
        x = self.following.shape[2]
        return self.following[:, :x].swapaxes(1, 2) - np.eye(x)

    def innovations(
        self, record: LongRecord, y: Array, start: Array
    ) -> Iterator[tuple[Array, Array]]:
        """Yield inputs and channels `(m, S + K)`, and the first filter's innovations `(m, K)`.

        `y (T, K)`: what channels are as sources; `start (X,)`.
        """
        x, series = self.following.shape[2], record.layout.n_series
        fall, columns = self.falls()[0].astype(Long), self.columns[0].astype(Long)
        state = start.astype(Long)
        predictions, following = (
            part[0].astype(Long) for part in (self.predictions, self.following)
        )
        for first in range(0, len(y), PART):
            last = min(first + PART, len(y))
            inputs, seen = record.inputs(first, last + 1), y[first:last]
            u = inputs.astype(Long)
            drive = columns[0] + u[:-1] @ columns[1 : 1 + series] + seen @ following[x:]
            if record.layout.first_order:
                drive = drive + np.diff(u, axis=0) @ columns[1 + series :]
            states = long_states(fall, drive, state)
            state = states[-1]
            left = -(states[:-1] @ predictions[:x] + seen @ predictions[x:])
            yield np.concatenate([inputs[:-1], seen], axis=1), np.asarray(left, dtype=float)


def filter_obstacle(response: Simulator) -> str:
    """Say in words why a filter's record cannot be compressed; empty where it can."""
    if response.record is None or even_record(response) is None:
        return "a torque is missing, and samples are too, or are uneven, or sensors have unknowns"
    return ""


def compress_filter(
    filtered: KalmanFilter, response: Simulator, parameters: Array, sigmas: Array
) -> CompressedFilter:
    """Compress the record of a filter for walkers `parameters (n, P)` and `sigmas (n, K)`.

    The first is the reference.  Raises `CompressionError` where it cannot be done.
    """
    record = even_record(response)
    if record is None or filter_obstacle(response):
        raise CompressionError(filter_obstacle(response))
    with np.errstate(all="ignore"):
        loops = ClosedLoops.of(filtered, parameters, sigmas)
        falls = loops.falls()
    inputs, (y, before) = record.inputs(0, record.count), _channel_sources(filtered)
    sources = np.concatenate([inputs - record.first_inputs, y], axis=1)
    sizes = np.hypot(np.linalg.norm(sources, axis=0), np.append(0.0 * inputs[0], before))
    for digits in range(*DIGITS):
        basis = basis_of(falls, np.zeros((falls.shape[1], 0)), 10.0**-digits)
        made = _nothing(filtered, record, basis, sizes)
        if np.mean(made.exceeds_bound(parameters, sigmas)) <= MAX_BEYOND:
            break
    else:
        raise CompressionError("the bound of what functions leave stays too large")
    shape = made.compression.shape
    start = np.array(filtered.augmented.initial_state(filtered.experiment.start))
    start = start + before @ loops.following[0, len(start) :]
    left = loops.innovations(record, y, start)
    blocks = column_blocks(record, basis, shape, left, before)
    known = triangle(blocks, shape.columns(made.compression.orders), 1, [slice(0, shape.channels)])
    reference = made.coefficients(parameters[:1], sigmas[:1])
    compression = dataclasses.replace(made.compression, record=known, reference=reference)
    return dataclasses.replace(made, compression=compression)


def _channel_sources(filtered: KalmanFilter) -> tuple[Array, Array]:
    """Return channels as sources `(T, K)`, see `turning_angle`, and what they were before `(K,)`."""
    y, before = filtered.experiment.y, np.zeros(filtered.system.k)
    if (turning := turning_angle(filtered.system, filtered.layout)) is not None:
        state, k = turning
        weights = filtered.output_matrix[:, state]
        turned = y[:, k] / weights[k]
        y = y - turned[:, None] * weights
        y[:-1, k], y[-1, k], before[k] = np.diff(turned), 0.0, turned[0]
    return y, before


def _nothing(
    filtered: KalmanFilter, record: LongRecord, basis: Basis, sizes: Array
) -> CompressedFilter:
    """Return a filter of nothing, under inputs and channels of these `sizes`."""
    k_count = filtered.system.k
    shape = BasisShape(
        layout=filtered.layout, poles=tuple(pole.size for pole in basis.poles), integrators=0,
        channels=k_count, impulse=True, measured=k_count,
    )  # fmt: skip
    orders = np.array([pole.order for pole in basis.poles], dtype=np.int64)
    empty = triangle((), shape.columns(orders), 1, [slice(0, k_count)])
    still = [1.0] + [math.sqrt(record.count)] * shape.constant
    compression = FilterCompression(
        shape=shape,
        orders=orders,
        frame=basis.frame([*still, *sizes], record.first_inputs),
        record=empty,
        reference=np.zeros((empty.matrix.shape[-1], k_count)),
    )
    fields = (filtered.model, filtered.torque, filtered.experiment)
    return CompressedFilter(*fields, compression=compression)
