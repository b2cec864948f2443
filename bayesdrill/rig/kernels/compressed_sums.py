"""Sums of squares of a long record, and their normal equations, from its triangle.

See `rational_basis` for the functions that are the triangle's columns.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from llvmlite import ir

from bayesdrill.rig.kernels.delayed_rows import DelayedRows
from bayesdrill.rig.kernels.exponential import emit_exponential
from bayesdrill.rig.kernels.jets import JetCells, Jets, Matrix
from bayesdrill.rig.kernels.lanes import (
    I64,
    NUMBERS,
    VEC,
    VECTORS,
    Builder,
    Loop,
    Vector,
    begin_kernel,
    vector,
)
from bayesdrill.rig.kernels.rational_basis import ROWS, WHOLE_NUMBERS, BasisExpansion, BasisShape

COUNTS = ("groups", "columns", "channel", "sum")
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
NORMAL_BLOCKS = {**BLOCKS, "directions": VECTORS, "weights": VECTORS}
ENDS = 2  # which of the sums has but two rows: of the first sample and the last


def _projections(
    b: Builder,
    shape: BasisShape,
    arguments: dict[str, ir.Value],
    coefficients: ir.Value,
) -> Iterator[tuple[int, ir.Value, list[ir.Value], Loop]]:
    """Loop over sums and blocks of rows of R times coefficients, as `(s, row, products, loop)`."""
    columns, k_count = arguments["columns"], shape.channels
    for s, (k, v) in enumerate(np.ndindex(k_count, shape.sums)):
        triangle = b.offset(arguments["triangles"], I64(k), arguments["channel"])
        triangle = b.offset(triangle, I64(v), arguments["sum"])
        rows = Loop(b, I64(1) if v == ENDS else b.sdiv(columns, I64(ROWS)), [], "rows")
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
        yield s, row, totals, rows


def write_squares(module: ir.Module, shape: BasisShape) -> None:
    """Write `squares(G, n, triangle, ...)`, whose arguments are `COUNTS` and `BLOCKS`.

    Of G groups of walkers `(G, P + X + K (X + 1), LANES)`: parameters, start, rows of channels.  `n`
    columns, a multiple of `ROWS`; `channel`: numbers from the triangle `(n, n)` of a channel to that
    of the next, zero where all have the same, and `sum` to that of the next sum.  `numbers`: step and
    constant inputs.  `projected (K, sums, n + 1)`: of the reference's residuals, and the square of
    what no function has.  `out (G, K sums + K, LANES)`: squares, and bounds of the size of what the
    functions leave.
    """
    exponential = emit_exponential(module, shape.layout, increments=True, beside_one=False)
    arguments, b = begin_kernel(module, "squares", COUNTS, BLOCKS)
    span, late_e = b.alloca(VEC), b.alloca(VEC, I64(shape.layout.size**2))
    groups = Loop(b, arguments["groups"], [], "groups")
    walker = b.offset(arguments["walkers"], groups.index, shape.walker_size)
    expansion = BasisExpansion(b, shape, arguments, arguments["scratch"])
    _call_exponential(b, exponential, walker, arguments["numbers"], span, expansion.e)
    start, rows = _walker_rows(b, shape, (walker,))
    inputs = list[Matrix]()
    if shape.delays:
        late = _Delays(b, shape, expansion, exponential, arguments["numbers"], span, late_e)
        rows, inputs = late.rows((walker,), walker, rows)
    errors = expansion.run(start, rows, inputs)
    _subtract_reference(b, expansion, arguments["reference"])
    n_sums = shape.channels * shape.sums
    out = b.offset(arguments["out"], groups.index, n_sums + shape.channels)
    _store_squares(b, shape, arguments, expansion, out, None)
    for k, error in enumerate(errors):
        b.write(error, out, n_sums + k)
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
    cells = JetCells(b, bases)
    start = [cells.read(p + i) for i in range(x)]
    width = x + 1
    rows = [
        [cells.read(p + x + k * width + i) for i in range(width)] for k in range(shape.channels)
    ]
    return start, rows


@dataclass(frozen=True, slots=True)
class _Delays:
    """Rows of channels that are late by spans of their own."""

    b: Builder
    shape: BasisShape
    expansion: BasisExpansion
    exponential: ir.Function
    numbers: ir.Value
    span: ir.Value
    e: ir.Value

    def rows(
        self, bases: tuple[ir.Value, ...], parameters: ir.Value, rows: Matrix
    ) -> tuple[Matrix, list[Matrix]]:
        """Return the rows over states, and weights of inputs; `bases`: of walkers and their slopes."""
        b, shape = self.b, self.shape
        x, layout, entry = shape.states, shape.layout, self.expansion.entry
        at, k_count = shape.walker_size - 2 * shape.channels, shape.channels
        step = b.splat(b.load(self.numbers))
        shifts = DelayedRows(
            b, x, layout.n_series, first_order=layout.first_order, steps=shape.delays,
            rates=self._rates(parameters, step),
        )  # fmt: skip
        late, direct, cells = [], [], JetCells(b, bases)
        for k, row in enumerate(rows):
            share = cells.read(at + k)
            b.write(b.fmul(share[0], step), self.span, 0)
            b.call(self.exponential, [parameters, b.gep(self.numbers, [I64(1)]), self.span, self.e])
            count = b.read(bases[0], at + k_count + k)
            part = functools.partial(entry, e=self.e)
            states, inputs = shifts.row(row, part, entry, share, count)
            late.append(states)
            direct.append(inputs)
        return late, direct

    def _rates(self, parameters: ir.Value, step: ir.Value) -> dict[tuple[int, int], ir.Value]:
        """Return the entries of M of the rig, times a step, by row and column of the rig."""
        b, x, layout = self.b, self.shape.states, self.shape.layout
        shift = layout.n_states - x
        rates = dict[tuple[int, int], ir.Value]()
        matrix = layout.matrix(b, parameters, b.gep(self.numbers, [I64(1)]))
        for row, column, value in matrix:
            if row < x and (column < x or column >= layout.n_states):
                place = (row, column if column < x else column - shift)
                rate = b.fmul(value.value if isinstance(value, Vector) else vector(value), step)
                rates[place] = b.fadd(rates[place], rate) if place in rates else rate
        return rates


def _subtract_reference(b: Builder, expansion: BasisExpansion, reference: ir.Value) -> None:
    """Leave of coefficients their difference from those of the reference."""
    base = expansion.coefficients.bases[0]
    each = Loop(b, expansion.count, [], "reference")
    at = b.gep(base, [each.index])
    known = b.splat(b.load(b.gep(reference, [each.index])))
    b.store(b.fsub(b.load(at, align=8), known), at, align=8)
    each.close([])


def _store_squares(
    b: Builder, shape: BasisShape, arguments: dict[str, ir.Value], expansion: BasisExpansion,
    out: ir.Value, residuals: ir.Value | None,
) -> None:  # fmt: skip
    """Store all sums, and `residuals (K sums, n)` along the functions if wanted."""
    columns = arguments["columns"]
    size = b.add(columns, I64(1))
    for s in range(shape.channels * shape.sums):
        projected = b.offset(arguments["projected"], I64(s), size)
        b.write(b.splat(b.load(b.gep(projected, [columns]))), out, s)
    coefficients = expansion.coefficients.bases[0]
    for s, row, products, rows in _projections(b, shape, arguments, coefficients):
        projected = b.offset(arguments["projected"], I64(s), size)
        total = b.read(out, s)
        for n, product in enumerate(products):
            at = b.add(row, I64(n))
            value = b.fsub(b.splat(b.load(b.gep(projected, [at]))), product)
            total = b.fma(value, value, total)
            if residuals is not None:
                index = b.add(b.mul(columns, I64(s)), at)
                b.store(value, b.gep(residuals, [index]), align=8)
        b.write(total, out, s)
        rows.close([])


def write_normal(module: ir.Module, shape: BasisShape) -> None:
    """Write `normal(G, n, triangle, q, ...)`, whose arguments are `NORMAL_COUNTS` and `NORMAL_BLOCKS`.

    `shape` has the tangent.  `directions (G, q, P + X + K (X + 1), LANES)`: slopes of what walkers
    have; `weights (G, K sums, LANES)`: of each sum.  `out (G, K sums + K + q + q q, LANES)`: squares
    and bounds, then slopes and the lower triangle of the products, these with their weights.
    """
    exponential = emit_exponential(module, shape.layout, increments=True, beside_one=False)
    arguments, b = begin_kernel(module, "normal", NORMAL_COUNTS, NORMAL_BLOCKS)
    span, q, n_sums = b.alloca(VEC), arguments["q"], shape.channels * shape.sums
    both = b.alloca(VEC, I64(2 * shape.parameters))
    late_e = b.alloca(VEC, I64(shape.layout.size**2))
    columns = arguments["columns"]
    length = b.mul(columns, I64(n_sums))
    groups = Loop(b, arguments["groups"], [], "groups")
    walker = b.offset(arguments["walkers"], groups.index, shape.walker_size)
    weights = b.offset(arguments["weights"], groups.index, n_sums)
    expansion = BasisExpansion(b, shape, arguments, arguments["scratch"])
    residuals = expansion.after
    slopes = b.gep(residuals, [length])  # (q, K sums, n)
    numbers = n_sums + shape.channels
    out = b.offset(arguments["out"], groups.index, b.add(I64(numbers), b.mul(q, b.add(q, I64(1)))))
    b.copy(walker, both, shape.parameters)
    directions = Loop(b, q, [], "directions")
    along = b.offset(
        arguments["directions"], b.add(b.mul(groups.index, q), directions.index), shape.walker_size
    )
    b.copy(along, b.gep(both, [I64(shape.parameters)]), shape.parameters)
    _call_exponential(b, exponential, both, arguments["numbers"], span, expansion.e)
    start, rows = _walker_rows(b, shape, (walker, along))
    inputs = list[Matrix]()
    if shape.delays:
        late = _Delays(b, shape, expansion, exponential, arguments["numbers"], span, late_e)
        rows, inputs = late.rows((walker, along), both, rows)
    errors = expansion.run(start, rows, inputs)
    for k, error in enumerate(errors):
        b.write(error, out, n_sums + k)
    row_slopes = b.offset(slopes, directions.index, length)
    moved = expansion.coefficients.bases[1]
    for s, row, products, blocks in _projections(b, shape, arguments, moved):
        for n, product in enumerate(products):
            index = b.add(b.mul(columns, I64(s)), b.add(row, I64(n)))
            b.store(product, b.gep(row_slopes, [index]), align=8)
        blocks.close([])
    directions.close([])
    _subtract_reference(b, expansion, arguments["reference"])
    _store_squares(b, shape, arguments, expansion, out, residuals)
    pairs = _WeightedProducts(b, shape, columns, weights)
    pairs.store(q, slopes, residuals, b.gep(out, [I64(numbers)]))
    groups.close([])
    b.ret_void()


@dataclass(frozen=True, slots=True)
class _WeightedProducts:
    """Products of rows `(K sums, n)`, each sum with its weight of `weights (K sums, LANES)`."""

    b: Builder
    shape: BasisShape
    columns: ir.Value
    weights: ir.Value

    def store(self, q: ir.Value, slopes: ir.Value, residuals: ir.Value, out: ir.Value) -> None:
        """Store products `(q,)` of slopes with residuals, and `(q, q)` with those up to each."""
        b, length = self.b, self.b.mul(self.columns, I64(self.shape.channels * self.shape.sums))
        each = Loop(b, q, [], "each")
        row_slopes = b.offset(slopes, each.index, length)
        b.store(self._inner(row_slopes, residuals), b.gep(out, [each.index]), align=8)
        row = b.gep(out, [b.mul(q, b.add(each.index, I64(1)))])
        pairs = Loop(b, b.add(each.index, I64(1)), [], "pairs")
        other = b.offset(slopes, pairs.index, length)
        b.store(self._inner(row_slopes, other), b.gep(row, [pairs.index]), align=8)
        pairs.close([])
        each.close([])

    def _inner(self, left: ir.Value, right: ir.Value) -> ir.Value:
        """Return the product of two rows."""
        b, total = self.b, vector(0.0)
        for s, (_, v) in enumerate(np.ndindex(self.shape.channels, self.shape.sums)):
            rows = I64(1) if v == ENDS else b.sdiv(self.columns, I64(ROWS))
            loop = Loop(b, rows, [vector(0.0)] * ROWS, "inner")
            at = b.add(b.mul(self.columns, I64(s)), b.mul(loop.index, I64(ROWS)))
            totals = []
            for n, part in enumerate(loop.carried):
                index = b.add(at, I64(n))
                first, second = (b.load(b.gep(base, [index]), align=8) for base in (left, right))
                totals.append(b.fma(first, second, part))
            loop.close(totals)
            product = b.fadd(b.fadd(totals[0], totals[1]), b.fadd(totals[2], totals[3]))
            total = b.fma(b.read(self.weights, s), product, total)
        return total
