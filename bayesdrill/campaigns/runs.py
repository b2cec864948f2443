"""List the runs of a campaign: files of a glob, rows of a table, or entries of its file."""

from __future__ import annotations

import csv
import glob
import math
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from bayesdrill.basics.errors import (
    InputError,
    Issue,
    count_noun,
    did_you_mean,
    report_damage,
    shortened,
)
from bayesdrill.config import loading
from bayesdrill.config.schema.campaign import SECONDS, CampaignSpec
from bayesdrill.config.yaml_source import Location, Source, read
from bayesdrill.record.formats.arrays import CUT_SHORT
from bayesdrill.record.formats.table import decode, missing_package

COLUMNS = ("file", "name", "rig", "time")  # of a table of runs, beside those that were noted
NO_PARQUET = "Parquet, in which a campaign keeps its draws,"


@dataclass(frozen=True, slots=True, kw_only=True)
class CampaignRun:
    """A run has a name, the `path` of its record, and what was noted beside it.

    `time` [s] is that since the first run.  `changes` are entries of the config that differ.
    """

    name: str
    path: Path
    rig: str
    time: float | None
    noted: Mapping[str, float]
    changes: Mapping[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class CampaignPlan:
    """A plan has the entries of a campaign's file, its runs in the order of time, and notes on them.

    `base` is the config of all runs.
    """

    spec: CampaignSpec
    source: Source
    base: Source
    runs: tuple[CampaignRun, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class _Row:
    """A row stands at `place`, with its plain entries."""

    place: str
    path: Path
    name: str
    rig: str
    time: float | str | None
    noted: Mapping[str, float]


NumberedRow = tuple[int, Sequence[Any]]  # the number of a row of a table, and its cells


def read_spec(path: Path) -> tuple[Source, CampaignSpec]:
    """Read the file of a campaign; raises `InputError` with all its mistakes."""
    source = read(path)
    return source, loading.read_document(CampaignSpec, source)


def read_plan(path: Path) -> CampaignPlan:
    """Read the file of a campaign and list its runs; raises `InputError` with all mistakes.

    No record is read.
    """
    source, spec = read_spec(path)
    folder, issues = path.parent, list[Issue]()
    rows = _rows(source, spec, issues)
    names = [row.name for row in rows]
    for section, known in (("leave_out", spec.leave_out), ("overrides", spec.overrides)):
        for k, name in enumerate(known):
            if rows and name not in names:
                at: Location = (section, k if section == "leave_out" else name)
                issues.append(
                    source.issue(at, f"no run is called {name}{did_you_mean(name, names)}")
                )
    rows = [row for row in rows if row.name not in spec.leave_out]
    if names and not rows:
        issues.append(source.issue(("leave_out",), "no run remains; take some out of this list"))
    issues += [
        Issue(r.place, "its file has a NUL in its name") for r in rows if "\0" in str(r.path)
    ]
    issues += _repeated(rows)
    times = _times(rows, spec, issues)
    issues += _repeated_times(rows, times)
    base = read(folder / spec.base)
    if "experiments" in base.data:
        message = "has several experiments; a campaign needs a config of a single record"
        issues.append(source.issue(("base",), message))
    if issues:
        raise InputError(list(dict.fromkeys(issues)))
    runs = [
        CampaignRun(
            name=row.name,
            path=row.path,
            rig=row.rig,
            time=time,
            noted=row.noted,
            changes=spec.overrides.get(row.name, {}),
        )
        for row, time in zip(rows, times, strict=True)
    ]
    if spec.by_name or None not in times:
        runs.sort(key=lambda run: (run.time or 0.0, natural_key(run.name)))
    return CampaignPlan(
        spec=spec, source=source, base=base, runs=tuple(runs), notes=tuple(_notes(spec, rows))
    )


def natural_key(name: str) -> tuple[Any, ...]:
    """Return a key by which run_9 comes before run_10."""
    return tuple((int(part), "") if part.isdecimal() else (-1, part) for part in _PARTS.split(name))


_PARTS = re.compile(r"(\d+)", re.ASCII)


def _rows(source: Source, spec: CampaignSpec, issues: list[Issue]) -> list[_Row]:
    if isinstance(spec.runs, list):
        return [
            _Row(
                source.issue(("runs", k), "").place,
                source.path.parent / run.file,
                run.name or Path(run.file).stem,
                run.rig,
                run.time,
                {n: math.nan if (x := run.noted.get(n)) is None else x for n in spec.noted},
            )
            for k, run in enumerate(spec.runs)
        ]
    path = source.path.parent / spec.runs
    if not glob.has_magic(spec.runs):
        return _table_rows(path, spec, issues)
    if spec.noted:
        message = "a glob has no columns; name a table of runs, with the columns file and these"
        issues.append(source.issue(("noted",), message))
    inside = "" if Path(spec.runs).is_absolute() else f"{glob.escape(str(source.path.parent))}/"
    matches = sorted(glob.iglob(inside + spec.runs, recursive=True), key=natural_key)
    files = [Path(match) for match in matches if os.path.splitext(match)[1]]
    if not files:
        message = f"no file matches {spec.runs}, in the folder of this file; check both"
        issues.append(source.issue(("runs",), message))
    return [_Row(str(file), file, file.stem, "", None, {}) for file in files]


def _table_rows(path: Path, spec: CampaignSpec, issues: list[Issue]) -> list[_Row]:
    columns, cells = _parquet(path) if path.suffix == ".parquet" else _csv(path)
    twice = dict.fromkeys(name for name in columns if columns.count(name) > 1)
    issues += [Issue(str(path), f"has two columns {name}; rename one of them") for name in twice]
    for name in ("file", *spec.noted):
        if name not in columns:
            hint = did_you_mean(name, columns)
            issues.append(Issue(str(path), f"has no column {name}{hint}"))
    if issues:
        return []
    rows = []
    for number, row in cells:
        place = f"{path} row {number}"
        known: dict[str, Any] = dict(zip(columns, row, strict=False))
        if len(row) != len(columns):
            issues.append(
                Issue(place, f"has {count_noun(len(row), 'cell')}, the header {len(columns)}")
            )
            continue
        file = str(known["file"] or "")
        if not file:
            issues.append(Issue(place, "names no file"))
            continue
        noted = {name: _number(known[name], name, place, issues) for name in spec.noted}
        time = known.get("time")
        name = str(known.get("name") or Path(file).stem)
        rows.append(_Row(place, path.parent / file, name, str(known.get("rig") or ""), time, noted))
    if not rows and not issues:
        issues.append(Issue(str(path), "has no rows; a campaign needs at least two runs"))
    return rows


def _csv(path: Path) -> tuple[list[str], Sequence[NumberedRow]]:
    """Return the header and the other rows with their numbers; blank lines are no rows."""
    lines = decode(path).splitlines()
    mark = max(",;\t", key=next((line for line in lines if line.strip()), "").count)
    try:
        cells = [[cell.strip() for cell in row] for row in csv.reader(lines, delimiter=mark)]
    except csv.Error as error:
        message = f"cannot be read as a table ({error}); write it as CSV with a row for each run"
        raise InputError.at(str(path), message) from None
    rows = [(number, row) for number, row in enumerate(cells, start=1) if any(row)]
    return (rows[0][1] if rows else []), rows[1:]


def _parquet(path: Path) -> tuple[list[str], Sequence[NumberedRow]]:
    try:
        from pyarrow import parquet
    except ImportError:
        raise missing_package(path, "a Parquet file", "parquet") from None
    with report_damage(str(path), f"the Parquet file {CUT_SHORT}"):
        table = parquet.read_table(path)
        cells = zip(*(column.to_pylist() for column in table.columns), strict=True)
        return table.column_names, [*enumerate(cells, start=1)]


def _number(cell: Any, name: str, place: str, issues: list[Issue]) -> float:
    """Return a noted number; NaN for an empty cell, and for text, which is an issue."""
    try:
        value = float(cell) if cell not in (None, "") else math.nan
    except (TypeError, ValueError):
        value = math.inf
    if math.isinf(value):
        message = f"'{shortened(str(cell))}' is not a number; leave the cell empty if none is known"
        issues.append(Issue(f"{place}: {name}", message))
    return value


def _repeated(rows: Sequence[_Row]) -> Iterable[Issue]:
    """Yield an issue for each name, and each file, that stands for a second run."""
    names, files = dict[str, _Row](), dict[str, _Row]()
    for row in rows:
        path = os.path.abspath(row.path)  # `resolve` would look at each file of a million
        if path in files:
            other = files[path].place
            yield Issue(row.place, f"{row.path} is a run already ({other}); take out one of them")
        elif row.name in names:
            other = str(names[row.name].path)
            message = f"{row.path} and {other} have the name {row.name}; give `name` in a table"
            yield Issue(row.place, message)
        names.setdefault(row.name, row)
        files.setdefault(path, row)


def _times(rows: Sequence[_Row], spec: CampaignSpec, issues: list[Issue]) -> list[float | None]:
    """Return the times [s] of all runs since the first, or None for each."""
    blank = [row for row in rows if row.time in (None, "")]
    if spec.by_name:
        if len(blank) < len(rows):
            issues.append(Issue(rows[0].place, "runs have times; remove `by_name`"))
        order = sorted((row.name for row in rows), key=natural_key)
        places = {name: k * SECONDS[spec.time_unit] for k, name in enumerate(order)}
        return [places[row.name] for row in rows]
    if len(blank) == len(rows):
        return [None] * len(rows)
    issues += [
        Issue(row.place, "has no time, and other runs have; give all or none") for row in blank
    ]
    seconds = list[float]()
    for row in rows:
        try:
            seconds.append(_seconds(row.time, spec))
        except ValueError:
            message = (
                f"'{shortened(str(row.time))}' is neither a number nor a date (2026-03-01T12:00)"
            )
            issues += [Issue(f"{row.place}: time", message)] if row not in blank else []
            seconds.append(math.nan)
    numeric = {_is_number(row.time) for row in rows if row not in blank}
    if len(numeric) > 1:
        issues.append(
            Issue(rows[0].place, "some times are numbers and others dates; write all alike")
        )
    start = min(seconds)
    return [second - start for second in seconds]


def _is_number(time: object) -> bool:
    try:
        return math.isfinite(float(str(time)))
    except ValueError:
        return False


def _seconds(time: object, spec: CampaignSpec) -> float:
    """Return a time in seconds; raises `ValueError`.  A date without a zone is one of UTC."""
    if _is_number(time):
        return float(str(time)) * SECONDS[spec.time_unit]
    date = time if isinstance(time, datetime) else datetime.fromisoformat(str(time))
    return (date if date.tzinfo else date.replace(tzinfo=UTC)).timestamp()


def _repeated_times(rows: Sequence[_Row], times: Sequence[float | None]) -> Iterable[Issue]:
    """Yield an issue for each run with the time of another run of its rig."""
    known = dict[tuple[str, float], str]()
    for row, time in zip(rows, times, strict=True):
        if time is not None and not math.isnan(time):
            other = known.setdefault((row.rig, time), row.name)
            if other != row.name:
                message = f"{row.name} has the time of {other}; give each its own, or none at all"
                yield Issue(row.place, message)


def _notes(spec: CampaignSpec, rows: Sequence[_Row]) -> Iterable[str]:
    """Yield sentences on what is allowed, but should be known."""
    if spec.leave_out:
        yield f"left out by name: {', '.join(spec.leave_out)}"
    for name in spec.noted:
        blank = [row.name for row in rows if math.isnan(row.noted[name])]
        if blank:
            listed = ", ".join(blank[:10]) + (", ..." if len(blank) > 10 else "")
            yield f"{name} was not noted in {len(blank)} of {len(rows)} runs: {listed}"
