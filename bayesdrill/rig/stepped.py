"""Rigs that rub, and inputs with lags of their own: the response in steps of one length.

While every friction slips or sticks a step is exact; one in which a speed changes its sign has an error
of the order of the step, so that `pieces` of them make the interval between two samples.  Channels whose
times are others are read between steps.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesdrill.record.experiment import Experiment, frozen
from bayesdrill.rig.ahead import Ahead
from bayesdrill.rig.kernels import LANES
from bayesdrill.rig.kernels.stepping import BLOCKS, COUNTS, Kernel, Own, Shape, compile_stepping
from bayesdrill.rig.models.friction import frictions_of
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.sensing import Sensing
from bayesdrill.rig.sums import normal
from bayesdrill.rig.walkers import Walkers

Array = NDArray[np.float64]
NONE = np.zeros(0)


@dataclass(frozen=True, slots=True)
class Motion:
    """What rigs do at the times of samples: `states (W, T, X)`, and `efforts (W, T, E)` of frictions in
    the step that begins there, positive against a positive speed.  What sticks has no speed at all.
    """

    states: Array
    efforts: Array


@dataclass(frozen=True)
class Stepped:
    """See `simulator.Simulator`; parameters are the model's, then those that `sensing` names."""

    model: Model
    experiment: Experiment
    sensing: Sensing
    pieces: int = 1

    @property
    def parameters(self) -> tuple[str, ...]:
        return self._walkers.parameters

    def of(self, experiment: Experiment) -> Stepped:
        return dataclasses.replace(self, experiment=experiment)

    def finer(self, pieces: int) -> Stepped:
        return dataclasses.replace(self, pieces=pieces)

    def with_record(self, y: Array) -> Stepped:
        """What was not measured stays so."""
        if y.shape != self.experiment.y.shape:
            raise ValueError(f"the record has shape {self.experiment.y.shape}, not {y.shape}")
        kept = frozen(np.where(self.experiment.seen, y, np.nan))
        return self.of(dataclasses.replace(self.experiment, y=kept))

    def with_series(self, series: Mapping[str, Array]) -> Stepped:
        if set(series) != set(self.experiment.series):
            raise ValueError(f"series of {sorted(self.experiment.series)} are wanted")
        ordered = {name: series[name] for name in self.experiment.series}
        return self.of(dataclasses.replace(self.experiment, series=ordered))

    def signals(self, full: Array) -> Array:
        with np.errstate(all="ignore"):
            return self._walkers.cut(self._run(self._ahead, full))

    def squares(self, full: Array) -> Array:
        with np.errstate(all="ignore"):
            return self._run(self._ahead, full, sums=True)

    def sensitivities(self, full: Array, along: Array) -> Array:
        return self.course(full, along)[1]

    def course(self, full: Array, along: Array) -> tuple[Array, Array]:
        n, q, p = along.shape
        points = np.repeat(full, q, axis=0)
        with np.errstate(all="ignore"):
            found = self._run(self._ahead, points, along.reshape(n * q, p))
        found = self._walkers.cut(found).reshape(n, q, *self.experiment.y.shape, 2)
        return np.ascontiguousarray(found[:, 0, ..., 0]), np.ascontiguousarray(found[..., 1])

    def normal(self, full: Array, along: Array, scales: Array) -> tuple[Array, Array, Array]:
        return normal(self, full, along, scales)

    def motion(self, full: Array) -> Motion:
        """As the rig moves, whatever sensors make of it."""
        nodes = self._ahead.every_node()
        x, e = len(self.model.states), len(frictions_of(self.model))
        with np.errstate(all="ignore"):
            every = self._run(nodes, full, efforts=True)
        last, share = self._ahead.between(self.experiment.t)
        share = share[None, :, None]
        states = every[:, last, :x] * (1 - share) + every[:, last + 1, :x] * share
        return Motion(states=states, efforts=every[:, last, x : x + e])

    # What the kernels are told.

    @cached_property
    def _walkers(self) -> Walkers:
        return Walkers(self.model, self.experiment, self.sensing)

    @cached_property
    def _ahead(self) -> Ahead:
        t, series = self._walkers.knots
        if self.experiment.uniform and not self._walkers.lead:
            t = t[0] + self.experiment.dt * np.arange(len(t))
        return Ahead(t, series, self.experiment.first_order, self.pieces)

    def _shape(self, ahead: Ahead, rows: Array, **kind: bool) -> Shape:
        return Shape(
            model=self._walkers.wired,
            series=self._walkers.inputs,
            late=tuple(n for n in self._walkers.inputs if n in self.sensing.input_lags),
            constant=tuple(self.experiment.constant.items()),
            first_order=self.experiment.first_order and bool(self._walkers.inputs),
            span=ahead.span,
            pattern=tuple(map(tuple, (rows != 0.0).any(axis=0).tolist())),
            **kind,
        )

    def _run(
        self,
        ahead: Ahead,
        full: Array,
        along: Array | None = None,
        *,
        sums: bool = False,
        efforts: bool = False,
    ) -> Array:
        """Sums `(W, K)`, or signals `(W, T, K)`, with slopes `(W, T, K, 2)`."""
        parts = self._parts(full, along)
        if efforts:
            parts["rows"] = [_unit_rows(len(full), parts["rows"][0].shape[2], self.model)]
        parts["rows"] = [np.ascontiguousarray(rows) for rows in parts["rows"]]
        rows = np.concatenate(parts["rows"])
        read = not efforts and (self.sensing.shifts or not ahead.aligned)
        shape = self._shape(
            ahead, rows, sums=sums, dual=along is not None, read=read,
            single=ahead.single and not read, efforts=efforts,
        )  # fmt: skip
        kernel = compile_stepping(shape)
        margin = ahead.margin(parts["lag"][0])
        after = ahead.after(parts["shift"][0]) if read else 0
        own = _in_lanes(parts, shape, ahead)
        y = np.ascontiguousarray(self._walkers.padded if not efforts else NONE)
        k, n = rows.shape[1], ahead.samples
        each = (k,) if sums else (n, k, shape.numbers)
        out = np.empty((len(own), *each, LANES))
        nodes = ahead.nodes + after
        blocks: dict[str, Any] = {
            "own": own,
            "u": ahead.inputs(margin, after)[margin:],  # rows before are looked at, too
            "pieces": ahead.counts,
            "t": ahead.places,
            "y": y,
            "trace": np.empty((nodes + 1) * k * 3 * shape.numbers * LANES) if read else NONE,
            "out": out,
        }
        self._call(kernel, (len(own), n, nodes), blocks)
        found = np.moveaxis(out, -1, 1).reshape(-1, *each)[: len(full)]
        return found[..., 0] if not sums and along is None else found

    @staticmethod
    def _call(kernel: Kernel, counts: tuple[int, int, int], blocks: dict[str, Any]) -> None:
        assert len(counts) == len(COUNTS)
        kernel.run(*counts, *(blocks[name].ctypes.data for name in BLOCKS))

    def _parts(self, full: Array, along: Array | None) -> dict[str, list[Array]]:
        """Each part of `own (W, ...)`, and its slopes."""
        w, n = self._walkers, len(full)
        of, weights = w.numbers(full), w.weights
        begin, gains = w.begin(of, full), w.gains(full)
        parts = {
            "parameters": [w.told(full)],
            "x0": [begin],
            "rows": [_rows(gains, w.of_channels(self.sensing.offsets, full), weights)],
            "before": [w.before(of, begin)],
            "shift": [w.later(full)],
            "lag": [w.of_inputs(self.sensing.input_lags, full)],
        }
        if along is None:
            return parts
        tangent = w.tangent_numbers(full, along)
        begin_slope = w.begin_slope(tangent, along)
        gain_slopes = w.of_channels(self.sensing.gains, along)
        offset_slopes = w.of_channels(self.sensing.offsets, along)
        both = np.concatenate([begin, begin_slope], axis=1)
        slopes = {
            "parameters": w.told(along),
            "x0": begin_slope,
            "rows": _rows(gain_slopes, offset_slopes, weights),
            "before": w.before_slope(tangent, both),
            "shift": w.later(along),
            "lag": w.of_inputs(self.sensing.input_lags, along),
        }
        assert all(len(slope) == n for slope in slopes.values())
        return {name: [value[0], slopes[name]] for name, value in parts.items()}


