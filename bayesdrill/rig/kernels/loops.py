"""Products and exponentials of matrices too large to be written out entry by entry.

Matrices stand in memory row by row, with a number of whole panels of `PANEL` columns in a row; one
with slopes is two of them.  Products are computed panel by panel, so that those of the other factor
stay close to the processor.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from llvmlite import ir

from bayesdrill.basics.duals import dual
from bayesdrill.rig.kernels.exponential import (
    TAYLOR_DEGREE,
    Layout,
    emit_balanced_norm,
    emit_shortening,
    timed_entries,
    value_registers,
)
from bayesdrill.rig.kernels.lanes import (
    F64,
    I64,
    VEC,
    Builder,
    Integer,
    Loop,
    Module,
    Vector,
    constant_table,
    integer,
    routine,
    vector,
)

PANEL = 7  # columns: two registers of AVX2 each, beside those of the other factor
Block = tuple[ir.Value, ...]  # the address of values, and that of slopes where there are some
Entries = Sequence[tuple[int, int]]


def in_panels(columns: int) -> int:
    """Return the columns of as many whole panels as it takes."""
    return -(-columns // PANEL) * PANEL


def multiply_panels(
    b: Builder,
    out: Block,
    left: Block,
    right: Block,
    size: tuple[Integer, int, int],
    stride: int,
    entries: Entries = (),
) -> None:
    """Store left times right, all of them with `stride` columns in memory.

    `size`: rows, inner columns, columns (all of the last panel).  Where there are `entries`, by row,
    `left` has these alone, one after the other.
    """
    rows, inner, columns = size
    panels = integer(in_panels(columns) // PANEL)
    terms = [(0, 0, 0), (1, 0, 1), (1, 1, 0)] if len(out) > 1 else [(0, 0, 0)]
    for n, (target, factor, other) in enumerate(terms):
        _store_product(
            b, integer(rows), integer(inner), panels, out[target], left[factor], right[other],
            stride, entries, add=n == 2,
        )  # fmt: skip


@routine
def _store_product(
    b: Builder,
    rows: ir.Value,
    inner: ir.Value,
    panels: ir.Value,
    out: ir.Value,
    left: ir.Value,
    right: ir.Value,
    stride: int,
    entries: Entries,
    *,
    add: bool,
) -> None:
    """Store a product or, with `add`, add it to what is there."""
    with b.loop(panels, "panels") as panel:
        first = b.mul(panel, PANEL)
        with b.loop(rows, "rows") as row:
            target = b.offset(out, b.add(b.mul(row, stride), first))
            begin, columns = b.mul(row, stride), None
            if entries:
                starts, columns = _table(b.module, entries)
                begin = b.load(b.gep(starts, [I64(0), row]))
                following = b.gep(starts, [I64(0), b.add(row, 1)])
                inner = b.sub(b.load(following), begin)
            start = b.read_row(target, PANEL) if add else [vector(0.0)] * PANEL
            each = Loop(b, inner, start, "inner")
            at = b.add(begin, each.index)
            k = each.index if columns is None else b.load(b.gep(columns, [I64(0), at]))
            factor = b.read(b.offset(left, at), 0)
            other = b.offset(right, b.add(b.mul(k, stride), first))
            totals = [
                b.fma(factor, b.read(other, c), total) for c, total in enumerate(each.carried)
            ]
            each.close(totals)
            b.write_row(totals, target)


def _table(module: Module, entries: Entries) -> list[ir.Value]:
    """Return where rows of sparse `entries` start, and their columns."""
    count = 1 + max(row for row, _ in entries)
    starts = [sum(row < i for row, _ in entries) for i in range(count + 1)]
    columns = [column for _, column in entries]
    return [constant_table(module, values).address for values in (starts, columns)]


@routine
def store_transposed_exponential(
    b: Builder,
    parameters: ir.Value,
    constants: ir.Value,
    span: ir.Value,
    layout: Layout,
    stride: int,
    apart: int,
    *blocks: ir.Value,
) -> None:
    """Store the transpose of what `store_exponential` does, of inputs' increments.

    `blocks`: where it is stored `(N, stride)`, with its slopes if slopes of parameters stand `apart`
    from them, and as much to spare.

    The matrix has few entries: a power of it is multiplied by them, term by term.  It is shortened
    by its norm in units of the states that balance it, which is near its largest rate; other units
    ask for many squarings, which cost far more here than terms.
    """
    width = len(blocks) // 2
    e, spare = blocks[:width], blocks[width:]
    slopes = [b.offset(parameters, apart)] if apart else []
    matrix = layout.matrix(b, constants, parameters, *slopes)
    timed = timed_entries(layout, matrix, Vector(b, span), increments=True)
    values = {index: dual(entry) for index, entry in timed.items()}
    plain = value_registers(values)
    halvings, factor = emit_shortening(b, emit_balanced_norm(b, layout.n_states, plain))
    # Rows of the transpose are columns, and none is without an entry.
    diagonal = {(i, i) for i in range(layout.size)}
    places = tuple(sorted({(column, row) for row, column in values} | diagonal))
    a = tuple(b.room(len(places)) for _ in range(width))
    for part, base in enumerate(a):
        for index, (column, row) in enumerate(places):
            entry = values.get((row, column), dual(0.0))
            shortened = Vector(b, factor) * (entry.slope if part else entry.value)
            b.write(shortened.value, base, index)
    _emit_series(b, layout.size, stride, (a, places), e, spare)
    _emit_squarings(b, layout.size, stride, halvings, e, spare)
    _add_unit(b, stride, e[0], F64(1.0), layout.size)


def _add_unit(b: Builder, stride: int, out: ir.Value, factor: ir.Value, count: Integer) -> None:
    """Add a factor to so many entries of the diagonal."""
    with b.loop(count, "unit") as each:
        at = b.offset(out, each, stride + 1)
        b.write(b.fadd(b.read(at, 0), b.splat(factor)), at, 0)


def _emit_series(
    b: Builder, n: int, stride: int, a: tuple[Block, Entries], e: Block, spare: Block
) -> None:
    """Store e = A (1 + A (1/2 + A (1/6 + ...))), panel by panel."""
    powers, places = a
    for base in e:
        b.clear(base, n * stride)
    with b.loop(in_panels(n) // PANEL, "panel") as panel:
        first = b.mul(panel, PANEL)
        here, there = (tuple(b.offset(base, first) for base in block) for block in (e, spare))
        diagonal = b.mul(first, stride)
        count = b.least(b.sub(n, first), PANEL)
        factorial = F64(math.factorial(TAYLOR_DEGREE))  # a whole number, as are all after it
        weight = b.fdiv(F64(1.0), factorial)
        _add_unit(b, stride, b.offset(here[0], diagonal), weight, count)
        pairs = Loop(b, TAYLOR_DEGREE // 2, [factorial], "pairs")
        factorial = pairs.carried[0]
        power = b.fsub(F64(TAYLOR_DEGREE), b.sitofp(b.mul(pairs.index, 2), F64))
        for out, right in ((there, here), (here, there)):
            factorial, power = b.fdiv(factorial, power), b.fsub(power, F64(1.0))
            multiply_panels(b, out, powers, right, (n, n, PANEL), stride, places)
            last = b.fcmp_ordered("==", power, F64(0.0))
            weight = b.select(last, F64(0.0), b.fdiv(F64(1.0), factorial))
            _add_unit(b, stride, b.offset(out[0], diagonal), weight, count)
        pairs.close([factorial])


def _emit_squarings(
    b: Builder, n: int, stride: int, halvings: ir.Value, e: Block, spare: Block
) -> None:
    """Store (1 + e)^2 - 1 at e, as often as each lane was halved."""
    most = b.largest(halvings)
    with b.if_then(b.icmp_signed(">", most, 0)), b.loop(most, "squarings") as squaring:
        wanted = b.sitofp(halvings, VEC)
        still = b.fcmp_ordered("<", b.splat(b.sitofp(squaring, F64)), wanted)
        multiply_panels(b, spare, e, e, (n, n, n), stride)
        for now, square in zip(e, spare, strict=True):
            with b.loop(n * stride, "each") as each:
                value, more = b.read(now, each), b.read(square, each)
                new = b.select(still, b.fma(vector(2.0), value, more), value)
                b.write(new, now, each)
