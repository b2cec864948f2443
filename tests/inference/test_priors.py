"""Densities against SciPy's and against quadrature: normalised, and quantiles that invert."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.integrate
import scipy.stats
from support.case_tables import run_cases

from bayesdrill.inference.priors import PRIORS, Prior, prior_log_sd, prior_sd

CASES: dict[str, tuple[Prior, object]] = {
    "uniform": (PRIORS["uniform"](low=0.3, high=1.7), scipy.stats.uniform(0.3, 1.4)),
    "log_uniform": (PRIORS["log_uniform"](low=0.02, high=5.0), scipy.stats.loguniform(0.02, 5.0)),
    "normal": (
        PRIORS["normal"](mean=0.4, sd=0.5),
        scipy.stats.truncnorm(-0.8, np.inf, 0.4, 0.5),
    ),
    "truncated_normal": (
        PRIORS["truncated_normal"](mean=1.0, sd=0.3, low=1.4, high=2.5),
        scipy.stats.truncnorm(4 / 3, 5.0, 1.0, 0.3),
    ),
    "log_normal": (PRIORS["log_normal"](median=0.7, sd_log=0.4), scipy.stats.lognorm(0.4, 0, 0.7)),
    "half_normal": (PRIORS["half_normal"](scale=0.6), scipy.stats.halfnorm(0, 0.6)),
}


def test_every_family_is_tested() -> None:
    assert set(CASES) == set(PRIORS)


@run_cases("family", CASES)
def test_density_equals_scipys(family: str) -> None:
    prior, true = CASES[family]
    x = np.linspace(1e-3, 6.0, 501)
    assert np.allclose(np.exp(prior.logpdf(x)), true.pdf(x), rtol=1e-10)


@run_cases("family", CASES)
def test_density_integrates_to_one(family: str) -> None:
    """Mutant killed: a family cut at zero without renormalising."""
    prior, _ = CASES[family]
    total, _ = scipy.integrate.quad(
        lambda x: np.exp(prior.logpdf(np.array([x]))[0]),
        0,
        12,
        points=[prior.low, 1.7, 2.5, 5.0],
        limit=400,
    )
    assert total == pytest.approx(1.0, abs=1e-6)


@run_cases("family", CASES)
def test_quantiles_invert_the_distribution(family: str) -> None:
    prior, true = CASES[family]
    u = np.array([0.003, 0.2, 0.55, 0.98])
    assert np.allclose(true.cdf(prior.quantile(u)), u, rtol=1e-9)


@run_cases("family", CASES)
def test_outside_the_support_is_minus_infinity_never_nan(family: str) -> None:
    prior, _ = CASES[family]
    outside = np.array([-1.0, -1e-9, 0.0, np.nan])
    with np.errstate(invalid="ignore"):
        density = prior.logpdf(outside)
    assert np.all(density[:3] == -np.inf)
    assert not np.isfinite(density[3])


@run_cases("family", CASES)
def test_draws_follow_it(family: str) -> None:
    prior, true = CASES[family]
    x = prior.quantile(np.random.default_rng(8).random(20_000))
    assert scipy.stats.kstest(x, true.cdf).pvalue > 1e-4


@run_cases("family", CASES)
def test_spreads_are_standard_deviations(family: str) -> None:
    prior, true = CASES[family]
    assert prior_sd(prior) == pytest.approx(true.std(), rel=0.01)
    logs = np.log(true.ppf((np.arange(100_000) + 0.5) / 100_000))
    assert prior_log_sd(prior) == pytest.approx(logs.std(), rel=0.02)


def test_a_far_tail_keeps_its_digits() -> None:
    prior = PRIORS["truncated_normal"](mean=1.0, sd=0.1, low=2.0, high=9.0)
    true = scipy.stats.expon(0, 1)  # beyond ten sigma the tail is exponential, rate 10/0.1
    x = prior.quantile(np.array([0.1, 0.5, 0.9]))
    assert np.allclose((x - 2.0) * 100, true.ppf([0.1, 0.5, 0.9]), rtol=0.03)
    assert np.isfinite(prior.logpdf(np.array([2.01]))[0])
