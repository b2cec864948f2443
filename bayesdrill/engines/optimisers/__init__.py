"""The registry of optimisers: to add one, write its file and one line here."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

from bayesdrill.engines.optimisers import fminsearch, nelder_mead, pairwise
from bayesdrill.engines.optimisers.contract import Optimum

OPTIMISERS: Mapping[str, Callable[..., Optimum]] = MappingProxyType(
    {
        "nelder_mead": nelder_mead.maximise,
        "fminsearch": fminsearch.maximise,
        "pairwise": pairwise.maximise,
    }
)
