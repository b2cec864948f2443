"""Text tables: find out how a file is written, then read it, or say exactly what is wrong."""

from __future__ import annotations

import itertools
import re
from pathlib import Path

import numpy as np

from bayesdrill.basics.errors import InputError, Problem
from bayesdrill.record.formats import dialect as dialects
from bayesdrill.record.formats.dialect import CsvOptions, Dialect
from bayesdrill.record.formats.numbers import parse
from bayesdrill.record.formats.table import Table, keys_of
from bayesdrill.record.formats.text import Lines, decode, lines_of, short, split, to_number

_SAMPLE = 500  # rows at each end of a file
_ROWS_OF_WORDS = 3  # below the header: units, kinds, descriptions


def read(path: Path, options: CsvOptions) -> Table:
    """Read a text table; empty and NaN cells become NaN.

    Raises InputError for a file that is no table, naming lines and columns.
    """
    return table(path, decode(path), options)


def table(path: Path, text: str, options: CsvOptions) -> Table:
    """Of a text that stands, or is to stand, in the file `path`."""
    check_options(path, options)
    lines = lines_of(path, text, options.skip_rows)
    dialect = dialects.find(lines.texts, options)
    lines = dialects.without_empty_tail(lines, dialect)
    header, body = _split_header(lines, dialect, options.header)
    if not body.texts:
        last = lines.numbers[-1]
        message = f"has a header but no data: nothing follows line {last}"
        raise InputError.one(str(path), f"{message}; record again, or set header: false")
    if options.decimal is None and dialect.separator != ",":
        dialect = Dialect(dialect.separator, dialects.decimal_of(body.texts) or dialect.decimal)
    body = dialects.without_trailing_delimiter(body, header, dialect)
    _check_numbers(body, dialect)
    width = dialects.usual_width(body.texts, dialect)
    names, ignored = _names(header, lines, dialect, width)
    if header is None:
        ignored = _in_comment(lines, dialect, width)
    values = parse(body, dialect, names)
    columns = {name: np.ascontiguousarray(values[:, i]) for i, name in enumerate(names)}
    numbers = np.array(body.numbers, dtype=np.int64)
    return Table(path=path, variables=columns, lines=numbers, ignored=ignored)


def check_options(path: Path, options: CsvOptions) -> None:
    """Raises InputError for marks that no table can be written with."""
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


def _split_header(lines: Lines, dialect: Dialect, wanted: bool | None) -> tuple[str | None, Lines]:
    """The header line, if there is one, and the rows after it and after rows of units."""
    if wanted is False:
        return None, lines
    numeric, words = _census(lines.texts[0], dialect)
    if wanted is None and not words:
        return None, lines
    if wanted is None and numeric:
        if len(lines.texts) > 1 and all(_census(one, dialect)[1] for one in lines.texts):
            message = "each line begins with a name: the table lies on its side; transpose it"
            raise InputError.one(lines.place(0), message)
        raise InputError.one(
            lines.place(0),
            f"mixes numbers and text such as {short(words[0])}; "
            f"say header: true if it names the columns, or mend the cell",
        )
    below = (_census(line, dialect) for line in lines.texts[1 : 1 + _ROWS_OF_WORDS])
    wordy = itertools.takewhile(lambda found: not found[0] and _are_words(found[1]), below)
    count = 1 + sum(1 for _ in wordy)
    return lines.texts[0], lines.after(count if count < len(lines.texts) else min(count, 2))


def _census(line: str, dialect: Dialect) -> tuple[int, list[str]]:
    """How many cells of a line are numbers, and those that are words; empty ones are neither."""
    cells = [cell for cell in split(line, dialect.separator) if cell.strip()]
    words = [cell for cell in cells if to_number(cell, dialect.decimal) is None]
    return len(cells) - len(words), words


def _are_words(cells: list[str]) -> bool:
    """Some, and none that would be a number with the other decimal sign."""
    return bool(cells) and all(to_number(one, sign) is None for one in cells for sign in ".,")


def _check_numbers(body: Lines, dialect: Dialect) -> None:
    """A file without any is no record: what stands in it is not for messages."""
    sample = [*body.texts[:_SAMPLE], *body.texts[-_SAMPLE:]]
    cells = (cell.strip() for line in sample for cell in split(line, dialect.separator))
    if not any(re.fullmatch(r"[-+.,\deE_]*\d[-+.,\deE_]*|[nN]a[nN]", cell) for cell in cells):
        message = "holds no numbers; name the file of the record, or say how it is written"
        raise InputError.one(str(body.path), message)


def _names(
    header: str | None, lines: Lines, dialect: Dialect, width: int
) -> tuple[list[str], dict[str, str]]:
    """A unique name per column, and why the names that stand twice cannot be picked."""
    if header is None:
        return [str(number) for number in range(1, width + 1)], {}
    names = _header_cells(header, dialect, width)
    if len(names) != width:
        raise InputError.one(
            lines.place(0),
            f"the header has {len(names)} cells and the rows have {width}; "
            f"{_why_not(header, lines, dialect, width)}",
        )
    return keys_of(names)


def _why_not(header: str, lines: Lines, dialect: Dialect, width: int) -> str:
    """Of a header of another width than the rows: the likely reason, and what to do."""
    count = len(_header_cells(header, dialect, width))
    other = [mark for mark in ",;\t|" if len(split(header, mark)) == width > 1]
    if other:
        return f"its names stand between {other[0]!r}, the numbers do not; write both the same way"
    if dialect.separator == "," and count > 1 and width in (2 * count, 2 * count - 1):
        return "if the numbers have decimal commas, export them with ; between the columns"
    if width == count + 1 and count > 1:
        return "if the first column holds row numbers, give it a name too, or set header: false"
    below = zip(lines.numbers[1:], lines.texts[1:], strict=True)
    names = [n for n, text in below if _is_header(text, dialect, width)]
    start = f"set skip_rows{f': {names[0] - 1}' if names else ''} to start at the header below it"
    return f"if it is a title, {start}, else check delimiter and decimal"


def _is_header(text: str, dialect: Dialect, width: int) -> bool:
    numeric, words = _census(text, dialect)
    return not numeric and len(words) == width


def _in_comment(lines: Lines, dialect: Dialect, width: int) -> dict[str, str]:
    """Why names cannot be picked that stand in the comment before the data."""
    comment = lines.comment[1:] if lines.comment else ""
    names = _header_cells(comment, dialect, width)
    if len(names) != width:
        return {}
    why = f"stands in a line that begins with {lines.comment[:1]!r}, a comment; remove that sign"
    return {name: why for name in names if name}


def _header_cells(header: str, dialect: Dialect, width: int) -> list[str]:
    names = [_bare(name.strip()) for name in split(header, dialect.separator)]
    if dialect.separator is not None:
        return names[:width] if len(names) == width + 1 and not names[-1] else names
    # `t [s]  w_1 [rpm]`: a blank inside a name is told from one between names by trial.
    with_units = re.findall(r'"[^"]*"|[^\s\[(]+(?:\s*(?:\[[^\[\]]*\]|\([^()]*\)))?', header)
    apart = re.split(r"\s{2,}|\t", header.strip())
    for guess in (names, with_units, apart):
        if len(guess) == width:
            return [name.strip('"') for name in guess]
    return names


def _bare(name: str) -> str:
    return name[1:-1] if len(name) > 2 and name[0] == name[-1] == "'" else name
