"""Roles are the names of a rig's inertias, shafts and motors, and of their parameters and states.

All code outside a rig asks for these roles, and never interprets the spelling of a symbol. If a
name is empty, or is no state, input or parameter of the rig, the rig does not have this quantity.
For a rig that moves along a line, an inertia is a mass, a torque a force, an angle a position.
"""

from __future__ import annotations

import functools
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from bayesdrill.basics.symbols import Symbol

GROUND = "ground"  # the end of a shaft that does not move

# Power p by unit: a quantity at the load, times (reduction factor)^p, is referred to the motor.
GEAR_POWERS: Mapping[str, int] = MappingProxyType(
    {"kg*m**2": 2, "N*m*s/rad": 2, "N*m/rad": 2, "N*m": 1, "rad/s": -1, "N*m*s**2/rad**2": 3}
)


@dataclass(frozen=True, slots=True)
class MotionWords:
    """These are the words and units in sentences about a rotary or a linear motion."""

    verb: str
    torque: str
    newtons: str
    angle: str


ROTARY = MotionWords("turns", "torque", "N m", "rad")
MOTIONS: Mapping[str, MotionWords] = MappingProxyType(
    {"rotary": ROTARY, "linear": MotionWords("moves", "force", "N", "m")}
)


@dataclass(frozen=True, slots=True, kw_only=True)
class InertiaRoles:
    """The roles of an inertia are the names of its states, inputs and parameters.

    `name` is its name in configs, and `words` its name in sentences (`the motor`).

    `angle` and `speed` are states: `reduction` times the angle and speed of the inertia itself. An
    imposed `speed` is an input instead. `friction` is a constant torque backwards. `sliding` and
    `static` are dry friction; their difference decays with the speed scale `fading`. `drag` times
    the squared speed is a torque. `sliding_back`, `static_back` and `damping_back` are the values for
    backward motion if they differ. Of the input torques, `torque` pushes forwards and `load`
    backwards. `efficiency` is that of the gear that the inertia drives, and `efficiency_back` the
    efficiency while the load drives. `weight` is the largest torque of gravity; this torque is zero
    at the angle -`tilt`. `cutting` has the coefficients of the rock that the inertia cuts under the
    weight `bit_weight`, an input. `effort` is the symbol of the dry friction. `latex` is the symbol of
    the inertia's own angle if this angle is no state.
    """

    name: str
    words: str
    angle: str
    speed: str
    latex: str = ""
    reduction: float = 1.0
    inertia: str = ""
    damping: str = ""
    friction: str = ""
    sliding: str = ""
    static: str = ""
    fading: str = ""
    drag: str = ""
    torque: str = ""
    load: str = ""
    efficiency: str = ""
    sliding_back: str = ""
    static_back: str = ""
    damping_back: str = ""
    efficiency_back: str = ""
    weight: str = ""
    tilt: str = ""
    cutting: tuple[str, ...] = ()
    bit_weight: str = ""
    effort: Symbol | None = None

    @property
    def at(self) -> str:
        """Return the location of the inertia in words, such as `at rotor 1`."""
        return f"at {self.words}"


@dataclass(frozen=True, slots=True, kw_only=True)
class ShaftRoles:
    """The roles of a shaft are the names of its parameters; its `ends` are inertias or `GROUND`.

    `words` is the name of the shaft in sentences, such as `the shaft`.
    """

    name: str
    words: str
    ends: tuple[str, str]
    stiffness: str
    damping: str = ""
    inertia: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class MotorRoles:
    """The roles of a motor name the quantities of its circuit; the motor turns an `inertia`.

    `current` is a state or an input, `voltage` an input. `series` is a second resistance. `drop` is a
    voltage that opposes the current, and `effort` its symbol. A servo has the input `goal` in place of
    a voltage, and the parameters that `models.servo` explains. `supply` is an input if `usual_supply`
    [V] is not zero, otherwise a parameter.
    """

    inertia: str
    words: str = "the motor"
    current: str = ""
    voltage: str = ""
    torque_constant: str = ""
    back_emf: str = ""
    resistance: str = ""
    series: str = ""
    inductance: str = ""
    drop: str = ""
    effort: Symbol | None = None
    goal: str = ""
    supply: str = ""
    usual_supply: float = 0.0
    duty: str = ""
    proportional: str = ""
    derivative: str = ""
    limit: str = ""
    band: str = ""
    goal_speed: str = ""

    def is_limited(self, names: Collection[str]) -> bool:
        """Return whether a servo with the parameters `names` is nonlinear or has a measured supply."""
        limits = {self.limit, self.band, self.goal_speed} - {""}
        return self.usual_supply > 0.0 or not limits.isdisjoint(names)


