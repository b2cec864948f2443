"""Register the rigs, and collect the symbols of all rigs.

Each rig is a class in `_RIGS`, or an entry point `bayesdrill.rig` of another package.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from bayesdrill.basics import symbols
from bayesdrill.basics.registry import Registry
from bayesdrill.basics.symbols import Symbol
from bayesdrill.rig.models.linear import Model, with_all
from bayesdrill.rig.models.long_shaft import LongShaft
from bayesdrill.rig.models.motor_shaft import DrivenShaft, Motor, MotorShaft, TwoRotors
from bayesdrill.rig.models.train import Train
from bayesdrill.rig.models.trial import check_rig

_RIGS: dict[str, type[Model]] = {
    "motor_shaft": MotorShaft,
    "two_rotors": TwoRotors,
    "driven_shaft": DrivenShaft,
    "motor": Motor,
    "long_shaft": LongShaft,
    "train": Train,
}
MODELS: Registry[type[Model]] = Registry("rig", _RIGS, judge=check_rig)


def _rigs() -> list[Model]:
    """Return each usable rig with all its options, except rigs whose configs name the symbols."""
    rigs = [with_all(kind()) for kind in MODELS.usable().values()]
    return [rig for rig in rigs if not rig.has_private_names]


def _all(role: str, known: Mapping[str, Symbol]) -> Mapping[str, Symbol]:
    """Return the `known` symbols, then those that rigs declare for a `role`, such as `states`.

    A rig cannot redefine a name that is already `known`.
    """
    declared = {
        symbol.name: symbol
        for rig in _rigs()
        for symbol in rig.declares
        if symbol.name in getattr(rig, role)
    }
    return MappingProxyType({**known, **{n: s for n, s in declared.items() if n not in known}})


PARAMETERS = _all("parameters", symbols.PARAMETERS)
STATES = _all("states", symbols.STATES)
INNER = frozenset(name for rig in _rigs() for name in rig.inner)  # states that start at zero
