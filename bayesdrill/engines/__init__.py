"""Climbing and walking on the density: the MAP, the proposal, the ensembles."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bayesdrill.basics.late import late

if TYPE_CHECKING:
    from bayesdrill.engines.optimisers.contract import Optimiser as Optimiser
    from bayesdrill.engines.optimisers.contract import Optimum as Optimum
    from bayesdrill.engines.optimisers.contract import Task as Task
    from bayesdrill.engines.optimisers.nelder_mead import THOROUGH as THOROUGH
    from bayesdrill.engines.optimisers.simplex import Run as Run
    from bayesdrill.engines.optimisers.simplex import descend as descend
    from bayesdrill.engines.samplers.moves import halves as halves
    from bayesdrill.engines.sampling import Plan as Plan
    from bayesdrill.engines.sampling import sample as sample
    from bayesdrill.engines.shelf import Memory as Memory
    from bayesdrill.engines.workers import Crew as Crew

__getattr__ = late(
    __name__,
    {
        "Crew": "workers",
        "Memory": "shelf",
        "Optimiser": "optimisers.contract",
        "Optimum": "optimisers.contract",
        "Plan": "sampling",
        "Run": "optimisers.simplex",
        "THOROUGH": "optimisers.nelder_mead",
        "Task": "optimisers.contract",
        "descend": "optimisers.simplex",
        "halves": "samplers.moves",
        "sample": "sampling",
    },
)
