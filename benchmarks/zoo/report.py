"""The zoo as lines on the screen, as CSV, and as Markdown."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from pathlib import Path

from bayesdrill.basics.own_files import whole
from benchmarks import tables
from benchmarks.zoo.judge import Agreement, Outcome
from benchmarks.zoo.row import Row

HEAD = (
    "row", "what", "unknowns", "samples", "seconds", "steps", "tau", "acceptance", "ESS/s", "seeds",
    "weights", "ends",
)  # fmt: skip
CSV_HEAD = (
    "row", "what", "expected", "run", "status", "passed", "complaints", "unknowns", "samples", "wall_s",
    "map_s", "sampling_s", "report_s", "converged", "steps", "tau", "tau_of", "acceptance_least",
    "acceptance_most", "ess_bulk", "ess_per_s", "seeds_distance", "seeds_of", "seeds_limit",
    "weights_draws", "weights_share", "weights_distance", "weights_of", "weights_limit", "maxima",
    "maxima_weights", "share_below", "fit_worst_rms", "reasons",
)  # fmt: skip
SHORT = 90  # letters of a complaint in the table


def line(outcome: Outcome) -> str:
    """For the screen, as soon as a row is done."""
    status = "/".join("-" if run.status is None else str(run.status) for run in outcome.runs)
    walls = " ".join(f"{run.wall:5.1f}" for run in outcome.runs)
    numbers = f"{walls} s {_most(outcome, 'steps'):>6} steps  tau {_tau(outcome):>5}"
    agreed = f"seeds {_distance(outcome.seeds)} weights {_distance(outcome.importance)}"
    rate = tables.digits(outcome.rate) or "-"
    end = "ok" if outcome.passed else f"FAILED: {'; '.join(outcome.complaints)}"
    return f"{outcome.row.name:21s} {status} {numbers} {rate:>7} ESS/s  {agreed}  {end}"


def markdown(outcomes: Sequence[Outcome], absent: Sequence[Row], seconds: float) -> list[str]:
    failed = [outcome.row.name for outcome in outcomes if not outcome.passed]
    lines = [
        tables.where(),
        "",
        tables.row(HEAD),
        tables.row(("---", "---", *["---:"] * (len(HEAD) - 3), "---")),
        *(tables.row(cells(outcome)) for outcome in outcomes),
        "",
        f"{len(outcomes) - len(failed)} of {len(outcomes)} rows did what they should, each run in at "
        f"most {seconds:.0f} s" + (f"; not: {', '.join(failed)}." if failed else "."),
    ]
    if absent:
        names = ", ".join(row.name for row in absent)
        lines.append(f"Left out, as their records are not there: {names}.")
    more = "More numbers, of both runs, are in [figures/zoo.csv](figures/zoo.csv)."
    return [*lines, "", "![seconds and effective draws per second](figures/zoo.png)", "", more]


def cells(outcome: Outcome) -> tuple[str, ...]:
    """Of both runs the worse."""
    acceptance = [share for run in outcome.runs for share in run.acceptance]
    return (
        outcome.row.name,
        outcome.row.shows.replace("|", "/"),
        str(outcome.unknowns or ""),
        str(outcome.samples),
        f"{outcome.wall:.1f}",
        _most(outcome, "steps"),
        _tau(outcome),
        f"{sum(acceptance) / len(acceptance):.2f}" if acceptance else "",
        tables.digits(outcome.rate),
        _distance(outcome.seeds),
        _distance(outcome.importance),
        _end(outcome),
    )


def save_csv(outcomes: Sequence[Outcome], path: Path) -> None:
    """A line for each run."""
    with whole(path) as aside, aside.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(CSV_HEAD)
        for outcome in outcomes:
            for number in range(len(outcome.runs)):
                writer.writerow(_values(outcome, number))


def _values(outcome: Outcome, number: int) -> list[object]:
    row, run = outcome.row, outcome.runs[number]
    slowest = max(run.tau, key=lambda name: run.tau[name], default="")
    own = run.importance
    return [
        row.name, row.shows, "sound" if row.sound else row.reason, number + 1,
        "" if run.status is None else run.status,
        outcome.passed, "; ".join(outcome.complaints), len(run.mean), outcome.samples,
        f"{run.wall:.2f}", *(run.seconds.get(name, "") for name in ("map", "sampling", "report")),
        run.converged, run.steps, run.tau.get(slowest, ""), slowest,
        min(run.acceptance, default=""), max(run.acceptance, default=""),
        run.ess, f"{run.rate:.1f}", *_parts(outcome.seeds),
        "" if own is None else own.draws, "" if own is None else own.share,
        *_parts(outcome.importance),
        len(run.maxima), " ".join(f"{one['weight']:.4f}" for one in run.maxima),
        f"{outcome.shares[number]:.4f}" if outcome.shares else "",
        max((one["rms_over_sigma"] for one in run.fit), default=""), "; ".join(run.reasons),
    ]  # fmt: skip


def _parts(agreement: Agreement | None) -> tuple[object, ...]:
    if agreement is None:
        return "", "", ""
    return f"{agreement.worst:.3f}", agreement.name, f"{agreement.limit:.3f}"


def _distance(agreement: Agreement | None) -> str:
    if agreement is None or math.isnan(agreement.worst):
        return "-"
    return f"{agreement.worst:.1f}"


def _most(outcome: Outcome, what: str) -> str:
    return str(max(getattr(run, what) for run in outcome.runs) or "")


def _tau(outcome: Outcome) -> str:
    found = [tau for run in outcome.runs for tau in run.tau.values()]
    return f"{max(found):.1f}" if found else ""


def _end(outcome: Outcome) -> str:
    if outcome.passed:
        return "converged" if outcome.row.sound else "says that it does not fit"
    said = "; ".join(outcome.complaints).replace("|", "/")
    return f"**{said if len(said) <= SHORT else said[: SHORT - 3] + '...'}**"


def listed(rows: Sequence[Row]) -> list[str]:
    """Names, what is expected, and what they show."""
    return [
        f"{row.name:21s} {'sound' if row.sound else 'UNSOUND':8s} {'quick' if row.quick else '':6s} "
        f"{row.shows}{'' if row.made.available else ' (its record is not there)'}"
        for row in rows
    ]
