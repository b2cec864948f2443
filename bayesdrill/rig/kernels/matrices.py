"""Small matrices of numbers in memory, and products of them: code of loops over their rows.

A number of a kind with slopes takes two vectors, its value and its slope.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from llvmlite import ir

from bayesdrill.basics.duals import Dual, dual
from bayesdrill.rig.kernels.lanes import (
    I64,
    LANES,
    VEC,
    VECTORS,
    Lane,
    Loop,
    function,
    intrinsic,
    load,
    store,
    vector,
)
from bayesdrill.rig.kernels.numbers import Number, fused

TINY = 1e-13  # of a diagonal: a pivot below it is rounding


@dataclass(frozen=True, slots=True)
class Memory:
    """Where numbers are kept: `width` vectors each."""

    b: ir.IRBuilder
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
        value = Lane(self.b, load(self.b, base, index * self.width))
        if not self.slopes:
            return value
        return Dual(value, Lane(self.b, load(self.b, base, 2 * index + 1)))

    def put(self, number: Number | float, base: ir.Value, index: int) -> None:
        parts = [dual(number).value, dual(number).slope] if self.slopes else [number]
        for k, part in enumerate(parts):
            value = part.value if isinstance(part, Lane) else vector(float(part))
            store(self.b, value, base, index * self.width + k)

    def row(self, base: ir.Value, count: int) -> list[Number]:
        return [self.get(base, k) for k in range(count)]

    def room(self, count: int) -> ir.Value:
        """On the stack, once, wherever the code stands."""
        with self.b.goto_entry_block():
            return self.b.alloca(VEC, I64(count * self.width))

    def clear(self, base: ir.Value, count: int) -> None:
        each = Loop(self.b, I64(count * self.width), [], "clear")
        self.b.store(vector(0.0), self.b.gep(base, [each.index]), align=8)
        each.close([])


def dot(left: Sequence[Number], right: Sequence[Number], start: Number | None = None) -> Number:
    total = start
    for one, other in zip(left, right, strict=True):
        total = fused(one, other, total)
    return total


def minus(number: Number) -> Number:
    return -number


def emit_product(
    module: ir.Module,
    shape: tuple[int, int, int],
    *,
    left: bool = False,
    right: bool = False,
    adds: bool = False,
    slopes: bool = False,
) -> ir.Function:
    """`product(out (m, n), a, b)`: of a (m, k), or with `left` its transpose in memory, and b (k, n), or
    with `right` its transpose; `adds` to what is there.
    """
    m, inner, n = shape
    turned = f"{'t' if left else ''}{'r' if right else ''}{'a' if adds else ''}"
    name = f"product_{m}_{inner}_{n}{turned}{'d' if slopes else ''}"
    if name in module.globals:
        return module.globals[name]
    made = function(module, name, 0, [VECTORS] * 3)
    out, a, other = made.args
    b = ir.IRBuilder(made.append_basic_block())
    memory = Memory(b, slopes)
    together = next(size for size in (3, 2, 1) if m % size in (0, 1) and size <= m)
    singles = m % together

    def some(first: ir.Value | int, count: int) -> None:
        """`count` rows at once: what is read of the other matrix serves all of them."""
        rows = []
        for r in range(count):
            if left:
                begin = memory.at(a, first)
                rows.append([memory.get(begin, k * m + r) for k in range(inner)])
            else:
                offset = first * inner if isinstance(first, int) else b.mul(first, I64(inner))
                rows.append(memory.row(memory.at(memory.at(a, offset), r * inner), inner))
        offset = first * n if isinstance(first, int) else b.mul(first, I64(n))
        into = memory.at(out, offset)
        for j in range(n):
            column = [
                memory.get(other, j * inner + k if right else k * n + j) for k in range(inner)
            ]
            for r, own in enumerate(rows):
                start = memory.get(into, r * n + j) if adds else None
                memory.put(dot(own, column, start), into, r * n + j)

    blocks = Loop(b, I64(m // together), [], "rows")
    some(b.mul(blocks.index, I64(together)), together)
    blocks.close([])
    if singles:
        some(m - 1, 1)
    b.ret_void()
    return made


def root(b: ir.IRBuilder, value: ir.Value) -> ir.Value:
    return b.call(intrinsic(b.module, f"llvm.sqrt.v{LANES}f64", VEC, [VEC]), [value])


def emit_factor(module: ir.Module, n: int) -> ir.Function:
    """`factor(out, a)`: lower triangle with out out' = a (n, n), which may be singular: what is nothing
    beside its diagonal gets a column of zeros.
    """
    name = f"factor_{n}"
    if name in module.globals:
        return module.globals[name]
    made = function(module, name, 0, [VECTORS] * 2)
    out, a = made.args
    b = ir.IRBuilder(made.append_basic_block())
    zero = vector(0.0)
    found: dict[tuple[int, int], Lane] = {}
    for j in range(n):
        diagonal = Lane(b, load(b, a, j * n + j))
        pivot = diagonal
        for k in range(j):
            pivot = fused(-found[j, k], found[j, k], pivot)
        good = b.fcmp_unordered(">", pivot.value, (diagonal * TINY).value)
        good = b.and_(good, b.fcmp_unordered(">", pivot.value, zero))
        size = root(b, b.select(good, pivot.value, vector(1.0)))
        over = Lane(b, b.select(good, b.fdiv(vector(1.0), size), zero))
        found[j, j] = Lane(b, b.select(good, size, zero))
        for i in range(j + 1, n):
            entry = Lane(b, load(b, a, i * n + j))
            for k in range(j):
                entry = fused(-found[i, k], found[j, k], entry)
            found[i, j] = entry * over
    for i in range(n):
        for j in range(n):
            store(b, found[i, j].value if j <= i else zero, out, i * n + j)
    b.ret_void()
    return made


def emit_over(module: ir.Module, m: int, n: int) -> ir.Function:
    """`over(a, l)`: rows of a (m, n) become those of a l'^-1, for a lower triangle l (n, n)."""
    name = f"over_{m}_{n}"
    if name in module.globals:
        return module.globals[name]
    made = function(module, name, 0, [VECTORS] * 2)
    a, triangle = made.args
    b = ir.IRBuilder(made.append_basic_block())
    overs = b.alloca(VEC, I64(n))
    for j in range(n):
        store(b, b.fdiv(vector(1.0), load(b, triangle, j * n + j)), overs, j)
    rows = Loop(b, I64(m), [], "rows")
    row = b.gep(a, [b.mul(rows.index, I64(n))])
    found: list[Lane] = []
    for j in range(n):
        entry = Lane(b, load(b, row, j))
        for k in range(j):
            entry = fused(-found[k], Lane(b, load(b, triangle, j * n + k)), entry)
        found.append(entry * Lane(b, load(b, overs, j)))
        store(b, found[j].value, row, j)
    rows.close([])
    b.ret_void()
    return made


