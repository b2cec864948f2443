"""JSON: columns in all shapes that loggers write, and what is said where there are none."""

import json
from pathlib import Path

import numpy as np
import pytest
from support.case_tables import run_cases

from bayesdrill.basics.errors import InputError
from bayesdrill.record.formats.json import MAX_KEYS, read
from bayesdrill.record.formats.table import RecordTable

T, W = np.array([0.0, 0.5, 1.25, 2.0]), np.array([1.0, -2.5, 1e-7, 3e11])
RECORDS = [{"t": t, "w": w} for t, w in zip(T.tolist(), W.tolist(), strict=True)]
ROWS = np.column_stack([T, W]).tolist()


COLUMNS = {"t": T.tolist(), "w": W.tolist()}
LINES = "\n".join(map(json.dumps, RECORDS))


def load(folder: Path, content: object) -> RecordTable:
    path = folder / "r.json"
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return read(path)


@run_cases(
    "content, prefix",
    [
        (COLUMNS, ""),
        (RECORDS, ""),
        ({"head": {"mass": 1}, "log": {"entries": RECORDS}}, "log.entries."),
        ([["t", "w"], *ROWS], ""),
        (LINES, ""),
        ({name: dict(zip("0123", x, strict=True)) for name, x in COLUMNS.items()}, ""),
        (dict(zip("0123", RECORDS, strict=True)), ""),
        ([{key: str(x) for key, x in record.items()} for record in RECORDS], ""),
    ],
    ids=[
        *(
            "columns",
            "records",
            "records below others",
            "rows below names",
            "a record on each line",
        ),
        *("rows by their numbers", "records by their numbers", "numbers in quotes"),
    ],
)
def test_columns_in_every_shape(content: object, prefix: str, tmp_path: Path) -> None:
    table = load(tmp_path, content)
    np.testing.assert_array_equal(table.pick(f"{prefix}t"), T)
    np.testing.assert_array_equal(table.pick(f"{prefix}w"), W)


@run_cases(
    "content, name",
    [(ROWS, "data"), ({"run": ROWS}, "run"), ({"run": np.transpose(ROWS).tolist()}, "run")],
)
def test_rows_without_names_are_a_matrix(content: object, name: str, tmp_path: Path) -> None:
    np.testing.assert_array_equal(load(tmp_path, content).pick(2, name), W)


def test_what_is_missing_and_what_is_no_number(tmp_path: Path) -> None:
    records = [{"t": 0, "on": True, "name": "a"}, None, {"t": 2, "w": {"x": 7}, "name": "b"}]
    table = load(tmp_path, records)
    np.testing.assert_array_equal(table.pick("t"), [0, np.nan, 2])
    np.testing.assert_array_equal(table.pick("w.x"), [np.nan, np.nan, 7])
    np.testing.assert_array_equal(table.pick("on"), [1, np.nan, np.nan])
    with pytest.raises(InputError, match=r"'name' of r\.json is neither a list of numbers nor"):
        table.pick("name")
    for content in ([[1, 2], [3]], [{"t": 1}, [2]], [[["a"]]], {"data": "text"}, [10**400]):
        with pytest.raises(InputError, match="neither a list of numbers"):
            load(tmp_path, content).pick("data")


def test_a_test_of_an_frc_log_has_the_names_of_its_columns(tmp_path: Path) -> None:
    rows = np.arange(27.0).reshape(3, 9)
    table = load(tmp_path, {"fast-forward": rows.tolist(), "other": rows.tolist()})
    np.testing.assert_array_equal(table.pick("fast-forward.left voltage [V]"), rows[:, 3])
    np.testing.assert_array_equal(table.pick("fast-forward.right speed"), rows[:, 8])
    assert table.variables["other"].shape == (9, 3)
    table = load(tmp_path, {"sysid": True, "test": "Arm", "slow-forward": rows.tolist()})
    np.testing.assert_array_equal(table.pick("slow-forward.right voltage [V]"), rows[:, 2])
    table = load(tmp_path, {"sysid": True, "slow-backward": rows[:, :4].tolist()})
    np.testing.assert_array_equal(table.pick("slow-backward.speed"), rows[:, 3])


@run_cases(
    "content, message",
    [
        (json.dumps(RECORDS)[:-9], "cannot be read as JSON .*line 1"),
        (LINES[:-5], "cannot be read as JSON .*line 4"),
        ("<html>", "cannot be read as JSON"),
        ("[" * 100_000, "cannot be read as JSON"),
        ("9" * 5000, "cannot be read as JSON"),
        (json.dumps([{str(k): 1} for k in range(MAX_KEYS + 1)]), "records with 1001 names"),
        ("\x00\x01\x02", "is a binary file"),
    ],
)
def test_what_is_no_json_is_refused_with_its_line(
    content: str, message: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=message) as caught:
        load(tmp_path, content)
    assert "r.json" in str(caught.value)


def test_what_holds_nothing_can_name_nothing(tmp_path: Path) -> None:
    for content in ("[]", "{}", '{"a": {}}', "  "):
        with pytest.raises(InputError, match=r"no numeric array|is empty"):
            load(tmp_path, content).pick("data")
