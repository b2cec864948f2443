"""The response in steps of one length: rigs with friction, and inputs with lags of their own.

While every friction slips or sticks a step is exact; one in which a speed changes its sign has an error
of the order of the step, so that it is made in parts, and `pieces` steps make the interval between two
samples.  Channels whose times are others are read between steps.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.record.experiment import Experiment
from bayesdrill.rig.kernels.compiling import Kernel, compile_kernel
from bayesdrill.rig.kernels.exponential import present
from bayesdrill.rig.kernels.lanes import LANES
from bayesdrill.rig.kernels.step_arguments import BLOCKS, SteppedShape
from bayesdrill.rig.kernels.sums import ResidualSums
from bayesdrill.rig.kernels.time_stepping import write_stepping
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.simulators.contract import TURNS, Motion, Simulator, Stepping, Steps, in_groups
from bayesdrill.rig.simulators.sensors import Sensing, Walkers
from bayesdrill.rig.simulators.time_grid import Ahead

NONE = np.zeros(0)


@dataclass(frozen=True)
class Told:
    """`y (T, K)` of the record; `numbers`: of steps, and of constant inputs."""

    kernel: Kernel
    shape: SteppedShape
    ahead: Ahead
    y: Array
    numbers: Array

    @cached_property
    def _staying(self) -> dict[str, int]:
        """Addresses; asking an array for its own takes as long as twenty steps of a group."""
        blocks = {
            "numbers": self.numbers,
            "pieces": self.ahead.counts,
            "usual": self.ahead.usual,
            "t": self.ahead.places,
            "y": NONE if self.shape.efforts else self.y,
        }
        return {name: block.ctypes.data for name, block in blocks.items()}

    @cached_property
    def _inputs(self) -> dict[tuple[int, int], int]:
        return {}

    def _u(self, margin: int, after: int) -> int:
        if (margin, after) not in self._inputs:
            self._inputs[margin, after] = self.ahead.inputs(margin, after).ctypes.data
        return self._inputs[margin, after]

    def run(self, n: int, parts: Mapping[str, list[Array]]) -> Array:
        """Of n walkers, each part `(W, ...)`, or `(1, ...)` where they have the same; and its slopes.

        A tally `(W, K, n)`, or signals `(W, T, K, numbers of one)`.
        """
        shape, ahead = self.shape, self.ahead
        k, numbers = len(shape.pattern), shape.numbers
        after = ahead.after(parts["shift"][0]) if shape.read else 0
        own, nodes = self._in_lanes(n, parts), ahead.nodes + after
        signals = (ahead.samples, k, numbers)
        each = signals if shape.tally is None else (k, shape.tally.count)
        out = np.empty((len(own), *each, LANES))
        trace = np.empty((nodes + 1) * k * 3 * numbers * LANES) if shape.read else NONE
        margin = ahead.margin(parts["lag"][0]) if shape.late else 0
        places = self._staying | {
            "u": self._u(margin, after),
            "own": own.ctypes.data,
            "trace": trace.ctypes.data,
            "out": out.ctypes.data,
        }
        blocks = [places[name] for name in BLOCKS]
        self.kernel["stepping"](len(own), ahead.samples, nodes, *blocks)
        return np.moveaxis(out, -1, 1).reshape(-1, *each)[:n]

    def _in_lanes(self, n: int, parts: Mapping[str, list[Array]]) -> Array:
        """Return `(G, width, LANES)`, see `walker_blocks`; the last walker fills the last group."""
        told = parts
        if self.shape.late:
            behind, *shares = self.ahead.delays(parts["lag"])
            told = {**parts, "share": shares, "behind": [behind] * len(shares)}
        rows, place = np.empty((n, self._width)), 0
        for part in (part for name in self._names for part in told[name]):
            flat = part.reshape(len(part), -1)
            rows[:, place : place + flat.shape[1]] = flat
            place += flat.shape[1]
        return in_groups(rows)

    @cached_property
    def _width(self) -> int:
        return sum(self.shape.walker_vectors.values())

    @cached_property
    def _names(self) -> tuple[str, ...]:
        """Asking the shape again and again takes as long as some steps of a group."""
        return tuple(self.shape.walker_blocks)


@dataclass(frozen=True)
class Stepped(Simulator):
    """See `simulator.Simulator`; parameters are the model's, then those that `sensing` names.

    `turns`: parts of a step in which something turns; `chosen`: both were, for the noise.
    """

    model: Model
    experiment: Experiment
    sensing: Sensing
    pieces: int = 1
    turns: int = TURNS
    chosen: bool = False

    @property
    def stepping(self) -> Stepping:
        return Stepping(self.pieces, self.turns, self.chosen)

    def finer(self, pieces: int, turns: int = TURNS, *, chosen: bool = False) -> Stepped:
        return dataclasses.replace(self, pieces=pieces, turns=turns, chosen=chosen)

    def signals(self, full: Array) -> Array:
        with np.errstate(all="ignore"):
            return self._walkers.cut(self._run(self._ahead, full))

    def sums(self, full: Array, tally: ResidualSums, weights: Array | None = None) -> Array:
        with np.errstate(all="ignore"):
            return self._run(self._ahead, full, tally=tally, weights=weights)

    def course(self, full: Array, along: Array) -> tuple[Array, Array]:
        n, q, p = along.shape
        points = np.repeat(full, q, axis=0)
        with np.errstate(all="ignore"):
            found = self._run(self._ahead, points, along.reshape(n * q, p))
        found = self._walkers.cut(found).reshape(n, q, *self.experiment.y.shape, 2)
        return np.ascontiguousarray(found[:, 0, ..., 0]), np.ascontiguousarray(found[..., 1])

    def motion(self, full: Array) -> Motion:
        """As the rig moves, whatever sensors make of it."""
        states, efforts = self._at_nodes(full)
        last, share = self._ahead.between(self.experiment.t)
        share = share[None, :, None]
        states = states[:, last] * (1 - share) + states[:, last + 1] * share
        return Motion(states=states, efforts=efforts[:, last])

    def _at_nodes(self, full: Array) -> tuple[Array, Array]:
        """States `(W, N, X)` and efforts of frictions `(W, N, E)`."""
        with np.errstate(all="ignore"):
            found = self._run(self._nodes, full, efforts=True)
        states, efforts = np.split(found, [len(self.model.states)], axis=2)
        return states, efforts

    def steps(self, full: Array) -> Steps:
        """Of all steps to the last sample, which is where the last one begins."""
        n = self._ahead.nodes
        states, efforts = self._at_nodes(full)
        felt, slopes = self._felt(full)
        return Steps(
            t=self._walkers.knots[0][0] + self._ahead.span * np.arange(n),
            span=self._ahead.span,
            motion=Motion(states=states[:, :n], efforts=efforts[:, :n]),
            felt=felt,
            slopes=slopes,
        )

    def _felt(self, full: Array) -> tuple[dict[str, Array], dict[str, Array]]:
        """Inputs at the beginning of steps, and their slopes, `(W, N)` each."""
        w, sensing, zero = self._walkers, self.sensing, np.zeros((len(full), self._ahead.nodes))
        felt, slopes = dict[str, Array](), dict[str, Array]()

        def told(names: Mapping[str, str], name: str, usual: float) -> Array:
            found = w.column(names[name], full) if name in names else np.full(len(full), usual)
            return np.asarray(found)

        for name in self.model.inputs:
            if name in w.inputs:
                lag = told(sensing.input_lags, name, 0.0)
                u, slope = self._ahead.felt(w.inputs.index(name), lag)
            else:
                u, slope = zero + self.experiment.constant.get(name, 0.0), zero
            gain = told(sensing.input_gains, name, 1.0)[:, None]
            felt[name] = gain * u + told(sensing.input_offsets, name, 0.0)[:, None]
            slopes[name] = gain * slope
        return felt, slopes

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

    @cached_property
    def _nodes(self) -> Ahead:
        return self._ahead.every_node()

    @cached_property
    def _gaps(self) -> bool:
        return bool(np.isnan(self._walkers.padded).any())

    @cached_property
    def _tellings(self) -> dict[Any, Told]:
        return {}

    @cached_property
    def _pattern(self) -> Array:
        """`(K, X + 1)`: what channels see of states, and of one."""
        offset = [channel.name in self.sensing.offsets for channel in self.experiment.channels]
        return np.column_stack([self._walkers.weights, offset])

    def _told(self, ahead: Ahead, *, tally: ResidualSums | None, **kind: bool) -> Told:
        wanted = (id(ahead), tally, *kind.values())
        if wanted not in self._tellings:
            w, one = self._walkers, self.experiment
            rows = _unit_rows(self.model)[0] if kind["efforts"] else self._pattern
            shape = SteppedShape(
                model=w.wired,
                series=w.inputs,
                late=tuple(n for n in w.inputs if n in self.sensing.input_lags),
                constant=present(one.constant),
                first_order=one.first_order and bool(w.inputs),
                pattern=tuple(map(tuple, (rows != 0).tolist())),
                gaps=self._gaps and tally is not None,
                tally=tally,
                turns=self.turns if self.model.frictions else 1,
                **kind,
            )
            kernel = compile_kernel(write_stepping, shape)
            inputs = [one.constant[name] for name in shape.constant]
            numbers = np.array([*ahead.spans, *inputs])
            self._tellings[wanted] = Told(kernel, shape, ahead, w.padded, numbers)
        return self._tellings[wanted]

    def _run(
        self,
        ahead: Ahead,
        full: Array,
        along: Array | None = None,
        *,
        tally: ResidualSums | None = None,
        weights: Array | None = None,
        efforts: bool = False,
    ) -> Array:
        """A tally `(W, K, n)`, or signals `(W, T, K)`, with slopes `(W, T, K, 2)`."""
        parts = self._parts(full, along)
        if weights is not None:
            parts["weight"] = [weights]
        if efforts:
            parts["rows"] = [_unit_rows(self.model)]
        read = not efforts and (self.sensing.shifts or not ahead.aligned)
        single = ahead.single and not read
        dual = along is not None
        told = self._told(ahead, efforts=efforts, tally=tally, dual=dual, read=read, single=single)
        found = told.run(len(full), parts)
        return found[..., 0] if tally is None and along is None else found

    @cached_property
    def _perfect(self) -> bool:
        return self.sensing.nothing

    def _parts(self, full: Array, along: Array | None) -> dict[str, list[Array]]:
        """Each part of `own (W, ...)`, or `(1, ...)` where walkers have the same; and its slopes."""
        w = self._walkers
        parts = {"parameters": [w.told(full)], **(self._same if self._perfect else self._own(full))}
        if along is None:
            return parts
        return {name: [*parts[name], slope] for name, slope in self._slopes(full, along).items()}

    def _own(self, full: Array) -> dict[str, list[Array]]:
        """Of each walker, as its sensors and its start are."""
        w = self._walkers
        of = w.numbers(full) if w.moves else None
        begin = w.begin(of, full)
        return {
            "x0": [begin],
            "rows": [w.rows(w.gains(full), full)],
            "before": [w.before(of, begin)],
            "shift": [w.later(full)],
            "lag": [w.of_inputs(self.sensing.input_lags, full)],
        }

    @cached_property
    def _same(self) -> dict[str, list[Array]]:
        """Of perfect sensors, and a start that is known."""
        w, k = self._walkers, len(self.experiment.channels)
        start = [[self.experiment.start.get(name, 0.0) for name in self.model.states]]
        return {
            "x0": [np.array(start)],
            "rows": [w.rows(np.ones((1, k)), np.zeros((1, 0)))],
            "before": [np.zeros((1, len(self.model.states)))],
            "shift": [np.zeros((1, k))],
            "lag": [np.zeros((1, 0))],
        }

    def _slopes(self, full: Array, along: Array) -> dict[str, Array]:
        w, sensing = self._walkers, self.sensing
        tangent = w.tangent_numbers(full, along) if w.moves else None
        begin_slope = w.begin_slope(tangent, along)
        begin = w.begin(w.numbers(full) if w.moves else None, full)
        both = np.concatenate([begin, begin_slope], axis=1)
        return {
            "parameters": w.told(along),
            "x0": begin_slope,
            "rows": w.rows(w.of_channels(sensing.gains, along), along),
            "before": w.before_slope(tangent, both),
            "shift": w.later(along),
            "lag": w.of_inputs(sensing.input_lags, along),
        }


class Unstepped(Simulator):
    """A simulator without steps of its own: what a rig does is said in steps of a sample each."""

    def motion(self, full: Array) -> Motion:
        return Stepped(self.model, self.experiment, self.sensing).motion(full)

    def steps(self, full: Array) -> Steps:
        return Stepped(self.model, self.experiment, self.sensing).steps(full)


def _unit_rows(model: Model) -> Array:
    """Each state, and each effort, for a channel: `(1, X + E, X + 1 + E)`."""
    x, e = len(model.states), len(model.frictions)
    rows = np.zeros((1, x + e, x + 1 + e))
    rows[:, range(x), range(x)] = 1.0
    rows[:, range(x, x + e), range(x + 1, x + 1 + e)] = 1.0
    return rows