def _rows(gains: Array, offsets: Array, weights: Array) -> Array:
    """`(W, K, X + 1)`: over states and one."""
    return np.concatenate([gains[:, :, None] * weights, offsets[:, :, None]], axis=2)


def _unit_rows(n: int, width: int, model: Model) -> Array:
    """Each state, and each effort, for a channel."""
    x, e = len(model.states), len(frictions_of(model))
    rows = np.zeros((n, x + e, width + e))
    rows[:, range(x), range(x)] = 1.0
    rows[:, range(x, x + e), range(width, width + e)] = 1.0
    return rows


def _in_lanes(parts: Mapping[str, list[Array]], shape: Shape, ahead: Ahead) -> Array:
    """`(G, width, LANES)`, as `Own` has it; the last walker fills the last group."""
    behind, *shares = ahead.delays(parts["lag"])
    told = {**parts, "share": shares, "behind": [behind] * len(shares)}
    n = len(behind)
    blocks = [part.reshape(n, -1) for name in Own(shape).parts for part in told[name]]
    flat = np.concatenate(blocks, axis=1)
    groups = -(-n // LANES)
    whole = np.concatenate([flat, np.repeat(flat[-1:], groups * LANES - n, axis=0)])
    return np.ascontiguousarray(whole.reshape(groups, LANES, -1).transpose(0, 2, 1))
