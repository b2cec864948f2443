"""Calibrate a posterior by simulation: refit many simulated records, and rank the truth.

With the right posterior the rank of a true value among L draws is uniform on 0 ... L (Talts et al.
2018).  The band for the empirical distribution function of N ranks is that of Saeilynoja, Buerkner
and Vehtari (2022): pointwise binomial intervals of one level, chosen so that the whole function
stays inside with the wanted probability, which their recursion gives exactly.

`refit` is a function of the study and the index alone: it can run anywhere, and run again.

The verdict on all ranks is wrong with at most `FALSE_ALARM` where the posterior is right.  Half of
that chance goes to the rank bands, shared equally by the quantities, and half to the credible
intervals, shared equally by unknowns and levels: a union bound, as the ranks of one refit depend on
each other.
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
from bayesdrill.inference.posterior import Posterior
from bayesdrill.sampling.fit import FitPlan, fit

NAMED_SHIFT_SDS = 3.0  # standard errors from which a shift or a spread of the ranks is named


def rank(truth: float, draws: Array, rng: np.random.Generator) -> int:
    """Count the `draws (L,)` below `truth`, 0 to L; ties are broken at random."""
    below, equal = int((draws < truth).sum()), int((draws == truth).sum())
    return below + int(rng.integers(equal + 1))


def shape(ranks: Counts, n_draws: int, *, of_fit: bool = False) -> str | None:
    """Name what is wrong with a posterior whose `ranks (N,)` are not uniform; None where unclear.

    By the mean and the spread of the ranks: a shift spreads them too, to one end alone.  `of_fit`:
    those of the log likelihood, of which only too much or too little can be said: draws that crowd
    around the best fit all fit the record better than the truth does.
    """
    u = (ranks + 0.5) / (n_draws + 1) - 0.5
    n = len(u)
    moved = float(u.mean()) * np.sqrt(12.0 * n)
    if of_fit:
        if abs(moved) < NAMED_SHIFT_SDS:
            return None
        return "posterior too wide" if moved > 0 else "posterior too narrow"
    spread = (float((u**2).mean()) - 1.0 / 12.0) * np.sqrt(180.0 * n)
    if max(abs(moved), abs(spread)) < NAMED_SHIFT_SDS:
        return None
    if abs(moved) >= max(NAMED_SHIFT_SDS, 0.5 * abs(spread)):
        return "posterior too low" if moved > 0 else "posterior too high"
    return "posterior too narrow" if spread > 0 else "posterior too wide"


LEVEL_BISECTIONS = 40  # of the interval in which the pointwise level is sought


@dataclass(frozen=True, slots=True, kw_only=True)
class RankBand:
    """A band of counts, `low` to `high (L,)`, of `n` uniform ranks below each of the `shares (L,)`.

    `false_alarm`: the exact probability that uniform ranks leave it somewhere.
    """

    n: int
    shares: Array
    low: Counts
    high: Counts
    false_alarm: float

    def counts(self, ranks: Counts) -> Counts:
        """Count the `ranks (n,)` below each share: `(L,)`."""
        n_draws = len(self.shares)
        return np.cumsum(np.bincount(ranks, minlength=n_draws + 1))[:n_draws]

    def reach(self, ranks: Counts) -> float:
        """Return the farthest departure from uniform, in half-widths: above 1 is outside."""
        expected = self.n * self.shares
        away = self.counts(ranks) - expected
        room = np.where(away > 0, self.high, self.low) - expected
        open_ended = np.where(away > 0, self.high == self.n, self.low == 0)  # none can be outside
        room = np.where(room == 0.0, np.copysign(0.5, away), room)
        return float(np.max(away / room, where=~open_ended, initial=0.0))

    def holds(self, ranks: Counts) -> bool:
        """Return whether all `ranks (n,)` stay inside."""
        counts = self.counts(ranks)
        return bool(np.all((counts >= self.low) & (counts <= self.high)))


@functools.cache
def ecdf_band(n: int, n_draws: int, false_alarm: float) -> RankBand:
    """Return the narrowest band that `n` uniform ranks leave with at most `false_alarm`."""
    shares = np.arange(1, n_draws + 1) / (n_draws + 1)
    table = scipy.special.bdtr(np.arange(n + 1)[:, None], n, shares)  # (n + 1, L): P(count <= row)
    inside, outside = 0.0, 1.0  # levels: at the first the band holds often enough
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
def count_band(n: int, share: float, false_alarm: float) -> tuple[int, int]:
    """Return the expected counts of `n` independent events of probability `share`, ends included."""
    table = scipy.special.bdtr(np.arange(n + 1)[:, None], n, np.array([share]))
    low, high = _pointwise(table, false_alarm)
    return int(low[0]), int(high[0])


def _pointwise(table: Array, level: float) -> tuple[Counts, Counts]:
    """Binomial intervals that leave at most `level / 2` out on either side."""
    low = (table <= 0.5 * level).sum(axis=0)
    high = (table < 1.0 - 0.5 * level).sum(axis=0)
    return low, np.minimum(high, len(table) - 1)


def _stay_probability(n: int, shares: Array, low: Counts, high: Counts) -> float:
    """The probability that the counts of `n` uniforms stay between `low` and `high` at all shares.

    A Markov chain: of those still above one share, each is below the next one independently.
    """
    log_factorial = scipy.special.gammaln(np.arange(n + 1) + 1.0)
    have, probability, before = np.array([0]), np.array([1.0]), 0.0
    for share, first, last in zip(shares, low, high, strict=True):
        if last < first:
            return 0.0
        p = (share - before) / (1.0 - before)
        now = np.arange(first, last + 1)
        more = now[None, :] - have[:, None]
        remaining = n - have[:, None]
        new = np.maximum(more, 0)
        log_p = (
            log_factorial[remaining]
            - log_factorial[new]
            - log_factorial[remaining - np.minimum(new, remaining)]
            + new * np.log(p)
            + (remaining - new) * np.log1p(-p)
        )
        probability = probability @ np.where(more >= 0, np.exp(log_p), 0.0)
        have, before = now, share
    return float(probability.sum())


LOG_LIKELIHOOD = "log likelihood"  # the quantity that depends on the record (Modrak et al. 2023)
MAX_PRIOR_TRIES = 1000  # draws from the prior until the model has a finite response


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationStudy:
    """A study that is repeated: `posterior` without its record, its fit, and L `draws` to rank in."""

    posterior: Posterior
    plan: FitPlan
    draws: int

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the quantities that are ranked."""
        return (*self.posterior.space.free, LOG_LIKELIHOOD)


