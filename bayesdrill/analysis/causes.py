"""Rank candidate models by what they would explain of a fit that leaves more than noise.

Each is refitted from the maximum, and ranked by the evidence for it.

What the rig is held without bends the parameters that it has, and the fit may well look like noise.
So before a table is blamed, each thing that the rig offers and has not is tried by itself:
parameters are held at their nominal values, within their tolerances, and all else is sought again.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np
import scipy

from bayesdrill.analysis.edits import with_candidates
from bayesdrill.basics.arrays import Array
from bayesdrill.inference import residual_checks, step_error
from bayesdrill.inference.compression import excerpt
from bayesdrill.inference.laplace import LogDensity
from bayesdrill.inference.posterior import Posterior, Problem
from bayesdrill.inference.residual_checks import ResidualSummary, like_noise
from bayesdrill.sampling.gauss_newton import gauss_newton

# Where in its prior what is new is sought from, together with the start that its config gives it.
START_QUANTILES = (0.02, 0.2, 0.35, 0.42, 0.58, 0.65, 0.8)
FIRST_STEPS, LAST_STEPS, CLIMBED_STARTS = 4, 30, 2  # uphill: of all starts, and of the best few
NEAR_END = 1e-3  # of the spread of a prior
# another maximum: so little lower, and so far, in spreads of the priors
OTHER_MAXIMUM_DEPTH, SAME_MAXIMUM = 3.0, 0.1
SURE_LOG_ODDS = 5.0  # natural logs: a candidate that is no better explains nothing
# Parts that absorb any misfit and name no cause: noises, and torques with the place where they act.
NOISE = ("unknown_noise", "ar1")
TORQUE = "missing_torque_"
# of what a catch-all gains in log evidence: a cause that gains as much is named first
MIN_SHARE_OF_CATCH_ALL = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class RefitMaximum:
    """The maximum of a posterior, found by Gauss and Newton from several starts.

    `values`, `sds`: of the unknowns, SI; `log_z`: the log evidence by Laplace; `fit`: what it leaves;
    `at_ends` of their priors are these; `several`: there is another, about as high, with other values
    of what is new; `seconds` that an evaluation takes; `numbers` of samples, with `log_likelihood`.
    """

    values: Mapping[str, float]
    sds: Mapping[str, float]
    log_posterior: float
    log_z: float
    fit: tuple[ResidualSummary, ...]
    at_ends: tuple[str, ...]
    several: bool
    seconds: float
    numbers: int
    log_likelihood: float

    def on(self, numbers: int) -> float:
        """Return what the log likelihood would gain by so many samples, fitted as well as these."""
        return (numbers / self.numbers - 1.0) * self.log_likelihood


def refit_candidate(
    posterior: Posterior,
    near: Mapping[str, float],
    least: float,
    alone: Mapping[str, float] = MappingProxyType({}),
) -> RefitMaximum | None:
    """Refit a candidate: return the maximum of its `posterior`; None without a finite response.

    It starts at `near`, values of unknowns that are known, and at values where what is new was `alone`.
    One that promises no more than the log density `least` is not followed to its very end.  The log
    evidence is that of a Gaussian with the curvature at the maximum; the priors count in it as
    Gaussians of their spread, so that a direction which the record does not determine costs each
    candidate the same (MacKay 2003, ch. 27).
    """
    space, coordinates = posterior.space, posterior.coordinates
    surface = LogDensity(posterior, physical=True)
    starts = coordinates.from_physical(_starts(posterior, near, alone))
    rows = np.clip(starts, surface.low, surface.high)
    first = gauss_newton(surface, rows, FIRST_STEPS)
    if not np.isfinite(first.value).any():
        return None
    begun = time.perf_counter()  # its code is compiled by now
    surface.value(rows)
    seconds = (time.perf_counter() - begun) / len(rows)
    best = np.argsort(-first.value, kind="stable")[:CLIMBED_STARTS]
    u, value, gain = first.u[best], first.value[best], first.gain[best]
    steps = LAST_STEPS if (value + gain)[np.isfinite(value)].max() > least else 0
    if step_error.chosen_steps(posterior):
        posterior = step_error.choose_steps(posterior, coordinates.to_physical(u)[0])
        surface = LogDensity(posterior, physical=True)
    top = gauss_newton(surface, u, steps)
    order = np.argsort(-top.value, kind="stable")
    u, heights = top.u[order], top.value[order]
    if not np.isfinite(heights[0]):
        return None
    theta = coordinates.to_physical(u[:1])[0]
    log_z, sds = _laplace(posterior, u[:1])
    near_end = np.minimum(u[0] - surface.low, surface.high - u[0]) < NEAR_END * surface.spread
    # Along a ridge of what is known all is one maximum.
    new = [name not in near for name in space.free]
    apart = (np.abs(u[1:] - u[0]) / surface.spread)[:, new].max(axis=1, initial=0.0)
    again = (apart > SAME_MAXIMUM) & (heights[1:] > heights[0] - OTHER_MAXIMUM_DEPTH)
    return RefitMaximum(
        values=dict(zip(space.free, map(float, theta), strict=True)),
        sds=dict(zip(space.free, map(float, sds), strict=True)),
        log_posterior=float(heights[0]),
        log_z=log_z,
        fit=residual_checks.residual_summaries(posterior.likelihood, theta),
        at_ends=tuple(name for name, end in zip(space.free, near_end, strict=True) if end),
        several=bool(again.any()),
        seconds=seconds,
        numbers=posterior.likelihood.n_measured,
        log_likelihood=float(posterior.likelihood(theta[None])[0]),
    )


def _starts(posterior: Posterior, near: Mapping[str, float], alone: Mapping[str, float]) -> Array:
    """Return physical starts `(S, D)`: the config's, and what is known, with others of what is new."""
    space = posterior.space
    begun = [{}, near, alone] if alone else [{}, near]
    rows = [space.vector({n: at.get(n, x) for n, x in space.start.items()}) for at in begun]
    known = rows[1]
    new = [k for k, name in enumerate(space.free) if name not in near]
    for share in START_QUANTILES if new else ():
        row = known.copy()
        row[new] = [space.unknowns[k].prior.quantile(np.array(share)) for k in new]
        rows.append(row)
    return np.array(rows)


