"""Define the layout of a rig's matrix M, and compute the exponential exp(M h) over a time span h.

Kernels are specialised for the layout. The layout does not contain an experiment's step, start,
constant inputs and channel weights, which are arguments of kernels. So experiments with the same
layout share code.  Each lane of a vector is one walker, which is a set of parameters.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np
from llvmlite import ir
from numpy.typing import NDArray

from bayesdrill.basics.duals import Dual, dual
from bayesdrill.rig.kernels.lanes import (
    F64,
    INT_VEC,
    VEC,
    Builder,
    IndexTable,
    Loop,
    Vector,
    constant_table,
    register,
    routine,
    vector,
)
from bayesdrill.rig.kernels.numbers import (
    Blocks,
    Number,
    Numbers,
    dot,
    multiply_large,
    sum_products,
)
from bayesdrill.rig.models.linear import Model

Entries = Callable[[Sequence[Any]], Sequence[tuple[int, int, Any]]]
Pattern = tuple[tuple[bool, ...], ...]
Registers = dict[tuple[int, int], ir.Value]  # entries by (row, column)
MOST_WRITTEN_OUT = 10  # largest number of states for which matrix products are unrolled


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """The layout describes the augmented N x N matrix of a rig, for which kernels are specialised.

    `entries(numbers)` returns (row, column, value) of the entries; values of one entry are added.
    The numbers are `n_parameters` parameters, then `n_constants` constant inputs. The columns are X
    states, the constant 1, `n_series` sampled inputs and, for a first-order hold, their time slopes.
    """

    n_parameters: int
    n_constants: int
    n_states: int
    n_series: int
    first_order: bool
    entries: Entries

    @classmethod
    def from_model(
        cls, model: Model, series: tuple[str, ...], constant: tuple[str, ...], *, first_order: bool
    ) -> Layout:
        """Build the layout of a rig with sampled inputs `series`, and non-zero `constant` inputs."""
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
        sizes = (self.n_parameters, self.n_states, self.n_series, self.first_order)
        return f"{sizes} {formulas(self.n_numbers, self.entries)}"

    @property
    def n_numbers(self) -> int:
        """Return the number of arguments of `entries`."""
        return self.n_parameters + self.n_constants

    @property
    def size(self) -> int:
        """Return the number N of rows and columns."""
        return self.n_states + 1 + self.n_series * (2 if self.first_order else 1)

    @property
    def large(self) -> bool:
        """Return whether matrix products are loops, because unrolled code would compile for minutes."""
        return self.n_states > MOST_WRITTEN_OUT

    @property
    def reachable(self) -> Pattern:
        """Return which entries `(N, N)` of the exponential can differ from zero."""
        reach = self._pattern | np.eye(self.size, dtype=bool)
        for _ in range(self.size):
            reach = reach | (reach.astype(int) @ reach.astype(int) > 0)
        return tuple(map(tuple, reach.tolist()))

    @property
    def is_zero_column(self) -> tuple[bool, ...]:
        """Return which columns are zero; the diagonal of the exponential is 1 in such a column."""
        return tuple(not column for column in self._pattern.any(axis=0))

    @property
    def _pattern(self) -> NDArray[np.bool_]:
        pattern = np.zeros((self.size, self.size), dtype=bool)
        for row, column, _ in self.entries([1.0] * self.n_numbers):
            pattern[row, column] = True
        return pattern

    def matrix(
        self, b: Builder, constants: ir.Value, *parameters: ir.Value
    ) -> Sequence[tuple[int, int, Any]]:
        """Return the entries at constant inputs `(C,)` and parameters `(P,)`, given by addresses.

        `parameters` are the addresses of the parameters' values and, if wanted, of their derivatives.
        """
        numbers = map(Blocks(b, parameters).get, range(self.n_parameters))
        return self.entries([*numbers, *(number(b, constants, c) for c in range(self.n_constants))])


def number(b: Builder, base: ir.Value, index: int) -> Vector:
    """Load a number from a block of single numbers into all lanes."""
    return Vector(b, b.shared(base, index))


def addresses(
    b: Builder, block: ir.Value, group: ir.Value, sizes: Mapping[str, int]
) -> dict[str, ir.Value]:
    """Return the addresses of a group's consecutive parts, whose numbers of vectors are `sizes`."""
    starts, start = {}, b.offset(block, b.mul(group, sum(sizes.values())))
    for name, size in sizes.items():
        starts[name], start = start, b.offset(start, size)
    return starts


