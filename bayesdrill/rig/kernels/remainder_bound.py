"""A bound of what rational functions leave of the response of a rig (`kernels.rational_basis`)."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

from bayesdrill.basics.duals import dual
from bayesdrill.rig.kernels.lanes import Builder, Vector, vector
from bayesdrill.rig.kernels.numbers import Matrix, Number, dot, inverted, plus, product

TURNS = 3  # of coordinates towards a walker's own modes
LEAST = -1e-300  # not below zero


class RemainderBound:
    """A bound of what the functions leave: the walker's own response to what is left as its input.

    Of blocks of modal coordinates, |(z - T)^-1| <= 1 / (1 - |T|) on the unit circle.  What blocks do to
    each other, at most Q, is summed to (1 - Q)^-1, which is no bound unless it has no negative entry.
    Coordinates are first turned towards the walker's own modes, so that Q is small.
    """

    def __init__(
        self, b: Builder, blocks: Sequence[Sequence[int]], fall: Matrix, seen: Matrix
    ) -> None:
        self._blocks = blocks
        self._zero, self._one = (Vector(b, vector(number)) for number in (0.0, 1.0))
        values, seen = ([_values(row) for row in matrix] for matrix in (fall, seen))
        self._back: Matrix = []
        for _ in range(TURNS):
            turn = self._turn(values)
            back = inverted(turn)
            values, seen = product(back, product(values, turn)), product(seen, turn)
            self._back = product(back, self._back) if self._back else back
        gains = [_gain(_part(values, block, block)) for block in blocks]
        remaining = [[self._one] * len(blocks) for _ in blocks]
        for i, j in itertools.permutations(range(len(blocks)), 2):
            rows = _part(values, blocks[i], blocks[j])
            remaining[i][j] = -gains[i] * _length([sum(e.size() for e in row) for row in rows])
        series = inverted(remaining)
        fine = gains[0].above(0.0)
        for number in itertools.chain(gains[1:], *series):
            fine = fine.both(number.above(LEAST))
        gains = [fine.chosen(gain, math.inf) for gain in gains]
        # Of each channel, by block of what is left.
        self._shares = [
            [gain * number for gain, number in zip(gains, row, strict=True)]
            for row in product([self._lengths(row) for row in seen], series)
        ]

    def _turn(self, values: Matrix) -> Matrix:
        """Return coordinates in which blocks do little to each other: any would do."""
        turn = plus([[self._zero] * len(values) for _ in values], self._one)
        for block, other in itertools.permutations(self._blocks, 2):
            pairs = ((block, block), (block, other), (other, other), (other, block))
            apart = _apart(*(_part(values, *pair) for pair in pairs))
            for (i, row), (j, column) in itertools.product(enumerate(block), enumerate(other)):
                turn[row][column] = apart[i][j]
        return turn

    def _lengths(self, row: Sequence[Number]) -> list[Number]:
        """Return the length of each block of a vector."""
        return [_length([row[i] for i in block]) for block in self._blocks]

    def add(self, errors: list[Number], left: Sequence[Number], size: Number) -> list[Number]:
        """Return the bounds `(K,)` with those of a source, whose input has this `size`."""
        lengths = self._lengths([dot(row, _values(left)) for row in self._back])
        pairs = zip(errors, self._shares, strict=True)
        return [error + size * dot(lengths, shares) for error, shares in pairs]


def _values(numbers: Sequence[Number]) -> list[Number]:
    return [dual(number).value for number in numbers]


def _part(values: Matrix, rows: Sequence[int], columns: Sequence[int]) -> Matrix:
    return [[values[i][j] for j in columns] for i in rows]


def _length(parts: Sequence[Number]) -> Number:
    return parts[0].size() if len(parts) == 1 else dot(parts, parts).sqrt()


def _apart(mine: Matrix, shared: Matrix, other: Matrix, back: Matrix) -> Matrix:
    """Return X of A X - X B = -C (Sylvester 1884), for A `mine`, B `other` and C `shared`.

    `back`: what the first does to the other.

    By p(A) = 0, with p the characteristic polynomial of A, X p(B) = A C + C B - tr(A) C if A is
    two by two.
    """
    if len(mine) == 1 and len(other) == 1:  # poles that nearly meet stay as they are
        gap, pair = other[0][0] - mine[0][0], (shared[0][0] * back[0][0]).size()
        return [[shared[0][0] * gap / (gap * gap + 4.0 * pair)]]
    if len(mine) == 1:
        return product(shared, inverted(plus(other, -mine[0][0])))
    if len(other) == 1:
        return product(inverted(plus([[-e for e in row] for row in mine], other[0][0])), shared)
    (p, q), (r, s) = mine
    trace, determinant = p + s, p * s - q * r
    sides = zip(product(plus(mine, -trace), shared), product(shared, other), strict=True)
    total = [[a + c for a, c in zip(*rows, strict=True)] for rows in sides]
    over = plus(product(plus(other, -trace), other), determinant)
    return product(total, inverted(over))


def _gain(block: Matrix) -> Number:
    """Return 1 / (1 - |T|), negative or infinite where |T| is not below one."""
    block = plus(block, 1.0)
    if len(block) == 1:
        return 1.0 / (1.0 - block[0][0].size())
    (p, q), (r, s) = block
    half, determinant = 0.5 * dot((p, q, r, s), (p, q, r, s)), p * s - q * r
    inner = half * half - determinant * determinant
    return 1.0 / (1.0 - (half + inner.above(0.0).chosen(inner, 0.0).sqrt()).sqrt())
