"""HDF5, NumPy and Parquet: the same numbers in the layouts of users, and what cannot be picked."""

from __future__ import annotations

import datetime
import decimal
import pickle
import sys
import zipfile
from itertools import product
from pathlib import Path

import h5py
import numpy as np
import pyarrow
import pytest
from pyarrow import parquet
from support.case_tables import together

import bayesdrill as bd
from bayesdrill.basics.errors import InputError
from bayesdrill.record.formats import FORMATS, Wanted, format_of
from bayesdrill.record.formats.table import RecordTable

T = np.array([10.0, 10.5, 11.25, 12.0])
W = np.array([101.25, 99.0, -98.5, 1.0 / 3.0])
DATA = np.column_stack([T, W, -W])
RECORDS = np.array(list(zip(T, W, strict=True)), dtype=[("t", "f8"), ("speed", ">f4")])

Files = dict[str, Path]


def load(path: Path, wanted: Wanted = None) -> RecordTable:
    file_format = FORMATS[format_of(path)]
    return file_format.read(path, file_format.options(), wanted)


def refusal(path: Path, column: str | int | None = None, variable: str | None = None) -> str:
    with pytest.raises(InputError) as caught:
        load(path).pick(column, variable)
    assert path.name in str(caught.value)
    return str(caught.value)


def write_hdf5(path: Path) -> None:
    with h5py.File(path, "w") as file:
        run = file.create_group("run 1/motor")
        run["speed"] = W.astype(">f4")
        run["speed"].attrs["unit"] = "furlong"
        run.create_dataset("t", data=T, compression="gzip", shuffle=True, chunks=(2,))
        file["flat"] = DATA
        file["of MATLAB"] = DATA.T
        file["row"] = W[None, :]
        file["table"] = RECORDS
        file["counts"] = np.arange(4, dtype=np.uint8)
        file["on"] = W > 0
        file["block"] = np.array([(i, DATA[i]) for i in range(4)], [("at", "i8"), ("x", "f8", 3)])
        file["text"] = "rig 3"
        file["words"] = np.array([b"a", b"b"])
        file["z"] = W + 1j
        file["cube"] = np.zeros((2, 3, 4))
        file["nothing"] = np.zeros(0)
        file["null"] = h5py.Empty("f8")
        file["kind"] = np.dtype("f8")
        file["ragged"] = np.array([T, W[:2]], dtype=h5py.vlen_dtype(np.float64))
        file.create_dataset("bomb", (10**12,), "f8", chunks=(10**6,))
        file["run 1/again"] = file["run 1"]
        plan = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        plan.set_chunk((4,))
        plan.set_filter(32015, h5py.h5z.FLAG_OPTIONAL, (3,))  # zstd, by its registered number
        space = h5py.h5s.create_simple((4,))
        h5py.h5d.create(file.id, b"packed", h5py.h5t.NATIVE_DOUBLE, space, plan)


class Bomb:
    """Unpickled, it would end the process."""

    def __reduce__(self) -> tuple[object, tuple[str]]:
        return sys.exit, ("unpickled",)


def write_npz(path: Path) -> None:
    arrays = {"flat": DATA, "of MATLAB": DATA.T, "row": W[None, :], "table": RECORDS}
    np.savez_compressed(
        path,
        **arrays,
        counts=np.arange(4, dtype=np.uint8),
        on=W > 0,
        words=np.array(["a", "b"]),
        dates=np.array(["2026-01-01", "2026-01-02"], dtype="M8[s]"),
        z=W + 1j,
        cube=np.zeros((2, 3, 4)),
        nothing=np.zeros(0),
        objects=np.array([Bomb()], dtype=object),
    )


def write_zip(path: Path, member: str, content: bytes) -> None:
    with zipfile.ZipFile(path, "w") as file:
        file.writestr(member, content)


def write_huge(path: Path) -> None:
    """An array of which there is only the header."""
    shape = "{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,), }"
    length = (118).to_bytes(2, "little")
    write_zip(path, "w.npy", b"\x93NUMPY\x01\x00" + length + shape.ljust(117).encode() + b"\n")


def write_parquet(path: Path) -> None:
    columns = {
        "t [s]": T,
        "name": ["a", "b", "c", "d"],
        "w.1": pyarrow.array([1, None, 3, 4], pyarrow.int16()),
        "on": [True, False, True, False],
        "money": [decimal.Decimal("1.50")] * 4,
        "at": [datetime.datetime(2026, 1, 1)] * 4,
        "list": [[1.0], [2.0], [], []],
    }
    parquet.write_table(pyarrow.table(columns), path, compression="zstd")


def write_twins(path: Path) -> None:
    arrays = [pyarrow.array(T), pyarrow.array(W)]
    parquet.write_table(pyarrow.Table.from_arrays(arrays, ["w", "w"]), path)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Files:
    folder = tmp_path_factory.mktemp("arrays")
    paths = {name: folder / f"run.{name}" for name in ("h5", "npz", "parquet")}
    paths |= {"huge": folder / "huge.npz", "twins": folder / "twins.parquet"}
    writers = (write_hdf5, write_npz, write_parquet, write_huge, write_twins)
    for write, path in zip(writers, paths.values(), strict=True):
        write(path)
    return paths


