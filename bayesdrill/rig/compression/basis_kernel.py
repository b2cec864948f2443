"""Expand the response of a linear rig in orthonormal rational functions, and differentiate it.

The poles of the functions are near those of the rig (Takenaka 1925, Malmquist 1926; for complex
pairs Kautz 1954).  For a pole a of the functions and any pole l of a rig

    1 / (z - l) = (1 - a^2) / ((z - a) (1 - a l)) + (1 - a z) / (z - a) (l - a) / (1 - a l) / (z - l)

The last term is again the response 1 / (z - l), to an input that has passed an all-pass.  It is
smaller by the factor |l - a| / |1 - a l|.  In place of l - 1, the code has the matrix F = Phi - 1 of
a walker (a set of parameters).  So it needs no eigenvalues, and poles may coincide.  The remainder
after the last function has a bound.  F instead of Phi saves digits at a high sampling rate.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import islice

from llvmlite import ir

from bayesdrill.basics.duals import dual
from bayesdrill.rig.kernels.exponential import Layout, number
from bayesdrill.rig.kernels.lanes import Builder, Integer, Loop, Vector, vector
from bayesdrill.rig.kernels.numbers import (
    Blocks,
    Matrix,
    Number,
    Numbers,
    dot,
    inverted,
    multiply_add,
    plus,
    product,
)

REAL, PAIR = 1, 2  # number of coordinates, and of functions per order: real pole, complex pair
ROWS = 4  # rows of the triangle that are multiplied at a time
# Rounds through all poles. The second round expands the remainder of the first, and its rounding
# errors are as small as this remainder.
ROUNDS = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class BasisShape:
    """Kernels are specialised for this structure.

    `slopes` says that numbers have derivatives. On the first `integrators` modal coordinates no rate
    depends. `poles` has the number of coordinates of each pole, in the order in which they follow.
    `impulse` says that the rig moves because of its start. `channels` is K. `sums` is the number of
    sums per channel: 1 for squared residuals, 3 with squared increments and both end residuals.
    """

    layout: Layout
    poles: tuple[int, ...]
    integrators: int
    channels: int
    impulse: bool
    sums: int = 1
    slopes: bool = False

    @property
    def text(self) -> str:
        """See `compile_kernel`."""
        sizes = (self.integrators, self.channels, self.impulse, self.sums)
        return f"{self.poles} {sizes} {self.slopes} {self.layout.text}"

    @property
    def blocks(self) -> list[list[int]]:
        """Return the coordinates of each pole, counted from the first one after the integrators."""
        ends = zip(self.poles, itertools.accumulate(self.poles), strict=True)
        return [[*range(end - size, end)] for size, end in ends]

    @property
    def decaying(self) -> int:
        """Return the number of coordinates that are no integrators."""
        return self.layout.n_states - self.integrators

    @property
    def constant(self) -> bool:
        """Return whether a constant drives the rig, such as the first value of an interpolated input."""
        if self.layout.first_order:
            return True
        column = self.layout.n_states
        return any(self.layout.reachable[i][column] for i in range(self.layout.n_states))

    @property
    def sources(self) -> list[str]:
        """Return what drives the rig: `impulse` (the start), `constant` (a forcing), each series."""
        series = [f"series {s}" for s in range(self.layout.n_series)]
        return ["impulse"] * self.impulse + ["constant"] * self.constant + series

    def columns(self, orders: Iterable[int]) -> int:
        """Count the columns: functions of all sources, direct terms of a first-order hold, an offset.

        `orders` has the number of functions of each pole in a round.
        """
        poles = sum(n * size for n, size in zip(orders, self.poles, strict=True))
        direct = self.layout.n_series * self.layout.first_order
        return len(self.sources) * (self.integrators + ROUNDS * poles) + direct + 1

    @property
    def walker_size(self) -> int:
        """Return how many numbers a walker has: parameters, start, and rows of channels."""
        rows = self.channels * (self.layout.n_states + 1)
        return self.layout.n_parameters + self.layout.n_states + rows

    def scratch_size(self, columns: int, q: int = 0) -> int:
        """Return how many vectors the scratch memory has."""
        width, products = 2 if self.slopes else 1, (1 + q) * self.channels * self.sums * columns
        return self.coefficients_at + width * self.channels * columns + products + ROWS

    @property
    def coefficients_at(self) -> int:
        """Return how many vectors precede the coefficients: an exponential, and matrices of poles."""
        width = 2 if self.slopes else 1
        return (self.layout.size**2 + 3 * len(self.poles) * self.decaying**2) * width


@dataclass(frozen=True, slots=True)
class PoleNumbers:
    """A real pole a = 1 + mu, or a complex pair, has these numbers.

    With M = `denominator` . (1, F, F^2), a pair has the functions `even_gain` (2 + F) / M and
    -`odd_gain` F / M. A real pole has `even_gain` / M. The `all_pass` (p, q, r) is p + (q + r F) / M.
    Rounding errors are smallest in this form if other modes are far faster or slower.
    """

    denominator: tuple[float, float, float]
    even_gain: float
    odd_gain: float
    all_pass: tuple[float, float, float]

    @classmethod
    def of_pole(cls, mu: complex) -> PoleNumbers:
        """Return the numbers of a real pole, or of a complex pole with its conjugate."""
        m, size = mu.real, abs(mu) ** 2
        if mu.imag == 0.0:
            a = 1.0 + m
            slow = (-1.0 / a, -m * (1.0 + 1.0 / a), 0.0) if a > 0.5 else (0.0, -m, 1.0)
            return cls((-m, -a, 0.0), math.sqrt(-m * (2.0 + m)), 0.0, slow)
        loss = 2.0 * m + size  # |a|^2 - 1
        square = 1.0 + loss
        along = (1.0 / square, loss * size / square, -2.0 * loss * (1.0 + m) / square)
        even, odd = math.sqrt(-0.5 * loss * size), math.sqrt(-0.5 * loss * (4.0 + 4.0 * m + size))
        return cls((size, 2.0 * (loss - m), square), even, odd, along)

    @property
    def numbers(self) -> list[float]:
        """Return all `COUNT` numbers in one list."""
        return [*self.denominator, self.even_gain, self.odd_gain, *self.all_pass]


COUNT = 8  # numbers of a pole


class ModalFrame:
    """The frame has numbers that all walkers share: coordinates, sizes, first inputs, poles.

    `vectors (X, X)` and their inverse `duals` define the modal coordinates. `sizes` are norms of
    the sources over all samples. `first (S,)` is subtracted from interpolated input series. `poles`
    has the `PoleNumbers` of each pole.
    """

    def __init__(self, b: Builder, shape: BasisShape, block: ir.Value) -> None:
        x, places = shape.layout.n_states, itertools.count()
        numbers = (number(b, block, place) for place in places)
        self.vectors, self.duals = (
            [[*islice(numbers, x)] for _ in range(x)] for _ in ("vectors", "duals")
        )
        self.sizes = [*islice(numbers, len(shape.sources))]
        self.first = [*islice(numbers, shape.layout.n_series)]
        self.poles = [[*islice(numbers, COUNT)] for _ in shape.poles]


@dataclass(frozen=True, slots=True)
class ExponentialEntries:
    """A call returns entries of exp(M span) - 1, which is at the address `e`."""

    b: Builder
    shape: BasisShape
    e: ir.Value

    def __call__(self, i: int, column: int) -> Number:
        """Return an entry, with its derivative if numbers have slopes."""
        layout, kind = self.shape.layout, Numbers(self.b, self.shape.slopes)
        reached = layout.reachable[i][column]
        return kind.get(self.e, i * layout.size + column) if reached else kind.zero()


class BasisExpansion:
    """A writer emits the code that expands the response of walkers, with derivatives if wanted."""

    def __init__(self, b: Builder, shape: BasisShape, arguments: dict[str, ir.Value]) -> None:
        self.b, self.shape, self.a = b, shape, arguments
        self._kind = Numbers(b, shape.slopes)
        self.frame = ModalFrame(b, shape, arguments["frame"])
        self.entry = ExponentialEntries(b, shape, arguments["scratch"])
        self.after = b.offset(arguments["scratch"], shape.layout.size**2 * self._kind.width)
        size = shape.decaying**2
        # The matrices of each pole are the inverse of M, the all-pass, and M.
        self.matrices = [[self._room(size) for _ in range(3)] for _ in shape.poles]
        self.count = b.mul(arguments["columns"], shape.channels)
        self.coefficients = self._room(self.count)

    def _room(self, count: Integer) -> Blocks:
        """Take scratch memory for `count` numbers."""
        bases = []
        for _ in range(self._kind.width):
            bases.append(self.after)
            self.after = self.b.offset(self.after, count)
        return Blocks(self.b, tuple(bases))

    def run(self, start: list[Number], rows: Matrix) -> list[ir.Value]:
        """Store the coefficients; return bounds `(K,)` of the truncation error's norm over all samples.

        `start (X,)` is the initial state. `rows (K, X + 1)` are weights of states, then offsets.
        """
        shape, x = self.shape, self.shape.layout.n_states
        rates = [[self.entry(i, j) for j in range(x)] for i in range(x)]
        self.begin(rates, [row[:x] for row in rows])
        column = 0
        for source, size in zip(shape.sources, self.frame.sizes, strict=True):
            column = self.add_source(column, self._drive(source, start, rates), size)
        for s in range(shape.layout.n_series if shape.layout.first_order else 0):
            rise = self._increment(s)
            column = self.store(column, [dot(row[:x], rise) for row in rows])
        self.store(column, [row[x] for row in rows])
        return [error.value for error in self.errors]

    def begin(self, rates: Matrix, rows: Matrix) -> None:
        """Prepare walkers with F, `rates (X, X)`, and `rows (K, X)`: weights of states in channels."""
        x, d = self.shape.layout.n_states, self.shape.integrators
        for base in self.coefficients.bases:
            self.b.clear(base, self.count)
        modal = product(self.frame.duals, product(rates, self.frame.vectors))
        self._fall = [row[d:] for row in modal[d:]]
        self._shown = product(rows, self.frame.vectors)
        self._carried = product([row[d:] for row in modal[:d]], inverted(self._fall)) if d else []
        self._seen = [
            [dot(row[:d], [line[j] for line in self._carried], row[d + j]) for j in range(x - d)]
            for row in self._shown
        ]
        self._store_matrices(self._fall)
        self._bound = _RemainderBound(self.b, self.shape.blocks, self._fall, self._seen)
        self.errors: list[Number] = [Vector(self.b, vector(0.0))] * self.shape.channels

    def add_source(self, column: ir.Value, drive: list[Number], size: Number) -> ir.Value:
        """Store the coefficients of a source from `column` on; return the next column.

        `drive (X,)` is the source's effect on the states, and `size` its norm over all samples.
        """
        d, modes = self.shape.integrators, applied(self.frame.duals, drive)
        for n in range(d):
            lost = dot([-entry for entry in self._carried[n]], modes[d:], modes[n])
            lost_shown = [multiply_add(row[n], lost, None) for row in self._shown]
            column = self.store(column, lost_shown)
        column, remainder = self._expand(column, modes[d:])
        self.errors = self._bound.add(self.errors, remainder, size)
        return column

    def _drive(self, source: str, start: list[Number], rates: Matrix) -> list[Number]:
        """Return the effect of a source on the states from one sample to the next."""
        x, layout = self.shape.layout.n_states, self.shape.layout
        if source == "impulse":
            return start
        if source == "constant":
            columns = range(x + 1, x + 1 + layout.n_series if layout.first_order else x + 1)
            return [
                dot(
                    self.frame.first[: len(columns)],
                    [self.entry(i, j) for j in columns],
                    self.entry(i, x),
                )
                for i in range(x)
            ]
        s = int(source.split()[1])
        held = [self.entry(i, x + 1 + s) for i in range(x)]
        if not layout.first_order:
            return held
        # As u(k + 1) - u(k) is (z - 1) u, a column of increments acts like F times this column.
        moved = applied(rates, self._increment(s))
        return [a + c for a, c in zip(held, moved, strict=True)]

    def _increment(self, s: int) -> list[Number]:
        x, layout = self.shape.layout.n_states, self.shape.layout
        return [self.entry(i, x + 1 + layout.n_series + s) for i in range(x)]

    def _store_matrices(self, fall: Matrix) -> None:
        """Store for each pole the matrices of its functions, see `PoleNumbers`."""
        square = product(fall, fall) if PAIR in self.shape.poles else []
        powers = [[*zip(*rows, strict=True)] for rows in zip(fall, square or fall, strict=True)]
        for index, size in enumerate(self.shape.poles):
            constant, *over, _, _, first, second, third = self.frame.poles[index]
            terms = [[dot(over[:size], entries[:size]) for entries in row] for row in powers]
            matrix = plus(terms, constant)
            inverse = inverted(matrix)
            scaled = [[multiply_add(third, entry, None) for entry in row] for row in fall]
            passed = plus(product(plus(scaled, second), inverse), first)
            for blocks, part in zip(self.matrices[index], (inverse, passed, matrix), strict=True):
                blocks.put_row(itertools.chain(*part))

    def _expand(self, column: ir.Value, x: list[Number]) -> tuple[ir.Value, list[Number]]:
        """Store a source's coefficients from `column` on; return the next column, and the remainder."""
        rounds = Loop(self.b, ROUNDS, [column, *self._kind.flat(x)], "rounds")
        column, x = rounds.carried[0], self._kind.shaped(rounds.carried[1:])
        for index in range(len(self.shape.poles)):
            column, x = self._expand_pole(index, column, x)
        rounds.close([column, *self._kind.flat(x)])
        return column, x

    def _expand_pole(
        self, index: int, column: ir.Value, x: list[Number]
    ) -> tuple[ir.Value, list[Number]]:
        b, n, size = self.b, self.shape.decaying, self.shape.poles[index]
        even, odd = self.frame.poles[index][3:5]
        inverse, pass_, over = (
            [[blocks.get(i * n + j) for j in range(n)] for i in range(n)]
            for blocks in self.matrices[index]
        )
        order = b.single(self.a["orders"], index)
        loop = Loop(b, order, self._kind.flat(applied(inverse, x)), "order")
        x = self._kind.shaped(loop.carried)
        at = b.add(column, b.mul(loop.index, size))
        if size == REAL:
            self._store_shown(at, x, even)
        else:
            moved = applied(self._fall, x)
            sums = [v + v + y for v, y in zip(x, moved, strict=True)]
            at = self._store_shown(at, sums, even)
            self._store_shown(at, moved, -odd)
        following = applied(pass_, x)
        loop.close(self._kind.flat(following))
        column = b.add(column, b.mul(order, size))
        return column, applied(over, following)

    def _store_shown(self, column: ir.Value, x: list[Number], factor: Number) -> ir.Value:
        shown = [multiply_add(dot(row, x), factor, None) for row in self._seen]
        return self.store(column, shown)

    def store(self, column: ir.Value, values: list[Number]) -> ir.Value:
        """Store the coefficients of all channels; return the next column."""
        self.coefficients.at(self.b.mul(column, self.shape.channels)).put_row(values)
        return self.b.add(column, 1)


