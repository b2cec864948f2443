"""Judge whether ensembles have converged, and name troubles that R-hat does not see.

R-hat is blind where every ensemble has the same trouble, and a few walkers out of many hardly move
an average.  So each walker is looked at by itself: does it move, is it where the others are, does
it cross between two places, and do the walkers' means spread as far as tau says they should?

Walkers of one ensemble are not independent chains: R-hat compares ensembles, and the effective
sample size comes from the autocorrelation time of an ensemble, averaged over its walkers.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from bayesdrill.basics.arrays import Array, Flags, Indices, StoredArray

STUCK_SHARE = 0.5  # of the kept steps: a walker that stands still for as long is stuck, ...
STUCK_RATIO = 5.0  # ... if that is as many times longer than half of the walkers ever do
LOW_DENSITY_QUANTILE = 0.001  # of the better walkers: none is below it for half of its time
MIN_GROUP_DISTANCE = 1.0  # standard deviations between two groups of walkers, at least
MAX_VALLEY_RATIO = 0.5  # density between the groups over the thinner one's; unimodal: 1 or more
GROUP_BINS = 12  # between the centres of the two groups
MIN_STAY_SHARE = 0.5  # of the kept steps: mean time until a walker of a group leaves it
FALSE_ALARM_PROBABILITY = 1e-6  # that the means of healthy walkers spread so far, each unknown's
MIN_STEPS_FOR_WALKERS = 50  # steps, below which nothing can be told of single walkers


@dataclass(frozen=True, slots=True, kw_only=True)
class PostBurnInChain:
    """Steps after the burn-in: `theta (E, S, W, D)` and `log_p (E, S, W)`, with `tau (D,)`."""

    theta: Array
    log_p: Array
    names: tuple[str, ...]
    tau: Array
    n_tau: float  # wanted


def walker_troubles(chain: PostBurnInChain) -> tuple[str, ...]:
    """Return a sentence for each trouble of single walkers: value, place, and what to do.

    A walker found out by one look is left out of the next, so that each trouble has one name.
    """
    stay, medians = longest_stay(chain.theta), np.median(chain.log_p, axis=1)
    # Walkers that once did not move for too long.
    usual, least = float(np.median(stay)), STUCK_SHARE * chain.theta.shape[1]
    still = stay >= (least if usual >= least else max(least, STUCK_RATIO * usual))
    # Walkers whose median log density is rare among the better half of the walkers.
    better = np.moveaxis(chain.log_p, 1, 2)[medians >= np.median(medians)]
    low = (medians < np.quantile(better, LOW_DENSITY_QUANTILE)) & ~still
    sound = ~(still | low)
    troubles = [*_stuck_walkers(chain, still, stay)]
    troubles += _low_density_walkers(chain, low, sound, medians)
    if (sound.sum(axis=1) > 1).any():
        sd = _series(chain.theta, sound).std(axis=0)
        troubles += _two_groups_of_walkers(chain, sound, sd) or _growing_tau(chain, sound, sd)
    return tuple(troubles)


def longest_stay(theta: Array) -> Indices:
    """Count the most steps in a row without a move, `(E, S, W, D) -> (E, W)`."""
    moved = (theta[:, 1:] != theta[:, :-1]).any(axis=-1)
    step = np.arange(1, theta.shape[1])[:, None]
    last = np.maximum.accumulate(np.where(moved, step, 0), axis=1)
    return np.asarray((step - last).max(axis=1))


@dataclass(frozen=True, slots=True, kw_only=True)
class BimodalSplit:
    """Two groups of walkers: their centres, the share in the upper, and crossings between them."""

    low: float
    high: float
    share: float
    crossings: int


def find_two_groups(x: Array) -> BimodalSplit | None:
    """Find two places of one unknown `(S, N)` that its walkers hardly ever leave, or None."""
    low, high = group_centres(x.mean(axis=0))
    counts, _ = np.histogram(x, bins=GROUP_BINS, range=(low, high))
    if counts[1:-1].min() >= MAX_VALLEY_RATIO * min(counts[0], counts[-1]):
        return None
    # A walker belongs to the place whose centre it was at, or beyond, last.
    side = np.where(x >= high, 1, np.where(x <= low, -1, 0))
    last = np.maximum.accumulate(np.where(side != 0, np.arange(len(x))[:, None], 0), axis=0)
    side = np.take_along_axis(side, last, axis=0)
    crossings = int((side[1:] * side[:-1] < 0).sum())
    upper, lower = int((side > 0).sum()), int((side < 0).sum())
    if min(upper, lower) / max(0.5 * crossings, 1.0) < MIN_STAY_SHARE * len(x):
        return None
    return BimodalSplit(low=low, high=high, share=upper / (upper + lower), crossings=crossings)


def group_centres(means: Array) -> tuple[float, float]:
    """Return the centres of two groups of walkers' means `(N,)`, by least squares."""
    means = np.sort(means)
    k = np.arange(1, len(means))
    sums = np.cumsum(means)[:-1]
    below, above = sums / k, (means.sum() - sums) / k[::-1]
    best = int(np.argmax(k * k[::-1] * (above - below) ** 2))
    return float(below[best]), float(above[best])


