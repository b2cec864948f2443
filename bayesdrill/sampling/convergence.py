"""Judge whether ensembles have converged, and find troubles that R-hat does not show.

R-hat does not show a trouble that all ensembles share, and a few bad walkers hardly change an
average.  So walkers are checked one by one: does a walker move, is its log density as high as
those of others, does it cross between groups?  And do walkers' means spread as tau predicts?

Walkers of one ensemble are not independent chains: R-hat compares ensembles, and the effective
sample size comes from the autocorrelation time of an ensemble, averaged over its walkers.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from bayesdrill.basics.arrays import Array, Flags, Indices, StoredArray
from bayesdrill.basics.findings import Finding

# A walker is stuck if its longest stay is at least `STUCK_SHARE` times the number of kept steps.
# Unless most walkers stay that long, it must also be `STUCK_RATIO` times the median longest stay.
STUCK_SHARE, STUCK_RATIO = 0.5, 5.0
LOW_DENSITY_QUANTILE = 0.001  # quantile of the better walkers' log_p; a lower median is too low
MIN_GROUP_DISTANCE = 1.0  # smallest distance between the centres of two groups of walkers, in sds
MAX_VALLEY_RATIO = 0.5  # limit of (density between distinct groups) / (density of the lower peak)
GROUP_BINS = 12  # bins of the histogram between the centres of two groups
MIN_STAY_SHARE = 0.5  # shortest mean stay of walkers in a group, as a fraction of the kept steps
FALSE_ALARM_PROBABILITY = 1e-6  # probability, per unknown, of finding a growing tau by chance
MIN_STEPS_FOR_WALKERS = 50  # with fewer kept steps single walkers are not judged


@dataclass(frozen=True, slots=True, kw_only=True)
class PostBurnInChain:
    """A chain after the burn-in has `theta (E, S, W, D)`, `log_p (E, S, W)`, and `tau (D,)` in steps."""

    theta: Array
    log_p: Array
    names: tuple[str, ...]
    tau: Array
    n_tau: float  # the target length in autocorrelation times


def walker_troubles(chain: PostBurnInChain) -> tuple[Finding, ...]:
    """Return findings on single walkers, each with the worst walker or unknown.

    Walkers that one check finds are excluded from the next check, so none is reported twice.
    """
    stay, medians = longest_stay(chain.theta), np.median(chain.log_p, axis=1)
    median_stay, limit = float(np.median(stay)), STUCK_SHARE * chain.theta.shape[1]
    stuck = stay >= (limit if median_stay >= limit else max(limit, STUCK_RATIO * median_stay))
    better = np.moveaxis(chain.log_p, 1, 2)[medians >= np.median(medians)]
    low = (medians < np.quantile(better, LOW_DENSITY_QUANTILE)) & ~stuck
    sound = ~(stuck | low)
    troubles = [*_stuck_walkers(chain, stuck, stay)]
    troubles += _low_density_walkers(chain, low, sound, medians)
    if (sound.sum(axis=1) > 1).any():
        sd = _pooled_steps(chain.theta, sound).std(axis=0)
        troubles += _two_groups_of_walkers(chain, sound, sd) or _growing_tau(chain, sound, sd)
    return tuple(troubles)


def longest_stay(theta: Array) -> Indices:
    """Return the longest run of steps without a move of each walker, `(E, S, W, D) -> (E, W)`."""
    moved = (theta[:, 1:] != theta[:, :-1]).any(axis=-1)
    step = np.arange(1, theta.shape[1])[:, None]
    last = np.maximum.accumulate(np.where(moved, step, 0), axis=1)
    return np.asarray((step - last).max(axis=1))


def find_two_groups(x: Array) -> tuple[float, float, float, int] | None:
    """Find two groups that walkers hardly leave, in values `x (S, N)` of one unknown, or None.

    Returns both centres, the fraction of steps in the upper group, and the number of crossings.
    """
    low, high = group_centres(x.mean(axis=0))
    counts, _ = np.histogram(x, bins=GROUP_BINS, range=(low, high))
    if counts[1:-1].min() >= MAX_VALLEY_RATIO * min(counts[0], counts[-1]):
        return None
    # A walker belongs to the group whose centre it last reached or passed.
    side = np.where(x >= high, 1, np.where(x <= low, -1, 0))
    last = np.maximum.accumulate(np.where(side != 0, np.arange(len(x))[:, None], 0), axis=0)
    side = np.take_along_axis(side, last, axis=0)
    crossings = int((side[1:] * side[:-1] < 0).sum())
    upper, lower = int((side > 0).sum()), int((side < 0).sum())
    if min(upper, lower) / max(0.5 * crossings, 1.0) < MIN_STAY_SHARE * len(x):
        return None
    return low, high, upper / (upper + lower), crossings


def group_centres(means: Array) -> tuple[float, float]:
    """Split walkers' means `(N,)` into two groups by least squares, and return their centres."""
    means = np.sort(means)
    k = np.arange(1, len(means))
    sums = np.cumsum(means)[:-1]
    below, above = sums / k, (means.sum() - sums) / k[::-1]
    best = int(np.argmax(k * k[::-1] * (above - below) ** 2))
    return float(below[best]), float(above[best])


