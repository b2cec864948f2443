"""Channels that are late, in a record that is compressed: their delays, and its first samples.

See `kernels.compressed_sums`.  A late channel shows the rig before the record began in its first
samples: these are left to the exact simulator.
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

    `step` [s] of the record; `shifts (K,)`: steps that no channel is later than; `steps`: less than how
    many it may be earlier, zero where nothing is late.
    """

    step: float
    shifts: tuple[int, ...]
    steps: int

    @classmethod
    def near(cls, sensors: SensorParameters, points: Array, step: float) -> Delays:
        """Return delays for rigs at `points (n, P)`."""
        late = sensors.channel_delays(points) / step
        shifts = np.ceil(late.max(axis=0) - ROUNDING)
        steps = math.floor(float((shifts - late).max()) + ROUNDING) + 1
        if steps > MAX_STEPS:
            raise CompressionError("delays are known too little")
        whole = tuple(int(shift) for shift in shifts)
        return cls(step, whole, steps if sensors.sensing.shifts else 0)

    def numbers(self, sensors: SensorParameters, full: Array) -> Array:
        """Return what walkers show of each step from there `(W, K steps)`.

        It is NaN of channels that are too late or too early.
        """
        ahead = self._ahead(sensors, full)
        inside = (ahead >= 0) & (ahead < self.steps)
        shares = np.clip(ahead - np.arange(self.steps), 0.0, 1.0)
        return np.where(inside, shares, np.nan).reshape(len(full), -1)

    def slopes(self, sensors: SensorParameters, full: Array, along: Array) -> Array:
        """Return the slopes of these numbers at `full (n, P)` along `along (n, P)`."""
        late = sensors.channel_delays(along)[..., None] / self.step
        ends = np.floor(self._ahead(sensors, full)) == np.arange(self.steps)
        return np.where(ends, -late, 0.0).reshape(len(full), -1)

    def _ahead(self, sensors: SensorParameters, full: Array) -> Array:
        """Return by how many steps channels are earlier than shifts `(W, K, 1)`."""
        ahead = np.array(self.shifts) - sensors.channel_delays(full) / self.step
        return np.where((ahead < 0.0) & (ahead > -ROUNDING), 0.0, ahead)[..., None]

    def head(self, simulator: Simulator, at: Whole | None) -> RecordHead:
        """Return the samples before functions are seen; `at`: knots of samples, None of all."""
        y = simulator.experiment.y
        knots = np.arange(len(y)) if at is None else at[simulator.sensors.lead :]
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
        parts = (dataclasses.replace(first, y=frozen(part[:length])) for part in (begin, seam))
        return RecordHead(*map(simulator.of, parts))


NOT_LATE = Delays(1.0, (), 0)


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
        begin = self.begin.normal(full, along, weights)
        seam = self.seam.normal(full, along, twice if weights.shape[2] > 1 else weights)
        squares, slopes, products = map(np.subtract, begin, seam)
        return squares, slopes, products
