"""The likelihood by a Kalman filter of one gain, of a record that is compressed.

Innovations are what a linear system makes of inputs, of the channels themselves, and of the start:
its poles are those of the filter, Phi (1 - K C).  So they are expanded in the functions of
`rational_basis`, which see channels as further sources.  What innovations show of the first state
are their products with the responses to it, which are functions of the impulse.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Sequence

from llvmlite import ir

from bayesdrill.rig.kernels.compressed_sums import store_squares
from bayesdrill.rig.kernels.exponential import Layout
from bayesdrill.rig.kernels.kalman_filter import StateSpace
from bayesdrill.rig.kernels.lanes import NUMBERS, VECTORS, WHOLE, Loop, Module, Vector, vector
from bayesdrill.rig.kernels.numbers import Blocks, Matrix, Number, Numbers, dot, multiply_add, plus
from bayesdrill.rig.kernels.rational_basis import BasisExpansion, BasisShape, applied
from bayesdrill.rig.kernels.steady_state_kalman import SteadyFilter, emit_steady_state

COUNTS = ("groups", "samples", "columns", "channel", "sum")
BLOCKS = {
    "told": VECTORS,  # (G, P + K): parameters, variances
    "constants": NUMBERS,  # see `recurrence.Constants`
    "frame": NUMBERS,
    "orders": WHOLE,
    "reference": NUMBERS,
    "triangles": NUMBERS,
    "projected": NUMBERS,
    "scratch": VECTORS,
    "bounds": VECTORS,  # (G, K): of the size of what functions leave of innovations
    "out": VECTORS,  # (2 K + 1, G)
}
CLOSED_COUNTS = ("groups", "samples")
CLOSED_BLOCKS = {
    "told": VECTORS,
    "constants": NUMBERS,
    "closed": VECTORS,  # (G, (n + K) (K + n) + n columns), see `_store_closed`
    "out": VECTORS,
}


def turning_angle(system: StateSpace, layout: Layout) -> tuple[int, int] | None:
    """Return an angle on which nothing depends, and a channel that shows it; None if there is none.

    States are counted from there, and the source of this channel is by how much it goes on: all
    sources stay small, however far a rig turns.
    """
    pairs = itertools.product(range(system.n), range(system.k))
    return next(((i, k) for i, k in pairs if layout.idle[i] and system.channels[k][i]), None)


class _Reactions:
    """How a filter goes on from states: predictions `(K,)` of its channels, and the next state."""

    def __init__(self, w: SteadyFilter) -> None:
        self._w, n, k_count = w, w.system.n, w.system.k
        self._zero, unity = (Vector(w.m.b, vector(value)) for value in (0.0, 1.0))
        self._phi = [[self.entry(i, j) for j in range(n)] for i in range(n)]
        units = plus([[self._zero] * n for _ in range(n)], unity)
        self.states = [self._onward(unit, 0) for unit in units]
        # A channel shows itself, and moves what is predicted of those after it.
        self.channels = []
        for k in range(k_count):
            predictions, following = self._onward(w.gains.gain(k), k + 1)
            self.channels.append(([self._zero] * k + [-unity, *predictions], following))
        if (turning := turning_angle(w.system, w.layout)) is not None:
            backwards = [-number for number in units[turning[0]]]
            self.channels[turning[1]] = ([self._zero] * k_count, backwards)

    def _onward(self, state: list[Number], first: int) -> tuple[list[Number], list[Number]]:
        """Go on from a state in a sample whose channels from the first on are zero."""
        predictions = []
        for k in range(first, self._w.system.k):
            innovation, state = self._w.gains.update_state(k, state, self._zero)
            predictions.append(-innovation)
        return predictions, applied(self._phi, state)

    def entry(self, i: int, column: int) -> Number:
        """Return an entry of Phi, or of the columns after it."""
        known = self._w.phi.get((i, column))
        return self._zero if known is None else Vector(self._w.m.b, known)

    def column(self, column: int) -> list[Number]:
        """Return a column of these entries."""
        return [self.entry(i, column) for i in range(self._w.system.n)]


def write_closed_loop(module: Module, system: StateSpace, layout: Layout) -> None:
    """Write `steadily`, which also stores of each state and channel predictions and the next state.

    These are `(n + K, K + n)`; then follow the columns after Phi `(N - n, n)`.
    """
    emit_steady_state(module, system, layout, (CLOSED_COUNTS, CLOSED_BLOCKS), _store_closed)


def _store_closed(w: SteadyFilter, state: list[ir.Value], shown: ir.Value) -> list[Number]:
    b, n, k_count, size = w.m.b, w.system.n, w.system.k, w.layout.size
    reactions = _Reactions(w)
    rows = [[*shows, *following] for shows, following in reactions.states + reactions.channels]
    rows += [reactions.column(column) for column in range(n, size)]
    numbers = [number.value for row in rows for number in row]
    b.write_row(numbers, b.offset(w.a["closed"], b.mul(w.group, len(numbers))))
    w.m.clear(shown, n)
    return [Vector(b, vector(0.0))] * k_count


def write_compressed_filter(
    module: Module, system: StateSpace, layout: Layout, shape: BasisShape
) -> None:
    """Write `steadily`, of COUNTS and addresses of BLOCKS; others are as in `compressed_sums`."""
    sums = functools.partial(_by_functions, shape)
    emit_steady_state(module, system, layout, (COUNTS, BLOCKS), sums)


def _by_functions(
    shape: BasisShape, w: SteadyFilter, state: list[ir.Value], shown: ir.Value
) -> list[Number]:
    """Return sums of squared innovations from the triangle; see `emit_steady_state`."""
    m, b, k_count = w.m, w.m.b, w.system.k
    expansion, columns = BasisExpansion(b, shape, w.a), w.a["columns"]
    first = _expand(expansion, _Reactions(w), m.shaped(state), w.a["frame"])
    squares, residuals = m.room(k_count), expansion.after
    store_squares(expansion, squares, residuals)
    # Of columns of the impulse, with what the reference and the difference from it leave.
    pulled = b.offset(residuals, b.mul(columns, k_count))
    for k in range(k_count):
        left, sums = (b.offset(base, b.mul(columns, k)) for base in (residuals, pulled))
        b.clear(sums, first)
        with b.loop(first, "rows") as row:
            residual = b.read(left, row)
            with b.loop(b.sub(first, row), "inner") as inner:
                j = b.add(row, inner)
                entry = b.shared(w.a["triangles"], b.add(b.mul(row, columns), j))
                b.write(b.fma(entry, residual, b.read(sums, j)), sums, j)
    spare = b.offset(residuals, b.mul(columns, 2 * k_count))
    expansion.coefficients = Blocks(b, (spare,))
    _show_start(w, expansion, first, pulled, shown)
    return m.row(squares, k_count)


def _expand(
    expansion: BasisExpansion, by: _Reactions, state: list[Number], block: ir.Value
) -> ir.Value:
    """Store the coefficients of predictions; return how many functions a source has.

    `block`: the frame.
    """
    b, shape = expansion.b, expansion.shape
    n, layout = shape.states, shape.layout
    unity, zero = (Vector(b, vector(value)) for value in (1.0, 0.0))
    rows = _turned([shows for shows, _ in by.states])
    fall = plus(_turned([following for _, following in by.states]), -unity)
    expansion.begin(fall, rows)
    held = [by.column(n + 1 + s) for s in range(layout.n_series)]
    rises = [by.column(n + 1 + layout.n_series + s) for s in range(layout.n_series)]
    rises = rises if layout.first_order else []
    drives, constant = [*held], by.column(n)
    for s, rise in enumerate(rises):  # see `BasisExpansion`
        begin = expansion.frame.first[s]
        constant = [multiply_add(begin, a, c) for a, c in zip(held[s], constant, strict=True)]
        drives[s] = [a + c for a, c in zip(held[s], applied(fall, rise), strict=True)]
    drives = [state, *[constant] * shape.constant, *drives, *(after for _, after in by.channels)]
    m, sizes = Numbers(b, False), b.offset(block, 2 * n * n)
    modes = m.room(n * len(drives))
    m.put_row(itertools.chain(*(applied(expansion.frame.duals, drive) for drive in drives)), modes)
    start = [0, *m.flat(expansion.errors)]
    each = Loop(b, len(drives), start, "sources")  # the code of them is there once
    expansion.errors = m.shaped(each.carried[1:])
    row = m.row(m.at(modes, b.mul(each.index, n)), n)
    size = Vector(b, b.shared(sizes, each.index))
    column = expansion.add_modes(each.carried[0], row, size)
    each.close([column, *m.flat(expansion.errors)])
    functions = b.sdiv(column, len(drives))
    for direct in (*(applied(rows, rise) for rise in rises), *(shows for shows, _ in by.channels)):
        column = expansion.store(column, direct)
    expansion.store(column, [zero] * shape.channels)
    return functions


def _show_start(
    w: SteadyFilter, expansion: BasisExpansion, first: ir.Value, pulled: ir.Value, shown: ir.Value
) -> None:
    """Store what innovations show of the first state `(n,)`, and bounds of what functions leave.

    These are for a start that is off by a standard deviation of any state, too.
    """
    m, b, n, k_count = w.m, w.m.b, w.system.n, w.system.k
    each = Loop(b, n, m.flat(expansion.errors), "each")
    duals = b.offset(w.a["frame"], b.add(n * n, each.index))
    unit = [Vector(b, b.shared(duals, n * i)) for i in range(n)]
    variance = Vector(b, b.read(w.at["p"], b.mul(each.index, n + 1)))
    expansion.errors = m.shaped(each.carried)
    expansion.add_modes(0, unit, variance.sqrt())
    totals = []
    for k in range(k_count):
        inner = Loop(b, first, [vector(0.0)], "inner")
        at = b.add(b.mul(inner.index, k_count), k)
        coefficient = b.read(expansion.coefficients.bases[0], at)
        index = b.add(b.mul(w.a["columns"], k), inner.index)
        product = b.fma(coefficient, b.read(pulled, index), inner.carried[0])
        inner.close([product])
        totals.append(Vector(b, product))
    roots = [w.gains.inverse_deviation(k) for k in range(k_count)]
    total = dot([root * root for root in roots], totals)
    b.write(total.value, shown, each.index)
    after = m.flat(expansion.errors)
    each.close(after)
    b.write_row(after, b.offset(w.a["bounds"], w.group, k_count))


def _turned(rows: Sequence[Sequence[Number]]) -> Matrix:
    return [[*column] for column in zip(*rows, strict=True)]
