"""The response of groups of walkers sample after sample, and its normal equations, summed up and
never stored.

Beside the state x there are its derivatives x_j in q directions of the parameters,

    x_j(k + 1) = Phi x_j(k) + Phi_j x(k) + g_j + G_j (u(k), ...)

with Phi_j from the exponential of the tangent's matrix.  At each sample the channels' derivatives
are multiplied with each other and with what is left of the record.
"""

from __future__ import annotations

from dataclasses import dataclass

from llvmlite import ir

from bayesdrill.rig.kernels.exponential import Layout, emit_exponential, number, weights_of
from bayesdrill.rig.kernels.lanes import (
    I64,
    NUMBERS,
    VEC,
    VECTORS,
    Builder,
    Lane,
    Loop,
    begin_function,
    vector,
)
from bayesdrill.rig.kernels.sums import TALLIES, Sample, Tally


def write_response(module: ir.Module, layout: Layout, *names: str) -> None:
    """`misfit(G, T, parameters, constants, y, u, out)`, `signals(...)` and others for G groups of LANES
    walkers.

    All arguments but counts are addresses of C-contiguous blocks: `parameters (G, P, LANES)`,
    `constants`, see `Constants`, `y (T, K)`, `u (T + 1, n_series)`.  `misfit` writes sums of squares
    `(G, K, LANES)`, `signals` `(G, T, K, LANES)`; a lane whose numbers overflow gets NaN.  Other
    `TALLIES` are as `misfit`, with as many numbers `(G, K, n, LANES)` as they have, and their weights
    `(K, m)` after the parameters.
    `normal`: see `emit_normal`.
    """
    exponential = emit_exponential(module, layout, increments=True)
    for name in names:
        if name == "normal":
            emit_normal(module, layout, exponential)
        else:
            emit_response(module, layout, exponential, name, TALLIES.get(name))


@dataclass(frozen=True, slots=True)
class Constants:
    """A block of numbers: the step, the span from the start to the first sample, inputs `(C,)`, the
    start `(X,)`, and weights of channels `(K, X)`.
    """

    b: Builder
    layout: Layout
    block: ir.Value

    @property
    def inputs(self) -> ir.Value:
        return self.b.gep(self.block, [I64(2)])

    @property
    def all_weights(self) -> ir.Value:
        """`(K, X)`."""
        return self.b.gep(self.block, [I64(2 + self.layout.n_constants + self.layout.n_states)])

    def span(self, *, lead: bool) -> Lane:
        """Of the lead, or of a step."""
        return number(self.b, self.block, int(lead))

    def start(self, count: int) -> list[ir.Value]:
        """Of the first `count` states."""
        first = 2 + self.layout.n_constants
        return [number(self.b, self.block, first + i).value for i in range(count)]

    def weights(self, k: int) -> dict[int, ir.Value]:
        """Of channel k, those that are not zero, by state."""
        found = weights_of(self.b, self.all_weights, self.layout.channels, k)
        return {i: weight.value for i, weight in found.items()}

    def exponential(self, of: ir.Function, own: ir.Value, e: ir.Value, *, lead: bool) -> None:
        """Into `e`, over a step or over the lead, of parameters `own`."""
        with self.b.goto_entry_block():
            span = self.b.alloca(VEC)
        self.b.write(self.span(lead=lead).value, span, 0)
        self.b.call(of, [own, self.inputs, span, e])


