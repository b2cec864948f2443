"""The columns of a file, each with what its head says and how a config names it."""

from __future__ import annotations

import dataclasses
import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesdrill.record.formats import Table
from bayesdrill.setup.guessing.names import Meaning, meaning

Array = NDArray[np.float64]

LEAST = 20  # samples, below which nothing is guessed
LARGEST = 1e12  # number that is believed


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """One column `(T,)`; `address`: the entries of a config that name it."""

    name: str
    address: Mapping[str, str | int]
    values: Array
    says: Meaning


def look(table: Table) -> tuple[list[Seen], dict[str, str]]:
    """Columns of one length, most of the file's, and why others are left out."""
    seen, left_out = [], dict(table.ignored)
    heads = _units_below(table)
    for position, (name, values) in enumerate(table.variables.items(), start=1):
        if values.ndim == 1:
            number = _number(table, name, position)
            column = name if number is None else number
            says = _says(name if number is None else "", heads.get(name, ""))
            seen.append(Seen(name, {"column": column}, values, says))
        elif values.shape[1] > max(values.shape[0], LEAST):
            size = f"{values.shape[0]} x {values.shape[1]}"
            left_out[name] = f"is {size}; save it with a row for each sample"
        else:
            seen += [
                Seen(f"{name}, column {k + 1}", {"variable": name, "column": k + 1}, one, Meaning())
                for k, one in enumerate(values.T)
            ]
    lengths = Counter(len(one.values) for one in seen if len(one.values) >= LEAST)
    usual = max(lengths, key=lambda length: (lengths[length], length), default=LEAST)
    for one in seen:
        if len(one.values) != usual:
            left_out[one.name] = f"has {_values(len(one.values))}, not {usual}"
    return [one for one in seen if len(one.values) == usual], left_out


def believable(values: Array) -> bool:
    """Squares of it can be computed with."""
    largest = float(np.abs(values).max())
    return largest == 0 or 1 / LARGEST < largest < LARGEST


def _says(name: str, unit_below: str) -> Meaning:
    """Of `rig.rotor.w`, the last part first; what that leaves open the whole may say."""
    last = re.split(r"\.(?=[^\W\d])", name)[-1]
    says, whole = meaning(last, unit_below), meaning(name, unit_below)
    if last == name or says.strange:
        return says
    return dataclasses.replace(
        says,
        kind=says.kind or whole.kind,
        place=says.place or whole.place,
        word=says.word or whole.word,
    )


def _number(table: Table, name: str, position: int) -> int | None:
    """Of a column of a text without a header, or with an empty or repeated head."""
    if table.lines is None:
        return None
    if found := re.fullmatch(r"\(column (\d+)\)", name):
        return int(found[1])
    return position if name == str(position) else None


def _values(count: int) -> str:
    return "one value" if count == 1 else f"{count} values"


def _units_below(table: Table) -> dict[str, str]:
    """By name, what stands in a row of units between the head of a text and its first row."""
    if table.lines is None or not len(table.lines) or table.lines[0] < 3:
        return {}
    with table.path.open(encoding="utf-8", errors="replace") as file:
        lines = [file.readline().strip() for _ in range(int(table.lines[0]) - 1)]
    for mark in ";\t,|":
        head, below = ([c.strip(' "') for c in line.split(mark)] for line in lines[-2:])
        if len(below) == len(head) == len(table.variables) > 1 and head[0] in table.variables:
            return dict(zip(table.variables, below, strict=True))
    return {}
