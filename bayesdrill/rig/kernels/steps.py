"""Steps between knots that are not all equal, for one group of walkers.

A step is a node, whose exponential is in a table, and a remainder within a cell: halvings of the
cell where that is long for a lane (`ladder`), and then a Taylor series of few terms.
"""

from __future__ import annotations

from dataclasses import dataclass

from llvmlite import ir

from bayesdrill.rig.kernels.gathering import splat_whole
from bayesdrill.rig.kernels.lanes import (
    F64,
    I64,
    VEC,
    Loop,
    floor,
    fma,
    load,
    splat,
    store,
    vector,
)
from bayesdrill.rig.kernels.layout import Layout
from bayesdrill.rig.kernels.recurrence import next_state
from bayesdrill.rig.kernels.sensing import Arguments
from bayesdrill.rig.kernels.series import DEEPEST, Cell, Values, emit_terms

MOST_LEVELS = DEEPEST


def entries_of(layout: Layout) -> list[tuple[int, int]]:
    """(row, column) of what tables keep of an exponential: rows of states, as far as they reach."""
    n, reach = layout.size, layout.reach
    return [(i, j) for i in range(layout.n_states) for j in range(n) if reach[i][j]]


@dataclass(frozen=True, slots=True)
class Slots:
    """Where state and sampled inputs are between two pieces of code."""

    b: ir.IRBuilder
    state: list[ir.Value]
    inputs: list[ir.Value]

    def read(self) -> tuple[Values, Values]:
        return (
            [load(self.b, slot, 0) for slot in self.state],
            [load(self.b, slot, 0) for slot in self.inputs],
        )

    def write(self, state: Values, inputs: Values) -> None:
        for value, slot in zip([*state, *inputs], [*self.state, *self.inputs], strict=True):
            store(self.b, value, slot, 0)


def slots(b: ir.IRBuilder, layout: Layout) -> Slots:
    def some(n: int) -> list[ir.Value]:
        return [b.alloca(VEC) for _ in range(n)]

    return Slots(b, some(layout.n_states), some(layout.n_series))


@dataclass(frozen=True, slots=True)
class Machine:
    """What the pieces of code for one group share."""

    b: ir.IRBuilder
    layout: Layout
    exponential: ir.Function
    product: ir.Function
    parameters: ir.Value
    rates: ir.Value
    norm: ir.Value
    over: ir.Value
    spans: ir.Value  # one vector
    e: ir.Value  # three matrices


def emit_exponential_of(m: Machine, spans: ir.Value, out: ir.Value) -> None:
    store(m.b, spans, m.spans, 0)
    m.b.call(m.exponential, [m.parameters, m.spans, out])


def keep(m: Machine, e: ir.Value, table: ir.Value) -> None:
    for place, (i, j) in enumerate(entries_of(m.layout)):
        store(m.b, load(m.b, e, i * m.layout.size + j), table, place)


def apply(m: Machine, table: ir.Value, state: Values, inputs: Values, slopes: Values) -> Values:
    """A kept exponential to a state."""
    phi = {where: load(m.b, table, place) for place, where in enumerate(entries_of(m.layout))}
    return next_state(m.b, m.layout.n_states, phi, state, [*inputs, *slopes])


@dataclass(frozen=True, slots=True)
class Rest:
    """Of spans within a cell: exponentials over its halvings, and the spans of these."""

    cell: Cell
    ladder: ir.Value
    spans: ir.Value


def emit_ladder(m: Machine, rest: Rest, width: ir.Value) -> None:
    """Over `width` / 2, / 4, ...; over 0 where a lane needs none."""
    b = m.b
    with b.if_then(b.icmp_signed(">", rest.cell.depth, I64(0))):
        levels = Loop(b, rest.cell.depth, [ir.Constant(F64, 0.5)], "levels")
        number = splat_whole(b, b.add(levels.index, I64(1)))
        wanted = b.icmp_signed(">=", rest.cell.halvings, number)
        span = b.select(wanted, splat(b, b.fmul(width, levels.carried[0])), vector(0.0))
        emit_level(m, rest, levels.index, span)
        levels.close([b.fmul(levels.carried[0], ir.Constant(F64, 0.5))])


def emit_level(m: Machine, rest: Rest, level: ir.Value, span: ir.Value) -> None:
    b, count = m.b, len(entries_of(m.layout))
    store(b, span, b.gep(rest.spans, [level]), 0)
    emit_exponential_of(m, span, m.e)
    keep(m, m.e, b.gep(rest.ladder, [b.mul(level, I64(count))]))


