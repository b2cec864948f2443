"""Summary tables: the same rows for the terminal, for CSV and for Markdown."""

from __future__ import annotations

import csv
import dataclasses
import io
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from bayesdrill.analysis.diagnostics import MEANING, Row
from bayesdrill.basics.symbols import plain
from bayesdrill.inference.derived import HDI_PROBABILITY
from bayesdrill.inference.display_units import OwnUnits
from bayesdrill.inference.posterior import Problem
from bayesdrill.report.section import Bar, Table
from bayesdrill.sampling.mode_search import Mode

_HDI = f"{100 * HDI_PROBABILITY:.0f} % HDI"

HEADERS = (
    "", "unit", "nominal", "MAP", "mean", "sd", _HDI, "dev. %", "R-hat", "ESS bulk", "ESS tail",
    "shrinkage", "the record says",
)  # fmt: skip


_ENDS = tuple(f"hdi{100 * HDI_PROBABILITY:.0f}_{end}" for end in ("low", "high"))


def cells(row: Row) -> tuple[str, ...]:
    """What is shown of a row, in the order of `HEADERS`."""
    return (
        row.name,
        plain(row.unit),
        "" if row.nominal is None else f"{row.nominal:.4g}",
        f"{row.map:.4g}",
        f"{row.mean:.4g}",
        f"{row.sd:.2g}",
        f"{row.hdi_low:.4g} to {row.hdi_high:.4g}",
        "" if row.deviation is None else f"{100 * row.deviation:+.2f}",
        f"{row.r_hat:.4f}",
        f"{row.ess_bulk:.0f}",
        f"{row.ess_tail:.0f}",
        f"{round(100 * row.shrinkage)} %",
        row.word,
    )


def as_csv(rows: Sequence[Row]) -> str:
    """All digits, SI; `deviation` and `shrinkage` are fractions."""
    return records_as_csv(Row, rows, {"word": "the_record_says"})


def records_as_csv(
    kind: type, rows: Sequence[object], names: Mapping[str, str], leave: Sequence[str] = ()
) -> str:
    """A column for each field of the record `kind` but those to `leave`, under its own name unless
    `names` has another.
    """
    named = {"hdi_low": _ENDS[0], "hdi_high": _ENDS[1], **names}
    keys = [field.name for field in dataclasses.fields(kind) if field.name not in leave]
    heads = [named.get(key, key) for key in keys]
    return lines_as_csv([heads, *([getattr(row, key) for key in keys] for row in rows)])


def lines_as_csv(lines: Iterable[Sequence[object]]) -> str:
    """Of all tables; what is None is empty."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerows(["" if value is None else value for value in line] for line in lines)
    return out.getvalue()


def as_record(row: Row) -> dict[str, Any]:
    """As a line of `summary.csv`."""
    names = {"hdi_low": _ENDS[0], "hdi_high": _ENDS[1], "word": "the_record_says"}
    return {names.get(name, name): value for name, value in dataclasses.asdict(row).items()}


def of_rows(rows: Sequence[Row], bars: tuple[Bar, ...] = ()) -> Table:
    left = frozenset((HEADERS[0], HEADERS[1], HEADERS[-1]))
    return Table(HEADERS, tuple(map(cells, rows)), left, bars=bars).filled()


@dataclass(frozen=True, slots=True, kw_only=True)
class ModeRow:
    """A line of `map.csv`."""

    name: str
    unit: str
    nominal: float | None
    map: float


def mode_rows(problem: Problem, mode: Mode) -> tuple[ModeRow, ...]:
    """SI."""
    return tuple(
        ModeRow(
            name=symbol.name,
            unit=symbol.unit,
            nominal=problem.nominal.get(symbol.name),
            map=mode.values[symbol.name],
        )
        for symbol in problem.symbols
    )


def of_mode(rows: Sequence[ModeRow]) -> Table:
    """The MAP beside the nominal values."""
    heads, lines = ("", "unit", "nominal", "MAP", "dev. %"), []
    for row in rows:
        shown = (
            ("", "")
            if row.nominal is None
            else (f"{row.nominal:.4g}", f"{100 * (row.map / row.nominal - 1):+.2f}")
        )
        lines.append((row.name, plain(row.unit), shown[0], f"{row.map:.6g}", shown[1]))
    return Table(heads, tuple(lines), frozenset(heads[:2])).filled()


def mode_as_csv(rows: Sequence[ModeRow]) -> str:
    """All digits."""
    return records_as_csv(ModeRow, rows, {})


def in_words(rows: Sequence[Row]) -> list[str]:
    """Which unknowns the record determines, and which it cannot."""
    sentences = []
    for word, meaning in MEANING.items():
        names = [row.name for row in rows if row.word == word]
        if names:
            sentences.append(f"{word}: {', '.join(names)} ({meaning})")
    return sentences


def notes(rows: Sequence[Row], own: OwnUnits) -> list[str]:
    """What is no reason to doubt the draws, but one to doubt the prior or the model; `rows` in SI."""
    return [
        f"note: {row.name} is pressed against the end {own.said(row.name, row.pressed_against)} of its "
        "prior, as if the record wanted it beyond: widen the prior, or doubt the model, the units and "
        "what is held"
        for row in rows
        if row.pressed_against is not None
    ]
