"""Guess the start of a record: its state (at rest, steady, moving or released) and its window."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.drafting import signals
from bayesdrill.drafting.columns import GEARBOX, MOTOR, ROTOR, TWIST
from bayesdrill.drafting.roles import SensorRoles
from bayesdrill.drafting.signals import TURNS, Segment, Sensor

FIRST_SAMPLES = 9  # number of samples that are fitted to find the first value
MIN_AFTER_ZERO = 100  # least number of samples after 0 s if samples before 0 s are cut off
CLEAR_OF_NOISE = 6.0  # smallest value that is clearly not zero, in sds of the noise
IMMEDIATE_SHARE = 0.4  # ratio of initial to mean speed above which a rig moved before the record
STEADY_SAMPLES = 40  # number of samples at the beginning that have to be steady
STEADY_NOISE = 1.3  # largest sd of a steady channel, relative to its noise
ZERO_PRIOR_FACTOR = 2.0  # prior sd of an angle's offset, relative to its first value


@dataclass(frozen=True, slots=True)
class StartGuess:
    """A start guess holds the entries `initial` and `window` of a config, empty for the default."""

    initial: str
    is_moving: bool
    window: str
    zero_sds: Mapping[str, float]  # prior sds of offsets, for angles at rest but not at zero
    max_delay: float  # largest delay of an input, in samples
    dead_samples: int  # delay from an input to a speed, in samples; 0 if unclear
    rest_end: float  # time of the first motion [s]; NaN if it is at the start
    window_doubt: str
    doubts: tuple[str, ...]


def guess_start(
    roles: SensorRoles, segment: Segment, *, measured: bool, inputs_begin: float | None = None
) -> StartGuess:
    """Guess how the segment begins; inputs that are `measured` begin at `inputs_begin` [s]."""
    t = segment.t
    begin, why, time = None, "", None
    if segment.is_cut:
        begin, why = float(t[0]), "the longest part with increasing times and no infinite value"
    if measured and inputs_begin is not None and inputs_begin > t[0]:
        t = t[t >= inputs_begin]
        begin, why = float(t[0]), "the window begins at the first sample of the inputs"
    moving, onset = _is_moving(roles), _onset(roles)
    dead, max_delay = _dead_time(roles) if measured else (0, 1.0)
    if roles.train is not None:
        free, reason = (
            _free_states(roles),
            "the record need not begin at rest: the start is unknown",
        )
        window = _window(begin, t)
        return StartGuess(free, True, window, {}, max_delay, dead, onset, why, (reason,))
    driven = measured or "v" in roles.rig.inputs  # a voltage without a column is constant
    if not (measured or moving or math.isnan(onset)):
        max_delay = 3.0
        begin, why = _release(float(t[0]), onset, segment.dt, driven=driven)
    elif begin is None and driven and not measured:
        begin, why, time = _switching_on(t, segment.dt)
    doubts = [] if time is None else [f"the start is taken at the first sample, {t[0]:.6g} s"]
    state = ""
    if moving and measured and _begins_steadily(roles):
        state = "steady"
        doubts.append("the rig turns when the record begins, steadily for a while")
    elif moving:
        state = "free"
        doubts.append("the rig moves when the record begins: the start is unknown")
    elif not driven:  # then only the initial state moves the rig
        state = "free"
        doubts.append("no input drives the rig: the start is unknown")
    if state and not measured and time is None and begin is None and t[0] != 0:
        time = float(t[0])
    initial, zeros = _initial(roles, state, time), {} if state else _zeros(roles)
    return StartGuess(
        initial, bool(state), _window(begin, t), zeros, max_delay, dead, onset, why, tuple(doubts)
    )


def _window(begin: float | None, t: Array) -> str:
    return "" if begin is None else f"[{begin:.12g}, {float(t[-1]):.12g}]"


def _dead_time(roles: SensorRoles) -> tuple[int, float]:
    """Return the dead time between input and speed, and its upper limit, in samples."""
    channels, inputs = [channel.sensor for channel in roles.channels], [*roles.inputs.values()]
    rigid = len(roles.rig.roles.moving(roles.rig.states, roles.rig.parameters)) == 1
    dead, margin = signals.dead_samples(channels, inputs, rigid=rigid)
    return dead, dead + 2.0 * margin if dead else 1.0


def _free_states(roles: SensorRoles) -> str:
    """Return the entry `initial` of a train; without a measured angle, the first angle is zero."""
    if any(channel.sensor.kind in ("angle", "position") for channel in roles.channels):
        return "free"
    return f"{{{', '.join(f'{name}: free' for name in roles.rig.states[1:])}}}"


def _release(first: float, rest: float, dt: float, *, driven: bool) -> tuple[float, str]:
    """Return the start time of a rig that is at rest until `rest` [s], and the reason for it."""
    begin = max(first, rest - 2 * dt if driven else rest)
    still = f"nothing moves before {begin:.6g} s"
    if driven:
        reason = "and a constant voltage acts from the start on, so this is the start"
        return begin, f"{still}, {reason}"
    return begin, f"{still}: the rig is released there"


def _switching_on(t: Array, dt: float) -> tuple[float | None, str, float | None]:
    """Return the window's begin, the reason, and the start time, for a constant voltage."""
    if t[0] < -1e-9 * dt and t[-1] > MIN_AFTER_ZERO * dt:
        return 0.0, "times before 0 s: a constant voltage is assumed to act from 0 s on", None
    return None, "", None if -1e-9 * dt <= t[0] <= 2 * dt else float(t[0])


