"""Judge nominal values by their distance from the posterior, if the record determines them.

Everything is in logs of the unknowns.  Quantities are the parameters, and a maximal set of
independent products of their powers that no exact symmetry changes.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

import numpy as np
import scipy
from numpy.typing import NDArray

from bayesdrill.analysis import plausibility
from bayesdrill.analysis.diagnostics import ParameterRow, Word, end_at_nominal, summarise
from bayesdrill.analysis.identifiability.information import SensitivityStudy, simple_exponents
from bayesdrill.analysis.identifiability.structure import Exponents
from bayesdrill.analysis.identifiability.study import IdentifiabilityStudy, products, study_of
from bayesdrill.basics import seeds
from bayesdrill.basics.arguments import check_arguments
from bayesdrill.basics.arrays import Array
from bayesdrill.basics.findings import Finding
from bayesdrill.config.schema.config import IdentifySpec
from bayesdrill.inference.derived import estimate
from bayesdrill.inference.posterior import Problem
from bayesdrill.sampling.ensembles import SamplingResult
from bayesdrill.sampling.mode_search import Mode

# Tail probabilities are counted up to this number of sigmas, in steps of this size.
MAX_COUNTED_SIGMA, SIGMA_STEP = 3.0, 0.25
MIN_DRAWS_BEYOND = 25  # a tail is counted if at least this number of draws lie in it
# The tail probability of a larger squared distance underflows.
MAX_SQUARED_DISTANCE = 1000.0
PRIOR_BINS = 100  # number of bins of equal mass for the density of a product under the prior


def tension(logs: Array, low: float, high: float) -> float:
    """Return sigmas between draws `logs (N,)` and the nearest value from `low` to `high`.

    The two-sided tail probability of that value is converted to sigmas of a normal distribution.  If
    too few draws lie beyond the value, a normal tail is assumed, whose sd follows from quantiles.
    """
    middle = float(np.median(logs))
    value = min(max(middle, low), high)
    side = np.sign(value - middle)
    if side == 0:
        return 0.0
    countable = -scipy.special.ndtri(min(MIN_DRAWS_BEYOND / len(logs), 0.4))
    top = min(MAX_COUNTED_SIGMA, float(countable))
    scores = np.linspace(0.0, top, max(3, round(top / SIGMA_STEP) + 1))
    places = np.abs(np.quantile(logs, scipy.special.ndtr(side * scores)) - middle)
    distance = abs(value - middle)
    if distance <= places[-1]:
        return float(np.interp(distance, places, scores))
    last = (places[-1] - places[-2]) / (scores[-1] - scores[-2])
    sd = max(float(places[-1]) / top, float(last), 1e-300)
    return top + (distance - float(places[-1])) / sd


def joint_tension(logs: Array, powers: Array, limits: Array) -> float:
    """Return sigmas between draws `logs (N, K)` of products and the nearest point within tolerance.

    Factors have `powers (K, m)` and tolerances `limits (m, 2)`.  The fraction of draws with a larger
    Mahalanobis distance, or the tail of chi-squared if these are few, is converted to sigmas.
    """
    centre, scale = logs.mean(axis=0), logs.std(axis=0)
    root = np.linalg.cholesky(np.atleast_2d(np.cov((logs / scale).T))) * scale[:, None]
    spread = np.linalg.solve(root, (logs - centre).T)
    middle = np.linalg.solve(root, centre)
    wide = limits[:, 1] > limits[:, 0]
    if wide.any():
        matrix = np.linalg.solve(root, powers[:, wide])
        nearest = scipy.optimize.lsq_linear(
            matrix, middle, bounds=(limits[wide, 0], limits[wide, 1])
        )
        middle = middle - matrix @ nearest.x
    squared = float(middle @ middle)
    beyond = int(np.sum(np.sum(spread**2, axis=0) >= squared))
    if beyond >= MIN_DRAWS_BEYOND:
        return float(-scipy.special.ndtri(0.5 * beyond / len(logs)))
    if squared > MAX_SQUARED_DISTANCE:
        return math.sqrt(squared)
    p = min(float(scipy.special.chdtrc(len(powers), squared)), MIN_DRAWS_BEYOND / len(logs))
    return float(-scipy.special.ndtri(0.5 * p))


def bits_gained(logs: Array, prior_logs: Array) -> float:
    """Return the Kullback-Leibler divergence from prior to posterior, in bits, from draws of both.

    The entropy of the posterior is estimated by spacings of its sorted draws (Ebrahimi), and the
    density of the prior by bins of equal mass.  A negative estimate is due to chance, and set to 0.
    """
    from scipy.stats import differential_entropy  # imported here, as loading takes half a second

    sd = float(logs.std()) or 1e-300
    with np.errstate(divide="ignore"):
        entropy = float(differential_entropy(logs / sd, method="ebrahimi"))
    if not np.isfinite(entropy):  # a stuck walker repeats a value often
        entropy = float(differential_entropy(np.unique(logs) / sd, method="ebrahimi"))
    edges = np.quantile(prior_logs, np.linspace(0.0, 1.0, PRIOR_BINS + 1))
    log_density = -math.log(PRIOR_BINS) - np.log(np.maximum(np.diff(edges), 1e-300))
    bins = np.clip(np.searchsorted(edges, logs) - 1, 0, PRIOR_BINS - 1)
    return max(0.0, (-(entropy + math.log(sd)) - float(log_density[bins].mean())) / math.log(2.0))


Says = Literal[
    "agrees", "disagrees", "in doubt", "not determined", "pressed against the prior", "cannot judge"
]
JUDGED: tuple[Says, ...] = ("agrees", "disagrees", "in doubt")

FALSE_ALARM = 0.01  # probability of any "disagrees" about a rig that agrees with its table
# Priors determine a product that a symmetry changes, if posterior sd / prior sd is below this limit.
MAX_BLIND_SD_RATIO = 0.25
# A prior may end at the nominal value of its unknown. Quantities that explain a larger fraction of the
# variance of this unknown are not judged. In simulations, false alarms are as rare as without ends.
MAX_EXPLAINED_BY_CUT = 0.25
PRIOR_DRAWS = 100_000  # number of draws from the prior


@dataclass(frozen=True, slots=True, kw_only=True)
class Quantity:
    """A quantity is a product of powers of the unknowns, SI, with a `nominal` value.

    `tolerance` and `deviation` of the mean are relative.  `tension` is sigmas between the posterior and
    the nearest value within tolerance.  `beyond` is the probability of values outside the tolerance, or
    None without tolerance.  `sd_ratio` is (posterior sd) / (prior sd) of the log, and `bits` the gained
    information.  An exact symmetry changes a `blind` quantity, so no record of these channels shows it.
    """

    exponents: Exponents
    nominal: float
    tolerance: tuple[float, float]
    mean: float
    sd: float
    hdi_low: float
    hdi_high: float
    deviation: float
    tension: float
    beyond: float | None
    sd_ratio: float
    bits: float
    blind: bool
    says: Says


@check_arguments
@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """A verdict judges the values of a nominal table.

    A quantity disagrees above `limit` sigmas. `joint` is sigmas between posterior and table for all
    determined products together, None if there are fewer than two. `fits` says whether the residuals
    look like noise. If not, the fit contradicts the model, and disagreement is *in doubt*. `ends` are
    ends of priors [SI], by unknown, that keep draws from passing the nominal value. Such unknowns, and
    quantities that they dominate, cannot be judged.
    """

    names: tuple[str, ...]
    parameters: tuple[Quantity, ...]
    products: tuple[Quantity, ...]
    limit: float
    joint: float | None
    fits: bool = True
    ends: Mapping[str, float] = dataclasses.field(default_factory=dict, hash=False)

    def saying(self, says: Says) -> tuple[Quantity, ...]:
        """Return the quantities with this result, each once: products, then parameters."""
        quantities = {q.exponents: q for q in (*self.products, *self.parameters)}
        return tuple(q for q in quantities.values() if q.says == says)

    @property
    def judged(self) -> tuple[Quantity, ...]:
        """Return the products that the record determines, and that no end of a prior affects."""
        return tuple(q for q in self.products if q.says in JUDGED)

    @property
    def undetermined(self) -> tuple[Quantity, ...]:
        """Return the quantities that this record leaves open, and that a better record could show."""
        return tuple(q for q in self.saying("not determined") if not q.blind)

    @property
    def far(self) -> tuple[Quantity, ...]:
        """Return quantities too far from the table for chance, even if the model is in doubt."""
        return (*self.saying("disagrees"), *self.saying("in doubt"))

    @property
    def far_together(self) -> bool:
        """Return whether the determined products together are farther away than chance explains."""
        return self.joint is not None and self.joint > self.limit

    @property
    def agrees(self) -> bool:
        """Return whether no quantity is farther from the table than chance explains."""
        return not self.far_together and not self.far


@dataclass(frozen=True, slots=True, kw_only=True)
class Judgement:
    """A judgement has a study, the verdict, and `findings` on how plausible the posterior is."""

    study: IdentifiabilityStudy
    verdict: Verdict
    findings: tuple[Finding, ...]


def judge(
    study: IdentifiabilityStudy,
    draws: Array,
    prior_draws: Array,
    nominal: Mapping[str, float],
    tolerance: Mapping[str, float],
    pressed: Collection[str],
    thresholds: IdentifySpec,
    ends: Mapping[str, float] = MappingProxyType({}),
    *,
    model_fits: bool = True,
) -> Verdict:
    """Judge the nominal table by nearly independent physical draws `(N, m)` and draws of the prior.

    Quantities with an unknown that has no nominal value are left out.  `pressed` names unknowns whose
    draws accumulate at an end of their prior.  `ends` maps unknowns to an end of the prior that keeps
    draws from passing the nominal value.
    """
    m = len(study.names)
    table = np.array([math.log(nominal.get(name, math.nan)) for name in study.names])
    tolerances = [tolerance.get(name, 0.0) for name in study.names]
    scene = _TableComparison(
        study=study,
        logs=np.log(draws) - table,
        prior_logs=np.log(prior_draws) - table,
        table=table,
        limits=np.array([(math.log1p(-x), math.log1p(x)) for x in tolerances]),
        at_end=np.array([name in pressed for name in study.names]),
        at_nominal=np.array([name in ends for name in study.names]),
        thresholds=thresholds,
        model_fits=model_fits,
    )
    units = [tuple(int(x) for x in row) for row in np.eye(m, dtype=int)[np.isfinite(table)]]
    products_shown = basis(study, nominal)
    judged = dict.fromkeys((*units, *products_shown))
    shown = {e: scene.shows(e) for e in judged}
    n_tests = 1 + sum(shown.values())  # the joint tension is a test, too
    limit = float(-scipy.special.ndtri(0.5 * FALSE_ALARM / n_tests))
    quantities = {e: scene.quantity(e, is_determined=shown[e], limit=limit) for e in judged}
    return Verdict(
        names=study.names,
        parameters=tuple(quantities[e] for e in units),
        products=tuple(quantities[e] for e in products_shown),
        limit=limit,
        joint=scene.joint([e for e in products_shown if shown[e] and not scene.is_cut_off([e])]),
        fits=model_fits,
        ends={name: end for name, end in ends.items() if name in study.names},
    )


def basis(study: IdentifiabilityStudy, among: Collection[str]) -> tuple[Exponents, ...]:
    """Return independent products of the unknowns `among` that no symmetry changes.

    Products that the record narrows come first, in order of increasing price.  The sparsest other
    products complete the set, as the record may narrow too few products of these unknowns alone.
    """
    simple = simple_exponents(len(study.names))
    simple = simple[~simple[:, [name not in among for name in study.names]].any(axis=1)]
    simple = simple[np.isfinite(study.information.bounds_of(simple))]
    before = np.array([parameter.prior_sd for parameter in study.parameters])
    # The thresholds do not matter, as the classification of these products is not used.
    best = products(study.information, before, simple, IdentifySpec())
    selected = [product.exponents for product in best if product.price < 1.0]
    for exponents in study.structure.invariants_of(among):
        if np.linalg.matrix_rank(np.array([*selected, exponents], dtype=float)) > len(selected):
            selected.append(exponents)
    return tuple(selected)


@dataclass(frozen=True, slots=True, kw_only=True)
class _TableComparison:
    """Logs of draw / nominal value are compared with `limits (m, 2)` of tolerances.

    Flags `(m,)`: draws are pressed against a prior's end (`at_end`), or cut off near the table's value.
    """

    study: IdentifiabilityStudy
    logs: Array
    prior_logs: Array
    table: Array
    limits: Array
    at_end: NDArray[np.bool_]
    at_nominal: NDArray[np.bool_]
    thresholds: IdentifySpec
    model_fits: bool

    def shows(self, exponents: Exponents) -> bool:
        """Return whether the record determines a product, by its linear bound and by the draws."""
        powers = np.array(exponents, dtype=float)
        before = np.array([parameter.prior_sd for parameter in self.study.parameters])
        bound = self.study.information.with_priors(before).bound(powers)
        linear = bound / np.linalg.norm(before * powers)
        drawn = self._sd_ratio(exponents)
        if self._blind(exponents):
            return bool(max(linear, drawn) < MAX_BLIND_SD_RATIO)
        if self.thresholds.classify(linear) == "left to the prior":
            return False
        return self.thresholds.classify(drawn) == "determined"

    def quantity(self, exponents: Exponents, *, is_determined: bool, limit: float) -> Quantity:
        logs = _combined(self.logs, exponents)
        nominal = math.exp(_combined(self.table, exponents))
        ends = np.array(exponents)[:, None] * self.limits  # tolerance of each factor
        low, high = float(ends.min(axis=1).sum()), float(ends.max(axis=1).sum())
        sigmas = tension(logs, low, high)
        return Quantity(
            exponents=exponents,
            nominal=nominal,
            tolerance=(math.expm1(low), math.expm1(high)),
            **estimate(nominal * np.exp(logs), nominal),
            tension=sigmas,
            beyond=float(np.mean((logs < low) | (logs > high))) if high > low else None,
            sd_ratio=self._sd_ratio(exponents),
            bits=bits_gained(logs, _combined(self.prior_logs, exponents)),
            blind=self._blind(exponents),
            says=self._result(exponents, is_determined=is_determined, far=sigmas > limit),
        )

    def _result(self, exponents: Exponents, *, is_determined: bool, far: bool) -> Says:
        factors = np.flatnonzero(exponents)
        alone = factors if len(factors) == 1 else factors[:0]
        cut = self.at_nominal[alone].any() or (is_determined and self.is_cut_off([exponents]))
        if cut:
            return "cannot judge"
        if self.at_end[alone].any():
            return "pressed against the prior"
        if not is_determined:
            return "not determined"
        if not far:
            return "agrees"
        return "disagrees" if self.model_fits else "in doubt"

    def joint(self, products: list[Exponents]) -> float | None:
        if len(products) < 2 or self.is_cut_off(products):
            return None
        powers = np.array(products, dtype=float)
        used = np.any(powers != 0, axis=0)
        ends = np.where(used[:, None], self.limits, 0.0)
        logs = np.where(used, self.logs, 0.0) @ powers.T
        return joint_tension(logs, powers, ends)

    def is_cut_off(self, products: Sequence[Exponents]) -> bool:
        """Return whether an end of a prior at a nominal value cuts off much of these products."""
        if not self.at_nominal.any():
            return False
        logs = np.stack([_combined(self.logs, e) for e in products], axis=-1)
        logs, at_end = logs - logs.mean(axis=0), self.logs[:, self.at_nominal]
        at_end = at_end - at_end.mean(axis=0)
        slopes, *_ = np.linalg.lstsq(logs, at_end)
        explained = np.sum((logs @ slopes) ** 2, axis=0) / np.sum(at_end**2, axis=0)
        return bool((explained > MAX_EXPLAINED_BY_CUT).any())

    def _blind(self, exponents: Exponents) -> bool:
        return not math.isfinite(self.study.information.bound(np.array(exponents, dtype=float)))

    def _sd_ratio(self, exponents: Exponents) -> float:
        before = _combined(self.prior_logs, exponents)
        return float(_combined(self.logs, exponents).std() / before.std())


def _combined(logs: Array, exponents: Exponents) -> Array:
    """Return the log of a product `(...,)`; only its factors need a nominal value."""
    used = np.flatnonzero(exponents)
    return np.asarray(logs[..., used] @ np.array(exponents, dtype=float)[used])


def reconciled(rows: Sequence[ParameterRow], verdict: Verdict) -> tuple[ParameterRow, ...]:
    """Return `rows` with the verdict's words, which also consider the priors of other unknowns."""
    judged = {verdict.names[q.exponents.index(1)]: q for q in verdict.parameters}
    words = ((row, _word(row.word, judged.get(row.name))) for row in rows)
    return tuple(dataclasses.replace(row, word=word) for row, word in words)


