"""Compiled kernels: a matrix exponential and a recurrence, eight walkers side by side.

The kernels are written for one problem at a time: the number of states, the entries that can
differ from zero, the channels and the hold of the inputs are constants of the generated code, and
every scalar of the recurrence is a vector of `LANES` walkers that stays in registers over all
samples.  LLVM (through llvmlite) compiles them for the processor at hand in about 0.2 s; no
compiler has to be installed and nothing is cached on disk.

Blocks: matrices `(G, N, N, LANES)`, states `(G, X, LANES)`, for G groups of LANES walkers.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import llvmlite.binding as llvm
import numpy as np
from llvmlite import ir
from numpy.typing import NDArray

LANES = 8
TAYLOR_DEGREE = 16
TAYLOR_NORM = 0.75  # 0.75**17 / 17! = 2e-17: the truncated series is exact to rounding below it

_F64 = ir.DoubleType()
_I64 = ir.IntType(64)
_I32 = ir.IntType(32)
_VEC = ir.VectorType(_F64, LANES)
_PTR = _F64.as_pointer()


@dataclass(frozen=True, slots=True)
class Layout:
    """What the generated code is specialised for.

    `reach[i][j]`: entry (i, j) of the exponential of the N x N matrix can differ from zero.
    Columns of that matrix: X states, one constant input, `n_series` sampled inputs and, with a
    first-order hold, their `n_series` increments.  `channels`: weights `(K, X)`.
    """

    n_states: int
    n_series: int
    first_order: bool
    channels: tuple[tuple[float, ...], ...]
    reach: tuple[tuple[bool, ...], ...]

    @property
    def size(self) -> int:
        return self.n_states + 1 + self.n_series * (2 if self.first_order else 1)


@dataclass(frozen=True, slots=True)
class Kernels:
    """`exponential(G, M, halvings, most, E)`, `misfit(G, T, E, x0, y, u, out)` and `signals(...)`.

    All arguments but counts are addresses of C-contiguous blocks.  `M` comes scaled by
    2**-halvings, `halvings (G, LANES)` as floats, `most (G,)` their largest as int64.
    `misfit` writes `(G, K, LANES)` sums of squares against `y (T, K)`; `signals` writes
    `(G, T, K, LANES)`.  `u` is `(T + 1, n_series)`.
    """

    exponential: Callable[..., None]
    misfit: Callable[..., None]
    signals: Callable[..., None]
    engine: Any  # owns the machine code


def compile_kernels(layout: Layout) -> Kernels:
    module = ir.Module("bayesdrill")
    fma = ir.Function(module, ir.FunctionType(_VEC, [_VEC] * 3), f"llvm.fmuladd.v{LANES}f64")
    _emit_exponential(module, fma, layout)
    _emit_recurrence(module, fma, layout, "misfit", store=False)
    _emit_recurrence(module, fma, layout, "signals", store=True)
    engine = _machine_code(module)
    address = engine.get_function_address
    pointer, count = ctypes.c_void_p, ctypes.c_int64
    return Kernels(
        exponential=ctypes.CFUNCTYPE(None, count, *[pointer] * 4)(address("exponential")),
        misfit=ctypes.CFUNCTYPE(None, count, count, *[pointer] * 5)(address("misfit")),
        signals=ctypes.CFUNCTYPE(None, count, count, *[pointer] * 5)(address("signals")),
        engine=engine,
    )


def _machine_code(module: ir.Module) -> Any:
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    target = llvm.Target.from_default_triple().create_target_machine(
        cpu=llvm.get_host_cpu_name(), features=llvm.get_host_cpu_features().flatten(), opt=3
    )
    parsed = llvm.parse_assembly(str(module))
    parsed.verify()
    options = llvm.create_pipeline_tuning_options(speed_level=2)
    passes = llvm.create_pass_builder(target, options)
    passes.getModulePassManager().run(parsed, passes)
    engine = llvm.create_mcjit_compiler(parsed, target)
    engine.finalize_object()
    return engine


def _vector(value: float) -> ir.Constant:
    return ir.Constant(_VEC, [value] * LANES)


def _load(b: ir.IRBuilder, base: ir.Value, index: int) -> ir.Value:
    place = b.bitcast(b.gep(base, [_I64(index * LANES)]), _VEC.as_pointer())
    return b.load(place, align=8)


def _store(b: ir.IRBuilder, value: ir.Value, base: ir.Value, index: int) -> None:
    place = b.bitcast(b.gep(base, [_I64(index * LANES)]), _VEC.as_pointer())
    b.store(value, place, align=8)


def _splat(b: ir.IRBuilder, scalar: ir.Value) -> ir.Value:
    undefined = ir.Constant(_VEC, ir.Undefined)
    one = b.insert_element(undefined, scalar, _I32(0))
    lanes = ir.Constant(ir.VectorType(_I32, LANES), [0] * LANES)
    return b.shuffle_vector(one, undefined, lanes)


class _Loop:
    """A counted loop (at least one pass) that carries values: read `carried`, then `close`."""

    def __init__(self, b: ir.IRBuilder, count: ir.Value, start: list[ir.Value], name: str) -> None:
        self._b, self._count = b, count
        before = b.block
        self._body = b.append_basic_block(name)
        b.branch(self._body)
        b.position_at_end(self._body)
        self.index = b.phi(_I64)
        self.index.add_incoming(_I64(0), before)
        self.carried = [b.phi(value.type) for value in start]
        for phi, value in zip(self.carried, start, strict=True):
            phi.add_incoming(value, before)

    def close(self, new: list[ir.Value]) -> None:
        b = self._b
        index = b.add(self.index, _I64(1))
        self.index.add_incoming(index, b.block)
        for phi, value in zip(self.carried, new, strict=True):
            phi.add_incoming(value, b.block)
        after = b.append_basic_block("after")
        b.cbranch(b.icmp_signed("<", index, self._count), self._body, after)
        b.position_at_end(after)


def _function(module: ir.Module, name: str, counts: int, pointers: int) -> ir.Function:
    signature = ir.FunctionType(ir.VoidType(), [_I64] * counts + [_PTR] * pointers)
    function = ir.Function(module, signature, name)
    for argument in function.args[counts:]:
        argument.add_attribute("noalias")
    return function


def _emit_product(module: ir.Module, fma: ir.Function, layout: Layout) -> ir.Function:
    """out = a b, over the entries in reach."""
    function = _function(module, "product", 0, 3)
    out, left, right = function.args
    b = ir.IRBuilder(function.append_basic_block())
    n, reach = layout.size, layout.reach
    for i in range(n):
        row = {k: _load(b, left, i * n + k) for k in range(n) if reach[i][k]}
        for j in (j for j in range(n) if reach[i][j]):
            total = _vector(0.0)
            for k in (k for k in row if reach[k][j]):
                total = b.call(fma, [row[k], _load(b, right, k * n + j), total])
            _store(b, total, out, i * n + j)
    b.ret_void()
    return function


def _emit_exponential(module: ir.Module, fma: ir.Function, layout: Layout) -> None:
    """Taylor series of degree 16 in powers of the fourth power, then squarings lane by lane."""
    product = _emit_product(module, fma, layout)
    function = _function(module, "exponential", 1, 4)
    n_groups, matrices, halvings, most, results = function.args
    b = ir.IRBuilder(function.append_basic_block())
    n = layout.size
    reached = [i * n + j for i in range(n) for j in range(n) if layout.reach[i][j]]
    scratch = b.alloca(_F64, _I64(4 * n * n * LANES))
    scratch.align = 64
    powers = [b.gep(scratch, [_I64(k * n * n * LANES)]) for k in range(4)]
    groups = _Loop(b, n_groups, [], "groups")
    offset = b.mul(groups.index, _I64(n * n * LANES))
    a, e = b.gep(matrices, [offset]), b.gep(results, [offset])
    second, third, fourth, spare = powers
    for out, left, right in ((second, a, a), (third, second, a), (fourth, second, second)):
        b.call(product, [out, left, right])

    def add_terms(base: ir.Value | None, first: int) -> None:
        """e = base + sum of A^k / (first + k)! for k = 0..3 (and 4 at the top)."""
        for entry in reached:
            terms = list(enumerate((a, second, third), start=1))
            if base is None:
                terms.append((4, fourth))
            start = 1.0 / math.factorial(first) if entry % (n + 1) == 0 else 0.0
            total = _vector(start)
            if base is not None:
                total = b.fadd(total, _load(b, base, entry))
            for power, matrix in terms:
                weight = _vector(1.0 / math.factorial(first + power))
                total = b.call(fma, [weight, _load(b, matrix, entry), total])
            _store(b, total, e, entry)

    add_terms(None, TAYLOR_DEGREE - 4)
    for first in range(TAYLOR_DEGREE - 8, -1, -4):
        b.call(product, [spare, e, fourth])
        add_terms(spare, first)

    wanted = _load(b, b.gep(halvings, [b.mul(groups.index, _I64(LANES))]), 0)
    count = b.load(b.gep(b.bitcast(most, _I64.as_pointer()), [groups.index]))
    squarings = _Loop(b, b.add(count, _I64(1)), [], "squarings")
    still = b.fcmp_ordered("<", _splat(b, b.sitofp(squarings.index, _F64)), wanted)
    b.call(product, [spare, e, e])
    for entry in reached:
        _store(b, b.select(still, _load(b, spare, entry), _load(b, e, entry)), e, entry)
    squarings.close([])
    groups.close([])
    b.ret_void()


def _emit_recurrence(
    module: ir.Module, fma: ir.Function, layout: Layout, name: str, *, store: bool
) -> None:
    """x(k + 1) = Phi x(k) + g + G0 u(k) + G1 (u(k + 1) - u(k)), and what is made of x(k)."""
    function = _function(module, name, 2, 5)
    n_groups, n_samples, exponentials, starts, y, u, out = function.args
    b = ir.IRBuilder(function.append_basic_block())
    n, x_count, s_count = layout.size, layout.n_states, layout.n_series
    channels = layout.channels
    groups = _Loop(b, n_groups, [], "groups")
    e = b.gep(exponentials, [b.mul(groups.index, _I64(n * n * LANES))])
    start = b.gep(starts, [b.mul(groups.index, _I64(x_count * LANES))])
    sums = b.gep(out, [b.mul(groups.index, _I64(len(channels) * LANES))])
    phi = {
        (i, j): _load(b, e, i * n + j)
        for i in range(x_count)
        for j in range(n)
        if layout.reach[i][j]
    }
    state = [_load(b, start, i) for i in range(x_count)]
    totals = [] if store else [_vector(0.0)] * len(channels)
    samples = _Loop(b, n_samples, state + totals, "samples")
    state, totals = samples.carried[:x_count], samples.carried[x_count:]

    def series(row: ir.Value, s: int) -> ir.Value:
        return b.load(b.gep(u, [b.add(b.mul(row, _I64(s_count)), _I64(s))]))

    drive = [series(samples.index, s) for s in range(s_count)]
    if layout.first_order:
        following = b.add(samples.index, _I64(1))
        drive += [b.fsub(series(following, s), drive[s]) for s in range(s_count)]
    drive = [_splat(b, value) for value in drive]

    new_totals = []
    for k, weights in enumerate(channels):
        flat = b.add(b.mul(samples.index, _I64(len(channels))), _I64(k))
        value = _vector(0.0) if store else _splat(b, b.load(b.gep(y, [flat])))
        for weight, x in zip(weights, state, strict=True):
            if weight == 0.0:
                continue
            value = b.call(fma, [_vector(weight if store else -weight), x, value])
        if store:
            row = b.add(b.mul(groups.index, b.mul(n_samples, _I64(len(channels)))), flat)
            _store(b, value, b.gep(out, [b.mul(row, _I64(LANES))]), 0)
        else:
            new_totals.append(b.call(fma, [value, value, totals[k]]))

    new_state = []
    for i in range(x_count):
        total = phi.get((i, x_count), _vector(0.0))
        for j, value in [*enumerate(state), *enumerate(drive, start=x_count + 1)]:
            if (i, j) in phi:
                total = b.call(fma, [phi[i, j], value, total])
        new_state.append(total)
    samples.close(new_state + new_totals)
    for k, total in enumerate(new_totals):
        _store(b, total, sums, k)
    groups.close([])
    b.ret_void()


def reach_of(pattern: NDArray[np.bool_]) -> tuple[tuple[bool, ...], ...]:
    """Entries of exp(M) that can differ from zero, for M with the `pattern (N, N)`."""
    reach = pattern | np.eye(len(pattern), dtype=bool)
    for _ in range(len(pattern)):
        reach = reach | (reach.astype(int) @ reach.astype(int) > 0)
    return tuple(tuple(bool(entry) for entry in row) for row in reach)
