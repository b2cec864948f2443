"""Which delimiter and decimal sign a text table is written with."""

from __future__ import annotations

import dataclasses
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import Field

from bayesdrill.basics.entries import MOST
from bayesdrill.record.formats.text import Lines, split, to_number


@dataclass(frozen=True, slots=True, kw_only=True)
class CsvOptions:
    """How a text table is written; None means find out.

    `delimiter` is one character, a blank meaning runs of white space; `decimal` is "." or ",";
    `skip_rows` counts lines of the file, blank ones and comments too.
    """

    delimiter: Annotated[str, Field(description="Default: found out")] | None = None
    decimal: Annotated[Literal[".", ","], Field(description="Default: found out")] | None = None
    header: Annotated[bool, Field(description="Default: found out")] | None = None
    skip_rows: Annotated[int, Field(ge=0, le=MOST, description="Lines before the table")] = 0


@dataclass(frozen=True, slots=True)
class Dialect:
    """How cells are told apart (None: runs of white space) and how numbers are written."""

    separator: str | None
    decimal: str


# In order of preference among dialects that explain a file equally well.
_DIALECTS = tuple(
    Dialect(*pair)
    for pair in [
        ("\t", "."), ("\t", ","), (";", "."), (";", ","), ("|", "."), ("|", ","),
        (",", "."), (None, "."), (None, ","),
    ]
)  # fmt: skip


def without_empty_tail(lines: Lines, dialect: Dialect) -> Lines:
    """Drop the `;;;;` lines that spreadsheets add at the end; elsewhere they are missing rows."""
    count = len(lines.texts)
    while count > 1 and not lines.texts[count - 1].strip(f' "{dialect.separator or ""}'):
        count -= 1
    return dataclasses.replace(lines, texts=lines.texts[:count], numbers=lines.numbers[:count])


def find(texts: Sequence[str], options: CsvOptions) -> Dialect:
    """The dialect under which most cells of a sample are numbers in rows of equal width."""
    sample = [*texts[:50], *texts[50:][-50:]]
    candidates = [*_DIALECTS, *([Dialect(",", ",")] if _quoted_commas(sample) else [])]
    if options.delimiter is not None:
        separator = None if options.delimiter == " " else options.delimiter
        candidates = [Dialect(separator, "."), Dialect(separator, ",")]
    if options.decimal is not None:
        separators = dict.fromkeys(one.separator for one in candidates)
        candidates = [Dialect(sep, options.decimal) for sep in separators if sep != options.decimal]
    return max(candidates, key=lambda dialect: _score(sample, dialect))


def _quoted_commas(sample: Sequence[str]) -> bool:
    """Whether `"0,05","1,25"` stands there, unlike `"1,234"`, which may be a thousand."""
    cells = re.findall(r'"([-+]?\d+,\d+)(?:[eE][-+]?\d+)?"', "\n".join(sample))
    return not all(re.fullmatch(r"[-+]?[1-9]\d{0,2},\d{3}", cell) for cell in cells)


def _score(sample: Sequence[str], dialect: Dialect) -> tuple[float, bool]:
    rows = [split(line, dialect.separator) for line in sample]
    width = Counter(map(len, rows)).most_common(1)[0][0]
    shares = [
        sum(to_number(cell, dialect.decimal) is not None for cell in row) / width
        if len(row) == width
        else 0.0
        for row in rows
    ]
    # A header of the right width speaks for a dialect nearly as much as a row of numbers does,
    # unless it is a single cell that looks like several.
    if (
        len(rows[0]) == width
        and not shares[0]
        and (width > 1 or not re.search(r"[,;|\t]", sample[0]))
    ):
        shares[0] = 0.9
    score = sum(shares)
    # Anything can be read as a single column, so that reading has to be without a fault.
    if width == 1 and min(shares) < 0.9:
        score /= 2
    return round(score, 9), width > 1


def decimal_of(texts: Sequence[str]) -> str | None:
    """A comma that the sample did not show, because the rig stood still there."""
    commas = any("," in line for line in texts)
    return "," if commas and not any("." in line for line in texts) else None


def usual_width(texts: Sequence[str], dialect: Dialect) -> int:
    sample = [*texts[:500], *texts[500:][-500:]]
    widths = Counter(len(split(line, dialect.separator)) for line in sample)
    return widths.most_common(1)[0][0]


def without_trailing_delimiter(body: Lines, header: str | None, dialect: Dialect) -> Lines:
    """Strip a delimiter that ends every row, unless the header names a column after it."""
    mark = dialect.separator
    if mark is None:
        return body
    texts = [line.rstrip(" ") for line in body.texts]
    if not all(line.endswith(mark) for line in texts):
        return body
    width = usual_width(texts, dialect)
    if header is not None:
        names = split(header, mark)
        if len(names) == width and names[-1].strip():
            return body
    return Lines(path=body.path, texts=[line[:-1] for line in texts], numbers=body.numbers)
