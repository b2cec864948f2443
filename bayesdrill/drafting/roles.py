"""Which channel or input of the rig each sensor is, the gear, lags between the ends, and how a
record begins.

How late one end of the shaft is told, by the law of rotor 1: the twist is what accelerates it.

Damping in the shaft, c_s, shifts that by c_s/k_s: what is found is a hint and no value.
"""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d

from bayesdrill.drafting import signals
from bayesdrill.drafting.columns import GEARBOX, MOTOR, ROTOR, STATES, TWIST
from bayesdrill.drafting.sensors import SLOWEST
from bayesdrill.drafting.signals import TURNS, Part, Sensor
from bayesdrill.record import anomalies
from bayesdrill.rig.models.linear import Model, with_named

WIDE = 10.0  # the prior of a noise: so many times below and above what differs between samples
_STATE = {meaning: state for state, meaning in STATES.items()}


@dataclass(frozen=True, slots=True, eq=False)
class Channel:
    """A sensor under the name that the config gives it; `measures` is empty for a state itself.

    `derived`: the channel of which it is differences.
    """

    name: str
    measures: str
    sensor: Sensor
    derived: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Roles:
    """`inputs`: measured ones, by their entries; `gear`: turns of the motor for one of the shaft."""

    channels: tuple[Channel, ...]
    inputs: Mapping[str, Sensor]
    rig: Model
    gear: float
    gear_why: str
    gear_doubt: str
    left_out: dict[str, str]

    @property
    def v(self) -> Sensor | None:
        return self.inputs.get("v")

    def with_sensors(self, change: Callable[[Sensor], Sensor]) -> Roles:
        """The same roles of sensors that `change` makes of these."""
        channels = (dataclasses.replace(c, sensor=change(c.sensor)) for c in self.channels)
        inputs = {name: change(sensor) for name, sensor in self.inputs.items()}
        return dataclasses.replace(self, channels=tuple(channels), inputs=inputs)


def roles(
    those: Sequence[Sensor],
    dt: float,
    rig: Model,
    gear: float | None = None,
    *,
    voltage: bool = False,
) -> Roles:
    """`gear`: where it is known; `voltage`: whether a constant one is."""
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
        value = 1.0
        doubt = (
            "no two columns tell the gear; it is taken as 1:1, so that the motor's parameters are those "
            "behind it. Say `--gear 14` for 14:1"
        )
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
    inputs, rig = _inputs(those, channels, rig, left_out, voltage=voltage)
    for name, channel in [*channels.items()]:
        if not {*_NAMED_STATES.findall(channel.measures or name)} <= {*rig.states}:
            left_out[channel.sensor.name] = f"is {name}, which the rig {rig.name} does not have"
            del channels[name]
    return Roles(tuple(channels.values()), inputs, rig, value, why, doubt, left_out)


_NAMED_STATES = re.compile(r"\b(?:theta_[12]|w_[12]|i)\b")
IMPOSED = ("theta_2", "w_2")  # the angle first: it is what is measured


def _inputs(
    those: Sequence[Sensor],
    channels: dict[str, Channel],
    rig: Model,
    left_out: dict[str, str],
    *,
    voltage: bool,
) -> tuple[dict[str, Sensor], Model]:
    """What moves the rig, and the rig with the circuit that a voltage or a current needs."""
    found: dict[str, Sensor] = {}
    voltages, torques = ([o for o in those if o.kind == kind] for kind in ("voltage", "torque"))
    motor = [one for one in torques if one.place in (MOTOR, "")]
    if motor and "t_m" in rig.inputs:
        found["t_m"] = motor[0]
    elif voltages or voltage or "i" in channels:
        m = rig.roles.motor
        rig = with_named(rig, (m.back_emf, m.torque_constant, m.resistance, m.inductance))
    if "v" in rig.inputs and (v := _voltage(voltages, left_out)) is not None:
        found["v"] = v
    if "t_1" in rig.inputs and (load := _load(torques, left_out)) is not None:
        found["t_1"] = load
    if "w_2" in rig.inputs:
        imposed = [channels.pop(name) for name in IMPOSED if name in channels]
        for channel in imposed[1:]:
            left_out[channel.sensor.name] = f"is imposed by {imposed[0].sensor.name} already"
        if imposed:
            found[imposed[0].name] = imposed[0].sensor
    used = [one.seen for one in found.values()]
    for one in [*voltages, *torques]:
        if one.seen not in used:
            left_out.setdefault(one.name, f"is no input of the rig {rig.name}")
    against = "it counts backwards, which an input cannot say: turn its sign in the file"
    turned = {n: one.but(doubt=against) for n, one in found.items() if one.seen.says.backwards}
    return found | turned, rig


