"""A record with a missing torque in a few hundred numbers: its Kalman filter's sums of squares.

See `kernels.compressed_filter`; other than for rigs, channels are sources beside the inputs, and
what the record becomes are innovations.  Slopes and smoothing have all samples.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from bayesdrill.basics.arrays import Array, Flags
from bayesdrill.rig.kernels.compiling import compile_kernel
from bayesdrill.rig.kernels.compressed_filter import (
    turning_angle,
    write_closed_loop,
    write_compressed_filter,
)
from bayesdrill.rig.kernels.lanes import LANES
from bayesdrill.rig.simulators.compressed import (
    MAX_BEYOND,
    TOLERANCE,
    Compression,
    column_blocks,
    even_record,
)
from bayesdrill.rig.simulators.contract import Simulator, in_groups
from bayesdrill.rig.simulators.kalman import KalmanFilter
from bayesdrill.rig.simulators.long_record import Long, LongRecord
from bayesdrill.rig.simulators.rational_basis import CompressionError, basis_of

DIGITS = (4, 26, 2)  # of a response that functions are to have: first, last, and steps between
FAR = 0.1  # of points, that may have no bound: filters move far with the torque, others are closer


@dataclass(frozen=True, eq=False, repr=False)
class CompressedFilter(KalmanFilter):
    """A filter by the record's triangle, and by all samples where that is not enough."""

    compression: Compression

    @property
    def by_samples(self) -> KalmanFilter:
        """See `KalmanFilter.by_samples`."""
        return KalmanFilter(self.model, self.torque, self.experiment)

    @property
    def functions(self) -> int:
        """See `KalmanFilter.functions`."""
        return len(self.compression.reference)

    def log_density(self, parameters: Array, sigmas: Array, record: Mapping[str, int]) -> Array:
        """See `KalmanFilter.log_density`."""
        terms, errors, _ = self.expanded(parameters, sigmas)
        if (far := np.flatnonzero(~(errors <= TOLERANCE))).size:
            terms[far] = super().log_density(parameters[far], sigmas[far], record)
        return terms

    def exceeds_bound(self, parameters: Array, sigmas: Array) -> Flags:
        """See `KalmanFilter.exceeds_bound`."""
        return np.asarray(~(self.expanded(parameters, sigmas)[1] <= TOLERANCE))

    def expanded(self, parameters: Array, sigmas: Array) -> tuple[Array, Array, Array]:
        """Return log-densities `(W, K)` by the triangle, and what they may be wrong by `(W,)`.

        With them come the coefficients `(n, K)` of the first of the last group of walkers, less the
        reference's.
        """
        k, columns, count = self.system.k, self.functions, len(parameters)
        known, shape = self.compression, self.compression.shape
        walkers = in_groups(parameters, sigmas**2)
        bounds = np.empty((len(walkers), k, LANES))
        out = np.empty((2 * k + 1, len(walkers) * LANES))
        scratch = np.empty((shape.scratch_size(columns, 2), LANES))
        compile_kernel(write_compressed_filter, self.system, self.layout, shape).call("steadily", {
            "groups": len(walkers), "samples": len(self.experiment.t), "columns": columns,
            "channel": 0, "sum": columns**2, "told": walkers, "constants": self.constants[1],
            "scratch": scratch, "bounds": bounds, "out": out, **known.blocks,
        })  # fmt: skip
        with np.errstate(all="ignore"):
            sizes = bounds.swapaxes(0, 1).reshape(k, -1) / out[k : 2 * k]
            # The first rows are minus half the sums of squares over the variances: of each sample one.
            squares = np.fmax(np.abs(2.0 * out[:k]), len(self.experiment.t))
            errors = (np.sqrt(squares) * sizes + 0.5 * sizes**2).sum(axis=0)
            terms = self._terms(out)
        coefficients = scratch[shape.coefficients_at :][: columns * k, 0].reshape(columns, k)
        return terms[:count], errors[:count], np.ascontiguousarray(coefficients)


