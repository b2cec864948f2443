"""Read text tables: find delimiter and decimal sign, then parse numbers, or report each mistake."""

from __future__ import annotations

import csv
import dataclasses
import itertools
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from bayesdrill.basics.arrays import Array, Indices
from bayesdrill.basics.entries import MAX_COUNT
from bayesdrill.basics.errors import InputError, Issue, count_noun, shortened
from bayesdrill.record.formats.table import RecordTable, decode, keys_of


@dataclass(frozen=True, slots=True, kw_only=True)
class CsvOptions:
    """The options describe how a text table is written; None stands for detection.

    `delimiter` is one character; a blank means runs of white space. `decimal` is "." or ",".
    `skip_rows` counts all lines of the file, including blank lines and comments.
    """

    delimiter: Annotated[str, Field(description="Default: found out")] | None = None
    decimal: Annotated[Literal[".", ","], Field(description="Default: found out")] | None = None
    header: Annotated[bool, Field(description="Default: found out")] | None = None
    skip_rows: Annotated[int, Field(ge=0, le=MAX_COUNT, description="Lines before the table")] = 0


@dataclass(frozen=True, slots=True)
class Dialect:
    """A dialect says how cells are separated (None: by white space) and numbers are written."""

    separator: str | None
    decimal: str


# In order of preference among dialects with an equal score.
_DIALECTS = [
    Dialect(separator, decimal)
    for separator in ("\t", ";", "|", ",", None)
    for decimal in ("." if separator == "," else ".,")
]


_NUMBER = r"[-+]?(\d+([.,]\d*)?|[.,]\d+)([eE][-+]?\d+)?"

_KINDS: tuple[tuple[str, str], ...] = (
    (
        r"\d{1,4}[-/.]\d{1,2}[-/.]\d{1,4}([ T].*)?|.*\d{1,2}:\d{2}(:\d{2}.*)?",
        "dates and times of day are not read: save seconds since the start, or write "
        "time: {rate: ...} instead of the column",
    ),
    (
        r"[-+]?\d{1,3}([ ,.'\u00a0\u2009\u202f]\d{3})+([.,]\d+)?",
        "thousands separators are not read, as they may be decimal signs: export numbers without them",
    ),
    (r"0[xX][0-9a-fA-F]+", "hexadecimal numbers are not read: export decimal ones"),
    (
        rf"{_NUMBER}\s*[-+]\s*{_NUMBER}\s*\*?[ij]",
        "complex numbers are not read: save the real part",
    ),
    (rf"{_NUMBER}\s*(#|%|//).+", "a comment needs a line of its own: remove it"),
    (
        rf"{_NUMBER}\s*%",
        "percent signs are not read: remove them, and give a unit such as % of 1.2 A",
    ),
    (
        rf"{_NUMBER}\s*[a-zA-Z\u00b0\u00b5\u03bc][^\s\d]*",
        "units in cells are not read: remove them, and give the unit in the config",
    ),
)


def advice_of_cells(cells: Iterable[str]) -> list[str]:
    """Return one sentence of advice for each kind of cell that occurs."""
    kinds = [
        next((advice for form, advice in _KINDS if re.fullmatch(form, cell)), "") for cell in cells
    ]
    return list(dict.fromkeys(advice for advice in kinds if advice))


LONGEST_LINE = 200_000  # characters, enough for ten thousand columns
_LONGEST_NUMBER = 400  # characters; Python takes minutes for a million digits

_MISSING = frozenset({"na", "n/a", "#n/a", "null", "none", "--", "#div/0!", "1.#qnan", "1.#ind"})
_POWER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)[dD][-+]?\d+")  # Fortran's exponents


