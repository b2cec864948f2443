"""The normal equations of groups of walkers: slopes of the response are summed up, never stored.

Beside the state x there are its derivatives x_j in q directions of the parameters,

    x_j(k + 1) = Phi x_j(k) + Phi_j x(k) + g_j + G_j (u(k), ...)

with Phi_j from the exponential of the tangent's matrix.  At each sample the channels' derivatives
are multiplied with each other and with what is left of the record.
"""

from __future__ import annotations

from llvmlite import ir

from bayesdrill.kernels.lanes import (
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
from bayesdrill.kernels.layout import Layout
from bayesdrill.kernels.recurrence import emit_drive, next_state

Values = list[ir.Value]


def scratch_size(layout: Layout, q: int) -> int:
    """Vectors of scratch that `normal` wants, for `layout` of the tangent."""
    x = layout.n_states // 2
    return layout.size**2 + q * (x * (layout.size - x) + x + len(layout.channels))


def emit_normal(
    module: ir.Module, layout: Layout, step: ir.Function, lead: ir.Function | None
) -> None:
    """`normal(G, T, q, parameters, directions, scales, y, u, scratch, out)`.

    `layout` is the tangent's: its first X states are the rig's, and its channels are derivatives.
    `parameters (G, P, LANES)`, `directions (G, q, P, LANES)`, `scales (G, K, LANES)`: one over the
    noise.  `out (G, K + q + q q, LANES)`: squares, slopes, and the lower triangle of the products.
    """
    blocks = [VECTORS, VECTORS, VECTORS, NUMBERS, NUMBERS, VECTORS, VECTORS]
    made = function(module, "normal", 3, blocks)
    n_groups, n_samples, q, parameters, directions, scales, y, u, scratch, out = made.args
    b = ir.IRBuilder(made.append_basic_block())
    x_count, k_count = layout.n_states // 2, len(layout.channels)
    p_count = layout.n_parameters // 2
    inputs = layout.size - layout.n_states  # the constant one and the sampled ones
    d_count = x_count * (x_count + inputs)
    e = scratch
    d = b.gep(e, [I64(layout.size**2)])
    slopes_x = b.gep(d, [b.mul(q, I64(d_count))])
    slopes_s = b.gep(slopes_x, [b.mul(q, I64(x_count))])
    both = b.alloca(VEC, I64(2 * p_count))
    out_count = b.add(I64(k_count), b.add(q, b.mul(q, q)))
    weights = [channel[x_count:] for channel in layout.channels]

    groups = Loop(b, n_groups, [], "groups")
    g = groups.index
    own_out = b.gep(out, [b.mul(g, out_count)])
    slope_sums = b.gep(own_out, [I64(k_count)])
    product_sums = b.gep(slope_sums, [q])
    clear = Loop(b, out_count, [], "clear")
    b.store(vector(0.0), b.gep(own_out, [clear.index]), align=8)
    clear.close([])
    for p in range(p_count):
        store(b, load(b, b.gep(parameters, [b.mul(g, I64(p_count))]), p), both, p)

    def with_direction(j: ir.Value) -> None:
        row = b.gep(directions, [b.mul(b.add(b.mul(g, q), j), I64(p_count))])
        for p in range(p_count):
            store(b, load(b, row, p), both, p_count + p)

    start = [vector(value) for value in layout.x0[:x_count]]
    state = start
    if lead is not None:
        begun = Loop(b, q, [], "begun")
        with_direction(begun.index)
        b.call(lead, [both, e])
        phi, slope = _entries(b, layout, e)
        mine = b.gep(slopes_x, [b.mul(begun.index, I64(x_count))])
        zero = [vector(0.0)] * x_count
        for i, value in enumerate(_next_slope(b, layout, phi, slope, start, zero, [])):
            store(b, value, mine, i)
        begun.close([])
        phi, _ = _entries(b, layout, e)
        state = next_state(b, x_count, phi, start, [])
    else:
        begun = Loop(b, b.mul(q, I64(x_count)), [], "begun")
        b.store(vector(0.0), b.gep(slopes_x, [begun.index]), align=8)
        begun.close([])
    matrices = Loop(b, q, [], "matrices")
    with_direction(matrices.index)
    b.call(step, [both, e])
    mine = b.gep(d, [b.mul(matrices.index, I64(d_count))])
    for place, value in enumerate(_slope_values(b, layout, e)):
        store(b, value, mine, place)
    matrices.close([])
    phi, _ = _entries(b, layout, e)

    samples = Loop(b, n_samples, state + [vector(0.0)] * k_count, "samples")
    state, totals = samples.carried[:x_count], samples.carried[x_count:]
    drive = emit_drive(b, layout, u, samples.index)
    left = []
    own_scales = b.gep(scales, [b.mul(g, I64(k_count))])
    for k in range(k_count):
        flat = b.add(b.mul(samples.index, I64(k_count)), I64(k))
        value = splat(b, b.load(b.gep(y, [flat])))
        for weight, x in zip(weights[k], state, strict=True):
            if weight != 0.0:
                value = fma(b, vector(-weight), x, value)
        left.append(b.fmul(value, load(b, own_scales, k)))
        totals[k] = fma(b, left[k], left[k], totals[k])
    each = Loop(b, q, [], "each")
    j = each.index
    own_x = b.gep(slopes_x, [b.mul(j, I64(x_count))])
    own_s = b.gep(slopes_s, [b.mul(j, I64(k_count))])
    own_d = b.gep(d, [b.mul(j, I64(d_count))])
    slope_x = [load(b, own_x, i) for i in range(x_count)]
    seen = []
    for k in range(k_count):
        value = vector(0.0)
        for weight, x in zip(weights[k], slope_x, strict=True):
            if weight != 0.0:
                value = fma(b, vector(weight), x, value)
        seen.append(b.fmul(value, load(b, own_scales, k)))
        store(b, seen[k], own_s, k)
    _add_products(b, b.gep(slope_sums, [j]), seen, left)
    row = b.gep(product_sums, [b.mul(j, q)])
    pairs = Loop(b, b.add(j, I64(1)), [], "pairs")
    other_s = b.gep(slopes_s, [b.mul(pairs.index, I64(k_count))])
    _add_products(b, b.gep(row, [pairs.index]), seen, [load(b, other_s, k) for k in range(k_count)])
    pairs.close([])
    slope = {place: load(b, own_d, n) for n, place in enumerate(_slope_places(layout))}
    for i, value in enumerate(_next_slope(b, layout, phi, slope, state, slope_x, drive)):
        store(b, value, own_x, i)
    each.close([])
    samples.close(next_state(b, x_count, phi, state, drive) + totals)
    for k, total in enumerate(totals):
        store(b, total, own_out, k)
    groups.close([])
    b.ret_void()


def _add_products(b: ir.IRBuilder, place: ir.Value, ones: Values, others: Values) -> None:
    total = b.load(place, align=8)
    for one, other in zip(ones, others, strict=True):
        total = fma(b, one, other, total)
    b.store(total, place, align=8)


def _slope_places(layout: Layout) -> list[tuple[int, int]]:
    """(row, column) of the entries of Phi_j, g_j and G_j that can differ from zero.

    Rows count the rig's states, columns go on with the inputs after them.
    """
    x, reach = layout.n_states // 2, layout.reach
    columns = [*range(x), *range(2 * x, layout.size)]
    return [(i, n) for i in range(x) for n, column in enumerate(columns) if reach[x + i][column]]


def _slope_values(b: ir.IRBuilder, layout: Layout, e: ir.Value) -> Values:
    x, size = layout.n_states // 2, layout.size
    found = []
    for i, n in _slope_places(layout):
        column = n if n < x else n + x
        found.append(load(b, e, (x + i) * size + column))
    return found


def _entries(
    b: ir.IRBuilder, layout: Layout, e: ir.Value
) -> tuple[dict[tuple[int, int], ir.Value], dict[tuple[int, int], ir.Value]]:
    """Phi with its inputs' columns, and their derivatives, from the tangent's exponential."""
    x, size, reach = layout.n_states // 2, layout.size, layout.reach
    phi = {}
    for i in range(x):
        for n in range(size - x):
            column = n if n < x else n + x
            if reach[i][column]:
                phi[i, n] = load(b, e, i * size + column)
    slope = dict(zip(_slope_places(layout), _slope_values(b, layout, e), strict=True))
    return phi, slope


def _next_slope(
    b: ir.IRBuilder,
    layout: Layout,
    phi: dict[tuple[int, int], ir.Value],
    slope: dict[tuple[int, int], ir.Value],
    state: Values,
    slope_x: Values,
    drive: Values,
) -> Values:
    x = layout.n_states // 2
    following = []
    for i in range(x):
        total = slope.get((i, x), vector(0.0))
        for n, value in [*enumerate(state), *enumerate(drive, start=x + 1)]:
            if (i, n) in slope:
                total = fma(b, slope[i, n], value, total)
        other = vector(0.0)
        for n, value in enumerate(slope_x):
            if (i, n) in phi:
                other = fma(b, phi[i, n], value, other)
        following.append(b.fadd(total, other))
    return following
