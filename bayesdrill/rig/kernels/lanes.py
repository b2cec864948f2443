"""Write LLVM code for vectors, which hold one number of each of 8 walkers (sets of parameters).

The module has constants, memory, loops and gathers, and numbers whose arithmetic becomes code.  The
place of a walker in all vectors is its lane.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache, wraps
from typing import Any, Concatenate

from llvmlite import ir

from bayesdrill.basics.duals import Choice, Number

LANES = 8
MOST_ON_STACK = 1024  # largest block on the stack, in vectors; larger ones are allocated by malloc
Values = list[ir.Value]
type Integer = ir.Value | int  # a 64-bit integer of a kernel, or a constant

F64 = ir.DoubleType()
I64 = ir.IntType(64)
I32 = ir.IntType(32)
BYTES = ir.IntType(8).as_pointer()
VEC = ir.VectorType(F64, LANES)
INT_VEC = ir.VectorType(I64, LANES)
# The masks that are false, and true, in all lanes.
NOWHERE = ir.Constant(ir.VectorType(ir.IntType(1), LANES), [0] * LANES)
EVERYWHERE = ir.Constant(ir.VectorType(ir.IntType(1), LANES), [1] * LANES)
# Types of blocks: of single numbers, of integers, and of vectors of `LANES` numbers.
NUMBERS, WHOLE, VECTORS = F64.as_pointer(), I64.as_pointer(), VEC.as_pointer()


def vector(value: float) -> ir.Constant:
    """Return a vector constant that has `value` in all lanes."""
    return _vector(value, math.copysign(1.0, value))


# Constants are cached, so that the text of each one is written only once.


@lru_cache(maxsize=4096)
def _vector(value: float, sign: float) -> ir.Constant:
    """Return a constant; `sign` distinguishes 0.0 and -0.0, which are equal keys of the cache."""
    return ir.Constant(VEC, [value] * LANES)


@lru_cache(maxsize=4096)
def _integer_lanes(value: int) -> ir.Constant:
    return ir.Constant(INT_VEC, [value] * LANES)


@lru_cache(maxsize=4096)
def _integer(value: int) -> ir.Constant:
    return I64(value)


def integer(number: Integer) -> ir.Value:
    """Return a 64-bit integer of the kernel; a Python integer becomes a constant."""
    return _integer(number) if isinstance(number, int) else number


_LEAST_POWER = -700.0  # lower exponents of e are raised to this: exp(-700) = 1e-304
_ROUNDER = 1.5 * 2.0**52  # adding it leaves the nearest integer in the last bits of a number
_PI = (math.pi, 1.2246467991473532e-16)  # pi as a double, and pi minus this double
_SIN = tuple((-1.0) ** k / math.factorial(2 * k + 1) for k in range(10))  # sin(x)/x in x^2
# Minimax polynomial of exp(x) for |x| < log(2)/2; its relative error is 2e-9.
_EXP = (
    1.0000000005541665,
    1.0000000363231971,
    0.49999992079816347,
    0.16666420169852542,
    0.041668225569617155,
    0.008374815804161584,
    0.001383684598538632,
)


def _of_whole(name: str) -> Any:
    """Return a method for LLVM's operation `name` on integers, which may be Python's own."""
    write = getattr(ir.IRBuilder, name)

    def method(builder: Builder, *operands: Any, **options: Any) -> ir.Value:
        kinds = [operand.type for operand in operands if isinstance(operand, ir.Value)]
        constant = _integer_lanes if any(isinstance(k, ir.VectorType) for k in kinds) else _integer
        known = (constant(x) if isinstance(x, int) else x for x in operands)
        return write(builder, *known, **options)

    return method


def _of_lanes(name: str, result: ir.Type = VEC) -> Any:
    """Return a method for LLVM's intrinsic function `name` of vectors, with a `result` type."""

    def method(builder: Builder, *operands: ir.Value) -> ir.Value:
        full = f"llvm.{name}.v{LANES}{'i64' if result == I64 else 'f64'}"
        kind = ir.FunctionType(result, [operand.type for operand in operands])
        known = builder.module.globals.get(full)
        return builder.call(known or ir.Function(builder.module, kind, full), operands)

    return method


