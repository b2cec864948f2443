"""A hundred records with every nuisance at once: what is inferred of them, and what is said without."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binom
from support.unexplained_records import causes_of

import bayesdrill as bd
from bayesdrill.inference import residual_checks
from benchmarks.rates.nuisance_records import write

RECORDS = 100
INSIDE = 0.94  # of the intervals looked at
BY_CHANCE = 1e-3  # that a right posterior would leave the band, all unknowns together


def between(draws: np.ndarray, truth: float) -> bool:
    low, high = np.quantile(draws, [0.5 - INSIDE / 2, 0.5 + INSIDE / 2])
    return bool(low <= truth <= high)


@pytest.mark.slow
def test_one_record_is_understood(tmp_path: Path) -> None:
    """The first of them, told of its nuisances: it converges and leaves noise."""
    path, truth = write(tmp_path, 3, told=True)
    run = bd.load(path).sample(processes=1)
    assert run.sampled.convergence.converged
    left = residual_checks.residual_summaries(
        run.job.problem.posterior.likelihood, run._view.chain.best
    )
    assert not any(one.large for one in left)
    inside = [between(run.draws[name], truth[name]) for name in run.job.problem.names]
    assert sum(inside) >= len(inside) - 4
    lag = run.draws["lag_alpha"]
    assert lag.mean() == pytest.approx(0.024, abs=5 * lag.std())


@pytest.mark.slow
def test_truths_lie_inside_at_the_rate_that_is_stated(tmp_path: Path) -> None:
    inside: dict[str, list[bool]] = {}
    for seed in range(RECORDS):
        path, truth = write(tmp_path, seed, told=True)
        run = bd.load(path).sample(processes=1)
        assert run.sampled.convergence.converged, seed
        for name in run.job.problem.names:
            inside.setdefault(name, []).append(between(run.draws[name], truth[name]))
    shares = {name: sum(found) for name, found in inside.items()}
    tail = BY_CHANCE / len(shares) / 2
    low, high = binom.ppf([tail, 1 - tail], RECORDS, INSIDE)
    assert {name: n for name, n in shares.items() if not low <= n <= high} == {}


@pytest.mark.slow
def test_without_them_the_report_names_a_nuisance(tmp_path: Path) -> None:
    """In at least 80 of 100; and never calls the fit noise."""
    named = 0
    for seed in range(RECORDS):
        path, _ = write(tmp_path, seed, told=False)
        said = causes_of(bd.load(path))
        assert said is not None, seed
        parts = {*said.best.parts} if said.best else set()
        lags = [one.value for one in said.best.new if one.name.startswith("lag_alpha")]
        named += "free_start" in parts and bool(lags) and abs(np.mean(lags) - 0.024) < 0.002
    assert named >= 80