def _laplace(posterior: Posterior, u: Array) -> tuple[float, Array]:
    """The log evidence, and the sds `(D,)` of the unknowns, at the maximum `u (1, D)`."""
    surface = LogDensity(posterior)
    here = surface.quadratic_model(u, np.eye(u.shape[1]))
    # What a prior bends by itself is in the curvature already: of a box it is nothing.
    flat = np.maximum(1.0 / surface.spread**2 - surface.prior_derivatives(u)[1][0], 0.0)
    matrix = here.curvature[0] + np.diag(flat)
    scale = 1.0 / np.sqrt(np.diag(matrix))
    _, log_det = np.linalg.slogdet(matrix * scale[:, None] * scale)
    log_det -= 2.0 * np.log(scale).sum()
    covariance = np.linalg.inv(matrix * scale[:, None] * scale) * scale[:, None] * scale
    slopes = posterior.coordinates.slopes(posterior.coordinates.to_physical(u))[0]
    value = float(surface.value(u)[0])
    log_z = value + 0.5 * (u.shape[1] * math.log(2.0 * math.pi) - float(log_det))
    return log_z, np.sqrt(np.maximum(np.diag(covariance), 0.0)) * np.abs(slopes)


@dataclass(frozen=True, slots=True)
class FittedValue:
    """An unknown of a refit, in `unit`: of a candidate, one that the config as given has not."""

    name: str
    value: float
    sd: float
    unit: str


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
    doubts: tuple[str, ...]

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
    """Candidates that were refitted, `ranked` with the most probable first.

    `given`: what the fit leaves without; `left_out`: why others could not be tried; `windows`: the
    unknowns as given, refitted on each of several windows of the record, where nothing explains all.
    """

    given: tuple[ResidualSummary, ...]
    ranked: tuple[Cause, ...]
    left_out: Mapping[str, str] = field(default_factory=dict)
    windows: tuple[tuple[FittedValue, ...], ...] = ()

    @property
    def good(self) -> tuple[Cause, ...]:
        """The candidates for which there is some evidence."""
        return tuple(cause for cause in self.ranked if cause.bayes > SURE_LOG_ODDS)

    @property
    def explains(self) -> bool:
        """Whether there is evidence for any candidate."""
        return bool(self.good)

    @property
    def best(self) -> Cause:
        """The candidate with the fewest parts of those that are about as probable as the first.

        Where that is a catch-all, the first that names a cause, if it gains a good share of that,
        and gains beside its own catch-all.
        """
        first = self.ranked[0]
        if first.absorbing == first.parts:
            alone = {cause.parts: cause.bayes for cause in self.ranked}
            for cause in self.ranked:
                beyond = alone.get(cause.absorbing, 0.0) + SURE_LOG_ODDS
                least = max(MIN_SHARE_OF_CATCH_ALL * first.bayes, beyond)
                if cause.absorbing != cause.parts and cause.bayes > least:
                    first = cause
                    break
        near = [c for c in self.ranked if first.bayes - SURE_LOG_ODDS < c.bayes <= first.bayes]
        return min(near, key=lambda cause: len(cause.parts))

    @property
    def lacking(self) -> tuple[str, ...]:
        """The parameters that the rig lacks."""
        return self.best.lacks if self.explains else ()


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
    best: EquivalentExplanation | None = None
    for which in tried:
        fitted = _fit_with_table(wider, start, table, tried, which)
        if fitted is not None and before - fitted[1] <= limit:
            limit = before - fitted[1]
            name = wider.space.free[which]
            best = EquivalentExplanation(parameter=name, value=fitted[0], lost=limit)
    return best


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
