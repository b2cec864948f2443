"""Observe channels whose times are shifted, each walker's by its own amount.

A sample belongs to the step in which its shifted time lies.  Between two knots each lane has its
own number of samples; a counter of each lane says which is the next.  A channel sees row exp(M s) z
at a span s after the knot with state and inputs z: rows times exponentials over all multiples of a
cell are computed beforehand, the remainder of s is a Taylor series.  Spans beyond the cells, and
lanes for which a cell is long, climb a ladder of exponentials first.

Where all steps are equal, all samples of a lane have the same span, and one row is enough; only
those after the last knot are as above.
"""

from __future__ import annotations

from llvmlite import ir

from bayesdrill.rig.kernels.exponential import (
    MAX_SERIES_DEGREE,
    Cell,
    Values,
    emit_cell,
    emit_terms,
)
from bayesdrill.rig.kernels.knots import (
    MAX_LEVELS,
    WHOLE,
    Arguments,
    Channels,
    ExponentialLadder,
    GroupMatrices,
    IrregularShape,
    Slots,
    extrapolate_inputs,
    row_blocks,
    table_entries,
)
from bayesdrill.rig.kernels.lanes import (
    F64,
    I64,
    INT_VEC,
    LANES,
    NUMBERS,
    VEC,
    VECTORS,
    Builder,
    Loop,
    begin_function,
    vector,
    whole_numbers,
)

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


def emit_interval(module: ir.Module, shape: IrregularShape) -> ir.Function:
    """Write the function that `Late.interval` calls."""
    counts, blocks = OWN_COUNTS + SHARED_COUNTS, OWN_BLOCKS | SHARED_BLOCKS
    function, b = begin_function(module, "interval", len(counts), list(blocks.values()))
    function.linkage = "internal"
    function.attributes.add("noinline")
    w = _Interval(Arguments(b, dict(zip([*counts, *blocks], function.args, strict=True))), shape)
    channels = Loop(b, I64(sum(shape.shifted)), [], "channels")
    w.while_due(w.a.at("which", channels.index))
    channels.close([])
    b.ret_void()
    return function


