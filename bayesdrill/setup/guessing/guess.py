"""From the files of records to a config that runs, or to why none can be made of them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from bayesdrill.basics import own_files
from bayesdrill.basics.errors import InputError, Problem
from bayesdrill.setup import loading, sources
from bayesdrill.setup.guessing import inputs, lags, page, several, start
from bayesdrill.setup.guessing.comments import REVIEW
from bayesdrill.setup.guessing.entries import Found
from bayesdrill.setup.guessing.lags import Lag
from bayesdrill.setup.guessing.several import Experiment, Experiments
from bayesdrill.setup.guessing.start import Start
from bayesdrill.setup.job import assemble
from bayesdrill.setup.yaml_source import parse


@dataclass(frozen=True, slots=True)
class Guess:
    """`text` of a config for the place `path`; `asks`: what of it `check` would refuse."""

    path: Path
    text: str
    channels: tuple[str, ...]
    experiments: tuple[str, ...]
    asks: tuple[Problem, ...]

    @property
    def reviews(self) -> int:
        return self.text.count(f"# {REVIEW}")

    def __str__(self) -> str:
        marks = "1 mark" if self.reviews == 1 else f"{self.reviews} marks"
        of = f"experiments {', '.join(self.experiments)}; " if self.experiments else ""
        lines = [
            f"{self.path}: {of}channels {', '.join(self.channels)}; {marks} REVIEW to look at",
            *(f"still to do: {one}" for one in self.asks),
        ]
        return "\n".join([*lines, f"then: bayesdrill check {self.path}"])

    __repr__ = __str__


def guess(
    records: Sequence[Path],
    target: Path,
    *,
    voltage: float | None = None,
    gear: float | None = None,
) -> Guess:
    """A config at `target` for the files; `voltage` [V], `gear`: n of n:1, where they are known.

    Raises `InputError` where nothing can be made of a file, or not of all together.
    """
    those = several.experiments(records, gear)
    found = Found(
        those=those,
        starts={one.label: _start(one, voltage) for one in those.every},
        lag=_lag(those),
        voltage=voltage,
        name=lambda path: sources.name_in(target.parent, path),
    )
    name = re.sub(r"[^A-Za-z0-9_.-]+", "_", target.stem).lstrip("_.-")[:100] or "my_rig"
    text = page.page(found, name)
    channels = tuple(one.name for one in found.channels)
    labels = tuple(one.label for one in those.every if one.label)
    return Guess(target, text, channels, labels, _asks(text, target, records[0]))


def save(made_: Guess, records: Sequence[Path], *, force: bool) -> None:
    """See `check_place`."""
    check_place(made_.path, records, force=force)
    own_files.write_text(made_.path, made_.text)


def check_place(path: Path, records: Sequence[Path], *, force: bool) -> None:
    """Never over a record, and over another file with `force` alone; raises `InputError`."""
    own_files.refuse_other_than_file(path)
    taken = {record.absolute() for record in records}
    if path.suffix.lower() not in (".yaml", ".yml") or path.absolute() in taken:
        message = "is no name of a config; give an --output that ends in .yaml"
        raise InputError.one(str(path), message)
    if path.exists() and not force:
        raise InputError.one(str(path), "exists already; give --force or another --output")
    if not path.parent.is_dir():
        raise InputError.one(str(path.parent), "there is no such folder; make it first")
    own_files.refuse_unwritable(path.parent)


def _start(one: Experiment, voltage: float | None) -> Start:
    found = one.of.found
    v = None if voltage is not None else found.v
    known = [i.raw.t[0] for i in (v, found.t_1) if i is not None and len(i.raw.t)]
    measured = (v is not None and v.varies) or found.t_1 is not None
    return start.start(found, one.of.part, measured=measured, known=max(known, default=None))


def _lag(those: Experiments) -> Lag | None:
    """Of the experiment that tells it best."""
    found = [lags.lag(one.of.found, one.of.part.dt) for one in those.every]
    hints = [one for one in found if one is not None]
    return max(hints, key=lambda one: one.clear, default=None)


def _asks(text: str, target: Path, record: Path) -> tuple[Problem, ...]:
    """What is wrong as it stands: a voltage that nobody has told.

    Raises `InputError` where `check` would refuse it with one, too.
    """
    whole = parse(target, text.replace(inputs.UNKNOWN, inputs.UNKNOWN.replace("# ", "")))
    try:
        assemble(loading.validated(whole), whole)
    except InputError as error:
        message = "`check` would refuse what can be made of it; mend it, or write a config by hand"
        raise InputError([Problem(str(record), message), *error.problems]) from None
    try:
        loading.validated(parse(target, text))
    except InputError as error:
        return error.problems
    return ()
