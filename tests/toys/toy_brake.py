"""The paper's rig with a brake at the gearbox: dry friction, by a law of its own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from bayesdrill.basics import Symbol
from bayesdrill.rig import Friction, Gear, Linear, Model, MotorShaft, Named


@dataclass(frozen=True, slots=True)
class Fading:
    """`t_b / (1 + |w|/w_b)`: brakes less the faster it turns."""

    parameters: ClassVar[tuple[str, ...]] = ("t_b", "w_b")
    seen: ClassVar[tuple[str, ...]] = ()
    steady: ClassVar[bool] = False

    def size(self, p: Named, speed: Any, seen: Mapping[str, Any]) -> Any:
        return p["t_b"] / (1.0 + speed / p["w_b"])


@dataclass(frozen=True, slots=True)
class Braked(Model):
    i_m: Gear = 1 / 8

    name: ClassVar[str] = "toy_braked"
    declares: ClassVar[tuple[Symbol, ...]] = (
        Symbol("t_b", "N*m", "t_b", r"N\,m", "torque of the brake at rest", "not negative"),
        Symbol("w_b", "rad/s", "w_b", "rad/s", "speed at which the brake has half of it"),
    )
    parameters: ClassVar[tuple[str, ...]] = (*MotorShaft.parameters, "t_b", "w_b")
    states: ClassVar[tuple[str, ...]] = MotorShaft.states
    inputs: ClassVar[tuple[str, ...]] = MotorShaft.inputs
    frictions: ClassVar[tuple[Friction, ...]] = (
        Friction(
            name="brake", against="w_2", law=Fading(), holds="theta_2", where="at the gearbox"
        ),
    )

    def linear(self, p: Named) -> Linear:
        plain = MotorShaft(self.i_m).linear(p)
        brake = {("w_2", "brake"): -(self.i_m**2) / p["j_m"]}
        return Linear(A=plain.A, B={**plain.B, **brake}, c=plain.c)
