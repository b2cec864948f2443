"""A bound of what rational functions leave of the response of a rig (`kernels.rational_basis`)."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from llvmlite import ir

from bayesdrill.rig.kernels.jets import JetArithmetic, Jets, Matrix
from bayesdrill.rig.kernels.lanes import Builder, vector

TURNS = 3  # of coordinates towards a walker's own modes


class RemainderBound:
    """A bound of what the functions leave: the walker's own response to what is left as its input.

    Of blocks of modal coordinates, |(z - T)^-1| <= 1 / (1 - |T|) on the unit circle.  What blocks do to
    each other, at most Q, is summed to (1 - Q)^-1, which is no bound unless it has no negative entry.
    Coordinates are first turned towards the walker's own modes, so that Q is small.
    """

    def __init__(
        self, b: Builder, blocks: Sequence[Sequence[int]], fall: Matrix, seen: Matrix
    ) -> None:
        self._b, self._blocks = b, blocks
        a = JetArithmetic(b)
        values, shown_by = ([[number[:1] for number in row] for row in m] for m in (fall, seen))
        seen = shown_by
        self._back: Matrix = []
        for _ in range(TURNS):
            turn = self._turn([[number[0] for number in row] for row in values])
            back = a.inverted(turn)
            values = a.product(back, a.product(values, turn))
            seen = a.product(seen, turn)
            self._back = a.product(back, self._back) if self._back else back
        entries = [[number[0] for number in row] for row in values]
        gains = [
            self._gain([[entries[i][j] for j in block] for i in block]) for block in self._blocks
        ]
        unit = vector(1.0)
        remaining: Matrix = []
        for index, block in enumerate(self._blocks):
            row = []
            for other, columns in enumerate(self._blocks):
                sums = [self._sum(b.absolute(entries[i][j]) for j in columns) for i in block]
                share = b.fneg(b.fmul(gains[index], self._length(sums)))
                row.append((unit if index == other else share,))
            remaining.append(row)
        series = [[number[0] for number in row] for row in a.inverted(remaining)]
        fine = b.fcmp_ordered(">", gains[0], vector(0.0))
        for number in (*gains[1:], *(number for row in series for number in row)):
            fine = b.and_(fine, b.fcmp_ordered(">=", number, vector(0.0)))
        gains = [b.select(fine, gain, vector(math.inf)) for gain in gains]
        # Of each channel, by block of what is left.
        self._shares = []
        for row in seen:
            shown = [self._length([row[i][0] for i in block]) for block in self._blocks]
            self._shares.append(
                [
                    b.fmul(gains[n], self._sum(map(b.fmul, shown, (line[n] for line in series))))
                    for n in range(len(self._blocks))
                ]
            )

    def _turn(self, entries: list[list[ir.Value]]) -> Matrix:
        """Return coordinates in which blocks do little to each other: any would do."""
        n = len(entries)
        turn: Matrix = [[(vector(float(i == j)),) for j in range(n)] for i in range(n)]
        for block in self._blocks:
            for other in (columns for columns in self._blocks if columns is not block):
                parts = [
                    [[(entries[i][j],) for j in columns] for i in rows]
                    for rows, columns in (
                        (block, block),
                        (block, other),
                        (other, other),
                        (other, block),
                    )
                ]
                for i, row in zip(block, self._apart(*parts), strict=True):
                    for j, number in zip(other, row, strict=True):
                        turn[i][j] = number
        return turn

    def _apart(self, block_matrix: Matrix, shared: Matrix, other: Matrix, back: Matrix) -> Matrix:
        """Return X of A X - X B = -C (Sylvester 1884), for A `block_matrix`, B `other` and C `shared`.

        `back`: what the first does to the other.

        By p(A) = 0, with p the characteristic polynomial of A, X p(B) = A C + C B - tr(A) C if A is
        two by two.
        """
        b, a = self._b, JetArithmetic(self._b)
        if len(block_matrix) == 1 and len(other) == 1:  # poles that nearly meet stay as they are
            gap = b.fsub(other[0][0][0], block_matrix[0][0][0])
            pair = b.absolute(b.fmul(shared[0][0][0], back[0][0][0]))
            size = b.fma(gap, gap, b.fmul(vector(4.0), pair))
            return [[(b.fdiv(b.fmul(shared[0][0][0], gap), size),)]]
        if len(block_matrix) == 1:
            apart = a.polynomial([(a.minus(block_matrix[0][0]), None), (a.constant(1.0), other)])
            return a.product(shared, _inverse(a, apart))
        if len(other) == 1:
            apart = a.polynomial([(other[0][0], None), (a.constant(-1.0), block_matrix)])
            return a.product(_inverse(a, apart), shared)
        trace = a.minus(a.add(block_matrix[0][0], block_matrix[1][1]))
        product = a.dot(
            [
                (block_matrix[0][0], block_matrix[1][1]),
                (a.minus(block_matrix[0][1]), block_matrix[1][0]),
            ]
        )
        powers = [(product, None), (trace, other), (a.constant(1.0), a.product(other, other))]
        sides = (a.product(block_matrix, shared), a.product(shared, other))
        total = a.polynomial([(a.constant(1.0), side) for side in sides] + [(trace, shared)])
        return a.product(total, _inverse(a, a.polynomial(powers)))

    def _gain(self, block: list[list[ir.Value]]) -> ir.Value:
        """Return 1 / (1 - |T|), negative or infinite where |T| is not below one."""
        b, unit = self._b, vector(1.0)
        if len(block) == 1:
            size = b.absolute(b.fadd(unit, block[0][0]))
        else:
            (p, q), (r, s) = block
            p, s = b.fadd(unit, p), b.fadd(unit, s)
            squares = self._sum(b.fmul(part, part) for part in (p, q, r, s))
            half = b.fmul(vector(0.5), squares)
            product = b.fsub(b.fmul(p, s), b.fmul(q, r))
            inner = b.fsub(b.fmul(half, half), b.fmul(product, product))
            positive = b.fcmp_ordered(">", inner, vector(0.0))
            inner = b.select(positive, inner, vector(0.0))
            size = b.root(b.fadd(half, b.root(inner)))
        return b.fdiv(unit, b.fsub(unit, size))

    def _sum(self, parts: Iterable[ir.Value]) -> ir.Value:
        total = vector(0.0)
        for part in parts:
            total = self._b.fadd(total, part)
        return total

    def _length(self, parts: list[ir.Value]) -> ir.Value:
        if len(parts) == 1:
            return self._b.absolute(parts[0])
        return self._b.root(self._sum(self._b.fmul(part, part) for part in parts))

    def add(self, errors: list[ir.Value], left: Jets, size: ir.Value) -> list[ir.Value]:
        """Return the bounds `(K,)` with those of a source, whose input has this `size`."""
        b, totals = self._b, []
        left = JetArithmetic(b).apply(self._back, [number[:1] for number in left])
        lengths = [self._length([left[i][0] for i in block]) for block in self._blocks]
        for error, shares in zip(errors, self._shares, strict=True):
            total = self._sum(map(b.fmul, lengths, shares))
            totals.append(b.fma(size, total, error))
        return totals


def _inverse(a: JetArithmetic, matrix: Matrix) -> Matrix:
    """Return the inverse of a matrix of two by two."""
    (p, q), (r, s) = matrix
    over = a.inverse(a.dot([(p, s), (a.minus(q), r)]))
    return [
        [a.times(s, over), a.times(a.minus(q), over)],
        [a.times(a.minus(r), over), a.times(p, over)],
    ]
