"""The likelihood of a record that a missing torque has shaken: one gain throughout, an exact start.

x(k + 1) = Phi x(k) + g + G u(k) + Phi K e(k), e = y - C x: that of the response, and residuals.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

from llvmlite import ir

from bayesdrill.rig.kernels.compiling import in_one_go, machine_code
from bayesdrill.rig.kernels.exponential import emit_exponential
from bayesdrill.rig.kernels.lanes import (
    I64,
    NUMBERS,
    VECTORS,
    Lane,
    Loop,
    fma,
    function,
    load,
    splat,
    store,
    vector,
)
from bayesdrill.rig.kernels.layout import Layout
from bayesdrill.rig.kernels.matrices import Memory, dot, emit_product
from bayesdrill.rig.kernels.numbers import fused
from bayesdrill.rig.kernels.recurrence import emit_drive, next_state
from bayesdrill.rig.kernels.settling import Settled, emit_begun, emit_settle
from bayesdrill.rig.kernels.spreading import Noisy, emit_spread

COUNTS = ("groups", "samples")
BLOCKS = {
    "parameters": VECTORS,  # (G, P)
    "variances": VECTORS,  # (G, K)
    "y": NUMBERS,  # (T, K)
    "u": NUMBERS,  # (T + 1, n_series)
    "rests": VECTORS,  # scratch (T + `AT_ONCE`, K), the last of them zero
    "out": VECTORS,  # (G, 2 K + 2)
}


@dataclass(frozen=True, slots=True)
class Steadily:
    """`run` gives sums of squares of the whitened residuals `(K,)`, their standard deviations
    `(K,)`, what the start adds to the sums, and the determinant that it takes.
    """

    run: Any
    engine: Any = field(repr=False)


AT_ONCE = 8  # samples


@lru_cache(maxsize=64)
@in_one_go
def compile_steadily(noisy: Noisy, layout: Layout) -> Steadily:
    """`layout`: of the rig with its torque."""
    module = ir.Module("steadily")
    _emit(module, noisy, layout)
    engine = machine_code(module)
    prototype = ctypes.CFUNCTYPE(
        None, *[ctypes.c_int64] * len(COUNTS), *[ctypes.c_void_p] * len(BLOCKS)
    )
    return Steadily(prototype(engine.get_function_address("steadily")), engine)


def _emit(module: ir.Module, noisy: Noisy, layout: Layout) -> None:
    step = emit_exponential(module, layout, "step", layout.dt)
    lead = emit_exponential(module, layout, "lead", layout.lead) if layout.lead > 0.0 else None
    spread = emit_spread(module, noisy, slopes=False)
    settle, begun = emit_settle(module, noisy), emit_begun(module, noisy)
    made = function(module, "steadily", len(COUNTS), list(BLOCKS.values()))
    a = dict(zip((*COUNTS, *BLOCKS), made.args, strict=True))
    b = ir.IRBuilder(made.append_basic_block())
    n, k_count, size = noisy.n, noisy.k, layout.size
    m, places = Memory(b, False), Settled(n, k_count)
    e, block, start = m.room(size * size), m.room(places.size), m.room(n * n)
    shown, span, spare = m.room(n), m.room(1), m.room(n * n)
    first = b.alloca(I64, I64(1))
    groups = Loop(b, a["groups"], [], "groups")
    own = b.gep(a["parameters"], [b.mul(groups.index, I64(noisy.p))])
    variances = b.gep(a["variances"], [b.mul(groups.index, I64(k_count))])
    out = b.gep(a["out"], [b.mul(groups.index, I64(2 * k_count + 2))])
    state = [vector(value) for value in layout.x0]
    m.clear(start, n * n)
    for i in range(n - noisy.own, n):
        m.put(1.0, start, i * n + i)
    phi_at, q_at = (m.at(block, places.of(name)) for name in ("phi", "q"))
    if lead is not None:
        store(b, vector(layout.lead), span, 0)
        b.call(spread, [own, span, phi_at, q_at])
        _carry(m, n, start, phi_at, q_at, spare)
        b.call(lead, [own, e])
        state = next_state(b, n, _entries(b, layout, e), state, [])
    store(b, vector(layout.dt), span, 0)
    b.call(spread, [own, span, phi_at, q_at])
    b.call(settle, [a["samples"], block, variances, first])
    b.call(step, [own, e])
    _emit_samples(m, noisy, layout, a, (e, block, out), state)
    _emit_back(m, noisy, a["rests"], block, b.load(first), shown)
    b.call(begun, [block, start, shown, b.gep(out, [I64(2 * k_count)])])
    groups.close([])
    b.ret_void()


def _carry(m: Memory, n: int, p: ir.Value, phi: ir.Value, q: ir.Value, spare: ir.Value) -> None:
    """p = phi p phi' + q."""
    b = m.b
    b.call(emit_product(b.module, (n, n, n)), [spare, phi, p])
    each = Loop(b, I64(n * n), [], "copy")
    b.store(b.load(b.gep(q, [each.index]), align=8), b.gep(p, [each.index]), align=8)
    each.close([])
    b.call(emit_product(b.module, (n, n, n), right=True, adds=True), [p, spare, phi])


