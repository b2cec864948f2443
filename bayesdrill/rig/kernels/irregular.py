"""Kernels for times that are not uniform, and for walkers with starts and sensors of their own.

The second family beside `misfit` and `signals`: what is constant there is an argument here.

An `IrregularShape` that is `late` also has channels whose times are shifted, each walker's by its own
amount.  A sample belongs to the step in which its shifted time lies.  Between two knots each lane has
its own number of samples; a counter of each lane says which is the next.  A channel sees row exp(M s) z
at a span s after the knot with state and inputs z: rows times exponentials over all multiples of a cell
are computed beforehand, the remainder of s is a Taylor series.  Spans beyond the cells, and lanes for
which a cell is long, climb a ladder of exponentials first.

Where all steps are equal, all samples of a lane have the same span, and one row is enough; only those
after the last knot are as above.
"""

from __future__ import annotations

from llvmlite import ir

from bayesdrill.rig.kernels.exponential import (
    MAX_SERIES_DEGREE,
    addresses,
    emit_cell,
    emit_terms,
)
from bayesdrill.rig.kernels.knots import (
    BLOCKS,
    COUNTS,
    MAX_LEVELS,
    Arguments,
    Channels,
    ExponentialLadder,
    GroupMatrices,
    IrregularShape,
    apply_exponential,
    emit_driven,
    emit_nodes,
    emit_remainder,
    extrapolate_inputs,
    table_entries,
)
from bayesdrill.rig.kernels.lanes import (
    F64,
    INT_VEC,
    LANES,
    VECTORS,
    Builder,
    Integer,
    Loop,
    Module,
    Values,
    kernel,
    routine,
    vector,
)
from bayesdrill.rig.kernels.recurrence import next_state

MAX_HIGH_LEVELS = 60
CHANNEL_SERIES_TAIL = 1e-14  # of what is seen: it does not add up from step to step
# What channels are observed with between two knots, beside the arguments of the kernel.
OWN = (
    "group", "knot", "degree", "depth", "rates",
    "over", "power", "unit", "half",  # of `GroupMatrices` and of the `Cell`
    "series", "levels", "z", "rises", "terms",
    "tau",  # (K,) the shifted time of the next sample
    "next",  # (K,) which that is
    "shift",
    "weight",  # (K, m) of tallies that have some
)  # fmt: skip
SHARED = ("knots", "cells", "high", "numbers", "t", "y", "which", "ladder", "rows", "out")


@routine
def _observe_interval(b: Builder, shape: IrregularShape, *values: ir.Value) -> None:
    """Observe all shifted channels from a knot to the next; `values`: of `OWN`, then of `SHARED`."""
    w = _Interval(b, dict(zip((*OWN, *SHARED), values, strict=True)), shape)
    with b.loop(sum(shape.shifted), "channels") as channel:
        w.while_due(b.single(w.a["which"], channel))


