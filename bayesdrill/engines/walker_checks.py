"""Troubles that R-hat between ensembles and one autocorrelation time for all walkers do not see.

R-hat is blind where every ensemble has the same trouble, and a few walkers out of many hardly move
an average.  So each walker is looked at by itself: does it move, is it where the others are, does
it cross between two places, and do the walkers' means spread as far as tau says they should?
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

STILL_SHARE = 0.5  # of the kept steps: a walker that stands still for as long is stuck, ...
STILL_RATIO = 5.0  # ... if that is as many times longer than half of the walkers ever do
LOW = 0.001  # quantile of the better walkers' log density: none spends half of its time below it
APART = 1.0  # standard deviations between two groups of walkers, at least
VALLEY = 0.5  # density between the groups over that in the thinner one; unimodal: 1 or more
BINS = 12  # between the centres of the two groups
STAY = 0.5  # of the kept steps: mean time until a walker of a group leaves it
CHANCE = 1e-6  # that the means of healthy walkers spread this far, for each unknown


@dataclass(frozen=True, slots=True, kw_only=True)
class Kept:
    """The steps that are judged: `theta (E, S, W, D)`, `log_p (E, S, W)`, `tau (D,)`."""

    theta: Array
    log_p: Array
    names: tuple[str, ...]
    tau: Array
    n_tau: float  # wanted


def suspicions(kept: Kept) -> tuple[str, ...]:
    """A sentence for each trouble: value, place, what to do.

    A walker found out by one look is left out of the next, so that each trouble has one name.
    """
    still = standing_still(kept.theta)
    low = spending_time_low(kept.log_p) & ~still
    sound = ~(still | low)
    found = [*_of_still(kept, still), *_of_low(kept, low, sound)]
    if (sound.sum(axis=1) > 1).any():
        sd = _series(kept.theta, sound).std(axis=0)
        found += _of_two_places(kept, sound, sd) or _of_growing_tau(kept, sound, sd)
    return tuple(found)


def standing_still(theta: Array) -> Flags:
    """`(E, W)`: walkers that once did not move for too long."""
    stay = longest_stay(theta)
    usual = float(np.median(stay))
    least = STILL_SHARE * theta.shape[1]
    return np.asarray(stay >= (least if usual >= least else max(least, STILL_RATIO * usual)))


def longest_stay(theta: Array) -> NDArray[np.intp]:
    """`(E, S, W, D) -> (E, W)`: most steps in a row without a move."""
    moved = (theta[:, 1:] != theta[:, :-1]).any(axis=-1)
    step = np.arange(1, theta.shape[1])[:, None]
    last = np.maximum.accumulate(np.where(moved, step, 0), axis=1)
    return np.asarray((step - last).max(axis=1))


def spending_time_low(log_p: Array) -> Flags:
    """`(E, W)`: walkers whose median log density is rare among the better half of the walkers."""
    medians = np.median(log_p, axis=1)
    better = np.moveaxis(log_p, 1, 2)[medians >= np.median(medians)]
    return np.asarray(medians < np.quantile(better, LOW))


@dataclass(frozen=True, slots=True, kw_only=True)
class Split:
    """Two groups of walkers: their places, the share in the upper, crossings between them."""

    low: float
    high: float
    share: float
    crossings: int


def split(x: Array) -> Split | None:
    """Two places of one unknown `(S, N)` that its walkers hardly ever leave, or None."""
    low, high = two_groups(x.mean(axis=0))
    counts, _ = np.histogram(x, bins=BINS, range=(low, high))
    if counts[1:-1].min() >= VALLEY * min(counts[0], counts[-1]):
        return None
    # A walker belongs to the place whose centre it was at, or beyond, last.
    side = np.where(x >= high, 1, np.where(x <= low, -1, 0))
    last = np.maximum.accumulate(np.where(side != 0, np.arange(len(x))[:, None], 0), axis=0)
    side = np.take_along_axis(side, last, axis=0)
    crossings = int((side[1:] * side[:-1] < 0).sum())
    upper, lower = int((side > 0).sum()), int((side < 0).sum())
    if min(upper, lower) / max(0.5 * crossings, 1.0) < STAY * len(x):
        return None
    return Split(low=low, high=high, share=upper / (upper + lower), crossings=crossings)


def two_groups(means: Array) -> tuple[float, float]:
    """Centres of the two groups that the walkers' means `(N,)` fall into: least squares."""
    means = np.sort(means)
    k = np.arange(1, len(means))
    sums = np.cumsum(means)[:-1]
    below, above = sums / k, (means.sum() - sums) / k[::-1]
    best = int(np.argmax(k * k[::-1] * (above - below) ** 2))
    return float(below[best]), float(above[best])


def long_run_tau(theta: Array, chosen: Flags, sd: Array, parts: int = 1) -> Array:
    """`(D,)`: tau from how far the walkers' means over a part of the chain spread; `sd` of all.

    No window cuts it short, so it sees slow motion of any size, up to the length of a part.  Means
    are compared within an ensemble; that ensembles differ is for R-hat to say.
    """
    length = theta.shape[1] // parts
    total, freedom = np.zeros(theta.shape[-1]), 0
    for chain, flags in zip(theta, chosen, strict=True):
        blocks = chain[: length * parts].reshape(parts, length, *chain.shape[1:])
        means = blocks.mean(axis=1)[:, flags]
        total += ((means - means.mean(axis=(0, 1))) ** 2).sum(axis=(0, 1)) if flags.any() else 0.0
        freedom += max(parts * int(flags.sum()) - 1, 0)
    return np.asarray(length * total / max(freedom, 1) / np.where(sd > 0, sd, 1.0) ** 2)


