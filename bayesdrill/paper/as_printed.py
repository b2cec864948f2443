"""The matrix that the paper prints, with its two errors: to see what they do, never to be believed.

    w_2' = (i_m^2 k_s/j_1) theta_1 - (i_m^2 k_s/j_m) theta_2 - (c_m/j_m) w_2 + (i_m k_T/j_m) i
           - i_m t_f/j_m
    i'   = -(i_n k_e/l_m) w_2 - (r_m/l_m) i + v/l_m

Sandoval, Cunha Jr and Sampaio (ENIEF 2013), the matrix below the state vector; the other rows are
those of `motor_shaft`.  Wrong in it, by the paper's own equations:

A(5,1)  stands over j_1; the equation of the second angle has j_m, as has A(5,2) beside it.  With
        j_1 the shaft pulls at the motor although it is not twisted, as if a spring held the motor
        to the room: the rig stops after 14 turns, its motor stalled with the current v/r_m.
A(6,5)  has `i_n`, which the paper does not define.  The motor's speed is w_2/i_m, so 1/i_m is
        right; `i_n` read as `i_m`, the only similar symbol, makes the counter-voltage i_m^2 (1/64)
        of what it is.

Speeds in rad/s at the nominal values and 8 V, from rest:

    A(5,1) over   A(6,5) with   w_1, w_2 at 10 s   w_2 at 30 s   both in the end
    j_m           1/i_m             13.4,   16.3         15.90     15.91   right
    j_1           1/i_m             -4.5,    2.6          0.07      0      (w_1 swings for minutes)
    j_m           i_m              661.1,  658.1        660.3     660.3
    j_1           i_m             -244.3,   10.8         -0.4       0      as printed
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from bayesdrill.basics import Positive, Symbol
from bayesdrill.rig import Gear, Linear, Model, MotorShaft, Named


@dataclass(frozen=True, slots=True)
class AsPrinted(Model):
    """`i_n` None: read as `i_m`; 1/i_m is right.  `a_51`: what A(5,1) stands over; j_m is right."""

    i_m: Gear = 1 / 8
    i_n: Annotated[
        Positive | None, Field(description="The undefined factor in A(6,5); without it: i_m.")
    ] = None
    a_51: Annotated[Literal["j_1", "j_m"], Field(description="What A(5,1) stands over.")] = "j_1"

    name: ClassVar[str] = "as_printed"
    declares: ClassVar[tuple[Symbol, ...]] = ()
    parameters: ClassVar[tuple[str, ...]] = MotorShaft.parameters
    states: ClassVar[tuple[str, ...]] = MotorShaft.states
    inputs: ClassVar[tuple[str, ...]] = MotorShaft.inputs

    def linear(self, p: Named) -> Linear:
        right = MotorShaft(self.i_m).linear(p)
        i_n = self.i_m if self.i_n is None else self.i_n
        printed = {
            ("w_2", "theta_1"): self.i_m**2 * p["k_s"] / p[self.a_51],
            ("i", "w_2"): -i_n * p["k_e"] / p["l_m"],
        }
        return Linear(A={**right.A, **printed}, B=right.B, c=right.c)
