"""Kernels for times that are not uniform, and for walkers with starts and sensors of their own.

The second family beside `misfit` and `signals`: what is constant there is an argument here.  An
`IrregularShape` that is `late` also has channels whose times are shifted, see `kernels.delays`.
"""

from __future__ import annotations

from llvmlite import ir

from bayesdrill.rig.kernels.delays import Late, emit_interval
from bayesdrill.rig.kernels.exponential import (
    MAX_SERIES_DEGREE,
    Values,
    addresses,
    emit_cell,
    emit_exponential,
    emit_rates,
    rate_entries,
)
from bayesdrill.rig.kernels.knots import (
    BLOCKS,
    COUNTS,
    LEADING_NUMBERS,
    MAX_LEVELS,
    Arguments,
    Channels,
    ExponentialLadder,
    GroupMatrices,
    IrregularShape,
    Slots,
    apply_exponential,
    emit_nodes,
    emit_remainder,
    table_entries,
)
from bayesdrill.rig.kernels.lanes import I64, VEC, Loop, begin_kernel, vector
from bayesdrill.rig.kernels.recurrence import next_state


def write_dense(module: ir.Module, shape: IrregularShape) -> None:
    """Write the kernel `dense`, of COUNTS and addresses of BLOCKS."""
    exponential = emit_exponential(module, shape.layout, increments=False)
    interval = emit_interval(module, shape) if shape.late else None
    arguments, b = begin_kernel(module, "dense", COUNTS, BLOCKS)
    w = _Writer(shape, Arguments(b, arguments), exponential, interval)
    groups = Loop(w.b, w.a["groups"], [], "groups")
    w.write(groups.index)
    groups.close([])
    w.b.ret_void()


class _Writer:
    """Writes the code for a group of walkers."""

    def __init__(
        self,
        shape: IrregularShape,
        a: Arguments,
        exponential: ir.Function,
        interval: ir.Function | None,
    ) -> None:
        self.b, self.a, self.shape, self.layout = a.b, a, shape, shape.layout
        b, layout = a.b, shape.layout
        self.exponential = exponential
        self.rates = b.alloca(VEC, I64(len(rate_entries(layout))))
        self.span = b.alloca(VEC)
        self.e = b.alloca(VEC, I64(3 * layout.size**2 + 1))
        self.weights = b.alloca(VEC, I64(MAX_SERIES_DEGREE + 1))
        table = b.alloca(VEC, I64(MAX_LEVELS * len(table_entries(layout))))
        self.ladder = ExponentialLadder(b, layout, table, b.alloca(VEC, I64(MAX_LEVELS)))
        state = [b.alloca(VEC) for _ in range(layout.n_states)]
        self.place = Slots(b, state, [b.alloca(VEC) for _ in range(layout.n_series)])
        self.end = [b.alloca(VEC) for _ in range(layout.n_states)]  # the state at the last knot
        # Sums stay in registers, but those of late channels.
        count = I64(shape.tally.count) if shape.tally is not None else None
        self.totals = [b.alloca(VEC, count) for _ in shape.pattern] if count is not None else []
        self.late = Late(b, a, shape, interval) if interval is not None else None
        self.width, self.least = a.number(0), b.splat(a.number(1))

    def write(self, group: ir.Value) -> None:
        """Write all that is done for a group of walkers."""
        b, a, layout = self.b, self.a, self.layout
        self.lane_arguments = addresses(b, a["own"], group, self.shape.walker_blocks)
        self.channels = Channels(a, self.shape, group, self.lane_arguments)
        m = self._machine()
        cell = emit_cell(b, m.norm, self.width, self.weights)
        self.ladder.fill_cell(m, cell, self.width)
        emit_nodes(m, a, cell, self.width)
        x0 = b.read_row(self.lane_arguments["x0"], layout.n_states)
        self.place.write(x0, [vector(0.0)] * layout.n_series)
        begun = self.shape.tally.initial() if self.shape.tally is not None else []
        for total in self.totals:
            b.write_row(begun, total)
        if self.late is not None:
            self.late.begin(m, self.channels)
        runs = Loop(b, a["runs"], [I64(0)], "runs")
        first = runs.carried[0]
        length, share = a.at("length", runs.index), a.at("share", runs.index)
        table = a.row("table", a.at("node", runs.index), len(table_entries(layout)))
        inside = b.fcmp_ordered(">=", share, ir.Constant(share.type, 0.0))
        with b.if_else(inside) as (then, otherwise):
            with then:
                inputs, slopes = self._observed(first)
                self.place.write(self.place.read()[0], inputs)
                emit_remainder(m, cell, self.ladder, share, self.place, slopes)
                state, inputs = self.place.read()
                self.place.write(apply_exponential(b, layout, table, state, inputs, slopes), inputs)
            with otherwise:
                self._equal_steps(first, length, table)
        runs.close([b.add(first, length)])
        if self.late is not None and self.shape.even:
            with b.if_then(b.icmp_signed(">", a["high"], I64(0))):
                # Samples of shifted channels, from the state at the last knot on.
                last = b.sub(a["knots"], I64(1))
                inputs, slopes = a.drive(layout, last)
                end = [b.read(at, 0) for at in self.end]
                self.late.interval(last, [*end, *inputs], slopes)
        out = a.row("out", group, self.shape.out_count)
        for k, total in enumerate(self.totals):
            for n in range(len(begun) if not self.shape.shifted[k] else 0):
                b.write(b.read(total, n), out, k * len(begun) + n)

    def _equal_steps(self, first: ir.Value, n: ir.Value, table: ir.Value) -> None:
        """Advance n equal steps with the exponential in registers, as far as there are some."""
        b, entries = self.b, table_entries(self.layout)
        phi = {entry: b.read(table, index) for index, entry in enumerate(entries)}
        knots = Loop(b, n, [], "knots")
        inputs, slopes = self._observed(b.add(first, knots.index))
        state, before = self.place.read()
        new = next_state(b, self.layout.n_states, phi, state, [*inputs, *slopes])
        if self.shape.even:
            for value, at in zip(state, self.end, strict=True):
                b.write(value, at, 0)
        self.place.write(new, before)
        knots.close([])

    def _observed(self, knot: ir.Value) -> tuple[Values, Values]:
        """Observe a knot, and shifted channels until the next; return inputs and their slopes."""
        inputs, slopes = self.a.drive(self.layout, knot)
        state, _ = self.place.read()
        z = [*state, vector(1.0), *inputs]
        self.channels.observe(knot, z, self.totals)
        if self.late is not None:
            if self.shape.even:
                self.late.even(knot, z, slopes)
            else:
                self.late.interval(knot, [*state, *inputs], slopes)
        return inputs, slopes

    def _machine(self) -> GroupMatrices:
        b, layout, parameters = self.b, self.layout, self.lane_arguments["parameters"]
        constants = b.gep(self.a["numbers"], [I64(LEADING_NUMBERS)])
        matrix = layout.matrix(b, parameters, constants)
        norm = emit_rates(b, layout, matrix, self.least, self.rates)
        over = b.fdiv(vector(1.0), norm)
        return GroupMatrices(
            b, layout, self.exponential, b.module.globals["product"], parameters, constants,
            self.rates, norm, over, self.span, self.e,
        )  # fmt: skip