@dataclass(frozen=True, slots=True, kw_only=True)
class TextLines:
    """Lines with content have line `numbers` from 1; `comment` is the last comment before them."""

    path: Path
    texts: list[str]
    numbers: Indices
    comment: str = ""

    def part(self, rows: slice) -> TextLines:
        """Return the lines of a slice."""
        return dataclasses.replace(self, texts=self.texts[rows], numbers=self.numbers[rows])

    def location(self, index: int) -> str:
        """Return the file and line number of a line, as messages give it."""
        return f"{self.path} line {self.numbers[index]}"


def read_lines(path: Path, text: str, skip: int) -> TextLines:
    """Return the lines with content after the first `skip`; raises InputError if there are none."""
    # str.splitlines would also split at form feeds and other characters that a cell may contain.
    everything = text.replace("\r\n", "\n").replace("\r", "\n").rstrip("\x1a").split("\n")
    for number, line in enumerate(everything, start=1):
        if len(line) > LONGEST_LINE:
            many = f"has {len(line)} letters; at most {LONGEST_LINE} are read"
            way_out = (
                "A table has a line for each sample: write it with line ends, or leave out columns"
            )
            raise InputError.at(f"{path} line {number}", f"{many}. {way_out}")
    filled = (
        number
        for number, line in enumerate(everything[skip:], start=skip + 1)
        if (bare := line.strip()) and bare[0] not in "#%"
    )
    numbers = np.fromiter(filled, dtype=np.int64)
    if not len(numbers):
        where = f" after the {count_noun(skip, 'line')} of skip_rows" if skip else ""
        raise InputError.at(str(path), f"holds no data{where}: only blank lines and comments")
    before = [bare for line in everything[skip : numbers[0] - 1] if (bare := line.strip())]
    return TextLines(
        path=path,
        texts=[everything[number - 1] for number in numbers],
        numbers=numbers,
        comment=before[-1] if before else "",
    )


def split(line: str, separator: str | None) -> list[str]:
    """Split a line into cells, at runs of white space if the separator is None."""
    if '"' not in line:
        return line.split(separator)
    if separator is None:
        return [cell.strip('"') for cell in re.findall(r'"[^"]*"|\S+', line)]
    try:
        return next(csv.reader([line], delimiter=separator, skipinitialspace=separator != "\t"))
    except csv.Error:  # a cell of more than 128 kB after an unclosed quote
        return line.split(separator)


def to_number(cell: str, decimal: str) -> float | None:
    """Return the number in a cell, NaN for an empty cell or a word that means missing, else None."""
    cell = cell.strip().replace("\u2212", "-")
    if len(cell) > _LONGEST_NUMBER:
        return None
    if not cell or cell.lower() in _MISSING:
        return float("nan")
    if "d" in cell.lower() and _POWER.fullmatch(cell.replace(decimal, ".")):
        cell = cell.replace("D", "e").replace("d", "e")
    if decimal == ",":
        if "." in cell:
            return None  # the point in 1.234,5 or 1.5 may separate thousands
        cell = cell.replace(",", ".")
    try:
        return None if "_" in cell else float(cell)
    except ValueError:
        return None


def quoted(text: str) -> str:
    """Return a quoted and shortened text of a file."""
    return repr(shortened(text.strip(), 40))


def without_empty_tail(lines: TextLines, dialect: Dialect) -> TextLines:
    """Drop final lines like `;;;;` of spreadsheets; elsewhere such lines are missing samples."""
    count = len(lines.texts)
    while count > 1 and not lines.texts[count - 1].strip(f' "{dialect.separator or ""}'):
        count -= 1
    return lines.part(slice(count))


def without_line_marks(lines: TextLines, options: CsvOptions) -> TextLines:
    """Strip a mark at the end of lines, as in `1, 2;`, if this turns more cells into numbers."""
    for mark in ";,|":
        if lines.texts[-1].rstrip().endswith(mark):
            before = _score(lines.texts, find_dialect(lines.texts, options))
            bare = [text.rstrip(f"{mark} ") for text in lines.texts]
            if _score(bare, find_dialect(bare, options)) > before:
                return dataclasses.replace(lines, texts=bare)
    return lines


