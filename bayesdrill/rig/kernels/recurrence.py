"""The response of groups of walkers sample after sample, and its normal equations.

Neither is stored.  Beside the state x there are its derivatives x_j in q directions of the
parameters,

    x_j(k + 1) = Phi x_j(k) + Phi_j x(k) + g_j + G_j (u(k), ...)

with Phi_j from the exponential of the tangent's matrix.  At each sample the channels' derivatives
are multiplied with each other and with the residuals.
"""

from __future__ import annotations

from dataclasses import dataclass

from llvmlite import ir

from bayesdrill.rig.kernels.exponential import Layout, channel_weights, emit_exponential, number
from bayesdrill.rig.kernels.lanes import (
    I64,
    NUMBERS,
    VEC,
    VECTORS,
    Builder,
    Loop,
    Vector,
    begin_function,
    vector,
)
from bayesdrill.rig.kernels.sums import RESIDUAL_SUMS, ResidualSums, Sample


def write_response(module: ir.Module, layout: Layout, *names: str) -> None:
    """Write `misfit(G, T, parameters, constants, y, u, out)`, `signals(...)` and others.

    They are for G groups of LANES walkers.  All arguments but counts are addresses of C-contiguous
    blocks: `parameters (G, P, LANES)`, `constants`, see `Constants`, `y (T, K)`, `u (T + 1,
    n_series)`.  `misfit` writes sums of squares `(G, K, LANES)`, `signals` `(G, T, K, LANES)`; a
    lane whose numbers overflow gets NaN.  Other `RESIDUAL_SUMS` are as `misfit`, with as many
    numbers `(G, K, n, LANES)` as they have, and their weights `(K, m)` after the parameters.
    `NORMALS`: see `emit_normal`.
    """
    exponential = emit_exponential(module, layout, increments=True)
    for name in names:
        if name in NORMALS:
            emit_normal(module, layout, exponential, name)
        else:
            emit_response(module, layout, exponential, name, RESIDUAL_SUMS.get(name))


@dataclass(frozen=True, slots=True)
class Constants:
    """The block of numbers that all walkers share.

    It has the step, the span from the start to the first sample, inputs `(C,)`, the start `(X,)`,
    and weights of channels `(K, X)`.
    """

    b: Builder
    layout: Layout
    block: ir.Value

    @property
    def inputs(self) -> ir.Value:
        """The address of the constant inputs `(C,)`."""
        return self.b.gep(self.block, [I64(2)])

    @property
    def all_weights(self) -> ir.Value:
        """The address of the weights `(K, X)`."""
        return self.b.gep(self.block, [I64(2 + self.layout.n_constants + self.layout.n_states)])

    def span(self, *, lead: bool) -> Vector:
        """Load the span of the lead, or of a step."""
        return number(self.b, self.block, int(lead))

    def start(self, count: int) -> list[ir.Value]:
        """Load the start of the first `count` states."""
        first = 2 + self.layout.n_constants
        return [number(self.b, self.block, first + i).value for i in range(count)]

    def weights(self, k: int) -> dict[int, ir.Value]:
        """Return the weights of channel k that are not zero, by state."""
        weights = channel_weights(self.b, self.all_weights, self.layout.channels, k)
        return {i: weight.value for i, weight in weights.items()}

    def exponential(
        self, function: ir.Function, parameters: ir.Value, e: ir.Value, *, lead: bool
    ) -> None:
        """Store the exponential of `parameters` over a step or over the lead at `e`."""
        with self.b.goto_entry_block():
            span = self.b.alloca(VEC)
        self.b.write(self.span(lead=lead).value, span, 0)
        self.b.call(function, [parameters, self.inputs, span, e])


