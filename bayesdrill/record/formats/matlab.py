"""Read MATLAB files: v5 to v7 by SciPy, v7.3 by h5py.

SciPy reads cells and structs recursively, and crashes if a file has some thousand levels. The depth
of a v5 to v7 file is therefore checked first, without recursion. The file is a flat stream of
elements, each with a tag, which this module reads in the same order as SciPy. The dimensions of a
cell, not the length in its tag, give the number of its members.
"""

from __future__ import annotations

import math
import struct
import warnings
import zlib
from collections.abc import Buffer, Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bayesdrill.basics.errors import InputError, report_damage
from bayesdrill.output_files import LARGEST_FILE
from bayesdrill.record.formats.arrays import CUT_SHORT, ITSELF, add_fields, datasets
from bayesdrill.record.formats.table import RecordTable, read_bytes

TITLES, UNITS = ("label", "title", "Name"), ("unit", "Unit")  # of a signal, in order of preference
MAX_DEPTH = 100  # usual files have fewer than ten levels, and SciPy fails at a thousand

_MATRIX, _COMPRESSED = 14, 15  # kinds of elements
# Classes of matrices that contain other matrices.
_CELL, _STRUCT, _OBJECT, _FUNCTION, _OPAQUE = 1, 2, 3, 16, 17
_CONTAINERS = {_CELL, _STRUCT, _OBJECT, _FUNCTION, _OPAQUE}
_CLASS = 16  # offset of a matrix's class from the beginning of its tag, in bytes
_MAX_DIMENSIONS = 32


def too_deep(file: bytes) -> bool:
    """Return whether a file has more than `MAX_DEPTH` levels, without decompressing numbers.

    Raises `zlib.error` or `struct.error` if the file is damaged.
    """
    if 0 in file[:4]:  # v4 has no cells
        return False
    order = "<" if file[126:128] == b"IM" else ">"
    at, view = 128, memoryview(file)
    while at < len(file):
        kind, size = struct.unpack_from(f"{order}II", file, at)
        matrix: Buffer = view[at:]
        if kind == _COMPRESSED:
            packed = view[at + 8 : at + 8 + size]
            matrix = zlib.decompressobj().decompress(packed, _CLASS + 4)
            if _class(matrix, 0, order) in _CONTAINERS:
                matrix = zlib.decompressobj().decompress(packed, LARGEST_FILE)
        if _class(matrix, 0, order) in _CONTAINERS and _Walk(matrix, order).too_deep():
            return True
        at += 8 + size
    return False


def _class(matrix: Buffer, at: int, order: str) -> int:
    return int(struct.unpack_from(f"{order}I", matrix, at + _CLASS)[0]) & 0xFF


