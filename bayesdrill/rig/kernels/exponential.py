"""The layout of a rig's matrix, and its exponential over a span of time.

Kernels are specialised for the layout.  Numbers of an experiment are no part of it: its step, its
start, its constant inputs and the weights of its channels are arguments of kernels, so that
experiments of one layout share them.  Besides the whole exponential there is its action on a state
by a Taylor series.

The matrix is divided by a number of each lane, `norm`, near the spectral radius of its absolute
values: then no power of it overflows, and few terms are enough.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from llvmlite import ir
from numpy.typing import NDArray

from bayesdrill.basics.duals import Dual
from bayesdrill.rig.kernels.lanes import (
    F64,
    INT_VEC,
    VEC,
    Builder,
    Loop,
    Values,
    Vector,
    register,
    routine,
    vector,
)
from bayesdrill.rig.kernels.numbers import Numbers
from bayesdrill.rig.models.linear import Model

Entries = Callable[[Sequence[Any]], Sequence[tuple[int, int, Any]]]
Pattern = tuple[tuple[bool, ...], ...]
WeightKinds = tuple[tuple[int, ...], ...]
Registers = dict[tuple[int, int], ir.Value]  # entries by place
OTHER_WEIGHT = 2  # other numbers than 0, 1 and -1


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """The augmented N x N matrix of a rig, for which kernels are specialised.

    `entries(numbers)` gives its (row, column, value), of the rig's `n_parameters` and then of the
    `n_constants` inputs that are constant; entries of one place add up.  Its columns are X states,
    one constant input, `n_series` sampled inputs and, with a first-order hold, their increments.
    `lead`: whether the start is before the first sample.  `channels (K, X)`: weights of states, see
    `weight_kinds`.
    """

    n_parameters: int
    n_constants: int
    n_states: int
    n_series: int
    first_order: bool
    entries: Entries
    lead: bool = False
    channels: WeightKinds = ()

    @classmethod
    def from_model(
        cls, model: Model, series: tuple[str, ...], constant: tuple[str, ...], *, first_order: bool
    ) -> Layout:
        """Build the layout of a rig with sampled inputs, and others that are constant and not zero."""
        return cls(
            n_parameters=len(model.parameters),
            n_constants=len(constant),
            n_states=len(model.states),
            n_series=len(series),
            first_order=first_order and bool(series),
            entries=AugmentedMatrix(model, with_slopes(series, first_order=first_order), constant),
        )

    @property
    def text(self) -> str:
        """See `compile_kernel`."""
        sizes = (self.n_parameters, self.n_states, self.n_series, self.first_order, self.lead)
        return f"{sizes} {self.channels} {formulas(self.n_numbers, self.entries)}"

    @property
    def n_numbers(self) -> int:
        """Arguments of `entries`."""
        return self.n_parameters + self.n_constants

    @property
    def size(self) -> int:
        """Rows and columns N."""
        return self.n_states + 1 + self.n_series * (2 if self.first_order else 1)

    @property
    def reach(self) -> Pattern:
        """Entries of the exponential that can differ from zero."""
        reach = self._pattern | np.eye(self.size, dtype=bool)
        for _ in range(self.size):
            reach = reach | (reach.astype(int) @ reach.astype(int) > 0)
        return tuple(map(tuple, reach.tolist()))

    @property
    def idle(self) -> tuple[bool, ...]:
        """Columns of zeros: nothing depends on that state, and its entry of the exponential is one."""
        return tuple(not column for column in self._pattern.any(axis=0))

    @property
    def _pattern(self) -> NDArray[np.bool_]:
        pattern = np.zeros((self.size, self.size), dtype=bool)
        for row, column, _ in self.entries([1.0] * self.n_numbers):
            pattern[row, column] = True
        return pattern

    def matrix(
        self, b: Builder, parameters: ir.Value, constants: ir.Value, *, apart: int = 0
    ) -> Sequence[tuple[int, int, Any]]:
        """Return the entries of parameters `(P,)` and constant inputs `(C,)`, as numbers.

        Slopes of parameters, if any, stand `apart` from them.
        """
        row = b.read_row(parameters, self.n_parameters)
        if apart:
            row += b.read_row(b.offset(parameters, apart), self.n_parameters)
        numbers = Numbers(b, bool(apart)).shaped(row)
        return self.entries([*numbers, *(number(b, constants, c) for c in range(self.n_constants))])


def number(b: Builder, base: ir.Value, index: int) -> Vector:
    """Load a number from a block of single numbers into all lanes."""
    return Vector(b, b.shared(base, index))


def addresses(
    b: Builder, block: ir.Value, group: ir.Value, sizes: Mapping[str, int]
) -> dict[str, ir.Value]:
    """Return where the parts of a group begin, which stand in a row; `sizes` counts their vectors."""
    starts, start = {}, b.offset(block, b.mul(group, sum(sizes.values())))
    for name, size in sizes.items():
        starts[name], start = start, b.offset(start, size)
    return starts


def weight_kinds(weights: NDArray[np.float64]) -> WeightKinds:
    """Return weights 0, 1 and -1 as they are, and `OTHER_WEIGHT` for others.

    Nothing is multiplied by a weight that is known.
    """
    known = np.isin(weights, (-1.0, 0.0, 1.0))
    return tuple(map(tuple, np.where(known, weights, OTHER_WEIGHT).astype(int).tolist()))


def channel_weights(b: Builder, block: ir.Value, kinds: WeightKinds, k: int) -> dict[int, Vector]:
    """Return the weights of channel k that are not zero, by state, from a block of all `(K, X)`."""
    return {
        i: number(b, block, k * len(kinds[k]) + i)
        if kind == OTHER_WEIGHT
        else Vector(b, vector(float(kind)))
        for i, kind in enumerate(kinds[k])
        if kind != 0
    }


@dataclass(frozen=True, slots=True)
class AugmentedMatrix:
    """The entries of the augmented matrix of a rig, see `Layout`.

    `driven`: columns after the constant one, of which `v slope` is by how much `v` rises.
    `constant`: inputs that are constant and not zero.
    """

    model: Model
    driven: tuple[str, ...]
    constant: tuple[str, ...]

    def __call__(self, numbers: Sequence[Any]) -> list[tuple[int, int, Any]]:
        """(row, column, value)."""
        names = self.model.parameters
        linear = self.model.linear(dict(zip(names, numbers[: len(names)], strict=True)))
        constant = dict(zip(self.constant, numbers[len(names) :], strict=True))
        index, x = {name: k for k, name in enumerate(self.model.states)}, len(self.model.states)
        places = {name: x + 1 + k for k, name in enumerate(self.driven)}
        entries = [(index[row], index[column], value) for (row, column), value in linear.A.items()]
        entries += [(index[row], x, value) for row, value in linear.c.items()]
        for (row, name), value in linear.B.items():
            if name in places:
                entries.append((index[row], places[name], value))
            if name in constant:
                entries.append((index[row], x, value * constant[name]))
        rising = [name for name in places if f"{name} slope" in places]
        return entries + [(places[name], places[f"{name} slope"], 1.0) for name in rising]


def with_slopes(series: Sequence[str], *, first_order: bool) -> tuple[str, ...]:
    """Return the columns of sampled inputs: with a first-order hold, also those of their slopes."""
    return (*series, *(f"{name} slope" for name in series)) if first_order else tuple(series)


def present(constant: Mapping[str, float]) -> dict[str, float]:
    """Return the constant inputs that are not zero: of others the matrix has no entries."""
    return {name: value for name, value in constant.items() if value != 0.0}


def formulas(count: int, evaluate: Callable[[Sequence[Vector]], Any]) -> str:
    """Return the code that formulas of `count` numbers become, and their result in it, as one text.

    Equal formulas have equal texts, wherever they come from.
    """
    kind = ir.FunctionType(ir.VoidType(), [VEC] * count)
    function = ir.Function(ir.Module(), kind, "formulas")
    b = Builder(function.append_basic_block())
    result = evaluate([Vector(b, argument) for argument in function.args])
    return f"{function}{_described(result)}"


def _described(result: Any) -> str:
    """Write numbers by their names in the code, containers by what they contain."""
    if isinstance(result, Vector):
        return str(result.value.get_reference())
    if isinstance(result, Dual):
        return f"({_described(result.value)}, {_described(result.slope)})"
    if isinstance(result, Mapping):
        return _described(list(result.items()))
    if isinstance(result, list | tuple):
        return f"[{', '.join(map(_described, result))}]"
    return repr(float(result) if isinstance(result, float) else result)


TAYLOR_DEGREE = 16
TAYLOR_NORM = 0.75  # 0.75**17 / 17! = 2e-17: the truncated series is exact to rounding below it
MAX_SQUARINGS = 60

_MANTISSA_BITS = 52
_EXPONENT_BIAS = 1023


@routine
def store_exponential(
    b: Builder,
    parameters: ir.Value,
    constants: ir.Value,
    span: ir.Value,
    e: ir.Value,
    layout: Layout,
    *,
    increments: bool,
    beside_one: bool = True,
) -> None:
    """Store the exponential e `(N, N)` of the augmented matrix, each lane over a `span` of its own.

    It is that of `parameters (P,)` and `constants (C,)`.  The last columns are those of the inputs'
    `increments` over the span, or else of their slopes.  `beside_one=False` stores e - 1, which has
    more digits where a span is short.

    By scaling and squaring (Moler and Van Loan 2003): a Taylor series of degree 16 in powers of the
    fourth power, then squarings lane by lane.  Both are of e - 1: beside a one, what a slow state
    does in the shortened span would be lost to rounding where another state is very fast.
    """
    n, reach = layout.size, layout.reach
    reached = [i * n + j for i in range(n) for j in range(n) if reach[i][j]]
    scratch = b.room(5 * n * n)
    a, second, third, fourth, spare = (b.offset(scratch, k * n * n) for k in range(5))
    matrix = layout.matrix(b, parameters, constants)
    timed = timed_entries(layout, matrix, Vector(b, span), increments=increments)
    values = register_entries(timed)
    # The size of the inputs' columns does not matter: the series in A alone converges.
    states = range(layout.n_states)
    rows = ([values[row, c] for c in states if (row, c) in values] for row in states)
    halvings, factor = emit_shortening(b, emit_norm(b, rows))
    for entry in reached:
        value = values.get(divmod(entry, n))
        b.write(vector(0.0) if value is None else b.fmul(value, factor), a, entry)
    for out, left, right in ((second, a, a), (third, second, a), (fourth, second, second)):
        multiply_reached(b, out, left, right, layout)

    def add_terms(base: ir.Value | None, first: int) -> None:
        """Store e = base + sum of A^k / (first + k)! for k = 0..3 (and 4 at the top)."""
        for entry in reached:
            powers = [a, second, third, *([fourth] if base is None else [])]
            diagonal = first > 0 and entry % (n + 1) == 0
            total = vector(1.0 / math.factorial(first) if diagonal else 0.0)
            if base is not None:
                total = b.fadd(total, b.read(base, entry))
            terms = (
                (vector(1.0 / math.factorial(first + k)), b.read(power, entry))
                for k, power in enumerate(powers, start=1)
            )
            b.write(b.add_products(terms, total), e, entry)

    add_terms(None, TAYLOR_DEGREE - 4)
    for first in range(TAYLOR_DEGREE - 8, -1, -4):
        multiply_reached(b, spare, e, fourth, layout)
        add_terms(spare, first)

    with b.loop(b.add(b.largest(halvings), 1), "squarings") as squarings:
        wanted = b.sitofp(halvings, VEC)
        still = b.fcmp_ordered("<", b.splat(b.sitofp(squarings, F64)), wanted)
        multiply_reached(b, spare, e, e, layout)
        for entry in reached:
            now = b.read(e, entry)
            twice = b.fma(vector(2.0), now, b.read(spare, entry))  # (1 + e)^2 - 1
            b.write(b.select(still, twice, now), e, entry)
    for entry in range(0, n * n, n + 1) if beside_one else ():
        b.write(b.fadd(b.read(e, entry), vector(1.0)), e, entry)


def timed_entries(
    layout: Layout, matrix: Sequence[tuple[int, int, Any]], span: Vector, *, increments: bool
) -> dict[tuple[int, int], Any]:
    """Return the entries by place, times the span."""
    entries: dict[tuple[int, int], Any] = {}
    for row, column, value in matrix:
        # Rows below the states stand for increments per step, whatever the step is, or for slopes.
        timed = value if increments and row >= layout.n_states else value * span
        entries[row, column] = entries.get((row, column), 0.0) + timed
    return entries


def emit_norm(b: Builder, rows: Iterable[Sequence[ir.Value]]) -> ir.Value:
    """Return the largest sum of absolute values of a row."""
    norm = vector(0.0)
    for row in rows:
        total = vector(0.0)
        for value in row:
            total = b.fadd(total, b.absolute(value))
        norm = b.select(b.fcmp_unordered(">", total, norm), total, norm)
    return norm


def emit_shortening(b: Builder, norm: ir.Value) -> tuple[ir.Value, ir.Value]:
    """Return how often a matrix with a norm is halved until its series converges, and the factor."""
    halvings = emit_halvings(b, norm, TAYLOR_NORM)
    return halvings, emit_power(b, b.sub(_EXPONENT_BIAS, halvings))


def emit_power(b: Builder, exponent: ir.Value) -> ir.Value:
    """Return two to the power of integers, of which `exponent` is by 1023 larger."""
    return b.bitcast(b.shl(exponent, _MANTISSA_BITS), VEC)


def emit_halvings(b: Builder, norm: ir.Value, bound: float) -> ir.Value:
    """Return the least h >= 0 with norm / 2**h <= `bound`, read off the bits of the quotient."""
    bits = b.bitcast(b.fdiv(norm, vector(bound)), INT_VEC)
    exponent = b.sub(b.lshr(bits, _MANTISSA_BITS), _EXPONENT_BIAS)
    mantissa = b.and_(bits, (1 << _MANTISSA_BITS) - 1)
    above = b.icmp_signed("!=", mantissa, 0)
    least = b.add(exponent, b.zext(above, INT_VEC))
    for end, side in ((0, "<"), (MAX_SQUARINGS, ">")):
        least = b.select(b.icmp_signed(side, least, end), end, least)
    return least


def register_entries(entries: Mapping[tuple[int, int], Vector | float]) -> Registers:
    """Return entries as registers."""
    return {index: register(entry) for index, entry in entries.items()}


@routine
def multiply_reached(
    b: Builder, out: ir.Value, left: ir.Value, right: ir.Value, layout: Layout
) -> None:
    """Store the product of two matrices `(N, N)`, of their entries in reach."""
    n, reach = layout.size, layout.reach
    for i in range(n):
        row = {k: b.read(left, i * n + k) for k in range(n) if reach[i][k]}
        for j in (j for j in range(n) if reach[i][j]):
            terms = [(row[k], b.read(right, k * n + j)) for k in row if reach[k][j]]
            b.write(b.add_products(terms), out, i * n + j)


MAX_SERIES_DEGREE = 12
MAX_SERIES_NORM = 0.25  # largest norm times span that a series is asked for
SERIES_TAIL = 1e-16  # of a truncated series, at the ends of a cell
BALANCING_ROUNDS = 6
MAX_SPAN_HALVINGS = 50  # halvings of a span: below, it is lost in the rounding of a time
MAX_NORM = 1e100  # of norms: a lane beyond has overflown

Use = Callable[[ir.Value, Values, Values], Values]


def rate_entries(layout: Layout) -> list[tuple[int, int]]:
    """Return (row, column) of the entries of A, c and B that the rig has."""
    entries = layout.entries([1.0] * layout.n_numbers)
    return sorted({(row, column) for row, column, _ in entries if row < layout.n_states})


def emit_rates(
    b: Builder,
    layout: Layout,
    matrix: Sequence[tuple[int, int, Any]],
    least: ir.Value,
    out: ir.Value,
) -> ir.Value:
    """Store the entries at `rate_entries`, divided by norm; return norm, not below `least`."""
    entries: dict[tuple[int, int], Vector | float] = {}
    for row, column, value in matrix:
        if row < layout.n_states:
            entries[row, column] = entries.get((row, column), 0.0) + value
    values = register_entries(entries)
    norm = emit_balanced_norm(b, layout.n_states, values)
    fit = b.fcmp_ordered(">", norm, least)
    fit = b.and_(fit, b.fcmp_ordered("<", norm, vector(MAX_NORM)))
    norm = b.select(fit, norm, least)
    over = b.fdiv(vector(1.0), norm)
    for index, entry in enumerate(rate_entries(layout)):
        b.write(b.fmul(values[entry], over), out, index)
    return norm


def emit_balanced_norm(b: Builder, x: int, values: Registers) -> ir.Value:
    """Return the largest row sum of D^-1 |A| D, which is a norm for any scales D > 0 of the states.

    Units of states are of any size; each round takes for D the geometric mean of D and |A| D.
    """
    size = {index: b.absolute(value) for index, value in values.items() if index[1] < x}
    rounds = Loop(b, BALANCING_ROUNDS, [vector(1.0)] * x + [vector(math.inf)], "rounds")
    scales, best = rounds.carried[:x], rounds.carried[x]
    norm, new = vector(0.0), []
    for row in range(x):
        terms = [(size[row, c], scale) for c, scale in enumerate(scales) if (row, c) in size]
        total = b.add_products(terms)
        share = b.fdiv(total, scales[row])
        norm = b.select(b.fcmp_unordered(">", share, norm), share, norm)
        known = b.fcmp_ordered(">", total, vector(0.0))
        new.append(b.select(known, b.root(b.fmul(total, scales[row])), scales[row]))
    best = b.select(b.fcmp_unordered("<", norm, best), norm, best)
    rounds.close([*new, best])
    return best


@dataclass(frozen=True, slots=True)
class Cell:
    """Spans up to the `width` of a cell, halved in each lane until a series is short enough.

    `halvings`: how often (integers); `power`: 2 to that; `half`: 1/2 in lanes without any, whose
    series begins in the middle of a cell, 0 in others; `unit`: norm times the width halved;
    `weights`: 1/k or, beyond the degree of the lane, 0; `count`: largest degree, at least 3;
    `depth`: most halvings.
    """

    halvings: ir.Value
    power: ir.Value
    half: ir.Value
    unit: ir.Value
    weights: ir.Value
    count: ir.Value
    depth: ir.Value


def emit_cell(
    b: Builder, norm: ir.Value, width: ir.Value, weights: ir.Value, *, tail: float = SERIES_TAIL
) -> Cell:
    """Choose halvings and degree of each lane's series, and store its `weights`.

    What the truncated series leaves out at the ends of a cell is about `tail`, relative to the
    state.
    """
    whole = b.fmul(norm, b.splat(width))
    short = b.fcmp_ordered("<=", whole, vector(2 * MAX_SERIES_NORM))
    halvings = b.select(short, 0, emit_halvings(b, whole, MAX_SERIES_NORM))
    deep = b.icmp_signed(">", halvings, MAX_SPAN_HALVINGS)
    halvings = b.select(deep, MAX_SPAN_HALVINGS, halvings)
    power = emit_power(b, b.add(halvings, _EXPONENT_BIAS))
    unit = b.fdiv(whole, power)
    half = b.select(short, vector(0.5), vector(0.0))
    size = b.select(short, b.fmul(unit, vector(0.5)), unit)
    degree = b.select(deep, 0, 1)
    for k in range(1, MAX_SERIES_DEGREE):
        enough = (tail * math.factorial(k + 1)) ** (1 / (k + 1))
        more = b.fcmp_ordered(">", size, vector(enough))
        more = b.and_(more, b.icmp_signed("==", degree, k))
        degree = b.add(degree, b.zext(more, INT_VEC))
    for k in range(1, MAX_SERIES_DEGREE + 1):
        wanted = b.icmp_signed(">=", degree, k)
        b.write(b.select(wanted, vector(1 / k), vector(0.0)), weights, k)
    count = b.largest(b.select(b.icmp_signed(">", degree, 3), degree, 3))
    return Cell(halvings, power, half, unit, weights, count, b.largest(halvings))


def emit_terms(
    b: Builder,
    layout: Layout,
    rates: ir.Value,
    values: tuple[Values, Values, Values],
    over: ir.Value,
    count: ir.Value,
    start: Values,
    use: Use,
) -> Values:
    """Evaluate derivatives of the state, the k-th times `over`**k (one over norm).

    For k = 1 to `count` >= 3, at state, inputs and slopes of inputs (`values`).  `use(k, term,
    carried)` returns what is carried on from `start`.
    """
    state, inputs, slopes = values
    x = layout.n_states
    columns = dict(enumerate(state))
    columns |= {x: vector(1.0)} | {x + 1 + n: value for n, value in enumerate(inputs)}
    term = _emit_rate(b, layout, rates, columns)
    result = use(1, term, start)
    columns = dict(enumerate(term))
    if layout.first_order:
        columns |= {x + 1 + n: b.fmul(value, over) for n, value in enumerate(slopes)}
    term = _emit_rate(b, layout, rates, columns)
    result = use(2, term, result)
    more = Loop(b, b.sub(count, 2), [*term, *result], "terms")
    term = _emit_rate(b, layout, rates, dict(enumerate(more.carried[:x])))
    result = use(b.add(more.index, 3), term, more.carried[x:])
    more.close([*term, *result])
    return result


def _emit_rate(b: Builder, layout: Layout, rates: ir.Value, columns: dict[int, ir.Value]) -> Values:
    """Return sums of products, each added up in two halves to shorten the chain of additions."""
    rate = []
    for row in range(layout.n_states):
        columns_of_row = [(n, c) for n, (r, c) in enumerate(rate_entries(layout)) if r == row]
        terms = [(b.read(rates, n), columns[c]) for n, c in columns_of_row if c in columns]
        halves = [terms[: len(terms) // 2], terms[len(terms) // 2 :]]
        totals = [b.add_products(half[1:], b.fmul(*half[0])) for half in halves if half]
        rate.append(b.fadd(*totals) if len(totals) == 2 else totals[0] if totals else vector(0.0))
    return rate
