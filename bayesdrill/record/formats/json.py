"""Read JSON: columns of numbers, lists of records and tables of rows, at any depth."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np

from bayesdrill.basics.errors import report_damage
from bayesdrill.record.formats.arrays import add_fields
from bayesdrill.record.formats.table import RecordTable, decode

_BLANK = re.compile(r"[\s,]*")
MAX_KEYS = 1000  # largest number of names in a list of records; each name becomes a column
FRC_TEST = re.compile("(slow|fast)-(forward|backward)")  # a test in a log of frc-characterization
# Names of columns in SysId's logs of a mechanism (4 columns) and of a drive (9 columns).
SYSID_COLUMNS = {
    4: ("time [s]", "voltage [V]", "position", "speed"),
    9: (
        *("time [s]", "left voltage [V]", "right voltage [V]", "left position", "right position"),
        *("left speed", "right speed", "gyro angle", "gyro rate"),
    ),
}
FRC_COLUMNS = (
    *("time [s]", "battery voltage [V]", "autospeed", "left voltage [V]", "right voltage [V]"),
    *("left position", "right position", "left speed", "right speed", "gyro angle"),
)


def read(path: Path) -> RecordTable:
    """Read all numbers of a JSON file; columns have dotted names, as in `entries.position`."""
    table, text = RecordTable(path=path), decode(path)
    with report_damage(
        str(path), "cannot be read as JSON ({}); write it again, or correct the line"
    ):
        _walk("", _parse(text), table)
    return table


def _parse(text: str) -> Any:
    """Return the value of a JSON text; a sequence of values, as in logs, becomes a list."""
    values, at = list[Any](), _BLANK.match(text, 0).end()  # type: ignore[union-attr]
    while at < len(text):
        value, at = json.JSONDecoder().raw_decode(text, at)
        values.append(value)
        at = _BLANK.match(text, at).end()  # type: ignore[union-attr]
    return values[0] if len(values) == 1 else values


def _with_names(log: dict[str, Any]) -> dict[str, Any]:
    """Return a log of frc-characterization with a row of names above the rows of each test."""
    drive = SYSID_COLUMNS[9] if log.get("sysid") is True else FRC_COLUMNS
    named = dict(log)
    for key, rows in log.items():
        first = rows[0] if isinstance(rows, list) and rows else None
        if FRC_TEST.fullmatch(key) and isinstance(first, list):
            count = len(first)
            names = SYSID_COLUMNS[4] if count == 4 else drive[:count] if count in (9, 10) else ()
            named[key] = [[*names], *rows] if len(names) == count else rows
    return named


def _walk(name: str, value: Any, table: RecordTable) -> None:
    """Add all columns below `name`, in mappings, lists of records, and rows; `null` becomes NaN."""
    if isinstance(value, dict) and [*value] == [*map(str, range(len(value)))]:  # row numbers
        value = [*value.values()]
    if isinstance(value, list) and {*map(type, value)} == {list} and value[0]:
        named = len(value) > 1 and {*map(type, value[0])} == {str}
        if named and {*map(len, value)} == {len(value[0])}:
            value = [dict(zip(value[0], row, strict=True)) for row in value[1:]]
    if isinstance(value, list) and {dict} <= {*map(type, value)} <= {dict, type(None)}:
        keys = dict.fromkeys(key for item in value for key in item or ())
        if len(keys) > MAX_KEYS:
            raise ValueError(f"records with {len(keys)} names are too many")
        value = {key: [(item or {}).get(key) for item in value] for key in keys}
    if isinstance(value, dict):
        for key, item in (value if name else _with_names(value)).items():
            _walk(f"{name}.{key}" if name else str(key), item, table)
        return
    try:
        add_fields(table, name or "data", np.array(value, dtype=np.float64))
    except (ValueError, TypeError, OverflowError):
        table.ignored[name or "data"] = "is neither a list of numbers nor rows of equal length"
