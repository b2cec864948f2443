"""Whether a rig of another package is one: said as it is loaded, not as it first moves."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from bayesdrill.basics import symbols
from bayesdrill.basics.duals import Dual
from bayesdrill.basics.entries import check_entries
from bayesdrill.rig.models.linear import Model, with_all

WANTED = ("name", "parameters", "states", "inputs", "declares", "linear")


def tried(name: str, rig: Any) -> None:
    """Raises `ValueError` with what is missing or cannot be."""
    if not (isinstance(rig, type) and dataclasses.is_dataclass(rig)):
        raise ValueError("a rig is a frozen dataclass")
    if Model not in rig.__mro__:
        raise ValueError("it is no bayesdrill.rig.Model; derive it from that")
    missing = [one for one in WANTED if getattr(rig, one) is getattr(Model, one)]
    if missing:
        raise ValueError(f"it has no {', '.join(missing)}")
    named: Any = rig
    if named.name != name:
        raise ValueError(f"its name is '{named.name}', and its entry point's '{name}'")
    check_entries(rig)
    plain = _made(rig)
    for one in (plain, with_all(plain)) if plain.offers else (plain,):
        _known(one)
        _rubs(one)
        _moves(one)


def _made(kind: Any) -> Any:
    try:
        return kind()
    except Exception as error:
        raise ValueError(f"each field wants a default ({type(error).__name__}: {error})") from None


def _known(rig: Any) -> None:
    """Names have symbols, and none a second meaning."""
    own = {one.name: one for one in rig.declares}
    house = {**symbols.PARAMETERS, **symbols.STATES}
    for name in own:
        if name in house and own[name].unit != house[name].unit:
            raise ValueError(f"it declares {name} in {own[name].unit}; that is {house[name].unit}")
    strange = [n for n in (*rig.parameters, *rig.states) if n not in {**own, **house}]
    if strange:
        raise ValueError(f"no symbol is declared of {', '.join(strange)}")
    strange = [name for name in rig.inputs if name not in symbols.INPUTS]
    if strange:
        raise ValueError(f"no rig has the input {', '.join(strange)}")


class _Number:
    """It can what a register of a kernel can, and no more."""

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
            raise TypeError("only whole powers from 1 on are known")
        return self


def _rubs(rig: Any) -> None:
    """Frictions have names of their own, states and parameters of the rig, and laws that can be read."""
    taken = [*rig.states, *rig.inputs, *rig.parameters]
    for one in rig.frictions:
        if one.name in taken:
            raise ValueError(f"a friction is called {one.name}, which is something else already")
        taken.append(one.name)
        holds = [] if one.holds is None else [one.holds]
        strange = [name for name in (one.against, *holds) if name not in rig.states]
        strange += [name for name in one.law.parameters if name not in rig.parameters]
        strange += [n for n in one.law.seen if n not in (*rig.states, *rig.inputs)]
        if strange:
            raise ValueError(
                f"the friction {one.name} names {', '.join(strange)}, which the rig has not"
            )
        some: Any = Dual(np.ones(2), np.ones(2))
        p, seen = (dict.fromkeys(names, some) for names in (one.law.parameters, one.law.seen))
        try:
            one.law.size(p, some, seen)
        except Exception as error:
            wanted = "its law wants what it does not name, or more than `basics.duals`"
            why = f"{type(error).__name__}: {error}"
            raise ValueError(f"the friction {one.name}: {wanted} ({why})") from None


def _moves(rig: Any) -> None:
    try:
        linear = rig.linear({name: _Number() for name in rig.parameters})
    except Exception as error:
        wanted = (
            "`linear` wants a parameter that is not there, or more than + - * / and whole powers"
        )
        raise ValueError(f"{wanted} ({type(error).__name__}: {error})") from None
    rows = {row for row, _ in (*linear.A, *linear.B)} | {*linear.c}
    strange = {*rows, *(column for _, column in linear.A)} - {*rig.states}
    columns = {one.name: one.against for one in rig.frictions}
    strange |= {name for _, name in linear.B} - {*rig.inputs, *columns}
    if strange:
        raise ValueError(f"`linear` names {', '.join(sorted(strange))}, no state or input of it")
    idle = [name for name, row in columns.items() if (row, name) not in linear.B]
    if idle:
        raise ValueError(f"`linear` has no column of the friction {', '.join(idle)} in `B`")