@dataclass(frozen=True, slots=True)
class AugmentedMatrix:
    """A call returns the entries of the augmented matrix of a rig, see `Layout`.

    `driven` names the columns after that of the constant 1. The column `v slope` is the time
    derivative or the increment of the input `v`. `constant` names the non-zero constant inputs.
    """

    model: Model
    driven: tuple[str, ...]
    constant: tuple[str, ...]

    def __call__(self, numbers: Sequence[Any]) -> list[tuple[int, int, Any]]:
        """Return the entries as (row, column, value)."""
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
    """Return the columns of sampled inputs and, with a first-order hold, of their time slopes."""
    return (*series, *(f"{name} slope" for name in series)) if first_order else tuple(series)


def present(constant: Mapping[str, float]) -> dict[str, float]:
    """Return the constant inputs that are not zero; the matrix has no entries for the others."""
    return {name: value for name, value in constant.items() if value != 0.0}


def formulas(count: int, evaluate: Callable[[Sequence[Vector]], Any]) -> str:
    """Return a text with the code of formulas of `count` numbers, and the names of their results.

    Equal formulas have equal texts, wherever they are defined.
    """
    kind = ir.FunctionType(ir.VoidType(), [VEC] * count)
    function = ir.Function(ir.Module(), kind, "formulas")
    b = Builder(function.append_basic_block())
    result = evaluate([Vector(b, argument) for argument in function.args])
    return f"{function}{_described(result)}"


def _described(result: Any) -> str:
    """Write numbers by their names in the code, and containers by their contents."""
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
TAYLOR_NORM = 0.75  # largest norm for the series: its remainder is 0.75**17 / 17! = 2e-17
MAX_SQUARINGS = 60

BALANCING_ROUNDS = 6  # iterations of `emit_balanced_norm`

_MANTISSA_BITS = 52
_EXPONENT_BIAS = 1023


@routine
def store_exponential(
    b: Builder,
    e: ir.Value,
    constants: ir.Value,
    layout: Layout,
    *numbers: ir.Value,
    increments: bool,
    beside_one: bool = True,
) -> None:
    """Store the exponential e `(N, N)` of the augmented matrix; each lane has its own span.

    `numbers` are the address of parameters `(P,)` and the span. If e shall have a derivative, the
    address of the parameters' derivatives and the span's derivative follow. With `increments`, the last
    columns belong to the increments of inputs over the span, else to their time derivatives.
    `beside_one=False` stores e - 1, which keeps more digits for short spans.

    The method is scaling and squaring (Moler and Van Loan 2003): a Taylor series of degree 16, then
    as many squarings as each lane needs. Both compute e - 1: if one state is very fast, the span of
    the series is short, and adding 1 would round off the small change of a slow state.
    """
    parameters, span, *changes = numbers
    memory, n = Numbers(b, bool(changes)), layout.size
    (length,) = memory.shaped([span, *changes[1:]])
    values: dict[tuple[int, int], Number] = {}
    for row, column, value in layout.matrix(b, constants, parameters, *changes[:1]):
        # With increments, the rows of inputs are the same for all spans.
        timed = value if increments and row >= layout.n_states else value * length
        values[row, column] = values.get((row, column), 0.0) + timed
    # The norm of the block A of states is enough: the series of M converges if that of A does.
    plain, states = value_registers(values), range(layout.n_states)
    if layout.large:  # balancing saves squarings, which take long for large matrices
        norm = emit_balanced_norm(b, layout.n_states, plain)
    else:
        norm = emit_norm(b, ([plain[r, c] for c in states if (r, c) in plain] for r in states))
    halvings = emit_halvings(b, norm, TAYLOR_NORM)
    factor = Vector(b, emit_power(b, b.sub(_EXPONENT_BIAS, halvings)))
    short = {place: value * factor for place, value in values.items()}
    # Reachable entries are added in loops: unrolled code would double the time to compile.
    places = np.flatnonzero(np.repeat(np.array(layout.reachable), memory.width))
    reached = constant_table(b.module, places.tolist())
    memory.clear(e, n * n)
    if layout.large:
        _sum_sparse_series(b, e, short, n, memory)
    else:
        _sum_series(b, e, short, layout, memory, reached)
    spare, most = memory.room(n * n), b.largest(halvings)
    with b.if_then(b.icmp_signed(">", most, 0)), b.loop(most, "squarings") as squarings:
        wanted = b.sitofp(halvings, VEC)
        still = b.fcmp_ordered("<", b.splat(b.sitofp(squarings, F64)), wanted)
        multiply_reached(b, spare, e, e, layout, slopes=memory.slopes)
        with reached.loop(b) as place:
            now = b.read(e, place)
            twice = b.fma(vector(2.0), now, b.read(spare, place))
            b.write(b.select(still, twice, now), e, place)  # (1 + e)^2 - 1
    if beside_one:
        _add_to_diagonal(b, e, 1.0, n, memory)


