"""HDF5, NumPy and Parquet: one set of numbers in the layouts of users, and what cannot be picked."""

from __future__ import annotations

import datetime
import decimal
import pickle
import sys
import zipfile
from pathlib import Path

import h5py
import numpy as np
import pyarrow
import pytest
from pyarrow import parquet
from support.case_tables import for_each

import bayesdrill as bd
from bayesdrill.basics.errors import InputError
from bayesdrill.record.formats import FORMATS, Wanted, format_of
from bayesdrill.record.formats.table import RecordTable

T = np.array([10.0, 10.5, 11.25, 12.0])
W = np.array([101.25, 99.0, -98.5, 1.0 / 3.0])
DATA = np.column_stack([T, W, -W])
RECORDS = np.array(list(zip(T, W, strict=True)), dtype=[("t", "f8"), ("speed", ">f4")])


def load(path: Path, wanted: Wanted = None) -> RecordTable:
    one = FORMATS[format_of(path)]
    return one.read(path, one.options(), wanted)


def refusal(path: Path, column: str | int | None = None, variable: str | None = None) -> str:
    with pytest.raises(InputError) as caught:
        load(path).pick(column, variable)
    assert path.name in str(caught.value)
    return str(caught.value)


def as_hdf5(folder: Path) -> Path:
    with h5py.File(folder / "run.h5", "w") as file:
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
        file["second name"] = h5py.SoftLink("/flat")
        file["elsewhere"] = h5py.ExternalLink("secret.h5", "x")
        file.create_dataset("bomb", (10**12,), "f8", chunks=(10**6,))
        file["run 1/again"] = file["run 1"]
    return folder / "run.h5"


def as_npz(folder: Path) -> Path:
    np.savez_compressed(
        folder / "run.npz",
        **{"flat": DATA, "of MATLAB": DATA.T, "row": W[None, :], "table": RECORDS},
        counts=np.arange(4, dtype=np.uint8),
        on=W > 0,
        words=np.array(["a", "b"]),
        dates=np.array(["2026-01-01", "2026-01-02"], dtype="M8[s]"),
        z=W + 1j,
        cube=np.zeros((2, 3, 4)),
        nothing=np.zeros(0),
        objects=np.array([1, None], dtype=object),
    )
    return folder / "run.npz"


def test_the_same_columns_of_every_layout(tmp_path_factory: pytest.TempPathFactory) -> None:
    cases = [
        (1, "flat", T),
        (3, "flat", -W),
        (2, "of MATLAB", W),
        ("row", None, W),
        (None, "table.t", T),
        ("speed", "table", W.astype("f4")),
        ("counts", None, np.arange(4.0)),
        ("on", None, W > 0),
    ]

    def check(write, column, variable, expected) -> None:
        tmp_path = tmp_path_factory.mktemp("case")
        path = write(tmp_path)
        for wanted in (
            None,
            {"flat", "of MATLAB", "row", "table.t", "table.speed", "counts", "on"},
        ):
            values = load(path, wanted).pick(column, variable)
            assert values.dtype == np.float64
            np.testing.assert_array_equal(values, expected)

    for_each(
        {
            f"{write.__name__} {case}": (write, *case)
            for write in [as_hdf5, as_npz]
            for case in cases
        },
        check,
    )


