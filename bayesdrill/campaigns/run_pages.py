"""Make the page of a run on demand: its place in the campaign, its fit, and what explains a misfit."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bayesdrill.analysis.causes import Causes
from bayesdrill.basics import software
from bayesdrill.basics.errors import InputError
from bayesdrill.basics.progress import Reporter
from bayesdrill.campaigns import fits
from bayesdrill.campaigns.fits import CheckedCampaign
from bayesdrill.campaigns.outcomes import RunOutcome
from bayesdrill.campaigns.records import run_job
from bayesdrill.campaigns.runs import CampaignRun
from bayesdrill.output_files import PAGES
from bayesdrill.report import publish
from bayesdrill.report.map_report import MapReport
from bayesdrill.report.section import build, table_of
from bayesdrill.report.sections import causes as causes_section
from bayesdrill.results.run_folder import Folder, dump_record, load_record
from bayesdrill.tasks import conclusions
from bayesdrill.tasks.find_map import fit_plan
from bayesdrill.tasks.ladder import search
from bayesdrill.tasks.remote import RefitExecutor

FORM = 1  # version of the file beside a page


@dataclass(frozen=True, slots=True, kw_only=True)
class RunPage:
    """A page shows a run with this `mark` of its draws; `reason` is why it may not belong.

    The reason is empty for a run that belongs to the others and fits.
    """

    run: str
    mark: str
    reason: str


def page_name(run: str) -> str:
    """Return the name of a run's page in the folder of its campaign."""
    return f"{PAGES}/{fits.number_of(run)}.html"


def known_reasons(folder: Path, marks: Mapping[str, str]) -> dict[str, str]:
    """Return what the pages say of runs whose draws have these marks; other pages count as none."""
    reasons = dict[str, str]()
    for run, mark in marks.items():
        path = (folder / page_name(run)).with_suffix(".json")
        if path.exists():
            with suppress(InputError):
                page = load_record(path, RunPage, FORM)[0]
                reasons |= {run: page.reason} if (page.run, page.mark) == (run, mark) else {}
    return reasons


def write_page(
    campaign: CheckedCampaign,
    run: CampaignRun,
    outcome: RunOutcome,
    folder: Folder,
    crew: RefitExecutor,
    report: Reporter,
) -> None:
    """Search the maximum of a run, rank causes if it does not fit, and write its page.

    The page has the name of the run as its title, and links to the page of the campaign.
    """
    job, reference = run_job(campaign.plan, run), campaign.reference
    report.say(f"the page of {run.name}")
    posterior = fits.started_at(job.problem.posterior, reference.values)
    mode = crew.submit(search, posterior, fit_plan(job)).result()
    job = job.with_steps_at(mode)
    left = conclusions.residuals(job, mode)
    causes = conclusions.causes(job, mode, left, crew.submit, report)
    reason = likely_reason(outcome, causes)
    numbers = (outcome.alone, outcome.alone_sd, outcome.shrunk, outcome.shrunk_sd)
    table = table_of(
        (
            {
                "": product,
                "alone": f"{np.exp(alone):.4g}",
                "+-": f"{100 * alone_sd:.2g} %",
                "in the population": f"{np.exp(shrunk):.4g}",
                "+- there": f"{100 * shrunk_sd:.2g} %",
            }
            for product, alone, alone_sd, shrunk, shrunk_sd in zip(
                reference.products, *numbers, strict=True
            )
        ),
        "",
    )
    said = f"It is {outcome.sds:.3g} sds from the other runs in {outcome.worst}."
    said += f"\nIts likely reason: {reason}." if reason else ""
    sections = (
        build("In the campaign", said, table),
        build("What would explain the misfit", *causes_section.candidates(causes)),
    )
    shown = MapReport(job.problem, job.config, mode)
    with tempfile.TemporaryDirectory() as name:
        place = Path(name) / "figures"
        place.mkdir()
        note = {"Title": run.name, "Creator": software.creator()}
        output = job.config.output
        for stem, drawing in shown.figures.items():
            looks = (shown.warning, output.formats_or_default, output.dpi)
            publish.draw(job.problem.posterior, stem, drawing, place, note, *looks)
        page = shown.page(
            Path(name),
            *(each for each in sections if each.blocks),
            title=f"Run {run.name}",
            parent=(f"Campaign {campaign.plan.spec.name}", "../report.html"),
        )
    path = folder.path / page_name(run.name)
    path.parent.mkdir(exist_ok=True)
    folder.write_text(page_name(run.name), page)
    record = RunPage(run=run.name, mark=campaign.marks[run.name], reason=reason)
    folder.write_text(f"{PAGES}/{path.stem}.json", dump_record(record, FORM))


def likely_reason(outcome: RunOutcome, causes: Causes | None) -> str:
    """Return why a run does not belong or does not fit, in words; an empty text if it does both."""
    if causes is None:
        alone = "its record fits by itself, so the rig or its state was another"
        return alone if outcome.outlier else ""
    if causes.best is None:
        return "nothing that was tried explains its record"
    return f"its record is explained by {causes.best.about}"
