"""Step by step through a record: states in registers, and what channels make of them at samples.

Of channels with times of their own values and rates are kept at all nodes, and read between them.
Between two nodes a channel is the cubic that has its values and its rates at both: the rate after
the first, with the efforts of this step, and the one before the second.
"""

from __future__ import annotations

from collections.abc import Sequence

from llvmlite import ir

from bayesdrill.basics.duals import Dual, dual, where
from bayesdrill.rig.kernels.exponential import addresses, emit_exponential, number
from bayesdrill.rig.kernels.friction import Going, Moment, Past, Regime, Rub, Step
from bayesdrill.rig.kernels.lanes import (
    F64,
    I64,
    INT_VEC,
    VEC,
    Builder,
    Lane,
    Loop,
    Mask,
    begin_kernel,
    vector,
    whole_numbers,
)
from bayesdrill.rig.kernels.numbers import Kind, Number, fused, total
from bayesdrill.rig.kernels.reversals import Parts, Stride, step_on
from bayesdrill.rig.kernels.step_arguments import BLOCKS, COUNTS, Rates, Shape
from bayesdrill.rig.kernels.sums import Sample


class Writer:
    """Where a group has its numbers, and the parts of the code."""

    def __init__(
        self,
        b: Builder,
        shape: Shape,
        arguments: dict[str, ir.Value],
        exponentials: tuple[ir.Value, ...],
    ) -> None:
        """`exponentials`: rooms for that of a step, of a part of one, and of a stride if it has them."""
        self.b, self.shape, self.a = b, shape, arguments
        self.whole, self.part_of_it, *self.stride_of_it = exponentials
        self.kind, self.spans = Kind(b, shape.dual), b.alloca(VEC)
        self.x_count, self.k_count = len(shape.model.states), len(shape.pattern)
        columns = self.x_count + 1 + len(shape.columns)
        size = Regime.size(self.x_count, columns, len(shape.frictions))
        self.room, *self.stride_room = (b.alloca(VEC, I64(size)) for _ in range(1 + shape.strides))

    # Numbers: a Lane, or a Dual of two.

    def number(self, base: ir.Value, index: int, apart: int) -> Number:
        """At a place of a part of `own`, whose slopes are `apart` vectors behind."""
        value = Lane(self.b, self.b.read(base, index))
        if not self.shape.dual:
            return value
        return Dual(value, Lane(self.b, self.b.read(base, apart + index)))

    def part(self, name: str) -> list[Number]:
        count = self.shape.own[name]
        return [self.number(self.own[name], k, count) for k in range(count)]

    def begin(self, group: ir.Value, exponential: ir.Function) -> None:
        b, shape = self.b, self.shape
        self.group, self.own = group, addresses(b, self.a["own"], group, shape.own_vectors)
        model = shape.model
        self.parameters = dict(zip(model.parameters, self.part("parameters"), strict=True))
        self.constant = {
            name: number(b, self.a["numbers"], 2 + c) for c, name in enumerate(shape.constant)
        }
        self.span = number(b, self.a["numbers"], 0)
        self._exponential(exponential, self.span, self.whole)
        if shape.turns > 1:
            self._exponential(exponential, self.span * (1.0 / shape.turns), self.part_of_it)
        self.rows = self._rows()
        self.step = self._step(self.whole, self.span)
        self.regime = self._regime(self.step, self.room)
        self.stride = self._stride(exponential)

    def _stride(self, exponential: ir.Function) -> Stride | None:
        """From sample to sample, where that is more than a step and may be one."""
        if not self.shape.strides:
            return None
        span = number(self.b, self.a["numbers"], 1)
        (matrix,), (room,) = self.stride_of_it, self.stride_room
        self._exponential(exponential, span, matrix)
        step = self._step(matrix, span)
        return Stride(step, self._regime(step, room))

    def turn(self, state: list[Number]) -> None:
        """Where something turns, the regime of a step and that of a stride are others."""
        for one in (self.regime, *([] if self.stride is None else [self.stride.regime])):
            one.set(state)

    def _exponential(self, function: ir.Function, span: Lane, room: ir.Value) -> None:
        self.b.write(span.value, self.spans, 0)
        constants = self.b.gep(self.a["numbers"], [I64(2)])
        self.b.call(function, [self.own["parameters"], constants, self.spans, room])

    def _rows(self) -> list[dict[int, Number]]:
        count, rows = self.shape.r_count, self.part("rows")
        return [
            {r: rows[k * count + r] for r, used in enumerate(pattern) if used}
            for k, pattern in enumerate(self.shape.pattern)
        ]

    def _entry(self, e: ir.Value, row: int, column: int) -> Number | None:
        """Of Phi and what follows it; columns count states, one, and what drives."""
        layout, x = self.shape.layout, self.x_count
        n, reach = layout.size, layout.reach
        place = column if column < x or not self.shape.dual else column + x
        value = Lane(self.b, self.b.read(e, row * n + place)) if reach[row][place] else None
        if not self.shape.dual:
            return value
        slope = None
        if reach[x + row][place]:
            slope = Lane(self.b, self.b.read(e, (x + row) * n + place))
        if value is None and slope is None:
            return None
        zero = Lane(self.b, vector(0.0))
        return Dual(zero if value is None else value, 0.0 if slope is None else slope)

    def _step(self, e: ir.Value, span: Lane) -> Step:
        shape, x, s = self.shape, self.x_count, len(self.shape.series)
        first = x + 1 + len(shape.columns)
        rubs, rates = [], Rates(self.b, shape, self.parameters, self.constant)
        for f, friction in enumerate(shape.frictions):
            row = shape.model.states.index(friction.against)
            column = {i: self._entry(e, i, first + f) for i in range(x)}
            kept = {i: value for i, value in column.items() if value is not None}
            acts = -rates.rows[row][first + f]  # a unit of it, on the rate
            steady = friction.law.steady
            known = friction.law.size(self.parameters, 0.0, {}) if steady else None
            rub = Rub(
                row=row,
                holds=None if friction.holds is None else shape.model.states.index(friction.holds),
                column=kept,
                over=-1.0 / kept[row],
                pull={k: entry / acts for k, entry in rates.rows[row].items() if k < first},
                pull_base=rates.base[row] / acts,
                law=friction.law,
                steady=known,
            )
            rubs.append(rub)
        columns = [k for k in range(first) if k != x]
        phi = [{k: self._entry(e, i, k) for k in columns} for i in range(x)]
        return Step(
            phi=[{k: value for k, value in row.items() if value is not None} for row in phi],
            base={i: base for i in range(x) if (base := self._entry(e, i, x)) is not None},
            rubs=rubs,
            parameters=self.parameters,
            states=shape.model.states,
            span=span,
            slopes={x + 1 + k: x + 1 + s + k for k in range(s)} if shape.first_order else {},
            first=first,
            kind=self.kind,
        )

    def _regime(self, step: Step, room: ir.Value) -> Regime:
        shape = self.shape
        return Regime(
            kind=self.kind,
            rows=step.rows(),
            rubs=step.rubs,
            first=step.first,
            shows=shape.read or shape.efforts,
            block=room,
        )

    def drive(self, node: ir.Value) -> tuple[dict[int, Number], dict[str, Number]]:
        """What a step from a node on is driven by: by column, and by name in its middle."""
        shape, first = self.shape, self.x_count + 1
        found = [self._input(node, k) for k in range(len(shape.columns))]
        middle: dict[str, Number] = dict.fromkeys(shape.model.inputs, 0.0) | self.constant
        for k, name in enumerate(shape.series):
            number = found[k] + middle.get(name, 0.0)
            if shape.first_order:
                number = number + found[len(shape.series) + k] * (self.span * 0.5)
            middle[name] = number
        return {first + k: number for k, number in enumerate(found)}, middle

    def _input(self, node: ir.Value, k: int) -> Number:
        """A late one is between two rows of the block, each lane at its own."""
        b, shape, count = self.b, self.shape, len(self.shape.columns)
        name = shape.series[k % len(shape.series)]
        if name not in shape.late:
            place = b.add(b.mul(node, I64(count)), I64(k))
            return Lane(b, b.splat(b.load(b.gep(self.a["u"], [place]))))
        late = shape.late.index(name)
        share = self.number(self.own["share"], late, len(shape.late))
        behind = b.fptosi(b.read(self.own["behind"], late), INT_VEC)
        row = b.sub(b.splat(node), behind)
        here, earlier = (
            Lane(
                b,
                b.gather(
                    self.a["u"], b.add(b.mul(row, whole_numbers(count)), whole_numbers(k - back))
                ),
            )
            for back in (0, count)
        )
        return here + (earlier - here) * share

    def start(self) -> list[ir.Value]:
        """What is carried from step to step: the state and, as far as it changes, the past."""
        state, step = self.part("x0"), self.step
        if not step.rubs:
            return self.kind.flat(state)
        self.turn(state)
        every = step.sizes(state, self.drive(I64(0))[1])
        sizes = [every[e] for e in step.varying]
        return self._carried(state, Past(sizes, [self.kind.zero() for _ in sizes]))

    def _carried(self, state: list[Number], past: Past) -> list[ir.Value]:
        return self.kind.flat([*state, *past.sizes, *past.trends])

    def once(
        self, node: ir.Value, carried: Sequence[ir.Value]
    ) -> tuple[list[Number], list[Number], list[ir.Value]]:
        """A step: the new state, the efforts (where they are shown), and what is carried on."""
        step, (state, past) = self.step, self._shaped(carried)
        drive, inputs = self.drive(node)
        if not step.rubs:
            new = step.free(state, drive)
            return new, [], self.kind.flat(new)
        going, parts = Going(step, self.regime), Parts(self.shape.turns, self._part)
        now = Moment(state, past, drive, inputs)
        new, efforts, past = step_on(going, parts, now, self.turn)
        return new, efforts, self._carried(new, past)

    def _shaped(self, carried: Sequence[ir.Value]) -> tuple[list[Number], Past]:
        numbers, x, v = self.kind.shaped(carried), self.x_count, len(self.step.varying)
        return numbers[:x], Past(numbers[x : x + v], numbers[x + v :])

    def _part(self) -> Step:
        """Of a step in which something turns."""
        count = self.shape.turns
        if count == 1:
            return self.step
        return self._step(self.part_of_it, self.span * (1.0 / count))

    def march(self) -> None:
        """From sample to sample; channels see the states there."""
        b, shape = self.b, self.shape
        sums = shape.tally.begun(self.k_count) if shape.tally is not None else []
        start = self.start()
        samples = Loop(b, self.a["samples"], [I64(0), *start, *sums], "samples")
        node, rest = samples.carried[0], samples.carried[1:]
        carried, totals = rest[: len(start)], rest[len(start) :]
        state = self.kind.shaped(carried)[: self.x_count]
        if shape.single:
            _, efforts, last = self.once(node, carried)
            totals = self.observe(samples.index, state, efforts, totals)
            samples.close([b.add(node, I64(1)), *last, *totals])
        else:
            totals = self.observe(samples.index, state, [], totals)
            count = b.load(b.gep(self.a["pieces"], [samples.index]))
            last = self._onward(samples.index, node, count, carried)
            samples.close([b.add(node, count), *last, *totals])
        self.keep(totals)

    def _onward(
        self, sample: ir.Value, node: ir.Value, count: ir.Value, carried: list[ir.Value]
    ) -> list[ir.Value]:
        """To the next sample."""
        b = self.b

        def steps() -> list[Number]:
            pieces = Loop(b, count, carried, "pieces")
            _, _, last = self.once(b.add(node, pieces.index), pieces.carried)
            pieces.close(last)
            return self.kind.shaped(last)

        if self.stride is None:
            return self.kind.flat(steps())
        wanted = b.icmp_signed("!=", b.load(b.gep(self.a["usual"], [sample])), I64(0))
        now = Moment(*self._shaped(carried), *self.drive(node))
        return self.kind.flat(self.stride.or_else(wanted, now, steps))

    def keep(self, totals: Sequence[ir.Value]) -> None:
        place = self.b.gep(self.a["out"], [self.b.mul(self.group, I64(len(totals)))])
        self.b.write_row(totals, place)

    def seen(self, k: int, state: Sequence[Number], efforts: Sequence[Number]) -> Number:
        """What channel k makes of it."""
        values = dict(enumerate([*state, None, *efforts]))
        terms = [(row, values[r]) for r, row in self.rows[k].items() if r != self.x_count]
        start = self.rows[k].get(self.x_count)
        found = total(start, terms)
        return Lane(self.b, vector(0.0)) if found is None else found

    def observe(
        self,
        sample: ir.Value,
        state: Sequence[Number],
        efforts: Sequence[Number],
        totals: Sequence[ir.Value],
    ) -> list[ir.Value]:
        """New sums, or none where there are signals."""
        if self.shape.tally is None:
            for k in range(self.k_count):
                self.show(sample, k, self.seen(k, state, efforts))
            return []
        found = []
        for k, row in enumerate(self.rows):
            left = self.measured(sample, k)
            for r, weight in row.items():
                value = Lane(self.b, vector(1.0)) if r == self.x_count else state[r]
                left = fused(-weight, value, left)
            found += self.summed(sample, k, left, totals)
        return found

    def measured(self, sample: ir.Value, k: int) -> Lane:
        flat = self.b.add(self.b.mul(sample, I64(self.k_count)), I64(k))
        return Lane(self.b, self.b.splat(self.b.load(self.b.gep(self.a["y"], [flat]))))

    def summed(
        self, sample: ir.Value, k: int, left: Lane, totals: Sequence[ir.Value]
    ) -> list[ir.Value]:
        """The tally of channel k, among `totals`, with what is left of a sample, if that was seen."""
        b, value, seen, tally = self.b, left.value, None, self.shape.tally
        assert tally is not None
        if self.shape.gaps:
            y = self.measured(sample, k).value
            seen = b.fcmp_ordered("ord", y, y)
            value = b.select(seen, value, vector(0.0))
        first, count = k * tally.weights, tally.count
        weights = [b.read(self.own["weight"], first + n) for n in range(tally.weights)]
        sample = Sample(value, seen, weights)
        return tally.added(b, totals[k * count : (k + 1) * count], sample)

    def show(self, sample: ir.Value, k: int, value: Number) -> None:
        """To the signals."""
        b, k_count = self.b, self.k_count
        flat = b.add(b.mul(sample, I64(k_count)), I64(k))
        row = b.mul(b.mul(self.group, self.a["samples"]), I64(k_count))
        place = b.mul(b.add(row, flat), I64(self.shape.numbers))
        b.write_row(self.kind.flat([value]), b.gep(self.a["out"], [place]))


