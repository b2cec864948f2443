"""What a kernel of steps is told: the record's blocks, which stay, and those of walkers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from bayesdrill.rig.ahead import Ahead
from bayesdrill.rig.grouped import in_groups
from bayesdrill.rig.kernels import LANES
from bayesdrill.rig.kernels.stepping import BLOCKS, Kernel, Own, Shape

Array = NDArray[np.float64]
NONE = np.zeros(0)


@dataclass(frozen=True)
class Told:
    """`y (T, K)` of the record."""

    kernel: Kernel
    shape: Shape
    ahead: Ahead
    y: Array

    @cached_property
    def _slices(self) -> dict[str, list[slice]]:
        """Of the numbers of a walker, by part: values, and slopes."""
        found, place, numbers = dict[str, list[slice]](), 0, self.shape.numbers
        for name, count in Own(self.shape).parts.items():
            ends = [place + k * count for k in range(numbers + 1)]
            found[name] = [slice(*both) for both in pairwise(ends)]
            place = ends[-1]
        return found

    @cached_property
    def _width(self) -> int:
        return Own(self.shape).width

    @cached_property
    def _staying(self) -> dict[str, int]:
        """Addresses; asking an array for its own takes as long as twenty steps of a group."""
        blocks = {
            "span": self.ahead.spans,
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
        self.kernel.run(len(own), ahead.samples, nodes, *[places[name] for name in BLOCKS])
        return np.moveaxis(out, -1, 1).reshape(-1, *each)[:n]

    def _in_lanes(self, n: int, parts: Mapping[str, list[Array]]) -> Array:
        """`(G, width, LANES)`, as `Own` has it; the last walker fills the last group."""
        told = parts
        if self.shape.late:
            behind, *shares = self.ahead.delays(parts["lag"])
            told = {**parts, "share": shares, "behind": [behind] * len(shares)}
        rows = np.empty((n, self._width))
        for name, slices in self._slices.items():
            for part, place in zip(told[name], slices, strict=True):
                rows[:, place] = part.reshape(len(part), -1)
        return in_groups(rows)