def find_dialect(texts: Sequence[str], options: CsvOptions) -> Dialect:
    """Find the dialect that gives a sample of lines the most numbers in rows of equal width."""
    sample = [*texts[:50], *texts[50:][-50:]]
    candidates = [*_DIALECTS, *([Dialect(",", ",")] if _quoted_commas(sample) else [])]
    if options.delimiter is not None:
        separator = None if options.delimiter == " " else options.delimiter
        candidates = [Dialect(separator, "."), Dialect(separator, ",")]
    if options.decimal is not None:
        separators = dict.fromkeys(candidate.separator for candidate in candidates)
        candidates = [Dialect(sep, options.decimal) for sep in separators if sep != options.decimal]
    return max(candidates, key=lambda dialect: _score(sample, dialect))


def _quoted_commas(sample: Sequence[str]) -> bool:
    """Return whether quoted decimal commas as in `"0,05"` occur; `"1,234"` does not count."""
    cells = re.findall(r'"([-+]?\d+,\d+)(?:[eE][-+]?\d+)?"', "\n".join(sample))
    return not all(re.fullmatch(r"[-+]?[1-9]\d{0,2},\d{3}", cell) for cell in cells)


def _score(texts: Sequence[str], dialect: Dialect) -> tuple[float, bool]:
    sample = [*texts[:50], *texts[50:][-50:]]
    rows = [split(line, dialect.separator) for line in sample]
    width = max(1, Counter(map(len, rows)).most_common(1)[0][0])
    number_fractions = [
        sum(to_number(cell, dialect.decimal) is not None for cell in row) / width
        if len(row) == width
        else 0.0
        for row in rows
    ]
    # A header of the right width speaks for a dialect nearly as much as a row of numbers does,
    # unless it is a single cell that looks like several.
    whole = width > 1 or not re.search(r"[,;|\t]", sample[0])
    if whole and len(rows[0]) == width and not number_fractions[0]:
        number_fractions[0] = 0.9
    score = sum(number_fractions)
    # Any text can be read as one column, so with one column nearly all cells must be numbers.
    if width == 1 and min(number_fractions) < 0.9:
        score /= 2
    return round(score, 9), width > 1


def typical_width(texts: Sequence[str], dialect: Dialect) -> int:
    """Return the most frequent number of cells of a line."""
    sample = [*texts[:500], *texts[500:][-500:]]
    widths = Counter(len(split(line, dialect.separator)) for line in sample)
    return widths.most_common(1)[0][0]


def without_trailing_delimiter(body: TextLines, header: str | None, dialect: Dialect) -> TextLines:
    """Strip a delimiter that ends every row, unless the header names a column after it."""
    mark, texts = dialect.separator, [line.rstrip(" ") for line in body.texts]
    if mark is None or not all(line.endswith(mark) for line in texts):
        return body
    names = [] if header is None else split(header, mark)
    named = len(names) == typical_width(texts, dialect) and names[-1].strip()
    return body if named else dataclasses.replace(body, texts=[line[:-1] for line in texts])


_CHUNK = 20_000  # rows parsed at once, so that only faulty chunks are parsed slowly
_SHOWN = 5  # number of faults of each kind that are listed
_LONG = 10_000  # length of lines above which cells are checked one by one


class _Faults:
    """Faults of one kind are counted, but only the first few are kept, to save memory."""

    def __init__(self, what: str) -> None:
        self.what = what
        self.count = 0
        self.first: list[Issue] = []
        self.cells: list[str] = []  # the first faulty cells

    def add(self, location: str, message: str, cell: str = "") -> None:
        self.count += 1
        if len(self.first) < _SHOWN:
            self.first.append(Issue(location, message))
            self.cells.append(cell)

    def report(self, path: Path, advice: str) -> list[Issue]:
        if not self.count:
            return []
        more = self.count - len(self.first)
        head = f"and {more} more {self.what}; " if more else ""
        return [*self.first, Issue(str(path), f"{head}{advice}")]


