"""Compare several models or experiments: which is more probable, and whether repeats agree.

Repeats are compared at the joint maximum: from there, a Gauss-Newton step with the samples of one
experiment gives its own estimate.  The spread of estimates follows DerSimonian and Laird (1986).
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
from bayesdrill.basics.findings import Finding
from bayesdrill.basics.symbols import Symbol
from bayesdrill.inference.derived import hdi
from bayesdrill.inference.posterior import Problem
from bayesdrill.inference.residual_checks import ResidualSummary, like_noise
from bayesdrill.sampling.evidence import Evidence


@dataclass(frozen=True, slots=True, kw_only=True)
class PosteriorSummary:
    """A summary of one run has its `name`, `draws (N, D)`, SI, and `settings` for comparison.

    `mark` identifies the results.  Figures show `warning`; `reasons` say why results are doubtful.
    """

    name: str
    mark: str
    problem: Problem
    draws: Array
    settings: Mapping[str, str]
    warning: str = ""
    reasons: tuple[str, ...] = ()

    def draws_of(self, symbol: Symbol) -> Array | None:
        """Return the draws `(N,)` of an unknown, or None if this run has no such unknown."""
        if symbol not in self.problem.symbols:
            return None
        return self.draws[:, self.problem.symbols.index(symbol)]


@dataclass(frozen=True, slots=True, kw_only=True)
class MarginalEstimate:
    """A run estimates a quantity, SI, by mean, sd and HDI; a fixed quantity has the sd 0."""

    mean: float
    sd: float
    low: float
    high: float

    @property
    def fixed(self) -> bool:
        """Return whether the run holds the quantity fixed."""
        return self.sd == 0.0


@dataclass(frozen=True, slots=True)
class OverlayRow:
    """A row has the estimate (`places`) and `nominal` value of an unknown in each run, None if absent.

    `distance` is |difference| / (rms of both sds) for the `pair` of means farthest apart, or None.
    """

    symbol: Symbol
    places: tuple[MarginalEstimate | None, ...]
    nominal: tuple[float | None, ...]
    distance: float | None
    pair: tuple[int, int] | None

    @property
    def agreed(self) -> float | None:
        """Return the nominal value if it is the same in all runs that have one, otherwise None."""
        known = {value for value in self.nominal if value is not None}
        return known.pop() if len(known) == 1 else None

    @property
    def shared(self) -> bool:
        """Return whether the symbol is an unknown of at least two runs."""
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
    estimates: Sequence[MarginalEstimate | None],
) -> Iterator[tuple[float, tuple[int, int]]]:
    free = [(k, place) for k, place in enumerate(estimates) if place is not None and place.sd > 0]
    for (k, first), (j, second) in itertools.combinations(free, 2):
        sd = math.sqrt(0.5 * (first.sd**2 + second.sd**2))
        yield abs(first.mean - second.mean) / sd, (k, j)


def differing(layers: Sequence[PosteriorSummary]) -> dict[str, tuple[str | None, ...]]:
    """Return settings that differ between runs, with the value in each run, None if absent."""
    names = dict.fromkeys(name for layer in layers for name in layer.settings)
    settings = {name: tuple(layer.settings.get(name) for layer in layers) for name in names}
    return {name: values for name, values in settings.items() if len(set(values)) > 1}


SURE_LOG_ODDS = 3.0  # log odds above which a model is preferred, about ln 20
MAX_LOG_ODDS_OF_PRIORS = 10.0  # upper limit of the log odds that too wide priors alone can cost
MAX_CHANCE_SE = 3.0  # largest difference of equal evidences by chance, in standard errors

Word = Literal["model", "noise", "both", "either", "priors", "neither"]


@dataclass(frozen=True, slots=True, kw_only=True)
class RunSummary:
    """A run is compared with others by its evidence and scores.

    Runs have the same rig if their settings `rig` are equal, and likewise for `noise`.  The priors of
    the unknowns are in `beliefs`, by name.  `loo` is a score, or the reason why there is none.
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
    loo: LooScore | Finding

    @property
    def name(self) -> str:
        """Return the name of the run."""
        return self.layer.name

    @property
    def log_z(self) -> float:
        """Return the log evidence."""
        return self.evidence.log_z

    @property
    def like_noise(self) -> bool:
        """Return whether the residuals look like noise."""
        return like_noise(self.residuals)


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelDecision:
    """A decision says which of several models is the most probable, and by how much.

    `first` and `best` are indices of the reference and of the most probable model. `gain` has the log
    odds of `best` against the reference ("first"), and against the best model with the reference's rig
    ("model") or noise ("noise").  Wide priors of `vague` unknowns alone may be decisive.
    """

    word: Word
    first: int
    best: int
    gain: Mapping[str, float]
    vague: tuple[str, ...]


