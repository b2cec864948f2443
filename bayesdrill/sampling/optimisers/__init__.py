"""Register the optimisers: add a file and a line here, or an entry point `bayesdrill.optimiser`."""

from __future__ import annotations

from typing import Any

from bayesdrill.basics.entries import entries_model
from bayesdrill.basics.registry import Registry
from bayesdrill.sampling.optimisers.contract import Optimiser
from bayesdrill.sampling.optimisers.nelder_mead import NelderMead


def _is_optimiser(_: str, member: Any) -> None:
    missing = [name for name in ("check", "__call__") if not hasattr(member, name)]
    if not isinstance(member, type) or missing:
        raise ValueError(f"an optimiser is a dataclass with {', '.join(missing) or 'entries'}")
    entries_model(member)


OPTIMISERS: Registry[type[Optimiser]] = Registry(
    "optimiser", {"nelder_mead": NelderMead}, judge=_is_optimiser
)
