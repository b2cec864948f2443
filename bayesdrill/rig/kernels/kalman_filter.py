"""Run a Kalman filter sample by sample: for gaps, uneven times, derivatives, smoothing and draws.

Over a step h, the state-space model x' = F x + g w with white noise w of intensity q has

    Phi = exp(F h)      Q = q int exp(F s) g g' exp(F s)' ds  from 0 to h

(Van Loan 1978).  h is halved until the Taylor series of Phi is short.  Over the halved step Q is a
Gauss-Legendre sum.  Then Phi <- Phi Phi and Q <- Q + Phi Q Phi', once for each halving.

The filter takes the channels of a sample one by one, so that it inverts no matrix (Anderson and
Moore 1979, section 6.4): with the innovation e = y - c x, its variance S = c P c' + R and the gain
k = P c' / S,

    update       x <- x + k e       P <- P - k c P
    prediction   x <- Phi x         P <- Phi P Phi' + Q

Once the covariance is steady, only a gap or another step length changes it.  The smoother runs
backwards by adjoints (Bryson and Frazier 1963; Bierman 1973), without inverting a covariance:

    r <- Phi' r      r <- r + c' (e / S - k' r)  channel by channel      x + P r  is the smoothed state
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from llvmlite import ir

from bayesdrill.basics.duals import Dual, dual
from bayesdrill.rig.kernels.exponential import (
    emit_halvings,
    emit_norm,
    emit_power,
    formulas,
    number,
)
from bayesdrill.rig.kernels.lanes import (
    F64,
    I64,
    NOWHERE,
    NUMBERS,
    VECTORS,
    WHOLE,
    Builder,
    Loop,
    Module,
    Vector,
    kernel,
    register,
    routine,
    vector,
)
from bayesdrill.rig.kernels.numbers import (
    Number,
    Numbers,
    dot,
    factorise,
    multiply,
    multiply_add,
    multiply_symmetric,
)
from bayesdrill.rig.models.latent_torque import TIME, AugmentedModel

TAYLOR_DEGREE = 13
MAX_TAYLOR_NORM = 0.5  # the remainder is then 0.5**14 / 14! = 7e-16
GAUSS_NODES = 9  # exact for polynomials up to degree 17


@dataclass(frozen=True, slots=True)
class StateSpace:
    """The state space is that of a rig with its latent torque; kernels are specialised for it.

    `channels (K, n)` has the weights of states in channels; torque states are last. Weights other
    than 0, 1 and -1 are None here, as they are arguments of the kernel.
    """

    model: AugmentedModel
    channels: tuple[tuple[float | None, ...], ...]

    @property
    def text(self) -> str:
        """See `compile_kernel`."""
        return f"{self.n} {self.n_torque_states} {self.channels} {formulas(self.p, self._formulas)}"

    def _formulas(self, lanes: Sequence[Vector]) -> Any:
        """Return the dynamics, and the noise intensity of the torque, at given parameters."""
        named: Any = dict(zip(self.model.parameters, lanes, strict=True))
        return _entries(self, named), self.model.torque.intensity(named[TIME])

    @property
    def n(self) -> int:
        """Return the number of states, including those of the torque."""
        return len(self.model.states)

    @property
    def p(self) -> int:
        """Return the number of parameters."""
        return len(self.model.parameters)

    @property
    def k(self) -> int:
        """Return the number of channels."""
        return len(self.channels)

    @property
    def n_torque_states(self) -> int:
        """Return the number of torque states, which are the last ones."""
        return len(self.model.torque.states)

    def weights(self, b: Builder, weights: ir.Value, k: int) -> dict[int, Vector]:
        """Return the weights of channel k, by state, from the block of all `weights (K, n)`."""
        return {
            i: number(b, weights, k * self.n + i) if known is None else Vector(b, vector(known))
            for i, known in enumerate(self.channels[k])
            if known != 0.0
        }


@routine
def store_transition(
    b: Builder,
    parameters: ir.Value,
    span: ir.Value,
    phi: ir.Value,
    q: ir.Value,
    system: StateSpace,
    *,
    slopes: bool,
) -> None:
    """Store Phi (n, n), and Q (n, n) of the process noise, over the time step `span` of each lane."""
    n, memory = system.n, Numbers(b, slopes)
    named = dict(zip(system.model.parameters, memory.row(parameters, system.p), strict=True))
    entries = _entries(system, named)
    halvings = _halvings(b, entries, n, span)
    power = emit_power(b, b.sub(1023, b.splat(halvings)))
    short = Vector(b, b.fmul(span, power))
    timed = {index: entry * short for index, entry in entries.items()}
    _emit_series(memory, timed, n, phi)
    driven = system.model.torque.intensity(named[TIME]) * short
    _emit_squares(memory, timed, n, q, driven)
    spare, other = memory.room(n * n), memory.room(n * n)
    with b.loop(halvings, "twice"):
        multiply(b, spare, phi, q, (n, n, n), slopes=slopes)
        multiply_symmetric(b, q, spare, phi, n, adds=True, slopes=slopes)
        multiply(b, other, phi, phi, (n, n, n), slopes=slopes)
        b.copy(other, phi, n * n * memory.width)


def _entries(system: StateSpace, named: dict[str, Number]) -> dict[tuple[int, int], Number]:
    states = system.model.states
    linear = system.model.linear(named)
    return {(states.index(r), states.index(c)): value for (r, c), value in linear.A.items()}


def _halvings(
    b: Builder, entries: dict[tuple[int, int], Number], n: int, span: ir.Value
) -> ir.Value:
    """Return the number of halvings of a step: at least one, and the same in all lanes."""
    rows = (
        [register(dual(value).value) for (i, _), value in entries.items() if i == row]
        for row in range(n)
    )
    most = b.largest(emit_halvings(b, b.fmul(emit_norm(b, rows), span), MAX_TAYLOR_NORM))
    return b.select(b.icmp_signed(">", most, 1), most, 1)


def _moved(
    entries: dict[tuple[int, int], Number], n: int, vector_: list[Number], times: Number
) -> list[Number]:
    moved: list[Number] = []
    for i in range(n):
        total: Number = None
        for (row, column), entry in entries.items():
            if row == i:
                total = multiply_add(entry, vector_[column], total)
        moved.append(0.0 if total is None else total * times)
    return moved


def _emit_series(
    memory: Numbers, timed: dict[tuple[int, int], Number], n: int, phi: ir.Value
) -> None:
    """Store the exponential of a matrix with the entries `timed`, a column at a time."""
    b = memory.b
    memory.clear(phi, n * n)
    for i in range(n):
        memory.put(1.0, phi, i * n + i)
    term = memory.room(n)
    with b.loop(n, "columns") as column:
        top = memory.at(phi, column)
        for i in range(n):
            memory.put(memory.get(top, i * n), term, i)
        with b.loop(TAYLOR_DEGREE, "orders") as order:
            for i, value in enumerate(_moved(timed, n, memory.row(term, n), _reciprocal(b, order))):
                memory.put(value, term, i)
                memory.put(memory.get(top, i * n) + value, top, i * n)


def _reciprocal(b: Builder, index: ir.Value) -> Vector:
    """Return 1 / (index + 1)."""
    return Vector(b, b.splat(b.fdiv(F64(1.0), b.sitofp(b.add(index, 1), F64))))


def _emit_squares(
    memory: Numbers, timed: dict[tuple[int, int], Number], n: int, q: ir.Value, driven: Number
) -> None:
    """Store q = driven int exp(F s) g g' exp(F s)' ds from 0 to 1, with the `timed` entries of F."""
    b = memory.b
    terms = memory.room((TAYLOR_DEGREE + 1) * n)
    memory.put_row([*[0.0] * (n - 1), 1.0], terms)
    with b.loop(TAYLOR_DEGREE, "orders") as order:
        here = memory.at(terms, b.mul(order, n))
        memory.put_row(_moved(timed, n, memory.row(here, n), _reciprocal(b, order)), here, n)
    memory.clear(q, n * n)
    # Nodes of Gauss-Legendre quadrature from 0 to 1, each followed by its weight.
    nodes, weights = np.polynomial.legendre.leggauss(GAUSS_NODES)
    gauss = np.stack([0.5 * (nodes + 1.0), 0.5 * weights], axis=1)
    table = b.room(gauss.size)
    b.write_row(map(vector, gauss.ravel().tolist()), table)
    with b.loop(GAUSS_NODES, "nodes") as each:
        row = b.offset(table, b.mul(each, 2))
        node, weight = Vector(b, b.read(row, 0)), Vector(b, b.read(row, 1))
        point = memory.row(terms, n, TAYLOR_DEGREE * n)
        for known in range(TAYLOR_DEGREE - 1, -1, -1):
            pairs = zip(point, memory.row(terms, n, known * n), strict=True)
            point = [multiply_add(partial, node, term) for partial, term in pairs]
        for i in range(n):
            scaled = point[i] * weight * driven
            for j in range(n):
                memory.put(multiply_add(scaled, point[j], memory.get(q, i * n + j)), q, i * n + j)


@dataclass(frozen=True, slots=True)
class Gains:
    """The block `(K, width)` has the Kalman gains of all channels.

    Each channel has its gain (n,), the variance S of its innovation, and 1 / sqrt(S). The
    channels' weights are in `weights (K, n)`.
    """

    memory: Numbers
    system: StateSpace
    block: ir.Value
    weights: ir.Value

    @staticmethod
    def width(n: int) -> int:
        """Return how many numbers a channel has, for n states."""
        return n + 2

    def gain(self, k: int) -> list[Number]:
        """Load the gain of channel k."""
        return self.memory.row(self.block, self.system.n, k * self.width(self.system.n))

    def variance(self, k: int) -> Number:
        """Load the variance of the innovation of channel k."""
        return self.memory.get(self.block, (k + 1) * self.width(self.system.n) - 2)

    def inverse_deviation(self, k: int) -> Number:
        """Load 1 / sqrt(S) of channel k."""
        return self.memory.get(self.block, (k + 1) * self.width(self.system.n) - 1)

    def update_covariance(
        self, k: int, p: ir.Value, variances: ir.Value, is_seen: Number = 1.0
    ) -> None:
        """Store gain, S and 1 / sqrt(S) of channel k, and update the covariance p (n, n)."""
        memory, n = self.memory, self.system.n
        weights = self.system.weights(memory.b, self.weights, k)
        c = list(weights.values())
        shown = [dot(c, [memory.get(p, i * n + j) for j in weights]) for i in range(n)]
        variance = dot(c, [shown[j] for j in weights], memory.get(variances, k))
        over = is_seen / variance
        gain = [covariance * over for covariance in shown]
        for i in range(n):
            for j in range(n):
                memory.put(multiply_add(-gain[i], shown[j], memory.get(p, i * n + j)), p, i * n + j)
        numbers = [*gain, variance * is_seen + (1.0 - is_seen), _root(memory.b, over)]
        memory.put_row(numbers, self.block, k * self.width(n))

    def update_state(
        self, k: int, state: Sequence[Number], y: Number
    ) -> tuple[Number, list[Number]]:
        """Return the innovation of channel k, and the updated state."""
        innovation = y
        for i, weight in self.system.weights(self.memory.b, self.weights, k).items():
            innovation = multiply_add(-weight, state[i], innovation)
        pairs = zip(self.gain(k), state, strict=True)
        return innovation, [multiply_add(gain, innovation, x) for gain, x in pairs]


def predict_covariance(memory: Numbers, n: int, p: ir.Value, phi: ir.Value, q: ir.Value) -> None:
    """Store p = phi p phi' + q, in place."""
    b, slopes, spare = memory.b, memory.slopes, memory.room(n * n)
    multiply(b, spare, phi, p, (n, n, n), slopes=slopes)
    b.copy(q, p, n * n * memory.width)
    multiply_symmetric(b, p, spare, phi, n, adds=True, slopes=slopes)


