"""Analyse a finished chain, or use the analysis that is stored with its run."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

import bayesdrill
from bayesdrill.analysis.causes import Causes, MapEach
from bayesdrill.analysis.diagnostics import sandwich_sds
from bayesdrill.analysis.identifiability.information import SensitivityStudy
from bayesdrill.analysis.identifiability.study import IdentifiabilityStudy
from bayesdrill.analysis.run_analysis import RunAnalysis, RunDraws, analyse
from bayesdrill.basics.equality import Value
from bayesdrill.basics.progress import SILENT, Reporter
from bayesdrill.config.building.case import ResolvedCase
from bayesdrill.config.building.experiments import EXPERIMENTS, SECTIONS
from bayesdrill.config.job import Job
from bayesdrill.config.records import sources
from bayesdrill.config.schema.config import Config
from bayesdrill.inference import residual_checks
from bayesdrill.inference.derived import product_name
from bayesdrill.inference.residual_checks import ResidualSummary
from bayesdrill.report.doubts import residual_reasons, sandwich_reasons
from bayesdrill.report.view import ReportContext
from bayesdrill.results import provenance
from bayesdrill.results.run_folder import chain_mark
from bayesdrill.sampling.convergence import Targets
from bayesdrill.sampling.ensembles import Plan, SamplingResult
from bayesdrill.sampling.mode_search import Mode
from bayesdrill.sampling.workers import WorkerPool
from bayesdrill.tasks import ranking


@dataclass(frozen=True, eq=False)
class SampledRun(Value):
    """A sampled run has a job, a maximum and a chain; `stored` is the saved analysis, if any."""

    job: Job
    mode: Mode
    sampled: SamplingResult
    stored: RunAnalysis | None = field(default=None, compare=False, kw_only=True)


def concluded(
    run: SampledRun,
    scenery: SensitivityStudy | None = None,
    seconds: Mapping[str, float] | None = None,
    *,
    is_single: bool = True,
    explain: Callable[..., Causes | None] | None = None,
    map_each: MapEach = map,
) -> ReportContext:
    """Return the context of a run's report, which analyses the chain at first use.

    `scenery` is the sensitivity study of the job's likelihood, if one exists.  If the run
    `is_single` (not one of several candidates), other rig models are tried before nominal values
    are judged wrong.  If causes are known already, `explain` returns them in place of `causes`.
    """
    job = run.job
    chain = RunDraws(job.problem, run.mode, run.sampled, job.config.seed)
    explain = explain or partial(causes, job, run.mode)
    evaluate = partial(_analysis, run, scenery, explain, map_each, is_single=is_single)
    return ReportContext(chain, job.config, evaluate, seconds or {})


def _analysis(
    run: SampledRun,
    scenery: SensitivityStudy | None,
    explain: Callable[..., Causes | None],
    map_each: MapEach,
    chain: RunDraws,
    *,
    is_single: bool,
) -> RunAnalysis:
    if run.stored is not None:
        return run.stored
    scenery = scenery or SensitivityStudy(run.job.problem.posterior.likelihood)
    ranked = explain(chain.fit) if is_single else None
    settings = run.job.config.identify
    return analyse(chain, settings, scenery, map_each, is_single=is_single, explained=ranked)


def causes(
    job: Job,
    mode: Mode,
    residuals: Sequence[ResidualSummary],
    submit: ranking.Submit | None = None,
    report: Reporter = SILENT,
) -> Causes | None:
    """Return causes that would explain the `residuals` of `mode`, or None.

    If the residuals are noise, only a value or unit that is off by a factor is sought, and only if
    unknowns are at ends of their priors.  The job must have the step sizes chosen at `mode`
    (`Job.with_steps_at`).  `submit` runs tasks in this process or in others.
    """
    ranked = None
    fits = residual_checks.like_noise(residuals)
    if not fits or mode.at_bound:
        with WorkerPool(job.problem.posterior, 1) as pool:
            how = job, mode.values, submit or pool.submit_function, report
            ranked = ranking.rank_scales(*how) if fits else ranking.rank(*how)[0]
    report.update(1.0, "")
    return ranked


def residuals(job: Job, mode: Mode) -> tuple[ResidualSummary, ...]:
    """Return the residuals of each channel at the maximum."""
    posterior = job.problem.posterior
    best = posterior.space.vector(mode.values)
    return residual_checks.residual_summaries(posterior.likelihood, best)


def doubts(job: Job, mode: Mode, study: IdentifiabilityStudy) -> tuple[str, ...]:
    """Return reasons why a bad fit invalidates the conclusions of a `study` at the maximum."""
    posterior, summaries = job.problem.posterior, residuals(job, mode)
    if residual_checks.like_noise(summaries):
        return ()
    known = [x for x in (*study.parameters, *study.products) if x.word == "determined"]
    best, limit = posterior.space.vector(mode.values), job.config.identify.determined
    sds = sandwich_sds(posterior, best, [x.exponents for x in known])
    times: dict[str, float] = {}
    for x in known:
        name, powers = product_name(study.names, x.exponents), np.array(x.exponents, dtype=float)
        sd = sds[name] / float(np.prod(best[: len(powers)] ** powers))
        times |= {name: sd / x.sd} if sd >= limit * x.prior_sd else {}
    return (*residual_reasons(summaries), *sandwich_reasons(times))


def settings(case: ResolvedCase) -> dict[str, Any]:
    """Return all entries of a config except the paths of records and the formats of figures."""
    sections = (*SECTIONS, EXPERIMENTS)
    entries = case.config.model_dump(exclude_none=True, exclude=set(sections))
    entries["output"].pop("formats", None)
    for experiment in case.experiments:
        alone = experiment.config.model_dump(exclude_none=True, include=set(SECTIONS))
        for section, key in sources.named_files(alone):
            del section[key]
        if experiment.label and (held := case.config.experiments[experiment.label].parameters):
            alone["parameters"] = held
        entries[f"experiment {experiment.label}"] = alone
    return entries | {"held out": case.held_out}


def analysis_mark(job: Job, mode: Mode, sampled: SamplingResult) -> str:
    """Return a digest of an analysis's inputs: config, record, maximum, chain and version."""
    given = {name: x for name, x in settings(job.case).items() if name != "output"}
    made_of = (
        bayesdrill.__version__,
        repr(given),
        repr(sorted(provenance.fingerprint(job.config, job.problem).items())),
        repr((dict(mode.values), mode.doubts, mode.pieces)),
        chain_mark(sampled.segments),
        repr(sampled.evidence),
    )
    return hashlib.sha256("\n".join(made_of).encode("utf-8", "replace")).hexdigest()


def plan(config: Config) -> Plan:
    """Return the sampling settings of a config."""
    sampler = config.sampler
    return Plan(
        ensembles=sampler.ensembles,
        walkers=sampler.walkers,
        moves=sampler.moves,
        targets=Targets(r_hat=sampler.r_hat, n_tau=sampler.n_tau, ess=sampler.ess),
        max_steps=sampler.max_steps,
        seed=config.seed,
    )
