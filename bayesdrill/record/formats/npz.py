"""Files of `numpy.savez`: arrays by their names. What is pickled in one is never opened."""

from __future__ import annotations

import zipfile
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np

from bayesdrill.basics.errors import InputError
from bayesdrill.record.formats.arrays import Damaged, Found, too_large
from bayesdrill.record.formats.table import Table, read_bytes

_ZIP = b"PK\x03\x04"
_HEADERS = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}


def read(path: Path, wanted: Collection[str] | None = None) -> Table:
    """Read the `wanted` arrays (fields of records under dotted names; None: all of numbers).

    Raises InputError when it cannot be read.
    """
    head = read_bytes(path, 8)
    if not head.startswith(_ZIP):
        raise InputError.one(str(path), _other(head))
    used = None if wanted is None else {name.split(".")[0] for name in wanted} | {*wanted}
    found = Found()
    try:
        with zipfile.ZipFile(path) as file:
            for member in file.namelist():
                name = member.removesuffix(".npy")
                if name == member:
                    found.ignored[name] = "is no array"
                elif used is not None and name not in used:
                    found.unread.append(name)
                else:
                    _add(name, file, member, found)
    except Exception as error:  # damaged bytes come up as anything
        reason = f"is damaged or cut short ({Damaged(error)}); copy or save it again"
        raise InputError.one(str(path), f"the .npz file {reason}") from error
    if not found.variables and not found.unread and all(map(_no_array, found.ignored.values())):
        raise InputError.one(str(path), "is a zip archive without arrays; save it with numpy.savez")
    return found.table(path)


def _no_array(reason: str) -> bool:
    return reason == "is no array"


def _other(head: bytes) -> str:
    if head.startswith(b"\x93NUMPY"):
        return "holds one array without a name; save it with numpy.savez('run.npz', t=t, w_1=w_1)"
    return "is not an .npz file; save it with numpy.savez('run.npz', t=t, w_1=w_1)"


def _add(name: str, file: zipfile.ZipFile, member: str, found: Found) -> None:
    """The head of an array says what it is, before anything of it is opened."""
    with file.open(member) as stream:
        version: Any = np.lib.format.read_magic(stream)
        if version not in _HEADERS:
            found.ignored[name] = "has names of fields beyond Latin letters; save plain arrays"
            return
        shape, _, dtype = _HEADERS[version](stream)
    if dtype.hasobject:
        found.ignored[name] = (
            "holds Python objects, which are never opened, as they can run code; save plain "
            f"numbers: {name}=np.asarray({name}, float)"
        )
    elif dtype.kind in "US":
        found.ignored[name] = "is text, not numbers"
    elif dtype.kind in "mM":
        found.ignored[name] = (
            f"holds dates or durations; save seconds: ({name} - {name}[0]) / np.timedelta64(1, 's')"
        )
    elif reason := too_large(shape, dtype.itemsize):
        found.ignored[name] = reason
    else:
        with file.open(member) as stream:
            found.add_fields(name, np.lib.format.read_array(stream, allow_pickle=False))
