"""Say what a campaign is and what it shows, on a screen, on a page and in tables."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bayesdrill import output_files
from bayesdrill.basics import software
from bayesdrill.campaigns.charts import places, runs_figure
from bayesdrill.campaigns.fit import PopulationFit
from bayesdrill.campaigns.fits import CheckedCampaign, write_parquet
from bayesdrill.campaigns.outcomes import Estimate, ProductPopulation
from bayesdrill.campaigns.run_pages import page_name
from bayesdrill.campaigns.runs import CampaignPlan
from bayesdrill.config.schema.campaign import SECONDS
from bayesdrill.output_files import FIGURES
from bayesdrill.report import run_report, style
from bayesdrill.report.findings import finding_sentences
from bayesdrill.report.render import as_html
from bayesdrill.report.scales import WIDTHS
from bayesdrill.report.section import (
    Badge,
    Badges,
    Link,
    Note,
    Picture,
    Section,
    Table,
    Tone,
    as_markdown,
    as_text,
    build,
    listed,
    mappings_as_csv,
    table_of,
)
from bayesdrill.results.run_folder import Folder

MOST_NAMED = 10  # runs that a sentence names


@dataclass(frozen=True, slots=True, kw_only=True)
class Alarm:
    """An alarm is about a run, a product, or both, in a sentence."""

    kind: str
    run: str = ""
    product: str = ""
    sentence: str


@dataclass(frozen=True, slots=True, kw_only=True)
class CampaignRecord:
    """The `campaign.json` of a finished campaign has these fields.

    name: the name of the campaign
    mark: digest of all that decides the population, which is kept while this is the same
    verdict: the result in one sentence
    history: drifts, changes and walks of products, in sentences
    not_used: runs that nothing could be sampled of, or whose record is bad, and why
    doubts: reasons not to believe the fits of runs
    reasons: likely reasons of runs whose pages were made
    alarms: runs and products that need a look
    population: the population of the runs, in logs of SI
    """

    name: str
    mark: str
    verdict: str
    history: tuple[str, ...]
    not_used: Mapping[str, str]
    doubts: Mapping[str, tuple[str, ...]]
    reasons: Mapping[str, str]
    alarms: tuple[Alarm, ...]
    population: PopulationFit

    @property
    def outliers(self) -> list[Alarm]:
        """Return the alarms of runs that do not belong to the others."""
        return [alarm for alarm in self.alarms if alarm.kind == "outlier"]

    @property
    def unbelievable(self) -> tuple[str, ...]:
        """Return reasons not to believe the population."""
        runs = self.population.misdescribed
        shape = "have a shape that no mixture of normal distributions follows"
        return (
            *finding_sentences(self.population.convergence.reasons),
            *([f"the draws of {named([*runs])} {shape}"] if runs else []),
        )


def concluded(
    name: str,
    mark: str,
    population: PopulationFit,
    not_used: Mapping[str, str],
    doubts: Mapping[str, tuple[str, ...]],
    misfit: Mapping[str, tuple[str, ...]],
    reasons: Mapping[str, str],
) -> CampaignRecord:
    """Return the record of a campaign; `misfit` are the reasons why residuals of runs are no noise."""
    history, alarms = list[tuple[str, str]](), list[Alarm]()
    for run in population.runs:
        if run.outlier:
            known = [*filter(None, [reasons.get(run.name), *misfit.get(run.name, ())])]
            sentence = f"{run.name} is {run.sds:.3g} sds off in {run.worst}"
            sentence = "; ".join([sentence, *known[:1]])
            alarms.append(Alarm(kind="outlier", run=run.name, sentence=sentence))
    foreign = [alarm.run for alarm in alarms]
    alarms += [
        Alarm(kind="not used", run=run, sentence=f"{run}: {reason}")
        for run, reason in not_used.items()
    ]
    for chart in population.charts:
        kind, product = chart.history.best, chart.product
        sentences = [*_histories(population, product)]
        history += sentences
        if chart.alarm:
            alarms += [
                Alarm(kind=kind, product=product, sentence=f"{finding} ({details})")
                for finding, details in sentences
            ]
    return CampaignRecord(
        name=name,
        mark=mark,
        verdict=_verdict(population, [finding for finding, _ in history], foreign, [*not_used]),
        history=tuple(f"{finding} ({details})" for finding, details in history),
        not_used=not_used,
        doubts=doubts,
        reasons=reasons,
        alarms=tuple(alarms),
        population=population,
    )


def _histories(population: PopulationFit, product: str) -> Iterator[tuple[str, str]]:
    """Yield finding and details of the drift, of each change, and of the walk of a product."""
    (history,) = (chart.history for chart in population.charts if chart.product == product)
    probability = f"probability {100 * history.probabilities[history.best]:.0f} %"
    if history.best == "drift":
        size = with_sd(history.drift, history.drift_sd)
        yield f"{product} drifts by {size} over the campaign", probability
    elif history.best == "walk":
        size = f"{100 * history.walk_sd:.2g} %"
        yield f"{product} wanders by about {size} over the campaign", probability
    for change in history.changes if history.best == "changes" else ():
        first, at, last = (population.timed[k] for k in (change.first, change.run, change.last))
        size = with_sd(change.size, change.size_sd)
        probability = f"probability {100 * change.probability:.0f} %"
        yield (
            f"{product} changes by {size} at {at}",
            f"{probability}, 90 % interval {first} to {last}",
        )


def _verdict(
    population: PopulationFit, history: list[str], foreign: list[str], not_used: list[str]
) -> str:
    """Return the verdict on a campaign in one sentence."""
    few = "too few runs have a time to see a drift"
    parts = history or ["the rig is steady" if population.charts else few]
    belong = "does not belong" if len(foreign) == 1 else "do not belong"
    parts.append(f"{named(foreign)} {belong}" if foreign else "all runs belong together")
    agrees = {p.product: p.table.agrees for p in population.populations if p.table is not None}
    wrong = [product for product, right in agrees.items() if not right]
    if agrees:
        nominal = "the nominal values"
        parts.append(f"{nominal} disagree in {listed(wrong)}" if wrong else f"{nominal} agree")
    if not_used:
        parts.append(f"not used: {named(not_used)}")
    return f"{len(population.runs)} runs: {'; '.join(parts)}"


def describe_plan(plan: CampaignPlan, notes: Sequence[str]) -> str:
    """Return what would run, and what is unusual about it, a line each."""
    spec, runs = plan.spec, plan.runs
    rigs = {run.rig for run in runs}
    many = f" of {len(rigs)} rigs" if len(rigs) > 1 else ""
    lines = [f"campaign {spec.name}: {len(runs)} runs{many}, each by {plan.base.path}"]
    times = [run.time for run in runs if run.time is not None]
    span = f"over {max(times, default=0.0) / SECONDS[spec.time_unit]:.6g} {spec.time_unit}"
    lines.append(f"times: {span}" if times else "times: none, so no drift is sought")
    lines.append(f"noted: {', '.join(spec.noted) or 'nothing'}")
    return "\n".join([*lines, *(f"note: {note}" for note in notes)])


def named(names: Sequence[str]) -> str:
    """Return the first names of a list, and how many more there are."""
    more = len(names) - MOST_NAMED
    return listed(names) if more <= 0 else f"{', '.join(names[:MOST_NAMED])} and {more} more"


def percent(log: float) -> str:
    """Return a difference of logs in percent, with its sign."""
    return f"{100 * np.expm1(log):+.2g} %"


def with_sd(mean: float, sd: float) -> str:
    """Return a difference of logs and its standard deviation, in percent."""
    return f"{percent(mean)} +- {100 * sd:.2g} %"


def _level(head: str, level: Estimate) -> dict[str, str]:
    """Return cells with a level and its standard deviation."""
    return {head: f"{np.exp(level.mean):.4g}", "+-": f"{100 * level.sd:.2g} %"}


def _following(ahead: Estimate) -> dict[str, str]:
    """Return a cell with the 90 % interval of the next run."""
    return {"next run, 90 %": f"{np.exp(ahead.low_90):.4g} to {np.exp(ahead.high_90):.4g}"}


def products_table(population: PopulationFit) -> Table:
    """Return the table of products: their population, the next run, and the nominal value."""

    def cells(p: ProductPopulation) -> dict[str, str]:
        table = p.table
        says = "" if table is None else "agrees" if table.agrees else "disagrees"
        return {
            "": p.product,
            **_level("centre", p.centre),
            "runs differ by": f"{100 * p.spread.mean:.2g} %",
            "rigs differ by": "" if p.rig_spread is None else f"{100 * p.rig_spread.mean:.2g} %",
            **_following(p.next_run),
            "nominal": "" if table is None else f"{np.exp(table.nominal):.4g}",
            "nominal is off": "" if table is None else percent(-table.offset.mean),
            "verdict": says,
        }

    return table_of(map(cells, population.populations), "", "verdict").filled()


def noted_table(population: PopulationFit) -> Table | None:
    """Return the table of noted columns, with the share of the spread that each explains."""
    lines = [
        {
            "column": effect.column,
            "product": effect.product,
            "for one sd of it": with_sd(effect.slope.mean, effect.slope.sd),
            "explains": f"{100 * effect.share.mean:.0f} %",
        }
        for effect in sorted(population.noted, key=lambda effect: -effect.share.mean)
    ]
    return table_of(lines, "column", "product") if lines else None


def rigs_table(population: PopulationFit) -> Table | None:
    """Return the table of rigs: the level of each, and its next run."""
    lines = [
        {"rig": rig.rig, "product": rig.product}
        | _level("level", rig.level)
        | _following(rig.next_run)
        for rig in population.rigs
    ]
    return table_of(lines, "rig", "product") if lines else None


TABLE_EXPLAINED = (
    "All in SI. `centre` is the level of the rig at the end of the campaign, at average noted numbers. "
    "`runs differ by` is half the width of the central 68 % of runs. The next run lies in its interval "
    "with a probability of 90 %. A nominal value agrees if more than 5 % of runs are as far off."
)
CHART = (
    "Each run by itself (bars: one standard deviation) and shrunk towards the others (dots), relative "
    "to the centre; grey: where the next run lies with 50 and 90 %."
)


def campaign_sections(
    record: CampaignRecord, ending: str = "png", links: tuple[Link, ...] = ()
) -> tuple[Section, ...]:
    """Build the sections of a campaign, the verdict first; `links` are the points of its figure."""
    population, doubts, steady = record.population, record.unbelievable, not record.alarms
    tone: Tone = "bad" if doubts else "good" if steady else "doubt"
    badge = "not to be believed" if doubts else "steady" if steady else "needs a look"
    warning = "\n".join(["DO NOT BELIEVE this population:", *(f"  {x}" for x in doubts)])
    held = population.leave_one_out
    coverage = (
        f"left out one by one, {100 * held.within_50:.0f} % of runs lie in the 50 % intervals of all "
        f"others, and {100 * held.within_90:.0f} % in the 90 % intervals"
    )
    foreign = [alarm.sentence for alarm in record.outliers]
    bad = [f"{name}: {reason}" for name, reason in record.not_used.items()]
    weak = [f"{name}: {reasons[0]}" for name, reasons in record.doubts.items()]
    badges, verdict = Badges((Badge(badge, tone),)), f"{record.verdict}."
    sections = (
        build("Verdict", badges, verdict, warning if doubts else None),
        build("Over time", "\n".join(record.history), Picture("runs", CHART, ending, links)),
        build("Products", products_table(population), Note(TABLE_EXPLAINED), coverage),
        build("Runs that do not belong", _lines(foreign[:MOST_NAMED]), brief=bool(foreign)),
        build("Noted", noted_table(population), brief=False),
        build("Rigs", rigs_table(population), brief=False),
        build("Runs that are not used", _lines(bad), brief=bool(bad)),
        build("Runs whose fit is doubtful", _lines(weak), brief=False),
    )
    return tuple(section for section in sections if section.blocks)


def _lines(sentences: list[str]) -> str:
    return "\n".join(sentences) or "none"


def screen(record: CampaignRecord) -> str:
    """Return the text for a terminal, whose last line is the verdict."""
    return "\n\n".join(as_text(campaign_sections(record)))


def write(campaign: CheckedCampaign, record: CampaignRecord, folder: Folder) -> None:
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
    links = tuple(_link(record, *point) for point in places(figure, points))
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
    """Return the link from a point to the page of its run, or how to make this page."""
    if run in record.reasons:
        return Link(x, y, run, page_name(run))
    return Link(x, y, f"{run}: bayesdrill campaign ... --page {run} makes its page")


def population_csv(population: PopulationFit) -> str:
    """Return CSV with a line for each product: all digits, in logs of SI."""
    histories = {chart.product: chart.history for chart in population.charts}
    lines = list[dict[str, object]]()
    for p in population.populations:
        ahead, history, table = p.next_run, histories.get(p.product), p.table
        lines.append(
            {
                "product": p.product,
                "centre": p.centre.mean,
                "centre_sd": p.centre.sd,
                "spread": p.spread.mean,
                "rig_spread": p.rig_spread and p.rig_spread.mean,
                "next_low_90": ahead.low_90,
                "next_low_50": ahead.low_50,
                "next_high_50": ahead.high_50,
                "next_high_90": ahead.high_90,
                "nominal": table and table.nominal,
                "agrees": table and table.agrees,
                "history": history and history.best,
                "probability": history and history.probabilities[history.best],
            }
        )
    return mappings_as_csv(lines)


def write_runs(plan: CampaignPlan, population: PopulationFit, folder: Folder) -> None:
    """Write `runs.parquet`: a row for each run, alone and in the population, in logs of SI."""
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
