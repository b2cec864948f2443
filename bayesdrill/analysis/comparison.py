"""Compare several models or experiments: which is more probable, and whether repeats agree.

Repeats: at the joint maximum each experiment alone would move the unknowns by its own slope over its
own information, nuisances taken out.  The spread beyond that is DerSimonian and Laird's (1986).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy

from bayesdrill.analysis.identifiability.information import (
    BLIND_SHARE,
    RANK_TOLERANCE,
    SensitivityStudy,
)
from bayesdrill.analysis.identifiability.structure import Exponents
from bayesdrill.analysis.plausibility import DiffusePrior
from bayesdrill.analysis.prediction import HeldOutScore, LooScore
from bayesdrill.basics.arrays import Array
from bayesdrill.basics.symbols import Symbol
from bayesdrill.inference.derived import hdi
from bayesdrill.inference.posterior import Problem
from bayesdrill.inference.residual_checks import ResidualSummary, like_noise
from bayesdrill.sampling.evidence import Evidence


@dataclass(frozen=True, slots=True, kw_only=True)
class PosteriorSummary:
    """One run under its `name`: `draws (N, D)`, SI; `settings`: what a reader compares of two runs.

    `mark`: whose files are; `warning`: of its figures, `reasons`: why it must not be believed.
    """

    name: str
    mark: str
    problem: Problem
    draws: Array
    settings: Mapping[str, str]
    warning: str = ""
    reasons: tuple[str, ...] = ()

    def draws_of(self, symbol: Symbol) -> Array | None:
        """Return the draws `(N,)` of an unknown; None where it is none of this run."""
        if symbol not in self.problem.symbols:
            return None
        return self.draws[:, self.problem.symbols.index(symbol)]


@dataclass(frozen=True, slots=True, kw_only=True)
class MarginalEstimate:
    """A run's estimate of a quantity, SI, with the narrowest interval; held fixed it has sd 0."""

    mean: float
    sd: float
    low: float
    high: float

    @property
    def fixed(self) -> bool:
        """Whether the run holds the quantity fixed."""
        return self.sd == 0.0


@dataclass(frozen=True, slots=True)
class OverlayRow:
    """An unknown of some run; `places`, `nominal`: of each run, None where it has none.

    `distance`: of the `pair` of means farthest apart, over the rms of their sds; None without two.
    """

    symbol: Symbol
    places: tuple[MarginalEstimate | None, ...]
    nominal: tuple[float | None, ...]
    distance: float | None
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


def overlay_rows(layers: Sequence[PosteriorSummary]) -> tuple[OverlayRow, ...]:
    """Return a row for each unknown of any run, in the order of the runs."""
    symbols = dict.fromkeys(symbol for layer in layers for symbol in layer.problem.symbols)
    rows = []
    for symbol in symbols:
        places = tuple(_marginal(symbol, layer) for layer in layers)
        nominal = tuple(layer.problem.nominal.get(symbol.name) for layer in layers)
        distance, pair = max(_distances(places), default=(None, None))
        rows.append(OverlayRow(symbol, places, nominal, distance, pair))
    return tuple(rows)


def _marginal(symbol: Symbol, layer: PosteriorSummary) -> MarginalEstimate | None:
    x, fixed = layer.draws_of(symbol), layer.problem.posterior.space.fixed.get(symbol.name)
    if x is not None:
        low, high = hdi(x)
        return MarginalEstimate(mean=float(x.mean()), sd=float(x.std(ddof=1)), low=low, high=high)
    return None if fixed is None else MarginalEstimate(mean=fixed, sd=0.0, low=fixed, high=fixed)


def _distances(
    places: Sequence[MarginalEstimate | None],
) -> Iterator[tuple[float, tuple[int, int]]]:
    free = [(k, each) for k, each in enumerate(places) if each is not None and each.sd > 0]
    for (k, first), (j, second) in itertools.combinations(free, 2):
        sd = math.sqrt(0.5 * (first.sd**2 + second.sd**2))
        yield abs(first.mean - second.mean) / sd, (k, j)


def differing(layers: Sequence[PosteriorSummary]) -> dict[str, tuple[str | None, ...]]:
    """Return what differs between runs, and what it is in each; None where a run has no such thing."""
    names = dict.fromkeys(name for layer in layers for name in layer.settings)
    settings = {name: tuple(layer.settings.get(name) for layer in layers) for name in names}
    return {name: values for name, values in settings.items() if len(set(values)) > 1}


SURE_LOG_ODDS = 3.0  # of log odds: twenty to one
MAX_LOG_ODDS_OF_PRIORS = 10.0  # of log odds: what priors that are too wide may take off
MAX_CHANCE_SE = 3.0  # standard errors of a difference that is none

Word = Literal["model", "noise", "both", "either", "priors", "neither"]


@dataclass(frozen=True, slots=True, kw_only=True)
class RunSummary:
    """A run among others, with its evidence.

    `rig`, `noise`: what it says of either, without priors, by which two are recognised as the same;
    `beliefs`: its priors, by unknowns; `loo`: or why there is none.
    """

    layer: PosteriorSummary
    converged: bool
    evidence: Evidence
    residuals: tuple[ResidualSummary, ...]
    vague: tuple[DiffusePrior, ...]
    rig: Mapping[str, str]
    noise: Mapping[str, str]
    beliefs: Mapping[str, str]
    held_out: HeldOutScore | None
    loo: LooScore | str

    @property
    def name(self) -> str:
        """The name of the run."""
        return self.layer.name

    @property
    def log_z(self) -> float:
        """The log evidence."""
        return self.evidence.log_z

    @property
    def like_noise(self) -> bool:
        """Whether its residuals look like noise."""
        return like_noise(self.residuals)


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelDecision:
    """Which of several models is the most probable, and by how much.

    `first`: what others are held against, `best`: the most probable; `gain`: log odds of it against
    those of the same rig (`model`), of the same noise (`noise`), or the first. `vague`: unknowns of
    models that lose by no more than priors which are too wide can make them.
    """

    word: Word
    first: int
    best: int
    gain: Mapping[str, float]
    vague: tuple[str, ...]


