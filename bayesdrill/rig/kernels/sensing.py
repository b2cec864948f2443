"""Arguments of the kernels of `kernels.dense`, and what a channel sees at a knot."""

from __future__ import annotations

from dataclasses import dataclass

from llvmlite import ir

from bayesdrill.rig.kernels.gathering import gather, scatter, splat_whole
from bayesdrill.rig.kernels.lanes import (
    I64,
    LANES,
    NUMBERS,
    VECTORS,
    fma,
    load,
    splat,
    store,
    vector,
    whole_numbers,
)
from bayesdrill.rig.kernels.layout import Layout
from bayesdrill.rig.kernels.tally import Tally

WHOLE = I64.as_pointer()

# T knots; `high`: rungs of the ladder that lead beyond the cells, of which there are `cells`, 0 where
# no sample wants it.
COUNTS = ("groups", "knots", "nodes", "runs", "cells", "high")
BLOCKS = {
    "own": VECTORS,  # (G, `Own.width`): what walkers have of their own
    "numbers": NUMBERS,  # widths of a cell of steps and of one of shifts, least norm
    "spans": NUMBERS,  # (N,) of nodes
    "inside": NUMBERS,  # (N,) 1 where shares follow
    "chained": WHOLE,  # (N,) 1 where a node is the one before and a cell
    "node": WHOLE,  # of each run of equal steps,
    "length": WHOLE,  # its steps,
    "share": NUMBERS,  # and its share of a cell, -1 without
    "u": NUMBERS,  # (T, S)
    "slopes": NUMBERS,  # (T, S)
    "y": NUMBERS,  # (T + 1, K), the last NaN
    "t": NUMBERS,  # (T + 1,), the last infinity
    "which": WHOLE,  # of the shifted channels
    "table": VECTORS,  # scratch: nodes
    "ladder": VECTORS,  # scratch of shifts: their ladder, ...
    "rows": NUMBERS,  # ... and their cells
    "out": VECTORS,  # (G, K, n) sums or (G, T + 1, K) signals
}


@dataclass(frozen=True, slots=True)
class Shape:
    """What a kernel is specialised for.

    `pattern (K, R)`: entries of the rows that may differ from zero; `tally`: None for signals;
    `shifted (K,)`: channels whose times are; `even`: all steps are equal.
    """

    layout: Layout
    pattern: tuple[tuple[bool, ...], ...]
    tally: Tally | None
    shifted: tuple[bool, ...]
    even: bool

    @property
    def late(self) -> bool:
        return any(self.shifted)

    @property
    def weights(self) -> int:
        """Of each channel."""
        return self.tally.weights if self.tally is not None else 0

    @property
    def out_count(self) -> int:
        """Vectors of a group in `out`, where there are sums."""
        return len(self.pattern) * (self.tally.count if self.tally is not None else 1)

    @property
    def r_count(self) -> int:
        return self.layout.n_states + 1 + self.layout.n_series


@dataclass(frozen=True, slots=True)
class Own:
    """Parts of the block `own`, and how many vectors each has."""

    shape: Shape

    @property
    def parts(self) -> dict[str, int]:
        k, x = len(self.shape.pattern), self.shape.layout.n_states
        always = {
            "parameters": self.shape.layout.n_parameters,
            "x0": x,
            "rows": k * self.shape.r_count,
        }
        late = {"before": x, "shift": k, "share": k, "offset": k, "head": k, "begin": k}
        found = always | (late if self.shape.late else {})
        return found | ({"weight": k * self.shape.weights} if self.shape.weights else {})

    @property
    def width(self) -> int:
        return sum(self.parts.values())

    def of(self, b: ir.IRBuilder, block: ir.Value, group: ir.Value) -> dict[str, ir.Value]:
        found, place = {}, b.gep(block, [b.mul(group, I64(self.width))])
        for name, size in self.parts.items():
            found[name], place = place, b.gep(place, [I64(size)])
        return found