def _sum_series(
    b: Builder,
    e: ir.Value,
    short: Mapping[tuple[int, int], Number],
    layout: Layout,
    memory: Numbers,
    reached: IndexTable,
) -> None:
    """Store the Taylor series of a matrix A with the entries `short`, as a polynomial in A^4."""
    n, slopes = layout.size, memory.slopes
    a, second, third, fourth, spare = (memory.room(n * n) for _ in range(5))
    memory.clear(a, n * n)
    for (row, column), value in short.items():
        memory.put(value, a, row * n + column)
    for out, left, right in ((second, a, a), (third, second, a), (fourth, second, second)):
        multiply_reached(b, out, left, right, layout, slopes=slopes)

    def add_terms(base: ir.Value, first: int, powers: Sequence[ir.Value]) -> None:
        """Store e = base + 1 / first! + sum A^k / (first + k)!, with the `powers` A, A^2, ..."""
        if first > 0:
            _add_to_diagonal(b, base, 1.0 / math.factorial(first), n, memory)
        with reached.loop(b) as place:
            total = b.read(base, place)
            for k, power in enumerate(powers, start=1):
                weight = vector(1.0 / math.factorial(first + k))
                total = b.fma(weight, b.read(power, place), total)
            b.write(total, e, place)

    add_terms(e, TAYLOR_DEGREE - 4, (a, second, third, fourth))
    for first in range(TAYLOR_DEGREE - 8, -1, -4):
        multiply_reached(b, spare, e, fourth, layout, slopes=slopes)
        add_terms(spare, first, (a, second, third))


def _sum_sparse_series(
    b: Builder, e: ir.Value, short: Mapping[tuple[int, int], Number], n: int, memory: Numbers
) -> None:
    """Store A (1 + A/2 (1 + A/3 (...))) by columns, where `short` has the few entries of A."""
    with b.loop(TAYLOR_DEGREE, "terms") as term:
        order = b.sitofp(b.sub(TAYLOR_DEGREE, term), F64)
        over = Vector(b, b.splat(b.fdiv(F64(1.0), order)))
        _add_to_diagonal(b, e, 1.0, n, memory)
        with b.loop(n, "columns") as column:
            at = memory.at(e, column)
            old = [memory.get(at, row * n) for row in range(n)]
            for row in range(n):
                terms = [(value, old[c]) for (r, c), value in short.items() if r == row]
                memory.put(sum_products(memory.zero(), terms) * over, at, row * n)


def _add_to_diagonal(b: Builder, block: ir.Value, number: float, n: int, memory: Numbers) -> None:
    """Add a number to the diagonal of a matrix `(n, n)`."""
    with b.loop(n, "diagonal") as row:
        at = memory.at(block, b.mul(row, n + 1))
        memory.put(memory.get(at, 0) + number, at, 0)


