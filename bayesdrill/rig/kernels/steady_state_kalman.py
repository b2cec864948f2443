"""The likelihood by a Kalman filter of one steady-state gain.

The Riccati equation is solved by doubling (Anderson 1978), and the start is exact.

2^j steps have the covariance H that they leave of a known state, a transition B, and the
information G of their samples on the state before them.  Two such stretches make one of twice the
length:

    B <- B E        E = (1 + H G)^-1 B
    G <- G + B' G E
    H <- H + B (1 + H G)^-1 H B'

until H is the steady-state covariance P.  One that goes before a stretch of information G' has,
with it, G + B' G' (1 + H G')^-1 B: the record is put together of stretches as its length is written
in twos.

With the gain of P the filter is the recurrence of the response, channel after channel of a sample e
= y - c x, x <- x + k e, then x <- Phi x + g + G u.  That the start has another covariance than P is
corrected at the end, from the information of all samples on it, see `emit_start_correction`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from llvmlite import ir

from bayesdrill.rig.kernels.exponential import Layout, addresses, emit_exponential
from bayesdrill.rig.kernels.kalman_filter import (
    Gains,
    StateSpace,
    emit_transition,
    predict_covariance,
)
from bayesdrill.rig.kernels.lanes import (
    I64,
    LANES,
    NUMBERS,
    VECTORS,
    Builder,
    Loop,
    Vector,
    begin_function,
    begin_kernel,
    vector,
)
from bayesdrill.rig.kernels.numbers import (
    Memory,
    Number,
    dot,
    emit_lu,
    emit_lu_solve,
    emit_product,
    emit_symmetric,
    multiply_add,
)
from bayesdrill.rig.kernels.recurrence import Constants, emit_drive, next_state, phi_entries

MIN_DOUBLINGS, MAX_DOUBLINGS = 7, 44  # doublings
COVARIANCE_TOLERANCE = 1e-14  # of the variance of a sample: what one more doubling may add to it
INFORMATION_TOLERANCE = (
    1e-15  # of a sum; after a stretch that adds no more to it, one as long as both tells nothing
)


def block_sizes(n: int, k: int) -> dict[str, int]:
    """Return the parts of the block that `riccati` reads and fills, and how many numbers each has.

    Matrices (n, n); gains, see `Gains`; pulls `(K, n)`, what a channel shows of the state before
    the sample, over its variance.
    """
    return dict.fromkeys(("p", "phi", "q", "g", "a"), n * n) | {
        "gains": k * Gains.width(n),
        "pulls": k * n,
    }


@dataclass(frozen=True, slots=True)
class Measurement:
    """The measurement of the state by channels: `variances (K,)` of noise, and `weights (K, n)`."""

    m: Memory
    system: StateSpace
    variances: ir.Value
    weights: ir.Value

    def information(self, information: ir.Value) -> None:
        """Store the `information (n, n)` of one sample on its state."""
        m, b, n = self.m, self.m.b, self.system.n
        m.clear(information, n * n)
        for k in range(self.system.k):
            over = Vector(b, b.fdiv(vector(1.0), b.read(self.variances, k)))
            for index, both in self._products(k):
                m.put(m.get(information, index) + over * both, information, index)

    def add_covariance(self, p: ir.Value, more: ir.Value, grown: ir.Value) -> ir.Value:
        """Add `more` to p, and tell whether any channel would see the next addition.

        That is smaller by at least as much as this one is than the one before, `grown (K,)`.
        """
        m, b, n = self.m, self.m.b, self.system.n
        moves = ir.Constant(ir.VectorType(ir.IntType(1), LANES), [0] * LANES)
        for k in range(self.system.k):
            change, variance = Vector(b, vector(0.0)), Vector(b, b.read(self.variances, k))
            for index, both in self._products(k):
                change = multiply_add(both, m.get(more, index), change)
                variance = multiply_add(both, m.get(p, index), variance)
            least = variance * COVARIANCE_TOLERANCE * m.get(grown, k)
            moves = b.or_(moves, b.fcmp_ordered(">", (change * change).value, least.value))
            m.put(change, grown, k)
        for index in range(n * n):
            m.put(m.get(p, index) + m.get(more, index), p, index)
        return b.anywhere(moves)

    def _products(self, k: int) -> Iterator[tuple[int, Vector]]:
        """Yield products of two weights of channel k, by index in a matrix."""
        weights = self.system.weights(self.m.b, self.weights, k)
        for i, weight in weights.items():
            for j, other in weights.items():
                yield i * self.system.n + j, weight * other


def emit_riccati(module: ir.Module, system: StateSpace) -> ir.Function:
    """Write `riccati(samples, block, variances, weights, first)`, which fills the `block`.

    It reads Phi and Q there.  G is that of all samples; `first (1,)` gets how many of them carry
    any information on the start.
    """
    double, gain, before = (
        _emit_doubling(module, system),
        _emit_gain(module, system),
        _emit_prepend(module, system.n),
    )
    function, b = begin_function(
        module, "riccati", 1, [VECTORS, VECTORS, NUMBERS, I64.as_pointer()]
    )
    samples, block, variances, weights, first = function.args
    n = system.n
    memory, at = Memory(b, False), addresses(b, block, I64(0), block_sizes(n, system.k))
    phi, q, p, g = (at[name] for name in ("phi", "q", "p", "g"))
    transition_a, transition_b, information = (memory.room(n * n) for _ in range(3))
    grown, grows = memory.room(system.k), b.alloca(ir.IntType(1), I64(1))
    for k in range(system.k):
        memory.put(math.inf, grown, k)
    b.copy(phi, transition_a, n * n)
    b.copy(q, p, n * n)
    Measurement(memory, system, variances, weights).information(information)
    memory.clear(g, n * n)
    b.store(samples, first)
    entry = b.block
    body, after = b.append_basic_block("doubling"), b.append_basic_block("settled")
    b.branch(body)
    b.position_at_end(body)
    count, transition, spare = b.phi(I64), b.phi(VECTORS), b.phi(VECTORS)
    for node, value in ((count, I64(0)), (transition, transition_a), (spare, transition_b)):
        node.add_incoming(value, entry)
    with b.if_then(b.trunc(b.lshr(samples, count), ir.IntType(1))):
        b.call(before, [transition, information, p, g])
    arguments = [transition, spare, information, p, variances, weights, grown, grows]
    moves = b.call(double, arguments)
    following = b.add(count, I64(1))
    length = b.shl(I64(1), following)
    informed = b.and_(b.not_(b.load(grows)), b.icmp_signed("<", length, b.load(first)))
    with b.if_then(informed):
        b.store(length, first)
    whole = b.icmp_signed(">", length, b.load(first))
    more = b.or_(moves, b.icmp_signed("<", count, I64(MIN_DOUBLINGS)))
    more = b.and_(b.or_(more, b.not_(whole)), b.icmp_signed("<", count, I64(MAX_DOUBLINGS)))
    count.add_incoming(following, b.block)
    transition.add_incoming(spare, b.block)
    spare.add_incoming(transition, b.block)
    b.cbranch(more, body, after)
    b.position_at_end(after)
    with b.if_then(b.icmp_signed("<", b.load(first), samples)):
        b.copy(information, g, n * n)
    b.call(gain, [block, variances, weights])
    b.ret_void()
    return function


def _emit_doubling(module: ir.Module, system: StateSpace) -> ir.Function:
    """Write `doubling(B, its next, G, H, variances, weights, grown (K,), grows)`.

    It returns whether one more changes anything in any lane; `grows (1,)`: whether G still does.
    """
    n = system.n
    plain, solved = emit_product(module, (n, n, n)), emit_lu_solve(module, n, n)
    across = emit_symmetric(module, n)
    along = emit_symmetric(module, n, transposed=True, adds=True)
    flag = ir.IntType(1)
    kinds = [*[VECTORS] * 5, NUMBERS, VECTORS, flag.as_pointer()]
    function = ir.Function(module, ir.FunctionType(flag, kinds), "doubling")
    for argument in function.args:
        argument.add_attribute("noalias")
    transition, following, information, p, variances, weights, grown, grows = function.args
    b = Builder(function.append_basic_block())
    m = Memory(b, False)
    lu, x, e, more = (m.room(n * n) for _ in range(4))
    b.call(plain, [x, p, information])
    _add_one(m, n, x)
    b.call(emit_lu(module, n), [lu, x, m.room(1)])
    b.call(solved, [x, lu, p])
    b.call(plain, [e, transition, x])
    b.call(across, [more, e, transition])
    b.call(solved, [e, lu, transition])
    b.call(plain, [following, transition, e])
    b.call(plain, [x, information, e])
    before = [m.get(information, i * n + i) for i in range(n)]
    b.call(along, [information, transition, x])
    b.store(_differs(m, n, before, information), grows)
    b.ret(Measurement(m, system, variances, weights).add_covariance(p, more, grown))
    return function


def _add_one(m: Memory, n: int, x: ir.Value) -> None:
    for i in range(n):
        m.put(m.get(x, i * n + i) + 1.0, x, i * n + i)


def _differs(m: Memory, n: int, before: list[Number], now: ir.Value) -> ir.Value:
    """Tell whether a diagonal has grown by more than rounding, and twice the stretch may grow more."""
    grown = ir.Constant(ir.VectorType(ir.IntType(1), LANES), [0] * LANES)
    for i, old in enumerate(before):
        much = old * (1.0 + INFORMATION_TOLERANCE)
        grown = m.b.or_(grown, m.b.fcmp_ordered(">", m.get(now, i * n + i).value, much.value))
    return m.b.anywhere(grown)


def _emit_prepend(module: ir.Module, n: int) -> ir.Function:
    """Write `prepend(B, G, H, end)`: put the stretch before one of information `end (n, n)`."""
    plain, solved = emit_product(module, (n, n, n)), emit_lu_solve(module, n, n)
    along = emit_symmetric(module, n, transposed=True, adds=True)
    function, b = begin_function(module, "prepend", 0, [VECTORS] * 4)
    transition, information, p, end = function.args
    m = Memory(b, False)
    lu, x, e = (m.room(n * n) for _ in range(3))
    b.call(plain, [x, p, end])
    _add_one(m, n, x)
    b.call(emit_lu(module, n), [lu, x, m.room(1)])
    b.call(solved, [e, lu, transition])
    b.call(plain, [x, end, e])
    b.copy(information, end, n * n)
    b.call(along, [end, transition, x])
    b.ret_void()
    return function


def _emit_gain(module: ir.Module, system: StateSpace) -> ir.Function:
    """Write `gain(block, variances, weights)`: gains, pulls, and A."""
    n = system.n
    onward = emit_product(module, (n, n, n))
    function, b = begin_function(module, "gain", 0, [VECTORS, VECTORS, NUMBERS])
    block, variances, weights = function.args
    m, at = Memory(b, False), addresses(b, block, I64(0), block_sizes(n, system.k))
    pulls, gains = at["pulls"], Gains(m, system, at["gains"], weights)
    updated, closed_loop = m.room(n * n), m.room(n * n)
    b.copy(at["p"], updated, n * n)
    m.clear(closed_loop, n * n)
    _add_one(m, n, closed_loop)
    for k in range(system.k):
        gains.update_covariance(k, updated, variances)
        weights_k = list(system.weights(b, weights, k).values())
        rows = [m.row(m.at(closed_loop, i * n), n) for i in system.observed_states(k)]
        shows = [dot(weights_k, [row[j] for row in rows]) for j in range(n)]
        root = gains.inverse_deviation(k)
        for i, (weight, gain) in enumerate(zip(shows, gains.gain(k), strict=True)):
            m.put(weight * root * root, pulls, k * n + i)
            for j, other in enumerate(shows):
                m.put(
                    multiply_add(-gain, other, m.get(closed_loop, i * n + j)),
                    closed_loop,
                    i * n + j,
                )
    b.call(onward, [at["a"], at["phi"], closed_loop])
    b.ret_void()
    return function


def emit_start_correction(module: ir.Module, n: int) -> ir.Function:
    """Write `start(p, g, p0, b, gained, determinant)`, which corrects the covariance of the start.

    It computes what the start adds to the sum of squares, and the determinant of the covariance of
    whitened residuals:

        b' (1 + P G) (1 + P0 G)^-1 (P - P0) b        det(1 + P0 G) / det(1 + P G)

    They are independent where the start has the covariance P, and it has P0; b (n,): what they show
    of it.
    """
    plain, decomposed = emit_product(module, (n, n, n)), emit_lu(module, n)
    function, b = begin_function(module, "start", 0, [VECTORS] * 6)
    p, g, start, shown, gained, determinant = function.args
    m = Memory(b, False)
    settled, known, lu = (m.room(n * n) for _ in range(3))
    row, solved, other = m.room(n), m.room(n), m.room(1)
    for product, covariance in ((settled, p), (known, start)):
        b.call(plain, [product, covariance, g])
        _add_one(m, n, product)
    b.call(decomposed, [lu, settled, other])
    b.call(decomposed, [lu, known, determinant])
    scores = m.row(shown, n)
    for i in range(n):
        change = [m.get(p, i * n + j) - m.get(start, i * n + j) for j in range(n)]
        m.put(dot(change, scores), row, i)
    b.call(emit_lu_solve(module, n, 1), [solved, lu, row])
    solution = m.row(solved, n)
    m.put(dot(scores, [dot(m.row(m.at(settled, i * n), n), solution) for i in range(n)]), gained, 0)
    m.put(m.get(determinant, 0) / m.get(other, 0), determinant, 0)
    b.ret_void()
    return function


COUNTS = ("groups", "samples")
BLOCKS = {
    "told": VECTORS,  # (G, P + K): parameters, variances
    "constants": NUMBERS,  # see `recurrence.Constants`
    "y": NUMBERS,  # (T, K)
    "u": NUMBERS,  # (T + 1, n_series)
    "shown": VECTORS,  # scratch (T / `BLOCK_SAMPLES` + 1, n)
    "out": VECTORS,  # (2 K + 1, G)
}
BLOCK_SAMPLES = 8  # samples


def write_steady_state(module: ir.Module, system: StateSpace, layout: Layout) -> None:
    """Write `steadily`, of COUNTS and addresses of BLOCKS; see `emit_steady_state`."""
    emit_steady_state(module, system, layout, (COUNTS, BLOCKS), _by_samples)


def emit_steady_state(
    module: ir.Module,
    system: StateSpace,
    layout: Layout,
    signature: tuple[Sequence[str], Mapping[str, ir.Type]],
    emit_sums: Callable[[SteadyFilter, list[ir.Value], ir.Value], list[Number]],
) -> None:
    """Write `steadily`, of counts and addresses of blocks, among them `told`, `constants`, `out`.

    It stores minus half the sums of squares of the whitened residuals `(K,)`, the start's part with
    them, their standard deviations `(K,)`, and the determinant that the start takes.  `layout`: of
    the rig with its torque.  `emit_sums`: of a filter that starts from a state `(n,)`, sums of
    squared innovations `(K,)`; it stores what they show of the first state `(n,)`.
    """
    exponential = emit_exponential(module, layout, increments=True)
    spread = emit_transition(module, system, slopes=False)
    riccati, start_of = emit_riccati(module, system), emit_start_correction(module, system.n)
    a, b = begin_kernel(module, "steadily", *signature)
    n, k_count, size = system.n, system.k, layout.size
    m, constants = Memory(b, False), Constants(b, layout, a["constants"])
    sizes = block_sizes(n, k_count)
    weights = constants.all_weights
    e, block, start = m.room(size * size), m.room(sum(sizes.values())), m.room(n * n)
    shown, span, gained = m.room(n), m.room(1), m.room(1)
    first = b.alloca(I64, I64(1))
    groups = Loop(b, a["groups"], [], "groups")
    parameters = b.gep(a["told"], [b.mul(groups.index, I64(system.p + k_count))])
    variances = m.at(parameters, system.p)
    out = [
        b.gep(a["out"], [b.add(b.mul(a["groups"], I64(k)), groups.index)])
        for k in range(2 * k_count + 1)
    ]
    state = constants.start(n)
    m.clear(start, n * n)
    for i in range(n - system.n_torque_states, n):
        m.put(1.0, start, i * n + i)
    at = addresses(b, block, I64(0), sizes)
    phi_at, q_at, p_at, g_at = (at[name] for name in ("phi", "q", "p", "g"))
    if layout.lead:
        b.write(constants.span(lead=True).value, span, 0)
        b.call(spread, [parameters, span, phi_at, q_at])
        predict_covariance(m, n, start, phi_at, q_at)
        constants.exponential(exponential, parameters, e, lead=True)
        state = next_state(b, n, phi_entries(b, layout, e), state, [])
    b.write(constants.span(lead=False).value, span, 0)
    b.call(spread, [parameters, span, phi_at, q_at])
    b.call(riccati, [a["samples"], block, variances, weights, first])
    constants.exponential(exponential, parameters, e, lead=False)
    phi = phi_entries(b, layout, e)
    steady = SteadyFilter(m, system, layout, a, phi, at, weights, first, groups.index)
    squares = emit_sums(steady, state, shown)
    b.call(start_of, [p_at, g_at, start, shown, gained, out[2 * k_count]])
    for k, total in enumerate(squares):
        root = steady.gains.inverse_deviation(k)
        m.put(-0.5 * (total * root * root + m.get(gained, 0) * (1.0 / k_count)), out[k], 0)
        m.put(1.0 / root, out[k_count + k], 0)
    groups.close([])
    b.ret_void()


@dataclass(frozen=True, slots=True)
class SteadyFilter:
    """What all samples of a group of walkers have in common; `first (1,)`: see `emit_riccati`."""

    m: Memory
    system: StateSpace
    layout: Layout
    a: dict[str, ir.Value]
    phi: dict[tuple[int, int], ir.Value]
    at: dict[str, ir.Value]  # see `block_sizes`
    weights: ir.Value
    first: ir.Value
    group: ir.Value

    @property
    def gains(self) -> Gains:
        """The gains of all channels."""
        return Gains(self.m, self.system, self.at["gains"], self.weights)

    def advance(
        self, index: ir.Value, registers: list[ir.Value], pulls: ir.Value | None
    ) -> list[ir.Value]:
        """Filter a sample: state (n), sums of squares (K) and, with `pulls (K, n)`, scores (n)."""
        b, n, k_count = self.m.b, self.system.n, self.system.k
        lanes = [Vector(b, register) for register in registers]
        state, sums, shown = lanes[:n], lanes[n : n + k_count], lanes[n + k_count :]
        drive = emit_drive(b, self.layout, self.a["u"], index)
        y = b.gep(self.a["y"], [b.mul(index, I64(k_count))])
        for k in range(k_count):
            value = Vector(b, b.splat(b.load(b.gep(y, [I64(k)]))))
            innovation, state = self.gains.update_state(k, state, value)
            sums[k] = multiply_add(innovation, innovation, sums[k])
            if pulls is not None:
                shown = [
                    multiply_add(self.m.get(pulls, k * n + i), innovation, x)
                    for i, x in enumerate(shown)
                ]
        following = next_state(b, n, self.phi, [x.value for x in state], drive, halves=False)
        return [*following, *(total.value for total in (*sums, *shown))]


def _by_samples(w: SteadyFilter, state: list[ir.Value], shown: ir.Value) -> list[Number]:
    """Filter sample after sample; see `emit_steady_state`."""
    b, informed = w.m.b, w.m.b.load(w.first)
    blocks = b.sdiv(b.add(informed, I64(BLOCK_SAMPLES - 1)), I64(BLOCK_SAMPLES))
    squares = _emit_samples(w, blocks, state)
    _emit_back(w, blocks, shown)
    return squares


def _emit_samples(w: SteadyFilter, blocks: ir.Value, state: list[ir.Value]) -> list[Number]:
    """Return the sums of squares of all samples; the first `blocks` store scores of their start."""
    m, b, n, k_count = w.m, w.m.b, w.system.n, w.system.k
    pulls = _emit_pulls(w)
    each = Loop(b, blocks, [*state, *[vector(0.0)] * k_count], "blocks")
    begins = b.mul(each.index, I64(BLOCK_SAMPLES))
    remaining = b.sub(w.a["samples"], begins)
    count = b.select(
        b.icmp_signed("<", remaining, I64(BLOCK_SAMPLES)), remaining, I64(BLOCK_SAMPLES)
    )
    inner = Loop(b, count, [*each.carried, *[vector(0.0)] * n], "samples")
    block_scores = m.at(pulls, b.mul(inner.index, I64(n * k_count)))
    inner_new = w.advance(b.add(begins, inner.index), inner.carried, block_scores)
    inner.close(inner_new)
    shown = m.at(w.a["shown"], b.mul(each.index, I64(n)))
    b.write_row(inner_new[n + k_count :], shown)
    each.close(inner_new[: n + k_count])
    totals = m.room(n + k_count)
    b.write_row(inner_new[: n + k_count], totals)
    begins = b.mul(blocks, I64(BLOCK_SAMPLES))
    remaining = b.sub(w.a["samples"], begins)
    with b.if_then(b.icmp_signed(">", remaining, I64(0))):
        later = Loop(b, remaining, b.read_row(totals, n + k_count), "later")
        new = w.advance(b.add(begins, later.index), later.carried, None)
        later.close(new)
        b.write_row(new, totals)
    return m.row(m.at(totals, n), k_count)


def _emit_pulls(w: SteadyFilter) -> ir.Value:
    """Return `(BLOCK_SAMPLES, K, n)`: what samples of a block show of its first state, A'^k pulls."""
    m, b, n, k_count = w.m, w.m.b, w.system.n, w.system.k
    each = n * k_count
    onward = emit_product(b.module, (k_count, n, n))
    pulls, a = m.room(BLOCK_SAMPLES * each), w.at["a"]
    b.copy(w.at["pulls"], pulls, each)
    for k in range(1, BLOCK_SAMPLES):
        b.call(onward, [m.at(pulls, k * each), m.at(pulls, (k - 1) * each), a])
    return pulls


def _emit_back(w: SteadyFilter, blocks: ir.Value, shown: ir.Value) -> None:
    """Store what all blocks show of the first state: the sum of A'^k of theirs, backwards."""
    m, b, n = w.m, w.m.b, w.system.n
    square = emit_product(b.module, (n, n, n))
    powers, power = m.room(2 * n * n), w.at["a"]
    for k in range(BLOCK_SAMPLES.bit_length() - 1):
        following = m.at(powers, (k % 2) * n * n)
        b.call(square, [following, power, power])
        power = following
    back = Loop(b, blocks, [vector(0.0)] * n, "back")
    at = b.mul(b.sub(b.sub(blocks, I64(1)), back.index), I64(n))
    block_scores = m.row(m.at(w.a["shown"], at), n)
    later_scores = [Vector(b, register) for register in back.carried]
    summed = [
        dot([m.get(power, j * n + i) for j in range(n)], later_scores, block_scores[i]).value
        for i in range(n)
    ]
    back.close(summed)
    b.write_row(summed, shown)
