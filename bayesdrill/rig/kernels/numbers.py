"""Numbers of kernels: registers with or without slopes, and small matrices of them in memory.

A number of a kind with slopes takes two vectors, its value and its slope.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from llvmlite import ir

from bayesdrill.basics.duals import Dual, dual, where
from bayesdrill.rig.kernels.lanes import (
    I64,
    VEC,
    VECTORS,
    Builder,
    Lane,
    Loop,
    Mask,
    begin_function,
    vector,
)

Number = Any  # a Lane, or a Dual of them
Column = Mapping[int, Number]


@dataclass(frozen=True, slots=True)
class Kind:
    """Of numbers: registers, or, `dual`, registers with slopes."""

    b: Builder
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
        with b.if_then(b.anywhere(mask.value), likely=False):
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
    return Lane(b, b.fma(left.value, right.value, sum_.value))


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


TINY = 1e-13  # of a diagonal: a pivot below it is rounding


@dataclass(frozen=True, slots=True)
class Memory:
    """Where numbers are kept: `width` vectors each."""

    b: Builder
    slopes: bool

    @property
    def width(self) -> int:
        return 2 if self.slopes else 1

    def at(self, base: ir.Value, index: ir.Value | int) -> ir.Value:
        """The address of a number, or of the first of a row."""
        if isinstance(index, int):
            return self.b.gep(base, [I64(index * self.width)])
        return self.b.gep(base, [self.b.mul(index, I64(self.width))])

    def get(self, base: ir.Value, index: int) -> Number:
        value = Lane(self.b, self.b.read(base, index * self.width))
        if not self.slopes:
            return value
        return Dual(value, Lane(self.b, self.b.read(base, 2 * index + 1)))

    def put(self, number: Number | float, base: ir.Value, index: int) -> None:
        parts = [dual(number).value, dual(number).slope] if self.slopes else [number]
        for k, part in enumerate(parts):
            value = part.value if isinstance(part, Lane) else vector(float(part))
            self.b.write(value, base, index * self.width + k)

    def row(self, base: ir.Value, count: int) -> list[Number]:
        return [self.get(base, k) for k in range(count)]

    def put_row(self, numbers: Iterable[Number | float], base: ir.Value) -> None:
        for index, number in enumerate(numbers):
            self.put(number, base, index)

    def room(self, count: int) -> ir.Value:
        """On the stack, once, wherever the code stands."""
        with self.b.goto_entry_block():
            return self.b.alloca(VEC, I64(count * self.width))

    def clear(self, base: ir.Value, count: int) -> None:
        self.b.clear(base, I64(count * self.width))


def dot(left: Sequence[Number], right: Sequence[Number], start: Number | None = None) -> Number:
    total = start
    for one, other in zip(left, right, strict=True):
        total = fused(one, other, total)
    return total


def emit_product(
    module: ir.Module, shape: tuple[int, int, int], *, slopes: bool = False
) -> ir.Function:
    """`product(out (m, n), a, b)`: of a (m, k) and b (k, n)."""
    m, inner, n = shape
    made, b = _begun(module, f"product_{m}_{inner}_{n}{'d' if slopes else ''}", 3)
    if b is None:
        return made
    out, a, other = made.args
    memory = Memory(b, slopes)
    together = next(size for size in (3, 2, 1) if m % size in (0, 1) and size <= m)

    def some(first: ir.Value, count: int) -> None:
        """`count` rows at once: what is read of the other matrix serves all of them."""
        begin, into = (
            memory.at(base, b.mul(first, I64(size))) for base, size in ((a, inner), (out, n))
        )
        rows = [memory.row(memory.at(begin, r * inner), inner) for r in range(count)]
        for j in range(n):
            column = [memory.get(other, k * n + j) for k in range(inner)]
            for r, own in enumerate(rows):
                memory.put(dot(own, column), into, r * n + j)

    blocks = Loop(b, I64(m // together), [], "rows")
    some(b.mul(blocks.index, I64(together)), together)
    blocks.close([])
    if m % together:
        some(I64(m - 1), 1)
    b.ret_void()
    return made


def _begun(module: ir.Module, name: str, blocks: int) -> tuple[ir.Function, Builder | None]:
    """A function of so many blocks of vectors; nothing to write it with where the module has it."""
    if name in module.globals:
        return module.globals[name], None
    return begin_function(module, name, 0, [VECTORS] * blocks)


def emit_even(
    module: ir.Module, n: int, *, left: bool = False, adds: bool = False, slopes: bool = False
) -> ir.Function:
    """`even(out, a, b)`, all (n, n): a b', or with `left` a' b, of which it is known that it is its own
    transpose: made of its lower half, and so exactly that.
    """
    made, b = _begun(
        module, f"even_{n}{'t' if left else ''}{'a' if adds else ''}{'d' if slopes else ''}", 3
    )
    if b is None:
        return made
    out, a, other = made.args
    memory = Memory(b, slopes)

    def line(base: ir.Value, i: int) -> list[Number]:
        return [memory.get(base, k * n + i if left else i * n + k) for k in range(n)]

    for first in range(0, n, 3):
        rows = {i: line(a, i) for i in range(first, min(first + 3, n))}
        for j in range(max(rows) + 1):
            column = line(other, j)
            for i in (i for i in rows if i >= j):
                total = dot(rows[i], column, memory.get(out, i * n + j) if adds else None)
                for place in {i * n + j, j * n + i}:
                    memory.put(total, out, place)
    b.ret_void()
    return made


def emit_factor(module: ir.Module, n: int) -> ir.Function:
    """`factor(out, a)`: lower triangle with out out' = a (n, n), which may be singular: what is nothing
    beside its diagonal gets a column of zeros.
    """
    made, b = _begun(module, f"factor_{n}", 2)
    if b is None:
        return made
    out, a = made.args
    zero = vector(0.0)
    found: dict[tuple[int, int], Lane] = {}
    for j in range(n):
        diagonal = Lane(b, b.read(a, j * n + j))
        pivot = diagonal
        for k in range(j):
            pivot = fused(-found[j, k], found[j, k], pivot)
        good = b.fcmp_unordered(">", pivot.value, (diagonal * TINY).value)
        good = b.and_(good, b.fcmp_unordered(">", pivot.value, zero))
        size = b.root(b.select(good, pivot.value, vector(1.0)))
        over = Lane(b, b.select(good, b.fdiv(vector(1.0), size), zero))
        found[j, j] = Lane(b, b.select(good, size, zero))
        for i in range(j + 1, n):
            entry = Lane(b, b.read(a, i * n + j))
            for k in range(j):
                entry = fused(-found[i, k], found[j, k], entry)
            found[i, j] = entry * over
    for i in range(n):
        for j in range(n):
            b.write(found[i, j].value if j <= i else zero, out, i * n + j)
    b.ret_void()
    return made


def emit_decomposed(module: ir.Module, n: int) -> ir.Function:
    """`decomposed(out (n, n), a (n, n), determinant)`: L and U with L U = a, one inside the other: L
    without its diagonal of ones, one over that of U.

    Of one and a product of two covariances, of which pivots are as good in their order as in any.
    """
    made, b = _begun(module, f"decomposed_{n}", 3)
    if b is None:
        return made
    out, a, determinant = made.args
    found = {(i, j): Lane(b, b.read(a, i * n + j)) for i in range(n) for j in range(n)}
    total = Lane(b, vector(1.0))
    for k in range(n):
        total = total * found[k, k]
        found[k, k] = 1.0 / found[k, k]
        for i in range(k + 1, n):
            found[i, k] = found[i, k] * found[k, k]
            for j in range(k + 1, n):
                found[i, j] = fused(-found[i, k], found[k, j], found[i, j])
    for (i, j), one in found.items():
        b.write(one.value, out, i * n + j)
    b.write(total.value, determinant, 0)
    b.ret_void()
    return made


def emit_solved(module: ir.Module, n: int, m: int) -> ir.Function:
    """`solved(out (n, m), lu (n, n), x (n, m))`: a^-1 x of what is decomposed."""
    made, b = _begun(module, f"solved_{n}_{m}", 3)
    if b is None:
        return made
    out, lu, x = made.args
    together = next(size for size in (3, 2, 1) if m % size == 0)
    columns = Loop(b, I64(m // together), [], "columns")
    first = b.mul(columns.index, I64(together))
    source, target = b.gep(x, [first]), b.gep(out, [first])
    entry = {(i, j): Lane(b, b.read(lu, i * n + j)) for i in range(n) for j in range(n)}
    found = [[Lane(b, b.read(source, i * m + c)) for c in range(together)] for i in range(n)]
    for i in range(n):
        for j in range(i):
            minus = -entry[i, j]
            found[i] = [fused(minus, y, z) for y, z in zip(found[j], found[i], strict=True)]
    for i in reversed(range(n)):
        for j in range(i + 1, n):
            minus = -entry[i, j]
            found[i] = [fused(minus, y, z) for y, z in zip(found[j], found[i], strict=True)]
        found[i] = [one * entry[i, i] for one in found[i]]
    for i, row in enumerate(found):
        for c, one in enumerate(row):
            b.write(one.value, target, i * m + c)
    columns.close([])
    b.ret_void()
    return made