PICKED = [
    (1, "flat", T),
    (3, "flat", -W),
    (2, "of MATLAB", W),
    ("row", None, W),
    (None, "table.t", T),
    ("speed", "table", W.astype("f4")),
    ("counts", None, np.arange(4.0)),
    ("on", None, W > 0),
]
OWN_PICKED = [
    ("h5", "run 1/motor/speed", None, W.astype("f4")),
    ("h5", "run 1/motor/t", None, T),
    ("h5", 2, "block.x", W),
    ("parquet", "t [s]", None, T),
    ("parquet", 1, None, T),
    ("parquet", "w.1", None, [1, np.nan, 3, 4]),
    ("parquet", 3, None, [1, np.nan, 3, 4]),
    ("parquet", "on", None, [1, 0, 1, 0]),
    ("parquet", "money", None, [1.5] * 4),
    ("twins", 2, None, W),
]


WANTED = {"flat", "of MATLAB", "row", "table.t", "table.speed", "counts", "on", "block.x"}
WANTED |= {"run 1/motor/speed", "run 1/motor/t", "t [s]", "w.1", "money", "(column 2)"}


@together("wanted", [None, WANTED])
@together(
    "name, column, variable, expected",
    [*((name, *row) for name, row in product(("h5", "npz"), PICKED)), *OWN_PICKED],
)
def test_columns_of_every_layout_are_picked(
    files: Files,
    wanted: Wanted,
    name: str,
    column: str | int,
    variable: str | None,
    expected: np.ndarray,
) -> None:
    values = load(files[name], wanted).pick(column, variable)
    assert values.dtype == np.float64
    np.testing.assert_array_equal(values, expected)


REFUSED = [
    ("fiat", None, "did you mean flat?"),
    ("flat", None, "4 rows and 3 columns; say which column, from 1 to 3"),
    (4, "flat", "no column 4; give one from 1 to 3"),
    ("table", None, "is a struct; name one of its fields: table.t, table.speed"),
    (None, None, "say which one: "),
    ("words", None, "is text"),
    ("z", None, "is complex; save its real part"),
    ("cube", None, "has 3 dimensions (2 x 3 x 4)"),
    ("nothing", None, "is empty"),
]
OWN_REFUSED = [
    ("h5", "run 1/motor", None, "is a group; name one: run 1/motor/speed, run 1/motor/t"),
    ("h5", "/flat", None, "did you mean flat?"),
    ("h5", "text", None, "is text"),
    ("h5", "null", None, "is empty"),
    ("h5", "kind", None, "is a named type"),
    ("h5", "ragged", None, "rows of unequal length"),
    ("h5", "bomb", None, "takes 8000000 MB; at most 1000 MB are read"),
    ("h5", "run 1/again", None, "is the same group under a second name"),
    ("h5", "packed", None, "is compressed by filter 32015, which is not here"),
    ("npz", "dates", None, "(dates - dates[0]) / np.timedelta64(1, 's')"),
    ("npz", "objects", None, "holds Python objects, which are never opened"),
    ("npz", "objects", None, "objects=np.asarray(objects, float)"),
    ("huge", "w", None, "takes 8000000 MB"),
    ("parquet", "t", None, "known: t [s], w.1, on, money"),
    ("parquet", "name", None, "column 'name' of run.parquet is of type string, not numbers"),
    ("parquet", 2, None, "column 'name' of run.parquet is of type string, not numbers"),
    ("parquet", "at", None, "(df['at'] - df['at'].iloc[0]).dt.total_seconds()"),
    ("parquet", "list", None, "not numbers"),
    ("parquet", 9, None, "has no column 9; it has the columns 1 to 7"),
    ("parquet", "on", "t", "is a table of columns and has no variable 't'"),
    ("twins", "w", None, "stands 2 times"),
]


@together(
    "name, column, variable, message",
    [*((name, *row) for name, row in product(("h5", "npz"), REFUSED)), *OWN_REFUSED],
)
def test_what_cannot_be_picked_is_named_with_a_way_out(
    files: Files, name: str, column: str | int | None, variable: str | None, message: str
) -> None:
    assert message in refusal(files[name], column, variable)


LINK, OTHER = "is a link to elsewhere", "has its numbers in other files"


@together("ending", [".h5", ".mat"])
@together(
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


def test_only_wanted_columns_of_parquet_are_read(files: Files) -> None:
    table = load(files["parquet"], {"w.1"})
    assert list(table.variables) == ["w.1"]
    assert {"t [s]", "on"} <= set(table.unread)
    assert table.where(2) == "row 3"


@together(
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
    files: Files, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    said = refusal(files["parquet"])
    assert "pip install 'bayesdrill[parquet]', or save the record as CSV" in said


@together("name, share", product(("h5", "npz", "parquet"), (0.1, 0.5, 0.9)))
def test_files_that_are_cut_short_are_refused(
    files: Files, name: str, share: float, tmp_path: Path
) -> None:
    content = files[name].read_bytes()
    path = tmp_path / f"run.{name}"
    path.write_bytes(content[: int(len(content) * share)])
    assert "damaged or cut short" in refusal(path)


FOREIGN = (b"t,w_1\n0,1\n" * 20, bytes(range(256)) * 4, b"x")


@together(
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
