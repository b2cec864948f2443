"""Update the population of a campaign by its conditional distributions (Gibbs sampling).

A t distribution is a normal distribution whose precision has a gamma distribution.  For each run, a
mixture component and this precision are drawn first, with the run's log products integrated out.
Given both, coefficients and levels are normal; given these, too, the log products are normal.
Covariances have the prior of Huang and Wand (2013): half-t standard deviations and uniform
correlations.  A missing covariate is an unknown with a standard normal prior.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import scipy

from bayesdrill.basics.arrays import Array, Indices
from bayesdrill.campaigns.mixture import RunArrays

HALF_T_FREEDOM = 2.0  # degrees of freedom of the half-t prior of sds; 2 makes correlations uniform
FREEDOMS = np.geomspace(2.0, 200.0, 14)  # grid of nu; at 200 the tails are practically normal
BATCH = 1 << 19  # approximate number of elements of a temporary array
RIG_UPDATES = 8  # number of updates of the rigs' mean and covariance in each sweep
PRECISION_NODES = 24  # number of quadrature nodes for the precision of a run
CUT_MASS = 1e-9  # probability of a precision below the first node, and above the last
LEAST_STEP, MOST_STEP = 0.05, 2.0  # bounds of the random sd of a Metropolis step of a log spread


@dataclass(frozen=True, slots=True, kw_only=True)
class GibbsState:
    """A chain has this state: Sigma^-1 = root root' and Sigma_rig^-1 = rig_root rig_root'.

    `scales (K,)` and `rig_scales (K,)` are auxiliary variables of Huang and Wand's prior.  `design`
    `(R, p)` contains drawn values for missing covariates.
    """

    slopes: Array
    levels: Array
    mean: Array
    root: Array
    scales: Array
    rig_root: Array
    rig_scales: Array
    nu: float
    design: Array

    def centres(self, rig: Indices) -> Array:
        """Return the expected log products of each run, `(R, K)`."""
        return np.asarray(self.levels[rig] + self.design @ self.slopes)


def log_t(squares: Array, nu: Array | float, n_products: int) -> Array:
    """Return the log density of a standard t in K dimensions at squared distances from zero."""
    half = 0.5 * (nu + n_products)
    norm = scipy.special.gammaln(half) - scipy.special.gammaln(0.5 * np.asarray(nu))
    norm = norm - 0.5 * n_products * np.log(np.pi * np.asarray(nu))
    return np.asarray(norm - half * np.log1p(squares / nu))


def start(data: RunArrays, spread_scale: float, rng: np.random.Generator) -> GibbsState:
    """Return a random start near the median of the runs; spreads are sds times random factors."""
    means = data.mean
    n_runs, n_products = means.shape
    sds = (means.std(axis=0) + 0.1 * spread_scale) * np.exp(0.5 * rng.standard_normal(n_products))
    middle = np.median(means, axis=0) + sds * rng.standard_normal(n_products) / np.sqrt(n_runs)
    slopes = np.zeros((data.design.shape[1], n_products))
    levels = np.zeros((data.n_rigs, n_products))
    if data.n_rigs == 1:
        slopes[0] = middle
    else:
        levels += middle
    scales = np.full(n_products, spread_scale**-2.0)
    return GibbsState(
        slopes=slopes,
        levels=levels,
        mean=middle,
        root=np.diag(1.0 / sds),
        scales=scales,
        rig_root=np.diag(1.0 / sds),
        rig_scales=scales,
        nu=float(rng.choice(FREEDOMS[4:])),
        design=np.nan_to_num(data.design, nan=0.0),
    )


def sweep(
    data: RunArrays, state: GibbsState, spread_scale: float, rng: np.random.Generator
) -> GibbsState:
    """Update every unknown once."""
    chosen, _ = choose(data, state, rng)
    state = _update_coefficients(data, state, chosen, rng)
    z = chosen.draw(state.centres(data.rig), state.root, rng)
    state, z = _rescale(data, state, z, spread_scale, rng)
    state = _impute(data, state, z, chosen.precision, rng)
    if data.n_rigs > 1:
        state = _update_rigs(state, spread_scale, rng)
    weights = chosen.precision
    residuals = z - state.centres(data.rig)
    scatter = (residuals * weights[:, None]).T @ residuals
    scatter += (state.slopes * data.precision[:, None]).T @ state.slopes
    count = len(z) + int((data.precision > 0).sum())
    root, scales = _update_covariance(scatter, count, state.scales, spread_scale, rng)
    squares = ((residuals @ root) ** 2).sum(axis=1)
    # The prior of nu is Gamma(2, 1/10) (Juarez and Steel 2010), here on an even grid of log nu.
    log_p = log_t(squares[:, None], FREEDOMS, len(root)).sum(axis=0)
    log_p += 2.0 * np.log(FREEDOMS) - FREEDOMS / 10.0
    p = np.exp(log_p - log_p.max())
    nu = float(FREEDOMS[np.searchsorted(np.cumsum(p)[:-1] / p.sum(), rng.random())])
    return replace(state, root=root, scales=scales, nu=nu)


@dataclass(frozen=True, slots=True)
class Chosen:
    """Each run has drawn a mixture component, with `means (R, K)`, and a `precision (R,)`.

    The columns of `axes (R, K, K)` define coordinates in which Sigma is the unit matrix, and the
    covariance of the component is diagonal with `variance (R, K)`.
    """

    means: Array
    axes: Array
    variance: Array
    precision: Array

    def draw(self, centres: Array, root: Array, rng: np.random.Generator) -> Array:
        """Draw the log products `(R, K)` of all runs, given their means `centres (R, K)`."""
        gap = ((self.means - centres)[:, None, :] @ self.axes)[:, 0]
        weight = 1.0 / (1.0 + self.variance * self.precision[:, None])  # of the run's own mean
        moved = weight * gap + np.sqrt(weight * self.variance) * rng.standard_normal(gap.shape)
        covariance = np.linalg.inv(root @ root.T)
        return np.asarray(centres + (self.axes @ moved[..., None])[..., 0] @ covariance)


def choose(data: RunArrays, state: GibbsState, rng: np.random.Generator) -> tuple[Chosen, Array]:
    """Draw a mixture component and a precision for each run, given the population.

    Returns both, and the contribution `(R,)` of each run to the population's log likelihood.
    """
    nodes, log_mass = _precisions(state.nu)
    (n_runs, width, n_products), centres = data.means.shape, state.centres(data.rig)
    uniform = np.asarray(rng.random((n_runs, 1)))
    parts = []
    size = max(1, BATCH // (width * n_products * PRECISION_NODES))
    for start in range(0, n_runs, size):
        part = slice(start, start + size)
        variance, axes = np.linalg.eigh(state.root.T @ data.covariances[part] @ state.root)
        # Rounding may make a variance negative.
        variance, axes = np.maximum(variance, 0.0), state.root @ axes
        deviation = ((data.means[part] - centres[part, None])[..., None, :] @ axes)[..., 0, :]
        total = variance[..., None, :] + 1.0 / nodes[:, None]
        log_p = -0.5 * (deviation[..., None, :] ** 2 / total + np.log(total)).sum(axis=-1)
        log_p = (log_p + data.log_weights[part, :, None] + log_mass).reshape(len(axes), -1)
        top = log_p.max(axis=1, keepdims=True)
        sums = np.cumsum(np.exp(log_p - top), axis=1)
        index = (sums < uniform[part] * sums[:, -1:]).sum(axis=1)
        best = np.arange(len(axes)), index // len(nodes)
        log_sum = top[:, 0] + np.log(sums[:, -1])
        node = nodes[index % len(nodes)]
        parts.append((data.means[part][best], axes[best], variance[best], node, log_sum))
    *chosen, log_likelihood = (np.concatenate(each) for each in zip(*parts, strict=True))
    log_likelihood += np.log(np.abs(np.diagonal(state.root))).sum()
    return Chosen(*chosen), log_likelihood - 0.5 * n_products * np.log(2.0 * np.pi)


def _rescale(
    data: RunArrays, state: GibbsState, z: Array, spread_scale: float, rng: np.random.Generator
) -> tuple[GibbsState, Array]:
    """Multiply the spread and all runs' deviations by a common factor, one product after another.

    Without these Metropolis steps, chains mix slowly: spreads change little while runs are fixed,
    and runs change little while spreads are fixed (Yu and Meng 2011).
    """
    n_products, centres = z.shape[1], state.centres(data.rig)
    size = np.exp(rng.uniform(np.log(LEAST_STEP), np.log(MOST_STEP), n_products))
    steps = size * rng.standard_normal(n_products)
    log_uniform = np.log(rng.random(n_products))
    root, before = state.root.copy(), _log_likelihood(data, z)
    common = data.precision > 0  # coefficients whose prior covariance is proportional to Sigma
    slopes, width = state.slopes[common], np.sqrt(data.precision[common])[:, None]
    power = HALF_T_FREEDOM + n_products - 1 + len(slopes)
    for k, step in enumerate(steps):
        stretched, narrowed = z.copy(), root.copy()
        stretched[:, k] += np.expm1(step) * (z[:, k] - centres[:, k])
        narrowed[k] *= np.exp(-step)
        after = _log_likelihood(data, stretched)
        change = after - before - power * step
        for sign, each in ((-1, narrowed), (1, root)):
            rate = HALF_T_FREEDOM * (each[k] ** 2).sum() + spread_scale**-2.0
            change += sign * 0.5 * (HALF_T_FREEDOM + n_products) * np.log(rate)
            change += sign * 0.5 * ((width * (slopes @ each)) ** 2).sum()
        if log_uniform[k] < change:
            z, root, before = stretched, narrowed, after
    return replace(state, root=root, scales=_draw_scales(root, spread_scale, rng)), z


def _draw_scales(root: Array, spread_scale: float, rng: np.random.Generator) -> Array:
    """Draw the auxiliary variables of the prior, given a root of the inverse covariance."""
    rate = HALF_T_FREEDOM * (root**2).sum(axis=1) + spread_scale**-2.0
    return np.asarray(rate / rng.gamma(0.5 * (HALF_T_FREEDOM + len(root)), size=len(root)))


def _log_likelihood(data: RunArrays, z: Array) -> float:
    """Return the log likelihood of log products `z (R, K)` of all runs, up to a constant."""
    standard = ((z[:, None] - data.means)[..., None, :] @ data.roots)[..., 0, :]
    terms = data.log_norms - 0.5 * (standard**2).sum(axis=-1)
    return float(np.logaddexp.reduce(terms, axis=1).sum())


@cache
def _precisions(nu: float) -> tuple[Array, Array]:
    """Return nodes and log masses of a gamma distribution with mean 1 and shape `nu / 2`.

    The trapezoidal rule in the logarithm is accurate even for the small precision of far outliers.
    """
    half = 0.5 * nu
    low, high = (
        scipy.special.gammaincinv(half, CUT_MASS),
        scipy.special.gammainccinv(half, CUT_MASS),
    )
    log_nodes = np.linspace(np.log(low / half), np.log(high / half), PRECISION_NODES)
    log_mass = half * (log_nodes - np.exp(log_nodes))
    return np.exp(log_nodes), np.asarray(log_mass - np.logaddexp.reduce(log_mass))


def _impute(
    data: RunArrays, state: GibbsState, z: Array, weights: Array, rng: np.random.Generator
) -> GibbsState:
    """Draw the missing covariates from their conditional normal distributions."""
    missing = np.isnan(data.design)
    if not missing.any():
        return state
    design = state.design.copy()
    for column in np.flatnonzero(missing.any(axis=0)):
        rows, slope = np.flatnonzero(missing[:, column]), state.slopes[column] @ state.root
        residuals = (z - state.levels[data.rig] - design @ state.slopes)[rows] @ state.root
        residuals += design[rows, column, None] * slope
        precision = 1.0 + weights[rows] * (slope @ slope)
        expected = weights[rows] * (residuals @ slope) / precision
        design[rows, column] = expected + rng.standard_normal(len(rows)) / np.sqrt(precision)
    return replace(state, design=design)


def _update_coefficients(
    data: RunArrays, state: GibbsState, chosen: Chosen, rng: np.random.Generator
) -> GibbsState:
    """Draw coefficients and, of several rigs, the levels; log products are integrated out."""
    slopes, levels, x = state.slopes, state.levels, state.design
    inverse = state.root @ state.root.T
    scale = 1.0 / (chosen.variance + 1.0 / chosen.precision[:, None])
    known = (chosen.axes * scale[:, None, :]) @ np.swapaxes(chosen.axes, 1, 2)
    if slopes.size:
        moment = (known @ (chosen.means - levels[data.rig])[..., None])[..., 0]
        precision = np.einsum("rp,rq,rij->piqj", x, x, known, optimize=True)
        precision += np.einsum("pq,ij->piqj", np.diag(data.precision), inverse)
        square = precision.reshape(slopes.size, slopes.size)
        slopes = _normal(square, (x.T @ moment).ravel(), rng).reshape(slopes.shape)
    if data.n_rigs > 1:
        prior = state.rig_root @ state.rig_root.T
        precision, moment = np.zeros((len(levels), *prior.shape)) + prior, state.mean @ prior
        moments = np.zeros_like(levels) + moment
        np.add.at(precision, data.rig, known)
        np.add.at(moments, data.rig, (known @ (chosen.means - x @ slopes)[..., None])[..., 0])
        levels = _normal(precision, moments, rng)
    return replace(state, slopes=slopes, levels=levels)


def _normal(precision: Array, moment: Array, rng: np.random.Generator) -> Array:
    """Draw from normals with `precision (..., n, n)` and precision @ mean = `moment`."""
    root = np.linalg.cholesky(precision)
    half = np.linalg.solve(root, moment[..., None]) + rng.standard_normal((*moment.shape, 1))
    return np.asarray(np.linalg.solve(np.swapaxes(root, -1, -2), half)[..., 0])


def _update_rigs(state: GibbsState, spread_scale: float, rng: np.random.Generator) -> GibbsState:
    """Draw the mean and the covariance of the rigs' levels, given these levels."""
    (n_rigs, n_products), levels = state.levels.shape, state.levels
    mean, rig_root, scales = state.mean, state.rig_root, state.rig_scales
    for _ in range(RIG_UPDATES):
        noise = rng.standard_normal(n_products) @ np.linalg.inv(rig_root)
        mean = levels.mean(axis=0) + noise / np.sqrt(n_rigs)
        scatter = (levels - mean).T @ (levels - mean)
        rig_root, scales = _update_covariance(scatter, n_rigs, scales, spread_scale, rng)
    return replace(state, mean=mean, rig_root=rig_root, rig_scales=scales)


def _update_covariance(
    scatter: Array, count: int, scales: Array, spread_scale: float, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Draw root and scales of a covariance, given `scatter (K, K)` of `count` residuals."""
    n_products = len(scatter)
    root = np.linalg.cholesky(np.linalg.inv(scatter + np.diag(2.0 * HALF_T_FREEDOM / scales)))
    freedom = HALF_T_FREEDOM + n_products - 1 + count
    factor = np.tril(rng.standard_normal((n_products, n_products)), -1)
    factor += np.diag(np.sqrt(rng.chisquare(freedom - np.arange(n_products))))  # Bartlett (1933)
    root = root @ factor
    return root, _draw_scales(root, spread_scale, rng)
