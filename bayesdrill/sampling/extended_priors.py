"""Extend priors whose ends are in the way, and see whether draws crowd at an end.

Against an end of a prior a tail cannot be counted: a box that begins at the nominal value has no
draw below it, however well the record agrees.  What the record says there is seen where the prior
goes on.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from contextlib import suppress

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.basics.progress import Reporter
from bayesdrill.inference.posterior import Posterior
from bayesdrill.inference.priors import Prior
from bayesdrill.sampling.ensembles import (
    ExtendedPriors,
    MemoryBackend,
    Plan,
    SamplingResult,
    sample,
)
from bayesdrill.sampling.proposal.learning import NoSupportError
from bayesdrill.sampling.workers import WorkerPool

END_MASS = 0.05  # of the prior, at an end of it; half of the draws there is a crowd
MIN_SHARE_NEAR_END = 0.25  # of draws are nearer than half the median where their density is flat
NEAR_END_MASS = 0.05  # of the prior between nominal value and end, or less
THREE_SIGMA_TAIL, TWO_SIGMA_TAIL = 1e-3, 2.28e-2  # of draws at three and two sigma of a normal
MAX_LOG_EXTENSION = math.log(10.0)  # an end is moved by the prior's own range, but no further


def with_extended_priors(
    sampled: SamplingResult,
    posterior: Posterior,
    nominal: Mapping[str, float],
    maxima: Array,
    plan: Plan,
    report: Reporter,
) -> SamplingResult:
    """Add what is seen beyond ends of priors that are in the way; `maxima (M, D)`, physical."""
    priors = _priors_to_extend(sampled, posterior, nominal)
    if not priors:
        return sampled
    names, edited = tuple(priors), posterior.edit(priors=priors)
    listed = ", ".join(names)
    report.say(f"priors of {listed} end near nominal values: once more without these ends")
    beyond = ExtendedPriors(names=names, draws=None, pressed=names)
    with suppress(NoSupportError), WorkerPool(edited, 1) as pool:
        extended = sample(pool, maxima, plan, MemoryBackend(), report)
        if extended.convergence.converged:
            draws = extended.draws.reshape(-1, maxima.shape[1])
            columns = dict(zip(posterior.space.free, draws.T, strict=True))
            crowded = [n for n in names if pressed_against(columns[n], priors[n]) is not None]
            beyond = ExtendedPriors(names=names, draws=draws, pressed=tuple(crowded))
    return dataclasses.replace(sampled, extended=beyond)


def unsaved_extension(
    sampled: SamplingResult, posterior: Posterior, nominal: Mapping[str, float]
) -> ExtendedPriors | None:
    """Return names alone of priors that end too near, where a run has saved no draws beyond."""
    names = tuple(_priors_to_extend(sampled, posterior, nominal))
    return ExtendedPriors(names=names, draws=None, pressed=names, saved=False) if names else None


def _priors_to_extend(
    sampled: SamplingResult, posterior: Posterior, nominal: Mapping[str, float]
) -> dict[str, Prior]:
    """Return priors that end too near to nominal values, with ends moved; none if not converged."""
    if not sampled.convergence.converged:
        return {}
    space = posterior.space
    draws = sampled.draws.reshape(-1, len(space.free))
    wider = {
        name: _extended_prior(prior, nominal[name], draws[:, column])
        for column, (name, prior) in enumerate(space.priors.items())
        if name in nominal
    }
    return {name: prior for name, prior in wider.items() if prior is not space.priors[name]}


def _extended_prior(prior: Prior, nominal: float, draws: Array) -> Prior:
    """The same density with the ends moved that are near the nominal value and that draws feel."""
    ends = []
    for end, sign in ((prior.low, 1.0), (prior.high, -1.0)):
        ends.append(end)
        near = 0 < end < math.inf and _ends_near(prior, nominal, sign)
        if not (near and _cuts_off_a_tail(end, draws, sign)):
            continue
        prior_range = math.log(prior.high / prior.low) if prior.low > 0 else MAX_LOG_EXTENSION
        past = 2.0 * max(sign * math.log(end / nominal), 0.0)
        ends[-1] = end * math.exp(-sign * max(min(prior_range, MAX_LOG_EXTENSION), past))
    low, high = ends
    return prior if (low, high) == (prior.low, prior.high) else prior.extended(low, high)


def _ends_near(prior: Prior, nominal: float, sign: float) -> bool:
    """Whether little of the prior lies between nominal value and its lower (upper: -1) end."""
    share = float(prior.quantile(np.array(NEAR_END_MASS if sign > 0 else 1.0 - NEAR_END_MASS)))
    return sign * (nominal - share) <= 0


def _cuts_off_a_tail(end: float, draws: Array, sign: float) -> bool:
    """Whether the end cuts off what draws `(N,)` show of a tail: farther out it does no harm."""
    logs = sign * np.log(draws)
    far, less = np.quantile(logs, [THREE_SIGMA_TAIL, TWO_SIGMA_TAIL])
    return bool(far - sign * math.log(end) < less - far)


def pressed_against(x: Array, prior: Prior) -> float | None:
    """Return the end of `prior` that draws `(N,)` crowd at, as if they wanted past it, or None.

    Half of them lie in the last `END_MASS` of the prior's mass, and they get denser towards the end
    both along x and relative to the prior.  What the corners of a box of priors do alone is weaker:
    where all nine parameters share one scale, a marginal rises like its eighth power, and 37 % of
    it lie in the last twentieth.
    """
    if prior.vanishes_at_ends:
        return None
    middle = float(np.median(x))
    for end, sign in ((prior.low, 1.0), (prior.high, -1.0)):
        if not math.isfinite(end):
            continue

        def at(mass: float, sign: float = sign) -> float:
            """The point that has this mass of the prior between itself and the end."""
            return float(prior.quantile(np.array(mass if sign > 0 else 1.0 - mass)))

        if sign * (middle - at(END_MASS)) > 0:
            continue
        halves = (0.5 * (end + middle), at(0.5 * _mass_between(at, middle, sign)))
        if all(np.mean(sign * (half - x) > 0) > MIN_SHARE_NEAR_END for half in halves):
            return end
    return None


def _mass_between(at: Callable[[float], float], x: float, sign: float) -> float:
    """The mass of the prior between its end and `x`, by bisection of its logarithm."""
    low, high = -40.0, 0.0
    for _ in range(60):
        mid = 0.5 * (low + high)
        low, high = (mid, high) if sign * (at(math.exp(mid)) - x) < 0 else (low, mid)
    return math.exp(high)
