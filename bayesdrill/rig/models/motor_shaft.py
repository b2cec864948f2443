"""Define the paper's rig (DC motor, gearbox, slender shaft, rotor), and rigs with fewer parts.

    theta_1' = w_1
    theta_2' = w_2
    w_1' = -(k_s/j_1)(theta_1 - theta_2) - t_1/j_1
    w_2' = (i_m^2 k_s/j_m)(theta_1 - theta_2) - (c_m/j_m) w_2 + (i_m k_T/j_m) i - i_m t_f/j_m
    i'   = -(k_e/(i_m l_m)) w_2 - (r_m/l_m) i + v/l_m

The equations are those of Sandoval, Cunha Jr and Sampaio (ENIEF 2013).  By these equations, two entries
of the matrix printed there are wrong: A(5,1) is `i_m^2 k_s/j_m` (the printed denominator is j_1),
and A(6,5) is `-k_e/(i_m l_m)` (printed `-i_n k_e/l_m`).  No other state depends on the charge `q`, so
it is omitted here.

The gearbox is rigid and without play, the shaft massless, and the sign of the friction `t_f` constant
(one-way rotation).  `t_1` is the load torque on rotor 1.  Parameters in `added` extend the equations:

    j_2    j_m + i_m^2 j_2 replaces j_m: an inertia at the output of the gearbox
    r_s    r_m + r_s replaces r_m
    c_s    k_s (theta_1 - theta_2) + c_s (w_1 - w_2) replaces k_s (theta_1 - theta_2)
    c_1    w_1' = ... - (c_1/j_1) w_1
    t_cm   w_2' = ... - (i_m/j_m) T; T opposes w_2, and |T| = t_cm.  With t_sm and w_sm, |T| follows
           Stribeck's law in the motor's speed w_2/i_m
    t_c1   w_1' = ... - T/j_1; T opposes w_1, and |T| = t_c1 or, with t_s1 and w_s1, by Stribeck's law
    v_d    i' = ... - (v_d/l_m) sgn i
    eta    |T| at the motor grows by (1/eta - 1) i_m k_s |theta_2 - theta_1|
    d_m    |T| at the motor grows by d_m (w_2/i_m)^2; likewise d_1: |T| at rotor 1 grows by d_1 w_1^2
    j_0, k_0
           w_1' = ... - (k_0/j_1)(theta_1 - theta_0) and w_0' = (k_0/j_0)(theta_1 - theta_0): a rotor 0
           beyond rotor 1; with c_0, c_0 (w_1 - w_0) is added to k_0 (theta_1 - theta_0)

In `two_rotors`, `j_2` and `r_s` are known.  With the motor's angle theta_3 = theta_2/i_m:

    l_m i' + (r_m + r_s) i + k_e theta_3' = v
    j_m theta_3'' + c_m theta_3' - k_T i + t_f = -i_m (k_s (theta_2 - theta_1) + j_2 theta_2'')

The second equation times i_m has the term (j_m + i_m^2 j_2) theta_2''.  A record determines only such
sums.  A `motor_shaft` has two scalings of its parameters that leave the response unchanged.  They
remain, but multiply these sums instead of j_m and r_m.

A `driven_shaft` has no motor: the motion of its upper end is measured, and the speed `w_2` of that end
is an input.  If an imposed angle is linear between samples, this speed is constant between samples.
For a drill string, `t_1` is the measured torque at the bit.  If the parameters of rock are `added`, the
torque at the bit is computed:

    b_0, b_1, b_2, b_3
           w_1' = ... - T/j_1; T opposes w_1, and `BitRock` gives |T| for the input `wob`

A `motor` has no shaft; `j_m` includes all parts that turn rigidly with the motor.  The input is a
measured torque `t_m` in place of k_T i or, if the circuit is named (`k_e k_T r_m l_m`), a voltage.
Angle and speed are those behind the gear, or the motor's own without a gear (`i_m` = 1, the default).
Parameters of the motor refer to the side before the gear.  `k_s`, `j_1`, `c_s` add a shaft and rotor 1.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Annotated, ClassVar, Literal

from pydantic import AfterValidator, Field

from bayesdrill.basics.entries import NonNegative, Positive
from bayesdrill.basics.symbols import Symbol
from bayesdrill.rig.models.equations import PartsModel, coordinate_inertia
from bayesdrill.rig.models.friction import Named
from bayesdrill.rig.models.linear import Linear, Model, Offers, ParameterNames, StateNames


def dry_friction(location: str) -> Offers:
    """Return the options of dry friction: sliding, and static friction that decays with speed."""
    sliding, static, fading = f"t_c{location}", f"t_s{location}", f"w_s{location}"
    return {sliding: (), static: (sliding, fading), fading: (sliding, static)}


def together(*names: str) -> Offers:
    """Return `names` as options, each of which requires all other names."""
    return {name: tuple(other for other in names if other != name) for name in names}


SHAFT = ("k_s", "j_1")
CIRCUIT, ROCK = ("k_e", "k_T", "r_m", "l_m"), ("b_0", "b_1", "b_2", "b_3")
PARAMETERS = ("j_m", "c_m", "k_e", "k_T", "r_m", "l_m", "k_s", "j_1", "t_f")
OFFERS: Offers = MappingProxyType(
    {
        **dict.fromkeys(("c_s", "j_2", "r_s", "c_1"), ()),
        **dry_friction("m"),
        **dry_friction("1"),
        **dict.fromkeys(("v_d", "eta", "d_m", "d_1"), ()),
    }
)
BEYOND = ("k_0", "j_0")  # a rotor beyond rotor 1
ROTOR_0: Offers = MappingProxyType({**together(*BEYOND), "c_0": BEYOND})
ITS_STATES: Mapping[tuple[str, ...], tuple[str, ...]] = MappingProxyType(
    {BEYOND: ("theta_0", "w_0")}
)


def _slows(i_m: float) -> float:
    if i_m > 1:
        raise ValueError(
            f"{i_m:g} would make the shaft turn {i_m:g} times as fast as the motor; is a reduction of "
            f"{i_m:g}:1 meant? Then write {1 / i_m:.6g}"
        )
    return i_m


Gear = Annotated[
    Positive,
    AfterValidator(_slows),
    Field(description="Gear reduction factor, at most 1 (8:1 is 0.125)."),
]
Power = Annotated[
    Literal[1, 2], Field(description="Of the speed in the exponential of static friction.")
]


@dataclass(frozen=True, slots=True)
class MotorShaft(PartsModel):
    """The paper's rig has a DC motor with a gear, which drives a rotor through a shaft.

    `i_m` is the gear reduction factor: theta_2 = i_m theta_3, with theta_3 the motor's angle.
    `stribeck` is the power of the speed in Stribeck's law. `added` has the names of further
    parameters, among those that the rig `offers`.
    """

    i_m: Gear = 1 / 8
    stribeck: Power = 1
    added: tuple[str, ...] = ()

    name: ClassVar[str] = "motor_shaft"
    offers: ClassVar[Offers] = MappingProxyType({**OFFERS, **ROTOR_0})
    parameters: ClassVar[ParameterNames] = ParameterNames(PARAMETERS)
    states: ClassVar[StateNames] = StateNames(("theta_1", "theta_2", "w_1", "w_2", "i"), ITS_STATES)
    inputs: ClassVar[tuple[str, ...]] = ("v", "t_1")


@dataclass(frozen=True, slots=True)
class DrivenShaft(PartsModel):
    """The upper end of the shaft has a prescribed motion; see `MotorShaft` for the fields."""

    stribeck: Power = 1
    added: tuple[str, ...] = ()

    name: ClassVar[str] = "driven_shaft"
    offers: ClassVar[Offers] = MappingProxyType(
        {"c_s": (), "c_1": (), **dry_friction("1"), "d_1": (), **together(*ROCK), **ROTOR_0}
    )
    parameters: ClassVar[ParameterNames] = ParameterNames(("k_s", "j_1"))
    states: ClassVar[StateNames] = StateNames(("theta_1", "theta_2", "w_1"), ITS_STATES)

    @property
    def inputs(self) -> tuple[str, ...]:
        """Return the imposed speed, the load torque and, for a bit, the weight on it."""
        return ("w_2", "t_1", "wob") if {*ROCK} <= {*self.added} else ("w_2", "t_1")


@dataclass(frozen=True, slots=True)
class Motor(PartsModel):
    """The motor has a shaft only if it is `added`; all fields are as in a `MotorShaft`."""

    i_m: Gear = 1.0
    stribeck: Power = 1
    added: tuple[str, ...] = ()

    name: ClassVar[str] = "motor"
    offers: ClassVar[Offers] = MappingProxyType(
        {
            **together(*CIRCUIT),
            **dict.fromkeys(("t_f", "j_2"), ()),
            "r_s": CIRCUIT,
            **dry_friction("m"),
            "v_d": CIRCUIT,
            "d_m": (),
            **together(*SHAFT),
            "c_s": SHAFT,
        }
    )
    parameters: ClassVar[ParameterNames] = ParameterNames(("j_m", "c_m"))
    states: ClassVar[StateNames] = StateNames(
        ("theta_2", "w_2"), {CIRCUIT: ("i",), SHAFT: ("theta_1", "w_1")}
    )

    @property
    def inputs(self) -> tuple[str, ...]:
        """Return the voltage of the circuit or, without a circuit, the torque."""
        return ("v",) if {*CIRCUIT} <= {*self.added} else ("t_m",)


@dataclass(frozen=True, slots=True)
class TwoRotors(Model):
    """The rig is a `MotorShaft` whose second rotor and series resistor have known values.

    `i_m` is as in `MotorShaft`; `j_2` [kg m^2] and `r_s` [ohm] may be zero.
    """

    i_m: Gear = 1 / 8
    j_2: Annotated[
        NonNegative, Field(description="Inertia at the output of the gearbox [kg m^2].")
    ] = 0.0
    r_s: Annotated[NonNegative, Field(description="Resistance in series with the motor [ohm].")] = (
        0.0
    )

    name: ClassVar[str] = "two_rotors"
    declares: ClassVar[tuple[Symbol, ...]] = ()
    parameters: ClassVar[tuple[str, ...]] = PARAMETERS
    states: ClassVar[tuple[str, ...]] = MotorShaft.states
    inputs: ClassVar[tuple[str, ...]] = MotorShaft.inputs

    def whole(self, p: Named) -> Named:
        """Return the parameters of the equivalent `motor_shaft` without options."""
        held = self._held(p)
        return {**p, "j_m": coordinate_inertia(self._rig, "w_2", held), "r_m": p["r_m"] + self.r_s}

    def linear(self, p: Named) -> Linear:
        """See `Model.linear`."""
        return self._rig.linear(self._held(p))

    @property
    def _rig(self) -> MotorShaft:
        return MotorShaft(self.i_m, added=("j_2", "r_s"))

    def _held(self, p: Named) -> Named:
        return {**p, "j_2": self.j_2, "r_s": self.r_s}
