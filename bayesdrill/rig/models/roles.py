"""Roles: what a rig calls the speed of rotor 1, the friction at its motor, the stiffness of its shaft.

Whatever looks at a rig from outside asks for these, and knows no symbol by its spelling.  They are the
names of `basics.symbols` where a rig says nothing else; a role whose name is none of a rig's states,
inputs or parameters is one that it has not.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from operator import attrgetter


@dataclass(frozen=True, slots=True, kw_only=True)
class MotorRoles:
    """`angle`, `speed`: behind the gear; `voltage`, `torque`: inputs; `friction`: of constant sign;
    `static` friction is lost over the speed `fading`; `series`: a resistance; `drop`: a voltage.
    """

    angle: str = "theta_2"
    speed: str = "w_2"
    current: str = "i"
    voltage: str = "v"
    torque: str = "t_m"
    damping: str = "c_m"
    friction: str = "t_f"
    sliding: str = "t_cm"
    static: str = "t_sm"
    fading: str = "w_sm"
    back_emf: str = "k_e"
    torque_constant: str = "k_T"
    resistance: str = "r_m"
    series: str = "r_s"
    inductance: str = "l_m"
    drop: str = "v_d"
    efficiency: str = "eta"


@dataclass(frozen=True, slots=True, kw_only=True)
class ShaftRoles:
    stiffness: str = "k_s"
    damping: str = "c_s"


@dataclass(frozen=True, slots=True, kw_only=True)
class RotorRoles:
    """`load`: an input; `static` friction is lost over the speed `fading`."""

    angle: str = "theta_1"
    speed: str = "w_1"
    load: str = "t_1"
    inertia: str = "j_1"
    damping: str = "c_1"
    sliding: str = "t_c1"
    static: str = "t_s1"
    fading: str = "w_s1"


@dataclass(frozen=True, slots=True, kw_only=True)
class Roles:
    """`gear`: the field of the rig with its gear reduction factor, at most 1."""

    motor: MotorRoles = field(default_factory=MotorRoles)
    shaft: ShaftRoles = field(default_factory=ShaftRoles)
    rotor: RotorRoles = field(default_factory=RotorRoles)
    gear: str = "i_m"

    def __getitem__(self, role: str) -> str:
        """The name of a role such as `motor.speed`; raises `AttributeError` where there is none."""
        found: str = attrgetter(role)(self)
        return found

    def at(self, place: str) -> MotorRoles | RotorRoles:
        """`motor`, or `rotor_1`."""
        return self.motor if place == "motor" else self.rotor

    @property
    def speeds(self) -> Mapping[str, str]:
        """Of angles."""
        return {one.angle: one.speed for one in (self.rotor, self.motor)}


USUAL = Roles()
STATES = ("rotor.angle", "rotor.speed", "motor.angle", "motor.speed", "motor.current")
