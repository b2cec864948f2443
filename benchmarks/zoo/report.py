"""The zoo as lines on the screen, and as Markdown."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence

from benchmarks import tables
from benchmarks.zoo.judge import Agreement, Outcome
from benchmarks.zoo.row import RANKED, Row
from benchmarks.zoo.table import Measured

HEAD = (
    "row", "what", "unknowns", "samples", "seconds", "steps", "tau", "acceptance", "ESS/s", "seeds",
    "weights", "ends",
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


def markdown(every: Sequence[Measured], absent: Sequence[Row], seconds: float) -> list[str]:
    failed = [one.name for one in every if not one.passed]
    told = (
        f"{len(every) - len(failed)} of {len(every)} rows did what they should"
        + (f"; {', '.join(failed)} did not." if failed else ".")
        + f" A run may take {seconds:.0f} s, but {RANKED:.0f} s if it ranks the causes of a bad fit, "
        "and 360 s with ten million samples."
    )
    if absent:
        names = ", ".join(row.name for row in absent)
        told += f" Not measured, as their records are not there: {names}."
    lines = [
        tables.where(),
        "",
        tables.row(HEAD),
        tables.row(("---", "---", *["---:"] * (len(HEAD) - 3), "---")),
        *(tables.row(cells(one)) for one in every),
        "",
        *textwrap.wrap(told, 100),
    ]
    more = "More numbers, of both runs, are in [figures/zoo.csv](figures/zoo.csv)."
    return [*lines, "", "![seconds and effective draws per second](figures/zoo.png)", "", more]


def cells(one: Measured) -> tuple[str, ...]:
    """Of both runs the worse."""
    acceptance = [*one.numbers("acceptance_least"), *one.numbers("acceptance_most")]
    tau, rate = one.numbers("tau"), one.numbers("ess_per_s")
    return (
        one.name,
        one.said("what").replace("|", "/"),
        _whole([n for n in one.numbers("unknowns") if n]),
        one.said("samples"),
        f"{max(one.numbers('wall_s')):.1f}",
        _whole([n for n in one.numbers("steps") if n]),
        f"{max(tau):.1f}" if tau else "",
        f"{sum(acceptance) / len(acceptance):.2f}" if acceptance else "",
        tables.digits(min(rate)) if rate else "",
        _least("seeds_distance", one),
        _least("weights_distance", one),
        _end(one),
    )


def _whole(numbers: Sequence[float]) -> str:
    return f"{max(numbers):.0f}" if numbers else ""


def _least(what: str, one: Measured) -> str:
    numbers = one.numbers(what)
    return f"{max(numbers):.1f}" if numbers else "-"


def _distance(agreement: Agreement | None) -> str:
    if agreement is None or math.isnan(agreement.worst):
        return "-"
    return f"{agreement.worst:.1f}"


def _most(outcome: Outcome, what: str) -> str:
    return str(max(getattr(run, what) for run in outcome.runs) or "")


def _tau(outcome: Outcome) -> str:
    found = [tau for run in outcome.runs for tau in run.tau.values()]
    return f"{max(found):.1f}" if found else ""


def _end(one: Measured) -> str:
    if one.passed:
        return "converged" if one.sound else "says why it must not be believed"
    said = one.said("complaints").replace("|", "/")
    return f"**{said if len(said) <= SHORT else said[: SHORT - 3] + '...'}**"


def listed(rows: Sequence[Row]) -> list[str]:
    """Names, what is expected, and what they show."""
    return [
        f"{row.name:21s} {'sound' if row.sound else 'UNSOUND':8s} {'quick' if row.quick else '':6s} "
        f"{row.shows}{'' if row.made.available else ' (its record is not there)'}"
        for row in rows
    ]
