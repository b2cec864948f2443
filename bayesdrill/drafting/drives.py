"""What can drive a rig that is seen to move, and which of several voltages does."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from bayesdrill.drafting.columns import MOTOR, TWIST
from bayesdrill.drafting.signals import Sensor

DRIVES = ("voltage", "current", "torque", "force")  # kinds
BOTH_WAYS, CLEARLY_BOTH_WAYS = 0.1, 0.3  # of what goes one way, that goes the other way
SUPPLY_RIPPLE = 0.1  # of a voltage, within which it is nearly constant


def question_drives(sensors: Sequence[Sensor]) -> tuple[list[Sensor], dict[str, str]]:
    """Doubt what cannot drive a rig that turns both ways; supplies are left out, with the reason."""
    moving = [s for s in sensors if s.kind not in DRIVES and s.location != TWIST]
    if not any_reverses(moving, CLEARLY_BOTH_WAYS):
        return list(sensors), {}
    kept, left_out = list[Sensor](), dict[str, str]()
    for sensor in sensors:
        low, middle, high = np.quantile(sensor.raw.x, (0.05, 0.5, 0.95))
        doubt = ""
        if sensor.kind == "voltage" and high - low < SUPPLY_RIPPLE * abs(middle):
            doubt = f"hardly changes ({low:.4g} to {high:.4g}) while the rig turns both ways: "
            doubt += "a supply, not what the motor gets"
        elif sensor.kind == "current" and (sensor.raw.x.min() >= 0 or sensor.raw.x.max() <= 0):
            doubt = "never changes its sign while the rig turns both ways: is it the size alone? "
            doubt += "Then it is no channel: leave it out"
        if sensor.kind == "voltage" and doubt and not sensor.column.meaning.typed:
            left_out[sensor.name] = doubt
        else:
            kept.append(sensor.revised(doubt=doubt and f"it {doubt}"))
    return kept, left_out


def any_reverses(sensors: Iterable[Sensor], share: float = BOTH_WAYS) -> bool:
    """Whether a drive or a motion goes both ways, the other way by this share of the larger one."""
    return any(_reverses(sensor, share) for sensor in sensors)


def _reverses(sensor: Sensor, share: float) -> bool:
    x, apart = sensor.raw.x, max(1, len(sensor.raw.x) // 200)
    if sensor.kind in ("angle", "position"):
        x = x[apart:] - x[:-apart]
    low, high = np.percentile(x, [2, 98])
    return bool(min(-low, high) > share * max(-low, high))


def voltage_rank(voltage: Sensor) -> tuple[bool, bool, int]:
    """Measured before asked for, the motor's before others; `v` [V] and words before `u` and `v1`."""
    meaning, name = voltage.column.meaning, voltage.name.lower()
    by_name = (bool(meaning.unit), len(meaning.word) > 1, name == "v", name == "u", True)
    return meaning.reference, voltage.location != MOTOR, by_name.index(True)
