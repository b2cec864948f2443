"""A shaft whose upper end is moved as it was measured, and a rotor: no motor.

    theta_1' = w_1
    theta_2' = w_2                                         w_2: the speed that is imposed, an input
    w_1' = -(k_s/j_1)(theta_1 - theta_2) - t_1/j_1

`t_1` is the load torque on rotor 1: of a drill string the torque at the bit, measured or, where its
law is `added`, computed.  What is `added`:

    c_s    k_s (theta_1 - theta_2) + c_s (w_1 - w_2) in the place of k_s (theta_1 - theta_2)
    c_1    w_1' = ... - (c_1/j_1) w_1
    t_c1   w_1' = ... - T/j_1, |T| = t_c1 against w_1; with t_s1 and w_s1 by Stribeck's law
    b_0, b_1, b_2, b_3
           w_1' = ... - T/j_1 against w_1, T = W b_0 (tanh(b_1 |w_1|) + b_2 |w_1| / (1 + b_3 w_1^2)),
           where the input `wob` is the weight W on the bit

An angle that is imposed, straight from sample to sample, is the speed that is constant between
them.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar

from bayesdrill.rig.models.equations import PartsModel
from bayesdrill.rig.models.linear import Offers, ParameterNames
from bayesdrill.rig.models.motor_shaft import Power, dry_friction, together

ROCK = ("b_0", "b_1", "b_2", "b_3")
OFFERS: Offers = MappingProxyType({"c_s": (), "c_1": (), **dry_friction("1"), **together(*ROCK)})


@dataclass(frozen=True, slots=True)
class DrivenShaft(PartsModel):
    """A shaft driven at its upper end; `stribeck`, `added`: as of a `MotorShaft`."""

    stribeck: Power = 1
    added: tuple[str, ...] = ()

    name: ClassVar[str] = "driven_shaft"
    offers: ClassVar[Offers] = OFFERS
    parameters: ClassVar[ParameterNames] = ParameterNames(("k_s", "j_1"))
    states: ClassVar[tuple[str, ...]] = ("theta_1", "theta_2", "w_1")

    @property
    def inputs(self) -> tuple[str, ...]:
        """The imposed speed, the load torque and, of a bit, the weight on it."""
        return ("w_2", "t_1", "wob") if {*ROCK} <= {*self.added} else ("w_2", "t_1")
