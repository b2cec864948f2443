"""The response of rigs of many states: steps of several samples at once, by one product of each.

With z = (x, 1, u(0), ..., u(m - 1)) at the first of m samples, what follows is z B: x and one after
them, and the channels at m - 1, ..., 0.  B of one sample is the transpose of the exponential, with
the channels' weights beside it; that of twice as many follows from a product of B with itself.  A
step of the states so takes a part of its X^2 multiplications.
"""

from __future__ import annotations

from dataclasses import dataclass

from llvmlite import ir

from bayesdrill.rig.kernels.exponential import Layout
from bayesdrill.rig.kernels.lanes import I64, NUMBERS, VECTORS, Builder, Loop, begin_function, vector
from bayesdrill.rig.kernels.loops import Block, Matrices, emit_large_exponential, in_panels
from bayesdrill.rig.kernels.recurrence import Constants, emit_drive
from bayesdrill.rig.kernels.sums import RESIDUAL_SUMS, ResidualSums, Sample

DOUBLINGS = 3  # of one sample: more cost more matrices than they save steps
SAMPLES = 2**DOUBLINGS
BLOCKS = 8  # whose channels are computed together, so that B is read once for all


@dataclass(frozen=True, slots=True)
class BlockShape:
    """Sizes of B: `rows` of x, one and inputs, `columns` of x, one and channels."""

    layout: Layout

    @property
    def head(self) -> int:
        """States and one."""
        return self.layout.n_states + 1

    @property
    def drives(self) -> int:
        """Inputs of a sample, with their increments."""
        return self.layout.size - self.head

    @property
    def channels(self) -> int:
        """Channels of a sample."""
        return len(self.layout.channels)

    @property
    def rows(self) -> int:
        """Rows of B."""
        return self.head + SAMPLES * self.drives

    @property
    def columns(self) -> int:
        """Columns of B in memory."""
        shown = self.head + in_panels(SAMPLES * self.channels)
        return in_panels(max(shown, self.rows))

    def scratch(self, *, slopes: bool) -> int:
        """Return the vectors of scratch that a kernel needs: two of B, and two of rows."""
        return (2 * self.rows + 2 * BLOCKS + 1) * self.columns * (1 + slopes)


def write_blocks(module: ir.Module, layout: Layout, *names: str) -> None:
    """Write functions as `write_response` does, with an address of scratch behind the others.

    Beside them `course`: signals and their slopes `(G, T, 2, K, LANES)`, in the direction that
    stands behind the parameters.
    """
    matrices = Matrices(module, BlockShape(layout).columns)
    exponential = emit_large_exponential(matrices, layout, slopes="course" in names)
    for name in names:
        _emit_response(matrices, layout, exponential, name, RESIDUAL_SUMS.get(name))


def _emit_response(
    matrices: Matrices,
    layout: Layout,
    exponential: ir.Function,
    name: str,
    tally: ResidualSums | None,
) -> None:
    blocks = [VECTORS, NUMBERS, NUMBERS, NUMBERS, VECTORS, VECTORS]
    function, b = begin_function(matrices.module, name, 2, blocks)
    n_groups, n_samples, parameters, block, y, u, out, scratch = function.args
    w = _Blocks(b, matrices, BlockShape(layout), Constants(b, layout, block), name == "course")
    one, other, z, following = w.parts(scratch)
    shape, width, k_count = w.shape, w.width, w.shape.channels
    each = tally.weights if tally is not None else 0
    groups = Loop(b, n_groups, [], "groups")
    mine = b.offset(parameters, groups.index, width * layout.n_parameters + k_count * each)
    weights = b.read_row(b.gep(mine, [I64(layout.n_parameters)]), k_count * each)
    w.begin(exponential, mine, one, other, z, following)
    w.double(exponential, mine, one, other)
    final = other if DOUBLINGS % 2 else one
    start = tally.initial(k_count) if tally is not None else []
    length = SAMPLES * BLOCKS
    stretches = Loop(b, _parts(b, n_samples, length), start, "stretches")
    first = b.mul(stretches.index, I64(length))
    here = _least(b, b.sub(n_samples, first), I64(length))
    count = _parts(b, here, SAMPLES)
    steps = Loop(b, count, [], "steps")
    now = tuple(b.offset(part, steps.index, shape.columns) for part in z)
    for j in range(SAMPLES):
        index = b.add(b.add(first, b.mul(steps.index, I64(SAMPLES))), I64(j))
        drive = emit_drive(b, layout, u, _least(b, index, b.sub(n_samples, I64(1))))
        b.write_row(drive, b.gep(now[0], [I64(shape.head + j * shape.drives)]))
    then = tuple(b.gep(part, [I64(shape.columns)]) for part in now)
    matrices.multiply(b, then, now, final, (1, shape.rows, shape.head))
    if w.slopes:
        b.clear(b.gep(then[1], [I64(shape.head)]), I64(shape.columns - shape.head))
    steps.close([])
    channels = tuple(b.gep(part, [I64(shape.head)]) for part in final)
    matrices.multiply(b, following, z, channels, (count, shape.rows, SAMPLES * k_count))
    for part in z:
        b.copy(b.offset(part, count, shape.columns), part, shape.head)
    samples = Loop(b, here, stretches.carried, "samples")
    totals = list(samples.carried)
    sample = b.add(first, samples.index)
    step = b.sdiv(samples.index, I64(SAMPLES))
    place = b.sub(I64(SAMPLES - 1), b.sub(samples.index, b.mul(step, I64(SAMPLES))))
    place = b.add(b.mul(step, I64(shape.columns)), b.mul(place, I64(k_count)))
    shown = [b.read_row(b.gep(part, [place]), k_count) for part in following]
    row = b.add(b.mul(groups.index, n_samples), sample)
    if tally is None:
        b.write_row([value for part in shown for value in part], b.offset(out, row, width * k_count))
    for k in range(k_count if tally is not None else 0):
        measured = b.splat(b.load(b.gep(y, [b.add(b.mul(sample, I64(k_count)), I64(k))])))
        channel = slice(k * tally.count, (k + 1) * tally.count)
        one_sample = Sample(b.fsub(measured, shown[0][k]), None, weights[k * each : (k + 1) * each])
        totals[channel] = tally.add(b, totals[channel], one_sample)
    samples.close(totals)
    stretches.close(totals)
    b.write_row(totals, b.offset(out, groups.index, len(totals)))
    groups.close([])
    b.ret_void()


