"""The density of log products, against sums of uniform and of normal numbers, and against draws."""

import math

import numpy as np
import pytest
import scipy

from bayesdrill.campaigns.interim_prior import log_density_of_products
from bayesdrill.inference.priors import LogNormal, LogUniform, Uniform


def irwin_hall(x: np.ndarray, n: int) -> np.ndarray:
    """Return the density of the sum of n uniform numbers between 0 and 1."""
    terms = [(-1) ** k * math.comb(n, k) * np.maximum(x - k, 0.0) ** (n - 1) for k in range(n + 1)]
    return np.sum(terms, axis=0) / math.factorial(n - 1)


@pytest.mark.parametrize(("free", "tolerance"), [(1, 1e-9), (2, 0.01), (3, 0.03)])
def test_a_product_of_log_uniform_numbers_has_the_density_of_irwin_and_hall(
    free: int, tolerance: float
) -> None:
    n = free + 1
    z = np.linspace(0.3 * free, n - 0.3 * free, 12)  # a lattice has few points in a corner
    log_p = log_density_of_products(z[:, None], np.ones((1, n)), [LogUniform(1.0, math.e)] * n)
    assert np.allclose(np.exp(log_p), irwin_hall(z, n), rtol=tolerance)


def test_a_ratio_of_uniform_numbers_has_its_closed_form() -> None:
    """The density is 1/2 for a ratio w below 1, and 1 / (2 w^2) for one above."""
    ratio = np.array([0.2, 0.7, 1.3, 4.0])
    log_p = log_density_of_products(np.log(ratio)[:, None], [[1, -1]], [Uniform(0.0, 1.0)] * 2)
    closed = np.where(ratio < 1, 0.5, 0.5 / ratio**2) * ratio
    assert np.allclose(np.exp(log_p), closed, rtol=1e-6)


def test_products_of_log_normal_numbers_are_normal_in_logs() -> None:
    exponents = np.array([[1.0, -1, 0, 0, 0], [0, 1, 1, -2, 0], [0, 0, 1, 1, 0]])
    sds = [0.1, 0.3, 0.2, 0.15, 5.0]  # the last is in no product
    medians = np.array([1.0, 20.0, 0.3, 4.0, 1.0])
    priors = [LogNormal(m, s) for m, s in zip(medians, sds, strict=True)]
    centre = exponents @ np.log(medians)
    covariance = exponents @ np.diag(np.square(sds)) @ exponents.T
    z = np.random.default_rng(1).multivariate_normal(centre, covariance, 20)
    closed = scipy.stats.multivariate_normal(centre, covariance).logpdf(z)
    assert np.allclose(log_density_of_products(z, exponents, priors), closed, atol=1e-3)
    square = np.array([[1.0, 1.0], [1.0, -1.0]])  # nothing is free
    closed = scipy.stats.multivariate_normal([0, 0], square @ square.T * 0.04).logpdf(z[:, :2])
    priors = [LogNormal(1.0, 0.2)] * 2
    assert np.allclose(log_density_of_products(z[:, :2], square, priors), closed)


def test_impossible_products_have_no_density_and_dependent_ones_are_refused() -> None:
    priors = [Uniform(1.0, 2.0)] * 2
    assert log_density_of_products(np.array([[2.0]]), [[1, 1]], priors)[0] == -np.inf
    with pytest.raises(ValueError, match="depend on one another"):
        log_density_of_products(np.zeros((1, 2)), [[1, 1], [2, 2]], priors)
