"""The response of rigs of many states: steps of several samples at once, by one product of each.

With z = (x, 1, u(0), ..., u(m - 1)) at the first of m samples, z B is what follows: x and one after
them, and the channels at m - 1, ..., 0.  B of one sample is the transpose of the exponential, with
the channels' rows beside it; that of twice as many samples is a product of B with itself.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from llvmlite import ir

from bayesdrill.rig.kernels.exponential import Constants, Layout, addresses, emit_drive
from bayesdrill.rig.kernels.lanes import (
    NUMBERS,
    VECTORS,
    Builder,
    Integer,
    Loop,
    Module,
    kernel,
    vector,
)
from bayesdrill.rig.kernels.loops import (
    Block,
    in_panels,
    multiply_panels,
    store_transposed_exponential,
)
from bayesdrill.rig.kernels.sums import RESIDUAL_SUMS, Sample

# G groups of LANES walkers, T samples.
COUNTS = ("groups", "samples")
BLOCKS = {
    "parameters": VECTORS,  # (G, P + K m): parameters, then weights `(K, m)` of sums that have some
    "constants": NUMBERS,  # see `Constants`
    "y": NUMBERS,  # (T, K)
    "u": NUMBERS,  # (T + 1, n_series)
    "scratch": VECTORS,
    "out": VECTORS,  # (G, K, n) sums, or (G, T, K) signals
}
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
        """See `compile_kernel`."""
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


def write_blocks(module: Module, shape: BlockShape, *names: str) -> None:
    """Write `signals`, and sums of `RESIDUAL_SUMS` by their names.

    A walker's numbers are `BlockShape.walker`; `constants` are the step, the lead and the constant
    inputs.  `sensitivities` writes slopes of signals `(G, T, K, LANES)`, in the direction of all
    these numbers that stands behind them.
    """
    for name in names:
        _emit_response(module, shape, name)


def _emit_response(module: Module, shape: BlockShape, name: str) -> None:
    tally, k_count = RESIDUAL_SUMS.get(name), shape.channels
    width, each = (2 if name == SLOPES else 1), tally.weights if tally is not None else 0
    size = width * sum(shape.walker.values())
    with kernel(module, name, COUNTS, BLOCKS) as (a, b):
        # Panels are wider than what they hold, and what lay in memory may be numbers so small that
        # each product with them takes a hundred times as long.
        b.clear(a["scratch"], shape.scratch(width))
        with b.loop(a["groups"], "groups") as group:
            mine = b.offset(a["parameters"], group, size + each * k_count)
            weights = b.read_row(b.offset(mine, size), each * k_count)
            w = _Group(b, shape, a, mine, width)
            w.begin()
            w.fill()
            start = tally.initial(k_count) if tally is not None else []
            stretches = Loop(b, _parts(b, a["samples"], SAMPLES * STEPS), start, "stretches")
            first = b.mul(stretches.index, SAMPLES * STEPS)
            here = b.least(b.sub(a["samples"], first), SAMPLES * STEPS)
            w.step(first, here)
            samples = Loop(b, here, stretches.carried, "samples")
            totals, sample = samples.carried, b.add(first, samples.index)
            values = w.channels(samples.index)
            if tally is None:
                row = b.add(b.mul(group, a["samples"]), sample)
                b.write_row(values, b.offset(a["out"], row, k_count))
            else:
                shown, y = list[Sample](), b.offset(a["y"], sample, k_count)
                for k, value in enumerate(values):
                    measured = b.shared(y, k)
                    part = weights[k * each : (k + 1) * each]
                    shown.append(Sample.from_measured(b, b.fsub(measured, value), measured, part))
                totals = tally.add_all(b, totals, shown)
            samples.close(totals)
            stretches.close(totals)
            b.write_row(totals, b.offset(a["out"], group, len(totals)))


def _parts(b: Builder, count: ir.Value, length: int) -> ir.Value:
    """Return how many parts of a length it takes."""
    return b.sdiv(b.add(count, length - 1), length)


class _Group:
    """The code that makes B of a group of walkers, whose numbers are at `mine`."""

    def __init__(
        self, b: Builder, shape: BlockShape, a: dict[str, ir.Value], mine: ir.Value, width: int
    ) -> None:
        self._b, self._shape, self._a, self._mine, self._width = b, shape, a, mine, width
        self._constants, blocks = Constants(b, shape.layout, a["constants"]), list[Block]()
        scratch = a["scratch"]
        for rows in (shape.rows, shape.rows, STEPS + 1, STEPS):
            *ends, scratch = (b.offset(scratch, n * rows * shape.columns) for n in range(width + 1))
            blocks.append(tuple(ends))
        self._front, self._back, self._z, self._shown = blocks  # two of B, z, and channels

    def _row(self, block: Block, index: Integer) -> Block:
        """Return the address of a row."""
        return tuple(self._b.offset(base, index, self._shape.columns) for base in block)

    def _numbers(self, name: str) -> Block:
        """Return the addresses of numbers of the group, and of their slopes."""
        b, sizes = self._b, self._shape.walker
        return tuple(addresses(b, self._mine, n, sizes)[name] for n in range(self._width))

    def begin(self) -> None:
        """Store z at the first sample."""
        b, shape, z = self._b, self._shape, self._z
        for base, start in zip(z, self._numbers("start"), strict=True):
            b.clear(base, shape.columns)
            b.copy(start, base, shape.layout.n_states)
        b.write(vector(1.0), z[0], shape.layout.n_states)
        if shape.layout.lead:
            until = emit_drive(b, shape.layout, self._a["u"], None)
            b.write_row(until, b.offset(z[0], shape.head))
            self._exponential(lead=True)
            self._multiply(self._back, z, self._front, (1, shape.layout.size, shape.head))
            self._move(self._back, z, shape.head)

    def _multiply(
        self, out: Block, left: Block, right: Block, size: tuple[Integer, int, int]
    ) -> None:
        multiply_panels(self._b, out, left, right, size, self._shape.columns)

    def _move(self, source: Block, target: Block, count: int) -> None:
        for old, new in zip(source, target, strict=True):
            self._b.copy(old, new, count)

    def step(self, first: ir.Value, here: ir.Value) -> None:
        """Store the channels of samples from the `first` on, so many `here`, and z after them."""
        b, shape, z, count = self._b, self._shape, self._z, _parts(self._b, here, SAMPLES)
        whole = (self._front, self._back)[DOUBLINGS % 2]
        with b.loop(count, "steps") as step:
            now = self._row(z, step)
            for j in range(SAMPLES):
                index = b.add(b.add(first, b.mul(step, SAMPLES)), j)
                index = b.least(index, b.sub(self._a["samples"], 1))  # what is beyond shows nowhere
                drive = emit_drive(b, shape.layout, self._a["u"], index)
                b.write_row(drive, b.offset(now[0], shape.head + j * shape.drives))
            following = self._row(now, 1)
            self._multiply(following, now, whole, (1, shape.rows, shape.head))
            for slopes in following[1:]:  # inputs have none
                b.clear(b.offset(slopes, shape.head), shape.columns - shape.head)
        channels = tuple(b.offset(base, shape.head) for base in whole)
        self._multiply(self._shown, z, channels, (count, shape.rows, SAMPLES * shape.channels))
        self._move(self._row(z, count), z, shape.head)

    def channels(self, sample: ir.Value) -> list[ir.Value]:
        """Return the channels at a sample, or their slopes where there are some."""
        b, k_count = self._b, self._shape.channels
        place = b.sub(SAMPLES - 1, b.srem(sample, SAMPLES))
        row = self._row(self._shown, b.sdiv(sample, SAMPLES))[-1]
        return b.read_row(b.offset(row, place, k_count), k_count)

    def _exponential(self, *, lead: bool) -> None:
        """Store it at the front."""
        shape, span = self._shape, self._constants.span(lead=lead)
        apart = sum(shape.walker.values()) * (self._width - 1)
        store_transposed_exponential(
            self._b, self._mine, self._constants.inputs, span, shape.layout, shape.columns, apart,
            *self._front, *self._back,
        )  # fmt: skip

    def fill(self) -> None:
        """Store B at one of two places, the second where `DOUBLINGS` are odd."""
        b, shape, front, back = self._b, self._shape, self._front, self._back
        self._exponential(lead=False)
        for base, rows in zip(front, self._numbers("rows"), strict=True):
            with b.loop(shape.layout.size, "every") as every:
                row = b.offset(b.offset(base, every, shape.columns), shape.head)
                b.write_row([vector(0.0)] * shape.channels, row)
            with b.loop(shape.head, "every") as every:
                row = b.offset(b.offset(base, every, shape.columns), shape.head)
                weights = b.offset(rows, every)
                b.write_row((b.read(weights, k * shape.head) for k in range(shape.channels)), row)
        for doubling in range(DOUBLINGS):
            self._double(2**doubling, front, back)
            front, back = back, front

    def _double(self, m: int, source: Block, target: Block) -> None:
        """Store B of 2 m samples from that of m.

        Rows are x, one, inputs of the first half and of the second; columns x, one, channels of the
        second half and of the first.
        """
        b, shape = self._b, self._shape
        rows, shown = shape.head + m * shape.drives, m * shape.channels
        columns = shape.head + shown
        self._multiply(target, source, source, (rows, shape.head, columns))
        with b.loop(rows, "first") as each:
            for old, new in zip(self._row(source, each), self._row(target, each), strict=True):
                b.copy(b.offset(old, shape.head), b.offset(new, columns), shown)
        if not shape.drives:
            return
        with b.loop(m * shape.drives, "second") as each:
            above = self._row(source, b.add(each, shape.head))
            below = self._row(target, b.add(each, rows))
            for old, new in zip(above, below, strict=True):
                b.copy(old, new, columns)
                b.clear(b.offset(new, columns), shown)
