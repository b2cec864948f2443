"""Channels with times of their own: values and rates are kept at all nodes, and read between them.

Between two nodes a channel is the cubic that has its values and its rates at both: the rate after
the first, with the efforts of this step, and the one before the second.
"""

from __future__ import annotations

from collections.abc import Sequence

from llvmlite import ir

from bayesdrill.basics.arithmetic import where
from bayesdrill.basics.duals import dual
from bayesdrill.rig.kernels.gathering import gather_own
from bayesdrill.rig.kernels.lanes import (
    F64,
    I64,
    INT_VEC,
    Lane,
    Loop,
    Mask,
    floor,
    splat,
    store,
    vector,
    whole_numbers,
)
from bayesdrill.rig.kernels.marching import Writer
from bayesdrill.rig.kernels.numbers import Number, total
from bayesdrill.rig.kernels.rates import Rates

KEPT = 3  # the value, and the rates after it and before the next one, times a step


def emit_trace(w: Writer) -> None:
    """Of all nodes; the last has a value alone."""
    b = w.b
    rates = Rates(b, w.shape, w.parameters)
    nodes = Loop(b, w.a["nodes"], w.start(), "nodes")
    state = w.kind.shaped(nodes.carried)[: w.x_count]
    drive, _ = w.drive(nodes.index)
    new, efforts, last = w.once(nodes.index, nodes.carried)
    after = rates.of(state, drive, efforts)
    before = rates.of(new, drive, efforts, later=w.span)
    for k in range(w.k_count):
        kept = [w.seen(k, state, []), *(_seen_rate(w, k, rate) for rate in (after, before))]
        _keep(w, nodes.index, k, kept)
    nodes.close(last)
    zero: Number = Lane(b, vector(0.0))
    for k in range(w.k_count):
        _keep(w, w.a["nodes"], k, [w.seen(k, new, []), zero, zero])


def _keep(w: Writer, node: ir.Value, k: int, kept: Sequence[Number]) -> None:
    b, numbers = w.b, w.shape.numbers
    place = b.mul(b.add(b.mul(node, I64(w.k_count)), I64(k)), I64(KEPT * numbers))
    at = b.gep(w.a["trace"], [place])
    for q, number in enumerate(kept):
        for n, register in enumerate(w.kind.flat([number])):
            store(b, register, at, q * numbers + n)


def _seen_rate(w: Writer, k: int, rates: Sequence[Number]) -> Number:
    """How much channel k changes in a step."""
    terms = [(row, rates[r]) for r, row in w.rows[k].items() if r < w.x_count]
    zero = Lane(w.b, vector(0.0))
    return total(zero, terms) * w.span


def emit_reading(w: Writer) -> None:
    """Of all samples, each lane at its own time."""
    b, shape = w.b, w.shape
    sums = shape.tally.begun(w.k_count) if shape.tally is not None else []
    shifts, begins = w.part("shift"), _before(w)
    samples = Loop(b, w.a["samples"], sums, "read")
    t = Lane(b, splat(b, b.load(b.gep(w.a["t"], [samples.index]))))
    totals: list[ir.Value] = []
    for k in range(w.k_count):
        when = t - shifts[k] / w.span
        value = _read(w, k, when, begins[k])
        if shape.tally is not None:
            left = w.measured(samples.index, k) - value
            totals += w.summed(samples.index, k, left, samples.carried)
        else:
            w.show(samples.index, k, value)
    samples.close(totals)
    w.keep(totals)


def _before(w: Writer) -> list[Number]:
    """How much channels change in a step before the start."""
    return [_seen_rate(w, k, w.part("before")) for k in range(w.k_count)]


def _read(w: Writer, k: int, when: Number, begin: Number) -> Number:
    b = w.b
    position = dual(when).value.value
    last = splat(b, b.sitofp(b.sub(w.a["nodes"], I64(1)), F64))
    node = floor(b, position)
    node = b.select(b.fcmp_ordered("<", node, last), node, last)
    node = b.select(b.fcmp_ordered(">", node, vector(0.0)), node, vector(0.0))
    share = when - Lane(b, node)
    value, after, before = (_kept(w, node, k, q) for q in range(KEPT))
    rise = _kept(w, b.fadd(node, vector(1.0)), k, 0) - value
    bend = rise * 3.0 - after * 2.0 - before
    turn = after + before - rise * 2.0
    between = value + share * (after + share * (bend + share * turn))
    early = Mask(b, b.fcmp_ordered("<", position, vector(0.0)))
    return where(early, value + share * begin, between)


def _kept(w: Writer, node: ir.Value, k: int, q: int) -> Number:
    b, numbers = w.b, w.shape.numbers
    row = b.mul(b.fptosi(node, INT_VEC), whole_numbers(w.k_count * KEPT * numbers))
    found = [
        gather_own(b, w.a["trace"], b.add(row, whole_numbers((k * KEPT + q) * numbers + n)))
        for n in range(numbers)
    ]
    return w.kind.shaped(found)[0]
