"""Write code for vectors of walkers in LLVM's language.

Constants, memory, loops and gathers; and numbers whose arithmetic becomes code.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
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
    """Return a vector constant that has `value` in all lanes."""
    return _vector(value, math.copysign(1.0, value))


# A constant is written out as text once, however often a kernel has it.


@lru_cache(maxsize=4096)
def _vector(value: float, sign: float) -> ir.Constant:
    """`sign`: zeros of either sign are equal, and are not the same."""
    return ir.Constant(VEC, [value] * LANES)


@lru_cache(maxsize=4096)
def whole_numbers(value: int) -> ir.Constant:
    """Return a vector constant of 64-bit integers that has `value` in all lanes."""
    return ir.Constant(INT_VEC, [value] * LANES)


@lru_cache(maxsize=4096)
def _place(index: int) -> ir.Constant:
    return I64(index)


_LEAST_POWER = -700.0  # of e; what is smaller still is nothing
_ROUNDER = 1.5 * 2.0**52  # added to a number, it leaves its nearest whole number in the last bits
_PI = (math.pi, 1.2246467991473532e-16)  # and what a double of it is short of
_SIN = tuple((-1.0) ** k / math.factorial(2 * k + 1) for k in range(10))  # of sin(x)/x, in x^2
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


class Builder(ir.IRBuilder):  # type: ignore[misc]
    """Writes the instructions of a function: LLVM's own, and those that kernels need for vectors."""

    def read(self, base: ir.Value, index: int) -> ir.Value:
        """Load vector number `index` of a block."""
        return self.load(self.gep(base, [_place(index)]), align=8)

    def write(self, value: ir.Value, base: ir.Value, index: int) -> None:
        """Store `value` as vector number `index` of a block."""
        self.store(value, self.gep(base, [_place(index)]), align=8)

    def read_row(self, base: ir.Value, count: int) -> list[ir.Value]:
        """Load the first `count` vectors of a block."""
        return [self.read(base, index) for index in range(count)]

    def write_row(self, values: Iterable[ir.Value], base: ir.Value) -> None:
        """Store `values` as the first vectors of a block."""
        for index, value in enumerate(values):
            self.write(value, base, index)

    def offset(self, base: ir.Value, *counts: ir.Value | int) -> ir.Value:
        """Return the address behind a number of rows.

        The first of `counts` is that number; the product of the others is the size of a row.
        """
        first, *others = counts
        for count in others:
            first = self.mul(first, I64(count) if isinstance(count, int) else count)
        return self.gep(base, [I64(first) if isinstance(first, int) else first])

    def clear(self, base: ir.Value, count: ir.Value) -> None:
        """Store zeros into the first `count` vectors."""
        each = Loop(self, count, [], "clear")
        self.store(vector(0.0), self.gep(base, [each.index]), align=8)
        each.close([])

    def copy(self, source: ir.Value, target: ir.Value, count: int) -> None:
        """Copy `count` vectors."""
        each = Loop(self, I64(count), [], "copy")
        moved = self.load(self.gep(source, [each.index]), align=8)
        self.store(moved, self.gep(target, [each.index]), align=8)
        each.close([])

    def splat(self, scalar: ir.Value) -> ir.Value:
        """Broadcast a number or an integer to all lanes."""
        undefined = ir.Constant(ir.VectorType(scalar.type, LANES), ir.Undefined)
        single = self.insert_element(undefined, scalar, I32(0))
        lanes = ir.Constant(ir.VectorType(I32, LANES), [0] * LANES)
        return self.shuffle_vector(single, undefined, lanes)

    def _intrinsic(self, name: str, *arguments: ir.Value, result: ir.Type = VEC) -> ir.Value:
        known = self.module.globals.get(name)
        kind = ir.FunctionType(result, [argument.type for argument in arguments])
        return self.call(known or ir.Function(self.module, kind, name), arguments)

    def floor(self, value: ir.Value) -> ir.Value:
        """Round each lane down."""
        return self._intrinsic(f"llvm.floor.v{LANES}f64", value)

    def absolute(self, value: ir.Value) -> ir.Value:
        """Return the absolute value of each lane."""
        return self._intrinsic(f"llvm.fabs.v{LANES}f64", value)

    def root(self, value: ir.Value) -> ir.Value:
        """Return the square root of each lane."""
        return self._intrinsic(f"llvm.sqrt.v{LANES}f64", value)

    def signed(self, value: ir.Value, like: ir.Value) -> ir.Value:
        """Return `value` with the signs of `like`."""
        return self._intrinsic(f"llvm.copysign.v{LANES}f64", value, like)

    def fma(self, factor: ir.Value, other: ir.Value, total: ir.Value) -> ir.Value:
        """Return `factor * other + total`, fused where the processor can."""
        return self._intrinsic(f"llvm.fmuladd.v{LANES}f64", factor, other, total)

    def dot(self, base: ir.Value, values: Sequence[ir.Value]) -> ir.Value:
        """Return the sum of products of the vectors at `base` with as many `values`."""
        total = vector(0.0)
        for index, value in enumerate(values):
            total = self.fma(self.read(base, index), value, total)
        return total

    def largest(self, values: ir.Value) -> ir.Value:
        """Return the largest lane of integers."""
        return self._intrinsic(f"llvm.vector.reduce.smax.v{LANES}i64", values, result=I64)

    def anywhere(self, mask: ir.Value) -> ir.Value:
        """Tell whether a mask is true in any lane."""
        bits = ir.IntType(LANES)
        return self.icmp_unsigned("!=", self.bitcast(mask, bits), bits(0))

    def polynomial(self, weights: list[ir.Value], x: ir.Value) -> ir.Value:
        """Evaluate a polynomial by pairs of its terms, in short chains of operations (Estrin 1960)."""
        while len(weights) > 1:
            ends = [*weights, None] if len(weights) % 2 else weights
            pairs = zip(ends[::2], ends[1::2], strict=True)
            weights = [low if high is None else self.fma(high, x, low) for low, high in pairs]
            x = self.fmul(x, x)
        return weights[0]

    def exp(self, value: ir.Value) -> ir.Value:
        """Return e to the power of numbers up to 700, to 2e-9: a power of two times a polynomial."""
        low = self.fcmp_ordered("<", value, vector(_LEAST_POWER))
        value = self.select(low, vector(_LEAST_POWER), value)
        shifted = self.fma(value, vector(1.0 / math.log(2.0)), vector(_ROUNDER))
        whole = self.fsub(shifted, vector(_ROUNDER))
        remaining = self.fma(whole, vector(-math.log(2.0)), value)
        total = self.polynomial([vector(weight) for weight in _EXP], remaining)
        power = self.shl(self.bitcast(shifted, INT_VEC), whole_numbers(52))
        return self.bitcast(self.add(self.bitcast(total, INT_VEC), power), VEC)

    def sin(self, value: ir.Value) -> ir.Value:
        """Return the sine of numbers up to 1e6, to 1e-10: that of the rest beyond whole half turns."""
        shifted = self.fma(value, vector(1.0 / math.pi), vector(_ROUNDER))
        whole = self.fsub(shifted, vector(_ROUNDER))
        remaining = value
        for part in _PI:
            remaining = self.fma(whole, vector(-part), remaining)
        square = self.fmul(remaining, remaining)
        total = self.polynomial([vector(weight) for weight in _SIN], square)
        odd = self.shl(self.bitcast(shifted, INT_VEC), whole_numbers(63))
        signed = self.xor(self.bitcast(self.fmul(total, remaining), INT_VEC), odd)
        return self.bitcast(signed, VEC)

    def gather(self, numbers: ir.Value, places: ir.Value) -> ir.Value:
        """Load for each lane the number at its place of a block; fast where lanes have one place."""

        def of_lane(index: ir.Value, _: int) -> ir.Value:
            return self.load(self.gep(numbers, [index]))

        return self._gather(places, of_lane, lambda index: self.splat(of_lane(index, 0)))

    def gather_lanes(self, vectors: ir.Value, places: ir.Value) -> ir.Value:
        """Load for each lane its own number of the vector at its place of a block."""
        numbers = self.bitcast(vectors, F64.as_pointer())

        def of_lane(index: ir.Value, lane: int) -> ir.Value:
            at = self.add(self.mul(index, I64(LANES)), I64(lane))
            return self.load(self.gep(numbers, [at]))

        def of_all(index: ir.Value) -> ir.Value:
            return self.load(self.gep(vectors, [index]), align=8)

        return self._gather(places, of_lane, of_all)

    def _gather(
        self,
        places: ir.Value,
        of_lane: Callable[[ir.Value, int], ir.Value],
        of_all: Callable[[ir.Value], ir.Value],
    ) -> ir.Value:
        first = self.extract_element(places, I32(0))
        other = self.icmp_signed("!=", places, self.splat(first))
        with self.if_else(self.anywhere(other)) as (then, otherwise):
            with then:
                gathered: ir.Value = ir.Constant(VEC, ir.Undefined)
                for lane in range(LANES):
                    number = of_lane(self.extract_element(places, I32(lane)), lane)
                    gathered = self.insert_element(gathered, number, I32(lane))
                block_apart = self.block
            with otherwise:
                broadcast = of_all(first)
                block_alike = self.block
        result = self.phi(VEC)
        result.add_incoming(gathered, block_apart)
        result.add_incoming(broadcast, block_alike)
        return result

    def scatter_lanes(self, value: ir.Value, numbers: ir.Value, places: ir.Value) -> None:
        """Store lane l of `value` as number l of the vector at the place of the lane."""
        for lane in range(LANES):
            vector_of = self.mul(self.extract_element(places, I32(lane)), I64(LANES))
            address = self.gep(numbers, [self.add(vector_of, I64(lane))])
            self.store(self.extract_element(value, I32(lane)), address)

    def transpose(self, rows: list[ir.Value]) -> list[ir.Value]:
        """Transpose LANES vectors: exchange halves of pairs, then quarters, then eighths."""
        rows = list(rows)
        for size in (1, 2, 4):
            for first_row in (i for i in range(LANES) if not i & size):
                first, second = rows[first_row], rows[first_row + size]
                low = [j if not j & size else LANES + j - size for j in range(LANES)]
                high = [j + size if not j & size else LANES + j for j in range(LANES)]
                for row, order in ((first_row, low), (first_row + size, high)):
                    lanes = ir.Constant(ir.VectorType(I32, LANES), order)
                    rows[row] = self.shuffle_vector(first, second, lanes)
        return rows


