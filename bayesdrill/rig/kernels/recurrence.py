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

from bayesdrill.rig.kernels.exponential import Layout, Registers, channel_weights, store_exponential
from bayesdrill.rig.kernels.lanes import (
    NUMBERS,
    VECTORS,
    Builder,
    Integer,
    Loop,
    Module,
    Values,
    kernel,
    vector,
)
from bayesdrill.rig.kernels.sums import RESIDUAL_SUMS, Sample

# G groups of LANES walkers, T samples, q directions.
COUNTS = ("groups", "samples")
BLOCKS = {
    "parameters": VECTORS,  # (G, P + K m): parameters, then weights `(K, m)` of sums that have some
    "constants": NUMBERS,  # see `Constants`
    "y": NUMBERS,  # (T, K)
    "u": NUMBERS,  # (T + 1, n_series)
    "out": VECTORS,  # (G, K, n) sums, or (G, T, K) signals
}
NORMAL_COUNTS = (*COUNTS, "q")
NORMAL_BLOCKS = {
    "parameters": VECTORS,  # (G, P)
    "directions": VECTORS,  # (G, q, P)
    "scales": VECTORS,  # (G, K) or, for noise that remembers, (G, 3 K); see `_emit_normal`
    "constants": NUMBERS,
    "y": NUMBERS,
    "u": NUMBERS,
    "scratch": VECTORS,  # (`scratch_size`,)
    "out": VECTORS,  # (G, K + q + q q): squares, slopes, and the lower triangle of the products
}
NORMALS = ("normal", "innovations")


def write_response(module: Module, layout: Layout, *names: str) -> None:
    """Write `signals`, sums of squares `misfit` or others of `RESIDUAL_SUMS`, and `NORMALS`.

    They are functions of counts and of addresses of blocks, C-contiguous.  A lane whose numbers
    overflow gets NaN.
    """
    for name in names:
        (_emit_normal if name in NORMALS else _emit_response)(module, layout, name)


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
        return self.b.offset(self.block, 2)

    @property
    def all_weights(self) -> ir.Value:
        """The address of the weights `(K, X)`."""
        return self.b.offset(self.block, 2 + self.layout.n_constants + self.layout.n_states)

    def span(self, *, lead: bool) -> ir.Value:
        """Load the span of the lead, or of a step."""
        return self.b.shared(self.block, int(lead))

    def start(self, count: int) -> Values:
        """Load the start of the first `count` states."""
        first = 2 + self.layout.n_constants
        return [self.b.shared(self.block, first + i) for i in range(count)]

    def shown(self, k: int, state: Values, measured: ir.Value | None = None) -> ir.Value:
        """Return what channel k shows of a state, or by how much less that is than `measured`."""
        b, weights = self.b, channel_weights(self.b, self.all_weights, self.layout.channels, k)
        terms = (
            (weight.value if measured is None else b.fneg(weight.value), state[i])
            for i, weight in weights.items()
        )
        return b.add_products(terms, measured)

    def exponential(self, parameters: ir.Value, e: ir.Value, *, lead: bool) -> None:
        """Store the exponential of `parameters` over a step or over the lead at `e`."""
        span = self.span(lead=lead)
        store_exponential(self.b, parameters, self.inputs, span, e, self.layout, increments=True)


def _emit_response(module: Module, layout: Layout, name: str) -> None:
    """Write the function of a tally or of signals.

    x(k + 1) = Phi x(k) + g + G0 u(k) + G1 (u(k + 1) - u(k)), and what is observed of x(k).
    """
    tally, k_count = RESIDUAL_SUMS.get(name), len(layout.channels)
    each = tally.weights if tally is not None else 0
    with kernel(module, name, COUNTS, BLOCKS) as (a, b):
        constants, e = Constants(b, layout, a["constants"]), b.room(layout.size**2)
        with b.loop(a["groups"], "groups") as group:
            mine = b.offset(a["parameters"], group, layout.n_parameters + k_count * each)
            weights = [b.read(mine, layout.n_parameters + i) for i in range(k_count * each)]
            state = constants.start(layout.n_states)
            if layout.lead:
                constants.exponential(mine, e, lead=True)
                state = next_state(b, phi_entries(b, layout, e), state, [])
            constants.exponential(mine, e, lead=False)
            phi = phi_entries(b, layout, e)
            totals = tally.initial(k_count) if tally is not None else []
            samples = Loop(b, a["samples"], state + totals, "samples")
            state, totals = samples.carried[: len(state)], samples.carried[len(state) :]
            drive = emit_drive(b, layout, a["u"], samples.index)
            places = [b.add(b.mul(samples.index, k_count), k) for k in range(k_count)]
            if tally is None:
                row = b.mul(group, b.mul(a["samples"], k_count))
                for k, flat in enumerate(places):
                    b.write(constants.shown(k, state), a["out"], b.add(row, flat))
            else:
                shown = []
                for k, flat in enumerate(places):
                    residual = constants.shown(k, state, b.shared(a["y"], flat))
                    shown.append(Sample(residual, None, weights[k * each : (k + 1) * each]))
                totals = tally.add_all(b, totals, shown)
            samples.close(next_state(b, phi, state, drive) + totals)
            b.write_row(totals, b.offset(a["out"], group, len(totals)))


