"""Frozen records that compare by content, and what is given and stored of them.

Records can be pickled.  The check of arguments against annotations is the border of the API: what
is given must be what annotations say, wherever it is given.  Only kinds are looked at, and whether
a path can be one; what a number may be, and what names there are, is for each call to say.  Names
of types that a module imports for annotations alone let pass all.

Frozen records are written as data for JSON and read back again, by the types of their fields; and
so is their JSON schema.  Floats keep all digits; those that JSON has no number for are the strings
`inf`, `-inf` and `nan`.
"""

from __future__ import annotations

import builtins
import dataclasses
import functools
import inspect
import math
import re
import typing
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from numbers import Integral, Real
from os import PathLike, fspath
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, cast, get_args, get_origin, get_type_hints

import numpy as np

from bayesdrill.basics.errors import InputError, Issue


class Value:
    """A frozen dataclass (`eq=False`): equal by its fields, pickled without what it has cached."""

    __slots__ = ()

    def __eq__(self, other: object) -> bool:
        return equal_content(self, other) if type(other) is type(self) else NotImplemented

    def __hash__(self) -> int:
        return hash(type(self))  # what it holds may have no hash; the few in one set are compared

    def __getstate__(self) -> dict[str, Any]:
        fields = dataclasses.fields(self)  # type: ignore[arg-type]  # each that inherits is one
        return {field.name: getattr(self, field.name) for field in fields}

    def __setstate__(self, state: Mapping[str, Any]) -> None:
        for name, value in state.items():
            object.__setattr__(self, name, value)


def equal_content(first: Any, second: Any) -> bool:
    """Tell whether two objects are of one type and content; NaN equals NaN, caches do not count."""
    if first is second:
        return True
    if type(first) is not type(second):
        return False
    if isinstance(first, np.ndarray):
        numeric = first.dtype.kind in "fc"
        return first.dtype == second.dtype and np.array_equal(first, second, equal_nan=numeric)
    if isinstance(first, Mapping):
        return first.keys() == second.keys() and all(
            equal_content(first[key], second[key]) for key in first
        )
    if isinstance(first, list | tuple):
        return len(first) == len(second) and all(map(equal_content, first, second))
    if isinstance(first, type) or inspect.isroutine(first):
        return False
    if dataclasses.is_dataclass(first):
        compared = (field.name for field in dataclasses.fields(first) if field.compare)
        return all(equal_content(getattr(first, name), getattr(second, name)) for name in compared)
    if getattr(type(first), "__eq__", None) is object.__eq__:
        return equal_content(first.__getstate__(), second.__getstate__())
    is_nan = first != first and second != second
    return bool(first == second or is_nan)


# Of what an annotation names: the kinds that fit, and what a message calls it.
KINDS: Mapping[Any, tuple[tuple[type, ...], str]] = {
    bool: ((bool,), "True or False"),
    int: ((Integral,), "a whole number"),
    float: ((Real,), "a number"),
    str: ((str,), "a text"),
    Path: ((PathLike,), "a path"),
    Mapping: ((Mapping,), "a mapping of names"),
    Sequence: ((list, tuple), "a list"),
    tuple: ((tuple,), "a tuple"),
    NoneType: ((NoneType,), "None"),
}
UNIONS = (Union, UnionType)


def check_arguments[T](what: T) -> T:
    """Return a function, or a class with all public methods, that checks its arguments.

    It raises `InputError` for what is none of the kinds that its annotations name, with every such
    argument at once; `Annotated[kind, "what to give"]` says it in words of its own.
    """
    if isinstance(what, type):
        for name, member in list(vars(what).items()):
            public = name == "__init__" or not name.startswith("_")
            if public and isinstance(member, staticmethod):
                setattr(what, name, staticmethod(_guarded(member.__func__)))
            elif public and inspect.isfunction(member):
                setattr(what, name, _guarded(member))
        return cast("T", what)
    return cast("T", _guarded(cast("Callable[..., Any]", what)))


def _guarded(call: Callable[..., Any]) -> Callable[..., Any]:
    signature = inspect.signature(call)

    @functools.cache
    def hints() -> Mapping[str, Any]:
        # The names of its module; those that it has not stand for anything.
        names = defaultdict[str, Any](lambda: Any, vars(builtins) | call.__globals__)
        return typing.get_type_hints(call, {}, names, include_extras=True)

    @functools.wraps(call)
    def guarded(*arguments: Any, **named: Any) -> Any:
        given = signature.bind(*arguments, **named).arguments
        known = ((name, value, hints().get(name, Any)) for name, value in given.items())
        wrong = [problem for argument in known for problem in _mismatches(*argument)]
        if wrong:
            raise InputError(wrong)
        return call(*arguments, **named)

    return guarded


