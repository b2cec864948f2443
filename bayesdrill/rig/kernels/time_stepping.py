"""Advance states step by step through a record, and observe channels at samples.

A step is exact while each friction keeps slipping one way or sticking. An event is a zero crossing
of a sliding speed, or the transition from stick to slip. A step with an event is divided into parts
with mean efforts (`reversals`). The event is not located in time, and leaves an error of second
order in the length of a part. Each lane of a vector is one walker (a set of parameters).

Channels with sampling times of their own are interpolated. Their values and rates are stored at all
nodes (ends of steps). Between two nodes a channel is the cubic with the values and rates at both
nodes (Hermite). The rates are evaluated with the efforts (see `friction`) of the step.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from llvmlite import ir

from bayesdrill.basics.duals import dual, where
from bayesdrill.rig.kernels.exponential import addresses, number, store_exponential
from bayesdrill.rig.kernels.friction import (
    FrictionHistory,
    FrictionMode,
    Sizes,
    Step,
    StepFriction,
    StepStart,
)
from bayesdrill.rig.kernels.lanes import (
    F64,
    INT_VEC,
    NOWHERE,
    Builder,
    Integer,
    Loop,
    Mask,
    Module,
    Vector,
    kernel,
    vector,
)
from bayesdrill.rig.kernels.numbers import Number, Numbers, sum_products
from bayesdrill.rig.kernels.reversals import ReversalStep, advance_step, advance_stride
from bayesdrill.rig.kernels.servo import ServoLoop, merged_step
from bayesdrill.rig.kernels.step_arguments import BLOCKS, COUNTS, Rates, SteppedShape
from bayesdrill.rig.kernels.sums import SQUARES, Record, ResidualSums, Sample


class Writer:
    """A writer emits the code that steps a group of walkers."""

    def __init__(
        self, b: Builder, shape: SteppedShape, arguments: dict[str, ir.Value], group: ir.Value
    ) -> None:
        """Write the code that computes the matrices of the group."""
        self.b, self.shape, self.a, self.group, model = b, shape, arguments, group, shape.model
        self.kind = Numbers(b, shape.dual)
        self.x_count, self.k_count = len(shape.model.states), len(shape.pattern)
        self.walker = addresses(b, self.a["own"], group, shape.walker_vectors)
        numbers = self.walker_numbers("parameters")
        self.parameters = dict(zip(model.parameters, numbers, strict=True))
        self.constant = {
            name: number(b, self.a["numbers"], 2 + c) for c, name in enumerate(shape.constant)
        }
        self.span = number(b, self.a["numbers"], 0)
        self.stored = b.icmp_signed("!=", self.a["stored"], 0)
        # Exponentials of a step, a part of a step and, if possible, a long step. `opened` has
        # those of a step and a part with the open loop of a servo.
        count = 2 + shape.long_steps
        whole, part, *stride = self.exponentials = [
            self.kind.room(shape.layout.size**2) for _ in range(count)
        ]
        self._exponential(self.span, whole)
        if model.frictions:
            self._part_exponential(whole, part)
        self.servo = self._servo() if model.saturation else None
        self.opened = [self.kind.room(shape.layout.size**2) for _ in range(2 if self.servo else 0)]
        if self.servo:
            for span, room in zip((self.span, self.span * self._part), self.opened, strict=True):
                self._exponential(span, room, opened=True)
            self.closed, self.regime = Mask(b, NOWHERE), b.room(1)
            # The reference, which follows a goal at limited speed, now and after the step.
            self.reference = self.kind.room(2)
        count, rows = shape.r_count, self.walker_numbers("rows")
        self.rows = [
            {r: rows[k * count + r] for r, used in enumerate(pattern) if used}
            for k, pattern in enumerate(shape.pattern)
        ]
        self.step = self._step(whole, self.span)
        self.mode = self._friction_mode(self.step)
        # The mode of a long step from sample to sample, if possible.
        self.stride: FrictionMode | None = None
        for matrix in stride:
            span = number(b, self.a["numbers"], 1)
            self._exponential(span, matrix)
            self.stride = self._friction_mode(self._step(matrix, span))

    def walker_numbers(self, name: str) -> list[Number]:
        """Load a part of the block `own`: numbers, and their slopes, which are stored after them."""
        return self.kind.shaped(self.b.read_row(self.walker[name], self.shape.walker_vectors[name]))

    def set_mode(self, state: list[Number]) -> None:
        """Set the friction modes of a step and of a long step by the speeds of a state."""
        for mode in filter(None, (self.mode, self.stride)):
            mode.set(state)

    def _exponential(self, span: Vector, room: ir.Value, *, opened: bool = False) -> None:
        b, constants = self.b, self.b.offset(self.a["numbers"], 2)
        parameters, layout = self.walker["parameters"], self.shape.layout
        if opened:
            parameters = b.room(layout.n_parameters * self.kind.width)
            b.write_row(self.kind.flat([*self._opened_parameters.values()]), parameters)
        numbers = [parameters, span.value]
        if self.shape.dual:
            numbers += [b.offset(parameters, layout.n_parameters), vector(0.0)]
        store_exponential(b, room, constants, layout, *numbers, increments=False)

    def _part_exponential(self, whole: ir.Value, part: ir.Value) -> None:
        """Store the exponential of a part of a step with an event; a single part is the whole step."""
        b = self.b
        parted = b.icmp_signed(">", self.a["turns"], 1)
        with b.if_else(parted) as (then, otherwise):
            with then:
                self._exponential(self.span * self._part, part)
            with otherwise:
                b.copy(whole, part, self.shape.layout.size**2 * self.kind.width)

    @property
    def _part(self) -> Vector:
        """Return the length of a part divided by that of its step."""
        b = self.b
        return Vector(b, b.splat(b.fdiv(F64(1.0), b.sitofp(self.a["turns"], F64))))

    def _entry(self, e: ir.Value, row: int, column: int) -> Number | None:
        """Return an entry, or None for zero; columns are states, the constant 1, drives, frictions."""
        layout = self.shape.layout
        reached = layout.reachable[row][column]
        return self.kind.get(e, row * layout.size + column) if reached else None

    @property
    def _opened_parameters(self) -> dict[str, Number]:
        """Return the parameters of the open loop of a servo."""
        assert self.shape.model.saturation is not None
        return {**self.parameters, self.shape.model.saturation.duty: self.kind.zero()}

    def _rates(self, *, opened: bool = False) -> Rates:
        parameters = self._opened_parameters if opened else self.parameters
        return Rates(self.b, self.shape, parameters, self.constant)

    def _servo(self) -> ServoLoop:
        """Return the servo; closed loop minus open loop gives its wanted voltage."""
        law, shape = self.shape.model.saturation, self.shape
        assert law is not None
        closed, opened = self._rates(), self._rates(opened=True)
        i = shape.model.states.index(law.row)
        column = self.x_count + 1 + len(shape.drives) - 1
        volt = closed.rows[i][column]
        before, after = closed.rows[i], opened.rows[i]
        row = {k: (before[k] - after[k]) / volt for k in before if k < column and k != self.x_count}
        base = (closed.base[i] - opened.base[i]) / volt
        return ServoLoop(law, column, row, base, self.parameters)

    def _step_of_loops(self, closed: Mask, place: int, span: Vector) -> Step:
        """Return a step with the loop of the servo closed in lanes `closed`, and open in others."""
        first = self._step(self.exponentials[place], span)
        return merged_step(closed, first, self._step(self.opened[place], span, opened=True))

    def _enter_loop(self, state: list[Number], drive: Mapping[int, Number]) -> None:
        """Close or open the servo's loop for a state; after a change, set the friction modes."""
        assert self.servo is not None
        b, zero = self.b, Vector(self.b, vector(0.0))
        self.closed = self.servo.is_closed(self.servo.wanted(state, drive))
        self.step = self._step_of_loops(self.closed, 0, self.span)
        self.mode = replace(self.mode, step=self.step)
        regime, before = where(self.closed, zero + 1.0, zero), Vector(b, b.read(self.regime, 0))
        changed = Mask(b, b.fcmp_unordered("!=", regime.value, before.value))

        def entered() -> list[Number]:
            b.write(regime.value, self.regime, 0)
            if self.step.frictions:
                self.set_mode(state)
            return []

        self.kind.replace_if_any(changed, [], entered)

    def _corrected(self, now: StepStart) -> StepStart:
        """Return the start of a step with the mean voltage of a servo whose loop may open or close."""
        assert self.servo is not None
        servo, step, x = self.servo, self.step, self.x_count
        if step.frictions:
            ahead = self.mode.advance(now, self.mode.directions())[:x]
        else:
            ahead = step.frictionless(now.state, now.drive)
        begin = servo.wanted(now.state, now.drive)
        end = servo.wanted(ahead, step.drive_after(now.drive, step.span))
        mean = servo.mean_beyond(begin, end, self.closed, servo.law.level(now.inputs))
        return replace(now, drive={**now.drive, servo.column: mean})

    def _step(self, e: ir.Value, span: Vector, *, opened: bool = False) -> Step:
        shape, x, s = self.shape, self.x_count, len(self.shape.series)
        first = x + 1 + len(shape.drives)
        columns = range(first + len(shape.model.frictions))
        entries = [{k: self._entry(e, i, k) for k in columns} for i in range(x)]
        matrix = [{k: v for k, v in row.items() if v is not None} for row in entries]
        acting, rates = [], self._rates(opened=opened)
        index = shape.model.states.index
        for column, friction in enumerate(shape.model.frictions, start=first):
            row, law = index(friction.against), friction.law
            acts = -rates.rows[row][column]  # effect of a unit effort on the rate
            steady = Sizes.by_law(self.b, law, self.parameters, 0.0, {}) if law.steady else None
            holding = {k: entry / acts for k, entry in rates.rows[row].items() if k < first}
            acting.append(
                StepFriction(
                    row=row,
                    angle=None if friction.holds is None else index(friction.holds),
                    column={i: terms[column] for i, terms in enumerate(matrix) if column in terms},
                    stop_gain=-1.0 / matrix[row][column],
                    holding_row=holding,
                    holding_base=rates.base[row] / acts,
                    law=law,
                    steady=steady,
                )
            )
        return Step(
            rows=matrix,
            frictions=acting,
            parameters=self.parameters,
            states=shape.model.states,
            span=span,
            slopes={x + 1 + k: x + 1 + s + k for k in range(s)} if shape.first_order else {},
            first_friction=first,
            kind=self.kind,
        )

    def _friction_mode(self, step: Step) -> FrictionMode:
        shape, frictions = self.shape, len(self.shape.model.frictions)
        rows = self.x_count + frictions
        # The mode stores directions and all entries.
        size = frictions + 2 * rows * (rows + 1 + len(shape.drives))
        return FrictionMode(step, shape.read or shape.efforts, self.b.room(size))

    def drive(
        self, node: Integer, state: Sequence[Number]
    ) -> tuple[dict[int, Number], dict[str, Number]]:
        """Return drives by column, and inputs in the middle by name, for the step after a node.

        Gravity is evaluated at the angle in the middle of the step, extrapolated with the speed.
        """
        shape, first = self.shape, self.x_count + 1
        driving = [self._input(node, k) for k in range(len(shape.columns))]
        if (goal := self._limited_goal) is not None:
            self._limit(driving, goal)
        middle: dict[str, Number] = dict.fromkeys(shape.model.inputs, 0.0) | self.constant
        for k, name in enumerate(shape.series):
            number = driving[k] + middle.get(name, 0.0)
            if shape.first_order:
                number = number + driving[len(shape.series) + k] * (self.span * 0.5)
            middle[name] = number
        middle = dict(shape.model.acting(self.parameters, middle))
        states = shape.model.states
        for gravity in shape.model.gravities:
            angle, speed = (state[states.index(name)] for name in (gravity.angle, gravity.speed))
            ahead = angle + speed * (self.span * 0.5)
            driving.append(gravity.torque(self.parameters, ahead))
        drive = {first + k: number for k, number in enumerate(driving)}
        if self.servo:
            wanted = self.servo.wanted(state, drive)
            closed = self.servo.is_closed(wanted)
            level = self.servo.law.level(middle)
            drive[self.servo.column] = self.servo.beyond_matrix(wanted, closed, level)
        return drive, middle

    @property
    def _limited_goal(self) -> int | None:
        """Return the index of the goal in `series` if the servo limits its speed, else None."""
        servo, series = self.shape.model.saturation, self.shape.series
        return series.index(servo.goal) if servo and servo.speed and servo.goal in series else None

    def _limit(self, driving: list[Number], goal: int) -> None:
        """Replace a goal by its reference, and store the reference at the end of the step."""
        assert self.servo is not None
        reference, slope = self.kind.get(self.reference, 0), len(self.shape.series) + goal
        straight, aim = self.shape.first_order, driving[goal]
        aim = aim + driving[slope] * self.span if straight else aim
        after, mean = self.servo.law.moved(self.parameters, self.span, reference, aim)
        self.kind.put(after, self.reference, 1)
        driving[goal] = reference if straight else mean
        if straight:
            driving[slope] = (after - reference) / self.span

    def _input(self, node: Integer, k: int) -> Number:
        """Load an input; if it has a lag, each lane interpolates between two rows at its own lag."""
        b, shape, count = self.b, self.shape, len(self.shape.columns)
        name = shape.series[k % len(shape.series)]
        if name not in shape.delayed_series:
            index = b.add(b.mul(node, count), k)
            return Vector(b, b.shared(self.a["u"], index))
        late = shape.delayed_series.index(name)
        fraction = self.walker_numbers("share")[late]
        behind = b.fptosi(b.read(self.walker["behind"], late), INT_VEC)
        row = b.mul(b.sub(b.splat(node), behind), count)
        here, earlier = (
            Vector(b, b.gather(self.a["u"], b.add(row, k - back))) for back in (0, count)
        )
        return here + (earlier - here) * fraction

    def start(self) -> list[ir.Value]:
        """Return the numbers carried from step to step: state and, if sizes vary, history."""
        state = self.walker_numbers("x0")
        if (goal := self._limited_goal) is not None:
            self.kind.put(self._input(0, goal), self.reference, 0)
        if self.servo:
            self.b.write(vector(-1.0), self.regime, 0)
            self._enter_loop(state, self.drive(0, state)[0])
        step = self.step
        if not step.frictions:
            return self.kind.flat(state)
        self.set_mode(state)
        sizes_now = step.sizes(state, self.drive(0, state)[1])
        sizes = [sizes_now[e].along(state[step.frictions[e].row]) for e in step.varying]
        return self.kind.flat([*state, *sizes, *(self.kind.zero() for _ in sizes)])

    def advance(
        self, node: Integer, registers: Sequence[ir.Value]
    ) -> tuple[list[Number], list[Number], list[ir.Value]]:
        """Advance a step; return the state, the efforts if they are shown, and carried numbers."""
        (state, past), x = self._shaped(registers), self.x_count
        now = StepStart(state, past, *self.drive(node, state))
        if self.servo:
            self._enter_loop(state, now.drive)
            now = self._corrected(now)
        if self._limited_goal is not None:
            self.kind.put(self.kind.get(self.reference, 1), self.reference, 0)
        step = self.step
        if not step.frictions:
            new = step.frictionless(state, now.drive)
            return new, [], self.kind.flat(new)
        result = advance_step(self.mode, self._turning, now, self.set_mode)
        end, new = len(result) - 2 * len(step.varying), result[:x]
        return new, result[x:end], self.kind.flat([*new, *result[end:]])

    def _shaped(self, registers: Sequence[ir.Value]) -> tuple[list[Number], FrictionHistory]:
        numbers, x, v = self.kind.shaped(registers), self.x_count, len(self.step.varying)
        return numbers[:x], FrictionHistory(numbers[x : x + v], numbers[x + v :])

    def _turning(self) -> ReversalStep:
        span = self.span * self._part
        if self.servo:
            step = self._step_of_loops(self.closed, 1, span)
        else:
            step = self._step(self.exponentials[1], span)
        return ReversalStep(step, self.a["turns"], self._part)

    def run_samples(self) -> None:
        """Advance from sample to sample, and observe the channels there."""
        b, shape = self.b, self.shape
        sums = shape.tally.initial(self.k_count) if shape.tally is not None else []
        start = self.start()
        samples = Loop(b, self.a["samples"], [0, *start, *sums], "samples")
        node, registers = samples.carried[0], samples.carried[1:]
        state_registers, totals = registers[: len(start)], registers[len(start) :]
        state = self.kind.shaped(state_registers)[: self.x_count]
        if shape.efforts:
            _, efforts, last = self.advance(node, state_registers)
            totals = self.observe(samples.index, state, efforts, totals)
            samples.close([b.add(node, 1), *last, *totals])
        else:
            totals = self.observe(samples.index, state, [], totals)
            count = b.single(self.a["pieces"], samples.index)
            last = self._to_next_sample(samples.index, node, count, state_registers)
            samples.close([b.add(node, count), *last, *totals])
        with b.if_then(b.not_(self.stored)):
            b.write_row(totals, b.offset(self.a["out"], self.group, len(totals)))

    def _to_next_sample(
        self, sample: ir.Value, node: ir.Value, count: ir.Value, registers: list[ir.Value]
    ) -> list[ir.Value]:
        """Advance to the next sample."""
        b = self.b

        def steps() -> list[Number]:
            pieces = Loop(b, count, registers, "pieces")
            _, _, last = self.advance(b.add(node, pieces.index), pieces.carried)
            pieces.close(last)
            return self.kind.shaped(last)

        if self.stride is None:
            return self.kind.flat(steps())
        wanted = b.icmp_signed("!=", b.single(self.a["usual"], sample), 0)
        state, past = self._shaped(registers)
        now = StepStart(state, past, *self.drive(node, state))
        return self.kind.flat(advance_stride(self.stride, wanted, now, steps))

    def evaluate_rates(
        self,
        state: Sequence[Number],
        drive: dict[int, Number],
        efforts: Sequence[Number],
        *,
        later: Number | None = None,
    ) -> list[Number]:
        """Evaluate the rig's equations, with a servo's loop open or closed as in this step."""
        rates = self._rates().evaluate(state, drive, efforts, later=later)
        if not self.servo:
            return rates
        opened = self._rates(opened=True).evaluate(state, drive, efforts, later=later)
        return [where(self.closed, *both) for both in zip(rates, opened, strict=True)]

    def output(self, k: int, state: Sequence[Number], efforts: Sequence[Number]) -> Number:
        """Return the value of channel k at states and efforts."""
        values = dict(enumerate([*state, None, *efforts]))
        terms = [(row, values[r]) for r, row in self.rows[k].items() if r != self.x_count]
        start = self.rows[k].get(self.x_count)
        output = sum_products(start, terms)
        return Vector(self.b, vector(0.0)) if output is None else output

    def observe(
        self,
        sample: ir.Value,
        state: Sequence[Number],
        efforts: Sequence[Number],
        totals: list[ir.Value],
    ) -> list[ir.Value]:
        """Return the sums with one more sample, or store the signals at the sample."""
        b, shape = self.b, self.shape

        def store() -> None:
            for k in range(self.k_count):
                self.write_signal(sample, k, self.output(k, state, efforts))

        if shape.tally is None:
            store()
            return []
        if shape.tally != SQUARES:
            return self._added(sample, state, totals)
        with b.if_else(self.stored) as (then, otherwise):
            with then:
                store()
                storing = b.block
            with otherwise:
                new, adding = self._added(sample, state, totals), b.block
        pairs = zip(totals, new, strict=True)
        return [b.merged((old, storing), (sum_, adding)) for old, sum_ in pairs]

    def _added(
        self, sample: ir.Value, state: Sequence[Number], totals: list[ir.Value]
    ) -> list[ir.Value]:
        for k in range(self.k_count):
            totals = self.add_sample(sample, k, self.output(k, state, []), totals)
        return totals

    def add_sample(
        self, sample: ir.Value, k: int, value: Number, totals: list[ir.Value]
    ) -> list[ir.Value]:
        """Return the sums of all channels with one more sample of channel k."""
        b, tally = self.b, self.shape.tally
        assert tally is not None
        first = k * tally.weights
        weights = [b.read(self.walker["weight"], first + n) for n in range(tally.weights)]
        record = Record(b, self.a["y"], self.a["begin"], self.k_count)
        residual = record.residual(sample, k, value.value)
        return tally.add_if_observed(b, totals, Sample(record, sample, k, residual, weights))

    def write_signal(self, sample: ir.Value, k: int, value: Number) -> None:
        """Store a value of channel k among the signals."""
        b, k_count = self.b, self.k_count
        flat = b.add(b.mul(sample, k_count), k)
        row = b.mul(b.mul(self.group, self.a["samples"]), k_count)
        index = b.mul(b.add(row, flat), self.shape.numbers)
        b.write_row(self.kind.flat([value]), b.offset(self.a["out"], index))