def emit_response(
    module: ir.Module,
    layout: Layout,
    exponential: ir.Function,
    name: str,
    tally: Tally | None,
) -> None:
    """What is called `name`, a `tally` or signals, see `write_response`.

    x(k + 1) = Phi x(k) + g + G0 u(k) + G1 (u(k + 1) - u(k)), and what is made of x(k).
    """
    blocks = [VECTORS, NUMBERS, NUMBERS, NUMBERS, VECTORS]
    made, b = begin_function(module, name, 2, blocks)
    n_groups, n_samples, parameters, block, y, u, out = made.args
    constants = Constants(b, layout, block)
    n, k_count = layout.size, len(layout.channels)
    e = b.alloca(VEC, I64(n * n))
    groups = Loop(b, n_groups, [], "groups")
    each = tally.weights if tally is not None else 0
    mine = b.gep(parameters, [b.mul(groups.index, I64(layout.n_parameters + k_count * each))])
    own = [b.read(mine, layout.n_parameters + place) for place in range(k_count * each)]
    state = constants.start(layout.n_states)
    if layout.lead:
        constants.exponential(exponential, mine, e, lead=True)
        state = next_state(b, layout.n_states, entries(b, layout, e), state, [])
    constants.exponential(exponential, mine, e, lead=False)
    phi = entries(b, layout, e)
    totals = tally.begun(k_count) if tally is not None else []
    samples = Loop(b, n_samples, state + totals, "samples")
    state, totals = samples.carried[: len(state)], samples.carried[len(state) :]
    drive = emit_drive(b, layout, u, samples.index)
    for k in range(k_count):
        flat = b.add(b.mul(samples.index, I64(k_count)), I64(k))
        value = vector(0.0) if tally is None else b.splat(b.load(b.gep(y, [flat])))
        for i, weight in constants.weights(k).items():
            value = b.fma(weight if tally is None else b.fneg(weight), state[i], value)
        if tally is not None:
            kept = slice(k * tally.count, (k + 1) * tally.count)
            sample = Sample(value, None, own[k * each : (k + 1) * each])
            totals[kept] = tally.added(b, totals[kept], sample)
        else:
            row = b.add(b.mul(groups.index, b.mul(n_samples, I64(k_count))), flat)
            b.write(value, b.gep(out, [row]), 0)
    samples.close(next_state(b, layout.n_states, phi, state, drive) + totals)
    place = b.gep(out, [b.mul(groups.index, I64(len(totals)))])
    b.write_row(totals, place)
    groups.close([])
    b.ret_void()


def entries(b: Builder, layout: Layout, e: ir.Value) -> dict[tuple[int, int], ir.Value]:
    size, reach, idle = layout.size, layout.reach, layout.idle
    found = {
        (i, j): b.read(e, i * size + j)
        for i in range(layout.n_states)
        for j in range(size)
        if reach[i][j]
    }
    # One, and known to be: an addition of it is none to multiply first.
    return found | {(i, i): vector(1.0) for i in range(layout.n_states) if idle[i]}


