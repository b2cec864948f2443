"""A Kalman filter, sample after sample: for gaps, uneven times, slopes, smoothing and draws.

Over a step h, the state-space model x' = F x + g w with white noise w of intensity q has

    Phi = exp(F h)      Q = q int exp(F s) g g' exp(F s)' ds  from 0 to h

(Van Loan 1978).  h is halved until a Taylor series is short; there Q is a Gauss-Legendre sum of squares.
Then Phi -> Phi Phi and Q -> Q + Phi Q Phi', as often as it was halved.

Channels of a sample are taken one after the other, so that only numbers are divided by (Anderson and
Moore 1979, section 6.4): with the innovation e = y - c x, its variance S = c P c' + R and the gain
k = P c' / S,

    update       x <- x + k e       P <- P - k c P
    prediction   x <- Phi x         P <- Phi P Phi' + Q

Once the covariances are steady they are left alone, until a gap or another step.  The smoother goes back
by adjoints (Bryson and Frazier 1963; Bierman 1973), without inverting a covariance:

    r <- Phi' r      r <- r + c' (e / S - k' r)  channel by channel      x + P r  is the smoothed state
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from llvmlite import ir

from bayesdrill.basics.duals import Dual, dual
from bayesdrill.rig.kernels.exponential import Kinds, emit_halvings, formulas, weights_of
from bayesdrill.rig.kernels.lanes import (
    F64,
    I64,
    LANES,
    NUMBERS,
    VEC,
    VECTORS,
    Builder,
    Lane,
    Loop,
    begin_function,
    begin_kernel,
    vector,
    whole_numbers,
)
from bayesdrill.rig.kernels.numbers import (
    Memory,
    Number,
    dot,
    emit_even,
    emit_factor,
    emit_product,
    fused,
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

    def weights(self, b: Builder, weights: ir.Value, k: int) -> dict[int, Lane]:
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
    made, b = begin_function(module, "transition_d" if slopes else "transition", 0, [VECTORS] * 4)
    parameters, span, phi, q = made.args
    memory = Memory(b, slopes)
    named = dict(zip(system.model.parameters, memory.row(parameters, system.p), strict=True))
    entries = _entries(system, named)
    halvings = _halvings(b, entries, n, b.read(span, 0))
    exponent = b.shl(b.sub(whole_numbers(1023), b.splat(halvings)), whole_numbers(52))
    short = Lane(b, b.fmul(b.read(span, 0), b.bitcast(exponent, VEC)))
    timed = {place: entry * short for place, entry in entries.items()}
    _emit_series(memory, timed, n, phi)
    driven = system.model.torque.driven(named[TIME]) * short
    _emit_squares(memory, timed, n, q, driven)
    spare, other = memory.room(n * n), memory.room(n * n)
    twice = Loop(b, halvings, [], "twice")
    b.call(multiply, [spare, phi, q])
    b.call(turned, [q, spare, phi])
    b.call(multiply, [other, phi, phi])
    b.copy(other, phi, n * n * memory.width)
    twice.close([])
    b.ret_void()
    return made


def _entries(system: StateSpace, named: dict[str, Number]) -> dict[tuple[int, int], Number]:
    states = system.model.states
    linear = system.model.linear(named)
    return {(states.index(r), states.index(c)): value for (r, c), value in linear.A.items()}


def _halvings(
    b: Builder, entries: dict[tuple[int, int], Number], n: int, span: ir.Value
) -> ir.Value:
    """At least one, the same of all lanes."""
    norm = vector(0.0)
    for row in range(n):
        total = vector(0.0)
        for entry in (value for (i, _), value in entries.items() if i == row):
            value = dual(entry).value
            known = value.value if isinstance(value, Lane) else vector(float(value))
            total = b.fadd(total, b.absolute(known))
        norm = b.select(b.fcmp_unordered(">", total, norm), total, norm)
    most = b.largest(emit_halvings(b, b.fmul(norm, span), NORM))
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


def _over(b: Builder, index: ir.Value) -> Lane:
    """One over the number after."""
    number = b.sitofp(b.add(index, I64(1)), F64)
    return Lane(b, b.splat(b.fdiv(ir.Constant(F64, 1.0), number)))


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
        b.write(vector(float(node)), table, 2 * k)
        b.write(vector(float(weight)), table, 2 * k + 1)
    each = Loop(b, I64(NODES), [], "nodes")
    row = b.gep(table, [b.mul(each.index, I64(2))])
    node, weight = Lane(b, b.read(row, 0)), Lane(b, b.read(row, 1))
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


@dataclass(frozen=True, slots=True)
class Gains:
    """Of all channels, in a `block (K, width)`: the gain (n,), the variance of what the channel shows,
    and the root of one over it.  `weights (K, n)`: the block of those of the channels.
    """

    memory: Memory
    system: StateSpace
    block: ir.Value
    weights: ir.Value

    @staticmethod
    def width(n: int) -> int:
        return n + 2

    def of(self, k: int) -> list[Number]:
        first = k * self.width(self.system.n)
        return [self.memory.get(self.block, first + i) for i in range(self.system.n)]

    def variance(self, k: int) -> Number:
        return self.memory.get(self.block, (k + 1) * self.width(self.system.n) - 2)

    def inverse_deviation(self, k: int) -> Number:
        return self.memory.get(self.block, (k + 1) * self.width(self.system.n) - 1)

    def update_covariance(
        self, k: int, p: ir.Value, variances: ir.Value, is_seen: Number = 1.0
    ) -> None:
        """Write what the block has of channel k, and update the covariance p (n, n)."""
        memory, n = self.memory, self.system.n
        own = self.system.weights(memory.b, self.weights, k)
        c = list(own.values())
        shown = [dot(c, [memory.get(p, i * n + j) for j in own]) for i in range(n)]
        variance = dot(c, [shown[j] for j in own], memory.get(variances, k))
        over = is_seen / variance
        gain = [one * over for one in shown]
        for i in range(n):
            for j in range(n):
                memory.put(fused(-gain[i], shown[j], memory.get(p, i * n + j)), p, i * n + j)
        numbers = [*gain, variance * is_seen + (1.0 - is_seen), _root(memory.b, over)]
        for i, one in enumerate(numbers, start=k * self.width(n)):
            memory.put(one, self.block, i)

    def update_state(
        self, k: int, state: Sequence[Number], y: Number
    ) -> tuple[Number, list[Number]]:
        """Return the innovation of channel k, and the updated state."""
        innovation = y
        for i, weight in self.system.weights(self.memory.b, self.weights, k).items():
            innovation = fused(-weight, state[i], innovation)
        pairs = zip(self.of(k), state, strict=True)
        return innovation, [fused(gain, innovation, x) for gain, x in pairs]


def predict_covariance(memory: Memory, n: int, p: ir.Value, phi: ir.Value, q: ir.Value) -> None:
    """p = phi p phi' + q, in place."""
    b = memory.b
    half = emit_product(b.module, (n, n, n), slopes=memory.slopes)
    whole = emit_even(b.module, n, adds=True, slopes=memory.slopes)
    spare = memory.room(n * n)
    b.call(half, [spare, phi, p])
    b.copy(q, p, n * n * memory.width)
    b.call(whole, [p, spare, phi])


