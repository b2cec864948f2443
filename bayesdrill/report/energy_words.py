"""Where the energy goes, in names, a table and as data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesdrill.basics.symbols import Symbol
from bayesdrill.basics.units import Unit
from bayesdrill.insight.energy import AT_START, CONVERTED, STORED, Account, Part
from bayesdrill.report.sections import Table
from bayesdrill.rig.models.friction import Friction

Array = NDArray[np.float64]

NAMES: Mapping[str, str] = {
    "v": "supply",
    "t_1": "load",
    "r_m": "resistance of the motor",
    "r_s": "resistance in series",
    "c_m": "viscous, at the motor",
    "c_s": "viscous, in the shaft",
    "c_1": "viscous, at rotor 1",
    "t_f": "friction t_f",
    CONVERTED: "k_T is not k_e",
    AT_START: "stored at the start",
    STORED: "stored",
}
UNEQUAL = (
    "*k_T is not k_e*: what a motor gives beyond what it takes, (k_T - k_e) times current and speed; in "
    "an ideal one the two are equal."
)
OPEN = 1e-3  # of all, from which on what does not close is said

READ = (
    "At the MAP: what came in, and what became of it until the end of the record. `share` is that of "
    "all that came in, `sd` of it over the posterior. Each is an integral of a power over all steps, "
    "exact where no speed changes its sign"
)


def named(part: str, frictions: Sequence[Friction]) -> str:
    """What a table or a legend calls it."""
    where = {one.name: one.where for one in frictions}
    if part in where:
        return f"friction {where[part]}" if part != "drop" else "voltage drop"
    return NAMES.get(part, part)


def table(found: Account, frictions: Sequence[Friction]) -> Table:
    """In the order: what came in, the largest first; what it went to; what is stored."""
    surely = any(part.sd is not None for part in found.parts)
    heads = ("", "", "J", "share", *(("sd",) if surely else ()))
    lines = []
    for side, names in (("in", found.came), ("out", found.went)):
        for part in ordered(found, names):
            sure = (f"{100 * part.sd:.2g} %",) if part.sd is not None else ("",) * surely
            share = f"{100 * part.share:.3g} %"
            lines.append((side, named(part.name, frictions), f"{part.joules:.4g}", share, *sure))
    return Table(heads, tuple(lines), frozenset(heads[:1]))


def ordered(found: Account, names: Mapping[str, Any]) -> list[Part]:
    """The largest first; what is stored stands last."""
    parts = [part for part in found.parts if part.name in names]
    return sorted(parts, key=lambda part: (part.name == STORED, -part.joules))


KINDS: Mapping[str, str] = {
    **dict.fromkeys(("r_m", "r_s", "drop"), "electrical"),
    **dict.fromkeys(("c_m", "c_s", "c_1"), "viscous"),
    STORED: "stored",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Stacked:
    """`kind`: electrical, viscous, friction, other or stored; `name` for a legend; `joules (N,)`."""

    kind: str
    name: str
    joules: Array


@dataclass(frozen=True, slots=True, kw_only=True)
class Balance:
    """At times `t (N,)` in the unit of `time`: `total` that came in from `sources`; what it became."""

    t: Array
    time: Symbol
    total: Array
    sources: str
    parts: tuple[Stacked, ...]


def balance(found: Account, frictions: Sequence[Friction], clock: Unit) -> Balance:
    """For a figure."""
    rubs = {one.name for one in frictions} | {"t_f"}
    parts = ordered(found, found.went)
    order = ("electrical", "viscous", "friction", "other", "stored")
    kinds = {p.name: KINDS.get(p.name, "friction" if p.name in rubs else "other") for p in parts}
    return Balance(
        t=found.t / clock.factor,
        time=Symbol("t", clock.name, "t", clock.latex, "time"),
        total=found.total,
        sources=", ".join(named(p.name, frictions) for p in ordered(found, found.came)),
        parts=tuple(
            Stacked(kind=kinds[p.name], name=named(p.name, frictions), joules=found.went[p.name])
            for p in sorted(parts, key=lambda part: order.index(kinds[part.name]))
        ),
    )


def note(found: Account) -> str:
    left = (
        f", but {100 * found.left:.2g} % of it is in neither, because of steps in which a speed "
        "changes its sign: finer steps are `model: {pieces: ...}`"
    )
    said = READ + (left if found.left > OPEN else "") + "."
    return f"{said} {UNEQUAL}" if CONVERTED in (*found.came, *found.went) else said


def as_data(found: Sequence[Account]) -> list[dict[str, Any]]:
    """For `run.json`: J."""
    return [
        {
            **({"experiment": one.label} if one.label else {}),
            "in": {part.name: _data(part) for part in ordered(one, one.came)},
            "out": {part.name: _data(part) for part in ordered(one, one.went)},
            "open": one.left,
        }
        for one in found
    ]


def _data(part: Part) -> dict[str, float | None]:
    return {"joules": part.joules, "share": part.share, "sd": part.sd}
