"""Logs whose signals have times of their own: WPILOG, MCAP, MDF4; and data sets of LeRobot."""

import json
import struct
import sys
from pathlib import Path

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


def test_messages_of_mcap_that_are_no_json_are_named(tmp_path: Path) -> None:
    """Also where no other messages are in the file."""
    writer_of = pytest.importorskip("mcap.writer")
    json_text = json.dumps({"position": [0.5, 1.5], "name": ["a", "b"]}).encode()
    messages = [("/ros", "cdr", b"\0\1"), ("/joints", "json", json_text)]
    for count, name in enumerate(("ros.mcap", "both.mcap"), 1):
        with (tmp_path / name).open("wb") as stream:
            writer = writer_of.Writer(stream)
            writer.start()
            for topic, encoding, data in messages[:count]:
                channel = writer.register_channel(
                    topic=topic, message_encoding=encoding, schema_id=0
                )
                writer.add_message(channel_id=channel, log_time=5, publish_time=5, data=data)
            writer.finish()
    why = r"encoded as cdr, not as JSON; .*two lines .* of docs/record\.md"
    with pytest.raises(InputError, match=f"no numbers that can be read, and /ros has .*{why}"):
        read(tmp_path / "ros.mcap", "mcap")
    table = read(tmp_path / "both.mcap", "mcap")
    np.testing.assert_array_equal(table.pick("/joints.position.1"), [1.5])
    with pytest.raises(InputError, match=why):
        table.pick("/ros")


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
