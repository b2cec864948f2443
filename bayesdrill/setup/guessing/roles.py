"""Which channel or input of the rig each sensor is, and the gear between motor and shaft."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayesdrill.record import angles
from bayesdrill.setup.guessing import relations
from bayesdrill.setup.guessing.drafts import TURNS, Sensor
from bayesdrill.setup.guessing.names import GEARBOX, MOTOR, ROTOR, TWIST
from bayesdrill.setup.guessing.sensors import SLOWEST

USUAL_GEAR = 8.0
WIDE = 10.0  # the prior of a noise: so many times below and above what differs between samples
_STATE = {("angle", ROTOR): "theta_1", ("angle", GEARBOX): "theta_2"} | {
    ("speed", ROTOR): "w_1",
    ("speed", GEARBOX): "w_2",
}


@dataclass(frozen=True, slots=True, eq=False)
class Channel:
    """A sensor under the name that the config gives it; `measures` is empty for a state itself.

    `derived`: the channel of which it is differences.
    """

    name: str
    measures: str
    sensor: Sensor
    derived: str = ""

    @property
    def noise(self) -> float:
        """In the column's unit."""
        return self.sensor.noise


@dataclass(frozen=True, slots=True, eq=False)
class Roles:
    """`gear`: turns of the motor for one of the shaft; `doubts` of the gear."""

    channels: tuple[Channel, ...]
    v: Sensor | None
    t_1: Sensor | None
    gear: float
    gear_why: str
    gear_doubt: str
    left_out: dict[str, str]


def roles(those: Sequence[Sensor], dt: float, gear: float | None = None) -> Roles:
    """`gear`: where it is known."""
    left_out: dict[str, str] = {}
    turning = _placed([one for one in those if one.kind in TURNS])
    found, sources = _ratio(turning, dt)
    turning = [_moved(one, turning, dt) for one in turning]
    why = doubt = ""
    if gear is not None:
        value, why = gear, "as it was given"
        if not math.isnan(found) and abs(abs(found) / gear - 1) > 0.05:
            doubt = f"{sources} turn as {abs(found):.4g}:1 by their units; check them, or the gear"
    elif math.isnan(found):
        value = USUAL_GEAR
        doubt = "no two columns tell the gear; this is the paper's 8:1, write your own"
    else:
        value = abs(found)
        doubt = f"the gear is not said; {sources} turn as {value:.5g}:1"
    channels: dict[str, Channel] = {}
    for one in [*turning, *(one for one in those if one.kind == "current")]:
        name, measures = _name(one, -value if found < 0 else value)
        kept = channels.get(name)
        if kept is not None:
            left_out[one.name] = f"{name} is taken from {kept.sensor.name} already"
        elif name:
            channels[name] = Channel(name, measures, one)
        else:
            left_out[one.name] = "nothing says at which end of the shaft it is"
    _tell_differenced(channels, dt)
    v = _voltage([one for one in those if one.kind == "voltage"], left_out)
    t_1 = _load([one for one in those if one.kind == "torque"], left_out)
    return Roles(tuple(channels.values()), v, t_1, value, why, doubt, left_out)


def _placed(turning: Sequence[Sensor]) -> list[Sensor]:
    """One without a place is where no other is; with a twist, at the gearbox."""
    placed = {one.place for one in turning if one.place}
    if ROTOR in placed and not placed & {GEARBOX, MOTOR}:
        free, because = GEARBOX, "the other end has a column of its own"
    elif placed & {GEARBOX, MOTOR} and not placed & {ROTOR, TWIST}:
        free, because = ROTOR, "the other end has a column of its own"
    else:
        because = (
            "the twist is counted from there" if TWIST in placed else "most encoders are there"
        )
        free = GEARBOX
    if ROTOR in placed and placed & {GEARBOX, MOTOR}:
        return list(turning)
    seen: set[str] = set()
    out = []
    for one in turning:
        if not one.place and one.kind not in seen:
            doubt = f"which end of the shaft is not said; taken as {free}, as {because}"
            seen.add(one.kind)
            one = one.but(place=free, doubt=doubt)
        out.append(one)
    return out


def _ratio(turning: Sequence[Sensor], dt: float) -> tuple[float, str]:
    """Turns of the motor for one of the shaft, NaN where it cannot be told, and of which columns."""
    ends = [one for one in turning if one.place in (GEARBOX, ROTOR)]
    for motor in (one for one in turning if one.place == MOTOR):
        for end in sorted(ends, key=lambda one: one.kind != motor.kind):
            value = _times(motor, end, dt)
            if abs(value) > 1.2:
                near = round(value)
                value = float(near) if abs(value / near - 1) < 0.02 else float(f"{value:.4g}")
                return value, f"{motor.name} and {end.name}"
    return math.nan, ""