def long_run_tau(theta: Array, selected: Flags, sd: Array, parts: int = 1) -> Array:
    """Estimate tau `(D,)` from how far the walkers' means over a part of the chain spread.

    `sd (D,)`: of all.  No window cuts it short, so it sees slow motion of any size, up to the length
    of a part.  Means are compared within an ensemble; that ensembles differ is for R-hat to say.
    """
    length = theta.shape[1] // parts
    total, freedom = np.zeros(theta.shape[-1]), 0
    for chain, flags in zip(theta, selected, strict=True):
        blocks = chain[: length * parts].reshape(parts, length, *chain.shape[1:])
        means = blocks.mean(axis=1)[:, flags]
        total += ((means - means.mean(axis=(0, 1))) ** 2).sum(axis=(0, 1)) if flags.any() else 0.0
        freedom += max(parts * int(flags.sum()) - 1, 0)
    return np.asarray(length * total / max(freedom, 1) / np.where(sd > 0, sd, 1.0) ** 2)


def _stuck_walkers(chain: PostBurnInChain, still: Flags, stay: Indices) -> Iterator[str]:
    n_steps = chain.theta.shape[1]
    if still.mean() > 0.5:
        yield (
            f"{still.sum()} of {still.size} walkers did not move for {STUCK_SHARE:.0%} of "
            f"{n_steps} steps or longer: the moves do not suit this posterior. Give sampler.moves "
            "other shares"
        )
    elif still.any():
        stay = np.where(still, stay, 0)
        yield (
            f"{_counted(still)} stuck: the longest did not move for {stay.max()} of {n_steps} steps "
            f"({_where(chain, int(np.argmax(stay)), ~still)}). Start over with another seed. If "
            "it happens there again, look at what the model does at this place"
        )


def _low_density_walkers(
    chain: PostBurnInChain, low: Flags, sound: Flags, medians: Array
) -> Iterator[str]:
    if not low.any():
        return
    lowest = int(np.argmin(np.where(low, medians, np.inf)))
    yield (
        f"{_counted(low)} far from where the posterior is: log density {medians.flat[lowest]:.1f}"
        f", the others' {np.median(medians[sound]):.1f} "
        f"({_where(chain, lowest, sound)}). This is a lesser maximum, or "
        "the chain is still on its way. Start over with another seed, or let an end of the prior "
        "exclude this place"
    )


def _two_groups_of_walkers(chain: PostBurnInChain, sound: Flags, sd: Array) -> list[str]:
    means = chain.theta.mean(axis=1)[sound]
    places = []
    for d, name in enumerate(chain.names):
        low, high = group_centres(means[:, d])
        if not high - low > MIN_GROUP_DISTANCE * sd[d]:
            continue
        if groups := find_two_groups(np.swapaxes(chain.theta[..., d], 1, 2)[sound].T):
            places.append(
                f"{name}: {1 - groups.share:.1%} of the draws near {groups.low:.4g}, {groups.share:.1%} "
                f"near {groups.high:.4g}, {groups.crossings} crossings"
            )
    if not places:
        return []
    return [
        f"the walkers sit in two places and hardly ever cross between them (SI; {'; '.join(places)} by "
        f"{len(means)} walkers in {chain.theta.shape[1]} steps). The shares are those of the start, "
        "not of the posterior. Give the prior an end that leaves one place out, or add a record that "
        "tells them apart"
    ]


