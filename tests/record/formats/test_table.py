"""Files of all formats: the same numbers, or what cannot be read or picked and a way out."""

import pickle
from itertools import product
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow
import pytest
from pyarrow import parquet
from support import array_files
from support.array_files import Bomb, T, W, write_zip
from support.case_tables import read_table, run_cases

import bayesdrill as bd
from bayesdrill.basics.errors import InputError
from bayesdrill.record.formats import FORMATS, Wanted, format_of
from bayesdrill.record.formats.table import RecordTable

TABLE = read_table(Path(__file__).with_name("picks.yaml"))
PICKED, REFUSED = (
    [(name, row) for row in TABLE[kind] for name in row["files"]] for kind in ("picked", "refused")
)
TEXT = "t [s],w_1 [rpm],theta,x,twin,twin\n1,2,3,4,5,6\n"
NAMED = {"flat", "of MATLAB", "row", "table.t", "table.speed", "counts", "on", "block.x", "t [s]"}
NAMED |= {"run 1/motor/speed", "run 1/motor/t", "w.1", "money", "(column 2)", "theta_1", "data"}
NAMED |= {"rate", "rig.theta", "rig.motor.w"}


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("formats")
    (folder / "run.csv").write_text(TEXT)
    return {**array_files.write_all(folder), "csv": folder / "run.csv"}


def load(path: Path, wanted: Wanted = None) -> RecordTable:
    file_format = FORMATS[format_of(path)]
    return file_format.read(path, file_format.options(), wanted)


@run_cases("wanted", [None, NAMED], ["all", "named"])
@run_cases("name, row", PICKED)
def test_columns_of_every_layout_are_picked(
    files: dict[str, Path], wanted: Wanted, name: str, row: dict[str, Any]
) -> None:
    values = load(files[name], wanted).pick(row.get("column"), row.get("variable"))
    assert values.dtype == np.float64
    np.testing.assert_array_equal(values, eval(row["values"], vars(array_files)))


@run_cases("name, row", REFUSED)
def test_what_cannot_be_picked_is_named_with_a_way_out(
    files: dict[str, Path], name: str, row: dict[str, Any]
) -> None:
    table = load(files[name])
    with pytest.raises(InputError) as caught:
        table.pick(row.get("column"), row.get("variable"), location="signals.w")
    message = str(caught.value)
    assert message.startswith("signals.w: ")
    assert files[name].name in message
    assert row["says"] in message


def refusal(path: Path, column: str | None = None) -> str:
    with pytest.raises(InputError) as caught:
        load(path).pick(column)
    assert path.name in str(caught.value)
    return str(caught.value)


@run_cases("name, share", product(("h5", "npz", "parquet", "v5", "v73"), (0.1, 0.5, 0.9)))
def test_files_that_are_cut_short_are_refused(
    files: dict[str, Path], name: str, share: float, tmp_path: Path
) -> None:
    content = files[name].read_bytes()
    path = tmp_path / files[name].name
    path.write_bytes(content[: int(len(content) * share)])
    assert "damaged or cut short" in refusal(path)


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


@run_cases(
    "columns, message",
    [
        ({"t": T[:0], "w": W[:0]}, "column 'w' of run.parquet is empty"),
        ({}, "no column 'w'"),
        ({"w": [[1.0], [2.0, 3.0]]}, "has lists of different lengths"),
    ],
)
def test_parquet_without_numbers_is_refused(
    columns: dict[str, Any], message: str, tmp_path: Path
) -> None:
    path = tmp_path / "run.parquet"
    parquet.write_table(pyarrow.table(columns), path)
    assert message in refusal(path, "w")
    with pytest.raises(InputError, match="no column has 20 numbers or more"):
        bd.init(path)


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
