"""Validate a config; in sections whose keys are symbols of the rig, each symbol has its bounds.

The names of a section, and the bounds of their numbers, depend on the rig's vocabulary. The classes
in `config` and `records` define all other entries.
"""

from __future__ import annotations

import math
import typing
from collections.abc import Mapping
from functools import cache
from typing import Annotated, Any, Literal, Union

from pydantic import BaseModel, Field, Tag, TypeAdapter, ValidationError

from bayesdrill.basics.entries import NonNegative, Number, Positive, Strict
from bayesdrill.basics.symbols import Symbol
from bayesdrill.config.schema import numbers
from bayesdrill.config.schema.config import (
    Config,
    MissingTorqueSpec,
    Nominal,
    Parameters,
    Simulation,
    Tolerance,
    Tolerances,
)
from bayesdrill.config.schema.records import DELAY, AngleColumn, Initial, Inputs, InputSpec
from bayesdrill.config.schema.vocabulary import HOUSE, Vocabulary

Place = tuple[str, ...]
EntryError = dict[str, Any]  # the form of pydantic's errors; see `read_entry`

# Classes of the sections whose keys are symbols of the rig, and of sections that contain them.
SECTIONS: Mapping[Place, type[Strict]] = {
    (): Config,
    ("parameters",): Parameters,
    ("nominal",): Nominal,
    ("nominal", "tolerance"): Tolerances,
    ("simulation",): Simulation,
    ("inputs",): Inputs,
    ("initial",): Initial,
    ("missing_torque",): MissingTorqueSpec,
}
_HELD: Mapping[str, Any] = {"positive": Positive, "not negative": NonNegative, "any": Number}


def _limited(symbol: Symbol, number: Any) -> Any:
    """Return the type `number`, limited to the largest value of the parameter."""
    bounded = not math.isinf(symbol.at_most)
    return Annotated[number, Field(le=symbol.at_most)] if bounded else number


def _with_number(spec: Any, number: Any) -> Any:
    """Return the type of an entry whose plain numbers are of the type `number`."""
    union, *metadata = typing.get_args(spec)
    members = (Annotated[number, Tag("<number>")], *typing.get_args(union)[1:])
    return Annotated[Union[members], *metadata] | None  # noqa: UP007


@cache
def named_entries(words: Vocabulary) -> Mapping[Place, Mapping[str, Any]]:
    """Return the type of each entry that this vocabulary names, by section and name."""
    entries: dict[Place, dict[str, Any]] = {place: {} for place in SECTIONS}
    for name, symbol in words.parameters.items():
        fixed = _limited(symbol, _HELD[symbol.held])
        kinds = {
            ("parameters",): _with_number(
                numbers.SignedSpec if symbol.signed else numbers.ParameterSpec, fixed
            ),
            ("nominal",): _with_number(numbers.NominalSpec, _limited(symbol, Positive)),
            ("nominal", "tolerance"): Tolerance | None,
            ("simulation",): fixed | None,
        }
        for place, kind in kinds.items():
            about = Field(description=f"{symbol.meaning} [{symbol.unit}]")
            entries[place][name] = Annotated[kind, about]
    inputs = entries["inputs",]
    for name, symbol in words.inputs.items():
        spec: Any = InputSpec if name in words.optional_inputs else InputSpec | None
        about = Field(description=f"{symbol.meaning} [{symbol.plain_unit}]")
        inputs[name] = Annotated[spec, about]
        if angle := words.angles.get(name):
            what = "angle" if angle.unit == "rad" else "position"
            text = f"the measured {what}, which is imposed on the rig."
            about = Field(description=f"[{angle.unit}] Replaces {name}: {text}")
            inputs[angle.name] = Annotated[AngleColumn | None, about]
    inputs[DELAY] = numbers.DelaySpec
    entries["initial",] = dict.fromkeys(words.starts, numbers.StateSpec)
    entries["missing_torque",] = {"at": Literal[words.inertias]}
    return entries


@cache
def adapter(kind: Any) -> TypeAdapter[Any]:
    """Return the adapter that validates a section or an entry of this type."""
    section = isinstance(kind, type) and issubclass(kind, Strict)
    return TypeAdapter(kind, config=None if section else Strict.model_config)


def read_config(
    data: Any, words: Vocabulary, previous: tuple[Any, Config] | None = None
) -> tuple[Config | None, list[EntryError]]:
    """Return the config from plain data (None if it has errors), and the errors of all entries.

    Entries equal to those of an earlier validation, `previous` (data, config), are not revalidated.
    """
    errors: list[EntryError] = []
    if previous is not None and previous[1].vocabulary == words:
        data = _with_known(data, *previous)
    read = _with_named_entries((), data, words, errors)
    config, others = read_entry(Config, read, (), words)
    return (None if errors else config), [*others, *errors]  # the last error of an entry counts


def read_entry(
    kind: Any, value: Any, path: Place, words: Vocabulary | None = None
) -> tuple[Any, list[EntryError]]:
    """Return the validated value at a place (None if it has errors), and its errors.

    An error is pydantic's mapping with two more keys: `kind` is the type of the entry at `loc[:depth]`.
    """
    try:
        return adapter(kind).validate_python(value, context=words), []
    except ValidationError as error:
        more = {"kind": kind, "depth": len(path)}
        return None, [{**item, "loc": (*path, *item["loc"]), **more} for item in error.errors()]


def _with_known(data: Any, plain: Any, validated: Any) -> Any:
    """Return `data`; entries equal to those of `plain` are replaced by those of `validated`."""
    if repr(data) == repr(plain):  # `==` does not distinguish 1, 1.0 and true
        return validated
    if not (isinstance(data, dict) and isinstance(plain, dict)):
        return data
    entries = dict(validated) if isinstance(validated, dict | BaseModel) else {}
    both = plain.keys() & entries.keys()
    return {
        key: _with_known(value, plain[key], entries[key]) if key in both else value
        for key, value in data.items()
    }


def _with_named_entries(
    path: Place, section: Any, words: Vocabulary, errors: list[EntryError]
) -> Any:
    """Return a section whose named entries are validated, in the order in which a rig lists them.

    Entries that have an error are left out.
    """
    if not isinstance(section, dict):
        return section
    entries, others, read = named_entries(words)[path], SECTIONS[path].model_fields, {}
    for name in [name for name in dict.fromkeys((*entries, *section)) if name in section]:
        inner, value, wrong = (*path, name), section[name], list[EntryError]()
        if name in entries:
            value, wrong = read_entry(entries[name], value, inner)
        elif name not in others:
            unknown = {"type": "extra_forbidden", "loc": inner, "input": value}
            wrong = [{**unknown, "known": [*entries, *others], "is_train": words is not HOUSE}]
        elif inner in SECTIONS:
            value = _with_named_entries(inner, value, words, errors)
        errors += wrong
        if not wrong:
            read[name] = value
    return read
