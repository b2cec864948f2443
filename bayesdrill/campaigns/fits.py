"""Fit each run of a campaign, and keep the draws of its determined products in a Parquet file."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from itertools import batched
from pathlib import Path
from typing import Any

import numpy as np

from bayesdrill import output_files
from bayesdrill.analysis.identifiability.information import (
    Information,
    SensitivityStudy,
    simple_exponents,
)
from bayesdrill.analysis.identifiability.study import KnownProduct, products, study_of
from bayesdrill.basics.arrays import Array
from bayesdrill.basics.errors import InputError
from bayesdrill.basics.progress import Reporter, Silent
from bayesdrill.campaigns.draws import MOST_ATTEMPTS, FittedRun, evenly_spaced
from bayesdrill.campaigns.interim_prior import log_density_of_products
from bayesdrill.campaigns.records import digest_of, run_job
from bayesdrill.campaigns.runs import CampaignPlan, CampaignRun
from bayesdrill.config.job import Job
from bayesdrill.config.schema.config import IdentifySpec
from bayesdrill.inference.posterior import Likelihood, Posterior
from bayesdrill.inference.priors import prior_log_sd
from bayesdrill.inference.residual_checks import residual_summaries
from bayesdrill.output_files import DRAWS
from bayesdrill.report.doubts import residual_reasons
from bayesdrill.report.findings import finding_sentences
from bayesdrill.report.sections.identifiability import product
from bayesdrill.sampling.convergence import Targets
from bayesdrill.sampling.fit import FitPlan, fit
from bayesdrill.tasks.find_map import fit_plan
from bayesdrill.tasks.ladder import search
from bayesdrill.tasks.remote import RefitExecutor, packed, run_jobs

FORM = 1  # version of the files of draws
SEARCHES = 3  # searches of a run's maximum: one starts at the reference, the others at prior draws
WALKERS = 64  # upper limit of walkers (unless 4 per unknown are more), which give enough draws
BATCH = 200  # number of runs whose records are in memory at the same time
INTERIM = "log_interim"
BEYOND = "its draws lie outside the priors"


@dataclass(frozen=True, slots=True, kw_only=True)
class Reference:
    """The reference of a campaign is the posterior maximum of the base config, at `values`.

    Searches of all runs begin there.  `products`, with powers `exponents` of unknowns `names`, are
    determined by the base record without priors.  `left_out` has other products, with the reason.
    """

    names: tuple[str, ...]
    products: tuple[str, ...]
    exponents: tuple[tuple[int, ...], ...]
    values: Mapping[str, float]
    left_out: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckedCampaign:
    """The records of a campaign are checked, and its reference is known.

    job: the job of the base config
    marks: for each run whose record is good, a digest of all inputs that determine its draws
    """

    plan: CampaignPlan
    job: Job
    reference: Reference
    marks: Mapping[str, str]


def find_reference(job: Job, crew: RefitExecutor) -> Reference:
    """Find the reference; raises `InputError` if the base record determines no product."""
    mode = crew.submit(search, job.problem.posterior, fit_plan(job)).result()
    posterior = job.with_steps_at(mode).problem.posterior
    sensitivity = SensitivityStudy(posterior.likelihood)
    theta = posterior.space.vector(mode.values)
    study = study_of(
        sensitivity, posterior, theta, job.config.identify, job.config.seed, "the maximum"
    )
    prior_sd = np.array([parameter.prior_sd for parameter in study.parameters])
    chosen = shown_products(study.information, prior_sd, job.config.identify)
    if not chosen:
        message = "no product of parameters is determined by its record; see `bayesdrill identify`"
        raise InputError.at(str(job.source.path), message)
    exponents = [each.exponents for each in chosen]
    others = [
        each
        for each in study.products
        if np.linalg.matrix_rank([*exponents, each.exponents]) > len(exponents)
    ]
    return Reference(
        names=study.names,
        products=tuple(product(study.names, powers) for powers in exponents),
        exponents=tuple(exponents),
        values=mode.values,
        left_out={product(study.names, each.exponents): _why_not(each) for each in others},
    )


def shown_products(
    information: Information, prior_sd: Array, settings: IdentifySpec
) -> tuple[KnownProduct, ...]:
    """Return independent products that the record determines without the priors of other unknowns.

    So a product is not returned if only the ends of such priors make its posterior narrow.
    """
    simple = simple_exponents(len(prior_sd))
    ratio = information.bounds_of(simple) / np.linalg.norm(simple * prior_sd, axis=1)
    return products(information, prior_sd, simple[ratio < settings.determined], settings)


def _why_not(product: KnownProduct) -> str:
    """Return why a product is left out of the population."""
    if not np.isfinite(product.bound):
        return "no such record determines it, so only its priors are known"
    alone, prior = (f"{100 * sd:.2g} %" for sd in (product.bound, product.prior_sd))
    return f"its sd is {alone} from the base record alone, and {prior} from the priors"


def seed_of(plan: CampaignPlan, run: CampaignRun, attempt: int = 1) -> int:
    """Return the seed of a run, a digest of its name, the campaign's seed, and the attempt."""
    again = f" {attempt}" if attempt > 1 else ""
    return int(digest_of(f"{plan.spec.seed} {run.name}{again}"), 16)