def parse(body: TextLines, dialect: Dialect, names: Sequence[str]) -> Array:
    """Parse all rows as `(T, n)`; raises InputError with faults of every kind."""
    ragged = _Faults("rows with a wrong number of cells")
    bad = _Faults("cells without a number")
    parts = []
    for start in range(0, len(body.texts), _CHUNK):
        chunk = body.part(slice(start, start + _CHUNK))
        short_lines = max(map(len, chunk.texts)) <= _LONG
        part = _parse_fast(chunk.texts, dialect, len(names)) if short_lines else None
        if part is None:
            part = _parse_carefully(chunk, dialect, names, ragged, bad)
        parts.append(part)
    mend = "correct or remove the rows, or check delimiter and decimal"
    problems = ragged.report(body.path, mend)
    if bad.count:
        advice = "; ".join(advice_of_cells(bad.cells)) or _cell_advice(bad, dialect)
        if {problem.place for problem in bad.first} == {body.location(0)} and bad.count < _SHOWN:
            advice = f"{advice}; if that line does not belong to the record, remove it"
        problems += bad.report(body.path, advice)
    if problems:
        raise InputError(problems)
    return np.concatenate(parts)


def _parse_fast(texts: list[str], dialect: Dialect, width: int) -> Array | None:
    """Return rows without faults or empty cells as `(T, n)`, quickly; None for other rows."""
    mark = dialect.separator
    if dialect.decimal == ",":
        if mark == "," or any("." in text for text in texts):
            return None
        texts = [text.replace(",", ".") for text in texts]
    try:
        values = np.loadtxt(texts, delimiter=mark, comments=None, quotechar='"', ndmin=2)
    except ValueError:
        return None
    return values if values.shape == (len(texts), width) else None


def _parse_carefully(
    lines: TextLines, dialect: Dialect, names: Sequence[str], ragged: _Faults, bad: _Faults
) -> Array:
    """Return the cells of `lines` as `(T, n)`, and add their faults to `ragged` and `bad`."""
    values = np.full((len(lines.texts), len(names)), np.nan)
    for i, line in enumerate(lines.texts):
        row = split(line, dialect.separator)
        if len(row) != len(names):
            ragged.add(
                lines.location(i),
                f"{count_noun(len(row), 'cell')} where {count_noun(len(names), 'is', 'are')} expected",
            )
            continue
        for j, cell in enumerate(row):
            value = to_number(cell, dialect.decimal)
            if value is None:
                text = cell.strip()
                message = f"column {quoted(names[j])}: {quoted(text)} is not a number"
                bad.add(lines.location(i), message, text)
            else:
                values[i, j] = value
    return values


def _cell_advice(bad: _Faults, dialect: Dialect) -> str:
    advice = "correct the cells, or leave them empty where a sample is missing"
    if any("," in problem.message for problem in bad.first) and dialect.decimal == ".":
        return f"{advice}; if the comma is the decimal mark set decimal: ','"
    if dialect.decimal == "," and any("." in problem.message for problem in bad.first):
        comma = "numbers are read with a decimal comma; if they have a point set decimal: '.'"
        return f"{advice}; {comma}"
    return f"{advice}; to skip text above the numbers set skip_rows and header: false"


_SAMPLE = 500  # rows at each end of a file from which the dialect is found
_ROWS_OF_WORDS = 3  # largest number of rows of units or descriptions below the header
_LONGEST_HEAD = 200  # largest number of lines with a recorder's settings above the header


def read(path: Path, options: CsvOptions, _: object = None) -> RecordTable:
    """Read a text table; empty cells become NaN, and errors name lines and columns."""
    text = decode(path)
    if kind := {"<": "a web page or XML", "{": "JSON"}.get(text.lstrip()[:1]):
        message = f"is {kind}, not a table; export it as CSV, or give JSON the ending .json"
        raise InputError.at(str(path), message)
    return table(path, text, options)


