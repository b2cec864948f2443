"""Frozen records that compare by content, checks of arguments, and records as JSON.

Records can be pickled.  Arguments of the API are checked against their annotations: only the type of
each, and whether a text can be a path.  Ranges and names are checked by each function itself.  A
type that a module imports for annotations alone accepts anything.

Frozen records are written as data for JSON, and read back by the types of their fields.  Floats keep
all digits; infinities and NaN are the strings `Infinity`, `-Infinity` and `NaN`.
"""

from __future__ import annotations

import builtins
import dataclasses
import functools
import inspect
import json
import re
import typing
from collections import defaultdict
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from functools import cache
from numbers import Integral, Real
from os import PathLike, fspath
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Union, cast

import numpy as np

from bayesdrill.basics.errors import InputError, Issue


class Value:
    """A base of frozen dataclasses (`eq=False`) that are equal by fields and pickled without caches."""

    __slots__ = ()

    def __eq__(self, other: object) -> bool:
        return equal_content(self, other) if type(other) is type(self) else NotImplemented

    def __hash__(self) -> int:
        return hash(type(self))  # fields may have no hash; sets compare their few members

    def __getstate__(self) -> dict[str, Any]:
        fields = dataclasses.fields(self)  # type: ignore[arg-type]  # subclasses are dataclasses
        return {field.name: getattr(self, field.name) for field in fields}

    def __setstate__(self, state: Mapping[str, Any]) -> None:
        for name, value in state.items():
            object.__setattr__(self, name, value)


def equal_content(first: Any, second: Any) -> bool:
    """Return whether two objects have the same type and content; NaN equals NaN, caches are ignored."""
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


# For each annotation the types that are accepted, and its name in a message.
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


def check_arguments[T](target: T) -> T:
    """Decorate a function, or all public methods of a class, to check arguments against annotations.

    The call raises `InputError` with every argument of a wrong type at once.  A message for one type
    is given by `Annotated[type, "what to give"]`.
    """
    if isinstance(target, type):
        for name, member in list(vars(target).items()):
            public = name == "__init__" or not name.startswith("_")
            if public and isinstance(member, staticmethod):
                setattr(target, name, staticmethod(_guarded(member.__func__)))
            elif public and inspect.isfunction(member):
                setattr(target, name, _guarded(member))
        return cast("T", target)
    return cast("T", _guarded(cast("Callable[..., Any]", target)))


def _guarded(call: Callable[..., Any]) -> Callable[..., Any]:
    signature = inspect.signature(call)

    @functools.cache
    def hints() -> Mapping[str, Any]:
        # A name that the module has only for type checkers accepts anything.
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
    """Return whether a value has the type of an annotation; its contents are not checked."""
    kind = typing.get_origin(hint) or hint
    if kind is typing.Literal:
        return isinstance(value, str) and value in typing.get_args(hint)
    if kind is Any or not isinstance(kind, type):
        return True
    if getattr(kind, "_is_protocol", False) and not getattr(kind, "_is_runtime_protocol", False):
        return True  # `isinstance` cannot check this protocol
    if getattr(value, "shape", None) == ():  # a NumPy scalar
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
    except (OSError, ValueError, TypeError, RuntimeError) as error:  # RuntimeError: ~ without home
        reason = getattr(error, "strerror", None) or error
        yield Issue(location, f"this cannot be a path ({reason}); give another")


FIELD_LINE = re.compile(r"(?P<name>\w+): (?P<description>.+?)(?: \[(?P<unit>.+)\])?")
LABEL_FIELDS = ("name", "channel", "label", "parameter")  # fields that name a record in a list


def as_data(value: Any) -> Any:
    """Convert a record and its contents to mappings, lists, numbers and strings for JSON."""
    from pydantic_core import to_json

    return json.loads(to_json(value, inf_nan_mode="strings", fallback=_plain))


def _plain(value: Any) -> Any:
    return dict(value) if isinstance(value, Mapping) else value.tolist()


def from_data[T](kind: type[T], data: Any, *, strict: bool = False) -> T:
    """Convert data of `as_data` back to a record, or typed mapping, of this kind.

    Raises `ValueError` for wrong names or types, and with `strict` also for numbers as strings.
    """
    # Lone surrogates, as in the name of a file, are replaced, since pydantic rejects them.
    text = json.dumps(data, ensure_ascii=False).encode("utf-8", "replace")
    return cast("T", _adapter(cast("Hashable", kind)).validate_json(text, strict=strict))


@cache
def _adapter(kind: Hashable) -> Any:
    from pydantic import TypeAdapter  # late: few commands read such files

    return TypeAdapter(cast("type", kind))


def field_descriptions(kind: type) -> dict[str, dict[str, str]]:
    """Parse descriptions and units from lines such as `size: the diameter [m]` of a docstring."""
    lines = map(FIELD_LINE.fullmatch, (inspect.getdoc(kind) or "").splitlines())
    parts = {line["name"]: line.groupdict() for line in lines if line}
    return {
        field.name: {
            key: text for key, text in parts.get(field.name, {}).items() if text and key != "name"
        }
        for field in dataclasses.fields(kind)
    }


def leaves(data: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the numbers, strings and Nones of data with names such as `unknowns.k_s.mean`."""
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