def applied(matrix: Matrix, x: list[Number]) -> list[Number]:
    """Return a matrix times a vector."""
    return [dot(row, x) for row in matrix]


TURNS = 3  # number of turns of coordinates towards a walker's own modes
LEAST = -1e-300  # lower limit of entries that should not be negative


class _RemainderBound:
    """The bound is that of a walker's response to an input that is the remainder of the series.

    For a diagonal block T of modal coordinates, |(z - T)^-1| <= 1 / (1 - |T|) on the unit circle.
    The coupling between blocks is at most Q. Repeated coupling sums to (1 - Q)^-1, a bound only if
    no entry is negative. Coordinates are first turned towards the walker's modes to make Q small.
    """

    def __init__(
        self, b: Builder, blocks: Sequence[Sequence[int]], fall: Matrix, seen: Matrix
    ) -> None:
        self._blocks = blocks
        self._zero, self._one = (Vector(b, vector(number)) for number in (0.0, 1.0))
        values, seen = ([_values(row) for row in matrix] for matrix in (fall, seen))
        self._back: Matrix = []
        for _ in range(TURNS):
            turn = self._decoupled(values)
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
        for entry in itertools.chain(gains[1:], *series):
            fine = fine.both(entry.above(LEAST))
        gains = [fine.chosen(gain, math.inf) for gain in gains]
        # The bound of each channel for a unit remainder in each block.
        self._shares = [
            [gain * number for gain, number in zip(gains, row, strict=True)]
            for row in product([self._lengths(row) for row in seen], series)
        ]

    def _decoupled(self, values: Matrix) -> Matrix:
        """Return coordinates with little coupling between blocks; any choice gives a valid bound."""
        turn = plus([[self._zero] * len(values) for _ in values], self._one)
        for block, other in itertools.permutations(self._blocks, 2):
            pairs = ((block, block), (block, other), (other, other), (other, block))
            solution = _solve_sylvester(*(_part(values, *pair) for pair in pairs))
            for (i, row), (j, column) in itertools.product(enumerate(block), enumerate(other)):
                turn[row][column] = solution[i][j]
        return turn

    def _lengths(self, row: Sequence[Number]) -> list[Number]:
        """Return the length of each block of a vector."""
        return [_length([row[i] for i in block]) for block in self._blocks]

    def add(self, errors: list[Number], remainder: Sequence[Number], size: Number) -> list[Number]:
        """Return the bounds `(K,)` plus that of a source, whose input has the norm `size`."""
        lengths = self._lengths([dot(row, _values(remainder)) for row in self._back])
        pairs = zip(errors, self._shares, strict=True)
        return [error + size * dot(lengths, shares) for error, shares in pairs]


