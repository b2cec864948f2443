"""What white noise does to the states of a rig in a step: the transition, and the covariance of it.

    Phi = exp(F h)      Q = q int exp(F s) g g' exp(F s)' ds  from 0 to h

Over a step that is halved until a Taylor series is short; there Q is a Gauss-Legendre sum of
squares.  Then Phi -> Phi Phi and Q -> Q + Phi Q Phi', as often as it was halved.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from llvmlite import ir

from bayesdrill.basics.duals import dual
from bayesdrill.rig.kernels.exponential import emit_halvings
from bayesdrill.rig.kernels.gathering import largest, splat_whole
from bayesdrill.rig.kernels.lanes import (
    F64,
    I64,
    LANES,
    VEC,
    VECTORS,
    Lane,
    Loop,
    function,
    intrinsic,
    load,
    splat,
    store,
    vector,
    whole_numbers,
)
from bayesdrill.rig.kernels.matrices import Memory, emit_copy, emit_even, emit_product
from bayesdrill.rig.kernels.numbers import Number, fused
from bayesdrill.rig.missing_torque import TIME, Pushed

DEGREE = 13
NORM = 0.5  # 0.5**14 / 14! = 7e-16
NODES = 9  # exact up to powers of 17


@dataclass(frozen=True, slots=True)
class Noisy:
    """A rig with its torque: what kernels are specialised for.

    `channels`: weights `(K, n)` of states, those of the torque last.
    """

    model: Pushed
    channels: tuple[tuple[float, ...], ...]

    @property
    def n(self) -> int:
        return len(self.model.states)

    @property
    def p(self) -> int:
        return len(self.model.parameters)

    @property
    def k(self) -> int:
        return len(self.channels)

    @property
    def own(self) -> int:
        """States of the torque."""
        return len(self.model.torque.states)

    def seen(self, k: int) -> dict[int, float]:
        """States of which channel k tells, with their weights."""
        return {i: weight for i, weight in enumerate(self.channels[k]) if weight != 0.0}


def emit_spread(module: ir.Module, noisy: Noisy, *, slopes: bool) -> ir.Function:
    """`spread(parameters (P,), span, phi (n, n), q (n, n))`, of numbers, with slopes or without.

    `span`: one vector, a length of time of each lane.
    """
    n = noisy.n
    multiply = emit_product(module, (n, n, n), slopes=slopes)
    turned = emit_even(module, n, adds=True, slopes=slopes)
    made = function(module, "spread_d" if slopes else "spread", 0, [VECTORS] * 4)
    parameters, span, phi, q = made.args
    b = ir.IRBuilder(made.append_basic_block())
    memory = Memory(b, slopes)
    named = dict(zip(noisy.model.parameters, memory.row(parameters, noisy.p), strict=True))
    entries = _entries(noisy, named)
    halvings = _halvings(b, entries, n, load(b, span, 0))
    exponent = b.shl(b.sub(whole_numbers(1023), splat_whole(b, halvings)), whole_numbers(52))
    short = Lane(b, b.fmul(load(b, span, 0), b.bitcast(exponent, VEC)))
    timed = {place: entry * short for place, entry in entries.items()}
    _emit_series(memory, timed, n, phi)
    driven = noisy.model.torque.driven(named[TIME]) * short
    _emit_squares(memory, timed, n, q, driven)
    spare, other = memory.room(n * n), memory.room(n * n)
    twice = Loop(b, halvings, [], "twice")
    b.call(multiply, [spare, phi, q])
    b.call(turned, [q, spare, phi])
    b.call(multiply, [other, phi, phi])
    emit_copy(b, other, phi, n * n * memory.width)
    twice.close([])
    b.ret_void()
    return made


def _entries(noisy: Noisy, named: dict[str, Number]) -> dict[tuple[int, int], Number]:
    states = noisy.model.states
    linear = noisy.model.linear(named)
    return {(states.index(r), states.index(c)): value for (r, c), value in linear.A.items()}


def _halvings(
    b: ir.IRBuilder, entries: dict[tuple[int, int], Number], n: int, span: ir.Value
) -> ir.Value:
    """At least one, the same of all lanes."""
    absolute = intrinsic(b.module, f"llvm.fabs.v{LANES}f64", VEC, [VEC])
    norm = vector(0.0)
    for row in range(n):
        total = vector(0.0)
        for entry in (value for (i, _), value in entries.items() if i == row):
            value = dual(entry).value
            known = value.value if isinstance(value, Lane) else vector(float(value))
            total = b.fadd(total, b.call(absolute, [known]))
        norm = b.select(b.fcmp_unordered(">", total, norm), total, norm)
    most = largest(b, emit_halvings(b, b.fmul(norm, span), NORM))
    return b.select(b.icmp_signed(">", most, I64(1)), most, I64(1))


def _moved(
    entries: dict[tuple[int, int], Number], n: int, vector_: list[Number], times: Number
) -> list[Number]:
    found: list[Number] = []
    for i in range(n):
        total: Number = None
        for (row, column), entry in entries.items():
            if row == i:
                total = fused(entry, vector_[column], total)
        found.append(0.0 if total is None else total * times)
    return found


def _emit_series(
    memory: Memory, timed: dict[tuple[int, int], Number], n: int, phi: ir.Value
) -> None:
    """exp of what is timed, a column at a time."""
    b = memory.b
    memory.clear(phi, n * n)
    for i in range(n):
        memory.put(1.0, phi, i * n + i)
    term = memory.room(n)
    columns = Loop(b, I64(n), [], "columns")
    top = memory.at(phi, columns.index)
    for i in range(n):
        memory.put(memory.get(top, i * n), term, i)
    orders = Loop(b, I64(DEGREE), [], "orders")
    for i, value in enumerate(_moved(timed, n, memory.row(term, n), _over(b, orders.index))):
        memory.put(value, term, i)
        memory.put(memory.get(top, i * n) + value, top, i * n)
    orders.close([])
    columns.close([])


def _over(b: ir.IRBuilder, index: ir.Value) -> Lane:
    """One over the number after."""
    number = b.sitofp(b.add(index, I64(1)), F64)
    return Lane(b, splat(b, b.fdiv(ir.Constant(F64, 1.0), number)))


def _emit_squares(
    memory: Memory, timed: dict[tuple[int, int], Number], n: int, q: ir.Value, driven: Number
) -> None:
    """`driven` times the integral over 0 to 1."""
    b = memory.b
    terms = memory.room((DEGREE + 1) * n)
    for i in range(n):
        memory.put(1.0 if i == n - 1 else 0.0, terms, i)
    orders = Loop(b, I64(DEGREE), [], "orders")
    here = memory.at(terms, b.mul(orders.index, I64(n)))
    for i, value in enumerate(_moved(timed, n, memory.row(here, n), _over(b, orders.index))):
        memory.put(value, here, n + i)
    orders.close([])
    memory.clear(q, n * n)
    nodes, weights = _gauss()
    table = b.alloca(VEC, I64(2 * NODES))
    for k, (node, weight) in enumerate(zip(nodes, weights, strict=True)):
        store(b, vector(float(node)), table, 2 * k)
        store(b, vector(float(weight)), table, 2 * k + 1)
    each = Loop(b, I64(NODES), [], "nodes")
    row = b.gep(table, [b.mul(each.index, I64(2))])
    node, weight = Lane(b, load(b, row, 0)), Lane(b, load(b, row, 1))
    point = [memory.get(terms, DEGREE * n + i) for i in range(n)]
    for order in range(DEGREE - 1, -1, -1):
        point = [fused(one, node, memory.get(terms, order * n + i)) for i, one in enumerate(point)]
    for i in range(n):
        scaled = point[i] * weight * driven
        for j in range(n):
            memory.put(fused(scaled, point[j], memory.get(q, i * n + j)), q, i * n + j)
    each.close([])


def _gauss() -> tuple[np.ndarray, np.ndarray]:
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    return 0.5 * (nodes + 1.0), 0.5 * weights