def _mismatches(location: str, value: Any, hint: Any) -> Iterator[Issue]:
    words = ""
    if typing.get_origin(hint) is Annotated:
        hint, words = typing.get_args(hint)
    choices = typing.get_args(hint) if typing.get_origin(hint) in UNIONS else (hint,)
    hint = next((choice for choice in choices if _fits(value, choice)), None)
    kind = typing.get_origin(hint)
    if hint is None:
        yield Issue(location, f"give {words or _in_words(choices)}, not {type(value).__name__}")
    elif kind in (Sequence, tuple):
        for number, item in enumerate(value, start=1):
            yield from _mismatches(f"{location}, number {number}", item, typing.get_args(hint)[0])
    elif kind is Mapping and not all(isinstance(name, str) for name in value):
        yield Issue(location, "its names must be texts")
    elif hint in (str, Path) and Path in choices:
        yield from _no_path(location, value)


def _fits(value: Any, hint: Any) -> bool:
    """Tell whether a value is of that kind; what it contains is not looked at."""
    kind = typing.get_origin(hint) or hint
    if kind is typing.Literal:
        return isinstance(value, str) and value in typing.get_args(hint)
    if kind is Any or not isinstance(kind, type):
        return True
    if getattr(kind, "_is_protocol", False) and not getattr(kind, "_is_runtime_protocol", False):
        return True  # at which `isinstance` cannot look
    if getattr(value, "shape", None) == ():  # a number of NumPy
        value = value.item()
    kinds = KINDS[kind][0] if kind in KINDS else kind
    return isinstance(value, kinds) and (not isinstance(value, bool) or kind not in (int, float))


def _in_words(choices: Sequence[Any]) -> str:
    return " or ".join(
        _word(choice) for choice in choices if choice is not str or Path not in choices
    )


def _word(hint: Any) -> str:
    kind, inner = typing.get_origin(hint) or hint, typing.get_args(hint)
    if kind is typing.Literal:
        return " or ".join(map(repr, inner))
    if kind in (Sequence, tuple):
        return f"{KINDS[kind][1]} (each {_in_words(typing.get_args(inner[0]) or inner[:1])})"
    if getattr(kind, "_is_protocol", False):
        return f"an object that has {' and '.join(sorted(kind.__protocol_attrs__))}"
    return KINDS[kind][1] if kind in KINDS else f"a {kind.__name__}"


def _no_path(location: str, value: str | PathLike[str]) -> Iterator[Issue]:
    if not fspath(value):
        yield Issue(location, "the path is empty; '.' is the folder of this process")
    try:
        Path(value).expanduser().lstat()
    except (FileNotFoundError, NotADirectoryError, PermissionError):
        pass
    except (OSError, ValueError, TypeError, RuntimeError) as error:  # RuntimeError: ~ of nobody
        reason = getattr(error, "strerror", None) or error
        yield Issue(location, f"this cannot be a path ({reason}); give another")


NUMBER: dict[str, Any] = {"anyOf": [{"type": "number"}, {"enum": ["inf", "-inf", "nan"]}]}
PLAIN_TYPES: dict[Any, dict[str, Any]] = {
    float: NUMBER,
    int: {"type": "integer"},
    str: {"type": "string"},
    bool: {"type": "boolean"},
}
FIELD_LINE = re.compile(r"(?P<name>\w+): (?P<description>.+?)(?: \[(?P<unit>.+)\])?")
LABEL_FIELDS = ("name", "channel", "label", "parameter")  # by which a record is known in a list


