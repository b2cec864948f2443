"""Evaluate a finished run once, for the tables and sentences of the report and for `run.json`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from bayesdrill.analysis import causes, diagnostics, latent_torque, plausibility
from bayesdrill.analysis.causes import Causes, EquivalentExplanation, MapEach
from bayesdrill.analysis.comparison import RepeatedProduct, repeats
from bayesdrill.analysis.diagnostics import DETERMINED_SHRINKAGE, ParameterRow
from bayesdrill.analysis.friction_motion import FrictionMotion, friction_motions
from bayesdrill.analysis.identifiability.information import SensitivityStudy
from bayesdrill.analysis.latent_torque import (
    ChannelMotion,
    TorqueEstimate,
    TorqueRegression,
    regress_torque,
)
from bayesdrill.analysis.plausibility import DiffusePrior
from bayesdrill.analysis.suspicions import InputTiming, half_sample_shift, suspicions_of_problem
from bayesdrill.analysis.verdict import Judgement, basis, conclude
from bayesdrill.basics import json_records, seeds
from bayesdrill.basics.arrays import Array
from bayesdrill.basics.equality import Value
from bayesdrill.basics.errors import ErrorCollector
from bayesdrill.basics.findings import Finding
from bayesdrill.config.schema.config import IdentifySpec
from bayesdrill.inference import derived
from bayesdrill.inference.derived import Derived, DerivedRow, product_name
from bayesdrill.inference.posterior import Problem
from bayesdrill.inference.residual_checks import (
    ResidualSummary,
    correlations,
    followed_inputs,
    like_noise,
    residual_summaries,
)
from bayesdrill.inference.step_error import StepError, step_errors
from bayesdrill.rig.models.latent_torque import TorqueLocation
from bayesdrill.sampling.convergence import Convergence
from bayesdrill.sampling.ensembles import SamplingResult
from bayesdrill.sampling.evidence import Evidence
from bayesdrill.sampling.mode_search import Mode

BAND_DRAWS, TORQUE_DRAWS = 100, 300  # numbers of draws for bands in figures, and for torques
CENTRAL_SHARES = (0.03, 0.97)  # quantiles of a torque's samples that are reported


@dataclass(frozen=True, eq=False)
class RunDraws(Value):
    """A finished run has draws; `errors` collects failures, so that remaining analyses still run."""

    problem: Problem
    mode: Mode
    sampled: SamplingResult
    seed: int
    errors: ErrorCollector = field(default_factory=ErrorCollector, compare=False)

    @cached_property
    def draws(self) -> Array:
        """Return the draws `(N, D)` of all ensembles."""
        return self.sampled.draws.reshape(-1, self.sampled.draws.shape[-1])

    @cached_property
    def best(self) -> Array:
        """Return the MAP `(D,)`, physical."""
        return self.problem.posterior.space.vector(self.mode.values)

    @cached_property
    def fit(self) -> tuple[ResidualSummary, ...]:
        """Return the residuals of each channel at the MAP."""
        return residual_summaries(self.problem.posterior.likelihood, self.best)

    def thinned(self, n: int) -> Array:
        """Return at most `n` draws `(n, D)`, evenly spaced."""
        return self.draws[:: max(1, -(-len(self.draws) // n))]

    @cached_property
    def friction_motions(self) -> tuple[tuple[FrictionMotion, ...], ...]:
        """Return the motions at the frictions of each experiment; empty if the rig has none."""
        if not self.problem.model.frictions:
            return ()
        return friction_motions(self.problem.posterior, self.best, self.thinned(BAND_DRAWS))

    @cached_property
    def torque_estimates(self) -> tuple[TorqueEstimate, ...]:
        """Return the missing torque of each experiment; empty if none is missing."""
        draws, rng = self.thinned(TORQUE_DRAWS), seeds.stream(self.seed, "torque")
        return latent_torque.torque_estimates(self.problem.posterior, draws, rng)

    @property
    def nothing_derived(self) -> Derived:
        """Return an empty set of derived quantities."""
        values = np.empty((*self.sampled.draws.shape[:2], 0))
        return Derived(symbols=(), values=values, nominal={})

    @cached_property
    def _derived(self) -> dict[tuple[tuple[int, ...], ...], Derived]:
        return {}  # keys are the products that are included

    def derived(self, judged: Judgement | None) -> Derived:
        """Return derived quantities, with the products of a verdict; an empty set after an error."""
        verdict = () if judged is None else judged.verdict.products
        products = tuple(quantity.exponents for quantity in verdict)
        if products not in self._derived:
            problem, draws = self.problem, self.sampled.draws
            result = self.nothing_derived
            with self.errors.collect("derived quantities"):
                following = derived.derive(problem, draws)
                result = derived.with_products(following, problem, draws, products)
            self._derived[products] = result
        return self._derived[products]


@dataclass(frozen=True, slots=True, kw_only=True)
class TorqueSummary:
    """A summary describes the missing torque of one experiment, N m.

    The expected torque is between `low` and `high` in 94 % of the samples, and `rms` is its root mean
    square. `width` is the mean half-width of the draws' band, and `sd` their mean sd. `sure` is the
    fraction of samples with a sure sign, `turning` that of samples at which the inertia turns.
    """

    label: str
    at: TorqueLocation
    low: float
    high: float
    width: float
    rms: float
    sd: float
    sure: float
    turning: float
    follows: tuple[TorqueRegression, ...]
    courses: tuple[ChannelMotion, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class RunAnalysis:
    """The analysis of a finished run is kept in `run.json`; `numbers` returns its values by name.

    unknowns: summary of the draws of each unknown [its own unit, SI]
    fit: residuals of each channel at the MAP [sd of the noise]
    inputs: inputs that residuals follow, if the fit leaves more than noise
    sandwich: sds of unknowns and products that allow for a misfit [its own unit, SI]
    judged: identifiability, and the verdict if there is a table [SI, sigma, natural logs]
    repeats: products of unknowns, estimated from each of several experiments [natural logs]
    causes: possible causes of a fit that leaves more than noise [SI]
    instead: missing parameter with which the nominal table would explain the record [SI]
    derived: summary of derived quantities [its own unit, SI]
    meanings: meanings of derived quantities, by name
    convergence: agreement of the ensembles [steps, draws]
    acceptance: share of accepted proposals of each ensemble [1]
    failures: proposals inside the prior that had no finite response [1]
    evidence: log probability of the record under the model [natural log]
    vague: priors that are too wide for a comparison of evidences [decades, 1]
    leaning: unknowns that are determined by the priors of others alone
    step_errors: errors that time steps cause at the MAP [sd of the noise]
    torques: the missing torque of each experiment [N m]
    moment: shifts of unknowns by inputs half a sample later [s, sd of the unknown]
    course: friction that drives instead of braking
    rig: mistakes in roles and gear of the rig
    suspicions: possible mistakes in columns, units and sensors of the record
    """

    unknowns: tuple[ParameterRow, ...]
    fit: tuple[ResidualSummary, ...]
    inputs: tuple[Finding, ...]
    sandwich: Mapping[str, float]
    judged: Judgement | None
    repeats: tuple[RepeatedProduct, ...]
    causes: Causes | None
    instead: EquivalentExplanation | None
    derived: tuple[DerivedRow, ...]
    meanings: Mapping[str, str]
    convergence: Convergence
    acceptance: tuple[float, ...]
    failures: int
    evidence: Evidence | None
    vague: tuple[DiffusePrior, ...]
    leaning: Mapping[str, tuple[str, ...]]
    step_errors: tuple[StepError, ...]
    torques: tuple[TorqueSummary, ...]
    moment: InputTiming | None
    course: tuple[Finding, ...]
    rig: tuple[Finding, ...]
    suspicions: tuple[Finding, ...]

    @property
    def numbers(self) -> Mapping[str, Any]:
        """Return all numbers by names such as `unknowns.k_s.mean` and `evidence.log_z`."""
        return dict(json_records.leaves(json_records.as_data(self)))

    @property
    def unsupported(self) -> Mapping[str, float]:
        """Return (sandwich sd) / sd of quantities that a sandwich sd would leave undetermined."""
        ratios = {u.name: (u.sd, 1 - u.shrinkage) for u in self.unknowns if u.word == "determined"}
        if self.judged is not None:
            verdict = self.judged.verdict
            for q in (*verdict.saying("agrees"), *verdict.far):
                ratios[product_name(verdict.names, q.exponents)] = q.sd, q.sd_ratio
        times = {n: self.sandwich.get(n, 0.0) / sd for n, (sd, _) in ratios.items() if sd > 0}
        return {n: x for n, x in times.items() if x * ratios[n][1] >= 1 - DETERMINED_SHRINKAGE}

    @classmethod
    def describe(cls, name: str) -> str:
        """Describe the number of this name, with its unit; raise `KeyError` for an unknown name."""
        field = json_records.field_descriptions(cls)[name.partition(".")[0]]
        unit = f" [{field['unit']}]" if "unit" in field else ""
        return field["description"] + unit


def analyse(
    run: RunDraws,
    settings: IdentifySpec,
    sensitivity: SensitivityStudy,
    map_each: MapEach = map,
    *,
    is_single: bool = True,
    explained: Causes | None = None,
) -> RunAnalysis:
    """Evaluate the `RunAnalysis` of a finished run, without sampling.

    If the run `is_single`, effects that the rig may lack are tried before the table is called wrong.
    """
    problem, sampled, best = run.problem, run.sampled, run.best
    posterior = problem.posterior
    fits = like_noise(run.fit)
    rows, judged = conclude(problem, settings, run.seed, run.mode, sampled, sensitivity, fits=fits)
    blamed = is_single and judged is not None and bool(judged.verdict.far)
    products = () if judged is None else basis(judged.study, judged.study.names)
    compared = () if judged is None else [q.exponents for q in judged.verdict.products]
    quantities = run.derived(judged)
    derived_rows: tuple[DerivedRow, ...] = ()
    with run.errors.collect("derived quantities"):
        derived_rows = derived.summarise(quantities)
    return RunAnalysis(
        unknowns=rows,
        fit=run.fit,
        inputs=() if fits else followed_inputs(correlations(posterior.likelihood, best)),
        sandwich={} if fits else diagnostics.sandwich_sds(posterior, best, compared),
        judged=judged,
        repeats=repeats(sensitivity, best, products),
        causes=explained,
        instead=causes.equivalent_explanation(problem, best, map_each) if blamed else None,
        derived=derived_rows,
        meanings={symbol.name: symbol.meaning for symbol in quantities.symbols},
        convergence=sampled.convergence,
        acceptance=tuple(map(float, sampled.acceptance)),
        failures=sampled.failures,
        evidence=sampled.evidence,
        vague=tuple(plausibility.diffuse_priors(run.draws, posterior.space.priors)),
        leaning=diagnostics.prior_dependence(rows, run.draws),
        step_errors=step_errors(posterior.likelihood, best),
        torques=tuple(map(torque_summary, run.torque_estimates)),
        # A shift of inputs can be judged only if the residuals look like noise.
        moment=half_sample_shift(sensitivity, best) if fits else None,
        course=tuple(plausibility.plausibility_of_course(sensitivity, best)),
        rig=(*plausibility.of_roles(problem), *plausibility.plausibility_of_gear(problem)),
        suspicions=tuple(suspicions_of_problem(problem)),
    )


def torque_summary(estimate: TorqueEstimate) -> TorqueSummary:
    """Summarise the missing torque of one experiment."""
    low, high = np.quantile(estimate.expected, CENTRAL_SHARES)
    band = estimate.band
    return TorqueSummary(
        label=estimate.label,
        at=estimate.location,
        low=float(low),
        high=float(high),
        width=float(np.mean(band[1] - band[0]) / 2),
        rms=float(np.sqrt(np.mean(estimate.expected**2))),
        sd=float(estimate.draws.std(axis=0).mean()),
        sure=float(np.mean((band[0] > 0) | (band[1] < 0))),
        turning=float(estimate.turning.mean()),
        follows=regress_torque(estimate),
        courses=estimate.courses,
    )
