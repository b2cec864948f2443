"""Text files as lines, lines as cells, and what a cell that is no number was meant to be."""

from __future__ import annotations

import codecs
import csv
import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

from bayesdrill.basics.errors import InputError, shortened
from bayesdrill.record.formats.table import read_bytes

_NUMBER = r"[-+]?(\d+([.,]\d*)?|[.,]\d+)([eE][-+]?\d+)?"

_KINDS: tuple[tuple[str, str], ...] = (
    (
        r"\d{1,4}[-/.]\d{1,2}[-/.]\d{1,4}([ T].*)?|.*\d{1,2}:\d{2}(:\d{2}.*)?",
        "dates and times of day are not read: save seconds since the start, or say "
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
    (rf"{_NUMBER}\s*(#|%|//).+", "a comment may only stand in a line of its own: remove it"),
    (
        rf"{_NUMBER}\s*%",
        "percent signs are not read: remove them, and say in the unit what a percent is",
    ),
    (
        rf"{_NUMBER}\s*[a-zA-Z\u00b0\u00b5\u03bc][^\s\d]*",
        "units do not stand in cells: remove them, and give the unit in the config",
    ),
)


def advice_of_cells(cells: Iterable[str]) -> list[str]:
    """Return one sentence for each kind of cell that is met."""
    kinds = [
        next((advice for form, advice in _KINDS if re.fullmatch(form, cell)), "") for cell in cells
    ]
    return list(dict.fromkeys(advice for advice in kinds if advice))


_MAGIC = {
    b"PK\x03\x04": "is a spreadsheet or zip archive; export it as CSV",
    b"MATLAB": "is a MATLAB file; give it the ending .mat, or say the format: mat",
    b"\x89HDF": "is an HDF5 file; give it the ending .h5, or .mat if MATLAB wrote it",
    b"PAR1": "is a Parquet file; give it the ending .parquet, or say the format: parquet",
    b"\xd0\xcf\x11\xe0": "is a spreadsheet (.xls); export it as CSV",
    b"\x93NUMPY": "is a NumPy array; save it with numpy.savez('run.npz', t=t, w_1=w_1)",
    b"version https://git-lfs": "is a pointer of Git LFS, not the file; run git lfs pull",
    b"\x1f\x8b": "is compressed (gzip); unpack it first: gunzip, or 7-Zip",
}


LONGEST_LINE = 200_000  # letters: ten thousand columns
_LONGEST_NUMBER = 400  # letters; Python takes minutes for a million digits
_LINES_OF_TEXT = 2  # after which a file is a text, whatever follows

_MISSING = frozenset({"na", "n/a", "#n/a", "null", "none", "--", "#div/0!", "1.#qnan", "1.#ind"})
_POWER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)[dD][-+]?\d+")  # of Fortran


@dataclass(frozen=True, slots=True, kw_only=True)
class TextLines:
    """The lines that hold something, their numbers (from 1), and the last `comment` before them."""

    path: Path
    texts: list[str]
    numbers: list[int]
    comment: str = ""

    def part(self, rows: slice) -> TextLines:
        """Return some of the lines."""
        return replace(self, texts=self.texts[rows], numbers=self.numbers[rows])

    def location(self, index: int) -> str:
        """Return the file and line of one of them, as messages have it."""
        return f"{self.path} line {self.numbers[index]}"


def decode(path: Path) -> str:
    """Read a text in UTF-8, UTF-16 or Latin-1; raises InputError for what is no table."""
    raw = read_bytes(path)
    for magic, message in _MAGIC.items():
        if raw.startswith(magic):
            raise InputError.at(str(path), message)
    try:
        if raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
            return raw.decode("utf-16")
        if len(raw) > 2 and not raw[1:400:2].strip(b"\0"):  # without its mark
            return raw.decode("utf-16-le")
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = raw.decode("latin-1")
    _check_text(path, text)
    return text


def _check_text(path: Path, text: str) -> None:
    odd = re.search(r"[\x00-\x08\x0e-\x19\x1b-\x1f]", text)
    line = text.count("\n", 0, odd.start()) + 1 if odd else 0
    if line > _LINES_OF_TEXT:
        message = "holds bytes that are no text, as where writing was cut; remove them"
        raise InputError.at(f"{path} line {line}", message)
    if odd:
        raise InputError.at(str(path), "is a binary file, not text; export it as CSV in UTF-8")
    kind = {"<": "a web page or XML", "{": "JSON"}.get(text.lstrip()[:1])
    if kind:
        raise InputError.at(str(path), f"is {kind}, not a table; export it as CSV")


def read_lines(path: Path, text: str, skip: int) -> TextLines:
    """Return the lines after the first `skip` that hold something; raises InputError without any."""
    # Not str.splitlines: it also breaks at form feeds and other characters a cell may hold.
    everything = text.replace("\r\n", "\n").replace("\r", "\n").rstrip("\x1a").split("\n")
    for number, line in enumerate(everything, start=1):
        if len(line) > LONGEST_LINE:
            message = f"has {len(line)} letters; at most {LONGEST_LINE} are read. "
            message += (
                "A table has a line for each sample: write it with line ends, or leave out columns"
            )
            raise InputError.at(f"{path} line {number}", message)
    filled = [
        (number, line)
        for number, line in enumerate(everything[skip:], start=skip + 1)
        if (bare := line.strip()) and bare[0] not in "#%"
    ]
    if not filled:
        where = f" after the {skip} lines of skip_rows" if skip else ""
        raise InputError.at(str(path), f"holds no data{where}: only blank lines and comments")
    before = [bare for line in everything[skip : filled[0][0] - 1] if (bare := line.strip())]
    return TextLines(
        path=path,
        texts=[line for _, line in filled],
        numbers=[n for n, _ in filled],
        comment=before[-1] if before else "",
    )


def split(line: str, separator: str | None) -> list[str]:
    """Split a line into cells, at runs of white space where the separator is None."""
    if '"' not in line:
        return line.split(separator)
    if separator is None:
        return [cell.strip('"') for cell in re.findall(r'"[^"]*"|\S+', line)]
    try:
        return next(csv.reader([line], delimiter=separator, skipinitialspace=separator != "\t"))
    except csv.Error:  # a cell of more than 128 kB: a quote that nobody closed
        return line.split(separator)


def to_number(cell: str, decimal: str) -> float | None:
    """Return the number in a cell, NaN for an empty one or a word for that, None for anything else."""
    cell = cell.strip().replace("\u2212", "-")
    if len(cell) > _LONGEST_NUMBER:
        return None
    if not cell or cell.lower() in _MISSING:
        return float("nan")
    if _POWER.fullmatch(cell.replace(decimal, ".")):
        cell = cell.replace("D", "e").replace("d", "e")
    if decimal == ",":
        if "." in cell:
            return None  # 1.234,5 or 1.5: which of the two marks is the decimal one?
        cell = cell.replace(",", ".")
    try:
        return None if "_" in cell else float(cell)
    except ValueError:
        return None


def short(text: str) -> str:
    """Quote a text of a file in few letters."""
    return repr(shortened(text.strip(), 40))
