"""MATLAB files of both kinds: one set of numbers, and what the errors say."""

import struct
import zlib
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io
import scipy.io.matlab
from support.array_files import DATA, T, W
from support.case_tables import run_cases

from bayesdrill.basics.errors import InputError
from bayesdrill.record.formats.matlab import MAX_DEPTH, read


def test_signals_in_an_array_of_structs_are_read_with_their_names(tmp_path: Path) -> None:
    """As ControlDesk saves: a time, and an array of structs of which each is a signal."""
    y = np.zeros((1, 2), dtype=[(n, "O") for n in ("Name", "Type", "Data", "Unit")])
    y[0, 0] = ("Model/speed", 2, W[None, :], "")
    y[0, 1] = ('"Model Root"/"duty"', 2, T[None, :], "")
    content = {"X": {"Name": "time", "Data": T[None, :]}, "Y": y}
    scipy.io.savemat(tmp_path / "run.mat", {"run1": content})
    table = read(tmp_path / "run.mat", {"run1.X.Data", "run1.Y(2).Data"})
    np.testing.assert_array_equal(table.pick("run1.Y(1).Data"), W)
    np.testing.assert_array_equal(table.pick("run1.Y(2).Data"), T)
    assert table.labels["run1.Y(1).Data"] == "Model/speed"
    assert table.labels["run1.X.Data"] == "time"
    assert "run1.Y(1).Type" not in table.variables
    with pytest.raises(InputError, match=r"an array of structs; name a field of one: run1.Y\(1"):
        table.pick("run1.Y")


def test_the_only_variable_needs_no_name(tmp_path: Path) -> None:
    scipy.io.savemat(tmp_path / "run.mat", {"data": DATA})
    np.testing.assert_array_equal(read(tmp_path / "run.mat").pick(2), W)


def test_a_damaged_or_huge_variable_that_is_not_wanted_does_no_harm(tmp_path: Path) -> None:
    path = tmp_path / "run.mat"
    scipy.io.savemat(path, {"t": T, "noise": np.arange(500.0)}, do_compression=False)
    path.write_bytes(path.read_bytes()[:-100])
    np.testing.assert_array_equal(read(path, {"t"}).pick("t"), T)
    with pytest.raises(InputError, match="damaged or cut short"):
        read(path)
    with h5py.File(path, "w") as file:
        file["t"] = T
        file.create_dataset("bomb", (10**12,), "f8", chunks=(10**6,))
    np.testing.assert_array_equal(read(path, {"t"}).pick("t"), T)


def nested(depth: int, *, packed: bool, size_of_cells: int | None = None) -> bytes:
    """Return a file of a number in cells in cells; a given size stands in the tags of inner ones."""
    number = element(14, element(6, struct.pack("<II", 6, 0)) + ONE + element(1, b"") + SEVEN)
    heads, size = [], len(number)
    for k in reversed(range(depth)):
        flags, name = element(6, struct.pack("<II", 1, 0)), element(1, b"" if k else b"deep")
        head = flags + ONE + name
        size += len(head)
        told = size if k == 0 or size_of_cells is None else size_of_cells
        heads.append(struct.pack("<II", 14, told) + head)
        size += 8
    content = b"".join(reversed(heads)) + number
    if packed:
        content = struct.pack("<II", 15, len(zlib.compress(content))) + zlib.compress(content)
    return b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" + content


def element(kind: int, content: bytes) -> bytes:
    return struct.pack("<II", kind, len(content)) + content.ljust(-(-len(content) // 8) * 8, b"\0")


ONE = element(5, struct.pack("<ii", 1, 1))  # by one
SEVEN = element(9, struct.pack("<d", 7.0))


@run_cases("packed", [False, True])
@run_cases("size_of_cells", [None, 8])
@run_cases("wanted", [None, {"deep"}, {"missing"}])
def test_cells_in_cells_end_no_process(
    packed: bool, size_of_cells: int | None, wanted: set[str] | None, tmp_path: Path
) -> None:
    """SciPy reads each inside the last, until its stack is full, and trusts no size of a cell."""
    path = tmp_path / "run.mat"
    path.write_bytes(nested(20_000, packed=packed, size_of_cells=size_of_cells))
    with pytest.raises(InputError, match=f"more than {MAX_DEPTH} deep; save plain arrays"):
        read(path, wanted)