def run_plan(plan: CampaignPlan, run: CampaignRun, job: Job, attempt: int = 1) -> FitPlan:
    """Return the plan of a run's fit: that of a calibration, with `effort` effective draws."""
    settings, given = job.config.calibration, fit_plan(job)
    effort = float(plan.spec.effort)
    targets = Targets(r_hat=job.config.sampler.r_hat, n_tau=settings.n_tau, ess=effort)
    chains = replace(
        given.chains,
        targets=targets,
        walkers=max(min(given.chains.walkers, WALKERS), 4 * len(job.problem.names)),
        max_steps=max(settings.max_steps, given.chains.max_steps),
        seed=seed_of(plan, run, attempt),
    )
    return replace(given, starts=SEARCHES, chains=chains, brief=True)


def fit_run(posterior: Posterior, plan: FitPlan, reference: Reference) -> FittedRun:
    """Fit a run in a worker process; the first search of its maximum begins at the reference."""
    names, powers = posterior.space.free, np.array(reference.exponents, dtype=float)
    columns = [names.index(name) for name in reference.names]
    posterior = started_at(posterior, reference.values)
    try:
        mode, sampled = fit(posterior, plan)
    except ValueError as error:
        none = np.zeros((0, len(powers)))
        return FittedRun(log_products=none, log_interim=none[:, 0], reasons=(str(error),))
    draws = sampled.draws.reshape(-1, len(names))
    logs = np.log(draws[evenly_spaced(len(draws))][:, columns]) @ powers.T
    priors = [posterior.space.priors[name] for name in reference.names]
    log_interim = log_density_of_products(logs, powers, priors)
    inside = np.isfinite(log_interim)  # draws at ends of priors may lie beyond the quadrature nodes
    summaries = residual_summaries(posterior.likelihood, posterior.space.vector(mode.values))
    misfit = residual_reasons(summaries)
    return FittedRun(
        log_products=logs[inside],
        log_interim=log_interim[inside],
        reasons=(*finding_sentences(sampled.convergence.reasons), *misfit),
        misfit=misfit,
    )


def started_at(posterior: Posterior, values: Mapping[str, float]) -> Posterior:
    """Return the posterior with these start `values`, except those outside their prior."""
    space = posterior.space
    unknowns = tuple(
        replace(unknown, start=x) if unknown.prior.low < x < unknown.prior.high else unknown
        for unknown in space.unknowns
        for x in [values.get(unknown.name, unknown.start)]
    )
    space = replace(space, unknowns=unknowns)
    observations, held_out = (
        tuple(observation.bind(space) for observation in group)
        for group in (posterior.likelihood.observations, posterior.likelihood.held_out)
    )
    return Posterior(space, Likelihood(observations, space, held_out), posterior.coordinates)


