"""Sample the distribution of products of parameters, in logs, over a population of runs.

The K log products of run r, which has rig g and covariates x_r, are

    z_r = eta_g + B' x_r + e_r,    e_r ~ t_nu(0, Sigma),    eta_g ~ N(mu, Sigma_rig),

where eta_g = mu if there is one rig.  The likelihood of a population is the product, over runs, of
the integrals of p(z_r | population) L_r(z_r).  Here L_r is the run's posterior divided by its
interim prior (Hogg, Myers and Bovy 2010), and is described by a mixture of normal distributions.

Chains of Gibbs sampling (see `gibbs.py`) run until they pass the checks of `convergence.py`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import scipy

from bayesdrill.basics.arrays import Array
from bayesdrill.basics.progress import Reporter
from bayesdrill.campaigns.gibbs import GibbsState, choose, start, sweep
from bayesdrill.campaigns.mixture import RunArrays
from bayesdrill.sampling.convergence import Convergence, Targets, assess, chain_length

CENTRAL = float(scipy.special.ndtr(1.0))  # probability below the upper end of the central 68 %
FIRST_CHECK = 800  # number of sweeps before the first check of convergence
NO_SPREAD = 1e-3  # added to sds whose logarithms are checked, as smaller sds need not converge
MOST_STATES = 2000  # largest number of stored states of a chain; beyond it, every other is dropped


@dataclass(frozen=True, slots=True, kw_only=True)
class NominalRange:
    """A nominal value has the logarithm `value`, and a tolerance from `low` to `high`, in logs."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, slots=True, kw_only=True)
class PopulationSettings:
    """A population is fitted with these settings.

    spread_scale: scale of the half-t prior (two degrees of freedom) of all spreads, in logs
    nominal: logs of nominal values by product; empty if they are not to be compared
    targets: targets at which the sampler stops
    max_sweeps: largest number of sweeps of each chain
    chains: number of chains
    draws: largest number of draws that all chains together return
    """

    spread_scale: float = 0.1
    nominal: Mapping[str, NominalRange] = field(default_factory=dict)
    targets: Targets = field(default_factory=lambda: Targets(r_hat=1.01, n_tau=50.0, ess=400.0))
    max_sweeps: int = 20_000
    chains: int = 4
    draws: int = 1000


@dataclass(frozen=True, slots=True, kw_only=True)
class PopulationDraws:
    """M draws of the population's parameters are arrays `(M, ...)`, with results for R runs.

    `covariance` is Sigma, `rig_covariance` is Sigma_rig (zero with one rig), and `levels` are eta_g.
    `log_likelihood (M, R)` has the term of each run.  `run_means` and `run_sds (R, K)` are the means
    and sds of the runs' log products, given their records and the population.
    """

    mean: Array
    slopes: Array
    levels: Array
    covariance: Array
    rig_covariance: Array
    nu: Array
    log_likelihood: Array
    run_means: Array
    run_sds: Array
    convergence: Convergence

    @property
    def spread(self) -> Array:
        """Return the spread of the runs of one rig, `(M, K)`."""
        return np.asarray(sds_of(self.covariance) * self.spread_of_t[:, None])

    @property
    def spread_of_t(self) -> Array:
        """Return half the width of the central 68 % of a standard t, `(M,)`."""
        return np.asarray(scipy.special.stdtrit(self.nu, CENTRAL))


def sds_of(covariance: Array) -> Array:
    """Return the standard deviations of covariances, `(..., K, K) -> (..., K)`."""
    return np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))


def sample_population(
    data: RunArrays,
    products: tuple[str, ...],
    settings: PopulationSettings,
    rng: np.random.Generator,
    report: Reporter,
) -> PopulationDraws:
    """Sample the population until its targets are met, and return evenly spaced draws."""
    targets, spread_scale = settings.targets, settings.spread_scale
    streams = rng.spawn(settings.chains)
    states = [start(data, spread_scale, stream) for stream in streams]
    traces: list[list[Array]] = [[] for _ in states]
    kept: list[list[GibbsState]] = [[] for _ in states]
    stride, wanted, names = 1, FIRST_CHECK, _trace_names(data, products)
    done, progress = 0.0, 1.0 / settings.max_sweeps  # fractions: of all work, and of one sweep
    report.update(0.0, "sampling the population")
    while True:
        wanted = min(wanted, settings.max_sweeps)
        for step in range(len(traces[0]), wanted):
            for k, stream in enumerate(streams):
                traces[k].append(_trace(data, states[k]))
                if step % stride == 0:
                    kept[k].append(states[k])
                states[k] = sweep(data, states[k], spread_scale, stream)
            if len(kept[0]) > MOST_STATES:
                kept, stride = [chain[::2] for chain in kept], 2 * stride
            done = max(done, min(progress * (step + 1), 0.99))
            report.update(done, "sampling the population")
        theta = np.array(traces)[:, :, None, :]
        length = chain_length(theta)
        checked = assess(theta, names, targets, measured=length)
        if checked.converged or wanted >= settings.max_sweeps:
            break
        progress = checked.progress(targets) / wanted
        wanted = max(length.next_check(wanted, targets.n_tau), int(1.25 * wanted))
    report.update(1.0, "")
    first, end = -(-checked.burn_in // stride), len(kept[0])
    count = min(end - first, settings.draws // settings.chains)
    chosen = np.unique(np.linspace(first, end - 1, count).astype(np.intp))
    sample = [chain[i] for chain in kept for i in chosen]
    return _population_draws(data, sample, checked, rng)


def _population_draws(
    data: RunArrays,
    states: list[GibbsState],
    checked: Convergence,
    rng: np.random.Generator,
) -> PopulationDraws:
    """Stack the states of all chains; the level of a single rig is the first row of coefficients."""
    log_likelihood = np.zeros((len(states), len(data.rig)))
    shrunk, spread = np.zeros_like(data.mean), np.zeros_like(data.mean)
    for m, state in enumerate(states):
        chosen, log_likelihood[m] = choose(data, state, rng)
        z = chosen.draw(state.centres(data.rig), state.root, rng)
        deviation = z - shrunk
        shrunk += deviation / (m + 1)
        spread += deviation * (z - shrunk)  # Welford (1962)

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
        run_means=shrunk,
        run_sds=np.sqrt(spread / len(states)),
        convergence=checked,
    )


def _trace(data: RunArrays, state: GibbsState) -> Array:
    """Return the checked numbers: coefficients, means, log sds, artanh of correlations, log nu."""
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
