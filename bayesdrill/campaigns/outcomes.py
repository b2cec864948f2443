"""Describe a fitted population: its products and runs, the next run, and the nominal table.

All levels, spreads and intervals are in natural logarithms of the products: 0.05 is about 5 %.
A spread is half the width of the interval that holds the central 68 % of the runs.  If runs are
normal, it is their standard deviation; a few foreign runs (outliers) hardly widen it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from bayesdrill.basics.arrays import Array, StoredArray
from bayesdrill.campaigns.mixture import RunArrays
from bayesdrill.campaigns.population import NominalRange, PopulationDraws, sds_of

SAME_RUNS = 0.05  # a nominal value agrees if `TableComparison.probability` is larger
FALSE_OUTLIERS = 0.01  # expected number of false outliers in a campaign without foreign runs
FOLLOWERS = 20  # number of simulated next runs for each draw of the population


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """An estimate has mean, standard deviation, and the ends of central 50 and 90 % intervals."""

    mean: float
    sd: float
    low_90: float
    low_50: float
    high_50: float
    high_90: float


def estimate(draws: Array) -> Estimate:
    """Return the estimate of a number from its draws."""
    names = ("low_90", "low_50", "high_50", "high_90")
    ends = dict(zip(names, np.quantile(draws, [0.05, 0.25, 0.75, 0.95]).tolist(), strict=True))
    return Estimate(mean=float(draws.mean()), sd=float(draws.std()), **ends)


@dataclass(frozen=True, slots=True, kw_only=True)
class TableComparison:
    """The nominal value of a product is compared with the population.

    nominal: logarithm of the nominal value, and its tolerance
    offset: the centre of the population minus the nominal value
    probability: probability that another run is at least as far from the median run as the nearest
        end of the tolerance; 1 if the tolerance contains the median run
    agrees: whether `probability` exceeds `SAME_RUNS`
    """

    nominal: NominalRange
    offset: Estimate
    probability: float
    agrees: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class ProductPopulation:
    """The population of a log product has a centre, and spreads over runs and over rigs.

    product: name of the product
    centre: level at the end of the campaign, with noted columns at their averages
    spread: spread of the runs of one rig
    rig_spread: spread of the levels of rigs, None if there is only one rig
    next_run: log product of the next run, on a new rig if there are several rigs
    table: comparison with the nominal value, None if there is none
    """

    product: str
    centre: Estimate
    spread: Estimate
    rig_spread: Estimate | None
    next_run: Estimate
    table: TableComparison | None


@dataclass(frozen=True, slots=True, kw_only=True)
class RigLevel:
    """A rig has a level of a log product, and a prediction of the log product in the next run."""

    rig: str
    product: str
    level: Estimate
    next_run: Estimate


@dataclass(frozen=True, slots=True, kw_only=True)
class RunOutcome:
    """A run has estimates of K log products, alone and as a member of the population.

    name: name of the run
    rig: name of its rig
    alone: means `(K,)` from its record alone, without its interim prior
    alone_sd: standard deviations `(K,)` that belong to the means `alone`
    shrunk: means `(K,)` as a member of the population
    shrunk_sd: standard deviations `(K,)` that belong to the means `shrunk`
    description_error: error of the mixture that describes the run's draws, see `RunMixture`
    ranks: probabilities `(K,)` of values below those of the run, predicted by all other runs
    worst: product in which the run is farthest from the other runs
    sds: distance from the other runs in this product, divided by the sd of run and population
    tail: probability of a run at least as far away, under the t distribution
    core_tail: the same probability under a normal distribution with the population's spread
    outlier: whether the run does not belong to the population
    """

    name: str
    rig: str
    alone: StoredArray
    alone_sd: StoredArray
    shrunk: StoredArray
    shrunk_sd: StoredArray
    description_error: float
    ranks: StoredArray
    worst: str
    sds: float
    tail: float
    core_tail: float
    outlier: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class NotedEffect:
    """A noted column (a covariate) explains a part of the variation of a log product.

    column: name of the column
    product: name of the product
    slope: change of the log product for one standard deviation of the column
    share: fraction of the variance over all runs that the column explains
    """

    column: str
    product: str
    slope: Estimate
    share: Estimate


def next_runs(
    draws: PopulationDraws, start: Array, design: Array, rng: np.random.Generator
) -> Array:
    """Draw log products `(M * FOLLOWERS, K)` of next runs, whose levels are `start (M, K)`.

    Each next run has the covariates of a random run of the campaign, a row of `design (R, p)`.
    """
    n_draws, n_products = draws.mean.shape
    shape = (n_draws, FOLLOWERS, n_products)
    x = design[rng.integers(len(design), size=shape[:2])]
    root = np.linalg.cholesky(draws.covariance)
    t = np.einsum("mij,mfj->mfi", root, rng.standard_normal(shape))
    t /= np.sqrt(rng.chisquare(draws.nu[:, None], shape[:2]) / draws.nu[:, None])[..., None]
    z = start[:, None] + x @ draws.slopes + t
    return np.asarray(z.reshape(-1, n_products))


def product_populations(
    draws: PopulationDraws,
    products: tuple[str, ...],
    nominal: Mapping[str, NominalRange],
    design: Array,
    rng: np.random.Generator,
) -> tuple[ProductPopulation, ...]:
    """Describe the population of each log product; `nominal` has nominal values by name."""
    several = bool(draws.rig_covariance.any())
    start, rig_spread = draws.mean, np.zeros_like(draws.mean)
    if several:
        root = np.linalg.cholesky(draws.rig_covariance)
        start = start + (root @ rng.standard_normal((*start.shape, 1)))[..., 0]
        rig_spread = sds_of(draws.rig_covariance)
    following = next_runs(draws, start, design, rng)
    return tuple(
        ProductPopulation(
            product=product,
            centre=estimate(draws.mean[:, k]),
            spread=estimate(draws.spread[:, k]),
            rig_spread=estimate(rig_spread[:, k]) if several else None,
            next_run=estimate(following[:, k]),
            table=(
                _compare(nominal[product], draws.mean[:, k], following[:, k])
                if product in nominal
                else None
            ),
        )
        for k, product in enumerate(products)
    )


def _compare(nominal: NominalRange, centres: Array, following: Array) -> TableComparison:
    middle = np.median(following)
    away = abs(np.clip(middle, nominal.low, nominal.high) - middle)
    probability = float((np.abs(following - middle) >= away).mean())
    return TableComparison(
        nominal=nominal,
        offset=estimate(centres - nominal.value),
        probability=probability,
        agrees=probability > SAME_RUNS,
    )


def rig_levels(
    draws: PopulationDraws,
    rigs: tuple[str, ...],
    products: tuple[str, ...],
    design: Array,
    rng: np.random.Generator,
) -> tuple[RigLevel, ...]:
    """Describe the level and the next run of each rig."""
    outcomes = []
    for g, rig in enumerate(rigs):
        following = next_runs(draws, draws.levels[:, g], design, rng)
        outcomes += [
            RigLevel(
                rig=rig,
                product=product,
                level=estimate(draws.levels[:, g, k]),
                next_run=estimate(following[:, k]),
            )
            for k, product in enumerate(products)
        ]
    return tuple(outcomes)


def noted_effects(
    draws: PopulationDraws, columns: tuple[str, ...], products: tuple[str, ...]
) -> tuple[NotedEffect, ...]:
    """Describe the effect of each noted column (of variance 1) on each log product."""
    unexplained = draws.spread**2 + sds_of(draws.rig_covariance) ** 2
    total = (draws.slopes[:, : len(columns)] ** 2).sum(axis=1) + unexplained
    return tuple(
        NotedEffect(
            column=column,
            product=product,
            slope=estimate(draws.slopes[:, j, k]),
            share=estimate(draws.slopes[:, j, k] ** 2 / total[:, k]),
        )
        for j, column in enumerate(columns)
        for k, product in enumerate(products)
    )


def _squared_distances(deviations: Array, covariances: Array) -> Array:
    """Return squared Mahalanobis distances `(M,)` of `deviations (M, K)`."""
    solved = np.linalg.solve(covariances, deviations[..., None])[..., 0]
    return np.asarray(np.einsum("mk,mk->m", deviations, solved))


def run_outcomes(
    data: RunArrays,
    draws: PopulationDraws,
    labels: tuple[tuple[str, str], ...],
    products: tuple[str, ...],
    offset: Array,
    errors: Sequence[float],
) -> tuple[RunOutcome, ...]:
    """Describe each run alone, and relative to the population of all other runs.

    `labels` are pairs of name and rig, and `errors` the errors of the runs' mixtures.  To leave out
    a run, each of M draws has the weight 1 / (likelihood of the run), but at most sqrt(M) times the
    mean weight (Ionides 2008).
    """
    alone, covariance = data.mean, data.covariance
    design = np.nan_to_num(data.design[:, data.design.shape[1] - draws.slopes.shape[1] :])
    outcomes = []
    for r, (name, rig) in enumerate(labels):
        inverse = np.exp(draws.log_likelihood[:, r].min() - draws.log_likelihood[:, r])
        weights = np.minimum(inverse, np.sqrt(len(inverse)) * inverse.mean())
        weights /= weights.sum()
        centres = draws.levels[:, data.rig[r]] + design[r] @ draws.slopes
        deviation = alone[r] - centres
        core = draws.covariance * (draws.spread_of_t**2)[:, None, None] + covariance[r]
        wide = draws.covariance + covariance[r]
        squares, t_squares = (
            _squared_distances(deviation, core),
            _squared_distances(deviation, wide),
        )
        n_products = len(products)
        core_tail = float(weights @ scipy.special.chdtrc(n_products, squares))
        tail = weights @ scipy.special.fdtrc(n_products, draws.nu, t_squares / n_products)
        sds = np.abs(weights @ (deviation / sds_of(core)))
        scales = sds_of(wide)
        outcomes.append(
            RunOutcome(
                name=name,
                rig=rig,
                alone=alone[r] + offset[r],
                alone_sd=sds_of(covariance[r]),
                shrunk=draws.run_means[r] + offset[r],
                shrunk_sd=draws.run_sds[r],
                description_error=errors[r],
                ranks=weights @ scipy.special.stdtr(draws.nu[:, None], deviation / scales),
                worst=products[int(np.argmax(sds))],
                sds=float(sds.max()),
                tail=float(tail),
                core_tail=core_tail,
                outlier=core_tail < FALSE_OUTLIERS / len(labels),
            )
        )
    return tuple(outcomes)