@dataclass(frozen=True, slots=True, kw_only=True)
class Roles:
    """The roles of a rig are those of its parts.

    `gear` is the name of the field with the gear reduction factor, empty without a gear.
    """

    inertias: tuple[InertiaRoles, ...] = ()
    shafts: tuple[ShaftRoles, ...] = ()
    motors: tuple[MotorRoles, ...] = ()
    gear: str = ""
    motion: MotionWords = ROTARY

    def inertia(self, name: str) -> InertiaRoles:
        """Return the inertia of this name; raises `KeyError` if there is none."""
        return {inertia.name: inertia for inertia in self.inertias}[name]

    def motor(self, inertia: str) -> MotorRoles | None:
        """Return the motor that turns an inertia, or None."""
        return next((motor for motor in self.motors if motor.inertia == inertia), None)

    def moving(
        self, states: Collection[str], parameters: Collection[str]
    ) -> dict[str, list[InertiaRoles]]:
        """Return for each speed in `states` the inertias with this speed, if `parameters` has them."""
        moving: dict[str, list[InertiaRoles]] = {}
        for inertia in self.inertias:
            if inertia.speed in states and inertia.inertia in parameters:
                moving.setdefault(inertia.speed, []).append(inertia)
        return moving

    def at_friction(self, against: str, where: str = "") -> InertiaRoles | None:
        """Among inertias with the speed `against`, return the one at `where` or else the first."""
        joined = [inertia for inertia in self.inertias if inertia.speed == against]
        return next((inertia for inertia in joined if inertia.at == where), (*joined, None)[0])

    def moved(self, drive: str) -> tuple[InertiaRoles, str] | None:
        """Return the inertia that an input drives, and the kind of input, such as `voltage`."""
        for inertia in self.inertias:
            motor = self.motor(inertia.name)
            for how, name in (("torque", inertia.torque), ("speed", inertia.speed)):
                if name == drive:
                    return inertia, how
            if motor is not None and drive in (motor.voltage, motor.current):
                return inertia, "voltage" if drive == motor.voltage else "current"
            if motor is not None and drive == motor.goal:
                return inertia, "goal"
        return None

    @property
    def speeds(self) -> Mapping[str, str]:
        """Map the name of each angle to the name of its speed."""
        return {inertia.angle: inertia.speed for inertia in self.inertias}

    @property
    def states(self) -> frozenset[str]:
        """Return the names of all angles, speeds and currents."""
        moving = {name for i in self.inertias for name in (i.angle, i.speed)}
        return frozenset(moving | {motor.current for motor in self.motors})

    def side(self, name: str) -> str:
        """Return on which side of the gear a parameter is: `motor`, `load`, or empty for neither."""
        driven = {motor.inertia for motor in self.motors}
        for i in self.inertias if self.gear else ():
            if name in (i.inertia, i.damping, i.friction, i.sliding, i.static, i.fading, i.drag):
                return "motor" if i.name in driven else "load"
        shafts = {n for s in self.shafts for n in (s.stiffness, s.damping, s.inertia)}
        return "load" if self.gear and name in shafts else ""


FRICTION_M = Symbol("friction_m", "N*m", "T_m", r"N\,m", "friction at the motor")
FRICTION_1 = Symbol("friction_1", "N*m", "T_1", r"N\,m", "friction at rotor 1")
DROP = Symbol("drop", "V", r"v_d", "V", "voltage drop")


GEARBOX = InertiaRoles(
    name="gearbox", words="the gearbox", angle="theta_2", speed="w_2", inertia="j_2"
)
ROTOR_1 = InertiaRoles(
    name="rotor_1", words="rotor 1", angle="theta_1", speed="w_1", inertia="j_1", damping="c_1",
    sliding="t_c1", static="t_s1", fading="w_s1", drag="d_1", load="t_1",
    cutting=("b_0", "b_1", "b_2", "b_3"), bit_weight="wob", effort=FRICTION_1,
)  # fmt: skip
ROTOR_0 = InertiaRoles(name="rotor_0", words="rotor 0", angle="theta_0", speed="w_0", inertia="j_0")
SHAFT = ShaftRoles(
    name="shaft", words="the shaft", ends=("gearbox", "rotor_1"), stiffness="k_s", damping="c_s",
    inertia="j_s",
)  # fmt: skip
SHAFT_0 = ShaftRoles(
    name="shaft_0", words="the shaft to rotor 0", ends=("rotor_1", "rotor_0"), stiffness="k_0",
    damping="c_0",
)  # fmt: skip
CIRCUIT = MotorRoles(
    inertia="motor", current="i", voltage="v", torque_constant="k_T", back_emf="k_e",
    resistance="r_m", series="r_s", inductance="l_m", drop="v_d", effort=DROP,
)  # fmt: skip


@functools.cache
def usual_roles(i_m: float = 1.0, gear: str = "i_m") -> Roles:
    """Return the roles of the paper's rig, with the symbols of `basics.symbols`."""
    motor = InertiaRoles(
        name="motor", words="the motor", angle="theta_2", speed="w_2", latex=r"\theta_3",
        reduction=i_m, inertia="j_m", damping="c_m", friction="t_f", sliding="t_cm", static="t_sm",
        fading="w_sm", drag="d_m", torque="t_m", efficiency="eta", effort=FRICTION_M,
    )  # fmt: skip
    inertias = (motor, GEARBOX, ROTOR_1, ROTOR_0)
    return Roles(inertias=inertias, shafts=(SHAFT, SHAFT_0), motors=(CIRCUIT,), gear=gear)
