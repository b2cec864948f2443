"""Report a calibration: the verdict, a table, and ranks against chance."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from bayesdrill.analysis.calibration import (
    FALSE_ALARM,
    MAX_NOT_CONVERGED,
    CalibrationVerdict,
    Refit,
)
from bayesdrill.basics.symbols import Symbol
from bayesdrill.config.schema.config import Config
from bayesdrill.inference.posterior import Problem
from bayesdrill.report import scales, style
from bayesdrill.report.findings import finding_sentence, finding_sentences
from bayesdrill.report.pages import build_page, departures, label_outside, legend_above, ranks_panel
from bayesdrill.report.section import (
    Badge,
    Badges,
    Note,
    Picture,
    Section,
    Table,
    Tone,
    build,
    lines_as_csv,
)
from bayesdrill.report.style import Axes, Figure

MOST_NAMED = 20  # largest number of refits that are named as not converged


def calibration_opening(problem: Problem, config: Config) -> str:
    """Describe what a calibration repeats, and how often."""
    records = " and one of ".join(
        f"{len(observation.experiment.t)} samples of {', '.join(observation.experiment.names)}"
        for observation in problem.observations
    )
    return (
        f"calibration: {config.calibration.refits} times, draw the unknowns from their priors, simulate "
        f"a record of {records}, and sample its posterior\n"
        f"unknown: {', '.join(problem.names)}"
    )


def describe_calibration(verdict: CalibrationVerdict) -> str:
    """Return the verdict in one sentence."""
    if verdict.faults:
        return f"not calibrated: {'; '.join(finding_sentences(verdict.faults))}"
    if verdict.doubts:
        return f"no verdict: {'; '.join(finding_sentences(verdict.doubts))}"
    return f"calibrated: over {verdict.refits} refits the truth ranks among the draws as by chance"


def calibration_rule(verdict: CalibrationVerdict) -> str:
    """Describe how often the verdict is wrong by chance, and when it cannot be "calibrated"."""
    return (
        f"A correct posterior would be called not calibrated in at most {100 * FALSE_ALARM:g} % of such "
        f"studies, for all {len(verdict.quantities)} quantities and intervals together. Nothing is "
        f"called calibrated if more than {100 * MAX_NOT_CONVERGED:g} % of the refits did not converge. "
        "The ranks include these refits."
    )


def describe_refits(verdict: CalibrationVerdict, refits: Sequence[Refit]) -> str:
    """Describe the refits that failed: how many, which, and why."""
    if not verdict.not_converged:
        return f"all {verdict.refits} refits converged"
    first = next(refit for refit in refits if not refit.converged)
    listed = ", ".join(map(str, verdict.not_converged[:MOST_NAMED]))
    more = ", ..." if len(verdict.not_converged) > MOST_NAMED else ""
    return (
        f"{len(verdict.not_converged)} of {verdict.refits} refits did not converge: {listed}{more}\n"
        f"  refit {first.index}: {finding_sentence(first.reasons[0])}"
    )


def calibration_sections(
    judged: CalibrationVerdict, refits: Sequence[Refit], ending: str
) -> tuple[Section, ...]:
    """Build the sections, the verdict first; `ending` is the type of the figure's file."""
    says = describe_calibration(judged)
    tone: Tone = "bad" if judged.faults else "doubt" if judged.doubts else "good"
    marks = Badges((Badge(says.split(":")[0], tone),))
    read = Note(
        f"Ranks are among {judged.n_draws} draws. `departure / band` is the largest departure of ranks "
        "from uniform, divided by what chance allows. Brackets give the percentages of truths that "
        "chance allows inside an interval. Exact values: `ranks.csv`."
    )
    seen = "Ranks of the truths among the draws, with what chance allows."
    return (
        build("Verdict", marks, f"{says[0].upper()}{says[1:]}.", Note(calibration_rule(judged))),
        build("Ranks", ranks_table(judged), read, Picture("calibration", seen, ending)),
        build("Refits", describe_refits(judged, refits)),
    )


def ranks_table(verdict: CalibrationVerdict) -> Table:
    """Build the table of ranks and of truths inside credible intervals, with what chance allows."""
    shares = [f"in {100 * i.share:.3g} % interval" for i in verdict.quantities[0].intervals]
    n, lines = max(verdict.band.n, 1), []
    for q in verdict.quantities:
        word = "as by chance" if q.holds else q.shape or "leave the band"
        covered = [
            f"{100 * i.inside / n:.0f} % ({100 * i.low / n:.0f} to {100 * i.high / n:.0f})"
            + ("" if i.is_consistent else " **outside**")
            for i in q.intervals
        ]
        known = (q.name, f"{q.reach:.2f}", word if verdict.band.n else "none")
        lines.append((*known, *(covered or [""] * len(shares))))
    heads = ("", "departure / band", "ranks", *shares)
    return Table(heads, tuple(lines), frozenset(("", "ranks")))