def _placed(turning: Sequence[Sensor]) -> list[Sensor]:
    """One without a place is where no other is; with a twist, at the gearbox."""
    placed = {one.place for one in turning if one.place}
    if ROTOR in placed and not placed & {GEARBOX, MOTOR}:
        free, because = GEARBOX, "the other end has a column of its own"
    elif placed & {GEARBOX, MOTOR} and not placed & {ROTOR, TWIST}:
        free, because = ROTOR, "the other end has a column of its own"
    else:
        twist = TWIST in placed
        free = GEARBOX
        because = "the twist is counted from there" if twist else "most encoders are there"
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
        return signals.ratio_through_shaft(motor.angle(dt), end.angle(dt), dt)
    return signals.ratio(motor.angle(dt), end.angle(dt))


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
    sign = "-" if one.seen.says.backwards else ""
    if one.kind == "current":
        return "i", "-i" if sign else ""
    if one.place == TWIST and one.kind == "angle":
        return "twist", "theta_2 - theta_1" if sign else "theta_1 - theta_2"
    if one.place == TWIST:
        return "twist_rate", "w_2 - w_1" if sign else "w_1 - w_2"
    if one.place == MOTOR:
        state = _STATE[one.kind, GEARBOX]
        name = "motor" if one.kind == "speed" else "motor_angle"
        return name, f"{-gear if sign else gear:.6g} * {state}"
    state = _STATE.get((one.kind, one.place), "")
    return state, f"-{state}" if sign and state else ""


def _tell_differenced(channels: dict[str, Channel], dt: float) -> None:
    """A speed that was made of an angle measures nothing of its own."""
    for angle, speed in (("theta_1", "w_1"), ("theta_2", "w_2"), ("motor_angle", "motor")):
        if angle in channels and speed in channels:
            first, second = channels[angle].sensor, channels[speed].sensor
            _, own, other = np.intersect1d(first.raw.t, second.raw.t, return_indices=True)
            x, w, t = first.raw.x[own], second.raw.x[other], first.raw.t[own]
            whole = len(t) > 0.99 * len(first.values)  # but for a few glitches
            alike = whole and anomalies.differenced(first.si, second.si, dt)
            if alike or signals.differenced(x, w, t):
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
        if one.place == "":
            left_out[one.name] = "is a torque, but not said to be that at rotor 1"
    for one in loads[1:]:
        left_out[one.name] = f"the load is taken from {loads[0].name} already"
    if not loads:
        return None
    return loads[0].but(
        doubt="taken as the load on rotor 1, against positive speed; check its sign"
    )


def both_ways(found: Roles) -> bool:
    """Whether the rig is driven, or turns, in both directions."""
    driven = [one for name, one in found.inputs.items() if name != "t_1"]
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
        return self.before / self.left if self.left > 0 else math.inf


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
    hints: list[tuple[float, float, float]] = []
    shifts = [k / FINER for k in range(-FURTHEST * FINER, FURTHEST * FINER + 1)]
    for width in WIDTHS:
        if min(len(first.sensor.values), MOST) < 20 * EDGE * width:
            break
        unexplained = _law(first, second, width, found.gear, dt)
        left = {shift: unexplained(shift) for shift in shifts}
        shift = min(left, key=lambda one: left[one])
        hints.append((left[shift], shift, left[0.0]))
    if not hints:
        return None
    after, samples, before = min(hints, key=lambda hint: hint[0])
    told = 1 - after > TOLD and before > BETTER * after and abs(samples) < FURTHEST
    late = first if samples > 0 else second
    return Lag(late.name, abs(samples), after, before) if told else None


