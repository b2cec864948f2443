"""What would explain what the fit leaves: sensors, the start, efforts that the rig lacks.

What is not unknown yet becomes so with a wide prior, all of it together, and the maximum is sought again
from the MAP.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesdrill.engines.climb import climb
from bayesdrill.inference.posterior import Posterior
from bayesdrill.inference.surface import PosteriorSurface
from bayesdrill.insight.candidates import Candidate, Kind
from bayesdrill.insight.widened import Widened, widened

Array = NDArray[np.float64]

STEPS = 60  # uphill
TRIED = (0.0, 3.0, -3.0)  # samples: lags from which it is sought
AGAIN = 4  # times: signs of a motion that the efforts themselves change
SURE = 5.0  # sds, of what is named
NOISE = 1.1  # mean square over the noise's, below which nothing more is tried
WORTH = 0.3  # of what is unexplained so far, that each thing named must explain
ROUNDING = 1e-12
EXPLAINS = 0.5  # of what the fit leaves beyond noise: with less, nothing is named
MOST_NAMED = 5

STAGES: tuple[frozenset[Kind], ...] = (
    frozenset({"gain", "offset", "lag", "input offset"}),
    frozenset({"gain", "offset", "lag", "input offset", "start"}),
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
    """`share`: of what is left beyond noise, that they explain together; `found`: what matters; `rest`:
    the mean square that they leave, over the noise's.
    """

    share: float
    rest: float
    found: tuple[Cause, ...]

    @property
    def explains(self) -> bool:
        return self.share >= EXPLAINS and bool(self.found)


def causes(posterior: Posterior, theta: Array) -> Causes | None:
    """At the MAP `theta (D,)`; None where nothing can be tried."""
    best: Causes | None = None
    for kinds in STAGES:
        found = _tried(posterior, theta, kinds)
        if found is not None and (best is None or found.share > best.share):
            best = found
        if best is not None and best.rest < NOISE:
            break
    return best


def _tried(posterior: Posterior, theta: Array, kinds: frozenset[Kind]) -> Causes | None:
    wide = widened(posterior, theta, kinds)
    if not wide.every:
        return None
    count, m = _Left.of(posterior, theta, wide.posterior), _before(posterior)
    top = _climbed(wide, theta, m)
    if top is None:
        return None
    wide, u = top
    every, wider = wide.every, wide.posterior
    there = wider.coordinates.to_physical(u)[0]
    left = count.at(posterior, theta)
    explained = left - count.at(wider, there)
    if left <= count.floor or explained <= 0:
        return None
    noisy = max(1.0, (left - explained) / count.numbers)
    surface = PosteriorSurface(wider, physical=True)
    curvature = surface.expand(u, np.eye(len(there))).curvature[0]
    # In units of what each would be known to alone, so that its diagonal is one.
    own = 1.0 / np.sqrt(np.maximum(np.diag(curvature), 1e-300))
    steps = own * wider.coordinates.slopes(there[None])[0]
    scaled = curvature * own[:, None] * own
    inverse = np.linalg.pinv(scaled, hermitian=True)
    sds = np.maximum(steps * np.sqrt(np.maximum(np.diag(inverse), 0.0)), 1e-300)
    tried_at = slice(m, m + len(every))
    off = (there[tried_at] - [c.neutral for c in every]) / steps[tried_at]
    chosen = _chosen(scaled, m, off, every, SURE**2 * noisy)
    named = [
        Cause(kind=c.kind, of=c.of, experiment=c.label, value=float(there[k]), sd=float(sds[k]))
        for group in chosen
        for k, c in enumerate(every, start=m)
        if c.group == group
    ]
    share = min(explained / (left - count.floor), 1.0)
    return Causes(share=share, rest=(left - explained) / count.numbers, found=tuple(named))


def _before(posterior: Posterior) -> int:
    """The place of what is tried among the unknowns."""
    return len(posterior.space.unknowns) - len(posterior.space.columns("noise"))


def _climbed(wide: Widened, theta: Array, m: int) -> tuple[Widened, Array] | None:
    """The maximum `(1, D)` from `theta (D,)`, and the signs that go with it; None where there is none."""
    surface = PosteriorSurface(wide.posterior, physical=True)
    tried = [[c.at(lag) for c in wide.every] for lag in TRIED]
    starts = np.array([np.concatenate([theta[:m], row, theta[m:]]) for row in tried])
    coordinates = wide.posterior.coordinates
    top = climb(surface, coordinates.from_physical(starts), STEPS)
    which = int(np.argmax(top.value))
    if not np.isfinite(top.value[which]):
        return None
    u = top.u[[which]]
    for _ in range(AGAIN if wide.dry else 0):
        wide = wide.moving(coordinates.to_physical(u)[0])
        u = climb(PosteriorSurface(wide.posterior, physical=True), u, STEPS).u
    return wide, u


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


@dataclass(frozen=True, slots=True)
class _Left:
    """Sums of squares over the noise of the MAP, of the samples that both likelihoods see."""

    scales: list[Array]
    seen: list[NDArray[np.bool_]]
    floor: float

    @classmethod
    def of(cls, posterior: Posterior, theta: Array, wider: Posterior) -> _Left:
        known = not any(one.noise.unknowns for one in posterior.likelihood.observations)
        seen = [one.experiment.seen for one in wider.likelihood.observations]
        return cls(
            scales=[one.scales(theta[None])[0] for one in posterior.likelihood.observations],
            seen=seen,
            floor=float(sum(each.sum() for each in seen)) if known else 0.0,
        )

    @property
    def numbers(self) -> float:
        return float(sum(each.sum() for each in self.seen))

    def at(self, posterior: Posterior, theta: Array) -> float:
        full, total = posterior.space.full(theta[None]), 0.0
        every = zip(posterior.likelihood.observations, self.scales, self.seen, strict=True)
        for one, scale, seen in every:
            rest = np.where(seen, one.residuals(full).samples[0], 0.0) / scale
            total += float((rest**2).sum())
        return total