def long_run_tau(theta: Array, selected: Flags, sd: Array, parts: int = 1) -> Array:
    """Estimate tau `(D,)` in steps from the scatter of the walkers' means over parts of a chain.

    `sd (D,)` is the standard deviation of all steps.  No window of lags cuts off slow motion: even
    motion as slow as a part is seen.  Means are compared within ensembles, not between them.
    """
    length = theta.shape[1] // parts
    total, freedom = np.zeros(theta.shape[-1]), 0  # sum of squares, and degrees of freedom
    for chain, flags in zip(theta, selected, strict=True):
        blocks = chain[: length * parts].reshape(parts, length, *chain.shape[1:])
        means = blocks.mean(axis=1)[:, flags]
        total += ((means - means.mean(axis=(0, 1))) ** 2).sum(axis=(0, 1)) if flags.any() else 0.0
        freedom += max(parts * int(flags.sum()) - 1, 0)
    return np.asarray(length * total / max(freedom, 1) / np.where(sd > 0, sd, 1.0) ** 2)


def _stuck_walkers(chain: PostBurnInChain, stuck: Flags, stay: Indices) -> Iterator[Finding]:
    steps = chain.theta.shape[1]
    if stuck.mean() > 0.5:
        counts = {"count": int(stuck.sum()), "walkers": stuck.size, "steps": steps}
        yield Finding("walkers that hardly move", {}, {**counts, "share": STUCK_SHARE})
    elif stuck.any():
        stay = np.where(stuck, stay, 0)
        stays = {"stay": int(stay.max()), "steps": steps}
        yield _at_walker("stuck walkers", stays, chain, int(np.argmax(stay)), stuck, ~stuck)


def _low_density_walkers(
    chain: PostBurnInChain, low: Flags, sound: Flags, medians: Array
) -> Iterator[Finding]:
    if not low.any():
        return
    lowest = int(np.argmin(np.where(low, medians, np.inf)))
    densities = {"density": float(medians.flat[lowest]), "others": float(np.median(medians[sound]))}
    yield _at_walker("walkers at a low density", densities, chain, lowest, low, sound)


def _two_groups_of_walkers(chain: PostBurnInChain, sound: Flags, sd: Array) -> list[Finding]:
    means = chain.theta.mean(axis=1)[sound]
    places = dict[str, tuple[float, ...]]()
    for d, name in enumerate(chain.names):
        low, high = group_centres(means[:, d])
        if not high - low > MIN_GROUP_DISTANCE * sd[d]:
            continue
        if groups := find_two_groups(np.swapaxes(chain.theta[..., d], 1, 2)[sound].T):
            places[name] = groups
    counts = {"walkers": len(means), "steps": chain.theta.shape[1]}
    return [Finding("two groups of walkers", {}, counts, places)] if places else []


def _growing_tau(chain: PostBurnInChain, sound: Flags, sd: Array) -> list[Finding]:
    n_steps, freedom = chain.theta.shape[1], int((sound.sum(axis=1) - 1).clip(0).sum())
    whole = long_run_tau(chain.theta, sound, sd)
    by_chance = float(scipy.special.chdtri(freedom, FALSE_ALARM_PROBABILITY)) / freedom
    grown = (whole > by_chance * chain.tau) & (whole > n_steps / chain.n_tau)
    if not grown.any():
        return []
    worst = int(np.argmax(np.where(grown, whole, 0.0)))
    quarter, half = (float(long_run_tau(chain.theta, sound, sd, n)[worst]) for n in (4, 2))
    numbers = {"quarter": quarter, "half": half, "whole": float(whole[worst])}
    numbers |= {"tau": float(chain.tau[worst]), "times": n_steps / float(whole[worst])}
    return [Finding("growing autocorrelation time", {"unknown": chain.names[worst]}, numbers)]


