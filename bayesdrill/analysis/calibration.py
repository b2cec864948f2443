"""Calibrate a posterior by simulation: refit many simulated records, and rank the truth.

If the posterior is right, the rank of a true value among L draws is uniform on 0 ... L (Talts et
al. 2018).  The band for the empirical distribution function of N ranks is that of Saeilynoja,
Buerkner and Vehtari (2022).  The band consists of pointwise binomial intervals of equal level.  A
recursion gives the exact probability that the whole function stays inside the band.

`refit` depends only on the study and the index, so refits can run in any process.

If the posterior is right, the verdict on all ranks is wrong with probability `FALSE_ALARM` at most.
Half of this probability is divided equally among the rank bands of all quantities.  The other half
is divided among the credible intervals of all unknowns (a union bound, as ranks are correlated).
"""

from __future__ import annotations

import dataclasses
import functools
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import scipy

from bayesdrill.basics import seeds
from bayesdrill.basics.arrays import Array, Counts
from bayesdrill.basics.errors import InputError
from bayesdrill.basics.findings import Finding
from bayesdrill.inference.posterior import Posterior
from bayesdrill.sampling.fit import FitPlan, fit

NAMED_SHIFT_SDS = 3.0  # smallest shift or excess spread of ranks that is named, in standard errors


def rank(truth: float, draws: Array, rng: np.random.Generator) -> int:
    """Count the `draws (L,)` below `truth`, 0 to L; ties are broken at random."""
    below, equal = int((draws < truth).sum()), int((draws == truth).sum())
    return below + int(rng.integers(equal + 1))


def shape(ranks: Counts, n_draws: int, *, of_fit: bool = False) -> str | None:
    """Name what is wrong with a posterior whose `ranks (N,)` are not uniform; None if unclear.

    Mean and spread of the ranks decide.  A shift alone increases the spread, too, but only at one
    end.  With `of_fit`, the ranks are those of the log likelihood: if draws are too narrow about
    the best fit, they all fit the record better than the truth does.
    """
    u = (ranks + 0.5) / (n_draws + 1) - 0.5
    n = len(u)
    shift = float(u.mean()) * np.sqrt(12.0 * n)
    if of_fit:
        if abs(shift) < NAMED_SHIFT_SDS:
            return None
        return "posterior too wide" if shift > 0 else "posterior too narrow"
    spread = (float((u**2).mean()) - 1.0 / 12.0) * np.sqrt(180.0 * n)
    if max(abs(shift), abs(spread)) < NAMED_SHIFT_SDS:
        return None
    if abs(shift) >= max(NAMED_SHIFT_SDS, 0.5 * abs(spread)):
        return "posterior too low" if shift > 0 else "posterior too high"
    return "posterior too narrow" if spread > 0 else "posterior too wide"


LEVEL_BISECTIONS = 40  # number of bisections for the level of the pointwise intervals


@dataclass(frozen=True, slots=True, kw_only=True)
class RankBand:
    """A band limits how many of `n` ranks are below each fraction `shares (L,)` of their range.

    Counts of uniform ranks are all between `low` and `high (L,)` with probability 1 - `false_alarm`.
    """

    n: int
    shares: Array
    low: Counts
    high: Counts
    false_alarm: float

    def count_below(self, ranks: Counts) -> Counts:
        """Count the `ranks (n,)` below each of `shares`, `(L,)`."""
        n_draws = len(self.shares)
        return np.cumsum(np.bincount(ranks, minlength=n_draws + 1))[:n_draws]

    def max_deviation(self, ranks: Counts) -> float:
        """Return the largest deviation from uniform ranks, divided by the half-width of the band."""
        expected = self.n * self.shares
        deviation = self.count_below(ranks) - expected
        width = np.where(deviation > 0, self.high, self.low) - expected
        # A limit at 0 or n cannot be exceeded.
        open_ended = np.where(deviation > 0, self.high == self.n, self.low == 0)
        width = np.where(width == 0.0, np.copysign(0.5, deviation), width)
        return float(np.max(deviation / width, where=~open_ended, initial=0.0))

    def contains(self, ranks: Counts) -> bool:
        """Return whether the counts of `ranks (n,)` stay inside the band."""
        return self.max_deviation(ranks) <= 1.0


