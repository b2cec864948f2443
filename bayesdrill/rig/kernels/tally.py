"""What kernels add up, channel by channel, of what is left of samples: what densities are made of."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from llvmlite import ir

from bayesdrill.rig.kernels.lanes import INT_VEC, VEC, fma, vector, whole_numbers

Values = list[ir.Value]


@dataclass(frozen=True, slots=True)
class Tally:
    """Squares.  `weighed`: walkers have a weight for each channel.  Registers carried from sample to
    sample begin as `start`, one vector each.
    """

    start: tuple[float, ...] = (0.0,)
    weighed: bool = False

    @property
    def count(self) -> int:
        return len(self.start)

    def begun(self, channels: int = 1) -> Values:
        """Of so many channels, one after the other."""
        return [vector(value) for value in self.start] * channels

    def added(
        self,
        b: ir.IRBuilder,
        kept: Sequence[ir.Value],
        left: ir.Value,
        seen: ir.Value | None,
        weight: ir.Value | None,
    ) -> Values:
        """With `left` of one more sample, zero in lanes that have not `seen` it (None: all have)."""
        return [fma(b, left, left, kept[0])]


@dataclass(frozen=True, slots=True)
class _Neighbours(Tally):
    """Squares; products of neighbours, as they are seen one after the other; the last, and the first."""

    start: tuple[float, ...] = (0.0, 0.0, 0.0, math.nan)

    def added(
        self,
        b: ir.IRBuilder,
        kept: Sequence[ir.Value],
        left: ir.Value,
        seen: ir.Value | None,
        weight: ir.Value | None,
    ) -> Values:
        squares, products, last, first = kept
        fresh = b.fcmp_unordered("uno", first, first)
        if seen is not None:
            fresh = b.and_(fresh, seen)
        return [
            fma(b, left, left, squares),
            fma(b, left, last, products),
            left if seen is None else b.select(seen, left, last),
            b.select(fresh, left, first),
        ]


_FRACTION = (1 << 52) - 1  # bits of a number that say how far it is from a power of two, ...
_ONE = 1023 << 52  # ... and those of the power, of one


@dataclass(frozen=True, slots=True)
class _Logs(Tally):
    """Squares; and the product of 1 + weight times square: a number from 1 to 2, and, in whole numbers,
    the power of two that it is times.  So no logarithm is taken but that of the whole.
    """

    start: tuple[float, ...] = (0.0, 1.0, 0.0)
    weighed: bool = True

    def added(
        self,
        b: ir.IRBuilder,
        kept: Sequence[ir.Value],
        left: ir.Value,
        seen: ir.Value | None,
        weight: ir.Value | None,
    ) -> Values:
        squares, product, powers = kept
        square = b.fmul(left, left)
        bits = b.bitcast(b.fmul(product, fma(b, weight, square, vector(1.0))), INT_VEC)
        power = b.sub(b.lshr(bits, whole_numbers(52)), whole_numbers(1023))
        fraction = b.or_(b.and_(bits, whole_numbers(_FRACTION)), whole_numbers(_ONE))
        return [
            b.fadd(squares, square),
            b.bitcast(fraction, VEC),
            b.bitcast(b.add(b.bitcast(powers, INT_VEC), power), VEC),
        ]


SQUARES = Tally()
NEIGHBOURS = _Neighbours()
LOGS = _Logs()
