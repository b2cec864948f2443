"""Channels whose times are shifted, each walker's by its own amount, for one group of walkers.

A sample belongs to the step in which its shifted time lies.  Between two knots there are as many
samples as there are, in each lane others; a counter of each lane says which is the next.  A channel
sees row exp(M s) z at a span s after the knot with state and inputs z: rows times exponentials
over all multiples of a cell are made beforehand, the rest of s is a Taylor series.  Spans beyond
the cells, and lanes for which a cell is long, climb a ladder of exponentials first.

Where all steps are equal, all samples of a lane have the same span, and one row is enough; only
those after the last knot are as above.
"""

from __future__ import annotations

from llvmlite import ir

from bayesdrill.rig.kernels.between import OWN_BLOCKS, SHARED_BLOCKS, SHARED_COUNTS
from bayesdrill.rig.kernels.gathering import gather, largest, splat_whole, turned
from bayesdrill.rig.kernels.lanes import (
    F64,
    I64,
    INT_VEC,
    LANES,
    VEC,
    VECTORS,
    Loop,
    fma,
    load,
    splat,
    store,
    vector,
)
from bayesdrill.rig.kernels.sensing import Arguments, Shape, emit_seen, row_blocks
from bayesdrill.rig.kernels.series import DEGREE, Cell, Values, emit_cell
from bayesdrill.rig.kernels.steps import (
    MOST_LEVELS,
    Machine,
    Rest,
    emit_exponential_of,
    emit_ladder,
    emit_level,
    entries_of,
)

MOST_HIGH = 60
TAIL = 1e-14  # of what is seen: it does not add up from step to step


