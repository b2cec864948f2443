"""What kernels add up, channel by channel, of what is left of samples: what densities are made of."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from llvmlite import ir

from bayesdrill.rig.kernels.lanes import INT_VEC, VEC, Builder, Lane, vector, whole_numbers

Values = list[ir.Value]


@dataclass(frozen=True, slots=True)
class Sample:
    """What is `left` of one, zero in lanes that have not `seen` it (None: all have), of a channel with
    these `weights`.
    """

    left: ir.Value
    seen: ir.Value | None
    weights: Sequence[ir.Value]


@dataclass(frozen=True, slots=True)
class Tally:
    """Squares.  `weights`: how many walkers have for each channel.  Registers carried from sample to
    sample begin as `start`, one vector each.  `name`: of the function that adds them up.
    """

    name: str = "misfit"
    start: tuple[float, ...] = (0.0,)
    weights: int = 0

    @property
    def count(self) -> int:
        return len(self.start)

    def begun(self, channels: int = 1) -> Values:
        """Of so many channels, one after the other."""
        return [vector(value) for value in self.start] * channels

    def added(self, b: Builder, kept: Sequence[ir.Value], sample: Sample) -> Values:
        """With one more sample."""
        return [b.fma(sample.left, sample.left, kept[0])]


@dataclass(frozen=True, slots=True)
class _Neighbours(Tally):
    """Squares; products of neighbours, as they are seen one after the other; the last, and the first."""

    name: str = "neighbours"
    start: tuple[float, ...] = (0.0, 0.0, 0.0, math.nan)

    def added(self, b: Builder, kept: Sequence[ir.Value], sample: Sample) -> Values:
        squares, products, last, first = kept
        left, seen = sample.left, sample.seen
        fresh = b.fcmp_unordered("uno", first, first)
        if seen is not None:
            fresh = b.and_(fresh, seen)
        return [
            b.fma(left, left, squares),
            b.fma(left, last, products),
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

    name: str = "logs"
    start: tuple[float, ...] = (0.0, 1.0, 0.0)
    weights: int = 1

    def added(self, b: Builder, kept: Sequence[ir.Value], sample: Sample) -> Values:
        squares, product, powers = kept
        square = b.fmul(sample.left, sample.left)
        factor = b.fma(sample.weights[0], square, vector(1.0))
        return [b.fadd(squares, square), *_times(b, product, powers, factor)]


def _times(b: Builder, product: ir.Value, powers: ir.Value, factor: ir.Value) -> Values:
    """A product and its powers of two, see `_Logs`, times a factor."""
    bits = b.bitcast(b.fmul(product, factor), INT_VEC)
    power = b.sub(b.lshr(bits, whole_numbers(52)), whole_numbers(1023))
    fraction = b.or_(b.and_(bits, whole_numbers(_FRACTION)), whole_numbers(_ONE))
    whole = b.add(b.bitcast(powers, INT_VEC), power)
    return [b.bitcast(fraction, VEC), b.bitcast(whole, VEC)]


DEEP = -8.5  # sds inside of an interval: beyond its end are 1e-17
_TURN = 3.0
# Of (1 + 2 x) erfcx(x) / 2 in (x - turn) / (x + turn), for x from zero on: to 1e-10 (Shepherd and
# Laframboise 1981).
_TAIL = (
    0.626504029134865,
    -0.06781055221817794,
    -0.023781147143580275,
    0.06482254768566878,
    -0.059636832964930137,
    0.034154359726710146,
    -0.011885243345947868,
    0.0012630128247643313,
    0.0009442732342668533,
    -0.00038565099561746285,
    -5.238290620130925e-05,
    5.6594558198715556e-05,
    2.1616152328836802e-06,
    -5.519855373374109e-06,
    -6.585111502014721e-08,
)


def _tail(b: Builder, far: ir.Value) -> ir.Value:
    """Of a standard normal number beyond `far`, over exp(-far^2 / 2); not below zero."""
    x = b.fmul(far, vector(math.sqrt(0.5)))
    wide, twice = b.fadd(x, vector(_TURN)), b.fma(x, vector(2.0), vector(1.0))
    over = b.fdiv(vector(1.0), b.fmul(wide, twice))
    place = b.fmul(b.fmul(b.fsub(x, vector(_TURN)), twice), over)
    return b.fmul(b.polynomial([vector(one) for one in _TAIL], place), b.fmul(wide, over))


@dataclass(frozen=True, slots=True)
class _Intervals(Tally):
    """Squares; and the product, as of `_Logs`, of the probabilities of the intervals of half a width
    about what is left, which are over exp(-x^2 / 2) at the nearer end x if zero is not inside; and the
    logs of what they are over.  Weights: one over the sd, half a width over it, at least 0.2.
    """

    name: str = "intervals"
    start: tuple[float, ...] = (0.0, 1.0, 0.0, 0.0)
    weights: int = 2

    def added(self, b: Builder, kept: Sequence[ir.Value], sample: Sample) -> Values:
        left, seen, (over, half) = sample.left, sample.seen, sample.weights
        middle = b.fmul(Lane(b, left).size().value, over)
        near = b.fsub(middle, half)
        found = [b.fma(left, left, kept[0])]
        # What the noise can hardly have moved out of its interval leaves the product as it is.
        before = b.block
        with b.if_then(b.anywhere(b.fcmp_unordered(">", near, vector(DEEP)))):
            moved = self._moved(b, kept[1:], near, middle, half, seen)
            inside = b.block
        for one, other in zip(kept[1:], moved, strict=True):
            found.append(b.phi(VEC))
            found[-1].add_incoming(one, before)
            found[-1].add_incoming(other, inside)
        return found

    def _moved(
        self,
        b: Builder,
        kept: Sequence[ir.Value],
        near: ir.Value,
        middle: ir.Value,
        half: ir.Value,
        seen: ir.Value | None,
    ) -> Values:
        product, powers, logs = kept
        zero, minus = vector(0.0), vector(-0.5)
        far = b.fadd(middle, half)
        beyond = b.fcmp_ordered(">", near, zero)
        log = b.fmul(b.fmul(near, near), minus)
        here = _tail(b, Lane(b, near).size().value)
        there = b.fmul(_tail(b, far), b.exp(b.fmul(b.fmul(middle, half), vector(-2.0))))
        outside = b.fmul(b.exp(log), b.fadd(here, there))
        mass = b.select(beyond, b.fsub(here, there), b.fsub(vector(1.0), outside))
        if seen is not None:
            mass = b.select(seen, mass, vector(1.0))
        return [*_times(b, product, powers, mass), b.fadd(logs, b.select(beyond, log, zero))]


SQUARES = Tally()
NEIGHBOURS = _Neighbours()
LOGS = _Logs()
INTERVALS = _Intervals()
TALLIES = {tally.name: tally for tally in (SQUARES, NEIGHBOURS, LOGS, INTERVALS)}
