"""Define the structure and the arguments of the kernel of linear rigs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from bayesdrill.rig.kernels.exponential import Layout, Pattern
from bayesdrill.rig.kernels.lanes import NUMBERS, VECTORS, WHOLE
from bayesdrill.rig.kernels.sums import ResidualSums
from bayesdrill.rig.kernels.transitions import MAX_RUNGS, table_entries

# G groups of LANES walkers (sets of parameters); T samples; K channels; S sampled inputs; N knots (the
# samples, and times after the last); q directions of derivatives; `nodes` are entries of the table of
# exponentials. `high` is the number of ladder rungs that span at least the width, or -1 if all spans
# are in the table. `stored` is 1 if signals are stored, else 0.
COUNTS = ("groups", "samples", "knots", "directions", "nodes", "high", "stored")
BLOCKS = {
    "own": VECTORS,  # (G, numbers in `LinearShape.part_sizes`, then `LinearShape.weights` numbers)
    "along": VECTORS,  # (G, q, `LinearShape.with_slopes`): derivatives of the first numbers of `own`
    "numbers": NUMBERS,  # width of the ladder of `transitions`, then constant inputs
    "spans": NUMBERS,  # span of each node
    "chained": WHOLE,  # 1 if a node's span is that of the node before, plus the width
    "node": WHOLE,  # (N,) node of the step from each knot
    "share": NUMBERS,  # (N,) excess of that step over its node's span, in widths; -1 for none
    "t": NUMBERS,  # (N + 1,) times of knots; the last is infinite
    "u": NUMBERS,  # (N, S or 2 S): sampled inputs and, with a first-order hold, their time slopes
    "y": NUMBERS,  # (T, K) measured values, NaN if missing
    "begin": WHOLE,  # (K,) index of the first observed sample of each channel
    "places": WHOLE,  # offset of each part of `SCRATCH`
    "scratch": VECTORS,
    # (G, 1 + q, T, K) signals and derivatives; (G, K, n) sums; (G, K + (1 + q)^2) normal equations
    "out": VECTORS,
}
SCRATCH = ("table", "states", "rungs", "planes", "last residuals", "trace")
SCALES = 3  # number of scales of a channel's residuals, see `simulators.contract.whitening_scales`
ROWS = 64  # number of samples in a chunk
JOINED = 4  # number of samples per step with large matrices; a divisor of ROWS


@dataclass(frozen=True, slots=True, kw_only=True)
class LinearShape:
    """A kernel is specialised for this structure of a record.

    `rows (K, X)` says which states a channel shows; weights of these states, and offsets, may differ
    between walkers. `is_delayed (K,)` says which channels have delays. `uneven` says that steps
    differ, or that there is no step. The kernel computes the sums of a `tally` or, without one, normal
    equations, for which numbers have slopes (derivatives). Kernels of `SQUARES` and of normal
    equations can store signals instead. `sensed` says that starts and rows have slopes, too, as
    sensors are not perfect.
    """

    layout: Layout
    rows: Pattern
    is_delayed: tuple[bool, ...]
    uneven: bool
    tally: ResidualSums | None
    sensed: bool

    @property
    def text(self) -> str:
        """See `compile_kernel`."""
        return (
            f"{self.rows} {self.is_delayed} {self.uneven} {self.tally} {self.sensed} "
            f"{self.layout.text}"
        )

    @property
    def slopes(self) -> bool:
        """Return whether numbers have slopes, which are derivatives in a direction of parameters."""
        return self.tally is None

    @property
    def channels(self) -> int:
        """Return the number K of channels."""
        return len(self.rows)

    @property
    def samples_per_step(self) -> int:
        """Return the number of samples per step; large matrices are faster with several samples."""
        plain = self.layout.large and not (self.uneven or any(self.is_delayed))
        return JOINED if plain else 1

    @property
    def joined_sizes(self) -> tuple[int, int]:
        """Return the shape of the matrix of `samples_per_step` samples, see `Transitions.join_steps`."""
        x = self.layout.n_states
        drives = self.layout.size - x - 1
        return x + self.samples_per_step * self.channels, x + 1 + self.samples_per_step * drives

    @property
    def table_numbers(self) -> int:
        """Return how many numbers the table has for each node."""
        joined = math.prod(self.joined_sizes) if self.samples_per_step > 1 else 0
        return len(table_entries(self.layout)) + joined

    @property
    def part_sizes(self) -> dict[str, int]:
        """Return how many numbers of a walker each part has, in the order of storage."""
        x, k = self.layout.n_states, self.channels
        parts = {"parameters": self.layout.n_parameters, "start": x, "rows": k * (x + 1)}
        return parts | ({"before": x, "delay": k} if any(self.is_delayed) else {})

    @property
    def with_slopes(self) -> int:
        """Return how many numbers, the first of the parts, have slopes in a kernel with slopes."""
        return sum(self.part_sizes.values()) if self.sensed else self.layout.n_parameters

    @property
    def weights(self) -> int:
        """Return how many numbers follow the parts: weights of a tally, or scales of residuals."""
        return self.channels * (SCALES if self.tally is None else self.tally.weights)

    @property
    def single_chunk(self) -> bool:
        """Return whether all samples are one chunk, computed for one direction after the other."""
        return self.tally is not None or any(self.is_delayed) or self.uneven

    @property
    def apart(self) -> bool:
        """Return whether values are computed before slopes, and not again in each direction."""
        return self.slopes and not self.single_chunk and self.samples_per_step == 1

    def scratch(self, counts: Mapping[str, int]) -> tuple[int, ...]:
        """Return the size of each part of `SCRATCH`, in vectors, for a run with these `COUNTS`."""
        width, x, k = 2 if self.slopes else 1, self.layout.n_states, self.channels
        count, directions = 1 + counts["directions"], max(1, counts["directions"])
        copies = 1 if self.single_chunk else directions
        rows = counts["samples"] if self.single_chunk else ROWS
        path = counts["samples"] if counts["stored"] else ROWS
        late = x if self.uneven else sum(self.is_delayed)
        rungs = MAX_RUNGS * len(table_entries(self.layout)) if counts["high"] >= 0 else 0
        trace = counts["knots"] * late if any(self.is_delayed) else path * x * self.apart
        table = copies * counts["nodes"] * self.table_numbers
        planes = (count * rows * k * self.slopes, count * k * self.slopes)
        return table * width, directions * x * width, rungs * width, *planes, trace * width
