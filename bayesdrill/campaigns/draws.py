"""Hold what is known of the runs of a campaign: draws of their log products under an interim prior.

A run is sampled once, by itself, under a prior that is only provisional (interim).  Draws and log
density of that prior are all that the population needs of a run (Hogg, Myers and Bovy 2010).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bayesdrill.basics.arrays import Array, Indices

MAX_DRAWS = 1000  # draws of a run that are used; more cost time and hardly change its weights


def evenly_spaced(count: int) -> Indices:
    """Return at most `MAX_DRAWS` indices of `count` draws, from the first to the last."""
    return np.unique(np.linspace(0, count - 1, min(count, MAX_DRAWS)).astype(np.intp))


@dataclass(frozen=True, slots=True, kw_only=True)
class InterimDraws:
    """A run has draws of its log products under its interim prior, and what was noted beside it.

    name: the name of the run
    rig: the name of the rig with which it was made
    time: the time since the first run, None if it is not known [s]
    noted: numbers that were noted beside the record, such as a temperature; NaN where missing
    log_products: draws `(S, K)` of the logarithms of the determined products
    log_interim: log density `(S,)` of the interim prior of these log products, up to a constant
    """

    name: str
    rig: str
    time: float | None
    noted: Mapping[str, float]
    log_products: Array
    log_interim: Array


@dataclass(frozen=True, slots=True, kw_only=True)
class CampaignDraws:
    """A campaign has K `products`, such as "k_s/j_1", and draws of each run.

    Raises `ValueError`, with all faults at once, if names repeat or shapes and numbers are wrong.
    """

    products: tuple[str, ...]
    runs: tuple[InterimDraws, ...]

    def __post_init__(self) -> None:
        faults = [fault for run in self.runs for fault in self._faults(run)]
        counts = Counter(run.name for run in self.runs)
        repeated = [name for name, count in counts.items() if count > 1]
        faults += [f"The name {name} stands for several runs." for name in repeated]
        if not self.runs:
            faults.append("A campaign needs at least one run.")
        if faults:
            raise ValueError(" ".join(faults))

    def _faults(self, run: InterimDraws) -> list[str]:
        faults = []
        shape, wanted = run.log_products.shape, (len(run.log_interim), len(self.products))
        if shape != wanted or len(run.log_interim) < 2:
            faults.append(f"Run {run.name} has draws of shape {shape}, but needs {wanted}.")
        elif not (np.isfinite(run.log_products).all() and np.isfinite(run.log_interim).all()):
            faults.append(f"Run {run.name} has draws or interim densities that are not finite.")
        if run.time is not None and not np.isfinite(run.time):
            faults.append(f"Run {run.name} has the time {run.time}, which is not finite.")
        return faults

    @property
    def rigs(self) -> tuple[str, ...]:
        """Return the names of the rigs, in the order in which they first appear."""
        return tuple(dict.fromkeys(run.rig for run in self.runs))

    @property
    def noted(self) -> tuple[str, ...]:
        """Return the names of all columns that were noted beside any run."""
        return tuple(dict.fromkeys(name for run in self.runs for name in run.noted))
