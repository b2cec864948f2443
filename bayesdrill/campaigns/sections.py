"""Build the report sections of a campaign and of its runs: text, tables and figures."""

from __future__ import annotations

import math

import numpy as np

from bayesdrill.analysis.causes import Causes
from bayesdrill.campaigns.conclusion import MOST_NAMED, CampaignRecord, percent, with_sd
from bayesdrill.campaigns.fit import MIN_RUNS, PopulationFit
from bayesdrill.campaigns.outcomes import Estimate, ProductPopulation, RunOutcome
from bayesdrill.campaigns.population import NominalRange
from bayesdrill.report.section import (
    Badge,
    Badges,
    Link,
    Note,
    Picture,
    Section,
    Table,
    Tone,
    build,
    listed,
    mappings_as_csv,
    table_of,
)
from bayesdrill.report.sections import causes as causes_section


def _level(log: float, sd: float) -> str:
    """Return the level exp(log) with two digits of its sd, but at least four digits."""
    digits = max(4, 2 - math.floor(math.log10(max(sd, 1e-12))))
    return f"{math.exp(log):.{digits}g}"


def level_cells(head: str, sd_head: str, mean: float, sd: float) -> dict[str, str]:
    """Return cells with a level and its sd in percent; `mean` and `sd` are those of its log."""
    return {head: _level(mean, sd), sd_head: f"{100 * sd:.2g} %"}


def _following(ahead: Estimate) -> dict[str, str]:
    """Return a cell with the 90 % interval of the next run."""
    ends = (_level(log, ahead.sd) for log in (ahead.low_90, ahead.high_90))
    return {"next run, 90 %": " to ".join(ends)}


def _tolerance(nominal: NominalRange) -> str:
    """Return the ends of a tolerance in percent of the nominal value; empty without a tolerance."""
    ends = (percent(end - nominal.value) for end in (nominal.low, nominal.high))
    return "" if nominal.low == nominal.high else " to ".join(ends)


def products_table(population: PopulationFit) -> Table:
    """Return the table of products of parameters: population, next run and nominal value of each."""

    def cells(p: ProductPopulation) -> dict[str, str]:
        table = p.table
        says = "" if table is None else "agrees" if table.agrees else "disagrees"
        return {
            "": p.product,
            **level_cells("centre", "+-", p.centre.mean, p.centre.sd),
            "runs differ by": f"{100 * p.spread.mean:.2g} %",
            "rigs differ by": "" if p.rig_spread is None else f"{100 * p.rig_spread.mean:.2g} %",
            **_following(p.next_run),
            "nominal": "" if table is None else f"{np.exp(table.nominal.value):.4g}",
            "tolerance": "" if table is None else _tolerance(table.nominal),
            "nominal is off": "" if table is None else percent(-table.offset.mean),
            "verdict": says,
        }

    return table_of(map(cells, population.populations), "", "verdict").filled()


def noted_table(population: PopulationFit) -> Table | None:
    """Return the table of noted columns (covariates), with the part of variance that each explains."""
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
    """Return the table of rigs, with the level and the next run of each rig."""
    lines = [
        {"rig": rig.rig, "product": rig.product}
        | level_cells("level", "+-", rig.level.mean, rig.level.sd)
        | _following(rig.next_run)
        for rig in population.rigs
    ]
    return table_of(lines, "rig", "product") if lines else None


TABLE_EXPLAINED = (
    "All in SI. `centre` is the level of the rig at the end of the campaign, for average values of "
    "noted columns. `runs differ by` is half the width of the central 68 % of runs. The next run lies "
    "in its interval with a probability of 90 %. Take the value within the tolerance that is nearest to "
    "the centre: the nominal value agrees if more than 5 % of runs lie at least as far from the centre."
)
CHART = (
    "Each run by itself (bars: one standard deviation) and shrunk towards the others (dots), relative "
    "to the centre; grey: the 50 and 90 % intervals of the next run."
)