def emit_response(
    module: ir.Module,
    layout: Layout,
    exponential: ir.Function,
    name: str,
    tally: ResidualSums | None,
) -> None:
    """Write the function `name`, of a `tally` or of signals, see `write_response`.

    x(k + 1) = Phi x(k) + g + G0 u(k) + G1 (u(k + 1) - u(k)), and what is observed of x(k).
    """
    blocks = [VECTORS, NUMBERS, NUMBERS, NUMBERS, VECTORS]
    function, b = begin_function(module, name, 2, blocks)
    n_groups, n_samples, parameters, block, y, u, out = function.args
    constants = Constants(b, layout, block)
    n, k_count = layout.size, len(layout.channels)
    e = b.alloca(VEC, I64(n * n))
    groups = Loop(b, n_groups, [], "groups")
    each = tally.weights if tally is not None else 0
    mine = b.gep(parameters, [b.mul(groups.index, I64(layout.n_parameters + k_count * each))])
    weights = [b.read(mine, layout.n_parameters + index) for index in range(k_count * each)]
    state = constants.start(layout.n_states)
    if layout.lead:
        constants.exponential(exponential, mine, e, lead=True)
        state = next_state(b, layout.n_states, phi_entries(b, layout, e), state, [])
    constants.exponential(exponential, mine, e, lead=False)
    phi = phi_entries(b, layout, e)
    totals = tally.initial(k_count) if tally is not None else []
    samples = Loop(b, n_samples, state + totals, "samples")
    state, totals = samples.carried[: len(state)], samples.carried[len(state) :]
    drive = emit_drive(b, layout, u, samples.index)
    for k in range(k_count):
        flat = b.add(b.mul(samples.index, I64(k_count)), I64(k))
        value = vector(0.0) if tally is None else b.splat(b.load(b.gep(y, [flat])))
        for i, weight in constants.weights(k).items():
            value = b.fma(weight if tally is None else b.fneg(weight), state[i], value)
        if tally is not None:
            channel = slice(k * tally.count, (k + 1) * tally.count)
            sample = Sample(value, None, weights[k * each : (k + 1) * each])
            totals[channel] = tally.add(b, totals[channel], sample)
        else:
            row = b.add(b.mul(groups.index, b.mul(n_samples, I64(k_count))), flat)
            b.write(value, b.gep(out, [row]), 0)
    samples.close(next_state(b, layout.n_states, phi, state, drive) + totals)
    address = b.gep(out, [b.mul(groups.index, I64(len(totals)))])
    b.write_row(totals, address)
    groups.close([])
    b.ret_void()


def phi_entries(b: Builder, layout: Layout, e: ir.Value) -> dict[tuple[int, int], ir.Value]:
    """Return the entries of Phi and of the columns after it that can differ from zero."""
    size, reach, idle = layout.size, layout.reach, layout.idle
    phi = {
        (i, j): b.read(e, i * size + j)
        for i in range(layout.n_states)
        for j in range(size)
        if reach[i][j]
    }
    # One, and known to be: an addition of it is none to multiply first.
    return phi | {(i, i): vector(1.0) for i in range(layout.n_states) if idle[i]}


def next_state(
    b: Builder,
    n_states: int,
    phi: dict[tuple[int, int], ir.Value],
    state: list[ir.Value],
    drive: list[ir.Value],
    *,
    halves: bool = True,
) -> list[ir.Value]:
    """Return the state after a step.

    Each sum is in two `halves` where a step takes as long as its longest chain of additions.
    """
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
    """Load the sampled inputs at a sample and, with a first-order hold, their increments."""

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
    """Return the vectors of scratch that `NORMALS` need, for `layout` of the tangent."""
    x = layout.n_states // 2
    return layout.size**2 + q * (x * (layout.size - x) + x + 2 * len(layout.channels))


NORMALS = ("normal", "innovations")


