"""List the runs of a campaign from a glob, from a table, or from the campaign's own file."""

from __future__ import annotations

import csv
import glob
import math
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
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
from bayesdrill.config.schema.campaign import SECONDS, CampaignSpec, TimeUnit
from bayesdrill.config.yaml_source import Location, Source, read
from bayesdrill.record.formats.arrays import CUT_SHORT
from bayesdrill.record.formats.table import decode, missing_package, read_bytes

NO_PARQUET = "Parquet, in which a campaign keeps its draws,"


@dataclass(frozen=True, slots=True, kw_only=True)
class CampaignRun:
    """A run has a name, the `path` of its record, and covariates `noted` by column.

    `time` [s] is the time since the first run.  `changes` are the entries in which the run's config
    differs from the base config.  `location` is the line or file that lists the run.
    """

    name: str
    path: Path
    rig: str = ""
    time: float | None = None
    noted: Mapping[str, float] = field(default_factory=dict)
    changes: Mapping[str, Any] = field(default_factory=dict)
    location: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class CampaignPlan:
    """A plan has the entries of a campaign's file, its runs in the order of time, and notes on them.

    `base` is the config of all runs.
    """

    spec: CampaignSpec
    source: Source
    base: Source
    runs: tuple[CampaignRun, ...] = ()
    notes: tuple[str, ...] = ()


DATE_AS_NUMBER = re.compile(r"(19|20)\d\d(0[1-9]|1[0-2])(0[1-9]|[12]\d|3[01])")  # 20260301
Listed = list[tuple[CampaignRun, Any]]  # runs, and their times as written; None or "": no time
NumberedRow = tuple[int, Sequence[Any]]  # the number of a row of a table, and its cells


def read_spec(path: Path) -> tuple[Source, CampaignSpec]:
    """Read the file of a campaign; raises `InputError` with all its mistakes."""
    source = read(path)
    if "record" in source.data:
        message = "is a config of one record; the file of a campaign has `base` and `runs`"
        raise InputError.at(str(path), message)
    return source, loading.read_document(CampaignSpec, source)


def read_plan(path: Path) -> CampaignPlan:
    """Read the file of a campaign and list its runs; raises `InputError` with all mistakes.

    No record is read.
    """
    source, spec = read_spec(path)
    base, issues = read(path.parent / spec.base), list[Issue]()
    if "experiments" in base.data:
        message = "has several experiments; a campaign needs a config of a single record"
        issues.append(source.issue(("base",), message))
    listed = _listed(source, spec, issues)
    issues += _mistaken_entries(source, spec, [run.name for run, _ in listed])
    listed = [(run, time) for run, time in listed if run.name not in spec.leave_out]
    times = _times(listed, spec, issues)
    runs = [
        replace(run, time=time, changes=spec.overrides.get(run.name, {}))
        for (run, _), time in zip(listed, times, strict=True)
    ]
    issues += _repeated(runs)
    if issues:
        raise InputError(list(dict.fromkeys(issues)))
    if spec.by_name or None not in times:
        runs.sort(key=lambda run: (run.time or 0.0, natural_key(run.name)))
    notes = tuple(_notes(spec, runs))
    return CampaignPlan(spec=spec, source=source, base=base, runs=tuple(runs), notes=notes)


def describe_plan(plan: CampaignPlan, notes: Sequence[str]) -> str:
    """Describe the runs in lines of text, with a line for each of the `notes`."""
    spec, runs = plan.spec, plan.runs
    rigs = {run.rig for run in runs}
    many = f" of {len(rigs)} rigs" if len(rigs) > 1 else ""
    lines = [f"campaign {spec.name}: {len(runs)} runs{many}, each with the config {plan.base.path}"]
    times = [run.time for run in runs if run.time is not None]
    span = f"over {max(times, default=0.0) / SECONDS[spec.time_unit]:.6g} {spec.time_unit}"
    span = "equal steps, in the order of names" if spec.by_name else span
    lines.append(f"times: {span}" if times else "times: none, so drifts are not searched")
    lines.append(f"noted columns: {', '.join(spec.noted) or 'none'}")
    return "\n".join([*lines, *(f"note: {note}" for note in notes)])


def natural_key(name: str) -> tuple[Any, ...]:
    """Return a sort key by which run_9 comes before run_10."""
    return tuple((int(part), "") if part.isdecimal() else (-1, part) for part in _PARTS.split(name))


_PARTS = re.compile(r"(\d+)", re.ASCII)


