"""A state, and a covariance of what is not known of it: what a sample teaches, and a step takes away.

Channels are taken one after the other, so that only numbers are divided by.
"""

from __future__ import annotations

from collections.abc import Sequence

from llvmlite import ir

from bayesdrill.basics.duals import Dual, dual
from bayesdrill.rig.kernels.lanes import Lane, vector
from bayesdrill.rig.kernels.matrices import Memory, dot, emit_copy, emit_even, emit_product, root
from bayesdrill.rig.kernels.numbers import Number, fused
from bayesdrill.rig.kernels.spreading import Noisy


def width(n: int) -> int:
    """Numbers that `emit_taught` leaves of a channel: the gain (n,), the variance of what it shows, and
    the root of one over it.
    """
    return n + 2


def emit_taught(
    memory: Memory,
    noisy: Noisy,
    k: int,
    p: ir.Value,
    variances: ir.Value,
    gains: ir.Value,
    is_seen: Number = 1.0,
) -> None:
    """Of channel k into `gains (K, width)`; the covariance p (n, n) loses what it teaches."""
    n, own = noisy.n, noisy.seen(k)
    weights = weights_of(memory.b, noisy, k)
    shown = [dot(weights, [memory.get(p, i * n + j) for j in own]) for i in range(n)]
    variance = dot(weights, [shown[j] for j in own], memory.get(variances, k))
    over = is_seen / variance
    gain = [one * over for one in shown]
    for i in range(n):
        for j in range(n):
            memory.put(fused(-gain[i], shown[j], memory.get(p, i * n + j)), p, i * n + j)
    at = k * width(n)
    for i, one in enumerate(gain):
        memory.put(one, gains, at + i)
    memory.put(variance * is_seen + (1.0 - is_seen), gains, at + n)
    memory.put(_root(memory.b, over), gains, at + n + 1)


def met(
    memory: Memory, noisy: Noisy, k: int, state: Sequence[Number], y: Number, gains: ir.Value
) -> tuple[Number, list[Number]]:
    """What channel k shows that the state does not, and the state that knows of it."""
    n = noisy.n
    rest = y
    for i, weight in noisy.seen(k).items():
        rest = fused(Lane(memory.b, vector(-weight)), state[i], rest)
    gain = [memory.get(gains, k * width(n) + i) for i in range(n)]
    return rest, [fused(one, rest, x) for one, x in zip(gain, state, strict=True)]


def emit_carried(memory: Memory, n: int, p: ir.Value, phi: ir.Value, q: ir.Value) -> None:
    """p = phi p phi' + q, where that is written."""
    b = memory.b
    half = emit_product(b.module, (n, n, n), slopes=memory.slopes)
    whole = emit_even(b.module, n, adds=True, slopes=memory.slopes)
    spare = memory.room(n * n)
    b.call(half, [spare, phi, p])
    emit_copy(b, q, p, n * n * memory.width)
    b.call(whole, [p, spare, phi])


def weights_of(b: ir.IRBuilder, noisy: Noisy, k: int) -> list[Number]:
    """Those of the states of which channel k tells."""
    return [Lane(b, vector(weight)) for weight in noisy.seen(k).values()]


def root_of(memory: Memory, n: int, k: int, gains: ir.Value) -> Number:
    """Of one over the variance of what channel k shows."""
    return memory.get(gains, k * width(n) + n + 1)


def _root(b: ir.IRBuilder, number: Number) -> Number:
    value = dual(number).value
    size = Lane(b, root(b, value.value))
    if not isinstance(number, Dual):
        return size
    safe = b.select(b.fcmp_ordered("==", size.value, vector(0.0)), vector(1.0), size.value)
    return Dual(size, number.slope * 0.5 / Lane(b, safe))
