"""Vectors of walkers in LLVM's language: constants, memory, loops, gathers, and numbers that write
code.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from llvmlite import ir

from bayesdrill.basics.duals import Choice, Number

LANES = 8

F64 = ir.DoubleType()
I64 = ir.IntType(64)
I32 = ir.IntType(32)
VEC = ir.VectorType(F64, LANES)
INT_VEC = ir.VectorType(I64, LANES)
NUMBERS = F64.as_pointer()  # a block of single numbers, and ...
VECTORS = VEC.as_pointer()  # ... one of vectors: `LANES` numbers each


def vector(value: float) -> ir.Constant:
    return _vector(value, math.copysign(1.0, value))


# A constant is written out as text once, however often a kernel has it.


@lru_cache(maxsize=4096)
def _vector(value: float, sign: float) -> ir.Constant:
    """`sign`: zeros of either sign are equal, and are not the same."""
    return ir.Constant(VEC, [value] * LANES)


@lru_cache(maxsize=4096)
def whole_numbers(value: int) -> ir.Constant:
    return ir.Constant(INT_VEC, [value] * LANES)


@lru_cache(maxsize=4096)
def _place(index: int) -> ir.Constant:
    return I64(index)


def load(b: ir.IRBuilder, base: ir.Value, index: int) -> ir.Value:
    return b.load(b.gep(base, [_place(index)]), align=8)


def store(b: ir.IRBuilder, value: ir.Value, base: ir.Value, index: int) -> None:
    b.store(value, b.gep(base, [_place(index)]), align=8)


def splat(b: ir.IRBuilder, scalar: ir.Value) -> ir.Value:
    """A number of either kind, in all lanes."""
    undefined = ir.Constant(ir.VectorType(scalar.type, LANES), ir.Undefined)
    one = b.insert_element(undefined, scalar, I32(0))
    lanes = ir.Constant(ir.VectorType(I32, LANES), [0] * LANES)
    return b.shuffle_vector(one, undefined, lanes)


def function(module: ir.Module, name: str, counts: int, blocks: Sequence[ir.Type]) -> ir.Function:
    """Takes `counts` integers, then addresses of `blocks` that do not overlap; gives nothing."""
    signature = ir.FunctionType(ir.VoidType(), [I64] * counts + list(blocks))
    made = ir.Function(module, signature, name)
    for argument in made.args[counts:]:
        argument.add_attribute("noalias")
    return made


def intrinsic(module: ir.Module, name: str, result: ir.Type, arguments: list[ir.Type]) -> ir.Value:
    known = module.globals.get(name)
    return known or ir.Function(module, ir.FunctionType(result, arguments), name)


def floor(b: ir.IRBuilder, value: ir.Value) -> ir.Value:
    return b.call(intrinsic(b.module, f"llvm.floor.v{LANES}f64", VEC, [VEC]), [value])


def fma(b: ir.IRBuilder, left: ir.Value, right: ir.Value, total: ir.Value) -> ir.Value:
    name = f"llvm.fmuladd.v{LANES}f64"
    return b.call(intrinsic(b.module, name, VEC, [VEC] * 3), [left, right, total])


def emit_clear(b: ir.IRBuilder, base: ir.Value, count: ir.Value) -> None:
    """Zeros into so many vectors."""
    each = Loop(b, count, [], "clear")
    b.store(vector(0.0), b.gep(base, [each.index]), align=8)
    each.close([])


class Loop:
    """A counted loop (at least one pass) that carries values: read `carried`, then `close`."""

    def __init__(self, b: ir.IRBuilder, count: ir.Value, start: list[ir.Value], name: str) -> None:
        self._b, self._count = b, count
        before = b.block
        self._body = b.append_basic_block(name)
        b.branch(self._body)
        b.position_at_end(self._body)
        self.index = b.phi(I64)
        self.index.add_incoming(I64(0), before)
        self.carried = [b.phi(value.type) for value in start]
        for phi, value in zip(self.carried, start, strict=True):
            phi.add_incoming(value, before)

    def close(self, new: list[ir.Value]) -> None:
        b = self._b
        index = b.add(self.index, I64(1))
        self.index.add_incoming(index, b.block)
        for phi, value in zip(self.carried, new, strict=True):
            phi.add_incoming(value, b.block)
        after = b.append_basic_block("after")
        b.cbranch(b.icmp_signed("<", index, self._count), self._body, after)
        b.position_at_end(after)


@dataclass(frozen=True, slots=True, eq=False)
class Lane(Number):
    """One number of each walker.  Arithmetic with it is written down as code, not carried out.

    A model's formulas, evaluated with these for numbers, become part of the kernel.
    """

    b: ir.IRBuilder
    value: ir.Value

    def _of(self, other: Lane | float) -> ir.Value:
        return other.value if isinstance(other, Lane) else vector(float(other))

    def _with(self, other: Any, operation: str, *, turned: bool = False) -> Any:
        """`operation` of the builder with what is a number too; others know how to take a lane."""
        if not isinstance(other, Lane | float | int):
            return NotImplemented
        pair = (self._of(other), self.value) if turned else (self.value, self._of(other))
        return Lane(self.b, getattr(self.b, operation)(*pair))

    def __add__(self, other: Any) -> Any:
        return self._with(other, "fadd")

    __radd__ = __add__

    def __sub__(self, other: Any) -> Any:
        return self._with(other, "fsub")

    def __rsub__(self, other: Any) -> Any:
        return self._with(other, "fsub", turned=True)

    def __mul__(self, other: Any) -> Any:
        return self._with(other, "fmul")

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Any:
        return self._with(other, "fdiv")

    def __rtruediv__(self, other: Any) -> Any:
        return self._with(other, "fdiv", turned=True)

    def __neg__(self) -> Lane:
        return Lane(self.b, self.b.fneg(self.value))

    def __pow__(self, power: int) -> Lane:
        if not isinstance(power, int) or power < 1:
            raise TypeError("models are compiled: only whole powers from 1 on are known")
        result = self
        for _ in range(power - 1):
            result = result * self
        return result

    def exp(self) -> Lane:
        return Lane(self.b, emit_exp(self.b, self.value))

    def size(self) -> Lane:
        absolute = intrinsic(self.b.module, f"llvm.fabs.v{LANES}f64", VEC, [VEC])
        return Lane(self.b, self.b.call(absolute, [self.value]))

    def signed(self, like: Lane) -> Lane:
        copied = intrinsic(self.b.module, f"llvm.copysign.v{LANES}f64", VEC, [VEC, VEC])
        return Lane(self.b, self.b.call(copied, [self.value, like.value]))

    def below(self, other: Lane | float) -> Mask:
        return Mask(self.b, self.b.fcmp_ordered("<", self.value, self._of(other)))

    def above(self, other: Lane | float) -> Mask:
        return Mask(self.b, self.b.fcmp_ordered(">", self.value, self._of(other)))


@dataclass(frozen=True, slots=True, eq=False)
class Mask(Choice):
    """Of lanes."""

    b: ir.IRBuilder
    value: ir.Value

    def chosen(self, yes: Lane | float, no: Lane | float) -> Lane:
        one, other = (n.value if isinstance(n, Lane) else vector(float(n)) for n in (yes, no))
        return Lane(self.b, self.b.select(self.value, one, other))

    def both(self, other: Mask) -> Mask:
        return Mask(self.b, self.b.and_(self.value, other.value))

    def turned(self) -> Mask:
        return Mask(self.b, self.b.not_(self.value))

    def without(self, other: Mask) -> Mask:
        return self.both(other.turned())

    def either(self, other: Mask) -> Mask:
        return Mask(self.b, self.b.or_(self.value, other.value))


_LEAST_POWER = -700.0  # of e; what is smaller still is nothing
_ROUNDER = 1.5 * 2.0**52  # added to a number, it leaves its nearest whole number in the last bits
# Of exp(x) for |x| < log(2)/2, least largest relative error: 2e-9.
_EXP = (
    1.0000000005541665,
    1.0000000363231971,
    0.49999992079816347,
    0.16666420169852542,
    0.041668225569617155,
    0.008374815804161584,
    0.001383684598538632,
)


def even_odd(b: ir.IRBuilder, weights: list[ir.Value], x: ir.Value) -> ir.Value:
    """A polynomial, pairs of its terms at a time: chains of a few operations (Estrin)."""
    while len(weights) > 1:
        ends = [*weights, None] if len(weights) % 2 else weights
        pairs = zip(ends[::2], ends[1::2], strict=True)
        weights = [low if high is None else fma(b, high, x, low) for low, high in pairs]
        x = b.fmul(x, x)
    return weights[0]


def emit_exp(b: ir.IRBuilder, value: ir.Value) -> ir.Value:
    """Of numbers up to 700, to 2e-9: a power of two and a short polynomial."""
    low = b.fcmp_ordered("<", value, vector(_LEAST_POWER))
    value = b.select(low, vector(_LEAST_POWER), value)
    shifted = fma(b, value, vector(1.0 / math.log(2.0)), vector(_ROUNDER))
    whole = b.fsub(shifted, vector(_ROUNDER))
    rest = fma(b, whole, vector(-math.log(2.0)), value)
    total = even_odd(b, [vector(weight) for weight in _EXP], rest)
    power = b.shl(b.bitcast(shifted, INT_VEC), whole_numbers(52))
    return b.bitcast(b.add(b.bitcast(total, INT_VEC), power), VEC)


def largest(b: ir.IRBuilder, values: ir.Value) -> ir.Value:
    """Of whole numbers."""
    name = f"llvm.vector.reduce.smax.v{LANES}i64"
    return b.call(intrinsic(b.module, name, I64, [INT_VEC]), [values])


def anywhere(b: ir.IRBuilder, mask: ir.Value) -> ir.Value:
    return b.icmp_unsigned("!=", b.bitcast(mask, ir.IntType(LANES)), ir.IntType(LANES)(0))


def gather(b: ir.IRBuilder, numbers: ir.Value, places: ir.Value) -> ir.Value:
    """Of a block of single numbers, at the place of each lane; quick where lanes have one place."""

    def of_lane(place: ir.Value, _: int) -> ir.Value:
        return b.load(b.gep(numbers, [place]))

    return _gathered(b, places, of_lane, lambda place: splat(b, of_lane(place, 0)))


def gather_own(b: ir.IRBuilder, vectors: ir.Value, places: ir.Value) -> ir.Value:
    """Of a block of vectors, each lane's number of the vector at its place."""
    numbers = b.bitcast(vectors, F64.as_pointer())

    def of_lane(place: ir.Value, lane: int) -> ir.Value:
        return b.load(b.gep(numbers, [b.add(b.mul(place, I64(LANES)), I64(lane))]))

    return _gathered(b, places, of_lane, lambda place: b.load(b.gep(vectors, [place]), align=8))


