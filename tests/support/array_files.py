"""Files of arrays in all formats: the same numbers in the layouts of users, and what is no number."""

import datetime
import decimal
import sys
import zipfile
from pathlib import Path

import h5py
import numpy as np
import pyarrow
import scipy.io
from pyarrow import parquet

T = np.array([10.0, 10.5, 11.25, 12.0])
W = np.array([101.25, 99.0, -98.5, 1.0 / 3.0])
DATA = np.column_stack([T, W, -W])
RECORDS = np.array(list(zip(T, W, strict=True)), dtype=[("t", "f8"), ("speed", ">f4")])
COUNTS = np.array([7, 8, 9, 250], dtype=np.uint8)


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


def write_v5(path: Path) -> None:
    cell = np.empty((1, 2), dtype=object)
    cell[:] = [[T, W]]
    content = {
        "theta_1": T[:, None],
        "row": W[None, :],
        "data": DATA,
        "counts": COUNTS[:, None],
        "on": (W > 0)[:, None],
        "rate": 1000.0,
        "rig": {"theta": T[:, None], "motor": {"w": W[:, None]}, "name": "rig 3"},
        "note": "a text",
        "cells": cell,
        "z": W + 1j,
        "cube": np.zeros((2, 3, 4)),
        "nothing": np.zeros((0, 0)),
    }
    scipy.io.savemat(path, content, do_compression=True)


def write_v73(path: Path) -> None:
    with h5py.File(path, "w", userblock_size=512) as file:

        def put(where: h5py.Group, name: str, values: np.ndarray, kind: str = "double") -> None:
            # As MATLAB does: the array transposed, its class in an attribute.
            item = where.create_dataset(name, data=np.atleast_2d(values).T)
            item.attrs["MATLAB_class"] = np.bytes_(kind)

        def struct(where: h5py.Group, name: str) -> h5py.Group:
            group = where.create_group(name)
            group.attrs["MATLAB_class"] = np.bytes_("struct")
            return group

        put(file, "theta_1", T[:, None])
        put(file, "row", W[None, :])
        put(file, "data", DATA)
        put(file, "counts", COUNTS[:, None], "uint8")
        put(file, "on", (W > 0).astype(np.uint8)[:, None], "logical")
        put(file, "rate", np.array([[1000.0]]))
        rig = struct(file, "rig")
        put(rig, "theta", T[:, None])
        put(struct(rig, "motor"), "w", W[:, None])
        put(rig, "name", np.frombuffer("rig 3".encode("utf-16-le"), np.uint16)[None, :], "char")
        put(file, "note", np.frombuffer("a text".encode("utf-16-le"), np.uint16)[None, :], "char")
        refs = file.create_group("#refs#")
        put(refs, "a", T)
        cells = file.create_dataset("cells", (1, 1), dtype=h5py.ref_dtype)
        cells[0, 0] = refs["a"].ref
        cells.attrs["MATLAB_class"] = np.bytes_("cell")
        pair = np.zeros((4, 1), dtype=[("real", "f8"), ("imag", "f8")])
        file.create_dataset("z", data=pair).attrs["MATLAB_class"] = np.bytes_("double")
        cube = file.create_dataset("cube", data=np.zeros((4, 3, 2)))
        cube.attrs["MATLAB_class"] = np.bytes_("double")
        nothing = file.create_dataset("nothing", data=np.zeros(2, dtype=np.uint64))
        nothing.attrs["MATLAB_class"] = np.bytes_("double")
        nothing.attrs["MATLAB_empty"] = np.uint8(1)
        series = file.create_dataset("ts", data=np.zeros((1, 6), dtype=np.uint32))
        series.attrs["MATLAB_class"] = np.bytes_("timeseries")
        series.attrs["MATLAB_object_decode"] = np.int32(3)
    head = b"MATLAB 7.3 MAT-file, Platform: GLNXA64, HDF5 schema 1.00 ."
    with path.open("r+b") as raw:
        raw.write(head.ljust(124) + b"\x00\x02IM")


WRITERS = {
    "run.h5": write_hdf5,
    "run.npz": write_npz,
    "run.parquet": write_parquet,
    "v5.mat": write_v5,
    "v73.mat": write_v73,
    "huge.npz": write_huge,
    "twins.parquet": write_twins,
}


def write_all(folder: Path) -> dict[str, Path]:
    """One file of each kind, by its name without the ending or, of `run`, by the ending."""
    paths = {}
    for name, write in WRITERS.items():
        stem, ending = name.split(".")
        paths[ending if stem == "run" else stem] = folder / name
        write(folder / name)
    return paths
