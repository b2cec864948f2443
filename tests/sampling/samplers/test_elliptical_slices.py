"""Elliptical slices sample a Gaussian under conditions."""

import numpy as np
import scipy

from bayesdrill.basics.arrays import Array, Indices
from bayesdrill.sampling.samplers.elliptical_slices import elliptical_slices


def test_elliptical_slices_sample_a_gaussian_with_ends() -> None:
    """Two directions of a correlated Gaussian are cut to a band, and follow the exact moments."""
    covariance = np.array([[1.0, 0.8], [0.8, 1.0]])
    root = np.linalg.cholesky(covariance).T

    def within(points: Array, here: Indices) -> Array:
        return np.where((points[:, 0] > -0.2) & (points[:, 0] < 2.0), 0.0, -np.inf)

    rng = np.random.default_rng(2)
    path = elliptical_slices(np.repeat(root[None], 2000, axis=0), within, 60, rng)[30:]
    cut = scipy.stats.truncnorm(-0.2, 2.0)
    x, y = path.reshape(-1, 2).T
    assert abs(x.mean() - cut.mean()) < 0.02
    assert abs(x.std() / cut.std() - 1.0) < 0.02
    assert abs(y.mean() - 0.8 * cut.mean()) < 0.02
    assert abs(y.std() / np.sqrt(0.64 * cut.var() + 0.36) - 1.0) < 0.02
