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
from bayesdrill.basics.errors import InputError, Issue, of_each
from bayesdrill.drafting import roles, sensors, signals
from bayesdrill.drafting.columns import LEAST, Seen, look
from bayesdrill.drafting.roles import Roles
from bayesdrill.drafting.signals import Part, Sensor, Timing
from bayesdrill.record.formats import FORMATS, format_of
from bayesdrill.record.formats.table import Table


@dataclass(frozen=True, slots=True, eq=False)
class Examined:
    path: Path
    columns: Sequence[Seen]
    time: Timing
    part: Part
    found: Roles
    left_out: dict[str, str]

    @property
    def only_inputs(self) -> bool:
        return not self.found.channels and (self.found.v is not None or self.found.t_1 is not None)

    @property
    def doubts(self) -> tuple[int, int]:
        """Units that are guessed, and all that is not sure."""
        sensors = [one.sensor for one in self.found.channels]
        sensors += [one for one in (self.found.v, self.found.t_1) if one is not None]
        guessed, doubts = sum(one.guessed for one in sensors), sum(len(o.doubts) for o in sensors)
        return guessed, doubts


def examine(path: Path, gear: float | None) -> Examined:
    """`gear`: where it is known; raises `InputError` where nothing can be made of the file."""
    columns, left_out = look(_read(path))
    if not columns:
        raise hopeless(path, left_out, f"no column has {LEAST} numbers or more")
    try:
        output_files.check_guessed(len(columns[0].values), len(columns))
    except ValueError as error:
        raise InputError.one(str(path), str(error)) from None
    time = signals.find_time(columns, sensors.rate(columns))
    others = [one for one in columns if one is not time.column]
    part = signals.part(time, [one for one in others if one.says.kind])
    if part is None:
        raise hopeless(path, left_out, f"nowhere {LEAST} rows follow each other in time")
    those, why_not = sensors.sensors(others, part)
    found = roles.with_signs(roles.roles(those, part.dt, gear))
    left_out |= why_not | found.left_out
    return Examined(path, columns, time, part, found, left_out)


def as_told(one: Examined, lead: Examined) -> Examined:
    """The same columns as those of `lead`, with its meanings; `InputError` where one is missing."""
    like = [channel.sensor for channel in lead.found.channels]
    like += [given for given in (lead.found.v, lead.found.t_1) if given is not None]
    wanted = [sensor.seen for sensor in like]
    every = wanted if lead.time.column is None else [*wanted, lead.time.column]
    by = {tuple(column.address.items()): column for column in one.columns}
    if missing := [column.name for column in every if tuple(column.address.items()) not in by]:
        raise InputError.one(
            str(one.path),
            f"has no column {', '.join(missing)}, and {lead.path} has; several files have to be of one "
            "kind, or one of channels and one of inputs at the same times; else write a config of each",
        )

    def same(column: Seen) -> Seen:
        return by[tuple(column.address.items())]

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

    found = dataclasses.replace(
        lead.found,
        channels=tuple(
            dataclasses.replace(c, sensor=sensor(c.sensor)) for c in lead.found.channels
        ),
        v=None if lead.found.v is None else sensor(lead.found.v),
        t_1=None if lead.found.t_1 is None else sensor(lead.found.t_1),
    )
    return Examined(one.path, one.columns, time, part, found, lead.left_out)


def hopeless(record: Path, left_out: dict[str, str], why: str) -> InputError:
    reasons = [Issue(str(record), f"column {name} {text}") for name, text in left_out.items()]
    message = (
        f"{why}; name them so (theta_1 [rad], n_motor [rpm], t [s]), or write a config by hand"
    )
    return InputError([Issue(str(record), message), *reasons])


def _read(record: Path) -> Table:
    output_files.check_file(record, output_files.LARGEST_GUESSED)
    kind = FORMATS[format_of(record)]
    return kind.read(record, kind.options(), None)


LONGEST_NAME = 40
NUMBERED = "run"


