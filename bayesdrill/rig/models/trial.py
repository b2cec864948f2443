"""Check a rig from another package when it is loaded, before it is ever simulated."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from bayesdrill.basics import symbols
from bayesdrill.basics.duals import Dual
from bayesdrill.basics.entries import entries_model
from bayesdrill.rig.models.friction import DIRECTION
from bayesdrill.rig.models.linear import Model, with_all

REQUIRED = ("name", "parameters", "states", "inputs", "declares", "linear")


def check_rig(name: str, rig: Any) -> None:
    """Raise `ValueError` if something is missing or wrong in a rig."""
    if not (isinstance(rig, type) and dataclasses.is_dataclass(rig)):
        raise ValueError("a rig is a frozen dataclass")
    if Model not in rig.__mro__:
        raise ValueError("it is no bayesdrill.rig.Model; derive it from that")
    missing = [
        attribute for attribute in REQUIRED if getattr(rig, attribute) is getattr(Model, attribute)
    ]
    if missing:
        raise ValueError(f"it has no {', '.join(missing)}")
    named: Any = rig
    if named.name != name:
        raise ValueError(f"its name is '{named.name}', but its entry point is called '{name}'")
    entries_model(rig)
    plain = _create(rig)
    for candidate in (plain, with_all(plain)) if plain.offers else (plain,):
        _check_names(candidate)
        _check_frictions(candidate)
        _check_linear(candidate)


def _create(kind: Any) -> Any:
    try:
        return kind()
    except Exception as error:
        raise ValueError(f"each field needs a default ({type(error).__name__}: {error})") from None


def _check_names(rig: Any) -> None:
    """Check that all names have symbols, and that none has a second meaning."""
    declared = {symbol.name: symbol for symbol in rig.declares}
    house = {**symbols.PARAMETERS, **symbols.STATES}
    for name in declared:
        if name in house and declared[name].unit != house[name].unit:
            raise ValueError(
                f"it declares {name} in {declared[name].unit}; its unit is {house[name].unit}"
            )
    strange = [n for n in (*rig.parameters, *rig.states) if n not in {**declared, **house}]
    if strange:
        raise ValueError(f"no symbol is declared for {', '.join(strange)}")
    strange = [name for name in rig.inputs if name not in symbols.INPUTS]
    if strange:
        raise ValueError(f"no rig has the input {', '.join(strange)}")


class _Number:
    """The number supports exactly the operations of a kernel's register."""

    def _with(self, other: Any) -> _Number:
        if not isinstance(other, _Number | int | float):
            raise TypeError(f"{type(other).__name__} is no number")
        return self

    __add__ = __radd__ = __sub__ = __rsub__ = __mul__ = __rmul__ = _with
    __truediv__ = __rtruediv__ = _with

    def __neg__(self) -> _Number:
        return self

    def __pow__(self, power: int) -> _Number:
        if not isinstance(power, int) or power < 1:
            raise TypeError("only whole powers of at least 1 are allowed")
        return self


def _check_frictions(rig: Any) -> None:
    """Check that frictions have unique names, known states and parameters, and usable laws."""
    used = [*rig.states, *rig.inputs, *rig.parameters]
    for friction in rig.frictions:
        if friction.name in used:
            raise ValueError(f"a friction is called {friction.name}, but that name is already used")
        used.append(friction.name)
        holds = [] if friction.holds is None else [friction.holds]
        strange = [name for name in (friction.against, *holds) if name not in rig.states]
        strange += [name for name in friction.law.parameters if name not in rig.parameters]
        strange += [n for n in friction.law.seen if n not in (*rig.states, *rig.inputs, DIRECTION)]
        if strange:
            raise ValueError(
                f"the friction {friction.name} names {', '.join(strange)}, which the rig lacks"
            )
        ones: Any = Dual(np.ones(2), np.ones(2))
        p, signals = (
            dict.fromkeys(names, ones) for names in (friction.law.parameters, friction.law.seen)
        )
        try:
            friction.law.size(p, ones, signals)
        except Exception as error:
            wanted = "its law uses values that it does not name, or functions beyond `basics.duals`"
            why = f"{type(error).__name__}: {error}"
            raise ValueError(f"the friction {friction.name}: {wanted} ({why})") from None


def _check_linear(rig: Any) -> None:
    try:
        linear = rig.linear({name: _Number() for name in rig.parameters})
    except Exception as error:
        wanted = "`linear` uses an unknown parameter, or more than + - * / and whole powers"
        raise ValueError(f"{wanted} ({type(error).__name__}: {error})") from None
    rows = {row for row, _ in (*linear.A, *linear.B)} | {*linear.c}
    strange = {*rows, *(column for _, column in linear.A)} - {*rig.states}
    columns = {friction.name: friction.against for friction in rig.frictions}
    strange |= {name for _, name in linear.B} - {*rig.inputs, *columns}
    if strange:
        raise ValueError(
            f"`linear` names {', '.join(sorted(strange))}, no state or input of the rig"
        )
    idle = [name for name, row in columns.items() if (row, name) not in linear.B]
    if idle:
        raise ValueError(f"`linear` has no column in `B` for the friction {', '.join(idle)}")
