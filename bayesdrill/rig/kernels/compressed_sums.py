"""Sums of squares of a long record, and their normal equations, from its triangle.

See `rational_basis` for the functions that are the triangle's columns.

A channel that is late by d sees x(t - d).  With a whole number m of samples no less than d, that is
the rig a span s = m dt - d after sample n - m: states there through exp(A s), and the inputs of the
steps between.  So a delay changes rows of weights, and adds inputs that are seen at once.  The span
is shares of the steps from there on: of a step that it does not reach, zero.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice

import numpy as np
from llvmlite import ir

from bayesdrill.basics.duals import Dual, dual
from bayesdrill.rig.kernels.exponential import store_exponential
from bayesdrill.rig.kernels.lanes import (
    NUMBERS,
    VECTORS,
    WHOLE,
    Builder,
    Loop,
    Module,
    Vector,
    kernel,
    vector,
)
from bayesdrill.rig.kernels.numbers import Blocks, Matrix, Number, dot
from bayesdrill.rig.kernels.rational_basis import (
    ROWS,
    BasisExpansion,
    BasisShape,
    ExponentialEntries,
)

COUNTS = ("groups", "columns", "channel", "sum", "q")
BLOCKS = (
    dict.fromkeys(("numbers", "frame", "reference", "triangles", "projected"), NUMBERS)
    | dict.fromkeys(("walkers", "scratch", "directions", "weights", "out"), VECTORS)
    | {"orders": WHOLE}
)
ENDS = 2  # which of the sums has but two rows: of the first sample and the last


def _store_over(
    expansion: BasisExpansion, share: ir.Value, parameters: ir.Value, e: ir.Value
) -> None:
    """Store exp(M span) - 1 of a walker over a `share` of a step."""
    b, numbers, layout = expansion.b, expansion.a["numbers"], expansion.shape.layout
    span, constants = b.fmul(share, b.shared(numbers, 0)), b.offset(numbers, 1)
    store_exponential(b, parameters, constants, span, e, layout, increments=True, beside_one=False)


class _DelayedRows:
    """The code of rows over the states at a sample, of what is seen at a later time."""

    def __init__(self, expansion: BasisExpansion, parameters: ir.Value) -> None:
        b, shape = expansion.b, expansion.shape
        self._shape, self._x, self._series = shape, shape.states, shape.layout.n_series
        self._expansion, self._parameters = expansion, parameters
        self._entry = ExponentialEntries(b, shape, b.room(shape.layout.size**2))
        self._nothing: list[Number] = [Vector(b, vector(0.0))] * self._series
        self._rates = self._of_a_step(b)

    def row(self, states: list[Number], shares: list[Number]) -> tuple[list[Number], Matrix]:
        """Return the row `(X + 1,)`, and weights of inputs `(D + 1, S)` at the samples from there.

        `shares (D,)`: of each step, that are in the span.
        """
        weights = [[*self._nothing] for _ in range(len(shares) + 1)]
        for step, share in reversed([*enumerate(shares)]):
            states, held, rise = self._passed(states, share)
            for s in range(self._series):
                weights[step][s] = weights[step][s] + (held[s] - rise[s])
                weights[step + 1][s] = weights[step + 1][s] + rise[s]
        return states, weights

    def _passed(self, row: list[Number], share: Number) -> tuple[list[Number], ...]:
        """Return a row before a span, and weights of inputs at its begin, and of their increments."""
        x, n, first_order = self._x, self._series, self._shape.layout.first_order
        span, by_share = dual(share).value, dual(share).slope
        e = self._entry
        _store_over(self._expansion, span.value, self._parameters, e.e)
        columns = [
            dot(row[:x], [e(i, column) for i in range(x)], row[column] if column <= x else None)
            for column in range(x + 1 + n * (1 + first_order))
        ]
        states, held, rise = columns[: x + 1], columns[x + 1 : x + 1 + n], columns[x + 1 + n :]
        rise = [number * span for number in rise] if first_order else self._nothing
        if self._shape.tangent:
            values = [dual(number).value for number in states]
            if first_order:
                rise = [
                    a + Dual(0.0, dual(c).value * by_share) for a, c in zip(rise, held, strict=True)
                ]
            states, held = (
                [
                    number + Dual(0.0, self._rate(values, column) * by_share)
                    for column, number in enumerate(part, first)
                ]
                for first, part in ((0, states), (x + 1, held))
            )
        return states, held, rise

    def _rate(self, values: list[Number], column: int) -> Number:
        """Return by how much a row times exp(M span) changes with a share of a step."""
        return sum(values[i] * rate for (i, at), rate in self._rates.items() if at == column)

    def _of_a_step(self, b: Builder) -> dict[tuple[int, int], Number]:
        """Return the entries of M of the rig, times a step, by row and column of the rig."""
        x, layout = self._x, self._shape.layout
        shift, rates = layout.n_states - x, dict[tuple[int, int], Number]()
        numbers = self._expansion.a["numbers"]
        step, constants = Vector(b, b.shared(numbers, 0)), b.offset(numbers, 1)
        for row, column, value in layout.matrix(b, self._parameters, constants):
            if row < x and (column < x or column >= layout.n_states):
                place = (row, column if column < x else column - shift)
                rates[place] = value * step + rates.get(place, 0.0)
        return rates


def _projections(
    expansion: BasisExpansion, coefficients: ir.Value
) -> Iterator[tuple[int, ir.Value, list[ir.Value]]]:
    """Loop over sums and blocks of rows of R times coefficients, as `(s, row, products)`."""
    b, a, k_count = expansion.b, expansion.a, expansion.shape.channels
    for s, (k, v) in enumerate(np.ndindex(k_count, expansion.shape.sums)):
        triangle = b.offset(a["triangles"], k, a["channel"])
        triangle = b.offset(triangle, v, a["sum"])
        with b.loop(1 if v == ENDS else b.sdiv(a["columns"], ROWS), "rows") as block:
            row = b.mul(block, ROWS)
            bases = [b.offset(triangle, b.add(row, n), a["columns"]) for n in range(ROWS)]
            inner = Loop(b, b.sub(a["columns"], row), [vector(0.0)] * ROWS, "inner")
            j = b.add(row, inner.index)
            value = b.read(coefficients, b.add(b.mul(j, k_count), k))
            pairs = zip(bases, inner.carried, strict=True)
            totals = [b.fma(b.shared(base, j), value, total) for base, total in pairs]
            inner.close(totals)
            yield s, row, totals


def write_sums(module: Module, shape: BasisShape) -> None:
    """Write `sums(G, n, triangle, ..., q, ...)`, whose arguments are `COUNTS` and `BLOCKS`.

    Of G groups of walkers `(G, P + X + K (X + 1) + K D, LANES)`: parameters, start, rows of channels,
    spans of delays.  `n` columns, a multiple of `ROWS`; `channel`: numbers from the triangle `(n, n)`
    of a channel to that of the next, zero where all have the same, and `sum` to that of the next sum.
    `numbers`: step and constant inputs.  `projected (K, sums, n + 1)`: of the reference's residuals,
    and the square of what no function has.  `out (G, K sums + K, LANES)`: squares, and bounds of the
    size of what the functions leave.

    With the tangent there are q directions too: `directions (G, q, P + ..., LANES)`, slopes of what
    walkers have, and `weights (G, K sums, LANES)` of each sum.  `out (G, K sums + K + q + q q, LANES)`
    goes on with slopes and the lower triangle of the products, these with their weights.
    """
    with kernel(module, "sums", COUNTS, BLOCKS) as (a, b):
        q, columns, n_sums = a["q"], a["columns"], shape.channels * shape.sums
        length, first = b.mul(columns, n_sums), n_sums + shape.channels
        both = b.room(2 * shape.parameters)
        with b.loop(a["groups"], "groups") as group:
            walker = b.offset(a["walkers"], group, shape.walker_size)
            expansion = BasisExpansion(b, shape, a)
            residuals = expansion.after
            slopes = b.offset(residuals, length)  # (q, K sums, n)
            out = b.offset(a["out"], group, b.add(first, b.mul(q, b.add(q, 1))))
            if shape.tangent:
                with b.loop(q, "directions") as direction:
                    row = b.add(b.mul(group, q), direction)
                    along = b.offset(a["directions"], row, shape.walker_size)
                    b.copy(walker, both, shape.parameters)
                    b.copy(along, b.offset(both, shape.parameters), shape.parameters)
                    errors = _expand(expansion, (walker, along), both)
                    row_slopes = b.offset(slopes, direction, length)
                    moved = expansion.coefficients.bases[1]
                    for s, row, products in _projections(expansion, moved):
                        for n, product in enumerate(products):
                            b.write(product, row_slopes, b.add(b.mul(columns, s), b.add(row, n)))
            else:
                errors = _expand(expansion, (walker,), walker)
            b.write_row(errors, b.offset(out, n_sums))
            store_squares(expansion, out, residuals if shape.tangent else None)
            if shape.tangent:
                weights = b.offset(a["weights"], group, n_sums)
                _store_products(expansion, weights, slopes, residuals, b.offset(out, first))


def _expand(
    expansion: BasisExpansion, bases: tuple[ir.Value, ...], parameters: ir.Value
) -> list[ir.Value]:
    """Store the coefficients of walkers; return bounds `(K,)`; `bases`: of numbers, and of slopes."""
    b, shape = expansion.b, expansion.shape
    blocks, inputs = Blocks(b, bases), list[Matrix]()
    numbers = map(blocks.get, range(shape.parameters, shape.walker_size))
    start = [*islice(numbers, shape.states)]
    rows = [[*islice(numbers, shape.states + 1)] for _ in range(shape.channels)]
    _store_over(expansion, vector(1.0), parameters, expansion.entry.e)
    if shape.delays:
        late = _DelayedRows(expansion, parameters)
        pairs = [late.row(row, [*islice(numbers, shape.delays)]) for row in rows]
        rows, inputs = [row for row, _ in pairs], [weights for _, weights in pairs]
    return expansion.run(start, rows, inputs)


def store_squares(expansion: BasisExpansion, out: ir.Value, residuals: ir.Value | None) -> None:
    """Store all sums, and `residuals (K sums, n)` along the functions if wanted.

    Coefficients become what they differ by from those of the reference.
    """
    b, a, columns = expansion.b, expansion.a, expansion.a["columns"]
    coefficients = expansion.coefficients.bases[0]
    with b.loop(expansion.count, "reference") as each:
        known = b.shared(a["reference"], each)
        b.write(b.fsub(b.read(coefficients, each), known), coefficients, each)
    size = b.add(columns, 1)
    for s in range(expansion.shape.channels * expansion.shape.sums):
        b.write(b.shared(b.offset(a["projected"], s, size), columns), out, s)
    for s, row, products in _projections(expansion, coefficients):
        projected = b.offset(a["projected"], s, size)
        total = b.read(out, s)
        for n, product in enumerate(products):
            at = b.add(row, n)
            value = b.fsub(b.shared(projected, at), product)
            total = b.fma(value, value, total)
            if residuals is not None:
                b.write(value, residuals, b.add(b.mul(columns, s), at))
        b.write(total, out, s)


def _store_products(
    expansion: BasisExpansion,
    weights: ir.Value,
    slopes: ir.Value,
    residuals: ir.Value,
    out: ir.Value,
) -> None:
    """Store products `(q,)` of slopes with residuals, and `(q, q)` with those up to each.

    They are of rows `(K sums, n)`, each sum with its weight of `weights (K sums,)`.
    """
    b, shape, q, columns = expansion.b, expansion.shape, expansion.a["q"], expansion.a["columns"]
    length = b.mul(columns, shape.channels * shape.sums)

    def inner(left: ir.Value, right: ir.Value) -> ir.Value:
        total = vector(0.0)
        for s, (_, v) in enumerate(np.ndindex(shape.channels, shape.sums)):
            rows = 1 if v == ENDS else b.sdiv(columns, ROWS)
            loop = Loop(b, rows, [vector(0.0)] * ROWS, "inner")
            at = b.add(b.mul(columns, s), b.mul(loop.index, ROWS))
            totals = []
            for n, part in enumerate(loop.carried):
                index = b.add(at, n)
                totals.append(b.fma(b.read(left, index), b.read(right, index), part))
            loop.close(totals)
            product = b.fadd(b.fadd(totals[0], totals[1]), b.fadd(totals[2], totals[3]))
            total = b.fma(b.read(weights, s), product, total)
        return total

    with b.loop(q, "each") as each:
        row_slopes = b.offset(slopes, each, length)
        b.write(inner(row_slopes, residuals), out, each)
        row = b.offset(out, q, b.add(each, 1))
        with b.loop(b.add(each, 1), "pairs") as other:
            b.write(inner(row_slopes, b.offset(slopes, other, length)), row, other)
