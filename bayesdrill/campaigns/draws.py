"""Hold the draws of each run's log products under an interim prior.

Each run is sampled on its own, under a provisional (interim) prior.  The population needs only the
draws and their log density under the interim prior (Hogg, Myers and Bovy 2010).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesdrill.basics.arrays import Array, Indices
from bayesdrill.campaigns.runs import CampaignRun

MAX_DRAWS = 1000  # largest number of draws used from each run; more hardly change its mixture
MOST_ATTEMPTS = 3  # largest number of attempts to sample a run, each with another seed


def evenly_spaced(count: int) -> Indices:
    """Return at most `MAX_DRAWS` evenly spaced indices from 0 to `count - 1`."""
    return np.unique(np.linspace(0, count - 1, min(count, MAX_DRAWS)).astype(np.intp))


@dataclass(frozen=True, slots=True, kw_only=True)
class FittedRun:
    """A fitted run has draws under its interim prior, and reasons not to believe them.

    log_products: draws `(S, K)` of the logarithms of the determined products
    log_interim: log density `(S,)` of the interim prior of these log products, up to a constant
    reasons: reasons not to believe the draws
    misfit: the part of `reasons` that says why the residuals of the run are not noise
    attempt: number of times that the run was sampled
    """

    log_products: Array
    log_interim: Array
    reasons: tuple[str, ...] = ()
    misfit: tuple[str, ...] = ()
    attempt: int = 1

    @property
    def usable(self) -> bool:
        """Return whether there are at least two draws; there are none if sampling failed."""
        return len(self.log_interim) > 1

    @property
    def complete(self) -> bool:
        """Return whether the draws converged, or no further attempt is allowed."""
        sound = self.usable and len(self.reasons) == len(self.misfit)
        return sound or self.attempt >= MOST_ATTEMPTS


@dataclass(frozen=True, slots=True, kw_only=True)
class CampaignDraws:
    """A campaign has K `products`, such as "k_s/j_1", and a fit with draws for each run."""

    products: tuple[str, ...]
    runs: tuple[CampaignRun, ...]
    fits: tuple[FittedRun, ...]

    @property
    def rigs(self) -> tuple[str, ...]:
        """Return the names of the rigs, in the order in which they first appear."""
        return tuple(dict.fromkeys(run.rig for run in self.runs))

    @property
    def noted(self) -> tuple[str, ...]:
        """Return the names of the noted columns, which are covariates recorded for some run."""
        return tuple(dict.fromkeys(name for run in self.runs for name in run.noted))
