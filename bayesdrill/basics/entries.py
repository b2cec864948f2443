"""Describe entries of a config: bounded numbers, and entries for members of registries.

A member of a registry (a rig, a noise, an optimiser) is a dataclass.  Each of its `Annotated`
fields, such as `i_m: Positive = 0.125`, is an entry of the config.
"""

from __future__ import annotations

import dataclasses
import functools
import types
import typing
from collections.abc import Callable, Hashable, Mapping
from typing import Annotated, Any, cast

from pydantic import BaseModel, ConfigDict, Field, ValidationError, create_model
from pydantic.fields import FieldInfo

from bayesdrill.basics.errors import InputError, Issue, short_repr


class Strict(BaseModel):
    """A section of a config refuses unknown keys, and values of wrong types.

    An entry is described by its `Field`, or by a string below the entry.
    """

    model_config = ConfigDict(
        defer_build=True,  # processes that read no config need no validators
        extra="forbid",
        strict=True,
        frozen=True,
        allow_inf_nan=False,
        use_attribute_docstrings=True,
    )


# Bounds of numbers in a config.  No rig exceeds them, and squares and ratios stay finite.
SMALLEST, LARGEST = 1e-30, 1e30
MAX_COUNT = 1_000_000  # largest value of a count in a config

Number = Annotated[float, Field(ge=-LARGEST, le=LARGEST)]
Positive = Annotated[float, Field(ge=SMALLEST, le=LARGEST)]
NonNegative = Annotated[float, Field(ge=0, le=LARGEST)]
Count = Annotated[int, Field(ge=1, le=MAX_COUNT)]
Latex = Annotated[str, Field(max_length=200)]  # Matplotlib draws longer texts very slowly


@dataclasses.dataclass(frozen=True, slots=True)
class NoEntries:
    """Members without entries in a config use this class, which is empty."""


@functools.cache
def entries_of(kind: type) -> Mapping[str, Any]:
    """Return the annotations of a member's entries; raises `ValueError` if it is no dataclass."""
    if not dataclasses.is_dataclass(kind):
        raise ValueError(f"{getattr(kind, '__name__', kind)} is no dataclass")
    hints = typing.get_type_hints(kind, include_extras=True)
    names = [field.name for field in dataclasses.fields(kind)]
    return {name: hints[name] for name in names if _annotated(hints[name])}


@functools.cache
def entries_model(kind: Any) -> type[Strict]:
    """Return a pydantic model of a member's entries; raises if pydantic refuses an annotation."""
    fields: dict[str, Any] = {name: (hint, ...) for name, hint in entries_of(kind).items()}
    return create_model("Entries", __base__=Strict, **fields)


def set_constants(member: Any) -> None:
    """Validate and convert the entries of a frozen member; raises `InputError` with all mistakes."""
    section = entries_model(cast("Hashable", type(member)))
    given = {name: getattr(member, name) for name in section.model_fields}
    try:
        read = section(
            **{n: x.item() if getattr(x, "shape", 0) == () else x for n, x in given.items()}
        )
    except ValidationError as error:
        reasons = {str(e["loc"][0]): e["msg"].removeprefix("Value error, ") for e in error.errors()}
        texts = {n: f"{short_repr(given[n])} is refused: {why}" for n, why in reasons.items()}
        raise InputError([Issue(*issue) for issue in texts.items()]) from None
    for name in given:
        object.__setattr__(member, name, getattr(read, name))


def _annotated(hint: Any) -> bool:
    """Return whether a type is `Annotated`, or a union that includes an `Annotated` type."""
    return typing.get_origin(hint) is Annotated or any(map(_annotated, _choices(hint)))


def _choices(hint: Any) -> tuple[Any, ...]:
    union = typing.get_origin(hint) in (typing.Union, types.UnionType)
    return typing.get_args(hint) if union else ()


def _about(hint: Any) -> str:
    metadata = getattr(hint, "__metadata__", ())
    descriptions = [item.description for item in metadata if isinstance(item, FieldInfo)]
    inner = [_about(choice) for choice in _choices(hint)]
    return next((text for text in (*reversed(descriptions), *inner) if text), "").rstrip(".")


def with_member_entries[B: Strict](
    key: str, members: Mapping[str, type]
) -> Callable[[type[B]], type[B]]:
    """Return a decorator that adds the entries of all members to a section, as optional entries.

    The entry `key` of the section selects a member by name.
    """
    return lambda section: _with_member_entries(section, key, members)


def _with_member_entries[B: Strict](
    base: type[B], key: str, members: Mapping[str, type]
) -> type[B]:
    key_field = base.model_fields[key]
    named = Field(
        key_field.default, description=key_field.description, json_schema_extra={"enum": [*members]}
    )
    fields: dict[str, Any] = {key: (key_field.annotation, named)}
    for entry, having in members_by_entry(members).items():
        if entry in base.model_fields:  # members of other packages must not replace an entry
            continue
        kind = members[having[0]]
        hint = entries_of(kind)[entry]
        default = {field.name: field.default for field in dataclasses.fields(kind)}[entry]
        plain = ", ".join(default) if isinstance(default, tuple) else default
        default_ = "" if plain in (None, "", dataclasses.MISSING) else f"; default: {plain}"
        description = f"{', '.join(having)}: {_about(hint)}{default_}."
        fields[entry] = (hint | None, Field(None, description=description))
    identity: Any = {"__doc__": base.__doc__, "__module__": base.__module__}
    return create_model(base.__name__, __base__=base, **identity, **fields)


def members_by_entry(members: Mapping[str, type]) -> dict[str, list[str]]:
    """Return each entry with the names of the members that have the entry."""
    holders: dict[str, list[str]] = {}
    for name, kind in members.items():
        for entry in entries_of(kind):
            holders.setdefault(entry, []).append(name)
    return holders


def build_member[T](kind: type[T], section: Strict) -> T:
    """Build a member from the entries of its section; entries that are None keep their defaults."""
    given = {entry: getattr(section, entry) for entry in entries_of(cast("Hashable", kind))}
    return kind(**{entry: value for entry, value in given.items() if value is not None})


def unknown_keys(
    choice: tuple[str, str], members: Mapping[str, type], kind: type, section: Strict
) -> dict[str, str]:
    """Return a message for each entry that a section gives but a member of class `kind` lacks.

    `choice` has the key that selects a member, and the noun for members in messages.
    """
    (key, what), known = choice, entries_of(kind)
    name = getattr(section, key)
    return {
        entry: f"the {what} {name} has no {entry}; remove it, or take {key}: {' or '.join(having)}"
        for entry, having in members_by_entry(members).items()
        if entry not in known and getattr(section, entry) is not None
    }
