"""Describe the likelihood of a run's log products by a mixture of normal distributions.

The draws of a run, with weights 1 / (density of the interim prior), represent the normalised
likelihood of the run.  A mixture is fitted to the weighted draws by expectation maximisation, with
the number of components that has the least BIC.  If a population is narrower than the posterior of
a run, few draws lie inside the population, but the smooth mixture has a value everywhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from bayesdrill.basics.arrays import Array, Indices
from bayesdrill.sampling.samplers.independence import (
    Mixture,
    effective_count,
    improved,
    mixture,
    normalised,
)

MAX_COMPONENTS = 6
ITERATIONS = 200  # largest number of iterations of expectation maximisation
TOLERANCE = 1e-4  # iterations stop if the mean log density grows by less
INDEPENDENT = 0.5  # fraction of effective draws that the BIC counts, as draws are autocorrelated
CRITICAL = 1.63  # critical value of a Kolmogorov-Smirnov test at 1 %, times sqrt(number of draws)
VARIANCE_FLOOR = 1e-6  # variance added to a component, relative to the variance of all draws
LEAST_SD = 1e-9  # lower limit of the sd of a log product: few draws may have a singular covariance


@dataclass(frozen=True, slots=True)
class RunMixture:
    """A run has a mixture with `log_weights (C,)`, `means (C, K)` and `covariances (C, K, K)`.

    `mean (K,)` and `covariance (K, K)` are the moments of the weighted draws.  `error` is the
    largest difference between the distribution functions of draws and mixture, minus its critical
    value, over all products and over K directions in which draws are uncorrelated.
    """

    log_weights: Array
    means: Array
    covariances: Array
    mean: Array
    covariance: Array
    error: float


def describe(draws: Array, log_interim: Array) -> RunMixture:
    """Return the mixture that describes a run with these draws; see `FittedRun`."""
    weights = normalised(-log_interim)
    mean = weights @ draws
    centred = draws - mean
    covariance = (weights[:, None] * centred).T @ centred
    covariance += np.diag(VARIANCE_FLOOR * np.diagonal(covariance) + LEAST_SD**2)
    root = np.linalg.cholesky(covariance)
    z = scipy.linalg.solve_triangular(root, centred.T, lower=True).T
    n_products, count = z.shape[1], INDEPENDENT * effective_count(weights)
    size = (n_products + 1) * (n_products + 2) / 2  # number of parameters of a component
    best, least = _fitted(z, weights, 1)[0], np.inf
    for components in range(1, min(MAX_COMPONENTS, int(count / size)) + 1):
        fitted, mean_log = _fitted(z, weights, components)
        bic = components * size * np.log(count) - 2 * count * mean_log
        if bic >= least:
            break
        best, least = fitted, bic
    chance = CRITICAL / np.sqrt(effective_count(weights))
    directions = np.concatenate([np.eye(n_products), root / np.sqrt(np.diag(covariance))[:, None]])
    roots = root @ best.roots
    return RunMixture(
        log_weights=np.log(best.weights),
        means=mean + best.means @ root.T,
        covariances=roots @ np.swapaxes(roots, 1, 2),
        mean=mean,
        covariance=covariance,
        error=max(0.0, *(_difference(z, weights, best, d) - chance for d in directions)),
    )


def _fitted(z: Array, weights: Array, components: int) -> tuple[Mixture, float]:
    """Fit a mixture to standardised draws `z (S, K)`; return it with its mean log density."""
    unit, nothing = np.eye(z.shape[1]), np.zeros((1, len(z)))
    centres = scipy.cluster.vq.kmeans2(z, components, minit="++", rng=components)[0]
    fitted = mixture((), [0] * components, np.ones(components), centres, [unit] * components)
    before = -np.inf
    for _ in range(ITERATIONS):
        fitted = improved(fitted, z[None], nothing, weights, [VARIANCE_FLOOR * unit])
        mean_log = float(weights @ fitted.log_density_at(z[None], nothing))
        if mean_log - before < TOLERANCE:
            break
        before = mean_log
    return fitted, mean_log


def _difference(z: Array, weights: Array, fitted: Mixture, direction: Array) -> float:
    """Return the largest difference of the two distribution functions along a direction."""
    x = z @ direction
    order = np.argsort(x)
    sds = np.sqrt(((direction @ fitted.roots) ** 2).sum(axis=1))
    cdf = scipy.special.ndtr((x[order, None] - fitted.means @ direction) / sds) @ fitted.weights
    above = np.cumsum(weights[order])
    return float(max(np.abs(above - cdf).max(), np.abs(above - weights[order] - cdf).max()))


@dataclass(frozen=True, slots=True, kw_only=True)
class RunArrays:
    """The mixtures of R runs have `log_weights (R, C)` (-inf if padded), `means`, `covariances`.

    `roots` times their transposes are the inverse covariances.  `log_norms (R, C)` are the logs of
    weight times density at the mean of each component, up to a constant.
    `mean (R, K)` and `covariance (R, K, K)` are the moments of each run alone, and `rig (R,)` is the
    index of each run's rig among `n_rigs`.
    `design (R, p)` has the covariates, NaN where missing.  `precision (p,)` is the prior precision
    of the coefficients of covariates in units of Sigma^-1; zero means a flat prior.
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
    """Stack the mixtures of runs in padded arrays; `offset (R, K)` is subtracted from the means."""
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
    if n_rigs == 1:  # the intercept of the only rig is a coefficient like the others
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