@dataclass(frozen=True, slots=True)
class _Stage(Silent):
    """A stage shows `progress`, the fraction of finished runs in all batches."""

    report: Reporter
    progress: Callable[[], float]

    def say(self, text: str) -> None:
        self.report.say(text)

    def update(self, fraction: float, text: str) -> None:
        if text:
            self.report.update(self.progress(), text)


def fit_runs(
    campaign: CheckedCampaign, folder: Path, crew: RefitExecutor, report: Reporter
) -> None:
    """Fit each good run whose draws in `folder` are missing or incomplete, and write its draws.

    The draws of a run do not depend on other runs.
    """
    plan, reference, marks = campaign.plan, campaign.reference, campaign.marks
    runs = [run for run in plan.runs if run.name in marks]
    attempts = dict[str, int]()  # for each run to be sampled, the number of the coming attempt
    for run in runs:
        kept = read_draws(folder, run.name, marks[run.name])
        if kept is None or not kept.complete:
            attempts[run.name] = 1 if kept is None else kept.attempt + 1
        if kept is not None and not kept.complete:
            again = f"{run.name} is sampled again, attempt {kept.attempt + 1} of {MOST_ATTEMPTS}"
            report.say(f"{again}: {(*kept.reasons, BEYOND)[0]}")
    missing = [run for run in runs if run.name in attempts]
    total, begun, done = len(runs), time.monotonic(), len(runs) - len(missing)
    first = done
    if missing:
        report.update(0.0, f"{done} of {total} runs")

    def finish(name: str, fitted: FittedRun) -> str:
        nonlocal done
        attempted = replace(fitted, attempt=attempts[name])
        write_draws(folder, name, marks[name], reference, attempted)
        done += 1
        rate = 60.0 * (done - first) / (time.monotonic() - begun)
        return f"{done} of {total} runs, {rate:.3g} a minute"

    stage = _Stage(report, lambda: max(done - first, 0.001) / len(missing))
    for batch in batched(missing, BATCH):
        made = ((run, run_job(plan, run, campaign.job.case)) for run in batch)
        jobs = {
            run.name: (
                packed(
                    each.problem.posterior, run_plan(plan, run, each, attempts[run.name]), reference
                ),
            )
            for run, each in made
        }
        run_jobs(crew, fit_run, jobs, finish, folder.parent, stage)
    report.update(1.0, "")


def draws_marks(digests: Mapping[str, str], reference: Reference) -> dict[str, str]:
    """Return, for each run, a digest of all inputs that determine its draws; see `run_digest`."""
    known = json.dumps(asdict(reference), sort_keys=True)
    return {name: digest_of(f"{digest} {known}") for name, digest in digests.items()}


def path_of(folder: Path, name: str) -> Path:
    """Return the path of a run's draws; a number is used, as the name may be no valid file name."""
    return folder / DRAWS / f"{number_of(name)}.parquet"


def number_of(name: str) -> int:
    """Return the number in the file names of a run, which is a digest of the run's name."""
    return int(digest_of(name)[:14], 16)


def write_draws(
    folder: Path, name: str, mark: str, reference: Reference, fitted: FittedRun
) -> None:
    """Write the draws of a run, a column for each log product; name and reasons are metadata."""
    import pyarrow

    columns: dict[str, Any] = dict(zip(reference.products, fitted.log_products.T, strict=True))
    about = {"form": FORM, "run": name, "mark": mark}
    about |= {"reasons": fitted.reasons, "misfit": fitted.misfit, "attempt": fitted.attempt}
    table = pyarrow.table({**columns, INTERIM: fitted.log_interim})
    table = table.replace_schema_metadata({"bayesdrill": json.dumps(about)})
    path = path_of(folder, name)
    path.parent.mkdir(exist_ok=True)
    write_parquet(path, table)