TRACE_VALUES = 3  # value at a node; span times rate after this node, and before the next node


def emit_trace(w: Writer) -> None:
    """Store the trace of all nodes; the last node has only a value."""
    b = w.b
    nodes = Loop(b, w.a["nodes"], w.start(), "nodes")
    state = w.kind.shaped(nodes.carried)[: w.x_count]
    drive, _ = w.drive(nodes.index, state)
    new, efforts, last = w.advance(nodes.index, nodes.carried)
    after = w.evaluate_rates(state, drive, efforts)
    before = w.evaluate_rates(new, drive, efforts, later=w.span)
    for k in range(w.k_count):
        entries = [w.output(k, state, []), *(_seen_rate(w, k, rate) for rate in (after, before))]
        _store_entries(w, nodes.index, k, entries)
    nodes.close(last)
    zero: Number = Vector(b, vector(0.0))
    for k in range(w.k_count):
        _store_entries(w, w.a["nodes"], k, [w.output(k, new, []), zero, zero])


def _store_entries(w: Writer, node: Integer, k: int, entries: Sequence[Number]) -> None:
    b, numbers = w.b, w.shape.numbers
    index = b.add(b.mul(node, w.k_count), k)
    w.kind.put_row(entries, b.offset(w.a["trace"], index, TRACE_VALUES * numbers))


