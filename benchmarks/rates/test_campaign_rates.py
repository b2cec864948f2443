"""Rates of intervals of campaigns: population, single runs, and the next run.

pytest -m slow -s benchmarks/rates/test_campaign_rates.py
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from support.simulated_campaigns import BRIEF, SimulatedRuns

from bayesdrill.basics.progress import SILENT
from bayesdrill.campaigns.fit import fit_population
from bayesdrill.campaigns.outcomes import Estimate
from bayesdrill.campaigns.population import PopulationSettings

pytestmark = pytest.mark.slow
RUNS = 12


def inside(estimate: Estimate, truth: float) -> list[bool]:
    """Return whether the truth is inside the 50 and the 90 % interval."""
    in_50 = estimate.low_50 < truth < estimate.high_50
    return [in_50, estimate.low_90 < truth < estimate.high_90]


def hits_of_campaign(seed: int, products: int) -> dict[str, list[list[bool]]]:
    """Fit a campaign, and return for each kind of number whether its intervals hold the truth."""
    rng = np.random.default_rng(seed)
    spread = np.exp(rng.uniform(np.log(0.01), np.log(0.08), products))
    common = 0.8 * rng.uniform(-1.0, 1.0, products)  # of each product with a common cause
    root = np.linalg.cholesky(np.outer(common, common) + np.diag(1.0 - common**2))
    mean = rng.normal(0.0, 0.1, products)
    z = mean + rng.standard_normal((RUNS + 1, products)) @ root.T * spread
    known = np.exp(rng.uniform(np.log(0.005), np.log(0.03), (RUNS, products)))
    draws = SimulatedRuns(z=z[:-1], sd=known).draws(rng, 500)
    fit = fit_population(draws, PopulationSettings(targets=BRIEF), rng, SILENT)
    assert fit.convergence.converged
    assert not fit.misdescribed
    hits: dict[str, list[list[bool]]] = {"centre": [], "spread": [], "next run": [], "run": []}
    for k, population in enumerate(fit.populations):
        hits["centre"].append(inside(population.centre, mean[k]))
        hits["spread"].append(inside(population.spread, spread[k]))
        hits["next run"].append(inside(population.next_run, z[-1, k]))
    for r, run in enumerate(fit.runs):
        sds = np.abs(run.shrunk - z[r]) / run.shrunk_sd
        hits["run"] += [[bool(x < 0.674), bool(x < 1.645)] for x in sds]
    return hits


@pytest.mark.parametrize(("products", "count"), [(2, 100), (5, 30), (7, 20)])
def test_intervals_of_campaigns_hold_the_truth_at_their_rate(products: int, count: int) -> None:
    campaigns = [hits_of_campaign(1000 * products + seed, products) for seed in range(count)]
    for kind in campaigns[0]:
        hits = np.array([campaign[kind] for campaign in campaigns])
        rates = hits.mean(axis=(0, 1))
        print(f"{kind}: {100 * rates[0]:.1f} % in 50 %, {100 * rates[1]:.1f} % in 90 %")
        # Numbers of a campaign depend on one another, so campaigns are what is counted.
        for rate, level in zip(rates, (0.5, 0.9), strict=True):
            low, high = stats.binom(count, level).interval(0.9999)
            assert low <= count * rate <= high, (kind, level, rate)