class _Interval:
    """The code of the function that observes shifted channels between two knots."""

    def __init__(self, b: Builder, a: Arguments, shape: IrregularShape) -> None:
        layout = shape.layout
        self.b, self.a, self.shape = b, a, shape
        self.x, self.s = layout.n_states, layout.n_series
        # A second state, and its derivatives, for lanes that climb the ladder.
        self.other = b.room(self.x + self.s)
        self.other_terms = b.room(MAX_SERIES_DEGREE * self.x)
        self.halved = b.fcmp_ordered("==", a["half"], vector(0.0))
        self.slopes = b.read_row(a["rises"], self.s) if layout.first_order else []
        knot = a["knot"]
        self.begin, self.end = b.single(a["t"], knot), b.single(a["t"], b.add(knot, 1))
        self.cells = b.sitofp(a["cells"], F64)
        self.per_cell = b.fdiv(F64(1.0), b.single(a["numbers"], 1))
        self.per_row = b.fdiv(F64(1.0), self.cells)
        self._derive(a["z"], a["terms"])

    def _derive(self, z: ir.Value, out: ir.Value) -> None:
        b, layout = self.b, self.shape.layout

        def keep(k: Integer, term: Values, totals: Values) -> Values:
            b.write_row(term, b.offset(out, b.sub(k, 1), self.x))
            return totals

        row = b.read_row(z, self.x + self.s)
        values = (row[: self.x], row[self.x :], self.slopes)
        emit_terms(b, layout, self.a["rates"], values, self.a["over"], self.a["degree"], [], keep)

    def while_due(self, k: ir.Value) -> None:
        """Observe as long as the next sample of any lane is before the next knot."""
        b, a = self.b, self.a
        shift = b.read(a["shift"], k)
        check, body, after = (b.append_basic_block(n) for n in ("check", "due", "after"))
        b.branch(check)
        b.position_at_end(check)
        tau = b.read(a["tau"], k)
        due = b.fcmp_ordered("<", tau, b.splat(self.end))
        b.cbranch(b.anywhere(due), body, after)
        b.position_at_end(body)
        span = b.select(due, b.fsub(tau, b.splat(self.begin)), vector(0.0))
        span = b.select(b.fcmp_ordered(">", span, vector(0.0)), span, vector(0.0))
        sample = b.read(a["next"], k)
        channels = Channels(b, a, self.shape, a["group"], {"weight": a["weight"]})
        channels.observe_at(k, sample, due, self._at(k, span))
        sample = b.add(sample, b.zext(due, INT_VEC))
        b.write(sample, a["next"], k)
        b.write(b.fsub(b.gather(a["t"], sample), shift), a["tau"], k)
        b.branch(check)
        b.position_at_end(after)

    def _at(self, k: ir.Value, span: ir.Value) -> ir.Value:
        """Return what channel k sees a span after the knot."""
        b, a, x = self.b, self.a, self.x
        cells = b.splat(self.cells)
        far = b.fmul(span, b.splat(self.per_cell))
        high = b.floor(b.fmul(far, b.splat(self.per_row)))
        far = b.fsub(far, b.fmul(high, cells))
        far = b.select(b.fcmp_ordered(">", far, vector(0.0)), far, vector(0.0))
        cell = b.floor(b.select(self.halved, far, b.fadd(far, vector(0.5))))
        cell = b.select(b.fcmp_ordered(">", cell, cells), cells, cell)
        share = b.fsub(far, cell)
        fine = b.fmul(share, a["power"])
        remainder = b.fsub(fine, b.select(self.halved, b.floor(fine), vector(0.0)))
        scaled = b.fmul(remainder, a["unit"])
        beyond = b.anywhere(b.fcmp_ordered(">", high, vector(0.0)))
        climbs = b.or_(beyond, b.icmp_signed(">", a["depth"], 0))
        with b.if_then(climbs):
            self._climb(b.fptosi(high, INT_VEC), share)
        z = b.select(climbs, self.other, a["z"])
        terms = b.select(climbs, self.other_terms, a["terms"])
        row = b.read_row(z, x + self.s)
        start, inputs = row[:x], row[x:]
        series = Loop(b, a["degree"], [vector(1.0), *start], "series")
        weight = b.fmul(scaled, b.read(a["series"], b.add(series.index, 1)))
        weight = b.fmul(weight, series.carried[0])
        mine = b.offset(terms, b.mul(series.index, x))
        state = [b.fma(weight, b.read(mine, i), to) for i, to in enumerate(series.carried[1:])]
        series.close([weight, *state])
        inputs = extrapolate_inputs(b, inputs, self.slopes, b.fmul(scaled, a["over"]))
        entries = [*state, vector(1.0), *inputs, *self.slopes]
        row = self._row(k, b.fptosi(cell, INT_VEC))
        return b.add_products(zip(row, entries, strict=True))

    def _row(self, k: ir.Value, cell: ir.Value) -> Values:
        b, a, blocks = self.b, self.a, self.shape.row_blocks
        first = b.mul(k, b.add(a["cells"], 1))
        lane_numbers = ir.Constant(INT_VEC, list(range(LANES)))
        places = b.mul(b.add(cell, b.splat(first)), LANES)
        places = b.mul(b.add(places, lane_numbers), LANES * blocks)
        lanes: list[Values] = []
        for lane in range(LANES):
            start = b.extract_element(places, ir.Constant(ir.IntType(32), lane))
            mine = b.bitcast(b.offset(a["rows"], start), VECTORS)
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
        slots = [b.offset(self.other, i) for i in range(self.x + self.s)]
        b.write_slots(b.read_row(a["z"], len(slots)), slots)
        ladder = ExponentialLadder(b, self.shape.layout, a["ladder"], a["levels"])
        with b.loop(b.add(a["high"], a["depth"]), "rungs") as rung:
            below = b.sub(rung, b.sub(a["high"], 1))
            low = b.icmp_signed(">", below, 0)
            power = b.sitofp(b.shl(1, b.select(low, below, 0)), F64)
            halves = b.fptosi(b.fmul(share, b.splat(power)), INT_VEC)
            doubles = b.lshr(high, b.splat(b.select(low, 0, rung)))
            number = b.select(low, halves, doubles)
            mask = b.icmp_signed("!=", b.and_(number, 1), 0)
            with b.if_then(b.anywhere(mask)):
                ladder.advance(rung, slots, self.slopes, mask)
        self._derive(self.other, self.other_terms)