def table(path: Path, text: str, options: CsvOptions) -> RecordTable:
    """Read the table in a text that is, or will be, the content of the file `path`."""
    check_options(path, options)
    lines = read_lines(path, text, options.skip_rows)
    del text  # frees the memory of a large file
    lines = without_line_marks(lines, options)
    dialect = find_dialect(lines.texts, options)
    lines = without_empty_tail(lines, dialect)
    if options.header is None:
        lines = lines.part(slice(_table_start(lines, dialect), None))
    header, body = _split_header(lines, dialect, options.header)
    if not body.texts:
        last = lines.numbers[-1]
        message = f"has a header but no data: nothing follows line {last}"
        raise InputError.at(str(path), f"{message}; record again, or set header: false")
    if options.decimal is None and dialect.separator != ",":
        # The sample may lack the decimal comma if the rig stood still.
        commas = any("," in line for line in body.texts)
        commas = commas and not any("." in line for line in body.texts)
        dialect = Dialect(dialect.separator, "," if commas else dialect.decimal)
    body = without_trailing_delimiter(body, header, dialect)
    _check_numbers(body, dialect)
    width = typical_width(body.texts, dialect)
    names, ignored = _names(header, lines, dialect, width)
    if header is None:
        ignored = _in_comment(lines, dialect, width)
    values = parse(body, dialect, names)
    columns = {name: np.ascontiguousarray(values[:, i]) for i, name in enumerate(names)}
    below = lines.texts[1] if len(lines.texts) - len(body.texts) == 2 else ""
    cells = [cell.strip() for cell in split(below, dialect.separator)] if dialect.separator else []
    units = dict(zip(names, cells, strict=True)) if len(cells) == width > 1 else {}
    return RecordTable(
        path=path, variables=columns, lines=body.numbers, ignored=ignored, units=units
    )


def check_options(path: Path, options: CsvOptions) -> None:
    """Raise InputError for a delimiter or decimal sign that no table can have."""
    mark, problems = options.delimiter, []
    if mark is not None and len(mark) != 1:
        problems.append(f"delimiter {mark!r} is not one character; use , ; | or a tab")
    elif mark and (mark.isalnum() or mark in '"+-.\r\n'):
        problems.append(f"delimiter {mark!r} occurs in numbers; use , ; | or a tab")
    if mark is not None and mark == options.decimal:
        problems.append(f"delimiter and decimal are both {mark!r}; change one")
    if problems:
        raise InputError([Issue(str(path), text) for text in problems])


def _table_start(lines: TextLines, dialect: Dialect) -> int:
    """Return the index of the line of column names below a recorder's settings, or 0."""
    width, names = typical_width(lines.texts, dialect), -1
    for at, line in enumerate(lines.texts[:_LONGEST_HEAD]):
        (numbers, words), row = _census(line, dialect), split(line, dialect.separator)
        number = row[0].strip() and to_number(row[0], dialect.decimal) is not None
        if len(row) == width and (number or numbers > len(words)):
            return max(names, 0)
        # A spreadsheet fills the row of a title with delimiters.
        title = names < 0 and len(words) == 1 < width and row[0].strip() != ""
        named = len(row) == width and words and not numbers and not title
        names = (at if names < 0 else names) if named else -1
    return 0


def _split_header(
    lines: TextLines, dialect: Dialect, selected: bool | None
) -> tuple[str | None, TextLines]:
    """Return the header line, or None, and the rows of numbers below header and units."""
    if selected is False:
        return None, lines
    numeric, words = _census(lines.texts[0], dialect)
    if selected is None and not words:
        return None, lines
    if selected is None and numeric:
        message = f"mixes numbers and text such as {quoted(words[0])}; "
        message += "write header: true if it names the columns, or correct the cell"
        if len(lines.texts) > 1 and all(_census(line, dialect)[1] for line in lines.texts):
            message = "each line begins with a name: the table lies on its side; transpose it"
        raise InputError.at(lines.location(0), message)
    below = (_census(line, dialect) for line in lines.texts[1 : 1 + _ROWS_OF_WORDS])
    wordy = itertools.takewhile(lambda census: not census[0] and _are_words(census[1]), below)
    count = 1 + sum(1 for _ in wordy)
    first = count if count < len(lines.texts) else min(count, 2)
    return lines.texts[0], lines.part(slice(first, None))