def _initial(roles: SensorRoles, state: str, time: float | None) -> str:
    """Return the entry `initial`; `state` is "free", "steady", or empty for a rig at rest."""
    angle = _start_angle(roles, state) if state else ""
    if time is None and not angle:
        return state
    at = "" if time is None else f"time: {time:.12g}"
    return f"{{{', '.join(filter(None, (at, state and f'state: {state}', angle)))}}}"


def _begins_steadily(roles: SensorRoles) -> bool:
    """Return whether angles grow linearly at first, and voltage and other channels are constant."""
    v = roles.v
    if v is None or not np.ptp(v.values[:STEADY_SAMPLES]) <= 0.01 * np.ptp(v.values):
        return False
    for sensor in (channel.sensor for channel in roles.channels if not channel.derived):
        t, x = sensor.raw.t[:STEADY_SAMPLES], sensor.raw.x[:STEADY_SAMPLES]
        grows = sensor.kind == "angle" and sensor.location != TWIST
        line = np.polyval(np.polyfit(t - t[0], x, 1 if grows else 0), t - t[0])
        if not float(np.std(x - line)) <= STEADY_NOISE * sensor.noise:
            return False
    return True


def _start_angle(roles: SensorRoles, state: str) -> str:
    """Return the entry for the angle that `initial:` must contain; empty if it needs no angle."""
    measured = {c.sensor.location for c in roles.channels if c.sensor.kind == "angle"}
    upper, rotor = bool(measured & {GEARBOX, MOTOR}), ROTOR in measured
    if state == "steady":
        return "theta_2: free" if upper else "theta_1: free" if rotor else ""
    return "" if upper or rotor else "theta_2: 0"  # any angle fits: only the twist matters


def _is_moving(roles: SensorRoles) -> bool:
    """Return whether a speed is clearly not zero at first or, without speeds, whether an angle grows."""
    turning = [c.sensor for c in roles.channels if c.sensor.kind in TURNS and not c.derived]
    if speeds := [sensor for sensor in turning if sensor.kind == "speed"]:
        return any(_first_value(sensor)[1] for sensor in speeds)
    whole = [sensor for sensor in turning if sensor.location != TWIST]
    return any(map(_is_growing, whole or turning))


def _is_growing(sensor: Sensor) -> bool:
    """Return whether an angle clearly changes from the first sample on, not only later."""
    if len(sensor.raw.x) < FIRST_SAMPLES:
        return False
    t, x = sensor.raw.t[:FIRST_SAMPLES], sensor.raw.x[:FIRST_SAMPLES]
    k = (t - t[0]) / (t[-1] - t[0])
    design = np.stack([np.ones(FIRST_SAMPLES), k, k**2], axis=-1)
    slope = float(np.linalg.lstsq(design, x, rcond=None)[0][1])
    sd = sensor.noise * math.sqrt(float(np.linalg.inv(design.T @ design)[1, 1]))
    mean = float(np.polyfit(k, x, 1)[0])
    return abs(slope) > CLEAR_OF_NOISE * sd and slope * mean > IMMEDIATE_SHARE * mean**2


def _zeros(roles: SensorRoles) -> dict[str, float]:
    """Return prior sds of offsets for angles that are not zero at rest."""
    zeros = {}
    for channel in (c for c in roles.channels if c.sensor.kind == "angle"):
        value, clear = _first_value(channel.sensor)
        if clear:
            zeros[channel.name] = float(f"{ZERO_PRIOR_FACTOR * abs(value):.2g}")
    return zeros


def _first_value(sensor: Sensor) -> tuple[float, bool]:
    """Return the first value, in the column's unit, and whether it is clearly not zero."""
    t, x = sensor.raw.t[:FIRST_SAMPLES], sensor.raw.x[:FIRST_SAMPLES]
    fitted = float(x[0])
    if len(x) == FIRST_SAMPLES:
        fitted = float(np.polyval(np.polyfit((t - t[0]) / (t[-1] - t[0]), x, 2), 0))
    least = CLEAR_OF_NOISE * sensor.noise + 0.002 * float(np.abs(sensor.raw.x).max())
    return float(f"{fitted:.4g}"), bool(abs(x[0]) > least and abs(fitted) > least)


def _onset(roles: SensorRoles) -> float:
    """Return the time of the first motion [s]; NaN if it is within the first few samples."""
    begins: list[tuple[float, int]] = []
    for sensor in (channel.sensor for channel in roles.channels):
        away = np.abs(sensor.raw.x - np.median(sensor.raw.x[:FIRST_SAMPLES])) > 8 * sensor.noise
        if away.any():
            begins.append((float(sensor.raw.t[np.argmax(away)]), int(np.argmax(away))))
    time, index = min(begins, default=(math.nan, 0))
    return time if index > 3 * FIRST_SAMPLES else math.nan
