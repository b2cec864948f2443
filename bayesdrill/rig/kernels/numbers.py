"""Numbers of kernels: registers, or registers with slopes, and what is made of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from llvmlite import ir

from bayesdrill.basics.arithmetic import where
from bayesdrill.basics.duals import Dual, dual
from bayesdrill.rig.kernels.gathering import anywhere
from bayesdrill.rig.kernels.lanes import Lane, Mask, fma, vector

Number = Any  # a Lane, or a Dual of them
Column = Mapping[int, Number]


@dataclass(frozen=True, slots=True)
class Kind:
    """Of numbers: registers, or, `dual`, registers with slopes."""

    b: ir.IRBuilder
    dual: bool

    def flat(self, numbers: Sequence[Number]) -> list[ir.Value]:
        """As registers, slopes after values."""
        if not self.dual:
            return [_register(number) for number in numbers]
        duals = [dual(number) for number in numbers]
        return [*(_register(d.value) for d in duals), *(_register(d.slope) for d in duals)]

    def shaped(self, registers: Sequence[ir.Value]) -> list[Number]:
        lanes = [Lane(self.b, value) for value in registers]
        if not self.dual:
            return list(lanes)
        n = len(lanes) // 2
        return [Dual(value, slope) for value, slope in zip(lanes[:n], lanes[n:], strict=True)]

    def zero(self) -> Number:
        """With a slope, as what is carried has one."""
        nothing = Lane(self.b, vector(0.0))
        return Dual(nothing, nothing) if self.dual else nothing

    def rarely(
        self, mask: Mask, usual: list[Number], other: Callable[[], list[Number]]
    ) -> list[Number]:
        """`other` in lanes of a mask, worked out where there is any; the rest has what is usual."""

        def chosen() -> list[Number]:
            pairs = zip(other(), usual, strict=True)
            return [where(mask, one, instead) for one, instead in pairs]

        return self.instead(mask, usual, chosen)

    def instead(
        self, mask: Mask, usual: list[Number], other: Callable[[], list[Number]]
    ) -> list[Number]:
        """`other` in all lanes if any is in a mask."""
        b = self.b
        before, ones = b.block, self.flat(usual)
        with b.if_then(anywhere(b, mask.value), likely=False):
            others = self.flat(other())
            inside = b.block
        found = []
        for one, another in zip(ones, others, strict=True):
            found.append(b.phi(one.type))
            found[-1].add_incoming(one, before)
            found[-1].add_incoming(another, inside)
        return self.shaped(found)


def _register(number: Lane | float) -> ir.Value:
    return number.value if isinstance(number, Lane) else vector(number)


def total(start: Number, terms: Sequence[tuple[Number, Number]]) -> Number:
    """Sum of products, in two halves: a step takes as long as its longest chain of additions."""
    half = (len(terms) + 1) // 2
    first = start
    for left, right in terms[:half]:
        first = fused(left, right, first)
    if len(terms) == half:
        return first
    second: Number = None
    for left, right in terms[half:]:
        second = fused(left, right, second)
    return first + second


def fused(left: Number, right: Number, sum_: Number) -> Number:
    """left * right + sum_; a slope of 0.0 is none."""
    one, other = dual(left), dual(right)
    if not isinstance(left, Dual) and not isinstance(right, Dual) and not isinstance(sum_, Dual):
        return _lane(left, right, sum_)
    before = dual(sum_) if sum_ is not None else None
    value = _lane(one.value, other.value, before.value if before else None)
    slope: Number = before.slope if before else 0.0
    for factor, change in ((one.slope, other.value), (one.value, other.slope)):
        if not _nothing(factor) and not _nothing(change):
            slope = _lane(factor, change, None if _nothing(slope) else slope)
    return Dual(value, slope)


def _nothing(number: Number) -> bool:
    return isinstance(number, float) and number == 0.0


def _lane(left: Lane, right: Lane, sum_: Lane | None) -> Lane:
    b = left.b
    if sum_ is None:
        return Lane(b, b.fmul(left.value, right.value))
    return Lane(b, fma(b, left.value, right.value, sum_.value))


def above(one: Number, other: Number) -> Mask:
    """NaN is above all."""
    left, right = dual(one).value, dual(other).value
    return Mask(left.b, left.b.fcmp_unordered(">", left.value, right.value))


def moving(speed: Number) -> Mask:
    """NaN moves."""
    value = dual(speed).value
    return Mask(value.b, value.b.fcmp_unordered("!=", value.value, vector(0.0)))


def way_of(speed: Number) -> Lane:
    """1 or -1 as it goes, 0 where it stands; NaN goes on."""
    value = dual(speed).value
    return moving(speed).chosen(Lane(value.b, vector(1.0)).signed(value), 0.0)


def sticking(way: Lane) -> Mask:
    return Mask(way.b, way.b.fcmp_ordered("==", way.value, vector(0.0)))


def goes_on(way: Lane, speed: Number) -> Mask:
    """Whether a speed is as before; what sticks is not said to."""
    product = way.b.fmul(way.value, dual(speed).value.value)
    return Mask(way.b, way.b.fcmp_unordered(">", product, vector(0.0)))
