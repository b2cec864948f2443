"""Records that are equal where all they hold is, arrays among it, and that can be pickled."""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Mapping
from typing import Any

import numpy as np


class Value:
    """A frozen dataclass (`eq=False`): equal by its fields, pickled without what it has cached."""

    __slots__ = ()

    def __eq__(self, other: object) -> bool:
        return alike(self, other) if type(other) is type(self) else NotImplemented

    def __hash__(self) -> int:
        return hash(type(self))  # what it holds may have no hash; the few in one set are compared

    def __getstate__(self) -> dict[str, Any]:
        fields = dataclasses.fields(self)  # type: ignore[arg-type]  # each that inherits is one
        return {field.name: getattr(self, field.name) for field in fields}

    def __setstate__(self, state: Mapping[str, Any]) -> None:
        for name, value in state.items():
            object.__setattr__(self, name, value)


def alike(one: Any, other: Any) -> bool:
    """Whether two things are of one type and hold the same: NaN is as NaN, and caches do not count."""
    if one is other:
        return True
    if type(one) is not type(other):
        return False
    if isinstance(one, np.ndarray):
        return _same_array(one, other)
    if isinstance(one, Mapping):
        return one.keys() == other.keys() and all(alike(one[key], other[key]) for key in one)
    if isinstance(one, list | tuple):
        return len(one) == len(other) and all(map(alike, one, other))
    if isinstance(one, type) or inspect.isroutine(one):
        return False
    if dataclasses.is_dataclass(one):
        compared = (field.name for field in dataclasses.fields(one) if field.compare)
        return all(alike(getattr(one, name), getattr(other, name)) for name in compared)
    if getattr(type(one), "__eq__", None) is object.__eq__:
        return alike(one.__getstate__(), other.__getstate__())
    is_nan = one != one and other != other
    return bool(one == other or is_nan)


def _same_array(one: np.ndarray, other: np.ndarray) -> bool:
    numeric = one.dtype.kind in "fc"
    return one.dtype == other.dtype and np.array_equal(one, other, equal_nan=numeric)
