"""Causes of a fit that leaves more than noise: candidate models, ranked by the evidence for each.

What the rig is held without bends the parameters that it has, and the fit may well look like noise.
So before a table is blamed, each thing that the rig offers and has not is tried by itself:
parameters are held at their nominal values, within their tolerances, and all else is sought again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import scipy

from bayesdrill.analysis.edits import with_candidates
from bayesdrill.basics.arrays import Array
from bayesdrill.inference.compression import excerpt
from bayesdrill.inference.laplace import LogDensity
from bayesdrill.inference.posterior import Posterior, Problem
from bayesdrill.inference.residual_checks import ResidualSummary, like_noise
from bayesdrill.sampling.gauss_newton import gauss_newton

SURE_LOG_ODDS = 5.0  # natural logs: a candidate that is no better explains nothing
# Parts that absorb any misfit and name no cause: noises, and torques with the place where they act.
NOISE = ("unknown_noise", "ar1")
TORQUE = "missing_torque_"
# of what a catch-all gains in log evidence: a cause that gains as much is recommended instead
MIN_SHARE_OF_CATCH_ALL = 0.5


@dataclass(frozen=True, slots=True)
class FittedValue:
    """An unknown of a refit, in `unit`: of a candidate, one that the config as given has not."""

    name: str
    value: float
    sd: float
    unit: str


@dataclass(frozen=True, slots=True)
class Doubt:
    """Why the evidence of a candidate cannot be trusted, and of which unknowns or changes that is said.

    `end`: one is at an end of its prior; `maxima`: there is another one, about as high; `alike`: they
    stand for each other; `hidden`: a `share` of the samples is, and others leave more than noise.
    """

    kind: Literal["end", "maxima", "alike", "hidden"]
    said_of: tuple[str, ...] = ()
    share: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Cause:
    """A candidate model: the config as given, and `parts` beside it.

    `words`: what each part is; `lines`: of a config, that say so; `lacks`: parameters that the rig
    lacks; `gain`: of the log posterior; `bayes`: of the log evidence by Laplace, against the config as
    given; `fit`: what it leaves; `doubts`: why its evidence cannot be trusted.
    """

    parts: tuple[str, ...]
    words: tuple[str, ...]
    lines: str
    lacks: tuple[str, ...]
    new: tuple[FittedValue, ...]
    gain: float
    bayes: float
    fit: tuple[ResidualSummary, ...]
    doubts: tuple[Doubt, ...]

    @property
    def name(self) -> str:
        """Its name: parts with dashes between."""
        return "-".join(self.parts)

    @property
    def about(self) -> str:
        """The parts beside the config as given, in words."""
        return " and ".join(self.words)

    @property
    def explains_all(self) -> bool:
        """Whether only noise is left."""
        return like_noise(self.fit)

    @property
    def absorbing(self) -> tuple[str, ...]:
        """The parts that absorb any misfit and name no cause."""
        return tuple(part for part in self.parts if part in NOISE or part.startswith(TORQUE))


@dataclass(frozen=True, slots=True, kw_only=True)
class Causes:
    """Candidates that were refitted, `ranked` with the recommended first, then the most probable.

    `given`: what the fit leaves without; `left_out`: why others could not be tried; `windows`: the
    unknowns as given, refitted on each of several windows of the record in which something moves, where
    nothing explains all.  `reference`: an input and the channel that follows it as a set point.
    """

    given: tuple[ResidualSummary, ...]
    ranked: tuple[Cause, ...]
    left_out: Mapping[str, str] = field(default_factory=dict)
    windows: tuple[tuple[FittedValue, ...], ...] = ()
    reference: tuple[str, str] | None = None

    @property
    def good(self) -> tuple[Cause, ...]:
        """The candidates for which there is some evidence."""
        return tuple(cause for cause in self.ranked if cause.bayes > SURE_LOG_ODDS)

    @property
    def best(self) -> Cause | None:
        """The candidate that is recommended; see `recommended`."""
        return recommended(self.ranked)


def recommended(causes: Sequence[Cause]) -> Cause | None:
    """Return the simplest of the candidates that are about as probable as the best of them.

    Only those count that have some evidence and can be trusted.  What absorbs any misfit gives way to
    causes that gain a good share of that without it, or else to one beside what absorbs, which gains
    more than that alone.
    """
    good = [cause for cause in causes if cause.bayes > SURE_LOG_ODDS and not cause.doubts]
    trusted = sorted(good, key=lambda cause: -round(cause.bayes, 3))
    if not trusted:
        return None
    first, least = trusted[0], MIN_SHARE_OF_CATCH_ALL * trusted[0].bayes
    alone = {c.parts: c.bayes + SURE_LOG_ODDS for c in causes if c.bayes > SURE_LOG_ODDS}
    beside = [cause for cause in trusted if cause.absorbing != cause.parts]
    named = [cause for cause in beside if not cause.absorbing and cause.bayes >= least]
    partly = [c for c in beside if c.bayes > max(least, alone.get(c.absorbing, SURE_LOG_ODDS))]
    if first.absorbing and named:
        first, trusted = named[0], named
    elif first.absorbing == first.parts and partly:
        first = partly[0]
    near = [c for c in trusted if first.bayes - SURE_LOG_ODDS < c.bayes <= first.bayes]
    near = [cause for cause in near if first.absorbing or not cause.absorbing]
    return min(near, key=lambda cause: len(cause.parts))


TABLE_FIT_STEPS = 40  # uphill
START_SHARES = (0.02, 0.2)  # of what it can be, from which it is sought
REJECTED_SHARE = 0.01  # of records of a rig that is so: more is lost by holding the table


@dataclass(frozen=True, slots=True, kw_only=True)
class EquivalentExplanation:
    """A parameter that explains the record as well as a rig off the nominal table.

    `parameter` that the rig lacks, and its `value` [SI] where all nominal values hold; `lost`: of
    the log likelihood, against the MAP, which has none of it; negative where it fits better.
    """

    parameter: str
    value: float
    lost: float


def equivalent_explanation(problem: Problem, theta: Array) -> EquivalentExplanation | None:
    """Find what fits the record with the table about as well as the MAP `theta (D,)` without it."""
    posterior = excerpt(problem.posterior) or problem.posterior
    wider, space = with_candidates(posterior, theta), posterior.space
    tried = [k for k, name in enumerate(wider.space.free) if name not in space.free]
    table = {}  # by columns: ends of the tolerance
    for k, name in enumerate(space.free):
        if name in problem.nominal:
            off = problem.tolerance.get(name, 0.0)
            table[k] = problem.nominal[name] * np.array([1.0 - off, 1.0 + off])
    pairs = ((space.unknowns[k].prior, ends) for k, ends in table.items())
    allowed = all(prior.low <= high and low <= prior.high for prior, (low, high) in pairs)
    if not (tried and table and allowed):
        return None
    start = np.insert(theta, tried[0], np.zeros(len(tried)))
    limit = 0.5 * float(scipy.special.chdtri(len(table), REJECTED_SHARE))
    before = float(posterior.likelihood(theta[None])[0])
    bare = _fit_with_table(wider, start, table, tried, None)
    if bare is None or before - bare[1] <= limit:
        return None  # the table needs no help
    fits = ((which, _fit_with_table(wider, start, table, tried, which)) for which in tried)
    every = [(before - fit[1], wider.space.free[k], fit[0]) for k, fit in fits if fit is not None]
    lost, parameter, value = min(every, default=(np.inf, "", 0.0))
    if lost > limit:
        return None
    return EquivalentExplanation(parameter=parameter, value=value, lost=lost)


def _fit_with_table(
    wider: Posterior, start: Array, table: Mapping[int, Array], tried: list[int], which: int | None
) -> tuple[float, float] | None:
    """With the unknown `which` of those tried, or with nothing: its value, and the likelihood."""
    ends = np.stack([start, start])
    ends[:, [*table]] = np.transpose([*table.values()])
    surface = LogDensity(wider, physical=True)
    fixed = np.zeros(len(start), dtype=bool)
    fixed[[*table, *tried]] = True
    rows = np.repeat(start[None], len(START_SHARES), axis=0)
    if which is not None:
        fixed[which] = False
        rows[:, which] = [wider.space.unknowns[which].prior.high * share for share in START_SHARES]
    low, high = np.clip(wider.coordinates.from_physical(ends), surface.low, surface.high)
    surface.low = np.where(fixed, low, surface.low)
    surface.high = np.where(fixed, high, surface.high)
    top = gauss_newton(surface, wider.coordinates.from_physical(rows), TABLE_FIT_STEPS)
    there = wider.coordinates.to_physical(top.u)
    likely = wider.likelihood(there)
    if not np.isfinite(likely).any():
        return None
    k = int(np.nanargmax(likely))
    return 0.0 if which is None else float(there[k, which]), float(likely[k])
