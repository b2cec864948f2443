"""Look up members of registries, also from other packages; import public names lazily."""

from __future__ import annotations

import ast
import importlib
import inspect
import itertools
import re
import sys
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from functools import cache, cached_property
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from bayesdrill.basics.errors import did_you_mean, was_stopped


@cache
def public_names(package: str) -> dict[str, str]:
    """Return the module of each public name of a package, from imports under `TYPE_CHECKING`."""
    tree = ast.parse(inspect.getsource(sys.modules[package]))
    blocks = (node.body for node in tree.body if isinstance(node, ast.If))
    imports = (node for body in blocks for node in body if isinstance(node, ast.ImportFrom))
    return {alias.name: str(node.module) for node in imports for alias in node.names}


def lazy_attributes(package: str) -> Callable[[str], Any]:
    """Return a module's `__getattr__` that imports each of the `public_names` at its first use."""

    def find(name: str) -> Any:
        known = {} if name.startswith("__") else public_names(package)  # e.g. `__path__`
        if name not in known:
            raise AttributeError(f"{package} has no {name}; it has {', '.join(known)}")
        return getattr(importlib.import_module(known[name]), name)

    return find


def check_callable(_: str, member: Any) -> None:
    """Raise `ValueError` if a member of another package is not callable."""
    if not callable(member):
        raise ValueError(f"give a function, not {type(member).__name__}")


class Registry[T](Mapping[str, T]):
    """A registry maps names to members of the kind `what`, including those of entry points.

    Members of this package come first.  A member of another package is loaded at its first use, or
    `ValueError` is raised.  It is ignored if it has the name of a member of this package.
    """

    def __init__(
        self, what: str, members: Mapping[str, T], judge: Callable[[str, Any], None] | None = None
    ) -> None:
        """`judge(name, member)` raises `ValueError` for an unsuitable member of another package."""
        self.what = what
        self._members = dict(members)
        self._judge = judge
        self._loaded: dict[str, T] = {}

    @cached_property
    def _entry_points_of_kind(self) -> dict[str, EntryPoint]:
        points = _entry_points().select(group=f"bayesdrill.{self.what}")
        by_name = {point.name: point for point in sorted(points, key=lambda point: point.name)}
        return {name: point for name, point in by_name.items() if name not in self._members}

    def __getitem__(self, name: str) -> T:
        if name in self._members:
            return self._members[name]
        if name not in self._loaded:
            self._loaded[name] = self._load(self._entry_points_of_kind[name])
        return self._loaded[name]

    def _load(self, entry_point: EntryPoint) -> T:
        try:
            member: T = entry_point.load()
            if self._judge is not None:
                self._judge(entry_point.name, member)
        except BaseException as error:  # other packages may raise any exception
            if was_stopped(error):
                raise
            failure = f"cannot be used from {entry_point.value}"
            raise ValueError(_blame(entry_point, failure, error)) from None
        return member

    def __iter__(self) -> Iterator[str]:
        return itertools.chain(self._members, self._entry_points_of_kind)

    def __len__(self) -> int:
        return len(self._members) + len(self._entry_points_of_kind)

    def __contains__(self, name: object) -> bool:
        return name in self._members or name in self._entry_points_of_kind

    def usable(self) -> dict[str, T]:
        """Return all members that can be loaded."""
        members = {}
        for name in self:
            with suppress(ValueError):
                members[name] = self[name]
        return members


_entry_points = cache(entry_points)  # a search of all installed packages takes milliseconds


def blamed_package(error: BaseException) -> str:
    """Return a message that names the extension in which an error arose, or an empty text."""
    text = "".join(traceback.format_exception(error))  # includes the traceback in a worker
    for entry_point in _entry_points():
        top = entry_point.module.partition(".")[0]
        file = getattr(sys.modules.get(top), "__file__", None)
        if not entry_point.group.startswith("bayesdrill.") or file is None:
            continue
        prefix = re.escape(file.removesuffix("__init__.py"))
        lines = re.findall(rf'File "({prefix}[^"]*)", line (\d+)', text)
        if lines:
            return _blame(entry_point, f"failed in {':'.join(lines[-1])}", error)
    return ""


def _blame(entry_point: EntryPoint, failure: str, error: BaseException) -> str:
    package = entry_point.dist.name if entry_point.dist else "an installed package"
    try:
        reason = str(error)
    except Exception:  # `__str__` is code of that package, and may fail
        reason = ""
    if not reason or not isinstance(error, ValueError):
        reason = f"{type(error).__name__}: {reason}".removesuffix(": ")
    brought = f"{entry_point.name} comes from {package}"
    return f"{brought}, and {failure} ({reason}); repair or remove that package"


def lookup[T](members: Mapping[str, T], name: str, what: str) -> T:
    """Return the member with this name; raises `ValueError` with the most similar known name."""
    if name not in members:
        raise ValueError(f"'{name}' is not a {what}{did_you_mean(name, members)}")
    return members[name]
