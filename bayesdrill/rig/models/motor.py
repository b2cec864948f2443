"""A motor alone, with whatever turns rigidly with it: driven by a measured torque, or by a voltage.

    theta_2' = w_2
    w_2' = -(c_m/j_m) w_2 + (i_m/j_m) t_m                  t_m: the torque of the motor, an input

Where the motor's circuit is named (`k_e k_T r_m l_m`) a voltage drives it, and `t_m` is k_T i:

    w_2' = -(c_m/j_m) w_2 + (i_m k_T/j_m) i
    i'   = -(k_e/(i_m l_m)) w_2 - (r_m/l_m) i + v/l_m

Angle and speed are those behind the gear, as in `motor_shaft`: of a motor without one (`i_m` 1, which is
the default here) its own.  All parameters are at the motor, before the gear.  What else is `added`:

    t_f    w_2' = ... - i_m t_f/j_m: friction of constant sign
    j_2    j_m + i_m^2 j_2 in the place of j_m
    r_s    r_m + r_s in the place of r_m
    t_cm   w_2' = ... - (i_m/j_m) T, |T| = t_cm against w_2; with t_sm and w_sm by Stribeck's law, whose
           speed is that of the motor, w_2/i_m
    v_d    i' = ... - (v_d/l_m) sgn i
"""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar

from bayesdrill.rig.models.equations import PartsModel
from bayesdrill.rig.models.linear import Offers, ParameterNames
from bayesdrill.rig.models.motor_shaft import Gear, Power, dry_friction, together

CIRCUIT = ("k_e", "k_T", "r_m", "l_m")
OFFERS: Offers = MappingProxyType(
    {
        **together(*CIRCUIT),
        "t_f": (),
        "j_2": (),
        "r_s": CIRCUIT,
        **dry_friction("m"),
        "v_d": CIRCUIT,
    }
)


@dataclass(frozen=True, slots=True)
class Motor(PartsModel):
    """A motor without a shaft; `i_m`, `stribeck`, `added`: as of a `MotorShaft`."""

    i_m: Gear = 1.0
    stribeck: Power = 1
    added: tuple[str, ...] = ()

    name: ClassVar[str] = "motor"
    offers: ClassVar[Offers] = OFFERS
    parameters: ClassVar[ParameterNames] = ParameterNames(("j_m", "c_m"))

    @property
    def states(self) -> tuple[str, ...]:
        """Angle, speed and, with a circuit, the current."""
        return ("theta_2", "w_2", "i") if self._wired else ("theta_2", "w_2")

    @property
    def inputs(self) -> tuple[str, ...]:
        """The voltage of its circuit, or else its torque."""
        return ("v",) if self._wired else ("t_m",)

    @property
    def _wired(self) -> bool:
        return {*CIRCUIT} <= {*self.added}
