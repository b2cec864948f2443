"""Run a campaign: check all records, fit each run, sample the population, and write the results."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from bayesdrill import output_files
from bayesdrill.basics import seeds, software
from bayesdrill.basics.errors import InputError, Issue, count_noun, did_you_mean
from bayesdrill.basics.json_records import as_data
from bayesdrill.basics.progress import Reporter
from bayesdrill.campaigns import fits, pages
from bayesdrill.campaigns.conclusion import CampaignRecord, concluded
from bayesdrill.campaigns.draws import CampaignDraws, FittedRun
from bayesdrill.campaigns.fit import MIN_RUNS, PopulationFit, fit_population
from bayesdrill.campaigns.fits import CheckedCampaign, Reference
from bayesdrill.campaigns.population import NominalRange, PopulationSettings
from bayesdrill.campaigns.records import KnownRecords, base_job, check_runs, digest_of, place_of
from bayesdrill.campaigns.runs import NO_PARQUET, CampaignPlan, describe_plan
from bayesdrill.config.job import Job
from bayesdrill.output_files import CAMPAIGN, DRAWS
from bayesdrill.record.formats.table import missing_package
from bayesdrill.results.provenance import RESUME, interruptions
from bayesdrill.results.run_folder import VERSION_OF, Folder, WriteMode, dump_record, load_record
from bayesdrill.tasks.remote import RefitExecutor

REFERENCE, RECORD = "reference.json", "campaign.json"
FORM = 2  # version of both files
OUTLIERS = "outliers"  # stands for all outliers in `--page`
WATCH_AGAIN = "`bayesdrill watch` continues it"


@dataclass(frozen=True, slots=True, kw_only=True)
class CampaignOutcome:
    """A finished campaign has a folder, results, and the text for the terminal, `summary`.

    `reasons` say why the results must not be believed.
    """

    folder: Path
    record: CampaignRecord
    summary: str
    reasons: tuple[str, ...]


def run_campaign(
    plan: CampaignPlan,
    output: Path,
    how: WriteMode,
    crew: RefitExecutor,
    report: Reporter,
    cached_records: KnownRecords | None = None,
    asked: Sequence[str] = (),
) -> CampaignOutcome:
    """Run a campaign with results in the folder `output`; raises `Interrupted` if stopped.

    A page is made for each run that `asked` names; the name `OUTLIERS` stands for all outliers.

    `cached_records` caches records that were read; if it is given, bad records raise no error.
    """
    _need_parquet(plan)
    names = [run.name for run in plan.runs]
    for name in asked:
        if name not in (*names, OUTLIERS):
            message = f"no run is called {name}{did_you_mean(name, names)}"
            raise InputError.at("--page", message)
    problems = None if cached_records is None else list[Issue]()
    with Folder(output, how, _marks(plan), CAMPAIGN) as folder:
        digests, notes = check_runs(plan, report, problems, cached_records)
        if len(digests) < MIN_RUNS:
            raise _too_few(plan, len(digests), problems or [])
        report.say(describe_plan(plan, notes))
        job = base_job(plan, digests)
        folder.begin(status="running", seed=plan.spec.seed, versions=software.installed_versions())
        folder.write_text("campaign.yaml", plan.source.text)

        def progress() -> str:
            done = len(list((output / DRAWS).glob("*.parquet")))
            return f"{done} of {len(plan.runs)} runs are kept in {output}"

        way_out = RESUME if cached_records is None else WATCH_AGAIN
        with interruptions(folder, progress, (InputError,), way_out):
            reference = _reference(job, folder, crew, report)
            marks = fits.draws_marks(digests, reference)
            campaign = CheckedCampaign(plan=plan, job=job, reference=reference, marks=marks)
            fits.fit_runs(campaign, output, crew, report)
            return _publish(campaign, folder, problems or [], asked, crew, report)


def _too_few(plan: CampaignPlan, count: int, reasons: list[Issue]) -> InputError:
    few = f"{count_noun(count, 'run is', 'runs are')} too few; a population needs {MIN_RUNS}"
    return InputError([plan.source.issue(("runs",), few), *reasons])


def _need_parquet(plan: CampaignPlan) -> None:
    try:
        import pyarrow  # noqa: F401
    except ImportError:
        raise missing_package(plan.source.path, NO_PARQUET, "parquet") from None


def _marks(plan: CampaignPlan) -> dict[str, str]:
    """Return by name the inputs that all runs share; they must not change, unlike the list of runs."""
    base = digest_of(repr(plan.base.data))
    versions = {f"{VERSION_OF}{name}": x for name, x in software.installed_versions().items()}
    settings = {"the seed": str(plan.spec.seed), "effort": str(plan.spec.effort)}
    return {"the base config": base, **settings, **versions}


def _reference(job: Job, folder: Folder, crew: RefitExecutor, report: Reporter) -> Reference:
    """Return the reference that `folder` stores; if there is none, find and store it."""
    path = folder.path / REFERENCE
    if path.exists():
        return load_record(path, Reference, FORM)[0]
    report.update(0.0, "searching the maximum of the base config")
    reference = fits.find_reference(job, crew)
    folder.write_text(REFERENCE, dump_record(reference, FORM))
    report.update(1.0, "")
    return reference


def _publish(
    campaign: CheckedCampaign,
    folder: Folder,
    problems: list[Issue],
    asked: Sequence[str],
    crew: RefitExecutor,
    report: Reporter,
) -> CampaignOutcome:
    """Sample the population of the fitted runs, and write all tables and pages."""
    campaign, fitted, not_used = _usable_runs(campaign, folder.path, problems)
    population, mark = _population(campaign, fitted, folder.path, report)
    outcomes = {outcome.name: outcome for outcome in population.runs}
    for run in (run for run in campaign.plan.runs if run.name in fitted):
        outcome = outcomes[run.name]
        if run.name in asked or (outcome.outlier and OUTLIERS in asked):
            pages.write_run(campaign, run, outcome, folder, crew, report)
    for name in {*asked} - {*outcomes, OUTLIERS}:
        report.say(f"{name} has no page, as none of its draws can be used")
    names = {place_of(run): run.name for run in campaign.plan.runs}
    for issue in problems:
        before = not_used.get(names[issue.place])
        not_used[names[issue.place]] = "; ".join(filter(None, (before, issue.message)))
    record = concluded(
        campaign.plan.spec.name,
        mark,
        population,
        campaign.reference.left_out,
        not_used,
        {name: run.reasons for name, run in fitted.items() if run.reasons},
        {name: run.misfit for name, run in fitted.items() if run.misfit},
        pages.known_reasons(folder.path, {name: campaign.marks[name] for name in outcomes}),
    )
    pages.write_campaign(campaign, record, folder)
    folder.write_text(RECORD, output_files.dumps_checksummed({"form": FORM, **as_data(record)}))
    folder.write_run(status="finished", files=folder.digests())
    said, why_not = pages.screen(record), (*record.unbelievable, *not_used.values())
    return CampaignOutcome(folder=folder.path, record=record, summary=said, reasons=why_not)


def _usable_runs(
    campaign: CheckedCampaign, folder: Path, problems: Sequence[Issue]
) -> tuple[CheckedCampaign, Mapping[str, FittedRun], dict[str, str]]:
    """Return the campaign with its determined products, usable runs, and why others are not used.

    Raises `InputError` if too few runs have draws.
    """
    kept = {run.name: fitted for run, fitted in fits.kept_draws(campaign, folder)}
    usable = {name: fitted for name, fitted in kept.items() if fitted.usable}
    not_used = {
        name: (*fitted.reasons, fits.BEYOND)[0]
        for name, fitted in kept.items()
        if not fitted.usable
    }
    if len(usable) < MIN_RUNS:
        reasons = [*itertools.starmap(Issue, not_used.items()), *problems]
        raise _too_few(campaign.plan, len(usable), reasons)
    return *fits.determined_products(campaign, usable), not_used


def _population(
    campaign: CheckedCampaign, fitted: Mapping[str, FittedRun], folder: Path, report: Reporter
) -> tuple[PopulationFit, str]:
    """Return the population of the runs, stored or newly sampled, and a digest of its inputs."""
    runs = tuple(run for run in campaign.plan.runs if run.name in fitted)
    products, seed = campaign.reference.products, campaign.plan.spec.seed
    settings = PopulationSettings(nominal=_nominal(campaign.job, campaign.reference))
    decisive = [
        (r.name, r.rig, r.time, dict(r.noted), campaign.marks[r.name], fitted[r.name].attempt)
        for r in runs
    ]
    mark = digest_of(repr((products, settings, seed, decisive)))
    before = kept_record(folder)
    if before is not None and before.mark == mark:
        return before.population, mark
    draws = CampaignDraws(
        products=products, runs=runs, fits=tuple(fitted[run.name] for run in runs)
    )
    rng = seeds.stream(seed, "campaign", 1)
    return fit_population(draws, settings, rng, report), mark


def kept_record(folder: Path) -> CampaignRecord | None:
    """Return the stored record of earlier results; None if it is missing or unreadable."""
    with suppress(OSError, InputError):
        return load_record(folder / RECORD, CampaignRecord, FORM)[0]
    return None


def _nominal(job: Job, reference: Reference) -> dict[str, NominalRange]:
    """Return the nominal range of each product whose parameters all have a nominal value."""
    problem, products = job.problem, dict[str, NominalRange]()
    for name, exponents in zip(reference.products, reference.exponents, strict=True):
        powers = {n: e for n, e in zip(reference.names, exponents, strict=True) if e}
        if powers.keys() <= problem.nominal.keys():
            value = sum(e * math.log(problem.nominal[n]) for n, e in powers.items())
            ends = [
                sorted(e * math.log1p(sign * problem.tolerance.get(n, 0.0)) for sign in (-1, 1))
                for n, e in powers.items()
            ]
            low, high = (value + sum(each) for each in zip(*ends, strict=True))
            products[name] = NominalRange(value=value, low=low, high=high)
    return products
