"""A bound of what rational functions leave of the response of a rig (`kernels.rational_basis`)."""

from __future__ import annotations

import itertools
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
        values, seen = ([[number[:1] for number in row] for row in m] for m in (fall, seen))
        self._back: Matrix = []
        for _ in range(TURNS):
            turn = self._turn(values)
            back = a.inverted(turn)
            values = a.product(back, a.product(values, turn))
            seen = a.product(seen, turn)
            self._back = a.product(back, self._back) if self._back else back
        gains = [self._gain(_part(values, block, block)) for block in blocks]
        remaining = [[a.constant(1.0)] * len(blocks) for _ in blocks]
        for i, j in itertools.permutations(range(len(blocks)), 2):
            rows = _part(values, blocks[i], blocks[j])
            sums = [(self._sum(b.absolute(number) for (number,) in row),) for row in rows]
            remaining[i][j] = (b.fneg(b.fmul(gains[i], self._length(sums))),)
        series = a.inverted(remaining)
        fine = b.fcmp_ordered(">", gains[0], vector(0.0))
        for number in (*gains[1:], *(number for row in series for (number,) in row)):
            fine = b.and_(fine, b.fcmp_ordered(">=", number, vector(0.0)))
        gains = [b.select(fine, gain, vector(math.inf)) for gain in gains]
        # Of each channel, by block of what is left.
        shown = [[(self._length([row[i] for i in block]),) for block in blocks] for row in seen]
        self._shares = [
            [b.fmul(gain, number) for gain, (number,) in zip(gains, row, strict=True)]
            for row in a.product(shown, series)
        ]

    def _turn(self, values: Matrix) -> Matrix:
        """Return coordinates in which blocks do little to each other: any would do."""
        n = len(values)
        turn: Matrix = [[(vector(float(i == j)),) for j in range(n)] for i in range(n)]
        for block, other in itertools.permutations(self._blocks, 2):
            pairs = ((block, block), (block, other), (other, other), (other, block))
            apart = self._apart(*(_part(values, *pair) for pair in pairs))
            for (i, row), (j, column) in itertools.product(enumerate(block), enumerate(other)):
                turn[row][column] = apart[i][j]
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
            return a.product(shared, a.inverted(apart))
        if len(other) == 1:
            apart = a.polynomial([(other[0][0], None), (a.constant(-1.0), block_matrix)])
            return a.product(a.inverted(apart), shared)
        (p, q), (r, s) = block_matrix
        trace, product = a.minus(a.add(p, s)), a.dot([(p, s), (a.minus(q), r)])
        powers = [(product, None), (trace, other), (a.constant(1.0), a.product(other, other))]
        sides = (a.product(block_matrix, shared), a.product(shared, other))
        total = a.polynomial([(a.constant(1.0), side) for side in sides] + [(trace, shared)])
        return a.product(total, a.inverted(a.polynomial(powers)))

    def _gain(self, block: Matrix) -> ir.Value:
        """Return 1 / (1 - |T|), negative or infinite where |T| is not below one."""
        b, unit = self._b, vector(1.0)
        if len(block) == 1:
            size = b.absolute(b.fadd(unit, block[0][0][0]))
        else:
            ((p,), (q,)), ((r,), (s,)) = block
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

    def _length(self, parts: Jets) -> ir.Value:
        if len(parts) == 1:
            return self._b.absolute(parts[0][0])
        return self._b.root(self._sum(self._b.fmul(part, part) for (part,) in parts))

    def add(self, errors: list[ir.Value], left: Jets, size: ir.Value) -> list[ir.Value]:
        """Return the bounds `(K,)` with those of a source, whose input has this `size`."""
        b, totals = self._b, []
        left = JetArithmetic(b).apply(self._back, [number[:1] for number in left])
        lengths = [self._length([left[i] for i in block]) for block in self._blocks]
        for error, shares in zip(errors, self._shares, strict=True):
            total = self._sum(map(b.fmul, lengths, shares))
            totals.append(b.fma(size, total, error))
        return totals


def _part(values: Matrix, rows: Sequence[int], columns: Sequence[int]) -> Matrix:
    return [[values[i][j] for j in columns] for i in rows]
