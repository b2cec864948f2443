"""The registry of optimisers: one file and one line here, or an entry point `bayesdrill.optimiser`."""

from __future__ import annotations

from bayesdrill.basics.registry import Registry
from bayesdrill.engines.optimisers.contract import Optimiser
from bayesdrill.engines.optimisers.nelder_mead import NelderMead

OPTIMISERS: Registry[type[Optimiser]] = Registry("optimiser", {"nelder_mead": NelderMead})