def begin_function(
    module: ir.Module, name: str, counts: int, blocks: Sequence[ir.Type]
) -> tuple[ir.Function, Builder]:
    """Begin a function without result, and return it with its builder.

    Its arguments are `counts` integers, then the addresses of `blocks`, which do not overlap.
    """
    signature = ir.FunctionType(ir.VoidType(), [I64] * counts + list(blocks))
    function = ir.Function(module, signature, name)
    for argument in function.args[counts:]:
        argument.add_attribute("noalias")
    return function, Builder(function.append_basic_block())


def begin_kernel(
    module: ir.Module, name: str, counts: Sequence[str], blocks: Mapping[str, ir.Type]
) -> tuple[dict[str, ir.Value], Builder]:
    """Begin a kernel, and return its arguments, `counts` and addresses of `blocks`, by name."""
    function, b = begin_function(module, name, len(counts), list(blocks.values()))
    return dict(zip([*counts, *blocks], function.args, strict=True)), b


class Loop:
    """A counted loop (at least one pass) that carries values: read `carried`, then `close`."""

    def __init__(self, b: Builder, count: ir.Value, start: list[ir.Value], name: str) -> None:
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
        """End a pass with the `new` values, and continue behind the loop."""
        b = self._b
        index = b.add(self.index, I64(1))
        self.index.add_incoming(index, b.block)
        for phi, value in zip(self.carried, new, strict=True):
            phi.add_incoming(value, b.block)
        after = b.append_basic_block("after")
        b.cbranch(b.icmp_signed("<", index, self._count), self._body, after)
        b.position_at_end(after)


