"""Rank candidate models of a bad fit by their evidence, and test the nominal table against them.

An effect that is missing from the rig biases the rig's parameters, even if residuals look like noise.
Before the nominal table is blamed, each optional effect of the rig is therefore added alone.
Parameters with a nominal value are held within its tolerance, and all others are fitted again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Literal

import numpy as np
import scipy

from bayesdrill.analysis.edits import with_candidates
from bayesdrill.basics.arrays import Array
from bayesdrill.inference.compression import excerpt
from bayesdrill.inference.laplace import LogDensity
from bayesdrill.inference.posterior import Posterior, Problem
from bayesdrill.inference.residual_checks import ResidualSummary, like_noise
from bayesdrill.sampling.gauss_newton import gauss_newton

SURE_LOG_ODDS = 5.0  # natural log of the odds; above it, there is evidence for a candidate
# Two kinds of parts absorb any misfit without naming a cause: noise models, and missing torques.
NOISE = ("unknown_noise", "ar1")
TORQUE = "missing_torque_"
SCALE = "scale_"  # prefix of parts that multiply a value, or correct a unit
# A cause is preferred if its log evidence is at least this fraction of that of an absorbing part.
MIN_SHARE_OF_CATCH_ALL = 0.5


@dataclass(frozen=True, slots=True)
class FittedValue:
    """A refit found this value of an unknown and its `sd`, both in `unit`."""

    name: str
    value: float
    sd: float
    unit: str


@dataclass(frozen=True, slots=True)
class Doubt:
    """A doubt says why the evidence of a candidate cannot be trusted.

    Its kind is "end" if an unknown is at an end of its prior, "maxima" if another maximum is about as
    high, and "alike" if unknowns are interchangeable.  It is "hidden" if the candidate leaves out a
    `share` of the samples without explaining the others.  `said_of` names the unknowns or changes.
    """

    kind: Literal["end", "maxima", "alike", "hidden"]
    said_of: tuple[str, ...] = ()
    share: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Cause:
    """A candidate model adds `parts` to the config as given.

    `words` describe the parts, and `lines` are the lines that add them to a config.  `lacks` names
    parameters that the rig lacks.  `gain` and `bayes` are the log posterior and the log evidence
    (Laplace) minus those of the config as given.  `new` are unknowns that the parts add, and `fit`
    summarises residuals.  A refit that is not `finished` was stopped, as it could not be the best.
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
    finished: bool = True

    @property
    def name(self) -> str:
        """Return the name: the parts, joined by hyphens."""
        return "-".join(self.parts)

    @property
    def about(self) -> str:
        """Return the parts in words."""
        return " and ".join(self.words)

    @property
    def explains_all(self) -> bool:
        """Return whether the residuals look like noise."""
        return like_noise(self.fit)

    @property
    def off_by_a_factor(self) -> bool:
        """Return whether a part multiplies a value or corrects a unit."""
        return any(part.startswith(SCALE) for part in self.parts)

    @property
    def absorbing(self) -> tuple[str, ...]:
        """Return the parts that absorb any misfit without naming a cause."""
        return tuple(part for part in self.parts if part in NOISE or part.startswith(TORQUE))


@dataclass(frozen=True, slots=True, kw_only=True)
class Causes:
    """Refitted candidates are `ranked`: the recommended one first, then the most probable.

    `given` summarises the residuals of the config as given.  `left_out` maps candidates that could not
    be tried to reasons.  If no candidate explains all, `windows` has the unknowns refitted to each
    window of the record.  `reference` is an input, and the channel that follows it as a set point.
    `untried` describes combinations that would have taken too many evaluations.  Refits use
    only the first `samples` of each record, or all if it is None.
    """

    given: tuple[ResidualSummary, ...]
    ranked: tuple[Cause, ...]
    left_out: Mapping[str, str] = field(default_factory=dict)
    windows: tuple[tuple[FittedValue, ...], ...] = ()
    reference: tuple[str, str] | None = None
    untried: tuple[str, ...] = ()
    samples: int | None = None

    @property
    def supported(self) -> tuple[Cause, ...]:
        """Return the candidates for which there is some evidence."""
        return tuple(cause for cause in self.ranked if cause.bayes > SURE_LOG_ODDS)

    @property
    def best(self) -> Cause | None:
        """Return the candidate that is recommended, if any; see `recommended`."""
        return recommended(self.ranked)