def _root(b: Builder, number: Number) -> Number:
    value = dual(number).value
    size = Vector(b, b.root(value.value))
    if not isinstance(number, Dual):
        return size
    safe = b.select(b.fcmp_ordered("==", size.value, vector(0.0)), vector(1.0), size.value)
    return Dual(size, number.slope * 0.5 / Vector(b, safe))


STEADY_TOLERANCE = 1e-13  # relative change of a variance below which the covariance is steady
STEADY_SLOPE_TOLERANCE = 1e-10  # same for the variance's derivative d, relative to |d| + variance

# G groups of walkers (sets of parameters), T samples, K channels, n states, M step lengths. If `lead`
# is 1, the start is before the first sample, and the last of the M steps leads from it to this sample.
COUNTS = ("groups", "samples", "steps", "lead")
BLOCKS = {
    "parameters": VECTORS,  # (G, P) numbers
    "variances": VECTORS,  # (G, K) numbers, variances of the noise
    # (G, T, K) residuals, measured minus model; for draws, (G, T, n + K) standard normal numbers.
    "left": VECTORS,
    "seen": NUMBERS,  # (T, K) 1 if the channel is observed, else 0
    "node": WHOLE,  # (T,) index in `spans` of the step to the next sample
    "same": WHOLE,  # (T,) 1 if observed channels and step are those of the previous sample
    "spans": NUMBERS,  # (M,) step lengths
    "weights": NUMBERS,  # (K, n) weights of states in channels
    "table": VECTORS,  # scratch (M, 2, n, n): Phi and Q of each step
    "kept": VECTORS,  # scratch (T, `smoother_size`) of the smoother
    "out": VECTORS,  # (G, T, K, 2) whitened, variances; (G, T, n) smoothed; (G, T, n + K) drawn
}


