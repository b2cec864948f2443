"""MATLAB files: v5/v7 through scipy, v7.3 (which is HDF5) through h5py."""

from __future__ import annotations

import warnings
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bayesdrill.basics.errors import InputError
from bayesdrill.record.formats.arrays import ITSELF, Damaged, Found
from bayesdrill.record.formats.mat_nesting import DEEPEST, too_deep
from bayesdrill.record.formats.table import Table, read_bytes


def read(path: Path, wanted: Collection[str] | None = None) -> Table:
    """Read the `wanted` variables of a .mat file (dotted names; None: all numeric ones).

    Raises InputError when it cannot be read.
    """
    import h5py

    head = read_bytes(path, 128)
    try:
        is_hdf5 = head.startswith(b"MATLAB 7.3") or bool(h5py.is_hdf5(path))
        found = _read_v73(path, wanted) if is_hdf5 else _read_v5(path, wanted)
    except Damaged as error:
        raise InputError.one(str(path), _broken(head, str(error))) from error
    return found.table(path)


def _broken(head: bytes, reason: str) -> str:
    if head.startswith(b"MATLAB"):
        return f"the MATLAB file is damaged or cut short ({reason}); copy or save it again"
    return (
        "is not a MATLAB file; save it in MATLAB with save('run.mat', ...), "
        "or if it is text give it the ending .csv"
    )


def _read_v5(path: Path, wanted: Collection[str] | None) -> Found:
    from scipy.io import loadmat

    found = Found()
    used = None if wanted is None else {name.split(".")[0] for name in wanted}
    with warnings.catch_warnings():
        # scipy warns of objects it cannot name; they are reported below when asked for.
        warnings.simplefilter("ignore")
        try:
            if too_deep(path.read_bytes()):
                message = f"holds cells or structs more than {DEEPEST} deep; save plain arrays"
                raise InputError.one(str(path), message)
            content: Mapping[str, Any] = loadmat(path, mat_dtype=False, variable_names=used)
            if used is not None and not used <= content.keys():  # for what is said of the mistake
                content = loadmat(path, mat_dtype=False)
        except InputError:
            raise
        except Exception as error:
            # scipy meets damaged bytes with a dozen kinds of exception; all mean the same here.
            raise Damaged(error) from error
    for name, value in content.items():
        if not name.startswith("__"):
            _walk_v5(name, value, found)
    return found


def _walk_v5(name: str, value: Any, found: Found) -> None:
    from scipy.io.matlab import MatlabFunction, MatlabObject, MatlabOpaque

    if isinstance(value, MatlabOpaque):
        # Older releases of scipy leave the variable's own name in the record, not in the index.
        known = value.dtype.names or ()
        name = _text(value["s0"].flat[0]) if "s0" in known else name
        kinds = [_text(value[key].flat[0]) for key in ("_Class", "s2") if key in known]
        found.ignored[name] = _opaque(name, kinds[0] if kinds else "")
    elif isinstance(value, MatlabObject | MatlabFunction):
        found.ignored[name] = _opaque(name, str(getattr(value, "classname", "function")))
    elif not isinstance(value, np.ndarray):
        found.ignored[name] = "is sparse; save full(...) of it"
    elif value.dtype.names is not None:
        if value.size != 1:
            found.ignored[name] = f"is an array of {value.size} structs; save a single struct"
            return
        for field_name in value.dtype.names:
            _walk_v5(f"{name}.{field_name}", value[field_name].flat[0], found)
    elif value.dtype.kind in "US":
        found.ignored[name] = "is text, not numbers"
    elif value.dtype.kind == "O":
        found.ignored[name] = "is a cell array; save cell2mat(...) of it"
    else:
        found.add(name, value)


def _read_v73(path: Path, wanted: Collection[str] | None) -> Found:
    import h5py

    found = Found()
    try:
        with h5py.File(path, "r") as file:
            _walk_v73("", file, wanted, found)
    except Exception as error:  # damaged bytes come up as anything here too
        raise Damaged(error) from error
    return found


def _walk_v73(prefix: str, group: Any, wanted: Collection[str] | None, found: Found) -> None:
    import h5py

    for member in group:
        if not prefix and member.startswith("#"):  # #refs# and #subsystem# are MATLAB's own
            continue
        name = f"{prefix}{member}"
        if not isinstance(group.get(member, getlink=True), h5py.HardLink):
            found.ignored[name] = f"is a link to elsewhere; {ITSELF}"
            continue
        item = group[member]
        reason = _unfit(name, item)
        if reason:
            found.ignored[name] = reason
        elif isinstance(item, h5py.Group):
            address = h5py.h5o.get_info(item.id).addr
            if address in found.structs:  # MATLAB never writes that, and a walk may have no end
                found.ignored[name] = "is the same struct under a second name; give the first"
                continue
            found.structs.add(address)
            _walk_v73(f"{name}.", item, wanted, found)
        elif wanted is None or name in wanted:
            # MATLAB writes column by column, so HDF5 shows every array transposed.
            found.add(name, np.asarray(item[()]).T)
        else:
            found.unread.append(name)


def _unfit(name: str, item: Any) -> str:
    """Why an item of a v7.3 file holds no plain numbers of its own, if so."""
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
        return "is part of an array of structs; save a single struct"
    if item.dtype.names == ("real", "imag"):
        return "is complex; save its real part"
    return ""


def _opaque(name: str, kind: str) -> str:
    """Why an object of a MATLAB class cannot be read, and what to type instead."""
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