@dataclass(frozen=True, slots=True)
class Nodes:
    """Blocks of the host, and the width of a cell."""

    a: Arguments
    width: ir.Value


def emit_nodes(m: Machine, cell: Cell, nodes: Nodes) -> None:
    """The table: a chained node is the one before and a cell, others have exponentials of their own."""
    b, a, n = m.b, nodes.a, m.layout.size
    e, hop, spare = (b.gep(m.e, [I64(k * n * n)]) for k in range(3))
    with b.if_then(b.fcmp_ordered(">", nodes.width, ir.Constant(F64, 0.0))):
        emit_exponential_of(m, splat(b, nodes.width), hop)
    each = Loop(b, a["nodes"], [], "nodes")
    linked = b.icmp_signed("!=", a.whole("chained", each.index), I64(0))
    with b.if_else(linked) as (then, otherwise):
        with then:
            b.call(m.product, [spare, e, hop])
            for i in range(n):
                for j in (j for j in range(n) if m.layout.reach[i][j]):
                    store(b, load(b, spare, i * n + j), e, i * n + j)
        with otherwise:
            middle = b.fmul(cell.half, splat(b, nodes.width))
            inside = splat(b, a.real("inside", each.index))
            span = fma(b, inside, middle, splat(b, a.real("spans", each.index)))
            emit_exponential_of(m, span, e)
    keep(m, e, a.row("table", each.index, len(entries_of(m.layout))))
    each.close([])


def remainder(b: ir.IRBuilder, cell: Cell, share: ir.Value) -> ir.Value:
    """Norm times what is left of a `share` (0 to 1, of a cell) below the halvings of each lane."""
    fine = b.fmul(share, cell.power)
    left = b.fsub(fine, floor(b, fine))
    return b.fmul(b.fsub(left, cell.half), cell.unit)


def emit_rest(m: Machine, rest: Rest, share: ir.Value, place: Slots, slopes: Values) -> None:
    """Goes on by `share` (a number, 0 to 1) of a cell, from `place` to `place`."""
    b, layout, x = m.b, m.layout, m.layout.n_states
    state, inputs = place.read()
    scaled = remainder(b, rest.cell, splat(b, share))

    def add(k: ir.Value, term: Values, carried: Values) -> Values:
        share_k = b.load(b.gep(rest.cell.weights, [k]), align=8)
        weight = b.fmul(carried[0], b.fmul(scaled, share_k))
        totals = [fma(b, weight, one, to) for one, to in zip(term, carried[1:], strict=True)]
        return [weight, *totals]

    start = [vector(1.0), *state]
    values = (state, inputs, slopes)
    done = emit_terms(b, layout, m.rates, values, m.over, rest.cell.count, start, add)
    span = b.fmul(scaled, m.over)
    place.write(done[1 : x + 1], later(b, inputs, slopes, span))
    with b.if_then(b.icmp_signed(">", rest.cell.depth, I64(0))):
        levels = Loop(b, rest.cell.depth, [], "descent")
        power = b.shl(I64(1), b.add(levels.index, I64(1)))
        number = b.fptosi(b.fmul(share, b.sitofp(power, F64)), I64)
        with b.if_then(b.icmp_signed("!=", b.and_(number, I64(1)), I64(0))):
            emit_rung(m, rest, levels.index, place, slopes)
        levels.close([])


def emit_rung(
    m: Machine,
    rest: Rest,
    level: ir.Value,
    place: Slots,
    slopes: Values,
    mask: ir.Value | None = None,
) -> None:
    """By one level of a ladder, in all lanes or in those of a `mask`."""
    b = m.b
    table = b.gep(rest.ladder, [b.mul(level, I64(len(entries_of(m.layout))))])
    span = b.load(b.gep(rest.spans, [level]), align=8)
    state, inputs = place.read()
    new = apply(m, table, state, inputs, slopes)
    after = later(b, inputs, slopes, span)
    if mask is not None:
        new = [b.select(mask, one, old) for one, old in zip(new, state, strict=True)]
        after = [b.select(mask, one, old) for one, old in zip(after, inputs, strict=True)]
    place.write(new, after)


def later(b: ir.IRBuilder, inputs: Values, slopes: Values, span: ir.Value) -> Values:
    """Inputs with slopes, a span later; held ones as they are."""
    if not slopes:
        return inputs
    return [fma(b, slope, span, u) for u, slope in zip(inputs, slopes, strict=True)]
