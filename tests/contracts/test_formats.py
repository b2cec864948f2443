"""Every file format reads columns as they were written, and names a file that it cannot read."""

import json
from collections.abc import Callable, Mapping
from importlib.util import find_spec
from pathlib import Path

import h5py
import numpy as np
import pyarrow
import pytest
import scipy.io
from pyarrow import parquet
from support import log_files
from support.case_tables import run_cases

from bayesdrill.basics.entries import entries_of
from bayesdrill.basics.errors import InputError
from bayesdrill.config.schema.records import RecordSpec
from bayesdrill.record.formats import FORMATS, format_of

COLUMNS = {"t": np.array([0.0, 0.1, 1 / 3]), "w_1": np.array([1e-9, -2.5, 1e12])}


type Columns = Mapping[str, np.ndarray]


def as_csv(path: Path, columns: Columns) -> None:
    rows = zip(*(values.tolist() for values in columns.values()), strict=True)
    lines = [",".join(columns), *(",".join(map(repr, row)) for row in rows)]
    path.write_text("\n".join(lines) + "\n")


def as_hdf5(path: Path, columns: Columns) -> None:
    with h5py.File(path, "w") as file:
        for name, values in columns.items():
            file[name] = values


def as_json(path: Path, columns: Columns) -> None:
    path.write_text(json.dumps({name: values.tolist() for name, values in columns.items()}))


# A format that comes without a writer here says so by failing.
WRITERS: Mapping[str, Callable[[Path, Columns], None]] = {
    "csv": as_csv,
    "mat": lambda path, columns: scipy.io.savemat(path, dict(columns)),
    "hdf5": as_hdf5,
    "npz": lambda path, columns: np.savez(path, **columns),
    "parquet": lambda path, columns: parquet.write_table(pyarrow.table(dict(columns)), path),
    "json": as_json,
    "wpilog": lambda path, columns: log_files.as_wpilog(path, columns),
    "mcap": lambda path, columns: log_files.as_mcap(path, columns),
    "mdf": lambda path, columns: log_files.as_mdf(path, columns),
    "toy_json": as_json,
}


@run_cases("name", FORMATS)
def test_what_is_written_is_read(name: str, tmp_path: Path) -> None:
    member = FORMATS[name]
    if find_spec(log_files.PACKAGES.get(name, "numpy")) is None:
        return  # its package is an extra; `test_logs.py` tests what is said then
    for ending in member.suffixes:
        path = tmp_path / f"record{ending}"
        WRITERS[name](path, COLUMNS)
        assert format_of(path) == format_of(path.with_suffix(ending.upper())) == name
        for wanted in (None, {"w_1", "t"}):
            table = member.read(path, member.options(), wanted)
            for column, values in COLUMNS.items():
                assert np.array_equal(table.pick(column), values)
    assert {*entries_of(member.options)} <= {*RecordSpec.model_fields}


@run_cases("name", FORMATS)
@run_cases("content", [b"", b"\x00\xff" * 40, None], ids=["empty", "noise", "gone"])
def test_a_file_that_cannot_be_read_is_an_input_error(
    name: str, content: bytes | None, tmp_path: Path
) -> None:
    member = FORMATS[name]
    path = tmp_path / f"record{member.suffixes[0]}"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        member.read(path, member.options(), None)
    assert path.name in str(caught.value)
