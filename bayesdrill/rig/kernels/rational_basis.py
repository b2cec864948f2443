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

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import islice

from llvmlite import ir

from bayesdrill.rig.kernels.exponential import Layout
from bayesdrill.rig.kernels.jets import Jet, JetArithmetic, JetCells, Jets, Matrix, with_slope
from bayesdrill.rig.kernels.lanes import (
    I64,
    Builder,
    Loop,
    vector,
)
from bayesdrill.rig.kernels.remainder_bound import RemainderBound

REAL, PAIR = 1, 2  # coordinates of a real pole, and of a complex pair, and their functions
ROWS = 4  # of the triangle at a time
# Times that all poles are gone through: what rounding carries from one to another is then as small as
# what the round before has left.
ROUNDS = 2

WHOLE_NUMBERS = I64.as_pointer()


@dataclass(frozen=True, slots=True, kw_only=True)
class BasisShape:
    """What the kernels are specialised for.

    `layout`: of the rig, or of its tangent where slopes are wanted (`tangent`).  `poles`: coordinates
    of each, in the order of modal coordinates; `integrators`: coordinates before these, on which
    nothing depends.  `impulse`: whether the start moves the rig; `channels`: K.  `sums`: of squares of
    each channel, of residuals alone, or of steps between them and of both ends too.  `delays`: by how
    many steps at most a channel looks beyond the sample of its states, see `delayed_rows`; zero where
    none is late.
    """

    layout: Layout
    poles: tuple[int, ...]
    integrators: int
    channels: int
    impulse: bool
    sums: int = 1
    delays: int = 0
    tangent: bool = False

    @property
    def text(self) -> str:
        """See `Structure`."""
        sizes = (self.integrators, self.channels, self.impulse, self.sums, self.delays)
        return f"{self.poles} {sizes} {self.tangent} {self.layout.text}"

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
        ends = zip(self.poles, itertools.accumulate(self.poles), strict=True)
        return [[*range(end - size, end)] for size, end in ends]

    @property
    def decaying(self) -> int:
        """Coordinates that are no integrators."""
        return self.states - self.integrators

    @property
    def constant(self) -> bool:
        """Whether something constant moves the rig, such as the first of inputs that change straight."""
        if self.layout.first_order:
            return True
        column = self.layout.n_states
        return any(self.layout.reach[i][column] for i in range(self.states))

    @property
    def sources(self) -> list[str]:
        """What drives the rig: the `impulse` of its start, what is `constant`, and each series."""
        series = [f"series {s}" for s in range(self.layout.n_series)]
        return ["impulse"] * self.impulse + ["constant"] * self.constant + series

    def columns(self, orders: Iterable[int]) -> int:
        """Count the functions: of each source, direct ones of a first-order hold, and offsets.

        `orders`: of each pole in a round.
        """
        poles = sum(n * size for n, size in zip(orders, self.poles, strict=True))
        direct = self.layout.n_series * (self.layout.first_order + self.inputs_ahead)
        return len(self.sources) * (self.integrators + ROUNDS * poles) + direct + 1

    @property
    def inputs_ahead(self) -> int:
        """Samples of inputs, from its own on, that a late channel shows at once."""
        return self.delays + self.layout.first_order if self.delays else 0

    @property
    def walker_size(self) -> int:
        """Numbers of a walker: parameters, start, rows of channels, and their delays."""
        rows = self.channels * (self.states + 1 + self.delays)
        return self.parameters + self.states + rows

    def scratch_size(self, columns: int, q: int = 0) -> int:
        """Vectors of scratch."""
        jets, products = 2 if self.tangent else 1, (1 + q) * self.channels * self.sums * columns
        return self.coefficients_at + jets * self.channels * columns + products + ROWS

    @property
    def coefficients_at(self) -> int:
        """Vectors of scratch before the coefficients: an exponential, and matrices of poles."""
        jets = 2 if self.tangent else 1
        return self.layout.size**2 + 3 * len(self.poles) * self.decaying**2 * jets


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
    def of_pole(cls, mu: complex) -> PoleNumbers:
        """Return the numbers of a pole, or of the pair of one that is complex."""
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
    def all(self) -> list[float]:
        """All of them in a row: `COUNT`."""
        return [*self.over, self.even, self.odd, *self.along]


COUNT = 8  # numbers of a pole


class ModalFrame:
    """Numbers that all walkers share: modal coordinates, sizes of sources, first inputs, poles.

    `vectors (X, X)`, and their inverse `duals`; `sizes`: of sources over all samples; `first (S,)`: of
    each series, from which it counts where it changes straight; `poles`: the `PoleNumbers` of each.
    """

    def __init__(self, b: Builder, shape: BasisShape, block: ir.Value) -> None:
        x, places = shape.states, itertools.count()
        numbers = ((b.splat(b.load(b.gep(block, [I64(place)]))),) for place in places)
        self.vectors, self.duals = (
            [[*islice(numbers, x)] for _ in range(x)] for _ in ("vectors", "duals")
        )
        self.sizes = [*islice(numbers, len(shape.sources))]
        self.first = [*islice(numbers, shape.layout.n_series)]
        self.poles = [[*islice(numbers, COUNT)] for _ in shape.poles]


@dataclass(frozen=True, slots=True)
class ExponentialEntries:
    """The entries of exp(M span) - 1 at the address `e`."""

    b: Builder
    shape: BasisShape
    e: ir.Value

    def __call__(self, i: int, column: int) -> Jet:
        """Return an entry, with its slope; `column` counts those of the rig."""
        x, layout = self.shape.states, self.shape.layout
        at = column if column < x or not self.shape.tangent else column + x
        rows = (i, x + i) if self.shape.tangent else (i,)
        return tuple(
            self.b.read(self.e, row * layout.size + at) if layout.reach[row][at] else vector(0.0)
            for row in rows
        )