class Builder(ir.IRBuilder):  # type: ignore[misc]
    """A builder emits the instructions of a function: LLVM's own, and those for vectors."""

    add, sub, mul, sdiv = map(_of_whole, ("add", "sub", "mul", "sdiv"))
    shl, lshr, and_, or_ = map(_of_whole, ("shl", "lshr", "and_", "or_"))
    icmp_signed, select, store = map(_of_whole, ("icmp_signed", "select", "store"))
    floor, absolute, root = map(_of_lanes, ("floor", "fabs", "sqrt"))
    signed = _of_lanes("copysign")  # (value, like)
    fma = _of_lanes("fmuladd")  # factor * other + total, fused where the processor can
    largest = _of_lanes("vector.reduce.smax", I64)  # the largest integer in any lane

    def room(self, count: int, kind: ir.Type = VEC) -> ir.Value:
        """Reserve `count` vectors, only once even in a loop: on the stack or, if many, by malloc."""
        with self.goto_entry_block():
            if count <= MOST_ON_STACK:
                return self.alloca(kind, I64(count))
            found = self.module.globals.get("malloc")
            malloc = found or ir.Function(self.module, ir.FunctionType(BYTES, [I64]), "malloc")
            self.taken.append(self.call(malloc, [I64((count + 1) * 8 * LANES)]))
            start = self.ptrtoint(self.taken[-1], I64)  # start at a cache line
            begin = self.and_(self.add(start, 8 * LANES - 1), -8 * LANES)
            return self.inttoptr(begin, kind.as_pointer())

    def read(self, base: ir.Value, index: Integer) -> ir.Value:
        """Load vector number `index` of a block."""
        return self.load(self.offset(base, index), align=8)

    def write(self, value: ir.Value, base: ir.Value, index: Integer) -> None:
        """Store `value` as vector number `index` of a block."""
        self.store(value, self.offset(base, index), align=8)

    def single(self, base: ir.Value, index: Integer) -> ir.Value:
        """Load number `index` of a block of single numbers or integers."""
        return self.load(self.offset(base, index))

    def shared(self, base: ir.Value, index: Integer) -> ir.Value:
        """Load number `index` of a block of single numbers into all lanes."""
        return self.splat(self.single(base, index))

    def read_row(self, base: ir.Value, count: int) -> list[ir.Value]:
        """Load the first `count` vectors of a block."""
        return [self.read(base, index) for index in range(count)]

    def write_row(self, values: Iterable[ir.Value], base: ir.Value) -> None:
        """Store `values` as the first vectors of a block."""
        for index, value in enumerate(values):
            self.write(value, base, index)

    def slots(self, count: int) -> list[ir.Value]:
        """Reserve memory for `count` single vectors, which LLVM turns into registers if possible."""
        return [self.room(1) for _ in range(count)]

    def read_slots(self, slots: Iterable[ir.Value]) -> list[ir.Value]:
        """Load the vectors in these slots."""
        return [self.read(slot, 0) for slot in slots]

    def write_slots(self, values: Sequence[ir.Value], slots: Sequence[ir.Value]) -> None:
        """Store each vector in its slot."""
        for value, slot in zip(values, slots, strict=True):
            self.write(value, slot, 0)

    def offset(self, base: ir.Value, count: Integer, size: Integer | None = None) -> ir.Value:
        """Return the address of entry `count` of a block, or of row `count` if rows have a `size`."""
        return self.gep(base, [integer(count if size is None else self.mul(count, size))])

    @contextmanager
    def loop(self, count: Integer, name: str) -> Iterator[ir.Value]:
        """Repeat the code written inside, at least once; yield the index of a pass."""
        each = Loop(self, count, [], name)
        yield each.index
        each.close([])

    def clear(self, base: ir.Value, count: Integer) -> None:
        """Store zeros into the first `count` vectors."""
        with self.loop(count, "clear") as index:
            self.write(vector(0.0), base, index)

    def copy(self, source: ir.Value, target: ir.Value, count: int) -> None:
        """Copy `count` vectors."""
        with self.loop(count, "copy") as index:
            self.write(self.read(source, index), target, index)

    def minimum(self, count: ir.Value, other: Integer) -> ir.Value:
        """Return the smaller of two integers."""
        return self.select(self.icmp_signed("<", count, other), count, other)

    def splat(self, scalar: Integer) -> ir.Value:
        """Broadcast a number or an integer to all lanes."""
        scalar = integer(scalar)
        undefined = ir.Constant(ir.VectorType(scalar.type, LANES), ir.Undefined)
        single = self.insert_element(undefined, scalar, I32(0))
        lanes = ir.Constant(ir.VectorType(I32, LANES), [0] * LANES)
        return self.shuffle_vector(single, undefined, lanes)

    def add_products(
        self, pairs: Iterable[tuple[ir.Value, ir.Value]], total: ir.Value | None = None
    ) -> ir.Value:
        """Return `total`, or zero if None, plus the products of pairs, added one by one."""
        total = vector(0.0) if total is None else total
        for factor, other in pairs:
            total = self.fma(factor, other, total)
        return total

    def anywhere(self, mask: ir.Value) -> ir.Value:
        """Return whether a mask is true in any lane."""
        bits = ir.IntType(LANES)
        return self.icmp_unsigned("!=", self.bitcast(mask, bits), bits(0))

    def polynomial(self, numbers: Sequence[float], x: ir.Value) -> ir.Value:
        """Evaluate a polynomial, constant term first, by pairs of its terms (Estrin 1960)."""
        weights = [*map(vector, numbers)]
        while len(weights) > 1:
            ends = [*weights, None] if len(weights) % 2 else weights
            pairs = zip(ends[::2], ends[1::2], strict=True)
            weights = [low if high is None else self.fma(high, x, low) for low, high in pairs]
            x = self.fmul(x, x)
        return weights[0]

    def exp(self, value: ir.Value) -> ir.Value:
        """Return exp(value) for values up to 700, as 2^n times a polynomial; relative error 2e-9."""
        low = self.fcmp_ordered("<", value, vector(_LEAST_POWER))
        value = self.select(low, vector(_LEAST_POWER), value)
        shifted = self.fma(value, vector(1.0 / math.log(2.0)), vector(_ROUNDER))
        whole = self.fsub(shifted, vector(_ROUNDER))
        remaining = self.fma(whole, vector(-math.log(2.0)), value)
        total = self.polynomial(_EXP, remaining)
        power = self.shl(self.bitcast(shifted, INT_VEC), 52)
        return self.bitcast(self.add(self.bitcast(total, INT_VEC), power), VEC)

    def sin(self, value: ir.Value) -> ir.Value:
        """Return sin(value) for |value| up to 1e6, by reduction to +-pi / 2; error 1e-10."""
        shifted = self.fma(value, vector(1.0 / math.pi), vector(_ROUNDER))
        whole = self.fsub(shifted, vector(_ROUNDER))
        remaining = value
        for part in _PI:
            remaining = self.fma(whole, vector(-part), remaining)
        square = self.fmul(remaining, remaining)
        total = self.polynomial(_SIN, square)
        odd = self.shl(self.bitcast(shifted, INT_VEC), 63)
        signed = self.xor(self.bitcast(self.fmul(total, remaining), INT_VEC), odd)
        return self.bitcast(signed, VEC)

    def gather(self, numbers: ir.Value, indices: ir.Value) -> ir.Value:
        """Load a number for each lane, at its own index of a block; fast if all indices are equal."""

        def of_lane(index: ir.Value, _: int) -> ir.Value:
            return self.single(numbers, index)

        return self._gather(indices, of_lane, lambda index: self.shared(numbers, index))

    def gather_lanes(self, vectors: ir.Value, indices: ir.Value) -> ir.Value:
        """Load each lane's component of the vector at the lane's own index of a block."""
        numbers = self.bitcast(vectors, NUMBERS)

        def of_lane(index: ir.Value, lane: int) -> ir.Value:
            return self.single(numbers, self.add(self.mul(index, LANES), lane))

        return self._gather(indices, of_lane, lambda index: self.read(vectors, index))

    def _gather(
        self,
        indices: ir.Value,
        of_lane: Callable[[ir.Value, int], ir.Value],
        of_all: Callable[[ir.Value], ir.Value],
    ) -> ir.Value:
        first = self.extract_element(indices, I32(0))
        other = self.icmp_signed("!=", indices, self.splat(first))
        with self.if_else(self.anywhere(other)) as (then, otherwise):
            with then:
                gathered: ir.Value = ir.Constant(VEC, ir.Undefined)
                for lane in range(LANES):
                    number = of_lane(self.extract_element(indices, I32(lane)), lane)
                    gathered = self.insert_element(gathered, number, I32(lane))
                block_apart = self.block
            with otherwise:
                broadcast = of_all(first)
                block_alike = self.block
        return self.merged((gathered, block_apart), (broadcast, block_alike))

    def merged(self, *cases: tuple[ir.Value, ir.Block]) -> ir.Value:
        """Return the value paired with the basic block from which the code has branched here."""
        result = self.phi(cases[0][0].type)
        for case in cases:
            result.add_incoming(*case)
        return result

    def last_until(self, numbers: ir.Value, place: ir.Value, bound: ir.Value) -> ir.Value:
        """Search increasing `numbers` from `place` on; return the index of the last one <= `bound`."""
        entry, check = self.block, self.append_basic_block("search")
        self.branch(check)
        self.position_at_end(check)
        here = self.phi(INT_VEC)
        here.add_incoming(place, entry)
        following = self.add(here, 1)
        due = self.fcmp_ordered("<=", self.gather(numbers, following), bound)
        new = self.select(due, following, here)
        here.add_incoming(new, self.block)
        after = self.append_basic_block("reached")
        self.cbranch(self.anywhere(due), check, after)
        self.position_at_end(after)
        return here

    def replace_if(
        self,
        flag: ir.Value,
        default: Sequence[ir.Value],
        other: Callable[[], Sequence[ir.Value]],
        *,
        likely: bool | None = None,
    ) -> list[ir.Value]:
        """Return the result of `other` if the flag is true, else `default` without running `other`."""
        before = self.block
        with self.if_then(flag, likely=likely):
            others, inside = other(), self.block
        pairs = zip(default, others, strict=True)
        return [self.merged((old, before), (new, inside)) for old, new in pairs]