def _pooled_steps(theta: Array, selected: Flags) -> Array:
    """Return the pooled steps of the selected walkers of all ensembles, `(E, S, W, D) -> (S N, D)`."""
    steps = theta if selected.all() else np.swapaxes(theta, 1, 2)[selected]
    return steps.reshape(-1, theta.shape[-1])


def _at_walker(
    kind: str,
    numbers: Mapping[str, float],
    chain: PostBurnInChain,
    k: int,
    doubtful: Flags,
    sound: Flags,
) -> Finding:
    """Return a finding on doubtful walkers, of which the k-th is the worst.

    The finding names the unknown in which this walker is farthest, in sds, from sound walkers.
    """
    ensemble, walker = np.unravel_index(k, sound.shape)
    others = _pooled_steps(chain.theta, sound)
    mean, centre = chain.theta[ensemble, :, walker].mean(axis=0), others.mean(axis=0)
    sd = others.std(axis=0)
    d = int(np.argmax(np.abs(mean - centre) / np.where(sd > 0, sd, 1.0)))
    place: dict[str, float] = {"walker": int(walker), "ensemble": int(ensemble)}
    place |= {"mean": float(mean[d]), "centre": float(centre[d]), "sd": float(sd[d])}
    place |= {"walkers": doubtful.size, **numbers}
    ensembles = tuple(doubtful.sum(axis=1).tolist())
    return Finding(kind, {"unknown": chain.names[d]}, place, {"ensembles": ensembles})


BURN_IN_TAUS = 5  # length of the burn-in, in autocorrelation times
STEPS_MARGIN = 1.2  # factor on the estimated number of steps, since tau is uncertain
MIN_CHECK_GROWTH, MAX_CHECK_GROWTH = 1.25, 1.5  # ratio of the lengths at two successive checks
MIN_STEPS_TO_STOP = 1000  # a shorter run is never stopped as futile
MIN_N_TAU_GROWTH = 1.3  # least growth factor of N/tau while steps double; it is 2 for a sound chain
SOKAL_WINDOW = 5.0  # Sokal's window ends at the first lag above this multiple of tau


@dataclass(frozen=True, slots=True, kw_only=True)
class Targets:
    """Every unknown must have at most this R-hat, and at least this N/tau and this bulk ESS."""

    r_hat: float
    n_tau: float
    ess: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ChainLength:
    """After `burn_in` steps, a chain is `n_tau` times as long as the longest of `tau (D,)`.

    `late_tau` is the longest tau, in steps, of the second half of the chain.  It determines
    `burn_in`, which is at most half of the chain.
    """

    burn_in: int
    late_tau: float
    tau: StoredArray
    n_tau: float

    @property
    def too_short_for_burn_in(self) -> bool:
        """Return whether half of the run is shorter than the burn-in should be."""
        return burn_in_wanted(self.late_tau) > self.burn_in

    def next_check(self, steps: int, n_tau: float) -> int:
        """Return the number of steps at the next check, when N/tau probably reaches `n_tau`."""
        foreseen = STEPS_MARGIN * (BURN_IN_TAUS + n_tau) * float(self.tau.max())
        return math.ceil(min(max(foreseen, MIN_CHECK_GROWTH * steps), MAX_CHECK_GROWTH * steps))


@dataclass(frozen=True, slots=True, kw_only=True)
class Convergence(ChainLength):
    """A convergence summarises how well the ensembles of a run have converged.

    Of the `steps` per ensemble, `burn_in` are dropped and every `thin`-th is kept.  `r_hat`,
    `ess_bulk` and `ess_tail` have the shape `(D,)`.  `reasons` say why the result must not be
    believed.  `slowest` is the unknown with the longest `tau`.  If the chain is merely too short,
    `enough` estimates the necessary number of steps.
    """

    steps: int
    thin: int
    r_hat: StoredArray
    ess_bulk: StoredArray
    ess_tail: StoredArray
    reasons: tuple[Finding, ...]
    slowest: str
    enough: int | None

    @property
    def converged(self) -> bool:
        """Return whether there is no reason to distrust the result."""
        return not self.reasons

    def progress(self, targets: Targets) -> float:
        """Return N/tau or ESS divided by its target, whichever ratio is smaller, and at most 1."""
        ess_ratio = float(self.ess_bulk.min()) / targets.ess
        return min(self.n_tau / targets.n_tau, ess_ratio, 1.0)


