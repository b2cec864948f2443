"""How a record begins: at rest, turning steadily or moving, and which part of it is used."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bayesdrill.setup.guessing.drafts import TURNS
from bayesdrill.setup.guessing.names import GEARBOX, MOTOR, ROTOR, TWIST
from bayesdrill.setup.guessing.parts import Part
from bayesdrill.setup.guessing.roles import Channel, Roles

FIRST = 9  # samples that tell the first value
FEWEST = 100  # samples after 0 s, for which those before it are given up
CLEAR = 6.0  # of the noise, that is no noise
SOON = 0.4  # of the first samples' mean speed, above which it was there from the first on
STEADY = 40  # samples that stay as they are, and the rig turns steadily
CALM = 1.3  # times the noise, that a steady channel differs by
FAR = 2.0  # times where an angle begins: sd of the prior of where it counts from


@dataclass(frozen=True, slots=True)
class Start:
    """`state`: of `initial:`, empty at rest; `time` is None for the default, `window` for all, s.

    `zeros`: of angles that begin at rest elsewhere than at zero, sd of where they count from, in their
    unit.  `switched`: samples before and after which a constant voltage is there.
    """

    state: str
    angle: str
    time: float | None
    window: tuple[float, float] | None
    zeros: Mapping[str, float]
    switched: tuple[float, float]
    window_doubt: str
    doubts: tuple[str, ...]

    @property
    def moving(self) -> bool:
        return self.state != ""


def start(found: Roles, part: Part, *, measured: bool, known: float | None = None) -> Start:
    """Of the rows that are used; `measured`: the voltage, or the load, from the time `known` on, s."""
    t, dt = part.t, part.dt
    window = (float(t[0]), float(t[-1])) if part.cut else None
    said = "the longest part in which times increase and none is infinite" if part.cut else ""
    if measured and known is not None and known > t[0]:
        t = t[t >= known]
        window, said = (float(t[0]), float(t[-1])), "from where the inputs are known"
    moving = any(_moves(one) for one in _telling(found))
    time, switched = None, (1.0, 1.0)
    late = math.nan if measured or moving else _onset(found)
    if not math.isnan(late):
        begin = max(float(t[0]), late - 2 * dt)
        window, switched = (begin, float(t[-1])), (1.0, 3.0)
        said = (
            f"nothing moves before {begin:.6g} s, and a constant voltage is there from the start on: so "
            "it starts there"
        )
    elif window is None and not measured and t[0] < -1e-9 * dt and t[-1] > FEWEST * dt:
        window = (0.0, float(t[-1]))
        said = "times before 0 s: a constant voltage is taken to be there from 0 s on"
    elif window is None and not measured and not -1e-9 * dt <= t[0] <= 2 * dt:
        time = float(t[0])
    doubts = [] if time is None else [f"the record begins at {t[0]:.6g} s, and so does the start"]
    if not moving:
        return Start("", "", time, window, _zeros(found), switched, said, tuple(doubts))
    if not measured and time is None and window is None and t[0] != 0:
        time = float(t[0])
    state, why = _how(found, measured=measured)
    return Start(state, _angle(found, state), time, window, {}, switched, said, (*doubts, why))


def _how(found: Roles, *, measured: bool) -> tuple[str, str]:
    v = found.v
    even = measured and all(_steady(one) for one in found.channels if not one.derived)
    if even and v is not None and np.ptp(v.values[:STEADY]) <= 0.01 * np.ptp(v.values):
        return "steady", "the rig turns when the record begins, and all stays as it is for a while"
    return "free", "the rig moves when the record begins: the start is unknown"


def _angle(found: Roles, state: str) -> str:
    """An angle that has to be named: free where one is measured and the steady state gives the others,
    held where none is measured and only the twist matters.
    """
    measured = [one.sensor.place for one in found.channels if one.sensor.kind == "angle"]
    if state == "steady":
        if {GEARBOX, MOTOR} & {*measured}:
            return "theta_2: free"
        return "theta_1: free" if ROTOR in measured else ""
    return "" if {GEARBOX, MOTOR, ROTOR} & {*measured} else "theta_2: 0"


def _telling(found: Roles) -> list[Channel]:
    """Speeds if there are any: angles tell of a quick start less than of a motion."""
    own = [one for one in found.channels if one.sensor.kind in TURNS and not one.derived]
    speeds = [one for one in own if one.sensor.kind == "speed"]
    turning = [one for one in own if one.sensor.place != TWIST]
    return speeds or turning or own


def _moves(one: Channel) -> bool:
    """A speed that is there from the first sample on, or an angle that grows from it on."""
    if one.sensor.kind == "speed":
        return _first(one)[1]
    if one.sensor.kind != "angle" or len(one.sensor.raw.x) < FIRST:
        return False
    t, x = one.sensor.raw.t[:FIRST], one.sensor.raw.x[:FIRST]
    k = (t - t[0]) / (t[-1] - t[0])
    design = np.stack([np.ones(FIRST), k, k**2], axis=-1)
    slope = float(np.linalg.lstsq(design, x, rcond=None)[0][1])
    sd = one.noise * math.sqrt(float(np.linalg.inv(design.T @ design)[1, 1]))
    mean = float(np.polyfit(k, x, 1)[0])
    return abs(slope) > CLEAR * sd and slope * mean > SOON * mean**2


def _steady(one: Channel) -> bool:
    """Whether a speed, a twist or a current stays, and an angle grows evenly."""
    t, x = one.sensor.raw.t[:STEADY], one.sensor.raw.x[:STEADY]
    grows = one.sensor.kind == "angle" and one.sensor.place != TWIST
    rest = x - np.polyval(np.polyfit(t - t[0], x, 1 if grows else 0), t - t[0])
    return float(np.std(rest)) <= CALM * one.noise


def _zeros(found: Roles) -> dict[str, float]:
    """Of a rig at rest, whose own angles may be counted from there."""
    firsts = {one.name: _first(one) for one in found.channels if one.sensor.kind == "angle"}
    return {
        name: float(f"{FAR * abs(value):.2g}") for name, (value, clear) in firsts.items() if clear
    }


def _first(one: Channel) -> tuple[float, bool]:
    """In the column's unit, and whether it is clearly not zero."""
    t, values = one.sensor.raw.t[:FIRST], one.sensor.raw.x[:FIRST]
    fitted = float(values[0])
    if len(values) == FIRST:
        fitted = float(np.polyval(np.polyfit((t - t[0]) / (t[-1] - t[0]), values, 2), 0))
    least = CLEAR * one.noise + 0.002 * float(np.abs(one.sensor.raw.x).max())
    return float(f"{fitted:.4g}"), bool(abs(values[0]) > least and abs(fitted) > least)


def _onset(found: Roles) -> float:
    """When anything first moves, s; NaN where that is within the first few samples."""
    begins: list[tuple[float, int]] = []
    for one in found.channels:
        t, x = one.sensor.raw.t, one.sensor.raw.x
        away = np.abs(x - np.median(x[:FIRST])) > 8 * one.noise
        if away.any():
            begins.append((float(t[np.argmax(away)]), int(np.argmax(away))))
    first = min(begins, default=(math.nan, 0))
    return first[0] if first[1] > 3 * FIRST else math.nan
