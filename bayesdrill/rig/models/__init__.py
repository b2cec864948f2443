"""The registry of rigs: one file and one line here, or an entry point `bayesdrill.rig`."""

from __future__ import annotations

from bayesdrill.basics.registry import Registry
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.models.motor_shaft import MotorShaft
from bayesdrill.rig.models.trial import tried
from bayesdrill.rig.models.two_rotors import TwoRotors

MODELS: Registry[type[Model]] = Registry(
    "rig", {"motor_shaft": MotorShaft, "two_rotors": TwoRotors}, judge=tried
)
