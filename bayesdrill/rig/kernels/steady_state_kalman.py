"""Compute the likelihood by a Kalman filter with one steady-state gain.

The Riccati equation is solved by doubling (Anderson 1978).

A block of 2^j samples has a transition B and two matrices.  H is the covariance of the state after
the block, given the state before it.  G is the information of the block's samples on the state
before it.  Two equal blocks make a block of twice the length:

    B <- B E        E = (1 + H G)^-1 B
    G <- G + B' G E
    H <- H + B (1 + H G)^-1 H B'

until H is the steady-state covariance P.  By the binary digits of the record's length, blocks are
joined to later samples with information G_2.  Together they have G + B' G_2 (1 + H G_2)^-1 B.

With the constant gain of P the filter is a linear recurrence.  Each channel of a sample updates
x <- x + k (y - c x), and the prediction is x <- Phi x + g + Gamma u.  The filter takes P for the
covariance at the start, too.  The result is corrected for this at the end, exactly, from the
information of all samples on the start (`_correct_start`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from llvmlite import ir

from bayesdrill.rig.kernels.exponential import Layout
from bayesdrill.rig.kernels.kalman_filter import (
    Gains,
    StateSpace,
    predict_covariance,
    store_transition,
)
from bayesdrill.rig.kernels.lanes import (
    I64,
    NOWHERE,
    NUMBERS,
    VECTORS,
    Builder,
    Loop,
    Module,
    Values,
    Vector,
    integer,
    kernel,
    vector,
)
from bayesdrill.rig.kernels.numbers import (
    Number,
    Numbers,
    decompose,
    dot,
    multiply,
    multiply_add,
    multiply_symmetric,
    solve,
)
from bayesdrill.rig.kernels.transitions import InputHold, State, Step, Transitions

# Smallest and largest number of doublings; no record has 2^44 samples.
MIN_DOUBLINGS, MAX_DOUBLINGS = 7, 44
# Largest addition of the next doubling to a channel's variance, relative to this variance.
COVARIANCE_TOLERANCE = 1e-14
# Once a block adds less than this fraction of the information, a block twice as long adds nothing.
INFORMATION_TOLERANCE = 1e-15


def _products(
    b: Builder, system: StateSpace, weights: ir.Value, k: int
) -> Iterator[tuple[int, Vector]]:
    """Yield the products of any two weights of channel k, by index in a matrix (n, n)."""
    shown = system.weights(b, weights, k)
    for i, weight in shown.items():
        for j, other in shown.items():
            yield i * system.n + j, weight * other


# Addresses of the matrices P, Phi, Q, G and A (n, n), gains (see `Gains`), `variances` of noise,
# `weights`, and pulls `(K, n)`: (dc/dx) / S of a predicted channel c with the innovation variance S.
Addresses = dict[str, ir.Value]


def _solve_riccati(
    m: Numbers, system: StateSpace, addresses: Addresses, samples: ir.Value, first: ir.Value
) -> None:
    """Store P, G, A, gains and pulls, for given Phi and Q.

    G is the information of all samples. `first (1,)` is the number of samples, counted from the
    start, that add information on the start.
    """
    n, b = system.n, m.b
    transition_a, transition_b, information = (m.room(n * n) for _ in range(3))
    addresses = addresses | {"information": information, "grown": m.room(system.k)}
    m.put_row([math.inf] * system.k, addresses["grown"])
    b.copy(addresses["phi"], transition_a, n * n)
    b.copy(addresses["q"], addresses["p"], n * n)
    m.clear(information, n * n)
    for k in range(system.k):
        over = 1.0 / m.get(addresses["variances"], k)
        for index, both in _products(b, system, addresses["weights"], k):
            m.put(m.get(information, index) + over * both, information, index)
    m.clear(addresses["g"], n * n)
    b.store(samples, first)
    entry = b.block
    body, after = b.append_basic_block("doubling"), b.append_basic_block("settled")
    b.branch(body)
    b.position_at_end(body)
    count, transition, spare = b.phi(I64), b.phi(VECTORS), b.phi(VECTORS)
    for node, value in ((count, integer(0)), (transition, transition_a), (spare, transition_b)):
        node.add_incoming(value, entry)
    with b.if_then(b.trunc(b.lshr(samples, count), ir.IntType(1))):
        _prepend(m, n, addresses, transition)
    grows, moves = _double(m, system, addresses, transition, spare)
    following = b.add(count, 1)
    length = b.shl(1, following)
    informed = b.and_(b.not_(grows), b.icmp_signed("<", length, b.load(first)))
    with b.if_then(informed):
        b.store(length, first)
    beyond = b.icmp_signed(">", length, b.load(first))
    more = b.or_(moves, b.icmp_signed("<", count, MIN_DOUBLINGS))
    more = b.and_(b.or_(more, b.not_(beyond)), b.icmp_signed("<", count, MAX_DOUBLINGS))
    count.add_incoming(following, b.block)
    transition.add_incoming(spare, b.block)
    spare.add_incoming(transition, b.block)
    b.cbranch(more, body, after)
    b.position_at_end(after)
    with b.if_then(b.icmp_signed("<", b.load(first), samples)):
        b.copy(information, addresses["g"], n * n)
    _store_gains(m, system, addresses)


def _double(
    m: Numbers, system: StateSpace, addresses: Addresses, transition: ir.Value, following: ir.Value
) -> tuple[ir.Value, ir.Value]:
    """Store the `following` B, and G (`information`) and H (`p`), for twice as many steps.

    Returns whether G has grown by more than rounding, and whether the next addition to H may change
    the variance of any channel. After the additions a_j-1 and a_j to this variance, the next is at
    most a_j^2 / a_j-1. `grown (K,)` stores a_j.
    """
    n, b, p, information = system.n, m.b, addresses["p"], addresses["information"]
    lu, x, e, more = (m.room(n * n) for _ in range(4))
    _decompose_sum(m, n, p, information, x, lu, m.room(1))
    solve(b, x, lu, p, n, n)
    multiply(b, e, transition, x, (n, n, n))
    multiply_symmetric(b, more, e, transition, n)
    solve(b, e, lu, transition, n, n)
    multiply(b, following, transition, e, (n, n, n))
    multiply(b, x, information, e, (n, n, n))
    before = [m.get(information, i * n + i) for i in range(n)]
    multiply_symmetric(b, information, transition, x, n, transposed=True, adds=True)
    changed = NOWHERE
    for i, old in enumerate(before):
        much, now = old * (1.0 + INFORMATION_TOLERANCE), m.get(information, i * n + i)
        changed = b.or_(changed, b.fcmp_ordered(">", now.value, much.value))
    grows, changed = b.anywhere(changed), NOWHERE
    for k in range(system.k):
        change, variance = Vector(b, vector(0.0)), m.get(addresses["variances"], k)
        for index, both in _products(b, system, addresses["weights"], k):
            change = multiply_add(both, m.get(more, index), change)
            variance = multiply_add(both, m.get(p, index), variance)
        least = variance * COVARIANCE_TOLERANCE * m.get(addresses["grown"], k)
        changed = b.or_(changed, b.fcmp_ordered(">", (change * change).value, least.value))
        m.put(change, addresses["grown"], k)
    m.put_row([m.get(p, index) + m.get(more, index) for index in range(n * n)], p)
    return grows, b.anywhere(changed)


def _decompose_sum(
    m: Numbers,
    n: int,
    p: ir.Value,
    g: ir.Value,
    total: ir.Value,
    lu: ir.Value,
    determinant: ir.Value,
) -> None:
    """Store 1 + P G, its decomposition `lu`, and its determinant."""
    multiply(m.b, total, p, g, (n, n, n))
    _add_one(m, n, total)
    decompose(m.b, lu, total, determinant, n)


def _add_one(m: Numbers, n: int, x: ir.Value) -> None:
    for i in range(n):
        m.put(m.get(x, i * n + i) + 1.0, x, i * n + i)


def _prepend(m: Numbers, n: int, addresses: Addresses, transition: ir.Value) -> None:
    """Put the block B, G, H before samples with information `g`; store the joint information in `g`."""
    b, end = m.b, addresses["g"]
    lu, x, e = (m.room(n * n) for _ in range(3))
    _decompose_sum(m, n, addresses["p"], end, x, lu, m.room(1))
    solve(b, e, lu, transition, n, n)
    multiply(b, x, end, e, (n, n, n))
    b.copy(addresses["information"], end, n * n)
    multiply_symmetric(b, end, transition, x, n, transposed=True, adds=True)


def _store_gains(m: Numbers, system: StateSpace, addresses: Addresses) -> None:
    """Store gains, pulls, and the transition A of the filter's error."""
    n, b = system.n, m.b
    gains = Gains(m, system, addresses["gains"], addresses["weights"])
    updated, closed_loop = m.room(n * n), m.room(n * n)
    b.copy(addresses["p"], updated, n * n)
    m.clear(closed_loop, n * n)
    _add_one(m, n, closed_loop)
    for k in range(system.k):
        gains.update_covariance(k, updated, addresses["variances"])
        weights = system.weights(b, addresses["weights"], k)
        rows = [m.row(closed_loop, n, i * n) for i in weights]
        shows = [dot([*weights.values()], [row[j] for row in rows]) for j in range(n)]
        root = gains.inverse_deviation(k)
        m.put_row([weight * root * root for weight in shows], addresses["pulls"], k * n)
        for i, gain in enumerate(gains.gain(k)):
            pairs = zip(shows, m.row(closed_loop, n, i * n), strict=True)
            m.put_row([multiply_add(-gain, *pair) for pair in pairs], closed_loop, i * n)
    multiply(b, addresses["a"], addresses["phi"], closed_loop, (n, n, n))