def emit_norm(b: Builder, rows: Iterable[Sequence[ir.Value]]) -> ir.Value:
    """Return the largest row sum of absolute values."""
    norm = vector(0.0)
    for row in rows:
        total = vector(0.0)
        for value in row:
            total = b.fadd(total, b.absolute(value))
        norm = b.select(b.fcmp_unordered(">", total, norm), total, norm)
    return norm


def emit_power(b: Builder, exponent: ir.Value) -> ir.Value:
    """Return 2^(exponent - 1023) for integers `exponent` in all lanes."""
    return b.bitcast(b.shl(exponent, _MANTISSA_BITS), VEC)


def emit_halvings(b: Builder, norm: ir.Value, bound: float) -> ir.Value:
    """Return the smallest h from 0 to 60 with norm / 2**h <= `bound`, by the bits of norm / bound."""
    bits = b.bitcast(b.fdiv(norm, vector(bound)), INT_VEC)
    exponent = b.sub(b.lshr(bits, _MANTISSA_BITS), _EXPONENT_BIAS)
    mantissa = b.and_(bits, (1 << _MANTISSA_BITS) - 1)
    above = b.icmp_signed("!=", mantissa, 0)
    least = b.add(exponent, b.zext(above, INT_VEC))
    for end, side in ((0, "<"), (MAX_SQUARINGS, ">")):
        least = b.select(b.icmp_signed(side, least, end), end, least)
    return least


def value_registers(entries: Mapping[tuple[int, int], Number]) -> Registers:
    """Return the values of entries as registers."""
    return {index: register(dual(entry).value) for index, entry in entries.items()}


@routine
def multiply_reached(
    b: Builder,
    out: ir.Value,
    left: ir.Value,
    right: ir.Value,
    layout: Layout,
    *,
    slopes: bool = False,
) -> None:
    """Store the product of two matrices `(N, N)`, only in entries that are `Layout.reachable`."""
    n, reach, memory = layout.size, layout.reachable, Numbers(b, slopes)
    if layout.large:
        multiply_large(b, out, left, right, (n, n, n), slopes=slopes)
        return
    for reached, rows in groupby(range(n), key=lambda i: reach[i]):
        first, *others = rows
        columns = [k for k in range(n) if reached[k]]
        with b.loop(1 + len(others), "rows") as i:
            start = b.mul(b.add(i, first), n)
            begin, into = (memory.at(base, start) for base in (left, out))
            row = {k: memory.get(begin, k) for k in columns}
            for j in columns:
                terms = [(row[k], memory.get(right, k * n + j)) for k in columns if reach[k][j]]
                memory.put(dot(*zip(*terms, strict=True)), into, j)


def emit_balanced_norm(b: Builder, x: int, values: Registers) -> ir.Value:
    """Return the largest row sum of D^-1 |A| D, a norm of A for any diagonal D > 0.

    D scales the states, whose units differ. Each iteration replaces the diagonal d of D by the
    geometric mean of d and |A| d; the smallest norm is returned.
    """
    size = {index: b.absolute(value) for index, value in values.items() if index[1] < x}
    rounds = Loop(b, BALANCING_ROUNDS, [vector(1.0)] * x + [vector(math.inf)], "rounds")
    scales, best = rounds.carried[:x], rounds.carried[x]
    norm, new = vector(0.0), []
    for row in range(x):
        terms = [(size[row, c], scale) for c, scale in enumerate(scales) if (row, c) in size]
        total = b.add_products(terms)
        row_sum = b.fdiv(total, scales[row])
        norm = b.select(b.fcmp_unordered(">", row_sum, norm), row_sum, norm)
        known = b.fcmp_ordered(">", total, vector(0.0))
        new.append(b.select(known, b.root(b.fmul(total, scales[row])), scales[row]))
    best = b.select(b.fcmp_unordered("<", norm, best), norm, best)
    rounds.close([*new, best])
    return best
