"""Define the parts of a drive train that a config describes: shafts, gears and drives."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, PlainSerializer, WithJsonSchema

from bayesdrill.basics.errors import short_repr

DRIVES = ("torque", "current", "voltage", "speed", "servo")
MAX_PARTS = 40
NAME = r"^[A-Za-z][A-Za-z0-9_]{0,29}$"


@dataclass(frozen=True, slots=True)
class Shaft:
    """A shaft joins the two inertias named in `ends`; one end may be the ground instead."""

    name: str
    ends: tuple[str, str]


@dataclass(frozen=True, slots=True)
class Gear:
    """A gear is rigid: the second of its `ends` turns `ratio` times as far as the first."""

    name: str
    ends: tuple[str, str]
    ratio: float


@dataclass(frozen=True, slots=True)
class Drive:
    """A drive moves an inertia; its `kind` is one of the `DRIVES`.

    `supply` [V] is the usual supply voltage of a servo whose supply is measured, otherwise zero.
    """

    inertia: str
    kind: str
    supply: float = 0.0

    @property
    def entry(self) -> Any:
        """Return the drive as an entry of a config."""
        return {self.kind: self.supply} if self.supply else self.kind


def _ends(name: str, value: Any) -> tuple[str, str]:
    pair = isinstance(value, list | tuple) and len(value) == 2
    if not (pair and all(isinstance(end, str) for end in value)):
        raise ValueError(f"{name} needs the names of two inertias, such as [motor, load]")
    return (value[0], value[1])


def _by_name(kind: type, example: str, make: Callable[[str, Any], Any], value: Any) -> Any:
    """Make parts from a mapping of names to entries, or from a tuple of parts made earlier."""
    if isinstance(value, tuple) and all(isinstance(part, kind) for part in value):
        pairs = [_entry(part) for part in value]
    elif isinstance(value, Mapping):
        pairs = [*value.items()]
    else:
        raise ValueError(f"write each {kind.__name__.lower()} by its name, such as `{example}`")
    for name, _ in pairs:
        if not re.fullmatch(NAME, str(name)):
            shown = short_repr(name)
            raise ValueError(f"{shown} is no name; write a letter, then letters, digits and `_`")
    return tuple(make(str(name), entry) for name, entry in pairs)


def _entry(part: Any) -> tuple[Any, Any]:
    """Return the name of a part, and its entry in a config."""
    if isinstance(part, Drive):
        return part.inertia, part.entry
    name, first, *ratio = dataclasses.astuple(part)
    return name, {"between": first, "ratio": ratio[0]} if ratio else first


def _shaft(name: str, entry: Any) -> Shaft:
    return Shaft(name, _ends(name, entry))


def _gear(name: str, entry: Any) -> Gear:
    if not isinstance(entry, Mapping) or {*entry} != {"between", "ratio"}:
        raise ValueError(f"{name} needs `between: [motor, arm]` and `ratio:`, and nothing else")
    ratio, number = entry["ratio"], isinstance(entry["ratio"], int | float)
    if not number or isinstance(ratio, bool) or not 1e-6 <= abs(ratio) <= 1e6:
        raise ValueError(
            f"{name} has the ratio {short_repr(ratio)}; write how far the second inertia turns for one "
            "turn of the first, such as 0.125"
        )
    return Gear(name, _ends(name, entry["between"]), float(ratio))


def _drive(name: str, entry: Any) -> Drive:
    if not isinstance(entry, Mapping):
        return Drive(name, str(entry))
    supply: Any = entry.get("servo") if len(entry) == 1 else None
    is_number = isinstance(supply, int | float) and not isinstance(supply, bool)
    if not is_number or not 1e-6 <= supply <= 1e6:
        raise ValueError(
            f"{name} has the drive {short_repr(dict(entry))}; write `servo` or, if the supply is "
            "measured, the usual supply in V: `{servo: 12}`"
        )
    return Drive(name, "servo", float(supply))


def _schema(entry: Mapping[str, Any]) -> WithJsonSchema:
    return WithJsonSchema({"type": "object", "additionalProperties": dict(entry)})


_PAIR = {"type": "array", "items": {"type": "string"}, "minItems": 2, "maxItems": 2}
_GEAR = {
    "type": "object",
    "properties": {"between": _PAIR, "ratio": {"type": "number"}},
    "required": ["between", "ratio"],
    "additionalProperties": False,
}
_SERVO = {
    "type": "object",
    "properties": {"servo": {"type": "number", "description": "Usual supply in V; an input."}},
    "required": ["servo"],
    "additionalProperties": False,
}
Names = Annotated[
    tuple[Annotated[str, Field(pattern=NAME)], ...],
    BeforeValidator(lambda value: tuple(value) if isinstance(value, list) else value),
    PlainSerializer(list),
    Field(max_length=MAX_PARTS),
]
Inertias = Annotated[Names, Field(min_length=1, description="Names of its inertias, or masses.")]
Shafts = Annotated[
    tuple[Shaft, ...],
    BeforeValidator(partial(_by_name, Shaft, "coupling: [motor, load]", _shaft)),
    PlainSerializer(lambda shafts: {s.name: list(s.ends) for s in shafts}),
    _schema(_PAIR),
    Field(max_length=MAX_PARTS, description="By name the two inertias that a shaft joins."),
]
Gears = Annotated[
    tuple[Gear, ...],
    BeforeValidator(partial(_by_name, Gear, "box: {between: [motor, arm], ratio: 0.125}", _gear)),
    PlainSerializer(
        lambda gears: {g.name: {"between": list(g.ends), "ratio": g.ratio} for g in gears}
    ),
    _schema(_GEAR),
    Field(max_length=MAX_PARTS, description="By name two inertias, and the ratio of their angles."),
]
Drives = Annotated[
    tuple[Drive, ...],
    BeforeValidator(partial(_by_name, Drive, "motor: current", _drive)),
    PlainSerializer(lambda drives: {d.inertia: d.entry for d in drives}),
    _schema({"anyOf": [{"enum": [*DRIVES]}, _SERVO]}),
    Field(max_length=MAX_PARTS, description="By inertia what moves it."),
]
Motion = Annotated[Literal["rotary", "linear"], Field(description="Angles, or positions.")]
Gravity = Annotated[Names, Field(description="Inertias that gravity turns, as pendulums.")]
Rock = Annotated[Names, Field(description="Inertias with a bit that cuts rock.")]
