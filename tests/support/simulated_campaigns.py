"""Campaigns of simulated runs whose records know their log products with normal errors."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bayesdrill.campaigns.draws import CampaignDraws, FittedRun
from bayesdrill.campaigns.runs import CampaignRun
from bayesdrill.sampling.convergence import Targets

BRIEF = Targets(r_hat=1.03, n_tau=15.0, ess=150.0)  # for tests that need no exact tails


@dataclass(frozen=True, kw_only=True)
class SimulatedRuns:
    """True log products `z (R, K)` are known to `sd (R, K)`; rigs, times and notes are as given."""

    z: np.ndarray
    sd: np.ndarray
    rigs: tuple[str, ...] = ()
    hours: np.ndarray | None = None
    noted: dict[str, np.ndarray] | None = None

    def draws(self, rng: np.random.Generator, count: int = 200) -> CampaignDraws:
        """Draw estimates, and posteriors under a normal interim prior that is wider by far."""
        (n_runs, n_products), noted = self.z.shape, self.noted or {}
        runs, fits = [], []
        for r in range(n_runs):
            estimate = self.z[r] + self.sd[r] * rng.standard_normal(n_products)
            log_products, log_interim = interim_posterior(estimate, self.sd[r], rng, count)
            run = CampaignRun(
                name=f"run {r}",
                path=Path(f"run_{r}.csv"),
                rig=self.rigs[r] if self.rigs else "rig",
                time=None if self.hours is None else 3600.0 * self.hours[r],
                noted={name: float(column[r]) for name, column in noted.items()},
            )
            runs.append(run)
            fits.append(FittedRun(log_products=log_products, log_interim=log_interim))
        products = tuple(f"p{k}" for k in range(n_products))
        return CampaignDraws(products=products, runs=tuple(runs), fits=tuple(fits))


def interim_posterior(
    estimate: np.ndarray, sd: np.ndarray, rng: np.random.Generator, count: int, width: float = 0.2
) -> tuple[np.ndarray, np.ndarray]:
    """Draw from the posterior of normal estimates under normal interim priors about zero."""
    precision = sd**-2.0 + width**-2.0
    noise = rng.standard_normal((count, len(sd))) / np.sqrt(precision)
    z = estimate * sd**-2.0 / precision + noise
    return z, -0.5 * (z**2).sum(axis=1) / width**2


def normal_runs(
    rng: np.random.Generator, n_runs: int, spread: np.ndarray, sd: float = 0.01, mean: float = 0.0
) -> SimulatedRuns:
    """Return runs of one rig whose log products scatter by `spread (K,)` about a mean."""
    z = mean + spread * rng.standard_normal((n_runs, len(spread)))
    return SimulatedRuns(z=z, sd=np.full(z.shape, sd))