def emit_solve(module: ir.Module, n: int, m: int) -> ir.Function:
    """`solve(x, a, determinant)`: x (n, m) becomes a^-1 x; what is in a (n, n) is lost.

    Of one and a product of two covariances, of which pivots are as good in their order as in any.
    """
    name = f"solve_{n}_{m}"
    if name in module.globals:
        return module.globals[name]
    made = function(module, name, 0, [VECTORS] * 3)
    x, a, determinant = made.args
    b = ir.IRBuilder(made.append_basic_block())
    total = Lane(b, vector(1.0))
    for k in range(n):
        top = [load(b, a, k * n + j) for j in range(k, n)] + [
            load(b, x, k * m + j) for j in range(m)
        ]
        total = total * Lane(b, top[0])
        over = Lane(b, b.fdiv(vector(1.0), top[0]))
        scaled = [Lane(b, one) * over for one in top[1:]]
        for i in range(k + 1, n):
            entry = -Lane(b, load(b, a, i * n + k))
            places = [(a, i * n + j) for j in range(k + 1, n)] + [(x, i * m + j) for j in range(m)]
            for one, place in zip(scaled, places, strict=True):
                store(b, fused(entry, one, Lane(b, load(b, *place))).value, *place)
        places = [(a, k * n + j) for j in range(k + 1, n)] + [(x, k * m + j) for j in range(m)]
        for one, place in zip(scaled, places, strict=True):
            store(b, one.value, *place)
    for k in reversed(range(n - 1)):
        entries = [-Lane(b, load(b, a, k * n + j)) for j in range(k + 1, n)]
        for j in range(m):
            below = [Lane(b, load(b, x, i * m + j)) for i in range(k + 1, n)]
            store(b, dot(entries, below, Lane(b, load(b, x, k * m + j))).value, x, k * m + j)
    store(b, total.value, determinant, 0)
    b.ret_void()
    return made