def write_filter(module: Module, system: StateSpace, name: str) -> None:
    """Write the kernel `name`: `whiten`, `slopes` (whiten with derivatives), `smooth` or `draw`.

    Its arguments are COUNTS and the addresses of BLOCKS.
    """
    with kernel(module, name, COUNTS, BLOCKS) as (a, b), b.loop(a["groups"], "groups") as group:
        w = _Writer(a, Numbers(b, name == "slopes"), system, group)
        if name == "draw":
            _emit_draw(w, group)
        else:
            _emit_filter(w, group, smooth=name == "smooth")


class _Writer:
    """A writer emits the code that filter, smoother and sampler share."""

    def __init__(
        self, a: dict[str, ir.Value], m: Numbers, system: StateSpace, group: ir.Value
    ) -> None:
        """Store the matrices of all steps, and the covariance at the first sample."""
        self.a, self.b, self.memory, self.system, self.n = a, m.b, m, system, system.n
        b, n = m.b, system.n
        self.p, self.x, self.flag = m.room(n * n), m.room(n), b.room(1, I64)
        self.gains = Gains(m, system, m.room(system.k * Gains.width(n)), a["weights"])
        parameters = m.at(a["parameters"], b.mul(group, system.p))
        self.variances = m.at(a["variances"], b.mul(group, system.k))
        with b.loop(a["steps"], "steps") as step:
            span, (phi, q) = b.shared(a["spans"], step), self.matrices(step)
            store_transition(b, parameters, span, phi, q, system, slopes=m.slopes)
        m.clear(self.p, n * n)
        for i in range(n - system.n_torque_states, n):
            m.put(1.0, self.p, i * n + i)
        m.clear(self.x, n)
        b.store(0, self.flag)
        with b.if_then(b.icmp_signed("!=", a["lead"], 0)):
            phi, q = self.matrices(b.sub(a["steps"], 1))
            predict_covariance(m, n, self.p, phi, q)

    def matrices(self, node: ir.Value) -> tuple[ir.Value, ir.Value]:
        b, size = self.b, self.n * self.n
        phi = self.memory.at(self.a["table"], b.mul(node, 2 * size))
        return phi, self.memory.at(phi, size)

    def matrices_to(self, t: ir.Value) -> tuple[ir.Value, ir.Value]:
        """Return Phi and Q of the step to sample t; for the first sample, those of any step."""
        b = self.b
        before = b.select(b.icmp_signed(">", t, 0), b.sub(t, 1), 0)
        return self.matrices(b.single(self.a["node"], before))


