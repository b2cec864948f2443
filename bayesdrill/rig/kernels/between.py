"""What shifted channels see from one knot to the next, see `kernels.late`."""

from __future__ import annotations

from llvmlite import ir

from bayesdrill.rig.kernels.gathering import anywhere, gather, splat_whole, turned
from bayesdrill.rig.kernels.lanes import (
    F64,
    I64,
    INT_VEC,
    LANES,
    NUMBERS,
    VEC,
    VECTORS,
    Loop,
    floor,
    fma,
    function,
    load,
    splat,
    store,
    vector,
    whole_numbers,
)
from bayesdrill.rig.kernels.sensing import WHOLE, Arguments, Shape, emit_seen, row_blocks
from bayesdrill.rig.kernels.series import DEGREE, Values, emit_terms
from bayesdrill.rig.kernels.steps import Machine, Rest, Slots, emit_rung, later

WHOLES = INT_VEC.as_pointer()

# What `interval` is called with beside the blocks of the kernel.
OWN_COUNTS = ("group", "knot", "degree", "depth")
OWN_BLOCKS = {
    "rates": VECTORS,
    "lane": VECTORS,  # norm, one over it, power and unit of the cell, 1 where that is halved
    "weights": VECTORS,
    "levels": VECTORS,
    "z": VECTORS,
    "rises": VECTORS,
    "terms": VECTORS,
    "tau": VECTORS,  # (K,) the shifted time of the next sample
    "next": WHOLES,  # (K,) which that is
    "shift": VECTORS,
    "weight": VECTORS,  # (K, m) of tallies that have some
}
SHARED_COUNTS = ("knots", "cells", "high")
SHARED_BLOCKS = {
    "numbers": NUMBERS, "t": NUMBERS, "y": NUMBERS, "which": WHOLE, "ladder": VECTORS,
    "rows": NUMBERS, "out": VECTORS,
}  # fmt: skip


def emit_interval(module: ir.Module, shape: Shape) -> ir.Function:
    """See `Late.interval`."""
    counts, blocks = OWN_COUNTS + SHARED_COUNTS, OWN_BLOCKS | SHARED_BLOCKS
    made = function(module, "interval", len(counts), list(blocks.values()))
    made.linkage = "internal"
    made.attributes.add("noinline")
    b = ir.IRBuilder(made.append_basic_block())
    w = _Interval(Arguments(b, dict(zip([*counts, *blocks], made.args, strict=True))), shape)
    channels = Loop(b, I64(sum(shape.shifted)), [], "channels")
    w.while_due(w.a.whole("which", channels.index))
    channels.close([])
    b.ret_void()
    return made


