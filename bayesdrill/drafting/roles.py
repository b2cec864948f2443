"""Assign each sensor to a channel or an input of the rig, and find the gear ratio and lags.

The lag between sensors at the ends of the shaft is the shift with which the equation of motion of
rotor 1 explains the twist best. Damping of the shaft adds c_s/k_s to the lag, so it is only a hint.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d

from bayesdrill.drafting import signals
from bayesdrill.drafting.columns import GEARBOX, MOTOR, ROTOR, STATES, TWIST
from bayesdrill.drafting.sensors import MIN_GEAR
from bayesdrill.drafting.signals import TURNS, Sensor
from bayesdrill.record import anomalies
from bayesdrill.rig.models.linear import Model, with_named
from bayesdrill.rig.models.train import Train

_STATE = {meaning: state for state, meaning in STATES.items()}
_NAMED_STATES = re.compile(r"\b(?:theta_[12]|w_[12]|i)\b")
# Twist sensors by kind: channel name, `measures:`, and `measures:` with the opposite sign.
_TWISTS = {
    "angle": ("twist", "theta_1 - theta_2", "theta_2 - theta_1"),
    "speed": ("twist_rate", "w_1 - w_2", "w_2 - w_1"),
}
IMPOSED = ("theta_2", "w_2")  # in order of preference: a speed is often computed from the angle


@dataclass(frozen=True, slots=True, eq=False)
class DraftChannel:
    """A draft channel has its `name` in the config; `measures` is empty if `name` is a state."""

    name: str
    measures: str
    sensor: Sensor
    derived: str = ""  # name of the angle channel from which this speed was computed


@dataclass(frozen=True, slots=True, eq=False)
class SensorRoles:
    """Roles assign sensors to `channels` and `inputs`; `gear` is motor turns per shaft turn."""

    channels: tuple[DraftChannel, ...]
    inputs: Mapping[str, Sensor]
    rig: Model
    gear: float
    gear_reason: str
    gear_doubt: str
    unused: dict[str, str]
    train: Train | None = None  # without optional physics; None if the rig is no train

    @property
    def v(self) -> Sensor | None:
        """Return the sensor of the voltage; None if it is not measured."""
        return self.inputs.get("v")

    def with_sensors(self, change: Callable[[Sensor], Sensor]) -> SensorRoles:
        """Return the roles with each sensor replaced by `change(sensor)`."""
        channels = (dataclasses.replace(c, sensor=change(c.sensor)) for c in self.channels)
        inputs = {name: change(sensor) for name, sensor in self.inputs.items()}
        return dataclasses.replace(self, channels=tuple(channels), inputs=inputs)


def assign_roles(
    sensors: Sequence[Sensor], dt: float, rig: Model, gear: float | None, *, voltage: bool
) -> SensorRoles:
    """Assign sensors with step `dt` [s] to a rig; `voltage` flags a given constant voltage."""
    unused: dict[str, str] = {}
    turning = _with_locations([sensor for sensor in sensors if sensor.kind in TURNS])
    ratio, sources = _gear_ratio(turning, dt)
    turning = [_behind_gear(sensor, turning, dt) for sensor in turning]
    value, why, doubt = gear or 1.0, "", ""
    if gear is not None:
        why = "as given"
        if abs(abs(ratio) / gear - 1) > 0.05:  # false for NaN
            doubt = f"{sources} show a gear of {abs(ratio):.4g}:1; check their units and the gear"
    elif math.isnan(ratio):
        doubt = "no two columns show the gear, so it is taken as 1:1"
        doubt += ". The motor's parameters then refer to the shaft. Use `--gear 14` for 14:1"
    else:
        value = abs(ratio)
        doubt = f"the gear ratio is not stated; {sources} turn as {value:.5g}:1"
    channels: dict[str, DraftChannel] = {}
    for sensor in [*turning, *(sensor for sensor in sensors if sensor.kind == "current")]:
        name, measures = _channel_name(sensor, -value if ratio < 0 else value)
        if name:
            add_channel(channels, DraftChannel(name, measures, sensor), unused)
        else:
            unused[sensor.name] = "does not say at which end of the shaft it is"
    mark_differenced(channels, dt)
    inputs, rig = _inputs(sensors, channels, rig, unused, voltage=voltage)
    for name, channel in [*channels.items()]:
        if not {*_NAMED_STATES.findall(channel.measures or name)} <= {*rig.states}:
            unused[channel.sensor.name] = f"is {name}, which the rig {rig.name} does not have"
            del channels[name]
    return SensorRoles(tuple(channels.values()), inputs, rig, value, why, doubt, unused)


def add_channel(
    channels: dict[str, DraftChannel], new: DraftChannel, unused: dict[str, str]
) -> None:
    """Add a channel, unless a channel with its name exists."""
    if known := channels.get(new.name):
        unused[new.sensor.name] = f"is not needed: {new.name} is taken from {known.sensor.name}"
    else:
        channels[new.name] = new


def _inputs(
    sensors: Sequence[Sensor],
    channels: dict[str, DraftChannel],
    rig: Model,
    unused: dict[str, str],
    *,
    voltage: bool,
) -> tuple[dict[str, Sensor], Model]:
    """Return the measured inputs, and the rig, with a circuit if voltage or current is known."""
    inputs: dict[str, Sensor] = {}
    voltages, torques = ([s for s in sensors if s.kind == kind] for kind in ("voltage", "torque"))
    motor = [torque for torque in torques if torque.location in (MOTOR, "")]
    if motor and "t_m" in rig.inputs:
        inputs["t_m"] = motor[0]
    elif voltages or voltage or "i" in channels:
        for m in rig.roles.motors:
            rig = with_named(rig, (m.back_emf, m.torque_constant, m.resistance, m.inductance))
    if "v" in rig.inputs and voltages:
        voltages.sort(key=_voltage_rank)
        inputs["v"] = _first_sensor(voltages, "voltage", unused)
        if others := ", ".join(s.name for s in voltages[1:] if not s.column.meaning.is_setpoint):
            doubt = f"{others} may be the voltage as well: this column has the clearest name"
            inputs["v"] = inputs["v"].revised(doubt=doubt)
    if "t_1" in rig.inputs:
        unlocated = [torque.name for torque in torques if torque.location == ""]
        why = "is a torque, but does not say whether it acts on rotor 1"
        unused |= dict.fromkeys(unlocated, why)
        if loads := [torque for torque in torques if torque.location == ROTOR]:
            doubt = "taken as the load on rotor 1; it acts against positive speed: check its sign"
            inputs["t_1"] = _first_sensor(loads, "load", unused).revised(doubt=doubt)
    if "w_2" in rig.inputs:
        imposed = [channels.pop(name) for name in IMPOSED if name in channels]
        for channel in imposed[1:]:
            why = f"is not needed: {imposed[0].sensor.name} gives the imposed motion"
            unused[channel.sensor.name] = why
        inputs |= {channel.name: channel.sensor for channel in imposed[:1]}
    used = [sensor.column for sensor in inputs.values()]
    for sensor in [*voltages, *torques]:
        if sensor.column not in used:
            unused.setdefault(sensor.name, f"is no input of the rig {rig.name}")
    doubt = "it counts backwards, but an input has no `measures`: change its sign in the file"
    backwards = {name: s for name, s in inputs.items() if s.column.meaning.is_reversed}
    return inputs | {name: s.revised(doubt=doubt) for name, s in backwards.items()}, rig


def _voltage_rank(voltage: Sensor) -> tuple[bool, bool, int]:
    """Return a sort key: measurements before set points, then the motor, then the clearest name."""
    meaning, name = voltage.column.meaning, voltage.name.lower()
    by_name = (bool(meaning.unit), len(meaning.kind_word) > 1, name == "v", name == "u", True)
    return meaning.is_setpoint, voltage.location != MOTOR, by_name.index(True)


def _first_sensor(sensors: Sequence[Sensor], what: str, unused: dict[str, str]) -> Sensor:
    for sensor in sensors[1:]:
        why = f"is not needed: the {what} is taken from {sensors[0].name}"
        if what == "voltage" and len(sensor.column.meaning.kind_word) == 1:
            why = f"has the name of a voltage, but {sensors[0].name} is taken as the voltage. If "
            why += f'it is a speed, use --columns "{sensor.column.command}=w_1 [rad/s]" or v_cart [mm/s]'
            why += f'. Then also name the voltage: --columns "{sensors[0].column.command}=v [V]"'
        unused[sensor.name] = why
    return sensors[0]


def _with_locations(turning: Sequence[Sensor]) -> list[Sensor]:
    """Return the sensors; the first unlocated one of each kind gets a free end or the gearbox."""
    located = {sensor.location for sensor in turning}
    rotor, upper, twist = ROTOR in located, bool(located & {GEARBOX, MOTOR}), TWIST in located
    if rotor and upper:
        return list(turning)
    free, because = GEARBOX, "most encoders are there"
    if rotor or (upper and not twist):
        free, because = GEARBOX if rotor else ROTOR, "the other end has a column of its own"
    elif twist:
        because = "the twist is counted from there"
    doubt = f"the end of the shaft is not stated; taken as {free}, because {because}"
    firsts = {sensor.kind: sensor for sensor in reversed(turning) if not sensor.location}
    return [
        s.revised(location=free, doubt=doubt) if s is firsts.get(s.kind) else s for s in turning
    ]


def _gear_ratio(turning: Sequence[Sensor], dt: float) -> tuple[float, str]:
    """Return turns of the motor per turn of the shaft (NaN if unknown), and the columns that show it."""
    ends = [sensor for sensor in turning if sensor.location in (GEARBOX, ROTOR)]
    for motor in (sensor for sensor in turning if sensor.location == MOTOR):
        for end in sorted(ends, key=lambda end: end.kind != motor.kind):
            value = _ratio(motor, end, dt)
            if abs(value) > 1.2:
                nearest = round(value)
                value = float(nearest) if abs(value / nearest - 1) < 0.02 else float(f"{value:.4g}")
                return value, f"{motor.name} and {end.name}"
    return math.nan, ""


def _ratio(motor: Sensor, end: Sensor, dt: float) -> float:
    """Return the ratio of the motor's angle to the angle of the sensor `end`."""
    if end.location == ROTOR:
        return signals.ratio_through_shaft(motor.angle(dt), end.angle(dt), dt)
    return signals.ratio(motor.angle(dt), end.angle(dt))


