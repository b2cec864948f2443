"""Distinguish a constant level, a steady drift, sudden changes and a random walk of a log product.

The estimate of run i, in order of time, is y_i = h_i' b + level_i + e_i.  The error e_i is normal
with the variance s^2 + c_i; s is the spread of runs, and c_i the variance due to the record.
Coefficients b of regressors h (rigs and covariates) have wide normal priors.  Four descriptions
of the level are compared by evidence, summed over grids of s, of the moment of a change, and of q:

    constant   level = 0
    drift      level = d (t_i - t_last) / (t_last - t_first),  d ~ N(0, SIZE^2)
    changes    level = sum of sizes of the changes before i,   size ~ N(0, SIZE^2), moment ~ uniform
    walk       level_i - level_(i-1) ~ N(0, q^2 (t_i - t_(i-1)) / (t_last - t_first))

Except for the grids, all is exact linear-Gaussian algebra: cumulative sums over runs give the
evidence of a change at every moment (Smith 1975), and a Kalman filter the evidence of the walk.
Changes are added one at a time, until a further change is improbable.

Any run may be foreign, with the prior probability FOREIGN; FOREIGN_SD^2 is then added to the
variance of e_i.  The evidence is summed over sets of foreign runs, which are chosen among the runs
farthest from their neighbours in time.  So a foreign run neither looks like a change nor hides one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy

from bayesdrill.basics.arrays import Array, StoredArray

SIZE = 0.1  # prior sd of a drift over the whole campaign and of a change, in logs
PRIOR = {"constant": 0.7, "drift": 0.1, "changes": 0.1, "walk": 0.1}
PRIOR_OF_ANOTHER = 0.1  # prior probability of a further change
ANOTHER_PROBABILITY = 0.9  # least posterior probability with which a further change is accepted
MAX_CHANGES = 10
HALF_T_FREEDOM = 2.0  # degrees of freedom of the half-t prior of s, as for the population's sds
# Scale of the prior of s.  With 0.1, a large s would explain a change and a foreign run of 15 %.
SPREAD_SCALE = 0.03
SMALLEST_SPREAD = 1e-5  # lower limit of the sd that scales the grid of s, as sums lose digits below
REGRESSOR_SD = 10.0  # prior sd of the coefficients of regressors
MIN_SPREADS, MAX_SPREADS = 12, 40  # bounds of the number of grid values of s
WALKS = 8  # number of grid values of q
NEIGHBOURS = 4  # number of runs in the medians before and after a run, see `_series`
MAD_FACTOR = 2.0  # sd of normal runs divided by the median of `deviation` in `_series`
FOREIGN = 0.03  # prior probability that a run is foreign
FOREIGN_SD = 0.2  # additional prior sd of a foreign run about the level, in logs
SUBSETS_OF = 3  # all subsets of the 3 farthest runs are tried; a larger set has the k farthest runs
MOST_FOREIGN = 0.3  # largest fraction of runs that may be foreign
# A set of foreign runs is dropped if its probability / the largest is smaller in each description.
NEGLIGIBLE = 1e-2


@dataclass(frozen=True, slots=True, kw_only=True)
class LevelChange:
    """A level changes between two runs, by `size` with standard deviation `size_sd`, in logs.

    run: index of the first run after the change, in order of time
    first: lower end of the 90 % interval of `run`
    last: upper end of the 90 % interval of `run`
    time: time of the run with index `run` [s]
    size: mean of the change of the log product
    size_sd: standard deviation of the change of the log product
    probability: probability of this change, given the changes that were found before it
    """

    run: int
    first: int
    last: int
    time: float
    size: float
    size_sd: float
    probability: float


@dataclass(frozen=True, slots=True, kw_only=True)
class LevelHistory:
    """The history of a log product has probabilities of four descriptions, and estimates for each.

    probabilities: posterior probability of each description
    drift: mean of a steady drift over the campaign, in logs
    drift_sd: standard deviation of that drift, in logs
    changes: sudden changes in order of time
    walk_sd: mean of q, the standard deviation of a random walk over the campaign, in logs
    level: mean of the level of a random walk at each run, at average regressors
    level_sd: standard deviation of that level
    """

    probabilities: dict[str, float]
    drift: float
    drift_sd: float
    changes: tuple[LevelChange, ...]
    walk_sd: float
    level: StoredArray
    level_sd: StoredArray

    @property
    def best(self) -> str:
        """Return the most probable description."""
        return max(self.probabilities, key=lambda name: self.probabilities[name])

    def terms(self, t: Array) -> dict[int, tuple[float, Array]]:
        """Return size and column `(R,)` of a drift (key 0) or of each change (key: its first run).

        The times `t (R,)` are in order.  Only the most probable description has terms.
        """
        if self.best == "drift":
            return {0: (self.drift, ramp(t))}
        changes = self.changes if self.best == "changes" else ()
        return {change.run: (change.size, step(change.run, len(t))) for change in changes}

    def level_over(self, t: Array) -> Array:
        """Return the level at the runs with times `t (R,)` in order, minus the level at the end."""
        if self.best == "walk":
            return np.asarray(self.level - self.level[-1])
        return sum((size * column for size, column in self.terms(t).values()), np.zeros(len(t)))


def ramp(t: Array) -> Array:
    """Return the column (t - t_last) / (t_last - t_first) of a drift, from -1 to 0."""
    return np.asarray((t - t[-1]) / (t[-1] - t[0]))


def step(run: int, count: int) -> Array:
    """Return the column `(count,)` of a change: -1 before index `run`, and 0 from `run` on."""
    return np.asarray(np.where(np.arange(count) < run, -1.0, 0.0))


@dataclass(frozen=True, slots=True, kw_only=True)
class _Series:
    """Estimates `y (R,)` at times `t (R,)` in order have regressors `h (R, p)` with prior sds `(p,)`.

    `variance (n, R)` has error variances for n pairs of an s and a set of foreign runs.  The pairs
    have prior log probabilities `log_prior (n,)`.
    """

    t: Array
    y: Array
    h: Array
    prior_sd: Array
    variance: Array
    log_prior: Array

    def with_column(self, column: Array) -> _Series:
        """Return the series with another regressor, a drift or a change."""
        h = np.column_stack([self.h, column])
        return replace(self, h=h, prior_sd=np.append(self.prior_sd, SIZE))


@dataclass(frozen=True, slots=True, kw_only=True)
class _LinearFit:
    """A linear fit has log evidence `(...)`, and mean and inverse covariance of coefficients."""

    log_evidence: Array
    mean: Array
    precision: Array


def _fit(y: Array, h: Array, variance: Array, prior_sd: Array) -> _LinearFit:
    """Fit `y (..., R)` by `h (..., R, p)` with independent errors of `variance (..., R)`."""
    weighted = h / variance[..., None]
    precision = np.swapaxes(weighted, -1, -2) @ h + np.diag(prior_sd**-2.0)
    moment = (np.swapaxes(weighted, -1, -2) @ y[..., None])[..., 0]
    mean = np.linalg.solve(precision, moment[..., None])[..., 0]
    squares = (y**2 / variance + np.log(2.0 * np.pi * variance)).sum(axis=-1)
    squares += np.linalg.slogdet(precision)[1] + 2.0 * np.log(prior_sd).sum()
    evidence = -0.5 * (squares - (moment * mean).sum(axis=-1))
    return _LinearFit(log_evidence=evidence, mean=mean, precision=precision)


def level_history(t: Array, y: Array, variance: Array, regressors: Array) -> LevelHistory:
    """Study the level of estimates `y (R,)` with `variance (R,)` at times `t (R,)` in order.

    The columns of `regressors (R, p)` must span the constant.
    """
    series = _series(t, y, variance, regressors)
    constant = _fit(series.y, series.h, series.variance, series.prior_sd).log_evidence
    log_constant = _log_sum(constant + series.log_prior)
    ramped = series.with_column(ramp(t))
    drift = _fit(ramped.y, ramped.h, ramped.variance, ramped.prior_sd)
    log_changes, runs, last_probability = _find_changes(series, log_constant)
    walk = _walk(series)
    log_z = {
        "constant": log_constant,
        "drift": _log_sum(drift.log_evidence + series.log_prior),
        "changes": log_changes,
        "walk": _log_sum(walk.log_evidence),
    }
    logs = np.array([log_z[name] + np.log(PRIOR[name]) for name in PRIOR])
    shares = _normalised(logs)
    probabilities = {name: float(share) for name, share in zip(PRIOR, shares, strict=True)}
    weights = _normalised(drift.log_evidence + series.log_prior)
    mean, sd = _mixture(weights, drift.mean[:, -1], np.linalg.inv(drift.precision)[:, -1, -1])
    changes = tuple(
        _change(series, runs, k, min([probabilities["changes"], *last_probability[: k + 1]]))
        for k in range(len(runs))
    )
    return LevelHistory(
        probabilities=probabilities,
        drift=mean,
        drift_sd=sd,
        changes=tuple(sorted(changes, key=lambda change: change.run)),
        walk_sd=walk.scale,
        level=walk.level,
        level_sd=walk.level_sd,
    )


def _series(t: Array, y: Array, c: Array, h: Array) -> _Series:
    """Make the grid of s, and of the sets of foreign runs that a description makes probable."""
    residuals = y - h @ np.linalg.lstsq(h, y, rcond=None)[0]
    deviation = np.minimum(_distance(residuals), _distance(residuals[::-1])[::-1])
    sd = max(MAD_FACTOR * float(np.median(deviation)), SMALLEST_SPREAD)
    known = float(np.sqrt(np.median(c)))  # typical sd of an estimate; may exceed s
    low, high = max(0.5 * sd, known), 1.5 * max(float(residuals.std()), sd, known)
    count = int(np.clip(1.5 * np.log(high / low) * np.sqrt(2 * len(y)), MIN_SPREADS, MAX_SPREADS))
    total = np.geomspace(low, high, count + 1) ** 2
    ends = np.sqrt(np.maximum(total - known**2, 0.0))
    ends[0] = 0.0
    x = ends / SPREAD_SCALE
    mass = np.diff(x / np.sqrt(HALF_T_FREEDOM + x**2))
    s = 0.5 * (ends[1:] + ends[:-1])[mass > 0]
    log_mass, prior_sd = np.log(mass[mass > 0]), np.full(h.shape[1], REGRESSOR_SD)
    grids, evidences = [], []
    for foreign in _foreign_sets(deviation):
        variance = s[:, None] ** 2 + c + FOREIGN_SD**2 * foreign
        log_prior = log_mass + foreign.sum() * np.log(FOREIGN / (1.0 - FOREIGN))
        grid = _Series(t=t, y=y, h=h, prior_sd=prior_sd, variance=variance, log_prior=log_prior)
        ramped = grid.with_column(ramp(t))
        drift = _fit(y, ramped.h, variance, ramped.prior_sd).log_evidence
        constant = _fit(y, h, variance, prior_sd).log_evidence
        grids.append(grid)
        evidences.append(
            [
                *map(_log_sum, (constant + log_prior, drift + log_prior)),
                _log_sum(_moments(grid)[0].ravel()),
            ]
        )
    relative = np.array(evidences) - np.max(evidences, axis=0)
    kept = [grids[i] for i in np.flatnonzero((relative > np.log(NEGLIGIBLE)).any(axis=1))]
    return replace(
        grids[0],
        variance=np.concatenate([grid.variance for grid in kept]),
        log_prior=np.concatenate([grid.log_prior for grid in kept]),
    )


def _foreign_sets(deviation: Array) -> Array:
    """Return masks `(n, R)` of n sets of runs that may be foreign, as their `deviation` is largest."""
    n_runs = len(deviation)
    rank = np.argsort(np.argsort(-deviation, kind="stable"))
    most = int(MOST_FOREIGN * n_runs)
    first = min(SUBSETS_OF, most)
    subsets = (np.arange(2**first)[:, None] >> np.minimum(rank, first)) & 1 == 1
    sizes = np.unique(np.geomspace(first + 1, max(most, first + 1), 12).astype(int))
    return np.concatenate([subsets, rank < sizes[sizes <= most, None]])


def _distance(residuals: Array) -> Array:
    """Return each run's distance from the median of the runs just before; the first is infinite."""
    padded = np.pad(residuals[:-1], (NEIGHBOURS, 0), constant_values=np.nan)
    before = np.lib.stride_tricks.sliding_window_view(padded, NEIGHBOURS)
    return np.asarray(np.abs(residuals - np.append(np.inf, np.nanmedian(before[1:], axis=1))))


