"""Where the gain of a Kalman filter settles, by doubling, and what its start takes to be exact.

The covariance P that a step leaves as it is: after 2^j steps it is H, with a transition B and what they
teach, G (the information of their samples on the state before them),.
Two such stretches make one of twice the length:

    B <- B E        E = (1 + H G)^-1 B
    G <- G + B' G E
    H <- H + B (1 + H G)^-1 H B'

A filter that begins with P has the same gain at all samples.  The rig begins with P0 instead: the
whitened residuals z are then not independent, by what the first N of them show of the state at the
start: W = sum A'^k C' S^-1 C A^k and b = sum A'^k C' S^-1 e, with A = Phi - K C; after N of them nothing
of it is left.
"""

from __future__ import annotations

from dataclasses import dataclass

from llvmlite import ir

from bayesdrill.rig.kernels.gathering import anywhere
from bayesdrill.rig.kernels.lanes import (
    I64,
    LANES,
    VECTORS,
    Lane,
    Loop,
    function,
    load,
    vector,
)
from bayesdrill.rig.kernels.matrices import (
    Memory,
    dot,
    emit_factor,
    emit_over,
    emit_product,
    emit_solve,
)
from bayesdrill.rig.kernels.numbers import fused
from bayesdrill.rig.kernels.spreading import Noisy

LEAST, MOST = 7, 44  # doublings
SETTLED = 1e-16  # of the variance of a sample: what one more doubling adds to it
GONE = 1e-24  # of W: what later samples add to it
MATRICES = ("p", "phi", "q", "w", "a")  # (n, n) of `Settled`


@dataclass(frozen=True, slots=True)
class Settled:
    """Where `settle` leaves what it finds, places of vectors in one block."""

    n: int
    k: int

    @property
    def gain(self) -> int:
        """Phi K `(n, K)`."""
        return 5 * self.n**2

    @property
    def lower(self) -> int:
        """The lower triangle L of S = L L' `(K, K)`."""
        return self.gain + self.n * self.k

    @property
    def pull(self) -> int:
        """C' S^-1 `(n, K)`."""
        return self.lower + self.k**2

    @property
    def size(self) -> int:
        return self.pull + self.n * self.k

    def of(self, name: str) -> int:
        return MATRICES.index(name) * self.n**2


def emit_settle(module: ir.Module, noisy: Noisy) -> ir.Function:
    """`settle(samples, block, variances, first)`: of Phi and Q in the `block`, all the rest of it;
    `first (1,)` gets N, a whole number up to the number of `samples`.
    """
    double = _emit_double(module, noisy)
    gain = _emit_gain(module, noisy)
    gather = _emit_gather(module, noisy)
    made = function(module, "settle", 1, [VECTORS, VECTORS, I64.as_pointer()])
    samples, block, variances, first = made.args
    b = ir.IRBuilder(made.append_basic_block())
    n = noisy.n
    places, memory = Settled(n, noisy.k), Memory(b, False)
    phi, q, p = (memory.at(block, places.of(name)) for name in ("phi", "q", "p"))
    spare = memory.room(2 * n * n)
    transition, taught = spare, memory.at(spare, n * n)
    _copy(b, phi, transition, n * n)
    _copy(b, q, p, n * n)
    memory.clear(taught, n * n)
    for k in range(noisy.k):
        over = Lane(b, b.fdiv(vector(1.0), load(b, variances, k)))
        for i, weight in noisy.seen(k).items():
            for j, other in noisy.seen(k).items():
                place = i * n + j
                memory.put(memory.get(taught, place) + over * (weight * other), taught, place)
    before = b.block
    body, after = b.append_basic_block("doubling"), b.append_basic_block("settled")
    b.branch(body)
    b.position_at_end(body)
    count = b.phi(I64)
    count.add_incoming(I64(0), before)
    moves = b.call(double, [transition, taught, p, variances])
    more = b.or_(moves, b.icmp_signed("<", count, I64(LEAST)))
    more = b.and_(more, b.icmp_signed("<", count, I64(MOST)))
    count.add_incoming(b.add(count, I64(1)), b.block)
    b.cbranch(more, body, after)
    b.position_at_end(after)
    b.call(gain, [block, variances])
    b.call(gather, [samples, block, first])
    b.ret_void()
    return made


def _copy(b: ir.IRBuilder, source: ir.Value, target: ir.Value, count: int) -> None:
    each = Loop(b, I64(count), [], "copy")
    b.store(b.load(b.gep(source, [each.index]), align=8), b.gep(target, [each.index]), align=8)
    each.close([])


