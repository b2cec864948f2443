"""Diagnose the draws of each unknown, its dependence on priors, and the ensembles' agreement.

If all ensembles draw from one distribution, the ranks of each are uniform, as ArviZ plots them
(Vehtari et al. 2021; Saeilynoja, Buerkner and Vehtari 2022).  Limits of chance are simulated by
random tables with the same totals of ensembles and bins.
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

# An unknown with less shrinkage, and a smaller distance to its prior, is not determined at all.
PRIOR_ONLY_SHRINKAGE = 0.1
PRIOR_ONLY_DISTANCE = 0.1
DETERMINED_SHRINKAGE = 0.5  # an unknown with more shrinkage is determined


@dataclass(frozen=True, slots=True, kw_only=True)
class ParameterRow:
    """A row of the summary table describes one unknown, SI.

    `deviation` is that of the mean from the nominal value, relative; both are None for noise levels.
    `shrinkage` is 1 - sd / sd of the prior.  Draws may accumulate at a prior's end `pressed_against`.
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
                word=_word(shrinkage, distance_to_prior(x, prior)),
                pressed_against=pressed_against(x, prior),
                **of_draws,
            )
        )
    return tuple(rows)


def distance_to_prior(x: Array, prior: Prior) -> float:
    """Return the Kolmogorov distance between draws `(N,)` and the prior."""
    shares = np.linspace(0.0, 1.0, 201)[1:-1]
    below = np.searchsorted(np.sort(x), prior.quantile(shares)) / len(x)
    return float(np.max(np.abs(below - shares)))


def _word(shrinkage: float, distance: float) -> Word:
    if shrinkage < PRIOR_ONLY_SHRINKAGE and distance < PRIOR_ONLY_DISTANCE:
        return "prior only"
    return "determined" if shrinkage > DETERMINED_SHRINKAGE else "weak"


END_MASS = 0.05  # mass of the prior next to its end in which half of the draws accumulate
MIN_SHARE_NEAR_END = 0.25  # share nearer to the end than half the median, at constant density
NEAR_END_MASS = 0.05  # a nominal value with less mass of the prior beyond it is near the end
THREE_SIGMA_TAIL, TWO_SIGMA_TAIL = 1e-3, 2.28e-2  # masses beyond three and two sigma of a normal


def pressed_against(x: Array, prior: Prior) -> float | None:
    """Return the end of `prior` at which draws `(N,)` accumulate, or None.

    Half of them lie in the last `END_MASS` of the prior's mass, and their density rises towards the
    end, both along x and relative to the prior.  Corners of a box of priors have less effect: if nine
    parameters share a scale, a marginal rises as its eighth power, and 37 % are in this part.
    """
    if prior.vanishes_at_ends:
        return None
    middle = float(np.median(x))
    for end, sign in ((prior.low, 1.0), (prior.high, -1.0)):
        if not math.isfinite(end):
            continue

        def at(mass: float, sign: float = sign) -> float:
            """Return the point that has this mass of the prior between itself and the end."""
            return float(prior.quantile(np.array(mass if sign > 0 else 1.0 - mass)))

        if sign * (middle - at(END_MASS)) > 0:
            continue
        halves = (0.5 * (end + middle), at(0.5 * _mass_between(at, middle, sign)))
        if all(np.mean(sign * (half - x) > 0) > MIN_SHARE_NEAR_END for half in halves):
            return end
    return None


def _mass_between(at: Callable[[float], float], x: float, sign: float) -> float:
    """Return the mass of the prior between its end and `x`, by bisection of its logarithm."""
    low, high = -40.0, 0.0
    for _ in range(60):
        mid = 0.5 * (low + high)
        low, high = (mid, high) if sign * (at(math.exp(mid)) - x) < 0 else (low, mid)
    return math.exp(high)


def end_at_nominal(x: Array, prior: Prior, nominal: float) -> float | None:
    """Return the end of `prior` that keeps draws `(N,)` from passing the nominal value, or None.

    The nominal value is at this end or beyond, or so near that the end cuts off a tail of the draws.
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


MIN_EXPLAINED = 0.8  # share of the variance of ranks that other unknowns have to explain
MIN_SLOPE = 0.3  # standardised slope from which on another unknown is named
MAX_DRAWS = 4000  # draws are thinned to about this number


def prior_dependence(rows: Sequence[ParameterRow], draws: Array) -> Mapping[str, tuple[str, ...]]:
    """Return unknowns that only the priors of others determine, with these others.

    `draws (N, D)` are in the order of `rows`. Ranks are regressed, so that ridges may be curved.
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
RANDOM_TABLES, TABLES_PER_BLOCK = 20_000, 2_000  # number of tables, and of those in memory
FALSE_ALARM = 0.01  # probability that a sound run leaves the band anywhere
TAUS_BETWEEN_DRAWS = 2  # autocorrelation times between draws that count as independent


@dataclass(frozen=True, slots=True, kw_only=True)
class RankHistogram:
    """A histogram has the `counts (E, BINS)` of ranks of each ensemble's draws among all draws.

    Cumulative counts differ by chance from their expectation by at most `half_width (BINS - 1,)`.
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
    def holds(self) -> NDArray[np.bool_]:
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
    """Return half-widths of a band that any ensemble leaves with probability `false_alarm`."""
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

    The sds of `products` of powers of the first unknowns follow, named like derived quantities.
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