def smoother_size(system: StateSpace) -> int:
    """Return how many numbers smoothing keeps per sample: gains, residuals, state, covariance."""
    n = system.n
    return system.k * (n + 1) + n + n * n


def _revise(w: _Writer, phi: ir.Value, q: ir.Value, observed: ir.Value) -> None:
    """Update and predict the covariance; set the flag if it is steady from now on."""
    b, m, n = w.b, w.memory, w.n
    old = [dual(m.get(w.p, i * n + i)) for i in range(n)]
    for k in range(w.system.k):
        w.gains.update_covariance(k, w.p, w.variances, Vector(b, b.shared(observed, k)))
    predict_covariance(m, n, w.p, phi, q)
    moving = NOWHERE
    for i, before in enumerate(old):
        now = dual(m.get(w.p, i * n + i))
        change = b.absolute((now.value - before.value).value)
        limit = (now.value * STEADY_TOLERANCE).value
        moving = b.or_(moving, b.fcmp_unordered(">", change, limit))
        if m.slopes:
            change = b.absolute((now.slope - before.slope).value)
            limit = ((now.slope.size() + now.value) * STEADY_SLOPE_TOLERANCE).value
            moving = b.or_(moving, b.fcmp_unordered(">", change, limit))
    b.store(b.select(b.anywhere(moving), 0, 1), w.flag)


