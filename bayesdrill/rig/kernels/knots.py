"""Advance states over steps between knots that are not all equal, and observe channels at knots.

A step is a node, whose exponential is in a table, and a remainder within a cell: halvings of the
cell where that is long for a lane (`ExponentialLadder`), and then a Taylor series of few terms.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from llvmlite import ir

from bayesdrill.rig.kernels.exponential import (
    MAX_SPAN_HALVINGS,
    Cell,
    Layout,
    Pattern,
    emit_rates,
    emit_terms,
    multiply_reached,
    rate_entries,
    store_exponential,
)
from bayesdrill.rig.kernels.lanes import (
    F64,
    I64,
    LANES,
    NUMBERS,
    VECTORS,
    WHOLE,
    Builder,
    Integer,
    Loop,
    Values,
    vector,
)
from bayesdrill.rig.kernels.recurrence import next_state
from bayesdrill.rig.kernels.sums import ResidualSums, Sample

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
        """See `compile_kernel`."""
        return f"{self.pattern} {self.tally} {self.shifted} {self.even} {self.layout.text}"

    @property
    def late(self) -> bool:
        """Whether any channel is shifted."""
        return any(self.shifted)

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
            shifts = ("shift", "share", "offset", "head", "begin")
            blocks |= {"before": x} | dict.fromkeys(shifts, k)
        weights = k * self.tally.weights if self.tally is not None else 0
        return blocks | ({"weight": weights} if weights else {})

    @property
    def row_blocks(self) -> int:
        """The blocks of LANES numbers that a row with all inputs and slopes takes."""
        return -(-self.layout.size // LANES)


Arguments = dict[str, ir.Value]


def emit_driven(b: Builder, layout: Layout, a: Arguments, knot: Integer) -> tuple[Values, Values]:
    """Return the sampled inputs at a knot and, with a first-order hold, their slopes."""
    count = layout.n_series
    inputs, slopes = (
        [b.shared(row, s) for s in range(count)]
        for row in [b.offset(a[name], knot, count) for name in ("u", "slopes")]
    )
    return inputs, slopes if layout.first_order else []


@dataclass(frozen=True, slots=True)
class Channels:
    """Add what channels see of a group of walkers to the sums, or store it as signals.

    `walker`: the parts of the group's block `own`.
    """

    b: Builder
    a: Arguments
    shape: IrregularShape
    group: ir.Value
    walker: Mapping[str, ir.Value]

    def observe(self, knot: ir.Value, z: Values, totals: Values) -> None:
        """Observe the channels that are not late, at a knot; `z`: the state with one and inputs."""
        b, shape, tally, k_count = self.b, self.shape, self.shape.tally, len(self.shape.pattern)
        for k in (k for k, shifted in enumerate(shape.shifted) if not shifted):
            flat = b.add(b.mul(knot, k_count), k)
            used = [r for r, entry in enumerate(shape.pattern[k]) if entry]
            terms = ((b.read(self.walker["rows"], k * shape.r_count + r), z[r]) for r in used)
            total = b.add_products(terms)
            if tally is not None:
                y = b.shared(self.a["y"], flat)
                self._add(totals[k], k * tally.weights, b.fsub(y, total), y)
            else:
                b.write(total, self._signals, flat)

    def observe_at(self, k: Integer, sample: ir.Value, due: ir.Value, value: ir.Value) -> None:
        """Observe channel k at a sample of each lane that is `due`.

        Sample T is none, but has a place.
        """
        b, tally, k_count = self.b, self.shape.tally, len(self.shape.pattern)
        if tally is None:
            sample = b.select(due, sample, b.splat(self.a["knots"]))
        flat = b.add(b.mul(sample, k_count), b.splat(k))
        if tally is None:
            b.scatter_lanes(value, b.bitcast(self._signals, NUMBERS), flat)
            return
        y = b.gather(self.a["y"], flat)
        sums = b.offset(self.a["out"], self.group, self.shape.out_count)
        address, first = b.offset(sums, k, tally.count), b.mul(k, tally.weights)
        self._add(address, first, b.fsub(y, value), y, due)

    def _add(
        self, sums: ir.Value, first: Integer, residual: ir.Value, y: ir.Value,
        due: ir.Value | None = None,
    ) -> None:  # fmt: skip
        """Add a sample to the sums of one channel, whose weights begin with the `first`."""
        b, tally = self.b, self.shape.tally
        assert tally is not None
        weights = Values()
        if tally.weights:
            weights = b.read_row(b.offset(self.walker["weight"], first), tally.weights)
        sample = Sample.from_measured(b, residual, y, weights, due)
        b.write_row(tally.add(b, b.read_row(sums, tally.count), sample), sums)

    @property
    def _signals(self) -> ir.Value:
        """The address in `out` of the signals of the group."""
        b = self.b
        size = b.mul(b.add(self.a["knots"], 1), len(self.shape.pattern))
        return b.offset(self.a["out"], self.group, size)


MAX_LEVELS = MAX_SPAN_HALVINGS


def table_entries(layout: Layout) -> list[tuple[int, int]]:
    """Return (row, column) of what tables keep of an exponential: rows of states, within reach."""
    n, reach = layout.size, layout.reach
    return [(i, j) for i in range(layout.n_states) for j in range(n) if reach[i][j]]


class GroupMatrices:
    """The matrices of a group of walkers, and exponentials of them.

    `rates`: see `emit_rates`; `over`: one over their `norm`; `e`: room for three matrices.
    """

    def __init__(
        self, b: Builder, layout: Layout, a: Arguments, parameters: ir.Value, least: ir.Value
    ) -> None:
        self.b, self.layout, self._parameters = b, layout, parameters
        self.rates = b.room(len(rate_entries(layout)))
        self.e = b.room(3 * layout.size**2)
        self._constants = b.offset(a["numbers"], LEADING_NUMBERS)
        matrix = layout.matrix(b, parameters, self._constants)
        self.norm = emit_rates(b, layout, matrix, least, self.rates)
        self.over = b.fdiv(vector(1.0), self.norm)

    def exponentiate(self, span: ir.Value, out: ir.Value) -> None:
        """Store the exponential over a span of each lane at `out`."""
        numbers = (self._parameters, self._constants)
        store_exponential(self.b, *numbers, span, out, self.layout, increments=False)

    def store(self, e: ir.Value, table: ir.Value) -> None:
        """Store the `table_entries` of the exponential `e` in a table."""
        for index, (i, j) in enumerate(table_entries(self.layout)):
            self.b.write(self.b.read(e, i * self.layout.size + j), table, index)


def apply_exponential(
    b: Builder, layout: Layout, table: ir.Value, state: Values, inputs: Values, slopes: Values
) -> Values:
    """Return the state after a step whose exponential is in a table."""
    phi = {entry: b.read(table, index) for index, entry in enumerate(table_entries(layout))}
    return next_state(b, phi, state, [*inputs, *slopes])


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
        self.b.write(span, self.b.offset(self.spans, level), 0)
        m.exponentiate(span, m.e)
        m.store(m.e, self._at(level))

    def fill_cell(self, m: GroupMatrices, cell: Cell, width: ir.Value) -> None:
        """Fill levels with spans `width` / 2, / 4, ...; 0 where a lane needs none."""
        b, half = self.b, ir.Constant(F64, 0.5)
        with b.if_then(b.icmp_signed(">", cell.depth, 0)):
            levels = Loop(b, cell.depth, [half], "levels")
            number = b.splat(b.add(levels.index, 1))
            wanted = b.icmp_signed(">=", cell.halvings, number)
            span = b.select(wanted, b.splat(b.fmul(width, levels.carried[0])), vector(0.0))
            self.fill(m, levels.index, span)
            levels.close([b.fmul(levels.carried[0], half)])

    def advance(
        self,
        level: ir.Value,
        slots: Sequence[ir.Value],
        slopes: Values,
        mask: ir.Value | None = None,
    ) -> None:
        """Advance state and inputs by the span of one level, in all lanes or in those of a `mask`."""
        b, span, old = self.b, self.b.read(self.spans, level), self.b.read_slots(slots)
        state, inputs = old[: self.layout.n_states], old[self.layout.n_states :]
        new = apply_exponential(b, self.layout, self._at(level), state, inputs, slopes)
        new += extrapolate_inputs(b, inputs, slopes, span)
        if mask is not None:
            new = [b.select(mask, *pair) for pair in zip(new, old, strict=True)]
        b.write_slots(new, slots)


def emit_nodes(m: GroupMatrices, a: Arguments, cell: Cell, width: ir.Value) -> None:
    """Fill the table of nodes: a chained one follows from the one before, others are exponentiated."""
    b, n = m.b, m.layout.size
    e, hop, spare = (b.offset(m.e, k * n * n) for k in range(3))
    with b.if_then(b.fcmp_ordered(">", width, F64(0.0))):
        m.exponentiate(b.splat(width), hop)
    with b.loop(a["nodes"], "nodes") as node:
        linked = b.icmp_signed("!=", b.single(a["chained"], node), 0)
        with b.if_else(linked) as (then, otherwise):
            with then:
                multiply_reached(b, spare, e, hop, m.layout)
                for i in range(n):
                    for j in (j for j in range(n) if m.layout.reach[i][j]):
                        b.write(b.read(spare, i * n + j), e, i * n + j)
            with otherwise:
                middle = b.fmul(cell.half, b.splat(width))
                inside = b.shared(a["inside"], node)
                m.exponentiate(b.fma(inside, middle, b.shared(a["spans"], node)), e)
        m.store(e, b.offset(a["table"], node, len(table_entries(m.layout))))


def emit_remainder(
    m: GroupMatrices,
    cell: Cell,
    ladder: ExponentialLadder,
    share: ir.Value,
    slots: Sequence[ir.Value],
    slopes: Values,
) -> None:
    """Advance state and inputs by `share` (a number, 0 to 1) of a cell.

    A series covers what is left below the halvings of each lane, the ladder these.
    """
    b, layout, old = m.b, m.layout, m.b.read_slots(slots)
    state, inputs = old[: layout.n_states], old[layout.n_states :]
    fine = b.fmul(b.splat(share), cell.power)
    remainder = b.fsub(fine, b.floor(fine))
    scaled = b.fmul(b.fsub(remainder, cell.half), cell.unit)

    def add(k: Integer, term: Values, sums: Values) -> Values:
        weight = b.fmul(sums[0], b.fmul(scaled, b.read(cell.weights, k)))
        pairs = zip(term, sums[1:], strict=True)
        return [weight, *(b.fma(weight, derivative, to) for derivative, to in pairs)]

    start = [vector(1.0), *state]
    values = (state, inputs, slopes)
    _, *moved = emit_terms(b, layout, m.rates, values, m.over, cell.count, start, add)
    span = b.fmul(scaled, m.over)
    b.write_slots([*moved, *extrapolate_inputs(b, inputs, slopes, span)], slots)
    with b.if_then(b.icmp_signed(">", cell.depth, 0)), b.loop(cell.depth, "descent") as level:
        power = b.shl(1, b.add(level, 1))
        number = b.fptosi(b.fmul(share, b.sitofp(power, F64)), I64)
        with b.if_then(b.icmp_signed("!=", b.and_(number, I64(1)), 0)):
            ladder.advance(level, slots, slopes)


def extrapolate_inputs(b: Builder, inputs: Values, slopes: Values, span: ir.Value) -> Values:
    """Return the inputs a span later: they follow their slopes, or are constant without any."""
    if not slopes:
        return inputs
    return [b.fma(slope, span, u) for u, slope in zip(inputs, slopes, strict=True)]
