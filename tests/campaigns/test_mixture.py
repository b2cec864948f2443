"""Mixtures describe draws of normal, skewed and bent posteriors, without their interim prior."""

import numpy as np
import pytest
from scipy import stats
from support.simulated_campaigns import interim_posterior

from bayesdrill.campaigns.mixture import RunMixture, describe


def described(z: np.ndarray, log_interim: np.ndarray | None = None) -> RunMixture:
    return describe(z, np.zeros(len(z)) if log_interim is None else log_interim)


def density(mixture: RunMixture, z: np.ndarray) -> np.ndarray:
    parts = zip(mixture.log_weights, mixture.means, mixture.covariances, strict=True)
    return sum(np.exp(w) * stats.multivariate_normal(m, c).pdf(z) for w, m, c in parts)


def test_a_normal_posterior_is_one_component_without_its_interim_prior() -> None:
    rng, estimate, sd = np.random.default_rng(1), np.array([0.05, -0.02]), np.array([0.02, 0.03])
    mixture = described(*interim_posterior(estimate, sd, rng, 1000, width=0.05))
    assert len(mixture.means) == 1
    assert np.allclose(mixture.means[0], estimate, atol=4 * sd.max() / np.sqrt(800))
    assert np.allclose(mixture.covariances[0], np.diag(sd**2), atol=2e-4)
    assert np.allclose(mixture.mean, mixture.means[0])
    assert mixture.error < 0.02


def test_a_bent_posterior_takes_several_components_with_its_density() -> None:
    """A friction that may be next to zero: its logarithm has a long tail, and bends another product."""
    rng = np.random.default_rng(2)
    linear = np.abs(1.0 + 0.4 * rng.standard_normal(1000))
    z = np.stack([np.log(linear), 0.2 * linear + 0.02 * rng.standard_normal(1000)], axis=1)
    mixture = described(z)
    assert 2 <= len(mixture.means) <= 6
    assert mixture.error < 0.02
    one = stats.multivariate_normal(z.mean(axis=0), np.cov(z.T)).logpdf(z).mean()
    assert np.log(density(mixture, z)).mean() > one + 0.5


def test_the_error_is_the_difference_of_distribution_functions_beyond_chance(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("bayesdrill.campaigns.mixture.MAX_COMPONENTS", 1)
    two_places = np.repeat([-1.0, 1.0], 400)[:, None]
    expected = 0.5 - stats.norm.cdf(-1.0) - 1.63 / np.sqrt(800)  # beyond what chance explains
    assert described(two_places).error == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("count", [2, 5])
def test_very_few_draws_have_one_component(count: int) -> None:
    mixture = described(np.random.default_rng(4).normal(size=(count, 3)))
    assert len(mixture.means) == 1
    assert np.isfinite(mixture.covariances).all()
