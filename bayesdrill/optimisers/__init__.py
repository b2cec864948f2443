"""The registry of optimisers: to add one, write its file and one line here."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from bayesdrill.optimisers import nelder_mead
from bayesdrill.optimisers.contract import Optimiser

OPTIMISERS: Mapping[str, Optimiser] = MappingProxyType({"nelder_mead": nelder_mead.maximise})
