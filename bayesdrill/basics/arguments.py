"""Check types of arguments against annotations, and whether a string can be a path.

Decorated functions check ranges and names themselves.  `pydantic.validate_call` is not used: it
needs types that are imported only for type checkers, and a schema for each class of arguments.
"""

from __future__ import annotations

import builtins
import functools
import inspect
import typing
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from numbers import Integral, Real
from os import PathLike, fspath
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Union, cast

from bayesdrill.basics.errors import InputError, Issue

# Accepted types for each annotation, and the words for the annotation in messages.
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


def check_arguments[T](target: T) -> T:
    """Decorate a function, or all public methods of a class, so that calls check their arguments.

    A call raises `InputError` with all arguments whose types do not match their annotations.  An
    annotation `Annotated[type, "what to give"]` sets the message.  Types that a module imports only
    for type checkers accept any argument.
    """
    if not isinstance(target, type):
        return cast("T", _guarded(cast("Callable[..., Any]", target)))
    for name, member in list(vars(target).items()):
        public = name == "__init__" or not name.startswith("_")
        if public and isinstance(member, staticmethod):
            setattr(target, name, staticmethod(_guarded(member.__func__)))
        elif public and inspect.isfunction(member):
            setattr(target, name, _guarded(member))
    return cast("T", target)


def _guarded(call: Callable[..., Any]) -> Callable[..., Any]:
    signature = inspect.signature(call)

    @functools.cache
    def hints() -> Mapping[str, Any]:
        # Types that are imported only for type checkers are unknown here: accept any argument.
        names = defaultdict[str, Any](lambda: Any, vars(builtins) | call.__globals__)
        return typing.get_type_hints(call, {}, names, include_extras=True)

    @functools.wraps(call)
    def guarded(*arguments: Any, **named: Any) -> Any:
        given = signature.bind(*arguments, **named).arguments.items()
        known = ((name, value, hints().get(name, Any)) for name, value in given)
        if wrong := [problem for argument in known for problem in _mismatches(*argument)]:
            raise InputError(wrong)
        return call(*arguments, **named)

    return guarded


def _mismatches(location: str, value: Any, hint: Any) -> Iterator[Issue]:
    words = ""
    if typing.get_origin(hint) is Annotated:
        hint, words = typing.get_args(hint)
    choices = _choices(hint)
    hint = next((choice for choice in choices if _has_type(value, choice)), None)
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


def _choices(hint: Any) -> tuple[Any, ...]:
    return typing.get_args(hint) if typing.get_origin(hint) in (Union, UnionType) else (hint,)


def _has_type(value: Any, hint: Any) -> bool:
    """Return whether a value has the type of an annotation; items of the value are not checked."""
    kind = typing.get_origin(hint) or hint
    if kind is typing.Literal:
        return isinstance(value, str) and value in typing.get_args(hint)
    if kind is Any or not isinstance(kind, type):
        return True
    if getattr(kind, "_is_protocol", False) and not getattr(kind, "_is_runtime_protocol", False):
        return True  # `isinstance` needs `runtime_checkable`
    if getattr(value, "shape", None) == ():  # a NumPy scalar
        value = value.item()
    kinds = KINDS[kind][0] if kind in KINDS else kind
    return isinstance(value, kinds) and (not isinstance(value, bool) or kind not in (int, float))


def _in_words(choices: Sequence[Any]) -> str:
    paths = Path in choices  # messages do not mention that a string is also accepted
    return " or ".join(
        _describe_type(choice) for choice in choices if choice is not str or not paths
    )


def _describe_type(hint: Any) -> str:
    kind, inner = typing.get_origin(hint) or hint, typing.get_args(hint)
    if kind is typing.Literal:
        return " or ".join(map(repr, inner))
    if kind in (Sequence, tuple):
        return f"{KINDS[kind][1]} (each {_in_words(_choices(inner[0]))})"
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
    except (OSError, ValueError, TypeError, RuntimeError) as error:  # RuntimeError: no home folder
        reason = getattr(error, "strerror", None) or error
        yield Issue(location, f"this cannot be a path ({reason}); give another")