def emit_normal(module: ir.Module, layout: Layout, exponential: ir.Function, name: str) -> None:
    """Write `normal(G, T, q, parameters, directions, scales, constants, y, u, scratch, out)`.

    `layout` is the tangent's: its first X states are the rig's, and its channels are derivatives.
    `parameters (G, P, LANES)`, `directions (G, q, P, LANES)`, `scales (G, K, LANES)`: one over the
    noise.  `out (G, K + q + q q, LANES)`: squares, slopes, and the lower triangle of the products.

    `innovations(...)` is the same for noise that remembers.  It has `scales (G, 3 K, LANES)`: those of
    a sample, of the sample before, which is taken from it, and of the first.
    """
    blocks = [VECTORS, VECTORS, VECTORS, NUMBERS, NUMBERS, NUMBERS, VECTORS, VECTORS]
    function, b = begin_function(module, name, 3, blocks)
    n_groups, n_samples, _, parameters, _, scales, block, _, u, e, out = function.args
    w = _Normal(function, b, Constants(b, layout, block), _Tangent(b, layout, e), exponential)
    x, q, k_count, p_count, memory = w.x, w.q, w.k_count, w.p_count, name == "innovations"
    groups = Loop(b, n_groups, [], "groups")
    out_count = b.add(I64(k_count), b.add(q, b.mul(q, q)))
    own_out = b.offset(out, groups.index, out_count)
    own_scales = b.offset(scales, groups.index, (3 if memory else 1) * k_count)
    slope_sums = b.gep(own_out, [I64(k_count)])
    product_sums = b.gep(slope_sums, [q])
    b.clear(own_out, out_count)
    walker = b.offset(parameters, groups.index, p_count)
    for p in range(p_count):
        b.write(b.read(walker, p), w.both, p)
    state = w.first_state(groups.index)
    matrices = Loop(b, q, [], "matrices")
    w.in_direction(groups.index, matrices.index, lead=False)
    mine = b.offset(w.d, matrices.index, w.d_count)
    b.write_row(w.matrix.slopes, mine)
    matrices.close([])
    phi = w.matrix.phi
    b.clear(w.slopes_before, b.mul(q, I64(k_count)))
    begin = state + [vector(0.0)] * ((2 if memory else 1) * k_count)
    samples = Loop(b, n_samples, begin, "samples")
    state, totals, before = (
        samples.carried[i:j] for i, j in ((0, x), (x, x + k_count), (x + k_count, None))
    )
    drive = emit_drive(b, layout, u, samples.index)
    left = w.residuals(samples.index, state)
    first = b.icmp_signed("==", samples.index, I64(0))
    residuals = w.whitened(left, before, own_scales, first)
    totals = [b.fma(value, value, total) for value, total in zip(residuals, totals, strict=True)]
    # In each direction: sums with what is left and with the directions up to it; then the next slopes.
    each = Loop(b, q, [], "each")
    own_x = b.offset(w.slopes_x, each.index, x)
    own_s = b.offset(w.slopes_s, each.index, k_count)
    own_d = b.offset(w.d, each.index, w.d_count)
    slope_x = b.read_row(own_x, x)
    shown = w.sensitivities(slope_x)
    own_before = b.offset(w.slopes_before, each.index, k_count)
    slopes_before = b.read_row(own_before, k_count) if memory else []
    sensitivities = w.whitened(shown, slopes_before, own_scales, first)
    b.write_row(sensitivities, own_s)
    if memory:
        b.write_row(shown, own_before)
    _add_products(b, b.gep(slope_sums, [each.index]), sensitivities, residuals)
    row = b.offset(product_sums, each.index, q)
    pairs = Loop(b, b.add(each.index, I64(1)), [], "pairs")
    other_s = b.offset(w.slopes_s, pairs.index, k_count)
    _add_products(b, b.gep(row, [pairs.index]), sensitivities, b.read_row(other_s, k_count))
    pairs.close([])
    slope = {index: b.read(own_d, n) for n, index in enumerate(w.matrix.places)}
    b.write_row(_next_slope(b, x, phi, slope, state, slope_x, drive), own_x)
    each.close([])
    samples.close(next_state(b, x, phi, state, drive) + totals + (left if memory else []))
    b.write_row(totals, own_out)
    groups.close([])
    b.ret_void()


