"""Read files of named arrays: HDF5 and `numpy.savez`. Pickled objects are never opened."""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Collection, Iterator
from itertools import accumulate, chain
from pathlib import Path
from typing import Any

import numpy as np

from bayesdrill.basics.errors import InputError, report_damage
from bayesdrill.output_files import LARGEST_FILE
from bayesdrill.record.formats.table import RecordTable, read_bytes

_NUMERIC = "fiub"  # numpy dtype kinds of real numbers and logicals
ITSELF = "save the numbers themselves in this file"


def _add(table: RecordTable, name: str, values: np.ndarray[Any, Any]) -> None:
    """Add a real array of one or two dimensions; list any other array in `ignored`."""
    if values.dtype.kind == "c":
        table.ignored[name] = "is complex; save its real part"
    elif values.dtype.kind not in _NUMERIC:
        table.ignored[name] = "is not a numeric array; save it as a plain array of double"
    elif values.size == 0:
        table.ignored[name] = "is empty"
    elif values.ndim > 2:
        size = " x ".join(str(n) for n in values.shape)
        table.ignored[name] = f"has {values.ndim} dimensions ({size}); save a matrix or a vector"
    else:
        flat = values.ravel() if 1 in values.shape or values.ndim == 0 else values
        table.variables[name] = np.ascontiguousarray(flat, dtype=np.float64)


def add_fields(table: RecordTable, name: str, values: np.ndarray[Any, Any]) -> None:
    """Add an array, or the fields of its records; the longer side of a matrix is time."""
    if values.dtype.names:
        for field_name in values.dtype.names:
            add_fields(table, f"{name}.{field_name}", values[field_name])
    elif values.ndim == 2 and values.shape[0] < values.shape[1]:
        _add(table, name, values.T)
    else:
        _add(table, name, values)


CUT_SHORT = "is damaged or cut short ({}); copy or save it again"


def too_large(shape: tuple[int, ...], itemsize: int) -> str:
    """Return the reason why an array is too large to be read, or an empty text."""
    size = itemsize * float(np.prod(np.array(shape, dtype=np.float64)))
    if size <= LARGEST_FILE:
        return ""
    most = f"at most {LARGEST_FILE / 1e6:.0f} MB are read"
    return f"takes {size / 1e6:.0f} MB; {most}: save fewer columns, or resample to a lower rate"


def read_hdf5(path: Path, selected: Collection[str] | None = None) -> RecordTable:
    """Read the `selected` datasets, with dotted names for fields; None stands for all."""
    import h5py

    head = read_bytes(path, 16)
    if head.startswith(b"MATLAB 7.3"):
        message = "is a MATLAB file; give it the ending .mat, or write format: mat"
        raise InputError.at(str(path), message)
    table = RecordTable(path=path)
    # `table.speed` is a field of `table`, or a name that contains a point.
    paths = [accumulate(name.lstrip("/").split("."), "{}.{}".format) for name in selected or ()]
    used = None if selected is None else {*chain.from_iterable(paths)}
    broken = "is not an HDF5 file; save it with h5py, or rename it to match its format"
    if head.startswith(b"\x89HDF\r\n\x1a\n"):
        broken = f"the HDF5 file {CUT_SHORT}"
    with report_damage(str(path), broken), h5py.File(path, "r") as file:
        for name, item in datasets(file, table, used, separator="/", called="group"):
            if reason := _unfit_dataset(item):
                table.ignored[name] = reason
            else:
                add_fields(table, name, np.asarray(item[()]))
    return table