def _emit_double(module: ir.Module, noisy: Noisy) -> ir.Function:
    """Whether it changes anything still in any lane."""
    n = noisy.n
    whole = (n, n, n)
    plain, right = emit_product(module, whole), emit_product(module, whole, right=True)
    left_adds = emit_product(module, whole, left=True, adds=True)
    signature = ir.FunctionType(ir.IntType(1), [VECTORS] * 4)
    made = ir.Function(module, signature, "double")
    for argument in made.args:
        argument.add_attribute("noalias")
    transition, taught, p, variances = made.args
    b = ir.IRBuilder(made.append_basic_block())
    m = Memory(b, False)
    x, y, u, e, det = m.room(n * n), m.room(n * n), m.room(n * n), m.room(2 * n * n), m.room(1)
    b.call(plain, [x, p, taught])
    for i in range(n):
        m.put(m.get(x, i * n + i) + 1.0, x, i * n + i)
        for j in range(n):  # B and H side by side
            m.put(m.get(transition, i * n + j), e, 2 * i * n + j)
            m.put(m.get(p, i * n + j), e, 2 * i * n + n + j)
    b.call(emit_solve(module, n, 2 * n), [e, x, det])
    for i in range(n):
        for j in range(n):
            m.put(m.get(e, 2 * i * n + j), x, i * n + j)
            m.put(m.get(e, 2 * i * n + n + j), y, i * n + j)
    b.call(plain, [u, transition, y])
    b.call(right, [y, u, transition])  # B (1 + H G)^-1 H B'
    b.call(plain, [u, taught, x])
    b.call(left_adds, [taught, transition, u])
    b.call(plain, [u, transition, x])
    _copy(b, u, transition, n * n)
    moves = _grow(m, noisy, p, y, variances)
    b.ret(moves)
    return made


def _grow(m: Memory, noisy: Noisy, p: ir.Value, more: ir.Value, variances: ir.Value) -> ir.Value:
    """`more` comes to p; whether a channel sees the difference."""
    b, n = m.b, noisy.n
    moves = ir.Constant(ir.VectorType(ir.IntType(1), LANES), [0] * LANES)
    for k in range(noisy.k):
        change, variance = Lane(b, vector(0.0)), Lane(b, load(b, variances, k))
        for i, weight in noisy.seen(k).items():
            for j, other in noisy.seen(k).items():
                both = Lane(b, vector(weight * other))
                change = fused(both, m.get(more, i * n + j), change)
                variance = fused(both, m.get(p, i * n + j), variance)
        moves = b.or_(moves, b.fcmp_ordered(">", change.value, (variance * SETTLED).value))
    for i in range(n):
        for j in range(i + 1):  # what rounding makes of a symmetry would grow
            sides = m.get(more, i * n + j) + m.get(more, j * n + i)
            total = fused(Lane(b, vector(0.5)), sides, m.get(p, i * n + j))
            m.put(total, p, i * n + j)
            m.put(total, p, j * n + i)
    return anywhere(b, moves)


def _emit_gain(module: ir.Module, noisy: Noisy) -> ir.Function:
    """`gain(block, variances)`: Phi K, L, C' S^-1, W of one sample, and A."""
    n, k_count = noisy.n, noisy.k
    places = Settled(n, k_count)
    factor, over = emit_factor(module, k_count), emit_over(module, n, k_count)
    wide = emit_product(module, (n, k_count, n), right=True)
    onward = emit_product(module, (n, n, k_count))
    made = function(module, "gain", 0, [VECTORS] * 2)
    block, variances = made.args
    b = ir.IRBuilder(made.append_basic_block())
    m = Memory(b, False)
    p, phi, lower, pull = (
        m.at(block, place)
        for place in (places.of("p"), places.of("phi"), places.lower, places.pull)
    )
    shown, s, moved = m.room(n * k_count), m.room(k_count**2), m.room(n * k_count)
    for k in range(k_count):
        own = noisy.seen(k)
        weights = [Lane(b, vector(weight)) for weight in own.values()]
        column = [dot(weights, [m.get(p, i * n + j) for j in own]) for i in range(n)]
        for i in range(n):
            m.put(column[i], shown, i * k_count + k)
            m.put(own.get(i, 0.0), pull, i * k_count + k)
        for j in range(k_count):
            other = noisy.seen(j)
            start = Lane(b, load(b, variances, k)) if j == k else None
            value = dot(
                [Lane(b, vector(w)) for w in other.values()], [column[i] for i in other], start
            )
            m.put(value, s, j * k_count + k)
    b.call(factor, [lower, s])
    b.call(over, [pull, lower])  # C' L'^-1
    b.call(wide, [m.at(block, places.of("w")), pull, pull])
    _divide(m, n, k_count, lower, pull)
    b.call(onward, [moved, phi, shown])
    gain = m.at(block, places.gain)
    _copy(b, moved, gain, n * k_count)
    b.call(over, [gain, lower])
    _divide(m, n, k_count, lower, gain)
    for i in range(n):
        row = m.row(m.at(phi, i * n), n)
        for k in range(k_count):
            entry = -m.get(gain, i * k_count + k)
            for j, weight in noisy.seen(k).items():
                row[j] = fused(entry, Lane(b, vector(weight)), row[j])
        for j, value in enumerate(row):
            m.put(value, m.at(block, places.of("a")), i * n + j)
    b.ret_void()
    return made


