"""Define the numbers with which kernels compute, and small matrices of such numbers.

A number is a vector, which has a lane for each walker (set of parameters).  In kernels with slopes,
it is two vectors: a value and a slope (a directional derivative).
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from llvmlite import ir

from bayesdrill.basics.duals import Dual, dual, where
from bayesdrill.rig.kernels.lanes import (
    Builder,
    Integer,
    Loop,
    Mask,
    Vector,
    register,
    routine,
    vector,
)

Number = Any  # a Vector, or a Dual of two Vectors
Column = Mapping[int, Number]


@dataclass(frozen=True, slots=True)
class Numbers:
    """A kind of numbers has one register for each number or, with `slopes`, two."""

    b: Builder
    slopes: bool

    @property
    def width(self) -> int:
        """Return how many vectors a number takes."""
        return 2 if self.slopes else 1

    def flat(self, numbers: Sequence[Number]) -> list[ir.Value]:
        """Return the registers of numbers: all values, then all slopes."""
        if not self.slopes:
            return [*map(register, numbers)]
        duals = [*map(dual, numbers)]
        return [register(d.value) for d in duals] + [register(d.slope) for d in duals]

    def shaped(self, registers: Sequence[ir.Value]) -> list[Number]:
        """Return numbers from their registers, as the inverse of `flat`."""
        lanes = [Vector(self.b, value) for value in registers]
        n = len(lanes) // 2
        return [*map(Dual, lanes[:n], lanes[n:])] if self.slopes else [*lanes]

    def zero(self) -> Number:
        """Return zero, with a slope where numbers of this kind have one."""
        return self.shaped([vector(0.0)] * self.width)[0]

    # Numbers in memory take `width` vectors each.

    def at(self, base: ir.Value, index: Integer) -> ir.Value:
        """Return the address of number `index` of a block."""
        known = isinstance(index, int)
        return self.b.offset(base, index * self.width if known else self.b.mul(index, self.width))

    def get(self, base: ir.Value, index: Integer) -> Number:
        """Load number `index` of a block."""
        return self.shaped(self.b.read_row(self.at(base, index), self.width))[0]

    def put(self, number: Number, base: ir.Value, index: Integer) -> None:
        """Store number `index` of a block."""
        self.b.write_row(self.flat([number]), self.at(base, index))

    def row(self, base: ir.Value, count: int, first: int = 0) -> list[Number]:
        """Load `count` numbers of a block, from number `first` on."""
        return [self.get(base, first + k) for k in range(count)]

    def put_row(self, numbers: Iterable[Number], base: ir.Value, first: int = 0) -> None:
        """Store numbers in a block, from number `first` on."""
        for index, number in enumerate(numbers, start=first):
            self.put(number, base, index)

    def room(self, count: int) -> ir.Value:
        """Reserve `count` numbers, see `Builder.room`."""
        return self.b.room(count * self.width)

    def clear(self, base: ir.Value, count: int) -> None:
        """Store `count` zeros."""
        self.b.clear(base, count * self.width)

    # Code that runs only if some walker needs it.

    def select_if_any(
        self, mask: Mask, default: list[Number], other: Callable[[], list[Number]]
    ) -> list[Number]:
        """Return `other` in lanes of the mask, `default` elsewhere.

        The code of `other` runs only if the mask is true in any lane.
        """

        def blended() -> list[Number]:
            return [where(mask, *pair) for pair in zip(other(), default, strict=True)]

        return self.replace_if_any(mask, default, blended)

    def replace_if_any(
        self, mask: Mask, default: list[Number], other: Callable[[], list[Number]]
    ) -> list[Number]:
        """Return `other` in all lanes if the mask is true in any lane, else `default`."""
        old, wanted = self.flat(default), self.b.anywhere(mask.value)
        new = self.b.replace_if(wanted, old, lambda: self.flat(other()), likely=False)
        return self.shaped(new)


def sum_products(
    start: Number, terms: Sequence[tuple[Number, Number]], *, halved: bool = True
) -> Number:
    """Return `start` plus the sum of products, as two partial sums that run in parallel.

    If not `halved`, one sum takes fewer registers: faster where other work fills the pipelines.
    """
    half = (len(terms) + 1) // 2 if halved else len(terms)
    first = start
    for factor, other in terms[:half]:
        first = multiply_add(factor, other, first)
    if len(terms) == half:
        return first
    second: Number = None
    for factor, other in terms[half:]:
        second = multiply_add(factor, other, second)
    return first + second


def multiply_add(factor_a: Number, factor_b: Number, sum_: Number) -> Number:
    """Return factor_a * factor_b + sum_; slopes that are the constant 0.0 get no code."""
    if not any(isinstance(number, Dual) for number in (factor_a, factor_b, sum_)):
        return _lane(factor_a, factor_b, sum_)
    a, b, before = map(dual, (factor_a, factor_b, sum_))
    value, slope = _lane(a.value, b.value, before.value), before.slope
    for factor, change in ((a.slope, b.value), (a.value, b.slope)):
        if not _nothing(factor) and not _nothing(change):
            slope = _lane(factor, change, None if _nothing(slope) else slope)
    return Dual(value, slope)


def _nothing(number: Number) -> bool:
    return isinstance(number, float) and number == 0.0


def _lane(factor: Vector, other: Vector, sum_: Vector | None) -> Vector:
    b = factor.b
    if sum_ is None:
        return Vector(b, b.fmul(factor.value, other.value))
    return Vector(b, b.fma(factor.value, other.value, sum_.value))


def above(number: Number, other: Number) -> Mask:
    """Return in which lanes a number is greater than another; NaN is greater than all."""
    value, bound = dual(number).value, dual(other).value
    return Mask(value.b, value.b.fcmp_unordered(">", value.value, bound.value))


def is_moving(speed: Number) -> Mask:
    """Return in which lanes a speed is not zero; NaN is not zero."""
    value = dual(speed).value
    return Mask(value.b, value.b.fcmp_unordered("!=", value.value, vector(0.0)))


def slip_direction(speed: Number) -> Vector:
    """Return the sign of a speed, and 0 at rest; the sign of NaN is 1 or -1."""
    value = dual(speed).value
    return is_moving(speed).chosen(Vector(value.b, vector(1.0)).signed(value), 0.0)


def is_sticking(direction: Vector) -> Mask:
    """Return in which lanes a direction is zero, so that the friction sticks."""
    return Mask(direction.b, direction.b.fcmp_ordered("==", direction.value, vector(0.0)))


def keeps_direction(direction: Vector, speed: Number) -> Mask:
    """Return in which lanes a speed has the sign `direction`, and this direction is not zero."""
    product = direction.b.fmul(direction.value, dual(speed).value.value)
    return Mask(direction.b, direction.b.fcmp_unordered(">", product, vector(0.0)))


MIN_RELATIVE_PIVOT = 1e-13  # relative to the diagonal: smaller pivots are rounding errors


@dataclass(frozen=True, slots=True)
class Blocks:
    """One block of memory has values; if numbers have slopes, a second block has the slopes."""

    b: Builder
    bases: tuple[ir.Value, ...]

    def at(self, offset: ir.Value) -> Blocks:
        """Return the blocks from an offset on."""
        return Blocks(self.b, tuple(self.b.offset(base, offset) for base in self.bases))

    def get(self, index: int) -> Number:
        """Load a number."""
        parts = [self.b.read(base, index) for base in self.bases]
        return Numbers(self.b, len(parts) > 1).shaped(parts)[0]

    def put_row(self, numbers: Iterable[Number]) -> None:
        """Store the first numbers."""
        kind = Numbers(self.b, len(self.bases) > 1)
        for index, number in enumerate(numbers):
            for base, part in zip(self.bases, kind.flat([number]), strict=True):
                self.b.write(part, base, index)


def dot(left: Sequence[Number], right: Sequence[Number], start: Number | None = None) -> Number:
    """Return the scalar product of two vectors of numbers, added to `start`."""
    total = start
    for factor, weight in zip(left, right, strict=True):
        total = multiply_add(factor, weight, total)
    return total


Matrix = list[list[Number]]  # in registers


def product(left: Matrix, right: Matrix) -> Matrix:
    """Return the product of two matrices."""
    columns = [*zip(*right, strict=True)]
    return [[dot(row, column) for column in columns] for row in left]


def plus(matrix: Matrix, number: Number) -> Matrix:
    """Return a matrix plus a number times the unit matrix."""
    return [
        [entry + number if i == j else entry for j, entry in enumerate(row)]
        for i, row in enumerate(matrix)
    ]


def inverted(matrix: Matrix) -> Matrix:
    """Return the inverse, by Gauss-Jordan elimination without pivoting."""
    rows = [[*row] for row in matrix]
    for i, row in enumerate(rows):
        over = 1.0 / row[i]
        row[:] = [over if j == i else multiply_add(e, over, None) for j, e in enumerate(row)]
        for other in (other for other in rows if other is not row):
            before = [None if j == i else entry for j, entry in enumerate(other)]
            factor = -other[i]
            other[:] = [multiply_add(factor, *pair) for pair in zip(row, before, strict=True)]
    return rows


@routine
def multiply(
    b: Builder,
    out: ir.Value,
    a: ir.Value,
    other: ir.Value,
    sizes: tuple[int, int, int],
    *,
    slopes: bool = False,
) -> None:
    """Store the product of `a (m, inner)` and `other (inner, n)`; `sizes` is (m, inner, n)."""
    (m, inner, n), memory = sizes, Numbers(b, slopes)
    for i, count in strips(b, m, 3):  # each entry of `other` is read once for a strip of rows
        begin, into = (memory.at(base, b.mul(i, size)) for base, size in ((a, inner), (out, n)))
        rows = [memory.row(begin, inner, r * inner) for r in range(count)]
        for j in range(n):
            column = [memory.get(other, k * n + j) for k in range(inner)]
            for r, entries in enumerate(rows):
                memory.put(dot(entries, column), into, r * n + j)


@routine
def multiply_large(
    b: Builder,
    out: ir.Value,
    a: ir.Value,
    other: ir.Value,
    sizes: tuple[int, int, int],
    *,
    slopes: bool = False,
) -> None:
    """Store the product of matrices too large to unroll, by tiles whose sums are registers."""
    (m, inner, n), memory = sizes, Numbers(b, slopes)
    tall, wide = (6, 1) if n == 1 else (2, 3)
    for i, rows in strips(b, m, tall):
        for j, columns in strips(b, n, wide):
            each = Loop(b, inner, [vector(0.0)] * (rows * columns * memory.width), "inner")
            k, totals = each.index, memory.shaped(each.carried)
            first = memory.at(a, b.add(b.mul(i, inner), k))
            left = [memory.get(first, r * inner) for r in range(rows)]
            right = memory.row(memory.at(other, b.add(b.mul(k, n), j)), columns)
            pairs = zip(itertools.product(left, right), totals, strict=True)
            totals = [multiply_add(*factors, total) for factors, total in pairs]
            each.close(memory.flat(totals))
            into = memory.at(out, b.add(b.mul(i, n), j))
            for place, total in enumerate(totals):
                memory.put(total, into, place // columns * n + place % columns)


def strips(b: Builder, count: int, size: int) -> Iterator[tuple[Integer, int]]:
    """Divide `count` rows into strips, and yield their first rows and sizes; full ones share a loop."""
    if count >= size:
        with b.loop(count // size, "strips") as strip:
            yield b.mul(strip, size), size
    if count % size:
        yield count - count % size, count % size


@routine
def multiply_symmetric(
    b: Builder,
    out: ir.Value,
    a: ir.Value,
    other: ir.Value,
    n: int,
    *,
    transposed: bool = False,
    adds: bool = False,
    slopes: bool = False,
) -> None:
    """Store a product of matrices (n, n): out = a other', or a' other if `transposed`.

    The product must be symmetric: only its lower half is computed, and mirrored. With `adds`
    the product is added to `out`.
    """
    memory = Numbers(b, slopes)

    def line(base: ir.Value, i: int) -> list[Number]:
        return [memory.get(base, k * n + i if transposed else i * n + k) for k in range(n)]

    for first in range(0, n, 3):
        rows = {i: line(a, i) for i in range(first, min(first + 3, n))}
        for j in range(max(rows) + 1):
            column = line(other, j)
            for i in (i for i in rows if i >= j):
                total = dot(rows[i], column, memory.get(out, i * n + j) if adds else None)
                for index in {i * n + j, j * n + i}:
                    memory.put(total, out, index)


@routine
def factorise(b: Builder, out: ir.Value, a: ir.Value, n: int) -> None:
    """Store the lower Cholesky factor `out` of a matrix: out out' = a (n, n).

    The matrix may be singular: a pivot that is negligible compared with its diagonal gets a column
    of zeros.
    """
    zero = vector(0.0)
    factor: dict[tuple[int, int], Vector] = {}
    for j in range(n):
        diagonal = Vector(b, b.read(a, j * n + j))
        pivot = diagonal
        for k in range(j):
            pivot = multiply_add(-factor[j, k], factor[j, k], pivot)
        good = b.fcmp_unordered(">", pivot.value, (diagonal * MIN_RELATIVE_PIVOT).value)
        good = b.and_(good, b.fcmp_unordered(">", pivot.value, zero))
        size = b.root(b.select(good, pivot.value, vector(1.0)))
        over = Vector(b, b.select(good, b.fdiv(vector(1.0), size), zero))
        factor[j, j] = Vector(b, b.select(good, size, zero))
        for i in range(j + 1, n):
            entry = Vector(b, b.read(a, i * n + j))
            for k in range(j):
                entry = multiply_add(-factor[i, k], factor[j, k], entry)
            factor[i, j] = entry * over
    for i in range(n):
        for j in range(n):
            b.write(factor[i, j].value if j <= i else zero, out, i * n + j)


@routine
def decompose(b: Builder, out: ir.Value, a: ir.Value, determinant: ir.Value, n: int) -> None:
    """Store L and U with L U = a (n, n) in one matrix, and the determinant.

    The diagonal of L, all ones, is not stored, and that of U is stored inverted.  There is no
    pivoting: a is 1 plus a product of two positive semidefinite matrices, and does not need it.
    """
    entries = {(i, j): Vector(b, b.read(a, i * n + j)) for i in range(n) for j in range(n)}
    total = Vector(b, vector(1.0))
    for k in range(n):
        total = total * entries[k, k]
        entries[k, k] = 1.0 / entries[k, k]
        for i in range(k + 1, n):
            entries[i, k] = entries[i, k] * entries[k, k]
            for j in range(k + 1, n):
                entries[i, j] = multiply_add(-entries[i, k], entries[k, j], entries[i, j])
    for (i, j), entry in entries.items():
        b.write(entry.value, out, i * n + j)
    b.write(total.value, determinant, 0)


@routine
def solve(b: Builder, out: ir.Value, lu: ir.Value, x: ir.Value, n: int, m: int) -> None:
    """Store out = a^-1 x (n, m), with `lu` from `decompose` of a (n, n)."""
    together = next(size for size in (3, 2, 1) if m % size == 0)
    with b.loop(m // together, "columns") as columns:
        first = b.mul(columns, together)
        source, target = b.offset(x, first), b.offset(out, first)
        entry = {(i, j): Vector(b, b.read(lu, i * n + j)) for i in range(n) for j in range(n)}
        solution = [
            [Vector(b, b.read(source, i * m + c)) for c in range(together)] for i in range(n)
        ]

        def take(i: int, j: int) -> None:
            """Subtract entry (i, j) times row j from row i."""
            minus, rows = -entry[i, j], zip(solution[j], solution[i], strict=True)
            solution[i] = [multiply_add(minus, *pair) for pair in rows]

        for i in range(n):
            for j in range(i):
                take(i, j)
        for i in reversed(range(n)):
            for j in range(i + 1, n):
                take(i, j)
            solution[i] = [number * entry[i, i] for number in solution[i]]
        for i, row in enumerate(solution):
            for c, number in enumerate(row):
                b.write(number.value, target, i * m + c)