def _least(b: Builder, value: ir.Value, other: ir.Value) -> ir.Value:
    return b.select(b.icmp_signed("<", value, other), value, other)


def _parts(b: Builder, count: ir.Value, length: int) -> ir.Value:
    """Return how many parts of a length it takes."""
    return b.sdiv(b.add(count, I64(length - 1)), I64(length))


@dataclass(frozen=True, slots=True)
class _Blocks:
    """The code that makes B of a group of walkers."""

    b: Builder
    matrices: Matrices
    shape: BlockShape
    constants: Constants
    slopes: bool

    @property
    def width(self) -> int:
        """Blocks of a matrix."""
        return 1 + self.slopes

    def parts(self, scratch: ir.Value) -> tuple[Block, Block, Block, Block]:
        """Return the addresses of two of B, z, and what follows from it."""
        shape, at, parts = self.shape, 0, []
        whole = shape.rows * shape.columns
        for size in (whole, whole, (BLOCKS + 1) * shape.columns, BLOCKS * shape.columns):
            starts = range(at, at + self.width * size, size)
            parts.append(tuple(self.b.gep(scratch, [I64(start)]) for start in starts))
            at += self.width * size
        one, other, z, following = parts
        return one, other, z, following

    def begin(
        self, exponential: ir.Function, mine: ir.Value, one: Block, other: Block, z: Block, y: Block
    ) -> None:
        """Store z at the first sample."""
        b, shape, x = self.b, self.shape, self.shape.layout.n_states
        for base in z:
            b.clear(base, I64(shape.columns))
        b.write_row([*self.constants.start(x), vector(1.0)], z[0])
        if shape.layout.lead:
            self._step(exponential, mine, one, other, lead=True)
            self.matrices.multiply(b, y, z, one, (1, shape.head, shape.head))
            for source, target in zip(y, z, strict=True):
                b.copy(source, target, shape.head)

    def double(
        self, exponential: ir.Function, mine: ir.Value, one: Block, other: Block
    ) -> None:
        """Store B at one of two places, the second where `DOUBLINGS` are odd."""
        b, shape = self.b, self.shape
        self._step(exponential, mine, one, other, lead=False)
        for base in one:
            self._each_row(shape.layout.size, base, shape.head, [vector(0.0)] * shape.channels)
        for k in range(shape.channels):
            for i, weight in self.constants.weights(k).items():
                b.write(weight, one[0], i * shape.columns + shape.head + k)
        for m in (2**doubling for doubling in range(DOUBLINGS)):
            self._doubled(m, one, other)
            one, other = other, one

    def _step(
        self, exponential: ir.Function, mine: ir.Value, e: Block, spare: Block, *, lead: bool
    ) -> None:
        b = self.b
        with b.goto_entry_block():
            span = b.alloca(vector(0.0).type)
        b.write(self.constants.span(lead=lead).value, span, 0)
        b.call(exponential, [mine, self.constants.inputs, span, *e, *spare])

    def _each_row(self, rows: int, base: ir.Value, at: int, values: list[ir.Value]) -> None:
        each = Loop(self.b, I64(rows), [], "row")
        start = self.b.offset(base, each.index, self.shape.columns)
        self.b.write_row(values, self.b.gep(start, [I64(at)]))
        each.close([])

    def _doubled(self, m: int, source: Block, target: Block) -> None:
        """Store B of 2 m samples from that of m.

        Rows are x, one, inputs of the first half and of the second; columns x, one, channels of the
        second half and of the first.
        """
        b, shape, stride = self.b, self.shape, self.shape.columns
        rows, shown = shape.head + m * shape.drives, m * shape.channels
        columns = shape.head + shown
        self.matrices.multiply(b, target, source, source, (rows, shape.head, columns))
        for old, new in zip(source, target, strict=True):
            each = Loop(b, I64(rows), [], "first")
            at = b.mul(each.index, I64(stride))
            b.copy(
                b.gep(old, [b.add(at, I64(shape.head))]), b.gep(new, [b.add(at, I64(columns))]), shown
            )
            each.close([])
            if shape.drives:
                each = Loop(b, I64(m * shape.drives), [], "second")
                above = b.offset(old, b.add(each.index, I64(shape.head)), stride)
                below = b.offset(new, b.add(each.index, I64(rows)), stride)
                b.copy(above, below, columns)
                b.clear(b.gep(below, [I64(columns)]), I64(shown))
                each.close([])
