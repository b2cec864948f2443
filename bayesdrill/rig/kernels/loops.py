"""Products and exponentials of matrices too large to be written out entry by entry.

Matrices stand in memory row by row, with a number of whole panels of `PANEL` columns in a row; one
with slopes is two of them.  Products are computed panel by panel, so that those of the other factor
stay close to the processor.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from llvmlite import ir

from bayesdrill.basics.duals import dual
from bayesdrill.rig.kernels.exponential import (
    TAYLOR_DEGREE,
    Layout,
    emit_balanced_norm,
    emit_shortening,
    register_entries,
    timed_entries,
)
from bayesdrill.rig.kernels.lanes import (
    F64,
    I64,
    NUMBERS,
    VEC,
    VECTORS,
    Builder,
    Loop,
    Vector,
    begin_function,
    vector,
)

PANEL = 7  # columns: two registers of AVX2 each, beside those of the other factor
Block = tuple[ir.Value, ...]  # the address of values, and that of slopes where there are some
Entries = Sequence[tuple[int, int]]


def in_panels(columns: int) -> int:
    """Return the columns of as many whole panels as it takes."""
    return -(-columns // PANEL) * PANEL


@dataclass(frozen=True, slots=True)
class Matrices:
    """Arithmetic of matrices with `stride` columns in memory, by functions in `module`."""

    module: ir.Module
    stride: int

    def multiply(
        self,
        b: Builder,
        out: Block,
        left: Block,
        right: Block,
        size: tuple[int | ir.Value, int, int],
        entries: Entries = (),
    ) -> None:
        """Store left times right; `size`: rows, inner columns, columns (all of the last panel).

        Where there are `entries`, by row, `left` has these alone, one after the other.
        """
        rows, inner, columns = size
        counts = [
            I64(rows) if isinstance(rows, int) else rows,
            I64(inner),
            I64(in_panels(columns) // PANEL),
        ]
        terms = [(0, 0, 0), (1, 0, 1), (1, 1, 0)] if len(out) > 1 else [(0, 0, 0)]
        for n, (target, factor, other) in enumerate(terms):
            function = self._product(entries, add=n == 2)
            b.call(function, [*counts, out[target], left[factor], right[other]])

    def _product(self, entries: Entries, *, add: bool) -> ir.Function:
        """Write `product(rows, inner, panels, out, left, right)`; `add`: to what is there."""
        name = f"product{'_sparse' * bool(entries)}{'_more' * add}"
        if name in self.module.globals:
            return self.module.globals[name]
        function, b = begin_function(self.module, name, 3, [VECTORS] * 3)
        function.linkage = "internal"
        rows, inner, panels, out, left, right = function.args
        panel = Loop(b, panels, [], "panels")
        first = b.mul(panel.index, I64(PANEL))
        row = Loop(b, rows, [], "rows")
        target = b.offset(out, b.add(b.mul(row.index, I64(self.stride)), first))
        begin, columns = b.mul(row.index, I64(self.stride)), None
        if entries:
            starts, columns = self._table(entries)
            begin = b.load(b.gep(starts, [I64(0), row.index]))
            following = b.gep(starts, [I64(0), b.add(row.index, I64(1))])
            inner = b.sub(b.load(following), begin)
        start = b.read_row(target, PANEL) if add else [vector(0.0)] * PANEL
        each = Loop(b, inner, start, "inner")
        at = b.add(begin, each.index)
        k = each.index if columns is None else b.load(b.gep(columns, [I64(0), at]))
        factor = b.read(b.offset(left, at), 0)
        other = b.offset(right, b.add(b.mul(k, I64(self.stride)), first))
        totals = [b.fma(factor, b.read(other, c), total) for c, total in enumerate(each.carried)]
        each.close(totals)
        b.write_row(totals, target)
        row.close([])
        panel.close([])
        b.ret_void()
        return function

    def _table(self, entries: Entries) -> tuple[ir.Value, ir.Value]:
        """Return where rows of sparse `entries` start, and their columns."""
        count = 1 + max(row for row, _ in entries)
        starts = [sum(row < i for row, _ in entries) for i in range(count + 1)]
        return self._integers("starts", starts), self._integers("columns", [c for _, c in entries])

    def _integers(self, name: str, values: Sequence[int]) -> ir.Value:
        if name in self.module.globals:
            return self.module.globals[name]
        kind = ir.ArrayType(I64, len(values))
        table = ir.GlobalVariable(self.module, kind, name)
        table.linkage, table.global_constant = "internal", True
        table.initializer = ir.Constant(kind, list(values))
        return table


def emit_transposed_exponential(
    matrices: Matrices, layout: Layout, *, apart: int = 0
) -> ir.Function:
    """Write `exponential(parameters, constants (C,), spans (LANES,), e, spare)`.

    It stores the transpose of what `emit_exponential` does, of inputs' increments, at `e (N, stride,
    LANES)`.  If the slopes of parameters stand `apart` from them, there are the addresses of slopes
    behind `e` and `spare`.

    The matrix has few entries: a power of it is multiplied by them, term by term.  It is shortened
    by its norm in units of the states that balance it, which is near its largest rate; other units
    ask for many squarings, which cost far more here than terms.
    """
    width = 1 + bool(apart)
    name = f"exponential_{width}"
    if name in matrices.module.globals:
        return matrices.module.globals[name]
    kinds = [VECTORS, NUMBERS, VECTORS, *[VECTORS] * (2 * width)]
    function, b = begin_function(matrices.module, name, 0, kinds)
    function.linkage = "internal"
    parameters, constants, spans, *both = function.args
    e, spare = tuple(both[:width]), tuple(both[width:])
    numbers = layout.numbers(b, parameters, constants, apart=apart)
    span, matrix = Vector(b, b.read(spans, 0)), layout.entries(numbers)
    timed = timed_entries(layout, matrix, span, increments=True)
    values = {index: dual(entry) for index, entry in timed.items()}
    plain = register_entries({index: entry.value for index, entry in values.items()})
    halvings, factor = emit_shortening(b, emit_balanced_norm(b, layout.n_states, plain))
    # Rows of the transpose are columns, and none is without an entry.
    places = sorted(
        {(column, row) for row, column in values} | {(i, i) for i in range(layout.size)}
    )
    a = tuple(b.alloca(VEC, I64(len(places))) for _ in range(width))
    for part, base in enumerate(a):
        for index, (column, row) in enumerate(places):
            entry = values.get((row, column), dual(0.0))
            shortened = Vector(b, factor) * (entry.slope if part else entry.value)
            b.write(shortened.value, base, index)
    _emit_series(b, matrices, layout.size, (a, places), e, spare)
    _emit_squarings(b, matrices, layout.size, halvings, e, spare)
    _add_unit(b, matrices, e[0], F64(1.0), I64(layout.size))
    b.ret_void()
    return function


def _add_unit(
    b: Builder, matrices: Matrices, out: ir.Value, factor: ir.Value, count: ir.Value
) -> None:
    """Add a factor to so many entries of the diagonal."""
    each = Loop(b, count, [], "unit")
    at = b.offset(out, each.index, matrices.stride + 1)
    b.write(b.fadd(b.read(at, 0), b.splat(factor)), at, 0)
    each.close([])


def _emit_series(
    b: Builder, matrices: Matrices, n: int, a: tuple[Block, Entries], e: Block, spare: Block
) -> None:
    """Store e = A (1 + A (1/2 + A (1/6 + ...))), panel by panel."""
    powers, places = a
    for base in e:
        b.clear(base, I64(n * matrices.stride))
    panel = Loop(b, I64(in_panels(n) // PANEL), [], "panel")
    first = b.mul(panel.index, I64(PANEL))
    here, there = (tuple(b.gep(base, [first]) for base in block) for block in (e, spare))
    diagonal = b.mul(first, I64(matrices.stride))
    count = b.sub(I64(n), first)
    count = b.select(b.icmp_signed("<", count, I64(PANEL)), count, I64(PANEL))
    factorial = F64(math.factorial(TAYLOR_DEGREE))  # a whole number, as are all after it
    weight = b.fdiv(F64(1.0), factorial)
    _add_unit(b, matrices, b.gep(here[0], [diagonal]), weight, count)
    pairs = Loop(b, I64(TAYLOR_DEGREE // 2), [factorial], "pairs")
    factorial = pairs.carried[0]
    power = b.fsub(F64(TAYLOR_DEGREE), b.sitofp(b.mul(pairs.index, I64(2)), F64))
    for out, right in ((there, here), (here, there)):
        factorial, power = b.fdiv(factorial, power), b.fsub(power, F64(1.0))
        matrices.multiply(b, out, powers, right, (n, n, PANEL), places)
        last = b.fcmp_ordered("==", power, F64(0.0))
        weight = b.select(last, F64(0.0), b.fdiv(F64(1.0), factorial))
        _add_unit(b, matrices, b.gep(out[0], [diagonal]), weight, count)
    pairs.close([factorial])
    panel.close([])


def _emit_squarings(
    b: Builder, matrices: Matrices, n: int, halvings: ir.Value, e: Block, spare: Block
) -> None:
    """Store (1 + e)^2 - 1 at e, as often as each lane was halved."""
    most = b.largest(halvings)
    with b.if_then(b.icmp_signed(">", most, I64(0))):
        squarings = Loop(b, most, [], "squarings")
        wanted = b.sitofp(halvings, VEC)
        still = b.fcmp_ordered("<", b.splat(b.sitofp(squarings.index, F64)), wanted)
        matrices.multiply(b, spare, e, e, (n, n, n))
        for now, square in zip(e, spare, strict=True):
            each = Loop(b, I64(n * matrices.stride), [], "each")
            at = b.offset(now, each.index)
            value, more = b.read(at, 0), b.read(b.offset(square, each.index), 0)
            b.write(b.select(still, b.fma(vector(2.0), value, more), value), at, 0)
            each.close([])
        squarings.close([])