def _correct_start(
    m: Numbers,
    n: int,
    addresses: Addresses,
    start: ir.Value,
    shown: ir.Value,
    determinant: ir.Value,
) -> Number:
    """Correct for the covariance P0 (`start`) of the start, which the filter takes as P.

    Return the first term, which is added to the sum of squares.  Store the second, the determinant
    of the covariance of the whitened residuals:

        b' (1 + P G) (1 + P0 G)^-1 (P - P0) b        det(1 + P0 G) / det(1 + P G)

    With P the residuals would be independent.  `b (n,)` would be the score of the start: the
    gradient of the log-likelihood with respect to the state at the start.
    """
    b, p, g = m.b, addresses["p"], addresses["g"]
    settled, known, lu = (m.room(n * n) for _ in range(3))
    row, solved, other = m.room(n), m.room(n), m.room(1)
    _decompose_sum(m, n, p, g, settled, lu, other)
    _decompose_sum(m, n, start, g, known, lu, determinant)
    scores = m.row(shown, n)
    for i in range(n):
        pairs = zip(m.row(p, n, i * n), m.row(start, n, i * n), strict=True)
        m.put(dot([now - begun for now, begun in pairs], scores), row, i)
    solve(b, solved, lu, row, n, 1)
    solution = m.row(solved, n)
    m.put(m.get(determinant, 0) / m.get(other, 0), determinant, 0)
    return dot(scores, [dot(m.row(settled, n, i * n), solution) for i in range(n)])