def _times(motor: Sensor, end: Sensor, dt: float) -> float:
    """How many times as far the one turns as the other."""
    if end.place == ROTOR:
        return relations.ratio_through_shaft(motor.angle(dt), end.angle(dt), dt)
    return relations.ratio(motor.angle(dt), end.angle(dt))


def _moved(one: Sensor, turning: Sequence[Sensor], dt: float) -> Sensor:
    """What is called the motor's, but turns as the shaft does, is behind the gear."""
    ends = [other for other in turning if other.place in (GEARBOX, ROTOR)]
    if one.place != MOTOR or not ends:
        return one
    value = _times(one, ends[0], dt)
    if abs(value) > 1.2 or math.isnan(value):
        return one
    if abs(value) < SLOWEST:
        doubt = f"it turns {value:.3g} times as far as {ends[0].name}, which no gear makes"
        return one.but(doubt=f"{doubt}: one of the units is wrong")
    doubt = f"named after the motor, but it turns {value:.3g} times as far as {ends[0].name}"
    return one.but(place=GEARBOX, doubt=f"{doubt}: taken as behind the gear")


def _name(one: Sensor, gear: float) -> tuple[str, str]:
    """Name and `measures` of its channel."""
    if one.kind == "current":
        return "i", ""
    if one.place == TWIST:
        return (
            ("twist", "theta_1 - theta_2") if one.kind == "angle" else ("twist_rate", "w_1 - w_2")
        )
    if one.place == MOTOR:
        state = _STATE[one.kind, GEARBOX]
        return "motor" if one.kind == "speed" else "motor_angle", f"{gear:.6g} * {state}"
    return _STATE.get((one.kind, one.place), ""), ""


def _tell_differenced(channels: dict[str, Channel], dt: float) -> None:
    """A speed that was made of an angle measures nothing of its own."""
    for angle, speed in (("theta_1", "w_1"), ("theta_2", "w_2"), ("motor_angle", "motor")):
        if angle in channels and speed in channels:
            first, second = channels[angle].sensor, channels[speed].sensor
            _, own, other = np.intersect1d(first.raw.t, second.raw.t, return_indices=True)
            x, w, t = first.raw.x[own], second.raw.x[other], first.raw.t[own]
            alike = len(first.values) == len(t) and angles.differenced(first.si, second.si, dt)
            if alike or relations.differenced(x, w, t):
                channels[speed] = dataclasses.replace(channels[speed], derived=angle)


def _voltage(those: Sequence[Sensor], left_out: dict[str, str]) -> Sensor | None:
    """One that was measured before one that was asked for, the motor's before others."""
    ranked = sorted(those, key=lambda one: (one.seen.says.wanted, one.place != MOTOR))
    for one in ranked[1:]:
        left_out[one.name] = f"the voltage is taken from {ranked[0].name} already"
    return ranked[0] if ranked else None


def _load(those: Sequence[Sensor], left_out: dict[str, str]) -> Sensor | None:
    loads = [one for one in those if one.place == ROTOR]
    for one in those:
        if one.place != ROTOR:
            left_out[one.name] = "is a torque, but not said to be that at rotor 1, the only input"
    for one in loads[1:]:
        left_out[one.name] = f"the load is taken from {loads[0].name} already"
    if not loads:
        return None
    return loads[0].but(
        doubt="taken as the load on rotor 1, against positive speed; check its sign"
    )


def both_ways(found: Roles) -> bool:
    """Whether the rig is driven, or turns, in both directions."""
    driven = [found.v] if found.v is not None else []
    seen = driven or [one.sensor for one in found.channels if one.sensor.kind == "speed"]
    for one in seen:
        low, high = np.percentile(one.raw.x, [2, 98])
        if min(-low, high) > 0.1 * max(-low, high):
            return True
    return False


def with_signs(found: Roles) -> Roles:
    """Doubts where what turns goes against the voltage."""
    if found.v is None or np.ptp(found.v.values) == 0:
        return found
    v = found.v.si - found.v.si.mean()
    channels = []
    for one in found.channels:
        if one.sensor.kind == "speed" and one.sensor.place != TWIST:
            w = one.sensor.values - one.sensor.values.mean()
            together = float(v @ w) / math.sqrt(float(v @ v) * float(w @ w))
            if together < -0.3 and not one.measures.startswith("-"):
                doubt = (
                    "it goes against the voltage; if it counts backwards, write `measures: -...`"
                )
                one = dataclasses.replace(one, sensor=one.sensor.but(doubt=doubt))
        channels.append(one)
    return dataclasses.replace(found, channels=tuple(channels))
