"""The response of groups of walkers, sample after sample, its state in registers throughout."""

from __future__ import annotations

from llvmlite import ir

from bayesdrill.rig.kernels.lanes import (
    I64,
    NUMBERS,
    VEC,
    VECTORS,
    Loop,
    fma,
    function,
    load,
    splat,
    store,
    vector,
)
from bayesdrill.rig.kernels.layout import Layout
from bayesdrill.rig.kernels.tally import Tally


def emit_response(
    module: ir.Module,
    layout: Layout,
    step: ir.Function,
    lead: ir.Function | None,
    name: str,
    tally: Tally | None,
) -> None:
    """What is called `name`, a `tally` or signals, see `Kernels`.

    x(k + 1) = Phi x(k) + g + G0 u(k) + G1 (u(k + 1) - u(k)), and what is made of x(k).
    """
    blocks = [VECTORS, NUMBERS, NUMBERS, VECTORS]
    made = function(module, name, 2, blocks)
    n_groups, n_samples, parameters, y, u, out = made.args
    b = ir.IRBuilder(made.append_basic_block())
    n, k_count = layout.size, len(layout.channels)
    e = b.alloca(VEC, I64(n * n))
    groups = Loop(b, n_groups, [], "groups")
    each = tally.weights if tally is not None else 0
    mine = b.gep(parameters, [b.mul(groups.index, I64(layout.n_parameters + k_count * each))])
    own = [load(b, mine, layout.n_parameters + place) for place in range(k_count * each)]
    state = [vector(value) for value in layout.x0]
    if lead is not None:
        b.call(lead, [mine, e])
        state = next_state(b, layout.n_states, entries(b, layout, e), state, [])
    b.call(step, [mine, e])
    phi = entries(b, layout, e)
    totals = tally.begun(k_count) if tally is not None else []
    samples = Loop(b, n_samples, state + totals, "samples")
    state, totals = samples.carried[: len(state)], samples.carried[len(state) :]
    drive = emit_drive(b, layout, u, samples.index)
    for k, weights in enumerate(layout.channels):
        flat = b.add(b.mul(samples.index, I64(k_count)), I64(k))
        value = vector(0.0) if tally is None else splat(b, b.load(b.gep(y, [flat])))
        for weight, x in zip(weights, state, strict=True):
            if weight != 0.0:
                value = fma(b, vector(weight if tally is None else -weight), x, value)
        if tally is not None:
            kept = slice(k * tally.count, (k + 1) * tally.count)
            totals[kept] = tally.added(b, totals[kept], value, None, own[k * each : (k + 1) * each])
        else:
            row = b.add(b.mul(groups.index, b.mul(n_samples, I64(k_count))), flat)
            store(b, value, b.gep(out, [row]), 0)
    samples.close(next_state(b, layout.n_states, phi, state, drive) + totals)
    place = b.gep(out, [b.mul(groups.index, I64(len(totals)))])
    for k, total in enumerate(totals):
        store(b, total, place, k)
    groups.close([])
    b.ret_void()


def entries(b: ir.IRBuilder, layout: Layout, e: ir.Value) -> dict[tuple[int, int], ir.Value]:
    size, reach, idle = layout.size, layout.reach, layout.idle
    found = {
        (i, j): load(b, e, i * size + j)
        for i in range(layout.n_states)
        for j in range(size)
        if reach[i][j]
    }
    # One, and known to be: an addition of it is none to multiply first.
    return found | {(i, i): vector(1.0) for i in range(layout.n_states) if idle[i]}


def next_state(
    b: ir.IRBuilder,
    n_states: int,
    phi: dict[tuple[int, int], ir.Value],
    state: list[ir.Value],
    drive: list[ir.Value],
    *,
    halves: bool = True,
) -> list[ir.Value]:
    """Each sum in two `halves`, where a step takes as long as its longest chain of additions."""
    constant = n_states
    following = []
    for i in range(n_states):
        columns = [*enumerate(state), *enumerate(drive, start=constant + 1)]
        terms = [(phi[i, j], value) for j, value in columns if (i, j) in phi]
        half = len(terms) // 2 if halves else len(terms)
        total = _sum(b, terms[:half], phi.get((i, constant), vector(0.0)))
        if halves:
            total = b.fadd(total, _sum(b, terms[half + 1 :], b.fmul(*terms[half])))
        following.append(total)
    return following


def _sum(b: ir.IRBuilder, terms: list[tuple[ir.Value, ir.Value]], total: ir.Value) -> ir.Value:
    for entry, value in terms:
        total = fma(b, entry, value, total)
    return total


def emit_drive(b: ir.IRBuilder, layout: Layout, u: ir.Value, index: ir.Value) -> list[ir.Value]:
    """The sampled inputs at this sample and, with a first-order hold, their increments."""

    def series(row: ir.Value, s: int) -> ir.Value:
        return b.load(b.gep(u, [b.add(b.mul(row, I64(layout.n_series)), I64(s))]))

    drive = [series(index, s) for s in range(layout.n_series)]
    if layout.first_order:
        following = b.add(index, I64(1))
        drive += [b.fsub(series(following, s), drive[s]) for s in range(layout.n_series)]
    return [splat(b, value) for value in drive]
