"""Parquet files: a table of named columns. The library for them is an extra, as it is a large one."""

from __future__ import annotations

import importlib
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np

from bayesdrill.basics.errors import InputError
from bayesdrill.record.formats.arrays import Damaged, too_large
from bayesdrill.record.formats.table import Table, keys_of, read_bytes

_MAGIC = b"PAR1"
_MISSING = (
    "a Parquet file needs the package pyarrow, which is missing; install it with pip install "
    "'bayesdrill[parquet]', or save the record as CSV"
)


def read(path: Path, wanted: Collection[str] | None = None) -> Table:
    """Read the `wanted` columns (None: all); cells without a value become NaN.

    Raises InputError when it cannot be read, or without `pyarrow`.
    """
    if read_bytes(path, 4) != _MAGIC:
        message = "is not a Parquet file; save it as one, or give it the ending of what it is"
        raise InputError.one(str(path), message)
    try:
        importlib.import_module("pyarrow.parquet")
    except ImportError:
        raise InputError.one(str(path), _MISSING) from None
    try:
        return _table(path, wanted)
    except Exception as error:  # damaged bytes come up as anything
        reason = f"is damaged or cut short ({Damaged(error)}); copy or save it again"
        raise InputError.one(str(path), f"the Parquet file {reason}") from error


def _table(path: Path, wanted: Collection[str] | None) -> Table:
    from pyarrow import float64, parquet

    with parquet.ParquetFile(path, pre_buffer=False) as file:
        schema, rows = file.schema_arrow, file.metadata.num_rows
        keys, ignored = keys_of(schema.names)
        kinds = dict(zip(keys, schema.types, strict=True))
        unfit = {name: why for name, kind in kinds.items() if (why := _unfit(name, kind, rows))}
        fit = [name for name in keys if name not in unfit and (wanted is None or name in wanted)]
        # By their names, unless two have the same one.
        content = file.read(columns=None if ignored else fit, use_threads=False)
        places = {name: (keys if ignored else fit).index(name) for name in fit}
        variables = {
            name: np.ascontiguousarray(content.column(at).cast(float64(), safe=False).to_numpy())
            for name, at in places.items()
        }
    return Table(
        path=path,
        variables=variables,
        lines=np.arange(1, rows + 1),
        called="row",
        columns=tuple(keys),
        ignored=ignored | unfit,
        unread=tuple(name for name in keys if name not in variables and name not in unfit),
    )


def _unfit(name: str, kind: Any, rows: int) -> str:
    """Why a column holds no numbers, if so."""
    from pyarrow import types

    if types.is_temporal(kind):
        return (
            f"holds dates, times or durations ({kind}); save seconds since the start as numbers, in "
            f"pandas (df[{name!r}] - df[{name!r}].iloc[0]).dt.total_seconds()"
        )
    if any(
        is_one(kind)
        for is_one in (types.is_integer, types.is_floating, types.is_boolean, types.is_decimal)
    ):
        return too_large((rows,), 8)
    return f"is of type {kind}, not numbers; save it as a column of double"