class Late:
    """The part of a kernel that prepares shifted channels."""

    def __init__(self, b: ir.IRBuilder, a: Arguments, shape: Shape, interval: ir.Function) -> None:
        self.b, self.a, self.shape, self.called = b, a, shape, interval
        layout, k, n = shape.layout, len(shape.pattern), shape.layout.size
        sizes = {
            "lane": 5, "weights": DEGREE + 1, "levels": MOST_HIGH + MOST_LEVELS,
            "z": layout.n_states + layout.n_series, "rises": max(1, layout.n_series),
            "terms": DEGREE * layout.n_states, "even": k * n, "tau": k,
        }  # fmt: skip
        self.own = {name: b.alloca(VEC, I64(size)) for name, size in sizes.items()}
        self.own |= {name: b.alloca(INT_VEC, I64(k)) for name in ("next", "offset")}
        self.row = b.alloca(VEC, I64(LANES * row_blocks(shape)))
        self.spare = b.alloca(VEC, I64(LANES * row_blocks(shape)))
        self.degree = b.alloca(I64)
        self.depth = b.alloca(I64)

    def begin(self, m: Machine, group: ir.Value, own: dict[str, ir.Value]) -> None:
        b, a, high = self.b, self.a, self.a["high"]
        self.own["rates"] = m.rates
        width = a.number(1)
        cell = emit_cell(b, m.norm, width, self.own["weights"], tail=TAIL)
        halved = b.select(b.fcmp_ordered("==", cell.half, vector(0.0)), vector(1.0), vector(0.0))
        for place, value in enumerate((m.norm, m.over, cell.power, cell.unit, halved)):
            store(b, value, self.own["lane"], place)
        b.store(cell.count, self.degree)
        b.store(cell.depth, self.depth)
        with b.if_then(b.icmp_signed(">", high, I64(0))):
            self._ladder(m, cell)
            channels = Loop(b, I64(sum(self.shape.shifted)), [], "cells")
            self._cells(m, own, a.whole("which", channels.index))
            channels.close([])
        self._begin_channels(m, group, own)

    def _ladder(self, m: Machine, cell: Cell) -> None:
        b, a, high, width = self.b, self.a, self.a["high"], self.a.number(1)
        whole = b.fmul(width, b.sitofp(a["cells"], F64))
        levels = Loop(b, high, [whole], "high")
        ladder = Rest(cell, a["ladder"], self.own["levels"])
        emit_level(m, ladder, levels.index, splat(b, levels.carried[0]))
        levels.close([b.fmul(levels.carried[0], ir.Constant(F64, 2.0))])
        above = a.row("ladder", high, len(entries_of(m.layout)))
        emit_ladder(m, Rest(cell, above, b.gep(self.own["levels"], [high])), width)
        emit_exponential_of(m, splat(b, width), m.e)

    def _begin_channels(self, m: Machine, group: ir.Value, own: dict[str, ir.Value]) -> None:
        b, a = self.b, self.a
        channels = Loop(b, I64(sum(self.shape.shifted)), [], "begin")
        k = a.whole("which", channels.index)
        if self.shape.tally is not None:
            first = b.mul(k, I64(self.shape.tally.count))
            place = b.gep(a.row("out", group, self.shape.out_count), [first])
            for n, value in enumerate(self.shape.tally.begun()):
                store(b, value, place, n)
        for name, of in (("next", "begin"), ("offset", "offset")):
            value = b.fptosi(b.load(b.gep(own[of], [k]), align=8), INT_VEC)
            b.store(value, b.gep(self.own[name], [k]), align=8)
        shift = b.load(b.gep(own["shift"], [k]), align=8)
        first = b.load(b.gep(self.own["next"], [k]), align=8)
        tau = b.fsub(gather(b, a["t"], first), shift)
        b.store(tau, b.gep(self.own["tau"], [k]), align=8)
        if self.shape.even:
            emit_exponential_of(m, b.load(b.gep(own["share"], [k]), align=8), m.e)
            self._copy_row(own, k)
            self._multiply(m)
            even = b.gep(self.own["even"], [b.mul(k, I64(m.layout.size))])
            for n in range(m.layout.size):
                store(b, load(b, self.row, n), even, n)
        self._head(group, own, k, shift)
        channels.close([])

    def _copy_row(self, own: dict[str, ir.Value], k: ir.Value) -> None:
        b, count = self.b, self.shape.r_count
        mine = b.gep(own["rows"], [b.mul(k, I64(count))])
        for n in range(LANES * row_blocks(self.shape)):
            store(b, load(b, mine, n) if n < count else vector(0.0), self.row, n)

    def _multiply(self, m: Machine) -> None:
        """The row from the left to the exponential at `m.e`."""
        b, n, reach = self.b, m.layout.size, m.layout.reach
        old = [load(b, self.row, i) for i in range(n)]
        for j in range(n):
            total = vector(0.0)
            for i in (i for i in range(n) if reach[i][j]):
                total = fma(b, old[i], load(b, m.e, i * n + j), total)
            store(b, total, self.row, j)

    def _cells(self, m: Machine, own: dict[str, ir.Value], k: ir.Value) -> None:
        """Rows over 0, 1, 2, ... cells: those of a lane are one after another."""
        b, a, blocks = self.b, self.a, row_blocks(self.shape)
        self._copy_row(own, k)
        count = b.add(a["cells"], I64(1))
        rows = Loop(b, count, [], "rows")
        place = b.mul(b.add(b.mul(k, count), rows.index), I64(LANES * blocks * LANES))
        base = b.bitcast(b.gep(a["rows"], [place]), VECTORS)
        for block in range(blocks):
            values = [load(b, self.row, LANES * block + n) for n in range(LANES)]
            for lane, numbers in enumerate(turned(b, values)):
                store(b, numbers, base, lane * blocks + block)
        self._multiply(m)
        rows.close([])

    def _head(
        self, group: ir.Value, own: dict[str, ir.Value], k: ir.Value, shift: ir.Value
    ) -> None:
        """Samples before the first knot, where states go on straight and inputs are constant."""
        b, a, layout = self.b, self.a, self.shape.layout
        wanted = b.fptosi(b.load(b.gep(own["head"], [k]), align=8), INT_VEC)
        most = largest(b, wanted)
        row = b.gep(own["rows"], [b.mul(k, I64(self.shape.r_count))])
        inputs = self.a.drive(layout, I64(0))[0]
        with b.if_then(b.icmp_signed(">", most, I64(0))):
            samples = Loop(b, most, [], "head")
            tau = b.fsub(splat(b, a.real("t", samples.index)), shift)
            states = [
                fma(b, tau, load(b, own["before"], i), load(b, own["x0"], i))
                for i in range(layout.n_states)
            ]
            value = vector(0.0)
            for r, one in enumerate([*states, vector(1.0), *inputs]):
                value = fma(b, load(b, row, r), one, value)
            sample = splat_whole(b, samples.index)
            due = b.icmp_signed("<", sample, wanted)
            emit_seen(a, self.shape, own.get("weight"), group, k, sample, due, value)
            samples.close([])

    def even(
        self, group: ir.Value, own: dict[str, ir.Value], knot: ir.Value, z: Values, slopes: Values
    ) -> None:
        """One sample in each lane, at the same span after every knot."""
        b, a = self.b, self.a
        for k in (k for k, shifted in enumerate(self.shape.shifted) if shifted):
            row = b.gep(self.own["even"], [I64(k * self.shape.layout.size)])
            value = vector(0.0)
            for r, one in enumerate([*z, *slopes]):
                value = fma(b, load(b, row, r), one, value)
            sample = b.add(splat_whole(b, knot), load(b, self.own["offset"], k))
            none = splat_whole(b, a["knots"])
            inside = b.icmp_unsigned("<", sample, none)
            sample = b.select(inside, sample, none)
            weight = own.get("weight")
            emit_seen(a, self.shape, weight, group, I64(k), sample, inside, value)

    def interval(
        self, group: ir.Value, own: dict[str, ir.Value], knot: ir.Value, z: Values, slopes: Values
    ) -> None:
        """What shifted channels see from a knot to the next."""
        b = self.b
        for place, value in enumerate(z):
            store(b, value, self.own["z"], place)
        for place, value in enumerate(slopes):
            store(b, value, self.own["rises"], place)
        known = self.own | {"shift": own["shift"], "weight": own.get("weight", own["shift"])}
        counts = [group, knot, b.load(self.degree), b.load(self.depth)]
        counts += [self.a[name] for name in SHARED_COUNTS]
        blocks = [known[name] for name in OWN_BLOCKS] + [self.a[name] for name in SHARED_BLOCKS]
        b.call(self.called, counts + blocks)
