"""The exact response at any times, as sensors show it.

They may be late, scaled and shifted, and the start unknown: `ObservationModel` says which numbers
that takes beside the rig's parameters.  Everything is linear in the states, so that sensors are
rows of weights, and their derivatives other rows (`Dense` runs both).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesdrill.basics.arrays import Array
from bayesdrill.record.experiment import Experiment
from bayesdrill.rig.kernels.compiling import Kernel, compile_kernel
from bayesdrill.rig.kernels.exponential import Layout, Pattern, present
from bayesdrill.rig.kernels.irregular import write_dense
from bayesdrill.rig.kernels.knots import MAX_LEVELS, IrregularShape, table_entries
from bayesdrill.rig.kernels.lanes import LANES
from bayesdrill.rig.kernels.sums import ResidualSums
from bayesdrill.rig.models.linear import Model, Tangent
from bayesdrill.rig.simulators.contract import in_groups
from bayesdrill.rig.simulators.sensors import ObservationModel, ObservedWalkers
from bayesdrill.rig.simulators.stepped import Unstepped
from bayesdrill.rig.simulators.time_grid import Grid, build_grid, runs

Mask = NDArray[np.bool_]

CELLS, SAMPLES_PER_CELL = (32, 64), 20  # of shifts, one for 20 samples between these ends
MAX_CELL_SPAN = 2.5  # usual steps: spans up to there are in cells
MAX_AHEAD = 2.0**40  # usual steps after the last sample
NONE = np.zeros(0)


class Dense:
    """Runs `model` at times `t (T,)`, increasing, with inputs as in an `Experiment`.

    Walkers have `parameters (W, P)`, a start `x0 (W, X)` at `t[0]`, before which states move
    straight at the rates `before (W, X)`, and channels: at time t channel k of walker w sees
    `rows[w, k] (R,)` times (states, 1, inputs of `series`) at the time t - `shift[w, k]`; they are
    given in the order (parameters, x0, before, shift, rows).  Before and after the record inputs
    are constant.  A shift of None is zero.  A walker whose numbers
    overflow gets NaN (or infinity, in a sum) in its own row alone.

    Kernels are compiled when they are first wanted, and again when rows have entries that were zero
    so far; what a walker gets depends neither on that nor on others.  `grid`: of `t`, if it is known.
    """

    def __init__(
        self,
        model: Model,
        t: Array,
        series: Mapping[str, Array],
        constant: Mapping[str, float],
        first_order: bool,
        grid: Grid | None = None,
    ) -> None:
        self._t = np.array(t, dtype=float)
        self._layout = Layout.from_model(
            model, tuple(series), tuple(present(constant)), first_order=first_order
        )
        g = self._grid = grid or build_grid(self._t)
        self._kept = len(table_entries(self._layout))
        self._kernels: dict[Any, tuple[Kernel, IrregularShape]] = {}
        self._cells = int(np.clip(len(g.t) // SAMPLES_PER_CELL, *CELLS))
        steps = np.diff(g.t[:-1])
        self._near = float(steps[steps <= MAX_CELL_SPAN * g.usual].max()) if len(steps) else 1.0
        self._farthest = float(steps.max()) if len(steps) else 0.0
        inputs_at_samples = np.array([*series.values()]).reshape(len(series), len(self._t)).T
        u, slopes = _driven(g, inputs_at_samples, self._layout.first_order)
        node, length, share = runs(g)
        widths = (g.width, self._near / self._cells, 1e-3 / g.usual)
        numbers = np.array([*widths, *present(constant).values()])
        self._blocks = {
            "numbers": numbers, "spans": g.spans, "inside": g.inside, "chained": g.chained,
            "node": node, "length": length, "share": share, "u": u, "slopes": slopes, "t": g.t,
        }  # fmt: skip
        self._addresses = {name: block.ctypes.data for name, block in self._blocks.items()}
        # Where samples are among knots: a slice copies faster.
        self._at: Any = slice(len(g.at)) if len(g.at) == len(g.t) - 1 else g.at
        self._pattern: Mask | None = None
        self._entries: Pattern = ()

    def sums(
        self, walkers: tuple[Any, ...], y: Array, tally: ResidualSums, weights: Array | None = None
    ) -> Array:
        """Return sums `(W, K, n)` of residuals of the record `y (T, K)`; `weights (W, K, m)` if any."""
        full = np.full((len(self._grid.t), y.shape[1]), np.nan)
        full[self._at] = y
        return self._run(walkers, full, (y.shape[1], tally.count), tally, weights)

    def signals(self, *walkers: Any) -> Array:
        """Return the channels `(W, T, K)`."""
        signals = self._run(walkers, NONE, (len(self._grid.t), walkers[-1].shape[1]))
        return np.ascontiguousarray(signals[:, self._at])

    def _run(
        self,
        walkers: tuple[Any, ...],
        y: Array,
        out: tuple[int, ...],
        tally: ResidualSums | None = None,
        weights: Array | None = None,
    ) -> Array:
        parameters, x0, before, shift, rows = walkers
        late = None
        if shift is not None and shift.any():
            late = _Late(self._grid, np.asarray(shift), rows)
            rows = late.rows
        shifted = late.shifted if late is not None else (False,) * rows.shape[1]
        kernel, shape = self._kernel(self._used(rows), tally, shifted)
        g, table_size = self._grid, self._kept * LANES
        blocks = {
            "y": y,
            "which": np.flatnonzero(shifted) if late is not None else NONE,
            "table": np.empty(len(g.spans) * table_size),
            "ladder": NONE,
            "rows": NONE,
        }
        walker_parts = [parameters, x0, rows]
        high = 0
        if late is not None:
            walker_parts += [before, *late.arguments]
            if late.searched:
                high = int(max(self._farthest, late.farthest) / self._near).bit_length() or 1
            blocks["ladder"] = np.empty((high + MAX_LEVELS) * table_size)
            each = (self._cells + 1) * LANES * LANES * shape.row_blocks
            blocks["rows"] = np.empty(rows.shape[1] * each)
        walker_parts += [] if weights is None else [weights]
        blocks["own"] = in_groups(*walker_parts)
        return kernel.run(
            "dense", len(rows), out, knots=len(g.t) - 1, nodes=len(g.spans),
            runs=len(self._blocks["node"]), cells=self._cells, high=high,
            **self._addresses, **blocks,
        )  # fmt: skip

    def _kernel(
        self, pattern: Pattern, tally: ResidualSums | None, shifted: tuple[bool, ...]
    ) -> tuple[Kernel, IrregularShape]:
        wanted = (pattern, tally, shifted)
        if wanted not in self._kernels:
            even = self._grid.uniform and any(shifted)  # of no other is the kernel another
            shape = IrregularShape(self._layout, pattern, tally, shifted, even)
            self._kernels[wanted] = compile_kernel(write_dense, shape), shape
        return self._kernels[wanted]

    def _used(self, rows: Array) -> Pattern:
        """Return which entries of rows are or were not zero, offsets included: one kernel for all."""
        known = self._pattern
        if known is None or known.shape != rows.shape[1:]:
            known = np.zeros(rows.shape[1:], dtype=bool)
            known[:, self._layout.n_states] = True
        if self._pattern is None or rows[:, ~known].any():
            known = known | (rows != 0.0).any(axis=0)
            self._pattern, self._entries = known, tuple(map(tuple, known.tolist()))
        return self._entries


class _Late:
    """What the kernels need to know of shifts `(W, K)`."""

    def __init__(self, g: Grid, shift: Array, rows: Array) -> None:
        n = len(g.t) - 1
        lost = ~(shift > -MAX_AHEAD * g.usual) | ~np.isfinite(shift)
        self.rows = np.where(lost[:, :, None], np.nan, rows)
        shift = np.where(lost, 0.0, shift)
        head = np.searchsorted(g.t[:n], shift, side="left").astype(float)
        offset, share, begin = np.zeros_like(shift), np.zeros_like(shift), head
        self.shifted = tuple(shift.any(axis=0).tolist())
        self.searched = True  # for the step in which samples lie
        if g.uniform:
            step = float(g.spans[0])
            ratio = shift / step
            whole = np.round(ratio)
            near = np.abs(ratio - whole) * step <= g.near
            offset = np.clip(np.where(near, whole, np.ceil(ratio)), -n, n)
            share = np.where(near, 0.0, np.clip(offset * step - shift, 0.0, step))
            head, begin = np.clip(offset, 0, n), np.clip(n + offset, 0, n)
            self.searched = bool((offset < 0).any())
        self.arguments = [shift, share, offset, head, begin]
        self.farthest = float(max(0.0, -shift.min()))


def _driven(g: Grid, inputs: Array, first_order: bool) -> tuple[Array, Array]:
    """Return inputs `(T, S)` at samples as they are at knots, and their slopes from there on."""
    n_knots = len(g.t) - 1
    before = np.searchsorted(g.at, np.arange(n_knots), side="right") - 1
    since = (g.t[:-1] - g.t[g.at][before])[:, None]
    slopes = np.zeros_like(inputs)
    if first_order:
        slopes[:-1] = np.diff(inputs, axis=0) / np.diff(g.t[g.at])[:, None]
    slopes = np.ascontiguousarray(slopes[before])
    return np.ascontiguousarray(inputs[before] + (slopes * since)), slopes


@dataclass(frozen=True)
class IrregularSimulator(Unstepped):
    """Simulates linear rigs at uneven times and with sensors of their own."""

    model: Model
    experiment: Experiment
    sensing: ObservationModel

    def signals(self, full: Array) -> Array:
        """See `Simulator.signals`."""
        with np.errstate(all="ignore"):
            settings = self._settings(ObservedWalkers(self.sensors, full))
            return self.sensors.drop_start(self._dense.signals(*settings))

    def sums(self, full: Array, tally: ResidualSums, weights: Array | None = None) -> Array:
        """See `Simulator.sums`."""
        with np.errstate(all="ignore"):
            settings = self._settings(ObservedWalkers(self.sensors, full))
            return self._dense.sums(settings, self.sensors.padded, tally, weights)

    def sensitivities(self, full: Array, along: Array) -> Array:
        """See `Simulator.sensitivities`."""
        n, q, _ = along.shape
        points = np.repeat(full, q, axis=0)
        with np.errstate(all="ignore"):
            slopes = self._slopes(points, along.reshape(n * q, -1))
        return slopes.reshape(n, q, *self.experiment.y.shape)

    # What `Dense` is told.

    @cached_property
    def _dense(self) -> Dense:
        return self._dense_of(self.sensors.observed_model)

    @cached_property
    def _tangent(self) -> Dense:
        return self._dense_of(Tangent(self.sensors.observed_model))

    def _dense_of(self, model: Model) -> Dense:
        t, series = self.sensors.knots
        constant, first_order = self.experiment.constant, self.experiment.first_order
        return Dense(model, t, series, constant, first_order, self.sensors.grid)

    def _settings(
        self, walkers: ObservedWalkers
    ) -> tuple[Array, Array, Array, Array | None, Array]:
        w, rows = self.sensors, walkers.rows
        rows = np.concatenate([rows, np.zeros((*rows.shape[:2], len(w.inputs)))], axis=2)
        shift = w.channel_delays(walkers.full) if self.sensing.shifts else None
        return walkers.parameters, walkers.start, walkers.before, shift, rows

    def _slopes(self, full: Array, along: Array) -> Array:
        """Return d signal along `along (n, P)` at `full (n, P)`: `(n, T, K)`."""
        w, walkers = self.sensors, ObservedWalkers(self.sensors, full)
        changes = ObservedWalkers(w, along, walkers)
        parameters, start, before, shift, rows = self._settings(walkers)
        x, (matrix, by_input, forcing) = start.shape[1], changes.system
        slopes = np.zeros((*rows.shape[:2], rows.shape[2] + x))
        slopes[:, :, :x], slopes[:, :, 2 * x] = changes.rows[:, :, :x], changes.rows[:, :, x]
        slopes[:, :, x : 2 * x] = rows[:, :, :x]
        later = w.channel_delays(along)[:, :, None]
        ahead = later * w.gains(full)[:, :, None] * w.weights  # d signal / d lag = - gain c . x'
        slopes[:, :, :x] -= np.einsum("nkx,nxy->nky", ahead, matrix[:, :x, :x])
        slopes[:, :, 2 * x] -= np.einsum("nkx,nx->nk", ahead, forcing[:, :x])
        slopes[:, :, 2 * x + 1 :] -= np.einsum("nkx,nxs->nks", ahead, by_input[:, :x])
        begin = np.concatenate([start, changes.start], axis=1)
        earlier = np.concatenate([before, changes.before], axis=1)
        both = np.concatenate([parameters, changes.parameters], axis=1)
        sensitivities = w.drop_start(self._tangent.signals(both, begin, earlier, shift, slopes))
        if shift is not None:
            self._mend_before(sensitivities, shift, ahead, walkers, changes)
        return sensitivities

    def _mend_before(
        self,
        sensitivities: Array,
        shift: Array,
        ahead: Array,
        walkers: ObservedWalkers,
        changes: ObservedWalkers,
    ) -> None:
        """Correct sensitivities before the start, where states go on straight."""
        x = self.sensors.weights.shape[1]
        when = self.experiment.t[None, :, None] - shift[:, None, :] - self.experiment.t_start
        if not (early := when < 0).any():
            return
        matrix, by_input, forcing = (part[:, :x] for part in changes.system)
        n, t, k = np.nonzero(early)
        here = walkers.start[n] + when[early][:, None] * walkers.before[n]
        moved = np.einsum("axy,ay->ax", matrix[n][:, :, :x], here) + forcing[n]
        moved += np.einsum("axs,s->ax", by_input[n], self.sensors.first_inputs)
        sensitivities[n, t, k] += np.einsum("ax,ax->a", ahead[n, k], moved - walkers.before[n])
