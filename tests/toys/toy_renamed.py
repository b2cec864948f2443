"""The paper's rig, with all physics that the house's one takes, in words of its own."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, ClassVar

from bayesdrill.basics import Symbol
from bayesdrill.basics.symbols import PARAMETERS, STATES
from bayesdrill.rig import Friction, Gear, Linear, Model, MotorShaft, Named, Roles, usual_roles
from bayesdrill.rig.models.linear import ParameterNames, StateNames

OWN = {
    "theta_1": "bit_angle", "w_1": "bit_speed", "j_1": "bit_inertia", "c_1": "bit_damping",
    "d_1": "bit_drag", "theta_0": "end_angle", "w_0": "end_speed", "j_0": "end_inertia",
    "k_0": "end_stiffness", "c_0": "end_damping",
    "t_c1": "bit_sliding", "t_s1": "bit_static", "w_s1": "bit_fading",
    "theta_2": "top_angle", "w_2": "top_speed", "i": "winding_current",
    "j_m": "motor_inertia", "c_m": "motor_damping", "t_f": "motor_friction",
    "t_cm": "motor_sliding", "t_sm": "motor_static", "w_sm": "motor_fading",
    "d_m": "motor_drag",
    "k_e": "volts_per_speed", "k_T": "torque_per_ampere", "r_m": "winding_resistance",
    "r_s": "series_resistance", "l_m": "winding_inductance", "v_d": "brush_drop",
    "eta": "gear_efficiency", "j_2": "table_inertia", "k_s": "pipe_stiffness",
    "c_s": "pipe_damping", "friction_m": "motor_rubs", "friction_1": "bit_rubs",
    "drop": "current_rubs",
}  # fmt: skip
USUAL = {own: usual for usual, own in OWN.items()}


def own(of: Any) -> Any:
    """With own names in the place of the usual ones: a name, names, or a law of friction."""
    if isinstance(of, tuple):
        return tuple(map(own, of))
    if dataclasses.is_dataclass(of) and not isinstance(of, Symbol | type):
        fields = dataclasses.fields(of)
        return dataclasses.replace(of, **{f.name: own(getattr(of, f.name)) for f in fields})
    return OWN.get(of, of) if isinstance(of, str) else of


@dataclass(frozen=True, slots=True)
class Renamed(Model):
    gear_down: Gear = 1 / 8
    added: tuple[str, ...] = ()

    name: ClassVar[str] = "toy_renamed"
    declares: ClassVar[tuple[Symbol, ...]] = tuple(
        dataclasses.replace(symbol, name=OWN[name])
        for name, symbol in {**PARAMETERS, **STATES}.items()
        if name in OWN
    )
    offers: ClassVar[dict[str, tuple[str, ...]]] = {
        own(name): own(needs) for name, needs in MotorShaft.offers.items()
    }
    parameters: ClassVar[ParameterNames] = ParameterNames(own(MotorShaft.parameters))
    states: ClassVar[StateNames] = StateNames(
        own(MotorShaft.states), {("end_stiffness", "end_inertia"): ("end_angle", "end_speed")}
    )
    inputs: ClassVar[tuple[str, ...]] = MotorShaft.inputs

    @property
    def roles(self) -> Roles:
        found: Roles = own(usual_roles(self.gear_down, gear="gear_down"))
        return found

    @property
    def frictions(self) -> tuple[Friction, ...]:
        found: tuple[Friction, ...] = own(self._usual.frictions)
        return found

    def linear(self, p: Named) -> Linear:
        found = self._usual.linear({USUAL.get(name, name): value for name, value in p.items()})
        return Linear(
            A={own(key): value for key, value in found.A.items()},
            B={own(key): value for key, value in found.B.items()},
            c={own(key): value for key, value in found.c.items()},
        )

    @property
    def _usual(self) -> MotorShaft:
        return MotorShaft(self.gear_down, added=tuple(USUAL[name] for name in self.added))
