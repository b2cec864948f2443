"""Numbers of walkers with or without a slope, and small matrices of them, as code."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from llvmlite import ir

from bayesdrill.rig.kernels.lanes import Builder, vector

Jet = tuple[ir.Value, ...]  # a value, or a value and its slope
Jets = list[Jet]
Matrix = list[Jets]


@dataclass(frozen=True, slots=True)
class JetArithmetic:
    """Arithmetic of jets; constants are jets without a slope."""

    b: Builder

    def constant(self, value: float) -> Jet:
        """Return a number that all lanes have."""
        return (vector(value),)

    def add(self, left: Jet, right: Jet) -> Jet:
        """Return a sum."""
        width = max(len(left), len(right))
        pairs = zip(with_slope(left, width), with_slope(right, width), strict=True)
        return tuple(self.b.fadd(*pair) for pair in pairs)

    def dot(self, pairs: Sequence[tuple[Jet, Jet]], total: Jet | None = None) -> Jet:
        """Return a total and the products of all pairs."""
        width = max(len(number) for pair in pairs for number in pair) if pairs else 1
        value, *slopes = with_slope(total or self.constant(0.0), max(width, len(total or ())))
        for left, right in pairs:
            value = self.b.fma(left[0], right[0], value)
            if len(left) > 1:
                slopes = [self.b.fma(left[1], right[0], slopes[0])]
            if len(right) > 1:
                slopes = [self.b.fma(left[0], right[1], slopes[0])]
        return (value, *slopes)

    def times(self, left: Jet, right: Jet) -> Jet:
        """Return a product."""
        return self.dot([(left, right)])

    def minus(self, number: Jet) -> Jet:
        """Return the negative."""
        return tuple(self.b.fneg(part) for part in number)

    def inverse(self, number: Jet) -> Jet:
        """Return one over a number."""
        value = self.b.fdiv(vector(1.0), number[0])
        if len(number) == 1:
            return (value,)
        square = self.b.fmul(value, value)
        return value, self.b.fneg(self.b.fmul(square, number[1]))

    def apply(self, matrix: Matrix, x: Jets) -> Jets:
        """Return a matrix times a vector."""
        return [self.dot(list(zip(row, x, strict=True))) for row in matrix]

    def product(self, left: Matrix, right: Matrix) -> Matrix:
        """Return the product of two matrices."""
        columns = [list(column) for column in zip(*right, strict=True)]
        turned = [self.apply(left, column) for column in columns]
        return [list(row) for row in zip(*turned, strict=True)]

    def inverted(self, matrix: Matrix) -> Matrix:
        """Return the inverse by Gauss and Jordan; modal coordinates need no pivots."""
        n = len(matrix)
        rows = [[*row, *self._unit(n, i)] for i, row in enumerate(matrix)]
        for i in range(n):
            over = self.inverse(rows[i][i])
            rows[i] = [self.times(entry, over) for entry in rows[i]]
            for j in (j for j in range(n) if j != i):
                factor = self.minus(rows[j][i])
                pairs = zip(rows[j], rows[i], strict=True)
                rows[j] = [self.dot([(factor, entry)], old) for old, entry in pairs]
        return [row[n:] for row in rows]

    def _unit(self, n: int, i: int) -> Jets:
        return [self.constant(float(j == i)) for j in range(n)]

    def polynomial(self, powers: Sequence[tuple[Jet, Matrix | None]]) -> Matrix:
        """Return the sum of factors times matrices; None is the unit matrix."""
        n = next(len(matrix) for _, matrix in powers if matrix is not None)

        def entry(i: int, j: int) -> Jet:
            pairs = [(factor, matrix[i][j]) for factor, matrix in powers if matrix is not None]
            units = [factor for factor, matrix in powers if matrix is None and i == j]
            return self.dot(pairs, units[0] if units else None)

        return [[entry(i, j) for j in range(n)] for i in range(n)]


def with_slope(number: Jet, width: int) -> Jet:
    """Return a number with a slope, zero where it has none, if `width` is two."""
    return (*number, *[vector(0.0)] * (width - len(number)))


@dataclass(frozen=True, slots=True)
class JetCells:
    """Memory of jets: a block of values, and one of slopes where they have some."""

    b: Builder
    bases: tuple[ir.Value, ...]

    def __getitem__(self, offset: ir.Value) -> JetCells:
        return JetCells(self.b, tuple(self.b.gep(base, [offset]) for base in self.bases))

    def read(self, index: int) -> Jet:
        """Load a number."""
        return tuple(self.b.read(base, index) for base in self.bases)

    def write(self, number: Jet, index: int) -> None:
        """Store a number."""
        for base, part in zip(self.bases, with_slope(number, len(self.bases)), strict=True):
            self.b.write(part, base, index)

    def read_matrix(self, n: int) -> Matrix:
        """Load a square matrix, row by row."""
        return [[self.read(i * n + j) for j in range(n)] for i in range(n)]

    def write_matrix(self, matrix: Matrix) -> None:
        """Store a matrix, row by row."""
        for index, number in enumerate(entry for row in matrix for entry in row):
            self.write(number, index)
