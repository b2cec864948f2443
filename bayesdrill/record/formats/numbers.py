"""Cells to numbers: fast where all is well, and otherwise naming every fault."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain
from pathlib import Path

import numpy as np

from bayesdrill.basics.errors import InputError, Problem
from bayesdrill.record.formats.advice import of_cells
from bayesdrill.record.formats.dialect import Dialect
from bayesdrill.record.formats.table import Array
from bayesdrill.record.formats.text import Lines, short, split, to_number

_CHUNK = 20_000
"""Rows parsed at once: bounds the memory of the cells, and the slow path to the chunk in fault."""
_SHOWN = 5
_LONG = 10_000  # letters of a line, from which on each cell is looked at before it is read


class _Faults:
    """Counts what is wrong and keeps the first few, so that a wholly wrong file stays cheap."""

    def __init__(self, what: str) -> None:
        self.what = what
        self.count = 0
        self.first: list[Problem] = []

    def add(self, place: str, message: str) -> None:
        self.count += 1
        if len(self.first) < _SHOWN:
            self.first.append(Problem(place, message))

    def report(self, path: Path, advice: str) -> list[Problem]:
        if not self.count:
            return []
        more = self.count - len(self.first)
        head = f"and {more} more {self.what}; " if more else ""
        return [*self.first, Problem(str(path), f"{head}{advice}")]


def parse(body: Lines, dialect: Dialect, names: Sequence[str]) -> Array:
    """All rows as `(T, n)`. Raises InputError with every kind of fault found."""
    careful = _Careful(body, dialect, names)
    parts = []
    for start in range(0, len(body.texts), _CHUNK):
        texts = body.texts[start : start + _CHUNK]
        rows = [split(line, dialect.separator) for line in texts]
        usual = max(map(len, texts)) <= _LONG
        part = _parse_fast(rows, dialect, len(names)) if usual else None
        parts.append(careful.parse(rows, start) if part is None else part)
    careful.raise_if_faulty()
    return np.concatenate(parts)


def _parse_fast(rows: list[list[str]], dialect: Dialect, width: int) -> Array | None:
    """Rows without any fault and without empty cells; None sends the chunk the slow way."""
    if set(map(len, rows)) != {width}:
        return None
    flat = list(chain.from_iterable(rows))
    text = "\n".join(flat)
    if "_" in text or (dialect.decimal == "," and "." in text):
        return None
    if dialect.decimal == ",":
        flat = text.replace(",", ".").split("\n")
    try:
        return np.fromiter(map(float, flat), np.float64, len(flat)).reshape(len(rows), width)
    except ValueError:
        return None


class _Careful:
    """The slow way, which collects what is wrong with rows and cells."""

    def __init__(self, body: Lines, dialect: Dialect, names: Sequence[str]) -> None:
        self._body, self._dialect, self._names = body, dialect, names
        self._cells: list[str] = []  # the first that are no numbers
        self._ragged = _Faults("rows with a wrong number of cells")
        self._bad = _Faults("cells without a number")

    def parse(self, rows: list[list[str]], start: int) -> Array:
        """`(len(rows), n)`; `start` is the index of the first row."""
        values = np.full((len(rows), len(self._names)), np.nan)
        for i, row in enumerate(rows):
            if len(row) != len(self._names):
                message = f"{len(row)} cells where {len(self._names)} are due"
                self._ragged.add(self._body.place(start + i), message)
                continue
            for j, cell in enumerate(row):
                value = to_number(cell, self._dialect.decimal)
                if value is None:
                    message = (
                        f"column {short(self._names[j])}: {short(cell.strip())} is not a number"
                    )
                    self._bad.add(self._body.place(start + i), message)
                    self._cells += [cell.strip()] if len(self._cells) < _SHOWN else []
                else:
                    values[i, j] = value
        return values

    def raise_if_faulty(self) -> None:
        path = self._body.path
        problems = [
            *self._ragged.report(
                path, "mend the rows or remove them, or check delimiter and decimal"
            ),
            *self._bad.report(path, self._advice()),
        ]
        if problems:
            raise InputError(problems)

    def _advice(self) -> str:
        kinds = "; ".join(of_cells(self._cells))
        said = kinds or _cell_advice(self._bad, self._dialect)
        places = {problem.place for problem in self._bad.first}
        if places == {self._body.place(0)} and self._bad.count < _SHOWN:
            return f"{said}; if that line is not one of the record, remove it"
        return said


def _cell_advice(bad: _Faults, dialect: Dialect) -> str:
    advice = "mend the cells, or leave them empty where a sample is missing"
    if any("," in problem.message for problem in bad.first) and dialect.decimal == ".":
        return f"{advice}; if the comma is the decimal mark set decimal: ','"
    if dialect.decimal == "," and any("." in problem.message for problem in bad.first):
        return (
            f"{advice}; numbers are read with a decimal comma, set decimal: '.' if they have none"
        )
    return f"{advice}; to pass over text above the numbers set skip_rows and header: false"