def _root(b: Builder, number: Number) -> Number:
    value = dual(number).value
    size = Lane(b, b.root(value.value))
    if not isinstance(number, Dual):
        return size
    safe = b.select(b.fcmp_ordered("==", size.value, vector(0.0)), vector(1.0), size.value)
    return Dual(size, number.slope * 0.5 / Lane(b, safe))


WHOLE = I64.as_pointer()
SAME = 1e-13  # of a variance: what it still changes when it is taken to have settled
SAME_SLOPE = 1e-10

# G groups, T samples, M lengths of steps; the last of them leads to the first sample, if there is
# a lead.
COUNTS = ("groups", "samples", "steps", "lead")
BLOCKS = {
    "parameters": VECTORS,  # (G, P) numbers
    "variances": VECTORS,  # (G, K) numbers, of the noise
    "left": VECTORS,  # (G, T, K) numbers: measured minus model; normals to draw with (G, T, n + K)
    "seen": NUMBERS,  # (T, K) one, or zero
    "node": WHOLE,  # (T,) which step leads to the next sample
    "same": WHOLE,  # (T,) whether gaps and step are as at the sample before
    "spans": NUMBERS,  # (M,)
    "weights": NUMBERS,  # (K, n) of channels
    "table": VECTORS,  # scratch (M, 2, n, n) numbers
    "kept": VECTORS,  # scratch (T, `Steps.kept`) where it smooths
    "out": VECTORS,  # (G, T, K, 2) numbers, whitened and variances; or (G, T, n), (G, T, n + K)
}


def write_filter(module: ir.Module, system: StateSpace, name: str) -> None:
    """`whiten`, `slopes` (whiten with slopes), `smooth` or `draw`, of COUNTS and addresses of BLOCKS."""
    (_emit_draw if name == "draw" else _emit_filter)(module, system, name)


