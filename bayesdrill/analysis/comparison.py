"""Several models or experiments side by side: which is the more probable, how far they are apart,
do repeats agree.

Whether experiments with one rig tell the same of it: their spread, against what each knows.

At the joint maximum each experiment alone would move the unknowns by its own slope over its own
information, nuisances taken out.  The spread beyond that is DerSimonian and Laird's (1986).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy

from bayesdrill.analysis.identifiability.information import BLIND, RANK_TOLERANCE, Scenery
from bayesdrill.analysis.identifiability.structure import Exponents
from bayesdrill.analysis.plausibility import Vague
from bayesdrill.analysis.prediction import HeldOut, LeftOut
from bayesdrill.basics.arrays import Array
from bayesdrill.basics.symbols import Symbol
from bayesdrill.inference.derived import hdi
from bayesdrill.inference.posterior import Problem
from bayesdrill.inference.residual_checks import ResidualSummary, like_noise
from bayesdrill.sampling.evidence import Evidence


@dataclass(frozen=True, slots=True, kw_only=True)
class Layer:
    """One run under its `name`: `draws (N, D)`, SI; `settings`: what a reader compares of two runs.

    `mark`: by which files say whose they are; `warning`: what its figures carry, `reasons`: why it must
    not be believed; empty where it may be.
    """

    name: str
    mark: str
    problem: Problem
    draws: Array
    settings: Mapping[str, str]
    warning: str = ""
    reasons: tuple[str, ...] = ()

    def of(self, symbol: Symbol) -> Array | None:
        """Draws `(N,)` of an unknown; None where it is none of this run."""
        if symbol not in self.problem.symbols:
            return None
        return self.draws[:, self.problem.symbols.index(symbol)]


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """Where a run has a quantity, SI: mean, sd and the narrowest interval; all one where it is held."""

    mean: float
    sd: float
    low: float
    high: float

    @property
    def held(self) -> bool:
        return self.sd == 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """An unknown of some run; `places`, `nominal`: of each run, None where it has none.

    `apart`: the largest difference of two means over the root mean square of their sds, and `pair`
    the two runs; None where fewer than two have it as an unknown.
    """

    symbol: Symbol
    places: tuple[Place | None, ...]
    nominal: tuple[float | None, ...]
    apart: float | None
    pair: tuple[int, int] | None

    @property
    def agreed(self) -> float | None:
        """The nominal value, where all runs that have one have the same."""
        known = {value for value in self.nominal if value is not None}
        return known.pop() if len(known) == 1 else None

    @property
    def shared(self) -> bool:
        """Whether two runs have it as an unknown."""
        return self.pair is not None


def overlay_rows(layers: Sequence[Layer]) -> tuple[Row, ...]:
    """In the order of the runs and of their unknowns."""
    rows = []
    for symbol in dict.fromkeys(s for layer in layers for s in layer.problem.symbols):
        places = tuple(_place(symbol, layer) for layer in layers)
        nominal = tuple(layer.problem.nominal.get(symbol.name) for layer in layers)
        apart, pair = max(_distances(places), default=(None, None))
        rows.append(Row(symbol=symbol, places=places, nominal=nominal, apart=apart, pair=pair))
    return tuple(rows)


def _place(symbol: Symbol, layer: Layer) -> Place | None:
    x, held = layer.of(symbol), layer.problem.posterior.space.fixed.get(symbol.name)
    if x is not None:
        low, high = hdi(x)
        return Place(mean=float(x.mean()), sd=float(x.std(ddof=1)), low=low, high=high)
    return None if held is None else Place(mean=held, sd=0.0, low=held, high=held)


def _distances(places: Sequence[Place | None]) -> Iterator[tuple[float, tuple[int, int]]]:
    """Of all pairs that have an sd, in sds."""
    free = [(k, place) for k, place in enumerate(places) if place is not None and place.sd > 0]
    for (k, one), (j, other) in itertools.combinations(free, 2):
        sd = math.sqrt(0.5 * (one.sd**2 + other.sd**2))
        yield abs(one.mean - other.mean) / sd, (k, j)


def differing(layers: Sequence[Layer]) -> dict[str, tuple[str | None, ...]]:
    """What is not the same in all runs, and what it is in each; None where a run has no such thing."""
    names = dict.fromkeys(name for layer in layers for name in layer.settings)
    found = {name: tuple(layer.settings.get(name) for layer in layers) for name in names}
    return {name: values for name, values in found.items() if len(set(values)) > 1}


SURE = 3.0  # of log odds: twenty to one
WIDE = 10.0  # of log odds: what priors that are too wide may take off
BY_CHANCE = 3.0  # standard errors of a difference that is none

Word = Literal["model", "noise", "both", "either", "priors", "neither"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Contender:
    """A run among others. `rig`, `noise`: what it says of either, without priors, by which two are told
    to be the same; `beliefs`: its priors, by unknowns; `loo`: or why there is none.
    """

    layer: Layer
    converged: bool
    evidence: Evidence
    left: tuple[ResidualSummary, ...]
    vague: tuple[Vague, ...]
    rig: Mapping[str, str]
    noise: Mapping[str, str]
    beliefs: Mapping[str, str]
    held_out: HeldOut | None
    loo: LeftOut | str

    @property
    def name(self) -> str:
        return self.layer.name

    @property
    def mark(self) -> str:
        return self.layer.mark

    @property
    def log_z(self) -> float:
        return self.evidence.log_z

    @property
    def like_noise(self) -> bool:
        return like_noise(self.left)


@dataclass(frozen=True, slots=True, kw_only=True)
class Decision:
    """`first`: what others are held against, `best`: the most probable; `gain`: log odds of it against
    those of the same rig (`model`), of the same noise (`noise`), or the first.

    `vague`: unknowns of models that lose by no more than priors which are too wide can make them.
    """

    word: Word
    first: int
    best: int
    gain: Mapping[str, float]
    vague: tuple[str, ...]

    def sure(self, what: str) -> bool:
        return self.gain[what] > SURE


def decide(models: Sequence[Contender]) -> Decision:
    """The first is what is held against all others."""
    first = models[0]
    best = max(range(len(models)), key=lambda k: models[k].log_z)
    top = models[best]

    def over(those: Callable[[Contender], bool]) -> float:
        """Log odds of the best against the best of those that are not like it."""
        return top.log_z - max((one.log_z for one in models if those(one)), default=-math.inf)

    gain = {
        "first": top.log_z - first.log_z,
        "model": over(lambda one: one.rig == first.rig),
        "noise": over(lambda one: one.noise == first.noise),
    }
    error = BY_CHANCE * math.hypot(top.evidence.error, first.evidence.error)
    word = _word(top, first, gain) if gain["first"] > SURE + error else "neither"
    return Decision(word=word, first=0, best=best, gain=gain, vague=_vague(models, top))


def _word(top: Contender, first: Contender, gain: Mapping[str, float]) -> Word:
    """Of a model that is better than the first."""
    if top.rig == first.rig and top.noise == first.noise:
        return "priors"
    model, noise = gain["model"] > SURE, gain["noise"] > SURE
    if top.rig == first.rig:
        return "noise" if noise else "either"
    if top.noise == first.noise:
        return "model" if model else "either"
    if model and noise:
        return "both"
    return "model" if model else "noise" if noise else "either"


def _vague(models: Sequence[Contender], top: Contender) -> tuple[str, ...]:
    """What the best has in common with the others makes no difference, however wide it is."""
    close = [one for one in models if 0.0 < top.log_z - one.log_z < WIDE]
    names = [
        each.name
        for one in close
        for each in one.vague
        if one.beliefs[each.name] != top.beliefs.get(each.name)
    ]
    return tuple(dict.fromkeys(names))


def probabilities(models: Sequence[Contender]) -> tuple[float, ...]:
    """Of each, where one of them is right and all were as likely before."""
    log_z = np.array([one.log_z for one in models])
    share = np.exp(log_z - log_z.max())
    return tuple(map(float, share / share.sum()))


def difference(one: HeldOut | LeftOut, other: HeldOut | LeftOut) -> tuple[float, float]:
    """Of two scores of the same samples, and its standard error."""
    each = one.each - other.each
    return float(each.sum()), math.sqrt(len(each)) * float(each.std())


FALSE_ALARM = 0.01  # of sets of repeats of one rig, any product at all


@dataclass(frozen=True, slots=True, kw_only=True)
class Repeat:
    """A product: how far each experiment (by name) puts its log from the joint one, and each one's sd.

    `p`: of a spread as large by chance; `spread`: sd of the log between experiments, beyond that.
    """

    exponents: Exponents
    labels: tuple[str, ...]
    apart: tuple[float, ...]
    sds: tuple[float, ...]
    p: float
    spread: float
    differs: bool


def repeats(scenery: Scenery, theta: Array, products: Sequence[Exponents]) -> tuple[Repeat, ...]:
    """Of products that more than one experiment determines; at `theta (D,)`, the joint maximum."""
    every = scenery.likelihood.observations
    if len(every) < 2 or not products:
        return ()
    full = scenery.likelihood.space.full(theta[None])
    rests = [one.whitened_jacobian_at(one.residuals(full).samples, theta).ravel() for one in every]
    alone = [scenery.alone(*pair) for pair in zip(scenery.each(theta), rests, strict=True)]
    found = []
    for exponents in products:
        powers = np.array(exponents, dtype=float)
        told = [(one.label, *_of(a, powers)) for one, a in zip(every, alone, strict=True)]
        known = [(label, x, sd) for label, x, sd in told if np.isfinite(sd)]
        if len(known) > 1:
            found.append((exponents, known))
    return tuple(_compared(exponents, known, len(found)) for exponents, known in found)


def _compared(
    exponents: Exponents, known: Sequence[tuple[str, float, float]], looks: int
) -> Repeat:
    labels, x, sds = zip(*known, strict=True)
    at, weights = np.array(x), 1.0 / np.array(sds) ** 2
    mean = weights @ at / weights.sum()
    q, freedom = float(weights @ (at - mean) ** 2), len(at) - 1
    c = weights.sum() - (weights**2).sum() / weights.sum()
    p = float(scipy.special.chdtrc(freedom, q))
    return Repeat(
        exponents=exponents,
        labels=labels,
        apart=tuple(map(float, at - mean)),
        sds=sds,
        p=p,
        spread=float(np.sqrt(max(0.0, (q - freedom) / c))),
        differs=p < FALSE_ALARM / looks,
    )


def _of(alone: tuple[Array, Array], powers: Array) -> tuple[float, float]:
    """The log of a product and its sd, of one experiment; infinite where it says nothing of it."""
    left, values, rows = np.linalg.svd(alone[0])
    seen = values > RANK_TOLERANCE * values[0]
    along = rows @ powers
    if np.linalg.norm(along[~seen]) > BLIND * np.linalg.norm(powers):
        return 0.0, np.inf
    weights = along[seen] / values[seen]
    return float(weights @ (left[:, seen].T @ alone[1])), float(np.linalg.norm(weights))