def _census(line: str, dialect: Dialect) -> tuple[int, list[str]]:
    """Return the number of numeric cells of a line, and the list of its text cells."""
    cells = [cell for cell in split(line, dialect.separator) if cell.strip()]
    words = [cell for cell in cells if to_number(cell, dialect.decimal) is None]
    return len(cells) - len(words), words


def _are_words(cells: list[str]) -> bool:
    """Return whether there are cells, and no cell is a number with decimal point or comma."""
    return bool(cells) and all(to_number(cell, sign) is None for cell in cells for sign in ".,")


def _check_numbers(body: TextLines, dialect: Dialect) -> None:
    """Raise InputError if no cell is a number; the message quotes nothing of the file."""
    sample = [*body.texts[:_SAMPLE], *body.texts[-_SAMPLE:]]
    cells = (cell.strip() for line in sample for cell in split(line, dialect.separator))
    if not any(re.fullmatch(r"[-+.,\deE_]*\d[-+.,\deE_]*|[nN]a[nN]", cell) for cell in cells):
        message = "holds no numbers; name the file of the record, or say how it is written"
        raise InputError.at(str(body.path), message)


def _names(
    header: str | None, lines: TextLines, dialect: Dialect, width: int
) -> tuple[list[str], dict[str, str]]:
    """Return a unique name per column, and why repeated names cannot be picked."""
    if header is None:
        return [str(number) for number in range(1, width + 1)], {}
    names = _header_cells(header, dialect, width)
    if (count := len(names)) == width:
        return keys_of(names)
    why = "if this line is a title, skip it with skip_rows; otherwise check delimiter and decimal"
    if other := [mark for mark in ",;\t|" if len(split(header, mark)) == width > 1]:
        why = (
            f"its names are separated by {other[0]!r}, unlike the numbers; write both the same way"
        )
    elif dialect.separator == "," and count > 1 and width in (2 * count, 2 * count - 1):
        why = "if the numbers have decimal commas, export them with ; between the columns"
    elif width == count + 1 and count > 1:
        why = "if the first column holds row numbers, give it a name too, or set header: false"
    message = f"the header has {count_noun(count, 'cell')} and the rows have {width}; {why}"
    raise InputError.at(lines.location(0), message)


def _in_comment(lines: TextLines, dialect: Dialect, width: int) -> dict[str, str]:
    """Return names in the comment before the data, with the reason why they cannot be picked."""
    names = _header_cells(lines.comment[1:], dialect, width)
    if len(names) != width:
        return {}
    why = f"stands in a line that begins with {lines.comment[:1]!r}, a comment; remove that sign"
    return {name: why for name in names if name}


def _header_cells(header: str, dialect: Dialect, width: int) -> list[str]:
    names = [re.sub("^'(.+)'$", r"\1", name.strip()) for name in split(header, dialect.separator)]
    if dialect.separator is not None:
        return names[:width] if len(names) == width + 1 and not names[-1] else names
    # In `t [s] w_1 [rpm]` some blanks separate names and some do not, so both splits are tried.
    with_units = re.findall(r'"[^"]*"|[^\s\[(]+(?:\s*(?:\[[^\[\]]*\]|\([^()]*\)))?', header)
    columns = re.split(r"\s{2,}|\t", header.strip())
    for guess in (names, with_units, columns):
        if len(guess) == width:
            return [name.strip('"') for name in guess]
    return names