def _mistaken_entries(source: Source, spec: CampaignSpec, names: Sequence[str]) -> Iterable[Issue]:
    """Yield the mistakes in entries that name runs, columns or files."""
    places: dict[Location, str] = {("leave_out", k): name for k, name in enumerate(spec.leave_out)}
    for place, name in (places | {("overrides", name): name for name in spec.overrides}).items():
        if names and name not in names:
            yield source.issue(place, f"no run is called {name}{did_you_mean(name, names)}")
    if names and not {*names}.difference(spec.leave_out):
        yield source.issue(("leave_out",), "no run remains; take some out of this list")
    for name, changes in spec.overrides.items():
        record = changes.get("record")
        if isinstance(record, Mapping) and "file" in record:
            message = "the file of a run is that of `runs`; change it there"
            yield source.issue(("overrides", name, "record", "file"), message)
    for k, name in enumerate(spec.noted):
        if name in spec.noted[:k]:
            yield source.issue(("noted", k), f"{name} stands here twice; remove one of them")


def _listed(source: Source, spec: CampaignSpec, issues: list[Issue]) -> Listed:
    """Return all listed runs, including those in `leave_out`."""
    folder, runs = source.path.parent, spec.runs
    if isinstance(runs, list):
        for k, run in enumerate(runs):
            for name in run.noted.keys() - {*spec.noted}:
                message = (
                    f"is not in the list `noted` of the campaign{did_you_mean(name, spec.noted)}"
                )
                issues.append(source.issue(("runs", k, "noted", name), message))
        return [
            _run(dict(run), run.noted, spec, folder, source.issue(("runs", k), "").place, issues)
            for k, run in enumerate(runs)
        ]
    if not glob.has_magic(runs):
        if (folder / runs).is_dir():
            message = f"{runs} is a folder; give a glob such as {runs}/*.csv, or a table of runs"
            raise source.error(("runs",), message)
        return _table_rows(folder / runs, spec, issues)
    if spec.noted:
        message = "a glob has no columns; name a table with the column file and the noted columns"
        issues.append(source.issue(("noted",), message))
    inside = "" if Path(runs).is_absolute() else f"{glob.escape(str(folder))}/"
    matches = sorted(glob.iglob(inside + runs, recursive=True), key=natural_key)
    files = [Path(match) for match in matches if os.path.splitext(match)[1]]
    if not files:
        message = f"no file matches {runs}, in the folder of this file; check both"
        issues.append(source.issue(("runs",), message))
    return [(CampaignRun(name=file.stem, path=file, location=str(file)), None) for file in files]


def _table_rows(path: Path, spec: CampaignSpec, issues: list[Issue]) -> Listed:
    columns, cells = _parquet(path) if path.suffix == ".parquet" else _csv(path)
    twice = dict.fromkeys(name for name in columns if columns.count(name) > 1)
    wrong = [f"has two columns {name}; rename one of them" for name in twice]
    lacking = [name for name in ("file", *spec.noted) if name not in columns]
    wrong += [f"has no column {name}{did_you_mean(name, columns)}" for name in lacking]
    if not wrong and not cells:
        wrong = ["has no rows; a campaign needs at least three runs"]
    issues += [Issue(str(path), message) for message in wrong]
    rows, folder = Listed(), path.parent
    for number, row in cells if not wrong else ():
        place = f"{path} row {number}"
        if len(row) != len(columns):
            issues.append(
                Issue(place, f"has {count_noun(len(row), 'cell')}, the header {len(columns)}")
            )
            continue
        known = dict(zip(columns, row, strict=True))
        file = str(known["file"] or "")
        if not file or "\0" in file:
            message = "its file has a NUL in its name" if file else "names no file"
            issues.append(Issue(place, message))
            continue
        rows.append(_run(known, known, spec, folder, place, issues))
    return rows


def _run(
    known: Mapping[str, Any],
    noted: Mapping[str, Any],
    spec: CampaignSpec,
    folder: Path,
    location: str,
    issues: list[Issue],
) -> tuple[CampaignRun, Any]:
    """Return the run of a row or an entry, and its time as it is written."""
    file = str(known["file"])
    name, rig = ("" if x is None else str(x) for x in map(known.get, ("name", "rig")))
    run = CampaignRun(
        name=name or Path(file).stem,
        path=folder / file,
        rig=rig,
        noted={name: _noted_number(noted.get(name), name, location, issues) for name in spec.noted},
        location=location,
    )
    return run, known.get("time")


def _csv(path: Path) -> tuple[list[str], Sequence[NumberedRow]]:
    """Return the header, and the other rows with their row numbers; blank lines are skipped."""
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
    read_bytes(path, 1)  # raises an error that says if there is no file
    with report_damage(str(path), f"the Parquet file {CUT_SHORT}"):
        table = parquet.read_table(path)
        columns = (map(_nan_as_none, each.to_pylist()) for each in table.columns)
        return table.column_names, [*enumerate(zip(*columns, strict=True), start=1)]


