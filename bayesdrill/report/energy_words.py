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
from bayesdrill.rig.models.linear import Model

Array = NDArray[np.float64]

NAMES: Mapping[str, str] = {  # of roles
    "motor.voltage": "supply",
    "rotor.load": "load",
    "motor.resistance": "resistance of the motor",
    "motor.series": "resistance in series",
    "motor.damping": "viscous, at the motor",
    "shaft.damping": "viscous, in the shaft",
    "rotor.damping": "viscous, at rotor 1",
}
OPEN = 1e-3  # of all, from which on what does not close is said

READ = (
    "At the MAP: what came in, and what became of it until the end of the record. `share` is that of "
    "all that came in, `sd` of it over the posterior. Each is an integral of a power over all steps, "
    "exact where no speed changes its sign"
)


def named(part: str, model: Model) -> str:
    """What a table or a legend calls it."""
    motor, names = model.roles.motor, {model.roles[role]: said for role, said in NAMES.items()}
    names |= {
        motor.friction: f"friction {motor.friction}",
        CONVERTED: f"{motor.torque_constant} is not {motor.back_emf}",
        AT_START: "stored at the start",
        STORED: "stored",
    }
    for one in model.frictions:
        drop = one.against == motor.current
        names[one.name] = "voltage drop" if drop else f"friction {one.where}"
    return names.get(part, part)


def table(found: Account, model: Model) -> Table:
    """In the order: what came in, the largest first; what it went to; what is stored."""
    surely = any(part.sd is not None for part in found.parts)
    heads = ("", "", "J", "share", *(("sd",) if surely else ()))
    lines = []
    for side, names in (("in", found.came), ("out", found.went)):
        for part in ordered(found, names):
            sure = (f"{100 * part.sd:.2g} %",) if part.sd is not None else ("",) * surely
            share = f"{100 * part.share:.3g} %"
            lines.append((side, named(part.name, model), f"{part.joules:.4g}", share, *sure))
    return Table(heads, tuple(lines), frozenset(heads[:1]))


def ordered(found: Account, names: Mapping[str, Any]) -> list[Part]:
    """The largest first; what is stored stands last."""
    parts = [part for part in found.parts if part.name in names]
    return sorted(parts, key=lambda part: (part.name == STORED, -part.joules))


def _kinds(model: Model) -> Mapping[str, str]:
    motor, rubs = model.roles.motor, {one.name: one.against for one in model.frictions}
    viscous = (motor.damping, model.roles.shaft.damping, model.roles.rotor.damping)
    return {
        **dict.fromkeys((motor.resistance, motor.series), "electrical"),
        **dict.fromkeys(viscous, "viscous"),
        **{n: "electrical" if s == motor.current else "friction" for n, s in rubs.items()},
        motor.friction: "friction",
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


def balance(found: Account, model: Model, clock: Unit) -> Balance:
    """For a figure."""
    kinds = _kinds(model)
    parts = ordered(found, found.went)
    order = ("electrical", "viscous", "friction", "other", "stored")
    kinds = {p.name: kinds.get(p.name, "other") for p in parts}
    return Balance(
        t=found.t / clock.factor,
        time=Symbol("t", clock.name, "t", clock.latex, "time"),
        total=found.total,
        sources=", ".join(named(p.name, model) for p in ordered(found, found.came)),
        parts=tuple(
            Stacked(kind=kinds[p.name], name=named(p.name, model), joules=found.went[p.name])
            for p in sorted(parts, key=lambda part: order.index(kinds[part.name]))
        ),
    )


def note(found: Account, model: Model) -> str:
    left = (
        f", but {100 * found.left:.2g} % of it is in neither, because of steps in which a speed "
        "changes its sign: finer steps are `model: {pieces: ...}`"
    )
    said = READ + (left if found.left > OPEN else "") + "."
    given, taken = model.roles.motor.torque_constant, model.roles.motor.back_emf
    unequal = (
        f"*{given} is not {taken}*: what a motor gives beyond what it takes, ({given} - {taken}) times "
        "current and speed; in an ideal one the two are equal."
    )
    return f"{said} {unequal}" if CONVERTED in (*found.came, *found.went) else said


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
