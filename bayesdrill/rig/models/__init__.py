"""The registry of rigs: one file and one line here, or an entry point `bayesdrill.rig`."""

from __future__ import annotations

from bayesdrill.basics.registry import Registry
from bayesdrill.rig.models.driven_shaft import DrivenShaft
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.models.long_shaft import LongShaft
from bayesdrill.rig.models.motor import Motor
from bayesdrill.rig.models.motor_shaft import MotorShaft
from bayesdrill.rig.models.trial import tried
from bayesdrill.rig.models.two_rotors import TwoRotors

_RIGS: dict[str, type[Model]] = {
    "motor_shaft": MotorShaft,
    "two_rotors": TwoRotors,
    "driven_shaft": DrivenShaft,
    "motor": Motor,
    "long_shaft": LongShaft,
}
MODELS: Registry[type[Model]] = Registry("rig", _RIGS, judge=tried)