class _Interval:
    def __init__(self, a: Arguments, shape: Shape) -> None:
        b, layout = a.b, shape.layout
        self.b, self.a, self.shape = b, a, shape
        self.x, self.s = layout.n_states, layout.n_series
        # A second state, and its derivatives, for lanes that climb the ladder.
        self.other = b.alloca(VEC, I64(self.x + self.s))
        self.other_terms = b.alloca(VEC, I64(DEGREE * self.x))
        names = ("norm", "over", "power", "unit", "halved")
        self.lane = {name: load(b, a["lane"], place) for place, name in enumerate(names)}
        self.lane["halved"] = b.fcmp_ordered("!=", self.lane["halved"], vector(0.0))
        none: ir.Value = None
        self.m = Machine(
            b,
            layout,
            none,
            none,
            none,
            a["rates"],
            self.lane["norm"],
            self.lane["over"],
            none,
            none,
        )
        self.slopes = [load(b, a["rises"], s) for s in range(self.s)] if layout.first_order else []
        knot = a["knot"]
        self.begin, self.end = a.real("t", knot), a.real("t", b.add(knot, I64(1)))
        one = ir.Constant(F64, 1.0)
        self.cells = b.sitofp(a["cells"], F64)
        self.per_cell, self.per_row = b.fdiv(one, a.number(1)), b.fdiv(one, self.cells)
        self._derive(a["z"], a["terms"])

    def _derive(self, z: ir.Value, out: ir.Value) -> None:
        b = self.b

        def keep(k: ir.Value, term: Values, carried: Values) -> Values:
            mine = b.gep(out, [b.mul(b.sub(k, I64(1)), I64(self.x))])
            for i, value in enumerate(term):
                store(b, value, mine, i)
            return carried

        state = [load(b, z, i) for i in range(self.x)]
        inputs = [load(b, z, self.x + s) for s in range(self.s)]
        values = (state, inputs, self.slopes)
        rates, over = self.a["rates"], self.lane["over"]
        emit_terms(b, self.shape.layout, rates, values, over, self.a["degree"], [], keep)

    def while_due(self, k: ir.Value) -> None:
        """As long as the next sample of any lane is before the next knot."""
        b, a = self.b, self.a
        place, count = b.gep(a["tau"], [k]), b.gep(a["next"], [k])
        shift = b.load(b.gep(a["shift"], [k]), align=8)
        check = b.append_basic_block("check")
        body = b.append_basic_block("due")
        after = b.append_basic_block("after")
        b.branch(check)
        b.position_at_end(check)
        tau = b.load(place, align=8)
        due = b.fcmp_ordered("<", tau, splat(b, self.end))
        b.cbranch(anywhere(b, due), body, after)
        b.position_at_end(body)
        span = b.fsub(tau, splat(b, self.begin))
        span = b.select(due, span, vector(0.0))
        span = b.select(b.fcmp_ordered(">", span, vector(0.0)), span, vector(0.0))
        sample = b.load(count, align=8)
        weight = a["weight"] if self.shape.weights else None
        emit_seen(a, self.shape, weight, a["group"], k, sample, due, self._at(k, span))
        sample = b.add(sample, b.zext(due, INT_VEC))
        b.store(sample, count, align=8)
        b.store(b.fsub(gather(b, a["t"], sample), shift), place, align=8)
        b.branch(check)
        b.position_at_end(after)

    def _at(self, k: ir.Value, span: ir.Value) -> ir.Value:
        """What channel k sees a span after the knot."""
        b, a, lane, x = self.b, self.a, self.lane, self.x
        cells = splat(b, self.cells)
        far = b.fmul(span, splat(b, self.per_cell))
        high = floor(b, b.fmul(far, splat(b, self.per_row)))
        far = b.fsub(far, b.fmul(high, cells))
        far = b.select(b.fcmp_ordered(">", far, vector(0.0)), far, vector(0.0))
        cell = floor(b, b.select(lane["halved"], far, b.fadd(far, vector(0.5))))
        cell = b.select(b.fcmp_ordered(">", cell, cells), cells, cell)
        share = b.fsub(far, cell)
        fine = b.fmul(share, lane["power"])
        left = b.fsub(fine, b.select(lane["halved"], floor(b, fine), vector(0.0)))
        scaled = b.fmul(left, lane["unit"])
        beyond = anywhere(b, b.fcmp_ordered(">", high, vector(0.0)))
        climbs = b.or_(beyond, b.icmp_signed(">", a["depth"], I64(0)))
        with b.if_then(climbs):
            self._climb(b.fptosi(high, INT_VEC), share)
        z = b.select(climbs, self.other, a["z"])
        terms = b.select(climbs, self.other_terms, a["terms"])
        start = [load(b, z, i) for i in range(x)]
        series = Loop(b, a["degree"], [vector(1.0), *start], "series")
        weight = b.fmul(scaled, b.load(b.gep(a["weights"], [b.add(series.index, I64(1))]), align=8))
        weight = b.fmul(weight, series.carried[0])
        mine = b.gep(terms, [b.mul(series.index, I64(x))])
        state = [fma(b, weight, load(b, mine, i), to) for i, to in enumerate(series.carried[1:])]
        series.close([weight, *state])
        inputs = [load(b, z, x + s) for s in range(self.s)]
        inputs = later(b, inputs, self.slopes, b.fmul(scaled, lane["over"]))
        row = self._row(k, b.fptosi(cell, INT_VEC))
        value = vector(0.0)
        for one, other in zip(row, [*state, vector(1.0), *inputs, *self.slopes], strict=True):
            value = fma(b, one, other, value)
        return value

    def _row(self, k: ir.Value, cell: ir.Value) -> Values:
        b, a, blocks = self.b, self.a, row_blocks(self.shape)
        first = b.mul(k, b.add(a["cells"], I64(1)))
        own = ir.Constant(INT_VEC, list(range(LANES)))
        places = b.mul(b.add(cell, splat_whole(b, first)), whole_numbers(LANES))
        places = b.mul(b.add(places, own), whole_numbers(LANES * blocks))
        lanes: list[Values] = []
        for lane in range(LANES):
            place = b.extract_element(places, ir.Constant(ir.IntType(32), lane))
            mine = b.bitcast(b.gep(a["rows"], [place]), VECTORS)
            lanes.append([load(b, mine, block) for block in range(blocks)])
        found = [one for block in range(blocks) for one in turned(b, [own[block] for own in lanes])]
        return found[: self.shape.layout.size]

    def _climb(self, high: ir.Value, share: ir.Value) -> None:
        """The state and its derivatives after all but the cells and the rest of the span."""
        b, a = self.b, self.a
        places = [b.gep(self.other, [I64(i)]) for i in range(self.x + self.s)]
        for i, place in enumerate(places):
            store(b, load(b, a["z"], i), place, 0)
        at = Slots(b, places[: self.x], places[self.x :])
        none: ir.Value = None
        ladder = Rest(none, a["ladder"], a["levels"])
        rungs = Loop(b, b.add(a["high"], a["depth"]), [], "rungs")
        below = b.sub(rungs.index, b.sub(a["high"], I64(1)))
        low = b.icmp_signed(">", below, I64(0))
        power = b.sitofp(b.shl(I64(1), b.select(low, below, I64(0))), F64)
        halves = b.fptosi(b.fmul(share, splat(b, power)), INT_VEC)
        doubles = b.lshr(high, splat_whole(b, b.select(low, I64(0), rungs.index)))
        number = b.select(low, halves, doubles)
        mask = b.icmp_signed("!=", b.and_(number, whole_numbers(1)), whole_numbers(0))
        with b.if_then(anywhere(b, mask)):
            emit_rung(self.m, ladder, rungs.index, at, self.slopes, mask)
        rungs.close([])
        self._derive(self.other, self.other_terms)