KEPT = 3  # the value, and the rates after it and before the next one, times a step


def emit_trace(w: Writer) -> None:
    """Of all nodes; the last has a value alone."""
    b = w.b
    rates = Rates(b, w.shape, w.parameters, w.constant)
    nodes = Loop(b, w.a["nodes"], w.start(), "nodes")
    state = w.kind.shaped(nodes.carried)[: w.x_count]
    drive, _ = w.drive(nodes.index)
    new, efforts, last = w.once(nodes.index, nodes.carried)
    after = rates.of(state, drive, efforts)
    before = rates.of(new, drive, efforts, later=w.span)
    for k in range(w.k_count):
        kept = [w.seen(k, state, []), *(_seen_rate(w, k, rate) for rate in (after, before))]
        _keep(w, nodes.index, k, kept)
    nodes.close(last)
    zero: Number = Lane(b, vector(0.0))
    for k in range(w.k_count):
        _keep(w, w.a["nodes"], k, [w.seen(k, new, []), zero, zero])


def _keep(w: Writer, node: ir.Value, k: int, kept: Sequence[Number]) -> None:
    b, numbers = w.b, w.shape.numbers
    place = b.mul(b.add(b.mul(node, I64(w.k_count)), I64(k)), I64(KEPT * numbers))
    at = b.gep(w.a["trace"], [place])
    for q, value in enumerate(kept):
        for n, register in enumerate(w.kind.flat([value])):
            b.write(register, at, q * numbers + n)


