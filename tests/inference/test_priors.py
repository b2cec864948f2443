"""Families of priors against the distributions of SciPy."""

from typing import Any

import numpy as np
import pytest
import scipy.stats
from support.case_tables import run_cases

from bayesdrill.inference.priors import PRIORS, Prior, prior_log_sd, prior_sd

FAMILIES: dict[str, tuple[Prior, Any]] = {
    "uniform": (PRIORS["uniform"](low=0.3, high=1.7), scipy.stats.uniform(0.3, 1.4)),
    "log_uniform": (PRIORS["log_uniform"](low=0.02, high=5.0), scipy.stats.loguniform(0.02, 5.0)),
    "normal": (PRIORS["normal"](mean=0.4, sd=0.5), scipy.stats.truncnorm(-0.8, np.inf, 0.4, 0.5)),
    "truncated_normal": (
        PRIORS["truncated_normal"](mean=1.0, sd=0.3, low=1.4, high=2.5),
        scipy.stats.truncnorm(4 / 3, 5.0, 1.0, 0.3),
    ),
    "log_normal": (PRIORS["log_normal"](median=0.7, sd_log=0.4), scipy.stats.lognorm(0.4, 0, 0.7)),
    "half_normal": (PRIORS["half_normal"](scale=0.6), scipy.stats.halfnorm(0, 0.6)),
}


def test_every_family_has_a_distribution_of_scipy() -> None:
    assert set(FAMILIES) == set(PRIORS)


@run_cases("prior, true", FAMILIES.values(), FAMILIES)
def test_density_and_quantiles_are_those_of_scipy(prior: Prior, true: Any) -> None:
    x = np.linspace(1e-3, 6.0, 501)
    assert np.exp(prior.logpdf(x)) == pytest.approx(true.pdf(x), rel=1e-10)
    u = np.array([0.003, 0.2, 0.55, 0.98])
    assert true.cdf(prior.quantile(u)) == pytest.approx(u, rel=1e-9)


@run_cases("prior, true", FAMILIES.values(), FAMILIES)
def test_the_density_outside_the_support_is_minus_infinity(prior: Prior, true: Any) -> None:
    with np.errstate(invalid="ignore"):
        density = prior.logpdf(np.array([-1.0, -1e-9, 0.0, np.nan]))
    assert np.all(density[:3] == -np.inf)
    assert not np.isfinite(density[3])


def test_an_unknown_is_walked_in_its_log_unless_zero_itself_has_a_density() -> None:
    """Its log would have an endless tail there."""
    from_zero = [PRIORS["uniform"](low=0.0, high=2.0)]
    from_zero += [PRIORS["truncated_normal"](mean=1.0, sd=0.4, low=0.0, high=2.0)]
    for prior in (*from_zero, *(prior for prior, _ in FAMILIES.values())):
        assert prior.in_logs == (np.exp(prior.logpdf(np.array([1e-12]))[0]) == 0.0), prior


@run_cases("prior, true", FAMILIES.values(), FAMILIES)
def test_spreads_are_standard_deviations(prior: Prior, true: Any) -> None:
    assert prior_sd(prior) == pytest.approx(true.std(), rel=0.01)
    logs = np.log(true.ppf((np.arange(100_000) + 0.5) / 100_000))
    assert prior_log_sd(prior) == pytest.approx(logs.std(), rel=0.02)


def test_derivatives_are_those_of_closed_forms() -> None:
    x = np.array([0.6, 1.1, 1.6])
    still, log_x = np.zeros(3), np.log(x / 0.7)
    expected = {
        "uniform": (still, still),
        "log_uniform": (-1 / x, 1 / x**2),
        "normal": ((0.4 - x) / 0.25, still - 4.0),
        "truncated_normal": ((1.0 - x) / 0.09, still - 1 / 0.09),
        "log_normal": (-(1 + log_x / 0.16) / x, (1 + (log_x - 1) / 0.16) / x**2),
        "half_normal": (-x / 0.36, still - 1 / 0.36),
    }
    for name, (prior, _) in FAMILIES.items():
        first, second = prior.derivatives(x)
        assert first == pytest.approx(expected[name][0], rel=1e-12), name
        assert second == pytest.approx(expected[name][1], rel=1e-12), name


def test_a_far_tail_keeps_its_digits() -> None:
    """Ten sigma from its mean a normal is an exponential of the rate 10 / sd."""
    prior = PRIORS["truncated_normal"](mean=1.0, sd=0.1, low=2.0, high=9.0)
    u = np.array([0.1, 0.5, 0.9])
    assert (prior.quantile(u) - 2.0) * 100 == pytest.approx(scipy.stats.expon.ppf(u), rel=0.03)
    assert np.isfinite(prior.logpdf(np.array([2.01]))[0])