class Late:
    """The part of a kernel that prepares and observes shifted channels of a group of walkers."""

    def __init__(
        self, b: Builder, a: Arguments, shape: IrregularShape, m: GroupMatrices, seen: Channels
    ) -> None:
        """Prepare tables, and observe the samples before the first knot."""
        self.b, self.a, self.shape, self.m, self.seen = b, a, shape, m, seen
        self.walkers = seen.walker
        k, x, n = len(shape.pattern), shape.layout.n_states, shape.layout.size
        sizes = {
            "series": MAX_SERIES_DEGREE + 1, "levels": MAX_HIGH_LEVELS + MAX_LEVELS,
            "z": x + shape.layout.n_series, "rises": max(1, shape.layout.n_series),
            "terms": MAX_SERIES_DEGREE * x, "even": k * n, "tau": k,
        }  # fmt: skip
        self.buffers = {name: b.room(size) for name, size in sizes.items()}
        self.buffers |= {name: b.room(k, INT_VEC) for name in ("next", "offset")}
        self.row = b.room(LANES * shape.row_blocks)
        width, shifted = b.single(a["numbers"], 1), sum(shape.shifted)
        series = self.buffers["series"]
        self.cell = emit_cell(b, m.norm, width, series, tail=CHANNEL_SERIES_TAIL)
        with b.if_then(b.icmp_signed(">", a["high"], 0)):
            self._fill_ladder(width)
            with b.loop(shifted, "cells") as channel:
                self._fill_cells(b.single(a["which"], channel))
        with b.loop(shifted, "begin") as channel:
            self._begin_channel(b.single(a["which"], channel))

    def _fill_ladder(self, width: ir.Value) -> None:
        b, a, m, high = self.b, self.a, self.m, self.a["high"]
        whole = b.fmul(width, b.sitofp(a["cells"], F64))
        levels = Loop(b, high, [whole], "high")
        ladder = ExponentialLadder(b, m.layout, a["ladder"], self.buffers["levels"])
        ladder.fill(m, levels.index, b.splat(levels.carried[0]))
        levels.close([b.fmul(levels.carried[0], F64(2.0))])
        above = b.offset(a["ladder"], high, len(table_entries(m.layout)))
        below = ExponentialLadder(b, m.layout, above, b.offset(self.buffers["levels"], high))
        below.fill_cell(m, self.cell, width)
        m.exponentiate(b.splat(width), m.e)

    def _begin_channel(self, k: ir.Value) -> None:
        b, a, m, buffers = self.b, self.a, self.m, self.buffers
        names = ("begin", "offset", "shift", "share", "head")
        begin, offset, shift, share, head = (b.read(self.walkers[name], k) for name in names)
        if self.shape.tally is not None:
            sums = b.offset(a["out"], self.seen.group, self.shape.out_count)
            address = b.offset(sums, k, self.shape.tally.count)
            b.write_row(self.shape.tally.initial(), address)
        first = b.fptosi(begin, INT_VEC)
        b.write(first, buffers["next"], k)
        b.write(b.fptosi(offset, INT_VEC), buffers["offset"], k)
        b.write(b.fsub(b.gather(a["t"], first), shift), buffers["tau"], k)
        if self.shape.even:
            m.exponentiate(share, m.e)
            self._copy_row(k)
            self._multiply()
            even = b.offset(buffers["even"], k, m.layout.size)
            b.write_row(b.read_row(self.row, m.layout.size), even)
        self._head(k, shift, head)

    def _copy_row(self, k: ir.Value) -> None:
        b, count = self.b, self.shape.r_count
        mine = b.read_row(b.offset(self.walkers["rows"], k, count), count)
        nothing = [vector(0.0)] * (LANES * self.shape.row_blocks - count)
        b.write_row([*mine, *nothing], self.row)

    def _multiply(self) -> None:
        """Multiply the row from the left to the exponential of the matrices."""
        b, e, n, reach = self.b, self.m.e, self.m.layout.size, self.m.layout.reach
        old = b.read_row(self.row, n)
        for j in range(n):
            terms = [(old[i], b.read(e, i * n + j)) for i in range(n) if reach[i][j]]
            b.write(b.add_products(terms), self.row, j)

    def _fill_cells(self, k: ir.Value) -> None:
        """Store rows over 0, 1, 2, ... cells: those of a lane one after another."""
        b, a, blocks = self.b, self.a, self.shape.row_blocks
        self._copy_row(k)
        count = b.add(a["cells"], 1)
        with b.loop(count, "rows") as row:
            start = b.mul(b.add(b.mul(k, count), row), LANES * blocks * LANES)
            base = b.bitcast(b.offset(a["rows"], start), VECTORS)
            for block in range(blocks):
                values = [b.read(self.row, LANES * block + n) for n in range(LANES)]
                for lane, numbers in enumerate(b.transpose(values)):
                    b.write(numbers, base, lane * blocks + block)
            self._multiply()

    def _head(self, k: ir.Value, shift: ir.Value, head: ir.Value) -> None:
        """Observe samples before the first knot, where states are straight and inputs constant."""
        b, a, walker, layout = self.b, self.a, self.walkers, self.shape.layout
        wanted = b.fptosi(head, INT_VEC)
        most = b.largest(wanted)
        row = b.offset(walker["rows"], k, self.shape.r_count)
        inputs, _ = emit_driven(b, layout, a, 0)
        with b.if_then(b.icmp_signed(">", most, 0)), b.loop(most, "head") as index:
            tau = b.fsub(b.shared(a["t"], index), shift)
            before, x0 = (b.read_row(walker[name], layout.n_states) for name in ("before", "x0"))
            states = [b.fma(tau, rate, start) for rate, start in zip(before, x0, strict=True)]
            value = self._shown(row, [*states, vector(1.0), *inputs])
            sample = b.splat(index)
            self.seen.observe_at(k, sample, b.icmp_signed("<", sample, wanted), value)

    def _shown(self, row: ir.Value, values: Values) -> ir.Value:
        """Return the product of a row and as many values."""
        b = self.b
        pairs = zip(b.read_row(row, len(values)), values, strict=True)
        return b.add_products(pairs)

    def even(self, knot: ir.Value, z: Values, slopes: Values) -> None:
        """Observe one sample in each lane, at the same span after every knot."""
        b, none = self.b, self.b.splat(self.a["knots"])
        for k in (k for k, shifted in enumerate(self.shape.shifted) if shifted):
            row = b.offset(self.buffers["even"], k * self.shape.layout.size)
            value = self._shown(row, [*z, *slopes])
            sample = b.add(b.splat(knot), b.read(self.buffers["offset"], k))
            inside = b.icmp_unsigned("<", sample, none)
            self.seen.observe_at(k, b.select(inside, sample, none), inside, value)

    def interval(self, knot: ir.Value, z: Values, slopes: Values) -> None:
        """Observe all shifted channels from a knot to the next."""
        b, walker, cell = self.b, self.walkers, self.cell
        b.write_row(z, self.buffers["z"])
        b.write_row(slopes, self.buffers["rises"])
        known = self.a | self.buffers | {
            "group": self.seen.group, "knot": knot, "degree": cell.count, "depth": cell.depth,
            "rates": self.m.rates, "over": self.m.over, "power": cell.power, "unit": cell.unit,
            "half": cell.half, "shift": walker["shift"],
            "weight": walker.get("weight", walker["shift"]),
        }  # fmt: skip
        _observe_interval(b, self.shape, *(known[name] for name in (*OWN, *SHARED)))


