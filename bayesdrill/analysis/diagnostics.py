"""Diagnose the draws of each unknown, its dependence on priors, and the ensembles' agreement.

If all ensembles draw from one distribution, the ranks of each ensemble's draws among all draws are
uniform (Vehtari et al. 2021; Saeilynoja, Buerkner and Vehtari 2022; ArviZ plots them).  The limits of
chance come from random tables (a row for each ensemble, a column for each bin) with equal totals.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bayesdrill.analysis.identifiability.structure import Exponents
from bayesdrill.basics.arrays import Array, Counts
from bayesdrill.inference import laplace
from bayesdrill.inference.derived import estimate, product_name
from bayesdrill.inference.posterior import Posterior, Problem
from bayesdrill.inference.priors import Prior, prior_sd
from bayesdrill.sampling.convergence import Convergence, thinned
from bayesdrill.sampling.mode_search import Mode

Word = Literal["determined", "weak", "through others", "prior only"]

# An unknown is "prior only" if shrinkage and Kolmogorov distance to the prior are below these limits.
PRIOR_ONLY_SHRINKAGE = 0.1
PRIOR_ONLY_DISTANCE = 0.1
DETERMINED_SHRINKAGE = 0.5  # an unknown with more shrinkage is determined


@dataclass(frozen=True, slots=True, kw_only=True)
class ParameterRow:
    """A row of the summary table describes one unknown, in SI.

    `deviation` is mean / nominal - 1, or None without a nominal value.  `shrinkage` is 1 - sd / (sd of
    the prior).  `pressed_against` is the end of the prior at which draws accumulate, or None.
    """

    name: str
    unit: str
    nominal: float | None
    map: float
    mean: float
    sd: float
    hdi_low: float
    hdi_high: float
    deviation: float | None
    r_hat: float
    ess_bulk: float
    ess_tail: float
    shrinkage: float
    word: Word
    pressed_against: float | None


def summarise(
    problem: Problem, draws: Array, mode: Mode, convergence: Convergence
) -> tuple[ParameterRow, ...]:
    """Return a row for each unknown, from nearly independent physical draws `(E, N, D)`."""
    rows = []
    for d, symbol in enumerate(problem.symbols):
        x = draws[..., d].ravel()
        nominal = problem.nominal.get(symbol.name)
        of_draws = estimate(x, nominal)
        prior = problem.posterior.space.priors[symbol.name]
        shrinkage = 1.0 - of_draws["sd"] / prior_sd(prior)
        rows.append(
            ParameterRow(
                name=symbol.name,
                unit=symbol.unit,
                nominal=nominal,
                map=mode.values[symbol.name],
                r_hat=float(convergence.r_hat[d]),
                ess_bulk=float(convergence.ess_bulk[d]),
                ess_tail=float(convergence.ess_tail[d]),
                shrinkage=shrinkage,
                word=_identification(shrinkage, distance_to_prior(x, prior)),
                pressed_against=pressed_against(x, prior),
                **of_draws,
            )
        )
    return tuple(rows)


def distance_to_prior(x: Array, prior: Prior) -> float:
    """Return the Kolmogorov distance between draws `(N,)` and the prior."""
    probabilities = np.linspace(0.0, 1.0, 201)[1:-1]
    below = np.searchsorted(np.sort(x), prior.quantile(probabilities)) / len(x)
    return float(np.max(np.abs(below - probabilities)))


def _identification(shrinkage: float, distance: float) -> Word:
    if shrinkage < PRIOR_ONLY_SHRINKAGE and distance < PRIOR_ONLY_DISTANCE:
        return "prior only"
    return "determined" if shrinkage > DETERMINED_SHRINKAGE else "weak"


END_MASS = 0.05  # prior mass next to an end; draws accumulate there if half of them are in it
MIN_SHARE_NEAR_END = 0.25  # a flat density has this fraction nearer to the end than to the median
NEAR_END_MASS = 0.05  # a nominal value is near an end if less prior mass lies between the two
THREE_SIGMA_TAIL, TWO_SIGMA_TAIL = 1e-3, 2.28e-2  # normal tail masses beyond three and two sigma


def pressed_against(x: Array, prior: Prior) -> float | None:
    """Return the end of `prior` at which draws `(N,)` accumulate, or None.

    Half of the draws lie in the last `END_MASS` of the prior's mass, and their density rises towards
    the end, both along x and relative to the prior.  A corner of the priors' box does not suffice: if
    nine parameters share a scale, the density rises as x^8, and 37 % of draws are in the last 5 %.
    """
    if prior.vanishes_at_ends:
        return None
    middle = float(np.median(x))
    for end, sign in ((prior.low, 1.0), (prior.high, -1.0)):
        if not math.isfinite(end):
            continue

        def at(mass: float, sign: float = sign) -> float:
            """Return the point with this prior mass between it and the end."""
            return float(prior.quantile(np.array(mass if sign > 0 else 1.0 - mass)))

        if sign * (middle - at(END_MASS)) > 0:
            continue
        halves = (0.5 * (end + middle), at(0.5 * _mass_between(at, middle, sign)))
        if all(np.mean(sign * (half - x) > 0) > MIN_SHARE_NEAR_END for half in halves):
            return end
    return None


def _mass_between(at: Callable[[float], float], x: float, sign: float) -> float:
    """Return the prior mass between the end and `x`, by bisection in the log of the mass."""
    low, high = -40.0, 0.0
    for _ in range(60):
        mid = 0.5 * (low + high)
        low, high = (mid, high) if sign * (at(math.exp(mid)) - x) < 0 else (low, mid)
    return math.exp(high)


def end_at_nominal(x: Array, prior: Prior, nominal: float) -> float | None:
    """Return the end of `prior` that keeps draws `(N,)` from passing the nominal value, or None.

    The nominal value is at or beyond this end, or so near that the end cuts off a tail of the draws.
    """
    for end, sign in ((prior.low, 1.0), (prior.high, -1.0)):
        if not 0 < end < math.inf:
            continue
        if sign * (nominal - end) <= 0:
            return end
        probability = NEAR_END_MASS if sign > 0 else 1.0 - NEAR_END_MASS
        is_near = sign * (nominal - float(prior.quantile(np.array(probability)))) <= 0
        if is_near:
            tails = np.quantile(sign * np.log(x), [THREE_SIGMA_TAIL, TWO_SIGMA_TAIL])
            if tails[0] - sign * math.log(end) < tails[1] - tails[0]:
                return end
    return None


MIN_EXPLAINED = 0.8  # smallest fraction of an unknown's rank variance that others have to explain
MIN_SLOPE = 0.3  # standardised regression coefficient above which another unknown is named
MAX_DRAWS = 4000  # draws are thinned to about this number


def prior_dependence(rows: Sequence[ParameterRow], draws: Array) -> Mapping[str, tuple[str, ...]]:
    """Map each unknown that is determined only through priors of other unknowns to these others.

    `draws (N, D)` are in the order of `rows`. Ranks are regressed, not values, as ridges may be curved.
    """
    alone = [d for d, row in enumerate(rows) if row.word == "prior only"]
    if not alone:
        return {}
    from scipy.stats import rankdata  # imported here, as loading takes half a second

    ranks = rankdata(draws[:: max(1, len(draws) // MAX_DRAWS)], axis=0)
    z = (ranks - ranks.mean(axis=0)) / np.maximum(ranks.std(axis=0), 1e-300)
    dependence = {}
    for d, row in enumerate(rows):
        if row.word != "determined":
            continue
        slopes, *_ = np.linalg.lstsq(z[:, alone], z[:, d])
        if 1 - np.mean((z[:, d] - z[:, alone] @ slopes) ** 2) >= MIN_EXPLAINED:
            steep = (k for k, slope in zip(alone, slopes, strict=True) if abs(slope) > MIN_SLOPE)
            dependence[row.name] = tuple(rows[k].name for k in steep)
    return dependence


RANK_BINS = 50
RANDOM_TABLES, TABLES_PER_BLOCK = 20_000, 2_000  # simulated tables, and tables in memory at a time
FALSE_ALARM = 0.01  # probability that a sound run leaves the band anywhere
TAUS_BETWEEN_DRAWS = 2  # autocorrelation times between two draws that count as independent


@dataclass(frozen=True, slots=True, kw_only=True)
class RankHistogram:
    """A histogram has `counts (E, B)` of the ranks of each ensemble's draws among all draws.

    Chance explains deviations of cumulative counts from expectation up to `half_width (B - 1,)`.
    """

    counts: Counts
    half_width: Array

    @property
    def draws(self) -> int:
        """Return the number of draws of each ensemble."""
        return int(self.counts[0].sum())

    @property
    def deviation(self) -> Array:
        """Return cumulative counts minus their expectation, `(E, RANK_BINS - 1)`."""
        return np.cumsum(self.counts, axis=1)[:, :-1] - self.draws * SHARES

    @property
    def is_consistent(self) -> NDArray[np.bool_]:
        """Return whether chance explains the ranks of each ensemble, `(E,)`."""
        return np.asarray(np.all(np.abs(self.deviation) <= self.half_width, axis=1))


SHARES = np.arange(1, RANK_BINS) / RANK_BINS


def independent_draws(theta: Array, burn_in: int, tau: float) -> Array:
    """Thin chains `(E, S, W, D)` to nearly independent draws `(E, N, D)`."""
    steps = theta.shape[1] - burn_in
    return thinned(theta, burn_in, max(1, min(math.ceil(TAUS_BETWEEN_DRAWS * tau), steps // 2)))


def rank_histograms(draws: Array, rng: np.random.Generator) -> tuple[RankHistogram, ...]:
    """Return a histogram for each unknown, of independent draws `(E, N, D)` of several ensembles."""
    from arviz_stats.base import array_stats  # imported here, as loading takes half a second

    n_ensembles, n, n_unknown = draws.shape
    half_width, histograms = _chance_widths(n_ensembles, n, FALSE_ALARM / n_unknown, rng), []
    for d in range(n_unknown):
        rank = array_stats.compute_ranks(draws[..., d], axis=None)  # type: ignore[no-untyped-call]
        bins = np.ceil(RANK_BINS * rank / (n_ensembles * n)).astype(np.int64) - 1
        counts = np.stack([np.bincount(row, minlength=RANK_BINS) for row in bins])
        histograms.append(RankHistogram(counts=counts, half_width=half_width))
    return tuple(histograms)


def _chance_widths(n_ensembles: int, n: int, false_alarm: float, rng: np.random.Generator) -> Array:
    """Return half-widths of a band; some ensemble leaves it with probability `false_alarm`."""
    from scipy.stats import random_table

    total = n_ensembles * n
    ends = np.floor(np.arange(RANK_BINS + 1) * total / RANK_BINS).astype(np.int64)
    spread = np.sqrt(n * SHARES * (1.0 - SHARES) * (total - n) / (total - 1))
    table = random_table(np.diff(ends), np.full(n_ensembles, n))
    farthest = []
    for _ in range(RANDOM_TABLES // TABLES_PER_BLOCK):
        counts = np.cumsum(table.rvs(TABLES_PER_BLOCK, random_state=rng), axis=1)[:, :-1]
        deviations = np.abs(counts - (n * SHARES)[:, None]) / spread[:, None]
        farthest.append(deviations.max(axis=(1, 2)))
    return np.asarray(spread * np.quantile(np.concatenate(farthest), 1.0 - false_alarm))


def sandwich_sds(
    posterior: Posterior, theta: Array, products: Sequence[Exponents] = ()
) -> dict[str, float]:
    """Return the sds of the unknowns by `laplace.sandwich`, in the units of `theta (D,)`.

    Entries for `products` of powers of the first unknowns follow, named like derived quantities.
    """
    covariance, names = laplace.sandwich(posterior, theta), posterior.space.free
    natural = posterior.coordinates.natural(theta[None])[0]
    sds = dict(zip(names, (np.sqrt(np.diag(covariance)) * natural).tolist(), strict=True))
    for exponents in products:
        used = np.flatnonzero(exponents)
        powers = np.array(exponents, dtype=float)[used]
        along = powers * natural[used] / theta[used]
        sd = math.sqrt(along @ covariance[np.ix_(used, used)] @ along)
        sds[product_name(names, exponents)] = sd * float(np.prod(theta[used] ** powers))
    return sds
