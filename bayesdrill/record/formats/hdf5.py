"""HDF5 files that are not MATLAB's: datasets by their paths, `run1/speed`."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np

from bayesdrill.basics.errors import InputError
from bayesdrill.record.formats.arrays import ITSELF, Damaged, Found, too_large
from bayesdrill.record.formats.table import Table, read_bytes

_MAGIC = b"\x89HDF\r\n\x1a\n"


def read(path: Path, wanted: Collection[str] | None = None) -> Table:
    """Read the `wanted` datasets (fields of records under dotted names; None: all).

    Attributes, also one called `unit`, are not looked at.  Raises InputError when it cannot be read.
    """
    import h5py

    head = read_bytes(path, 16)
    if head.startswith(b"MATLAB 7.3"):
        raise InputError.one(
            str(path), "is a MATLAB file; give it the ending .mat, or say the format: mat"
        )
    found = Found()
    used = None if wanted is None else {form for name in wanted for form in _records(name)}
    try:
        with h5py.File(path, "r") as file:
            _walk("", file, used, found)
    except Exception as error:  # damaged bytes come up as anything
        raise InputError.one(str(path), _broken(head, str(Damaged(error)))) from error
    return found.table(path)


def _records(name: str) -> tuple[str, ...]:
    """`table.speed` is a field of `table`, or has a point in its own name."""
    parts = name.lstrip("/").split(".")
    return tuple(".".join(parts[:count]) for count in range(1, len(parts) + 1))


def _broken(head: bytes, reason: str) -> str:
    if head.startswith(_MAGIC):
        return f"the HDF5 file is damaged or cut short ({reason}); copy or save it again"
    return "is not an HDF5 file; save it with h5py, or give it the ending of what it is"


def _walk(prefix: str, group: Any, wanted: Collection[str] | None, found: Found) -> None:
    import h5py

    for member in group:
        name = f"{prefix}{member}"
        if not isinstance(group.get(member, getlink=True), h5py.HardLink):
            found.ignored[name] = f"is a link to elsewhere; {ITSELF}"
            continue
        item = group[member]
        if isinstance(item, h5py.Group):
            address = h5py.h5o.get_info(item.id).addr
            if address in found.structs:  # a walk might have no end
                found.ignored[name] = "is the same group under a second name; give the first"
                continue
            found.structs.add(address)
            _walk(f"{name}/", item, wanted, found)
        elif wanted is not None and name not in wanted:
            found.unread.append(name)
        elif reason := _unfit(item):
            found.ignored[name] = reason
        else:
            found.add_fields(name, np.asarray(item[()]))


def _unfit(item: Any) -> str:
    """Why an item holds no plain numbers of its own, if so."""
    import h5py

    if not isinstance(item, h5py.Dataset):
        return "is a named type, not numbers"
    if item.is_virtual or item.external:
        return f"has its numbers in other files; {ITSELF}"
    if missing := _filters_missing(item):
        return f"is compressed by {missing}, which is not here; save it with gzip, or plain"
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