def _operation(name: str, *, turned: bool = False) -> Callable[[Vector, Any], Any]:
    """Return a method that writes an operation of the builder; a plain number becomes a constant."""

    def method(lane: Vector, other: Any) -> Any:
        if not isinstance(other, Vector | float | int):
            return NotImplemented
        pair = (lane.value, lane._operand(other))
        return Vector(lane.b, getattr(lane.b, name)(*(reversed(pair) if turned else pair)))

    return method


@dataclass(frozen=True, slots=True, eq=False)
class Vector(Number):
    """One number of each walker, whose arithmetic is written down as code, not carried out.

    A model's formulas, evaluated with these for numbers, become part of the kernel.
    """

    b: Builder
    value: ir.Value

    def _operand(self, other: Vector | float) -> ir.Value:
        return other.value if isinstance(other, Vector) else vector(float(other))

    __add__ = __radd__ = _operation("fadd")
    __sub__, __rsub__ = _operation("fsub"), _operation("fsub", turned=True)
    __mul__ = __rmul__ = _operation("fmul")
    __truediv__, __rtruediv__ = _operation("fdiv"), _operation("fdiv", turned=True)

    def __neg__(self) -> Vector:
        return Vector(self.b, self.b.fneg(self.value))

    def __pow__(self, power: int) -> Vector:
        if not isinstance(power, int) or power < 1:
            raise TypeError("models are compiled: only whole powers from 1 on are known")
        result = self
        for _ in range(power - 1):
            result = result * self
        return result

    def exp(self) -> Vector:
        """See `Builder.exp`."""
        return Vector(self.b, self.b.exp(self.value))

    def sin(self) -> Vector:
        """See `Builder.sin`."""
        return Vector(self.b, self.b.sin(self.value))

    def sqrt(self) -> Vector:
        """Return the square roots."""
        return Vector(self.b, self.b.root(self.value))

    def size(self) -> Vector:
        """Return the absolute values."""
        return Vector(self.b, self.b.absolute(self.value))

    def signed(self, like: Vector) -> Vector:
        """Return these numbers with the signs of `like`."""
        return Vector(self.b, self.b.signed(self.value, like.value))

    def below(self, other: Vector | float) -> Mask:
        """Tell in which lanes it is less than `other`; NaN is not."""
        return Mask(self.b, self.b.fcmp_ordered("<", self.value, self._operand(other)))

    def above(self, other: Vector | float) -> Mask:
        """Tell in which lanes it is greater than `other`; NaN is not."""
        return Mask(self.b, self.b.fcmp_ordered(">", self.value, self._operand(other)))


@dataclass(frozen=True, slots=True, eq=False)
class Mask(Choice):
    """A truth value for each lane."""

    b: Builder
    value: ir.Value

    def chosen(self, yes: Vector | float, no: Vector | float) -> Vector:
        """Select `yes` in lanes where it is true, `no` in others."""
        chosen_value, other_value = (
            n.value if isinstance(n, Vector) else vector(float(n)) for n in (yes, no)
        )
        return Vector(self.b, self.b.select(self.value, chosen_value, other_value))

    def both(self, other: Mask) -> Mask:
        """Return its conjunction with another mask."""
        return Mask(self.b, self.b.and_(self.value, other.value))

    def negate(self) -> Mask:
        """Return its negation."""
        return Mask(self.b, self.b.not_(self.value))

    def without(self, other: Mask) -> Mask:
        """Return the lanes in which it is true and `other` is not."""
        return self.both(other.negate())

    def either(self, other: Mask) -> Mask:
        """Return its disjunction with another mask."""
        return Mask(self.b, self.b.or_(self.value, other.value))