@dataclass(frozen=True, slots=True, kw_only=True)
class Refit:
    """One refit, `truth` and `ranks` in the order of `CalibrationStudy.names`; no ranks of no draws."""

    index: int
    truth: tuple[float, ...]
    ranks: tuple[int, ...]
    r_hat: float
    ess: float
    steps: int
    reasons: tuple[str, ...]
    seconds: float = field(compare=False)  # that it took: no part of the result

    @property
    def converged(self) -> bool:
        """Whether the refit met its targets."""
        return not self.reasons


def refit(study: CalibrationStudy, index: int) -> Refit:
    """Refit record `index`, counted from 0; the truth makes the record and is ranked."""
    begun = time.perf_counter()
    rng = seeds.stream(study.plan.chains.seed, "calibrate", index)
    theta, posterior = _simulated(study.posterior, rng)
    seed = int(rng.integers(2**32))
    truth = np.array([*theta, posterior.likelihood(theta[None])[0]])
    chains = dataclasses.replace(study.plan.chains, seed=seed)
    ranks: tuple[int, ...] = ()
    r_hat, ess, steps = np.inf, 0.0, 0
    try:
        _, sampled = fit(posterior, dataclasses.replace(study.plan, chains=chains))
    except ValueError as error:  # numbers fail far from any reasonable record
        reasons: tuple[str, ...] = (f"nothing could be sampled: {error}",)
    else:
        # Among L of the nearly independent draws, picked at random.
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
    """Unknowns `(D,)` from the prior, and the posterior of a record that they made."""
    likelihood = posterior.likelihood
    for _ in range(MAX_PRIOR_TRIES):
        theta = posterior.space.draw(1, rng)
        signals = likelihood.all_signals(theta)
        # Where the model overflows the posterior is zero: such unknowns are no part of the prior.
        if all(np.all(np.isfinite(each)) for each in signals):
            pairs = zip(likelihood.observations, signals, strict=True)
            records = [observation.draw(each, theta, rng)[0] for observation, each in pairs]
            return theta[0], posterior.edit(records=records)
    tries = f"{MAX_PRIOR_TRIES} draws from the priors"
    raise InputError.at("parameters", f"the model has no finite response at {tries}; narrow them")


FALSE_ALARM = 0.01  # of the whole verdict
LEVELS = (0.5, 0.8, 0.94)  # of the credible intervals
MAX_NOT_CONVERGED = 0.05  # of the refits; with more there is no verdict


