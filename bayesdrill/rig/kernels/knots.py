"""Advance states over steps between knots that are not all equal, and observe channels at knots.

A step is a node, whose exponential is in a table, and a remainder within a cell: halvings of the
cell where that is long for a lane (`ExponentialLadder`), and then a Taylor series of few terms.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from llvmlite import ir

from bayesdrill.rig.kernels.exponential import (
    MAX_SPAN_HALVINGS,
    Cell,
    Layout,
    Pattern,
    Values,
    emit_terms,
)
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
from bayesdrill.rig.kernels.sums import ResidualSums, Sample

WHOLE = I64.as_pointer()

# T knots; `high`: rungs of the ladder that lead beyond the cells, of which there are `cells`, 0 where
# no sample wants it.
COUNTS = ("groups", "knots", "nodes", "runs", "cells", "high")
BLOCKS = {
    "own": VECTORS,  # (G, vectors of `walker_blocks` of the shape): what walkers have of their own
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

LEADING_NUMBERS = 3  # before the constant inputs


@dataclass(frozen=True, slots=True)
class IrregularShape:
    """The structure of an irregular record, for which a kernel is specialised.

    `pattern (K, R)`: entries of the rows that may differ from zero; `tally`: None for signals;
    `shifted (K,)`: channels whose times are; `even`: all steps are equal.
    """

    layout: Layout
    pattern: Pattern
    tally: ResidualSums | None
    shifted: tuple[bool, ...]
    even: bool

    @property
    def text(self) -> str:
        """See `Structure`."""
        return f"{self.pattern} {self.tally} {self.shifted} {self.even} {self.layout.text}"

    @property
    def late(self) -> bool:
        """Whether any channel is shifted."""
        return any(self.shifted)

    @property
    def weights(self) -> int:
        """Weights of each channel in the sums."""
        return self.tally.weights if self.tally is not None else 0

    @property
    def out_count(self) -> int:
        """Vectors of a group in `out`, where there are sums."""
        return len(self.pattern) * (self.tally.count if self.tally is not None else 1)

    @property
    def r_count(self) -> int:
        """Entries R of a channel's row: states, one, sampled inputs."""
        return self.layout.n_states + 1 + self.layout.n_series

    @property
    def walker_blocks(self) -> dict[str, int]:
        """Parts of the block `own`, and how many vectors each has."""
        k, x = len(self.pattern), self.layout.n_states
        blocks = {"parameters": self.layout.n_parameters, "x0": x, "rows": k * self.r_count}
        if self.late:
            blocks |= {"before": x} | dict.fromkeys(
                ("shift", "share", "offset", "head", "begin"), k
            )
        return blocks | ({"weight": k * self.weights} if self.weights else {})


@dataclass(frozen=True, slots=True)
class Arguments:
    """The arguments of a kernel by name."""

    b: Builder
    named: dict[str, ir.Value]

    def __getitem__(self, name: str) -> ir.Value:
        return self.named[name]

    def row(self, name: str, index: ir.Value, count: int) -> ir.Value:
        """Return the address of row `index` of a block, whose rows have `count` entries."""
        return self.b.offset(self.named[name], index, count)

    def at(self, name: str, index: ir.Value) -> ir.Value:
        """Load entry `index` of a block."""
        return self.b.load(self.b.gep(self.named[name], [index]))

    def number(self, index: int) -> ir.Value:
        """Load entry `index` of the block `numbers`."""
        return self.b.load(self.b.gep(self.named["numbers"], [I64(index)]))

    def drive(self, layout: Layout, knot: ir.Value) -> tuple[list[ir.Value], list[ir.Value]]:
        """Return the sampled inputs at a knot and, with a first-order hold, their slopes."""
        b, count = self.b, layout.n_series
        drive: list[list[ir.Value]] = []
        for name in ("u", "slopes"):
            mine = self.row(name, knot, count)
            drive.append([b.splat(b.load(b.gep(mine, [I64(s)]))) for s in range(count)])
        return drive[0], drive[1] if layout.first_order else []


