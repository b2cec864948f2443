"""What would explain what the fit leaves: candidate models, each refitted from the maximum, ranked by
the evidence for it; and whether the nominal table may be right after all.

What the rig is held without bends the parameters that it has, and the fit may well look like noise.  So
before a table is blamed, each thing that the rig offers and has not is tried by itself: parameters
are held at their nominal values, within their tolerances, and all else is sought again.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import scipy

from bayesdrill.analysis.edits import Widened, widened
from bayesdrill.basics.arrays import Array
from bayesdrill.inference import residual_checks, step_error
from bayesdrill.inference.laplace import PosteriorLogDensity
from bayesdrill.inference.posterior import Posterior, Problem
from bayesdrill.inference.residual_checks import ResidualSummary, like_noise
from bayesdrill.sampling.gauss_newton import climb

# Where in its prior what is new is sought from, together with the start that its config gives it.
QUANTILES = (0.02, 0.2, 0.35, 0.42, 0.58, 0.65, 0.8)
FIRST_STEPS, STEPS, FOLLOWED = 4, 30, 2  # uphill: of all starts, and of the best few
AT_END = 1e-3  # of the spread of a prior
OTHER, NEAR = 3.0, 0.1  # another maximum: so little lower, and so far, in spreads of the priors
SURE = 5.0  # natural logs: a candidate that is no better explains nothing


@dataclass(frozen=True, slots=True, kw_only=True)
class Maximum:
    """The maximum of a posterior, found by Gauss and Newton from several starts.

    `values`, `sds`: of the unknowns, SI; `log_z`: the log evidence by Laplace; `fit`: what it leaves;
    `at_ends`: unknowns at an end of their prior; `several`: whether there is another, about as high,
    with other values of what is new; `seconds`: that an evaluation takes.
    """

    values: Mapping[str, float]
    sds: Mapping[str, float]
    log_posterior: float
    log_z: float
    fit: tuple[ResidualSummary, ...]
    at_ends: tuple[str, ...]
    several: bool
    seconds: float


def refit(posterior: Posterior, near: Mapping[str, float], least: float) -> Maximum | None:
    """The maximum of `posterior`, from `near`: values of those of its unknowns that are known.

    None where it has no finite response there.  One that promises no more than the log density `least`
    is not followed to its very end.  The log evidence is that of a Gaussian with the
    curvature at the maximum; the priors count in it as Gaussians of their spread, so that a direction
    which the record does not determine costs each candidate the same (MacKay 2003, ch. 27).
    """
    space, coordinates = posterior.space, posterior.coordinates
    surface = PosteriorLogDensity(posterior, physical=True)
    rows = np.clip(coordinates.from_physical(_starts(posterior, near)), surface.low, surface.high)
    first = climb(surface, rows, FIRST_STEPS)
    if not np.isfinite(first.value).any():
        return None
    begun = time.perf_counter()  # its code is compiled by now
    surface.value(rows)
    seconds = (time.perf_counter() - begun) / len(rows)
    best = np.argsort(-first.value, kind="stable")[:FOLLOWED]
    u, value, gain = first.u[best], first.value[best], first.gain[best]
    steps = STEPS if (value + gain)[np.isfinite(value)].max() > least else 0
    if step_error.chosen_steps(posterior):
        posterior = step_error.choose_steps(posterior, coordinates.to_physical(u)[0])
        surface = PosteriorLogDensity(posterior, physical=True)
    top = climb(surface, u, steps)
    order = np.argsort(-top.value, kind="stable")
    u, heights = top.u[order], top.value[order]
    if not np.isfinite(heights[0]):
        return None
    theta = coordinates.to_physical(u[:1])[0]
    log_z, sds = _laplace(posterior, u[:1])
    near_end = np.minimum(u[0] - surface.low, surface.high - u[0]) < AT_END * surface.spread
    # Along a ridge of what is known all is one maximum.
    new = [name not in near for name in space.free]
    apart = (np.abs(u[1:] - u[0]) / surface.spread)[:, new].max(axis=1, initial=0.0) > NEAR
    return Maximum(
        values=dict(zip(space.free, map(float, theta), strict=True)),
        sds=dict(zip(space.free, map(float, sds), strict=True)),
        log_posterior=float(heights[0]),
        log_z=log_z,
        fit=residual_checks.residual_summaries(posterior.likelihood, theta),
        at_ends=tuple(name for name, end in zip(space.free, near_end, strict=True) if end),
        several=bool((apart & (heights[1:] > heights[0] - OTHER)).any()),
        seconds=seconds,
    )


def _starts(posterior: Posterior, near: Mapping[str, float]) -> Array:
    """Physical, `(S, D)`: where the config begins; and what is known where it is, with what is new where
    it begins and at several places of its prior.
    """
    space = posterior.space
    known = space.vector(
        {**space.start, **{name: x for name, x in near.items() if name in space.start}}
    )
    rows = [space.vector(space.start), known]
    new = [k for k, name in enumerate(space.free) if name not in near]
    for share in QUANTILES if new else ():
        row = known.copy()
        row[new] = [space.unknowns[k].prior.quantile(np.array(share)) for k in new]
        rows.append(row)
    return np.array(rows)


def _laplace(posterior: Posterior, u: Array) -> tuple[float, Array]:
    """The log evidence, and the sds `(D,)` of the unknowns, at the maximum `u (1, D)`."""
    surface = PosteriorLogDensity(posterior)
    here = surface.quadratic_model(u, np.eye(u.shape[1]))
    # What a prior bends by itself is in the curvature already: of a box it is nothing.
    flat = np.maximum(1.0 / surface.spread**2 - surface.prior_curvature(u)[0], 0.0)
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

    `about`: in words; `lines`: of a config, that say so; `lacks`: parameters that the rig lacks; `gain`:
    of the log posterior; `bayes`: of the log evidence by Laplace, against the config as given; `fit`:
    what it leaves; `doubts`: why its evidence cannot be trusted.
    """

    parts: tuple[str, ...]
    about: str
    lines: str
    lacks: tuple[str, ...]
    new: tuple[FittedValue, ...]
    gain: float
    bayes: float
    fit: tuple[ResidualSummary, ...]
    doubts: tuple[str, ...]

    @property
    def explains_all(self) -> bool:
        """Whether only noise is left."""
        return like_noise(self.fit)


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
        """Those for which there is some evidence."""
        return tuple(one for one in self.ranked if one.bayes > SURE)

    @property
    def explains(self) -> bool:
        return bool(self.good)

    @property
    def best(self) -> Cause:
        """The one with the fewest parts of those that are about as probable as the first."""
        near = [one for one in self.ranked if one.bayes > self.ranked[0].bayes - SURE]
        return min(near, key=lambda one: len(one.parts))

    @property
    def lacking(self) -> tuple[str, ...]:
        """Parameters that the rig lacks."""
        return self.best.lacks if self.explains else ()