COUNTS = ("groups", "samples", "lead")  # lead: 1 if the start is before the first sample, else 0
BLOCKS = {
    "told": VECTORS,  # (G, P + K) of G groups of walkers: P parameters, K variances of noise
    "spans": NUMBERS,  # (2,): step, and span from the start to the first sample
    "constants": NUMBERS,  # constant inputs
    "start": NUMBERS,  # (n,)
    "weights": NUMBERS,  # (K, n) weights of states in channels
    "y": NUMBERS,  # (T, K) measured values
    "u": NUMBERS,  # (T, S or 2 S): sampled inputs and, with a first-order hold, their time slopes
    "shown": VECTORS,  # scratch (T / `BLOCK_SAMPLES` + 1, n): scores of blocks
    "out": VECTORS,  # (2 K + 1, G), see `write_steady_state`
}
BLOCK_SAMPLES = 8  # number of samples for which one score is stored


def write_steady_state(module: Module, system: StateSpace, layout: Layout) -> None:
    """Write the kernel `steadily`, whose arguments are COUNTS and the addresses of BLOCKS.

    It stores minus half the sums of squared whitened residuals `(K,)`, which include the term of
    the start.  Standard deviations of innovations `(K,)` and the determinant of `_correct_start`
    follow.  `layout` is that of the rig with its torque.
    """
    n, k_count = system.n, system.k
    with kernel(module, "steadily", COUNTS, BLOCKS) as (a, b):
        m = Numbers(b, False)
        sizes = dict.fromkeys(("p", "phi", "q", "g", "a"), n * n)
        sizes |= {"gains": k_count * Gains.width(n), "pulls": k_count * n}
        at = {name: m.room(size) for name, size in sizes.items()}
        at["weights"] = a["weights"]
        start, shown, first = m.room(n * n), m.room(n), b.room(1, I64)
        table, has_lead = m.room(2 * layout.size**2), b.icmp_signed("!=", a["lead"], 0)
        with b.loop(a["groups"], "groups") as group:
            parameters = b.offset(a["told"], group, system.p + k_count)
            at["variances"] = m.at(parameters, system.p)
            out = [
                b.offset(a["out"], b.add(b.mul(a["groups"], k), group))
                for k in range(2 * k_count + 1)
            ]
            m.clear(start, n * n)
            for i in range(n - system.n_torque_states, n):
                m.put(1.0, start, i * n + i)
            transitions = Transitions(
                b=b, layout=layout, kind=m, parameters=(parameters,), constants=a["constants"],
                table=table, rungs=table, width=Vector(b, b.shared(a["spans"], 0)),
                halved=False,
            )  # fmt: skip
            transitions.fill_table(b.add(a["lead"], 1), a["spans"], None)
            state = [Vector(b, b.shared(a["start"], i)) for i in range(n)]

            def at_first_sample(
                parameters: ir.Value = parameters,
                transitions: Transitions = transitions,
                state: State = state,
            ) -> Values:
                span = b.shared(a["spans"], 1)
                store_transition(b, parameters, span, at["phi"], at["q"], system, slopes=False)
                predict_covariance(m, n, start, at["phi"], at["q"])
                drive = InputHold.load(b, layout, a["u"], integer(0))
                held = InputHold(drive.inputs, [m.zero() for _ in drive.slopes])
                return m.flat(transitions.step(table, 1)(state, held))

            registers = b.replace_if(has_lead, m.flat(state), at_first_sample)
            span = b.shared(a["spans"], 0)
            store_transition(b, parameters, span, at["phi"], at["q"], system, slopes=False)
            _solve_riccati(m, system, at, a["samples"], first)
            step = transitions.step(table, 0)
            steady = SteadyFilter(m, system, layout, a, step, at, first)
            squares = _emit_sums(steady, registers, shown)
            gained = _correct_start(m, n, at, start, shown, out[2 * k_count])
            for k, total in enumerate(squares):
                root = steady.gains.inverse_deviation(k)
                start_part = gained * (1.0 / k_count)
                m.put(-0.5 * (total * root * root + start_part), out[k], 0)
                m.put(1.0 / root, out[k_count + k], 0)


