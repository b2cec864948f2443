"""Fit the population of a campaign, its history over time, its runs and its rigs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayesdrill.basics.arrays import Array, Indices, StoredArray
from bayesdrill.basics.progress import Reporter
from bayesdrill.campaigns.draws import CampaignDraws
from bayesdrill.campaigns.mixture import RunArrays, RunMixture, describe, run_arrays
from bayesdrill.campaigns.outcomes import (
    NotedEffect,
    ProductPopulation,
    RigLevel,
    RunOutcome,
    noted_effects,
    product_populations,
    rig_levels,
    run_outcomes,
)
from bayesdrill.campaigns.population import PopulationSettings, sample_population, sds_of
from bayesdrill.campaigns.time_study import FOREIGN, FOREIGN_SD, LevelHistory, level_history
from bayesdrill.sampling.convergence import Convergence

MIN_RUNS = 3  # fewer runs hardly determine their spread
MIN_TIMED_RUNS = 8  # with fewer different times, drifts and changes are not searched
MAX_ERROR = 0.05  # largest acceptable `RunMixture.error`, a difference of probabilities
NOTED_PRECISION = 0.1  # prior precision of covariates' coefficients, relative to Sigma^-1
MAD_TO_SD = 1.4826  # sd of a normal distribution divided by its median absolute deviation
SUSPICIOUS = 4.0  # a run this many sds from the median of its rig may be foreign
ALARM = 0.05  # an alarm is raised if the probability of a constant level is smaller


@dataclass(frozen=True, slots=True, kw_only=True)
class ControlChart:
    """A control chart has the history of a log product, and a score of each run in order of time.

    history: drift, changes and random walk of the log product, with their probabilities
    score: (run - median run) / hypot(sd of the run, spread of the population)
    alarm: whether a constant level is improbable
    """

    product: str
    history: LevelHistory
    score: StoredArray
    alarm: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class LeaveOneOut:
    """Each run is compared with the intervals that all other runs predict for it.

    within_50: fraction of all products of all runs that lie inside their 50 % interval
    within_90: fraction of all products of all runs that lie inside their 90 % interval
    """

    within_50: float
    within_90: float


@dataclass(frozen=True, slots=True, kw_only=True)
class PopulationFit:
    """A fitted population has these fields; all levels are natural logarithms of SI values.

    products: names of the log products
    populations: population of each log product
    correlation: correlation of the products over runs, from the mean of Sigma, `(K, K)`
    tails: posterior mean of the degrees of freedom of the t distribution of runs
    rigs: levels of the rigs; empty if there is only one rig
    runs: each run alone and as a member of the population, in the order of the draws
    noted: effects of the noted columns
    missing: number of missing values in each noted column
    ignored: noted columns that are constant or nearly empty
    timed: names of the runs with a time, in order of time
    charts: control chart of each product; empty if there are too few times
    leave_one_out: check of the intervals that the population predicts for a run
    misdescribed: runs whose draws no mixture describes well, which makes the population doubtful
    convergence: convergence of the chains
    """

    products: tuple[str, ...]
    populations: tuple[ProductPopulation, ...]
    correlation: StoredArray
    tails: float
    rigs: tuple[RigLevel, ...]
    runs: tuple[RunOutcome, ...]
    noted: tuple[NotedEffect, ...]
    missing: Mapping[str, int]
    ignored: tuple[str, ...]
    timed: tuple[str, ...]
    charts: tuple[ControlChart, ...]
    leave_one_out: LeaveOneOut
    misdescribed: tuple[str, ...]
    convergence: Convergence


def fit_population(
    draws: CampaignDraws,
    settings: PopulationSettings,
    rng: np.random.Generator,
    report: Reporter,
) -> PopulationFit:
    """Fit the population of all runs.

    If products drift or change, the population describes the end of the campaign.  The drift and
    each change are covariates with a coefficient.  If a product walks at random, the mean level of
    the walk is subtracted from the runs.

    Parameters
    ----------
    draws : CampaignDraws
        Draws of each run under its interim prior.
    settings : PopulationSettings
        Priors, targets and nominal values.
    rng : numpy.random.Generator
        The stream of random numbers.
    report : Reporter
        It shows the progress.

    Returns
    -------
    PopulationFit
        The fitted population, which is doubtful if `misdescribed` is not empty.

    Raises
    ------
    ValueError
        If there are too few runs.
    """
    if len(draws.runs) < MIN_RUNS:
        raise ValueError(f"A population needs at least {MIN_RUNS} runs, but has {len(draws.runs)}.")
    rigs, runs, products = draws.rigs, draws.runs, draws.products
    rig = np.array([rigs.index(run.rig) for run in runs])
    noted, missing, ignored = _noted(draws)
    precision = np.full(noted.shape[1], NOTED_PRECISION)
    mixtures = [describe(fit.log_products, fit.log_interim) for fit in draws.fits]
    plain = run_arrays(mixtures, rig, np.zeros((len(runs), len(products))), noted, precision)
    mixtures = _contaminated(mixtures, rig)
    order = _order_of_time(draws)
    histories = _histories(draws, plain, noted, order)
    offset, trends, extra_sd = _trends(histories, draws, order)
    design = np.column_stack([noted, trends])
    precision = np.append(precision, np.zeros(trends.shape[1]))
    data = run_arrays(mixtures, rig, offset, design, precision)
    sampled = sample_population(data, products, settings, rng, report)
    shift = extra_sd * rng.standard_normal(sampled.mean.shape)
    end = replace(sampled, mean=sampled.mean + shift, levels=sampled.levels + shift[:, None])
    ahead = np.column_stack([np.nan_to_num(noted), np.zeros_like(trends)])
    populations = product_populations(end, products, settings.nominal, ahead, rng)
    labels = tuple((run.name, run.rig) for run in runs)
    errors = [mixture.error for mixture in mixtures]
    outcomes = run_outcomes(data, sampled, labels, products, offset, errors)
    mean = sampled.covariance.mean(axis=0)
    sds = sds_of(mean)
    columns = tuple(missing)
    ranks = np.array([run.ranks for run in outcomes])
    return PopulationFit(
        products=products,
        populations=populations,
        correlation=mean / np.outer(sds, sds),
        tails=float(sampled.nu.mean()),
        rigs=rig_levels(end, rigs, products, ahead, rng) if len(rigs) > 1 else (),
        runs=outcomes,
        noted=noted_effects(sampled, columns, products),
        missing=missing,
        ignored=ignored,
        timed=tuple(runs[r].name for r in order),
        charts=_charts(histories, populations, outcomes, order),
        leave_one_out=LeaveOneOut(
            within_50=float((np.abs(ranks - 0.5) < 0.25).mean()),
            within_90=float((np.abs(ranks - 0.5) < 0.45).mean()),
        ),
        misdescribed=tuple(run.name for run in outcomes if run.description_error > MAX_ERROR),
        convergence=sampled.convergence,
    )


def _contaminated(mixtures: Sequence[RunMixture], rig: Indices) -> list[RunMixture]:
    """Add a wide component to the mixture of each run that is far from the median of its rig.

    Such a run is foreign with the prior probability `FOREIGN`.  If so, FOREIGN_SD^2 is added to its
    variance in the products in which it is far away, and it hardly affects spread and centre.
    """
    mean = np.array([run.mean for run in mixtures])
    for g in np.unique(rig):
        mean[rig == g] -= np.median(mean[rig == g], axis=0)
    spread = MAD_TO_SD * np.median(np.abs(mean), axis=0)
    known = np.array([np.diagonal(run.covariance) for run in mixtures])
    far = mean**2 > SUSPICIOUS**2 * (spread**2 + known)
    return [
        replace(
            run,
            log_weights=np.append(*(run.log_weights + np.log([[1.0 - FOREIGN], [FOREIGN]]))),
            means=np.concatenate([run.means, run.means]),
            covariances=np.concatenate(
                [run.covariances, run.covariances + FOREIGN_SD**2 * np.diag(products)]
            ),
        )
        if products.any()
        else run
        for run, products in zip(mixtures, far, strict=True)
    ]


def _noted(draws: CampaignDraws) -> tuple[Array, dict[str, int], tuple[str, ...]]:
    """Return standardised covariates (noted columns), numbers of missing values, and ignored columns."""
    columns, missing, ignored = [], {}, []
    for name in draws.noted:
        x = np.array([run.noted.get(name, np.nan) for run in draws.runs])
        x[~np.isfinite(x)] = np.nan
        present = x[~np.isnan(x)]
        if len(present) < MIN_RUNS or np.ptp(present) <= 1e-9 * np.abs(present).max():
            ignored.append(name)
            continue
        columns.append((x - present.mean()) / present.std())
        missing[name] = len(x) - len(present)
    stacked = np.array(columns).T if columns else np.zeros((len(draws.runs), 0))
    return stacked, missing, tuple(ignored)


def _order_of_time(draws: CampaignDraws) -> Indices:
    """Return indices of runs with a time, in order of time; empty with too few different times."""
    times = np.array([np.nan if run.time is None else run.time for run in draws.runs])
    order = np.argsort(times, kind="stable")[: int(np.isfinite(times).sum())]
    return order if len(np.unique(times[order])) >= MIN_TIMED_RUNS else order[:0]


def _histories(
    draws: CampaignDraws, data: RunArrays, noted: Array, order: Indices
) -> tuple[LevelHistory, ...]:
    """Return the history of each log product, with rigs and covariates as regressors."""
    if len(order) == 0:
        return ()
    mean, covariance = data.mean, data.covariance
    times = np.array([draws.runs[r].time for r in order], dtype=float)
    rigs = np.eye(data.n_rigs)[data.rig]
    regressors = np.column_stack([rigs, np.nan_to_num(noted)])[order]
    regressors = regressors[:, regressors.any(axis=0)]
    return tuple(
        level_history(times, mean[order, k], covariance[order, k, k], regressors)
        for k in range(mean.shape[1])
    )


def _trends(
    histories: tuple[LevelHistory, ...], draws: CampaignDraws, order: Indices
) -> tuple[Array, Array, Array]:
    """Return walks' levels `(R, K)`, columns of drifts and changes, and walks' final sds `(K,)`.

    Levels and columns are zero at the end of the campaign, and for runs without a time.
    """
    n_runs, n_products = len(draws.runs), len(draws.products)
    offset, extra_sd = np.zeros((n_runs, n_products)), np.zeros(n_products)
    columns: dict[int, Array] = {}
    times = np.array([draws.runs[r].time for r in order], dtype=float)
    for k, history in enumerate(histories):
        if history.best == "walk":
            offset[order, k] = history.level - history.level[-1]
            extra_sd[k] = history.level_sd[-1]
        for run, (_, column) in history.terms(times).items():
            columns[run] = np.zeros(n_runs)
            columns[run][order] = column
    trends = np.array([columns[key] for key in sorted(columns)]).reshape(-1, n_runs).T
    return offset, trends, extra_sd


def _charts(
    histories: tuple[LevelHistory, ...],
    populations: tuple[ProductPopulation, ...],
    outcomes: tuple[RunOutcome, ...],
    order: Indices,
) -> tuple[ControlChart, ...]:
    """Return the control chart of each product, whose scores are relative to the median run."""
    charts = []
    for k, history in enumerate(histories):
        alone, sd = (
            np.array([getattr(outcomes[r], name)[k] for r in order])
            for name in ("alone", "alone_sd")
        )
        charts.append(
            ControlChart(
                product=populations[k].product,
                history=history,
                score=(alone - np.median(alone)) / np.hypot(sd, populations[k].spread.mean),
                alarm=history.probabilities["constant"] < ALARM,
            )
        )
    return tuple(charts)