@dataclass(frozen=True, slots=True)
class Channels:
    """Add what channels see of a group of walkers to the sums, or store it as signals.

    `walker`: the parts of the group's block `own`.
    """

    a: Arguments
    shape: IrregularShape
    group: ir.Value
    walker: Mapping[str, ir.Value]

    def observe(self, knot: ir.Value, z: list[ir.Value], totals: list[ir.Value]) -> None:
        """Observe the channels that are not late, at a knot; `z`: the state with one and inputs."""
        b, shape, k_count = self.a.b, self.shape, len(self.shape.pattern)
        for k in (k for k, shifted in enumerate(shape.shifted) if not shifted):
            flat = b.add(b.mul(knot, I64(k_count)), I64(k))
            total = vector(0.0)
            for r in (r for r, used in enumerate(shape.pattern[k]) if used):
                total = b.fma(b.read(self.walker["rows"], k * shape.r_count + r), z[r], total)
            if shape.tally is not None:
                y = b.splat(self.a.at("y", flat))
                observed = b.fcmp_ordered("ord", y, y)
                residual = b.select(observed, b.fsub(y, total), vector(0.0))
                first = k * shape.weights
                weights = [b.read(self.walker["weight"], first + n) for n in range(shape.weights)]
                _add_to(b, shape.tally, totals[k], Sample(residual, observed, weights))
            else:
                b.write(total, b.gep(self._signals, [flat]), 0)

    def observe_at(self, k: ir.Value, sample: ir.Value, due: ir.Value, value: ir.Value) -> None:
        """Observe channel k at a sample of each lane that is `due`.

        Sample T is none, but has a place.
        """
        a, b, shape, k_count = self.a, self.a.b, self.shape, len(self.shape.pattern)
        if shape.tally is None:
            sample = b.select(due, sample, b.splat(a["knots"]))
        flat = b.add(b.mul(sample, whole_numbers(k_count)), b.splat(k))
        if shape.tally is None:
            b.scatter_lanes(value, b.bitcast(self._signals, NUMBERS), flat)
            return
        y = b.gather(a["y"], flat)
        observed = b.and_(due, b.fcmp_ordered("ord", y, y))
        residual = b.select(observed, b.fsub(y, value), vector(0.0))
        address = b.offset(a.row("out", self.group, shape.out_count), k, shape.tally.count)
        first = b.mul(k, I64(shape.weights))
        weights = [b.read(b.gep(self.walker["weight"], [first]), n) for n in range(shape.weights)]
        _add_to(b, shape.tally, address, Sample(residual, observed, weights))

    @property
    def _signals(self) -> ir.Value:
        """The address in `out` of the signals of the group."""
        b = self.a.b
        size = b.mul(b.add(self.a["knots"], I64(1)), I64(len(self.shape.pattern)))
        return b.offset(self.a["out"], self.group, size)


def _add_to(b: Builder, tally: ResidualSums, address: ir.Value, sample: Sample) -> None:
    """Add a sample to the sums of one channel."""
    sums = b.read_row(address, tally.count)
    b.write_row(tally.add(b, sums, sample), address)


