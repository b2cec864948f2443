"""An independence proposal learnt from a pilot run: a Gaussian mixture, fitted once, then frozen.

Frozen, it depends on nothing that the chain does, so that detailed balance holds exactly: a
proposal z' drawn from the mixture q is accepted with min(1, p(z') q(z) / (p(z) q(z'))).
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

COMPONENTS = 12
DRAWS_PER_COMPONENT = 20  # times the dimension: fewer draws get fewer components
MOST_DRAWS = 6000
FLOOR = 1e-4  # added to the variances of whitened draws, so that no component collapses


@dataclass(frozen=True, slots=True)
class Mixture:
    """`weights (K,)`, `means (K, D)`, `roots (K, D, D)`: lower Cholesky factors."""

    weights: Array
    means: Array
    roots: Array

    def draw(self, n: int, random: np.random.RandomState) -> Array:
        """`(n, D)`."""
        chosen = np.searchsorted(np.cumsum(self.weights)[:-1], random.random_sample(n))
        normal = random.standard_normal((n, self.means.shape[1]))
        moved: Array = self.means[chosen] + np.einsum("wij,wj->wi", self.roots[chosen], normal)
        return moved

    def log_density(self, z: Array) -> Array:
        """`(W, D) -> (W,)`, normalised."""
        inverse = np.linalg.inv(self.roots)
        parts = np.empty((len(self.weights), len(z)))
        for k, (weight, mean) in enumerate(zip(self.weights, self.means, strict=True)):
            standard = (z - mean) @ inverse[k].T
            log_det = np.log(np.diag(self.roots[k])).sum()
            parts[k] = np.log(weight) - log_det - 0.5 * (standard**2).sum(axis=1)
        highest = parts.max(axis=0)
        constant = 0.5 * z.shape[1] * np.log(2 * np.pi)
        return np.asarray(highest + np.log(np.exp(parts - highest).sum(axis=0)) - constant)

    def propose(self, z: Array, random: np.random.RandomState) -> tuple[Array, Array]:
        """As emcee's `MHMove` wants it: new points and log q(old) - log q(new)."""
        fresh = self.draw(len(z), random)
        return fresh, self.log_density(z) - self.log_density(fresh)


def fit(draws: Array, seed: int) -> Mixture:
    """A mixture for `draws (N, D)` of a pilot run; the same draws and seed give the same mixture."""
    from sklearn.mixture import GaussianMixture  # late: only runs that learn a proposal need it

    draws = draws[:: max(1, len(draws) // MOST_DRAWS)]
    n, d = draws.shape
    centre = draws.mean(axis=0)
    root = np.linalg.cholesky(np.cov(draws.T).reshape(d, d))
    white = np.linalg.solve(root, (draws - centre).T).T
    components = int(np.clip(n // (DRAWS_PER_COMPONENT * d), 1, COMPONENTS))
    model: Any = GaussianMixture(
        components, reg_covar=FLOOR, tol=1e-3, max_iter=100, random_state=seed
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a fit that is not finished is a good proposal too
        model.fit(white)
    roots = np.linalg.cholesky(model.covariances_)
    return Mixture(model.weights_, centre + model.means_ @ root.T, root @ roots)


def expected_acceptance(
    mixture: Mixture,
    target: Callable[[Array], Array],
    draws: Array,
    log_p: Array,
    random: np.random.RandomState,
) -> float:
    """Share of proposals that would be accepted from `draws (N, D)` with densities `log_p (N,)`."""
    fresh, factor = mixture.propose(draws, random)
    ratio = target(fresh) - log_p + factor
    return float(np.mean(np.exp(np.minimum(ratio, 0.0))))
