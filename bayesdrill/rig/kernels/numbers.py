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

    def rarely(
        self, mask: Mask, usual: list[Number], other: Callable[[], list[Number]]
    ) -> list[Number]:
        """`other` in lanes of a mask, worked out where there is any; the rest has what is usual."""
        b = self.b
        before, ones = b.block, self.flat(usual)
        with b.if_then(anywhere(b, mask.value), likely=False):
            pairs = zip(other(), usual, strict=True)
            others = self.flat([where(mask, one, instead) for one, instead in pairs])
            inside = b.block
        found = []
        for one, instead in zip(ones, others, strict=True):
            found.append(b.phi(one.type))
            found[-1].add_incoming(one, before)
            found[-1].add_incoming(instead, inside)
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


def keeps_sign(old: Number, new: Number) -> Mask:
    """Whether a speed has the sign that it had; what is zero has none."""
    one, other = dual(old).value, dual(new).value
    product = one.b.fmul(one.value, other.value)
    return Mask(one.b, one.b.fcmp_ordered(">", product, vector(0.0)))
