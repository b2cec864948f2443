"""What moves: models of rigs, kernels compiled from them, the exact response."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bayesdrill.basics.late import late

if TYPE_CHECKING:
    from bayesdrill.rig.models.driven_shaft import DrivenShaft as DrivenShaft
    from bayesdrill.rig.models.friction import BitRock as BitRock
    from bayesdrill.rig.models.friction import Both as Both
    from bayesdrill.rig.models.friction import Coulomb as Coulomb
    from bayesdrill.rig.models.friction import Friction as Friction
    from bayesdrill.rig.models.friction import Stribeck as Stribeck
    from bayesdrill.rig.models.linear import Linear as Linear
    from bayesdrill.rig.models.linear import Model as Model
    from bayesdrill.rig.models.linear import Named as Named
    from bayesdrill.rig.models.long_shaft import LongShaft as LongShaft
    from bayesdrill.rig.models.motor import Motor as Motor
    from bayesdrill.rig.models.motor_shaft import Gear as Gear
    from bayesdrill.rig.models.motor_shaft import MotorShaft as MotorShaft
    from bayesdrill.rig.models.roles import MotorRoles as MotorRoles
    from bayesdrill.rig.models.roles import Roles as Roles
    from bayesdrill.rig.models.roles import RotorRoles as RotorRoles
    from bayesdrill.rig.models.roles import ShaftRoles as ShaftRoles
    from bayesdrill.rig.models.two_rotors import TwoRotors as TwoRotors
    from bayesdrill.rig.response import Response as Response

__getattr__ = late(
    __name__,
    {
        "BitRock": "models.friction",
        "Both": "models.friction",
        "Coulomb": "models.friction",
        "DrivenShaft": "models.driven_shaft",
        "Friction": "models.friction",
        "Gear": "models.motor_shaft",
        "Linear": "models.linear",
        "LongShaft": "models.long_shaft",
        "Model": "models.linear",
        "Motor": "models.motor",
        "MotorRoles": "models.roles",
        "MotorShaft": "models.motor_shaft",
        "Named": "models.linear",
        "Response": "response",
        "Roles": "models.roles",
        "RotorRoles": "models.roles",
        "ShaftRoles": "models.roles",
        "Stribeck": "models.friction",
        "TwoRotors": "models.two_rotors",
    },
)
