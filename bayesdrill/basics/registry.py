"""Members of a kind by name: those that stand here and those that installed packages bring; names
that load late.
"""

from __future__ import annotations

import ast
import importlib
import inspect
import itertools
import re
import sys
import traceback
from collections.abc import Callable, Iterator, Mapping
from functools import cache, cached_property
from importlib.metadata import EntryPoint, EntryPoints, entry_points
from typing import Any

from bayesdrill.basics.errors import Stopped, did_you_mean


@cache
def public_names(package: str) -> dict[str, str]:
    """What a package imports under `TYPE_CHECKING`, for others to have: by name, the module of each."""
    tree = ast.parse(inspect.getsource(sys.modules[package]))
    blocks = (node.body for node in tree.body if isinstance(node, ast.If))
    imports = (node for body in blocks for node in body if isinstance(node, ast.ImportFrom))
    return {alias.name: str(node.module) for node in imports for alias in node.names}


def late(package: str) -> Callable[[str], Any]:
    """The `__getattr__` of a package: loads each of its `public_names` when it is asked for."""

    def find(name: str) -> Any:
        known = {} if name.startswith("__") else public_names(package)  # Python asks for `__path__`
        if name not in known:
            raise AttributeError(f"{package} has no {name}; it has {', '.join(known)}")
        return getattr(importlib.import_module(known[name]), name)

    return find


def callable_one(_: str, member: Any) -> None:
    """Raises `ValueError` where what another package brings cannot be called."""
    if not callable(member):
        raise ValueError(f"a function is wanted, not {type(member).__name__}")


class Registry[T](Mapping[str, T]):
    """Of `what`: `own` members, then the entry points `bayesdrill.<what>` of installed packages.

    A member of another package is loaded when it is asked for, and raises `ValueError` when it cannot
    be; one with the name of an own member is never asked for.
    """

    def __init__(
        self, what: str, own: Mapping[str, T], judge: Callable[[str, Any], None] | None = None
    ) -> None:
        """`judge(name, member)` raises `ValueError` where what another package brings is none."""
        self.what = what
        self._own = dict(own)
        self._judge = judge
        self._loaded: dict[str, T] = {}

    @cached_property
    def _brought(self) -> dict[str, EntryPoint]:
        found = _every_entry_point().select(group=f"bayesdrill.{self.what}")
        every = {one.name: one for one in sorted(found, key=lambda one: one.name)}
        return {name: one for name, one in every.items() if name not in self._own}

    def __getitem__(self, name: str) -> T:
        if name in self._own:
            return self._own[name]
        if name not in self._loaded:
            self._loaded[name] = self._load(self._brought[name])
        return self._loaded[name]

    def _load(self, one: EntryPoint) -> T:
        try:
            member: T = one.load()
            if self._judge is not None:
                self._judge(one.name, member)
        except Stopped:
            raise
        except BaseException as error:  # whatever the code of others does
            raise ValueError(
                f"{one.name} is brought by {_package(one)}, and cannot be used from {one.value} "
                f"({_why(error)}); mend or remove that package"
            ) from None
        return member

    def __iter__(self) -> Iterator[str]:
        return itertools.chain(self._own, self._brought)

    def __len__(self) -> int:
        return len(self._own) + len(self._brought)

    def __contains__(self, name: object) -> bool:
        return name in self._own or name in self._brought

    def usable(self) -> dict[str, T]:
        """All but those that cannot be loaded."""
        found = {}
        for name in self:
            try:
                found[name] = self[name]
            except ValueError:
                continue
        return found


@cache
def _every_entry_point() -> EntryPoints:
    """Of all packages: to look for them takes some milliseconds."""
    return entry_points()


def blame(error: BaseException) -> str:
    """Of what went wrong in the code of another package: which, and where; else empty."""
    text = "".join(traceback.format_exception(error))  # of a worker's too
    for one in _every_entry_point():
        top = one.module.partition(".")[0]
        file = getattr(sys.modules.get(top), "__file__", None)
        if not one.group.startswith("bayesdrill.") or top == "bayesdrill" or file is None:
            continue
        place = re.escape(file.removesuffix("__init__.py"))
        lines = re.findall(rf'File "({place}[^"]*)", line (\d+)', text)
        if lines:
            return (
                f"{one.name} is brought by {_package(one)}, and failed in {':'.join(lines[-1])} "
                f"({_why(error)}); mend or remove that package"
            )
    return ""


def _package(one: EntryPoint) -> str:
    return one.dist.name if one.dist else "an installed package"


def _why(error: BaseException) -> str:
    try:
        said = str(error)
    except Exception:  # that, too, is code of others
        said = ""
    kind = type(error).__name__
    return said if said and isinstance(error, ValueError) else f"{kind}: {said}".removesuffix(": ")


def lookup[T](members: Mapping[str, T], name: str, what: str) -> T:
    """Raises `ValueError` with the nearest name there is."""
    if name not in members:
        raise ValueError(f"'{name}' is not a {what}{did_you_mean(name, members)}")
    return members[name]
