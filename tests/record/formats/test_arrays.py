"""HDF5, NumPy and Parquet: the same numbers in the layouts of users, and what cannot be picked."""

import pickle
import sys
from itertools import product
from pathlib import Path

import h5py
import numpy as np
import pyarrow
import pytest
from pyarrow import parquet
from support.array_files import Bomb, T, W, write_all, write_zip
from support.case_tables import run_cases

import bayesdrill as bd
from bayesdrill.basics.errors import InputError
from bayesdrill.record.formats import FORMATS, Wanted, format_of
from bayesdrill.record.formats.table import RecordTable


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return write_all(tmp_path_factory.mktemp("arrays"))


def load(path: Path, wanted: Wanted = None) -> RecordTable:
    file_format = FORMATS[format_of(path)]
    return file_format.read(path, file_format.options(), wanted)


def refusal(path: Path, column: str | int | None = None, variable: str | None = None) -> str:
    with pytest.raises(InputError) as caught:
        load(path).pick(column, variable)
    assert path.name in str(caught.value)
    return str(caught.value)


LINK, OTHER = "is a link to elsewhere", "has its numbers in other files"


@run_cases("ending", [".h5", ".mat"])
@run_cases(
    "reference, message",
    [("external link", LINK), ("soft link", LINK), ("virtual", OTHER), ("external storage", OTHER)],
)
def test_numbers_of_other_files_are_never_read(
    ending: str, reference: str, message: str, tmp_path: Path
) -> None:
    with h5py.File(tmp_path / "secret.h5", "w") as other:
        other["x"] = W
    (tmp_path / "secret.bin").write_bytes(W.tobytes())
    path = tmp_path / f"run{ending}"
    with h5py.File(path, "w") as file:
        file["t"] = T
        match reference:
            case "external link":
                file["w"] = h5py.ExternalLink("secret.h5", "x")
            case "soft link":
                file["#refs#"] = h5py.ExternalLink("secret.h5", "/")
                file["w"] = h5py.SoftLink("/#refs#/x")
            case "virtual":
                layout = h5py.VirtualLayout(W.shape, W.dtype)
                layout[:] = h5py.VirtualSource(str(tmp_path / "secret.h5"), "x", W.shape)
                file.create_virtual_dataset("w", layout)
            case "external storage":
                storage = [(str(tmp_path / "secret.bin"), 0, W.nbytes)]
                file.create_dataset("w", W.shape, W.dtype, external=storage)
    np.testing.assert_array_equal(load(path, {"t", "w"}).pick("t"), T)
    assert f"'w' of run{ending} {message}; save the numbers themselves" in refusal(path, "w")


def test_only_wanted_columns_of_parquet_are_read(files: dict[str, Path]) -> None:
    table = load(files["parquet"], {"w.1"})
    assert list(table.variables) == ["w.1"]
    assert {"t [s]", "on"} <= set(table.unread)
    assert table.where(2) == "row 3"


@run_cases(
    "columns, message",
    [({"t": T[:0], "w": W[:0]}, "column 'w' of run.parquet is empty"), ({}, "no column 'w'")],
)
def test_parquet_without_rows_is_refused(
    columns: dict[str, np.ndarray], message: str, tmp_path: Path
) -> None:
    path = tmp_path / "run.parquet"
    parquet.write_table(pyarrow.table(columns), path)
    assert message in refusal(path, "w")
    with pytest.raises(InputError, match="no column has 20 numbers or more"):
        bd.init(path)


def test_without_its_library_parquet_says_what_to_install(
    files: dict[str, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    said = refusal(files["parquet"])
    assert "pip install 'bayesdrill[parquet]', or save the record as CSV" in said


@run_cases("name, share", product(("h5", "npz", "parquet"), (0.1, 0.5, 0.9)))
def test_files_that_are_cut_short_are_refused(
    files: dict[str, Path], name: str, share: float, tmp_path: Path
) -> None:
    content = files[name].read_bytes()
    path = tmp_path / f"run.{name}"
    path.write_bytes(content[: int(len(content) * share)])
    assert "damaged or cut short" in refusal(path)


FOREIGN = (b"t,w_1\n0,1\n" * 20, bytes(range(256)) * 4, b"x")


@run_cases(
    "ending, content, message",
    [
        *((*row, "is not a") for row in product(("h5", "npz", "parquet"), FOREIGN)),
        ("h5", b"MATLAB 7.3 MAT-file".ljust(512), "give it the ending .mat"),
        ("npz", pickle.dumps(Bomb()), "is not an .npz file"),
        ("npz", b"\x93NUMPY\x01\x00", "holds one array without a name"),
    ],
)
def test_files_of_another_kind_are_refused(
    ending: str, content: bytes, message: str, tmp_path: Path
) -> None:
    path = tmp_path / f"run.{ending}"
    path.write_bytes(content)
    assert message in refusal(path)


def test_an_archive_without_arrays_is_refused(tmp_path: Path) -> None:
    write_zip(tmp_path / "run.npz", "xl/workbook.xml", b"<a/>")
    assert "without arrays; save it with numpy.savez" in refusal(tmp_path / "run.npz")
