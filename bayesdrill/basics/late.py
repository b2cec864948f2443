"""Names that a package hands on, each loaded when it is first asked for."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from typing import Any


def late(package: str, places: Mapping[str, str]) -> Callable[[str], Any]:
    """The `__getattr__` of a package; `places`: in which of its modules each name stands."""

    def find(name: str) -> Any:
        if name not in places:
            raise AttributeError(f"{package} has no {name}; it has {', '.join(places)}")
        return getattr(importlib.import_module(f"{package}.{places[name]}"), name)

    return find
