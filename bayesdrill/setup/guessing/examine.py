"""One file as it is understood: its time, the rows that are used, and what its columns are."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from bayesdrill.basics import sizes
from bayesdrill.basics.errors import InputError, Problem
from bayesdrill.record.formats import FORMATS, Table, format_of
from bayesdrill.setup.guessing import drafts, parts, roles, sensors, timing
from bayesdrill.setup.guessing.columns import LEAST, Seen, look
from bayesdrill.setup.guessing.drafts import Sensor
from bayesdrill.setup.guessing.parts import Part
from bayesdrill.setup.guessing.roles import Roles
from bayesdrill.setup.guessing.timing import Timing


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
        sizes.check_guessed(len(columns[0].values), len(columns))
    except ValueError as error:
        raise InputError.one(str(path), str(error)) from None
    time = timing.find(columns, sensors.rate(columns))
    others = [one for one in columns if one is not time.column]
    part = parts.part(time, [one for one in others if one.says.kind])
    if part is None:
        raise hopeless(path, left_out, f"nowhere {LEAST} rows follow each other in time")
    those, why_not = sensors.sensors(others, part)
    found = roles.with_signs(roles.roles(those, part.dt, gear))
    left_out |= why_not | found.left_out
    return Examined(path, columns, time, part, found, left_out)


def as_told(one: Examined, lead: Examined) -> Examined:
    """The same columns as those of `lead`, with its meanings; `InputError` where one is missing."""
    missing: list[str] = []
    by = {tuple(column.address.items()): column for column in one.columns}

    def column(like: Seen) -> Seen | None:
        same = by.get(tuple(like.address.items()))
        if same is None:
            missing.append(like.name)
        return same

    wanted = [c.sensor for c in lead.found.channels]
    wanted += [i for i in (lead.found.v, lead.found.t_1) if i is not None]
    seen = {id(sensor): column(sensor.seen) for sensor in wanted}
    if lead.time.column is None:
        time = timing.counted(len(one.time.t), lead.time)
    else:
        own = column(lead.time.column)
        time = one.time if own is None else timing.of(own, lead.time)
    if missing:
        names = ", ".join(missing)
        raise InputError.one(
            str(one.path),
            f"has no column {names}, and {lead.path} has; several files have to be of one kind, or one "
            "of channels and one of inputs at the same times; else write a config of each",
        )
    part = parts.part(time, [c for c in seen.values() if c is not None])
    if part is None:
        raise hopeless(one.path, {}, f"nowhere {LEAST} rows follow each other in time")
    jumped = drafts.jumps([c for c in seen.values() if c is not None], part)

    def sensor(like: Sensor) -> Sensor:
        found = seen[id(like)]
        if found is None or len(parts.numbers(found, part)) < LEAST:
            raise hopeless(one.path, {}, f"column {like.name} has less than {LEAST} numbers")
        drawn = drafts.draft(found, part, jumped, like.kind, like.unit)
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
    reasons = [Problem(str(record), f"column {name} {text}") for name, text in left_out.items()]
    message = (
        f"{why}; name them so (theta_1 [rad], n_motor [rpm], t [s]), or write a config by hand"
    )
    return InputError([Problem(str(record), message), *reasons])


def _read(record: Path) -> Table:
    sizes.check_file(record, sizes.LARGEST_GUESSED)
    kind = FORMATS[format_of(record)]
    return kind.read(record, kind.options(), None)
