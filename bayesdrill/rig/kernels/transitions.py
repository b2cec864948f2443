"""Compute transition matrices of walkers (sets of parameters), over a record's steps and other spans.

The distinct steps of a record have a table of matrix exponentials.  Any other span is expressed as a
ratio times a `width`.  Its exponential acts on a state by a ladder, whose rungs are
exponentials over ..., 4, 2, 1, 1/2, 1/4, ... widths: each 1 in the binary digits of the ratio takes
a product with a rung.  A Taylor series of few terms covers the span that remains after the last
rung.  The larger the norm of a walker's matrix, the more rungs shorter than the width it needs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

from llvmlite import ir

from bayesdrill.basics.duals import Dual, dual, where
from bayesdrill.rig.kernels.exponential import (
    Layout,
    emit_balanced_norm,
    emit_halvings,
    emit_power,
    multiply_reached,
    number,
    store_exponential,
    value_registers,
)
from bayesdrill.rig.kernels.lanes import (
    INT_VEC,
    Builder,
    Integer,
    Loop,
    Mask,
    Values,
    Vector,
    vector,
)
from bayesdrill.rig.kernels.numbers import (
    Number,
    Numbers,
    multiply_add,
    multiply_large,
    sum_products,
)

MAX_SERIES_DEGREE = 14
MAX_SERIES_NORM = 0.3  # largest norm times span for which a series is used
SERIES_TAIL = 1e-16  # truncation error of a series, relative to the state
MAX_HALVINGS = 50  # largest number of halvings of the width: shorter spans are lost in rounding
MAX_RUNGS = 60 + MAX_HALVINGS
LEAST_NORM = 1e-3  # smallest norm times width; a smaller product is raised to this
MAX_NORM = 1e100  # largest norm; a lane with a larger one has overflowed

State = list[Number]
Step = Callable[[State, "InputHold"], State]


def table_entries(layout: Layout) -> list[tuple[int, int]]:
    """Return (row, column) of the entries that tables store: reachable ones in rows of states.

    For a large matrix these are whole rows.
    """
    n, reach, large = layout.size, layout.reachable, layout.large
    return [(i, j) for i in range(layout.n_states) for j in range(n) if large or reach[i][j]]


@dataclass(frozen=True, slots=True)
class InputHold:
    """The sampled inputs have values at a time and, if interpolated, time slopes from then on."""

    inputs: Sequence[Number]
    slopes: Sequence[Number]

    @classmethod
    def load(cls, b: Builder, layout: Layout, u: ir.Value, knot: ir.Value) -> InputHold:
        """Load the inputs and time slopes from a knot on, from the block `u` of all knots."""
        columns = layout.size - layout.n_states - 1
        at = b.offset(u, knot, columns) if columns else u
        values = [number(b, at, c) for c in range(columns)]
        return cls(values[: layout.n_series], values[layout.n_series :])

    def later(self, span: Number) -> InputHold:
        """Return the drive after a span: inputs follow their slopes or, without slopes, are constant."""
        if not self.slopes:
            return self
        pairs = zip(self.inputs, self.slopes, strict=True)
        return InputHold([multiply_add(slope, span, u) for u, slope in pairs], self.slopes)


@dataclass(frozen=True, slots=True)
class ExponentialLadder:
    """A ladder has memory for each lane's norm and series, see `Transitions.act`.

    `rates` are the entries of A, c and B divided by the norm. `weights` are 1/k for term k. `scale`
    has norm * width, and 1 / norm. `halvings` has the number of halvings of the width in each lane.
    `counts` has the numbers of series terms, of rungs of at least the width, and of all rungs.
    """

    rates: ir.Value
    weights: ir.Value
    scale: list[ir.Value]
    halvings: ir.Value
    counts: ir.Value


@dataclass(frozen=True)
class Transitions:
    """The writer has the code that fills and applies the transition matrices of walkers.

    `kind` says whether numbers have derivatives. `parameters` are the addresses of the parameters'
    values and derivatives, and `constants` is that of constant inputs. `table` is the address of the
    exponentials of steps. `width` is the span that ratios refer to. `rungs` is the address of the
    ladder's exponentials. `halved` says whether sums of a step have two halves, see `sum_products`.
    """

    b: Builder
    layout: Layout
    kind: Numbers
    parameters: tuple[ir.Value, ...]
    constants: ir.Value
    table: ir.Value
    rungs: ir.Value
    width: Vector
    halved: bool = True

    @property
    def size(self) -> int:
        """Return how many vectors an exponential takes in a table."""
        return len(table_entries(self.layout)) * self.kind.width

    def exponentiate(self, span: Number, e: ir.Value) -> None:
        """Store the exponential `(N, N)` over a span."""
        numbers = [*self.parameters[:1], *self.kind.flat([span])[:1]]
        if self.kind.slopes:
            numbers += [self.parameters[1], *self.kind.flat([span])[1:]]
        store_exponential(self.b, e, self.constants, self.layout, *numbers, increments=False)

    def store(self, e: ir.Value, table: ir.Value, index: Integer) -> None:
        """Store the `table_entries` of an exponential as number `index` of a table."""
        at = self.b.offset(table, index, self.size)
        if self.layout.large:
            self.b.copy(e, at, self.size)
            return
        for entry, (i, j) in enumerate(table_entries(self.layout)):
            self.kind.put(self.kind.get(e, i * self.layout.size + j), at, entry)

    def fill_table(self, nodes: ir.Value, spans: ir.Value, chained: ir.Value | None) -> None:
        """Store the exponentials of all `nodes`, the entries of the table, over their `spans`.

        The exponential of a `chained` node is that of the node before, times that over the width.
        """
        b, n = self.b, self.layout.size
        e, hop, spare = (self.kind.room(n * n) for _ in range(3))
        if chained is not None:
            self.exponentiate(self.width, hop)
        with b.loop(nodes, "nodes") as node:

            def exponentiate_span(at: ir.Value = node) -> None:
                self.exponentiate(Vector(b, b.shared(spans, at)), e)

            if chained is None:
                exponentiate_span()
            else:
                linked = b.icmp_signed("!=", b.single(chained, node), 0)
                with b.if_else(linked) as (then, otherwise):
                    with then:
                        multiply_reached(b, spare, e, hop, self.layout, slopes=self.kind.slopes)
                        b.copy(spare, e, n * n * self.kind.width)
                    with otherwise:
                        exponentiate_span()
            self.store(e, self.table, node)

    def step(self, table: ir.Value, index: Integer) -> Step:
        """Return the function that advances a state by exponential number `index` of a table."""
        at = self.b.offset(table, index, self.size)
        if self.layout.large:
            return lambda state, drive: self._multiply_large(at, state, drive)
        phi = {entry: self.kind.get(at, n) for n, entry in enumerate(table_entries(self.layout))}
        # No rate depends on an idle state, so its entry on the diagonal is the constant 1.
        unity = Vector(self.b, vector(1.0))
        idle = self.layout.is_zero_column
        phi |= {(i, i): unity for i in range(self.layout.n_states) if idle[i]}
        return lambda state, drive: self._multiply(phi, state, drive)

    def _multiply(
        self, phi: dict[tuple[int, int], Number], state: State, drive: InputHold
    ) -> State:
        x = self.layout.n_states
        columns = dict(enumerate(state)) | dict(enumerate((*drive.inputs, *drive.slopes), x + 1))
        zero = Vector(self.b, vector(0.0))
        following = []
        for i in range(x):
            terms = [(phi[i, j], value) for j, value in columns.items() if (i, j) in phi]
            following.append(sum_products(phi.get((i, x), zero), terms, halved=self.halved))
        return following

    def _multiply_large(self, phi: ir.Value, state: State, drive: InputHold) -> State:
        x, n, kind = self.layout.n_states, self.layout.size, self.kind
        z, following = kind.room(n), kind.room(x)
        kind.put_row([*state, Vector(self.b, vector(1.0)), *drive.inputs, *drive.slopes], z)
        multiply_large(self.b, following, phi, z, (x, n, 1), slopes=kind.slopes)
        return kind.row(following, x)

    def join_steps(
        self, joined: ir.Value, rows: Sequence[Mapping[int, Number]], count: int
    ) -> None:
        """Store the matrix that does `count` steps at once, from z = (x, 1, inputs of all steps).

        Its product with z is x after the steps, then the channels after each step. All steps have
        the first exponential of the table. Each column is the response to a unit vector of z.
        Channels are `rows` times (x, 1).
        """
        b, kind, x, n = self.b, self.kind, self.layout.n_states, self.layout.size
        columns, unity = x + 1 + count * (n - x - 1), Vector(b, vector(1.0))
        units, following = kind.room(n * columns), kind.room(x * columns)
        kind.clear(units, n * columns)
        with b.loop(x + 1, "units") as unit:
            kind.put(unity, units, b.mul(unit, columns + 1))
        with b.loop(count, "steps") as step:
            first = b.add(b.mul(step, n - x - 1), x + 1)
            for drive in range(n - x - 1):
                unit = kind.at(units, (x + 1 + drive) * columns)
                kind.clear(unit, columns)
                kind.put(unity, unit, b.add(first, drive))
            sizes = (x, n, columns)
            multiply_large(b, following, self.table, units, sizes, slopes=kind.slopes)
            b.copy(following, units, x * columns * kind.width)
            shown = kind.at(joined, b.mul(b.add(b.mul(step, len(rows)), x), columns))
            with b.loop(columns, "columns") as column:
                at, into = kind.at(units, column), kind.at(shown, column)
                for k, row in enumerate(rows):
                    terms = [(weight, kind.get(at, i * columns)) for i, weight in row.items()]
                    kind.put(sum_products(kind.zero(), terms), into, k * columns)
        b.copy(units, joined, x * columns * kind.width)

    # Spans that are not in the table.

    @cached_property
    def _rate_entries(self) -> list[tuple[int, int]]:
        """Return (row, column) of the entries of A, c and B that may differ from zero."""
        entries = self.layout.entries([1.0] * self.layout.n_numbers)
        return sorted({(row, column) for row, column, _ in entries if row < self.layout.n_states})

    @cached_property
    def _constant_rates(self) -> set[tuple[int, int]]:
        """Return those `_rate_entries` that depend on no parameter and thus have no derivative."""
        entries = self.layout.entries([Dual(1.0, 1.0)] * self.layout.n_numbers)
        depends = {(row, column) for row, column, value in entries if isinstance(value, Dual)}
        return {*self._rate_entries} - depends

    @cached_property
    def _ladder(self) -> ExponentialLadder:
        b = self.b
        return ExponentialLadder(
            rates=self.kind.room(len(self._rate_entries)),
            weights=b.room(MAX_SERIES_DEGREE + 1),
            scale=b.slots(2),
            halvings=b.room(1, INT_VEC),
            counts=b.room(3, ir.IntType(64)),
        )

    def fill_ladder(self, high: ir.Value) -> None:
        """Store all rungs, `high` of which span at least the width, and the series' coefficients."""
        b, ladder, x = self.b, self._ladder, self.layout.n_states
        entries: dict[tuple[int, int], Number] = {}
        for row, column, value in self.layout.matrix(b, self.constants, *self.parameters):
            if row < x:
                entries[row, column] = entries.get((row, column), 0.0) + value
        norm = emit_balanced_norm(b, x, value_registers(entries))
        least = (LEAST_NORM / self.width).value
        fit = b.fcmp_ordered(">", norm, least)
        fit = b.and_(fit, b.fcmp_ordered("<", norm, vector(MAX_NORM)))
        norm = b.select(fit, norm, least)
        over = Vector(b, b.fdiv(vector(1.0), norm))
        for index, entry in enumerate(self._rate_entries):
            self.kind.put(entries[entry] * over, ladder.rates, index)
        whole = b.fmul(norm, self.width.value)
        halvings = emit_halvings(b, whole, MAX_SERIES_NORM)
        deep = b.icmp_signed(">", halvings, MAX_HALVINGS)
        halvings = b.select(deep, MAX_HALVINGS, halvings)
        b.store(halvings, ladder.halvings)
        b.write_slots([whole, over.value], ladder.scale)
        size = b.fdiv(whole, emit_power(b, b.add(halvings, 1023)))
        degree = self._store_weights(size, b.select(deep, 0, 1))
        count = b.largest(b.select(b.icmp_signed(">", degree, 3), degree, 3))
        rungs = b.add(high, b.largest(halvings))
        for place, each in enumerate((count, high, rungs)):
            b.store(each, b.offset(ladder.counts, place))
        e = self.kind.room(self.layout.size**2)
        with b.if_then(b.icmp_signed(">", rungs, 0)), b.loop(rungs, "rungs") as rung:
            self.exponentiate(self.width * Vector(b, self._rung_ratio(rung)), e)
            self.store(e, self.rungs, rung)

    def _store_weights(self, size: ir.Value, degree: ir.Value) -> ir.Value:
        """Store weights 1/k up to the degree of each lane, then 0; return degrees of at least `degree`.

        The truncated series of exp(x) for x <= `size` lacks about `SERIES_TAIL` of the state.
        """
        b = self.b
        for k in range(1, MAX_SERIES_DEGREE):
            enough = (SERIES_TAIL * math.factorial(k + 1)) ** (1 / (k + 1))
            more = b.fcmp_ordered(">", size, vector(enough))
            more = b.and_(more, b.icmp_signed("==", degree, k))
            degree = b.add(degree, b.zext(more, INT_VEC))
        for k in range(1, MAX_SERIES_DEGREE + 1):
            wanted = b.icmp_signed(">=", degree, k)
            b.write(b.select(wanted, vector(1 / k), vector(0.0)), self._ladder.weights, k)
        return degree

    def _rung_ratio(self, rung: ir.Value) -> ir.Value:
        """Return the span of a rung divided by the width: 2^(high - 1 - rung)."""
        high = self.b.load(self.b.offset(self._ladder.counts, 1))
        exponent = self.b.add(self.b.sub(high, rung), 1023 - 1)
        return emit_power(self.b, self.b.splat(exponent))

    def act(self, ratio: Number, state: State, drive: InputHold) -> tuple[State, InputHold]:
        """Return state and drive after a span of `ratio` times the width."""
        b, kind, ladder, x = self.b, self.kind, self._ladder, self.layout.n_states
        _, high, rungs = (b.load(b.offset(ladder.counts, place)) for place in range(3))
        # Inputs receive derivatives only from a ratio that has one.
        plain = Numbers(b, isinstance(ratio, Dual))

        def flat(numbers: State) -> Values:
            return [*kind.flat(numbers[:x]), *plain.flat(numbers[x:])]

        def shaped(registers: Values) -> State:
            first = x * kind.width
            return [*kind.shaped(registers[:first]), *plain.shaped(registers[first:])]

        begin = flat([*state, *drive.inputs, ratio])
        slots = b.slots(len(begin))
        b.write_slots(begin, slots)
        # Skip the rungs that are longer than the span of every lane.
        whole = b.largest(b.fptosi(dual(ratio).value.value, INT_VEC))
        above = b.sub(high, b.sub(64, b.ctlz(whole, ir.IntType(1)(0))))
        above = b.select(b.icmp_signed(">", above, 0), above, 0)
        more = b.sub(rungs, above)
        with b.if_then(b.icmp_signed(">", more, 0)), b.loop(more, "ladder") as step:
            rung = b.add(above, step)
            *old, remaining = shaped(b.read_slots(slots))
            rung_ratio = Vector(b, self._rung_ratio(rung))
            taken = b.fcmp_ordered(">=", dual(remaining).value.value, rung_ratio.value)
            depth = b.load(ladder.halvings)
            reached = b.icmp_signed("<", b.splat(b.sub(rung, high)), depth)
            taken = b.and_(taken, reached)
            with b.if_then(b.anywhere(taken)):
                here = InputHold(old[x:], drive.slopes)
                new = self.step(self.rungs, rung)(old[:x], here)
                new += here.later(rung_ratio * self.width).inputs
                pairs = zip([*new, remaining - rung_ratio], [*old, remaining], strict=True)
                b.write_slots(flat([where(Mask(b, taken), *pair) for pair in pairs]), slots)
        *moved, remaining = shaped(b.read_slots(slots))
        state, drive = moved[:x], InputHold(moved[x:], drive.slopes)
        return self._series(remaining, state, drive), drive.later(remaining * self.width)

    def _series(self, ratio: Number, state: State, drive: InputHold) -> State:
        """Return the state after a span of `ratio` times the width, by a Taylor series.

        Term k is the k-th time derivative of the state, divided by norm^k.
        """
        b, kind, ladder, x = self.b, self.kind, self._ladder, self.layout.n_states
        whole, over = (Vector(b, value) for value in b.read_slots(ladder.scale))
        scaled, unity = ratio * whole, Vector(b, vector(1.0))

        def add(k: Integer, term: State, power: Number, total: State) -> tuple[Number, State]:
            weight = power * (scaled * Vector(b, b.read(ladder.weights, k)))
            pairs = zip(term, total, strict=True)
            return weight, [multiply_add(weight, rate, to) for rate, to in pairs]

        columns = dict(enumerate(state)) | {x: unity} | dict(enumerate(drive.inputs, x + 1))
        term = self._rate(columns)
        power, total = add(1, term, unity, state)
        slopes = {} if not drive.slopes else {
            x + 1 + n: slope * over for n, slope in enumerate(drive.slopes)
        }  # fmt: skip
        term = self._rate(dict(enumerate(term)) | slopes)
        power, total = add(2, term, power, total)
        count, plain = b.sub(b.load(ladder.counts), 2), Numbers(b, isinstance(power, Dual))
        more = Loop(b, count, [*kind.flat([*term, *total]), *plain.flat([power])], "terms")
        carried = more.carried[: -plain.width]
        numbers, (power,) = kind.shaped(carried), plain.shaped(more.carried[len(carried) :])
        term = self._rate(dict(enumerate(numbers[:x])))
        power, total = add(b.add(more.index, 3), term, power, numbers[x:])
        more.close([*kind.flat([*term, *total]), *plain.flat([power])])
        return total

    def _rate(self, columns: dict[int, Number]) -> State:
        """Return the rates of the states, divided by the norm."""
        rates: list[Number] = []
        zero = Vector(self.b, vector(0.0))

        def load(n: int, place: tuple[int, int]) -> Number:
            rate = self.kind.get(self._ladder.rates, n)
            return dual(rate).value if place in self._constant_rates else rate

        for row in range(self.layout.n_states):
            terms = [
                (load(n, (r, c)), columns[c])
                for n, (r, c) in enumerate(self._rate_entries)
                if r == row and c in columns
            ]
            rates.append(sum_products(zero, terms))
        return rates
