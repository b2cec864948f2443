"""The peers, one module each: `run(job, ..., budget) -> Result`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

from benchmarks.problem import Job
from benchmarks.verdict import Result


def _ours(job: Job, budget: float) -> Result:
    from benchmarks.peers import ours

    return ours.run(job)


def _stretch(job: Job, budget: float) -> Result:
    from benchmarks.peers import naive

    return naive.with_exact_response(job, budget)


def _first_try(job: Job, budget: float) -> Result:
    from benchmarks.peers import naive

    return naive.first_try(job, budget)


def _pints(coordinates: str) -> Callable[[Job, float], Result]:
    def run(job: Job, budget: float) -> Result:
        from benchmarks.peers import pints_

        return pints_.run(job, coordinates, budget)

    return run


def _nuts(coordinates: str) -> Callable[[Job, float], Result]:
    def run(job: Job, budget: float) -> Result:
        from benchmarks.peers import numpyro_

        return numpyro_.run(job, coordinates, budget)

    return run


# In the order of their runs; modules are imported late, as one peer's package may be missing.
PEERS: Mapping[str, Callable[[Job, float], Result]] = MappingProxyType(
    {
        "ours": _ours,
        "stretch": _stretch,
        "first_try": _first_try,
        "pints_physical": _pints("physical"),
        "pints_log": _pints("log"),
        "nuts_physical": _nuts("physical"),
        "nuts_modal": _nuts("modal"),
        "nuts_unfolded": _nuts("unfolded"),
    }
)