def burn_in_wanted(late_tau: float) -> int:
    """Return the number of burn-in steps, given the longest tau of the chain's second half."""
    return math.ceil(BURN_IN_TAUS * late_tau)


def chain_length(theta: Array) -> ChainLength:
    """Measure the length of chains `theta (E, S, W, D)` in autocorrelation times."""
    half = theta.shape[1] // 2
    late = float(autocorrelation_time(theta[:, half:]).max())
    burn_in = min(burn_in_wanted(late), half)
    tau = autocorrelation_time(theta[:, burn_in:])
    n_tau = (theta.shape[1] - burn_in) / float(tau.max())
    return ChainLength(burn_in=burn_in, late_tau=late, tau=tau, n_tau=n_tau)


def assess(
    theta: Array,
    names: tuple[str, ...],
    targets: Targets,
    log_p: Array | None = None,
    measured: ChainLength | None = None,
) -> Convergence:
    """Return the convergence of chains `theta (E, S, W, D)`, such as unknowns in SI.

    Walkers at a low density are only found if `log_p (E, S, W)` is given.  `measured` is the length
    of the chains, if it is known already.
    """
    from arviz_stats.base import array_stats  # imported here, as loading takes half a second

    n_steps = theta.shape[1]
    measured = measured or chain_length(theta)
    burn_in, tau = measured.burn_in, measured.tau
    post_burn_in = theta[:, burn_in:]
    thin = max(1, min(math.ceil(float(tau.max())), post_burn_in.shape[1] // 4))
    draws = thinned(theta, burn_in, thin)
    arviz: Any = array_stats  # it has no type annotations
    axes = {"chain_axis": 0, "draw_axis": 1}
    r_hat = arviz.rhat(draws, **axes, method="rank")
    # ArviZ gets one series in which walkers alternate, so it misses the correlation of a walker's
    # draw with the same walker's previous draw.
    by_walkers = draws.shape[0] * draws.shape[1] / autocorrelation_time(post_burn_in[:, ::thin])
    ess_bulk = np.minimum(arviz.ess(draws, **axes, method="bulk"), by_walkers)
    ess_tail = np.minimum(arviz.ess(draws, **axes, method="tail", prob=0.9), by_walkers)
    missing = list(_reasons(names, targets, measured, r_hat, ess_bulk))
    troubles: tuple[Finding, ...] = ()
    if post_burn_in.shape[1] >= MIN_STEPS_FOR_WALKERS:
        density = np.zeros(post_burn_in.shape[:-1]) if log_p is None else log_p[:, burn_in:]
        chain = PostBurnInChain(
            theta=post_burn_in, log_p=density, names=names, tau=tau, n_tau=targets.n_tau
        )
        troubles = walker_troubles(chain)
    if measured.too_short_for_burn_in and not troubles:
        wanted = burn_in_wanted(measured.late_tau)
        steps = {"taus": BURN_IN_TAUS, "wanted": wanted, "burn_in": burn_in}
        missing.append(Finding("burn-in too short to judge", {}, steps))
    enough = None
    if not troubles and (r_hat <= targets.r_hat).all():
        short = max(targets.n_tau / measured.n_tau, targets.ess / float(ess_bulk.min()))
        enough = math.ceil(STEPS_MARGIN * short * n_steps) if short > 1 else None
    return Convergence(
        **dataclasses.asdict(measured),
        steps=n_steps,
        thin=thin,
        r_hat=r_hat,
        ess_bulk=ess_bulk,
        ess_tail=ess_tail,
        reasons=(*troubles, *missing),
        slowest=names[int(np.argmax(tau))],
        enough=enough,
    )


def thinned(chains: Array, burn_in: int, thin: int) -> Array:
    """Thin `(E, S, W, ...)` to nearly independent draws `(E, draws, ...)`, in order of time."""
    steps = chains[:, burn_in::thin]
    return np.ascontiguousarray(steps.reshape(steps.shape[0], -1, *steps.shape[3:]))


def futility(
    trail: Sequence[tuple[int, float]], target: float, allowed: int, step_limit: int
) -> Finding | None:
    """Return why more steps would not help, or None.

    `trail` has the steps and N/tau at each check, and `target` is the target of N/tau.  `allowed`
    is `sampler.max_steps`; `step_limit` is the smaller of `allowed` and the length that fits in memory.
    """
    steps, n_tau = trail[-1]
    if steps < MIN_STEPS_TO_STOP or n_tau >= target:
        return None
    earlier = [(n, count) for n, count in trail if n <= steps / 2]
    if earlier and n_tau < MIN_N_TAU_GROWTH * earlier[-1][1]:
        n, count = earlier[-1]
        numbers = {"tau": n / count, "steps": n, "late_tau": steps / n_tau, "late_steps": steps}
        return Finding("stopped early, as tau grows", {}, numbers)
    needed = steps * target / n_tau
    if needed <= step_limit:
        return None
    kind = "more steps than max_steps" if step_limit == allowed else "more steps than fit in memory"
    return Finding(kind, {}, {"needed": needed, "most": step_limit})


@dataclass(frozen=True, slots=True, kw_only=True)
class Autocorrelation:
    """The autocorrelation of chains is summed over Sokal's window.

    `rho (S, D)` is given at each lag in steps.  `tau (D,)` is 2 sum(rho) - 1 from lag 0 to the lag
    `window (D,)`, and at least 1.
    """

    rho: Array
    tau: Array
    window: Indices


def autocorrelation(chains: Array) -> Autocorrelation:
    """Compute the autocorrelation of chains `(E, S, W, D)`, averaged over walkers and ensembles.

    The sum extends over Sokal's window (Goodman and Weare 2010), as in emcee for one ensemble.
    """
    n_steps = chains.shape[1]
    padded = scipy.fft.next_fast_len(2 * n_steps, real=True)
    total: Array = np.zeros((n_steps, chains.shape[-1]))
    for chain in chains:
        spectrum = scipy.fft.rfft(chain - chain.mean(axis=(0, 1)), n=padded, axis=0)
        power = (spectrum.real**2 + spectrum.imag**2).sum(axis=1)
        total += scipy.fft.irfft(power, n=padded, axis=0)[:n_steps]
    with np.errstate(invalid="ignore", divide="ignore"):
        rho = np.nan_to_num(total / total[0], nan=1.0)
    tau = 2.0 * np.cumsum(rho, axis=0) - 1.0
    in_window = np.arange(n_steps)[:, None] < SOKAL_WINDOW * tau
    window = np.where(in_window.all(axis=0), n_steps - 1, np.argmin(in_window, axis=0))
    tau_in_window = np.maximum(tau[window, np.arange(tau.shape[1])], 1.0)
    return Autocorrelation(rho=rho, tau=np.asarray(tau_in_window), window=window)


def autocorrelation_time(chains: Array) -> Array:
    """Return the integrated autocorrelation time in steps, `(E, S, W, D) -> (D,)`."""
    return autocorrelation(chains).tau


def _reasons(
    names: tuple[str, ...], targets: Targets, measured: ChainLength, r_hat: Array, ess: Array
) -> Iterator[Finding]:
    if not np.all(np.isfinite(r_hat)) or r_hat.max() > targets.r_hat:
        worst = int(np.argmax(np.nan_to_num(r_hat, nan=np.inf)))
        numbers = {"r_hat": float(r_hat[worst]), "wanted": targets.r_hat}
        yield Finding("the ensembles disagree", {"unknown": names[worst]}, numbers)
    if measured.n_tau < targets.n_tau:
        worst = int(np.argmax(measured.tau))
        numbers = {"n_tau": measured.n_tau, "tau": float(measured.tau[worst])}
        numbers["wanted"] = targets.n_tau
        yield Finding("the chain is too short", {"unknown": names[worst]}, numbers)
    if not np.all(np.isfinite(ess)) or ess.min() < targets.ess:
        worst = int(np.argmin(np.nan_to_num(ess, nan=0.0)))
        numbers = {"ess": float(ess[worst]), "wanted": targets.ess}
        yield Finding("too few effective draws", {"unknown": names[worst]}, numbers)