def write_parquet(path: Path, table: Any) -> None:
    """Write a pyarrow table as Parquet, so that no reader sees an incomplete file."""
    from pyarrow import BufferOutputStream, parquet

    sink = BufferOutputStream()
    parquet.write_table(table, sink)
    output_files.write(path, sink.getvalue().to_pybytes())


def read_draws(folder: Path, name: str, mark: str) -> FittedRun | None:
    """Return the draws of a run; None if they are missing, damaged, or made from other inputs."""
    from pyarrow import ArrowException, parquet

    path = path_of(folder, name)
    if not path.exists():
        return None
    try:
        with parquet.ParquetFile(path) as file:
            about = json.loads(file.schema_arrow.metadata[b"bayesdrill"])
            if (about["form"], about["run"], about["mark"]) != (FORM, name, mark):
                return None
            columns = [column.to_numpy() for column in file.read().columns]
        return FittedRun(
            log_products=np.stack(columns[:-1], axis=-1),
            log_interim=columns[-1],
            reasons=tuple(about["reasons"]),
            misfit=tuple(about["misfit"]),
            attempt=about["attempt"],
        )
    except (OSError, ValueError, KeyError, TypeError, ArrowException):
        return None


def kept_draws(campaign: CheckedCampaign, folder: Path) -> Iterator[tuple[CampaignRun, FittedRun]]:
    """Yield each fitted run with its draws."""
    for run in campaign.plan.runs:
        mark = campaign.marks.get(run.name)
        fitted = None if mark is None else read_draws(folder, run.name, mark)
        if fitted is not None:
            yield run, fitted


def determined_products(
    campaign: CheckedCampaign, fitted: Mapping[str, FittedRun]
) -> tuple[CheckedCampaign, Mapping[str, FittedRun]]:
    """Return campaign and draws with only those products that more than half of the runs determine.

    A run determines a product if sd(draws) / sd(prior) is below `determined` of `identify:`.  The
    interim prior of the remaining products is the marginal of the interim prior of all products.
    Raises `InputError` if no product remains.
    """
    reference, job = campaign.reference, campaign.job
    powers, priors = np.array(reference.exponents, dtype=float), job.problem.posterior.space.priors
    before = powers * [prior_log_sd(priors[name]) for name in reference.names]
    limits = job.config.identify.determined * np.linalg.norm(before, axis=1)
    counts = sum((run.log_products.std(axis=0) < limits).astype(int) for run in fitted.values())
    kept = [k for k, count in enumerate(counts) if 2 * count > len(fitted)]
    if len(kept) == len(powers):
        return campaign, fitted
    few = {
        reference.products[k]: f"only {count} of {len(fitted)} runs determine it"
        for k, count in enumerate(counts)
        if k not in kept
    }
    if not kept:
        message = f"no product ({', '.join(few)}) is determined by more than half of the runs"
        way_out = "leave out runs that determine none of them"
        raise InputError.at(str(job.source.path), f"{message}; {way_out}")
    draws = dict[str, FittedRun]()
    for run in campaign.plan.runs:
        if run.name in fitted:
            each = run_job(campaign.plan, run) if run.changes else job
            priors, logs = (
                each.problem.posterior.space.priors,
                fitted[run.name].log_products[:, kept],
            )
            known = [priors[name] for name in reference.names]
            density = log_density_of_products(logs, powers[kept], known)
            inside = np.isfinite(density)
            draws[run.name] = replace(
                fitted[run.name], log_products=logs[inside], log_interim=density[inside]
            )
    reduced = replace(
        reference,
        products=tuple(reference.products[k] for k in kept),
        exponents=tuple(reference.exponents[k] for k in kept),
        left_out={**reference.left_out, **few},
    )
    return replace(campaign, reference=reduced), draws