def campaign_sections(
    record: CampaignRecord, ending: str = "png", links: tuple[Link, ...] = ()
) -> tuple[Section, ...]:
    """Build the sections of a campaign, the verdict first; `links` are on points of its figure."""
    population, doubts, calm = record.population, record.unbelievable, not record.alarms
    tone: Tone = "bad" if doubts else "good" if calm else "doubt"
    badge = "not to be believed" if doubts else "no alarm" if calm else "needs a look"
    warning = "\n".join(["DO NOT BELIEVE this population:", *(f"  {x}" for x in doubts)])
    check = population.leave_one_out
    coverage = (
        f"if each run is left out in turn, {100 * check.within_50:.0f} % of its products lie in the "
        f"50 % intervals of the others, and {100 * check.within_90:.0f} % in their 90 % intervals"
    )
    few = f"not used, as they are constant or have fewer than {MIN_RUNS} numbers"
    ignored = f"{few}: {listed(population.ignored)}" if population.ignored else None
    foreign = [alarm.sentence for alarm in record.outliers]
    bad = [f"{name}: {reason}" for name, reason in record.not_used.items()]
    weak = [f"{name}: {reasons[0]}" for name, reasons in record.doubts.items()]
    left_out = [f"{name}: {reason}" for name, reason in record.left_out.items()]
    badges, verdict = Badges((Badge(badge, tone),)), f"{record.verdict}."
    sections = (
        build("Verdict", badges, verdict, warning if doubts else None),
        build("Over time", "\n".join(record.history), Picture("runs", CHART, ending, links)),
        build("Products", products_table(population), Note(TABLE_EXPLAINED), coverage),
        build("Products that are left out", _lines(left_out), brief=False),
        build("Runs that do not belong", _lines(foreign[:MOST_NAMED]), brief=bool(foreign)),
        build("Noted", noted_table(population), ignored, brief=False),
        build("Rigs", rigs_table(population), brief=False),
        build("Runs that are not used", _lines(bad), brief=bool(bad)),
        build("Runs whose fit is doubtful", _lines(weak), brief=False),
    )
    return tuple(section for section in sections if section.blocks)


def _lines(sentences: list[str]) -> str:
    return "\n".join(sentences) or "none"


def population_csv(population: PopulationFit) -> str:
    """Return CSV with a line for each product: all digits, in natural logarithms of SI values."""
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
                "nominal": table and table.nominal.value,
                "tolerance_low": table and table.nominal.low,
                "tolerance_high": table and table.nominal.high,
                "agrees": table and table.agrees,
                "history": history and history.best,
                "probability": history and history.probabilities[history.best],
            }
        )
    return mappings_as_csv(lines)


def run_sections(
    outcome: RunOutcome, products: tuple[str, ...], reason: str, causes: Causes | None
) -> tuple[Section, ...]:
    """Build the sections of a run's page: its deviation from other runs, and causes of a misfit."""
    numbers = (outcome.alone, outcome.alone_sd, outcome.shrunk, outcome.shrunk_sd)
    lines = (
        {"": product}
        | level_cells("alone", "+-", alone, alone_sd)
        | level_cells("in the population", "+- there", shrunk, shrunk_sd)
        for product, alone, alone_sd, shrunk, shrunk_sd in zip(products, *numbers, strict=True)
    )
    text = f"In {outcome.worst}, this run is {outcome.sds:.3g} sds from the other runs."
    text += f"\nIts likely reason: {reason}." if reason else ""
    sections = (
        build("In the campaign", text, table_of(lines, "")),
        build("What would explain the misfit", *causes_section.candidates(causes)),
    )
    return tuple(section for section in sections if section.blocks)


def likely_reason(outcome: RunOutcome, causes: Causes | None) -> str:
    """Return the likely reason why a run is an outlier or does not fit; empty if neither."""
    if causes is None:
        alone = "the model fits its record, so the rig or its state differed from other runs"
        return alone if outcome.outlier else ""
    if causes.best is None:
        return "nothing that was tried explains its record"
    return f"its record is explained by {causes.best.about}"
