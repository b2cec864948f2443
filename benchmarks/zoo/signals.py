"""What drives the rigs of the zoo: inputs as they are measured, each from its own numbers alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from benchmarks.zoo.plant import Plant

Array = NDArray[np.float64]


class Signal(Protocol):
    def series(self, t: Array, plant: Plant) -> Array:
        """Its values at the times `t (T,)`; `plant` is what a loop closes around."""
        ...


@dataclass(frozen=True, slots=True)
class Square:
    """`offset` plus and minus `amplitude`, half a `period` [s] each."""

    amplitude: float
    period: float
    offset: float = 0.0

    def series(self, t: Array, plant: Plant) -> Array:
        up = np.floor(2.0 * t / self.period + 1e-9) % 2 == 0
        return self.offset + np.where(up, self.amplitude, -self.amplitude)


@dataclass(frozen=True, slots=True)
class Chirp:
    """A sine whose frequency [Hz] rises evenly from `low` to `high`."""

    amplitude: float
    low: float
    high: float
    offset: float = 0.0

    def series(self, t: Array, plant: Plant) -> Array:
        s = t - t[0]
        turns = self.low * s + 0.5 * (self.high - self.low) * s**2 / s[-1]
        return self.offset + self.amplitude * np.sin(2.0 * np.pi * turns)


@dataclass(frozen=True, slots=True)
class RandomSteps:
    """`offset` plus or minus `amplitude`, drawn anew every `hold` [s]."""

    amplitude: float
    hold: float
    seed: int
    offset: float = 0.0

    def series(self, t: Array, plant: Plant) -> Array:
        place = np.floor((t - t[0]) / self.hold + 1e-9).astype(np.intp)
        signs = np.random.default_rng(self.seed).choice([-1.0, 1.0], place[-1] + 1)
        return np.asarray(self.offset + self.amplitude * signs[place])


@dataclass(frozen=True, slots=True)
class Levels:
    """Each of `values` for an equal share of the record."""

    values: tuple[float, ...]

    def series(self, t: Array, plant: Plant) -> Array:
        share = np.arange(len(t)) * len(self.values) // len(t)
        return np.array(self.values)[share]


@dataclass(frozen=True, slots=True, kw_only=True)
class Loop:
    """The voltage of a proportional and differential controller of `theta_2`, from rest.

    The angle is to go to and fro by `amplitude` [rad] every `period` [s]; the controller sees it
    with noise of `sensor` [rad], and its voltage ends at `limit` and has steps of `quantum`.
    """

    amplitude: float
    period: float
    gain: float  # V/rad
    damping: float  # V s/rad
    limit: float
    sensor: float
    seed: int
    quantum: float = 5e-3

    def series(self, t: Array, plant: Plant) -> Array:
        wanted = Square(self.amplitude, self.period).series(t, plant)
        seen = self.sensor * np.random.default_rng(self.seed).standard_normal(len(t))
        x, v, held = plant.rest(), np.zeros(len(t)), 0.0
        angle, speed = plant.states.index("theta_2"), plant.states.index("w_2")
        for k in range(len(t)):
            force = self.gain * (wanted[k] - x[angle] - seen[k]) - self.damping * x[speed]
            asked = self.quantum * round(min(max(force, -self.limit), self.limit) / self.quantum)
            # Where the voltage goes straight to its next value, that one is decided now.
            begin, end = (held, asked) if plant.first_order else (asked, asked)
            x, v[k], held = plant.step(x, begin, end), begin, asked
        return v
