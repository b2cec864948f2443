"""Hold the draws of the log products of each run of a campaign, under an interim prior.

A run is sampled once, by itself, under a prior that is only provisional (interim).  Draws and log
density of that prior are all that the population needs of a run (Hogg, Myers and Bovy 2010).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesdrill.basics.arrays import Array, Indices
from bayesdrill.campaigns.runs import CampaignRun

MAX_DRAWS = 1000  # draws of a run that are used; more cost time and hardly change its weights
MOST_ATTEMPTS = 3  # most times a run is sampled, each with another seed, until it converges


def evenly_spaced(count: int) -> Indices:
    """Return at most `MAX_DRAWS` indices of `count` draws, from the first to the last."""
    return np.unique(np.linspace(0, count - 1, min(count, MAX_DRAWS)).astype(np.intp))


@dataclass(frozen=True, slots=True, kw_only=True)
class FittedRun:
    """A fitted run has draws under its interim prior, and reasons not to believe them.

    log_products: draws `(S, K)` of the logarithms of the determined products
    log_interim: log density `(S,)` of the interim prior of these log products, up to a constant
    reasons: reasons not to believe the draws
    misfit: those reasons that say why its residuals are not noise
    attempt: number of times that it was sampled
    """

    log_products: Array
    log_interim: Array
    reasons: tuple[str, ...] = ()
    misfit: tuple[str, ...] = ()
    attempt: int = 1

    @property
    def usable(self) -> bool:
        """Return whether there are draws; else nothing could be sampled."""
        return len(self.log_interim) > 1

    @property
    def complete(self) -> bool:
        """Return whether the run has draws that converged, or has been sampled often enough."""
        sound = self.usable and len(self.reasons) == len(self.misfit)
        return sound or self.attempt >= MOST_ATTEMPTS


@dataclass(frozen=True, slots=True, kw_only=True)
class CampaignDraws:
    """A campaign has K `products`, such as "k_s/j_1", and for each of its runs a fit with draws."""

    products: tuple[str, ...]
    runs: tuple[CampaignRun, ...]
    fits: tuple[FittedRun, ...]

    @property
    def rigs(self) -> tuple[str, ...]:
        """Return the names of the rigs, in the order in which they first appear."""
        return tuple(dict.fromkeys(run.rig for run in self.runs))

    @property
    def noted(self) -> tuple[str, ...]:
        """Return the names of all columns that were noted for any run."""
        return tuple(dict.fromkeys(name for run in self.runs for name in run.noted))