class _Interval:
    """The code of the function that observes shifted channels between two knots."""

    def __init__(self, a: Arguments, shape: IrregularShape) -> None:
        b, layout = a.b, shape.layout
        self.b, self.a, self.shape = b, a, shape
        self.x, self.s = layout.n_states, layout.n_series
        # A second state, and its derivatives, for lanes that climb the ladder.
        self.other = b.alloca(VEC, I64(self.x + self.s))
        self.other_terms = b.alloca(VEC, I64(MAX_SERIES_DEGREE * self.x))
        names = ("norm", "over", "power", "unit", "halved")
        self.lane = {name: b.read(a["lane"], index) for index, name in enumerate(names)}
        self.lane["halved"] = b.fcmp_ordered("!=", self.lane["halved"], vector(0.0))
        self.slopes = b.read_row(a["rises"], self.s) if layout.first_order else []
        knot = a["knot"]
        self.begin, self.end = a.at("t", knot), a.at("t", b.add(knot, I64(1)))
        unit = ir.Constant(F64, 1.0)
        self.cells = b.sitofp(a["cells"], F64)
        self.per_cell, self.per_row = b.fdiv(unit, a.number(1)), b.fdiv(unit, self.cells)
        self._derive(a["z"], a["terms"])

    def _derive(self, z: ir.Value, out: ir.Value) -> None:
        b = self.b

        def keep(k: ir.Value, term: Values, totals: Values) -> Values:
            mine = b.gep(out, [b.mul(b.sub(k, I64(1)), I64(self.x))])
            b.write_row(term, mine)
            return totals

        state = b.read_row(z, self.x)
        inputs = [b.read(z, self.x + s) for s in range(self.s)]
        values = (state, inputs, self.slopes)
        rates, over = self.a["rates"], self.lane["over"]
        emit_terms(b, self.shape.layout, rates, values, over, self.a["degree"], [], keep)

    def while_due(self, k: ir.Value) -> None:
        """Observe as long as the next sample of any lane is before the next knot."""
        b, a = self.b, self.a
        tau_at, next_at = b.gep(a["tau"], [k]), b.gep(a["next"], [k])
        shift = b.load(b.gep(a["shift"], [k]), align=8)
        check = b.append_basic_block("check")
        body = b.append_basic_block("due")
        after = b.append_basic_block("after")
        b.branch(check)
        b.position_at_end(check)
        tau = b.load(tau_at, align=8)
        due = b.fcmp_ordered("<", tau, b.splat(self.end))
        b.cbranch(b.anywhere(due), body, after)
        b.position_at_end(body)
        span = b.fsub(tau, b.splat(self.begin))
        span = b.select(due, span, vector(0.0))
        span = b.select(b.fcmp_ordered(">", span, vector(0.0)), span, vector(0.0))
        sample = b.load(next_at, align=8)
        walker = {"weight": a["weight"]} if self.shape.weights else {}
        Channels(a, self.shape, a["group"], walker).observe_at(k, sample, due, self._at(k, span))
        sample = b.add(sample, b.zext(due, INT_VEC))
        b.store(sample, next_at, align=8)
        b.store(b.fsub(b.gather(a["t"], sample), shift), tau_at, align=8)
        b.branch(check)
        b.position_at_end(after)

    def _at(self, k: ir.Value, span: ir.Value) -> ir.Value:
        """Return what channel k sees a span after the knot."""
        b, a, lane, x = self.b, self.a, self.lane, self.x
        cells = b.splat(self.cells)
        far = b.fmul(span, b.splat(self.per_cell))
        high = b.floor(b.fmul(far, b.splat(self.per_row)))
        far = b.fsub(far, b.fmul(high, cells))
        far = b.select(b.fcmp_ordered(">", far, vector(0.0)), far, vector(0.0))
        cell = b.floor(b.select(lane["halved"], far, b.fadd(far, vector(0.5))))
        cell = b.select(b.fcmp_ordered(">", cell, cells), cells, cell)
        share = b.fsub(far, cell)
        fine = b.fmul(share, lane["power"])
        remainder = b.fsub(fine, b.select(lane["halved"], b.floor(fine), vector(0.0)))
        scaled = b.fmul(remainder, lane["unit"])
        beyond = b.anywhere(b.fcmp_ordered(">", high, vector(0.0)))
        climbs = b.or_(beyond, b.icmp_signed(">", a["depth"], I64(0)))
        with b.if_then(climbs):
            self._climb(b.fptosi(high, INT_VEC), share)
        z = b.select(climbs, self.other, a["z"])
        terms = b.select(climbs, self.other_terms, a["terms"])
        start = b.read_row(z, x)
        series = Loop(b, a["degree"], [vector(1.0), *start], "series")
        weight = b.fmul(scaled, b.load(b.gep(a["weights"], [b.add(series.index, I64(1))]), align=8))
        weight = b.fmul(weight, series.carried[0])
        mine = b.gep(terms, [b.mul(series.index, I64(x))])
        state = [b.fma(weight, b.read(mine, i), to) for i, to in enumerate(series.carried[1:])]
        series.close([weight, *state])
        inputs = [b.read(z, x + s) for s in range(self.s)]
        inputs = extrapolate_inputs(b, inputs, self.slopes, b.fmul(scaled, lane["over"]))
        row = self._row(k, b.fptosi(cell, INT_VEC))
        value = vector(0.0)
        for coefficient, entry in zip(
            row, [*state, vector(1.0), *inputs, *self.slopes], strict=True
        ):
            value = b.fma(coefficient, entry, value)
        return value

    def _row(self, k: ir.Value, cell: ir.Value) -> Values:
        b, a, blocks = self.b, self.a, row_blocks(self.shape)
        first = b.mul(k, b.add(a["cells"], I64(1)))
        lane_numbers = ir.Constant(INT_VEC, list(range(LANES)))
        places = b.mul(b.add(cell, b.splat(first)), whole_numbers(LANES))
        places = b.mul(b.add(places, lane_numbers), whole_numbers(LANES * blocks))
        lanes: list[Values] = []
        for lane in range(LANES):
            start = b.extract_element(places, ir.Constant(ir.IntType(32), lane))
            mine = b.bitcast(b.gep(a["rows"], [start]), VECTORS)
            lanes.append(b.read_row(mine, blocks))
        entries = [
            entry
            for block in range(blocks)
            for entry in b.transpose([lane_blocks[block] for lane_blocks in lanes])
        ]
        return entries[: self.shape.layout.size]

    def _climb(self, high: ir.Value, share: ir.Value) -> None:
        """Advance state and derivatives by all of the span but its cells and its remainder."""
        b, a = self.b, self.a
        slots = [b.gep(self.other, [I64(i)]) for i in range(self.x + self.s)]
        for i, slot in enumerate(slots):
            b.write(b.read(a["z"], i), slot, 0)
        state = Slots(b, slots[: self.x], slots[self.x :])
        ladder = ExponentialLadder(b, self.shape.layout, a["ladder"], a["levels"])
        rungs = Loop(b, b.add(a["high"], a["depth"]), [], "rungs")
        below = b.sub(rungs.index, b.sub(a["high"], I64(1)))
        low = b.icmp_signed(">", below, I64(0))
        power = b.sitofp(b.shl(I64(1), b.select(low, below, I64(0))), F64)
        halves = b.fptosi(b.fmul(share, b.splat(power)), INT_VEC)
        doubles = b.lshr(high, b.splat(b.select(low, I64(0), rungs.index)))
        number = b.select(low, halves, doubles)
        mask = b.icmp_signed("!=", b.and_(number, whole_numbers(1)), whole_numbers(0))
        with b.if_then(b.anywhere(mask)):
            ladder.advance(rungs.index, state, self.slopes, mask)
        rungs.close([])
        self._derive(self.other, self.other_terms)


