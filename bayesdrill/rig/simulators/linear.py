"""Compute the response of a linear rig to constant and sampled inputs, exact except for rounding.

A recurrence over the samples uses the matrix exponential of each distinct step length. If there are
many lengths, the action of the exponential on the state is computed at each step instead. A sampled
input is constant between samples (zero-order hold) or interpolated linearly (first-order hold). The
discrete system is exact for both holds (Van Loan 1978). Sensors may have delays, gains and offsets,
and the start may be unknown (`sensors`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.basics.duals import Dual, dual, linear_map
from bayesdrill.record.experiment import Experiment
from bayesdrill.rig.kernels.compiling import BoundFunction, compile_kernel
from bayesdrill.rig.kernels.exponential import present
from bayesdrill.rig.kernels.lanes import LANES
from bayesdrill.rig.kernels.linear import write_linear
from bayesdrill.rig.kernels.linear_arguments import SCALES, LinearShape
from bayesdrill.rig.kernels.sums import SQUARES, ResidualSums
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.simulators.contract import (
    Simulator,
    aligned,
    first_observed,
    in_groups,
    whitening_scales,
)
from bayesdrill.rig.simulators.long_record import LongRecord, input_layout, record_blocks
from bayesdrill.rig.simulators.sensors import ObservationModel, ObservedWalkers, join_flat
from bayesdrill.rig.simulators.time_grid import Grid, inputs_at_knots

# Largest number of values in a record whose signals a kernel stores for eight walkers at once.
MAX_GROUPED = 8_000_000
PERFECT = ObservationModel()
MAX_AHEAD = 4  # largest negative delay of a channel, as a multiple of the record's length


@dataclass(frozen=True, eq=False)
class Response(Simulator):
    """The response of `model` in `experiment` is observed by the sensors that `sensing` describes."""

    model: Model
    experiment: Experiment
    sensing: ObservationModel = PERFECT

    exact: ClassVar[bool] = True

    @cached_property
    def record(self) -> Mapping[str, Array] | None:
        """See `Simulator.record`; None unless times are even, sensors perfect, no sample missing."""
        experiment = self.experiment
        plain = self.sensing.empty and experiment.uniform and bool(experiment.is_measured.all())
        return record_blocks(experiment) if plain else None

    def signals(self, full: Array) -> Array:
        """Return the channels `(W, T, K)` in SI, for parameters `(W, P)`."""
        if self._padded.size > MAX_GROUPED and self.record is not None:
            record = LongRecord(self.sensors, self.experiment.dt, len(self._grid.t) - 1)
            return np.array([record.signals(point) for point in full])
        shape = (1, *self._padded.shape)
        return self._run(full, shape, tally=SQUARES, stored=True)[:, 0, self._samples]

    def course(self, full: Array, directions: Array) -> tuple[Array, Array]:
        """Return signals `(W, T, K)` and their slopes `(W, q, T, K)` in `directions`."""
        shape = (1 + directions.shape[1], *self._padded.shape)
        planes = self._run(full, shape, directions=directions, stored=True)[:, :, self._samples]
        return planes[:, 0], planes[:, 1:]

    def sums(self, full: Array, tally: ResidualSums, weights: Array | None = None) -> Array:
        """See `Simulator.sums`."""
        shape = (self._padded.shape[1], tally.count)
        return self._run(full, shape, tally=tally, weights=weights)

    def normal(self, full: Array, directions: Array, weights: Array) -> tuple[Array, Array, Array]:
        """See `Simulator.normal`; q is at least 1."""
        q, k = directions.shape[1], self._padded.shape[1]
        scales = whitening_scales(weights)
        if scales.shape[2] == 1:  # white noise: the previous sample has no weight
            scales = scales * np.array([1.0, 0.0, 1.0])
        flat = scales.swapaxes(1, 2).reshape(len(scales), -1)
        rows = self._run(full, (k + (1 + q) ** 2,), directions=directions, weights=flat)
        products = rows[:, k:].reshape(-1, 1 + q, 1 + q)
        lower = np.tril(products[:, 1:, 1:])
        return rows[:, :k], -products[:, 1:, 0], lower + np.tril(lower, -1).swapaxes(1, 2)

    # Arguments of the kernel that depend on the record.

    @property
    def _grid(self) -> Grid:
        return self.sensors.grid

    @cached_property
    def _padded(self) -> Array:
        """Return the record at all knots, up to a whole number of joined steps; NaN without a sample."""
        g, y = self._grid, np.asarray(self.sensors.padded)
        joined = self._structure.samples_per_step
        padded = np.full((-(-(len(g.t) - 1) // joined) * joined, y.shape[1]), np.nan)
        padded[g.samples] = y
        return padded

    @cached_property
    def _samples(self) -> Any:
        """Return the indices of samples among knots; a slice if possible, since slices copy faster."""
        at = self._grid.samples[1:] if self.sensors.lead else self._grid.samples
        in_a_row = len(at) == 0 or len(at) == at[-1] - at[0] + 1
        return slice(at[0], at[-1] + 1) if in_a_row else at

    @cached_property
    def _is_delayed(self) -> tuple[bool, ...]:
        """Return for each channel whether it has a delay."""
        lags, delayed = self.sensing.lags, self.sensing.delay is not None
        return tuple(delayed or channel.name in lags for channel in self.experiment.channels)

    @cached_property
    def _structure(self) -> LinearShape:
        """Return the structure of rig, sensors and times that kernels of all outputs share."""
        return LinearShape(
            layout=input_layout(self.sensors.observed_model, self.experiment),
            rows=tuple(map(tuple, (self.sensors.weights != 0.0).tolist())),
            is_delayed=self._is_delayed,
            uneven=not self._grid.uniform,
            tally=SQUARES,
            sensed=False,
        )

    @cached_property
    def _functions(self) -> dict[tuple[Any, ...], tuple[BoundFunction, int]]:
        """Return the cache of `_bind`."""
        return {}

    def _bind(
        self, tally: ResidualSums | None, q: int, ahead: int, *, stored: bool
    ) -> tuple[BoundFunction, int]:
        """Return the kernel, bound to all arguments that walkers share, and the size of its scratch.

        There are q directions, and `ahead` further knots after the record.
        """
        wanted = (tally, q, ahead, stored)
        if wanted not in self._functions:
            sensed = tally is None and not self.sensing.empty
            shape = replace(self._structure, tally=tally, sensed=sensed)
            samples = len(self._padded)
            counts = {
                "samples": samples, "knots": samples + ahead, "directions": q, "high": self._high,
                "nodes": len(self._grid.spans), "stored": int(stored),
            }  # fmt: skip
            places = np.cumsum([0, *shape.scratch(counts)])
            kernel, blocks = compile_kernel(write_linear, shape), self._knots(ahead)
            bound = kernel.bind("linear", places=places, **counts, **blocks)
            self._functions[wanted] = bound, int(places[-1]) + 1
        return self._functions[wanted]

    @cached_property
    def _shared(self) -> dict[str, Array]:
        """Return blocks that all walkers share: constants, nodes of the grid, and the record."""
        g, constants = self._grid, present(self.experiment.constant).values()
        numbers = np.array([g.width or g.median_step, *constants])
        record = {"y": self._padded, "begin": first_observed(self._padded)}
        return {"numbers": numbers, "spans": g.spans, "chained": g.is_chained, **record}

    def _knots(self, ahead: int) -> dict[str, Array]:
        """Return all blocks that walkers share, with `ahead` further knots after the record."""
        g, first_order = self._grid, self.experiment.first_order
        u, slopes = inputs_at_knots(g, self.sensors.knots[1], first_order=first_order)
        more = ahead + len(self._padded) - len(u)
        u = np.vstack([u, u[-1:].repeat(more, axis=0)])
        if first_order:
            u = np.hstack([u, np.vstack([slopes, np.zeros((more, slopes.shape[1]))])])
        later = g.t[-2] + self._median_step * np.arange(1, more + 1)
        node = np.append(g.node[:-1], np.full(more + 1, self._median_node))
        return self._shared | {
            "node": node.astype(np.int64),
            "share": np.append(g.excess, np.full(more, -1.0)),
            "t": np.concatenate([g.t[:-1], later, [np.inf]]),
            "u": np.ascontiguousarray(u),
        }

    @cached_property
    def _median_node(self) -> int:
        """Return the index of the node whose span is nearest to the median step."""
        return int(np.argmin(np.abs(self._grid.spans - self._grid.median_step)))

    @property
    def _median_step(self) -> float:
        return float(self._grid.spans[self._median_node])

    @cached_property
    def _high(self) -> int:
        """Return how many rungs of `kernels.transitions` span at least `width`; -1 without a ladder."""
        g = self._grid
        if not any(self._is_delayed):
            return 0 if g.width > 0.0 else -1
        longest = float(np.diff(g.t[:-1]).max(initial=0.0))
        return int(longest / (g.width or g.median_step)).bit_length()

    # Arguments of the kernel that depend on walkers.

    @cached_property
    def _perfect(self) -> Array | None:
        """Return start and sensor rows, `(1, X + K (X + 1))`, if all are known; otherwise None."""
        if not self.sensing.empty:
            return None
        weights = self.sensors.weights
        start = [self.experiment.start.get(name, 0.0) for name in self.model.states]
        return np.append(start, np.column_stack([weights, np.zeros(len(weights))]))[None]

    def _walkers(self, full: Array | Dual) -> tuple[list[Any], int]:
        """Return blocks of numbers `(W, ...)`, or `(1, ...)` if walkers share them, and `ahead`.

        Only the first block can have derivatives. `ahead` is the number of knots after the record.
        """
        if self._perfect is not None:
            return [full, self._perfect], 0
        walkers = ObservedWalkers(self.sensors, full)
        with np.errstate(all="ignore"):
            if not self.sensing.shifts:
                return [walkers.numbers], 0
            delay = self.sensors.channel_delays(full)
            value, step = dual(delay).value, self._median_step
            farthest = MAX_AHEAD * (float(self._grid.t[-2]) + step)
            lost = ~(value > -farthest) | ~np.isfinite(value)
            rows = linear_map(lambda part: np.where(lost[:, :, None], np.nan, part), walkers.rows)
            delay = linear_map(lambda part: np.where(lost, 0.0, part), delay)
            ahead = int(-dual(delay).value.min(initial=0.0) / step)
            parts = (walkers.parameters, walkers.start, rows, walkers.before, delay)
            return [join_flat(*parts)], 1 << (ahead + 1).bit_length() if ahead else 1

    def _run(
        self,
        full: Array,
        out: tuple[int, ...],
        *,
        directions: Array | None = None,
        tally: ResidualSums | None = None,
        weights: Array | None = None,
        stored: bool = False,
    ) -> Array:
        """Return `(W, *out)`: sums of a `tally`, normal equations in `directions`, or signals."""
        blocks, q = dict[str, Array](), 0
        walkers: Array | Dual = full
        if directions is not None:
            n, q, p = directions.shape
            # With perfect sensors, `along` itself has the derivatives, and no value is repeated.
            times = q if self._perfect is None else 1
            walkers = Dual(full.repeat(times, axis=0), directions.reshape(n * q, p))
        (numbers, *others), ahead = self._walkers(walkers)
        if directions is not None:
            blocks["along"] = in_groups(numbers.slope.reshape(len(full), -1))
            numbers = numbers.value[::times]  # the values are the same in all directions
        if weights is None and directions is not None:  # signals need no weights
            weights = np.zeros((1, SCALES * self._padded.shape[1]))
        others += [] if weights is None else [weights]
        bound, size = self._bind(tally, q, ahead, stored=stored)
        scratch = np.empty((size, LANES))
        walkers = in_groups(numbers, *others)
        return bound.run(len(full), out, own=walkers, scratch=aligned(scratch), **blocks)
