"""The likelihood by a Kalman filter of one steady-state gain: the Riccati equation by doubling, and an
exact start.

2^j steps have the covariance H that they leave of a known state, a transition B, and the information G
of their samples on the state before them.  Two such stretches make one of twice the length (Anderson
1978):

    B <- B E        E = (1 + H G)^-1 B
    G <- G + B' G E
    H <- H + B (1 + H G)^-1 H B'

until H is the steady-state covariance P.  One that goes before a stretch of information G' has, with
it, G + B' G' (1 + H G')^-1 B: the record is put together of stretches as its length is written in twos.

With the gain of P the filter is the recurrence of the response, channel after channel of a sample
e = y - c x, x <- x + k e, then x <- Phi x + g + G u.  That the start has another covariance than P is
made good at the end, from the information of all samples on it, see `emit_start`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
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
    Lane,
    Loop,
    begin_function,
    begin_kernel,
    vector,
)
from bayesdrill.rig.kernels.numbers import (
    Memory,
    Number,
    dot,
    emit_decomposed,
    emit_even,
    emit_product,
    emit_solved,
    fused,
)
from bayesdrill.rig.kernels.recurrence import Constants, emit_drive, entries, next_state

LEAST, MOST = 7, 44  # doublings
SETTLED = 1e-14  # of the variance of a sample: what one more doubling may add to it
ROUNDING = (
    1e-15  # of a sum; after a stretch that adds no more to it, one as long as both tells nothing
)


def block_sizes(n: int, k: int) -> dict[str, int]:
    """Of what `riccati` is told and leaves in one block: matrices (n, n); see `Gains`; pulls `(K, n)`,
    what a channel shows of the state before the sample, over its variance.
    """
    return dict.fromkeys(("p", "phi", "q", "g", "a"), n * n) | {
        "gains": k * Gains.width(n),
        "pulls": k * n,
    }


@dataclass(frozen=True, slots=True)
class Measurement:
    """Of what channels show of the state: `variances (K,)` of its noise, and `weights (K, n)`."""

    m: Memory
    system: StateSpace
    variances: ir.Value
    weights: ir.Value

    def inform(self, information: ir.Value) -> None:
        """`information (n, n)` of one sample on its state."""
        m, b, n = self.m, self.m.b, self.system.n
        m.clear(information, n * n)
        for k in range(self.system.k):
            over = Lane(b, b.fdiv(vector(1.0), b.read(self.variances, k)))
            for place, both in self._products(k):
                m.put(m.get(information, place) + over * both, information, place)

    def grow(self, p: ir.Value, more: ir.Value, grown: ir.Value) -> ir.Value:
        """`more` comes to p; whether a channel would see the next: that is less by at least as much as
        this one is than the one before, `grown (K,)`.
        """
        m, b, n = self.m, self.m.b, self.system.n
        moves = ir.Constant(ir.VectorType(ir.IntType(1), LANES), [0] * LANES)
        for k in range(self.system.k):
            change, variance = Lane(b, vector(0.0)), Lane(b, b.read(self.variances, k))
            for place, both in self._products(k):
                change = fused(both, m.get(more, place), change)
                variance = fused(both, m.get(p, place), variance)
            least = variance * SETTLED * m.get(grown, k)
            moves = b.or_(moves, b.fcmp_ordered(">", (change * change).value, least.value))
            m.put(change, grown, k)
        for place in range(n * n):
            m.put(m.get(p, place) + m.get(more, place), p, place)
        return b.anywhere(moves)

    def _products(self, k: int) -> Iterator[tuple[int, Lane]]:
        """Of two weights of channel k, by place in a matrix."""
        own = self.system.weights(self.m.b, self.weights, k)
        for i, weight in own.items():
            for j, other in own.items():
                yield i * self.system.n + j, weight * other


def emit_riccati(module: ir.Module, system: StateSpace) -> ir.Function:
    """`riccati(samples, block, variances, weights, first)`: of Phi and Q in the `block`, all the rest of
    it; G is that of all samples; `first (1,)` gets how many of them tell anything of the start.
    """
    double, gain, before = (
        _emit_doubling(module, system),
        _emit_gain(module, system),
        _emit_prepend(module, system.n),
    )
    made, b = begin_function(module, "riccati", 1, [VECTORS, VECTORS, NUMBERS, I64.as_pointer()])
    samples, block, variances, weights, first = made.args
    n = system.n
    memory, at = Memory(b, False), addresses(b, block, I64(0), block_sizes(n, system.k))
    phi, q, p, g = (at[name] for name in ("phi", "q", "p", "g"))
    one, other, information = (memory.room(n * n) for _ in range(3))
    grown, grows = memory.room(system.k), b.alloca(ir.IntType(1), I64(1))
    for k in range(system.k):
        memory.put(math.inf, grown, k)
    b.copy(phi, one, n * n)
    b.copy(q, p, n * n)
    Measurement(memory, system, variances, weights).inform(information)
    memory.clear(g, n * n)
    b.store(samples, first)
    entry = b.block
    body, after = b.append_basic_block("doubling"), b.append_basic_block("settled")
    b.branch(body)
    b.position_at_end(body)
    count, transition, spare = b.phi(I64), b.phi(VECTORS), b.phi(VECTORS)
    for node, value in ((count, I64(0)), (transition, one), (spare, other)):
        node.add_incoming(value, entry)
    with b.if_then(b.trunc(b.lshr(samples, count), ir.IntType(1))):
        b.call(before, [transition, information, p, g])
    arguments = [transition, spare, information, p, variances, weights, grown, grows]
    moves = b.call(double, arguments)
    following = b.add(count, I64(1))
    length = b.shl(I64(1), following)
    told = b.and_(b.not_(b.load(grows)), b.icmp_signed("<", length, b.load(first)))
    with b.if_then(told):
        b.store(length, first)
    whole = b.icmp_signed(">", length, b.load(first))
    more = b.or_(moves, b.icmp_signed("<", count, I64(LEAST)))
    more = b.and_(b.or_(more, b.not_(whole)), b.icmp_signed("<", count, I64(MOST)))
    count.add_incoming(following, b.block)
    transition.add_incoming(spare, b.block)
    spare.add_incoming(transition, b.block)
    b.cbranch(more, body, after)
    b.position_at_end(after)
    with b.if_then(b.icmp_signed("<", b.load(first), samples)):
        b.copy(information, g, n * n)
    b.call(gain, [block, variances, weights])
    b.ret_void()
    return made


def _emit_doubling(module: ir.Module, system: StateSpace) -> ir.Function:
    """`doubling(B, its next, G, H, variances, weights, grown (K,), grows)`: whether one more changes
    anything in any lane; `grows (1,)`: whether G still does.
    """
    n = system.n
    plain, solved = emit_product(module, (n, n, n)), emit_solved(module, n, n)
    across = emit_even(module, n)
    along = emit_even(module, n, left=True, adds=True)
    flag = ir.IntType(1)
    kinds = [*[VECTORS] * 5, NUMBERS, VECTORS, flag.as_pointer()]
    made = ir.Function(module, ir.FunctionType(flag, kinds), "doubling")
    for argument in made.args:
        argument.add_attribute("noalias")
    transition, following, information, p, variances, weights, grown, grows = made.args
    b = Builder(made.append_basic_block())
    m = Memory(b, False)
    lu, x, e, more = (m.room(n * n) for _ in range(4))
    b.call(plain, [x, p, information])
    _add_one(m, n, x)
    b.call(emit_decomposed(module, n), [lu, x, m.room(1)])
    b.call(solved, [x, lu, p])
    b.call(plain, [e, transition, x])
    b.call(across, [more, e, transition])
    b.call(solved, [e, lu, transition])
    b.call(plain, [following, transition, e])
    b.call(plain, [x, information, e])
    before = [m.get(information, i * n + i) for i in range(n)]
    b.call(along, [information, transition, x])
    b.store(_differs(m, n, before, information), grows)
    b.ret(Measurement(m, system, variances, weights).grow(p, more, grown))
    return made


def _add_one(m: Memory, n: int, x: ir.Value) -> None:
    for i in range(n):
        m.put(m.get(x, i * n + i) + 1.0, x, i * n + i)


def _differs(m: Memory, n: int, before: list[Number], now: ir.Value) -> ir.Value:
    """Whether a diagonal has grown by more than rounding, and twice the stretch may tell more."""
    grown = ir.Constant(ir.VectorType(ir.IntType(1), LANES), [0] * LANES)
    for i, old in enumerate(before):
        much = old * (1.0 + ROUNDING)
        grown = m.b.or_(grown, m.b.fcmp_ordered(">", m.get(now, i * n + i).value, much.value))
    return m.b.anywhere(grown)


def _emit_prepend(module: ir.Module, n: int) -> ir.Function:
    """`prepend(B, G, H, end)`: the stretch goes before what has the information `end (n, n)`."""
    plain, solved = emit_product(module, (n, n, n)), emit_solved(module, n, n)
    along = emit_even(module, n, left=True, adds=True)
    made, b = begin_function(module, "prepend", 0, [VECTORS] * 4)
    transition, information, p, end = made.args
    m = Memory(b, False)
    lu, x, e = (m.room(n * n) for _ in range(3))
    b.call(plain, [x, p, end])
    _add_one(m, n, x)
    b.call(emit_decomposed(module, n), [lu, x, m.room(1)])
    b.call(solved, [e, lu, transition])
    b.call(plain, [x, end, e])
    b.copy(information, end, n * n)
    b.call(along, [end, transition, x])
    b.ret_void()
    return made


def _emit_gain(module: ir.Module, system: StateSpace) -> ir.Function:
    """`gain(block, variances, weights)`: gains, pulls, and A."""
    n = system.n
    onward = emit_product(module, (n, n, n))
    made, b = begin_function(module, "gain", 0, [VECTORS, VECTORS, NUMBERS])
    block, variances, weights = made.args
    m, at = Memory(b, False), addresses(b, block, I64(0), block_sizes(n, system.k))
    pulls, gains = at["pulls"], Gains(m, system, at["gains"], weights)
    left, passed = m.room(n * n), m.room(n * n)
    b.copy(at["p"], left, n * n)
    m.clear(passed, n * n)
    _add_one(m, n, passed)
    for k in range(system.k):
        gains.update_covariance(k, left, variances)
        own = list(system.weights(b, weights, k).values())
        rows = [m.row(m.at(passed, i * n), n) for i in system.seen(k)]
        shows = [dot(own, [row[j] for row in rows]) for j in range(n)]
        root = gains.inverse_deviation(k)
        for i, (one, gain) in enumerate(zip(shows, gains.of(k), strict=True)):
            m.put(one * root * root, pulls, k * n + i)
            for j, other in enumerate(shows):
                m.put(fused(-gain, other, m.get(passed, i * n + j)), passed, i * n + j)
    b.call(onward, [at["a"], at["phi"], passed])
    b.ret_void()
    return made


def emit_start(module: ir.Module, n: int) -> ir.Function:
    """`start(p, g, p0, b, gained, determinant)`: what the start adds to the sum of squares, and the
    determinant of the covariance of whitened residuals:

        b' (1 + P G) (1 + P0 G)^-1 (P - P0) b        det(1 + P0 G) / det(1 + P G)

    They are independent where the start has the covariance P, and it has P0; b (n,): what they show
    of it.
    """
    plain, decomposed = emit_product(module, (n, n, n)), emit_decomposed(module, n)
    made, b = begin_function(module, "start", 0, [VECTORS] * 6)
    p, g, start, shown, gained, determinant = made.args
    m = Memory(b, False)
    settled, known, lu = (m.room(n * n) for _ in range(3))
    row, solved, other = m.room(n), m.room(n), m.room(1)
    for product, covariance in ((settled, p), (known, start)):
        b.call(plain, [product, covariance, g])
        _add_one(m, n, product)
    b.call(decomposed, [lu, settled, other])
    b.call(decomposed, [lu, known, determinant])
    own = m.row(shown, n)
    for i in range(n):
        change = [m.get(p, i * n + j) - m.get(start, i * n + j) for j in range(n)]
        m.put(dot(change, own), row, i)
    b.call(emit_solved(module, n, 1), [solved, lu, row])
    found = m.row(solved, n)
    m.put(dot(own, [dot(m.row(m.at(settled, i * n), n), found) for i in range(n)]), gained, 0)
    m.put(m.get(determinant, 0) / m.get(other, 0), determinant, 0)
    b.ret_void()
    return made


COUNTS = ("groups", "samples")
BLOCKS = {
    "told": VECTORS,  # (G, P + K): parameters, variances
    "constants": NUMBERS,  # see `recurrence.Constants`
    "y": NUMBERS,  # (T, K)
    "u": NUMBERS,  # (T + 1, n_series)
    "shown": VECTORS,  # scratch (T / `AT_ONCE` + 1, n)
    "out": VECTORS,  # (2 K + 1, G)
}
AT_ONCE = 8  # samples


def write_steady_state(module: ir.Module, system: StateSpace, layout: Layout) -> None:
    """`steadily`, of COUNTS and addresses of BLOCKS: minus half the sums of squares of the whitened
    residuals `(K,)`, the start's part with them, their standard deviations `(K,)`, and the determinant
    that the start takes.  `layout`: of the rig with its torque.
    """
    exponential = emit_exponential(module, layout, increments=True)
    spread = emit_transition(module, system, slopes=False)
    riccati, start_of = emit_riccati(module, system), emit_start(module, system.n)
    a, b = begin_kernel(module, "steadily", COUNTS, BLOCKS)
    n, k_count, size = system.n, system.k, layout.size
    m, constants = Memory(b, False), Constants(b, layout, a["constants"])
    sizes = block_sizes(n, k_count)
    weights = constants.all_weights
    e, block, start = m.room(size * size), m.room(sum(sizes.values())), m.room(n * n)
    shown, span, gained = m.room(n), m.room(1), m.room(1)
    first = b.alloca(I64, I64(1))
    groups = Loop(b, a["groups"], [], "groups")
    own = b.gep(a["told"], [b.mul(groups.index, I64(system.p + k_count))])
    variances = m.at(own, system.p)
    out = [
        b.gep(a["out"], [b.add(b.mul(a["groups"], I64(k)), groups.index)])
        for k in range(2 * k_count + 1)
    ]
    state = constants.start(n)
    m.clear(start, n * n)
    for i in range(n - system.own, n):
        m.put(1.0, start, i * n + i)
    at = addresses(b, block, I64(0), sizes)
    phi_at, q_at, p_at, g_at = (at[name] for name in ("phi", "q", "p", "g"))
    if layout.lead:
        b.write(constants.span(lead=True).value, span, 0)
        b.call(spread, [own, span, phi_at, q_at])
        predict_covariance(m, n, start, phi_at, q_at)
        constants.exponential(exponential, own, e, lead=True)
        state = next_state(b, n, entries(b, layout, e), state, [])
    b.write(constants.span(lead=False).value, span, 0)
    b.call(spread, [own, span, phi_at, q_at])
    b.call(riccati, [a["samples"], block, variances, weights, first])
    constants.exponential(exponential, own, e, lead=False)
    writer = _Samples(m, system, layout, a, entries(b, layout, e), at, weights)
    blocks = b.sdiv(b.add(b.load(first), I64(AT_ONCE - 1)), I64(AT_ONCE))
    squares = _emit_samples(writer, blocks, state)
    _emit_back(writer, blocks, shown)
    b.call(start_of, [p_at, g_at, start, shown, gained, out[2 * k_count]])
    for k, total in enumerate(squares):
        root = writer.gains.inverse_deviation(k)
        m.put(-0.5 * (total * root * root + m.get(gained, 0) * (1.0 / k_count)), out[k], 0)
        m.put(1.0 / root, out[k_count + k], 0)
    groups.close([])
    b.ret_void()


@dataclass(frozen=True, slots=True)
class _Samples:
    """What all samples of a group of walkers have in common."""

    m: Memory
    system: StateSpace
    layout: Layout
    a: dict[str, ir.Value]
    phi: dict[tuple[int, int], ir.Value]
    at: dict[str, ir.Value]  # see `block_sizes`
    weights: ir.Value

    @property
    def gains(self) -> Gains:
        return Gains(self.m, self.system, self.at["gains"], self.weights)

    def passed(
        self, index: ir.Value, carried: list[ir.Value], pulls: ir.Value | None
    ) -> list[ir.Value]:
        """A sample: state (n), sums of squares (K) and, with `pulls (K, n)`, what it shows (n)."""
        b, n, k_count = self.m.b, self.system.n, self.system.k
        lanes = [Lane(b, one) for one in carried]
        state, sums, shown = lanes[:n], lanes[n : n + k_count], lanes[n + k_count :]
        drive = emit_drive(b, self.layout, self.a["u"], index)
        y = b.gep(self.a["y"], [b.mul(index, I64(k_count))])
        for k in range(k_count):
            value = Lane(b, b.splat(b.load(b.gep(y, [I64(k)]))))
            innovation, state = self.gains.update_state(k, state, value)
            sums[k] = fused(innovation, innovation, sums[k])
            if pulls is not None:
                shown = [
                    fused(self.m.get(pulls, k * n + i), innovation, x) for i, x in enumerate(shown)
                ]
        following = next_state(b, n, self.phi, [x.value for x in state], drive, halves=False)
        return [*following, *(one.value for one in (*sums, *shown))]


def _emit_samples(w: _Samples, blocks: ir.Value, state: list[ir.Value]) -> list[Number]:
    """Sums of squares of all samples, forwards; the first `blocks` say what they show of their start."""
    m, b, n, k_count = w.m, w.m.b, w.system.n, w.system.k
    pulls = _emit_pulls(w)
    each = Loop(b, blocks, [*state, *[vector(0.0)] * k_count], "blocks")
    begins = b.mul(each.index, I64(AT_ONCE))
    left = b.sub(w.a["samples"], begins)
    count = b.select(b.icmp_signed("<", left, I64(AT_ONCE)), left, I64(AT_ONCE))
    inner = Loop(b, count, [*each.carried, *[vector(0.0)] * n], "samples")
    own = m.at(pulls, b.mul(inner.index, I64(n * k_count)))
    inner_new = w.passed(b.add(begins, inner.index), inner.carried, own)
    inner.close(inner_new)
    shown = m.at(w.a["shown"], b.mul(each.index, I64(n)))
    b.write_row(inner_new[n + k_count :], shown)
    each.close(inner_new[: n + k_count])
    kept = m.room(n + k_count)
    b.write_row(inner_new[: n + k_count], kept)
    begins = b.mul(blocks, I64(AT_ONCE))
    left = b.sub(w.a["samples"], begins)
    with b.if_then(b.icmp_signed(">", left, I64(0))):
        later = Loop(b, left, b.read_row(kept, n + k_count), "later")
        new = w.passed(b.add(begins, later.index), later.carried, None)
        later.close(new)
        b.write_row(new, kept)
    return m.row(m.at(kept, n), k_count)


def _emit_pulls(w: _Samples) -> ir.Value:
    """`(AT_ONCE, K, n)`: what the samples of a block show of its first state, A'^k of the first's."""
    m, b, n, k_count = w.m, w.m.b, w.system.n, w.system.k
    each = n * k_count
    onward = emit_product(b.module, (k_count, n, n))
    pulls, a = m.room(AT_ONCE * each), w.at["a"]
    b.copy(w.at["pulls"], pulls, each)
    for k in range(1, AT_ONCE):
        b.call(onward, [m.at(pulls, k * each), m.at(pulls, (k - 1) * each), a])
    return pulls


def _emit_back(w: _Samples, blocks: ir.Value, shown: ir.Value) -> None:
    """What all blocks show of the first state: sum of A'^k of theirs, from the last to the first."""
    m, b, n = w.m, w.m.b, w.system.n
    square = emit_product(b.module, (n, n, n))
    powers, power = m.room(2 * n * n), w.at["a"]
    for k in range(AT_ONCE.bit_length() - 1):
        following = m.at(powers, (k % 2) * n * n)
        b.call(square, [following, power, power])
        power = following
    back = Loop(b, blocks, [vector(0.0)] * n, "back")
    at = b.mul(b.sub(b.sub(blocks, I64(1)), back.index), I64(n))
    own = m.row(m.at(w.a["shown"], at), n)
    carried = [Lane(b, one) for one in back.carried]
    found = [
        dot([m.get(power, j * n + i) for j in range(n)], carried, own[i]).value for i in range(n)
    ]
    back.close(found)
    b.write_row(found, shown)
