"""JSON: columns in all shapes that loggers write, and what is said where there are none."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from support.case_tables import for_each

from bayesdrill.basics.errors import InputError
from bayesdrill.record.formats.json import MAX_KEYS, read

T, W = np.array([0.0, 0.5, 1.25, 2.0]), np.array([1.0, -2.5, 1e-7, 3e11])
RECORDS = [{"t": t, "w": w} for t, w in zip(T.tolist(), W.tolist(), strict=True)]
ROWS = np.column_stack([T, W]).tolist()


def file(folder: Path, content: object) -> Path:
    path = folder / "r.json"
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


def test_columns_in_every_shape(tmp_path: Path) -> None:
    """Mutants killed: records lose the keys that the first does not have; a matrix is turned."""
    columns = {"t": T.tolist(), "w": W.tolist()}
    numbered = {name: dict(zip("0123", x, strict=True)) for name, x in columns.items()}

    def check(content: object, prefix: str) -> None:
        table = read(file(tmp_path, content))
        np.testing.assert_array_equal(table.pick(f"{prefix}t"), T)
        np.testing.assert_array_equal(table.pick(f"{prefix}w"), W)

    cases: dict[str, tuple[object, str]] = {
        "columns": (columns, ""),
        "records": (RECORDS, ""),
        "records below others": (
            {"head": {"mass": 1}, "log": {"entries": RECORDS}},
            "log.entries.",
        ),
        "rows below names": ([["t", "w"], *ROWS], ""),
        "a record on each line": ("\n".join(map(json.dumps, RECORDS)), ""),
        "rows by their numbers": (numbered, ""),
        "records by their numbers": (dict(zip("0123", RECORDS, strict=True)), ""),
        "numbers in quotes": ([{k: str(x) for k, x in one.items()} for one in RECORDS], ""),
    }
    for_each(cases, check)
    for content, name in (
        (ROWS, "data"),
        ({"run": ROWS}, "run"),
        ({"run": np.transpose(ROWS).tolist()}, "run"),
    ):
        table = read(file(tmp_path, content))
        np.testing.assert_array_equal(table.pick(2, name), W)


def test_what_is_missing_and_what_is_no_number(tmp_path: Path) -> None:
    records = [{"t": 0, "on": True, "name": "a"}, None, {"t": 2, "w": {"x": 7}, "name": "b"}]
    table = read(file(tmp_path, records))
    np.testing.assert_array_equal(table.pick("t"), [0, np.nan, 2])
    np.testing.assert_array_equal(table.pick("w.x"), [np.nan, np.nan, 7])
    np.testing.assert_array_equal(table.pick("on"), [1, np.nan, np.nan])
    with pytest.raises(InputError, match=r"'name' of r\.json is no list of numbers"):
        table.pick("name")
    for content in ([[1, 2], [3]], [{"t": 1}, [2]], [[["a"]]], {"data": "text"}, [10**400]):
        with pytest.raises(InputError, match="no list of numbers"):
            read(file(tmp_path, content)).pick("data")


def test_a_test_of_an_frc_log_has_the_names_of_its_columns(tmp_path: Path) -> None:
    rows = np.arange(27.0).reshape(3, 9)
    table = read(file(tmp_path, {"fast-forward": rows.tolist(), "other": rows.tolist()}))
    np.testing.assert_array_equal(table.pick("fast-forward.left voltage [V]"), rows[:, 3])
    np.testing.assert_array_equal(table.pick("fast-forward.right speed"), rows[:, 8])
    assert table.variables["other"].shape == (3, 9) or table.variables["other"].shape == (9, 3)


def test_what_is_cut_or_no_json_has_its_line(tmp_path: Path) -> None:
    def check(content: str, said: str) -> None:
        with pytest.raises(InputError, match=said) as caught:
            read(file(tmp_path, content))
        assert "r.json" in str(caught.value)

    lines = "\n".join(map(json.dumps, RECORDS))
    many = json.dumps([{str(k): 1} for k in range(MAX_KEYS + 1)])
    cases = {
        "cut": (json.dumps(RECORDS)[:-9], "cannot be read as JSON .*line 1"),
        "a line cut": (lines[:-5], "cannot be read as JSON .*line 4"),
        "a web page": ("<html>", "cannot be read as JSON"),
        "too deep": ("[" * 100_000, "cannot be read as JSON"),
        "long numbers": ("9" * 5000, "cannot be read as JSON"),
        "many names": (many, "records with 1001 names"),
        "bytes": ("\x00\x01\x02", "is a binary file"),
    }
    for_each(cases, check)


def test_what_holds_nothing_can_name_nothing(tmp_path: Path) -> None:
    for content in ("[]", "{}", '{"a": {}}', "  "):
        with pytest.raises(InputError, match=r"no numeric array|is empty"):
            read(file(tmp_path, content)).pick("data")