def _behind_gear(sensor: Sensor, turning: Sequence[Sensor], dt: float) -> Sensor:
    """Return the sensor, with a location behind the gear if it turns as fast as the shaft."""
    ends = [other for other in turning if other.location in (GEARBOX, ROTOR)]
    if sensor.location != MOTOR or not ends:
        return sensor
    value = _ratio(sensor, ends[0], dt)
    if abs(value) > 1.2 or math.isnan(value):
        return sensor
    times = f"it turns {value:.3g} times as far as {ends[0].name}"
    if abs(value) < MIN_GEAR:
        return sensor.revised(doubt=f"{times}, which no gear makes: one of the units is wrong")
    doubt = f"named after the motor, but {times}: taken as behind the gear"
    return sensor.revised(location=GEARBOX, doubt=doubt)


def _channel_name(sensor: Sensor, gear: float) -> tuple[str, str]:
    """Return name and `measures:` of a sensor's channel; the name is empty if it is unknown."""
    backwards = sensor.column.meaning.is_reversed
    if sensor.location == TWIST and sensor.kind in _TWISTS:
        name, forwards, reverse = _TWISTS[sensor.kind]
        return name, reverse if backwards else forwards
    if sensor.location == MOTOR and sensor.kind != "current":
        name = "motor" if sensor.kind == "speed" else "motor_angle"
        return name, f"{-gear if backwards else gear:.6g} * {_STATE[sensor.kind, GEARBOX]}"
    state = "i" if sensor.kind == "current" else _STATE.get((sensor.kind, sensor.location), "")
    return state, f"-{state}" if backwards and state else ""


