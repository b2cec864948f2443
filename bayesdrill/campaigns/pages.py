"""Write the results of a campaign: figure, tables, page, and the pages of runs on demand."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from bayesdrill import output_files
from bayesdrill.basics import software
from bayesdrill.basics.errors import InputError
from bayesdrill.basics.progress import Reporter
from bayesdrill.campaigns import fits
from bayesdrill.campaigns.charts import relative_positions, runs_figure
from bayesdrill.campaigns.conclusion import CampaignRecord
from bayesdrill.campaigns.fit import PopulationFit
from bayesdrill.campaigns.fits import CheckedCampaign, write_parquet
from bayesdrill.campaigns.outcomes import RunOutcome
from bayesdrill.campaigns.records import run_job
from bayesdrill.campaigns.runs import CampaignPlan, CampaignRun
from bayesdrill.campaigns.sections import (
    campaign_sections,
    likely_reason,
    population_csv,
    run_sections,
)
from bayesdrill.output_files import FIGURES, PAGES
from bayesdrill.report import run_report, style
from bayesdrill.report.map_report import MapReport
from bayesdrill.report.render import as_html
from bayesdrill.report.scales import WIDTHS
from bayesdrill.report.section import Link, as_markdown, as_text
from bayesdrill.results.run_folder import Folder, dump_record, load_record
from bayesdrill.tasks import conclusions
from bayesdrill.tasks.find_map import fit_plan
from bayesdrill.tasks.ladder import search
from bayesdrill.tasks.remote import RefitExecutor

PAGE_FORM = 1  # version of the JSON file that accompanies a page


@dataclass(frozen=True, slots=True, kw_only=True)
class RunPage:
    """A page shows a run: `mark` identifies its draws, and `reason` explains why it deviates.

    The reason is empty if the run belongs to the population and its model fits.
    """

    run: str
    mark: str
    reason: str


def page_name(run: str) -> str:
    """Return the path of a run's page, relative to the folder of the campaign."""
    return f"{PAGES}/{fits.number_of(run)}.html"


def known_reasons(folder: Path, marks: Mapping[str, str]) -> dict[str, str]:
    """Return the reasons by run, from pages that were made from draws with these `marks`."""
    reasons = dict[str, str]()
    for run, mark in marks.items():
        path = (folder / page_name(run)).with_suffix(".json")
        if path.exists():
            with suppress(InputError):
                page = load_record(path, RunPage, PAGE_FORM)[0]
                reasons |= {run: page.reason} if (page.run, page.mark) == (run, mark) else {}
    return reasons


def screen(record: CampaignRecord) -> str:
    """Return the text for a terminal, whose last line is the verdict."""
    return "\n\n".join(as_text(campaign_sections(record)))


def write_campaign(campaign: CheckedCampaign, record: CampaignRecord, folder: Folder) -> None:
    """Write figure, tables and pages."""
    plan, population, output = campaign.plan, record.population, campaign.job.config.output
    place, formats = folder.path / FIGURES, output.formats_or_default
    place.mkdir(exist_ok=True)
    symbols, exponents = campaign.job.problem.symbols, campaign.reference.exponents
    figure, points = runs_figure(plan, population, exponents, symbols, WIDTHS[output.size])
    note = {"Title": record.name, "Creator": software.creator()}
    style.save(figure, place, "runs", note, formats=formats, dpi=output.dpi)
    folder.write_text("population.csv", population_csv(population))
    write_runs(plan, population, folder)
    ending = output_files.preferred_format(formats)
    links = tuple(_link(record, *point) for point in relative_positions(figure, points))
    sections = campaign_sections(record, ending, links)
    title = f"Campaign {record.name}"
    folder.write_text("summary.md", as_markdown(title, sections))
    lines = (
        ("campaign", record.name),
        ("base", str(plan.base.path)),
        ("seed", str(plan.spec.seed)),
        ("versions", software.versions_text()),
    )
    every = (*sections, run_report.made_of(lines, folder.path), run_report.cite())
    folder.write_text("report.html", as_html(title, "campaign", every, place, symbols))


def _link(record: CampaignRecord, run: str, x: float, y: float) -> Link:
    """Return a link to the page of a run, or a text that says how to make this page."""
    if run in record.reasons:
        return Link(x, y, run, page_name(run))
    return Link(x, y, f"{run}: bayesdrill campaign ... --page {run} makes its page")


def write_runs(plan: CampaignPlan, population: PopulationFit, folder: Folder) -> None:
    """Write `runs.parquet`: estimates of each run alone and in the population, in logs of SI."""
    import pyarrow

    known, runs = {run.name: run for run in plan.runs}, population.runs
    columns: dict[str, object] = {
        name: [getattr(run, name) for run in runs] for name in ("name", "rig")
    }
    columns["time"] = [known[run.name].time for run in runs]
    columns |= {c: [known[run.name].noted[c] for run in runs] for c in plan.spec.noted}
    for k, product in enumerate(population.products):
        for part in ("alone", "alone_sd", "shrunk", "shrunk_sd"):
            columns[f"{product} {part}"] = [float(getattr(run, part)[k]) for run in runs]
    for name in ("sds", "worst", "outlier"):
        columns[name] = [getattr(run, name) for run in runs]
    write_parquet(folder.path_of("runs.parquet"), pyarrow.table(columns))


def write_run(
    campaign: CheckedCampaign,
    run: CampaignRun,
    outcome: RunOutcome,
    folder: Folder,
    crew: RefitExecutor,
    report: Reporter,
) -> None:
    """Search the maximum of a run, rank the causes of a misfit, and write the page of the run.

    The page has the name of the run as its title, and links to the page of the campaign.
    """
    job, reference = run_job(campaign.plan, run), campaign.reference
    report.say(f"the page of {run.name}")
    posterior = fits.started_at(job.problem.posterior, reference.values)
    mode = crew.submit(search, posterior, fit_plan(job)).result()
    job = job.with_steps_at(mode)
    fit = conclusions.residuals(job, mode)
    causes = conclusions.causes(job, mode, fit, crew.submit, report)
    reason = likely_reason(outcome, causes)
    sections = run_sections(outcome, reference.products, reason, causes)
    shown = MapReport(job.problem, job.config, mode)
    with tempfile.TemporaryDirectory() as name:
        shown.draw(Path(name), run.name)
        page = shown.page(
            Path(name),
            *sections,
            title=f"Run {run.name}",
            parent=(f"Campaign {campaign.plan.spec.name}", "../report.html"),
        )
    path = folder.path / page_name(run.name)
    path.parent.mkdir(exist_ok=True)
    folder.write_text(page_name(run.name), page)
    record = RunPage(run=run.name, mark=campaign.marks[run.name], reason=reason)
    folder.write_text(f"{PAGES}/{path.stem}.json", dump_record(record, PAGE_FORM))
