"""Compute the response in equal time steps, for rigs with friction and inputs with lags of their own.

A step without an event is exact. An event, such as a zero crossing of a speed, causes an error of
second order in the step length (`kernels.reversals`). So a step with an event is divided into parts,
and the interval between two samples into `pieces` steps. Channels whose samples lie between steps are
interpolated.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.basics.duals import Dual, linear_map
from bayesdrill.record.experiment import Experiment
from bayesdrill.rig.kernels.compiling import BoundFunction, compile_kernel
from bayesdrill.rig.kernels.exponential import present
from bayesdrill.rig.kernels.lanes import LANES
from bayesdrill.rig.kernels.step_arguments import SteppedShape
from bayesdrill.rig.kernels.sums import SQUARES, ResidualSums
from bayesdrill.rig.kernels.time_stepping import write_stepping
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.simulators.contract import (
    REVERSAL_SUBSTEPS,
    Motion,
    Simulator,
    Stepping,
    first_observed,
    in_groups,
)
from bayesdrill.rig.simulators.sensors import ObservationModel, ObservedWalkers
from bayesdrill.rig.simulators.time_grid import UniformGrid


@dataclass(frozen=True)
class Stepped(Simulator):
    """The simulator advances in steps; `Stepping` explains its last three fields."""

    model: Model
    experiment: Experiment
    sensing: ObservationModel
    pieces: int = 1
    turns: int = REVERSAL_SUBSTEPS
    chosen: bool = False

    @property
    def stepping(self) -> Stepping:
        """See `Simulator.stepping`."""
        return Stepping(self.pieces, self.turns, self.chosen)

    def with_substeps(
        self, substeps: int, reversal_substeps: int = REVERSAL_SUBSTEPS, *, adaptive: bool = False
    ) -> Stepped:
        """See `Simulator.with_substeps`."""
        return dataclasses.replace(self, pieces=substeps, turns=reversal_substeps, chosen=adaptive)

    def signals(self, full: Array) -> Array:
        """See `Simulator.signals`."""
        with np.errstate(all="ignore"):
            return self.sensors.drop_start(self._run(self._grid, full))

    def sums(self, full: Array, tally: ResidualSums, weights: Array | None = None) -> Array:
        """See `Simulator.sums`."""
        with np.errstate(all="ignore"):
            return self._run(self._grid, full, tally=tally, weights=weights)

    def course(self, full: Array, directions: Array) -> tuple[Array, Array]:
        """See `Simulator.course`."""
        n, q, p = directions.shape
        points = np.repeat(full, q, axis=0)
        with np.errstate(all="ignore"):
            duals = self._run(self._grid, points, directions.reshape(n * q, p))
        duals = self.sensors.drop_start(duals).reshape(n, q, *self.experiment.y.shape, 2)
        return duals[:, 0, ..., 0], duals[..., 1]

    def motion(self, full: Array) -> Motion:
        """See `Simulator.motion`."""
        with np.errstate(all="ignore"):
            nodes = self._run(self._nodes, full, efforts=True)
        states, efforts = np.split(nodes, [len(self.model.states)], axis=2)
        last, fraction = self._grid.locate(self.experiment.t)
        fraction = fraction[None, :, None]
        states = states[:, last] * (1 - fraction) + states[:, last + 1] * fraction
        return Motion(states=states, efforts=efforts[:, last])

    # Arguments of the kernels.

    @cached_property
    def _grid(self) -> UniformGrid:
        return UniformGrid(*self.sensors.knots, self.experiment.first_order, self.pieces)

    @cached_property
    def _nodes(self) -> UniformGrid:
        """Return the grid with a sample at each node."""
        knots, first_order = self.sensors.knots, self.experiment.first_order
        return UniformGrid(*knots, first_order, self.pieces, every_node=True)

    @cached_property
    def _functions(self) -> dict[Any, tuple[SteppedShape, tuple[str, ...], BoundFunction]]:
        """Return the cache of `_bind`."""
        return {}

    def _bind(
        self, grid: UniformGrid, tally: ResidualSums | None, **kind: bool
    ) -> tuple[SteppedShape, tuple[str, ...], BoundFunction]:
        """Return the structure of a kernel, the names of its `walker_blocks`, and the kernel.

        The kernel is bound to all arguments that walkers (sets of parameters) share.
        """
        wanted = (id(grid), tally, *kind.values())
        if wanted not in self._functions:
            w, experiment = self.sensors, self.experiment
            # The last column is for offsets; it is always there, so that one kernel serves all sensors.
            seen = np.column_stack([w.weights, np.ones(len(w.weights))])
            rows = _unit_rows(self.model)[0] if kind["efforts"] else seen
            shape = SteppedShape(
                model=w.observed_model,
                series=w.inputs,
                delayed_series=tuple(n for n in w.inputs if n in self.sensing.input_lags),
                constant=tuple(present(experiment.constant)),
                first_order=experiment.first_order and bool(w.inputs),
                pattern=tuple(map(tuple, (rows != 0).tolist())),
                tally=tally,
                **kind,
            )
            inputs = [experiment.constant[name] for name in shape.constant]
            bound = compile_kernel(write_stepping, shape).bind(
                "stepping", numbers=np.array([*grid.spans, *inputs]), pieces=grid.counts,
                usual=grid.usual, t=grid.places, samples=grid.samples, turns=self.turns,
                y=w.padded, begin=first_observed(w.padded),
            )  # fmt: skip
            self._functions[wanted] = shape, tuple(shape.walker_blocks), bound
        return self._functions[wanted]

    def _run(
        self,
        grid: UniformGrid,
        full: Array,
        directions: Array | None = None,
        *,
        tally: ResidualSums | None = None,
        weights: Array | None = None,
        efforts: bool = False,
    ) -> Array:
        """Return sums `(W, K, n)`, signals `(W, T, K)`, or signals with derivatives `(W, T, K, 2)`."""
        parts = self._parts(full, directions)
        if weights is not None:
            parts["weight"] = [weights]
        if efforts:
            parts["rows"] = [_unit_rows(self.model)]
        read = not efforts and (self.sensing.shifts or not grid.aligned)
        dual = directions is not None
        stored = tally is None and not dual and not efforts  # the kernel of `SQUARES` can do it
        wanted = SQUARES if stored else tally
        shape, names, function = self._bind(grid, wanted, efforts=efforts, dual=dual, read=read)
        after = grid.steps_after(parts["shift"][0]) if read else 0
        margin = 0
        if shape.delayed_series:
            behind, *fractions = grid.delays(parts["lag"])
            parts |= {"share": fractions, "behind": [behind] * len(fractions)}
            margin = grid.margin(parts["lag"][0])
        k, numbers, nodes = len(shape.pattern), shape.numbers, grid.nodes + after
        own = in_groups(*(part for name in names for part in parts[name]))
        trace = np.empty((nodes + 1) * k * 3 * numbers * LANES) if read else 0
        out = (k, tally.count) if tally else (grid.samples, k, numbers)
        result = function.run(
            len(full), out, nodes=nodes, stored=int(stored), own=own, trace=trace,
            u=grid.inputs(margin, after),
        )  # fmt: skip
        return result if tally or dual else result[..., 0]

    def _parts(self, full: Array, directions: Array | None) -> dict[str, list[Array]]:
        """Return the parts of the block `own` by name, each followed by its slopes in `directions`.

        Each part is `(W, ...)`, or `(1, ...)` if all walkers share it.
        """
        walkers = ObservedWalkers(
            self.sensors, full if directions is None else Dual(full, directions)
        )
        known = self._shared_parts or self._walker_parts(walkers)
        parts = {"parameters": walkers.parameters, **known}
        if directions is None:
            return {name: [part] for name, part in parts.items()}
        return {
            name: [part.value, part.slope]
            if isinstance(part, Dual)
            else [part, np.zeros_like(part)]
            for name, part in parts.items()
        }

    def _walker_parts(self, walkers: ObservedWalkers) -> dict[str, Any]:
        """Return the parts that depend on each walker's sensors and start."""
        w, full = self.sensors, walkers.full
        # Only channels with a delay need the states before the start.
        shifts, start = self.sensing.shifts, walkers.start
        before = walkers.before if shifts else linear_map(np.zeros_like, start)
        return {
            "x0": start,
            "rows": walkers.rows,
            "before": before,
            "shift": w.channel_delays(full),
            "lag": w.input_values(self.sensing.input_lags, full),
        }

    @cached_property
    def _shared_parts(self) -> dict[str, Array] | None:
        """Return the parts that are known; None if sensors or the start have unknowns."""
        if not self.sensing.empty:
            return None
        parts = self._walker_parts(
            ObservedWalkers(self.sensors, np.zeros((1, len(self.parameters))))
        )
        return parts | {"before": np.zeros((1, len(self.model.states)))}


def _unit_rows(model: Model) -> Array:
    """Return sensor rows that select each state and each effort, `(1, X + E, X + 1 + E)`."""
    x, e = len(model.states), len(model.frictions)
    rows = np.zeros((1, x + e, x + 1 + e))
    rows[:, range(x), range(x)] = 1.0
    rows[:, range(x, x + e), range(x + 1, x + 1 + e)] = 1.0
    return rows
