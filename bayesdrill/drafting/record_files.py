"""Identify the time, rows and columns of each file, and which files form a record."""

from __future__ import annotations

import dataclasses
import itertools
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bayesdrill import output_files
from bayesdrill.basics import units
from bayesdrill.basics.arrays import Array
from bayesdrill.basics.errors import InputError, collect_each
from bayesdrill.drafting import roles, sensors, signals, trains
from bayesdrill.drafting.columns import MIN_SAMPLES, FileColumn, NamedColumn, read_columns, unusable
from bayesdrill.drafting.roles import SensorRoles
from bayesdrill.drafting.signals import Segment, Sensor, Timing
from bayesdrill.record.formats import FORMATS, format_of
from bayesdrill.rig.models.linear import Model


@dataclass(frozen=True, slots=True, kw_only=True)
class GivenFacts:
    """The user may give `gear` (8 for 8:1), a constant `voltage` [V], a `rate` [Hz] and columns."""

    rig: Model
    gear: float | None = None
    voltage: float | None = None
    rate: float = 0.0
    columns: tuple[NamedColumn, ...] = ()
    has_several: bool = False  # a new record begins where times go back


@dataclass(frozen=True, slots=True, eq=False)
class RecordFile:
    """A record file is a file with identified columns; files in `companions` complete the record."""

    path: Path
    columns: Sequence[FileColumn]
    time: Timing
    segment: Segment
    roles: SensorRoles
    unused: dict[str, str]
    companions: tuple[RecordFile, ...] = ()
    label: str = ""
    rows: Sequence[int] = ()  # first and last row, if the record is a part of the file

    @property
    def sensors(self) -> list[Sensor]:
        """Return the sensors of the channels, then those of the inputs."""
        return [*(c.sensor for c in self.roles.channels), *self.roles.inputs.values()]

    @property
    def uncertainty(self) -> tuple[int, ...]:
        """Return a sort key, lower with more channels and inputs, and with fewer guesses and doubts."""
        guessed = sum(sensor.guessed for sensor in self.sensors)
        doubts = sum(len(sensor.doubts) for sensor in self.sensors)
        return -len(self.roles.channels), -len(self.roles.inputs), guessed, doubts

    def file_of(self, sensor: Sensor) -> RecordFile:
        """Return the file that contains a sensor's column."""
        return self.companions[sensor.column.file - 1] if sensor.column.file else self