def _moments(series: _Series) -> tuple[Array, Array, Array]:
    """Return log evidence, mean and variance of the size of a change before each run, `(n, R - 1)`.

    The evidence includes `log_prior` and the moment's prior, which is zero between equal times.
    """
    base = _fit(series.y, series.h, series.variance, series.prior_sd)
    weights = 1.0 / series.variance

    def sums(values: Array) -> Array:  # the column of a change is -1 in all runs before it
        return -np.cumsum(values, axis=1)[:, :-1]

    with_h = sums(weights[..., None] * series.h)
    explained = np.linalg.solve(base.precision[:, None], with_h[..., None])[..., 0]
    precision = -sums(weights) + SIZE**-2.0 - (with_h * explained).sum(axis=-1)
    moment = sums(weights * series.y) - (with_h * base.mean[:, None]).sum(axis=-1)
    log_bf = 0.5 * moment**2 / precision - 0.5 * np.log(SIZE**2 * precision)
    possible = np.diff(series.t) > 0
    log_bf = np.where(possible, log_bf - np.log(possible.sum()), -np.inf)
    return (
        log_bf + (base.log_evidence + series.log_prior)[:, None],
        moment / precision,
        1 / precision,
    )


def _find_changes(series: _Series, log_constant: float) -> tuple[float, list[int], list[float]]:
    """Add changes while a further change is probable.

    Returns the log evidence of at least one change, and first run and probability of each change.
    """
    runs: list[int] = []
    probabilities: list[float] = []
    log_changes, log_base = -np.inf, log_constant
    while len(runs) < min(MAX_CHANGES, len(series.t) // 3):
        log_p = _moments(series)[0]
        gain = _log_sum(log_p.ravel()) - log_base
        odds = gain + np.log(PRIOR_OF_ANOTHER / (1 - PRIOR_OF_ANOTHER))
        probability = float(scipy.special.expit(odds))
        if runs and probability < ANOTHER_PROBABILITY:
            break
        log_changes = (
            log_constant + gain if not runs else log_changes + gain + np.log(PRIOR_OF_ANOTHER)
        )
        probabilities.append(probability if runs else 1.0)
        runs.append(int(np.argmax(np.logaddexp.reduce(log_p, axis=0))) + 1)
        series = series.with_column(step(runs[-1], len(series.t)))
        log_base = _log_sum(
            _fit(series.y, series.h, series.variance, series.prior_sd).log_evidence
            + series.log_prior
        )
    return log_changes, runs, probabilities


def _change(series: _Series, runs: list[int], k: int, probability: float) -> LevelChange:
    """Describe change `k` by the posterior of its moment and size, given the other moments."""
    for other in runs[:k] + runs[k + 1 :]:
        series = series.with_column(step(other, len(series.t)))
    log_p, size, variance = _moments(series)
    weights = _normalised(log_p)
    moments = np.cumsum(weights.sum(axis=0))
    run = int(np.argmax(weights.sum(axis=0))) + 1
    first, last = np.searchsorted(moments, [0.05, 0.95]) + 1
    mean, sd = _mixture(weights, size, variance)
    return LevelChange(
        run=run,
        first=int(first),
        last=int(last),
        time=float(series.t[run]),
        size=mean,
        size_sd=sd,
        probability=probability,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Walk:
    """A random walk has log evidence plus log prior `(n WALKS,)`, a mean q, and levels `(R,)`."""

    log_evidence: Array
    scale: float
    level: Array
    level_sd: Array


def _walk(series: _Series) -> _Walk:
    """Compute the evidence of a walk by a Kalman filter, and the level of the walk by smoothing."""
    scales = SIZE * np.geomspace(0.03, 3.0, WALKS)
    log_prior = _log_normalised(np.log(scales) - 0.5 * (scales / SIZE) ** 2)  # half-normal
    shape = (len(series.variance), WALKS)
    log_prior = (series.log_prior[:, None] + log_prior).ravel()
    steps = np.diff(ramp(series.t), append=0.0)[:, None] * np.tile(scales**2, shape[0])
    variance = np.repeat(series.variance, WALKS, axis=0).T
    innovations, total, _, _ = _filter(np.column_stack([series.y, series.h]), variance, steps, 0.0)
    columns = np.moveaxis(innovations, 0, 1)
    fit = _fit(columns[..., 0], columns[..., 1:], total.T, series.prior_sd)
    weights = _normalised(fit.log_evidence + log_prior)
    effect = series.h @ (weights @ fit.mean)
    y = series.y - effect + effect.mean()
    _, _, mean, spread = _filter(y[:, None], variance, steps, REGRESSOR_SD**2)
    mean = mean[..., 0]
    for i in range(len(y) - 2, -1, -1):  # Rauch, Tung and Striebel (1965)
        gain = spread[i] / (spread[i] + steps[i])
        mean[i] += gain * (mean[i + 1] - mean[i])
        spread[i] += gain**2 * (spread[i + 1] - spread[i] - steps[i])
    level = mean @ weights
    variance = (spread + (mean - level[:, None]) ** 2) @ weights
    return _Walk(
        log_evidence=fit.log_evidence + log_prior,
        scale=float(weights @ np.tile(scales, shape[0])),
        level=level,
        level_sd=np.sqrt(variance),
    )


def _filter(
    columns: Array, variance: Array, step: Array, start: float
) -> tuple[Array, Array, Array, Array]:
    """Run the Kalman filter of a level over `columns (R, c)` at each of G pairs of s and q.

    `variance (R, G)` is the variance of errors, `step (R, G)` the variance that the walk gains
    after each run, and `start` the variance of the first level.  Returns innovations `(R, G, c)`,
    their variances `(R, G)`, filtered levels `(R, G, c)`, and the variances of levels `(R, G)`.
    """
    n_runs, n_pairs = variance.shape
    innovations = np.empty((n_runs, n_pairs, columns.shape[1]))
    levels, total, spread = (
        np.empty_like(innovations),
        np.empty_like(variance),
        np.empty_like(variance),
    )
    level, p = np.zeros(innovations.shape[1:]), np.full(n_pairs, start)
    for i in range(n_runs):
        innovations[i], total[i] = columns[i] - level, p + variance[i]
        gain = p / total[i]
        level = level + gain[:, None] * innovations[i]
        p = p * variance[i] / total[i]
        levels[i], spread[i] = level, p
        p = p + step[i]
    return innovations, total, levels, spread


def _log_sum(logs: Array) -> float:
    """Return the logarithm of the sum of numbers with these logarithms."""
    return float(np.logaddexp.reduce(logs))


def _log_normalised(logs: Array) -> Array:
    """Return the logs of numbers that are scaled to the sum 1."""
    return np.asarray(logs - _log_sum(logs.ravel()))


def _normalised(logs: Array) -> Array:
    """Return numbers proportional to exp(logs), with the sum 1."""
    return np.asarray(np.exp(_log_normalised(logs)))


def _mixture(weights: Array, means: Array, variances: Array) -> tuple[float, float]:
    """Return mean and standard deviation of a mixture of normal distributions."""
    mean = float((weights * means).sum())
    return mean, float(np.sqrt((weights * (variances + (means - mean) ** 2)).sum()))