Reactions = tuple[Array, Array, Array]


def closed_loops(filtered: KalmanFilter, parameters: Array, sigmas: Array) -> Reactions:
    """Return how a state or a channel changes predictions, and the next state, of walkers.

    They are `(W, X + K, K)` and `(W, X + K, X)`; then columns after those of Phi `(W, C, X)`.
    """
    n, k, count = filtered.system.n, filtered.system.k, filtered.layout.size
    walkers, size = in_groups(parameters, sigmas**2), (n + k) ** 2
    closed = np.empty((len(walkers), size + n * (count - n), LANES))
    compile_kernel(write_closed_loop, filtered.system, filtered.layout).call("steadily", {
        "groups": len(walkers), "samples": len(filtered.experiment.t), "told": walkers,
        "constants": filtered.constants[1], "closed": closed,
        "out": np.empty((2 * k + 1, len(walkers) * LANES)),
    })  # fmt: skip
    rows = closed.transpose(0, 2, 1).reshape(len(walkers) * LANES, -1)[: len(parameters)]
    reactions, columns = rows[:, :size].reshape(-1, n + k, k + n), rows[:, size:]
    return reactions[..., :k], reactions[..., k:], columns.reshape(-1, count - n, n)


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
    record, k_count = even_record(response), filtered.system.k
    if record is None or filter_obstacle(response):
        raise CompressionError(filter_obstacle(response))
    with np.errstate(all="ignore"):
        loops = closed_loops(filtered, parameters, sigmas)
    x = loops[2].shape[2]
    falls = loops[1][:, :x].swapaxes(1, 2) - np.eye(x)
    inputs, (y, before) = record.inputs(0, record.count), _channel_sources(filtered)
    sources = np.concatenate([inputs - record.first_inputs, y], axis=1)
    sizes = np.hypot(np.linalg.norm(sources, axis=0), np.append(0.0 * inputs[0], before))
    share = 1.0
    for digits in range(*DIGITS):
        basis = basis_of(falls, np.zeros((x, 0)), 10.0**-digits)
        nothing = Compression.of_nothing(
            basis, record, sizes, layout=filtered.layout, channels=k_count, impulse=True,
            measured=k_count,
        )  # fmt: skip
        made = CompressedFilter(filtered.model, filtered.torque, filtered.experiment, nothing)
        before_that, share = share, float(np.mean(made.exceeds_bound(parameters, sigmas)))
        if share <= MAX_BEYOND or share == before_that <= FAR:  # more functions would not help
            break
    if share > FAR:
        raise CompressionError("the bound of what functions leave stays too large")
    start = np.array(filtered.augmented.initial_state(filtered.experiment.start))
    first = (loops[0][0], loops[1][0], loops[2][0])
    left = _innovations(first, record, y, start + before @ loops[1][0, x:])
    blocks = column_blocks(record, basis, nothing.shape, left, before)
    known = nothing.triangle(blocks, [slice(0, k_count)])
    reference = made.expanded(parameters[:1], sigmas[:1])[2]
    compression = dataclasses.replace(nothing, record=known, reference=reference)
    return dataclasses.replace(made, compression=compression)


def _innovations(
    loop: Reactions, record: LongRecord, y: Array, start: Array
) -> Iterator[tuple[Array, Array]]:
    """Yield inputs and channels `(m, S + K)`, and innovations `(m, K)`, in long numbers.

    `y (T, K)`: what channels are as sources; `start (X,)`.
    """
    x, first = len(start), 0
    predictions, following, columns = (part.astype(Long) for part in loop)
    fall = following[:x].T - np.eye(x, dtype=Long)
    sources = (y, following[x:])
    for inputs, states in record.courses(fall, columns, start.astype(Long), sources):
        seen = y[first : first + len(inputs)]
        first += len(inputs)
        left = -(states @ predictions[:x] + seen @ predictions[x:])
        yield np.concatenate([inputs, seen], axis=1), np.asarray(left, dtype=float)


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