def _nan_as_none(cell: Any) -> Any:
    return None if isinstance(cell, float) and math.isnan(cell) else cell


def _noted_number(cell: Any, name: str, location: str, issues: list[Issue]) -> float:
    """Return a noted number, NaN for an empty cell; text and infinite numbers add an issue."""
    try:
        value = float(cell) if cell not in (None, "") else math.nan
    except (TypeError, ValueError):
        value = math.inf
    if math.isinf(value):
        message = f"'{shortened(str(cell))}' is not a number; leave the cell empty if none is known"
        issues.append(Issue(f"{location}: {name}", message))
    return value


def _times(listed: Listed, spec: CampaignSpec, issues: list[Issue]) -> Sequence[float | None]:
    """Return the time [s] of each run since the first run; all are None if no run has a time."""
    blank = [run for run, time in listed if time in (None, "")]
    if spec.by_name:
        if len(blank) < len(listed):
            issues.append(Issue(listed[0][0].location, "runs have times; remove `by_name`"))
        order = sorted((run.name for run, _ in listed), key=natural_key)
        places = {name: k * SECONDS[spec.time_unit] for k, name in enumerate(order)}
        return [places[run.name] for run, _ in listed]
    if len(blank) == len(listed):
        return [None] * len(listed)
    issues += [
        Issue(run.location, "has no time, and other runs have; give all or none") for run in blank
    ]
    seconds, kinds = list[float](), set[str]()
    for run, time in listed:
        kind, second = _seconds(time, spec.time_unit)
        seconds.append(second)
        kinds.add(kind)
        if not kind and time not in (None, ""):
            message = f"'{shortened(str(time))}' is neither a number nor a date (2026-03-01T12:00)"
            issues.append(Issue(f"{run.location}: time", message))
    if {"number", "date"} <= kinds:
        message = "some times are numbers and others dates; write all alike"
        issues.append(Issue(listed[0][0].location, message))
    if all(DATE_AS_NUMBER.fullmatch(str(time)) for _, time in listed):
        message = f"{listed[0][1]} would be read as a number; write a date as 2026-03-01"
        issues.append(Issue(f"{listed[0][0].location}: time", message))
    start = min(seconds)
    return [second - start for second in seconds]


def _seconds(time: object, unit: TimeUnit) -> tuple[str, float]:
    """Return the kind of a time ("number", "date", or "" for neither), and the time in seconds.

    A date without a time zone is in UTC.
    """
    text = str(time)
    try:
        second = float(text) * SECONDS[unit]
    except ValueError:
        try:
            date = time if isinstance(time, datetime) else datetime.fromisoformat(text)
        except ValueError:
            return "", math.nan
        return "date", (date if date.tzinfo else date.replace(tzinfo=UTC)).timestamp()
    return ("number", second) if math.isfinite(second) else ("", math.nan)


def _repeated(runs: Sequence[CampaignRun]) -> Iterable[Issue]:
    """Yield an issue for each run with the name, the file, or both rig and time of another run."""
    names, files = dict[str, CampaignRun](), dict[str, CampaignRun]()
    times = dict[tuple[str, float], str]()
    for run in runs:
        path = os.path.abspath(run.path)  # `resolve` would access each of possibly a million files
        if path in files:
            other = files[path].location
            yield Issue(
                run.location, f"{run.path} is a run already ({other}); take out one of them"
            )
        elif run.name in names:
            other = str(names[run.name].path)
            message = f"{run.path} and {other} have the name {run.name}; give `name` in a table"
            yield Issue(run.location, message)
        names.setdefault(run.name, run)
        files.setdefault(path, run)
        if run.time is not None and not math.isnan(run.time):
            other = times.setdefault((run.rig, run.time), run.name)
            if other != run.name:
                message = f"{run.name} has the time of {other}; give each its own, or none at all"
                yield Issue(run.location, message)


def _notes(spec: CampaignSpec, runs: Sequence[CampaignRun]) -> Iterable[str]:
    """Yield sentences about entries that are allowed but unusual."""
    if spec.leave_out:
        yield f"left out by name: {', '.join(spec.leave_out)}"
    for name in spec.noted:
        blank = [run.name for run in runs if math.isnan(run.noted[name])]
        if blank:
            listed = ", ".join(blank[:10]) + (", ..." if len(blank) > 10 else "")
            yield f"{name} was not noted in {len(blank)} of {len(runs)} runs: {listed}"