def examine(path: Path, facts: GivenFacts) -> list[RecordFile]:
    """Identify the records of one file; raises `InputError` if it has no usable columns."""
    output_files.check_file(path, output_files.LARGEST_GUESSED)
    reader = FORMATS[format_of(path)]
    named = [column for column in facts.columns if column.file in ("", path.name)]
    table = reader.read(path, reader.options(), None)
    columns, unused = read_columns(table, named)
    if not columns:
        raise unusable(path, unused, f"no column has {MIN_SAMPLES} numbers or more")
    try:
        output_files.check_guessed(len(columns[0].values), len(columns))
    except ValueError as error:
        raise InputError.at(str(path), str(error)) from None
    time = signals.find_time(columns, sensors.infer_rate(columns), facts.rate)
    parts, records = _increasing_parts(time.t), list[RecordFile]()
    if not facts.has_several or not parts:
        for (first, last), (begin, _) in itertools.pairwise(parts):
            if time.t[begin] < time.t[(first + last) // 2]:  # times restart
                back = f"{table.where(begin)} ({time.t[last - 1]:.6g} s to {time.t[begin]:.6g} s)"
                message = f"time goes back at {back}: {len(parts)} records in one file? "
                raise InputError.at(str(path), message + "Use --split for an experiment of each")
        return [_understand(path, columns, time, unused, facts)]
    for begin, end in parts:
        cut = [dataclasses.replace(column, values=column.values[begin:end]) for column in columns]
        clock = None if time.column is None else cut[columns.index(time.column)]
        timing = dataclasses.replace(time, t=time.t[begin:end], column=clock)
        record = _understand(path, cut, timing, unused, facts)
        records.append(dataclasses.replace(record, rows=table.numbers[[begin, end - 1]].tolist()))
    return records


def _increasing_parts(t: Array) -> list[tuple[int, int]]:
    """Return begin and end of each part of increasing times with at least `MIN_SAMPLES`."""
    edges = [0, *(np.flatnonzero(np.diff(t) <= 0) + 1).tolist(), len(t)]
    return [pair for pair in itertools.pairwise(edges) if pair[1] - pair[0] >= MIN_SAMPLES]


def _understand(
    path: Path,
    columns: Sequence[FileColumn],
    time: Timing,
    unused: dict[str, str],
    facts: GivenFacts,
) -> RecordFile:
    others = [column for column in columns if column is not time.column]
    segment = _segment(path, time, [c for c in others if c.meaning.kind], unused)
    known, unusable_columns = sensors.identify_sensors(others, segment)
    if trains.is_train(known, facts.rig):
        try:
            assigned = trains.assign_train(known, segment.dt)
        except InputError as error:
            message = f"these names give no train: {error}. Rename its inertias"
            raise InputError.at("--columns", message) from None
    else:
        voltage = facts.voltage is not None
        assigned = roles.assign_roles(known, segment.dt, facts.rig, facts.gear, voltage=voltage)
    unused = unused | unusable_columns | assigned.unused
    return RecordFile(path, columns, time, segment, assigned, unused)


def _segment(
    path: Path, time: Timing, columns: Sequence[FileColumn], unused: dict[str, str]
) -> Segment:
    segment = signals.longest_segment(time, columns)
    if segment is None:
        raise unusable(path, unused, f"no {MIN_SAMPLES} successive rows have increasing times")
    return segment


def with_roles_of(lead: RecordFile, file: RecordFile) -> RecordFile:
    """Identify the columns of `file` like `lead`'s; raises `InputError` if one is missing."""
    wanted = [sensor.column for sensor in lead.sensors]
    by_key = {column.key: column for column in file.columns}
    timed = wanted if lead.time.column is None else [*wanted, lead.time.column]
    if missing := [column.name for column in timed if column.key not in by_key]:
        raise InputError.at(
            str(file.path),
            f"has no column {', '.join(missing)}, but {lead.path} has. Several files must have the same "
            "columns, or complete each other at the same times. Otherwise write a config for each",
        )
    if lead.time.column is None:  # use the lead's sampling rate
        clock, t = None, lead.time.dt * np.arange(len(file.time.t), dtype=np.float64)
    else:
        clock = by_key[lead.time.column.key]
        t = clock.values * units.factor(lead.time.unit, "s")
    time = dataclasses.replace(lead.time, t=t, column=clock)
    used = [by_key[column.key] for column in wanted]
    segment = _segment(file.path, time, used, {})
    jumped = signals.input_jumps(used, segment)

    def as_in_lead(sensor: Sensor) -> Sensor:
        column = by_key[sensor.column.key]
        if np.isfinite(column.values[segment.rows]).sum() < MIN_SAMPLES:
            reason = f"column {sensor.name} has fewer than {MIN_SAMPLES} numbers"
            raise unusable(file.path, {}, reason)
        new = signals.read_sensor(column, segment, jumped, sensor.kind, sensor.unit)
        if not new.varies and sensor.kind not in ("voltage", "torque"):
            message = f"column {sensor.name} is {new.raw.x[0]:g} in every row. Leave this file out"
            raise InputError.at(str(file.path), message)
        why, doubts = sensor.reasons, sensor.doubts
        return dataclasses.replace(new, location=sensor.location, reasons=why, doubts=doubts)

    assigned = lead.roles.with_sensors(as_in_lead)
    changes: dict[str, Any] = {"segment": segment, "roles": assigned, "unused": lead.unused}
    return _on_own_clocks(dataclasses.replace(file, time=time, **changes))


def read_records(
    paths: Sequence[Path], facts: GivenFacts
) -> tuple[tuple[RecordFile, ...], RecordFile]:
    """Return the records, identified like their lead, and the lead; raises `InputError`."""
    for k, path in enumerate(paths):
        if path.resolve() in [other.resolve() for other in paths[:k]]:
            raise InputError.at(str(path), "is given twice. Give each file once")
    examined = collect_each(lambda path: examine(path, facts), paths)
    kinds = _by_kind([*itertools.chain(*examined)])
    records = _join_kinds(kinds, facts) if len(kinds) > 1 else kinds[0]
    collect_each(_refuse_without_channels, records)
    lead = min(records, key=lambda record: record.uncertainty)
    identified = collect_each(lambda r: r if r is lead else with_roles_of(lead, r), records)
    labels = experiment_labels([r.path for r in identified]) if len(identified) > 1 else [""]
    pairs = zip(identified, labels, strict=True)
    named = tuple(dataclasses.replace(record, label=label) for record, label in pairs)
    return named, named[identified.index(lead)]


def _refuse_without_channels(file: RecordFile) -> None:
    if not file.roles.channels:
        why = "no column is an angle, a speed or a current of the rig"
        columns = [column for column in file.columns if column is not file.time.column]
        unknown = [c for c in columns if not c.meaning.kind or c.name in file.unused]
        raise unusable(file.path, file.unused, why, unknown or columns)


def _by_kind(files: Sequence[RecordFile]) -> list[list[RecordFile]]:
    """Group files that have all the used columns of the most certain file in the group."""
    remaining, kinds = [*files], []
    while remaining:
        lead = min(remaining, key=lambda record: record.uncertainty)
        used = {(sensor.column.key, sensor.column.meaning) for sensor in lead.sensors}
        kinds.append([f for f in remaining if used <= {(c.key, c.meaning) for c in f.columns}])
        remaining = [file for file in remaining if file not in kinds[-1]]
    return kinds


def _join_kinds(kinds: Sequence[Sequence[RecordFile]], facts: GivenFacts) -> list[RecordFile]:
    """Return records, each of which joins one file of every kind."""
    firsts, *others = kinds
    leads = [kind[0].roles for kind in kinds]
    names = [name for lead in leads for name in (*(c.name for c in lead.channels), *lead.inputs)]
    if len({*names}) < len(names) or not all(kind[0].sensors for kind in kinds):
        for file in others[0]:
            with_roles_of(firsts[0], file)  # raises for missing columns
        collect_each(_refuse_without_channels, others[0])
    pairs = [(first, [_nearest(first, kind) for kind in others]) for first in firsts]
    used = {id(file) for _, companions in pairs for file in companions}
    if {len(kind) for kind in others} != {len(firsts)} or len(used) < len(firsts) * len(others):
        message = (
            "cannot be matched with the files that complete it: "
            f"{', '.join(str(file.path) for file in others[0])}. Give one file of each kind for each "
            "record, with names that begin alike (slow.csv, slow_v.csv). Or write a config for each"
        )
        raise InputError.at(str(firsts[0].path), message)
    return [_join(first, companions, facts) for first, companions in pairs]


def _nearest(file: RecordFile, kind: Sequence[RecordFile]) -> RecordFile:
    return max(kind, key=lambda other: _common_length([file.path.stem, other.path.stem]))


def _join(first: RecordFile, companions: Sequence[RecordFile], facts: GivenFacts) -> RecordFile:
    """Return the record of several files, with all columns at the times of the first file."""
    columns, t = [*first.columns], first.time.t
    for k, other in enumerate(companions, start=1):
        for file in (first, other):
            if file.time.column is None and not np.array_equal(t, other.time.t):
                message = "has no column of times, so it cannot be joined with another file"
                raise InputError.at(str(file.path), f"{message}. Add such a column")
        u, s = first.segment.t, other.segment.t
        if np.sum((u >= s[0]) & (u <= s[-1])) < MIN_SAMPLES:
            raise InputError.at(
                str(other.path),
                f"goes from {s[0]:.6g} to {s[-1]:.6g} s, and {first.path} from {u[0]:.6g} to "
                f"{u[-1]:.6g} s. Files of one record must overlap in time: bring both to one clock",
            )
        for column in other.columns:
            if column is not other.time.column:
                name, x = f"{column.name} of {other.path.name}", _interpolated(t, other, column)
                columns.append(dataclasses.replace(column, name=name, file=k, values=x))
    record = _understand(first.path, columns, first.time, {}, facts)
    return _on_own_clocks(dataclasses.replace(record, companions=tuple(companions)))


def _on_own_clocks(record: RecordFile) -> RecordFile:
    """Return the record with each sensor's raw samples on the clock of its file."""

    def on_own_clock(sensor: Sensor) -> Sensor:
        file = record.file_of(sensor)
        if np.array_equal(file.time.t, record.time.t):
            return sensor
        column = next(c for c in file.columns if c.address == sensor.column.address)
        calm = np.zeros(len(file.segment.t), dtype=np.bool_)
        raw = signals.read_sensor(column, file.segment, calm, sensor.kind, sensor.unit).raw
        return dataclasses.replace(sensor, raw=raw)

    return dataclasses.replace(record, roles=record.roles.with_sensors(on_own_clock))


def _interpolated(t: Array, file: RecordFile, column: FileColumn) -> Array:
    """Return a column of another file, interpolated at `t (T,)`; NaN outside that file's times."""
    if np.array_equal(t, file.time.t):
        return column.values
    values = column.values[file.segment.rows]
    known = np.isfinite(values)
    x = np.interp(t, file.segment.t[known], values[known], left=np.nan, right=np.nan)
    return np.asarray(x)


MAX_LABEL_LETTERS = 40
LABEL_PREFIX = "run"


def experiment_labels(paths: Sequence[Path]) -> list[str]:
    """Return a label for each path: its words without those with which all paths begin or end."""
    tokens = [[*filter(None, _split(path.with_suffix("").as_posix()))] for path in paths]
    first = _common_length(tokens)
    shortest, ends = min(map(len, tokens)), [words[::-1] for words in tokens]
    last = min(shortest - first, _common_length(ends))
    if any(len(words) == first + last for words in tokens):  # a path has only common words
        first, last = max(first - 1, 0), 0
    parts = ["_".join(words[first : len(words) - last])[-MAX_LABEL_LETTERS:] for words in tokens]
    labels = [part if part.isidentifier() else f"{LABEL_PREFIX}_{part}" for part in parts]
    if len({*labels}) == len(labels) and all(label.isidentifier() for label in labels):
        return labels
    return [f"{LABEL_PREFIX}_{k}" for k in range(1, len(labels) + 1)]


def common_stem(paths: Sequence[Path]) -> str:
    """Return the common beginning of the names of several files."""
    stems = [_split(path.stem) for path in paths]
    return "_".join(filter(None, stems[0][: _common_length(stems)])) or "experiments"


def _split(name: str) -> list[str]:
    return re.split(r"[\W_]+", name)


def _common_length(names: Sequence[Sequence[str]]) -> int:
    """Return the number of letters, or words, that are common to the beginnings of all names."""
    columns = zip(*names, strict=False)
    return sum(1 for _ in itertools.takewhile(lambda column: len({*column}) == 1, columns))
