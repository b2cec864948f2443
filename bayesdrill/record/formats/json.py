"""JSON: columns of numbers, lists of records and tables of rows, at any depth of names.

A record on each line, as loggers append them, is a list of records.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from bayesdrill.basics.errors import InputError, report_damage
from bayesdrill.record.formats.arrays import add_fields
from bayesdrill.record.formats.table import RecordTable
from bayesdrill.record.formats.text import decode

MAX_KEYS = 1000  # of the records of one list, each of which becomes a column
# Columns of each test in a log of frc-characterization, which does not name them.
FRC_TESTS = {f"{speed}-{way}" for speed in ("slow", "fast") for way in ("forward", "backward")}
FRC_COLUMNS = (
    *("time [s]", "battery voltage [V]", "autospeed", "left voltage [V]", "right voltage [V]"),
    *("left position", "right position", "left speed", "right speed", "gyro angle"),
)


def read(path: Path) -> RecordTable:
    """Read all numbers of a JSON file; columns have dotted names, as in `entries.position`."""
    table, text = RecordTable(path=path), decode(path)
    with report_damage(str(path), "cannot be read as JSON ({}); write it again"):
        _walk("", _parse(path, text), table)
    return table


def _parse(path: Path, text: str) -> Any:
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        if not error.msg.startswith("Extra data"):
            raise
    records = []
    for number, line in enumerate(text.splitlines(), start=1):
        try:
            records += [json.loads(line)] if line.strip() else []
        except ValueError:
            message = "is no JSON of its own, as where writing was cut; mend it or remove it"
            raise InputError.at(f"{path} line {number}", message) from None
    return records


def _walk(name: str, value: Any, table: RecordTable) -> None:
    """Add what is below `name`: numbers, or what has names or numbers of its own."""
    if isinstance(value, dict) and [*value] == [*map(str, range(len(value)))]:  # as pandas writes
        value = [*value.values()]
    if isinstance(value, dict) and {"columns", "data"} <= value.keys():  # as pandas splits
        value = [value["columns"], *value["data"]]
    if isinstance(value, list) and {*map(type, value)} == {list} and value[0]:
        if name in FRC_TESTS and len(value[0]) in (len(FRC_COLUMNS) - 1, len(FRC_COLUMNS)):
            value = [[*FRC_COLUMNS[: len(value[0])]], *value]
        named = len(value) > 1 and {*map(type, value[0])} == {str}
        if named and {*map(len, value)} == {len(value[0])}:
            value = [dict(zip(value[0], row, strict=True)) for row in value[1:]]
    if isinstance(value, list) and {dict} <= {*map(type, value)} <= {dict, type(None)}:
        keys = dict.fromkeys(key for item in value for key in item or ())
        if len(keys) > MAX_KEYS:
            table.ignored[name or "data"] = (
                f"has records with {len(keys)} names, and a column for each"
            )
            return
        value = {key: [(item or {}).get(key) for item in value] for key in keys}
    if isinstance(value, dict):
        for key, item in value.items():
            _walk(f"{name}.{key}" if name else str(key), item, table)
    else:
        _add(name or "data", value, table)


def _add(name: str, value: Any, table: RecordTable) -> None:
    """Add numbers, as a column or a matrix of rows; `null` is a missing sample."""
    try:
        values = np.array(value, dtype=np.float64)
    except (ValueError, TypeError, OverflowError):
        text = isinstance(value, str) or {*map(type, value)} == {str}
        mixed = (
            "holds rows of unequal length, or no numbers; save a list of numbers for each column"
        )
        table.ignored[name] = "is text, not numbers" if text else mixed
    else:
        add_fields(table, name, values)
