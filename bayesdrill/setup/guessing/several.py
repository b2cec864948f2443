"""Several files: which of them are experiments of one kind, and which hold the inputs of others."""

from __future__ import annotations

import dataclasses
import itertools
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bayesdrill.basics.errors import InputError, of_each
from bayesdrill.setup.guessing.columns import LEAST
from bayesdrill.setup.guessing.drafts import Sensor
from bayesdrill.setup.guessing.examine import Examined, as_told, examine, hopeless

LONGEST_NAME = 40
NUMBERED = "run"


@dataclass(frozen=True, slots=True, eq=False)
class Experiment:
    """`of`: the file of the channels, with the inputs at its times; `inputs`: their file, if another."""

    label: str
    of: Examined
    inputs: Examined | None


@dataclass(frozen=True, slots=True, eq=False)
class Experiments:
    """All are understood as `lead`, one of them, is."""

    every: tuple[Experiment, ...]
    lead: Experiment


def experiments(records: Sequence[Path], gear: float | None) -> Experiments:
    """Raises `InputError` where nothing can be made of a file, or not of all together."""
    _refuse_twice(records)
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
    return Experiments(every, next(one for one in every if one.of.path == lead.path))


def _refuse_without_channels(one: Examined) -> None:
    if not one.found.channels:
        why = "no column is an angle, a speed or a current of the rig"
        raise hopeless(one.path, one.left_out, why)


def _unsure(one: Examined) -> tuple[int, bool, tuple[int, int]]:
    return -len(one.found.channels), one.found.v is None, one.doubts


def _refuse_twice(records: Sequence[Path]) -> None:
    seen: set[Path] = set()
    for path in records:
        if path.resolve() in seen:
            raise InputError.one(str(path), "is named twice; name each file once")
        seen.add(path.resolve())


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