def _values(numbers: Sequence[Number]) -> list[Number]:
    return [dual(number).value for number in numbers]


def _part(values: Matrix, rows: Sequence[int], columns: Sequence[int]) -> Matrix:
    return [[values[i][j] for j in columns] for i in rows]


def _length(parts: Sequence[Number]) -> Number:
    return parts[0].size() if len(parts) == 1 else dot(parts, parts).sqrt()


def _solve_sylvester(mine: Matrix, shared: Matrix, other: Matrix, back: Matrix) -> Matrix:
    """Return X of A X - X B = -C (Sylvester 1884), for A `mine`, B `other` and C `shared`.

    `back` is the coupling in the other direction.

    If A is 2 x 2 with the characteristic polynomial p, then p(A) = 0 gives
    X p(B) = A C + C B - tr(A) C.
    """
    if len(mine) == 1 and len(other) == 1:  # X stays small if poles nearly coincide
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
    """Return 1 / (1 - |T|), which is negative or infinite unless |T| is below one."""
    block = plus(block, 1.0)
    if len(block) == 1:
        return 1.0 / (1.0 - block[0][0].size())
    (p, q), (r, s) = block
    half, determinant = 0.5 * dot((p, q, r, s), (p, q, r, s)), p * s - q * r
    inner = half * half - determinant * determinant
    return 1.0 / (1.0 - (half + inner.above(0.0).chosen(inner, 0.0).sqrt()).sqrt())
