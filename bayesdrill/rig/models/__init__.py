"""The registry of rigs (one file and one line here, or an entry point `bayesdrill.rig`), and the
symbols of all of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from bayesdrill.basics import symbols
from bayesdrill.basics.registry import Registry
from bayesdrill.basics.symbols import Symbol
from bayesdrill.rig.models.driven_shaft import DrivenShaft
from bayesdrill.rig.models.linear import Model, with_all
from bayesdrill.rig.models.long_shaft import LongShaft
from bayesdrill.rig.models.motor import Motor
from bayesdrill.rig.models.motor_shaft import MotorShaft, TwoRotors
from bayesdrill.rig.models.trial import tried

_RIGS: dict[str, type[Model]] = {
    "motor_shaft": MotorShaft,
    "two_rotors": TwoRotors,
    "driven_shaft": DrivenShaft,
    "motor": Motor,
    "long_shaft": LongShaft,
}
MODELS: Registry[type[Model]] = Registry("rig", _RIGS, judge=tried)


def _rigs() -> list[Model]:
    """Each with all that it offers."""
    return [with_all(kind()) for kind in MODELS.usable().values()]


def _all(of: str, known: Mapping[str, Symbol]) -> Mapping[str, Symbol]:
    """Those of `known` first: a rig cannot give another meaning to what has one."""
    own = {
        symbol.name: symbol
        for rig in _rigs()
        for symbol in rig.declares
        if symbol.name in getattr(rig, of)
    }
    return MappingProxyType({**known, **{n: s for n, s in own.items() if n not in known}})


PARAMETERS = _all("parameters", symbols.PARAMETERS)
STATES = _all("states", symbols.STATES)
INNER = frozenset(name for rig in _rigs() for name in rig.inner)  # of no start
