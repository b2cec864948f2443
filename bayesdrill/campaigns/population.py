"""Sample the population of the runs' log products, given the likelihood of each run as a mixture.

The log products of run r with rig g and covariates x_r (K numbers each) are

    z_r = eta_g + B' x_r + e_r,    e_r ~ t_nu(0, Sigma),    eta_g ~ N(mu, Sigma_rig),

where eta_g = mu if there is one rig.  The likelihood of a population is the product over runs of the
integral of p(z_r | population) L_r(z_r).  The likelihood L_r of a run is a mixture of normal
distributions, for its posterior over its interim prior (Hogg, Myers and Bovy 2010).

Each sweep of a chain first draws z_r of every run, and then updates the population by its conditional
distributions (Gibbs).  A t distribution is a normal one whose precision has a gamma distribution, over
which z_r is drawn by quadrature.  Covariances have the prior of Huang and Wand (2013): half-t standard
deviations, uniform correlations.  A covariate that was not noted is an unknown with a standard normal
prior.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import scipy

from bayesdrill.basics.arrays import Array, Indices
from bayesdrill.basics.progress import Reporter
from bayesdrill.campaigns.mixture import RunMixture
from bayesdrill.sampling.convergence import Convergence, Targets, assess, chain_length

HALF_T_FREEDOM = 2.0  # of the sds; with two, correlations are uniform between -1 and 1
CENTRAL = float(scipy.special.ndtr(1.0))  # the quantile at one standard deviation
FREEDOMS = np.geomspace(2.0, 200.0, 14)  # values of nu; with 200 the tails are normal
FIRST_CHECK = 800  # sweeps
BATCH = 1 << 19  # numbers in memory at a time
RIG_UPDATES = 8  # updates of the spread of rigs in a sweep, since few rigs leave it to its prior
PRECISION_NODES = 24  # of the quadrature over the precision of a run
CUT_MASS = 1e-9  # mass of that precision beyond each end of the quadrature
LEAST_STEP, MOST_STEP = 0.05, 2.0  # of logarithms of spreads, whatever is known of them
NO_SPREAD = 1e-3  # chains need not agree on logarithms of spreads far below this
MOST_STATES = 2000  # states of a chain that are kept; of more, every other one is dropped


@dataclass(frozen=True, slots=True, kw_only=True)
class RunArrays:
    """The mixtures of R runs have `log_weights (R, C)`, -inf in padding, `means` and `covariances`.

    `roots` times their transposes are the inverse covariances, and `log_norms (R, C)` the logarithms
    of weights times densities at the means, up to a constant.
    `mean (R, K)` and `covariance (R, K, K)` are the moments of each run alone, and `information` is the
    inverse of that covariance.  `rig (R,)` is the index of the run's rig among `n_rigs`.
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
    information: Array
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
    covariance = np.array([run.covariance for run in runs])
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
        covariance=covariance,
        information=np.linalg.inv(covariance),
        rig=rig,
        n_rigs=n_rigs,
        design=design,
        precision=precision,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _State:
    """A chain has this state; `root` times its transpose is the inverse of Sigma, and so `rig_root`.

    `scales (K,)` are the auxiliary numbers of the prior of the sds, and `design (R, p)` has no gaps.
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


@dataclass(frozen=True, slots=True, kw_only=True)
class PopulationDraws:
    """M draws of the population have its parameters, `(M, ...)` each, and the terms of R runs.

    `covariance` is Sigma, `rig_covariance` is Sigma_rig (zero with one rig), and `levels` are eta_g.
    `log_likelihood (M, R)` are the terms of the runs in the likelihood.  As a member of the population
    a run has the moments `shrunk` and `shrunk_sd`, `(R, K)` each.
    """

    mean: Array
    slopes: Array
    levels: Array
    covariance: Array
    rig_covariance: Array
    nu: Array
    log_likelihood: Array
    shrunk: Array
    shrunk_sd: Array
    convergence: Convergence

    @property
    def spread(self) -> Array:
        """Return the spread over runs of a rig, `(M, K)`."""
        return np.asarray(sds_of(self.covariance) * self.spread_of_t[:, None])

    @property
    def spread_of_t(self) -> Array:
        """Return half the width of the central 68 % of a standard t, `(M,)`."""
        return np.asarray(scipy.special.stdtrit(self.nu, CENTRAL))


def sds_of(covariance: Array) -> Array:
    """Return the standard deviations of covariances, `(..., K, K) -> (..., K)`."""
    return np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))


def log_t(squares: Array, nu: Array | float, n_products: int) -> Array:
    """Return the log density of a standard t at squared distances, with `nu` degrees of freedom."""
    half = 0.5 * (nu + n_products)
    norm = scipy.special.gammaln(half) - scipy.special.gammaln(0.5 * np.asarray(nu))
    norm = norm - 0.5 * n_products * np.log(np.pi * np.asarray(nu))
    return np.asarray(norm - half * np.log1p(squares / nu))


def sample_population(
    data: RunArrays,
    products: tuple[str, ...],
    spread_scale: float,
    targets: Targets,
    max_sweeps: int,
    n_chains: int,
    most_draws: int,
    rng: np.random.Generator,
    report: Reporter,
) -> PopulationDraws:
    """Sample the population until `targets` are met, and return at most `most_draws`, evenly spaced.

    Half-t priors of sds have the `spread_scale`.
    """
    streams = rng.spawn(n_chains)
    states = [_start(data, spread_scale, stream) for stream in streams]
    traces: list[list[Array]] = [[] for _ in states]
    kept: list[list[_State]] = [[] for _ in states]
    stride, wanted, names = 1, FIRST_CHECK, _trace_names(data, products)
    report.update(0.0, "sampling the population")
    while True:
        wanted = min(wanted, max_sweeps)
        for sweep in range(len(traces[0]), wanted):
            for k, stream in enumerate(streams):
                traces[k].append(_trace(data, states[k]))
                if sweep % stride == 0:
                    kept[k].append(states[k])
                states[k] = _sweep(data, states[k], spread_scale, stream)
            if len(kept[0]) > MOST_STATES:
                kept, stride = [chain[::2] for chain in kept], 2 * stride
            report.update(0.99 * sweep / wanted, "sampling the population")
        theta = np.array(traces)[:, :, None, :]
        length = chain_length(theta)
        checked = assess(theta, names, targets, measured=length)
        if checked.converged or wanted >= max_sweeps:
            break
        wanted = max(length.next_check(wanted, targets.n_tau), int(1.25 * wanted))
    report.update(1.0, "")
    first, end = -(-checked.burn_in // stride), len(kept[0])
    count = min(end - first, most_draws // n_chains)
    chosen = np.unique(np.linspace(first, end - 1, count).astype(np.intp))
    sample = [chain[i] for chain in kept for i in chosen]
    return _population_draws(data, sample, checked, rng)


def _population_draws(
    data: RunArrays,
    states: list[_State],
    checked: Convergence,
    rng: np.random.Generator,
) -> PopulationDraws:
    """Stack the states of all chains; with one rig its level is taken from the coefficients."""
    log_likelihood = np.zeros((len(states), len(data.rig)))
    shrunk, spread = np.zeros_like(data.mean), np.zeros_like(data.mean)
    for m, state in enumerate(states):
        z, log_likelihood[m] = _draw_runs(data, state, rng)
        apart = z - shrunk
        shrunk += apart / (m + 1)
        spread += apart * (z - shrunk)  # Welford (1962)

    def stacked(name: str) -> Array:
        return np.array([getattr(state, name) for state in states])

    slopes, levels, mean = stacked("slopes"), stacked("levels"), stacked("mean")
    rig_root, root = stacked("rig_root"), stacked("root")
    rig_covariance = np.zeros_like(root)
    if data.n_rigs == 1:
        levels, mean, slopes = slopes[:, :1], slopes[:, 0], slopes[:, 1:]
    else:
        rig_covariance = np.linalg.inv(rig_root @ np.swapaxes(rig_root, -1, -2))
    return PopulationDraws(
        mean=mean,
        slopes=slopes,
        levels=levels,
        covariance=np.linalg.inv(root @ np.swapaxes(root, -1, -2)),
        rig_covariance=rig_covariance,
        nu=stacked("nu"),
        log_likelihood=log_likelihood,
        shrunk=shrunk,
        shrunk_sd=np.sqrt(spread / len(states)),
        convergence=checked,
    )


def _start(data: RunArrays, spread_scale: float, rng: np.random.Generator) -> _State:
    """Start a chain at the runs' means, with standard deviations off by a random factor."""
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
    return _State(
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


def _sweep(data: RunArrays, state: _State, spread_scale: float, rng: np.random.Generator) -> _State:
    """Update all that is unknown once."""
    n_products = len(state.root)
    z, _ = _draw_runs(data, state, rng)
    state, z = _rescale(data, state, z, spread_scale, rng)
    state, z = _shift(data, state, z, rng)
    standard = (z - state.centres(data.rig)) @ state.root
    squares = (standard**2).sum(axis=1)
    weights = rng.gamma(0.5 * (state.nu + n_products), 2.0 / (state.nu + squares))
    state = _impute(data, state, z, weights, rng)
    state = _update_slopes(data, state, z, weights, rng)
    if data.n_rigs > 1:
        state = _update_levels(data, state, z, weights, spread_scale, rng)
    residuals = z - state.centres(data.rig)
    scatter = (residuals * weights[:, None]).T @ residuals
    scatter += (state.slopes * data.precision[:, None]).T @ state.slopes
    count = len(z) + int((data.precision > 0).sum())
    root, scales = _update_covariance(scatter, count, state.scales, spread_scale, rng)
    squares = ((residuals @ root) ** 2).sum(axis=1)
    # Juarez and Steel's (2010) prior of nu, Gamma(2, 1/10), on a grid of its logarithm
    log_p = log_t(squares[:, None], FREEDOMS, n_products).sum(axis=0)
    log_p += 2.0 * np.log(FREEDOMS) - FREEDOMS / 10.0
    p = np.exp(log_p - log_p.max())
    nu = float(FREEDOMS[np.searchsorted(np.cumsum(p)[:-1] / p.sum(), rng.random())])
    return replace(state, root=root, scales=scales, nu=nu)


def _draw_runs(data: RunArrays, state: _State, rng: np.random.Generator) -> tuple[Array, Array]:
    """Draw the log products of each run, given the population; return them and log likelihoods.

    Coordinates are those in which Sigma is the unit matrix and a component's covariance is diagonal.
    """
    nodes, log_mass = _precisions(state.nu)
    (n_runs, width, n_products), centres = data.means.shape, state.centres(data.rig)
    uniform, noise = np.asarray(rng.random(n_runs)), rng.standard_normal((n_runs, n_products))
    back = np.linalg.inv(state.root)
    log_likelihood, z = np.empty(n_runs), np.empty((n_runs, n_products))
    size = max(1, BATCH // (width * n_products * PRECISION_NODES))
    for start in range(0, n_runs, size):
        part = slice(start, start + size)
        rows = np.arange(len(centres[part]))
        apart = (data.means[part] - centres[part, None]) @ state.root
        variance, axes = np.linalg.eigh(state.root.T @ data.covariances[part] @ state.root)
        apart = (apart[..., None, :] @ axes)[..., 0, :]
        total = variance[..., None, :] + 1.0 / nodes[:, None]
        log_p = -0.5 * (apart[..., None, :] ** 2 / total + np.log(total)).sum(axis=-1)
        log_p = (log_p + data.log_weights[part, :, None] + log_mass).reshape(len(rows), -1)
        top = log_p.max(axis=1)
        sums = np.cumsum(np.exp(log_p - top[:, None]), axis=1)
        log_likelihood[part] = top + np.log(sums[:, -1])
        index = (sums < uniform[part, None] * sums[:, -1:]).sum(axis=1)
        component, node = index // len(nodes), index % len(nodes)
        share = 1.0 / (1.0 + variance[rows, component] * nodes[node, None])  # that the run decides
        moved = share * apart[rows, component]
        moved += np.sqrt(share * variance[rows, component]) * noise[part]
        z[part] = (axes[rows, component] @ moved[..., None])[..., 0] @ back
    log_likelihood += np.log(np.abs(np.diagonal(state.root))).sum()
    return z + centres, log_likelihood - 0.5 * n_products * np.log(2.0 * np.pi)


def _rescale(
    data: RunArrays, state: _State, z: Array, spread_scale: float, rng: np.random.Generator
) -> tuple[_State, Array]:
    """Stretch the spread and all runs along each product in turn, by Metropolis steps.

    The other updates change spreads little while the runs are fixed, and the runs little while the
    spreads are (Yu and Meng 2011).
    """
    n_products, centres = z.shape[1], state.centres(data.rig)
    size = np.exp(rng.uniform(np.log(LEAST_STEP), np.log(MOST_STEP), n_products))
    steps = size * rng.standard_normal(n_products)
    log_uniform = np.log(rng.random(n_products))
    root, before = state.root.copy(), _log_likelihoods(data, z).sum()
    common = data.precision > 0  # coefficients whose prior has the covariance of the runs
    slopes, width = state.slopes[common], np.sqrt(data.precision[common])[:, None]
    power = HALF_T_FREEDOM + n_products - 1 + len(slopes)
    for k, step in enumerate(steps):
        stretched, narrowed = z.copy(), root.copy()
        stretched[:, k] += np.expm1(step) * (z[:, k] - centres[:, k])
        narrowed[k] *= np.exp(-step)
        after = _log_likelihoods(data, stretched).sum()
        change = after - before - power * step
        for sign, each in ((-1, narrowed), (1, root)):
            rate = HALF_T_FREEDOM * (each[k] ** 2).sum() + spread_scale**-2.0
            change += sign * 0.5 * (HALF_T_FREEDOM + n_products) * np.log(rate)
            change += sign * 0.5 * ((width * (slopes @ each)) ** 2).sum()
        if log_uniform[k] < change:
            z, root, before = stretched, narrowed, after
    return replace(state, root=root, scales=_draw_scales(root, spread_scale, rng)), z


def _shift(
    data: RunArrays, state: _State, z: Array, rng: np.random.Generator
) -> tuple[_State, Array]:
    """Move each coefficient, and each level of several rigs, together with the runs.

    As in `_rescale`, the conditional updates hardly move them where the spread is small.
    """
    inverse, slopes = state.root @ state.root.T, state.slopes.copy()
    alone = np.zeros(len(z), dtype=np.intp)
    for j, x in enumerate(state.design.T):
        prior = data.precision[j] * inverse
        moved = _moved(data, z, x, alone, -slopes[j : j + 1], prior, rng)
        slopes[j] += moved[0]
        z = z + x[:, None] * moved[0]
    levels = state.levels
    if data.n_rigs > 1:
        prior = state.rig_root @ state.rig_root.T
        moved = _moved(data, z, np.ones(len(z)), data.rig, state.mean - levels, prior, rng)
        levels, z = levels + moved, z + moved[data.rig]
    return replace(state, slopes=slopes, levels=levels), z


def _moved(
    data: RunArrays,
    z: Array,
    x: Array,
    group: Indices,
    to_prior: Array,
    prior: Array,
    rng: np.random.Generator,
) -> Array:
    """Return by how much each group moves, `(G, K)`: log products move by this times `x (R,)`.

    The proposal has the normal approximation of each run, and is exact if that has one component.
    Prior means are at a distance of `to_prior (G, K)`, with the precision `prior (K, K)`.
    """
    n_groups, n_products = to_prior.shape
    total = np.zeros((n_groups, n_products, n_products)) + prior
    moment = to_prior @ prior
    np.add.at(total, group, (x**2)[:, None, None] * data.information)
    pull = (data.information @ (data.mean - z)[..., None])[..., 0]
    np.add.at(moment, group, x[:, None] * pull)
    root = np.linalg.cholesky(total)
    best = np.linalg.solve(total, moment[..., None])[..., 0]
    noise = rng.standard_normal((n_groups, n_products, 1))
    step = best + np.linalg.solve(np.swapaxes(root, 1, 2), noise)[..., 0]
    gain = np.zeros(n_groups)
    after = _log_likelihoods(data, z + x[:, None] * step[group])
    np.add.at(gain, group, after - _log_likelihoods(data, z))
    gain -= 0.5 * (((step - to_prior) @ prior) * (step - to_prior)).sum(axis=1)
    gain += 0.5 * ((to_prior @ prior) * to_prior).sum(axis=1)
    gain += 0.5 * (noise**2).sum(axis=(1, 2)) - 0.5 * (moment * best).sum(axis=1)
    return np.where(np.log(rng.random(n_groups)) < gain, 1.0, 0.0)[:, None] * step


def _draw_scales(root: Array, spread_scale: float, rng: np.random.Generator) -> Array:
    """Draw the auxiliary numbers of the prior of the sds, given the inverse covariance."""
    rate = HALF_T_FREEDOM * (root**2).sum(axis=1) + spread_scale**-2.0
    return np.asarray(rate / rng.gamma(0.5 * (HALF_T_FREEDOM + len(root)), size=len(root)))


def _log_likelihoods(data: RunArrays, z: Array) -> Array:
    """Return the log likelihoods `(R,)` of the log products `z (R, K)` of runs, up to constants."""
    standard = ((z[:, None] - data.means)[..., None, :] @ data.roots)[..., 0, :]
    terms = data.log_norms - 0.5 * (standard**2).sum(axis=-1)
    return np.asarray(np.logaddexp.reduce(terms, axis=1))


@cache
def _precisions(nu: float) -> tuple[Array, Array]:
    """Return nodes and log masses of a gamma distribution with mean 1 and shape `nu / 2`.

    The trapezoidal rule in the logarithm is accurate for far outliers, too, whose precision is small.
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
    data: RunArrays, state: _State, z: Array, weights: Array, rng: np.random.Generator
) -> _State:
    """Draw the covariates that were not noted from their conditional normal distributions."""
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


def _update_slopes(
    data: RunArrays, state: _State, z: Array, weights: Array, rng: np.random.Generator
) -> _State:
    """Draw the coefficients, which are matrix-normal given all else."""
    width = state.design.shape[1]
    if width == 0:
        return state
    weighted = state.design * weights[:, None]
    root = np.linalg.cholesky(weighted.T @ state.design + np.diag(data.precision))
    moment = weighted.T @ (z - state.levels[data.rig])
    noise = rng.standard_normal((width, z.shape[1])) @ np.linalg.inv(state.root)
    slopes = np.linalg.solve(root.T, np.linalg.solve(root, moment) + noise)
    return replace(state, slopes=slopes)


def _update_levels(
    data: RunArrays,
    state: _State,
    z: Array,
    weights: Array,
    spread_scale: float,
    rng: np.random.Generator,
) -> _State:
    """Draw the levels of the rigs, their mean and their covariance."""
    n_rigs, n_products = state.levels.shape
    precision, rig_precision = state.root @ state.root.T, state.rig_root @ state.rig_root.T
    totals, sums = np.zeros(n_rigs), np.zeros((n_rigs, n_products))
    np.add.at(totals, data.rig, weights)
    np.add.at(sums, data.rig, weights[:, None] * (z - state.design @ state.slopes))
    root = np.linalg.cholesky(totals[:, None, None] * precision + rig_precision)
    moment = (sums @ precision + state.mean @ rig_precision)[..., None]
    noise = rng.standard_normal((n_rigs, n_products, 1))
    levels = np.linalg.solve(np.swapaxes(root, 1, 2), np.linalg.solve(root, moment) + noise)[..., 0]
    rig_root, scales = state.rig_root, state.rig_scales
    for _ in range(RIG_UPDATES):
        noise = rng.standard_normal(n_products) @ np.linalg.inv(rig_root)
        mean = levels.mean(axis=0) + noise / np.sqrt(n_rigs)
        scatter = (levels - mean).T @ (levels - mean)
        rig_root, scales = _update_covariance(scatter, n_rigs, scales, spread_scale, rng)
    return replace(state, levels=levels, mean=mean, rig_root=rig_root, rig_scales=scales)


def _update_covariance(
    scatter: Array, count: int, scales: Array, spread_scale: float, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Draw a root of the precision, given `scatter (K, K)` of `count` residuals, and new scales."""
    n_products = len(scatter)
    root = np.linalg.cholesky(np.linalg.inv(scatter + np.diag(2.0 * HALF_T_FREEDOM / scales)))
    freedom = HALF_T_FREEDOM + n_products - 1 + count
    factor = np.tril(rng.standard_normal((n_products, n_products)), -1)
    factor += np.diag(np.sqrt(rng.chisquare(freedom - np.arange(n_products))))  # Bartlett (1933)
    root = root @ factor
    return root, _draw_scales(root, spread_scale, rng)


def _trace(data: RunArrays, state: _State) -> Array:
    """Return what convergence is judged by: levels, coefficients, log sds, correlations, log nu."""
    parts = [state.slopes.ravel()]
    roots = [state.root] if data.n_rigs == 1 else [state.root, state.rig_root]
    if data.n_rigs > 1:
        parts.append(state.mean)
    above = np.triu_indices(len(state.root), 1)
    for root in roots:
        covariance = np.linalg.inv(root @ root.T)
        sds = sds_of(covariance)
        parts += [np.log(sds + NO_SPREAD), np.arctanh((covariance / np.outer(sds, sds))[above])]
    return np.concatenate([*parts, [np.log(state.nu)]])


def _trace_names(data: RunArrays, products: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names of the entries of `_trace`."""
    names = [f"coefficient {k} of {p}" for k in range(data.design.shape[1]) for p in products]
    above = zip(*np.triu_indices(len(products), 1), strict=True)
    pairs = [f"{products[i]} and {products[j]}" for i, j in above]
    kinds = ["runs"] if data.n_rigs == 1 else ["runs", "rigs"]
    if data.n_rigs > 1:
        names += [f"mean of {p}" for p in products]
    for kind in kinds:
        names += [f"sd of {p} over {kind}" for p in products]
        names += [f"correlation of {pair} over {kind}" for pair in pairs]
    return (*names, "nu")
