"""Sums of squares of a long record, and their normal equations, from its triangle.

See `rational_basis` for the functions that are the triangle's columns.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice

import numpy as np
from llvmlite import ir

from bayesdrill.rig.kernels.delayed_rows import DelayedRows, SpanExponential
from bayesdrill.rig.kernels.exponential import emit_exponential
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
from bayesdrill.rig.kernels.numbers import Blocks, Matrix
from bayesdrill.rig.kernels.rational_basis import ROWS, WHOLE_NUMBERS, BasisExpansion, BasisShape

COUNTS = ("groups", "columns", "channel", "sum", "q")
BLOCKS = {
    "walkers": VECTORS,
    "numbers": NUMBERS,
    "frame": NUMBERS,
    "orders": WHOLE_NUMBERS,
    "reference": NUMBERS,
    "triangles": NUMBERS,
    "projected": NUMBERS,
    "scratch": VECTORS,
    "directions": VECTORS,
    "weights": VECTORS,
    "out": VECTORS,
}
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


def write_sums(module: ir.Module, shape: BasisShape) -> None:
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
    exponential = emit_exponential(module, shape.layout, increments=True, beside_one=False)
    arguments, b = begin_kernel(module, "sums", COUNTS, BLOCKS)
    q, columns, n_sums = arguments["q"], arguments["columns"], shape.channels * shape.sums
    length, first = b.mul(columns, I64(n_sums)), n_sums + shape.channels
    both = b.alloca(VEC, I64(2 * shape.parameters))
    through = SpanExponential(b, shape, exponential, arguments["numbers"])
    groups = Loop(b, arguments["groups"], [], "groups")
    walker = b.offset(arguments["walkers"], groups.index, shape.walker_size)
    expansion = BasisExpansion(b, shape, arguments)
    residuals = expansion.after
    slopes = b.gep(residuals, [length])  # (q, K sums, n)
    out = b.offset(arguments["out"], groups.index, b.add(I64(first), b.mul(q, b.add(q, I64(1)))))
    if shape.tangent:
        directions = Loop(b, q, [], "directions")
        row = b.add(b.mul(groups.index, q), directions.index)
        along = b.offset(arguments["directions"], row, shape.walker_size)
        b.copy(walker, both, shape.parameters)
        b.copy(along, b.gep(both, [I64(shape.parameters)]), shape.parameters)
        errors = _expand(expansion, through, (walker, along), both)
        row_slopes = b.offset(slopes, directions.index, length)
        moved = expansion.coefficients.bases[1]
        for s, row, products, blocks in _projections(b, shape, arguments, moved):
            for n, product in enumerate(products):
                index = b.add(b.mul(columns, I64(s)), b.add(row, I64(n)))
                b.store(product, b.gep(row_slopes, [index]), align=8)
            blocks.close([])
        directions.close([])
    else:
        errors = _expand(expansion, through, (walker,), walker)
    b.write_row(errors, b.gep(out, [I64(n_sums)]))
    subtract_reference(b, expansion, arguments["reference"])
    store_squares(b, shape, arguments, expansion, out, residuals if shape.tangent else None)
    if shape.tangent:
        weights = b.offset(arguments["weights"], groups.index, n_sums)
        pairs = _WeightedProducts(b, shape, columns, weights)
        pairs.store(q, slopes, residuals, b.gep(out, [I64(first)]))
    groups.close([])
    b.ret_void()


def _expand(
    expansion: BasisExpansion,
    through: SpanExponential,
    bases: tuple[ir.Value, ...],
    parameters: ir.Value,
) -> list[ir.Value]:
    """Store the coefficients of walkers; return bounds `(K,)`; `bases`: of numbers, and of slopes."""
    b, shape = expansion.b, expansion.shape
    blocks, inputs = Blocks(b, bases), list[Matrix]()
    numbers = map(blocks.get, range(shape.parameters, shape.walker_size))
    start = [*islice(numbers, shape.states)]
    rows = [[*islice(numbers, shape.states + 1)] for _ in range(shape.channels)]
    through.over(vector(1.0), parameters, expansion.entry.e)
    if shape.delays:
        late = DelayedRows(b, shape, through, parameters)
        pairs = [late.row(row, [*islice(numbers, shape.delays)]) for row in rows]
        rows, inputs = [row for row, _ in pairs], [weights for _, weights in pairs]
    return expansion.run(start, rows, inputs)


def subtract_reference(b: Builder, expansion: BasisExpansion, reference: ir.Value) -> None:
    """Leave of coefficients their difference from those of the reference."""
    base = expansion.coefficients.bases[0]
    each = Loop(b, expansion.count, [], "reference")
    at = b.gep(base, [each.index])
    known = b.splat(b.load(b.gep(reference, [each.index])))
    b.store(b.fsub(b.load(at, align=8), known), at, align=8)
    each.close([])


def store_squares(
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
