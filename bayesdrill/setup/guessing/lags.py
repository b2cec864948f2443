"""How late one end of the shaft is told, by the law of rotor 1: the twist is what accelerates it.

Damping in the shaft, c_s, shifts that by c_s/k_s: what is found is a hint and no value.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d

from bayesdrill.setup.guessing import relations
from bayesdrill.setup.guessing.columns import Array
from bayesdrill.setup.guessing.drafts import TURNS, Sensor
from bayesdrill.setup.guessing.names import GEARBOX, MOTOR, ROTOR, TWIST
from bayesdrill.setup.guessing.roles import Channel, Roles

WIDTHS = (2, 4, 8, 16)  # samples, of filters one of which suits the rig's swing: sd of a Gaussian
EDGE = 4  # widths of a filter that see an end of the record
FURTHEST = 8  # samples late, at most
FINER = 2  # shifts a sample
MOST = 10_000  # samples looked at
TOLD = 0.9  # of the variance of the twist, that its law has to explain
BETTER = 1.5  # times what is left without a lag, over what is left with it


@dataclass(frozen=True, slots=True)
class Lag:
    """`of` a channel, in samples; `left`: share of the twist that is left, `before` without it."""

    of: str
    samples: float
    left: float
    before: float

    @property
    def clear(self) -> float:
        return self.before / self.left


def lag(found: Roles, dt: float) -> Lag | None:
    """Of one channel against another; None where nothing hints at any."""
    pairs = [_clearest(*pair, found, dt) for pair in _pairs(found.channels)]
    hints = [one for one in pairs if one is not None]
    return max(hints, key=lambda one: one.clear, default=None)


def _pairs(channels: Sequence[Channel]) -> list[tuple[Channel, Channel]]:
    """Twist or rotor 1 first, each with an independent one."""
    turning = [one for one in channels if one.sensor.kind in TURNS and not one.derived]
    by = {
        place: [one for one in turning if one.sensor.place == place]
        for place in (TWIST, ROTOR, GEARBOX, MOTOR)
    }
    twists = [one for one in by[TWIST] if one.sensor.kind == "angle"]
    if twists:
        return [(twists[0], one) for one in (*by[GEARBOX], *by[MOTOR], *by[ROTOR])]
    return [(one, other) for one in by[ROTOR] for other in (*by[GEARBOX], *by[MOTOR])]


def _clearest(first: Channel, second: Channel, found: Roles, dt: float) -> Lag | None:
    one, other = _angle(first, found.gear, dt), _angle(second, found.gear, dt)
    best: tuple[float, float, float] | None = None
    for width in WIDTHS:
        if len(one) < 20 * EDGE * width:
            break
        law = _law(one, other, width, first, second)
        shifts = [k / FINER for k in range(-FURTHEST * FINER, FURTHEST * FINER + 1)]
        left = {shift: law.left(shift) for shift in shifts}
        shift = min(left, key=lambda one: left[one])
        if best is None or left[shift] < best[1]:
            best = shift, left[shift], left[0.0]
    if best is None:
        return None
    samples, after, before = best
    told = 1 - after > TOLD and before > BETTER * after and abs(samples) < FURTHEST
    late = first if samples > 0 else second
    return Lag(late.name, abs(samples), after, before) if told else None


def _angle(one: Channel, gear: float, dt: float) -> Array:
    sensor: Sensor = one.sensor
    return sensor.angle(dt)[:MOST] / (gear if sensor.place == MOTOR else 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class _Law:
    """Two angles with their derivatives, smoothed, (3, n); `is_twist`: the first."""

    one: Array
    other: Array
    inner: slice
    is_twist: bool
    of_rotor: bool

    def left(self, shift: float) -> float:
        """Share of the twist's variance that is left, with `one` earlier by `shift` samples."""
        other, k = self.other[:, self.inner], np.arange(self.one.shape[1], dtype=np.float64)
        one = np.stack([np.interp(k[self.inner] + shift, k, x) for x in self.one])
        if self.is_twist:
            twist, (_, speed, acceleration) = one[0], other if self.of_rotor else other + one
        else:
            twist, (_, speed, acceleration) = one[0] - other[0], one
        causes = [acceleration, speed, np.sign(speed), k[self.inner]]
        factors, share = relations.explained(twist, *causes)
        return 1 - share if factors[0] < 0 else 1.0  # else it is no spring


def _law(one: Array, other: Array, width: int, first: Channel, second: Channel) -> _Law:
    """One filter for all derivatives: the law holds of what it leaves."""
    filtered = [
        np.stack([gaussian_filter1d(x, width, order=d, truncate=EDGE) for d in (0, 1, 2)])
        for x in (one, other)
    ]
    margin = EDGE * width + FURTHEST
    inner = slice(margin, len(one) - margin)
    of_rotor = second.sensor.place == ROTOR
    return _Law(filtered[0], filtered[1], inner, first.sensor.place == TWIST, of_rotor)


def wide(samples: float, dt: float) -> float:
    """Largest lag [s] that a prior around such a hint allows, to two digits."""
    most = max(5.0, 2 * samples + 3) * dt
    digits = 1 - math.floor(math.log10(most))
    return math.ceil(most * 10.0**digits) / 10.0**digits
