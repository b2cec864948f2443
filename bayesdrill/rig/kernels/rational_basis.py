"""Sums of squares of a long record from a few hundred numbers, and their normal equations.

The response of a linear rig is expanded in orthonormal rational functions with poles near those of
the rig (Takenaka 1925, Malmquist 1926; for complex pairs Kautz 1954).  For a pole a and any pole l
of a rig

    1 / (z - l) = (1 - a^2) / ((z - a) (1 - a l)) + (1 - a z) / (z - a) (l - a) / (1 - a l) / (z - l)

of which the last term is the same response once more, of an input that has passed an all-pass, and
smaller by |l - a| / |1 - a l|.  With the matrix F = Phi - 1 of a walker in the place of l - 1 nothing
is ever decomposed, poles may meet or part, and what is left after the last function has a bound.
All is written in F, so that a high sampling rate costs no digits.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from llvmlite import ir

from bayesdrill.rig.kernels.exponential import Layout, emit_exponential
from bayesdrill.rig.kernels.lanes import (
    I64,
    NUMBERS,
    VEC,
    VECTORS,
    Builder,
    Loop,
    begin_kernel,
    vector,
)

Jet = tuple[ir.Value, ...]  # a value, or a value and its slope
Jets = list[Jet]
Matrix = list[Jets]

REAL, PAIR = "r", "p"  # kinds of poles: one real, or a complex pair
ROWS = 4  # of the triangle at a time
# Times that all poles are gone through: what rounding carries from one to another is then as small as
# what the round before has left.
ROUNDS = 2
TURNS = 3  # of coordinates towards a walker's own modes, for the bound

COUNTS = ("groups", "columns", "triangle")
WHOLE_NUMBERS = I64.as_pointer()
BLOCKS = {
    "walkers": VECTORS,
    "numbers": NUMBERS,
    "frame": NUMBERS,
    "orders": WHOLE_NUMBERS,
    "reference": NUMBERS,
    "triangles": NUMBERS,
    "projected": NUMBERS,
    "scratch": VECTORS,
    "out": VECTORS,
}
NORMAL_COUNTS = (*COUNTS, "q")
NORMAL_BLOCKS = {**BLOCKS, "directions": VECTORS, "scales": VECTORS}


@dataclass(frozen=True, slots=True, kw_only=True)
class BasisShape:
    """What the kernels are specialised for.

    `layout`: of the rig, or of its tangent where slopes are wanted (`tangent`).  `poles`: the kind of
    each pole, in the order of modal coordinates; `integrators`: coordinates before these, on which
    nothing depends.  `impulse`: whether the start moves the rig; `channels`: K.
    """

    layout: Layout
    poles: tuple[str, ...]
    integrators: int
    channels: int
    impulse: bool
    tangent: bool = False

    @property
    def text(self) -> str:
        """See `Structure`."""
        own = (self.poles, self.integrators, self.channels, self.impulse, self.tangent)
        return f"{own} {self.layout.text}"

    @property
    def states(self) -> int:
        """States X of the rig."""
        return self.layout.n_states // 2 if self.tangent else self.layout.n_states

    @property
    def parameters(self) -> int:
        """Parameters P of the rig."""
        return self.layout.n_parameters // 2 if self.tangent else self.layout.n_parameters

    @property
    def blocks(self) -> list[list[int]]:
        """Coordinates of each pole, counted from the first that is no integrator."""
        blocks, first = [], 0
        for kind in self.poles:
            size = 1 if kind == REAL else 2
            blocks.append([*range(first, first + size)])
            first += size
        return blocks

    @property
    def decaying(self) -> int:
        """Coordinates that are no integrators."""
        return self.states - self.integrators

    @property
    def constant(self) -> bool:
        """Whether something constant moves the rig."""
        column = self.layout.n_states
        return any(self.layout.reach[i][column] for i in range(self.states))

    @property
    def sources(self) -> list[str]:
        """What drives the rig: the `impulse` of its start, what is `constant`, and each series."""
        series = [f"series {s}" for s in range(self.layout.n_series)]
        return ["impulse"] * self.impulse + ["constant"] * self.constant + series

    def columns(self, orders: Sequence[int]) -> int:
        """Count the functions: of each source, direct ones of a first-order hold, and offsets.

        `orders`: of each pole in a round.
        """
        poles = sum(n * (1 if kind == REAL else 2) for n, kind in zip(orders, self.poles, strict=True))
        direct = self.layout.n_series if self.layout.first_order else 0
        return len(self.sources) * (self.integrators + ROUNDS * poles) + direct + 1

    @property
    def walker_size(self) -> int:
        """Numbers of a walker: parameters, start, and rows of channels."""
        return self.parameters + self.states + self.channels * (self.states + 1)

    @property
    def frame_size(self) -> int:
        """Numbers of the frame, see `Frame`."""
        return 2 * self.states**2 + len(self.sources) + COUNT * len(self.poles)

    def scratch_size(self, columns: int, q: int = 0) -> int:
        """Vectors of scratch."""
        jets = 2 if self.tangent else 1
        matrices = 3 * len(self.poles) * self.decaying**2 * jets
        products = (1 + q) * self.channels * columns
        return self.layout.size**2 + matrices + jets * self.channels * columns + products + 64


@dataclass(frozen=True, slots=True)
class PoleNumbers:
    """Numbers of a pole a = 1 + mu, or of the pair of it.

    With M = `over` . (1, F, F^2), its functions have the coefficients `even` (2 + F) / M and - `odd` F /
    M of a pair, or `even` / M.  The all-pass is `along[0]` + (`along[1]` + `along[2]` F) / M, the form
    in which least is lost to rounding beside modes of other speeds.
    """

    over: tuple[float, float, float]
    even: float
    odd: float
    along: tuple[float, float, float]

    @classmethod
    def of_pole(cls, kind: str, mu: complex) -> PoleNumbers:
        """Return the numbers of a pole of this kind."""
        m, size = mu.real, abs(mu) ** 2
        if kind == REAL:
            a = 1.0 + m
            slow = (-1.0 / a, -m * (1.0 + 1.0 / a), 0.0) if a > 0.5 else (0.0, -m, 1.0)
            return cls((-m, -a, 0.0), math.sqrt(-m * (2.0 + m)), 0.0, slow)
        loss = 2.0 * m + size  # |a|^2 - 1
        square = 1.0 + loss
        along = (1.0 / square, loss * size / square, -2.0 * loss * (1.0 + m) / square)
        even, odd = math.sqrt(-0.5 * loss * size), math.sqrt(-0.5 * loss * (4.0 + 4.0 * m + size))
        return cls((size, 2.0 * (loss - m), square), even, odd, along)

    @property
    def all(self) -> list[float]:
        """All of them in a row: `COUNT`."""
        return [*self.over, self.even, self.odd, *self.along]


COUNT = 8  # numbers of a pole


@dataclass(frozen=True, slots=True)
class _Arithmetic:
    """Arithmetic of jets; constants are jets without a slope."""

    b: Builder

    def constant(self, value: float) -> Jet:
        return (vector(value),)

    def add(self, left: Jet, right: Jet, *, sign: int = 1) -> Jet:
        operation = self.b.fadd if sign > 0 else self.b.fsub
        width = max(len(left), len(right))
        pairs = zip(_wide(left, width), _wide(right, width), strict=True)
        return tuple(operation(*pair) for pair in pairs)

    def dot(self, pairs: Sequence[tuple[Jet, Jet]], total: Jet | None = None) -> Jet:
        """Return a total and the products of all pairs."""
        width = max(len(number) for pair in pairs for number in pair) if pairs else 1
        value, *slopes = _wide(total or self.constant(0.0), max(width, len(total or ())))
        for left, right in pairs:
            value = self.b.fma(left[0], right[0], value)
            if len(left) > 1:
                slopes = [self.b.fma(left[1], right[0], slopes[0])]
            if len(right) > 1:
                slopes = [self.b.fma(left[0], right[1], slopes[0])]
        return (value, *slopes)

    def times(self, left: Jet, right: Jet) -> Jet:
        return self.dot([(left, right)])

    def minus(self, number: Jet) -> Jet:
        return tuple(self.b.fneg(part) for part in number)

    def inverse(self, number: Jet) -> Jet:
        value = self.b.fdiv(vector(1.0), number[0])
        if len(number) == 1:
            return (value,)
        square = self.b.fmul(value, value)
        return value, self.b.fneg(self.b.fmul(square, number[1]))

    def apply(self, matrix: Matrix, x: Jets) -> Jets:
        return [self.dot(list(zip(row, x, strict=True))) for row in matrix]

    def product(self, left: Matrix, right: Matrix) -> Matrix:
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


def _wide(number: Jet, width: int) -> Jet:
    return (*number, *[vector(0.0)] * (width - len(number)))


@dataclass(frozen=True, slots=True)
class _Cells:
    """Memory of jets: a block of values, and one of slopes where they have some."""

    b: Builder
    bases: tuple[ir.Value, ...]

    def __getitem__(self, offset: ir.Value) -> _Cells:
        return _Cells(self.b, tuple(self.b.gep(base, [offset]) for base in self.bases))

    def read(self, index: int) -> Jet:
        return tuple(self.b.read(base, index) for base in self.bases)

    def write(self, number: Jet, index: int) -> None:
        for base, part in zip(self.bases, _wide(number, len(self.bases)), strict=True):
            self.b.write(part, base, index)

    def read_matrix(self, n: int) -> Matrix:
        return [[self.read(i * n + j) for j in range(n)] for i in range(n)]

    def write_matrix(self, matrix: Matrix) -> None:
        for index, number in enumerate(entry for row in matrix for entry in row):
            self.write(number, index)


class _Frame:
    """Numbers that all walkers share: modal coordinates, sizes of inputs, poles."""

    def __init__(self, b: Builder, shape: BasisShape, block: ir.Value) -> None:
        self._b, x = b, shape.states
        sizes = (x * x, x * x, len(shape.sources))
        starts = [0]
        for size in sizes:
            starts.append(starts[-1] + size)
        self._bases = [b.gep(block, [I64(start)]) for start in starts]
        self._x, self._shape = x, shape

    def _number(self, part: int, index: int) -> ir.Value:
        b = self._b
        return b.splat(b.load(b.gep(self._bases[part], [I64(index)])))

    def vectors(self, i: int, j: int) -> Jet:
        return (self._number(0, i * self._x + j),)

    def duals(self, i: int, j: int) -> Jet:
        return (self._number(1, i * self._x + j),)

    def size(self, source: int) -> ir.Value:
        return self._number(2, source)

    def pole(self, index: int) -> Jets:
        return [(self._number(3, COUNT * index + n),) for n in range(COUNT)]


class _Expansion:
    """The code that expands the response of a group of walkers, with slopes where it has a tangent."""

    def __init__(
        self, b: Builder, shape: BasisShape, arguments: dict[str, ir.Value], scratch: ir.Value
    ) -> None:
        self.b, self.shape, self.a = b, shape, _Arithmetic(b)
        self.frame = _Frame(b, shape, arguments["frame"])
        self.orders, self.columns = arguments["orders"], arguments["columns"]
        jets = 2 if shape.tangent else 1
        self.e = scratch
        at = b.gep(scratch, [I64(shape.layout.size**2)])
        size = shape.decaying**2
        self.matrices = []  # of each pole: the inverse of M, the all-pass, M
        for _ in shape.poles:
            parts = []
            for _ in range(3):
                parts.append(_Cells(b, tuple(b.gep(at, [I64(size * n)]) for n in range(jets))))
                at = b.gep(at, [I64(size * jets)])
            self.matrices.append(parts)
        count = b.mul(self.columns, I64(shape.channels))
        bases = [at]
        for _ in range(jets - 1):
            bases.append(b.gep(bases[-1], [count]))
        self.coefficients = _Cells(b, tuple(bases))
        self.after = b.gep(bases[-1], [count])
        self.count = count

    def _entry(self, i: int, column: int) -> Jet:
        """Return an entry of exp(M dt) - 1, with its slope; `column` counts those of the rig."""
        x, layout = self.shape.states, self.shape.layout
        at = column if column < x or not self.shape.tangent else column + x
        rows = (i, x + i) if self.shape.tangent else (i,)
        return tuple(
            self.b.read(self.e, row * layout.size + at) if layout.reach[row][at] else vector(0.0)
            for row in rows
        )

    def run(self, start: Jets, rows: Matrix) -> list[ir.Value]:
        """Store the coefficients; return bounds `(K,)` of what they leave, as sizes over all samples.

        `start (X,)`; `rows (K, X + 1)`: weights of states, and offsets.
        """
        shape, a, x, d = self.shape, self.a, self.shape.states, self.shape.integrators
        for base in self.coefficients.bases:
            self.b.clear(base, self.count)
        rates = [[self._entry(i, j) for j in range(x)] for i in range(x)]
        modal = self._to_modal(rates)
        fall = [row[d:] for row in modal[d:]]
        shown = [
            [a.dot([(row[i], self.frame.vectors(i, j)) for i in range(x)]) for j in range(x)]
            for row in rows
        ]
        carried = a.product([row[d:] for row in modal[:d]], a.inverted(fall)) if d else []
        seen = [
            [a.dot([(row[n], carried[n][j]) for n in range(d)], row[d + j]) for j in range(x - d)]
            for row in shown
        ]
        self._store_matrices(fall)
        bound = _Bound(self.b, shape, fall, seen)
        errors = [vector(0.0)] * shape.channels
        column = I64(0)
        for index, source in enumerate(shape.sources):
            drive = self._drive(source, start, rates)
            modes = self._modal_vector(drive)
            for n in range(d):
                lost = a.dot(
                    [(a.minus(carried[n][j]), modes[d + j]) for j in range(x - d)], modes[n]
                )
                self._store(column, [a.times(row[n], lost) for row in shown])
                column = self.b.add(column, I64(1))
            column, left = self._expand(column, modes[d:], fall, seen)
            errors = bound.add(errors, left, self.frame.size(index))
        for s in range(shape.layout.n_series if shape.layout.first_order else 0):
            rise = self._increment(s)
            self._store(column, [a.dot(list(zip(row[:x], rise, strict=True))) for row in rows])
            column = self.b.add(column, I64(1))
        self._store(column, [row[x] for row in rows])
        return errors

    def _to_modal(self, rates: Matrix) -> Matrix:
        x, frame = self.shape.states, self.frame
        vectors = [[frame.vectors(i, j) for j in range(x)] for i in range(x)]
        duals = [[frame.duals(i, j) for j in range(x)] for i in range(x)]
        return self.a.product(duals, self.a.product(rates, vectors))

    def _modal_vector(self, drive: Jets) -> Jets:
        x = self.shape.states
        return [
            self.a.dot([(self.frame.duals(i, j), drive[j]) for j in range(x)]) for i in range(x)
        ]

    def _drive(self, source: str, start: Jets, rates: Matrix) -> Jets:
        """Return what a source does to the states from one sample to the next."""
        x, layout = self.shape.states, self.shape.layout
        if source == "impulse":
            return start
        if source == "constant":
            return [self._entry(i, x) for i in range(x)]
        s = int(source.split()[1])
        held = [self._entry(i, x + 1 + s) for i in range(x)]
        if not layout.first_order:
            return held
        # With u(k + 1) - u(k) as (z - 1) u: the columns of increments drive like F times themselves.
        moved = self.a.apply(rates, self._increment(s))
        return [self.a.add(*pair) for pair in zip(held, moved, strict=True)]

    def _increment(self, s: int) -> Jets:
        x, layout = self.shape.states, self.shape.layout
        return [self._entry(i, x + 1 + layout.n_series + s) for i in range(x)]

    def _store_matrices(self, fall: Matrix) -> None:
        """Store of each pole the matrices of its functions, see the head of the module."""
        a = self.a
        square = a.product(fall, fall) if PAIR in self.shape.poles else []
        for index, kind in enumerate(self.shape.poles):
            *over, _, _, first, second, third = self.frame.pole(index)
            powers = zip(over, (None, fall, square) if kind == PAIR else (None, fall), strict=False)
            matrix = a.polynomial(list(powers))
            inverse = a.inverted(matrix)
            moved = a.product(a.polynomial([(second, None), (third, fall)]), inverse)
            passed = a.polynomial([(first, None), (a.constant(1.0), moved)])
            for cells, part in zip(self.matrices[index], (inverse, passed, matrix), strict=True):
                cells.write_matrix(part)

    def _expand(
        self, column: ir.Value, x: Jets, fall: Matrix, seen: Matrix
    ) -> tuple[ir.Value, Jets]:
        """Store the coefficients of a source from `column` on; return the next, and what is left."""
        rounds = Loop(self.b, I64(ROUNDS), [column, *self._flat(x)], "rounds")
        column, x = rounds.carried[0], self._jets(rounds.carried[1:])
        for index in range(len(self.shape.poles)):
            column, x = self._expand_pole(index, column, x, fall, seen)
        rounds.close([column, *self._flat(x)])
        return column, x

    def _expand_pole(
        self, index: int, column: ir.Value, x: Jets, fall: Matrix, seen: Matrix
    ) -> tuple[ir.Value, Jets]:
        b, a, n = self.b, self.a, self.shape.decaying
        kind, numbers = self.shape.poles[index], self.frame.pole(index)
        inverse, pass_, over = (cells.read_matrix(n) for cells in self.matrices[index])
        order = b.load(b.gep(self.orders, [I64(index)]))
        loop = Loop(b, order, self._flat(a.apply(inverse, x)), "order")
        x = self._jets(loop.carried)
        if kind == REAL:
            self._store(b.add(column, loop.index), self._shown(seen, x, numbers[3]))
        else:
            at = b.add(column, b.mul(loop.index, I64(2)))
            moved = a.apply(fall, x)
            sums = [a.dot([(a.constant(2.0), v)], y) for v, y in zip(x, moved, strict=True)]
            self._store(at, self._shown(seen, sums, numbers[3]))
            self._store(b.add(at, I64(1)), self._shown(seen, moved, a.minus(numbers[4])))
        following = a.apply(pass_, x)
        loop.close(self._flat(following))
        column = b.add(column, b.mul(order, I64(1 if kind == REAL else 2)))
        return column, a.apply(over, following)

    def _flat(self, x: Jets) -> list[ir.Value]:
        return [part for number in x for part in _wide(number, self._width)]

    def _jets(self, parts: list[ir.Value]) -> Jets:
        width = self._width
        return [tuple(parts[i : i + width]) for i in range(0, len(parts), width)]

    @property
    def _width(self) -> int:
        return 2 if self.shape.tangent else 1

    def _shown(self, seen: Matrix, x: Jets, factor: Jet) -> Jets:
        a = self.a
        return [a.times(a.dot(list(zip(row, x, strict=True))), factor) for row in seen]

    def _store(self, column: ir.Value, values: Jets) -> None:
        cells = self.coefficients[self.b.mul(column, I64(self.shape.channels))]
        for k, value in enumerate(values):
            cells.write(value, k)


class _Bound:
    """A bound of what the functions leave: the walker's own response to what is left as its input.

    Of blocks of modal coordinates, |(z - T)^-1| <= 1 / (1 - |T|) on the unit circle.  What blocks do to
    each other, at most Q, is summed to (1 - Q)^-1, which is no bound unless it has no negative entry.
    Coordinates are first turned towards the walker's own modes, so that Q is small.
    """

    def __init__(self, b: Builder, shape: BasisShape, fall: Matrix, seen: Matrix) -> None:
        self._b, self._blocks = b, shape.blocks
        a = _Arithmetic(b)
        values, shown_by = ([[number[:1] for number in row] for row in m] for m in (fall, seen))
        self._back, seen = [], shown_by
        for _ in range(TURNS):
            turn = self._turn([[number[0] for number in row] for row in values])
            back = a.inverted(turn)
            values = a.product(back, a.product(values, turn))
            seen = a.product(seen, turn)
            self._back = a.product(back, self._back) if self._back else back
        entries = [[number[0] for number in row] for row in values]
        gains = [self._gain([[entries[i][j] for j in block] for i in block]) for block in self._blocks]
        one = vector(1.0)
        remaining: Matrix = []
        for own, block in enumerate(self._blocks):
            row = []
            for other, columns in enumerate(self._blocks):
                sums = [self._sum(b.absolute(entries[i][j]) for j in columns) for i in block]
                share = b.fneg(b.fmul(gains[own], self._length(sums)))
                row.append((one if own == other else share,))
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
        b, n = self._b, len(entries)
        middles, block_of = [vector(0.0)] * n, {}
        for index, block in enumerate(self._blocks):
            total = self._sum(entries[i][i] for i in block)
            for i in block:
                middles[i], block_of[i] = b.fmul(total, vector(1.0 / len(block))), index

        def entry(i: int, j: int) -> Jet:
            if block_of[i] == block_of[j]:
                return (vector(float(i == j)),)
            apart = b.fsub(middles[j], middles[i])
            pair = b.absolute(b.fmul(entries[i][j], entries[j][i]))
            size = b.fma(apart, apart, b.fmul(vector(4.0), pair))
            return (b.fdiv(b.fmul(entries[i][j], apart), size),)

        return [[entry(i, j) for j in range(n)] for i in range(n)]

    def _gain(self, block: list[list[ir.Value]]) -> ir.Value:
        """Return 1 / (1 - |T|), negative or infinite where |T| is not below one."""
        b, one = self._b, vector(1.0)
        if len(block) == 1:
            size = b.absolute(b.fadd(one, block[0][0]))
        else:
            (p, q), (r, s) = block
            p, s = b.fadd(one, p), b.fadd(one, s)
            squares = self._sum(b.fmul(part, part) for part in (p, q, r, s))
            half = b.fmul(vector(0.5), squares)
            product = b.fsub(b.fmul(p, s), b.fmul(q, r))
            inner = b.fsub(b.fmul(half, half), b.fmul(product, product))
            positive = b.fcmp_ordered(">", inner, vector(0.0))
            inner = b.select(positive, inner, vector(0.0))
            size = b.root(b.fadd(half, b.root(inner)))
        return b.fdiv(one, b.fsub(one, size))

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
        left = _Arithmetic(b).apply(self._back, [number[:1] for number in left])
        lengths = [self._length([left[i][0] for i in block]) for block in self._blocks]
        for error, shares in zip(errors, self._shares, strict=True):
            total = self._sum(map(b.fmul, lengths, shares))
            totals.append(b.fma(size, total, error))
        return totals


def _projections(
    b: Builder, shape: BasisShape, arguments: dict[str, ir.Value], coefficients: ir.Value,
    first: bool,
) -> Iterator[tuple[int, ir.Value, list[ir.Value], Loop]]:
    """Loop over channels and blocks of rows of R times coefficients, as `(k, row, products, loop)`."""
    columns, k_count = arguments["columns"], shape.channels
    for k in range(k_count):
        triangle = b.offset(arguments["triangles"], I64(k), arguments["triangle"])
        rows = Loop(b, b.sdiv(columns, I64(ROWS)), [], "rows")
        row = b.mul(rows.index, I64(ROWS))
        bases = [b.gep(triangle, [b.mul(b.add(row, I64(n)), columns)]) for n in range(ROWS)]
        inner = Loop(b, b.sub(columns, row), [vector(0.0)] * ROWS, "inner")
        j = b.add(row, inner.index)
        value = b.load(b.gep(coefficients, [b.add(b.mul(j, I64(k_count)), I64(k))]), align=8)
        totals = [
            b.fma(b.splat(b.load(b.gep(base, [j]))), value, total)
            for base, total in zip(bases, inner.carried, strict=True)
        ]
        inner.close(totals)
        yield k, row, totals, rows


def write_basis(module: ir.Module, shape: BasisShape) -> None:
    """Write `squares(G, n, triangle, ...)`, whose arguments are `COUNTS` and `BLOCKS`.

    Of G groups of walkers `(G, P + X + K (X + 1), LANES)`: parameters, start, rows of channels.  `n`
    columns, a multiple of `ROWS`; `triangle`: numbers from the triangle `(n, n)` of a channel to that
    of the next, zero where all have the same.  `numbers`: step and constant inputs.  `projected (K, n
    + 1)`: of the reference's residuals, and the square of what no function has.  `out (G, K, 2,
    LANES)`: squares, and bounds of the size of what the functions leave.
    """
    exponential = emit_exponential(module, shape.layout, increments=True, beside_one=False)
    arguments, b = begin_kernel(module, "squares", COUNTS, BLOCKS)
    span = b.alloca(VEC)
    groups = Loop(b, arguments["groups"], [], "groups")
    walker = b.offset(arguments["walkers"], groups.index, shape.walker_size)
    expansion = _Expansion(b, shape, arguments, arguments["scratch"])
    _call_exponential(b, exponential, walker, arguments["numbers"], span, expansion.e)
    start, rows = _walker_rows(b, shape, (walker,))
    errors = expansion.run(start, rows)
    _subtract_reference(b, expansion, arguments["reference"])
    out = b.offset(arguments["out"], groups.index, 2 * shape.channels)
    _store_squares(b, shape, arguments, expansion, out, None)
    for k, error in enumerate(errors):
        b.write(error, out, 2 * k + 1)
    groups.close([])
    b.ret_void()


def _call_exponential(
    b: Builder, exponential: ir.Function, walker: ir.Value, numbers: ir.Value, span: ir.Value,
    e: ir.Value,
) -> None:  # fmt: skip
    b.write(b.splat(b.load(numbers)), span, 0)
    b.call(exponential, [walker, b.gep(numbers, [I64(1)]), span, e])


def _walker_rows(b: Builder, shape: BasisShape, bases: tuple[ir.Value, ...]) -> tuple[Jets, Matrix]:
    """Read start and rows of a walker; `bases`: of its numbers, and of their slopes."""
    x, p = shape.states, shape.parameters
    cells = _Cells(b, bases)
    start = [cells.read(p + i) for i in range(x)]
    width = x + 1
    rows = [
        [cells.read(p + x + k * width + i) for i in range(width)] for k in range(shape.channels)
    ]
    return start, rows


def _subtract_reference(b: Builder, expansion: _Expansion, reference: ir.Value) -> None:
    """Leave of coefficients their difference from those of the reference."""
    base = expansion.coefficients.bases[0]
    each = Loop(b, expansion.count, [], "reference")
    at = b.gep(base, [each.index])
    known = b.splat(b.load(b.gep(reference, [each.index])))
    b.store(b.fsub(b.load(at, align=8), known), at, align=8)
    each.close([])


def _store_squares(
    b: Builder, shape: BasisShape, arguments: dict[str, ir.Value], expansion: _Expansion,
    out: ir.Value, residuals: ir.Value | None,
) -> None:  # fmt: skip
    """Store the squares of all channels, and `residuals (K, n)` along the functions if wanted."""
    columns = arguments["columns"]
    size = b.add(columns, I64(1))
    for k in range(shape.channels):
        projected = b.offset(arguments["projected"], I64(k), size)
        b.write(b.splat(b.load(b.gep(projected, [columns]))), out, 2 * k)
    coefficients = expansion.coefficients.bases[0]
    for k, row, products, rows in _projections(b, shape, arguments, coefficients, True):
        projected = b.offset(arguments["projected"], I64(k), size)
        total = b.read(out, 2 * k)
        for n, product in enumerate(products):
            at = b.add(row, I64(n))
            value = b.fsub(b.splat(b.load(b.gep(projected, [at]))), product)
            total = b.fma(value, value, total)
            if residuals is not None:
                index = b.add(b.mul(columns, I64(k)), at)
                b.store(value, b.gep(residuals, [index]), align=8)
        b.write(total, out, 2 * k)
        rows.close([])


def write_normal(module: ir.Module, shape: BasisShape) -> None:
    """Write `normal(G, n, triangle, q, ...)`, whose arguments are `NORMAL_COUNTS` and `NORMAL_BLOCKS`.

    `shape` has the tangent.  `directions (G, q, P + X + K (X + 1), LANES)`: slopes of what walkers have;
    `scales (G, K, LANES)`: one over the noise.  `out (G, 2 K + q + q q, LANES)`: squares and bounds, then
    slopes and the lower triangle of the products, these times scales.
    """
    exponential = emit_exponential(module, shape.layout, increments=True, beside_one=False)
    arguments, b = begin_kernel(module, "normal", NORMAL_COUNTS, NORMAL_BLOCKS)
    span, q, k_count = b.alloca(VEC), arguments["q"], shape.channels
    both = b.alloca(VEC, I64(2 * shape.parameters))
    columns = arguments["columns"]
    length = b.mul(columns, I64(k_count))
    groups = Loop(b, arguments["groups"], [], "groups")
    walker = b.offset(arguments["walkers"], groups.index, shape.walker_size)
    scales = b.offset(arguments["scales"], groups.index, k_count)
    expansion = _Expansion(b, shape, arguments, arguments["scratch"])
    residuals = expansion.after
    slopes = b.gep(residuals, [length])  # (q, K, n)
    out = b.offset(arguments["out"], groups.index, b.add(I64(2 * k_count), b.mul(q, b.add(q, I64(1)))))
    b.copy(walker, both, shape.parameters)
    directions = Loop(b, q, [], "directions")
    along = b.offset(
        arguments["directions"], b.add(b.mul(groups.index, q), directions.index), shape.walker_size
    )
    b.copy(along, b.gep(both, [I64(shape.parameters)]), shape.parameters)
    _call_exponential(b, exponential, both, arguments["numbers"], span, expansion.e)
    errors = expansion.run(*_walker_rows(b, shape, (walker, along)))
    for k, error in enumerate(errors):
        b.write(error, out, 2 * k + 1)
    own = b.offset(slopes, directions.index, length)
    moved = expansion.coefficients.bases[1]
    for k, row, products, rows in _projections(b, shape, arguments, moved, False):
        for n, product in enumerate(products):
            index = b.add(b.mul(columns, I64(k)), b.add(row, I64(n)))
            b.store(b.fmul(product, b.read(scales, k)), b.gep(own, [index]), align=8)
        rows.close([])
    directions.close([])
    _subtract_reference(b, expansion, arguments["reference"])
    _store_squares(b, shape, arguments, expansion, out, residuals)
    for k in range(k_count):
        scale = b.read(scales, k)
        b.write(b.fmul(b.read(out, 2 * k), b.fmul(scale, scale)), out, 2 * k)
        each = Loop(b, columns, [], "scaled")
        at = b.gep(residuals, [b.add(b.mul(columns, I64(k)), each.index)])
        b.store(b.fmul(b.load(at, align=8), scale), at, align=8)
        each.close([])
    _store_products(b, q, length, slopes, residuals, b.gep(out, [I64(2 * k_count)]))
    groups.close([])
    b.ret_void()


def _store_products(
    b: Builder, q: ir.Value, length: ir.Value, slopes: ir.Value, residuals: ir.Value, out: ir.Value
) -> None:
    """Store products `(q,)` of slopes with residuals, and `(q, q)` with those up to each."""
    each = Loop(b, q, [], "each")
    own = b.offset(slopes, each.index, length)
    b.store(_inner(b, own, residuals, length), b.gep(out, [each.index]), align=8)
    row = b.gep(out, [b.mul(q, b.add(each.index, I64(1)))])
    pairs = Loop(b, b.add(each.index, I64(1)), [], "pairs")
    other = b.offset(slopes, pairs.index, length)
    b.store(_inner(b, own, other, length), b.gep(row, [pairs.index]), align=8)
    pairs.close([])
    each.close([])


def _inner(b: Builder, left: ir.Value, right: ir.Value, length: ir.Value) -> ir.Value:
    """Return the product of two rows, in four sums."""
    loop = Loop(b, b.sdiv(length, I64(ROWS)), [vector(0.0)] * ROWS, "inner")
    at = b.mul(loop.index, I64(ROWS))
    totals = []
    for n, total in enumerate(loop.carried):
        index = b.add(at, I64(n))
        pair = (b.load(b.gep(base, [index]), align=8) for base in (left, right))
        totals.append(b.fma(*pair, total))
    loop.close(totals)
    return b.fadd(b.fadd(totals[0], totals[1]), b.fadd(totals[2], totals[3]))