def _growing_tau(chain: PostBurnInChain, sound: Flags, sd: Array) -> list[str]:
    n_steps, freedom = chain.theta.shape[1], int((sound.sum(axis=1) - 1).clip(0).sum())
    whole = long_run_tau(chain.theta, sound, sd)
    by_chance = float(scipy.special.chdtri(freedom, FALSE_ALARM_PROBABILITY)) / freedom
    grown = (whole > by_chance * chain.tau) & (whole > n_steps / chain.n_tau)
    if not grown.any():
        return []
    worst = int(np.argmax(np.where(grown, whole, 0.0)))
    quarter, half = (float(long_run_tau(chain.theta, sound, sd, n)[worst]) for n in (4, 2))
    return [
        f"the autocorrelation time of {chain.names[worst]} still grows with the chain: {quarter:.0f} "
        f"steps from quarters of it, {half:.0f} from halves, {whole[worst]:.0f} from the whole. Its "
        f"correlations only seem to fade after {chain.tau[worst]:.0f}. The chain is at most "
        f"{n_steps / whole[worst]:.0f} of these times long, which is too short"
    ]


def _series(theta: Array, selected: Flags) -> Array:
    """Steps of the chosen walkers of all ensembles, `(S N, D)`."""
    steps = theta if selected.all() else np.swapaxes(theta, 1, 2)[selected]
    return steps.reshape(-1, theta.shape[-1])


def _counted(flags: Flags) -> str:
    n, each = int(flags.sum()), flags.sum(axis=1)
    where = ", ".join(f"{count} in ensemble {k}" for k, count in enumerate(each) if count)
    return f"{n} of {flags.size} walkers ({where}) {'is' if n == 1 else 'are'}"


def _where(chain: PostBurnInChain, k: int, sound: Flags) -> str:
    """The unknown in which the k-th walker is farthest from the sound ones, in their spreads."""
    ensemble, walker = np.unravel_index(k, sound.shape)
    others = _series(chain.theta, sound)
    mean, centre = chain.theta[ensemble, :, walker].mean(axis=0), others.mean(axis=0)
    sd = others.std(axis=0)
    d = int(np.argmax(np.abs(mean - centre) / np.where(sd > 0, sd, 1.0)))
    return (
        f"walker {walker} of ensemble {ensemble}, at {chain.names[d]} {mean[d]:.4g} where the others "
        f"have {centre[d]:.4g} +- {sd[d]:.2g} in SI"
    )


BURN_IN_TAUS = 5  # steps dropped, in autocorrelation times
STEPS_MARGIN = 1.2  # times the steps that seem to be needed, since tau is not known well ...
MIN_CHECK_GROWTH, MAX_CHECK_GROWTH = 1.25, 1.5  # ... but not more often or less
MIN_STEPS_TO_STOP = 1000  # steps before which no run is called futile
MIN_N_TAU_GROWTH = 1.3  # twice the steps of a sound chain are twice as many autocorrelation times
SOKAL_WINDOW = 5.0  # Sokal's window for the autocorrelation time


@dataclass(frozen=True, slots=True, kw_only=True)
class Targets:
    """Targets at which sampling stops: every R-hat, N/tau and bulk ESS must meet its own."""

    r_hat: float
    n_tau: float
    ess: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Convergence:
    """What the ensembles say of each other, and which of their steps are kept.

    `steps` per ensemble, of which `burn_in` are dropped and every `thin`-th is kept.  `tau`, `r_hat`,
    `ess_bulk`, `ess_tail` are `(D,)`; `reasons` says in words why the result must not be believed;
    `burn_in_rule` how `burn_in` was chosen.  `slowest`: the unknown of the longest `tau`; `enough`:
    how many steps would do, where nothing but length is missing, and None elsewhere.
    """

    steps: int
    burn_in: int
    burn_in_rule: str
    thin: int
    tau: StoredArray
    r_hat: StoredArray
    ess_bulk: StoredArray
    ess_tail: StoredArray
    n_tau: float
    reasons: tuple[str, ...]
    slowest: str
    enough: int | None

    @property
    def converged(self) -> bool:
        """Whether nothing speaks against the result."""
        return not self.reasons


