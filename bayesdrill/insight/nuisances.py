"""Whether sensors or the start would explain what the fit leaves: all of them tried together.

Gains, offsets and lags of channels, gain and offset of the voltage, then the start as well: what is not
unknown yet becomes so with a wide prior, and the maximum is sought again from the MAP.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bayesdrill.basics.symbols import Symbol
from bayesdrill.engines.climb import climb
from bayesdrill.inference.likelihood import Likelihood, Observation, Part
from bayesdrill.inference.noise.contract import Noise
from bayesdrill.inference.noise.mixed import with_gaps
from bayesdrill.inference.posterior import Posterior
from bayesdrill.inference.priors import Prior, TruncatedNormal, Uniform
from bayesdrill.inference.surface import PosteriorSurface
from bayesdrill.inference.unknowns import ParameterSpace, Unknown, of_label
from bayesdrill.record.experiment import Experiment, frozen, of_states, usual_inputs
from bayesdrill.rig.measured import Measured

Array = NDArray[np.float64]

Kind = Literal["gain", "offset", "lag", "input offset", "start"]

STEPS = 60  # uphill
LATEST = 20  # samples: how far a lag is sought
TRIED = (0.0, 3.0, -3.0)  # samples: lags from which it is sought
SURE = 5.0  # sds, of what is named
NOISE = 1.1  # mean square over the noise's, below which nothing more is tried
WORTH = 0.3  # of what is unexplained so far, that each thing named must explain
ROUNDING = 1e-12
EXPLAINS = 0.5  # of what the fit leaves beyond noise: with less, nothing is named
MOST_NAMED = 5


@dataclass(frozen=True, slots=True, kw_only=True)
class Cause:
    """One of those: `of` a channel, an input or a state of one `experiment`; `value`, `sd` in SI."""

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


@dataclass(frozen=True, slots=True)
class _Candidate:
    """`step`: of a lag, from one sample to the next."""

    kind: Kind
    of: str
    label: str
    neutral: float
    prior: Prior
    step: float = 0.0

    @property
    def name(self) -> str:
        return of_label(f"tried {self.kind} {self.of}", self.label)

    def at(self, lag: float) -> float:
        """Where a search begins; `lag` in samples."""
        return self.neutral + lag * self.step

    @property
    def group(self) -> tuple[str, str]:
        """The same thing in all experiments; a start is one thing with all its states."""
        return (self.kind, "" if self.kind == "start" else self.of)

    @property
    def unknown(self) -> Unknown:
        symbol = Symbol(self.name, "", "", "", "")
        return Unknown(symbol=symbol, role="sensor", prior=self.prior, start=self.neutral)


def causes(posterior: Posterior, theta: Array) -> Causes | None:
    """At the MAP `theta (D,)`; None where nothing can be tried."""
    best: Causes | None = None
    for with_start in (False, True):
        found = _tried(posterior, theta, with_start=with_start)
        if found is not None and (best is None or found.share > best.share):
            best = found
        if best is not None and best.rest < NOISE:
            break
    return best


def _tried(posterior: Posterior, theta: Array, *, with_start: bool) -> Causes | None:
    wider, every = _opened(posterior, theta, with_start=with_start)
    if not every:
        return None
    count = _Left.of(posterior, theta, wider)
    surface = PosteriorSurface(wider, physical=True)
    m = len(theta) - len(posterior.space.columns("noise"))
    tried = [[c.at(lag) for c in every] for lag in TRIED]
    starts = np.array([np.concatenate([theta[:m], row, theta[m:]]) for row in tried])
    top = climb(surface, wider.coordinates.from_physical(starts), STEPS)
    which = int(np.argmax(top.value))
    if not np.isfinite(top.value[which]):
        return None
    there = wider.coordinates.to_physical(top.u[[which]])[0]
    left = count.at(posterior, theta)
    explained = left - count.at(wider, there)
    if left <= count.floor or explained <= 0:
        return None
    noisy = max(1.0, (left - explained) / count.numbers)
    curvature = surface.expand(top.u[[which]], np.eye(len(there))).curvature[0]
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


def _chosen(
    scaled: Array, m: int, off: Array, every: Sequence[_Candidate], least: float
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


def _opened(
    posterior: Posterior, theta: Array, *, with_start: bool
) -> tuple[Posterior, list[_Candidate]]:
    """The posterior with all of it unknown, in the order of what is tried, before the noise."""
    space, likelihood = posterior.space, posterior.likelihood
    every: list[_Candidate] = []
    parts = []
    for one in likelihood.observations:
        own = [*_of_sensors(one)]
        if with_start:
            own += _of_start(one, space, theta)
        every += own
        parts.append(_part(one, space, own, with_start=with_start))
    noise = len(space.unknowns) - len(space.columns("noise"))
    new = tuple(c.unknown for c in every)
    wider = dataclasses.replace(
        space,
        model=(*space.model, *(c.name for c in every)),
        unknowns=(*space.unknowns[:noise], *new, *space.unknowns[noise:]),
    )
    made = Posterior(
        space=wider,
        likelihood=Likelihood.joint(wider, parts),
        coordinates=wider.coordinates(),
    )
    return made, every


def _part(
    one: Observation, space: ParameterSpace, own: Sequence[_Candidate], *, with_start: bool
) -> Part:
    told = one.named(one.response.parameters, space.model)
    old = one.response.sensing
    names = {(c.kind, c.of): c.name for c in own}

    def with_new(kind: Kind, known: Mapping[str, str]) -> dict[str, str]:
        return {**known, **{of: name for (k, of), name in names.items() if k == kind}}

    sensing = dataclasses.replace(
        old,
        gains=with_new("gain", old.gains),
        offsets=with_new("offset", old.offsets),
        lags=with_new("lag", old.lags),
        input_offsets=with_new("input offset", old.input_offsets),
        states=with_new("start", old.states),
    )
    experiment, noise = _without_first(one) if with_start else (one.experiment, one.noise)
    response = Measured(one.response.model, experiment, sensing)
    return Part(
        response=response,
        noise=noise,
        told=[told.get(name, name) for name in response.parameters],
        levels=one.levels(space),
        label=one.label,
    )


def _without_first(one: Observation) -> tuple[Experiment, Noise]:
    """Before a lag is over, a rig in motion shows what was before its start.  Too short a record, and
    one whose noise needs every sample, stay whole.
    """
    experiment, y = one.experiment, np.array(one.experiment.y)
    y[experiment.t < experiment.t_start + LATEST * experiment.dt] = np.nan
    if np.isnan(y).mean() >= 0.5:
        return experiment, one.noise
    later = dataclasses.replace(experiment, y=frozen(y))
    try:
        return later, with_gaps(one.noise, later.counts)
    except ValueError:
        return experiment, one.noise


def _of_sensors(one: Observation) -> Iterator[_Candidate]:
    """What is not told of its sensors yet."""
    sensing = one.response.sensing
    experiment, latest = one.experiment, LATEST * one.experiment.dt
    for k, channel in enumerate(experiment.channels):
        y = experiment.y[experiment.seen[:, k], k]
        spread = float(y.std())
        if not spread > 0:
            continue
        if channel.name not in sensing.gains:
            prior = TruncatedNormal(1.0, 0.5, 0.05, math.inf)
            yield _Candidate("gain", channel.name, one.label, 1.0, prior)
        if channel.name not in sensing.offsets:
            prior = TruncatedNormal(0.0, spread, -math.inf, math.inf)
            yield _Candidate("offset", channel.name, one.label, 0.0, prior)
        if channel.name not in sensing.lags and sensing.delay is None:
            late = Uniform(-latest, latest)
            yield _Candidate("lag", channel.name, one.label, 0.0, late, experiment.dt)
    size = usual_inputs(experiment)["v"]
    if "v" in experiment.series and "v" not in sensing.input_offsets:
        prior = TruncatedNormal(0.0, 0.3 * size, -math.inf, math.inf)
        yield _Candidate("input offset", "v", one.label, 0.0, prior)


def _of_start(one: Observation, space: ParameterSpace, theta: Array) -> list[_Candidate]:
    """Each state that is held at the start, within what it does later."""
    sensing = one.response.sensing
    if sensing.steady:
        return []
    model, experiment = one.response.model, one.experiment
    y = np.zeros((len(experiment.t), len(model.states)))
    shown = dataclasses.replace(experiment, channels=of_states(model.states), y=y)
    motion = one.response.of(shown).signals(one.told(space.full(theta[None])))[0]
    reach = 2.0 * np.abs(motion).max(axis=0)
    return [
        _Candidate("start", name, one.label, held, TruncatedNormal(held, far, -math.inf, math.inf))
        for name, far in zip(model.states, reach, strict=True)
        if name not in sensing.states and far > 0
        for held in [float(experiment.start.get(name, 0.0))]
    ]
