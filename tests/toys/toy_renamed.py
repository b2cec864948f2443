"""The paper's rig, with all physics that the house's one takes, in words of its own."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, ClassVar

from bayesdrill.basics import Symbol
from bayesdrill.basics.symbols import PARAMETERS, STATES
from bayesdrill.rig import (
    Friction,
    Gear,
    Linear,
    Model,
    MotorRoles,
    MotorShaft,
    Named,
    Roles,
    RotorRoles,
    ShaftRoles,
)
from bayesdrill.rig.models.linear import ParameterNames

ROLES = Roles(
    motor=MotorRoles(
        angle="top_angle",
        speed="top_speed",
        current="winding_current",
        inertia="motor_inertia",
        damping="motor_damping",
        friction="motor_friction",
        sliding="motor_sliding",
        static="motor_static",
        fading="motor_fading",
        back_emf="volts_per_speed",
        torque_constant="torque_per_ampere",
        resistance="winding_resistance",
        series="series_resistance",
        inductance="winding_inductance",
        drop="brush_drop",
        efficiency="gear_efficiency",
    ),
    shaft=ShaftRoles(
        gear_inertia="table_inertia", stiffness="pipe_stiffness", damping="pipe_damping"
    ),
    rotor=RotorRoles(
        angle="bit_angle",
        speed="bit_speed",
        inertia="bit_inertia",
        damping="bit_damping",
        sliding="bit_sliding",
        static="bit_static",
        fading="bit_fading",
    ),
    gear="gear_down",
)
ROLE_OF = {
    getattr(usual, role): getattr(getattr(ROLES, part), role)
    for part in ("motor", "shaft", "rotor")
    for usual in [getattr(Roles(), part)]
    for role in (one.name for one in dataclasses.fields(usual))
}
OWN = {usual: name for usual, name in ROLE_OF.items() if name != usual} | {
    "friction_m": "motor_rubs",
    "friction_1": "bit_rubs",
    "drop": "current_rubs",
}
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
    states: ClassVar[tuple[str, ...]] = own(MotorShaft.states)
    inputs: ClassVar[tuple[str, ...]] = MotorShaft.inputs
    roles: ClassVar[Roles] = ROLES

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