def datasets(
    file: Any,
    table: RecordTable,
    used: Collection[str] | None,
    *,
    separator: str,
    called: str,
    unfit: Callable[[str, Any], str] = lambda name, item: "",
    hidden_prefix: str = "/",
) -> Iterator[tuple[str, Any]]:
    """Yield names and items of an HDF5 file that are `used`; None stands for all.

    Messages use the noun `called` for groups. If `unfit(name, item)` returns a reason, the item is
    ignored and `table` keeps the reason. Names that begin with `hidden_prefix` are skipped.
    """
    import h5py

    groups = set[int]()  # addresses of visited groups, as hard links may form cycles

    def below(group: Any, prefix: str) -> Iterator[tuple[str, Any]]:
        for member in group:
            name = f"{prefix}{member}"
            if name.startswith(hidden_prefix):
                continue
            if not isinstance(group.get(member, getlink=True), h5py.HardLink):
                table.ignored[name] = f"is a link to elsewhere; {ITSELF}"
                continue
            item = group[member]
            if reason := unfit(name, item):
                table.ignored[name] = reason
            elif not isinstance(item, h5py.Group):
                if used is None or name in used:
                    yield name, item
                else:
                    table.unread.append(name)
            elif (address := h5py.h5o.get_info(item.id).addr) in groups:
                table.ignored[name] = f"is a second name of the same {called}; give the first name"
            else:
                groups.add(address)
                yield from below(item, f"{name}{separator}")

    return below(file, "")


def _unfit_dataset(item: Any) -> str:
    """Return the reason why an item holds no plain numbers; empty for plain numbers."""
    import h5py

    if not isinstance(item, h5py.Dataset):
        return "is a named type, not numbers"
    if item.is_virtual or item.external:
        return f"has its numbers in other files; {ITSELF}"
    if missing := _filters_missing(item):
        return f"is compressed by {missing}, which is not installed; save it with gzip, or plain"
    if item.shape is None:
        return "is empty"
    if h5py.check_string_dtype(item.dtype) is not None or item.dtype.kind == "S":
        return "is text, not numbers"
    if item.dtype.kind == "O":
        return "holds references or rows of unequal length; save it as a plain array of double"
    return too_large(item.shape, item.dtype.itemsize)


def _filters_missing(item: Any) -> str:
    from h5py import h5z

    plan = item.id.get_create_plist()
    filters = [plan.get_filter(at) for at in range(plan.get_nfilters())]
    names = [name.decode(errors="replace") or f"filter {code}" for code, _, _, name in filters]
    here = [h5z.filter_avail(code) for code, *_ in filters]
    return ", ".join(name for name, known in zip(names, here, strict=True) if not known)


_HEADERS = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}


def read_npz(path: Path, selected: Collection[str] | None = None) -> RecordTable:
    """Read the `selected` arrays, with dotted names for fields of records; None stands for all."""
    head = read_bytes(path, 8)
    if not head.startswith(b"PK\x03\x04"):
        alone = head.startswith(b"\x93NUMPY")
        what = "holds one array without a name" if alone else "is not an .npz file"
        message = f"{what}; save it with numpy.savez('run.npz', t=t, w_1=w_1)"
        raise InputError.at(str(path), message)
    used = None if selected is None else {name.split(".")[0] for name in selected} | {*selected}
    table = RecordTable(path=path)
    with report_damage(str(path), f"the .npz file {CUT_SHORT}"), zipfile.ZipFile(path) as file:
        for member in file.namelist():
            name = member.removesuffix(".npy")
            if name == member:
                table.ignored[name] = "is no array"
            elif used is not None and name not in used:
                table.unread.append(name)
            elif reason := _unfit_array(name, file, member):
                table.ignored[name] = reason
            else:
                with file.open(member) as stream:
                    values = np.lib.format.read_array(stream, allow_pickle=False)
                add_fields(table, name, values)
    nothing = not table.variables and not table.unread
    if nothing and {*table.ignored.values()} <= {"is no array"}:
        raise InputError.at(str(path), "is a zip archive without arrays; save it with numpy.savez")
    return table


def _unfit_array(name: str, file: zipfile.ZipFile, member: str) -> str:
    """Read an array's header, and return why the array cannot be read; empty for plain numbers."""
    with file.open(member) as stream:
        version: Any = np.lib.format.read_magic(stream)
        if version not in _HEADERS:
            return "has field names with letters beyond Latin-1; save plain arrays"
        shape, _, dtype = _HEADERS[version](stream)
    if dtype.hasobject:
        why = "holds Python objects, which are never opened, as they can run code"
        return f"{why}; save plain numbers: {name}=np.asarray({name}, float)"
    if dtype.kind in "US":
        return "is text, not numbers"
    if dtype.kind in "mM":
        seconds = f"({name} - {name}[0]) / np.timedelta64(1, 's')"
        return f"holds dates or durations; save seconds: {seconds}"
    return too_large(shape, dtype.itemsize)
