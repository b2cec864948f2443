"""Steps between knots that are not all equal, and what a channel sees at a knot.

A step is a node, whose exponential is in a table, and a remainder within a cell: halvings of the
cell where that is long for a lane (`ladder`), and then a Taylor series of few terms.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from llvmlite import ir

from bayesdrill.rig.kernels.exponential import DEEPEST, Cell, Layout, Pattern, Values, emit_terms
from bayesdrill.rig.kernels.lanes import (
    F64,
    I64,
    LANES,
    NUMBERS,
    VECTORS,
    Builder,
    Loop,
    vector,
    whole_numbers,
)
from bayesdrill.rig.kernels.recurrence import next_state
from bayesdrill.rig.kernels.sums import Sample, Tally

WHOLE = I64.as_pointer()

# T knots; `high`: rungs of the ladder that lead beyond the cells, of which there are `cells`, 0 where
# no sample wants it.
COUNTS = ("groups", "knots", "nodes", "runs", "cells", "high")
BLOCKS = {
    "own": VECTORS,  # (G, vectors of `Shape.own`): what walkers have of their own
    "numbers": NUMBERS,  # widths of a cell of steps and of one of shifts, least norm; constant inputs
    "spans": NUMBERS,  # (N,) of nodes
    "inside": NUMBERS,  # (N,) 1 where shares follow
    "chained": WHOLE,  # (N,) 1 where a node is the one before and a cell
    "node": WHOLE,  # of each run of equal steps,
    "length": WHOLE,  # its steps,
    "share": NUMBERS,  # and its share of a cell, -1 without
    "u": NUMBERS,  # (T, S)
    "slopes": NUMBERS,  # (T, S)
    "y": NUMBERS,  # (T + 1, K), the last NaN
    "t": NUMBERS,  # (T + 1,), the last infinity
    "which": WHOLE,  # of the shifted channels
    "table": VECTORS,  # scratch: nodes
    "ladder": VECTORS,  # scratch of shifts: their ladder, ...
    "rows": NUMBERS,  # ... and their cells
    "out": VECTORS,  # (G, K, n) sums or (G, T + 1, K) signals
}

OWN_NUMBERS = 3  # before the constant inputs


@dataclass(frozen=True, slots=True)
class Shape:
    """What a kernel is specialised for.

    `pattern (K, R)`: entries of the rows that may differ from zero; `tally`: None for signals;
    `shifted (K,)`: channels whose times are; `even`: all steps are equal.
    """

    layout: Layout
    pattern: Pattern
    tally: Tally | None
    shifted: tuple[bool, ...]
    even: bool

    @property
    def text(self) -> str:
        """See `Structure`."""
        return f"{self.pattern} {self.tally} {self.shifted} {self.even} {self.layout.text}"

    @property
    def late(self) -> bool:
        return any(self.shifted)

    @property
    def weights(self) -> int:
        """Of each channel."""
        return self.tally.weights if self.tally is not None else 0

    @property
    def out_count(self) -> int:
        """Vectors of a group in `out`, where there are sums."""
        return len(self.pattern) * (self.tally.count if self.tally is not None else 1)

    @property
    def r_count(self) -> int:
        return self.layout.n_states + 1 + self.layout.n_series

    @property
    def own(self) -> dict[str, int]:
        """Parts of the block `own`, and how many vectors each has."""
        k, x = len(self.pattern), self.layout.n_states
        found = {"parameters": self.layout.n_parameters, "x0": x, "rows": k * self.r_count}
        if self.late:
            found |= {"before": x} | dict.fromkeys(("shift", "share", "offset", "head", "begin"), k)
        return found | ({"weight": k * self.weights} if self.weights else {})


@dataclass(frozen=True, slots=True)
class Arguments:
    b: Builder
    named: dict[str, ir.Value]

    def __getitem__(self, name: str) -> ir.Value:
        return self.named[name]

    def row(self, name: str, index: ir.Value, count: int) -> ir.Value:
        return self.b.past(self.named[name], index, count)

    def at(self, name: str, index: ir.Value) -> ir.Value:
        return self.b.load(self.b.gep(self.named[name], [index]))

    def number(self, index: int) -> ir.Value:
        return self.b.load(self.b.gep(self.named["numbers"], [I64(index)]))

    def drive(self, layout: Layout, knot: ir.Value) -> tuple[list[ir.Value], list[ir.Value]]:
        """The sampled inputs and, with a first-order hold, their slopes."""
        b, count = self.b, layout.n_series
        found: list[list[ir.Value]] = []
        for name in ("u", "slopes"):
            mine = self.row(name, knot, count)
            found.append([b.splat(b.load(b.gep(mine, [I64(s)]))) for s in range(count)])
        return found[0], found[1] if layout.first_order else []


@dataclass(frozen=True, slots=True)
class Channels:
    """What they see of a group of walkers, whose numbers stand in their `own` blocks, goes into the
    tally or to the signals.
    """

    a: Arguments
    shape: Shape
    group: ir.Value
    own: Mapping[str, ir.Value]

    def observe(self, knot: ir.Value, z: list[ir.Value], totals: list[ir.Value]) -> None:
        """Those that are not late, at a knot where the state with one and inputs is `z`."""
        b, shape, k_count = self.a.b, self.shape, len(self.shape.pattern)
        for k in (k for k, shifted in enumerate(shape.shifted) if not shifted):
            flat = b.add(b.mul(knot, I64(k_count)), I64(k))
            total = vector(0.0)
            for r in (r for r, used in enumerate(shape.pattern[k]) if used):
                total = b.fma(b.read(self.own["rows"], k * shape.r_count + r), z[r], total)
            if shape.tally is not None:
                y = b.splat(self.a.at("y", flat))
                seen = b.fcmp_ordered("ord", y, y)
                left = b.select(seen, b.fsub(y, total), vector(0.0))
                first = k * shape.weights
                weights = [b.read(self.own["weight"], first + n) for n in range(shape.weights)]
                _add_to(b, shape.tally, totals[k], Sample(left, seen, weights))
            else:
                b.write(total, b.gep(self._signals, [flat]), 0)

    def see(self, k: ir.Value, sample: ir.Value, due: ir.Value, value: ir.Value) -> None:
        """What k sees at a sample of each lane that is `due`; sample T is none, but has a place."""
        a, b, shape, k_count = self.a, self.a.b, self.shape, len(self.shape.pattern)
        if shape.tally is None:
            sample = b.select(due, sample, b.splat(a["knots"]))
        flat = b.add(b.mul(sample, whole_numbers(k_count)), b.splat(k))
        if shape.tally is None:
            b.scatter(value, b.bitcast(self._signals, NUMBERS), flat)
            return
        y = b.gather(a["y"], flat)
        seen = b.and_(due, b.fcmp_ordered("ord", y, y))
        left = b.select(seen, b.fsub(y, value), vector(0.0))
        place = b.past(a.row("out", self.group, shape.out_count), k, shape.tally.count)
        first = b.mul(k, I64(shape.weights))
        weights = [b.read(b.gep(self.own["weight"], [first]), n) for n in range(shape.weights)]
        _add_to(b, shape.tally, place, Sample(left, seen, weights))

    @property
    def _signals(self) -> ir.Value:
        """Where in `out` those of the group begin."""
        b = self.a.b
        size = b.mul(b.add(self.a["knots"], I64(1)), I64(len(self.shape.pattern)))
        return b.past(self.a["out"], self.group, size)


def _add_to(b: Builder, tally: Tally, place: ir.Value, sample: Sample) -> None:
    """To the tally of one channel, which stands at a place."""
    kept = b.read_row(place, tally.count)
    b.write_row(tally.added(b, kept, sample), place)


def row_blocks(shape: Shape) -> int:
    """Blocks of LANES numbers that a row with all inputs and slopes takes."""
    return -(-shape.layout.size // LANES)


MOST_LEVELS = DEEPEST


def entries_of(layout: Layout) -> list[tuple[int, int]]:
    """(row, column) of what tables keep of an exponential: rows of states, as far as they reach."""
    n, reach = layout.size, layout.reach
    return [(i, j) for i in range(layout.n_states) for j in range(n) if reach[i][j]]


@dataclass(frozen=True, slots=True)
class Slots:
    """Where state and sampled inputs are between two pieces of code."""

    b: Builder
    state: list[ir.Value]
    inputs: list[ir.Value]

    def read(self) -> tuple[Values, Values]:
        return (
            [self.b.read(slot, 0) for slot in self.state],
            [self.b.read(slot, 0) for slot in self.inputs],
        )

    def write(self, state: Values, inputs: Values) -> None:
        for value, slot in zip([*state, *inputs], [*self.state, *self.inputs], strict=True):
            self.b.write(value, slot, 0)


@dataclass(frozen=True, slots=True)
class Machine:
    """What the pieces of code for one group share."""

    b: Builder
    layout: Layout
    exponential: ir.Function
    product: ir.Function
    parameters: ir.Value
    constants: ir.Value
    rates: ir.Value
    norm: ir.Value
    over: ir.Value
    spans: ir.Value  # one vector
    e: ir.Value  # three matrices

    def exponentiate(self, spans: ir.Value, out: ir.Value) -> None:
        self.b.write(spans, self.spans, 0)
        self.b.call(self.exponential, [self.parameters, self.constants, self.spans, out])

    def keep(self, e: ir.Value, table: ir.Value) -> None:
        for place, (i, j) in enumerate(entries_of(self.layout)):
            self.b.write(self.b.read(e, i * self.layout.size + j), table, place)


def apply(
    b: Builder, layout: Layout, table: ir.Value, state: Values, inputs: Values, slopes: Values
) -> Values:
    """A kept exponential to a state."""
    phi = {where: b.read(table, place) for place, where in enumerate(entries_of(layout))}
    return next_state(b, layout.n_states, phi, state, [*inputs, *slopes])


@dataclass(frozen=True, slots=True)
class Ladder:
    """Exponentials over spans that are halved or doubled from level to level, and these `spans`."""

    b: Builder
    layout: Layout
    table: ir.Value
    spans: ir.Value

    def _at(self, level: ir.Value) -> ir.Value:
        return self.b.past(self.table, level, len(entries_of(self.layout)))

    def fill(self, m: Machine, level: ir.Value, span: ir.Value) -> None:
        self.b.write(span, self.b.gep(self.spans, [level]), 0)
        m.exponentiate(span, m.e)
        m.keep(m.e, self._at(level))

    def fill_cell(self, m: Machine, cell: Cell, width: ir.Value) -> None:
        """Over `width` / 2, / 4, ...; over 0 where a lane needs none."""
        b, half = self.b, ir.Constant(F64, 0.5)
        with b.if_then(b.icmp_signed(">", cell.depth, I64(0))):
            levels = Loop(b, cell.depth, [half], "levels")
            number = b.splat(b.add(levels.index, I64(1)))
            wanted = b.icmp_signed(">=", cell.halvings, number)
            span = b.select(wanted, b.splat(b.fmul(width, levels.carried[0])), vector(0.0))
            self.fill(m, levels.index, span)
            levels.close([b.fmul(levels.carried[0], half)])

    def climb(
        self, level: ir.Value, place: Slots, slopes: Values, mask: ir.Value | None = None
    ) -> None:
        """By one level, in all lanes or in those of a `mask`."""
        b, table = self.b, self._at(level)
        span = b.load(b.gep(self.spans, [level]), align=8)
        state, inputs = place.read()
        new = apply(b, self.layout, table, state, inputs, slopes)
        after = later(b, inputs, slopes, span)
        if mask is not None:
            new = [b.select(mask, one, old) for one, old in zip(new, state, strict=True)]
            after = [b.select(mask, one, old) for one, old in zip(after, inputs, strict=True)]
        place.write(new, after)


def emit_nodes(m: Machine, a: Arguments, cell: Cell, width: ir.Value) -> None:
    """The table: a chained node is the one before and a cell, others have exponentials of their own."""
    b, n = m.b, m.layout.size
    e, hop, spare = (b.gep(m.e, [I64(k * n * n)]) for k in range(3))
    with b.if_then(b.fcmp_ordered(">", width, ir.Constant(F64, 0.0))):
        m.exponentiate(b.splat(width), hop)
    each = Loop(b, a["nodes"], [], "nodes")
    linked = b.icmp_signed("!=", a.at("chained", each.index), I64(0))
    with b.if_else(linked) as (then, otherwise):
        with then:
            b.call(m.product, [spare, e, hop])
            for i in range(n):
                for j in (j for j in range(n) if m.layout.reach[i][j]):
                    b.write(b.read(spare, i * n + j), e, i * n + j)
        with otherwise:
            middle = b.fmul(cell.half, b.splat(width))
            inside = b.splat(a.at("inside", each.index))
            span = b.fma(inside, middle, b.splat(a.at("spans", each.index)))
            m.exponentiate(span, e)
    m.keep(e, a.row("table", each.index, len(entries_of(m.layout))))
    each.close([])


def emit_rest(
    m: Machine, cell: Cell, ladder: Ladder, share: ir.Value, place: Slots, slopes: Values
) -> None:
    """Goes on by `share` (a number, 0 to 1) of a cell, from `place` to `place`: by a series of what is
    left below the halvings of each lane, and by these.
    """
    b, layout, x = m.b, m.layout, m.layout.n_states
    state, inputs = place.read()
    fine = b.fmul(b.splat(share), cell.power)
    left = b.fsub(fine, b.floor(fine))
    scaled = b.fmul(b.fsub(left, cell.half), cell.unit)

    def add(k: ir.Value, term: Values, carried: Values) -> Values:
        share_k = b.load(b.gep(cell.weights, [k]), align=8)
        weight = b.fmul(carried[0], b.fmul(scaled, share_k))
        totals = [b.fma(weight, one, to) for one, to in zip(term, carried[1:], strict=True)]
        return [weight, *totals]

    start = [vector(1.0), *state]
    values = (state, inputs, slopes)
    done = emit_terms(b, layout, m.rates, values, m.over, cell.count, start, add)
    span = b.fmul(scaled, m.over)
    place.write(done[1 : x + 1], later(b, inputs, slopes, span))
    with b.if_then(b.icmp_signed(">", cell.depth, I64(0))):
        levels = Loop(b, cell.depth, [], "descent")
        power = b.shl(I64(1), b.add(levels.index, I64(1)))
        number = b.fptosi(b.fmul(share, b.sitofp(power, F64)), I64)
        with b.if_then(b.icmp_signed("!=", b.and_(number, I64(1)), I64(0))):
            ladder.climb(levels.index, place, slopes)
        levels.close([])


def later(b: Builder, inputs: Values, slopes: Values, span: ir.Value) -> Values:
    """Inputs with slopes, a span later; held ones as they are."""
    if not slopes:
        return inputs
    return [b.fma(slope, span, u) for u, slope in zip(inputs, slopes, strict=True)]
