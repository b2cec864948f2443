"""Physics that a rig takes when its parameter is named, and is without when it is not.

A rig that is composed has a class-level `offers`: parameters, each with the names that it means nothing
without; and a field `added`, the names that this one has.  `parameters`, `linear` and `frictions` of an
instance follow from `added`.  Of other rigs both are empty.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

from bayesdrill.rig.models.friction import Coulomb, Law, Stribeck
from bayesdrill.rig.models.linear import Model


@dataclass(frozen=True, slots=True)
class Names:
    """Those of a rig's parameters: `always`, of the class too, and behind them what is `added`."""

    always: tuple[str, ...]

    def __get__(self, rig: Any, kind: type | None = None) -> tuple[str, ...]:
        return self.always if rig is None else (*self.always, *rig.added)


def with_named(rig: Model, names: Collection[str]) -> Model:
    """With what it has, and what it offers of these, in its own order."""
    wanted = {*names, *rig.added}
    added = tuple(name for name in rig.offers if name in wanted)
    if not added:
        return rig
    found: Model = dataclasses.replace(rig, added=added)  # type: ignore[type-var]
    return found


def with_all(rig: Model) -> Model:
    """With all that it offers."""
    return with_named(rig, rig.offers)


def lacking(rig: Model) -> dict[str, tuple[str, ...]]:
    """What is added in vain, each with what it means nothing without."""
    needed = {name: rig.offers.get(name, ()) for name in rig.added}
    found = {name: tuple(n for n in needs if n not in rig.added) for name, needs in needed.items()}
    return {name: missing for name, missing in found.items() if missing}


def in_vain(name: str, missing: Collection[str]) -> str:
    """In words."""
    others = " and ".join(missing)
    return f"{name} means nothing without {others}; name {others} too, or remove {name}"


def constants(rig: Any) -> dict[str, Any]:
    """Its gear, and other fields that are not as they are by default, with their values."""
    every = {one.name: (getattr(rig, one.name), one.default) for one in dataclasses.fields(rig)}
    gear = rig.roles.gear
    return {n: value for n, (value, usual) in every.items() if n == gear or value != usual}


def dry(added: Collection[str], law: Stribeck) -> Law | None:
    """`law`, where static friction is added; sliding friction alone; or none."""
    if all(name in added for name in law.parameters):
        return law
    return Coulomb(law.sliding) if law.sliding in added else None