def phi_entries(b: Builder, layout: Layout, e: ir.Value) -> Registers:
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
    b: Builder, phi: Registers, state: Values, drive: Values, *, halves: bool = True
) -> Values:
    """Return the state after a step.

    Each sum is in two `halves` where a step takes as long as its longest chain of additions.
    """
    constant, following = len(state), []
    columns = [*enumerate(state), *enumerate(drive, start=constant + 1)]
    for i in range(constant):
        terms = [(phi[i, j], value) for j, value in columns if (i, j) in phi]
        half = len(terms) // 2 if halves else len(terms)
        total = b.add_products(terms[:half], phi.get((i, constant)))
        if halves:
            total = b.fadd(total, b.add_products(terms[half + 1 :], b.fmul(*terms[half])))
        following.append(total)
    return following


def emit_drive(b: Builder, layout: Layout, u: ir.Value, index: Integer) -> Values:
    """Load the sampled inputs at a sample and, with a first-order hold, their increments."""

    def series(row: Integer, s: int) -> ir.Value:
        return b.single(u, b.add(b.mul(row, layout.n_series), s))

    drive = [series(index, s) for s in range(layout.n_series)]
    if layout.first_order:
        following = b.add(index, 1)
        drive += [b.fsub(series(following, s), drive[s]) for s in range(layout.n_series)]
    return [b.splat(value) for value in drive]


def scratch_size(layout: Layout, q: int) -> int:
    """Return the vectors of scratch that `NORMALS` need, for `layout` of the tangent."""
    x = layout.n_states // 2
    return layout.size**2 + q * (x * (layout.size - x) + x + 2 * len(layout.channels))


def _emit_normal(module: Module, layout: Layout, name: str) -> None:
    """Write `normal`, or `innovations`, which is the same for noise that remembers.

    `layout` is the tangent's: its first X states are the rig's, and its channels are derivatives.
    Scales are one over the noise or, where it remembers, those of a sample, of the sample before,
    which is taken from it, and of the first.
    """
    k_count, p_count, memory = len(layout.channels), layout.n_parameters // 2, name == "innovations"
    with kernel(module, name, NORMAL_COUNTS, NORMAL_BLOCKS) as (a, b):
        w, q = _Directions(b, layout, a), a["q"]
        x, constants = w.x, w.constants
        with b.loop(a["groups"], "groups") as group:
            out_count = b.add(k_count, b.add(q, b.mul(q, q)))
            own_out = b.offset(a["out"], group, out_count)
            own_scales = b.offset(a["scales"], group, (3 if memory else 1) * k_count)
            slope_sums = b.offset(own_out, k_count)
            product_sums = b.offset(slope_sums, q)
            b.clear(own_out, out_count)
            walker = b.offset(a["parameters"], group, p_count)
            b.write_row(b.read_row(walker, p_count), w.both)
            state = w.first_state(group)
            with b.loop(q, "matrices") as direction:
                w.exponential(group, direction, lead=False)
                slopes = w.slopes
                b.write_row(slopes.values(), b.offset(w.d, direction, w.d_count))
            phi = w.phi
            b.clear(w.slopes_before, b.mul(q, k_count))
            begin = state + [vector(0.0)] * ((2 if memory else 1) * k_count)
            samples = Loop(b, a["samples"], begin, "samples")
            state, totals, before = (
                samples.carried[i:j] for i, j in ((0, x), (x, x + k_count), (x + k_count, None))
            )
            drive = emit_drive(b, layout, a["u"], samples.index)
            row = b.mul(samples.index, k_count)
            measured = [b.shared(a["y"], b.add(row, k)) for k in range(k_count)]
            # Channels are those of slopes, and have their weights of the states themselves.
            left = [constants.shown(k, 2 * state, y) for k, y in enumerate(measured)]
            first = b.icmp_signed("==", samples.index, 0)
            residuals = _whitened(b, left, before, own_scales, first)
            totals = [b.fma(r, r, total) for r, total in zip(residuals, totals, strict=True)]
            # In each direction: sums with what is left and with the directions up to it; then the
            # next slopes.
            with b.loop(q, "each") as each:
                own_x = b.offset(w.slopes_x, each, x)
                own_s = b.offset(w.slopes_s, each, k_count)
                own_d = b.offset(w.d, each, w.d_count)
                slope_x = b.read_row(own_x, x)
                shown = [constants.shown(k, 2 * slope_x) for k in range(k_count)]
                own_before = b.offset(w.slopes_before, each, k_count)
                slopes_before = b.read_row(own_before, k_count) if memory else []
                sensitivities = _whitened(b, shown, slopes_before, own_scales, first)
                b.write_row(sensitivities, own_s)
                if memory:
                    b.write_row(shown, own_before)
                _add_products(b, b.offset(slope_sums, each), sensitivities, residuals)
                products = b.offset(product_sums, each, q)
                with b.loop(b.add(each, 1), "pairs") as other:
                    other_s = b.read_row(b.offset(w.slopes_s, other, k_count), k_count)
                    _add_products(b, b.offset(products, other), sensitivities, other_s)
                slope = {index: b.read(own_d, n) for n, index in enumerate(slopes)}
                b.write_row(_next_slope(b, phi, slope, state, slope_x, drive), own_x)
            samples.close(next_state(b, phi, state, drive) + totals + (left if memory else []))
            b.write_row(totals, own_out)