@dataclass(frozen=True, slots=True)
class Arguments:
    b: ir.IRBuilder
    named: dict[str, ir.Value]

    def __getitem__(self, name: str) -> ir.Value:
        return self.named[name]

    def row(self, name: str, index: ir.Value, count: int) -> ir.Value:
        return self.b.gep(self.named[name], [self.b.mul(index, I64(count))])

    def whole(self, name: str, index: ir.Value) -> ir.Value:
        return self.b.load(self.b.gep(self.named[name], [index]))

    real = whole

    def number(self, index: int) -> ir.Value:
        return self.b.load(self.b.gep(self.named["numbers"], [I64(index)]))

    def drive(self, layout: Layout, knot: ir.Value) -> tuple[list[ir.Value], list[ir.Value]]:
        """The sampled inputs and, with a first-order hold, their slopes."""
        b, count = self.b, layout.n_series
        found: list[list[ir.Value]] = []
        for name in ("u", "slopes"):
            mine = self.row(name, knot, count)
            found.append([splat(b, b.load(b.gep(mine, [I64(s)]))) for s in range(count)])
        return found[0], found[1] if layout.first_order else []

    def signals_of(self, group: ir.Value, k_count: int) -> ir.Value:
        """Where in `out` those of a group begin."""
        size = self.b.mul(self.b.add(self.named["knots"], I64(1)), I64(k_count))
        return self.b.gep(self.named["out"], [self.b.mul(group, size)])


def observe(
    a: Arguments,
    shape: Shape,
    own: dict[str, ir.Value],
    group: ir.Value,
    knot: ir.Value,
    z: list[ir.Value],
    totals: list[ir.Value],
) -> None:
    """Channels that are not late, at a knot where the state with one and inputs is `z`."""
    b, k_count = a.b, len(shape.pattern)
    for k in (k for k, shifted in enumerate(shape.shifted) if not shifted):
        flat = b.add(b.mul(knot, I64(k_count)), I64(k))
        total = vector(0.0)
        for r in (r for r, used in enumerate(shape.pattern[k]) if used):
            total = fma(b, load(b, own["rows"], k * shape.r_count + r), z[r], total)
        if shape.tally is not None:
            y = splat(b, a.real("y", flat))
            seen = b.fcmp_ordered("ord", y, y)
            left = b.select(seen, b.fsub(y, total), vector(0.0))
            weights = [load(b, own["weight"], k * shape.weights + n) for n in range(shape.weights)]
            add_to(b, shape.tally, totals[k], left, seen, weights)
        else:
            store(b, total, b.gep(a.signals_of(group, k_count), [flat]), 0)


def add_to(
    b: ir.IRBuilder,
    tally: Tally,
    place: ir.Value,
    left: ir.Value,
    seen: ir.Value,
    weights: list[ir.Value],
) -> None:
    """To the tally of one channel, which stands at a place."""
    kept = [load(b, place, n) for n in range(tally.count)]
    for n, value in enumerate(tally.added(b, kept, left, seen, weights)):
        store(b, value, place, n)


def emit_seen(
    a: Arguments,
    shape: Shape,
    weight: ir.Value | None,
    group: ir.Value,
    k: ir.Value,
    sample: ir.Value,
    due: ir.Value,
    value: ir.Value,
) -> None:
    """What channel k sees at a sample of each lane that is `due`; sample T is none, but has a place.

    `weight`: where those of the channels stand, if they have any.
    """
    b, k_count = a.b, len(shape.pattern)
    if shape.tally is None:
        sample = b.select(due, sample, splat_whole(b, a["knots"]))
    flat = b.add(b.mul(sample, whole_numbers(k_count)), splat_whole(b, k))
    if shape.tally is None:
        scatter(b, value, b.bitcast(a.signals_of(group, k_count), NUMBERS), flat)
        return
    y = gather(b, a["y"], flat)
    seen = b.and_(due, b.fcmp_ordered("ord", y, y))
    left = b.select(seen, b.fsub(y, value), vector(0.0))
    place = b.gep(a.row("out", group, shape.out_count), [b.mul(k, I64(shape.tally.count))])
    first = b.mul(k, I64(shape.weights))
    own = [load(b, b.gep(weight, [first]), n) for n in range(shape.weights)]
    add_to(b, shape.tally, place, left, seen, own)


def row_blocks(shape: Shape) -> int:
    """Blocks of LANES numbers that a row with all inputs and slopes takes."""
    return -(-shape.layout.size // LANES)