INSTEAD_STEPS = 40  # uphill
SHARES = (0.02, 0.2)  # of what it can be, from which it is sought
AS_WELL = 0.01  # of records of a rig that is so: more is lost by holding the table


@dataclass(frozen=True, slots=True, kw_only=True)
class Instead:
    """`parameter` that the rig lacks, and its `value` [SI] where all nominal values hold; `lost`: of the
    log likelihood, against the MAP, which has none of it; negative where it fits better.
    """

    parameter: str
    value: float
    lost: float


def instead(problem: Problem, theta: Array) -> Instead | None:
    """What fits the record with the table about as well as the MAP `theta (D,)` without; the best."""
    posterior = problem.posterior
    wide = widened(posterior, theta)
    held = [k for k, name in enumerate(posterior.space.free) if name in problem.nominal]
    if not wide.sizes or not held or not _allowed(problem):
        return None
    limit = 0.5 * float(scipy.special.chdtri(len(held), AS_WELL))
    bare = _held(problem, wide, theta, held, None)
    if bare is None or bare[1] <= limit:
        return None  # the table needs no help
    best: Instead | None = None
    for which, name in zip(wide.tried, wide.sizes, strict=True):
        found = _held(problem, wide, theta, held, which)
        if found is not None and found[1] <= min(limit, limit if best is None else best.lost):
            best = Instead(parameter=name, value=found[0], lost=found[1])
    return best


def _allowed(problem: Problem) -> bool:
    """Whether the priors allow the table at all."""
    nominal, off = problem.nominal, problem.tolerance
    return all(
        prior.low <= nominal[name] * (1.0 + off.get(name, 0.0))
        and nominal[name] * (1.0 - off.get(name, 0.0)) <= prior.high
        for name, prior in problem.posterior.space.priors.items()
        if name in nominal
    )


def _held(
    problem: Problem, wide: Widened, theta: Array, held: list[int], which: int | None
) -> tuple[float, float] | None:
    """With the unknown `which` of what is tried, or with nothing: its value, and what is lost."""
    space, wider = problem.posterior.space, wide.posterior
    start = wide.at(theta)
    ends = np.stack([start, start])
    for k in held:
        name = space.free[k]
        off = problem.tolerance.get(name, 0.0)
        ends[:, k] = problem.nominal[name] * np.array([1.0 - off, 1.0 + off])
    surface = PosteriorLogDensity(wider, physical=True)
    fixed = np.zeros(len(start), dtype=bool)
    fixed[[*held, *wide.tried]] = True
    rows = np.repeat(start[None], len(SHARES), axis=0)
    if which is not None:
        fixed[which] = False
        rows[:, which] = [wider.space.unknowns[which].prior.high * share for share in SHARES]
    low, high = np.clip(wider.coordinates.from_physical(ends), surface.low, surface.high)
    surface.low = np.where(fixed, low, surface.low)
    surface.high = np.where(fixed, high, surface.high)
    top = climb(surface, wider.coordinates.from_physical(rows), INSTEAD_STEPS)
    there = wider.coordinates.to_physical(top.u)
    likely = wider.likelihood(there)
    if not np.isfinite(likely).any():
        return None
    k = int(np.nanargmax(likely))
    before = float(problem.posterior.likelihood(theta[None])[0])
    value = 0.0 if which is None else float(there[k, which])
    return value, before - float(likely[k])