def _seen_rate(w: Writer, k: int, rates: Sequence[Number]) -> Number:
    """How much channel k changes in a step."""
    terms = [(row, rates[r]) for r, row in w.rows[k].items() if r < w.x_count]
    zero = Lane(w.b, vector(0.0))
    return total(zero, terms) * w.span


def emit_reading(w: Writer) -> None:
    """Of all samples, each lane at its own time."""
    b, shape = w.b, w.shape
    sums = shape.tally.begun(w.k_count) if shape.tally is not None else []
    shifts, begins = w.part("shift"), _before(w)
    samples = Loop(b, w.a["samples"], sums, "read")
    t = Lane(b, b.splat(b.load(b.gep(w.a["t"], [samples.index]))))
    totals: list[ir.Value] = []
    for k in range(w.k_count):
        when = t - shifts[k] / w.span
        value = _read(w, k, when, begins[k])
        if shape.tally is not None:
            left = w.measured(samples.index, k) - value
            totals += w.summed(samples.index, k, left, samples.carried)
        else:
            w.show(samples.index, k, value)
    samples.close(totals)
    w.keep(totals)


def _before(w: Writer) -> list[Number]:
    """How much channels change in a step before the start."""
    return [_seen_rate(w, k, w.part("before")) for k in range(w.k_count)]