@dataclass(frozen=True, slots=True, kw_only=True)
class ChainLength:
    """The length of a chain: `n_tau` of the longest of `tau (D,)`, after `burn_in` steps.

    `early`: the longest of the second half, by which `burn_in` is chosen; `wanted`: what it should be.
    """

    burn_in: int
    wanted: int
    early: float
    tau: Array
    n_tau: float

    def next_check(self, steps: int, n_tau: float) -> int:
        """Return after how many steps to look again: when the chain is likely to be long enough."""
        foreseen = STEPS_MARGIN * (BURN_IN_TAUS + n_tau) * float(self.tau.max())
        return math.ceil(min(max(foreseen, MIN_CHECK_GROWTH * steps), MAX_CHECK_GROWTH * steps))


def chain_length(theta: Array) -> ChainLength:
    """Measure the length of physical chains `(E, S, W, D)` in autocorrelation times."""
    half = theta.shape[1] // 2
    early = float(autocorrelation_time(theta[:, half:]).max())
    wanted = math.ceil(BURN_IN_TAUS * early)
    burn_in = min(wanted, half)
    tau = autocorrelation_time(theta[:, burn_in:])
    n_tau = (theta.shape[1] - burn_in) / float(tau.max())
    return ChainLength(burn_in=burn_in, wanted=wanted, early=early, tau=tau, n_tau=n_tau)