@functools.cache
def ecdf_band(n: int, n_draws: int, false_alarm: float) -> RankBand:
    """Return the narrowest band that `n` uniform ranks leave with probability <= `false_alarm`."""
    shares = np.arange(1, n_draws + 1) / (n_draws + 1)
    table = scipy.special.bdtr(np.arange(n + 1)[:, None], n, shares)  # (n + 1, L): P(count <= row)
    inside, outside = 0.0, 1.0  # levels of bands that are wide enough, and too narrow
    low, high = _pointwise(table, inside)
    for _ in range(LEVEL_BISECTIONS):
        level = 0.5 * (inside + outside) if inside > 0 else 0.1 * outside
        tried = _pointwise(table, level)
        if _stay_probability(n, shares, *tried) >= 1.0 - false_alarm:
            inside, (low, high) = level, tried
        else:
            outside = level
    probability = _stay_probability(n, shares, low, high)
    return RankBand(n=n, shares=shares, low=low, high=high, false_alarm=1.0 - probability)


@functools.cache
def count_band(n: int, probability: float, false_alarm: float) -> tuple[int, int]:
    """Return limits for the count of `n` independent events with this `probability`.

    Counts are outside these limits with a probability of at most `false_alarm`.
    """
    table = scipy.special.bdtr(np.arange(n + 1)[:, None], n, np.array([probability]))
    low, high = _pointwise(table, false_alarm)
    return int(low[0]), int(high[0])


def _pointwise(table: Array, level: float) -> tuple[Counts, Counts]:
    """Return binomial intervals; the tail on each side has a probability of at most `level / 2`."""
    low = (table <= 0.5 * level).sum(axis=0)
    high = (table < 1.0 - 0.5 * level).sum(axis=0)
    return low, np.minimum(high, len(table) - 1)


def _stay_probability(n: int, quantiles: Array, low: Counts, high: Counts) -> float:
    """Return the probability that counts of `n` uniforms are from `low` to `high` at all `quantiles`.

    Uniforms above quantile k are independently below quantile k + 1, so counts are a Markov chain.
    """
    log_factorial = scipy.special.gammaln(np.arange(n + 1) + 1.0)
    counts, probability, before = np.array([0]), np.array([1.0]), 0.0
    for quantile, first, last in zip(quantiles, low, high, strict=True):
        if last < first:
            return 0.0
        p = (quantile - before) / (1.0 - before)
        next_counts = np.arange(first, last + 1)
        steps = next_counts[None, :] - counts[:, None]
        remaining = n - counts[:, None]
        new = np.maximum(steps, 0)
        log_p = (
            log_factorial[remaining]
            - log_factorial[new]
            - log_factorial[remaining - np.minimum(new, remaining)]
            + new * np.log(p)
            + (remaining - new) * np.log1p(-p)
        )
        probability = probability @ np.where(steps >= 0, np.exp(log_p), 0.0)
        counts, before = next_counts, quantile
    return float(probability.sum())


LOG_LIKELIHOOD = "log likelihood"  # ranked too, as it depends on the record (Modrak et al. 2023)
MAX_PRIOR_TRIES = 1000  # largest number of draws from the prior until a response is finite


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationStudy:
    """A study refits simulated records by `plan`, and ranks each truth among `draws` draws."""

    posterior: Posterior
    plan: FitPlan
    draws: int

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the ranked quantities: unknowns and the log likelihood."""
        return (*self.posterior.space.free, LOG_LIKELIHOOD)


@dataclass(frozen=True, slots=True, kw_only=True)
class Refit:
    """A refit has `truth` and `ranks` by the study's `names`; without draws, `ranks` is empty."""

    index: int
    truth: tuple[float, ...]
    ranks: tuple[int, ...]
    r_hat: float
    ess: float
    steps: int
    reasons: tuple[Finding, ...]
    seconds: float = field(compare=False)  # duration, which differs between repetitions

    @property
    def converged(self) -> bool:
        """Return whether the refit met its convergence targets."""
        return not self.reasons


