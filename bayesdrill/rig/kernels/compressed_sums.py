"""Sums of squares of a long record, and their normal equations, from its triangle.

See `rational_basis` for the functions that are the triangle's columns.
"""

from __future__ import annotations

from collections.abc import Iterator

from llvmlite import ir

from bayesdrill.rig.kernels.exponential import emit_exponential
from bayesdrill.rig.kernels.jets import JetCells, Jets, Matrix
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
from bayesdrill.rig.kernels.rational_basis import ROWS, WHOLE_NUMBERS, BasisExpansion, BasisShape

COUNTS = ("groups", "columns", "triangle")
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


def _projections(
    b: Builder,
    shape: BasisShape,
    arguments: dict[str, ir.Value],
    coefficients: ir.Value,
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


def write_squares(module: ir.Module, shape: BasisShape) -> None:
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
    expansion = BasisExpansion(b, shape, arguments, arguments["scratch"])
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
    cells = JetCells(b, bases)
    start = [cells.read(p + i) for i in range(x)]
    width = x + 1
    rows = [
        [cells.read(p + x + k * width + i) for i in range(width)] for k in range(shape.channels)
    ]
    return start, rows


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
    """Store the squares of all channels, and `residuals (K, n)` along the functions if wanted."""
    columns = arguments["columns"]
    size = b.add(columns, I64(1))
    for k in range(shape.channels):
        projected = b.offset(arguments["projected"], I64(k), size)
        b.write(b.splat(b.load(b.gep(projected, [columns]))), out, 2 * k)
    coefficients = expansion.coefficients.bases[0]
    for k, row, products, rows in _projections(b, shape, arguments, coefficients):
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

    `shape` has the tangent.  `directions (G, q, P + X + K (X + 1), LANES)`: slopes of what walkers
    have; `scales (G, K, LANES)`: one over the noise.  `out (G, 2 K + q + q q, LANES)`: squares and
    bounds, then slopes and the lower triangle of the products, these times scales.
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
    expansion = BasisExpansion(b, shape, arguments, arguments["scratch"])
    residuals = expansion.after
    slopes = b.gep(residuals, [length])  # (q, K, n)
    out = b.offset(
        arguments["out"], groups.index, b.add(I64(2 * k_count), b.mul(q, b.add(q, I64(1))))
    )
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
    row_slopes = b.offset(slopes, directions.index, length)
    moved = expansion.coefficients.bases[1]
    for k, row, products, rows in _projections(b, shape, arguments, moved):
        for n, product in enumerate(products):
            index = b.add(b.mul(columns, I64(k)), b.add(row, I64(n)))
            b.store(b.fmul(product, b.read(scales, k)), b.gep(row_slopes, [index]), align=8)
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
    row_slopes = b.offset(slopes, each.index, length)
    b.store(_inner(b, row_slopes, residuals, length), b.gep(out, [each.index]), align=8)
    row = b.gep(out, [b.mul(q, b.add(each.index, I64(1)))])
    pairs = Loop(b, b.add(each.index, I64(1)), [], "pairs")
    other = b.offset(slopes, pairs.index, length)
    b.store(_inner(b, row_slopes, other, length), b.gep(row, [pairs.index]), align=8)
    pairs.close([])
    each.close([])


def _inner(b: Builder, left: ir.Value, right: ir.Value, length: ir.Value) -> ir.Value:
    """Return the product of two rows, in four sums."""
    loop = Loop(b, b.sdiv(length, I64(ROWS)), [vector(0.0)] * ROWS, "inner")
    at = b.mul(loop.index, I64(ROWS))
    totals = []
    for n, total in enumerate(loop.carried):
        index = b.add(at, I64(n))
        first, second = (b.load(b.gep(base, [index]), align=8) for base in (left, right))
        totals.append(b.fma(first, second, total))
    loop.close(totals)
    return b.fadd(b.fadd(totals[0], totals[1]), b.fadd(totals[2], totals[3]))
