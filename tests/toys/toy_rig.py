"""The paper's rig with a shaft that damps: its torque is k_s (twist + tau_s twist')."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from bayesdrill.basics import Symbol
from bayesdrill.rig import Gear, Linear, Model, MotorShaft, Named


@dataclass(frozen=True, slots=True)
class Damped(Model):
    i_m: Gear = 1 / 8

    name: ClassVar[str] = "toy_damped"
    declares: ClassVar[tuple[Symbol, ...]] = (
        Symbol("tau_s", "s", r"\tau_s", "s", "retardation time of the shaft", "not negative"),
    )
    parameters: ClassVar[tuple[str, ...]] = (*MotorShaft.parameters, "tau_s")
    states: ClassVar[tuple[str, ...]] = MotorShaft.states
    inputs: ClassVar[tuple[str, ...]] = MotorShaft.inputs

    def linear(self, p: Named) -> Linear:
        plain = MotorShaft(self.i_m).linear(p)
        a, c_s = dict(plain.A), p["tau_s"] * p["k_s"]
        a["w_1", "w_1"], a["w_1", "w_2"] = -c_s / p["j_1"], c_s / p["j_1"]
        a["w_2", "w_1"] = self.i_m**2 * c_s / p["j_m"]
        a["w_2", "w_2"] = a["w_2", "w_2"] - self.i_m**2 * c_s / p["j_m"]
        return Linear(A=a, B=plain.B, c=plain.c)