class _Writer:
    """Where a group of walkers has its numbers."""

    def __init__(self, module: ir.Module, system: StateSpace, name: str) -> None:
        self.a, self.b = begin_kernel(module, name, COUNTS, BLOCKS)
        b = self.b
        self.system, self.slopes, self.smooth = system, name == "slopes", name == "smooth"
        self.memory = m = Memory(b, self.slopes)
        n = self.n = system.n
        self.spread = emit_transition(module, system, slopes=self.slopes)
        self.p, self.x = m.room(n * n), m.room(n)
        block = m.room(system.k * Gains.width(n))
        self.gains = Gains(m, system, block, self.a["weights"])
        self.span = b.alloca(VEC, I64(1))
        self.flag = b.alloca(I64, I64(1))

    @property
    def kept(self) -> int:
        return kept(self.system)

    def matrices(self, node: ir.Value) -> tuple[ir.Value, ir.Value]:
        b, size = self.b, self.n * self.n
        phi = self.memory.at(self.a["table"], b.mul(node, I64(2 * size)))
        return phi, self.memory.at(phi, size)

    def begin(self, group: ir.Value) -> None:
        """Matrices of all steps, and the covariance at the first sample."""
        b, m, a, n = self.b, self.memory, self.a, self.n
        own = m.at(a["parameters"], b.mul(group, I64(self.system.p)))
        self.variances = m.at(a["variances"], b.mul(group, I64(self.system.k)))
        steps = Loop(b, a["steps"], [], "steps")
        b.write(b.splat(b.load(b.gep(a["spans"], [steps.index]))), self.span, 0)
        b.call(self.spread, [own, self.span, *self.matrices(steps.index)])
        steps.close([])
        m.clear(self.p, n * n)
        for i in range(n - self.system.own, n):
            m.put(1.0, self.p, i * n + i)
        m.clear(self.x, n)
        b.store(I64(0), self.flag)
        with b.if_then(b.icmp_signed("!=", a["lead"], I64(0))):
            phi, q = self.matrices(b.sub(a["steps"], I64(1)))
            predict_covariance(m, n, self.p, phi, q)


def kept(system: StateSpace) -> int:
    """Numbers of a sample that smoothing wants: gains, residuals, state, covariance."""
    n = system.n
    return system.k * (n + 1) + n + n * n


def _emit_revise(module: ir.Module, system: StateSpace, *, slopes: bool) -> ir.Function:
    """`revise(p, gains, variances, phi, q, seen, weights, flag)`: an update and a prediction."""
    n = system.n
    made, b = begin_function(module, "revise", 0, [VECTORS] * 5 + [NUMBERS, NUMBERS, WHOLE])
    p, gains, variances, phi, q, seen, weights, flag = made.args
    memory = Memory(b, slopes)
    found = Gains(memory, system, gains, weights)
    old = [dual(memory.get(p, i * n + i)) for i in range(n)]
    for k in range(system.k):
        is_seen = Lane(b, b.splat(b.load(b.gep(seen, [I64(k)]))))
        found.update_covariance(k, p, variances, is_seen)
    predict_covariance(memory, n, p, phi, q)
    moving = _moving(memory, n, p, old)
    b.store(b.select(b.anywhere(moving), I64(0), I64(1)), flag)
    b.ret_void()
    return made


def _moving(memory: Memory, n: int, p: ir.Value, old: list[Dual]) -> ir.Value:
    """Lanes in which a variance changes still."""
    b = memory.b
    moving = ir.Constant(ir.VectorType(ir.IntType(1), LANES), [0] * LANES)
    for i, before in enumerate(old):
        now = dual(memory.get(p, i * n + i))
        far = b.absolute((now.value - before.value).value)
        near = (now.value * SAME).value
        moving = b.or_(moving, b.fcmp_unordered(">", far, near))
        if memory.slopes:
            far = b.absolute((now.slope - before.slope).value)
            size = Lane(b, b.absolute(now.slope.value)) + now.value
            moving = b.or_(moving, b.fcmp_unordered(">", far, (size * SAME_SLOPE).value))
    return moving


def _emit_filter(module: ir.Module, system: StateSpace, name: str) -> None:
    revise = _emit_revise(module, system, slopes=name == "slopes")
    w = _Writer(module, system, name)
    b, a, m, n = w.b, w.a, w.memory, w.n
    groups = Loop(b, a["groups"], [], "groups")
    w.begin(groups.index)
    samples = Loop(b, a["samples"], [], "samples")
    t = samples.index
    here = b.mul(b.add(b.mul(groups.index, a["samples"]), t), I64(system.k))
    if w.smooth:
        keep = m.at(a["kept"], b.mul(t, I64(w.kept)))
        b.copy(w.x, b.gep(keep, [I64(system.k * (n + 1))]), n)
        b.copy(w.p, b.gep(keep, [I64(system.k * (n + 1) + n)]), n * n)
    phi, q = w.matrices(b.load(b.gep(a["node"], [t])))
    settled = b.and_(b.load(w.flag), b.load(b.gep(a["same"], [t])))
    seen = b.gep(a["seen"], [b.mul(t, I64(system.k))])
    with b.if_then(b.icmp_signed("==", settled, I64(0))):
        b.call(revise, [w.p, w.gains.block, w.variances, phi, q, seen, a["weights"], w.flag])
    _emit_sample(w, here, t, phi)
    samples.close([])
    if w.smooth:
        _emit_back(w, groups.index)
    groups.close([])
    b.ret_void()