def _gathered(
    b: ir.IRBuilder,
    places: ir.Value,
    of_lane: Callable[[ir.Value, int], ir.Value],
    of_all: Callable[[ir.Value], ir.Value],
) -> ir.Value:
    first = b.extract_element(places, I32(0))
    other = b.icmp_signed("!=", places, splat(b, first))
    with b.if_else(anywhere(b, other)) as (then, otherwise):
        with then:
            apart: ir.Value = ir.Constant(VEC, ir.Undefined)
            for lane in range(LANES):
                number = of_lane(b.extract_element(places, I32(lane)), lane)
                apart = b.insert_element(apart, number, I32(lane))
            block_apart = b.block
        with otherwise:
            alike = of_all(first)
            block_alike = b.block
    found = b.phi(VEC)
    found.add_incoming(apart, block_apart)
    found.add_incoming(alike, block_alike)
    return found


def scatter(b: ir.IRBuilder, value: ir.Value, numbers: ir.Value, places: ir.Value) -> None:
    """Lane l of `value` to number l of the vector at the place of the lane."""
    for lane in range(LANES):
        vector_of = b.mul(b.extract_element(places, I32(lane)), I64(LANES))
        place = b.gep(numbers, [b.add(vector_of, I64(lane))])
        b.store(b.extract_element(value, I32(lane)), place)


def turned(b: ir.IRBuilder, rows: list[ir.Value]) -> list[ir.Value]:
    """The transpose of LANES vectors: halves of pairs are exchanged, then quarters, then eighths."""
    rows = list(rows)
    for size in (1, 2, 4):
        for one in (i for i in range(LANES) if not i & size):
            first, second = rows[one], rows[one + size]
            low = [j if not j & size else LANES + j - size for j in range(LANES)]
            high = [j + size if not j & size else LANES + j for j in range(LANES)]
            for row, order in ((one, low), (one + size, high)):
                lanes = ir.Constant(ir.VectorType(I32, LANES), order)
                rows[row] = b.shuffle_vector(first, second, lanes)
    return rows


def dot(b: ir.IRBuilder, base: ir.Value, first: int, values: list[ir.Value]) -> ir.Value:
    """Of the vectors at `base` from `first` on with `values`."""
    total = b.fmul(load(b, base, first), values[0])
    for place, value in enumerate(values[1:], start=first + 1):
        total = fma(b, load(b, base, place), value, total)
    return total
