"""Describe the likelihood of a run's log products by a mixture of normal distributions.

The draws of a run, weighted by one over the density of their interim prior, are draws of its
normalised likelihood.  The mixture is fitted to them by expectation maximisation, with the number of
components that has the least BIC.  It is smooth: a population that is narrower than the posterior of a
run, in many products, finds few draws of that run in its midst, but a mixture has a value everywhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from bayesdrill.basics.arrays import Array, Indices
from bayesdrill.campaigns.draws import InterimDraws

MAX_COMPONENTS = 6
ITERATIONS = 200  # of expectation maximisation, at most
TOLERANCE = 1e-4  # gain of the mean log density at which it stops
INDEPENDENT = 0.5  # share of the kept draws that counts in the BIC, since they are autocorrelated
CRITICAL = 1.63  # of a Kolmogorov-Smirnov test, over 1 / sqrt(draws), at a level of 1 %
PRIOR_DRAWS = 5.0  # a component's covariance is drawn to that of all with this weight for a product


@dataclass(frozen=True, slots=True)
class RunMixture:
    """A run has a mixture with `log_weights (C,)`, `means (C, K)` and `covariances (C, K, K)`.

    `mean (K,)` and `covariance (K, K)` are the moments of the weighted draws.  `error` is by how much
    distribution functions of draws and mixture differ more than by chance, at most, over the products
    and the directions that make the draws uncorrelated.
    """

    log_weights: Array
    means: Array
    covariances: Array
    mean: Array
    covariance: Array
    error: float


def describe(run: InterimDraws) -> RunMixture:
    """Return the mixture that describes a run."""
    draws, log_interim = run.thinned()
    weights = np.exp(log_interim.min() - log_interim)
    weights /= weights.sum()
    mean = weights @ draws
    centred = draws - mean
    covariance = (weights[:, None] * centred).T @ centred
    # Draws on a line, as very few are, get a width that is a trifle of their spread.
    covariance += np.diag(1e-9 * np.diagonal(covariance) + 1e-18)
    root = np.linalg.cholesky(covariance)
    z = scipy.linalg.solve_triangular(root, centred.T, lower=True).T
    count = INDEPENDENT / (weights**2).sum()
    n_products = z.shape[1]
    size = (n_products + 1) * (n_products + 2) / 2  # numbers of a component
    chance = CRITICAL * float(np.sqrt((weights**2).sum()))
    best, least = _Standard.single(n_products), np.inf
    for components in range(1, MAX_COMPONENTS + 1):
        if components * size > count:
            break
        found, mean_log = _fit(z, weights, components)
        bic = (components * size - 1) * np.log(count) - 2 * count * mean_log
        if bic >= least:
            break
        best, least = found, bic
    directions = np.concatenate([np.eye(n_products), root / np.sqrt(np.diag(covariance))[:, None]])
    return RunMixture(
        log_weights=np.log(best.weights),
        means=mean + best.means @ root.T,
        covariances=root @ best.covariances @ root.T,
        mean=mean,
        covariance=covariance,
        error=max(0.0, *(_difference(z @ d, weights, best, d) - chance for d in directions)),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class RunArrays:
    """The mixtures of R runs have `log_weights (R, C)`, -inf in padding, `means` and `covariances`.

    `roots` times their transposes are the inverse covariances, and `log_norms (R, C)` the logarithms
    of weights times densities at the means, up to a constant.
    `mean (R, K)` and `covariance (R, K, K)` are the moments of each run alone, and `rig (R,)` is the
    index of its rig among `n_rigs`.
    `design (R, p)` has the covariates, NaN where missing, and `precision (p,)` the prior precision of
    their coefficients in units of 1 / Sigma; zero is a flat prior.
    """

    log_weights: Array
    means: Array
    covariances: Array
    roots: Array
    log_norms: Array
    mean: Array
    covariance: Array
    rig: Indices
    n_rigs: int
    design: Array
    precision: Array


def run_arrays(
    runs: Sequence[RunMixture], rig: Indices, offset: Array, design: Array, precision: Array
) -> RunArrays:
    """Pad the mixtures of all runs, minus `offset (R, K)`, to one array."""
    n_runs, n_products = offset.shape
    width = max(len(run.log_weights) for run in runs)
    log_weights, means = np.full((n_runs, width), -np.inf), np.zeros((n_runs, width, n_products))
    covariances = np.zeros((n_runs, width, n_products, n_products)) + np.eye(n_products)
    for r, run in enumerate(runs):
        count = len(run.log_weights)
        log_weights[r, :count] = run.log_weights
        means[r, :count], covariances[r, :count] = run.means - offset[r], run.covariances
    roots = np.swapaxes(np.linalg.inv(np.linalg.cholesky(covariances)), -1, -2)
    log_det = np.log(np.diagonal(roots, axis1=-2, axis2=-1)).sum(axis=-1)
    n_rigs = int(rig.max()) + 1
    if n_rigs == 1:  # the level of the only rig is a coefficient like others
        design = np.column_stack([np.ones(n_runs), design])
        precision = np.concatenate([[0.0], precision])
    return RunArrays(
        log_weights=log_weights,
        means=means,
        covariances=covariances,
        roots=roots,
        log_norms=log_weights + log_det,
        mean=np.array([run.mean for run in runs]) - offset,
        covariance=np.array([run.covariance for run in runs]),
        rig=rig,
        n_rigs=n_rigs,
        design=design,
        precision=precision,
    )


@dataclass(frozen=True, slots=True)
class _Standard:
    """A mixture of draws with mean 0 and covariance 1 has these weights, means and covariances."""

    weights: Array
    means: Array
    covariances: Array

    @classmethod
    def single(cls, n_products: int) -> _Standard:
        """Return the standard normal distribution."""
        return cls(np.ones(1), np.zeros((1, n_products)), np.eye(n_products)[None])

    def log_terms(self, z: Array) -> Array:
        """Return the log density `(S, C)` of each component at `z (S, K)`, with its weight."""
        root = np.linalg.cholesky(self.covariances)
        standard = np.linalg.solve(root, np.swapaxes(z - self.means[:, None], 1, 2))
        log_det = np.log(np.diagonal(root, axis1=1, axis2=2)).sum(axis=1)
        squares = (standard**2).sum(axis=1).T
        norm = np.log(self.weights) - log_det - 0.5 * z.shape[1] * np.log(2 * np.pi)
        return np.asarray(norm - 0.5 * squares)


def _fit(z: Array, weights: Array, components: int) -> tuple[_Standard, float]:
    """Fit a mixture to standardised draws `z (S, K)`; return it with its mean log density."""
    n_products = z.shape[1]
    mixture, before = _Standard.single(n_products), -np.inf
    share = np.ones((len(z), 1))
    if components > 1:
        _, label = scipy.cluster.vq.kmeans2(z, components, minit="++", rng=components)
        share = np.eye(components)[label] + 0.1 / components
        share /= share.sum(axis=1, keepdims=True)
    for _ in range(ITERATIONS):
        mass = weights[:, None] * share
        total = np.maximum(mass.sum(axis=0), 1e-12)
        means = (mass.T @ z) / total[:, None]
        apart = z - means[:, None]
        scatter = np.einsum("sc,csi,csj->cij", mass, apart, apart, optimize=True)
        extra = PRIOR_DRAWS * n_products * (weights**2).sum() * (components > 1)
        covariances = (scatter + extra * np.eye(n_products)) / (total + extra)[:, None, None]
        mixture = _Standard(total, means, covariances)
        terms = mixture.log_terms(z)
        log_density = np.logaddexp.reduce(terms, axis=1)
        mean_log = float(weights @ log_density)
        if mean_log - before < TOLERANCE:
            break
        before, share = mean_log, np.exp(terms - log_density[:, None])
    return mixture, mean_log


def _difference(x: Array, weights: Array, mixture: _Standard, direction: Array) -> float:
    """Return the largest difference of distribution functions along a direction."""
    order = np.argsort(x)
    sds = np.sqrt(np.einsum("i,cij,j->c", direction, mixture.covariances, direction))
    cdf = scipy.special.ndtr((x[order, None] - mixture.means @ direction) / sds) @ mixture.weights
    above = np.cumsum(weights[order])
    return float(max(np.abs(above - cdf).max(), np.abs(above - weights[order] - cdf).max()))