def ranks_csv(names: Sequence[str], refits: Sequence[Refit]) -> str:
    """Return CSV with a line for each refit: all digits, SI, the same on every machine."""
    keys = [name.replace(" ", "_") for name in names]
    heads = ["refit", "converged", "r_hat", "ess", "steps"]
    heads += [f"{what}_{key}" for what in ("true", "rank") for key in keys]
    lines: list[Sequence[object]] = [heads]
    for refit in refits:
        first = (refit.index, int(refit.converged), refit.r_hat, refit.ess, refit.steps)
        lines.append([*first, *refit.truth, *(refit.ranks or [None] * len(names))])
    return lines_as_csv(lines)


MARKERS = ("o", "s", "^")  # markers of the intervals, in the order of their probabilities


def calibration_figure(
    verdict: CalibrationVerdict, symbols: Sequence[Symbol], width: float = scales.DOUBLE
) -> Figure:
    """Draw rank distributions against uniform, above the coverage of credible intervals.

    `symbols` has the unknowns; the log likelihood is added as the last quantity.
    """
    labels = [*(symbol.latex for symbol in symbols), r"\log L"]
    away = [departures(verdict.band, quantity.ranks) for quantity in verdict.quantities]
    most = max(float(np.abs(each).max()) for each in away)
    with style.styled(width):
        figure, (*panels, covered) = build_page(len(labels), 4, 1.2, width, last=1.9)
        for panel, label, quantity, each in zip(
            panels, labels, verdict.quantities, away, strict=True
        ):
            shape = (quantity.shape or "leaves the band").removeprefix("posterior ")
            wrong = "" if quantity.holds else shape
            ranks_panel(panel, verdict.band, each, most, wrong, 3, style.BAND)
            style.corner_text(panel, f"${label}$")
        label_outside(panels, "normalised rank", "ECDF difference")
        _coverage(covered, verdict, labels[:-1])
        return legend_above(figure, _legend(verdict))


def _mark(marker: str, *, holds: bool) -> dict[str, Any]:
    face, edge = ("white", style.BLACK) if holds else (style.MAP_COLOUR, style.MAP_COLOUR)
    look = {"marker": marker, "markersize": 3.4, "markeredgewidth": 0.8}
    return {**look, "markerfacecolor": face, "markeredgecolor": edge}


def _coverage(panel: Axes, verdict: CalibrationVerdict, labels: Sequence[str]) -> None:
    n = max(verdict.band.n, 1)
    unknown = [quantity for quantity in verdict.quantities if quantity.intervals]
    shares = [interval.share for interval in unknown[0].intervals]
    for share in shares:
        panel.axhline(100 * share, color=style.MIDDLE, linewidth=0.5, zorder=0)
    width = 0.2 * min(1.0, len(unknown) / 6)
    for column, quantity in enumerate(unknown):
        for k, interval in enumerate(quantity.intervals):
            x = column + 1.1 * width * (k - 1)
            low, high = 100 * interval.low / n, 100 * interval.high / n
            panel.bar(x, high - low, width, bottom=low, zorder=1, **style.BAND)
            look = _mark(MARKERS[k], holds=interval.is_consistent)
            panel.plot([x], [100 * interval.inside / n], zorder=3, **look)
    panel.set_xlim(-0.6, len(unknown) - 0.4)
    floor = min(min(min(i.low, i.inside) for i in q.intervals) for q in unknown)
    panel.set_ylim(max(0.0, 100 * floor / n - 6.0), 102.0)
    style.set_ticks(panel.xaxis, range(len(unknown)), [f"${label}$" for label in labels])
    panel.tick_params(axis="x", length=0)
    style.set_ticks(panel.yaxis, [100 * s for s in shares], [f"{100 * s:.3g}" for s in shares])
    panel.set_ylabel("truths inside [%]")


def _legend(verdict: CalibrationVerdict) -> dict[str, style.Look]:
    quantities = verdict.quantities
    looks: dict[str, style.Look] = {"what chance allows": style.BAND}
    if any(q.holds for q in quantities):
        looks["ranks of the truth"] = style.BLACK_LINE
    if not all(q.holds for q in quantities):
        looks["ranks that leave the band"] = style.OUTSIDE
    intervals = next(q.intervals for q in quantities if q.intervals)
    for marker, interval in zip(MARKERS, intervals, strict=True):
        label = f"{100 * interval.share:.3g} % interval"
        looks[label] = {"linestyle": "none", **_mark(marker, holds=True)}
    return looks