def _word(word: Word, quantity: Quantity | None) -> Word:
    if quantity is not None and quantity.says in JUDGED:
        return "determined"
    if quantity is not None and quantity.says == "not determined" and word == "determined":
        return "through others" if quantity.blind else "weak"
    return word


def conclude(
    problem: Problem,
    settings: IdentifySpec,
    seed: int,
    mode: Mode,
    sampled: SamplingResult,
    sensitivity: SensitivityStudy,
    *,
    fits: bool,
) -> tuple[tuple[ParameterRow, ...], Judgement | None]:
    """Return a row for each unknown, and the verdict if there is a nominal table."""
    posterior, space = problem.posterior, problem.posterior.space
    rows = summarise(problem, sampled.draws, mode, sampled.convergence)
    best = space.vector(mode.values)
    if not any(name in problem.nominal for name in sensitivity.unknowns):
        return rows, None
    study = study_of(sensitivity, posterior, best, settings, seed, "the MAP")
    draws, m = sampled.draws.reshape(-1, len(best)), len(study.names)
    prior_draws = space.draw(PRIOR_DRAWS, seeds.stream(seed, "identify", 1))
    prior_draws = prior_draws[np.isfinite(space.log_prior(prior_draws))]
    ends = {
        name: end
        for name, x in zip(study.names, draws[:, :m].T, strict=True)
        if name in problem.nominal
        and (end := end_at_nominal(x, space.priors[name], problem.nominal[name])) is not None
    }
    pressed = [row.name for row in rows if row.pressed_against is not None]
    verdict = judge(
        study,
        draws[:, :m],
        prior_draws[:, :m],
        problem.nominal,
        problem.tolerance,
        pressed,
        settings,
        ends,
        model_fits=fits,
    )
    findings = plausibility.plausibility_of_draws(problem, draws, study.information)
    findings += tuple(plausibility.plausibility_of_course(sensitivity, best))
    judged = Judgement(study=study, verdict=verdict, findings=findings)
    return reconciled(rows, verdict), judged