def recommended(causes: Sequence[Cause]) -> Cause | None:
    """Return the simplest candidate whose evidence is close to that of the best candidate.

    Only finished candidates with evidence and without doubts count.  A named cause replaces an absorbing
    part if it has at least `MIN_SHARE_OF_CATCH_ALL` of that part's log evidence.  Otherwise a cause and
    the absorbing part together replace this part alone, if their evidence is clearly larger.
    """
    good = [c for c in causes if c.bayes > SURE_LOG_ODDS and c.finished and not c.doubts]
    trusted = sorted(good, key=lambda cause: -round(cause.bayes, 3))
    if not trusted:
        return None
    first, least = trusted[0], MIN_SHARE_OF_CATCH_ALL * trusted[0].bayes
    alone = {c.parts: c.bayes + SURE_LOG_ODDS for c in causes if c.bayes > SURE_LOG_ODDS}
    explaining = [cause for cause in trusted if cause.absorbing != cause.parts]
    named = [cause for cause in explaining if not cause.absorbing and cause.bayes >= least]
    partly = [c for c in explaining if c.bayes > max(least, alone.get(c.absorbing, SURE_LOG_ODDS))]
    if first.absorbing and named:
        first, trusted = named[0], named
    elif first.absorbing == first.parts and partly:
        first = partly[0]
    similar = [c for c in trusted if first.bayes - SURE_LOG_ODDS < c.bayes <= first.bayes]
    similar = [cause for cause in similar if first.absorbing or not cause.absorbing]
    return min(similar, key=lambda cause: len(cause.parts))


TABLE_FIT_STEPS = 40  # largest number of Gauss-Newton steps of a fit
START_SHARES = (0.02, 0.2)  # start values of a search, as fractions of a parameter's largest value
REJECTED_SHARE = 0.01  # probability of rejecting the table although the rig agrees with it


@dataclass(frozen=True, slots=True, kw_only=True)
class EquivalentExplanation:
    """The nominal table explains the record as well as the MAP does, if a `parameter` is added.

    With this `value` [SI] all nominal values hold.  `lost` is the log likelihood of the MAP without
    the parameter, minus that of the table with the parameter; it is negative if the table fits better.
    """

    parameter: str
    value: float
    lost: float


# Type of functions like `map`, which call a function with each item.
MapEach = Callable[[Callable[[Any], Any], Iterable[Any]], Iterable[Any]]


def equivalent_explanation(
    problem: Problem, theta: Array, map_each: MapEach = map
) -> EquivalentExplanation | None:
    """Find a parameter with which the table fits the record as well as the MAP `theta (D,)`.

    The result is None if no parameter suffices, or if the table fits without any further parameter.
    `map_each` may run the fits in other processes, one fit for each parameter.
    """
    posterior = excerpt(problem.posterior) or problem.posterior
    wider, space = with_candidates(posterior, theta), posterior.space
    tried = [k for k, name in enumerate(wider.space.free) if name not in space.free]
    table = {}  # lowest and highest value within the tolerance, by column
    for k, name in enumerate(space.free):
        if name in problem.nominal:
            tolerance = problem.tolerance.get(name, 0.0)
            table[k] = problem.nominal[name] * np.array([1.0 - tolerance, 1.0 + tolerance])
    pairs = ((space.unknowns[k].prior, ends) for k, ends in table.items())
    allowed = all(prior.low <= high and low <= prior.high for prior, (low, high) in pairs)
    if not (tried and table and allowed):
        return None
    start = np.insert(theta, tried[0], np.zeros(len(tried)))
    limit = 0.5 * float(scipy.special.chdtri(len(table), REJECTED_SHARE))
    before = float(posterior.likelihood(theta[None])[0])
    bare = _fit_with_table(wider, start, table, tried, None)
    if bare is None or before - bare[1] <= limit:
        return None  # the table fits without a further parameter
    each = map_each(partial(_fit_with_table, wider, start, table, tried), tried)
    fits = zip(tried, each, strict=True)
    losses = [(before - fit[1], wider.space.free[k], fit[0]) for k, fit in fits if fit is not None]
    lost, parameter, value = min(losses, default=(np.inf, "", 0.0))
    if lost > limit:
        return None
    return EquivalentExplanation(parameter=parameter, value=value, lost=lost)


def _fit_with_table(
    wider: Posterior, start: Array, table: Mapping[int, Array], tried: list[int], free: int | None
) -> tuple[float, float] | None:
    """Return the value of the unknown in column `free`, and the log likelihood of the fit.

    Other `tried` unknowns are held at zero.  The result is None if no response is finite.
    """
    ends = np.stack([start, start])
    ends[:, [*table]] = np.transpose([*table.values()])
    surface = LogDensity(wider, physical=True)
    fixed = np.zeros(len(start), dtype=bool)
    fixed[[*table, *tried]] = True
    rows = np.repeat(start[None], len(START_SHARES), axis=0)
    if free is not None:
        fixed[free] = False
        rows[:, free] = [wider.space.unknowns[free].prior.high * share for share in START_SHARES]
    low, high = np.clip(wider.coordinates.from_physical(ends), surface.low, surface.high)
    surface.low = np.where(fixed, low, surface.low)
    surface.high = np.where(fixed, high, surface.high)
    top = gauss_newton(surface, wider.coordinates.from_physical(rows), TABLE_FIT_STEPS)
    theta = wider.coordinates.to_physical(top.u)
    log_l = wider.likelihood(theta)
    if not np.isfinite(log_l).any():
        return None
    k = int(np.nanargmax(log_l))
    return 0.0 if free is None else float(theta[k, free]), float(log_l[k])
