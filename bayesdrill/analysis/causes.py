"""What would explain what the fit leaves, and whether the nominal table may be right after all.

What is not unknown yet of sensors, the start and efforts that the rig lacks becomes so with a wide
prior, all of it together, and the maximum is sought again from the MAP.

What the rig is held without bends the parameters that it has, and the fit may well look like noise.  So
before a table is blamed, each thing that the rig offers and has not is tried by itself: parameters
are held at their nominal values, within their tolerances, and all else is sought again.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from bayesdrill.analysis.edits import Candidate, Kind, Widened, widened
from bayesdrill.basics.arrays import Array, Flags
from bayesdrill.inference.laplace import PosteriorSurface
from bayesdrill.inference.posterior import Posterior, Problem
from bayesdrill.sampling.gauss_newton import climb

CAUSE_STEPS = 60  # uphill
TRIED = (0.0, 3.0, -3.0)  # samples: lags from which it is sought
SURE = 5.0  # sds, of what is named
NOISE = 1.1  # mean square over the noise's, below which nothing more is tried
WORTH = 0.3  # of what is unexplained so far, that each thing named must explain
ROUNDING = 1e-12
EXPLAINS = 0.5  # of what the fit leaves beyond noise: with less, nothing is named
MOST_NAMED = 5
PROMISES = 0.3  # of what is left, to first order, for a search beside another cause ...
HOPE = 0.1  # ... and for the first one
ALIKE = 0.1  # of what is left: two explanations that differ by less are equals

SENSORS: frozenset[Kind] = frozenset({"gain", "offset", "lag", "input offset", "input lag"})
LATE: frozenset[Kind] = frozenset({"input lag"})
NEARLY = 0.97  # of what the fit leaves: where late inputs explain that, nothing else need be late
STAGES: tuple[frozenset[Kind], ...] = (
    LATE,
    SENSORS,
    SENSORS | {"start"},
    SENSORS | {"rig"},
    SENSORS | {"rig", "start"},
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Cause:
    """One of those: `of` a channel, an input or a state of one `experiment`, or the parameter that the
    rig lacks; `value`, `sd` in SI.
    """

    kind: Kind
    of: str
    experiment: str
    value: float
    sd: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Causes:
    """`share`: of what is left beyond noise, that they explain together, or, where the noise is unknown,
    of what passed for it; `found`: what matters; `rest`: the mean square that they leave, over the
    noise's; `beyond`: what of it is more than noise or, where that is unknown, what still passes for it;
    `other`: explains as much.
    """

    share: float
    rest: float
    found: tuple[Cause, ...]
    beyond: float = 0.0
    other: Causes | None = None

    @property
    def explains(self) -> bool:
        return self.share >= EXPLAINS and bool(self.found)

    @property
    def lacking(self) -> tuple[str, ...]:
        """Parameters that the rig lacks."""
        return tuple(one.of for one in self.found if one.kind == "rig")


def causes(posterior: Posterior, theta: Array) -> Causes | None:
    """At the MAP `theta (D,)`; None where nothing can be tried.

    What takes more to explain must leave so much less.  Where sensors and the start explain it, what
    the rig lacks may do so as well.
    """
    best: Causes | None = None
    known = not any(one.unknowns for one in posterior.likelihood.observations)
    for kinds in STAGES:
        found = _tried(posterior, theta, kinds, HOPE)
        if found is not None and (best is None or found.beyond < (1.0 - WORTH) * best.beyond):
            best = found
        enough = best is not None and kinds == LATE and best.share > NEARLY
        if enough or (best is not None and known and best.rest < NOISE):
            break
    if best is None or not best.explains or best.lacking:
        return best
    other = _tried(posterior, theta, frozenset({"rig"}), PROMISES)
    alike = other is not None and other.explains and other.share > best.share - ALIKE
    return dataclasses.replace(best, other=other) if alike else best


def _tried(
    posterior: Posterior, theta: Array, kinds: frozenset[Kind], least: float
) -> Causes | None:
    trial = _Trial.of(posterior, theta, kinds)
    return trial.outcome() if trial is not None and trial.promises(least) else None


@dataclass(frozen=True, slots=True)
class _Trial:
    """Of what is `wide`, from the MAP `theta (D,)` of `posterior` on.

    `before`: the sum of squares over the noise that the MAP leaves; `floor`: what noise alone leaves of
    it, zero where it is unknown.
    """

    posterior: Posterior
    theta: Array
    wide: Widened
    before: float = 0.0
    floor: float = 0.0

    @classmethod
    def of(cls, posterior: Posterior, theta: Array, kinds: frozenset[Kind]) -> _Trial | None:
        """None where there is nothing to try, or nothing to explain."""
        wide = widened(posterior, theta, kinds)
        if not wide.every:
            return None
        trial = cls(posterior, theta, wide)
        known = not any(one.unknowns for one in posterior.likelihood.observations)
        before, floor = trial.left(posterior, theta, theta), trial.numbers if known else 0.0
        return dataclasses.replace(trial, before=before, floor=floor) if before > floor else None

    @property
    def numbers(self) -> float:
        """Samples that both likelihoods see."""
        observations = self.wide.posterior.likelihood.observations
        return float(sum(one.experiment.seen.sum() for one in observations))

    def left(self, posterior: Posterior, theta: Array, best: Array) -> float:
        """The sum of squares of these that `theta (D,)` leaves, over the noise at `best (D,)`, the MAP
        among these unknowns.
        """
        full, total = posterior.space.full(theta[None]), 0.0
        wider = self.wide.posterior.likelihood.observations
        for one, other in zip(posterior.likelihood.observations, wider, strict=True):
            left = one.whiten(one.residuals(full).samples, best[None])[0]
            total += float((np.where(other.experiment.seen, left, 0.0) ** 2).sum())
        return total

    def starts(self) -> Array:
        """In coordinates: with each lag from which it is sought."""
        lags = TRIED if any(c.step for c in self.wide.every) else (0.0,)
        full = [self.wide.at(self.theta, lag) for lag in lags]
        return self.wide.posterior.coordinates.from_physical(np.array(full))

    def promises(self, least: float) -> bool:
        """Whether it would explain so much of what is left, were the response straight: at the MAP, and
        of inputs that alone may be late from each lag, as what is late by many samples is bent.
        """
        surface = PosteriorSurface(self.wide.posterior, physical=True)
        starts = self.starts()
        late = all(one.kind in LATE for one in self.wide.every)
        u = np.clip(starts if late else starts[:1], surface.low, surface.high)
        here, value = surface.expand(u, np.eye(u.shape[1])), surface.value(u)
        free = np.ones(u.shape[1], dtype=bool)
        reached = [
            height + _gain(slope, curvature, free)
            for height, slope, curvature in zip(value, here.slope, here.curvature, strict=True)
        ]
        free[self.wide.tried] = False
        without = value[0] + _gain(here.slope[0], here.curvature[0], free)
        return bool(2.0 * (max(reached) - without) > least * (self.before - self.floor))

    def outcome(self) -> Causes | None:
        """None where it comes to nothing."""
        wider, numbers = self.wide.posterior, self.numbers
        surface = PosteriorSurface(wider, physical=True)
        top = climb(surface, self.starts(), CAUSE_STEPS)
        which = int(np.argmax(top.value))
        if not np.isfinite(top.value[which]):
            return None
        u = top.u[[which]]
        there = wider.coordinates.to_physical(u)[0]
        rest = self.left(wider, there, self.wide.at(self.theta)) / numbers
        explained = self.before / numbers - rest
        if explained <= 0:
            return None
        curvature = surface.expand(u, np.eye(len(there))).curvature[0]
        share = min(explained * numbers / (self.before - self.floor), 1.0)
        beyond = max(rest - 1.0, 0.0)
        if not self.floor:  # the mean square of the noise, over that at the MAP
            pairs = ((self.posterior.likelihood, self.theta), (wider.likelihood, there))
            before, after = (float(one(at[None])[0]) / one.numbers for one, at in pairs)
            beyond = math.exp(min(2.0 * (before - after), 0.0))
            share = 1.0 - beyond
        named = self._named(there, curvature, SURE**2 * max(1.0, rest))
        return Causes(share=share, rest=rest, found=named, beyond=beyond)

    def _named(self, there: Array, curvature: Array, least: float) -> tuple[Cause, ...]:
        """At the maximum `there (E,)`, where the cost is bent by `curvature (E, E)`."""
        every, tried = self.wide.every, self.wide.tried
        # In units of what each would be known to alone, so that its diagonal is one.
        own = 1.0 / np.sqrt(np.maximum(np.diag(curvature), 1e-300))
        steps = own * self.wide.posterior.coordinates.slopes(there[None])[0]
        scaled = curvature * own[:, None] * own
        inverse = np.linalg.pinv(scaled, hermitian=True)
        sds = np.maximum(steps * np.sqrt(np.maximum(np.diag(inverse), 0.0)), 1e-300)
        off = (there[tried] - [c.neutral for c in every]) / steps[tried]
        return tuple(
            Cause(kind=c.kind, of=c.of, experiment=c.label, value=float(there[k]), sd=float(sds[k]))
            for group in _chosen(scaled, tried.start, off, every, least)
            for k, c in enumerate(every, start=tried.start)
            if c.group == group
        )


def _gain(slope: Array, curvature: Array, free: Flags) -> float:
    """Of the log density, by a step of what is `free (D,)` alone."""
    own = 1.0 / np.sqrt(np.maximum(np.diag(curvature)[free], 1e-300))
    scaled = curvature[np.ix_(free, free)] * own[:, None] * own + ROUNDING * np.eye(len(own))
    return float(0.5 * (slope[free] * own) @ np.linalg.solve(scaled, slope[free] * own))


def _chosen(
    scaled: Array, m: int, off: Array, every: Sequence[Candidate], least: float
) -> list[tuple[str, str]]:
    """What matters most, one after the other: of the same thing in all experiments together.

    `off (n,)`: how far each is from what it is without it; the costs of that are taken as quadratic,
    all else as free to adapt.
    """
    groups, chosen = list(dict.fromkeys(c.group for c in every)), list[tuple[str, str]]()
    now = _cost(scaled, m, off, [True] * len(every))
    while len(chosen) < MOST_NAMED:
        rest = [group for group in groups if group not in chosen]
        if not rest:
            break
        costs = [
            _cost(scaled, m, off, [c.group not in (*chosen, group) for c in every])
            for group in rest
        ]
        best = int(np.argmin(costs))
        if now - costs[best] < max(least, WORTH * now):
            break
        chosen.append(rest[best])
        now = costs[best]
    return chosen


def _cost(scaled: Array, m: int, off: Array, held: Sequence[bool]) -> float:
    """Of holding these `off` where the fit wants them, with all others free, as `scaled` has it."""
    kept = m + np.flatnonzero(held)
    free = np.setdiff1d(np.arange(len(scaled)), kept)
    inner = scaled[np.ix_(free, free)] + ROUNDING * np.eye(len(free))
    cross = scaled[np.ix_(free, kept)]
    left = scaled[np.ix_(kept, kept)] - cross.T @ np.linalg.solve(inner, cross)
    by = off[np.flatnonzero(held)]
    return float(by @ left @ by)


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
    wide = widened(posterior, theta, frozenset({"rig"}))
    held = [k for k, name in enumerate(posterior.space.free) if name in problem.nominal]
    if not wide.every or not held or not _allowed(problem):
        return None
    limit = 0.5 * float(scipy.special.chdtri(len(held), AS_WELL))
    bare = _held(problem, wide, theta, held, None)
    if bare is None or bare[1] <= limit:
        return None  # the table needs no help
    best: Instead | None = None
    for which, one in enumerate(wide.every):
        found = _held(problem, wide, theta, held, which)
        if found is not None and found[1] <= min(limit, limit if best is None else best.lost):
            best = Instead(parameter=one.of, value=found[0], lost=found[1])
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
    """With one of what is tried, or with nothing: its value, and what is lost."""
    space, wider, m = problem.posterior.space, wide.posterior, wide.tried.start
    start = wide.at(theta)
    ends = np.stack([start, start])
    for k in held:
        name = space.free[k]
        off = problem.tolerance.get(name, 0.0)
        ends[:, k] = problem.nominal[name] * np.array([1.0 - off, 1.0 + off])
    surface = PosteriorSurface(wider, physical=True)
    fixed = np.zeros(len(start), dtype=bool)
    fixed[[*held, *range(m, m + len(wide.every))]] = True
    rows = np.repeat(start[None], len(SHARES), axis=0)
    if which is not None:
        fixed[m + which] = False
        rows[:, m + which] = [wide.every[which].prior.high * share for share in SHARES]
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
    value = 0.0 if which is None else float(there[k, m + which])
    return value, before - float(likely[k])
