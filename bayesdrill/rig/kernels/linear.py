"""Compute the response of linear rigs: the channels of groups of walkers, sample by sample.

With z = (x, 1, u, du/dt) a step is x(j + 1) = E(j) z(j).  E has the first rows of the matrix
exponential over the step (`transitions`).  A channel is a row times (x, 1).  If derivatives are
wanted, matrices, starts, rows and delays have slopes: derivatives in a direction of the parameters.

A late channel, with delay s, shows at time t its value at t - s.  On even times, s is a number of
whole steps minus a fraction of one, and the row is multiplied by the exponential over this fraction.
On uneven times the state at the knot before t - s is advanced by the remaining time, with a ladder
of exponentials over 2^n times a width (`transitions`).  Before the start, states change linearly.

Rigs of more than ten states multiply matrices in loops (`multiply_large`).  On even times, one
product then computes four samples (`Transitions.join_steps`).

If only sums of residuals are wanted, they are added up as channels are computed.  Otherwise the
channels are stored in planes `(rows, K)`: values, then slopes in each direction.  Planes are the
output, or are reduced to normal equations in chunks of samples that fit into the processor's cache.
One kernel has code for both, as most of its code is that of the matrices, which both need.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Sequence
from functools import partial

from llvmlite import ir

from bayesdrill.basics.duals import Dual, dual, where
from bayesdrill.rig.kernels.exponential import number
from bayesdrill.rig.kernels.lanes import (
    F64,
    INT_VEC,
    LANES,
    Builder,
    Integer,
    Loop,
    Mask,
    Module,
    Values,
    Vector,
    integer,
    kernel,
    vector,
)
from bayesdrill.rig.kernels.linear_arguments import (
    BLOCKS,
    COUNTS,
    ROWS,
    SCALES,
    SCRATCH,
    LinearShape,
)
from bayesdrill.rig.kernels.numbers import Number, Numbers, multiply_large, sum_products
from bayesdrill.rig.kernels.sums import SQUARES, Record, ResidualSums, Sample
from bayesdrill.rig.kernels.transitions import InputHold, State, Transitions

FARTHEST = 2.0**40  # largest delay in steps; larger ones have the same effect
TILE, MOST_TOTALS = 2, 24  # planes that are loaded together; largest number of sums in registers
VALUES, SLOPES, BOTH = [0], [1], [0, 1]  # parts of a number


def write_linear(module: Module, shape: LinearShape) -> None:
    """Write the kernel `linear`, whose arguments are `COUNTS` and the addresses of `BLOCKS`."""
    with kernel(module, "linear", COUNTS, BLOCKS) as (a, b), b.loop(a["groups"], "groups") as group:
        _Writer(b, a, shape, group).write()


class _Writer:
    """A writer emits the code for a group of walkers."""

    def __init__(
        self, b: Builder, a: dict[str, ir.Value], shape: LinearShape, group: ir.Value
    ) -> None:
        self.b, self.a, self.shape, self.group = b, a, shape, group
        self.layout, self.kind = shape.layout, Numbers(b, shape.slopes)
        self.x, self.k = shape.layout.n_states, shape.channels
        size = sum(shape.part_sizes.values())
        self.walker = b.offset(a["own"], group, size + shape.weights)
        self.weights = b.offset(self.walker, size)
        self.record = Record(b, a["y"], a["begin"], self.k)
        self.plane_count = b.add(a["directions"], 1)
        parts = [b.offset(a["scratch"], b.single(a["places"], n)) for n in range(len(SCRATCH))]
        self.table, self.states, self.rungs, planes, self.last_residuals, self.trace = parts
        self.table_size = b.mul(a["nodes"], shape.table_numbers * self.kind.width)
        self.stored = b.icmp_signed("!=", a["stored"], 0)
        size = b.mul(self.plane_count, b.mul(a["samples"], self.k))
        self.plane_memory, self.plane_rows = b.offset(a["out"], group, size), a["samples"]
        if shape.tally is None:
            length = a["samples"] if shape.single_chunk else integer(ROWS)
            self.plane_memory = b.select(self.stored, self.plane_memory, planes)
            self.plane_rows = b.select(self.stored, self.plane_rows, length)
            size = b.add(self.k, b.mul(self.plane_count, self.plane_count))
            self.products = b.offset(a["out"], group, size)

    def write(self) -> None:
        """Write the code for a group of walkers."""
        if self.shape.tally is None:
            self._write_planes()
            return
        walker = _Walker(self, integer(0))
        walker.prepare()
        if self.shape.tally != SQUARES:
            self._write_sums(walker, self.shape.tally)
            return
        with self.b.if_else(self.stored) as (then, otherwise):
            with then:
                walker.advance(integer(0), self.a["samples"], [])
                walker.show_late([])
            with otherwise:
                self._write_sums(walker, self.shape.tally)

    def _write_sums(self, walker: _Walker, tally: ResidualSums) -> None:
        totals = walker.advance(integer(0), self.a["samples"], tally.initial(self.k))
        totals = walker.show_late(totals)
        self.b.write_row(totals, self.b.offset(self.a["out"], self.group, len(totals)))

    def _write_planes(self) -> None:
        """Store planes, or add up their products chunk by chunk."""
        b, a, single = self.b, self.a, self.shape.single_chunk
        with b.loop(a["directions"], "directions") as direction:
            walker = _Walker(self, direction)
            walker.prepare()
            if single:
                walker.advance(integer(0), a["samples"], [])
                walker.show_late([])
        with b.if_then(b.not_(self.stored)):
            b.clear(self.products, b.add(self.k, b.mul(self.plane_count, self.plane_count)))
        chunks = integer(1)
        if not single:
            chunks = b.sdiv(b.add(a["samples"], ROWS - 1), ROWS)
            chunks = b.select(self.stored, 1, chunks)
        with b.loop(chunks, "chunks") as chunk:
            first = b.mul(chunk, ROWS)
            rows = b.minimum(b.sub(a["samples"], first), self.plane_rows)
            if self.shape.apart:
                _Walker(self, integer(0), VALUES).advance(first, rows, [])
            if not single:
                parts = SLOPES if self.shape.apart else BOTH
                with b.loop(a["directions"], "directions") as direction:
                    _Walker(self, direction, parts).advance(first, rows, [])
            with b.if_then(b.not_(self.stored)):
                self._add_products(first, rows)

    def at(self, plane: Integer, row: Integer, k: int = 0) -> ir.Value:
        """Return the address of channel k in a row of a plane."""
        b = self.b
        row = b.add(b.mul(plane, self.plane_rows), row)
        return b.offset(self.plane_memory, b.add(b.mul(row, self.k), k))

    def add_sample(self, sample: ir.Value, k: int, value: ir.Value, totals: Values) -> Values:
        """Return the sums of all channels with one more sample of channel k."""
        b, tally = self.b, self.shape.tally
        assert tally is not None
        weights = b.read_row(b.offset(self.weights, k * tally.weights), tally.weights)
        residual = self.record.residual(sample, k, value)
        return tally.add_if_observed(b, totals, Sample(self.record, sample, k, residual, weights))

    # Normal equations.

    def _add_products(self, first: ir.Value, rows: ir.Value) -> None:
        """Add up squares `(K,)` of residuals, and products of planes (a triangle `(1 + q, 1 + q)`)."""
        b, k_count = self.b, self.k
        with b.loop(self.plane_count, "whiten") as plane:
            self._whiten(plane, first, rows)

        def totals(planes: list[Integer], others: list[Integer]) -> list[Values]:
            """Return sums `(K,)` of products over samples, for each pair of `planes` and `others`."""
            pairs = [*itertools.product(range(len(planes)), range(len(others)))]
            samples = Loop(b, rows, [vector(0.0)] * len(pairs) * k_count, "products")
            left, right = (
                [b.read_row(self.at(p, samples.index), k_count) for p in members]
                for members in (planes, others)
            )
            factors = [each for p, o in pairs for each in zip(left[p], right[o], strict=True)]
            new = [
                b.fma(*each, so_far) for each, so_far in zip(factors, samples.carried, strict=True)
            ]
            samples.close(new)
            return [new[n * k_count :][:k_count] for n in range(len(pairs))]

        def add(value: ir.Value, index: Integer) -> None:
            at = b.offset(self.products, index)
            b.write(b.fadd(b.read(at, 0), value), at, 0)

        def add_tile(planes: list[Integer], others: list[Integer]) -> None:
            sums = zip(itertools.product(planes, others), totals(planes, others), strict=True)
            for (plane, other), each in sums:
                row = b.add(b.mul(plane, self.plane_count), other)
                add(functools.reduce(b.fadd, each), b.add(row, k_count))

        (squares,) = totals([0], [0])
        for k, square in enumerate(squares):
            add(square, k)
        size = TILE if TILE**2 * k_count <= MOST_TOTALS else 1

        def tile(index: ir.Value) -> list[Integer]:
            return [b.add(b.mul(index, size), n) for n in range(size)]

        tiles = b.sdiv(self.plane_count, size)
        with b.loop(tiles, "tiles") as i, b.loop(b.add(i, 1), "others") as j:
            add_tile(tile(i), tile(j))
        last = b.sub(self.plane_count, 1)
        with b.if_then(b.icmp_signed("==", b.mul(tiles, size), last)):
            with b.loop(tiles, "others") as j:
                add_tile([last], tile(j))
            add_tile([last], [last])

    def _whiten(self, plane: ir.Value, first: ir.Value, rows: ir.Value) -> None:
        """Replace channels in a plane by whitened residuals, or slopes of channels by slopes of these.

        With three weights s, the residual r_j becomes s_0 r_j - s_1 r_i, where i is the observed
        sample before j.  The first residual r of a channel becomes s_2 r.
        """
        b, k_count = self.b, self.k
        scales = b.read_row(self.weights, SCALES * k_count)
        kept = b.offset(self.last_residuals, plane, k_count)
        samples = Loop(b, rows, b.read_row(kept, k_count), "white")
        sample, carried = b.add(first, samples.index), Values()
        is_values = b.icmp_signed("==", plane, 0)
        for k, last in enumerate(samples.carried):
            at = self.at(plane, samples.index, k)
            measured = b.select(is_values, self.record.measured(sample, k), F64(0.0))
            residual = b.fsub(b.splat(measured), b.read(at, 0))
            white = partial(self._white, sample, k, scales[k::k_count], residual, last)
            new, residual = self.record.if_observed(sample, k, [vector(0.0), last], white)
            b.write(new, at, 0)
            carried.append(residual)
        samples.close(carried)
        b.write_row(carried, kept)

    def _white(
        self, sample: ir.Value, k: int, scales: Values, residual: ir.Value, last: ir.Value
    ) -> Values:
        """Return the whitened residual, and the residual, which is `last` for the next sample."""
        b = self.b
        later = b.fsub(b.fmul(residual, scales[0]), b.fmul(last, scales[1]))
        white = self.record.unless_first(sample, k, [later], [b.fmul(residual, scales[2])])
        return [*white, residual]


class _Walker:
    """A walker's writer has the code for the response, and for its slopes in one direction.

    If only `VALUES` are advanced, states are stored in the trace. If only `SLOPES` are advanced,
    states are read from the trace.
    """

    def __init__(self, w: _Writer, direction: Integer, parts: Sequence[int] = BOTH) -> None:
        b, shape = w.b, w.shape
        self.parts = [part for part in parts if part < w.kind.width]
        self.w, self.b, self.shape, self.kind = w, b, shape, w.kind
        self.direction, self.x = direction, w.x
        bases = [w.walker]
        if shape.slopes:
            row = b.add(b.mul(w.group, w.a["directions"]), direction)
            bases.append(b.offset(w.a["along"], row, shape.with_slopes))
        self.bases = tuple(bases)
        copy = integer(0) if shape.single_chunk else direction
        self.transitions = Transitions(
            b=b, layout=w.layout, kind=w.kind, parameters=self.bases,
            constants=b.offset(w.a["numbers"], 1), table=b.offset(w.table, copy, w.table_size),
            rungs=w.rungs, width=number(b, w.a["numbers"], 0),
        )  # fmt: skip
        self.joined = b.offset(self.transitions.table, self.transitions.size)
        self.state = b.offset(w.states, direction, self.x * self.kind.width)
        self.late = [k for k, late in enumerate(shape.is_delayed) if late]
        self.rows = self._rows()

    def numbers(self, name: str) -> list[Number]:
        """Load the numbers of a part, see `LinearShape.part_sizes`."""
        sizes = self.shape.part_sizes
        first = sum([*sizes.values()][: [*sizes].index(name)])
        values, *slopes = [
            [Vector(self.b, value) for value in self.b.read_row(at, sizes[name])]
            for at in (self.b.offset(base, first) for base in self._bases_of(first))
        ]
        return [*map(Dual, values, *slopes)] if slopes else values

    def _bases_of(self, first: int) -> tuple[ir.Value, ...]:
        """Return addresses of values and, if the part from `first` on has slopes, of slopes."""
        return self.bases if first < self.shape.with_slopes else self.bases[:1]

    def _rows(self) -> list[dict[int, Number]]:
        """Return each channel's row: its weights by index of the state, and its offset at `self.x`."""
        numbers, count = self.numbers("rows"), self.x + 1
        return [
            {i: numbers[k * count + i] for i in range(count) if i == self.x or shows[i]}
            for k, shows in enumerate(self.shape.rows)
        ]

    def prepare(self) -> None:
        """Store the transition matrices, the start, and the rows of late channels."""
        b, a, shape = self.b, self.w.a, self.shape
        if shape.uneven:
            with b.if_then(b.icmp_signed(">=", a["high"], 0)):
                self.transitions.fill_ladder(a["high"])
        chained = a["chained"] if shape.uneven else None
        self.transitions.fill_table(a["nodes"], a["spans"], chained)
        start = self.numbers("start")
        self.kind.put_row(start, self.state)
        if shape.samples_per_step > 1:
            self.transitions.join_steps(self.joined, self.rows, shape.samples_per_step)
        if not self.late:
            return
        delay = self.numbers("delay")
        self.delays = {k: delay[k] for k in self.late}
        if not shape.uneven:
            span = number(b, a["spans"], 0)
            self.late_rows, self.offsets = {}, {}
            for k in self.late:
                self.offsets[k], excess = self._split(delay[k], span)
                self.late_rows[k] = self._late_row(k, excess)

    def _split(self, delay: Number, step: Vector) -> tuple[ir.Value, Number]:
        """Return a delay as a number of steps, rounded up, and the time by which the steps exceed it."""
        b = self.b
        count = -Vector(b, b.floor((dual(delay).value / (-step)).value))
        count = where(count.below(FARTHEST), count, FARTHEST)
        count = where(count.above(-FARTHEST), count, -FARTHEST)
        return b.fptosi(count.value, INT_VEC), count * step - delay

    def _late_row(self, k: int, span: Number) -> ir.Value:
        """Store the row of channel k times the exponential over a span; return its address."""
        n, layout, kind = self.w.layout.size, self.w.layout, self.kind
        e, row = kind.room(n * n), kind.room(n)
        self.transitions.exponentiate(span, e)
        for j in range(n):
            terms = [
                (weight, kind.get(e, i * n + j))
                for i, weight in self.rows[k].items()
                if layout.reachable[i][j]
            ]
            kind.put(sum_products(kind.zero(), terms), row, j)
        return row

    # Steps from knot to knot.

    def advance(self, first: ir.Value, rows: ir.Value, totals: Values) -> Values:
        """Advance the state from the `first` knot on, and `show` the channels that are not late."""
        if self.shape.samples_per_step > 1:
            return self._advance_joined(first, rows, totals)
        totals = self._advance(first, rows, totals, shows=True)
        if self.late:
            more = self.b.sub(self.w.a["knots"], rows)
            with self.b.if_then(self.b.icmp_signed(">", more, 0)):
                self._advance(rows, more, [], shows=False)
        return totals

    def _advance(self, first: ir.Value, rows: ir.Value, totals: Values, *, shows: bool) -> Values:
        b, a, kind, shape = self.b, self.w.a, self.kind, self.shape
        step = None if shape.uneven else self.transitions.step(self.transitions.table, 0)
        begin = self._advanced(kind.row(self.state, self.x))
        steps = Loop(b, rows, [*begin, *totals], "steps")
        state = self._completed(steps.carried[: len(begin)], steps.index)
        totals = steps.carried[len(begin) :]
        knot = b.add(first, steps.index)
        drive = InputHold.load(b, self.w.layout, a["u"], knot)
        for k in range(shape.channels) if shows else ():
            if not shape.is_delayed[k]:
                totals = self.show(knot, steps.index, k, self._channel_value(k, state), totals)
        if self.late:
            self._trace(knot, state, drive)
        if shape.uneven:
            state, drive = self._advance_fraction(b.single(a["share"], knot), state, drive)
        here = step or self.transitions.step(self.transitions.table, b.single(a["node"], knot))
        new = self._advanced(here(state, drive))
        steps.close([*new, *totals])
        for n, register in enumerate(new):
            b.write(register, self.state, n % self.x * kind.width + self.parts[n // self.x])
        return totals

    def _advanced(self, state: State) -> Values:
        """Return the registers of a state that are carried from step to step."""
        registers = self.kind.flat(state)
        return [x for part in self.parts for x in registers[part * self.x :][: self.x]]

    def _completed(self, registers: Values, row: ir.Value) -> State:
        """Return the state from the registers of `_advanced`; the trace keeps values for slopes."""
        if len(self.parts) < self.kind.width:
            at = self.b.offset(self.w.trace, row, self.x)
            if self.parts == VALUES:
                self.b.write_row(registers, at)
                registers = [*registers, *[vector(0.0)] * self.x]  # slopes that nothing needs
            else:
                registers = [*self.b.read_row(at, self.x), *registers]
        return self.kind.shaped(registers)

    def _advance_joined(self, first: ir.Value, rows: ir.Value, totals: Values) -> Values:
        """Advance from the `first` knot on by steps of several samples, and show channels."""
        b, kind, x, k_count, m = self.b, self.kind, self.x, self.w.k, self.shape.samples_per_step
        out, columns = self.shape.joined_sizes
        out -= k_count  # the channels after the last step belong to the next joined step
        z, following = kind.room(columns), kind.room(out)
        kind.put_row([*kind.row(self.state, x), Vector(b, vector(1.0))], z)
        steps = Loop(b, b.sdiv(rows, m), totals, "steps")
        totals, row = steps.carried, b.mul(steps.index, m)
        knot = b.add(first, row)
        at = b.offset(self.w.a["u"], knot, self.w.layout.size - x - 1)
        kind.put_row([number(b, at, c) for c in range(columns - x - 1)], z, x + 1)
        multiply_large(b, following, self.joined, z, (out, columns, 1), slopes=kind.slopes)
        state = kind.row(z, x)
        for j, k in itertools.product(range(m), range(k_count)):
            place = x + (j - 1) * k_count + k
            shown = kind.get(following, place) if j else self._channel_value(k, state)
            totals = self.show(b.add(knot, j), b.add(row, j), k, shown, totals)
        b.copy(following, z, x * kind.width)
        steps.close(totals)
        b.copy(z, self.state, x * kind.width)
        return totals

    def _advance_fraction(
        self, fraction: ir.Value, state: State, drive: InputHold
    ) -> tuple[State, InputHold]:
        """Advance by `fraction` times the ladder's width, or not at all if `fraction` is negative."""
        b, kind, count = self.b, self.kind, len(drive.inputs)
        default = [*kind.flat(state), *(u.value for u in drive.inputs)]

        def moved() -> Values:
            new, later = self.transitions.act(Vector(b, b.splat(fraction)), state, drive)
            return [*kind.flat(new), *(dual(u).value.value for u in later.inputs)]

        registers = b.replace_if(b.fcmp_ordered(">=", fraction, F64(0.0)), default, moved)
        inputs = [Vector(b, u) for u in registers[len(registers) - count :]]
        return kind.shaped(registers[: len(registers) - count]), InputHold(inputs, drive.slopes)

    def _channel_value(self, k: int, state: State, *, offset: bool = True) -> Number:
        """Return the value of channel k at a state, with or without its offset."""
        terms = [(weight, state[i]) for i, weight in self.rows[k].items() if i < self.x]
        return sum_products(self.rows[k][self.x] if offset else self.kind.zero(), terms)

    def show(self, sample: ir.Value, row: Integer, k: int, value: Number, totals: Values) -> Values:
        """Add a value of channel k at a sample to the sums, or store it in a row of the planes."""
        values = self.kind.flat([value])
        if totals:
            return self.w.add_sample(sample, k, values[0], totals)
        for part in self.parts:
            plane = self.b.add(self.direction, 1) if part else 0
            self.b.write(values[part], self.w.at(plane, row, k), 0)
        return totals

    # Late channels.

    def _trace(self, knot: ir.Value, state: State, drive: InputHold) -> None:
        """Store the values of late channels at even times; at uneven times, store the state."""
        kept = state
        if not self.shape.uneven:
            entries = [*state, Vector(self.b, vector(1.0)), *drive.inputs, *drive.slopes]
            kept = []
            for k in self.late:
                row = self.kind.row(self.late_rows[k], self.w.layout.size)
                kept.append(sum_products(None, [*zip(row, entries, strict=True)]))
        at = self.b.offset(self.w.trace, knot, len(kept) * self.kind.width)
        self.kind.put_row(kept, at)

    def show_late(self, totals: Values) -> Values:
        """Add the values of late channels to the sums, or store them in the planes."""
        if not self.late:
            return totals
        b, w, shape = self.b, self.w, self.shape
        start, before = self.numbers("start"), self.numbers("before")
        begins = {k: self._channel_value(k, start) for k in self.late}
        rates = {k: self._channel_value(k, before, offset=False) for k in self.late}
        first = ir.Constant(INT_VEC, [0] * LANES)
        carried = [first for _ in self.late] if shape.uneven else []
        samples = Loop(b, w.a["samples"], [*carried, *totals], "late")
        totals = samples.carried[len(carried) :]
        t, places = Vector(b, b.shared(w.a["t"], samples.index)), []
        for n, k in enumerate(self.late):
            when = t - self.delays[k]
            early = dual(when).value.below(0.0)
            straight = begins[k] + when * rates[k]
            if not shape.uneven:
                place = b.sub(b.splat(samples.index), self.offsets[k])
                last = b.splat(b.sub(w.a["knots"], 1))
                inside = b.select(b.icmp_signed("<", place, last), place, last)
                inside = b.select(b.icmp_signed(">", inside, 0), inside, 0)
                value = self._load_traced(inside, len(self.late), n)
                early = Mask(b, b.icmp_signed("<", place, 0))  # independent of the rounding of t
            else:
                place = b.last_until(w.a["t"], samples.carried[n], dual(when).value.value)
                places.append(place)
                value = self._channel_value_at(k, place, when)
            shown = where(early, straight, value)
            totals = self.show(samples.index, samples.index, k, shown, totals)
        samples.close([*places, *totals])
        return totals

    def _load_traced(self, knot: ir.Value, count: int, n: int) -> Number:
        """Load number n of the `count` numbers that `_trace` has stored at the knot of each lane."""
        width = self.kind.width
        first = self.b.mul(knot, count * width)
        places = [self.b.add(first, n * width + part) for part in range(width)]
        return self.kind.shaped([self.b.gather_lanes(self.w.trace, at) for at in places])[0]

    def _channel_value_at(self, k: int, knot: ir.Value, when: Number) -> Number:
        """Return the value of channel k at the time `when`, which is after the knot of each lane."""
        b, layout = self.b, self.w.layout
        state = [self._load_traced(knot, self.x, i) for i in range(self.x)]
        columns = layout.size - self.x - 1
        first = b.mul(knot, columns)
        inputs = [Vector(b, b.gather(self.w.a["u"], b.add(first, c))) for c in range(columns)]
        drive = InputHold(inputs[: layout.n_series], inputs[layout.n_series :])
        span = when - Vector(b, b.gather(self.w.a["t"], knot))
        early = dual(span).value.below(0.0)
        nothing = Dual(Vector(b, vector(0.0)), dual(span).slope) if self.kind.slopes else 0.0
        span = where(early, nothing, span)
        moved, _ = self.transitions.act(span / self.transitions.width, state, drive)
        return self._channel_value(k, moved)
