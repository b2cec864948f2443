"""The exact response of rigs of many states: by steps of several samples, see `kernels.blocks`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.rig.kernels.blocks import BlockShape, write_blocks
from bayesdrill.rig.kernels.compiling import compile_kernel
from bayesdrill.rig.kernels.lanes import LANES
from bayesdrill.rig.simulators.contract import Simulator, in_groups, ungrouped
from bayesdrill.rig.simulators.exact import Response

MOST_STATES = 10  # of rigs whose kernels are written out entry by entry


@dataclass(frozen=True, eq=False)
class ChainResponse(Response):
    """The response of a rig of any number of states, whose kernels are loops."""

    def _function(self, name: str) -> Callable[..., None]:
        if name not in self._kernels:
            names = self.together if name in self.together else (name,)
            kernel = compile_kernel(write_blocks, self._layout, *names)
            self._kernels.update(dict.fromkeys(names, kernel))
        return self._kernels[name][name]

    def _run(self, name: str, blocks: Array, out: Array) -> None:
        count = BlockShape(self._layout).scratch(slopes=name == "course")
        scratch = np.empty((count + 1, LANES))
        start = scratch.ctypes.data  # vectors that cross lines of the cache take twice as long
        addresses = (*self._addresses, out.ctypes.data, start + -start % 64)
        self._function(name)(
            len(blocks), len(self.experiment.t), blocks.ctypes.data, *addresses
        )

    def normal(self, theta: Array, directions: Array, weights: Array) -> tuple[Array, Array, Array]:
        """See `Simulator.normal`."""
        return Simulator.normal(self, theta, directions, weights)

    def sensitivities(self, theta: Array, directions: Array) -> Array:
        """See `Simulator.sensitivities`."""
        return self.course(theta, directions)[1]

    def course(self, theta: Array, directions: Array) -> tuple[Array, Array]:
        """See `Simulator.course`."""
        n, q, p = directions.shape
        points = np.concatenate([np.repeat(theta, q, axis=0), directions.reshape(n * q, p)], axis=1)
        blocks, (t_count, k_count) = in_groups(points), self.experiment.y.shape
        out = np.empty((len(blocks), t_count, 2 * k_count, LANES))
        self._run("course", blocks, out)
        both = ungrouped(out, n * q).reshape(n, q, t_count, 2, k_count)
        return both[:, 0, :, 0], both[:, :, :, 1]
