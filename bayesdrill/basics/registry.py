"""Members of a kind by name: those that stand here, and those that installed packages bring."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cached_property
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from bayesdrill.basics.errors import did_you_mean


class Registry[T](Mapping[str, T]):
    """Of `what`: `own` members, then the entry points `bayesdrill.<what>` of installed packages.

    A member of another package is loaded when it is asked for, and raises `ValueError` when it cannot
    be; one with the name of an own member is never asked for.
    """

    def __init__(self, what: str, own: Mapping[str, T]) -> None:
        self.what = what
        self._own = dict(own)

    @cached_property
    def _brought(self) -> dict[str, EntryPoint]:
        found = entry_points(group=f"bayesdrill.{self.what}")
        return {one.name: one for one in sorted(found, key=lambda one: one.name)}

    def __getitem__(self, name: str) -> T:
        if name in self._own:
            return self._own[name]
        found: T = _loaded(self._brought[name])
        return found

    def __iter__(self) -> Iterator[str]:
        return iter({**self._own, **self._brought})

    def __len__(self) -> int:
        return len({**self._own, **self._brought})

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


def lookup[T](members: Mapping[str, T], name: str, what: str) -> T:
    """Raises `ValueError` with the nearest name there is."""
    if name not in members:
        raise ValueError(f"'{name}' is not a {what}{did_you_mean(name, members)}")
    return members[name]


def _loaded(one: EntryPoint) -> Any:
    try:
        return one.load()
    except Exception as error:  # whatever the code of others does
        package = one.dist.name if one.dist else "an installed package"
        raise ValueError(
            f"{one.name} is brought by {package}, and cannot be loaded from {one.value} "
            f"({type(error).__name__}: {error}); mend or remove that package"
        ) from None
