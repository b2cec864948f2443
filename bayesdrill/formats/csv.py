"""Text tables: find out how a file is written, then read it fast, or say exactly what is wrong."""

from __future__ import annotations

import codecs
import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

import numpy as np

from bayesdrill.errors import InputError, Problem
from bayesdrill.formats.table import Array, Table, read_bytes

_CHUNK = 20_000
"""Rows parsed at once: bounds the memory of the cells, and the slow path to the chunk in fault."""
_SHOWN = 5
_MAGIC = {
    b"PK\x03\x04": "is a spreadsheet or zip archive; export it as CSV",
    b"MATLAB": "is a MATLAB file; give it the ending .mat, or say the format: mat",
    b"\x89HDF": "is an HDF5 file; give it the ending .mat if MATLAB wrote it",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class CsvOptions:
    """How a text table is written; None means find out.

    `delimiter` is one character, a blank meaning runs of white space; `decimal` is "." or ",";
    `skip_rows` counts lines of the file, blank ones and comments too.
    """

    delimiter: str | None = None
    decimal: str | None = None
    header: bool | None = None
    skip_rows: int = 0


@dataclass(frozen=True, slots=True)
class _Dialect:
    """How cells are told apart (None: runs of white space) and how numbers are written."""

    separator: str | None
    decimal: str


# In order of preference among dialects that explain a file equally well.
_DIALECTS = tuple(
    _Dialect(*pair)
    for pair in [
        ("\t", "."), ("\t", ","), (";", "."), (";", ","), ("|", "."), ("|", ","),
        (",", "."), (None, "."), (None, ","),
    ]
)  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class _Lines:
    """The lines that hold something, with their line numbers in the file (from 1)."""

    path: Path
    texts: list[str]
    numbers: list[int]

    def after(self, count: int) -> _Lines:
        return _Lines(path=self.path, texts=self.texts[count:], numbers=self.numbers[count:])

    def place(self, index: int) -> str:
        return f"{self.path} line {self.numbers[index]}"


def read(path: Path, options: CsvOptions) -> Table:
    """Read a text table; empty and NaN cells become NaN.

    Raises InputError for a file that is no table, naming lines and columns.
    """
    _check_options(path, options)
    lines = _lines(path, _decode(path), options.skip_rows)
    dialect = _find_dialect(lines.texts, options)
    lines = _without_empty_tail(lines, dialect)
    header, body = _split_header(lines, dialect, options.header)
    if not body.texts:
        last = lines.numbers[-1]
        message = f"has a header but no data: nothing follows line {last}"
        raise InputError.one(str(path), f"{message}; record again, or set header: false")
    if options.decimal is None and dialect.separator != ",":
        dialect = _Dialect(dialect.separator, _decimal_of(body.texts) or dialect.decimal)
    body = _without_trailing_delimiter(body, header, dialect)
    width = _usual_width(body.texts, dialect)
    names, ignored = _names(header, lines, dialect, width)
    values = _parse(body, dialect, names)
    columns = {name: np.ascontiguousarray(values[:, i]) for i, name in enumerate(names)}
    numbers = np.array(body.numbers, dtype=np.int64)
    return Table(path=path, variables=columns, lines=numbers, ignored=ignored)


def _check_options(path: Path, options: CsvOptions) -> None:
    problems = []
    if options.delimiter is not None and len(options.delimiter) != 1:
        problems.append(f"delimiter {options.delimiter!r} is not one character; use , ; | or a tab")
    elif options.delimiter and (options.delimiter.isalnum() or options.delimiter in '"+-.\r\n'):
        problems.append(f"delimiter {options.delimiter!r} occurs in numbers; use , ; | or a tab")
    if options.decimal not in (None, ".", ","):
        problems.append(f"decimal {options.decimal!r} is neither '.' nor ','")
    if options.decimal is not None and options.decimal == options.delimiter:
        problems.append(f"delimiter and decimal are both {options.decimal!r}; change one")
    if options.skip_rows < 0:
        problems.append(f"skip_rows {options.skip_rows} is negative; give 0 or more")
    if problems:
        raise InputError([Problem(str(path), text) for text in problems])


# --- from bytes to lines -------------------------------------------------------------------


def _decode(path: Path) -> str:
    raw = read_bytes(path)
    for magic, message in _MAGIC.items():
        if raw.startswith(magic):
            raise InputError.one(str(path), message)
    try:
        if raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
            return raw.decode("utf-16")
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = raw.decode("latin-1")
    if re.search(r"[\x00-\x08\x0e-\x19\x1b-\x1f]", text):
        raise InputError.one(str(path), "is a binary file, not text; export it as CSV in UTF-8")
    return text


def _lines(path: Path, text: str, skip: int) -> _Lines:
    # Not str.splitlines: it also breaks at form feeds and other characters a cell may hold.
    everything = text.replace("\r\n", "\n").replace("\r", "\n").rstrip("\x1a").split("\n")
    kept = [
        (number, line)
        for number, line in enumerate(everything[skip:], start=skip + 1)
        if (bare := line.strip()) and bare[0] not in "#%"
    ]
    if not kept:
        rest = f" after the {skip} lines of skip_rows" if skip else ""
        raise InputError.one(str(path), f"holds no data{rest}: only blank lines and comments")
    return _Lines(path=path, texts=[line for _, line in kept], numbers=[n for n, _ in kept])


def _without_empty_tail(lines: _Lines, dialect: _Dialect) -> _Lines:
    """Drop the `;;;;` lines that spreadsheets add at the end; elsewhere they are missing rows."""
    count = len(lines.texts)
    while count > 1 and not lines.texts[count - 1].strip(f' "{dialect.separator or ""}'):
        count -= 1
    return _Lines(path=lines.path, texts=lines.texts[:count], numbers=lines.numbers[:count])


# --- from lines to cells -------------------------------------------------------------------


def _cells(line: str, separator: str | None) -> list[str]:
    if '"' not in line:
        return line.split(separator)
    if separator is None:
        return [cell.strip('"') for cell in re.findall(r'"[^"]*"|\S+', line)]
    try:
        return next(csv.reader([line], delimiter=separator, skipinitialspace=separator != "\t"))
    except csv.Error:  # a cell of more than 128 kB: a quote that nobody closed
        return line.split(separator)


def _number(cell: str, decimal: str) -> float | None:
    """The number in a cell, NaN for an empty one, None for anything else."""
    cell = cell.strip()
    if not cell:
        return float("nan")
    if decimal == ",":
        if "." in cell:
            return None  # 1.234,5 or 1.5: which of the two marks is the decimal one?
        cell = cell.replace(",", ".")
    try:
        return None if "_" in cell else float(cell)
    except ValueError:
        return None


def _find_dialect(texts: Sequence[str], options: CsvOptions) -> _Dialect:
    """The dialect under which most cells of a sample are numbers in rows of equal width."""
    sample = [*texts[:50], *texts[50:][-50:]]
    candidates = list(_DIALECTS)
    if options.delimiter is not None:
        separator = None if options.delimiter == " " else options.delimiter
        candidates = [_Dialect(separator, "."), _Dialect(separator, ",")]
    if options.decimal is not None:
        separators = dict.fromkeys(one.separator for one in candidates)
        candidates = [
            _Dialect(sep, options.decimal) for sep in separators if sep != options.decimal
        ]
    return max(candidates, key=lambda dialect: _score(sample, dialect))


def _score(sample: Sequence[str], dialect: _Dialect) -> tuple[float, bool]:
    rows = [_cells(line, dialect.separator) for line in sample]
    width = Counter(map(len, rows)).most_common(1)[0][0]
    score = 0.0
    for index, row in enumerate(rows):
        numeric = sum(_number(cell, dialect.decimal) is not None for cell in row)
        if len(row) == width:
            # A header of the right width speaks for a dialect as much as a row of numbers does.
            score += 1.0 if index == 0 and numeric == 0 else numeric / width
    return round(score, 9), width > 1


def _decimal_of(texts: Sequence[str]) -> str | None:
    """A comma that the sample did not show, because the rig stood still there."""
    commas = any("," in line for line in texts)
    return "," if commas and not any("." in line for line in texts) else None


def _usual_width(texts: Sequence[str], dialect: _Dialect) -> int:
    sample = [*texts[:500], *texts[500:][-500:]]
    widths = Counter(len(_cells(line, dialect.separator)) for line in sample)
    return widths.most_common(1)[0][0]


def _without_trailing_delimiter(body: _Lines, header: str | None, dialect: _Dialect) -> _Lines:
    """Strip a delimiter that ends every row, unless the header names a column after it."""
    mark = dialect.separator
    if mark is None:
        return body
    texts = [line.rstrip(" ") for line in body.texts]
    if not all(line.endswith(mark) for line in texts):
        return body
    width = _usual_width(texts, dialect)
    if header is not None:
        names = _cells(header, mark)
        if len(names) == width and names[-1].strip():
            return body
    return _Lines(path=body.path, texts=[line[:-1] for line in texts], numbers=body.numbers)


# --- header --------------------------------------------------------------------------------


def _split_header(
    lines: _Lines, dialect: _Dialect, wanted: bool | None
) -> tuple[str | None, _Lines]:
    """The header line, if there is one, and the rows after it and after a row of units."""
    if wanted is False:
        return None, lines
    numeric, words = _census(lines.texts[0], dialect)
    if wanted is None and not words:
        return None, lines
    if wanted is None and numeric:
        raise InputError.one(
            lines.place(0),
            f"mixes numbers and text: {_short(lines.texts[0])}; "
            f"say header: true if it names the columns, or mend the cell",
        )
    count = 1
    if len(lines.texts) > 1:
        numeric, words = _census(lines.texts[1], dialect)
        count = 2 if words and not numeric else 1
    return lines.texts[0], lines.after(count)


def _census(line: str, dialect: _Dialect) -> tuple[int, int]:
    """How many cells of a line are numbers, and how many are words; empty ones are neither."""
    cells = [cell for cell in _cells(line, dialect.separator) if cell.strip()]
    numeric = sum(_number(cell, dialect.decimal) is not None for cell in cells)
    return numeric, len(cells) - numeric


def _names(
    header: str | None, lines: _Lines, dialect: _Dialect, width: int
) -> tuple[list[str], dict[str, str]]:
    """A unique name per column, and why the names that stand twice cannot be picked."""
    if header is None:
        return [str(number) for number in range(1, width + 1)], {}
    names = _header_cells(header, dialect, width)
    if len(names) != width:
        raise InputError.one(
            lines.place(0),
            f"the header has {len(names)} cells and the rows have {width}: {_short(header)}; "
            f"if it is a title, set skip_rows to start at the header below it, "
            f"else check delimiter and decimal",
        )
    ignored = {}
    for name, count in Counter(names).items():
        if count > 1 and name:
            at = ", ".join(str(i) for i, other in enumerate(names, start=1) if other == name)
            ignored[name] = f"stands {count} times in the header (columns {at}); give the number"
    keys = [
        f"(column {i})" if not name or name in ignored or name.startswith("(column ") else name
        for i, name in enumerate(names, start=1)
    ]
    return keys, ignored


def _header_cells(header: str, dialect: _Dialect, width: int) -> list[str]:
    names = [name.strip() for name in _cells(header, dialect.separator)]
    if dialect.separator is not None:
        return names[:width] if len(names) == width + 1 and not names[-1] else names
    # `t [s]  w_1 [rpm]`: a blank inside a name is told from one between names by trial.
    with_units = re.findall(r'"[^"]*"|[^\s\[(]+(?:\s*(?:\[[^\]]*\]|\([^)]*\)))?', header)
    apart = re.split(r"\s{2,}|\t", header.strip())
    for guess in (names, with_units, apart):
        if len(guess) == width:
            return [name.strip('"') for name in guess]
    return names


# --- numbers -------------------------------------------------------------------------------


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


def _parse(body: _Lines, dialect: _Dialect, names: Sequence[str]) -> Array:
    """All rows as `(T, n)`. Raises InputError with every kind of fault found."""
    ragged, bad = _Faults("rows with a wrong number of cells"), _Faults("cells without a number")
    parts = []
    for start in range(0, len(body.texts), _CHUNK):
        texts = body.texts[start : start + _CHUNK]
        rows = [_cells(line, dialect.separator) for line in texts]
        part = _parse_fast(rows, dialect, len(names))
        if part is None:
            part = _parse_slow(rows, start, body, dialect, names, ragged, bad)
        parts.append(part)
    problems = [
        *ragged.report(body.path, "mend the rows, or check delimiter and decimal"),
        *bad.report(body.path, _cell_advice(bad, dialect)),
    ]
    if problems:
        raise InputError(problems)
    return np.concatenate(parts)


def _parse_fast(rows: list[list[str]], dialect: _Dialect, width: int) -> Array | None:
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


def _parse_slow(
    rows: list[list[str]],
    start: int,
    body: _Lines,
    dialect: _Dialect,
    names: Sequence[str],
    ragged: _Faults,
    bad: _Faults,
) -> Array:
    values = np.full((len(rows), len(names)), np.nan)
    for i, row in enumerate(rows):
        if len(row) != len(names):
            message = (
                f"{len(row)} cells where {len(names)} are due: {_short(body.texts[start + i])}"
            )
            ragged.add(body.place(start + i), message)
            continue
        for j, cell in enumerate(row):
            number = _number(cell, dialect.decimal)
            if number is None:
                place = body.place(start + i)
                bad.add(place, f"column {names[j]!r}: {_short(cell.strip())} is not a number")
            else:
                values[i, j] = number
    return values


def _cell_advice(bad: _Faults, dialect: _Dialect) -> str:
    advice = "mend the cells, or leave them empty where a sample is missing"
    if any("," in problem.message for problem in bad.first) and dialect.decimal == ".":
        return f"{advice}; if the comma is the decimal mark set decimal: ','"
    if dialect.decimal == "," and any("." in problem.message for problem in bad.first):
        return (
            f"{advice}; numbers are read with a decimal comma, set decimal: '.' if they have none"
        )
    return f"{advice}; to pass over text above the numbers set skip_rows and header: false"


def _short(text: str) -> str:
    text = text.strip()
    return repr(text if len(text) <= 40 else f"{text[:37]}...")
