"""The response of rigs of many states: steps of several samples at once, by one product of each.

With z = (x, 1, u(0), ..., u(m - 1)) at the first of m samples, z B is what follows: x and one after
them, and the channels at m - 1, ..., 0.  B of one sample is the transpose of the exponential, with
the channels' rows beside it; that of twice as many samples is a product of B with itself.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from llvmlite import ir

from bayesdrill.rig.kernels.exponential import Layout, addresses
from bayesdrill.rig.kernels.lanes import (
    I64,
    NUMBERS,
    VEC,
    VECTORS,
    Builder,
    Loop,
    begin_function,
    vector,
)
from bayesdrill.rig.kernels.loops import Block, Matrices, emit_transposed_exponential, in_panels
from bayesdrill.rig.kernels.recurrence import Constants, emit_drive
from bayesdrill.rig.kernels.sums import RESIDUAL_SUMS, ResidualSums, Sample

DOUBLINGS = 3  # of one sample: more cost more matrices than they save steps
SAMPLES = 1 << DOUBLINGS  # of a step
SLOPES = "sensitivities"
STEPS = 8  # whose channels are computed together, so that B is read once for all


@dataclass(frozen=True, slots=True)
class BlockShape:
    """Sizes of B, for a `layout` and its `channels`."""

    layout: Layout
    channels: int

    @property
    def text(self) -> str:
        """See `Structure`."""
        return f"{self.layout.text} {self.channels}"

    @property
    def head(self) -> int:
        """States and one."""
        return self.layout.n_states + 1

    @property
    def drives(self) -> int:
        """Inputs of a sample, with their increments."""
        return self.layout.size - self.head

    @property
    def rows(self) -> int:
        """Of B: x, one, and inputs."""
        return self.head + SAMPLES * self.drives

    @property
    def columns(self) -> int:
        """Of B in memory: x, one and channels, and no fewer than rows."""
        shown = self.head + in_panels(SAMPLES * self.channels)
        return in_panels(max(shown, self.rows))

    @property
    def walker(self) -> Mapping[str, int]:
        """Numbers of a walker: parameters, start, and rows `(K, X + 1)` of channels."""
        layout, rows = self.layout, self.channels * self.head
        return {"parameters": layout.n_parameters, "start": layout.n_states, "rows": rows}

    def scratch(self, width: int) -> int:
        """Return the vectors that a kernel needs: two of B, one z more than steps, and channels."""
        return (2 * self.rows + 2 * STEPS + 1) * self.columns * width


def write_blocks(module: ir.Module, shape: BlockShape, *names: str) -> None:
    """Write functions as `write_response` does, with the address of scratch behind the others.

    A walker's numbers are `BlockShape.walker`; `constants` are the step, the lead and the constant
    inputs.  `sensitivities` writes slopes of signals `(G, T, K, LANES)`, in the direction of all
    these numbers that stands behind them.
    """
    for name in names:
        _emit_response(module, shape, name, RESIDUAL_SUMS.get(name))


def _emit_response(
    module: ir.Module, shape: BlockShape, name: str, tally: ResidualSums | None
) -> None:
    blocks = [VECTORS, NUMBERS, NUMBERS, NUMBERS, VECTORS, VECTORS]
    function, b = begin_function(module, name, 2, blocks)
    n_groups, n_samples, numbers, block, y, u, out, scratch = function.args
    width, k_count = (2 if name == SLOPES else 1), shape.channels
    groups, size = Loop(b, n_groups, [], "groups"), width * sum(shape.walker.values())
    each = tally.weights * k_count if tally is not None else 0
    mine = b.offset(numbers, groups.index, size + each)
    weights = b.read_row(b.gep(mine, [I64(size)]), each)
    constants = Constants(b, shape.layout, block)
    w = _Group(b, Matrices(module, shape.columns), shape, constants, mine, width)
    front, back, z, shown = w.parts(scratch)
    w.begin(front, back, z)
    w.fill(front, back)
    start = tally.initial(k_count) if tally is not None else []
    stretches = Loop(b, _parts(b, n_samples, SAMPLES * STEPS), start, "stretches")
    first = b.mul(stretches.index, I64(SAMPLES * STEPS))
    here = _least(b, b.sub(n_samples, first), I64(SAMPLES * STEPS))
    w.step(first, here, (u, n_samples), (front, back)[DOUBLINGS % 2], z, shown)
    samples = Loop(b, here, stretches.carried, "samples")
    totals, sample = samples.carried, b.add(first, samples.index)
    values = w.channels(shown, samples.index)
    if tally is None:
        row = b.add(b.mul(groups.index, n_samples), sample)
        b.write_row(values, b.offset(out, row, k_count))
    else:
        totals = _add_sample(b, tally, totals, b.offset(y, sample, k_count), values, weights)
    samples.close(totals)
    stretches.close(totals)
    b.write_row(totals, b.offset(out, groups.index, len(totals)))
    groups.close([])
    b.ret_void()


def _add_sample(
    b: Builder,
    tally: ResidualSums,
    totals: list[ir.Value],
    y: ir.Value,
    values: list[ir.Value],
    weights: list[ir.Value],
) -> list[ir.Value]:
    """Return the totals of all channels with one more sample, what was measured of it at `y`."""
    added = []
    for k, value in enumerate(values):
        measured = b.splat(b.load(b.gep(y, [I64(k)])))
        observed = b.fcmp_ordered("ord", measured, measured)
        residual = b.select(observed, b.fsub(measured, value), vector(0.0))
        sample = Sample(residual, observed, weights[k * tally.weights : (k + 1) * tally.weights])
        added += tally.add(b, totals[k * tally.count : (k + 1) * tally.count], sample)
    return added


def _least(b: Builder, value: ir.Value, back: ir.Value) -> ir.Value:
    return b.select(b.icmp_signed("<", value, back), value, back)


def _parts(b: Builder, count: ir.Value, length: int) -> ir.Value:
    """Return how many parts of a length it takes."""
    return b.sdiv(b.add(count, I64(length - 1)), I64(length))


@dataclass(frozen=True, slots=True)
class _Group:
    """The code that makes B of a group of walkers, whose numbers are at `mine`."""

    b: Builder
    matrices: Matrices
    shape: BlockShape
    constants: Constants
    mine: ir.Value
    width: int

    def row(self, block: Block, index: ir.Value) -> Block:
        """Return the address of a row."""
        return tuple(self.b.offset(base, index, self.shape.columns) for base in block)

    def parts(self, scratch: ir.Value) -> list[Block]:
        """Return the addresses of two of B, of z, and of channels."""
        blocks = []
        for rows in (self.shape.rows, self.shape.rows, STEPS + 1, STEPS):
            size = rows * self.shape.columns
            ends = [self.b.gep(scratch, [I64(n * size)]) for n in range(self.width + 1)]
            blocks.append(tuple(ends[:-1]))
            scratch = ends[-1]
        return blocks

    def _numbers(self, name: str) -> Block:
        """Return the addresses of numbers of the group, and of their slopes."""
        b, sizes = self.b, self.shape.walker
        return tuple(addresses(b, self.mine, I64(n), sizes)[name] for n in range(self.width))

    def begin(self, front: Block, back: Block, z: Block) -> None:
        """Store z at the first sample."""
        b, shape = self.b, self.shape
        for base, start in zip(z, self._numbers("start"), strict=True):
            b.clear(base, I64(shape.columns))
            b.copy(start, base, shape.layout.n_states)
        b.write(vector(1.0), z[0], shape.layout.n_states)
        if shape.layout.lead:
            self._exponential(front, back, lead=True)
            self.matrices.multiply(b, back, z, front, (1, shape.head, shape.head))
            self._move(back, z, shape.head)

    def _move(self, source: Block, target: Block, count: int) -> None:
        for old, new in zip(source, target, strict=True):
            self.b.copy(old, new, count)

    def step(
        self,
        first: ir.Value,
        here: ir.Value,
        inputs: tuple[ir.Value, ir.Value],
        whole: Block,
        z: Block,
        shown: Block,
    ) -> None:
        """Store the channels of samples from the `first` on, so many `here`, and z after them.

        `inputs`: their address, and the count of all samples; `whole`: B.
        """
        b, shape, count = self.b, self.shape, _parts(self.b, here, SAMPLES)
        steps = Loop(b, count, [], "steps")
        now = self.row(z, steps.index)
        for j in range(SAMPLES):
            index = b.add(b.add(first, b.mul(steps.index, I64(SAMPLES))), I64(j))
            index = _least(b, index, b.sub(inputs[1], I64(1)))  # what is beyond shows nowhere
            drive = emit_drive(b, shape.layout, inputs[0], index)
            b.write_row(drive, b.gep(now[0], [I64(shape.head + j * shape.drives)]))
        following = self.row(now, I64(1))
        self.matrices.multiply(b, following, now, whole, (1, shape.rows, shape.head))
        for slopes in following[1:]:  # inputs have none
            b.clear(b.gep(slopes, [I64(shape.head)]), I64(shape.columns - shape.head))
        steps.close([])
        channels = tuple(b.gep(base, [I64(shape.head)]) for base in whole)
        size = (count, shape.rows, SAMPLES * shape.channels)
        self.matrices.multiply(b, shown, z, channels, size)
        self._move(self.row(z, count), z, shape.head)

    def channels(self, shown: Block, sample: ir.Value) -> list[ir.Value]:
        """Return the channels at a sample, or their slopes where there are some."""
        b, k_count = self.b, self.shape.channels
        place = b.sub(I64(SAMPLES - 1), b.srem(sample, I64(SAMPLES)))
        row = self.row(shown, b.sdiv(sample, I64(SAMPLES)))[-1]
        return b.read_row(b.offset(row, place, k_count), k_count)

    def _exponential(self, e: Block, spare: Block, *, lead: bool) -> None:
        b, shape = self.b, self.shape
        apart = sum(shape.walker.values()) * (self.width - 1)
        function = emit_transposed_exponential(self.matrices, shape.layout, apart=apart)
        with b.goto_entry_block():
            span = b.alloca(VEC)
        b.write(self.constants.span(lead=lead).value, span, 0)
        b.call(function, [self.mine, self.constants.inputs, span, *e, *spare])

    def fill(self, front: Block, back: Block) -> None:
        """Store B at one of two places, the second where `DOUBLINGS` are odd."""
        b, shape = self.b, self.shape
        self._exponential(front, back, lead=False)
        for base, rows in zip(front, self._numbers("rows"), strict=True):
            every = Loop(b, I64(shape.layout.size), [], "every")
            row = b.gep(b.offset(base, every.index, shape.columns), [I64(shape.head)])
            b.write_row([vector(0.0)] * shape.channels, row)
            every.close([])
            every = Loop(b, I64(shape.head), [], "every")
            row = b.gep(b.offset(base, every.index, shape.columns), [I64(shape.head)])
            weights = b.gep(rows, [every.index])
            b.write_row((b.read(weights, k * shape.head) for k in range(shape.channels)), row)
            every.close([])
        for doubling in range(DOUBLINGS):
            self._double(2**doubling, front, back)
            front, back = back, front

    def _double(self, m: int, source: Block, target: Block) -> None:
        """Store B of 2 m samples from that of m.

        Rows are x, one, inputs of the first half and of the second; columns x, one, channels of the
        second half and of the first.
        """
        b, shape = self.b, self.shape
        rows, shown = shape.head + m * shape.drives, m * shape.channels
        columns = shape.head + shown
        self.matrices.multiply(b, target, source, source, (rows, shape.head, columns))
        each = Loop(b, I64(rows), [], "first")
        for old, new in zip(
            self.row(source, each.index), self.row(target, each.index), strict=True
        ):
            b.copy(b.gep(old, [I64(shape.head)]), b.gep(new, [I64(columns)]), shown)
        each.close([])
        if not shape.drives:
            return
        each = Loop(b, I64(m * shape.drives), [], "second")
        above = self.row(source, b.add(each.index, I64(shape.head)))
        below = self.row(target, b.add(each.index, I64(rows)))
        for old, new in zip(above, below, strict=True):
            b.copy(old, new, columns)
            b.clear(b.gep(new, [I64(columns)]), I64(shown))
        each.close([])
