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
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from pydantic import Field

from bayesdrill.basics.entries import NonNegative
from bayesdrill.basics.symbols import Symbol
from bayesdrill.rig.models.linear import Linear, Named
from bayesdrill.rig.models.motor_shaft import PARAMETERS, Gear, MotorShaft


@dataclass(frozen=True, slots=True)
class TwoRotors:
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

    def _added(self) -> dict[str, float]:
        """To the motor's own values, what the rest of the rig adds to them."""
        return {"j_m": self.i_m**2 * self.j_2, "r_m": self.r_s}

    def whole(self, p: Named) -> Named:
        """Parameters of the `motor_shaft` which this rig is."""
        return {**p, **{name: p[name] + constant for name, constant in self._added().items()}}

    def linear(self, p: Named) -> Linear:
        return MotorShaft(self.i_m).linear(self.whole(p))