PAIRS = (("theta_1", "w_1"), ("theta_2", "w_2"), ("motor_angle", "motor"))


def mark_differenced(
    channels: dict[str, DraftChannel], dt: float, pairs: Iterable[tuple[str, str]] = PAIRS
) -> None:
    """Mark each speed that was computed from an angle instead of being measured."""
    for angle, speed in pairs:
        if angle in channels and speed in channels:
            first, second = channels[angle].sensor, channels[speed].sensor
            t, rows, others = np.intersect1d(first.raw.t, second.raw.t, return_indices=True)
            is_complete = len(t) > 0.99 * len(first.values)  # except glitches, which were removed
            computed = is_complete and anomalies.differenced(first.si, second.si, dt)
            if computed or signals.differenced(first.raw.x[rows], second.raw.x[others], t):
                channels[speed] = dataclasses.replace(channels[speed], derived=angle)


def turns_both_ways(roles: SensorRoles) -> bool:
    """Return whether the rig is driven, or turns, in both directions."""
    driving = [sensor for name, sensor in roles.inputs.items() if name != "t_1"]
    moving = [c.sensor for c in roles.channels if c.sensor.kind != "current"]
    speeds = [sensor for sensor in moving if sensor.kind == "speed"]
    return any(map(signals.reverses, driving or speeds or moving))