def refit(study: CalibrationStudy, index: int) -> Refit:
    """Simulate record `index`, counted from 0, refit it, and rank the truth."""
    begun = time.perf_counter()
    rng = seeds.stream(study.plan.chains.seed, "calibrate", index)
    theta, posterior = _simulated(study.posterior, rng)
    chains = dataclasses.replace(study.plan.chains, seed=int(rng.integers(2**32)))
    truth = np.array([*theta, posterior.likelihood(theta[None])[0]])
    ranks: tuple[int, ...] = ()
    r_hat, ess, steps = np.inf, 0.0, 0
    try:
        _, sampled = fit(posterior, dataclasses.replace(study.plan, chains=chains))
    except ValueError as error:  # the record may be so unreasonable that numbers overflow
        reasons: tuple[Finding, ...] = (Finding("nothing sampled", {"why": str(error)}),)
    else:
        # The truth is ranked among L of the nearly independent draws, selected at random.
        pool = sampled.draws.reshape(-1, len(theta))
        draws = pool[rng.choice(len(pool), study.draws, replace=len(pool) < study.draws)]
        values = np.column_stack([draws, posterior.likelihood(draws)])
        ranks = tuple(rank(x, column, rng) for x, column in zip(truth, values.T, strict=True))
        convergence = sampled.convergence
        r_hat, ess = float(convergence.r_hat.max()), float(convergence.ess_bulk.min())
        steps, reasons = convergence.steps, convergence.reasons
    return Refit(
        index=index,
        truth=tuple(map(float, truth)),
        ranks=ranks,
        r_hat=r_hat,
        ess=ess,
        steps=steps,
        reasons=reasons,
        seconds=time.perf_counter() - begun,
    )


def _simulated(posterior: Posterior, rng: np.random.Generator) -> tuple[Array, Posterior]:
    """Return unknowns `(D,)` from the prior, and the posterior of a record simulated with them."""
    likelihood = posterior.likelihood
    for _ in range(MAX_PRIOR_TRIES):
        theta = posterior.space.draw(1, rng)
        signals = likelihood.all_signals(theta)
        # The posterior is zero if the model overflows, so such unknowns are excluded from the prior.
        if all(np.all(np.isfinite(signal)) for signal in signals):
            pairs = zip(likelihood.observations, signals, strict=True)
            records = [observation.draw(signal, theta, rng)[0] for observation, signal in pairs]
            return theta[0], posterior.edit(records=records)
    tries = f"{MAX_PRIOR_TRIES} draws from the priors"
    raise InputError.at("parameters", f"the model has no finite response at {tries}; narrow them")


FALSE_ALARM = 0.01  # probability that the verdict finds a fault although the posterior is right
LEVELS = (0.5, 0.8, 0.94)  # probabilities of the credible intervals
MAX_NOT_CONVERGED = 0.05  # largest fraction of refits that may miss their convergence targets


@dataclass(frozen=True, slots=True, kw_only=True)
class IntervalCoverage:
    """Intervals of probability `share` contain `inside` true values; chance explains `low` to `high`."""

    share: float
    inside: int
    low: int
    high: int

    @property
    def is_consistent(self) -> bool:
        """Return whether chance explains the coverage."""
        return self.low <= self.inside <= self.high


@dataclass(frozen=True, slots=True, kw_only=True)
class RankedQuantity:
    """A ranked quantity is an unknown or the log likelihood; `shape` names its fault, if known."""

    name: str
    ranks: Counts
    reach: float
    holds: bool
    shape: str | None
    intervals: tuple[IntervalCoverage, ...]


