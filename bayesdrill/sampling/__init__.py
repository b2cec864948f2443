"""Find the maximum of a posterior (MAP) and sample it.

Samplers only use a log density, and depend on neither rigs nor files. The package `analysis`
interprets the draws.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from bayesdrill.basics.registry import lazy_attributes

if TYPE_CHECKING:
    from bayesdrill.sampling.ensembles import MemoryBackend as MemoryBackend
    from bayesdrill.sampling.ensembles import Plan as Plan
    from bayesdrill.sampling.ensembles import sample as sample
    from bayesdrill.sampling.optimisers.contract import Optimiser as Optimiser
    from bayesdrill.sampling.optimisers.contract import Optimum as Optimum
    from bayesdrill.sampling.optimisers.contract import Task as Task
    from bayesdrill.sampling.optimisers.nelder_mead import NelderMead as NelderMead
    from bayesdrill.sampling.samplers.ensemble import halves as halves
    from bayesdrill.sampling.workers import WorkerPool as WorkerPool

__getattr__ = lazy_attributes(__name__)
