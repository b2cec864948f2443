"""Compare frozen dataclasses by their contents, and pickle them without cached properties."""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Mapping
from typing import Any

import numpy as np


class Value:
    """A value is a frozen dataclass (`eq=False`), compared by its fields; pickles omit caches.

    With `repr=False`, `repr` returns the same text as `str`.
    """

    __slots__ = ()

    def __repr__(self) -> str:
        return str(self)

    def __eq__(self, other: object) -> bool:
        return equal_content(self, other) if type(other) is type(self) else NotImplemented

    def __hash__(self) -> int:
        return hash(type(self))  # fields may be unhashable; sets of values are small

    def __getstate__(self) -> dict[str, Any]:
        fields = dataclasses.fields(self)  # type: ignore[arg-type]  # subclasses are dataclasses
        return {field.name: getattr(self, field.name) for field in fields}

    def __setstate__(self, state: Mapping[str, Any]) -> None:
        for name, value in state.items():
            object.__setattr__(self, name, value)


def equal_content(first: Any, second: Any) -> bool:
    """Return whether types and contents are equal; NaN equals NaN, and caches are ignored."""
    if first is second:
        return True
    if type(first) is not type(second) or isinstance(first, type) or inspect.isroutine(first):
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
    if dataclasses.is_dataclass(first):
        compared = (field.name for field in dataclasses.fields(first) if field.compare)
        return all(equal_content(getattr(first, name), getattr(second, name)) for name in compared)
    if getattr(type(first), "__eq__", None) is object.__eq__:
        return equal_content(first.__getstate__(), second.__getstate__())
    return bool(first == second or (first != first and second != second))
