"""The file formats of measured records: one reader per format, found by the ending of the file."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from types import MappingProxyType

from bayesdrill.basics.errors import InputError, did_you_mean
from bayesdrill.record.formats import csv, matlab
from bayesdrill.record.formats.csv import check_options
from bayesdrill.record.formats.csv import table as text_table
from bayesdrill.record.formats.dialect import CsvOptions
from bayesdrill.record.formats.table import Table, variable_name

__all__ = [
    "FORMATS",
    "SUFFIXES",
    "CsvOptions",
    "Table",
    "check_options",
    "format_of",
    "text_table",
    "variable_name",
]


Wanted = Collection[str] | None  # variables that will be picked, by name; None: any of them


def _read_csv(path: Path, options: CsvOptions, _: Wanted) -> Table:
    return csv.read(path, options)


def _read_matlab(path: Path, _: CsvOptions, wanted: Wanted) -> Table:
    return matlab.read(path, wanted)


FORMATS: Mapping[str, Callable[[Path, CsvOptions, Wanted], Table]] = MappingProxyType(
    {"csv": _read_csv, "mat": _read_matlab}
)

SUFFIXES: Mapping[str, str] = MappingProxyType(
    {".csv": "csv", ".txt": "csv", ".tsv": "csv", ".dat": "csv", ".mat": "mat"}
)


def format_of(path: Path) -> str:
    """The key of FORMATS for a file, by its ending. Raises InputError for an unknown ending."""
    suffix = path.suffix.lower()
    if suffix in SUFFIXES:
        return SUFFIXES[suffix]
    ending = f"the ending {suffix!r} is unknown" if suffix else "the file name has no ending"
    guess = did_you_mean(suffix, SUFFIXES) if suffix else ""
    hint = guess if guess.startswith("; did") else ""
    raise InputError.one(
        str(path),
        f"{ending}{hint}; read are {', '.join(SUFFIXES)}, or say the format: "
        f"{' or '.join(FORMATS)}",
    )
