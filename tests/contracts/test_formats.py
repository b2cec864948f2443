"""What holds of every file format: columns as they were written, and messages instead of tracebacks."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path

import h5py
import numpy as np
import pyarrow
import pytest
import scipy.io
from pyarrow import parquet
from support.case_tables import run_cases

from bayesdrill.basics.entries import entries_of
from bayesdrill.basics.errors import InputError
from bayesdrill.config.schema.records import RecordSpec
from bayesdrill.record.formats import FORMATS, format_of

COLUMNS = {"t": np.array([0.0, 0.1, 1 / 3]), "w_1": np.array([1e-9, -2.5, 1e12])}


def as_csv(path: Path, columns: Mapping[str, np.ndarray]) -> None:
    rows = zip(*(values.tolist() for values in columns.values()), strict=True)
    lines = [",".join(columns), *(",".join(map(repr, row)) for row in rows)]
    path.write_text("\n".join(lines) + "\n")


def as_mat(path: Path, columns: Mapping[str, np.ndarray]) -> None:
    scipy.io.savemat(path, dict(columns))


def as_hdf5(path: Path, columns: Mapping[str, np.ndarray]) -> None:
    with h5py.File(path, "w") as file:
        for name, values in columns.items():
            file[name] = values


def as_npz(path: Path, columns: Mapping[str, np.ndarray]) -> None:
    np.savez(path, **columns)


def as_parquet(path: Path, columns: Mapping[str, np.ndarray]) -> None:
    parquet.write_table(pyarrow.table(dict(columns)), path)


def as_json(path: Path, columns: Mapping[str, np.ndarray]) -> None:
    path.write_text(json.dumps({name: values.tolist() for name, values in columns.items()}))


# A format that comes without a writer here says so by failing.
WRITERS: Mapping[str, Callable[[Path, Mapping[str, np.ndarray]], None]] = {
    "csv": as_csv,
    "mat": as_mat,
    "hdf5": as_hdf5,
    "npz": as_npz,
    "parquet": as_parquet,
    "json": as_json,
    "toy_json": as_json,
}


@run_cases("name", FORMATS)
def test_what_is_written_is_read(name: str, tmp_path: Path) -> None:
    one = FORMATS[name]
    for ending in one.suffixes:
        path = tmp_path / f"record{ending}"
        WRITERS[name](path, COLUMNS)
        assert format_of(path) == format_of(path.with_suffix(ending.upper())) == name
        for wanted in (None, {"w_1", "t"}):
            table = one.read(path, one.options(), wanted)
            for column, values in COLUMNS.items():
                assert np.array_equal(table.pick(column), values)
    assert {*entries_of(one.options)} <= {*RecordSpec.model_fields}


@run_cases("name", FORMATS)
@run_cases("content", [b"", b"\x00\xff" * 40, None], ids=["empty", "noise", "gone"])
def test_what_it_cannot_read_is_an_input_error(
    name: str, content: bytes | None, tmp_path: Path
) -> None:
    one = FORMATS[name]
    path = tmp_path / f"record{one.suffixes[0]}"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        one.read(path, one.options(), None)
    assert path.name in str(caught.value)