def decide(models: Sequence[RunSummary]) -> ModelDecision:
    """Decide between models, of which the first is the reference."""
    first = models[0]
    best = max(range(len(models)), key=lambda k: models[k].log_z)
    top = models[best]

    def over(selects: Callable[[RunSummary], bool]) -> float:
        others = (model.log_z for model in models if selects(model))
        return top.log_z - max(others, default=-math.inf)

    gain = {
        "first": top.log_z - first.log_z,
        "model": over(lambda model: model.rig == first.rig),
        "noise": over(lambda model: model.noise == first.noise),
    }
    error = MAX_CHANCE_SE * math.hypot(top.evidence.error, first.evidence.error)
    word = _decision_word(top, first, gain) if gain["first"] > SURE_LOG_ODDS + error else "neither"
    # Models slightly worse than the best may have lost only by wide priors that the best lacks.
    close = [model for model in models if 0.0 < top.log_z - model.log_z < MAX_LOG_ODDS_OF_PRIORS]
    vague = {
        prior.name: None
        for model in close
        for prior in model.vague
        if model.beliefs[prior.name] != top.beliefs.get(prior.name)
    }
    return ModelDecision(word=word, first=0, best=best, gain=gain, vague=tuple(vague))


def _decision_word(top: RunSummary, first: RunSummary, gain: Mapping[str, float]) -> Word:
    """Return what makes the best model better than the first: rig, noise, both, either or priors."""
    if top.rig == first.rig and top.noise == first.noise:
        return "priors"
    model, noise = gain["model"] > SURE_LOG_ODDS, gain["noise"] > SURE_LOG_ODDS
    if model and noise:
        return "both"
    return "model" if model else "noise" if noise else "either"


def probabilities(models: Sequence[RunSummary]) -> tuple[float, ...]:
    """Return each model's probability, if one of them is right and all are equally likely a priori."""
    return tuple(scipy.special.softmax([model.log_z for model in models]).tolist())


def difference(
    first: HeldOutScore | LooScore, second: HeldOutScore | LooScore
) -> tuple[float, float]:
    """Return the difference of two scores of the same samples, and its standard error."""
    terms = first.terms - second.terms
    return float(terms.sum()), math.sqrt(len(terms)) * float(terms.std())


FALSE_ALARM = 0.01  # probability that repeats of one rig differ by chance in any product


@dataclass(frozen=True, slots=True, kw_only=True)
class RepeatedProduct:
    """A product of powers is estimated by each of several experiments, named by `labels`.

    `apart` are deviations of its log from the mean, with standard deviations `sds`.  `p` is the
    p-value of their chi squared.  `spread` is the sd between experiments that `sds` do not explain.
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
    """Compare products that two or more experiments determine, at the joint maximum `theta (D,)`."""
    observations = sensitivity.likelihood.observations
    if len(observations) < 2 or not products:
        return ()
    full = sensitivity.likelihood.space.full(theta[None])
    alone = []
    for observation, rows in zip(observations, sensitivity.by_experiment(theta), strict=True):
        whitened = observation.whitened_jacobian_at(observation.residuals(full).samples, theta)
        alone.append((observation.label, sensitivity.local_estimate(rows, whitened.ravel())))
    determined = []
    for exponents in products:
        powers = np.array(exponents, dtype=float)
        estimates = [(label, *_product_estimate(*estimate, powers)) for label, estimate in alone]
        known = [(label, x, sd) for label, x, sd in estimates if np.isfinite(sd)]
        if len(known) > 1:
            determined.append((exponents, known))
    return tuple(_compared(exponents, known, len(determined)) for exponents, known in determined)


def _compared(
    exponents: Exponents, known: Sequence[tuple[str, float, float]], looks: int
) -> RepeatedProduct:
    labels, x, sds = zip(*known, strict=True)
    logs, weights = np.array(x), 1.0 / np.array(sds) ** 2
    mean = weights @ logs / weights.sum()
    q, freedom = float(weights @ (logs - mean) ** 2), len(logs) - 1
    c = weights.sum() - (weights**2).sum() / weights.sum()
    p = float(scipy.special.chdtrc(freedom, q))
    return RepeatedProduct(
        exponents=exponents,
        labels=labels,
        apart=tuple(map(float, logs - mean)),
        sds=sds,
        p=p,
        spread=float(np.sqrt(max(0.0, (q - freedom) / c))),
        differs=p < FALSE_ALARM / looks,
    )


def _product_estimate(root: Array, lead: Array, powers: Array) -> tuple[float, float]:
    """Return one experiment's estimate of the log of a product, and its sd, infinite if unknown."""
    u, values, rows = np.linalg.svd(root)
    determined = values > RANK_TOLERANCE * values[0]
    along = rows @ powers
    if np.linalg.norm(along[~determined]) > BLIND_SHARE * np.linalg.norm(powers):
        return 0.0, np.inf
    weights = along[determined] / values[determined]
    return float(weights @ (u[:, determined].T @ lead)), float(np.linalg.norm(weights))
