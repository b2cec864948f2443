"""The matrix exponential of a model's dynamics over one span of time, for one group of walkers."""

from __future__ import annotations

import math

from llvmlite import ir

from bayesdrill.rig.kernels.lanes import (
    F64,
    I64,
    INT_VEC,
    LANES,
    VEC,
    VECTORS,
    Lane,
    Loop,
    fma,
    function,
    intrinsic,
    load,
    splat,
    store,
    vector,
    whole_numbers,
)
from bayesdrill.rig.kernels.layout import Layout

TAYLOR_DEGREE = 16
TAYLOR_NORM = 0.75  # 0.75**17 / 17! = 2e-17: the truncated series is exact to rounding below it
MOST_HALVINGS = 60

_MANTISSA_BITS = 52
_EXPONENT_BIAS = 1023


def emit_exponential(
    module: ir.Module, layout: Layout, name: str, span: float | None
) -> ir.Function:
    """`name(parameters (P, LANES), e (N, N, LANES))`: e = exp of the augmented matrix over `span`.

    Without a span `name(parameters, spans (LANES,), e)`: each lane has its own, and the columns of
    the increments become those of the inputs' slopes.

    Taylor series of degree 16 in powers of the fourth power, then squarings lane by lane.  Both are
    of e - 1: beside a one, what a slow state does in the shortened span would be lost to rounding
    where another state is very fast.
    """
    product = module.globals.get("product") or _emit_product(module, layout)
    made = function(module, name, 0, [VECTORS] * (2 if span is not None else 3))
    parameters, *spans, e = made.args
    b = ir.IRBuilder(made.append_basic_block())
    duration: Lane | float = Lane(b, load(b, spans[0], 0)) if span is None else span
    n, reach = layout.size, layout.reach
    reached = [i * n + j for i in range(n) for j in range(n) if reach[i][j]]
    scratch = b.alloca(VEC, I64(5 * n * n))
    a, second, third, fourth, spare = (b.gep(scratch, [I64(k * n * n)]) for k in range(5))
    halvings = _emit_scaled_matrix(b, layout, parameters, duration, a)
    for out, left, right in ((second, a, a), (third, second, a), (fourth, second, second)):
        b.call(product, [out, left, right])

    def add_terms(base: ir.Value | None, first: int) -> None:
        """e = base + sum of A^k / (first + k)! for k = 0..3 (and 4 at the top)."""
        for entry in reached:
            terms = list(enumerate((a, second, third), start=1))
            if base is None:
                terms.append((4, fourth))
            diagonal = first > 0 and entry % (n + 1) == 0
            total = vector(1.0 / math.factorial(first) if diagonal else 0.0)
            if base is not None:
                total = b.fadd(total, load(b, base, entry))
            for power, matrix in terms:
                weight = vector(1.0 / math.factorial(first + power))
                total = fma(b, weight, load(b, matrix, entry), total)
            store(b, total, e, entry)

    add_terms(None, TAYLOR_DEGREE - 4)
    for first in range(TAYLOR_DEGREE - 8, -1, -4):
        b.call(product, [spare, e, fourth])
        add_terms(spare, first)

    largest = intrinsic(module, f"llvm.vector.reduce.smax.v{LANES}i64", I64, [INT_VEC])
    squarings = Loop(b, b.add(b.call(largest, [halvings]), I64(1)), [], "squarings")
    wanted = b.sitofp(halvings, VEC)
    still = b.fcmp_ordered("<", splat(b, b.sitofp(squarings.index, F64)), wanted)
    b.call(product, [spare, e, e])
    for entry in reached:
        now = load(b, e, entry)
        twice = fma(b, vector(2.0), now, load(b, spare, entry))  # (1 + e)^2 - 1
        store(b, b.select(still, twice, now), e, entry)
    squarings.close([])
    for entry in range(0, n * n, n + 1):
        store(b, b.fadd(load(b, e, entry), vector(1.0)), e, entry)
    b.ret_void()
    return made


def _emit_scaled_matrix(
    b: ir.IRBuilder, layout: Layout, parameters: ir.Value, span: Lane | float, a: ir.Value
) -> ir.Value:
    """The augmented matrix times `span` into `a`, halved until its series converges: how often."""
    n, x = layout.size, layout.n_states
    lanes = [Lane(b, load(b, parameters, p)) for p in range(layout.n_parameters)]
    matrix: dict[tuple[int, int], Lane | float] = {}
    for row, column, value in layout.entries(lanes):
        # Rows below the states stand for increments per step, whatever the step is, or for slopes.
        timed = value * span if row < x or isinstance(span, Lane) else value
        matrix[row, column] = matrix.get((row, column), 0.0) + timed
    values = {place: _value(entry) for place, entry in matrix.items()}
    # The size of the inputs' columns does not matter: the series in A alone converges.
    absolute = intrinsic(b.module, f"llvm.fabs.v{LANES}f64", VEC, [VEC])
    norm = vector(0.0)
    for row in range(x):
        total = vector(0.0)
        for column in (c for c in range(x) if (row, c) in values):
            total = b.fadd(total, b.call(absolute, [values[row, column]]))
        norm = b.select(b.fcmp_unordered(">", total, norm), total, norm)
    halvings = emit_halvings(b, norm, TAYLOR_NORM)
    exponent = b.sub(whole_numbers(_EXPONENT_BIAS), halvings)
    factor = b.bitcast(b.shl(exponent, whole_numbers(_MANTISSA_BITS)), VEC)
    reach = layout.reach
    for row in range(n):
        for column in (c for c in range(n) if reach[row][c]):
            value = values.get((row, column))
            scaled = vector(0.0) if value is None else b.fmul(value, factor)
            store(b, scaled, a, row * n + column)
    return halvings


def emit_halvings(b: ir.IRBuilder, norm: ir.Value, bound: float) -> ir.Value:
    """The least h >= 0 with norm / 2**h <= `bound`, read off the bits of the quotient."""
    bits = b.bitcast(b.fdiv(norm, vector(bound)), INT_VEC)
    exponent = b.sub(b.lshr(bits, whole_numbers(_MANTISSA_BITS)), whole_numbers(_EXPONENT_BIAS))
    mantissa = b.and_(bits, whole_numbers((1 << _MANTISSA_BITS) - 1))
    above = b.icmp_signed("!=", mantissa, whole_numbers(0))
    least = b.add(exponent, b.zext(above, INT_VEC))
    for limit, side in ((0, "<"), (MOST_HALVINGS, ">")):
        end = whole_numbers(limit)
        least = b.select(b.icmp_signed(side, least, end), end, least)
    return least


def _value(entry: Lane | float) -> ir.Value:
    return entry.value if isinstance(entry, Lane) else vector(float(entry))


def _emit_product(module: ir.Module, layout: Layout) -> ir.Function:
    """out = a b, over the entries in reach."""
    made = function(module, "product", 0, [VECTORS] * 3)
    out, left, right = made.args
    b = ir.IRBuilder(made.append_basic_block())
    n, reach = layout.size, layout.reach
    for i in range(n):
        row = {k: load(b, left, i * n + k) for k in range(n) if reach[i][k]}
        for j in (j for j in range(n) if reach[i][j]):
            total = vector(0.0)
            for k in (k for k in row if reach[k][j]):
                total = fma(b, row[k], load(b, right, k * n + j), total)
            store(b, total, out, i * n + j)
    b.ret_void()
    return made