def _read(w: Writer, k: int, when: Number, begin: Number) -> Number:
    b = w.b
    position = dual(when).value.value
    last = b.splat(b.sitofp(b.sub(w.a["nodes"], I64(1)), F64))
    node = b.floor(position)
    node = b.select(b.fcmp_ordered("<", node, last), node, last)
    node = b.select(b.fcmp_ordered(">", node, vector(0.0)), node, vector(0.0))
    share = when - Lane(b, node)
    value, after, before = (_kept(w, node, k, q) for q in range(KEPT))
    rise = _kept(w, b.fadd(node, vector(1.0)), k, 0) - value
    bend = rise * 3.0 - after * 2.0 - before
    turn = after + before - rise * 2.0
    between = value + share * (after + share * (bend + share * turn))
    early = Mask(b, b.fcmp_ordered("<", position, vector(0.0)))
    return where(early, value + share * begin, between)


def _kept(w: Writer, node: ir.Value, k: int, q: int) -> Number:
    b, numbers = w.b, w.shape.numbers
    row = b.mul(b.fptosi(node, INT_VEC), whole_numbers(w.k_count * KEPT * numbers))
    found = [
        b.gather_own(w.a["trace"], b.add(row, whole_numbers((k * KEPT + q) * numbers + n)))
        for n in range(numbers)
    ]
    return w.kind.shaped(found)[0]


def write_stepping(module: ir.Module, shape: Shape) -> None:
    """`stepping`, of COUNTS and addresses of BLOCKS."""
    exponential = emit_exponential(module, shape.layout, increments=False)
    arguments, b = begin_kernel(module, "stepping", COUNTS, BLOCKS)
    rooms = [b.alloca(VEC, I64(shape.layout.size**2)) for _ in range(2 + shape.strides)]
    w = Writer(b, shape, arguments, tuple(rooms))
    groups = Loop(b, w.a["groups"], [], "groups")
    w.begin(groups.index, exponential)
    if shape.read:
        emit_trace(w)
        emit_reading(w)
    else:
        w.march()
    groups.close([])
    b.ret_void()
