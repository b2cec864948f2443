"""Say what a campaign is and what it shows, on a screen, on a page and in tables."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from bayesdrill import output_files
from bayesdrill.basics import software
from bayesdrill.campaigns.charts import runs_figure
from bayesdrill.campaigns.fit import PopulationFit
from bayesdrill.campaigns.fits import Reference
from bayesdrill.campaigns.outcomes import Estimate, ProductPopulation
from bayesdrill.campaigns.records import CheckedRuns
from bayesdrill.campaigns.runs import CampaignPlan
from bayesdrill.config.job import Job
from bayesdrill.config.schema.campaign import SECONDS
from bayesdrill.output_files import FIGURES
from bayesdrill.report import run_report, style
from bayesdrill.report.findings import finding_sentences
from bayesdrill.report.render import as_html
from bayesdrill.report.scales import WIDTHS
from bayesdrill.report.section import (
    Badge,
    Badges,
    Note,
    Picture,
    Section,
    Table,
    Tone,
    as_markdown,
    as_text,
    build,
    lines_as_csv,
    listed,
    table_of,
)
from bayesdrill.results.run_folder import Folder

MOST_NAMED = 10  # runs that a sentence names


@dataclass(frozen=True, slots=True, kw_only=True)
class Alarm:
    """An alarm is about a run, a product, or both, in a sentence."""

    kind: str
    run: str
    product: str
    sentence: str


@dataclass(frozen=True, slots=True, kw_only=True)
class CampaignRecord:
    """The `campaign.json` of a finished campaign has these fields.

    name: the name of the campaign
    verdict: the result in one sentence
    not_used: runs that nothing could be sampled of, or whose record is bad, and why
    doubts: reasons not to believe the fits of runs
    misfit: runs whose residuals are more than noise, and why
    alarms: runs and products that need a look
    population: the population of the runs, in logs of SI
    """

    name: str
    verdict: str
    not_used: Mapping[str, str]
    doubts: Mapping[str, tuple[str, ...]]
    misfit: Mapping[str, tuple[str, ...]]
    alarms: tuple[Alarm, ...]
    population: PopulationFit


def describe_plan(plan: CampaignPlan, checked: CheckedRuns) -> str:
    """Return what would run, and what is unusual about it, a line each."""
    spec, runs = plan.spec, plan.runs
    rigs = {run.rig for run in runs}
    many = f" of {len(rigs)} rigs" if len(rigs) > 1 else ""
    lines = [f"campaign {spec.name}: {len(runs)} runs{many}, each by {plan.base.path}"]
    times = [run.time for run in runs if run.time is not None]
    span = f"over {max(times, default=0.0) / SECONDS[spec.time_unit]:.6g} {spec.time_unit}"
    lines.append(f"times: {span}" if times else "times: none, so no drift is sought")
    lines.append(f"noted: {', '.join(spec.noted) or 'nothing'}")
    return "\n".join([*lines, *(f"note: {note}" for note in checked.notes)])


def named(names: list[str]) -> str:
    """Return the first names of a list, and how many more there are."""
    more = len(names) - MOST_NAMED
    return listed(names) if more <= 0 else f"{', '.join(names[:MOST_NAMED])} and {more} more"


def percent(log: float) -> str:
    """Return a difference of logs in percent, with its sign."""
    return f"{100 * np.expm1(log):+.2g} %"


def with_sd(mean: float, sd: float) -> str:
    """Return a difference of logs and its standard deviation, in percent."""
    return f"{percent(mean)} +- {100 * sd:.2g} %"


def between(estimate: Estimate) -> str:
    """Return the 90 % interval of a product whose log has this estimate."""
    return f"{np.exp(estimate.low_90):.4g} to {np.exp(estimate.high_90):.4g}"


def outliers(population: PopulationFit) -> list[str]:
    """Return the names of runs that do not belong to the population."""
    return [run.name for run in population.runs if run.outlier]


def population_reasons(population: PopulationFit) -> tuple[str, ...]:
    """Return reasons not to believe a population."""
    few = []
    if population.resample:
        names = named([*population.resample])
        few = [
            f"the draws of {names} hardly reach the population, so that their weights are uneven"
        ]
    return (*finding_sentences(population.convergence.reasons), *few)


def history_sentences(population: PopulationFit) -> Iterator[tuple[str, str, str]]:
    """Yield product, finding and details of each drift, change and walk of a product."""
    for chart in population.charts:
        history, product = chart.history, chart.product
        probability = f"probability {100 * history.probabilities[history.best]:.0f} %"
        if history.best == "drift":
            size = with_sd(history.drift, history.drift_sd)
            yield product, f"{product} drifts by {size} over the campaign", probability
        elif history.best == "changes":
            for change in history.changes:
                moment = (change.first, change.run, change.last)
                first, at, last = (population.timed[k] for k in moment)
                size = with_sd(change.size, change.size_sd)
                details = (
                    f"probability {100 * change.probability:.0f} %, 90 % interval {first} to {last}"
                )
                yield product, f"{product} changes by {size} at {at}", details
        elif history.best == "walk":
            size = f"{100 * history.walk_sd:.2g} %"
            yield product, f"{product} wanders by about {size} over the campaign", probability


def outlier_sentences(
    population: PopulationFit, misfit: Mapping[str, tuple[str, ...]]
) -> Iterator[tuple[str, str]]:
    """Yield name and sentence of each run that does not belong to the population."""
    for run in population.runs:
        if run.outlier:
            why = f"; {misfit[run.name][0]}" if run.name in misfit else ""
            yield run.name, f"{run.name} is {run.sds:.3g} sds off in {run.worst}{why}"


def say_alarms(
    population: PopulationFit, misfit: Mapping[str, tuple[str, ...]], not_used: Mapping[str, str]
) -> Iterator[Alarm]:
    """Yield an alarm for each foreign run, bad record, and product whose level is not constant."""
    for name, sentence in outlier_sentences(population, misfit):
        yield Alarm(kind="outlier", run=name, product="", sentence=sentence)
    for name, reason in not_used.items():
        yield Alarm(kind="not used", run=name, product="", sentence=f"{name}: {reason}")
    kinds = {chart.product: chart.history.best for chart in population.charts if chart.alarm}
    for product, finding, details in history_sentences(population):
        if product in kinds:
            sentence = f"{finding} ({details})"
            yield Alarm(kind=kinds[product], run="", product=product, sentence=sentence)


def describe_population(population: PopulationFit, not_used: Mapping[str, str]) -> str:
    """Return the verdict on a campaign in one sentence."""
    parts = [finding for _, finding, _ in history_sentences(population)]
    if not parts:
        few = "too few runs have a time to see a drift"
        parts = ["the rig is steady" if population.charts else few]
    foreign, tables = (
        outliers(population),
        [p for p in population.populations if p.table is not None],
    )
    belong = "does not belong" if len(foreign) == 1 else "do not belong"
    parts.append(f"{named(foreign)} {belong}" if foreign else "all runs belong together")
    wrong = [p.product for p in tables if p.table is not None and not p.table.agrees]
    if tables:
        parts.append(f"the table disagrees in {listed(wrong)}" if wrong else "the table agrees")
    if not_used:
        parts.append(f"not used: {named([*not_used])}")
    return f"{len(population.runs)} runs: {'; '.join(parts)}"


def products_table(population: PopulationFit) -> Table:
    """Return the table of products: their population, the next run, and the nominal value."""

    def cells(p: ProductPopulation) -> dict[str, str]:
        table = p.table
        says = "" if table is None else "agrees" if table.agrees else "disagrees"
        return {
            "": p.product,
            "centre": f"{np.exp(p.centre.mean):.4g}",
            "+-": f"{100 * p.centre.sd:.2g} %",
            "runs differ by": f"{100 * p.spread.mean:.2g} %",
            "rigs differ by": "" if p.rig_spread is None else f"{100 * p.rig_spread.mean:.2g} %",
            "next run, 90 %": between(p.next_run),
            "nominal": "" if table is None else f"{np.exp(table.nominal):.4g}",
            "nominal is off": "" if table is None else percent(-table.offset.mean),
            "verdict": says,
        }

    return table_of(map(cells, population.populations), "", "verdict").filled()


def noted_table(population: PopulationFit) -> Table | None:
    """Return the table of noted columns, with the share of the spread that each explains."""
    if not population.noted:
        return None
    lines = (
        {
            "column": effect.column,
            "product": effect.product,
            "for one sd of it": with_sd(effect.slope.mean, effect.slope.sd),
            "explains": f"{100 * effect.share.mean:.0f} %",
        }
        for effect in sorted(population.noted, key=lambda effect: -effect.share.mean)
    )
    return table_of(lines, "column", "product")


def rigs_table(population: PopulationFit) -> Table | None:
    """Return the table of rigs: the level of each, and its next run."""
    if not population.rigs:
        return None
    return table_of(
        (
            {
                "rig": level.rig,
                "product": level.product,
                "level": f"{np.exp(level.level.mean):.4g}",
                "+-": f"{100 * level.level.sd:.2g} %",
                "next run, 90 %": between(level.next_run),
            }
            for level in population.rigs
        ),
        "rig",
        "product",
    )


TABLE_EXPLAINED = (
    "All in SI. `centre` is the level of the rig at the end of the campaign, at average noted numbers. "
    "`runs differ by` is half the width of the central 68 % of runs. The next run lies in its interval "
    "with a probability of 90 %. The table agrees if more than 5 % of runs are as far off as it is."
)
CHART = (
    "Each run by itself (bars: one standard deviation) and shrunk towards the others (dots), relative "
    "to the centre; grey: where the next run lies with 50 and 90 %."
)


def campaign_sections(record: CampaignRecord, ending: str) -> tuple[Section, ...]:
    """Build the sections of a campaign, the verdict first."""
    population = record.population
    doubts = population_reasons(population)
    steady = not record.alarms
    tone: Tone = "bad" if doubts else "good" if steady else "doubt"
    badge = "not to be believed" if doubts else "steady" if steady else "needs a look"
    warning = "\n".join(["DO NOT BELIEVE this population:", *(f"  {x}" for x in doubts)])
    held = population.leave_one_out
    coverage = (
        f"left out one by one, {100 * held.within_50:.0f} % of runs lie in the 50 % intervals of all "
        f"others, and {100 * held.within_90:.0f} % in the 90 % intervals"
    )
    foreign = [sentence for _, sentence in outlier_sentences(population, record.misfit)]
    bad = [f"{name}: {reason}" for name, reason in record.not_used.items()]
    history = [f"{finding} ({details})" for _, finding, details in history_sentences(population)]
    weak = [f"{name}: {reasons[0]}" for name, reasons in record.doubts.items()]
    sections = (
        build(
            "Verdict",
            Badges((Badge(badge, tone),)),
            f"{record.verdict}.",
            warning if doubts else None,
        ),
        build("Over time", "\n".join(history), Picture("runs", CHART, ending)),
        build("Products", products_table(population), Note(TABLE_EXPLAINED), coverage),
        build("Runs that do not belong", "\n".join(foreign[:MOST_NAMED])),
        build("Noted", noted_table(population), brief=False),
        build("Rigs", rigs_table(population), brief=False),
        build("Runs that are not used", "\n".join(bad)),
        build("Runs whose fit is doubtful", "\n".join(weak), brief=False),
    )
    return tuple(section for section in sections if section.blocks)


def screen(record: CampaignRecord) -> str:
    """Return the text for a terminal, whose last line is the verdict."""
    return "\n\n".join(as_text(campaign_sections(record, "png")))


def write(
    plan: CampaignPlan, job: Job, reference: Reference, record: CampaignRecord, folder: Folder
) -> None:
    """Write figure, tables and pages."""
    population, output = record.population, job.config.output
    place, formats = folder.path / FIGURES, output.formats_or_default
    place.mkdir(exist_ok=True)
    symbols = job.problem.symbols
    figure = runs_figure(plan, population, reference.exponents, symbols, WIDTHS[output.size])
    note = {"Title": record.name, "Creator": software.creator()}
    style.save(figure, place, "runs", note, formats=formats, dpi=output.dpi)
    folder.write_text("population.csv", population_csv(population))
    write_runs(plan, population, folder)
    ending = output_files.preferred_format(formats)
    sections = campaign_sections(record, ending)
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


def population_csv(population: PopulationFit) -> str:
    """Return CSV with a line for each product: all digits, in logs of SI."""
    heads = ["product", "centre", "centre_sd", "spread", "rig_spread", "next_low_90", "next_low_50"]
    heads += ["next_high_50", "next_high_90", "nominal", "agrees", "history", "probability"]
    best = {c.product: (c.history.best, c.history.probabilities) for c in population.charts}
    lines: list[list[object]] = [[*heads]]
    for p in population.populations:
        history, probabilities = best.get(p.product, ("", {}))
        ahead, table = p.next_run, p.table
        lines.append(
            [
                *(p.product, p.centre.mean, p.centre.sd, p.spread.mean),
                None if p.rig_spread is None else p.rig_spread.mean,
                *(ahead.low_90, ahead.low_50, ahead.high_50, ahead.high_90),
                *((None, None) if table is None else (table.nominal, table.agrees)),
                *(history, probabilities.get(history)),
            ]
        )
    return lines_as_csv(lines)


def write_runs(plan: CampaignPlan, population: PopulationFit, folder: Folder) -> None:
    """Write `runs.parquet`: a row for each run, alone and in the population, in logs of SI."""
    import pyarrow
    from pyarrow import parquet

    known = {run.name: run for run in plan.runs}
    runs = population.runs
    columns: dict[str, object] = {
        "name": [run.name for run in runs],
        "rig": [run.rig for run in runs],
        "time": [known[run.name].time for run in runs],
    }
    columns |= {c: [known[run.name].noted[c] for run in runs] for c in plan.spec.noted}
    for k, product in enumerate(population.products):
        for part in ("alone", "alone_sd", "shrunk", "shrunk_sd"):
            columns[f"{product} {part}"] = [float(getattr(run, part)[k]) for run in runs]
    columns |= {"sds": [run.sds for run in runs], "worst": [run.worst for run in runs]}
    columns |= {"outlier": [run.outlier for run in runs]}
    sink = pyarrow.BufferOutputStream()
    parquet.write_table(pyarrow.table(columns), sink)
    output_files.write(folder.path_of("runs.parquet"), sink.getvalue().to_pybytes())
