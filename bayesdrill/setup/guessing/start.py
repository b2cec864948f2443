"""How a record begins: at rest or moving, at which time, and which part of it is used."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bayesdrill.basics import units
from bayesdrill.setup.guessing.columns import Array
from bayesdrill.setup.guessing.names import GEARBOX, MOTOR, ROTOR, SI, TWIST
from bayesdrill.setup.guessing.roles import Channel, Roles

FIRST = 9  # samples that tell the first value
FEWEST = 100  # samples after 0 s, for which those before it are given up
CLEAR = 6.0  # of the noise, that is no noise


@dataclass(frozen=True, slots=True)
class Start:
    """`state`: what is not zero at `time` (None: the default); `window` in s, None for all."""

    state: Mapping[str, float]
    time: float | None
    window: tuple[float, float] | None
    doubts: tuple[str, ...]
    why: str


def start(found: Roles, t: Array, *, cut: bool, measured: bool) -> Start:
    """Of the rows that are used, at times `t (T,)`; `cut`: others are not; `measured`: the voltage."""
    doubts, window = [], (float(t[0]), float(t[-1])) if cut else None
    if cut:
        doubts.append(
            "the longest part with equal steps and no number missing; the rest is not used"
        )
    state, moving = _state(found)
    time, dt = None, float(t[1] - t[0])
    late = 0 if measured or moving else _onset(found)
    if late:
        window = (float(t[late]), float(t[-1]))
        doubts.append(
            f"nothing moves before {t[late]:.6g} s, and a constant voltage is there from the start on: "
            "so it starts there"
        )
    elif window is None and not measured and t[0] < -1e-9 * dt and t[-1] > FEWEST * dt:
        window = (0.0, float(t[-1]))
        doubts.append("times before 0 s: a constant voltage is taken to be there from 0 s on")
    elif window is None and not measured and not -1e-9 * dt <= t[0] <= 2 * dt:
        time = float(t[0])
        doubts.append(f"the record begins at {t[0]:.6g} s: the start is taken to be there")
    if moving:
        doubts.append(
            "the rig moves when the record begins. These are its first values, held; what was not "
            "measured there is taken as the other end has it, the current as zero. A start that is "
            "unknown, or steady, is not supported yet: better begin where it rests, with `window:`"
        )
        if not measured and time is None and window is None:
            time = float(t[0])
    elif state:
        doubts.append("it begins at rest, but not at angle zero")
    return Start(state, time, window, tuple(doubts), "at rest" if not moving else "")


def _state(found: Roles) -> tuple[dict[str, float], bool]:
    """First values of the states in SI, those that are clearly not zero; and whether it moves."""
    first: dict[tuple[str, str], float] = {}
    moving = False
    for one in found.channels:
        sensor = one.sensor
        value, clear = _first(one)
        scale = units.factor(sensor.unit, SI[sensor.kind])
        if sensor.place == MOTOR:
            first.setdefault((sensor.kind, GEARBOX), value * scale * clear / found.gear)
        else:
            first[sensor.kind, sensor.place] = value * scale * clear
        moving |= clear and sensor.kind == "speed"
    twist = first.get(("angle", TWIST), 0.0)
    state: dict[str, float] = {}
    for kind, name in (("angle", "theta"), ("speed", "w")):
        apart = twist if kind == "angle" else 0.0
        far, near = first.get((kind, ROTOR)), first.get((kind, GEARBOX))
        if far is None:
            far = apart if near is None else near + apart
        if near is None:
            near = far - apart
        state |= {f"{name}_1": far, f"{name}_2": near}
    state["i"] = first.get(("current", ""), 0.0)
    return {name: value for name, value in state.items() if value != 0.0}, moving


def _first(one: Channel) -> tuple[float, bool]:
    """In the column's unit, and whether it is clearly not zero."""
    values = one.sensor.values[:FIRST]
    k = np.arange(len(values))
    fitted = float(np.polyval(np.polyfit(k, values, 2), 0)) if len(values) == FIRST else values[0]
    least = CLEAR * one.noise + 0.002 * float(np.abs(one.sensor.values).max())
    return float(f"{fitted:.4g}"), bool(abs(values[0]) > least and abs(fitted) > least)


def _onset(found: Roles) -> int:
    """The last sample before anything moves, where that is not the first few."""
    begins = []
    for one in found.channels:
        values = one.sensor.values
        away = np.abs(values - np.median(values[:FIRST])) > 8 * one.noise
        if away.any():
            begins.append(int(np.argmax(away)))
    first = min(begins, default=0)
    return max(first - 2, 0) if first > 3 * FIRST else 0