def decide(models: Sequence[RunSummary]) -> ModelDecision:
    """Decide between models; the first is held against all others."""
    first = models[0]
    best = max(range(len(models)), key=lambda k: models[k].log_z)
    top = models[best]

    def over(those: Callable[[RunSummary], bool]) -> float:
        return top.log_z - max((model.log_z for model in models if those(model)), default=-math.inf)

    gain = {
        "first": top.log_z - first.log_z,
        "model": over(lambda model: model.rig == first.rig),
        "noise": over(lambda model: model.noise == first.noise),
    }
    error = MAX_CHANCE_SE * math.hypot(top.evidence.error, first.evidence.error)
    word = _word(top, first, gain) if gain["first"] > SURE_LOG_ODDS + error else "neither"
    return ModelDecision(word=word, first=0, best=best, gain=gain, vague=_vague(models, top))


def _word(top: RunSummary, first: RunSummary, gain: Mapping[str, float]) -> Word:
    """Of a model that is better than the first; on what it has in common it gains nothing."""
    if top.rig == first.rig and top.noise == first.noise:
        return "priors"
    model, noise = gain["model"] > SURE_LOG_ODDS, gain["noise"] > SURE_LOG_ODDS
    if model and noise:
        return "both"
    return "model" if model else "noise" if noise else "either"


def _vague(models: Sequence[RunSummary], top: RunSummary) -> tuple[str, ...]:
    """What the best has in common with the others makes no difference, however wide it is."""
    close = [model for model in models if 0.0 < top.log_z - model.log_z < MAX_LOG_ODDS_OF_PRIORS]
    names = [
        each.name
        for model in close
        for each in model.vague
        if model.beliefs[each.name] != top.beliefs.get(each.name)
    ]
    return tuple(dict.fromkeys(names))


def probabilities(models: Sequence[RunSummary]) -> tuple[float, ...]:
    """Return each model's probability, if one is right and all were as likely before."""
    return tuple(scipy.special.softmax([model.log_z for model in models]).tolist())


def difference(
    first: HeldOutScore | LooScore, second: HeldOutScore | LooScore
) -> tuple[float, float]:
    """Return the difference of two scores of the same samples, and its standard error."""
    each = first.each - second.each
    return float(each.sum()), math.sqrt(len(each)) * float(each.std())


FALSE_ALARM = 0.01  # of sets of repeats of one rig, any product at all


@dataclass(frozen=True, slots=True, kw_only=True)
class RepeatedProduct:
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


def repeats(
    sensitivity: SensitivityStudy, theta: Array, products: Sequence[Exponents]
) -> tuple[RepeatedProduct, ...]:
    """Compare products that more than one experiment determines, at the joint maximum `theta (D,)`."""
    observations = sensitivity.likelihood.observations
    if len(observations) < 2 or not products:
        return ()
    full = sensitivity.likelihood.space.full(theta[None])
    alone = []
    for observation, rows in zip(observations, sensitivity.by_experiment(theta), strict=True):
        left = observation.whitened_jacobian_at(observation.residuals(full).samples, theta)
        alone.append((observation.label, sensitivity.local_estimate(rows, left.ravel())))
    determined = []
    for exponents in products:
        powers = np.array(exponents, dtype=float)
        each = [(label, *_product_estimate(*estimate, powers)) for label, estimate in alone]
        known = [(label, x, sd) for label, x, sd in each if np.isfinite(sd)]
        if len(known) > 1:
            determined.append((exponents, known))
    return tuple(_compared(exponents, known, len(determined)) for exponents, known in determined)


def _compared(
    exponents: Exponents, known: Sequence[tuple[str, float, float]], looks: int
) -> RepeatedProduct:
    labels, x, sds = zip(*known, strict=True)
    at, weights = np.array(x), 1.0 / np.array(sds) ** 2
    mean = weights @ at / weights.sum()
    q, freedom = float(weights @ (at - mean) ** 2), len(at) - 1
    c = weights.sum() - (weights**2).sum() / weights.sum()
    p = float(scipy.special.chdtrc(freedom, q))
    return RepeatedProduct(
        exponents=exponents,
        labels=labels,
        apart=tuple(map(float, at - mean)),
        sds=sds,
        p=p,
        spread=float(np.sqrt(max(0.0, (q - freedom) / c))),
        differs=p < FALSE_ALARM / looks,
    )


def _product_estimate(root: Array, lead: Array, powers: Array) -> tuple[float, float]:
    """The log of a product and its sd, of one experiment; infinite where it says nothing of it."""
    u, values, rows = np.linalg.svd(root)
    determined = values > RANK_TOLERANCE * values[0]
    along = rows @ powers
    if np.linalg.norm(along[~determined]) > BLIND_SHARE * np.linalg.norm(powers):
        return 0.0, np.inf
    weights = along[determined] / values[determined]
    return float(weights @ (u[:, determined].T @ lead)), float(np.linalg.norm(weights))
