"""Find runs and products of parameters that need attention, and describe them in sentences."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bayesdrill.campaigns.fit import MIN_TIMED_RUNS, ControlChart, PopulationFit
from bayesdrill.report.findings import finding_sentences
from bayesdrill.report.section import listed

MOST_NAMED = 10  # largest number of runs that a sentence names


@dataclass(frozen=True, slots=True, kw_only=True)
class Alarm:
    """An alarm describes a problem of a run or a product in a sentence."""

    kind: str
    run: str = ""
    product: str = ""
    sentence: str


@dataclass(frozen=True, slots=True, kw_only=True)
class CampaignRecord:
    """The `campaign.json` of a finished campaign has these fields.

    name: the name of the campaign
    mark: digest of all inputs of the population; while it is the same, the population is reused
    verdict: the result in one sentence
    history: drifts, changes and random walks of products, in sentences
    left_out: products that are not part of the population, and why
    not_used: runs that could not be sampled, or whose record is bad, and why
    doubts: for each doubtful run, the reasons not to believe its fit
    reasons: for each run whose page was made, the likely reason of its deviation, or ""
    alarms: problems of runs and products that need attention
    population: the population of the runs, in natural logarithms of SI values
    """

    name: str
    mark: str
    verdict: str
    history: tuple[str, ...]
    left_out: Mapping[str, str]
    not_used: Mapping[str, str]
    doubts: Mapping[str, tuple[str, ...]]
    reasons: Mapping[str, str]
    alarms: tuple[Alarm, ...]
    population: PopulationFit

    @property
    def outliers(self) -> list[Alarm]:
        """Return the alarms about outliers: runs that do not belong to the population."""
        return [alarm for alarm in self.alarms if alarm.kind == "outlier"]

    @property
    def unbelievable(self) -> tuple[str, ...]:
        """Return reasons not to believe the population."""
        runs = self.population.misdescribed
        shape = "have a shape that no mixture of normal distributions follows"
        return (
            *finding_sentences(self.population.convergence.reasons),
            *([f"the draws of {name_list([*runs])} {shape}"] if runs else []),
        )


def concluded(
    name: str,
    mark: str,
    population: PopulationFit,
    left_out: Mapping[str, str],
    not_used: Mapping[str, str],
    doubts: Mapping[str, tuple[str, ...]],
    misfit: Mapping[str, tuple[str, ...]],
    reasons: Mapping[str, str],
) -> CampaignRecord:
    """Return the record of a campaign; `misfit` says by run why residuals are not noise."""
    alarms = list[Alarm]()
    for run in population.runs:
        if run.outlier:
            known = [*filter(None, [reasons.get(run.name), *misfit.get(run.name, ())])]
            sentence = f"{run.name} is {run.sds:.3g} sds from other runs in {run.worst}"
            sentence = "; ".join([sentence, *known[:1]])
            alarms.append(Alarm(kind="outlier", run=run.name, sentence=sentence))
    foreign = [alarm.run for alarm in alarms]
    alarms += [
        Alarm(kind="not used", run=run, sentence=f"{run}: {reason}")
        for run, reason in not_used.items()
    ]
    findings, history = list[str](), list[str]()
    for chart in population.charts:
        for finding, details in _findings(chart, population.timed):
            sentence = f"{finding} ({details})"
            findings.append(finding)
            history.append(sentence)
            if chart.alarm:
                kind, product = chart.history.best, chart.product
                alarms.append(Alarm(kind=kind, product=product, sentence=sentence))
    return CampaignRecord(
        name=name,
        mark=mark,
        verdict=_verdict(population, findings, foreign, [*not_used]),
        history=tuple(history),
        left_out=left_out,
        not_used=not_used,
        doubts=doubts,
        reasons=reasons,
        alarms=tuple(alarms),
        population=population,
    )


def _findings(chart: ControlChart, timed: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Yield a finding and its details for the drift, the random walk or each change of a product.

    `timed` has the names of the runs in order of time.
    """
    history, product = chart.history, chart.product
    may, s = ("", "s") if chart.alarm else ("may ", "")
    probability = f"probability {100 * history.probabilities[history.best]:.0f} %"
    if history.best == "drift":
        size = with_sd(history.drift, history.drift_sd)
        yield f"{product} {may}drift{s} by {size} over the campaign", probability
    elif history.best == "walk":
        size = f"{100 * history.walk_sd:.2g} %"
        yield f"{product} {may}wander{s} by about {size} over the campaign", probability
    for change in history.changes if history.best == "changes" else ():
        first, at, last = (timed[k] for k in (change.first, change.run, change.last))
        size = with_sd(change.size, change.size_sd)
        probability = f"probability {100 * change.probability:.0f} %"
        yield (
            f"{product} {may}change{s} by {size} at {at}",
            f"{probability}, 90 % interval {first} to {last}",
        )


def _verdict(
    population: PopulationFit, history: list[str], foreign: list[str], not_used: list[str]
) -> str:
    """Return the verdict on a campaign in one sentence."""
    few = f"fewer than {MIN_TIMED_RUNS} different times, so drifts are not searched"
    parts = history or ["the rig is steady" if population.charts else few]
    belong = "does not belong" if len(foreign) == 1 else "do not belong"
    parts.append(f"{name_list(foreign)} {belong}" if foreign else "all runs belong together")
    agrees = {p.product: p.table.agrees for p in population.populations if p.table is not None}
    wrong = [product for product, right in agrees.items() if not right]
    if agrees:
        parts.append(f"the nominal values {f'disagree in {listed(wrong)}' if wrong else 'agree'}")
    if not_used:
        parts.append(f"not used: {name_list(not_used)}")
    return f"{len(population.runs)} runs: {'; '.join(parts)}"


def name_list(names: Sequence[str]) -> str:
    """Return the first `MOST_NAMED` names as text, with the number of the other names."""
    more = len(names) - MOST_NAMED
    return listed(names) if more <= 0 else f"{', '.join(names[:MOST_NAMED])} and {more} more"


def percent(log: float) -> str:
    """Return a difference of logarithms as a relative change in percent, with its sign."""
    return f"{100 * np.expm1(log):+.2g} %"


def with_sd(mean: float, sd: float) -> str:
    """Return a difference of logarithms and its standard deviation as percentages."""
    return f"{percent(mean)} +- {100 * sd:.2g} %"
