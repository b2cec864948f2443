"""The steps of a Kalman filter: the transition with its process noise, update and prediction.

Over a step h, the state-space model x' = F x + g w with white noise w of intensity q has

    Phi = exp(F h)      Q = q int exp(F s) g g' exp(F s)' ds  from 0 to h

(Van Loan 1978).  h is halved until a Taylor series is short; there Q is a Gauss-Legendre sum of squares.
Then Phi -> Phi Phi and Q -> Q + Phi Q Phi', as often as it was halved.

Channels of a sample are taken one after the other, so that only numbers are divided by (Anderson and
Moore 1979, section 6.4): with the innovation e = y - c x, its variance S = c P c' + R and the gain
k = P c' / S,

    update       x <- x + k e       P <- P - k c P
    prediction   x <- Phi x         P <- Phi P Phi' + Q
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from llvmlite import ir

from bayesdrill.basics.duals import Dual, dual
from bayesdrill.rig.kernels.exponential import emit_halvings
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
    largest,
    load,
    splat,
    store,
    vector,
    whole_numbers,
)
from bayesdrill.rig.kernels.layout import Kinds, formulas, weights_of
from bayesdrill.rig.kernels.numbers import (
    Memory,
    Number,
    dot,
    emit_copy,
    emit_even,
    emit_product,
    fused,
    root,
)
from bayesdrill.rig.models.latent_torque import TIME, Pushed

DEGREE = 13
NORM = 0.5  # 0.5**14 / 14! = 7e-16
NODES = 9  # exact up to powers of 17


@dataclass(frozen=True, slots=True)
class StateSpace:
    """A rig with its torque: what kernels are specialised for.

    `channels (K, n)`: weights of states, those of the torque last, see `weight_kinds`.
    """

    model: Pushed
    channels: Kinds

    @property
    def text(self) -> str:
        """See `Structure`."""
        return f"{self.n} {self.own} {self.channels} {formulas(self.p, self._formulas)}"

    def _formulas(self, lanes: Sequence[Lane]) -> Any:
        """Of the model: its dynamics, and what drives its torque; they have slopes where kernels do."""
        named: Any = dict(zip(self.model.parameters, lanes, strict=True))
        return _entries(self, named), self.model.torque.driven(named[TIME])

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

    def seen(self, k: int) -> list[int]:
        """States of which channel k tells."""
        return [i for i, kind in enumerate(self.channels[k]) if kind != 0]

    def weights(self, b: ir.IRBuilder, weights: ir.Value, k: int) -> dict[int, Lane]:
        """Of channel k, by state, from the block of all `weights (K, n)`."""
        return weights_of(b, weights, self.channels, k)


def emit_transition(module: ir.Module, system: StateSpace, *, slopes: bool) -> ir.Function:
    """`transition(parameters (P,), span, phi (n, n), q (n, n))`: Phi, and Q of the process noise, of
    numbers with slopes or without.

    `span`: one vector, a length of time of each lane.
    """
    n = system.n
    multiply = emit_product(module, (n, n, n), slopes=slopes)
    turned = emit_even(module, n, adds=True, slopes=slopes)
    made = function(module, "transition_d" if slopes else "transition", 0, [VECTORS] * 4)
    parameters, span, phi, q = made.args
    b = ir.IRBuilder(made.append_basic_block())
    memory = Memory(b, slopes)
    named = dict(zip(system.model.parameters, memory.row(parameters, system.p), strict=True))
    entries = _entries(system, named)
    halvings = _halvings(b, entries, n, load(b, span, 0))
    exponent = b.shl(b.sub(whole_numbers(1023), splat(b, halvings)), whole_numbers(52))
    short = Lane(b, b.fmul(load(b, span, 0), b.bitcast(exponent, VEC)))
    timed = {place: entry * short for place, entry in entries.items()}
    _emit_series(memory, timed, n, phi)
    driven = system.model.torque.driven(named[TIME]) * short
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


def _entries(system: StateSpace, named: dict[str, Number]) -> dict[tuple[int, int], Number]:
    states = system.model.states
    linear = system.model.linear(named)
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
    """The integral over 0 to 1, times the intensity `driven`."""
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


def gain_width(n: int) -> int:
    """Numbers that `update_covariance` leaves of a channel: the gain (n,), the variance of what it
    shows, and the root of one over it.
    """
    return n + 2


def update_covariance(
    memory: Memory,
    system: StateSpace,
    k: int,
    p: ir.Value,
    variances: ir.Value,
    gains: ir.Value,
    weights: ir.Value,
    is_seen: Number = 1.0,
) -> None:
    """Write the gain of channel k into `gains (K, gain_width)`, and update the covariance p (n, n)."""
    n, own = system.n, system.weights(memory.b, weights, k)
    c = list(own.values())
    shown = [dot(c, [memory.get(p, i * n + j) for j in own]) for i in range(n)]
    variance = dot(c, [shown[j] for j in own], memory.get(variances, k))
    over = is_seen / variance
    gain = [one * over for one in shown]
    for i in range(n):
        for j in range(n):
            memory.put(fused(-gain[i], shown[j], memory.get(p, i * n + j)), p, i * n + j)
    at = k * gain_width(n)
    for i, one in enumerate(gain):
        memory.put(one, gains, at + i)
    memory.put(variance * is_seen + (1.0 - is_seen), gains, at + n)
    memory.put(_root(memory.b, over), gains, at + n + 1)


def update_state(
    memory: Memory,
    system: StateSpace,
    k: int,
    state: Sequence[Number],
    y: Number,
    gains: ir.Value,
    weights: ir.Value,
) -> tuple[Number, list[Number]]:
    """Return the innovation of channel k, and the updated state."""
    n = system.n
    innovation = y
    for i, weight in system.weights(memory.b, weights, k).items():
        innovation = fused(-weight, state[i], innovation)
    gain = [memory.get(gains, k * gain_width(n) + i) for i in range(n)]
    return innovation, [fused(one, innovation, x) for one, x in zip(gain, state, strict=True)]


def predict_covariance(memory: Memory, n: int, p: ir.Value, phi: ir.Value, q: ir.Value) -> None:
    """p = phi p phi' + q, in place."""
    b = memory.b
    half = emit_product(b.module, (n, n, n), slopes=memory.slopes)
    whole = emit_even(b.module, n, adds=True, slopes=memory.slopes)
    spare = memory.room(n * n)
    b.call(half, [spare, phi, p])
    emit_copy(b, q, p, n * n * memory.width)
    b.call(whole, [p, spare, phi])


def inverse_deviation(memory: Memory, n: int, k: int, gains: ir.Value) -> Number:
    """Of one over the variance of what channel k shows."""
    return memory.get(gains, k * gain_width(n) + n + 1)


def _root(b: ir.IRBuilder, number: Number) -> Number:
    value = dual(number).value
    size = Lane(b, root(b, value.value))
    if not isinstance(number, Dual):
        return size
    safe = b.select(b.fcmp_ordered("==", size.value, vector(0.0)), vector(1.0), size.value)
    return Dual(size, number.slope * 0.5 / Lane(b, safe))