@dataclass(frozen=True, kw_only=True)
class CalibrationVerdict:
    """The verdict has indices of refits that have `not_converged`, or have no ranks (`lost`)."""

    n_draws: int
    band: RankBand
    quantities: tuple[RankedQuantity, ...]
    refits: int
    not_converged: tuple[int, ...]
    lost: tuple[int, ...]

    @property
    def calibrated(self) -> bool:
        """Return whether there are no faults and no doubts."""
        return not self.faults and not self.doubts

    @cached_property
    def faults(self) -> tuple[Finding, ...]:
        """Return faults that chance does not explain, the worst first."""
        faults = [
            Finding("ranks outside the band", {"quantity": each.name, "shape": each.shape or ""})
            for each in sorted(self.quantities, key=lambda q: -q.reach)
            if not each.holds
        ]
        for quantity in self.quantities:
            for interval in (each for each in quantity.intervals if not each.is_consistent):
                inside = 100 * interval.inside / self.band.n
                numbers = {"percent": 100 * interval.share, "inside": inside}
                name = {"quantity": quantity.name}
                faults.append(Finding("intervals of a wrong share", name, numbers))
        return tuple(faults)

    @cached_property
    def doubts(self) -> tuple[Finding, ...]:
        """Return reasons to withhold the verdict even if all ranks look uniform."""
        doubts = []
        if len(self.not_converged) > MAX_NOT_CONVERGED * self.refits:
            numbers = {"count": len(self.not_converged), "refits": self.refits}
            most = {"most": 100 * MAX_NOT_CONVERGED}
            doubts.append(Finding("refits not converged", {}, numbers | most))
        if self.lost:
            numbers = {"count": len(self.lost), "refits": self.refits}
            doubts.append(Finding("refits without draws", {}, numbers))
        return tuple(doubts)


def judge_calibration(
    names: Sequence[str], refits: Sequence[Refit], n_draws: int
) -> CalibrationVerdict:
    """Judge the ranks of all `refits` for the quantities `names`; the last is the log likelihood."""
    ranked = [refit for refit in refits if refit.ranks]
    table = np.array([refit.ranks for refit in ranked], dtype=np.int64).reshape(-1, len(names))
    band = ecdf_band(len(ranked), n_draws, 0.5 * FALSE_ALARM / len(names))
    n_unknown, quantities = len(names) - 1, []
    for k, (name, ranks) in enumerate(zip(names, table.T, strict=True)):
        holds, unknown = band.contains(ranks), k < n_unknown
        quantity = RankedQuantity(
            name=name,
            ranks=ranks,
            reach=band.max_deviation(ranks),
            holds=holds,
            shape=shape(ranks, n_draws, of_fit=not unknown) if len(ranks) and not holds else None,
            intervals=_intervals(ranks, n_draws, n_unknown) if unknown else (),
        )
        quantities.append(quantity)
    return CalibrationVerdict(
        n_draws=n_draws,
        band=band,
        quantities=tuple(quantities),
        refits=len(refits),
        not_converged=tuple(refit.index for refit in refits if not refit.converged),
        lost=tuple(refit.index for refit in refits if not refit.ranks),
    )


def _intervals(ranks: Counts, n_draws: int, n_unknown: int) -> tuple[IntervalCoverage, ...]:
    """Return the coverage of intervals that end at sorted draws, so that they have exact levels."""
    intervals = []
    for level in LEVELS:
        out = math.floor(0.5 * (1.0 - level) * (n_draws + 1) + 0.5)
        share = 1.0 - 2 * out / (n_draws + 1)
        inside = int(((ranks >= out) & (ranks <= n_draws - out)).sum())
        alarm = 0.5 * FALSE_ALARM / (n_unknown * len(LEVELS))
        low, high = count_band(len(ranks), share, alarm)
        intervals.append(IntervalCoverage(share=share, inside=inside, low=low, high=high))
    return tuple(intervals)
