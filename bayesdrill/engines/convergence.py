"""Whether the ensembles may be believed, and which of their steps.

Walkers of one ensemble are not independent chains: R-hat compares ensembles, and the effective
sample size comes from the autocorrelation time of an ensemble, averaged over its walkers.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from bayesdrill.engines.walker_checks import Kept, suspicions

Array = NDArray[np.float64]

BURN_IN_TAUS = 5  # steps dropped, in autocorrelation times
AMPLY = 1.2  # so many times the steps that seem to be needed, since tau is not known well ...
LEAST_GROWTH, MOST_GROWTH = 1.25, 1.5  # ... but not more often or less
WINDOW = 5.0  # Sokal's window for the autocorrelation time
PATIENCE = 1000  # steps before which no run is called futile
GROWING = 1.3  # twice the steps of a sound chain are twice as many autocorrelation times
LEAST_KEPT = 50  # steps, below which nothing can be told of single walkers


@dataclass(frozen=True, slots=True, kw_only=True)
class Targets:
    """When to stop: every R-hat <= r_hat, N/tau >= n_tau, every bulk ESS >= ess."""

    r_hat: float
    n_tau: float
    ess: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Convergence:
    """`steps` per ensemble, of which `burn_in` are dropped and every `thin`-th is kept.

    `tau`, `r_hat`, `ess_bulk`, `ess_tail` are `(D,)`; `reasons` says in words why the result must
    not be believed; `burn_in_rule` how `burn_in` was chosen.  `slowest`: the unknown of the longest
    `tau`; `enough`: how many steps would do, where nothing but length is missing, and None elsewhere.
    """

    steps: int
    burn_in: int
    burn_in_rule: str
    thin: int
    tau: Array
    r_hat: Array
    ess_bulk: Array
    ess_tail: Array
    n_tau: float
    reasons: tuple[str, ...]
    slowest: str
    enough: int | None

    @property
    def converged(self) -> bool:
        return not self.reasons


@dataclass(frozen=True, slots=True, kw_only=True)
class Length:
    """Of a chain in autocorrelation times: `n_tau` of the longest of `tau (D,)`, after `burn_in` steps.

    `early`: the longest of the second half, by which `burn_in` is chosen; `wanted`: what it should be.
    """

    burn_in: int
    wanted: int
    early: float
    tau: Array
    n_tau: float

    def next_check(self, steps: int, n_tau: float) -> int:
        """After how many steps to look again: when the chain is likely to be as long as it should be."""
        foreseen = AMPLY * (BURN_IN_TAUS + n_tau) * float(self.tau.max())
        return math.ceil(min(max(foreseen, LEAST_GROWTH * steps), MOST_GROWTH * steps))


def length(theta: Array) -> Length:
    """Of physical chains `(E, S, W, D)`."""
    half = theta.shape[1] // 2
    early = float(autocorrelation_time(theta[:, half:]).max())
    wanted = math.ceil(BURN_IN_TAUS * early)
    burn_in = min(wanted, half)
    tau = autocorrelation_time(theta[:, burn_in:])
    n_tau = (theta.shape[1] - burn_in) / float(tau.max())
    return Length(burn_in=burn_in, wanted=wanted, early=early, tau=tau, n_tau=n_tau)


def assess(
    theta: Array,
    names: tuple[str, ...],
    targets: Targets,
    log_p: Array | None = None,
    found: Length | None = None,
) -> Convergence:
    """Judge physical chains `(E, S, W, D)`.

    `log_p (E, S, W)` finds walkers that are far from the rest; without it they are not looked for.
    `found`: their length, where it has been measured already.
    """
    from arviz_stats.base import array_stats  # late: it takes half a second to load

    n_steps = theta.shape[1]
    found = found or length(theta)
    burn_in, tau, n_tau = found.burn_in, found.tau, found.n_tau
    capped = found.wanted > burn_in
    kept = theta[:, burn_in:]
    thin = max(1, min(math.ceil(float(tau.max())), kept.shape[1] // 4))
    draws = thinned(theta, burn_in, thin)
    r_hat = _each(array_stats.rhat, draws, method="rank")
    # ArviZ takes draws for a series in which walkers take turns, and so cannot see that a walker
    # still remembers where it was at its last draw.
    still = draws.shape[0] * draws.shape[1] / autocorrelation_time(kept[:, ::thin])
    ess_bulk = np.minimum(_each(array_stats.ess, draws, method="bulk"), still)
    ess_tail = np.minimum(_each(array_stats.ess, draws, method="tail", prob=0.9), still)
    apart = not (r_hat <= targets.r_hat).all()
    missing = _reasons(names, targets, tau, r_hat, ess_bulk, n_tau)
    named: tuple[str, ...] = ()
    if kept.shape[1] >= LEAST_KEPT:
        density = np.zeros(kept.shape[:-1]) if log_p is None else log_p[:, burn_in:]
        seen = Kept(theta=kept, log_p=density, names=names, tau=tau, n_tau=targets.n_tau)
        named = suspicions(seen)
    if capped and not named:
        missing.append(
            f"the run is too short to judge its burn-in: {BURN_IN_TAUS} autocorrelation times are "
            f"{found.wanted} steps, half of the run is {burn_in}"
        )
    return Convergence(
        steps=n_steps,
        burn_in=burn_in,
        burn_in_rule=_rule(found.early, capped=capped),
        thin=thin,
        tau=tau,
        r_hat=r_hat,
        ess_bulk=ess_bulk,
        ess_tail=ess_tail,
        n_tau=n_tau,
        reasons=(*named, *missing),
        slowest=names[int(np.argmax(tau))],
        enough=None if named or apart else _enough(n_steps, targets, n_tau, ess_bulk),
    )


def _enough(steps: int, targets: Targets, n_tau: float, ess: Array) -> int | None:
    """By proportion, with something to spare; None where nothing is missing."""
    short = max(targets.n_tau / n_tau, targets.ess / float(ess.min()))
    return math.ceil(AMPLY * short * steps) if short > 1 else None


def _rule(tau: float, *, capped: bool) -> str:
    if capped:
        return f"half of the run, too short for {BURN_IN_TAUS} autocorrelation times"
    return f"{BURN_IN_TAUS} autocorrelation times of {tau:.1f} steps"


def thinned(chains: Array, burn_in: int, thin: int) -> Array:
    """`(E, S, W, ...)` to nearly independent draws `(E, draws, ...)`, in order of time."""
    kept = chains[:, burn_in::thin]
    return np.ascontiguousarray(kept.reshape(kept.shape[0], -1, *kept.shape[3:]))


def futile(trail: Sequence[tuple[int, float]], wanted: float, allowed: int, most: int) -> str:
    """Why more steps would not help, or nothing.

    `trail`: (steps, how many autocorrelation times long) at each check, of which `wanted` are
    wanted.  `allowed`: sampler.max_steps; `most`: that, or fewer where the chain would be too large.
    """
    steps, n_tau = trail[-1]
    if steps < PATIENCE or n_tau >= wanted:
        return ""
    earlier = [(n, count) for n, count in trail if n <= steps / 2]
    if earlier and n_tau < GROWING * earlier[-1][1]:
        n, count = earlier[-1]
        return (
            f"stopped early: tau grows with the chain, {n / count:.0f} steps after {n} and "
            f"{steps / n_tau:.0f} after {steps}, so that more of them do not help; hold an unknown, "
            "give the priors nearer ends, or look whether the model can make this record at all"
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
    """`rho (S, D)` by lag in steps; its sum up to the lag `window (D,)` gives `tau (D,)`, at least 1."""

    rho: Array
    tau: Array
    window: NDArray[np.intp]


def autocorrelation(chains: Array) -> Autocorrelation:
    """Of `(E, S, W, D)`, averaged over walkers and ensembles, then summed in Sokal's window
    (Goodman and Weare 2010, as emcee does per ensemble).
    """
    n_steps = chains.shape[1]
    total: Array = np.zeros((n_steps, chains.shape[-1]))
    for chain in chains:
        centred = chain - chain.mean(axis=(0, 1))
        spectrum = fft.rfft(centred, n=fft.next_fast_len(2 * n_steps, real=True), axis=0)
        power = (spectrum.real**2 + spectrum.imag**2).sum(axis=1)
        total += fft.irfft(power, n=fft.next_fast_len(2 * n_steps, real=True), axis=0)[:n_steps]
    with np.errstate(invalid="ignore", divide="ignore"):
        rho = np.nan_to_num(total / total[0], nan=1.0)
    tau = 2.0 * np.cumsum(rho, axis=0) - 1.0
    inside = np.arange(n_steps)[:, None] < WINDOW * tau
    window = np.where(inside.all(axis=0), n_steps - 1, np.argmin(inside, axis=0))
    found = np.maximum(tau[window, np.arange(tau.shape[1])], 1.0)
    return Autocorrelation(rho=rho, tau=np.asarray(found), window=window)


def autocorrelation_time(chains: Array) -> Array:
    """Integrated, in steps: `(E, S, W, D) -> (D,)`."""
    return autocorrelation(chains).tau


def _each(statistic: object, draws: Array, **options: object) -> Array:
    assert callable(statistic)
    columns = range(draws.shape[-1])
    return np.array(
        [float(statistic(draws[..., d], chain_axis=0, draw_axis=1, **options)) for d in columns]
    )


def _reasons(
    names: tuple[str, ...],
    targets: Targets,
    tau: Array,
    r_hat: Array,
    ess: Array,
    n_tau: float,
) -> list[str]:
    reasons = []
    if not np.all(np.isfinite(r_hat)) or r_hat.max() > targets.r_hat:
        worst = int(np.argmax(np.nan_to_num(r_hat, nan=np.inf)))
        reasons.append(
            f"the ensembles disagree on {names[worst]}: R-hat {r_hat[worst]:.4f}, "
            f"wanted at most {targets.r_hat:g}"
        )
    if n_tau < targets.n_tau:
        worst = int(np.argmax(tau))
        reasons.append(
            f"the chain is {n_tau:.0f} autocorrelation times long (tau {tau[worst]:.0f} steps, "
            f"{names[worst]}), wanted at least {targets.n_tau:g}"
        )
    if not np.all(np.isfinite(ess)) or ess.min() < targets.ess:
        worst = int(np.argmin(np.nan_to_num(ess, nan=0.0)))
        reasons.append(
            f"{ess[worst]:.0f} effective draws of {names[worst]}, wanted at least {targets.ess:g}"
        )
    return reasons