def _seen_rate(w: Writer, k: int, rates: Sequence[Number]) -> Number:
    """Return the change of channel k over a step with constant rates."""
    terms = [(row, rates[r]) for r, row in w.rows[k].items() if r < w.x_count]
    zero = Vector(w.b, vector(0.0))
    return sum_products(zero, terms) * w.span


def emit_reading(w: Writer) -> None:
    """Observe all samples, each lane at its own time: store signals, or add up sums."""
    b, tally, before = w.b, w.shape.tally, w.walker_numbers("before")
    begins = [_seen_rate(w, k, before) for k in range(w.k_count)]  # before the start
    if tally != SQUARES:
        _read_samples(w, begins, tally)
        return
    with b.if_else(w.stored) as (then, otherwise):
        with then:
            _read_samples(w, begins, None)
        with otherwise:
            _read_samples(w, begins, tally)


def _read_samples(w: Writer, begins: Sequence[Number], tally: ResidualSums | None) -> None:
    b, shifts = w.b, w.walker_numbers("shift")
    sums = tally.initial(w.k_count) if tally is not None else []
    samples = Loop(b, w.a["samples"], sums, "read")
    t = Vector(b, b.shared(w.a["t"], samples.index))
    totals = samples.carried
    for k in range(w.k_count):
        when = t - shifts[k] / w.span
        value = _read(w, k, when, begins[k])
        if tally is not None:
            totals = w.add_sample(samples.index, k, value, totals)
        else:
            w.write_signal(samples.index, k, value)
    samples.close(totals)
    b.write_row(totals, b.offset(w.a["out"], w.group, len(totals)))