def assess(
    theta: Array,
    names: tuple[str, ...],
    targets: Targets,
    log_p: Array | None = None,
    measured: ChainLength | None = None,
) -> Convergence:
    """Judge physical chains `(E, S, W, D)`.

    `log_p (E, S, W)` finds walkers that are far from the rest; without it they are not looked for.
    `measured`: their length, where it has been measured already.
    """
    from arviz_stats.base import array_stats  # late: it takes half a second to load

    n_steps = theta.shape[1]
    measured = measured or chain_length(theta)
    burn_in, tau, n_tau = measured.burn_in, measured.tau, measured.n_tau
    capped = measured.wanted > burn_in
    post_burn_in = theta[:, burn_in:]
    thin = max(1, min(math.ceil(float(tau.max())), post_burn_in.shape[1] // 4))
    draws = thinned(theta, burn_in, thin)
    arviz: Any = array_stats  # without types
    axes = {"chain_axis": 0, "draw_axis": 1}
    r_hat = arviz.rhat(draws, **axes, method="rank")
    # ArviZ takes draws for a series in which walkers take turns, and so cannot see that a walker
    # still remembers where it was at its last draw.
    still = draws.shape[0] * draws.shape[1] / autocorrelation_time(post_burn_in[:, ::thin])
    ess_bulk = np.minimum(arviz.ess(draws, **axes, method="bulk"), still)
    ess_tail = np.minimum(arviz.ess(draws, **axes, method="tail", prob=0.9), still)
    disagreeing = not (r_hat <= targets.r_hat).all()
    missing = list(_reasons(names, targets, measured, r_hat, ess_bulk))
    named: tuple[str, ...] = ()
    if post_burn_in.shape[1] >= MIN_STEPS_FOR_WALKERS:
        density = np.zeros(post_burn_in.shape[:-1]) if log_p is None else log_p[:, burn_in:]
        chain = PostBurnInChain(
            theta=post_burn_in, log_p=density, names=names, tau=tau, n_tau=targets.n_tau
        )
        named = walker_troubles(chain)
    if capped and not named:
        missing.append(
            f"the run is too short to judge its burn-in: {BURN_IN_TAUS} autocorrelation times are "
            f"{measured.wanted} steps, half of the run is {burn_in}"
        )
    return Convergence(
        steps=n_steps,
        burn_in=burn_in,
        burn_in_rule=f"half of the run, too short for {BURN_IN_TAUS} autocorrelation times"
        if capped
        else f"{BURN_IN_TAUS} autocorrelation times of {measured.early:.1f} steps",
        thin=thin,
        tau=tau,
        r_hat=r_hat,
        ess_bulk=ess_bulk,
        ess_tail=ess_tail,
        n_tau=n_tau,
        reasons=(*named, *missing),
        slowest=names[int(np.argmax(tau))],
        enough=None if named or disagreeing else _steps_needed(n_steps, targets, n_tau, ess_bulk),
    )


def _steps_needed(steps: int, targets: Targets, n_tau: float, ess: Array) -> int | None:
    """By proportion, with something to spare; None where nothing is missing."""
    short = max(targets.n_tau / n_tau, targets.ess / float(ess.min()))
    return math.ceil(STEPS_MARGIN * short * steps) if short > 1 else None


def thinned(chains: Array, burn_in: int, thin: int) -> Array:
    """Thin `(E, S, W, ...)` to nearly independent draws `(E, draws, ...)`, in order of time."""
    steps = chains[:, burn_in::thin]
    return np.ascontiguousarray(steps.reshape(steps.shape[0], -1, *steps.shape[3:]))


def futility(trail: Sequence[tuple[int, float]], wanted: float, allowed: int, most: int) -> str:
    """Return why more steps would not help, or an empty text.

    `trail`: (steps, how many autocorrelation times long) at each check, of which `wanted` are wanted.
    `allowed`: sampler.max_steps; `most`: that, or fewer where the chain would be too large.
    """
    steps, n_tau = trail[-1]
    if steps < MIN_STEPS_TO_STOP or n_tau >= wanted:
        return ""
    earlier = [(n, count) for n, count in trail if n <= steps / 2]
    if earlier and n_tau < MIN_N_TAU_GROWTH * earlier[-1][1]:
        n, count = earlier[-1]
        return (
            f"stopped early: tau grows with the chain, {n / count:.0f} steps after {n} and "
            f"{steps / n_tau:.0f} after {steps}. More steps do not help. Hold an unknown, give the "
            "priors nearer ends, or check whether the model can make this record at all"
        )
    needed = steps * wanted / n_tau
    if needed > most:
        return f"stopped early: it would take about {needed:.0f} steps, more than " + (
            f"sampler.max_steps ({allowed}); raise that and continue with --resume, or hold an "
            "unknown"
            if most == allowed
            else f"the {most} that a chain of so many walkers and unknowns may have; give "
            "sampler.walkers a smaller number, or hold an unknown"
        )
    return ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Autocorrelation:
    """Autocorrelation of chains, and its integral in Sokal's window.

    `rho (S, D)` by lag in steps; its sum up to the lag `window (D,)` gives `tau (D,)`, at least 1.
    """

    rho: Array
    tau: Array
    window: Indices


def autocorrelation(chains: Array) -> Autocorrelation:
    """Compute the autocorrelation of `(E, S, W, D)`, averaged over walkers and ensembles.

    It is summed in Sokal's window (Goodman and Weare 2010), as emcee does per ensemble.
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
    inside = np.arange(n_steps)[:, None] < SOKAL_WINDOW * tau
    window = np.where(inside.all(axis=0), n_steps - 1, np.argmin(inside, axis=0))
    tau_in_window = np.maximum(tau[window, np.arange(tau.shape[1])], 1.0)
    return Autocorrelation(rho=rho, tau=np.asarray(tau_in_window), window=window)


def autocorrelation_time(chains: Array) -> Array:
    """Return the integrated autocorrelation time in steps, `(E, S, W, D) -> (D,)`."""
    return autocorrelation(chains).tau


def _reasons(
    names: tuple[str, ...], targets: Targets, measured: ChainLength, r_hat: Array, ess: Array
) -> Iterator[str]:
    if not np.all(np.isfinite(r_hat)) or r_hat.max() > targets.r_hat:
        worst = int(np.argmax(np.nan_to_num(r_hat, nan=np.inf)))
        yield (
            f"the ensembles disagree on {names[worst]}: R-hat {r_hat[worst]:.4f}, "
            f"wanted at most {targets.r_hat:g}"
        )
    if measured.n_tau < targets.n_tau:
        worst = int(np.argmax(measured.tau))
        yield (
            f"the chain is {measured.n_tau:.0f} autocorrelation times long (tau "
            f"{measured.tau[worst]:.0f} steps, {names[worst]}), wanted at least {targets.n_tau:g}"
        )
    if not np.all(np.isfinite(ess)) or ess.min() < targets.ess:
        worst = int(np.argmin(np.nan_to_num(ess, nan=0.0)))
        yield f"{ess[worst]:.0f} effective draws of {names[worst]}, wanted at least {targets.ess:g}"