class _Walk:
    """A walk reads one variable, element by element, to find its depth."""

    def __init__(self, data: Buffer, order: str) -> None:
        self._data, self._order, self._at = memoryview(data), order, 0

    def too_deep(self) -> bool:
        remaining = [1]  # number of matrices still to read, at each depth
        try:
            while remaining and len(remaining) <= MAX_DEPTH + 1:
                if remaining[-1] == 0:
                    remaining.pop()
                    continue
                remaining[-1] -= 1
                if count := self._enter():
                    remaining.append(count)
        except struct.error:  # the end of the data, or a file that is cut short
            return False
        return bool(remaining)

    def _enter(self) -> int:
        """Advance past the head of a matrix, and return the number of matrices that it contains."""
        (size,) = self._words(self._at + 4, 1)
        if size == 0:
            self._at += 8
            return 0
        kind, count = _class(self._data, self._at, self._order), 0
        self._at += _CLASS + 8
        if kind in (_FUNCTION, _OPAQUE):
            count = 1
        if kind != _OPAQUE:
            begin, size = self._element()
            count = count or math.prod(self._words(begin, min(size // 4, _MAX_DIMENSIONS)))
            self._element()  # name of the matrix
        if kind == _OBJECT:
            self._element()  # name of the class
        if kind in (_STRUCT, _OBJECT):
            letters = self._words(self._element()[0], 1)[0]
            count *= self._element()[1] // max(letters, 1)
        while self._words(self._at, 1)[0] != _MATRIX:
            self._element()
        return count if kind in _CONTAINERS else 0

    def _element(self) -> tuple[int, int]:
        """Advance past an element that is no matrix; return the offset and size of its data [bytes]."""
        at, (kind, size) = self._at, self._words(self._at, 2)
        if kind >> 16:  # the tag of a small element contains the data
            self._at += 8
            return at + 4, kind >> 16
        self._at += 8 + size + -size % 8
        return at + 8, size

    def _words(self, at: int, count: int) -> tuple[int, ...]:
        return struct.unpack_from(f"{self._order}{count}I", self._data, at)


def read(path: Path, selected: Collection[str] | None = None) -> RecordTable:
    """Read the `selected` variables of a .mat file, or all if None, with dotted names for fields."""
    import h5py

    head = read_bytes(path, 128)
    is_hdf5 = head.startswith(b"MATLAB 7.3") or bool(h5py.is_hdf5(path))
    broken = "is not a MATLAB file; save it in MATLAB with save('run.mat', ...), "
    broken += "or if it is text give it the ending .csv"
    if head.startswith(b"MATLAB"):
        broken = f"the MATLAB file {CUT_SHORT}"
    with report_damage(str(path), broken):
        return _read_v73(path, selected) if is_hdf5 else _read_v5(path, selected)


def _read_v5(path: Path, selected: Collection[str] | None) -> RecordTable:
    from scipy.io import loadmat

    table = RecordTable(path=path)
    used = None if selected is None else {name.split(".")[0] for name in selected}
    with warnings.catch_warnings():
        # SciPy warns of unnamed objects; the code below reports them if they are wanted.
        warnings.simplefilter("ignore")
        if too_deep(path.read_bytes()):
            message = f"holds cells or structs more than {MAX_DEPTH} deep; save plain arrays"
            raise InputError.at(str(path), message)
        content: Mapping[str, Any] = loadmat(path, mat_dtype=False, variable_names=used)
        if used is not None and not used <= content.keys():  # the error message lists all names
            content = loadmat(path, mat_dtype=False)
    for name, value in content.items():
        if not name.startswith("__"):
            _walk_v5(name, value, table)
    return table


def _walk_v5(name: str, value: Any, table: RecordTable) -> None:
    from scipy.io.matlab import MatlabFunction, MatlabObject, MatlabOpaque

    if isinstance(value, MatlabOpaque):
        # Older releases of SciPy store the variable's name in the array, not as the key.
        known = value.dtype.names or ()
        name = _text(value["s0"].flat[0]) if "s0" in known else name
        kinds = [_text(value[key].flat[0]) for key in ("_Class", "s2") if key in known]
        table.ignored[name] = _opaque(name, kinds[0] if kinds else "")
    elif isinstance(value, MatlabObject | MatlabFunction):
        table.ignored[name] = _opaque(name, str(getattr(value, "classname", "function")))
    elif not isinstance(value, np.ndarray):
        table.ignored[name] = "is sparse; save full(...) of it"
    elif value.dtype.names is not None:
        for number, element in enumerate(value.flat, start=1):
            place = f"{name}({number})" if value.size > 1 else name
            fields = value.dtype.names  # some fields only describe the signal
            samples = [f for f in fields if f == "values" or (f == "Data" and value.size > 1)]
            for field in samples or fields:
                _walk_v5(f"{place}.{field}", element[field], table)
            for label_of, names in ((table.labels, TITLES), (table.units, UNITS)):
                texts = [element[field] for field in names if field in fields]
                if texts := [text for text in texts if text.dtype.kind == "U" and text.size]:
                    label_of |= {f"{place}.{f}": str(texts[0].flat[0]) for f in ("values", "Data")}
    elif value.dtype.kind in "US":
        table.ignored[name] = "is text, not numbers"
    elif value.dtype.kind == "O":
        table.ignored[name] = "is a cell array; save cell2mat(...) of it"
    else:
        add_fields(table, name, value)


def _read_v73(path: Path, selected: Collection[str] | None) -> RecordTable:
    import h5py

    table = RecordTable(path=path)
    layout = {
        "separator": ".",
        "called": "struct",
        "hidden_prefix": "#",
    }  # MATLAB's own group is #refs#
    with h5py.File(path, "r") as file:
        for name, item in datasets(file, table, selected, unfit=_unfit, **layout):
            # MATLAB writes column by column, so HDF5 shows every array transposed.
            add_fields(table, name, np.asarray(item[()]).T)
    return table


def _unfit(name: str, item: Any) -> str:
    """Return why an item of a v7.3 file holds no plain numbers; an empty text if it holds them."""
    import h5py

    kind = _text(item.attrs.get("MATLAB_class", b""))
    if "MATLAB_object_decode" in item.attrs:
        return _opaque(name, kind)
    if "MATLAB_sparse" in item.attrs:
        return "is sparse; save full(...) of it"
    if isinstance(item, h5py.Group):
        return ""
    if item.attrs.get("MATLAB_empty", 0):
        return "is empty"
    if kind == "char":
        return "is text, not numbers"
    if kind == "cell":
        return "is a cell array; save cell2mat(...) of it"
    if item.is_virtual or item.external:
        return f"has its numbers in other files; {ITSELF}"
    if item.dtype.kind == "O":
        return "is part of an array of structs; save a single struct, or all with -v7"
    if item.dtype.names == ("real", "imag"):
        return "is complex; save its real part"
    return ""


def _opaque(name: str, kind: str) -> str:
    """Return the reason why a MATLAB object cannot be read, and what to type in MATLAB."""
    what = f"is a MATLAB object ({kind})" if kind else "is a MATLAB object"
    ways = {
        "timeseries": f"t = {name}.Time; y = {name}.Data; save('run.mat', 't', 'y')",
        "timetable": f"y = {name}.Variables; save('run.mat', 'y')",
        "table": f"y = {name}.Variables; save('run.mat', 'y')",
    }
    example = f": {ways[kind]}" if kind in ways else ""
    return f"{what}, which only MATLAB can open; save it as plain arrays{example}"


def _text(value: Any) -> str:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)