def row_blocks(shape: IrregularShape) -> int:
    """Return the blocks of LANES numbers that a row with all inputs and slopes takes."""
    return -(-shape.layout.size // LANES)


MAX_LEVELS = MAX_SPAN_HALVINGS


def table_entries(layout: Layout) -> list[tuple[int, int]]:
    """Return (row, column) of what tables keep of an exponential: rows of states, within reach."""
    n, reach = layout.size, layout.reach
    return [(i, j) for i in range(layout.n_states) for j in range(n) if reach[i][j]]


@dataclass(frozen=True, slots=True)
class Slots:
    """The addresses of state and sampled inputs between two pieces of code."""

    b: Builder
    state: list[ir.Value]
    inputs: list[ir.Value]

    def read(self) -> tuple[Values, Values]:
        """Load the state and the inputs."""
        return (
            [self.b.read(slot, 0) for slot in self.state],
            [self.b.read(slot, 0) for slot in self.inputs],
        )

    def write(self, state: Values, inputs: Values) -> None:
        """Store the state and the inputs."""
        for value, slot in zip([*state, *inputs], [*self.state, *self.inputs], strict=True):
            self.b.write(value, slot, 0)


@dataclass(frozen=True, slots=True)
class GroupMatrices:
    """The matrices of a group of walkers, and the functions that make exponentials of them."""

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
        """Store the exponential over a span of each lane at `out`."""
        self.b.write(spans, self.spans, 0)
        self.b.call(self.exponential, [self.parameters, self.constants, self.spans, out])

    def store(self, e: ir.Value, table: ir.Value) -> None:
        """Store the `table_entries` of the exponential `e` in a table."""
        for index, (i, j) in enumerate(table_entries(self.layout)):
            self.b.write(self.b.read(e, i * self.layout.size + j), table, index)


def apply_exponential(
    b: Builder, layout: Layout, table: ir.Value, state: Values, inputs: Values, slopes: Values
) -> Values:
    """Return the state after a step whose exponential is in a table."""
    phi = {entry: b.read(table, index) for index, entry in enumerate(table_entries(layout))}
    return next_state(b, layout.n_states, phi, state, [*inputs, *slopes])


@dataclass(frozen=True, slots=True)
class ExponentialLadder:
    """Exponentials over `spans` that are halved or doubled from level to level."""

    b: Builder
    layout: Layout
    table: ir.Value
    spans: ir.Value

    def _at(self, level: ir.Value) -> ir.Value:
        return self.b.offset(self.table, level, len(table_entries(self.layout)))

    def fill(self, m: GroupMatrices, level: ir.Value, span: ir.Value) -> None:
        """Store the exponential over a span as that of a level."""
        self.b.write(span, self.b.gep(self.spans, [level]), 0)
        m.exponentiate(span, m.e)
        m.store(m.e, self._at(level))

    def fill_cell(self, m: GroupMatrices, cell: Cell, width: ir.Value) -> None:
        """Fill levels with spans `width` / 2, / 4, ...; 0 where a lane needs none."""
        b, half = self.b, ir.Constant(F64, 0.5)
        with b.if_then(b.icmp_signed(">", cell.depth, I64(0))):
            levels = Loop(b, cell.depth, [half], "levels")
            number = b.splat(b.add(levels.index, I64(1)))
            wanted = b.icmp_signed(">=", cell.halvings, number)
            span = b.select(wanted, b.splat(b.fmul(width, levels.carried[0])), vector(0.0))
            self.fill(m, levels.index, span)
            levels.close([b.fmul(levels.carried[0], half)])

    def advance(
        self, level: ir.Value, slots: Slots, slopes: Values, mask: ir.Value | None = None
    ) -> None:
        """Advance state and inputs by the span of one level, in all lanes or in those of a `mask`."""
        b, table = self.b, self._at(level)
        span = b.load(b.gep(self.spans, [level]), align=8)
        state, inputs = slots.read()
        new = apply_exponential(b, self.layout, table, state, inputs, slopes)
        after = extrapolate_inputs(b, inputs, slopes, span)
        if mask is not None:
            new = [b.select(mask, moved, old) for moved, old in zip(new, state, strict=True)]
            after = [b.select(mask, moved, old) for moved, old in zip(after, inputs, strict=True)]
        slots.write(new, after)


def emit_nodes(m: GroupMatrices, a: Arguments, cell: Cell, width: ir.Value) -> None:
    """Fill the table of nodes: a chained one follows from the one before, others are exponentiated."""
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
    m.store(e, a.row("table", each.index, len(table_entries(m.layout))))
    each.close([])


def emit_remainder(
    m: GroupMatrices,
    cell: Cell,
    ladder: ExponentialLadder,
    share: ir.Value,
    slots: Slots,
    slopes: Values,
) -> None:
    """Advance state and inputs by `share` (a number, 0 to 1) of a cell.

    A series covers what is left below the halvings of each lane, the ladder these.
    """
    b, layout, x = m.b, m.layout, m.layout.n_states
    state, inputs = slots.read()
    fine = b.fmul(b.splat(share), cell.power)
    remainder = b.fsub(fine, b.floor(fine))
    scaled = b.fmul(b.fsub(remainder, cell.half), cell.unit)

    def add(k: ir.Value, term: Values, sums: Values) -> Values:
        share_k = b.load(b.gep(cell.weights, [k]), align=8)
        weight = b.fmul(sums[0], b.fmul(scaled, share_k))
        totals = [
            b.fma(weight, derivative, to) for derivative, to in zip(term, sums[1:], strict=True)
        ]
        return [weight, *totals]

    start = [vector(1.0), *state]
    values = (state, inputs, slopes)
    done = emit_terms(b, layout, m.rates, values, m.over, cell.count, start, add)
    span = b.fmul(scaled, m.over)
    slots.write(done[1 : x + 1], extrapolate_inputs(b, inputs, slopes, span))
    with b.if_then(b.icmp_signed(">", cell.depth, I64(0))):
        levels = Loop(b, cell.depth, [], "descent")
        power = b.shl(I64(1), b.add(levels.index, I64(1)))
        number = b.fptosi(b.fmul(share, b.sitofp(power, F64)), I64)
        with b.if_then(b.icmp_signed("!=", b.and_(number, I64(1)), I64(0))):
            ladder.advance(levels.index, slots, slopes)
        levels.close([])


def extrapolate_inputs(b: Builder, inputs: Values, slopes: Values, span: ir.Value) -> Values:
    """Return the inputs a span later: they follow their slopes, or are constant without any."""
    if not slopes:
        return inputs
    return [b.fma(slope, span, u) for u, slope in zip(inputs, slopes, strict=True)]