class _Directions:
    """The addresses of slopes in all directions, and the exponential of the tangent's matrix.

    Rows of that count the rig's `x` states, columns go on with the inputs after them.
    """

    def __init__(self, b: Builder, layout: Layout, a: dict[str, ir.Value]) -> None:
        self._b, self._layout, self._a = b, layout, a
        self.constants = Constants(b, layout, a["constants"])
        self.x, k_count = layout.n_states // 2, len(layout.channels)
        self._p_count = layout.n_parameters // 2
        self.d_count = self.x * (layout.size - self.x)
        self.d = b.offset(a["scratch"], layout.size**2)
        self.slopes_x = b.offset(self.d, a["q"], self.d_count)  # of states
        self.slopes_s = b.offset(self.slopes_x, a["q"], self.x)  # of what channels show
        self.slopes_before = b.offset(self.slopes_s, a["q"], k_count)  # at the sample before
        self.both = b.room(2 * self._p_count)  # parameters, and a direction

    def exponential(self, group: ir.Value, direction: ir.Value, *, lead: bool) -> None:
        """Store the exponential in a direction."""
        b, p_count = self._b, self._p_count
        row = b.add(b.mul(group, self._a["q"]), direction)
        along = b.read_row(b.offset(self._a["directions"], row, p_count), p_count)
        b.write_row(along, b.offset(self.both, p_count))
        self.constants.exponential(self.both, self._a["scratch"], lead=lead)

    def first_state(self, group: ir.Value) -> Values:
        """Return the rig's state at the first sample, and store those of the slopes."""
        b, x, q, state = self._b, self.x, self._a["q"], self.constants.start(self.x)
        if not self._layout.lead:
            b.clear(self.slopes_x, b.mul(q, x))
            return state
        zero = [vector(0.0)] * x
        with b.loop(q, "begun") as direction:
            self.exponential(group, direction, lead=True)
            slope_x = _next_slope(b, self.phi, self.slopes, state, zero, [])
            b.write_row(slope_x, b.offset(self.slopes_x, direction, x))
        return next_state(b, self.phi, state, [])

    def _entries(self, first: int) -> Registers:
        """Return entries that can differ from zero, in as many rows from the `first` on."""
        size, reach = self._layout.size, self._layout.reach
        columns = [*range(self.x), *range(2 * self.x, size)]
        return {
            (i, n): self._b.read(self._a["scratch"], (first + i) * size + column)
            for i in range(self.x)
            for n, column in enumerate(columns)
            if reach[first + i][column]
        }

    @property
    def phi(self) -> Registers:
        """The entries of Phi, g and G."""
        return self._entries(0)

    @property
    def slopes(self) -> Registers:
        """The entries of Phi_j, g_j and G_j."""
        return self._entries(self.x)


def _whitened(
    b: Builder, values: Values, before: Values, scales: ir.Value, first: ir.Value
) -> Values:
    """Return values over the noise; `before`: at the sample before, none of white noise."""
    k_count = len(values)
    if not before:
        return [b.fmul(value, b.read(scales, k)) for k, value in enumerate(values)]
    whitened = []
    for k, (value, earlier) in enumerate(zip(values, before, strict=True)):
        scale = b.select(first, b.read(scales, 2 * k_count + k), b.read(scales, k))
        remembered = b.fmul(earlier, b.read(scales, k_count + k))
        whitened.append(b.fsub(b.fmul(value, scale), remembered))
    return whitened


def _add_products(b: Builder, address: ir.Value, ones: Values, others: Values) -> None:
    total = b.add_products(zip(ones, others, strict=True), b.read(address, 0))
    b.write(total, address, 0)


def _next_slope(
    b: Builder, phi: Registers, slope: Registers, state: Values, slope_x: Values, drive: Values
) -> Values:
    following = []
    for i, total in enumerate(next_state(b, slope, state, drive, halves=False)):
        terms = [(phi[i, n], value) for n, value in enumerate(slope_x) if (i, n) in phi]
        following.append(b.fadd(total, b.add_products(terms)))
    return following