FILTER_WIDTHS = (2, 4, 8, 16)  # sds of the Gaussian filters to try, in samples; the best is used
FILTER_REACH = 4  # distance at which filters are cut off, in sds
MAX_SHIFT = 8  # largest lag that is tried, in samples
SHIFTS_PER_SAMPLE = 2  # number of lags that are tried per sample
MAX_LAG_SAMPLES = 10_000  # largest number of samples from which a lag is found
MIN_EXPLAINED = 0.9  # least fraction of the twist's variance that the equation explains
MIN_IMPROVEMENT = 1.5  # least ratio of the residual variances without and with a lag


@dataclass(frozen=True, slots=True)
class LagHint:
    """A lag hint gives the number of samples by which a `channel` seems to be late."""

    channel: str
    samples: float
    residual: float  # unexplained fraction of the twist's variance with this lag
    baseline: float  # the same fraction without a lag


def find_lags(roles: SensorRoles, dt: float) -> list[LagHint]:
    """Return hints of lags between each motion and the twist (or rotor 1, without a twist)."""
    turning = [c for c in roles.channels if c.sensor.kind in TURNS and not c.derived]

    def at(*locations: str) -> list[DraftChannel]:
        return [c for location in locations for c in turning if c.sensor.location == location]

    twists = [channel for channel in at(TWIST) if channel.sensor.kind == "angle"]
    others = at(GEARBOX, MOTOR, ROTOR) if twists else at(GEARBOX, MOTOR)
    pairs = itertools.product(twists[:1] or at(ROTOR), others)
    hints = [_lag_of_pair(*pair, roles.gear, dt) for pair in pairs]
    return [hint for hint in hints if hint is not None]


def _lag_of_pair(
    first: DraftChannel, second: DraftChannel, gear: float, dt: float
) -> LagHint | None:
    trials: list[tuple[float, float, float]] = []
    for width in FILTER_WIDTHS:
        if min(len(first.sensor.values), MAX_LAG_SAMPLES) < 20 * FILTER_REACH * width:
            break
        unexplained = _twist_law(first.sensor, second.sensor, width, gear, dt)
        steps = range(-MAX_SHIFT * SHIFTS_PER_SAMPLE, MAX_SHIFT * SHIFTS_PER_SAMPLE + 1)
        residuals = {k / SHIFTS_PER_SAMPLE: unexplained(k / SHIFTS_PER_SAMPLE) for k in steps}
        shift = min(residuals, key=lambda shift: residuals[shift])
        trials.append((residuals[shift], shift, residuals[0.0]))
    if not trials:
        return None
    after, samples, before = min(trials, key=lambda trial: trial[0])
    clear = 1 - after > MIN_EXPLAINED and before > MIN_IMPROVEMENT * after
    delayed = first if samples > 0 else second
    hint = LagHint(delayed.name, abs(samples), after, before)
    return hint if clear and abs(samples) < MAX_SHIFT else None


def _twist_law(
    first: Sensor, second: Sensor, width: int, gear: float, dt: float
) -> Callable[[float], float]:
    """Return the function: shift of `first` -> unexplained fraction of the twist's variance."""
    smoothed = []  # one filter for all derivatives, so that filtered signals obey the equation, too
    for sensor in (first, second):
        angle = sensor.angle(dt)[:MAX_LAG_SAMPLES] / (gear if sensor.location == MOTOR else 1.0)
        orders = [
            gaussian_filter1d(angle, width, order=d, truncate=FILTER_REACH) for d in (0, 1, 2)
        ]
        smoothed.append(np.stack(orders))
    margin, k = FILTER_REACH * width + MAX_SHIFT, np.arange(smoothed[0].shape[1], dtype=np.float64)
    inner = slice(margin, len(k) - margin)
    other = smoothed[1][:, inner]

    def unexplained(shift: float) -> float:
        shifted = np.stack([np.interp(k[inner] + shift, k, x) for x in smoothed[0]])
        twist, rotor = shifted[0] - other[0], shifted
        if first.location == TWIST:
            twist, rotor = shifted[0], other if second.location == ROTOR else other + shifted
        _, speed, acceleration = rotor
        causes = [acceleration, speed, np.sign(speed), k[inner]]
        factors, fraction = signals.explained(twist, *causes)
        return 1 - fraction if factors[0] < 0 else 1.0  # a spring has twist = -J/k * acceleration

    return unexplained