def as_data(value: Any) -> Any:
    """Return mappings, lists, numbers and strings of a record and all that it contains."""
    if dataclasses.is_dataclass(value):
        return {f.name: as_data(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {str(key): as_data(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return as_data(value.tolist())
    if isinstance(value, list | tuple):
        return [as_data(item) for item in value]
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value


def from_data[T](kind: type[T], data: Any) -> T:
    """Return the record of what `as_data` gave; raises `ValueError` where names or types are wrong."""
    try:
        return cast("T", _read(kind, data))
    except (KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"no {kind.__name__}: {error}") from None


def _read(kind: Any, data: Any) -> Any:
    origin, inside = _parts(kind)
    if origin in (Union, UnionType):
        (choice,) = inside
        return None if data is None else _read(choice, data)
    if origin is Literal and data in inside:
        return data
    if origin is np.ndarray:
        return np.array(data, dtype=float)
    if origin is tuple:
        kinds = inside[:1] * len(data) if inside[1:] == (...,) else inside
        return tuple(_read(*pair) for pair in zip(kinds, data, strict=True))
    if origin is Mapping:
        return {name: _read(inside[1], item) for name, item in data.items()}
    record = cast("type", kind)
    if dataclasses.is_dataclass(kind) and _hints(record).keys() == {*data}:
        return record(**{name: _read(hint, data[name]) for name, hint in _hints(record).items()})
    if kind is float:
        return float(data)
    if kind not in PLAIN_TYPES or not isinstance(data, kind):
        raise ValueError(f"{str(data)[:100]} is no {kind}")
    return data


def _parts(kind: Any) -> tuple[Any, tuple[Any, ...]]:
    """Return a type's origin, through an alias such as that of arrays, and what it is of but None."""
    origin = get_origin(kind)
    inside = tuple(part for part in get_args(kind) if part is not NoneType)
    return get_origin(getattr(origin, "__value__", None)) or origin, inside


@cache
def _hints(kind: type) -> dict[str, Any]:
    hints = get_type_hints(kind)
    return {field.name: hints[field.name] for field in dataclasses.fields(kind)}


def field_descriptions(kind: type) -> dict[str, dict[str, str]]:
    """Return descriptions and units by lines such as `size: how large it is [m]` of the docstring."""
    lines = map(FIELD_LINE.fullmatch, (inspect.getdoc(kind) or "").splitlines())
    parts = {line["name"]: line.groupdict() for line in lines if line}
    return {
        name: {key: text for key, text in parts.get(name, {}).items() if text and key != "name"}
        for name in _hints(kind)
    }


def schema(kind: type) -> dict[str, Any]:
    """Return the JSON schema of what `as_data` makes of a record."""
    definitions: dict[str, Any] = {}
    return {**_schema(kind, definitions), "$defs": dict(sorted(definitions.items()))}


def _schema(kind: Any, definitions: dict[str, Any]) -> dict[str, Any]:
    origin, inside = _parts(kind)
    if origin in (Union, UnionType):
        (choice,) = inside
        return {"anyOf": [_schema(choice, definitions), {"type": "null"}]}
    if origin is Literal:
        return {"enum": [*inside]}
    if origin is np.ndarray:
        row = {"type": "array", "items": NUMBER}  # of a matrix
        return {"type": "array", "items": {"anyOf": [*NUMBER["anyOf"], row]}}
    if origin is tuple and inside[1:] == (...,):
        return {"type": "array", "items": _schema(inside[0], definitions)}
    if origin is tuple:
        return {"type": "array", "prefixItems": [_schema(item, definitions) for item in inside]}
    if origin is Mapping:
        return {"type": "object", "additionalProperties": _schema(inside[1], definitions)}
    if not dataclasses.is_dataclass(kind):
        return PLAIN_TYPES[kind]
    record = cast("type", kind)
    name = f"{record.__module__.rpartition('.')[2]}.{record.__name__}"
    if name not in definitions:
        definitions[name] = {}  # it may hold others of its kind
        fields = {
            key: _schema(_hints(record)[key], definitions) | description
            for key, description in field_descriptions(record).items()
        }
        definitions[name] = {
            "type": "object",
            "description": inspect.getdoc(record),
            "properties": fields,
            "required": [*fields],
            "additionalProperties": False,
        }
    return {"$ref": f"#/$defs/{name}"}


def leaves(data: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the numbers, strings and Nones of what `as_data` gave, by names like `unknowns.k_s.mean`."""
    if isinstance(data, Mapping):
        parts = {str(key): item for key, item in data.items()}
    elif isinstance(data, list):
        parts = {_known(k, item): item for k, item in enumerate(data)}
        parts = parts if len(parts) == len(data) else {str(k): item for k, item in enumerate(data)}
    else:
        yield name, data
        return
    for key, item in parts.items():
        yield from leaves(item, f"{name}.{key}" if name else key)


def _known(k: int, item: Any) -> str:
    fields = LABEL_FIELDS if isinstance(item, Mapping) else ()
    return str(next((item[key] for key in fields if item.get(key)), k))
