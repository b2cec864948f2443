"""The paper's rig and two things that its model leaves out, both known constants.

j_2   inertia at the output side of the gearbox: rotor 2, the gear, the coupling
r_s   resistance in series with the motor: driver, leads, brushes

    l_m i' + (r_m + r_s) i + k_e theta_3' = v
    j_m theta_3'' + c_m theta_3' - k_T i + t_f = -i_m t_2
    t_2 = k_s (theta_2 - theta_1) + j_2 theta_2''              theta_2 = i_m theta_3
    j_1 theta_1'' + k_s (theta_1 - theta_2) = -t_1

Times i_m, the second equation with the third in it has (j_m + i_m^2 j_2) theta_2'': the rig is a
`motor_shaft` with that inertia and with the resistance r_m + r_s.  So a record shows no more of it:
both scales of a `motor_shaft` stay open, though they are no common factors here.

It is the `motor_shaft` to which both are added, held: one that may have a prior is named there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from pydantic import Field

from bayesdrill.basics.entries import NonNegative
from bayesdrill.basics.symbols import Symbol
from bayesdrill.rig.models.linear import Linear, Model, Named
from bayesdrill.rig.models.motor_shaft import PARAMETERS, Gear, MotorShaft


@dataclass(frozen=True, slots=True)
class TwoRotors(Model):
    """`i_m` as in `MotorShaft`; `j_2` [kg m^2] and `r_s` [ohm] may be zero."""

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
        """Parameters of the plain `motor_shaft` which this rig is."""
        lumped = MotorShaft(self.i_m, added=("j_2", "r_s")).lumped(self._held(p))
        return {name: lumped[name] for name in p}

    def linear(self, p: Named) -> Linear:
        return MotorShaft(self.i_m, added=("j_2", "r_s")).linear(self._held(p))

    def _held(self, p: Named) -> Named:
        return {**p, "j_2": self.j_2, "r_s": self.r_s}