class Module(ir.Module):  # type: ignore[misc]
    """The module has kernels with the names of their `arguments`, and the `routines` that they call."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.arguments: dict[str, list[str]] = {}
        self.routines: dict[Any, ir.Function] = {}


@contextmanager
def function(
    module: Module, name: str, kinds: Iterable[ir.Type]
) -> Iterator[tuple[ir.Function, Builder]]:
    """Write a function of counts and addresses of blocks, which do not overlap; it returns nothing."""
    written = ir.Function(module, ir.FunctionType(ir.VoidType(), [*kinds]), name)
    for argument in written.args:
        if isinstance(argument.type, ir.PointerType):
            argument.add_attribute("noalias")
    b = Builder(written.append_basic_block())
    b.taken = Values()  # memory that the function frees at its end
    yield written, b
    for place in b.taken:
        kind = ir.FunctionType(ir.VoidType(), [BYTES])
        b.call(module.globals.get("free") or ir.Function(module, kind, "free"), [place])
    b.ret_void()


@contextmanager
def kernel(
    module: Module, name: str, counts: Sequence[str], blocks: Mapping[str, ir.Type]
) -> Iterator[tuple[dict[str, ir.Value], Builder]]:
    """Write a kernel; yield its arguments by name: `counts`, and the addresses of `blocks`."""
    names = module.arguments[name] = [*counts, *blocks]
    with function(module, name, [*[I64] * len(counts), *blocks.values()]) as (written, b):
        yield dict(zip(names, written.args, strict=True)), b


def routine[**P](
    write: Callable[Concatenate[Builder, P], None],
) -> Callable[Concatenate[Builder, P], None]:
    """Turn a writer of code into a function, which a module contains once and calls repeatedly.

    The function has those arguments that are `ir.Value`, and is specialised for all others.
    """

    @wraps(write)
    def call(b: Builder, /, *args: P.args, **options: P.kwargs) -> None:
        values = [arg for arg in args if isinstance(arg, ir.Value)]
        known = tuple(... if isinstance(arg, ir.Value) else arg for arg in args)
        key = (write, known, tuple(options.items()))
        if key not in b.module.routines:
            name = b.module.get_unique_name(write.__name__)
            with function(b.module, name, [value.type for value in values]) as (written, inner):
                written.linkage = "internal"
                b.module.routines[key] = written
                given = iter(written.args)
                placed: Any = [next(given) if isinstance(arg, ir.Value) else arg for arg in args]
                write(inner, *placed, **options)
        b.call(b.module.routines[key], values)

    return call


class Loop:
    """The loop runs `count` times (at least once) and carries values: read `carried`, then `close`."""

    def __init__(self, b: Builder, count: Integer, start: Iterable[Integer], name: str) -> None:
        self._b, self._count = b, count
        before, begin = b.block, [*map(integer, start)]
        self._body = b.append_basic_block(name)
        b.branch(self._body)
        b.position_at_end(self._body)
        self.index = b.phi(I64)
        self.index.add_incoming(I64(0), before)
        self.carried = [b.phi(value.type) for value in begin]
        for phi, value in zip(self.carried, begin, strict=True):
            phi.add_incoming(value, before)

    def close(self, new: list[ir.Value]) -> None:
        """End a pass with the `new` values, and continue after the loop."""
        b = self._b
        index = b.add(self.index, 1)
        self.index.add_incoming(index, b.block)
        for phi, value in zip(self.carried, new, strict=True):
            phi.add_incoming(value, b.block)
        after = b.append_basic_block("after")
        b.cbranch(b.icmp_signed("<", index, self._count), self._body, after)
        b.position_at_end(after)


@dataclass(frozen=True, slots=True)
class IndexTable:
    """The table has `count` constant integers of a module, stored at an `address`."""

    address: ir.Value
    count: int

    @contextmanager
    def loop(self, b: Builder) -> Iterator[ir.Value]:
        """Repeat the code written inside for each number; yield that number."""
        with b.loop(self.count, "table") as index:
            yield b.load(b.gep(self.address, [I64(0), index]))


def constant_table(module: Module, values: Sequence[int]) -> IndexTable:
    """Write constant integers into a module, and return their table."""
    kind = ir.ArrayType(I64, len(values))
    table = ir.GlobalVariable(module, kind, module.get_unique_name("table"))
    table.linkage, table.global_constant = "internal", True
    table.initializer = ir.Constant(kind, values)
    return IndexTable(table, len(values))


def _method(name: str) -> Any:
    """Return a method that writes the builder's operation `name`."""

    def method(*lanes: Vector) -> Vector:
        b = lanes[0].b
        return Vector(b, getattr(b, name)(*(lane.value for lane in lanes)))

    return method