def _read(w: Writer, k: int, when: Number, begin: Number) -> Number:
    b = w.b
    position = dual(when).value.value
    last = b.splat(b.sitofp(b.sub(w.a["nodes"], 1), F64))
    node = b.floor(position)
    node = b.select(b.fcmp_ordered("<", node, last), node, last)
    node = b.select(b.fcmp_ordered(">", node, vector(0.0)), node, vector(0.0))
    fraction = when - Vector(b, node)
    value, after, before = (_load_entries(w, node, k, q) for q in range(TRACE_VALUES))
    rise = _load_entries(w, b.fadd(node, vector(1.0)), k, 0) - value
    bend = rise * 3.0 - after * 2.0 - before
    turn = after + before - rise * 2.0
    between = value + fraction * (after + fraction * (bend + fraction * turn))
    early = Mask(b, b.fcmp_ordered("<", position, vector(0.0)))
    return where(early, value + fraction * begin, between)


def _load_entries(w: Writer, node: ir.Value, k: int, q: int) -> Number:
    b, numbers = w.b, w.shape.numbers
    row = b.mul(b.fptosi(node, INT_VEC), w.k_count * TRACE_VALUES * numbers)
    first = (k * TRACE_VALUES + q) * numbers
    places = [b.add(row, first + n) for n in range(numbers)]
    return w.kind.shaped([b.gather_lanes(w.a["trace"], place) for place in places])[0]


def write_stepping(module: Module, shape: SteppedShape) -> None:
    """Write the kernel `stepping`, whose arguments are COUNTS and the addresses of BLOCKS."""
    with (
        kernel(module, "stepping", COUNTS, BLOCKS) as (a, b),
        b.loop(a["groups"], "groups") as group,
    ):
        w = Writer(b, shape, a, group)
        if shape.read:
            emit_trace(w)
            emit_reading(w)
        else:
            w.run_samples()