def _entries(b: ir.IRBuilder, layout: Layout, e: ir.Value) -> dict[tuple[int, int], ir.Value]:
    size, reach = layout.size, layout.reach
    places = [(i, j) for i in range(layout.n_states) for j in range(size) if reach[i][j]]
    return {(i, j): load(b, e, i * size + j) for i, j in places}


def _emit_samples(
    m: Memory,
    noisy: Noisy,
    layout: Layout,
    a: dict[str, ir.Value],
    blocks: tuple[ir.Value, ir.Value, ir.Value],
    state: list[ir.Value],
) -> None:
    """All samples, forwards: residuals are kept, and their products summed up."""
    b, n, k_count = m.b, noisy.n, noisy.k
    e, block, out = blocks
    phi = _entries(b, layout, e)
    gain = m.row(m.at(block, Settled(n, k_count).gain), n * k_count)
    pairs = [(i, j) for i in range(k_count) for j in range(i + 1)]
    samples = Loop(b, a["samples"], [*state, *[vector(0.0)] * len(pairs)], "samples")
    state, totals = samples.carried[:n], samples.carried[n:]
    drive = emit_drive(b, layout, a["u"], samples.index)
    at = b.mul(samples.index, I64(k_count))
    rests = []
    for k in range(k_count):
        value = splat(b, b.load(b.gep(a["y"], [b.add(at, I64(k))])))
        for i, weight in noisy.seen(k).items():
            value = fma(b, vector(-weight), state[i], value)
        rests.append(value)
        store(b, value, b.gep(a["rests"], [at]), k)
    following = next_state(b, n, phi, state, drive)
    for i in range(n):
        own = [gain[i * k_count + k].value for k in range(k_count)]
        for entry, value in zip(own, rests, strict=True):
            following[i] = fma(b, entry, value, following[i])
    sums = [fma(b, rests[i], rests[j], total) for (i, j), total in zip(pairs, totals, strict=True)]
    samples.close([*following, *sums])
    _emit_whitened(
        m, k_count, m.at(block, Settled(n, k_count).lower), dict(zip(pairs, sums, strict=True)), out
    )


def _emit_whitened(
    m: Memory,
    k_count: int,
    lower: ir.Value,
    sums: dict[tuple[int, int], ir.Value],
    out: ir.Value,
) -> None:
    """The diagonal of L^-1 of the sums L'^-1, and that of L."""
    b = m.b
    triangle = {(i, j): m.get(lower, i * k_count + j) for i in range(k_count) for j in range(i + 1)}
    overs = [1.0 / triangle[k, k] for k in range(k_count)]
    rows: list[list[Lane]] = []
    for k in range(k_count):
        own: list[Lane] = []  # row k of L^-1
        for j in range(k + 1):
            entry = Lane(b, vector(1.0 if j == k else 0.0))
            for i in range(j, k):
                entry = fused(-triangle[k, i], rows[i][j], entry)
            own.append(entry * overs[k])
        rows.append(own)
        total = Lane(b, vector(0.0))
        for i in range(k + 1):
            for j in range(k + 1):
                product = Lane(b, sums[max(i, j), min(i, j)])
                total = fused(own[i] * own[j], product, total)
        m.put(total, out, k)
        m.put(triangle[k, k], out, k_count + k)


def _emit_back(
    m: Memory, noisy: Noisy, rests: ir.Value, block: ir.Value, first: ir.Value, shown: ir.Value
) -> None:
    """What the first samples show of the state at the start, some at once: sum of A'^k C' S^-1 e_k."""
    b, n, k_count = m.b, noisy.n, noisy.k
    places = Settled(n, k_count)
    a, each = m.at(block, places.of("a")), n * k_count
    onward = emit_product(b.module, (n, n, k_count), left=True)
    square = emit_product(b.module, (n, n, n))
    pulls, powers = m.room(AT_ONCE * each), m.room(2 * n * n)
    copied = Loop(b, I64(each), [], "copied")
    source = b.gep(block, [b.add(I64(places.pull), copied.index)])
    b.store(b.load(source, align=8), b.gep(pulls, [copied.index]), align=8)
    copied.close([])
    for k in range(1, AT_ONCE):
        b.call(onward, [m.at(pulls, k * each), a, m.at(pulls, (k - 1) * each)])
    power = a
    for k in range(AT_ONCE.bit_length() - 1):
        following = m.at(powers, (k % 2) * n * n)
        b.call(square, [following, power, power])
        power = following
    blocks = b.sdiv(b.add(first, I64(AT_ONCE - 1)), I64(AT_ONCE))
    back = Loop(b, blocks, [vector(0.0)] * n, "back")
    at = b.mul(b.sub(b.sub(blocks, I64(1)), back.index), I64(AT_ONCE * k_count))
    own = m.row(b.gep(rests, [at]), AT_ONCE * k_count)
    carried = [Lane(b, one) for one in back.carried]
    found = []
    for i in range(n):
        entries = [
            m.get(pulls, j * each + i * k_count + k) for j in range(AT_ONCE) for k in range(k_count)
        ]
        half = len(own) // 2
        moved = dot([m.get(power, j * n + i) for j in range(n)], carried)
        total = dot(entries[:half], own[:half]) + dot(entries[half:], own[half:], moved)
        found.append(total.value)
    back.close(found)
    for i, value in enumerate(found):
        store(b, value, shown, i)
