"""From the file of a record to a config that runs, or to why none can be made of it."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from bayesdrill.basics import own_files, sizes
from bayesdrill.basics.errors import InputError, Problem
from bayesdrill.record.formats import FORMATS, Table, format_of
from bayesdrill.setup import job, loading
from bayesdrill.setup.guessing import page, roles, sensors, start, timing
from bayesdrill.setup.guessing.columns import LEAST, look
from bayesdrill.setup.yaml_source import parse


@dataclass(frozen=True, slots=True)
class Guess:
    """`text` of a config for the place `path`; `asks`: what `check` would say of it."""

    path: Path
    text: str
    channels: tuple[str, ...]
    asks: tuple[Problem, ...]

    @property
    def reviews(self) -> int:
        return self.text.count(f"# {page.REVIEW}")

    def __str__(self) -> str:
        marks = "1 mark" if self.reviews == 1 else f"{self.reviews} marks"
        lines = [
            f"{self.path}: channels {', '.join(self.channels)}; {marks} REVIEW to look at",
            *(f"still to do: {one}" for one in self.asks),
        ]
        return "\n".join([*lines, f"then: bayesdrill check {self.path}"])

    __repr__ = __str__


def guess(
    record: Path, target: Path, *, voltage: float | None = None, gear: float | None = None
) -> Guess:
    """A config at `target` for a record; `voltage` [V], `gear`: n of n:1, where they are known.

    Raises `InputError` where nothing can be made of the file.
    """
    table = _read(record)
    columns, left_out = look(table)
    if not columns:
        raise _hopeless(record, left_out, f"no column has {LEAST} numbers or more")
    time = timing.find(columns, sensors.rate(columns))
    others = [one for one in columns if one is not time.column]
    used = [one.values for one in others if one.says.kind]
    rows = timing.longest(time.t, used)
    if rows.stop - rows.start < LEAST:
        raise _hopeless(record, left_out, f"nowhere {LEAST} rows follow each other in equal steps")
    those, why_not = sensors.sensors(others, rows, time.dt)
    found = roles.with_signs(roles.roles(those, time.dt, gear))
    left_out |= why_not | found.left_out
    if not found.channels:
        raise _hopeless(record, left_out, "no column is an angle, a speed or a current of the rig")
    cut = rows.stop - rows.start < len(time.t)
    t = time.t[rows]
    begin = start.start(found, t, cut=cut, measured=_varies(found, voltage))
    text = page.page(
        Path(os.path.relpath(record, target.parent)).as_posix(),
        re.sub(r"[^A-Za-z0-9_.-]+", "_", target.stem).lstrip("_.-")[:100] or "my_rig",
        time,
        found,
        begin,
        left_out,
        voltage=voltage,
        turns_back=roles.both_ways(found),
    )
    return Guess(target, text, tuple(one.name for one in found.channels), _asks(text, target))


def save(made_: Guess, record: Path, *, force: bool) -> None:
    """Never over the record, and over another file with `force` alone; raises `InputError`."""
    path = made_.path
    own_files.refuse_other_than_file(path)
    if path.suffix.lower() not in (".yaml", ".yml") or path.absolute() == record.absolute():
        message = "is no name of a config; give an --output that ends in .yaml"
        raise InputError.one(str(path), message)
    if path.exists() and not force:
        raise InputError.one(str(path), "exists already; give --force or another --output")
    if not path.parent.is_dir():
        raise InputError.one(str(path.parent), "there is no such folder; make it first")
    with own_files.whole(path) as aside:
        aside.write_text(made_.text, encoding="utf-8")


def _read(record: Path) -> Table:
    try:
        sizes.check_file(record)
    except ValueError as error:
        raise InputError.one(str(record), str(error)) from None
    kind = FORMATS[format_of(record)]
    return kind.read(record, kind.options(), None)


def _varies(found: roles.Roles, voltage: float | None) -> bool:
    v = None if voltage is not None else found.v
    if v is not None and v.values.min() < v.values.max():
        return True
    return found.t_1 is not None


def _asks(text: str, target: Path) -> tuple[Problem, ...]:
    """What is wrong with it as it stands, as far as `check` gets."""
    try:
        source = parse(target, text)
        job.assemble(loading.validated(source), source)
    except InputError as error:
        return error.problems
    return ()


def _hopeless(record: Path, left_out: dict[str, str], why: str) -> InputError:
    reasons: Sequence[Problem] = [
        Problem(str(record), f"column {name} {text}") for name, text in left_out.items()
    ]
    message = (
        f"{why}; name them so (theta_1 [rad], n_motor [rpm], t [s]), or write a config by hand"
    )
    return InputError([Problem(str(record), message), *reasons])
