"""Sample the population of the runs' log products by reweighting the draws of each run.

The log products of run r with rig g and covariates x_r (K numbers each) are

    z_r = eta_g + B' x_r + e_r,    e_r ~ t_nu(0, Sigma),    eta_g ~ N(mu, Sigma_rig),

where eta_g = mu if there is one rig.  The likelihood of a population is the product over runs of the
mean of p(z_rs | population) / interim(z_rs) over the draws s (Hogg, Myers and Bovy 2010).

Each sweep of a chain first chooses a draw of every run, with these ratios as weights, and then updates
the population by its conditional distributions (Gibbs).  Its stationary distribution is exactly this
likelihood times the prior, for the cost of one likelihood a sweep: a covariance of seven products and
hundreds of runs would take an ensemble millions of likelihoods.  Covariances have the prior of Huang
and Wand (2013): half-t standard deviations, uniform correlations.  A covariate that was not noted is
an unknown with a standard normal prior.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from bayesdrill.basics.arrays import Array, Indices
from bayesdrill.basics.progress import Reporter
from bayesdrill.campaigns.draws import MAX_DRAWS, InterimDraws
from bayesdrill.sampling.convergence import Convergence, Targets, assess, chain_length

HALF_T_FREEDOM = 2.0  # of the sds; with two, correlations are uniform between -1 and 1
CENTRAL = float(scipy.special.ndtr(1.0))  # the quantile at one standard deviation
FREEDOMS = np.geomspace(2.0, 200.0, 14)  # values of nu; with 200 the tails are normal
FIRST_CHECK = 800  # sweeps
MAX_NUMBERS = 4e7  # numbers in the draws of all runs, of which fewer are taken in a large campaign
MIN_DRAWS = 100  # draws of a run that are always taken
BATCH = 1 << 19  # numbers in memory at a time
RIG_UPDATES = 8  # updates of the spread of rigs in a sweep, since few rigs leave it to its prior
RUNS_EACH_SWEEP = 500  # with more runs, their terms are stored in fewer sweeps


@dataclass(frozen=True, slots=True, kw_only=True)
class RunArrays:
    """The arrays of R runs are draws `(R, S, K)` and `log_interim (R, S)`, with inf in padding.

    `counts (R,)` are the draws of each, and `rig (R,)` the index of its rig among `n_rigs`.
    `design (R, p)` has the covariates, NaN where missing, and `precision (p,)` the prior precision of
    their coefficients in units of 1 / Sigma; zero is a flat prior.
    """

    draws: Array
    log_interim: Array
    counts: Indices
    rig: Indices
    n_rigs: int
    design: Array
    precision: Array


def run_arrays(
    runs: Sequence[InterimDraws], rig: Indices, offset: Array, design: Array, precision: Array
) -> RunArrays:
    """Pad the draws of all runs, minus `offset (R, K)`, to one array."""
    n_products = offset.shape[1]
    most = int(MAX_NUMBERS / (len(runs) * n_products))
    taken = [run.thinned(min(MAX_DRAWS, max(MIN_DRAWS, most))) for run in runs]
    counts = np.array([len(log_interim) for _, log_interim in taken])
    draws = np.zeros((len(runs), int(counts.max()), n_products))
    log_interim = np.full(draws.shape[:2], np.inf)
    for r, (z, log_density) in enumerate(taken):
        draws[r, : counts[r]] = z - offset[r]
        log_interim[r, : counts[r]] = log_density - log_density.max()
    n_rigs = int(rig.max()) + 1
    if n_rigs == 1:  # the level of the only rig is a coefficient like others
        design = np.column_stack([np.ones(len(runs)), design])
        precision = np.concatenate([[0.0], precision])
    return RunArrays(
        draws=draws,
        log_interim=log_interim,
        counts=counts,
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
    `index (M, R)` is the chosen draw of each run, `log_likelihood (M, R)` its term of the likelihood,
    and `effective (M, R)` the effective number of its draws.
    """

    mean: Array
    slopes: Array
    levels: Array
    covariance: Array
    rig_covariance: Array
    nu: Array
    index: Indices
    log_likelihood: Array
    effective: Array
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
    stride = max(1, len(data.counts) // RUNS_EACH_SWEEP)
    sweeps: list[list[_State]] = [[] for _ in states]
    terms: list[list[tuple[Indices, Array, Array]]] = [[] for _ in states]
    wanted, names = FIRST_CHECK, _trace_names(data, products)
    report.update(0.0, "sampling the population")
    while True:
        wanted = min(wanted, max_sweeps)
        for k, stream in enumerate(streams):
            while len(sweeps[k]) < wanted:
                kept = len(sweeps[k]) % stride == 0
                sweeps[k].append(states[k])
                states[k], term = _sweep(data, states[k], spread_scale, stream)
                if kept:
                    terms[k].append(term)
                report.update(0.99 * len(sweeps[k]) / wanted, "sampling the population")
        theta = np.array([[_trace(data, state) for state in chain] for chain in sweeps])
        length = chain_length(theta[:, :, None, :])
        checked = assess(theta[:, :, None, :], names, targets, measured=length)
        if checked.converged or wanted >= max_sweeps:
            break
        wanted = max(length.next_check(wanted, targets.n_tau), int(1.25 * wanted))
    report.update(1.0, "")
    first, end = -(-checked.burn_in // stride), len(terms[0])
    count = min(end - first, most_draws // n_chains)
    chosen = np.unique(np.linspace(first, end - 1, count).astype(np.intp))
    states = [chain[i * stride] for chain in sweeps for i in chosen]
    return _population_draws(data, states, [chain[i] for chain in terms for i in chosen], checked)


def _population_draws(
    data: RunArrays,
    states: list[_State],
    terms: list[tuple[Indices, Array, Array]],
    checked: Convergence,
) -> PopulationDraws:
    """Stack the states of all chains; with one rig its level is taken from the coefficients."""

    def stacked(name: str) -> Array:
        return np.array([getattr(state, name) for state in states])

    slopes, levels, mean = stacked("slopes"), stacked("levels"), stacked("mean")
    rig_root, root = stacked("rig_root"), stacked("root")
    rig_covariance = np.zeros_like(root)
    if data.n_rigs == 1:
        levels, mean, slopes = slopes[:, :1], slopes[:, 0], slopes[:, 1:]
    else:
        rig_covariance = np.linalg.inv(rig_root @ np.swapaxes(rig_root, -1, -2))
    index, log_likelihood, effective = map(np.array, zip(*terms, strict=True))
    return PopulationDraws(
        mean=mean,
        slopes=slopes,
        levels=levels,
        covariance=np.linalg.inv(root @ np.swapaxes(root, -1, -2)),
        rig_covariance=rig_covariance,
        nu=stacked("nu"),
        index=index,
        log_likelihood=log_likelihood,
        effective=effective,
        convergence=checked,
    )


def _start(data: RunArrays, spread_scale: float, rng: np.random.Generator) -> _State:
    """Start a chain at the runs' means, with standard deviations off by a random factor."""
    used = np.isfinite(data.log_interim)
    means = data.draws.sum(axis=1) / used.sum(axis=1)[:, None]
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


def _sweep(
    data: RunArrays, state: _State, spread_scale: float, rng: np.random.Generator
) -> tuple[_State, tuple[Indices, Array, Array]]:
    """Update all that is unknown once; return the terms of the runs at the old state, too."""
    n_products = len(state.root)
    term = _choose_draws(data, state, rng)
    z = data.draws[np.arange(len(data.counts)), term[0]]
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
    return replace(state, root=root, scales=scales, nu=nu), term


def _choose_draws(
    data: RunArrays, state: _State, rng: np.random.Generator
) -> tuple[Indices, Array, Array]:
    """Choose a draw of each run by its weight; return indices, log likelihoods and effective draws."""
    n_runs, n_draws, n_products = data.draws.shape
    centres, uniform = state.centres(data.rig), np.asarray(rng.random(n_runs))
    size = max(1, BATCH // (n_draws * n_products))
    terms = []
    for start in range(0, n_runs, size):
        part = slice(start, start + size)
        standard = (data.draws[part] - centres[part, None]) @ state.root
        squares = np.einsum("rsk,rsk->rs", standard, standard)
        log_w = log_t(squares, state.nu, n_products) - data.log_interim[part]
        top = log_w.max(axis=1)
        weights = np.exp(log_w - top[:, None])
        sums = np.cumsum(weights, axis=1)
        total = sums[:, -1]
        index = (sums < (uniform[part, None] * sums[:, -1:])).sum(axis=1)
        log_like = top + np.log(total / data.counts[part])
        terms.append((index, log_like, total**2 / (weights**2).sum(axis=1)))
    index, log_like, effective = (np.concatenate(parts) for parts in zip(*terms, strict=True))
    log_like += np.log(np.abs(np.diagonal(state.root))).sum()
    return index.astype(np.int16), log_like, effective


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
    rate = HALF_T_FREEDOM * (root**2).sum(axis=1) + spread_scale**-2.0
    return root, rate / rng.gamma(0.5 * (HALF_T_FREEDOM + n_products), size=n_products)


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
        parts += [np.log(sds), np.arctanh((covariance / np.outer(sds, sds))[above])]
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