@dataclass(frozen=True, slots=True, kw_only=True)
class IntervalCoverage:
    """The coverage of the central interval of probability `share`; `low` to `high` is chance."""

    share: float
    inside: int
    low: int
    high: int

    @property
    def holds(self) -> bool:
        """Whether chance explains the coverage."""
        return self.low <= self.inside <= self.high


@dataclass(frozen=True, slots=True, kw_only=True)
class RankedQuantity:
    """One unknown, or the log likelihood (without `intervals`); `shape`: what is wrong, if known."""

    name: str
    ranks: Counts
    reach: float
    holds: bool
    shape: str | None
    intervals: tuple[IntervalCoverage, ...]


@dataclass(frozen=True, kw_only=True)
class CalibrationVerdict:
    """The verdict; `not_converged`: refits that missed their targets, `lost`: those without ranks."""

    n_draws: int
    band: RankBand
    quantities: tuple[RankedQuantity, ...]
    refits: int
    not_converged: tuple[int, ...]
    lost: tuple[int, ...]

    @property
    def calibrated(self) -> bool:
        """Whether nothing speaks against the posterior."""
        return not self.faults and not self.doubts

    @cached_property
    def faults(self) -> tuple[str, ...]:
        """Faults that chance does not explain, worst first."""
        faults = []
        for quantity in sorted(self.quantities, key=lambda q: -q.reach):
            if not quantity.holds:
                why = f" ({quantity.shape})" if quantity.shape else ""
                faults.append(f"ranks of {quantity.name} leave the band{why}")
        faults += [
            f"{100 * interval.share:.3g} % intervals of {quantity.name} hold the truth in "
            f"{100 * interval.inside / self.band.n:.0f} % of the refits"
            for quantity in self.quantities
            for interval in quantity.intervals
            if not interval.holds
        ]
        return tuple(faults)

    @cached_property
    def doubts(self) -> tuple[str, ...]:
        """Reasons why nothing can be said, however good the ranks look."""
        doubts = []
        if len(self.not_converged) > MAX_NOT_CONVERGED * self.refits:
            doubts.append(
                f"{len(self.not_converged)} of {self.refits} refits did not converge (at most "
                f"{100 * MAX_NOT_CONVERGED:g} % may)"
            )
        if self.lost:
            doubts.append(f"{len(self.lost)} of {self.refits} refits gave no draws at all")
        return tuple(doubts)


def judge_calibration(
    names: Sequence[str], refits: Sequence[Refit], n_draws: int
) -> CalibrationVerdict:
    """Judge the ranks of all `refits`, by index, of quantities `names`, the log likelihood last."""
    ranked = [refit for refit in refits if refit.ranks]
    table = np.array([refit.ranks for refit in ranked], dtype=np.int64).reshape(-1, len(names))
    band = ecdf_band(len(ranked), n_draws, 0.5 * FALSE_ALARM / len(names))
    n_unknown = len(names) - 1

    def judged(name: str, ranks: Counts, *, unknown: bool) -> RankedQuantity:
        holds = band.holds(ranks)
        return RankedQuantity(
            name=name,
            ranks=ranks,
            reach=band.reach(ranks),
            holds=holds,
            shape=shape(ranks, n_draws, of_fit=not unknown) if len(ranks) and not holds else None,
            intervals=_intervals(ranks, n_draws, n_unknown) if unknown else (),
        )

    return CalibrationVerdict(
        n_draws=n_draws,
        band=band,
        quantities=tuple(
            judged(name, table[:, k], unknown=k < n_unknown) for k, name in enumerate(names)
        ),
        refits=len(refits),
        not_converged=tuple(refit.index for refit in refits if not refit.converged),
        lost=tuple(refit.index for refit in refits if not refit.ranks),
    )


def _intervals(ranks: Counts, n_draws: int, n_unknown: int) -> tuple[IntervalCoverage, ...]:
    """Between two of the sorted draws, so that their probability is exact: 25/100 ... 75/100."""
    intervals = []
    for level in LEVELS:
        out = math.floor(0.5 * (1.0 - level) * (n_draws + 1) + 0.5)
        share = 1.0 - 2 * out / (n_draws + 1)
        inside = int(((ranks >= out) & (ranks <= n_draws - out)).sum())
        alarm = 0.5 * FALSE_ALARM / (n_unknown * len(LEVELS))
        low, high = count_band(len(ranks), share, alarm)
        intervals.append(IntervalCoverage(share=share, inside=inside, low=low, high=high))
    return tuple(intervals)