@dataclass(frozen=True, slots=True)
class SteadyFilter:
    """The filter has the numbers that all samples of a group of walkers share.

    `n_informative (1,)` is the argument `first` of `_solve_riccati`.
    """

    m: Numbers
    system: StateSpace
    layout: Layout
    a: dict[str, ir.Value]
    step: Step
    addresses: Addresses
    n_informative: ir.Value

    @property
    def gains(self) -> Gains:
        """Return the gains of all channels."""
        return Gains(self.m, self.system, self.addresses["gains"], self.addresses["weights"])

    def advance(
        self, index: ir.Value, registers: list[ir.Value], pulls: ir.Value | None
    ) -> list[ir.Value]:
        """Filter a sample; return state (n), sums of squares (K) and, if `pulls (K, n)`, scores (n)."""
        b, n, k_count = self.m.b, self.system.n, self.system.k
        lanes = [Vector(b, register) for register in registers]
        state, sums, shown = lanes[:n], lanes[n : n + k_count], lanes[n + k_count :]
        drive = InputHold.load(b, self.layout, self.a["u"], index)
        y = b.offset(self.a["y"], b.mul(index, k_count))
        for k in range(k_count):
            value = Vector(b, b.shared(y, k))
            innovation, state = self.gains.update_state(k, state, value)
            sums[k] = multiply_add(innovation, innovation, sums[k])
            if pulls is not None:
                pairs = zip(self.m.row(pulls, n, k * n), shown, strict=True)
                shown = [multiply_add(pull, innovation, x) for pull, x in pairs]
        return self.m.flat([*self.step(state, drive), *sums, *shown])


