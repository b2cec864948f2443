"""Derive a train from its columns: an inertia for each angle, shafts between inertias, drives.

Columns have the symbols of the train as names: `theta_motor`, `w_load`, `x_cart`, `v_cart`; inputs
are `i_motor`, `u_motor`, `t_motor`, `f_cart`, and for a servo `goal_motor` and `supply_motor`. Even
without such names, a record with several angles and a current is taken as the record of a train.
"""

from __future__ import annotations

import itertools
import re
from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from bayesdrill.drafting.columns import GEARBOX, KIND_OF_LETTER, MOTIONS, MOTOR, ROTOR, train_symbol
from bayesdrill.drafting.roles import DraftChannel, SensorRoles, add_channel, mark_differenced
from bayesdrill.drafting.signals import Sensor
from bayesdrill.rig.models.linear import Model, with_named
from bayesdrill.rig.models.train import Train

LETTERS = {kind: letter for letter, kind in KIND_OF_LETTER.items()}
DRIVES = {kind: kind for kind in ("current", "voltage", "torque")} | {"force": "torque"}
LOCATIONS = {MOTOR: "motor", GEARBOX: "gearbox", ROTOR: "load"}


def is_train(sensors: Sequence[Sensor], rig: Model) -> bool:
    """Return whether the user asks for a train, or several angles and a current suggest a train."""
    if rig.has_private_names or any(map(_symbol, sensors)):
        return True
    kinds = [sensor.kind for sensor in sensors]
    several = max(kinds.count("angle"), kinds.count("speed")) > 1
    return several and "current" in kinds and not {"voltage", "torque"} & {*kinds}


def _symbol(sensor: Sensor) -> re.Match[str] | None:
    return train_symbol(sensor.column.meaning.symbol)


def _is_called(letter: str, sensor: Sensor) -> bool:
    """Return whether a sensor is called a `goal` or a `supply` of a servo."""
    match = _symbol(sensor)
    return match is not None and match[1] == letter


def assign_train(sensors: Sequence[Sensor], dt: float) -> SensorRoles:
    """Assign sensors to the channels and inputs of the train that these sensors describe."""
    moving = [s for s in sensors if s.kind in MOTIONS and not _is_called("goal", s)]
    names = _names(moving)
    inertias = [*dict.fromkeys(names[id(sensor)] for sensor in moving)]
    unused: dict[str, str] = {}
    channels: dict[str, DraftChannel] = {}
    for sensor in moving:
        name = f"{LETTERS[sensor.kind]}_{names[id(sensor)]}"
        measures = f"-{name}" if sensor.column.meaning.is_reversed else ""
        add_channel(channels, DraftChannel(name, measures, sensor), unused)
    inputs, drives = _inputs(sensors, inertias, channels, unused)
    inertias = [*dict.fromkeys((*inertias, *drives))]
    letters = (("theta", "w"), ("x", "v"))
    mark_differenced(channels, dt, [(f"{a}_{n}", f"{w}_{n}") for n in inertias for a, w in letters])
    pairs = [*itertools.pairwise(inertias)]
    shafts = {f"shaft_{k}" if len(pairs) > 1 else "shaft": [*p] for k, p in enumerate(pairs, 1)}
    linear = any(sensor.kind in ("position", "velocity", "force") for sensor in sensors)
    plain = Train(
        inertias=(*inertias,),
        shafts=shafts,  # type: ignore[arg-type]
        drives=drives,  # type: ignore[arg-type]
        motion="linear" if linear else "rotary",
    )
    named = [f"c_{name}" for name in (*inertias, *shafts)]
    named += [m.inductance for m in plain.roles.motors if m.current in channels]
    return SensorRoles(
        channels=(*channels.values(),),
        inputs=inputs,
        rig=with_named(plain, named),
        train=plain,
        gear=1.0,
        gear_reason="",
        gear_doubt="inertias are in the order of their columns, and a shaft joins each to the next. "
        "Correct this if necessary (a gear is `gears: {box: {between: [motor, load], ratio: 0.1}}`)",
        unused=unused,
    )


def _names(moving: Sequence[Sensor]) -> dict[int, str]:
    """Map the id of each sensor to the name of its inertia: as given, or from the location."""
    names, counts = dict[int, str](), Counter[str]()
    for sensor in moving:
        match = _symbol(sensor)
        counts[sensor.kind] += match is None
        place = LOCATIONS.get(sensor.location, f"inertia_{counts[sensor.kind]}")
        names[id(sensor)] = match[2] if match else place
    return names


def _inputs(
    sensors: Sequence[Sensor],
    inertias: Sequence[str],
    channels: dict[str, DraftChannel],
    unused: dict[str, str],
) -> tuple[dict[str, Sensor], dict[str, Any]]:
    """Return the inputs, and each inertia's drive; a current with a voltage becomes a channel."""
    inputs: dict[str, Sensor] = {}
    drives: dict[str, Any] = {}
    for letter, sensor in itertools.product(("goal", "supply"), sensors):
        if _is_called(letter, sensor):
            name = sensor.column.meaning.symbol
            typical = round(float(np.median(sensor.si)), 2)
            drives[name.removeprefix(f"{letter}_")] = (
                "servo" if letter == "goal" else {"servo": typical}
            )
            inputs[name] = sensor
    order = [*DRIVES]
    driving = [s for s in sensors if s.kind in DRIVES and not _is_called("supply", s)]
    for sensor in sorted(driving, key=lambda s: (s.kind == "current", order.index(s.kind))):
        letter, kind = LETTERS[sensor.kind], DRIVES[sensor.kind]
        match = _symbol(sensor)
        at = match[2] if match else inertias[0] if inertias else "inertia_1"
        if match is None and sensor.column.meaning.is_setpoint:
            unused[sensor.name] = "is a set point, and the rig need not have followed it"
        elif at not in drives:
            drives[at], inputs[f"{letter}_{at}"] = kind, sensor
        elif sensor.kind == "current" and drives[at] == "voltage":
            channels[f"i_{at}"] = DraftChannel(f"i_{at}", "", sensor)
        else:
            unused[sensor.name] = f"is not needed: {at} is driven by {next(iter(inputs))}"
    return inputs, drives


def model_lines(train: Train) -> list[str]:
    """Write the section `model:`."""
    lines = ["model:", "  name: train"]
    if train.motion != "rotary":
        lines.append(f"  motion: {train.motion}")
    lines.append(f"  inertias: [{', '.join(train.inertias)}]")
    shafts = ", ".join(f"{shaft.name}: [{', '.join(shaft.ends)}]" for shaft in train.shafts)
    drives = ", ".join(f"{d.inertia}: {d.entry}" for d in train.drives).replace("'", "")
    lines += [f"  shafts: {{{shafts}}}"] if shafts else []
    return lines + ([f"  drives: {{{drives}}}"] if drives else [])


HELD_SCALE = (
    "no measured signal shows its scale, so it is held at one: inertias, damping and stiffness are "
    "{} by it. Write its value if a data sheet has it"
)


def held_scales(rig: Model, sensors: Sequence[Sensor]) -> dict[str, str]:
    """Return why motor parameters that only scale all other parameters are held at one."""
    motors = rig.roles.motors
    factors = [name for m in motors for name in (m.torque_constant, m.supply, m.duty)]
    held = dict.fromkeys(factors, HELD_SCALE.format("divided"))
    if not any(sensor.kind == "current" for sensor in sensors):
        held |= {motor.resistance: HELD_SCALE.format("multiplied") for motor in motors}
    return held
