"""Logs whose signals have times of their own: WPILOG, MCAP, MDF4; and data sets of LeRobot."""

import json
import struct
import sys
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import ClassVar

import numpy as np
import pyarrow
import pytest
from pyarrow import parquet
from support.case_tables import run_cases
from support.command_line import assert_refused, cli
from support.log_files import wpilog_record, wpilog_start

from bayesdrill.basics.errors import InputError
from bayesdrill.record.formats import FORMATS
from bayesdrill.record.formats.logs import TIME

HEAD = b"WPILOG" + struct.pack("<HI", 0x0100, 0)


def read(path: Path, kind: str, wanted: set[str] | None = None):
    return FORMATS[kind].read(path, FORMATS[kind].options(), wanted)


def double(entry: int, time: int, value: float) -> bytes:
    return wpilog_record(entry, time, struct.pack("<d", value))


def test_entries_of_a_robot_log_keep_their_own_times(tmp_path: Path) -> None:
    path = tmp_path / "robot.wpilog"
    flags = wpilog_record(3, 2_000_000, struct.pack("<2f", 0.5, -2.0))
    path.write_bytes(
        HEAD + wpilog_start(1, "/drive/voltage", "double") + wpilog_start(2, "/state", "string")
        + wpilog_start(3, "both", "float[]") + double(1, 1_000_000, 6.0)
        + wpilog_record(2, 1_500_000, b"slow-forward") + flags + double(1, 3_000_000, 7.5)
        + double(7, 3_500_000, 1.0) + double(1, 4_000_000, 8.0)[:-3]
    )  # fmt: skip
    table = read(path, "wpilog")
    np.testing.assert_allclose(table.pick(TIME), [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(table.pick("/drive/voltage"), [6.0, np.nan, 7.5])
    np.testing.assert_array_equal(table.pick("both.1"), [np.nan, -2.0, np.nan])
    assert table.units[TIME] == "s"
    with pytest.raises(
        InputError, match=r"'/state' of robot.wpilog is of type string, not numbers"
    ):
        table.pick("/state")
    few = read(path, "wpilog", {"/drive/voltage"})
    np.testing.assert_array_equal(few.pick("/drive/voltage"), [6.0, 7.5])
    assert few.unread == ["both.0", "both.1"]


@run_cases(
    "content", [HEAD, HEAD + wpilog_start(1, "a", "string"), HEAD[:9], b"WPILOX" + b"0" * 90]
)
def test_a_robot_log_without_numbers_is_refused(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "robot.wpilog"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"robot.wpilog.*(holds no numbers|is not a WPILOG)"):
        read(path, "wpilog")


@run_cases(
    "name, package, head, extra",
    [
        ("r.mcap", "mcap.reader", b"\x89MCAP0\r\n", "bayesdrill[mcap]"),
        ("r.mf4", "asammdf", b"MDF     4.10", "bayesdrill[mdf]"),
        ("r.parquet", "pyarrow.parquet", b"PAR1", "bayesdrill[parquet]"),
    ],
)
def test_a_missing_package_is_named_with_its_extra(
    name: str, package: str, head: bytes, extra: str, tmp_path: Path, monkeypatch
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    (tmp_path / name).write_bytes(head + b"\0" * 80)
    monkeypatch.chdir(tmp_path)
    assert_refused(cli("init", name), name, "needs a package that is missing", extra)


def stub_of_mcap(messages: Sequence[tuple[str, str, float, object]]) -> SimpleNamespace:
    """Return a module with the documented reader of MCAP: topic, encoding, time [s] and data."""
    triples = [
        (
            None,
            SimpleNamespace(topic=topic, message_encoding=encoding),
            SimpleNamespace(log_time=round(1e9 * time), data=json.dumps(data).encode()),
        )
        for topic, encoding, time, data in messages
    ]
    return SimpleNamespace(
        make_reader=lambda stream: SimpleNamespace(iter_messages=lambda: iter(triples))
    )


def test_messages_of_mcap_that_are_no_json_are_named(tmp_path: Path, monkeypatch) -> None:
    """Also where no other messages are in the file; times are those since the first message."""
    path = tmp_path / "robot.mcap"
    path.write_bytes(b"\x89MCAP0\r\n")
    joints = {"position": [0.5, 1.5], "name": ["a", "b"], "motor": [{"current": 2}]}
    ros = [("/ros", "cdr", 5.0, 0)]
    both = [*ros, ("/joints", "json", 5.2, joints), ("/joints", "json", 5.4, {})]
    both += [("/motor", "json", 5.2001, 7.0), ("/motor", "json", 5.3, 8.0)]
    why = r"encoded as cdr, not as JSON; .*two lines .* of docs/record\.md"
    monkeypatch.setitem(sys.modules, "mcap", ModuleType("mcap"))
    monkeypatch.setitem(sys.modules, "mcap.reader", stub_of_mcap(ros))
    with pytest.raises(InputError, match=f"no numbers that can be read, and /ros has .*{why}"):
        read(path, "mcap")
    monkeypatch.setitem(sys.modules, "mcap.reader", stub_of_mcap(both))
    table = read(path, "mcap")
    np.testing.assert_allclose(table.pick(TIME), [0.2, 0.3])  # times of one pass are joined
    np.testing.assert_array_equal(table.pick("/joints.position.1"), [1.5, np.nan])
    np.testing.assert_array_equal(table.pick("/joints.motor.0.current"), [2.0, np.nan])
    np.testing.assert_array_equal(table.pick("/motor"), [7.0, 8.0])
    assert table.ignored["/joints.name.1"] == "is text, not a number"
    with pytest.raises(InputError, match=why):
        table.pick("/ros")
    monkeypatch.setattr("bayesdrill.record.formats.logs.LARGEST_FILE", 79.0)
    with pytest.raises(InputError, match="has 4 signals at 2 times, too many for one table"):
        read(path, "mcap")


class StubOfMDF:
    """It has what `asammdf.MDF` documents of a file with a master, a speed in rpm and a text."""

    masters_db: ClassVar[dict[int, int]] = {0: 0}
    channels_db: ClassVar = {"t": ((0, 0),), "speed": ((0, 1), (1, 4)), "state": ((0, 2),)}

    def __init__(self, name: str) -> None:
        assert Path(name).exists()

    def __enter__(self) -> "StubOfMDF":
        return self

    def __exit__(self, *_: object) -> None: ...

    def get(self, *, group: int, index: int) -> SimpleNamespace:
        assert group == 0
        samples = {1: np.array([3, 4], dtype=np.int16), 2: np.array([b"on", b"off"])}[index]
        return SimpleNamespace(samples=samples, timestamps=np.array([0.5, 0.6]), unit="rpm")


def test_channels_of_an_mdf_file_have_units_and_texts_are_named(
    tmp_path: Path, monkeypatch
) -> None:
    path = tmp_path / "bench.mf4"
    path.write_bytes(b"MDF     4.10")
    monkeypatch.setitem(sys.modules, "asammdf", SimpleNamespace(MDF=StubOfMDF))
    table = read(path, "mdf")
    np.testing.assert_array_equal(table.pick(TIME), [0.5, 0.6])
    np.testing.assert_array_equal(table.pick("speed"), [3.0, 4.0])
    assert table.units["speed"] == "rpm"
    assert "t" not in table.variables
    with pytest.raises(InputError, match=r"'state' of bench.mf4 is not a channel of numbers"):
        table.pick("state")


STATE = np.arange(12.0).reshape(6, 2)


def lerobot(folder: Path, names: object) -> Path:
    """Write a data set of six rows with two joints; return the path of its file."""
    path = folder / "data" / "chunk-000" / "file-000.parquet"
    path.parent.mkdir(parents=True)
    (folder / "meta").mkdir()
    features = {"observation.state": {"shape": [2], "names": names}}
    (folder / "meta" / "info.json").write_text(json.dumps({"fps": 30, "features": features}))
    state = pyarrow.array(STATE.tolist(), pyarrow.list_(pyarrow.float32(), 2))
    columns = {"timestamp": np.arange(6) / 30, "observation.state": state}
    parquet.write_table(pyarrow.table(columns), path)
    return path


@run_cases(
    "names, keys",
    [
        (["pan.pos", "lift.pos"], ["pan.pos", "lift.pos"]),
        ({"motors": ["pan", "lift"]}, ["pan", "lift"]),
        (None, ["0", "1"]),
        (["of another robot"], ["0", "1"]),
    ],
)
def test_lists_of_a_data_set_are_columns_with_their_names(
    names: object, keys: list[str], tmp_path: Path
) -> None:
    table = read(lerobot(tmp_path, names), "parquet")
    for key, values in zip(keys, STATE.T, strict=True):
        np.testing.assert_array_equal(table.pick(f"observation.state.{key}"), values)
    np.testing.assert_array_equal(table.pick(3), STATE[:, 1])
