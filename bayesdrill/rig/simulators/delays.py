"""Channels that are late, in a record that is compressed: their delays, and its first samples.

See `kernels.delayed_rows`.  A late channel shows the rig before the record began in its first samples:
these are left to the exact simulator.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.record.experiment import frozen
from bayesdrill.rig.simulators.contract import Simulator
from bayesdrill.rig.simulators.rational_basis import CompressionError
from bayesdrill.rig.simulators.sensors import SensorParameters
from bayesdrill.rig.simulators.time_grid import Whole

MAX_STEPS = 4  # that delays may differ by: each is code of its own
ROUNDING = 1e-9  # of a step


@dataclass(frozen=True, slots=True)
class Delays:
    """Delays near whole numbers of steps.

    `shifts (K,)`: steps of the record that no channel is later than; `steps`: less than how many it may
    be earlier.
    """

    shifts: tuple[int, ...]
    steps: int

    @classmethod
    def near(cls, sensors: SensorParameters, points: Array, step: float) -> Delays | None:
        """Return delays for rigs at `points (n, P)`; None where nothing is late."""
        if not sensors.sensing.shifts:
            return None
        late = sensors.channel_delays(points) / step
        shifts = np.ceil(late.max(axis=0) - ROUNDING)
        steps = math.floor(float((shifts - late).max()) + ROUNDING) + 1
        if steps > MAX_STEPS:
            raise CompressionError("delays are known too little")
        return cls(tuple(int(shift) for shift in shifts), steps)

    def numbers(self, sensors: SensorParameters, full: Array, step: float) -> Array:
        """Return of walkers what kernels want `(W, 2 K)`: spans over a step, then whole steps.

        Spans are NaN of channels that are too late or too early.
        """
        ahead = np.array(self.shifts) - sensors.channel_delays(full) / step
        ahead = np.where((ahead < 0.0) & (ahead > -ROUNDING), 0.0, ahead)
        whole = np.floor(ahead)
        inside = (whole >= 0) & (whole < self.steps)
        return np.concatenate([np.where(inside, ahead - whole, np.nan), whole], axis=1)

    def slopes(self, sensors: SensorParameters, along: Array, step: float) -> Array:
        """Return the slopes of these numbers along `along (n, P)`."""
        late = sensors.channel_delays(along) / step
        return np.concatenate([-late, np.zeros_like(late)], axis=1)

    def head(self, simulator: Simulator, at: Whole | None, *, lead: bool) -> RecordHead:
        """Return the samples before functions are seen; `at`: knots of samples, None of all."""
        y = simulator.experiment.y
        knots = np.arange(len(y)) + lead if at is None else np.asarray(at)[lead:]
        length = int(np.searchsorted(knots, max(self.shifts))) + 1
        begin, seam = np.full(y.shape, np.nan), np.full(y.shape, np.nan)
        for k, shift in enumerate(self.shifts):
            seen = np.flatnonzero(~np.isnan(y[:, k]) & (knots >= shift))
            last = int(seen[0]) if len(seen) else len(y) - 1
            begin[: last + 1, k], seam[last, k] = y[: last + 1, k], y[last, k]
            length = max(length, last + 1)
        ahead = self.steps + 2 - min((0, *self.shifts))
        length = int(np.searchsorted(knots, knots[length - 1] + ahead)) + 1
        first = simulator.experiment.first(length)
        return RecordHead(
            *(
                simulator.of(dataclasses.replace(first, y=frozen(part[:length])))
                for part in (begin, seam)
            )
        )


@dataclass(frozen=True, slots=True)
class RecordHead:
    """The first samples: those up to the first of which there are functions, and that one alone.

    It counts in both parts, and once too often.
    """

    begin: Simulator
    seam: Simulator

    def sums(self, full: Array, n: int) -> Array:
        """Return what sums `(W, K, n)` of the rest are without; n as in `Simulator.normal`."""
        seam = self.seam.squares(full)
        if n == 1:
            return (self.begin.squares(full) - seam)[..., None]
        sums = self.begin.neighbours(full)
        return np.asarray(sums - seam[..., None] * np.array([1.0, 0.0, 2.0]))

    def normal(self, full: Array, along: Array, weights: Array) -> tuple[Array, Array, Array]:
        """Return what normal equations of the rest are without; see `Simulator.normal`."""
        twice = weights[..., :1] + 2.0 * weights[..., 2:]
        first, second = (
            simulator.normal(full, along, part)
            for simulator, part in (
                (self.begin, weights), (self.seam, twice if weights.shape[2] > 1 else weights)
            )
        )  # fmt: skip
        squares, slopes, products = (a - b for a, b in zip(first, second, strict=True))
        return squares, slopes, products
