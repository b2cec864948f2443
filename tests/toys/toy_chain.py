"""Three discs on two shafts, turned by a torque at the top: a rig whose parts are its own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from bayesdrill.basics import Symbol
from bayesdrill.rig import (
    Coulomb,
    Friction,
    InertiaRoles,
    Linear,
    Model,
    Named,
    Roles,
    ShaftRoles,
)
from bayesdrill.rig.models.linear import ParameterNames

DISCS = ("top", "middle", "bit")
SHAFTS = {"pipe": ("top", "middle"), "collar": ("middle", "bit")}


def symbols(
    letter: str, name: str, unit: str, meaning: str, held: Any = "positive"
) -> list[Symbol]:
    return [
        Symbol(
            f"{name}_{disc}", unit, rf"{letter}_\mathrm{{{disc}}}", "", f"{meaning} {disc}", held
        )
        for disc in (SHAFTS if name in ("stiffness", "loss") else DISCS)
    ]


@dataclass(frozen=True, slots=True)
class Chain(Model):
    added: tuple[str, ...] = ()

    name: ClassVar[str] = "toy_chain"
    has_private_names: ClassVar[bool] = True  # its inertias are not those of the house
    declares: ClassVar[tuple[Symbol, ...]] = (
        *symbols(r"\alpha", "angle", "rad", "angle of the disc"),
        *symbols(r"\dot\alpha", "speed", "rad/s", "speed of the disc"),
        *symbols("J", "mass", "kg*m**2", "moment of inertia of the disc"),
        *symbols("K", "stiffness", "N*m/rad", "stiffness of the"),
        *symbols("d", "oil", "N*m*s/rad", "viscous damping at the disc", "not negative"),
        *symbols("f", "dry", "N*m", "dry friction at the disc", "not negative"),
        *symbols("D", "loss", "N*m*s/rad", "damping of the", "not negative"),
    )
    offers: ClassVar[dict[str, tuple[str, ...]]] = {
        s.name: () for s in declares if s.name.startswith(("oil", "dry", "loss"))
    }
    parameters: ClassVar[ParameterNames] = ParameterNames(
        tuple(s.name for s in declares if s.name.startswith(("mass", "stiffness")))
    )
    states: ClassVar[tuple[str, ...]] = tuple(s.name for s in declares[:6])
    inputs: ClassVar[tuple[str, ...]] = ("t_m",)
    roles: ClassVar[Roles] = Roles(
        inertias=tuple(
            InertiaRoles(
                name=disc,
                words=f"the {disc}",
                angle=f"angle_{disc}",
                speed=f"speed_{disc}",
                inertia=f"mass_{disc}",
                damping=f"oil_{disc}",
                sliding=f"dry_{disc}",
                torque="t_m" if disc == "top" else "",
            )
            for disc in DISCS
        ),
        shafts=tuple(
            ShaftRoles(
                name=name,
                words=f"the {name}",
                ends=ends,
                stiffness=f"stiffness_{name}",
                damping=f"loss_{name}",
            )
            for name, ends in SHAFTS.items()
        ),
    )

    @property
    def frictions(self) -> tuple[Friction, ...]:
        return tuple(
            Friction(
                name=f"rubs_{disc}",
                against=f"speed_{disc}",
                law=Coulomb(f"dry_{disc}"),
                holds=f"angle_{disc}",
                where=f"at the {disc}",
            )
            for disc in DISCS
            if f"dry_{disc}" in self.added
        )

    def linear(self, p: Named) -> Linear:
        a: dict[tuple[str, str], Any] = {(f"angle_{d}", f"speed_{d}"): 1.0 for d in DISCS}
        for name, ends in SHAFTS.items():
            for here, there in (ends, ends[::-1]):
                row, mass = f"speed_{here}", p[f"mass_{here}"]
                for what, of in (("stiffness", "angle"), ("loss", "speed")):
                    if f"{what}_{name}" in self.parameters:
                        times = p[f"{what}_{name}"] / mass
                        key = (row, f"{of}_{here}")
                        a[key] = a[key] - times if key in a else -times
                        a[row, f"{of}_{there}"] = times
        for disc in DISCS:
            if f"oil_{disc}" in self.added:
                key, brake = (f"speed_{disc}",) * 2, p[f"oil_{disc}"] / p[f"mass_{disc}"]
                a[key] = a[key] - brake if key in a else -brake
        b: dict[tuple[str, str], Any] = {("speed_top", "t_m"): 1.0 / p["mass_top"]}
        for friction in self.frictions:
            disc = friction.against.removeprefix("speed_")
            b[friction.against, friction.name] = -1.0 / p[f"mass_{disc}"]
        return Linear(A=a, B=b, c={})