def _emit_sums(w: SteadyFilter, state: list[ir.Value], shown: ir.Value) -> list[Number]:
    """Return sums of squared innovations `(K,)` of a filter that starts from a `state (n,)`.

    `shown` receives the score `(n,)` of the first state.
    """
    b, informed = w.m.b, w.m.b.load(w.n_informative)
    blocks = b.sdiv(b.add(informed, BLOCK_SAMPLES - 1), BLOCK_SAMPLES)
    squares = _emit_samples(w, blocks, state)
    _emit_back(w, blocks, shown)
    return squares


def _emit_samples(w: SteadyFilter, blocks: ir.Value, state: list[ir.Value]) -> list[Number]:
    """Return the sums of squares of all samples; the first `blocks` of samples store their scores."""
    m, b, n, k_count = w.m, w.m.b, w.system.n, w.system.k
    pulls, none = _emit_pulls(w), vector(0.0)
    each = Loop(b, blocks, [*state, *[none] * k_count], "blocks")
    begins = b.mul(each.index, BLOCK_SAMPLES)
    count = b.minimum(b.sub(w.a["samples"], begins), BLOCK_SAMPLES)
    inner = Loop(b, count, [*each.carried, *[none] * n], "samples")
    block_scores = m.at(pulls, b.mul(inner.index, n * k_count))
    new = w.advance(b.add(begins, inner.index), inner.carried, block_scores)
    inner.close(new)
    b.write_row(new[n + k_count :], m.at(w.a["shown"], b.mul(each.index, n)))
    each.close(new[: n + k_count])
    begins = b.mul(blocks, BLOCK_SAMPLES)
    remaining = b.sub(w.a["samples"], begins)

    def others() -> list[ir.Value]:
        later = Loop(b, remaining, new[: n + k_count], "later")
        last = w.advance(b.add(begins, later.index), later.carried, None)
        later.close(last)
        return last

    more = b.icmp_signed(">", remaining, 0)
    return m.shaped(b.replace_if(more, new[: n + k_count], others)[n:])


def _emit_pulls(w: SteadyFilter) -> ir.Value:
    """Return pulls times A^j `(BLOCK_SAMPLES, K, n)`, for sample j and its block's first state."""
    m, b, n, k_count = w.m, w.m.b, w.system.n, w.system.k
    each = n * k_count
    pulls, a = m.room(BLOCK_SAMPLES * each), w.addresses["a"]
    b.copy(w.addresses["pulls"], pulls, each)
    for k in range(1, BLOCK_SAMPLES):
        multiply(b, m.at(pulls, k * each), m.at(pulls, (k - 1) * each), a, (k_count, n, n))
    return pulls


def _emit_back(w: SteadyFilter, blocks: ir.Value, shown: ir.Value) -> None:
    """Store the score s of the first state: backwards, s <- (A^BLOCK_SAMPLES)' s + block's score."""
    m, b, n = w.m, w.m.b, w.system.n
    powers, power = m.room(2 * n * n), w.addresses["a"]
    for k in range(BLOCK_SAMPLES.bit_length() - 1):
        following = m.at(powers, (k % 2) * n * n)
        multiply(b, following, power, power, (n, n, n))
        power = following
    back = Loop(b, blocks, [vector(0.0)] * n, "back")
    at = b.mul(b.sub(b.sub(blocks, 1), back.index), n)
    scores, later_scores = m.row(m.at(w.a["shown"], at), n), m.shaped(back.carried)
    columns = [[m.get(power, j * n + i) for j in range(n)] for i in range(n)]
    pairs = zip(columns, scores, strict=True)
    summed = m.flat([dot(column, later_scores, score) for column, score in pairs])
    back.close(summed)
    b.write_row(summed, shown)