def _law(
    first: Channel, second: Channel, width: int, gear: float, dt: float
) -> Callable[[float], float]:
    """By the samples that `first` is made earlier: what rotor 1's law leaves of the twist's variance.

    There is one filter for all derivatives: the law holds of what it leaves.
    """
    angles = [
        channel.sensor.angle(dt)[:MOST] / (gear if channel.sensor.place == MOTOR else 1.0)
        for channel in (first, second)
    ]
    smoothed = [
        np.stack([gaussian_filter1d(x, width, order=d, truncate=EDGE) for d in (0, 1, 2)])
        for x in angles
    ]
    margin, k = EDGE * width + FURTHEST, np.arange(len(angles[0]), dtype=np.float64)
    inner = slice(margin, len(k) - margin)
    other = smoothed[1][:, inner]

    def left(shift: float) -> float:
        one = np.stack([np.interp(k[inner] + shift, k, x) for x in smoothed[0]])
        if first.sensor.place == TWIST:
            rotor = other if second.sensor.place == ROTOR else other + one
            twist, (_, speed, acceleration) = one[0], rotor
        else:
            twist, (_, speed, acceleration) = one[0] - other[0], one
        causes = [acceleration, speed, np.sign(speed), k[inner]]
        factors, share = signals.explained(twist, *causes)
        return 1 - share if factors[0] < 0 else 1.0  # else it is no spring

    return left


def wide(samples: float, dt: float) -> float:
    """Largest lag [s] that a prior around such a hint allows, to two digits."""
    most = max(5.0, 2 * samples + 3) * dt
    digits = 1 - math.floor(math.log10(most))
    return math.ceil(most * 10.0**digits) / 10.0**digits


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
    return Start(
        state, _start_angle(found, state), time, window, {}, switched, said, (*doubts, why)
    )


def _how(found: Roles, *, measured: bool) -> tuple[str, str]:
    v = found.v
    even = measured and all(_steady(one) for one in found.channels if not one.derived)
    if even and v is not None and np.ptp(v.values[:STEADY]) <= 0.01 * np.ptp(v.values):
        return "steady", "the rig turns when the record begins, and all stays as it is for a while"
    return "free", "the rig moves when the record begins: the start is unknown"


def _start_angle(found: Roles, state: str) -> str:
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
    sd = one.sensor.noise * math.sqrt(float(np.linalg.inv(design.T @ design)[1, 1]))
    mean = float(np.polyfit(k, x, 1)[0])
    return abs(slope) > CLEAR * sd and slope * mean > SOON * mean**2


def _steady(one: Channel) -> bool:
    """Whether a speed, a twist or a current stays, and an angle grows evenly."""
    t, x = one.sensor.raw.t[:STEADY], one.sensor.raw.x[:STEADY]
    grows = one.sensor.kind == "angle" and one.sensor.place != TWIST
    rest = x - np.polyval(np.polyfit(t - t[0], x, 1 if grows else 0), t - t[0])
    return float(np.std(rest)) <= CALM * one.sensor.noise


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
    least = CLEAR * one.sensor.noise + 0.002 * float(np.abs(one.sensor.raw.x).max())
    return float(f"{fitted:.4g}"), bool(abs(values[0]) > least and abs(fitted) > least)


def _onset(found: Roles) -> float:
    """When anything first moves, s; NaN where that is within the first few samples."""
    begins: list[tuple[float, int]] = []
    for one in found.channels:
        t, x = one.sensor.raw.t, one.sensor.raw.x
        away = np.abs(x - np.median(x[:FIRST])) > 8 * one.sensor.noise
        if away.any():
            begins.append((float(t[np.argmax(away)]), int(np.argmax(away))))
    first = min(begins, default=(math.nan, 0))
    return first[0] if first[1] > 3 * FIRST else math.nan
