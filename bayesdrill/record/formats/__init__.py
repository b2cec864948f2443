"""Register formats of record files; the entry point `bayesdrill.format` adds others."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bayesdrill.basics.entries import NoEntries, entries_model
from bayesdrill.basics.errors import InputError, did_you_mean
from bayesdrill.basics.registry import Registry
from bayesdrill.record.formats import arrays, csv, json, logs, matlab, parquet
from bayesdrill.record.formats.csv import CsvOptions
from bayesdrill.record.formats.table import RecordTable

Wanted = Collection[str] | None  # names of the required variables; None stands for all


@dataclass(frozen=True, slots=True)
class Format:
    """A format has the endings of its files, and the function that reads them.

    `suffixes` are endings in lower case. `options` is a dataclass whose annotated fields are entries of
    `record:`. `read(path, options, wanted)` raises `InputError`.
    """

    suffixes: tuple[str, ...]
    read: Callable[[Path, Any, Wanted], RecordTable]
    options: type = NoEntries


def _is_format(_: str, member: Any) -> None:
    if not isinstance(member, Format):
        raise ValueError(f"a format is a `Format`, not {type(member).__name__}")
    entries_model(member.options)


FORMATS: Registry[Format] = Registry(
    "format",
    {
        "csv": Format((".csv", ".txt", ".tsv", ".dat"), csv.read, CsvOptions),
        "mat": Format((".mat",), lambda path, _, wanted: matlab.read(path, wanted)),
        "hdf5": Format((".h5", ".hdf5"), lambda path, _, wanted: arrays.read_hdf5(path, wanted)),
        "npz": Format((".npz",), lambda path, _, wanted: arrays.read_npz(path, wanted)),
        "json": Format((".json", ".jsonl", ".ndjson"), lambda path, _, __: json.read(path)),
        "parquet": Format((".parquet",), lambda path, _, wanted: parquet.read(path, wanted)),
        "wpilog": Format((".wpilog",), lambda path, _, wanted: logs.read_wpilog(path, wanted)),
        "mcap": Format((".mcap",), lambda path, _, wanted: logs.read_mcap(path, wanted)),
        "mdf": Format((".mf4", ".mdf"), lambda path, _, wanted: logs.read_mdf(path, wanted)),
    },
    judge=_is_format,
)


_OTHERS = {
    **dict.fromkeys((".gz", ".zip", ".bz2", ".xz", ".7z"), ". Unpack the file first"),
    **dict.fromkeys((".xlsx", ".xls", ".ods"), ". Export the spreadsheet as CSV"),
    **dict.fromkeys((".tdms", ".lvm"), ". Export the recording as CSV or .mat"),
    **dict.fromkeys((".bag", ".db3"), ". Convert the recording as docs/record.md says"),
    ".npy": ". Save it with numpy.savez('run.npz', t=t, w_1=w_1)",
}


def format_of(path: Path) -> str:
    """Return the key of FORMATS for a file by its ending; raises InputError for an unknown ending."""
    endings = {ending: name for name, kind in FORMATS.usable().items() for ending in kind.suffixes}
    suffix = path.suffix.lower()
    if suffix in endings:
        return endings[suffix]
    ending = f"the ending {suffix!r} is unknown" if suffix else "the file name has no ending"
    guess = did_you_mean(suffix, endings) if suffix else ""
    hint = _OTHERS.get(suffix) or (guess if guess.startswith("; did") else "")
    known = f"files with {', '.join(endings)} are read; or write format: {' or '.join(FORMATS)}"
    raise InputError.at(str(path), f"{ending}{hint}; {known}")
