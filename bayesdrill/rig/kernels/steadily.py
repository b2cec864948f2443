"""The likelihood of a record that a missing torque has shaken: one gain throughout, an exact start.

Channel after channel of a sample, r = y - c x, x <- x + k r; then x <- Phi x + g + G u: that of the
response, and residuals.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

from llvmlite import ir

from bayesdrill.rig.kernels.belief import emit_carried, met, root_of
from bayesdrill.rig.kernels.compiling import HARDER, in_one_go, machine_code
from bayesdrill.rig.kernels.exponential import emit_exponential
from bayesdrill.rig.kernels.lanes import (
    I64,
    NUMBERS,
    VECTORS,
    Lane,
    Loop,
    function,
    load,
    splat,
    store,
    vector,
)
from bayesdrill.rig.kernels.layout import Layout
from bayesdrill.rig.kernels.matrices import Memory, dot, emit_copy, emit_product
from bayesdrill.rig.kernels.numbers import Number, fused
from bayesdrill.rig.kernels.recurrence import emit_drive, entries, next_state
from bayesdrill.rig.kernels.settling import Settled, emit_begun, emit_settle
from bayesdrill.rig.kernels.spreading import Noisy, emit_spread

COUNTS = ("groups", "samples")
BLOCKS = {
    "told": VECTORS,  # (G, P + K): parameters, variances
    "y": NUMBERS,  # (T, K)
    "u": NUMBERS,  # (T + 1, n_series)
    "shown": VECTORS,  # scratch (T / `AT_ONCE` + 1, n)
    "out": VECTORS,  # (2 K + 1, G)
}
AT_ONCE = 8  # samples


@dataclass(frozen=True, slots=True)
class Steadily:
    """`run` gives minus half the sums of squares of the whitened residuals `(K,)`, the start's part with
    them, their standard deviations `(K,)`, and the determinant that the start takes.
    """

    run: Any
    engine: Any = field(repr=False)


@lru_cache(maxsize=64)
@in_one_go
def compile_steadily(noisy: Noisy, layout: Layout) -> Steadily:
    """`layout`: of the rig with its torque."""
    module = ir.Module("steadily")
    _emit(module, noisy, layout)
    engine = machine_code(module, HARDER)
    prototype = ctypes.CFUNCTYPE(
        None, *[ctypes.c_int64] * len(COUNTS), *[ctypes.c_void_p] * len(BLOCKS)
    )
    return Steadily(prototype(engine.get_function_address("steadily")), engine)


def _emit(module: ir.Module, noisy: Noisy, layout: Layout) -> None:
    step = emit_exponential(module, layout, "step", layout.dt)
    lead = emit_exponential(module, layout, "lead", layout.lead) if layout.lead > 0.0 else None
    spread = emit_spread(module, noisy, slopes=False)
    settle, begun = emit_settle(module, noisy), emit_begun(module, noisy.n)
    made = function(module, "steadily", len(COUNTS), list(BLOCKS.values()))
    a = dict(zip((*COUNTS, *BLOCKS), made.args, strict=True))
    b = ir.IRBuilder(made.append_basic_block())
    n, k_count, size = noisy.n, noisy.k, layout.size
    m, places = Memory(b, False), Settled(n, k_count)
    e, block, start = m.room(size * size), m.room(places.size), m.room(n * n)
    shown, span, gained = m.room(n), m.room(1), m.room(1)
    first = b.alloca(I64, I64(1))
    groups = Loop(b, a["groups"], [], "groups")
    own = b.gep(a["told"], [b.mul(groups.index, I64(noisy.p + k_count))])
    variances = m.at(own, noisy.p)
    out = [
        b.gep(a["out"], [b.add(b.mul(a["groups"], I64(k)), groups.index)])
        for k in range(2 * k_count + 1)
    ]
    state = [vector(value) for value in layout.x0]
    m.clear(start, n * n)
    for i in range(n - noisy.own, n):
        m.put(1.0, start, i * n + i)
    phi_at, q_at, p_at, g_at = (m.at(block, places.of(name)) for name in ("phi", "q", "p", "g"))
    if lead is not None:
        store(b, vector(layout.lead), span, 0)
        b.call(spread, [own, span, phi_at, q_at])
        emit_carried(m, n, start, phi_at, q_at)
        b.call(lead, [own, e])
        state = next_state(b, n, entries(b, layout, e), state, [])
    store(b, vector(layout.dt), span, 0)
    b.call(spread, [own, span, phi_at, q_at])
    b.call(settle, [a["samples"], block, variances, first])
    b.call(step, [own, e])
    writer = _Samples(m, noisy, layout, a, entries(b, layout, e), block)
    blocks = b.sdiv(b.add(b.load(first), I64(AT_ONCE - 1)), I64(AT_ONCE))
    squares = _emit_samples(writer, blocks, state)
    _emit_back(writer, blocks, shown)
    b.call(begun, [p_at, g_at, start, shown, gained, out[2 * k_count]])
    for k, (total, root) in enumerate(zip(squares, writer.roots, strict=True)):
        m.put(-0.5 * (total * root * root + m.get(gained, 0) * (1.0 / k_count)), out[k], 0)
        m.put(1.0 / root, out[k_count + k], 0)
    groups.close([])
    b.ret_void()


@dataclass(frozen=True, slots=True)
class _Samples:
    """What all samples of a group of walkers have in common."""

    m: Memory
    noisy: Noisy
    layout: Layout
    a: dict[str, ir.Value]
    phi: dict[tuple[int, int], ir.Value]
    block: ir.Value

    def at(self, place: int) -> ir.Value:
        return self.m.at(self.block, place)

    @property
    def places(self) -> Settled:
        return Settled(self.noisy.n, self.noisy.k)

    @property
    def roots(self) -> list[Number]:
        """Of one over the variances of what channels show."""
        n, gains = self.noisy.n, self.at(self.places.gains)
        return [root_of(self.m, n, k, gains) for k in range(self.noisy.k)]

    def passed(
        self, index: ir.Value, carried: list[ir.Value], pulls: ir.Value | None
    ) -> list[ir.Value]:
        """A sample: state (n), sums of squares (K) and, with `pulls (K, n)`, what it shows (n)."""
        b, n, k_count = self.m.b, self.noisy.n, self.noisy.k
        lanes = [Lane(b, one) for one in carried]
        state, sums, shown = lanes[:n], lanes[n : n + k_count], lanes[n + k_count :]
        drive = emit_drive(b, self.layout, self.a["u"], index)
        y = b.gep(self.a["y"], [b.mul(index, I64(k_count))])
        gains = self.at(self.places.gains)
        for k in range(k_count):
            value = Lane(b, splat(b, b.load(b.gep(y, [I64(k)]))))
            rest, state = met(self.m, self.noisy, k, state, value, gains)
            sums[k] = fused(rest, rest, sums[k])
            if pulls is not None:
                shown = [fused(self.m.get(pulls, k * n + i), rest, x) for i, x in enumerate(shown)]
        following = next_state(b, n, self.phi, [x.value for x in state], drive, halves=False)
        return [*following, *(one.value for one in (*sums, *shown))]


def _emit_samples(w: _Samples, blocks: ir.Value, state: list[ir.Value]) -> list[Number]:
    """Sums of squares of all samples, forwards; the first `blocks` say what they show of their start."""
    m, b, n, k_count = w.m, w.m.b, w.noisy.n, w.noisy.k
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
    for i, one in enumerate(inner_new[n + k_count :]):
        store(b, one, shown, i)
    each.close(inner_new[: n + k_count])
    kept = m.room(n + k_count)
    for i, one in enumerate(inner_new[: n + k_count]):
        store(b, one, kept, i)
    begins = b.mul(blocks, I64(AT_ONCE))
    left = b.sub(w.a["samples"], begins)
    with b.if_then(b.icmp_signed(">", left, I64(0))):
        later = Loop(b, left, [load(b, kept, i) for i in range(n + k_count)], "later")
        new = w.passed(b.add(begins, later.index), later.carried, None)
        later.close(new)
        for i, one in enumerate(new):
            store(b, one, kept, i)
    return m.row(m.at(kept, n), k_count)


def _emit_pulls(w: _Samples) -> ir.Value:
    """`(AT_ONCE, K, n)`: what the samples of a block show of its first state, A'^k of the first's."""
    m, b, n, k_count = w.m, w.m.b, w.noisy.n, w.noisy.k
    each = n * k_count
    onward = emit_product(b.module, (k_count, n, n))
    pulls, a = m.room(AT_ONCE * each), w.at(w.places.of("a"))
    emit_copy(b, w.at(w.places.pulls), pulls, each)
    for k in range(1, AT_ONCE):
        b.call(onward, [m.at(pulls, k * each), m.at(pulls, (k - 1) * each), a])
    return pulls


def _emit_back(w: _Samples, blocks: ir.Value, shown: ir.Value) -> None:
    """What all blocks show of the first state: sum of A'^k of theirs, from the last to the first."""
    m, b, n = w.m, w.m.b, w.noisy.n
    square = emit_product(b.module, (n, n, n))
    powers, power = m.room(2 * n * n), w.at(w.places.of("a"))
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
    for i, value in enumerate(found):
        store(b, value, shown, i)