def _operation(name: str, *, turned: bool = False) -> Callable[[Vector, Any], Any]:
    """Return a method that writes the operation `name`, with operands exchanged if `turned`."""

    def method(lane: Vector, other: Any) -> Any:
        if not isinstance(other, Vector | float | int):
            return NotImplemented
        pair = (lane.value, register(other))
        return Vector(lane.b, getattr(lane.b, name)(*(reversed(pair) if turned else pair)))

    return method


@dataclass(frozen=True, slots=True, eq=False)
class Vector(Number):
    """A vector holds one number of each walker; its arithmetic is written as code.

    The formulas of a model, evaluated with vectors as numbers, become part of the kernel.
    """

    b: Builder
    value: ir.Value

    __add__ = __radd__ = _operation("fadd")
    __sub__, __rsub__ = _operation("fsub"), _operation("fsub", turned=True)
    __mul__ = __rmul__ = _operation("fmul")
    __truediv__, __rtruediv__ = _operation("fdiv"), _operation("fdiv", turned=True)
    __neg__ = _method("fneg")

    def __pow__(self, power: int) -> Vector:
        if not isinstance(power, int) or power < 1:
            raise TypeError("models are compiled: an exponent must be a whole number of at least 1")
        result = self
        for _ in range(power - 1):
            result = result * self
        return result

    exp, sin, sqrt, size = map(_method, ("exp", "sin", "root", "absolute"))
    signed = _method("signed")

    def below(self, other: Vector | float) -> Mask:
        """Return in which lanes the number is less than `other`; NaN never is."""
        return Mask(self.b, self.b.fcmp_ordered("<", self.value, register(other)))

    def above(self, other: Vector | float) -> Mask:
        """Return in which lanes the number is greater than `other`; NaN never is."""
        return Mask(self.b, self.b.fcmp_ordered(">", self.value, register(other)))


def register(number: Vector | float) -> ir.Value:
    """Return the register of a number, or a constant."""
    return number.value if isinstance(number, Vector) else vector(float(number))


@dataclass(frozen=True, slots=True, eq=False)
class Mask(Choice):
    """A mask holds a truth value for each lane."""

    b: Builder
    value: ir.Value

    def chosen(self, yes: Vector | float, no: Vector | float) -> Vector:
        """Select `yes` in lanes where the mask is true, and `no` in the others."""
        return Vector(self.b, self.b.select(self.value, register(yes), register(no)))

    def both(self, other: Mask) -> Mask:
        """Return the logical and of both masks."""
        return Mask(self.b, self.b.and_(self.value, other.value))

    def negate(self) -> Mask:
        """Return the logical not of the mask."""
        return Mask(self.b, self.b.not_(self.value))

    def without(self, other: Mask) -> Mask:
        """Return the mask of lanes where this mask is true and `other` is false."""
        return self.both(other.negate())

    def either(self, other: Mask) -> Mask:
        """Return the logical or of both masks."""
        return Mask(self.b, self.b.or_(self.value, other.value))
