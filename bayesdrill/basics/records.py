"""Frozen records as data for JSON and back again, by the types of their fields; and their JSON schema.

Floats keep all digits; those that JSON has no number for are the strings `inf`, `-inf` and `nan`.
"""

from __future__ import annotations

import dataclasses
import inspect
import math
import re
from collections.abc import Iterator, Mapping
from functools import cache
from types import NoneType, UnionType
from typing import Any, Literal, Union, cast, get_args, get_origin, get_type_hints

import numpy as np

NUMBER: dict[str, Any] = {"anyOf": [{"type": "number"}, {"enum": ["inf", "-inf", "nan"]}]}
PLAIN: dict[Any, dict[str, Any]] = {
    float: NUMBER,
    int: {"type": "integer"},
    str: {"type": "string"},
    bool: {"type": "boolean"},
}
DESCRIBED = re.compile(r"(?P<name>\w+): (?P<description>.+?)(?: \[(?P<unit>.+)\])?")
NAMES = ("name", "channel", "label", "parameter")  # fields by which a record is known in a list


def as_data(value: Any) -> Any:
    """Mappings, lists, numbers and strings, of a record and all that it holds."""
    if dataclasses.is_dataclass(value):
        return {f.name: as_data(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {str(key): as_data(one) for key, one in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return as_data(value.tolist())
    if isinstance(value, list | tuple):
        return [as_data(one) for one in value]
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value


def from_data[T](kind: type[T], data: Any) -> T:
    """The record of what `as_data` gave; raises `ValueError` where names or types are not right."""
    try:
        return cast("T", _read(kind, data))
    except (KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"no {kind.__name__}: {error}") from None


def _read(kind: Any, data: Any) -> Any:
    origin, inside = _parts(kind)
    if origin in (Union, UnionType):
        return None if data is None else _read(_but_none(inside), data)
    if origin is Literal and data in inside:
        return data
    if origin is np.ndarray:
        return np.array(data, dtype=float)
    if origin is tuple:
        kinds = inside[:1] * len(data) if inside[1:] == (...,) else inside
        return tuple(_read(*pair) for pair in zip(kinds, data, strict=True))
    if origin is Mapping:
        return {name: _read(inside[1], one) for name, one in data.items()}
    if dataclasses.is_dataclass(kind) and {*_hints(cast("type", kind))} == {*data}:
        hints = _hints(cast("type", kind))
        return cast("type", kind)(**{name: _read(hints[name], data[name]) for name in hints})
    if kind is float:
        return float(data)
    if kind not in PLAIN or not isinstance(data, kind):
        raise ValueError(f"{str(data)[:100]} is no {kind}")
    return data


def _parts(kind: Any) -> tuple[Any, tuple[Any, ...]]:
    """Its origin, through an alias such as that of arrays, and what is in its brackets."""
    origin = get_origin(kind)
    return get_origin(getattr(origin, "__value__", None)) or origin, get_args(kind)


def _but_none(kinds: tuple[Any, ...]) -> Any:
    (kind,) = (one for one in kinds if one is not NoneType)
    return kind


@cache
def _hints(kind: type) -> dict[str, Any]:
    hints = get_type_hints(kind)
    return {field.name: hints[field.name] for field in dataclasses.fields(kind)}


def described(kind: type) -> dict[str, dict[str, str]]:
    """What fields are, by name, with their units: lines such as `size: how large it is [m]` of the
    docstring.
    """
    lines = map(DESCRIBED.fullmatch, (inspect.getdoc(kind) or "").splitlines())
    found = {line["name"]: line.groupdict() for line in lines if line}
    parts = {name: found.get(name, {}) for name in _hints(kind)}
    return {
        name: {key: text for key, text in one.items() if text and key != "name"}
        for name, one in parts.items()
    }


def schema(kind: type) -> dict[str, Any]:
    """The JSON schema of what `as_data` makes of a record."""
    found: dict[str, Any] = {}
    return {**_schema(kind, found), "$defs": dict(sorted(found.items()))}


def _schema(kind: Any, found: dict[str, Any]) -> dict[str, Any]:
    origin, inside = _parts(kind)
    if origin in (Union, UnionType):
        return {"anyOf": [_schema(_but_none(inside), found), {"type": "null"}]}
    if origin is Literal:
        return {"enum": [*inside]}
    if origin is np.ndarray:
        row = {"type": "array", "items": NUMBER}  # of a matrix
        return {"type": "array", "items": {"anyOf": [*NUMBER["anyOf"], row]}}
    if origin is tuple and inside[1:] == (...,):
        return {"type": "array", "items": _schema(inside[0], found)}
    if origin is tuple:
        return {"type": "array", "prefixItems": [_schema(one, found) for one in inside]}
    if origin is Mapping:
        return {"type": "object", "additionalProperties": _schema(inside[1], found)}
    if not dataclasses.is_dataclass(kind):
        return PLAIN[kind]
    record = cast("type", kind)
    name = f"{record.__module__.rpartition('.')[2]}.{record.__name__}"
    if name not in found:
        found[name] = {}  # it may hold others of its kind
        hints, said = _hints(record), described(record)
        found[name] = {
            "type": "object",
            "description": inspect.getdoc(record),
            "properties": {key: _schema(hints[key], found) | said[key] for key in hints},
            "required": [*hints],
            "additionalProperties": False,
        }
    return {"$ref": f"#/$defs/{name}"}


def leaves(data: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Numbers, strings and what is None in what `as_data` gave, by names such as `unknowns.k_s.mean`."""
    if isinstance(data, Mapping):
        parts = {str(key): one for key, one in data.items()}
    elif isinstance(data, list):
        parts = {_known(k, one): one for k, one in enumerate(data)}
        parts = parts if len(parts) == len(data) else {str(k): one for k, one in enumerate(data)}
    else:
        yield name, data
        return
    for key, one in parts.items():
        yield from leaves(one, f"{name}.{key}" if name else key)


def _known(k: int, one: Any) -> str:
    names = [one[key] for key in NAMES if one.get(key)] if isinstance(one, Mapping) else []
    return str(names[0]) if names else str(k)
