"""Files of records as they are understood: time, rows and columns of each, and which belong
together.
"""

from __future__ import annotations

import dataclasses
import itertools
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bayesdrill import output_files
from bayesdrill.basics import units
from bayesdrill.basics.arrays import Array
from bayesdrill.basics.errors import InputError, Issue, collect_each
from bayesdrill.drafting import roles, sensors, signals
from bayesdrill.drafting.columns import LEAST, NamedColumn, Seen, look, way_out
from bayesdrill.drafting.roles import Roles
from bayesdrill.drafting.signals import Part, Sensor, Timing
from bayesdrill.record.formats import FORMATS, format_of
from bayesdrill.record.formats.table import Table
from bayesdrill.rig.models.linear import Model


@dataclass(frozen=True, slots=True, kw_only=True)
class Known:
    """What the user says beside the files: `gear`: turns of the motor for one of the shaft; `voltage`: a
    constant one [V]; `rate` [Hz]; `rig` and `columns`.
    """

    rig: Model
    gear: float | None = None
    voltage: float | None = None
    rate: float = 0.0
    columns: tuple[NamedColumn, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Examined:
    """A file as it is understood, or several that make one record: `beside` are the others."""

    path: Path
    columns: Sequence[Seen]
    time: Timing
    part: Part
    found: Roles
    left_out: dict[str, str]
    beside: tuple[Examined, ...] = ()

    @property
    def sensors(self) -> list[Sensor]:
        return [*(one.sensor for one in self.found.channels), *self.found.inputs.values()]

    @property
    def doubts(self) -> tuple[int, int]:
        """Units that are guessed, and all that is not sure."""
        guessed = sum(one.guessed for one in self.sensors)
        return guessed, sum(len(one.doubts) for one in self.sensors)

    def file_of(self, sensor: Sensor) -> Examined:
        """That in which a column of the record stands."""
        return self.beside[sensor.seen.file - 1] if sensor.seen.file else self


def examine(path: Path, known: Known) -> Examined:
    """Raises `InputError` where nothing can be made of the file."""
    columns, left_out = look(
        _read(path), [one for one in known.columns if one.file in ("", path.name)]
    )
    if not columns:
        raise hopeless(path, left_out, f"no column has {LEAST} numbers or more")
    try:
        output_files.check_guessed(len(columns[0].values), len(columns))
    except ValueError as error:
        raise InputError.one(str(path), str(error)) from None
    time = signals.find_time(columns, sensors.rate(columns), known.rate)
    return _understood(path, columns, time, left_out, known)


def _understood(
    path: Path, columns: Sequence[Seen], time: Timing, left_out: dict[str, str], known: Known
) -> Examined:
    others = [one for one in columns if one is not time.column]
    part = signals.part(time, [one for one in others if one.says.kind])
    if part is None:
        raise hopeless(path, left_out, f"nowhere {LEAST} rows follow each other in time")
    those, why_not = sensors.sensors(others, part)
    given = known.voltage is not None
    found = roles.with_signs(roles.roles(those, part.dt, known.rig, known.gear, voltage=given))
    whole = left_out | why_not | found.left_out
    return Examined(path, columns, time, part, found, whole)


def as_told(one: Examined, lead: Examined) -> Examined:
    """The same columns as those of `lead`, with its meanings; `InputError` where one is missing."""
    wanted = [sensor.seen for sensor in lead.sensors]
    every = wanted if lead.time.column is None else [*wanted, lead.time.column]
    by = {column.key: column for column in one.columns}
    if missing := [column.name for column in every if column.key not in by]:
        raise InputError.one(
            str(one.path),
            f"has no column {', '.join(missing)}, and {lead.path} has; several files have to be of one "
            "kind, or complete each other at the same times; else write a config of each",
        )

    def same(column: Seen) -> Seen:
        return by[column.key]

    clock = None if lead.time.column is None else same(lead.time.column)
    if clock is None:  # as many samples a second
        t = lead.time.dt * np.arange(len(one.time.t), dtype=np.float64)
    else:
        t = clock.values * units.factor(lead.time.unit, "s")
    time = dataclasses.replace(lead.time, t=t, column=clock)
    used = [same(column) for column in wanted]
    part = signals.part(time, used)
    if part is None:
        raise hopeless(one.path, {}, f"nowhere {LEAST} rows follow each other in time")
    jumped = signals.jumps(used, part)

    def sensor(like: Sensor) -> Sensor:
        found = same(like.seen)
        if np.isfinite(found.values[part.rows]).sum() < LEAST:
            raise hopeless(one.path, {}, f"column {like.name} has less than {LEAST} numbers")
        drawn = signals.draft(found, part, jumped, like.kind, like.unit)
        if not drawn.varies and like.kind not in ("voltage", "torque"):
            message = f"column {like.name} is {drawn.raw.x[0]:g} in every row; leave this file out"
            raise InputError.one(str(one.path), message)
        return dataclasses.replace(drawn, place=like.place, why=like.why, doubts=like.doubts)

    found = lead.found.with_sensors(sensor)
    whole = Examined(one.path, one.columns, time, part, found, lead.left_out, one.beside)
    return _as_measured(whole)


def hopeless(
    record: Path, left_out: dict[str, str], why: str, columns: Sequence[Seen] = ()
) -> InputError:
    """What nothing can be made of, and what to type; `columns`: those of which nothing is known."""
    reasons = [Issue(str(record), f"column {name} {text}") for name, text in left_out.items()]
    typed = way_out(columns) or '--columns "speed=w_2 [rpm]"'
    message = f"{why}; say what columns are, for example {typed}, or write a config by hand"
    return InputError([Issue(str(record), message), *reasons])


def _read(record: Path) -> Table:
    output_files.check_file(record, output_files.LARGEST_GUESSED)
    kind = FORMATS[format_of(record)]
    return kind.read(record, kind.options(), None)


LONGEST_NAME = 40
NUMBERED = "run"


@dataclass(frozen=True, slots=True, eq=False)
class Experiment:
    label: str
    of: Examined


def experiments(records: Sequence[Path], known: Known) -> tuple[tuple[Experiment, ...], Experiment]:
    """All, and the one as which all are understood.

    Raises `InputError` where nothing can be made of a file, or not of all together.
    """
    for k, path in enumerate(records):
        if path.resolve() in [other.resolve() for other in records[:k]]:
            raise InputError.one(str(path), "is named twice; name each file once")
    kinds = _kinds(collect_each(lambda path: examine(path, known), records))
    every = _completed(kinds, known) if len(kinds) > 1 else kinds[0]
    collect_each(_refuse_without_channels, every)
    lead = min(every, key=_unsure)
    every = collect_each(lambda one: one if one is lead else as_told(one, lead), every)
    names = labels([one.path for one in every]) if len(every) > 1 else [""]
    found = tuple(Experiment(name, one) for name, one in zip(names, every, strict=True))
    return found, next(one for one in found if one.of.path == lead.path)


def _refuse_without_channels(one: Examined) -> None:
    if not one.found.channels:
        why = "no column is an angle, a speed or a current of the rig"
        columns = [c for c in one.columns if c is not one.time.column]
        nameless = [c for c in columns if not c.says.kind or c.name in one.left_out]
        raise hopeless(one.path, one.left_out, why, nameless or columns)


def _unsure(one: Examined) -> tuple[int, int, tuple[int, int]]:
    return -len(one.found.channels), -len(one.found.inputs), one.doubts


def _kinds(examined: Sequence[Examined]) -> list[list[Examined]]:
    """Files with the columns that are used of the one that tells most, and those without, in turn."""
    remaining, kinds = [*examined], []
    while remaining:
        lead = min(remaining, key=_unsure)
        used = {(sensor.seen.key, sensor.seen.says) for sensor in lead.sensors}
        same = [o for o in remaining if used <= {(c.key, c.says) for c in o.columns}]
        kinds.append(same)
        remaining = [one for one in remaining if one not in same]
    return kinds


def _completed(kinds: Sequence[Sequence[Examined]], known: Known) -> list[Examined]:
    """Records of which each is a file of every kind."""
    lead, *others = kinds
    names = [
        n
        for kind in kinds
        for n in (*(c.name for c in kind[0].found.channels), *kind[0].found.inputs)
    ]
    if len({*names}) < len(names) or not all(kind[0].sensors for kind in kinds):
        for one in others[0]:
            as_told(one, lead[0])  # says what is missing
        collect_each(_refuse_without_channels, others[0])
    pairs = []
    for one in lead:
        beside = [max(kind, key=lambda other: _alike(one.path, other.path)) for kind in others]
        pairs.append((one, beside))
    taken = {id(file) for _, beside in pairs for file in beside}
    if {len(kind) for kind in others} != {len(lead)} or len(taken) < len(lead) * len(others):
        held = ", ".join(str(one.path) for one in others[0])
        message = (
            f"is completed by other files: {held}; name for each record one of each kind, and let their "
            "names begin alike (slow.csv, slow_v.csv), or write a config of each"
        )
        raise InputError.one(str(lead[0].path), message)
    return [_joined(one, beside, known) for one, beside in pairs]


def _alike(one: Path, other: Path) -> int:
    return _alike_at_first([one.stem, other.stem])


def _joined(one: Examined, beside: Sequence[Examined], known: Known) -> Examined:
    """A record of several files, whose columns are understood together, at the times of the first."""
    columns, t = [*one.columns], one.time.t
    for k, other in enumerate(beside, start=1):
        for file in (one, other):
            if file.time.column is None and not np.array_equal(t, other.time.t):
                message = "has no column of times, and cannot be laid beside another file; add one"
                raise InputError.one(str(file.path), message)
        s = other.part.t
        if np.sum((one.part.t >= s[0]) & (one.part.t <= s[-1])) < LEAST:
            raise InputError.one(
                str(other.path),
                f"goes from {s[0]:.6g} to {s[-1]:.6g} s, and {one.path} from {one.part.t[0]:.6g} to "
                f"{one.part.t[-1]:.6g} s; files of one record have to overlap: bring both to one clock",
            )
        columns += [
            dataclasses.replace(
                c, name=f"{c.name} of {other.path.name}", file=k, values=_at(t, other, c)
            )
            for c in other.columns
            if c is not other.time.column
        ]
    whole = _understood(one.path, columns, one.time, {}, known)
    return _as_measured(dataclasses.replace(whole, beside=tuple(beside)))


def _as_measured(one: Examined) -> Examined:
    """With what each sensor measured on its own clock, where that is not the record's."""

    def own(sensor: Sensor) -> Sensor:
        file = one.file_of(sensor)
        if np.array_equal(file.time.t, one.time.t):
            return sensor
        column = next(c for c in file.columns if c.address == sensor.seen.address)
        calm = np.zeros(len(file.part.t), dtype=np.bool_)
        raw = signals.draft(column, file.part, calm, sensor.kind, sensor.unit).raw
        return dataclasses.replace(sensor, raw=raw)

    return dataclasses.replace(one, found=one.found.with_sensors(own))


def _at(t: Array, file: Examined, column: Seen) -> Array:
    """A column of another file at times `t (T,)`, NaN where it has none."""
    if np.array_equal(t, file.time.t):
        return column.values
    known = np.isfinite(column.values[file.part.rows])
    times, values = file.part.t[known], column.values[file.part.rows][known]
    return np.asarray(np.interp(t, times, values, left=np.nan, right=np.nan))


def labels(paths: Sequence[Path]) -> list[str]:
    """Of each the shortest part of its name that tells it from the others, as an identifier."""
    tokens = [_tokens(path) for path in paths]
    least = min(map(len, tokens))
    first = _alike_at_first(tokens)
    last = min(least - first, _alike_at_first([one[::-1] for one in tokens]))
    if any(len(one) == first + last for one in tokens):  # one has nothing of its own
        first, last = max(first - 1, 0), 0
    found = ["_".join(one[first : len(one) - last])[-LONGEST_NAME:] for one in tokens]
    named = [one if one.isidentifier() else f"{NUMBERED}_{one}" for one in found]
    if len({*named}) == len(named) and all(one.isidentifier() for one in named):
        return named
    return [f"{NUMBERED}_{k}" for k in range(1, len(named) + 1)]


def _tokens(path: Path) -> list[str]:
    """Of the whole path, as names may be alike in several folders."""
    return [part for part in re.split(r"[\W_]+", path.with_suffix("").as_posix()) if part]


def stem(paths: Sequence[Path]) -> str:
    """What the names of several files have in common."""
    every = [re.split(r"[\W_]+", path.stem) for path in paths]
    shared = every[0][: _alike_at_first(every)]
    return "_".join(part for part in shared if part) or "experiments"


def _alike_at_first(every: Sequence[Sequence[str]]) -> int:
    """How many letters, or words, all have in common before they differ."""
    alike = itertools.takewhile(lambda column: len({*column}) == 1, zip(*every, strict=False))
    return sum(1 for _ in alike)