class _Normal:
    """The addresses of slopes in all directions, and the code for those of a group of walkers."""

    def __init__(
        self,
        function: ir.Function,
        b: Builder,
        constants: Constants,
        matrix: _Tangent,
        exponential: ir.Function,
    ) -> None:
        _, _, self.q, _, self.directions, _, _, self.y, _, e, _ = function.args
        self.b, self.constants, self.matrix, self.exponential = b, constants, matrix, exponential
        layout, self.x = matrix.layout, matrix.x
        self.k_count, self.p_count = len(layout.channels), layout.n_parameters // 2
        self.d_count = self.x * (layout.size - self.x)
        self.d = b.gep(e, [I64(layout.size**2)])
        self.slopes_x = b.offset(self.d, self.q, self.d_count)  # of states
        self.slopes_s = b.offset(self.slopes_x, self.q, self.x)  # of what channels show
        self.slopes_before = b.offset(self.slopes_s, self.q, self.k_count)  # at the sample before
        self.both = b.alloca(VEC, I64(2 * self.p_count))

    def _weights(self, k: int) -> dict[int, ir.Value]:
        """Return the weights of channel k by the rig's own states: those of their derivatives."""
        return {i - self.x: weight for i, weight in self.constants.weights(k).items()}

    def in_direction(self, group: ir.Value, direction: ir.Value, *, lead: bool) -> None:
        """Store the exponential of the tangent's matrix in a direction."""
        b = self.b
        row = b.offset(self.directions, b.add(b.mul(group, self.q), direction), self.p_count)
        for p in range(self.p_count):
            b.write(b.read(row, p), self.both, self.p_count + p)
        self.constants.exponential(self.exponential, self.both, self.matrix.e, lead=lead)

    def first_state(self, group: ir.Value) -> Values:
        """Return the rig's state at the first sample, and store those of the slopes."""
        b, x, matrix, state = self.b, self.x, self.matrix, self.constants.start(self.x)
        if not matrix.layout.lead:
            b.clear(self.slopes_x, b.mul(self.q, I64(x)))
            return state
        zero, begun = [vector(0.0)] * x, Loop(b, self.q, [], "begun")
        self.in_direction(group, begun.index, lead=True)
        phi, slope = matrix.phi, dict(zip(matrix.places, matrix.slopes, strict=True))
        mine = b.offset(self.slopes_x, begun.index, x)
        b.write_row(_next_slope(b, x, phi, slope, state, zero, []), mine)
        begun.close([])
        return next_state(b, x, matrix.phi, state, [])

    def residuals(self, sample: ir.Value, state: Values) -> Values:
        """Return measured minus computed."""
        b, residuals = self.b, []
        for k in range(self.k_count):
            flat = b.add(b.mul(sample, I64(self.k_count)), I64(k))
            value = b.splat(b.load(b.gep(self.y, [flat])))
            for i, weight in self._weights(k).items():
                value = b.fma(b.fneg(weight), state[i], value)
            residuals.append(value)
        return residuals

    def sensitivities(self, slope_x: Values) -> Values:
        """Return what channels show of slopes of the states."""
        b, sensitivities = self.b, []
        for k in range(self.k_count):
            value = vector(0.0)
            for i, weight in self._weights(k).items():
                value = b.fma(weight, slope_x[i], value)
            sensitivities.append(value)
        return sensitivities

    def whitened(self, values: Values, before: Values, scales: ir.Value, first: ir.Value) -> Values:
        """Return values over the noise; `before`: at the sample before, none of white noise."""
        b, k_count = self.b, self.k_count
        if not before:
            return [b.fmul(value, b.read(scales, k)) for k, value in enumerate(values)]
        whitened = []
        for k, (value, earlier) in enumerate(zip(values, before, strict=True)):
            scale = b.select(first, b.read(scales, 2 * k_count + k), b.read(scales, k))
            remembered = b.fmul(earlier, b.read(scales, k_count + k))
            whitened.append(b.fsub(b.fmul(value, scale), remembered))
        return whitened


def _add_products(b: Builder, address: ir.Value, ones: Values, others: Values) -> None:
    total = b.load(address, align=8)
    for factor, other in zip(ones, others, strict=True):
        total = b.fma(factor, other, total)
    b.store(total, address, align=8)


@dataclass(frozen=True, slots=True)
class _Tangent:
    """The exponential `e` of a tangent's matrix.

    Rows count the rig's `x` states, columns go on with the inputs after them.
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
        return {index: self.b.read(self.e, at) for index, at in self._reached(0).items()}

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