def _divide(m: Memory, rows: int, k_count: int, lower: ir.Value, of: ir.Value) -> None:
    """Rows become those of `of` L^-1."""
    b = m.b
    triangle = {(i, j): m.get(lower, i * k_count + j) for i in range(k_count) for j in range(i + 1)}
    overs = [1.0 / triangle[k, k] for k in range(k_count)]
    each = Loop(b, I64(rows), [], "divide")
    row = m.at(of, b.mul(each.index, I64(k_count)))
    found: dict[int, Lane] = {}
    for k in reversed(range(k_count)):
        entry = m.get(row, k)
        for j in range(k + 1, k_count):
            entry = fused(-found[j], triangle[j, k], entry)
        found[k] = entry * overs[k]
        m.put(found[k], row, k)
    each.close([])


def _emit_gather(module: ir.Module, noisy: Noisy) -> ir.Function:
    """`gather(samples, block, first)`: W of the first N samples; A in the block stays."""
    n = noisy.n
    whole = (n, n, n)
    plain, left = emit_product(module, whole), emit_product(module, whole, left=True)
    adds = emit_product(module, whole, left=True, adds=True)
    made = function(module, "gather", 1, [VECTORS, I64.as_pointer()])
    samples, block, first = made.args
    b = ir.IRBuilder(made.append_basic_block())
    m, places = Memory(b, False), Settled(n, noisy.k)
    w, a = m.at(block, places.of("w")), m.at(block, places.of("a"))
    power, sums, all_sums, all_power, x, y = (m.room(n * n) for _ in range(6))
    for source, target in ((a, power), (w, sums)):
        _copy(b, source, target, n * n)
    for matrix in (all_sums, all_power):
        m.clear(matrix, n * n)
    for i in range(n):
        m.put(1.0, all_power, i * n + i)
    before = b.block
    body, after = b.append_basic_block("gathering"), b.append_basic_block("gathered")
    b.branch(body)
    b.position_at_end(body)
    length = b.phi(I64)
    length.add_incoming(I64(1), before)
    with b.if_then(b.icmp_signed("!=", b.and_(length, samples), I64(0))):
        b.call(plain, [x, sums, all_power])
        b.call(adds, [all_sums, all_power, x])
        b.call(plain, [x, power, all_power])
        _copy(b, x, all_power, n * n)
    b.call(plain, [x, sums, power])
    b.call(left, [y, power, x])
    gone = b.not_(anywhere(b, _adds(m, n, sums, y)))
    with b.if_then(b.not_(gone)):
        each = Loop(b, I64(n * n), [], "each")
        place = b.gep(sums, [each.index])
        more = b.load(b.gep(y, [each.index]), align=8)
        b.store(b.fadd(b.load(place, align=8), more), place, align=8)
        each.close([])
        b.call(plain, [x, power, power])
        _copy(b, x, power, n * n)
    twice = b.mul(length, I64(2))
    length.add_incoming(twice, b.block)
    ends = b.or_(gone, b.icmp_signed(">", twice, samples))
    b.cbranch(ends, after, body)
    b.position_at_end(after)
    with b.if_else(gone) as (early, late):
        with early:
            _copy(b, sums, w, n * n)
            shorter = b.icmp_signed("<", length, samples)
            b.store(b.select(shorter, length, samples), first)
        with late:
            _copy(b, all_sums, w, n * n)
            b.store(samples, first)
    b.ret_void()
    return made


def _adds(m: Memory, n: int, sums: ir.Value, more: ir.Value) -> ir.Value:
    """Lanes in which `more` is something beside `sums`, by their diagonals."""
    b = m.b
    found = ir.Constant(ir.VectorType(ir.IntType(1), LANES), [0] * LANES)
    for i in range(n):
        here = m.get(sums, i * n + i) * GONE
        found = b.or_(found, b.fcmp_ordered(">", m.get(more, i * n + i).value, here.value))
    return found


def emit_begun(module: ir.Module, noisy: Noisy) -> ir.Function:
    """`begun(block, p0, b, out)`: of P, W, the covariance at the start and the sum b, (2,)
    numbers: what the sum of squares gains, and the determinant of the covariance of z, b' (1 - D
    W)^-1 D b and that of 1 - D W with D = P - P0.
    """
    n = noisy.n
    plain, solve = emit_product(module, (n, n, n)), emit_solve(module, n, 1)
    made = function(module, "begun", 0, [VECTORS] * 4)
    block, start, shown, out = made.args
    b = ir.IRBuilder(made.append_basic_block())
    m, places = Memory(b, False), Settled(n, noisy.k)
    p, w = m.at(block, places.of("p")), m.at(block, places.of("w"))
    change, x, row = m.room(n * n), m.room(n * n), m.room(n)
    for i in range(n * n):
        m.put(m.get(start, i) - m.get(p, i), change, i)
    b.call(plain, [x, change, w])
    own = m.row(shown, n)
    for i in range(n):
        m.put(m.get(x, i * n + i) + 1.0, x, i * n + i)
        m.put(-dot(m.row(m.at(change, i * n), n), own), row, i)
    b.call(solve, [row, x, m.at(out, 1)])
    m.put(dot(own, m.row(row, n)), out, 0)
    b.ret_void()
    return made