def _of_still(kept: Kept, still: Flags) -> list[str]:
    n_steps = kept.theta.shape[1]
    if not still.any():
        return []
    if still.mean() > 0.5:
        return [
            f"{still.sum()} of {still.size} walkers did not move for {STILL_SHARE:.0%} of {n_steps} "
            "steps or longer: the moves do not suit this posterior; give sampler.moves other shares"
        ]
    stay = np.where(still, longest_stay(kept.theta), 0)
    ensemble, walker = np.unravel_index(int(np.argmax(stay)), stay.shape)
    return [
        f"{_counted(still)} stuck: the longest did not move for {stay.max()} of {n_steps} steps "
        f"({_where(kept, int(ensemble), int(walker), ~still)}); start over with another seed, and if "
        "it happens there again look at what the model does at this place"
    ]


def _of_low(kept: Kept, low: Flags, sound: Flags) -> list[str]:
    if not low.any():
        return []
    medians = np.median(kept.log_p, axis=1)
    ensemble, walker = np.unravel_index(int(np.argmin(np.where(low, medians, np.inf))), low.shape)
    return [
        f"{_counted(low)} far from where the posterior is: log density {medians[ensemble, walker]:.1f}"
        f", the others' {np.median(medians[sound]):.1f} "
        f"({_where(kept, int(ensemble), int(walker), sound)}); caught in a lesser maximum or still on "
        "the way: start over with another seed, or give the prior an end that leaves the place out"
    ]


def _of_two_places(kept: Kept, sound: Flags, sd: Array) -> list[str]:
    means = kept.theta.mean(axis=1)[sound]
    places = []
    for d, name in enumerate(kept.names):
        low, high = two_groups(means[:, d])
        found = split(_series(kept.theta, sound, d)) if high - low > APART * sd[d] else None
        if found:
            places.append(
                f"{name}: {1 - found.share:.1%} of the draws near {found.low:.4g}, {found.share:.1%} "
                f"near {found.high:.4g}, {found.crossings} crossings"
            )
    if not places:
        return []
    return [
        f"the walkers sit in two places and hardly ever cross between them (SI; {'; '.join(places)} by "
        f"{len(means)} walkers in {kept.theta.shape[1]} steps): the shares are those of the start, "
        "not of the posterior; give the prior an end that leaves one place out, or a record that "
        "tells them apart"
    ]


def _of_growing_tau(kept: Kept, sound: Flags, sd: Array) -> list[str]:
    n_steps, freedom = kept.theta.shape[1], int((sound.sum(axis=1) - 1).clip(0).sum())
    whole = long_run_tau(kept.theta, sound, sd)
    by_chance = float(chdtri(freedom, CHANCE)) / freedom
    grown = (whole > by_chance * kept.tau) & (whole > n_steps / kept.n_tau)
    if not grown.any():
        return []
    worst = int(np.argmax(np.where(grown, whole, 0.0)))
    quarter, half = (float(long_run_tau(kept.theta, sound, sd, n)[worst]) for n in (4, 2))
    return [
        f"the autocorrelation time of {kept.names[worst]} still grows with the chain: {quarter:.0f} "
        f"steps from quarters of it, {half:.0f} from halves, {whole[worst]:.0f} from the whole, where "
        f"its correlations seem to fade after {kept.tau[worst]:.0f}; the chain is at most "
        f"{n_steps / whole[worst]:.0f} of these times long and needs more steps"
    ]


def _series(theta: Array, chosen: Flags, d: int | slice = slice(None)) -> Array:
    """The chosen walkers of all ensembles side by side: `(S, N)` of unknown `d`, or `(S N, D)`."""
    if isinstance(d, slice):
        if chosen.all():
            return theta.reshape(-1, theta.shape[-1])
        return np.swapaxes(theta, 1, 2)[chosen].reshape(-1, theta.shape[-1])
    return np.swapaxes(theta[..., d], 1, 2)[chosen].T


def _counted(flags: Flags) -> str:
    n, each = int(flags.sum()), flags.sum(axis=1)
    where = ", ".join(f"{count} in ensemble {k}" for k, count in enumerate(each) if count)
    return f"{n} of {flags.size} walkers ({where}) {'is' if n == 1 else 'are'}"


def _where(kept: Kept, ensemble: int, walker: int, sound: Flags) -> str:
    """The unknown in which this walker is farthest from the sound ones, in their spreads."""
    others = _series(kept.theta, sound)
    mean, centre = kept.theta[ensemble, :, walker].mean(axis=0), others.mean(axis=0)
    sd = others.std(axis=0)
    d = int(np.argmax(np.abs(mean - centre) / np.where(sd > 0, sd, 1.0)))
    return (
        f"walker {walker} of ensemble {ensemble}, at {kept.names[d]} {mean[d]:.4g} where the others "
        f"have {centre[d]:.4g} +- {sd[d]:.2g} in SI"
    )