MAX_HIGH_LEVELS = 60
CHANNEL_SERIES_TAIL = 1e-14  # of what is seen: it does not add up from step to step


class Late:
    """The part of a kernel that prepares and observes shifted channels."""

    def __init__(
        self, b: Builder, a: Arguments, shape: IrregularShape, interval: ir.Function
    ) -> None:
        self.b, self.a, self.shape, self.called = b, a, shape, interval
        layout, k, n = shape.layout, len(shape.pattern), shape.layout.size
        sizes = {
            "lane": 5, "weights": MAX_SERIES_DEGREE + 1, "levels": MAX_HIGH_LEVELS + MAX_LEVELS,
            "z": layout.n_states + layout.n_series, "rises": max(1, layout.n_series),
            "terms": MAX_SERIES_DEGREE * layout.n_states, "even": k * n, "tau": k,
        }  # fmt: skip
        self.buffers = {name: b.alloca(VEC, I64(size)) for name, size in sizes.items()}
        self.buffers |= {name: b.alloca(INT_VEC, I64(k)) for name in ("next", "offset")}
        self.row = b.alloca(VEC, I64(LANES * row_blocks(shape)))
        self.spare = b.alloca(VEC, I64(LANES * row_blocks(shape)))
        self.degree = b.alloca(I64)
        self.depth = b.alloca(I64)

    def begin(self, m: GroupMatrices, observer: Channels) -> None:
        """Prepare the tables of a group of walkers, and the samples before the first knot."""
        b, a, high = self.b, self.a, self.a["high"]
        self.seen, self.walkers = observer, observer.walker
        self.buffers["rates"] = m.rates
        width, shifted = a.number(1), I64(sum(self.shape.shifted))
        cell = emit_cell(b, m.norm, width, self.buffers["weights"], tail=CHANNEL_SERIES_TAIL)
        halved = b.select(b.fcmp_ordered("==", cell.half, vector(0.0)), vector(1.0), vector(0.0))
        b.write_row((m.norm, m.over, cell.power, cell.unit, halved), self.buffers["lane"])
        b.store(cell.count, self.degree)
        b.store(cell.depth, self.depth)
        with b.if_then(b.icmp_signed(">", high, I64(0))):
            self._ladder(m, cell)
            loop = Loop(b, shifted, [], "cells")
            self._cells(m, a.at("which", loop.index))
            loop.close([])
        loop = Loop(b, shifted, [], "begin")
        self._begin_channel(m, a.at("which", loop.index))
        loop.close([])

    def _ladder(self, m: GroupMatrices, cell: Cell) -> None:
        b, a, high, width = self.b, self.a, self.a["high"], self.a.number(1)
        whole = b.fmul(width, b.sitofp(a["cells"], F64))
        levels = Loop(b, high, [whole], "high")
        ladder = ExponentialLadder(b, m.layout, a["ladder"], self.buffers["levels"])
        ladder.fill(m, levels.index, b.splat(levels.carried[0]))
        levels.close([b.fmul(levels.carried[0], ir.Constant(F64, 2.0))])
        above = a.row("ladder", high, len(table_entries(m.layout)))
        below = ExponentialLadder(b, m.layout, above, b.gep(self.buffers["levels"], [high]))
        below.fill_cell(m, cell, width)
        m.exponentiate(b.splat(width), m.e)

    def _begin_channel(self, m: GroupMatrices, k: ir.Value) -> None:
        b, a = self.b, self.a

        def walker_number(name: str) -> ir.Value:
            return b.load(b.gep(self.walkers[name], [k]), align=8)

        if self.shape.tally is not None:
            first = b.mul(k, I64(self.shape.tally.count))
            address = b.gep(a.row("out", self.seen.group, self.shape.out_count), [first])
            b.write_row(self.shape.tally.initial(), address)
        for name, source in (("next", "begin"), ("offset", "offset")):
            value = b.fptosi(walker_number(source), INT_VEC)
            b.store(value, b.gep(self.buffers[name], [k]), align=8)
        shift = walker_number("shift")
        first = b.load(b.gep(self.buffers["next"], [k]), align=8)
        tau = b.fsub(b.gather(a["t"], first), shift)
        b.store(tau, b.gep(self.buffers["tau"], [k]), align=8)
        if self.shape.even:
            m.exponentiate(walker_number("share"), m.e)
            self._copy_row(k)
            self._multiply(m)
            even = b.offset(self.buffers["even"], k, m.layout.size)
            for n in range(m.layout.size):
                b.write(b.read(self.row, n), even, n)
        self._head(k, shift, walker_number("head"))

    def _copy_row(self, k: ir.Value) -> None:
        b, count = self.b, self.shape.r_count
        mine = b.offset(self.walkers["rows"], k, count)
        for n in range(LANES * row_blocks(self.shape)):
            b.write(b.read(mine, n) if n < count else vector(0.0), self.row, n)

    def _multiply(self, m: GroupMatrices) -> None:
        """Multiply the row from the left to the exponential at `m.e`."""
        b, n, reach = self.b, m.layout.size, m.layout.reach
        old = b.read_row(self.row, n)
        for j in range(n):
            total = vector(0.0)
            for i in (i for i in range(n) if reach[i][j]):
                total = b.fma(old[i], b.read(m.e, i * n + j), total)
            b.write(total, self.row, j)

    def _cells(self, m: GroupMatrices, k: ir.Value) -> None:
        """Store rows over 0, 1, 2, ... cells: those of a lane one after another."""
        b, a, blocks = self.b, self.a, row_blocks(self.shape)
        self._copy_row(k)
        count = b.add(a["cells"], I64(1))
        rows = Loop(b, count, [], "rows")
        start = b.mul(b.add(b.mul(k, count), rows.index), I64(LANES * blocks * LANES))
        base = b.bitcast(b.gep(a["rows"], [start]), VECTORS)
        for block in range(blocks):
            values = [b.read(self.row, LANES * block + n) for n in range(LANES)]
            for lane, numbers in enumerate(b.transpose(values)):
                b.write(numbers, base, lane * blocks + block)
        self._multiply(m)
        rows.close([])

    def _head(self, k: ir.Value, shift: ir.Value, head: ir.Value) -> None:
        """Observe samples before the first knot, where states are straight and inputs constant."""
        b, a, walker = self.b, self.a, self.walkers
        wanted = b.fptosi(head, INT_VEC)
        most = b.largest(wanted)
        row = b.offset(walker["rows"], k, self.shape.r_count)
        inputs = a.drive(self.shape.layout, I64(0))[0]
        with b.if_then(b.icmp_signed(">", most, I64(0))):
            samples = Loop(b, most, [], "head")
            tau = b.fsub(b.splat(a.at("t", samples.index)), shift)
            states = [
                b.fma(tau, b.read(walker["before"], i), b.read(walker["x0"], i))
                for i in range(self.shape.layout.n_states)
            ]
            value = b.dot(row, [*states, vector(1.0), *inputs])
            sample = b.splat(samples.index)
            due = b.icmp_signed("<", sample, wanted)
            self.seen.observe_at(k, sample, due, value)
            samples.close([])

    def even(self, knot: ir.Value, z: Values, slopes: Values) -> None:
        """Observe one sample in each lane, at the same span after every knot."""
        b, a = self.b, self.a
        for k in (k for k, shifted in enumerate(self.shape.shifted) if shifted):
            row = b.gep(self.buffers["even"], [I64(k * self.shape.layout.size)])
            value = b.dot(row, [*z, *slopes])
            sample = b.add(b.splat(knot), b.read(self.buffers["offset"], k))
            none = b.splat(a["knots"])
            inside = b.icmp_unsigned("<", sample, none)
            sample = b.select(inside, sample, none)
            self.seen.observe_at(I64(k), sample, inside, value)

    def interval(self, knot: ir.Value, z: Values, slopes: Values) -> None:
        """Observe all shifted channels from a knot to the next."""
        b, walker = self.b, self.walkers
        b.write_row(z, self.buffers["z"])
        b.write_row(slopes, self.buffers["rises"])
        known = self.buffers | {
            "shift": walker["shift"],
            "weight": walker.get("weight", walker["shift"]),
        }
        counts = [self.seen.group, knot, b.load(self.degree), b.load(self.depth)]
        counts += [self.a[name] for name in SHARED_COUNTS]
        blocks = [known[name] for name in OWN_BLOCKS] + [self.a[name] for name in SHARED_BLOCKS]
        b.call(self.called, counts + blocks)
