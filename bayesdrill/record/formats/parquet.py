"""Read Parquet with `pyarrow`: columns of numbers, and of lists, as LeRobot writes them.

A column of lists with equal lengths becomes a column for each element of the lists, such as
`observation.state.shoulder`. Names of elements come from `meta/info.json` of the data set;
elements without a name are counted from 0.
"""

from __future__ import annotations

import json
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.basics.errors import InputError, report_damage
from bayesdrill.record.formats.arrays import CUT_SHORT, too_large
from bayesdrill.record.formats.table import RecordTable, keys_of, missing_package, read_bytes

LEVELS = 4  # number of folders above the file in which `meta` is searched
MAX_PLACES = 1000  # largest length of a list; each element becomes a column


def read(path: Path, selected: Collection[str] | None = None) -> RecordTable:
    """Read the `selected` columns; None stands for all, and empty cells become NaN."""
    if read_bytes(path, 4) != b"PAR1":
        message = "is not a Parquet file; save it as one, or rename it to match its format"
        raise InputError.at(str(path), message)
    try:
        from pyarrow import default_memory_pool, float64, types
        from pyarrow.parquet import ParquetFile
    except ImportError:
        raise missing_package(path, "a Parquet file", "parquet") from None
    named, unfit = _names_of_places(path), dict[str, str]()
    variables, columns, unread = dict[str, Array](), list[str](), list[str]()
    damage = report_damage(str(path), f"the Parquet file {CUT_SHORT}")
    with damage, ParquetFile(path, pre_buffer=False) as file:
        schema, rows = file.schema_arrow, file.metadata.num_rows
        keys, ignored = keys_of(schema.names)
        # Columns are read one by one; if two have the same name, all are read together.
        whole = file.read(use_threads=False) if ignored else None
        for name, kind in zip(keys, schema.types, strict=True):
            is_list = types.is_list(kind) or types.is_fixed_size_list(kind)
            reason = _unfit_column(name, kind.value_type if is_list else kind, rows)
            here = dict[str, Array]()
            if not reason and (is_list or selected is None or name in selected):
                table = file.read(columns=[name], use_threads=False) if whole is None else whole
                column = table.column(0 if whole is None else keys.index(name))
                if is_list:
                    here = _element_columns(name, column, rows, named.get(name, []))
                    reason = "" if here else "has lists of different lengths, or very long ones"
                else:
                    here = {name: np.array(column.cast(float64(), safe=False).to_numpy())}
            variables |= here
            columns += [*here] or [name]
            if reason:
                unfit[name] = reason
            elif not here:
                unread.append(name)
    default_memory_pool().release_unused()
    return RecordTable(
        path=path,
        variables=variables,
        lines=np.arange(1, rows + 1),
        called="row",
        columns=tuple(columns),
        ignored=ignored | unfit,
        unread=unread,
    )


def _element_columns(name: str, column: Any, rows: int, named: list[str]) -> dict[str, Array]:
    """Return a column for each element of the lists in a column; empty if their lengths differ."""
    flat = column.combine_chunks().flatten()
    if column.null_count or len(flat) > MAX_PLACES * rows:
        return {}
    if len({len(item) for item in column.to_pylist()}) != 1 or not len(flat):
        return {}
    matrix = np.array(flat.to_numpy(zero_copy_only=False), dtype=np.float64).reshape(rows, -1)
    places = named if len(named) == matrix.shape[1] else range(matrix.shape[1])
    return {f"{name}.{place}": x for place, x in zip(places, matrix.T.copy(), strict=True)}


def _names_of_places(path: Path) -> dict[str, list[str]]:
    """Return the names of list elements by column, from `meta/info.json` in a folder above."""
    for folder in path.resolve().parents[:LEVELS]:
        try:
            features = json.loads((folder / "meta" / "info.json").read_text())["features"]
            names = {name: feature.get("names") for name, feature in features.items()}
        except (OSError, ValueError, KeyError, AttributeError, TypeError):
            continue
        lists = {
            n: next(iter(x.values()), x) if isinstance(x, dict) else x for n, x in names.items()
        }
        return {n: [*map(str, x)] for n, x in lists.items() if isinstance(x, list)}
    return {}


def _unfit_column(name: str, kind: Any, rows: int) -> str:
    """Return the reason why a column holds no numbers; empty for numbers."""
    from pyarrow import types

    if types.is_temporal(kind):
        seconds = f"in pandas (df[{name!r}] - df[{name!r}].iloc[0]).dt.total_seconds()"
        dates = f"holds dates, times or durations ({kind})"
        return f"{dates}; save seconds since the start as numbers, {seconds}"
    numeric = (types.is_integer, types.is_floating, types.is_boolean, types.is_decimal)
    if any(is_one(kind) for is_one in numeric):
        return too_large((rows,), 8)
    return f"is of type {kind}, not numbers; save it as a column of double"