def _emit_filter(w: _Writer, group: ir.Value, *, smooth: bool) -> None:
    b, a, m, n, system = w.b, w.a, w.memory, w.n, w.system
    size, after_gains = smoother_size(system), system.k * (n + 1)
    with b.loop(a["samples"], "samples") as t:
        here = b.mul(b.add(b.mul(group, a["samples"]), t), system.k)
        keep = m.at(a["kept"], b.mul(t, size)) if smooth else None
        if smooth:
            b.copy(w.x, b.offset(keep, after_gains), n)
            b.copy(w.p, b.offset(keep, after_gains + n), n * n)
        phi, q = w.matrices(b.single(a["node"], t))
        settled = b.and_(b.load(w.flag), b.single(a["same"], t))
        observed = b.offset(a["seen"], b.mul(t, system.k))
        with b.if_then(b.icmp_signed("==", settled, 0)):
            _revise(w, phi, q, observed)
        residuals, state = m.at(a["left"], here), m.row(w.x, n)
        out = m.at(a["out"], b.mul(here, 2))
        for k in range(system.k):
            innovation, state = w.gains.update_state(k, state, m.get(residuals, k))
            over = w.gains.inverse_deviation(k)
            white = innovation * over
            if keep is not None:
                m.put_row([*w.gains.gain(k), white * over], keep, k * (n + 1))
            else:
                m.put_row([white, w.gains.variance(k)], out, 2 * k)
        rows = [m.row(phi, n, i * n) for i in range(n)]
        m.put_row([dot(row, state) for row in rows], w.x)
    if smooth:
        _emit_back(w, group)


def _emit_back(w: _Writer, group: ir.Value) -> None:
    """Write the smoother, from the last sample to the first."""
    b, a, m, n, system = w.b, w.a, w.memory, w.n, w.system
    back = Loop(b, a["samples"], [vector(0.0)] * n, "back")
    t = b.sub(b.sub(a["samples"], 1), back.index)
    adjoint: list[Number] = m.shaped(back.carried)
    keep = m.at(a["kept"], b.mul(t, smoother_size(system)))
    for k in reversed(range(system.k)):
        *gain, innovation = m.row(keep, n + 1, k * (n + 1))
        more = innovation - dot(gain, adjoint)
        for i, weight in system.weights(b, a["weights"], k).items():
            adjoint[i] = multiply_add(weight, more, adjoint[i])
    first = system.k * (n + 1)
    out = m.at(a["out"], b.mul(b.add(b.mul(group, a["samples"]), t), n))
    for i in range(n):
        row = m.row(keep, n, first + n + i * n)
        m.put(dot(row, adjoint, m.get(keep, first + i)), out, i)
    phi, _ = w.matrices_to(t)
    columns = [[m.get(phi, j * n + i) for j in range(n)] for i in range(n)]
    back.close([dot(column, adjoint).value for column in columns])


def _emit_draw(w: _Writer, group: ir.Value) -> None:
    """Write the code that draws states and their noisy channels from standard normal numbers."""
    b, a, m, n, k_count = w.b, w.a, w.memory, w.n, w.system.k
    first, spare = m.room(n * n), m.room(n * n)
    factorise(b, first, w.p, n)
    with b.loop(a["steps"], "factors") as step:
        _, q = w.matrices(step)
        factorise(b, spare, q, n)
        b.copy(spare, q, n * n)
    samples = Loop(b, a["samples"], [vector(0.0)] * n, "samples")
    t = samples.index
    here = b.mul(b.add(b.mul(group, a["samples"]), t), n + k_count)
    normals = m.row(m.at(a["left"], here), n + k_count)
    phi, q = w.matrices_to(t)
    spreads = b.select(b.icmp_signed("==", t, 0), first, q)
    state: list[Number] = []
    for i in range(n):
        moved = dot(m.row(phi, n, i * n), m.shaped(samples.carried))
        state.append(dot(m.row(spreads, i + 1, i * n), normals[: i + 1], moved))
    out = m.at(a["out"], here)
    m.put_row(state, out)
    for k in range(k_count):
        value = m.get(w.variances, k).sqrt() * normals[n + k]
        for i, weight in w.system.weights(b, a["weights"], k).items():
            value = multiply_add(weight, state[i], value)
        m.put(value, out, n + k)
    samples.close(m.flat(state))
