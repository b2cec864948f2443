"""The paper's rig: DC motor, gearbox, slender shaft, rotor.

    theta_1' = w_1
    theta_2' = w_2
    w_1' = -(k_s/j_1)(theta_1 - theta_2) - t_1/j_1
    w_2' = (i_m^2 k_s/j_m)(theta_1 - theta_2) - (c_m/j_m) w_2 + (i_m k_T/j_m) i - i_m t_f/j_m
    i'   = -(k_e/(i_m l_m)) w_2 - (r_m/l_m) i + v/l_m

Sandoval, Cunha Jr and Sampaio (ENIEF 2013), equations for motor, gearbox and rotors.  The matrix
printed there has two errors that its own equations correct: A(5,1) is `i_m^2 k_s/j_m` (printed
over j_1) and A(6,5) is `-k_e/(i_m l_m)` (printed `-i_n k_e/l_m`).  What they do shows in
`as_printed`.  The charge `q` never feeds back and is left out here.

Assumes: rigid gearbox without loss or play, massless and undamped shaft, friction `t_f` of
constant sign (one-way rotation), `t_1` the load torque on rotor 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from pydantic import AfterValidator, Field

from bayesdrill.basics.entries import Positive
from bayesdrill.basics.symbols import Symbol
from bayesdrill.rig.models.linear import Linear, Named

PARAMETERS = ("j_m", "c_m", "k_e", "k_T", "r_m", "l_m", "k_s", "j_1", "t_f")


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


@dataclass(frozen=True, slots=True)
class MotorShaft:
    """`i_m` is the gear reduction factor: theta_2 = i_m theta_3, with theta_3 the motor's angle."""

    i_m: Gear = 1 / 8

    name: ClassVar[str] = "motor_shaft"
    declares: ClassVar[tuple[Symbol, ...]] = ()
    parameters: ClassVar[tuple[str, ...]] = PARAMETERS
    states: ClassVar[tuple[str, ...]] = ("theta_1", "theta_2", "w_1", "w_2", "i")
    inputs: ClassVar[tuple[str, ...]] = ("v", "t_1")

    def linear(self, p: Named) -> Linear:
        i_m = self.i_m
        j_m, c_m, k_e, k_T = p["j_m"], p["c_m"], p["k_e"], p["k_T"]
        r_m, l_m, k_s, j_1, t_f = p["r_m"], p["l_m"], p["k_s"], p["j_1"], p["t_f"]
        rotor = k_s / j_1
        shaft = i_m**2 * k_s / j_m
        return Linear(
            A={
                ("theta_1", "w_1"): 1.0,
                ("theta_2", "w_2"): 1.0,
                ("w_1", "theta_1"): -rotor,
                ("w_1", "theta_2"): rotor,
                ("w_2", "theta_1"): shaft,
                ("w_2", "theta_2"): -shaft,
                ("w_2", "w_2"): -c_m / j_m,
                ("w_2", "i"): i_m * k_T / j_m,
                ("i", "w_2"): -k_e / (i_m * l_m),
                ("i", "i"): -r_m / l_m,
            },
            B={("w_1", "t_1"): -1.0 / j_1, ("i", "v"): 1.0 / l_m},
            c={"w_2": -i_m * t_f / j_m},
        )
