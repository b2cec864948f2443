"""Compute sums of squares of a long record, and their normal equations, from its triangle.

See `basis_kernel` for the functions that are the triangle's columns.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice

import numpy as np
from llvmlite import ir

from bayesdrill.rig.compression.basis_kernel import ROWS, BasisExpansion, BasisShape
from bayesdrill.rig.kernels.exponential import store_exponential
from bayesdrill.rig.kernels.lanes import NUMBERS, VECTORS, WHOLE, Loop, Module, kernel, vector
from bayesdrill.rig.kernels.numbers import Blocks

COUNTS = ("groups", "columns", "channel", "sum", "q")
BLOCKS = (
    dict.fromkeys(("numbers", "frame", "reference", "triangles", "projected"), NUMBERS)
    | dict.fromkeys(("walkers", "scratch", "directions", "weights", "out"), VECTORS)
    | {"orders": WHOLE}
)
ENDS = 2  # index of the sum that has only two rows: the first and the last sample


def _projections(
    expansion: BasisExpansion, coefficients: ir.Value
) -> Iterator[tuple[int, ir.Value, list[ir.Value]]]:
    """Yield `(s, row, products)`: for sum s, `ROWS` rows of R from `row` on times the coefficients."""
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
    """Write the kernel `sums`, whose arguments are `COUNTS` and the addresses of `BLOCKS`.

    There are G groups of walkers (sets of parameters).  `walkers (G, P + X + K (X + 1), LANES)` has P
    parameters, X start values, and the rows of K channels.  `columns` is n, a multiple of `ROWS`.
    `channel` is the distance in memory between the triangles `(n, n)` of two channels, zero if they
    share one, and `sum` is that between two sums.  `numbers` are step and constant inputs.
    `projected (K, sums, n + 1)` is that of `Triangle`.  `out (G, K sums + K, LANES)` has sums and
    truncation bounds.

    With slopes, `directions (G, q, P + ..., LANES)` are slopes of the walkers' numbers in q
    directions, and `weights (G, K sums, LANES)` are weights of the sums.  The results of
    `_store_products` are at the end of `out (G, K sums + K + q + q q, LANES)`.
    """
    with kernel(module, "sums", COUNTS, BLOCKS) as (a, b):
        q, columns, n_sums = a["q"], a["columns"], shape.channels * shape.sums
        length, first = b.mul(columns, n_sums), n_sums + shape.channels
        with b.loop(a["groups"], "groups") as group:
            walker = b.offset(a["walkers"], group, shape.walker_size)
            expansion = BasisExpansion(b, shape, a)
            residuals = expansion.after
            slopes = b.offset(residuals, length)  # (q, K sums, n)
            out = b.offset(a["out"], group, b.add(first, b.mul(q, b.add(q, 1))))
            if shape.slopes:
                with b.loop(q, "directions") as direction:
                    row = b.add(b.mul(group, q), direction)
                    along = b.offset(a["directions"], row, shape.walker_size)
                    errors = _expand(expansion, (walker, along))
                    row_slopes = b.offset(slopes, direction, length)
                    moved = expansion.coefficients.bases[1]
                    for s, row, products in _projections(expansion, moved):
                        for n, product in enumerate(products):
                            b.write(product, row_slopes, b.add(b.mul(columns, s), b.add(row, n)))
            else:
                errors = _expand(expansion, (walker,))
            b.write_row(errors, b.offset(out, n_sums))
            store_squares(expansion, out, residuals if shape.slopes else None)
            if shape.slopes:
                weights = b.offset(a["weights"], group, n_sums)
                _store_products(expansion, weights, slopes, residuals, b.offset(out, first))


def _expand(expansion: BasisExpansion, bases: tuple[ir.Value, ...]) -> list[ir.Value]:
    """Store the coefficients of walkers at `bases` (numbers, slopes); return bounds `(K,)`."""
    b, shape, layout = expansion.b, expansion.shape, expansion.shape.layout
    numbers = map(Blocks(b, bases).get, range(layout.n_parameters, shape.walker_size))
    start = [*islice(numbers, layout.n_states)]
    rows = [[*islice(numbers, layout.n_states + 1)] for _ in range(shape.channels)]
    span, constants = b.shared(expansion.a["numbers"], 0), b.offset(expansion.a["numbers"], 1)
    e = expansion.entry.e
    values = [bases[0], span] + ([bases[1], vector(0.0)] if shape.slopes else [])
    store_exponential(b, e, constants, layout, *values, increments=True, beside_one=False)
    return expansion.run(start, rows)


def store_squares(expansion: BasisExpansion, out: ir.Value, residuals: ir.Value | None) -> None:
    """Store all sums and, if not None, the projected `residuals (K sums, n)`.

    The coefficients of the reference are subtracted from those of the walkers.
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
    """Store products `(q,)` of slopes and residuals, and the triangle `(q, q)` of products of slopes.

    Slopes and residuals are `(K sums, n)`, and each sum has a weight in `weights (K sums,)`.
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