def test_what_cannot_be_picked(tmp_path_factory: pytest.TempPathFactory) -> None:
    cases = [
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

    def check(write, column, variable, said: str) -> None:
        tmp_path = tmp_path_factory.mktemp("case")
        assert said in refusal(write(tmp_path), column, variable)

    for_each(
        {
            f"{write.__name__} {case}": (write, *case)
            for write in [as_hdf5, as_npz]
            for case in cases
        },
        check,
    )


def test_datasets_stand_at_their_paths(tmp_path_factory: pytest.TempPathFactory) -> None:
    cases = [("run 1/motor/speed", W.astype("f4")), ("run 1/motor/t", T)]

    def check(name: str, expected: np.ndarray) -> None:
        tmp_path = tmp_path_factory.mktemp("case")
        path = as_hdf5(tmp_path)
        np.testing.assert_array_equal(load(path, {name}).pick(name), expected)
        np.testing.assert_array_equal(load(path).pick(2, "block.x"), W)

    for_each({case[0]: case for case in cases}, check)


def test_what_cannot_be_picked_of_hdf5(tmp_path_factory: pytest.TempPathFactory) -> None:
    cases = [
        ("run 1/motor", "is a group; name one: run 1/motor/speed, run 1/motor/t"),
        ("/flat", "did you mean flat?"),
        ("text", "is text"),
        ("null", "is empty"),
        ("kind", "is a named type"),
        ("ragged", "rows of unequal length"),
        ("second name", "is a link to elsewhere; save the numbers themselves"),
        ("elsewhere", "is a link to elsewhere; save the numbers themselves"),
        ("bomb", "takes 8000000 MB; at most 1000 MB are read"),
        ("run 1/again", "is the same group under a second name"),
    ]

    def check(name: str, said: str) -> None:
        tmp_path = tmp_path_factory.mktemp("case")
        assert said in refusal(as_hdf5(tmp_path), name)

    for_each({case[0]: case for case in cases}, check)


def test_numbers_of_other_files_are_never_read(tmp_path_factory: pytest.TempPathFactory) -> None:
    def check(how: str) -> None:
        tmp_path = tmp_path_factory.mktemp("case")
        (tmp_path / "secret.bin").write_bytes(W.tobytes())
        with h5py.File(tmp_path / "run.h5", "w") as file:
            if how == "virtual dataset":
                layout = h5py.VirtualLayout(W.shape, W.dtype)
                layout[:] = h5py.VirtualSource(str(tmp_path / "secret.h5"), "x", W.shape)
                file.create_virtual_dataset("w", layout)
            else:
                storage = [(str(tmp_path / "secret.bin"), 0, W.nbytes)]
                file.create_dataset("w", W.shape, W.dtype, external=storage)
        assert "has its numbers in other files" in refusal(tmp_path / "run.h5", "w")

    for_each({how: (how,) for how in ["virtual dataset", "external storage"]}, check)


def test_a_filter_that_is_not_here_is_named(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "run.h5", "w") as file:
        space = h5py.h5s.create_simple((4,))
        plan = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        plan.set_chunk((4,))
        plan.set_filter(32015, h5py.h5z.FLAG_OPTIONAL, (3,))  # zstd, by its registered number
        h5py.h5d.create(file.id, b"w", h5py.h5t.NATIVE_DOUBLE, space, plan)
    assert "is compressed by filter 32015, which is not here" in refusal(tmp_path / "run.h5", "w")


class Bomb:
    """Unpickled, it would end the process."""

    def __reduce__(self) -> tuple[object, tuple[str]]:
        return sys.exit, ("unpickled",)


def test_nothing_pickled_is_opened(tmp_path: Path) -> None:
    np.savez(tmp_path / "run.npz", t=T, w=np.array([Bomb()], dtype=object))
    np.testing.assert_array_equal(load(tmp_path / "run.npz").pick("t"), T)
    said = refusal(tmp_path / "run.npz", "w")
    assert "holds Python objects, which are never opened" in said
    assert "w=np.asarray(w, float)" in said
    (tmp_path / "run.npz").write_bytes(pickle.dumps(Bomb()))
    assert "is not an .npz file" in refusal(tmp_path / "run.npz")


def test_an_array_that_is_too_large_is_told_by_its_head(tmp_path: Path) -> None:
    path = tmp_path / "run.npz"
    head = b"\x93NUMPY\x01\x00" + (118).to_bytes(2, "little")
    text = "{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,), }"
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("w.npy", head + text.ljust(117).encode() + b"\n")
    assert "takes 8000000 MB" in refusal(path, "w")


def test_dates_in_numpy_say_how_to_make_seconds(tmp_path: Path) -> None:
    assert "(dates - dates[0]) / np.timedelta64(1, 's')" in refusal(as_npz(tmp_path), "dates")


def test_archives_that_are_no_records(tmp_path: Path) -> None:
    path = tmp_path / "run.npz"
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("xl/workbook.xml", "<a/>")
    assert "without arrays; save it with numpy.savez" in refusal(path)
    np.save(tmp_path / "run.npy", T)
    path.write_bytes((tmp_path / "run.npy").read_bytes())
    assert "holds one array without a name" in refusal(path)


# --- tables ----------------------------------------------------------------------------------------


def as_parquet(folder: Path) -> Path:
    columns = {
        "t [s]": T,
        "name": ["a", "b", "c", "d"],
        "w.1": pyarrow.array([1, None, 3, 4], pyarrow.int16()),
        "on": [True, False, True, False],
        "money": [decimal.Decimal("1.50")] * 4,
        "at": [datetime.datetime(2026, 1, 1)] * 4,
        "list": [[1.0], [2.0], [], []],
    }
    parquet.write_table(pyarrow.table(columns), folder / "run.parquet", compression="zstd")
    return folder / "run.parquet"


def test_columns_of_parquet(tmp_path_factory: pytest.TempPathFactory) -> None:
    cases = [
        ("t [s]", T),
        (1, T),
        ("w.1", [1, np.nan, 3, 4]),
        (3, [1, np.nan, 3, 4]),
        ("on", [1, 0, 1, 0]),
        ("money", [1.5] * 4),
    ]

    def check(column: str | int, expected: np.ndarray) -> None:
        tmp_path = tmp_path_factory.mktemp("case")
        table = load(as_parquet(tmp_path))
        np.testing.assert_array_equal(table.pick(column), expected)
        assert table.where(17 - 15) == "row 3"

    for_each({str(case): case for case in cases}, check)


def test_what_cannot_be_picked_of_parquet(tmp_path_factory: pytest.TempPathFactory) -> None:
    cases = [
        ("t", None, "known: t [s], w.1, on, money"),
        ("name", None, "column 'name' of run.parquet is of type string, not numbers"),
        (2, None, "column 'name' of run.parquet is of type string, not numbers"),
        ("at", None, "(df['at'] - df['at'].iloc[0]).dt.total_seconds()"),
        ("list", None, "not numbers"),
        (9, None, "has no column 9; it has the columns 1 to 7"),
        ("on", "t", "is a table of columns and has no variable 't'"),
    ]

    def check(column, variable, said: str) -> None:
        tmp_path = tmp_path_factory.mktemp("case")
        assert said in refusal(as_parquet(tmp_path), column, variable)

    for_each({str(case): case for case in cases}, check)


def test_only_wanted_columns_of_parquet_are_read(tmp_path: Path) -> None:
    table = load(as_parquet(tmp_path), {"w.1"})
    assert list(table.variables) == ["w.1"]
    assert {"t [s]", "on"} <= set(table.unread)


def test_columns_of_parquet_with_one_name(tmp_path: Path) -> None:
    table = pyarrow.Table.from_arrays([pyarrow.array(T), pyarrow.array(W)], ["w", "w"])
    parquet.write_table(table, tmp_path / "run.parquet")
    np.testing.assert_array_equal(load(tmp_path / "run.parquet").pick(2), W)
    assert "stands 2 times" in refusal(tmp_path / "run.parquet", "w")


def test_parquet_without_rows(tmp_path_factory: pytest.TempPathFactory) -> None:
    def check(columns: dict[str, np.ndarray]) -> None:
        tmp_path = tmp_path_factory.mktemp("case")
        path = tmp_path / "run.parquet"
        parquet.write_table(pyarrow.table(columns), path)
        assert ("column 'w' of run.parquet is empty" if columns else "no column 'w'") in refusal(
            path, "w"
        )
        with pytest.raises(InputError, match="no column has 20 numbers or more"):
            bd.init(path)

    for_each({str(columns): (columns,) for columns in [{"t": T[:0], "w": W[:0]}, {}]}, check)


def test_without_its_library_parquet_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = as_parquet(tmp_path)
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    assert "pip install 'bayesdrill[parquet]', or save the record as CSV" in refusal(path)


def test_cut_files_are_refused(tmp_path_factory: pytest.TempPathFactory) -> None:
    def check(write, keep: float) -> None:
        tmp_path = tmp_path_factory.mktemp("case")
        path = write(tmp_path)
        raw = path.read_bytes()
        path.write_bytes(raw[: int(len(raw) * keep)])
        assert "damaged or cut short" in refusal(path)

    for_each(
        {
            f"{write.__name__} {keep}": (write, keep)
            for write in [as_hdf5, as_npz, as_parquet]
            for keep in [0.1, 0.5, 0.9]
        },
        check,
    )


def test_other_files_are_refused(tmp_path_factory: pytest.TempPathFactory) -> None:
    contents = [b"t,w_1\n0,1\n" * 20, bytes(range(256)) * 4, b"x"]

    def check(ending: str, content: bytes) -> None:
        tmp_path = tmp_path_factory.mktemp("case")
        path = tmp_path / f"run{ending}"
        path.write_bytes(content)
        assert "is not a" in refusal(path)

    for_each(
        {
            f"{ending} {content}": (ending, content)
            for ending in [".h5", ".npz", ".parquet"]
            for content in contents
        },
        check,
    )


def test_a_file_of_matlab_is_left_to_its_reader(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    path.write_bytes(b"MATLAB 7.3 MAT-file".ljust(512))
    assert "give it the ending .mat" in refusal(path)
