"""The exact response of rigs of many states, in steps of several samples, see `kernels.blocks`."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.basics.duals import Dual
from bayesdrill.record.experiment import Experiment
from bayesdrill.rig.kernels.blocks import SLOPES, BlockShape, write_blocks
from bayesdrill.rig.kernels.compiling import Kernel, compile_kernel
from bayesdrill.rig.kernels.lanes import LANES
from bayesdrill.rig.kernels.sums import SQUARES, ResidualSums
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.simulators.contract import aligned, in_groups
from bayesdrill.rig.simulators.long_record import constant_numbers, input_layout, record_blocks
from bayesdrill.rig.simulators.sensors import ObservationModel, ObservedWalkers
from bayesdrill.rig.simulators.stepped import Unstepped

MOST_STATES = 10  # of rigs whose kernels are written out entry by entry
TOGETHER = (SQUARES.name, "signals")  # what is compiled at once


@dataclass(frozen=True, eq=False)
class ChainResponse(Unstepped):
    """The response of a rig of any number of states at even times; no channel is late."""

    model: Model
    experiment: Experiment
    sensing: ObservationModel

    def sums(self, full: Array, tally: ResidualSums, weights: Array | None = None) -> Array:
        """See `Simulator.sums`."""
        numbers = ObservedWalkers(self.sensors, full).numbers
        parts = (numbers,) if weights is None else (numbers, weights)
        return self._run(tally.name, (self.experiment.y.shape[1], tally.count), *parts)

    def signals(self, full: Array) -> Array:
        """See `Simulator.signals`."""
        numbers = ObservedWalkers(self.sensors, full).numbers
        return self._run("signals", self.experiment.y.shape, numbers)

    def sensitivities(self, full: Array, along: Array) -> Array:
        """See `Simulator.sensitivities`."""
        (n, q, p), shape = along.shape, self.experiment.y.shape
        repeated = Dual(np.repeat(full, q, axis=0), along.reshape(n * q, p))
        numbers = ObservedWalkers(self.sensors, repeated).numbers
        slopes = self._run(SLOPES, shape, numbers.value, numbers.slope)
        return slopes.reshape(n, q, *shape)

    def course(self, full: Array, along: Array) -> tuple[Array, Array]:
        """See `Simulator.course`."""
        return self.signals(full), self.sensitivities(full, along)

    def _run(self, name: str, shape: tuple[int, ...], *walkers: Array) -> Array:
        scratch = np.empty((self._shape.scratch(1 + (name == SLOPES)) + 1, LANES))
        return self._kernel(name).run(
            name, len(walkers[0]), shape, samples=len(self.experiment.t),
            parameters=in_groups(*walkers), scratch=aligned(scratch), **self._blocks,
        )  # fmt: skip

    def _kernel(self, name: str) -> Kernel:
        if name not in self._kernels:
            names = TOGETHER if name in TOGETHER else (name,)
            kernel = compile_kernel(write_blocks, self._shape, *names)
            self._kernels.update(dict.fromkeys(names, kernel))
        return self._kernels[name]

    @cached_property
    def _kernels(self) -> dict[str, Kernel]:
        return {}

    @cached_property
    def _shape(self) -> BlockShape:
        layout = input_layout(self.sensors.observed_model, self.experiment, with_lead=True)
        return BlockShape(layout, self.experiment.y.shape[1])

    @cached_property
    def _blocks(self) -> dict[str, Array]:
        """Constants, record, inputs."""
        constants = np.array(constant_numbers(self.experiment))
        return {"constants": constants, **record_blocks(self.experiment)}