def _emit_sample(w: _Writer, here: ir.Value, t: ir.Value, phi: ir.Value) -> None:
    """Update the state by a sample, and predict the next."""
    b, m, n, system = w.b, w.memory, w.n, w.system
    left, state = m.at(w.a["left"], here), m.row(w.x, n)
    out = m.at(w.a["out"], b.mul(here, I64(2)))
    for k in range(system.k):
        innovation, state = w.gains.update_state(k, state, m.get(left, k))
        over = w.gains.inverse_deviation(k)
        white = innovation * over
        if w.smooth:
            keep = m.at(w.a["kept"], b.mul(t, I64(w.kept)))
            for i, gain in enumerate(w.gains.of(k)):
                m.put(gain, keep, k * (n + 1) + i)
            m.put(white * over, keep, k * (n + 1) + n)
        else:
            m.put(white, out, 2 * k)
            m.put(w.gains.variance(k), out, 2 * k + 1)
    rows = [[m.get(phi, i * n + j) for j in range(n)] for i in range(n)]
    for i, row in enumerate(rows):
        m.put(dot(row, state), w.x, i)


def _emit_back(w: _Writer, group: ir.Value) -> None:
    """The smoother, from the last sample to the first."""
    b, a, m, n, system = w.b, w.a, w.memory, w.n, w.system
    back = Loop(b, a["samples"], [vector(0.0)] * n, "back")
    t = b.sub(b.sub(a["samples"], I64(1)), back.index)
    adjoint: list[Number] = [Lane(b, one) for one in back.carried]
    keep = m.at(a["kept"], b.mul(t, I64(w.kept)))
    for k in reversed(range(system.k)):
        gain = [m.get(keep, k * (n + 1) + i) for i in range(n)]
        more = m.get(keep, k * (n + 1) + n) - dot(gain, adjoint)
        for i, weight in system.weights(b, a["weights"], k).items():
            adjoint[i] = fused(weight, more, adjoint[i])
    first = system.k * (n + 1)
    out = m.at(a["out"], b.mul(b.add(b.mul(group, a["samples"]), t), I64(n)))
    for i in range(n):
        row = [m.get(keep, first + n + i * n + j) for j in range(n)]
        m.put(dot(row, adjoint, m.get(keep, first + i)), out, i)
    before = b.select(b.icmp_signed(">", t, I64(0)), b.sub(t, I64(1)), I64(0))
    phi, _ = w.matrices(b.load(b.gep(a["node"], [before])))
    columns = [[m.get(phi, j * n + i) for j in range(n)] for i in range(n)]
    back.close([dot(column, adjoint).value for column in columns])


def _emit_draw(module: ir.Module, system: StateSpace, name: str) -> None:
    """States, and what channels show of them with noise, of numbers that are standard normal."""
    factor = emit_factor(module, system.n)
    w = _Writer(module, system, name)
    b, a, m, n = w.b, w.a, w.memory, w.n
    groups = Loop(b, a["groups"], [], "groups")
    w.begin(groups.index)
    first = m.room(n * n)
    b.call(factor, [first, w.p])
    steps = Loop(b, a["steps"], [], "factors")
    _, q = w.matrices(steps.index)
    spare = m.room(n * n)
    b.call(factor, [spare, q])
    b.copy(spare, q, n * n)
    steps.close([])
    samples = Loop(b, a["samples"], [vector(0.0)] * n, "samples")
    t, k_count = samples.index, system.k
    here = b.mul(b.add(b.mul(groups.index, a["samples"]), t), I64(n + k_count))
    normals = m.row(m.at(a["left"], here), n + k_count)
    before = b.select(b.icmp_signed(">", t, I64(0)), b.sub(t, I64(1)), I64(0))
    phi, q = w.matrices(b.load(b.gep(a["node"], [before])))
    begins = b.icmp_signed("==", t, I64(0))
    spreads = b.select(begins, first, q)
    state: list[Number] = []
    for i in range(n):
        moved = dot(
            [m.get(phi, i * n + j) for j in range(n)], [Lane(b, x) for x in samples.carried]
        )
        spread = [m.get(spreads, i * n + j) for j in range(i + 1)]
        state.append(dot(spread, normals[: i + 1], moved))
    out = m.at(a["out"], here)
    m.put_row(state, out)
    for k in range(k_count):
        size = Lane(b, b.root(b.read(w.variances, k)))
        value = size * normals[n + k]
        for i, weight in system.weights(b, a["weights"], k).items():
            value = fused(weight, state[i], value)
        m.put(value, out, n + k)
    samples.close([one.value for one in state])
    groups.close([])
    b.ret_void()