class BasisExpansion:
    """The code that expands the response of a group of walkers, with slopes where it has a tangent."""

    def __init__(self, b: Builder, shape: BasisShape, arguments: dict[str, ir.Value]) -> None:
        self.b, self.shape, self.a = b, shape, JetArithmetic(b)
        self.frame = ModalFrame(b, shape, arguments["frame"])
        self.orders, self.columns = arguments["orders"], arguments["columns"]
        jets = 2 if shape.tangent else 1
        self.entry = ExponentialEntries(b, shape, arguments["scratch"])
        at = b.gep(arguments["scratch"], [I64(shape.layout.size**2)])
        size = shape.decaying**2
        self.matrices = []  # of each pole: the inverse of M, the all-pass, M
        for _ in shape.poles:
            parts = []
            for _ in range(3):
                parts.append(JetCells(b, tuple(b.gep(at, [I64(size * n)]) for n in range(jets))))
                at = b.gep(at, [I64(size * jets)])
            self.matrices.append(parts)
        count = b.mul(self.columns, I64(shape.channels))
        bases = [at]
        for _ in range(jets - 1):
            bases.append(b.gep(bases[-1], [count]))
        self.coefficients = JetCells(b, tuple(bases))
        self.after = b.gep(bases[-1], [count])
        self.count = count

    def run(self, start: Jets, rows: Matrix, direct: Sequence[Matrix] = ()) -> list[ir.Value]:
        """Store the coefficients; return bounds `(K,)` of what they leave, as sizes over all samples.

        `start (X,)`; `rows (K, X + 1)`: weights of states, and offsets; `direct (K, n, S)`: of inputs at
        the next samples, of late channels.
        """
        shape, a, x, d = self.shape, self.a, self.shape.states, self.shape.integrators
        for base in self.coefficients.bases:
            self.b.clear(base, self.count)
        rates = [[self.entry(i, j) for j in range(x)] for i in range(x)]
        modal = a.product(self.frame.duals, a.product(rates, self.frame.vectors))
        fall = [row[d:] for row in modal[d:]]
        shown = a.product([row[:x] for row in rows], self.frame.vectors)
        carried = a.product([row[d:] for row in modal[:d]], a.inverted(fall)) if d else []
        seen = [
            [a.dot([(row[n], carried[n][j]) for n in range(d)], row[d + j]) for j in range(x - d)]
            for row in shown
        ]
        self._store_matrices(fall)
        bound = RemainderBound(self.b, shape.blocks, fall, seen)
        errors = [vector(0.0)] * shape.channels
        column = I64(0)
        for index, source in enumerate(shape.sources):
            drive = self._drive(source, start, rates)
            modes = a.apply(self.frame.duals, drive)
            for n in range(d):
                lost = a.dot(
                    [(a.minus(carried[n][j]), modes[d + j]) for j in range(x - d)], modes[n]
                )
                self._store(column, [a.times(row[n], lost) for row in shown])
                column = self.b.add(column, I64(1))
            column, left = self._expand(column, modes[d:], fall, seen)
            errors = bound.add(errors, left, self.frame.sizes[index][0])
        for s in range(shape.layout.n_series if shape.layout.first_order else 0):
            rise = self._increment(s)
            self._store(column, [a.dot(list(zip(row[:x], rise, strict=True))) for row in rows])
            column = self.b.add(column, I64(1))
        offsets = [row[x] for row in rows]
        for step in range(shape.inputs_ahead):
            for s in range(shape.layout.n_series):
                weights = [channel[step][s] for channel in direct]
                self._store(column, weights)
                column = self.b.add(column, I64(1))
                offsets = [
                    a.dot([(self.frame.first[s], weight)], offset)
                    for weight, offset in zip(weights, offsets, strict=True)
                ]
        self._store(column, offsets)
        return errors

    def _drive(self, source: str, start: Jets, rates: Matrix) -> Jets:
        """Return what a source does to the states from one sample to the next."""
        x, layout = self.shape.states, self.shape.layout
        if source == "impulse":
            return start
        if source == "constant":
            drive = [self.entry(i, x) for i in range(x)]
            for s, first in enumerate(self.frame.first if layout.first_order else []):
                drive = [
                    self.a.dot([(first, self.entry(i, x + 1 + s))], drive[i]) for i in range(x)
                ]
            return drive
        s = int(source.split()[1])
        held = [self.entry(i, x + 1 + s) for i in range(x)]
        if not layout.first_order:
            return held
        # With u(k + 1) - u(k) as (z - 1) u: the columns of increments drive like F times themselves.
        moved = self.a.apply(rates, self._increment(s))
        return [self.a.add(*pair) for pair in zip(held, moved, strict=True)]

    def _increment(self, s: int) -> Jets:
        x, layout = self.shape.states, self.shape.layout
        return [self.entry(i, x + 1 + layout.n_series + s) for i in range(x)]

    def _store_matrices(self, fall: Matrix) -> None:
        """Store of each pole the matrices of its functions, see the head of the module."""
        a = self.a
        square = a.product(fall, fall) if PAIR in self.shape.poles else []
        for index, kind in enumerate(self.shape.poles):
            *over, _, _, first, second, third = self.frame.poles[index]
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
        kind, numbers = self.shape.poles[index], self.frame.poles[index]
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
        column = b.add(column, b.mul(order, I64(kind)))
        return column, a.apply(over, following)

    def _flat(self, x: Jets) -> list[ir.Value]:
        return [part for number in x for part in with_slope(number, self._width)]

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
