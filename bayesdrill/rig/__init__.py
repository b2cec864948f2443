"""Compute how a rig moves: models of rigs, compiled kernels, and simulators.

`models/` has the equations of motion, `kernels/` writes machine code, and `simulators/` computes
the response of the channels at given parameters. `compression/` reduces a long record to a few
hundred numbers. Priors, noise and densities are in `inference`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from bayesdrill.basics.registry import lazy_attributes

if TYPE_CHECKING:
    from bayesdrill.rig.models.friction import BitRock as BitRock
    from bayesdrill.rig.models.friction import CombinedLaw as CombinedLaw
    from bayesdrill.rig.models.friction import Coulomb as Coulomb
    from bayesdrill.rig.models.friction import Friction as Friction
    from bayesdrill.rig.models.friction import Named as Named
    from bayesdrill.rig.models.friction import Stribeck as Stribeck
    from bayesdrill.rig.models.linear import Linear as Linear
    from bayesdrill.rig.models.linear import Model as Model
    from bayesdrill.rig.models.linear import constant_forcing as constant_forcing
    from bayesdrill.rig.models.linear import dynamics as dynamics
    from bayesdrill.rig.models.long_shaft import LongShaft as LongShaft
    from bayesdrill.rig.models.motor_shaft import DrivenShaft as DrivenShaft
    from bayesdrill.rig.models.motor_shaft import Gear as Gear
    from bayesdrill.rig.models.motor_shaft import Motor as Motor
    from bayesdrill.rig.models.motor_shaft import MotorShaft as MotorShaft
    from bayesdrill.rig.models.motor_shaft import TwoRotors as TwoRotors
    from bayesdrill.rig.models.roles import InertiaRoles as InertiaRoles
    from bayesdrill.rig.models.roles import MotorRoles as MotorRoles
    from bayesdrill.rig.models.roles import Roles as Roles
    from bayesdrill.rig.models.roles import ShaftRoles as ShaftRoles
    from bayesdrill.rig.models.roles import usual_roles as usual_roles
    from bayesdrill.rig.models.train import Train as Train
    from bayesdrill.rig.simulators.linear import Response as Response

__getattr__ = lazy_attributes(__name__)