@dataclass(frozen=True, slots=True, eq=False)
class Experiment:
    """`of`: the file of the channels, with the inputs at its times; `inputs`: their file, if another."""

    label: str
    of: Examined
    inputs: Examined | None


def experiments(
    records: Sequence[Path], gear: float | None
) -> tuple[tuple[Experiment, ...], Experiment]:
    """All, and the one as which all are understood.

    Raises `InputError` where nothing can be made of a file, or not of all together.
    """
    for k, path in enumerate(records):
        if path.resolve() in [other.resolve() for other in records[:k]]:
            raise InputError.one(str(path), "is named twice; name each file once")
    examined = of_each(lambda path: examine(path, gear), records)
    inputs = [one for one in examined if one.only_inputs]
    channels = [one for one in examined if not one.only_inputs]
    of_each(_refuse_without_channels, channels or inputs)
    lead = min(channels, key=_unsure)
    channels = of_each(lambda one: one if one is lead else as_told(one, lead), channels)
    beside: list[Examined | None] = [None] * len(channels)
    if inputs:
        best = min(inputs, key=lambda one: one.doubts)
        inputs = of_each(lambda one: one if one is best else as_told(one, best), inputs)
        beside = [*_paired(channels, inputs)]
    names = labels([one.path for one in channels]) if len(channels) > 1 else [""]
    every = tuple(
        Experiment(name, one if other is None else _joined(one, other), other)
        for name, one, other in zip(names, channels, beside, strict=True)
    )
    return every, next(one for one in every if one.of.path == lead.path)


def _refuse_without_channels(one: Examined) -> None:
    if not one.found.channels:
        why = "no column is an angle, a speed or a current of the rig"
        raise hopeless(one.path, one.left_out, why)


def _unsure(one: Examined) -> tuple[int, bool, tuple[int, int]]:
    return -len(one.found.channels), one.found.v is None, one.doubts


def _paired(channels: Sequence[Examined], inputs: Sequence[Examined]) -> list[Examined]:
    """The file of inputs of each file of channels: that whose name begins alike."""
    taken = [one for one in channels if one.found.v is not None and inputs[0].found.v is not None]
    if taken:
        message = f"holds inputs alone, and {taken[0].path} has a voltage of its own; leave one out"
        raise InputError.one(str(inputs[0].path), message)
    found = [max(inputs, key=lambda other: _alike(one.path, other.path)) for one in channels]
    if len(inputs) != len(channels) or len({id(one) for one in found}) != len(inputs):
        held = ", ".join(str(one.path) for one in inputs)
        message = (
            f"holds no voltage, and these hold inputs alone: {held}; give for each file of channels one "
            "of inputs whose name begins alike (slow.csv, slow_v.csv), or write a config of each"
        )
        raise InputError.one(str(channels[0].path), message)
    return found


def _alike(one: Path, other: Path) -> int:
    return _alike_at_first([one.stem, other.stem])


def _joined(one: Examined, other: Examined) -> Examined:
    """Channels with inputs of another file, as they were at the channels' times."""
    for file in (one, other):
        if file.time.column is None:
            message = "has no column of times, and cannot be laid beside another file; add one"
            raise InputError.one(str(file.path), message)
    t, s = one.part.t, other.part.t
    if np.sum((t >= s[0]) & (t <= s[-1])) < LEAST:
        raise InputError.one(
            str(other.path),
            f"goes from {s[0]:.6g} to {s[-1]:.6g} s, and {one.path} from {t[0]:.6g} to {t[-1]:.6g} s; "
            "inputs have to be of the times of the channels: bring both to one clock",
        )

    def there(sensor: Sensor | None) -> Sensor | None:
        if sensor is None:
            return None
        return sensor.but(values=np.interp(one.part.grid, sensor.raw.t, sensor.raw.x))

    found = dataclasses.replace(
        one.found,
        v=there(other.found.v) or one.found.v,
        t_1=there(other.found.t_1) or one.found.t_1,
    )
    return dataclasses.replace(one, found=found)


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