def write_dense(module: Module, shape: IrregularShape) -> None:
    """Write the kernel `dense`, of COUNTS and addresses of BLOCKS."""
    with kernel(module, "dense", COUNTS, BLOCKS) as (a, b):
        w = _Writer(b, a, shape)
        with b.loop(a["groups"], "groups") as group:
            w.write(group)


class _Writer:
    """Writes the code for a group of walkers."""

    def __init__(self, b: Builder, a: Arguments, shape: IrregularShape) -> None:
        self.b, self.a, self.shape, self.layout = b, a, shape, shape.layout
        self.entries = table_entries(shape.layout)
        self.state, self.inputs = b.slots(shape.layout.n_states), b.slots(shape.layout.n_series)
        self.end = b.slots(shape.layout.n_states)  # the state at the last knot
        # Sums stay in registers, but those of late channels.
        self.totals = [b.room(shape.tally.count) for _ in shape.pattern] if shape.tally else []
        self.width, self.least = b.single(a["numbers"], 0), b.shared(a["numbers"], 1)

    def write(self, group: ir.Value) -> None:
        """Write all that is done for a group of walkers."""
        b, a, layout = self.b, self.a, self.layout
        walker = addresses(b, a["own"], group, self.shape.walker_blocks)
        self.channels = Channels(b, a, self.shape, group, walker)
        m = GroupMatrices(b, layout, a, walker["parameters"], self.least)
        cell = emit_cell(b, m.norm, self.width, b.room(MAX_SERIES_DEGREE + 1))
        table = b.room(MAX_LEVELS * len(self.entries))
        ladder = ExponentialLadder(b, layout, table, b.room(MAX_LEVELS))
        ladder.fill_cell(m, cell, self.width)
        emit_nodes(m, a, cell, self.width)
        x0 = b.read_row(walker["x0"], layout.n_states)
        b.write_slots(x0, self.state)
        b.write_slots([vector(0.0)] * layout.n_series, self.inputs)
        begun = self.shape.tally.initial() if self.shape.tally is not None else []
        for total in self.totals:
            b.write_row(begun, total)
        self.late = Late(b, a, self.shape, m, self.channels) if self.shape.late else None
        runs = Loop(b, a["runs"], [0], "runs")
        first = runs.carried[0]
        length, share = b.single(a["length"], runs.index), b.single(a["share"], runs.index)
        node = b.single(a["node"], runs.index)
        table = b.offset(a["table"], node, len(self.entries))
        with b.if_else(b.fcmp_ordered(">=", share, F64(0.0))) as (then, otherwise):
            with then:
                inputs, slopes = self._observed(first)
                b.write_slots(inputs, self.inputs)
                emit_remainder(m, cell, ladder, share, [*self.state, *self.inputs], slopes)
                state, inputs = b.read_slots(self.state), b.read_slots(self.inputs)
                new = apply_exponential(b, layout, table, state, inputs, slopes)
                b.write_slots(new, self.state)
            with otherwise:
                self._equal_steps(first, length, table)
        runs.close([b.add(first, length)])
        if self.late is not None and self.shape.even:
            with b.if_then(b.icmp_signed(">", a["high"], 0)):
                # Samples of shifted channels, from the state at the last knot on.
                last = b.sub(a["knots"], 1)
                inputs, slopes = emit_driven(b, layout, a, last)
                self.late.interval(last, [*b.read_slots(self.end), *inputs], slopes)
        out = b.offset(a["out"], group, self.shape.out_count)
        for k, total in enumerate(self.totals):
            if not self.shape.shifted[k]:
                b.write_row(b.read_row(total, len(begun)), b.offset(out, k * len(begun)))

    def _equal_steps(self, first: ir.Value, n: ir.Value, table: ir.Value) -> None:
        """Advance n equal steps with the exponential in registers, as far as there are some."""
        b = self.b
        phi = {entry: b.read(table, index) for index, entry in enumerate(self.entries)}
        with b.loop(n, "knots") as knot:
            inputs, slopes = self._observed(b.add(first, knot))
            state = b.read_slots(self.state)
            new = next_state(b, phi, state, [*inputs, *slopes])
            if self.shape.even:
                b.write_slots(state, self.end)
            b.write_slots(new, self.state)

    def _observed(self, knot: ir.Value) -> tuple[Values, Values]:
        """Observe a knot, and shifted channels until the next; return inputs and their slopes."""
        inputs, slopes = emit_driven(self.b, self.layout, self.a, knot)
        state = self.b.read_slots(self.state)
        z = [*state, vector(1.0), *inputs]
        self.channels.observe(knot, z, self.totals)
        if self.late is not None and self.shape.even:
            self.late.even(knot, z, slopes)
        elif self.late is not None:
            self.late.interval(knot, [*state, *inputs], slopes)
        return inputs, slopes