def next_state(
    b: Builder,
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


def _sum(b: Builder, terms: list[tuple[ir.Value, ir.Value]], total: ir.Value) -> ir.Value:
    for entry, value in terms:
        total = b.fma(entry, value, total)
    return total


def emit_drive(b: Builder, layout: Layout, u: ir.Value, index: ir.Value) -> list[ir.Value]:
    """The sampled inputs at this sample and, with a first-order hold, their increments."""

    def series(row: ir.Value, s: int) -> ir.Value:
        return b.load(b.gep(u, [b.add(b.mul(row, I64(layout.n_series)), I64(s))]))

    drive = [series(index, s) for s in range(layout.n_series)]
    if layout.first_order:
        following = b.add(index, I64(1))
        drive += [b.fsub(series(following, s), drive[s]) for s in range(layout.n_series)]
    return [b.splat(value) for value in drive]


Values = list[ir.Value]
Entries = dict[tuple[int, int], ir.Value]


def scratch_size(layout: Layout, q: int) -> int:
    """Vectors of scratch that `normal` wants, for `layout` of the tangent."""
    x = layout.n_states // 2
    return layout.size**2 + q * (x * (layout.size - x) + x + len(layout.channels))


def emit_normal(module: ir.Module, layout: Layout, exponential: ir.Function) -> None:
    """`normal(G, T, q, parameters, directions, scales, constants, y, u, scratch, out)`.

    `layout` is the tangent's: its first X states are the rig's, and its channels are derivatives.
    `parameters (G, P, LANES)`, `directions (G, q, P, LANES)`, `scales (G, K, LANES)`: one over the
    noise.  `out (G, K + q + q q, LANES)`: squares, slopes, and the lower triangle of the products.
    """
    blocks = [VECTORS, VECTORS, VECTORS, NUMBERS, NUMBERS, NUMBERS, VECTORS, VECTORS]
    made, b = begin_function(module, "normal", 3, blocks)
    n_groups, n_samples, _, parameters, _, scales, block, _, u, e, out = made.args
    w = _Normal(made, b, Constants(b, layout, block), _Tangent(b, layout, e), exponential)
    x, q, k_count, p_count = w.x, w.q, w.k_count, w.p_count
    groups = Loop(b, n_groups, [], "groups")
    out_count = b.add(I64(k_count), b.add(q, b.mul(q, q)))
    own_out = b.past(out, groups.index, out_count)
    own_scales = b.past(scales, groups.index, k_count)
    slope_sums = b.gep(own_out, [I64(k_count)])
    product_sums = b.gep(slope_sums, [q])
    b.clear(own_out, out_count)
    own = b.past(parameters, groups.index, p_count)
    for p in range(p_count):
        b.write(b.read(own, p), w.both, p)
    state = w.first_state(groups.index)
    matrices = Loop(b, q, [], "matrices")
    w.in_direction(groups.index, matrices.index, lead=False)
    mine = b.past(w.d, matrices.index, w.d_count)
    b.write_row(w.matrix.slopes, mine)
    matrices.close([])
    phi = w.matrix.phi
    samples = Loop(b, n_samples, state + [vector(0.0)] * k_count, "samples")
    state, totals = samples.carried[:x], samples.carried[x:]
    drive = emit_drive(b, layout, u, samples.index)
    left = w.left(samples.index, state, own_scales)
    totals = [b.fma(value, value, total) for value, total in zip(left, totals, strict=True)]
    # In each direction: sums with what is left and with the directions up to it; then the next slopes.
    each = Loop(b, q, [], "each")
    own_x = b.past(w.slopes_x, each.index, x)
    own_s = b.past(w.slopes_s, each.index, k_count)
    own_d = b.past(w.d, each.index, w.d_count)
    slope_x = b.read_row(own_x, x)
    seen = w.seen(slope_x, own_scales)
    b.write_row(seen, own_s)
    _add_products(b, b.gep(slope_sums, [each.index]), seen, left)
    row = b.past(product_sums, each.index, q)
    pairs = Loop(b, b.add(each.index, I64(1)), [], "pairs")
    other_s = b.past(w.slopes_s, pairs.index, k_count)
    _add_products(b, b.gep(row, [pairs.index]), seen, b.read_row(other_s, k_count))
    pairs.close([])
    slope = {place: b.read(own_d, n) for n, place in enumerate(w.matrix.places)}
    b.write_row(_next_slope(b, x, phi, slope, state, slope_x, drive), own_x)
    each.close([])
    samples.close(next_state(b, x, phi, state, drive) + totals)
    b.write_row(totals, own_out)
    groups.close([])
    b.ret_void()


class _Normal:
    """Where slopes stand, in all directions, and what is made of those of a group of walkers."""

    def __init__(
        self,
        made: ir.Function,
        b: Builder,
        constants: Constants,
        matrix: _Tangent,
        exponential: ir.Function,
    ) -> None:
        _, _, self.q, _, self.directions, _, _, self.y, _, e, _ = made.args
        self.b, self.constants, self.matrix, self.exponential = b, constants, matrix, exponential
        layout, self.x = matrix.layout, matrix.x
        self.k_count, self.p_count = len(layout.channels), layout.n_parameters // 2
        self.d_count = self.x * (layout.size - self.x)
        self.d = b.gep(e, [I64(layout.size**2)])
        self.slopes_x = b.past(self.d, self.q, self.d_count)  # of states
        self.slopes_s = b.past(self.slopes_x, self.q, self.x)  # of what channels show
        self.both = b.alloca(VEC, I64(2 * self.p_count))

    def _weights(self, k: int) -> dict[int, ir.Value]:
        """Of channel k, by the rig's own states: those of the derivatives that it shows."""
        return {i - self.x: weight for i, weight in self.constants.weights(k).items()}

    def in_direction(self, group: ir.Value, direction: ir.Value, *, lead: bool) -> None:
        """The exponential of the tangent's matrix."""
        b = self.b
        row = b.past(self.directions, b.add(b.mul(group, self.q), direction), self.p_count)
        for p in range(self.p_count):
            b.write(b.read(row, p), self.both, self.p_count + p)
        self.constants.exponential(self.exponential, self.both, self.matrix.e, lead=lead)

    def first_state(self, group: ir.Value) -> Values:
        """Of the rig, at the first sample; those of the slopes are stored."""
        b, x, matrix, state = self.b, self.x, self.matrix, self.constants.start(self.x)
        if not matrix.layout.lead:
            b.clear(self.slopes_x, b.mul(self.q, I64(x)))
            return state
        zero, begun = [vector(0.0)] * x, Loop(b, self.q, [], "begun")
        self.in_direction(group, begun.index, lead=True)
        phi, slope = matrix.phi, dict(zip(matrix.places, matrix.slopes, strict=True))
        mine = b.past(self.slopes_x, begun.index, x)
        b.write_row(_next_slope(b, x, phi, slope, state, zero, []), mine)
        begun.close([])
        return next_state(b, x, matrix.phi, state, [])

    def left(self, sample: ir.Value, state: Values, scales: ir.Value) -> Values:
        """Of the record, over the noise."""
        b, found = self.b, []
        for k in range(self.k_count):
            flat = b.add(b.mul(sample, I64(self.k_count)), I64(k))
            value = b.splat(b.load(b.gep(self.y, [flat])))
            for i, weight in self._weights(k).items():
                value = b.fma(b.fneg(weight), state[i], value)
            found.append(b.fmul(value, b.read(scales, k)))
        return found

    def seen(self, slope_x: Values, scales: ir.Value) -> Values:
        """Of slopes of the states, by channels, over the noise."""
        b, found = self.b, []
        for k in range(self.k_count):
            value = vector(0.0)
            for i, weight in self._weights(k).items():
                value = b.fma(weight, slope_x[i], value)
            found.append(b.fmul(value, b.read(scales, k)))
        return found


def _add_products(b: Builder, place: ir.Value, ones: Values, others: Values) -> None:
    total = b.load(place, align=8)
    for one, other in zip(ones, others, strict=True):
        total = b.fma(one, other, total)
    b.store(total, place, align=8)


@dataclass(frozen=True, slots=True)
class _Tangent:
    """The exponential `e` of a tangent's matrix: rows count the rig's `x` states, columns go on with the
    inputs after them.
    """

    b: Builder
    layout: Layout
    e: ir.Value

    @property
    def x(self) -> int:
        return self.layout.n_states // 2

    @property
    def _columns(self) -> list[int]:
        return [*range(self.x), *range(2 * self.x, self.layout.size)]

    def _reached(self, first: int) -> dict[tuple[int, int], int]:
        """Where entries stand that can differ from zero, in as many rows from the `first` on."""
        size, reach = self.layout.size, self.layout.reach
        return {
            (i, n): (first + i) * size + column
            for i in range(self.x)
            for n, column in enumerate(self._columns)
            if reach[first + i][column]
        }

    @property
    def phi(self) -> Entries:
        return {place: self.b.read(self.e, at) for place, at in self._reached(0).items()}

    @property
    def places(self) -> list[tuple[int, int]]:
        """(row, column) of entries of Phi_j, g_j and G_j."""
        return list(self._reached(self.x))

    @property
    def slopes(self) -> Values:
        """These entries."""
        return [self.b.read(self.e, at) for at in self._reached(self.x).values()]


def _next_slope(
    b: Builder,
    x: int,
    phi: Entries,
    slope: Entries,
    state: Values,
    slope_x: Values,
    drive: Values,
) -> Values:
    following = []
    for i in range(x):
        total = slope.get((i, x), vector(0.0))
        for n, value in [*enumerate(state), *enumerate(drive, start=x + 1)]:
            if (i, n) in slope:
                total = b.fma(slope[i, n], value, total)
        other = vector(0.0)
        for n, value in enumerate(slope_x):
            if (i, n) in phi:
                other = b.fma(phi[i, n], value, other)
        following.append(b.fadd(total, other))
    return following
