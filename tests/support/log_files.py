"""Write logs in formats whose files have signals with times of their own."""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from pathlib import Path

import numpy as np

PACKAGES = {"mcap": "mcap", "mdf": "asammdf"}  # formats whose packages are extras
STEP = 0.02  # s


def wpilog_record(entry: int, time: int, payload: bytes) -> bytes:
    """Return a record of WPILOG with the shortest widths that its numbers have."""
    numbers = [
        number.to_bytes(max(1, -(-number.bit_length() // 8)), "little")
        for number in (entry, len(payload), time)
    ]
    widths = [len(number) - 1 for number in numbers]
    head = widths[0] | widths[1] << 2 | widths[2] << 4
    return bytes([head]) + b"".join(numbers) + payload


def wpilog_start(entry: int, name: str, kind: str) -> bytes:
    """Return the control record that names an entry."""
    texts = b"".join(struct.pack("<I", len(text)) + text.encode() for text in (name, kind, ""))
    return wpilog_record(0, 1000, b"\0" + struct.pack("<I", entry) + texts)


def as_wpilog(path: Path, columns: Mapping[str, np.ndarray]) -> None:
    """Write columns `(n,)` as entries of doubles, a sample every `STEP`."""
    extra = b"made by a test"
    raw = b"WPILOG" + struct.pack("<HI", 0x0100, len(extra)) + extra
    for entry, name in enumerate(columns, start=1):
        raw += wpilog_start(entry, name, "double")
    for k in range(len(next(iter(columns.values())))):
        for entry, values in enumerate(columns.values(), start=1):
            time = 5_000_000 + round(1e6 * STEP * k)
            raw += wpilog_record(entry, time, struct.pack("<d", values[k]))
    path.write_bytes(raw)


def as_mcap(path: Path, columns: Mapping[str, np.ndarray]) -> None:
    """Write each column as a topic of messages in JSON, whose number has no name below the topic's."""
    from mcap.writer import Writer

    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema(name="number", encoding="jsonschema", data=b"{}")
        for name, values in columns.items():
            topic = writer.register_channel(topic=name, message_encoding="json", schema_id=schema)
            for k, value in enumerate(values.tolist()):
                time = 1_700_000_000_000_000_000 + round(1e9 * STEP * k)
                data = json.dumps(value).encode()
                writer.add_message(channel_id=topic, log_time=time, publish_time=time, data=data)
        writer.finish()


def as_mdf(path: Path, columns: Mapping[str, np.ndarray]) -> None:
    """Write all columns as channels of one group."""
    from asammdf import MDF, Signal

    times = STEP * np.arange(len(next(iter(columns.values()))))
    with MDF(version="4.10") as file:
        file.append([Signal(x, times, name=n, unit="rad/s") for n, x in columns.items()])
        file.save(path.with_suffix(".mf4"), overwrite=True)
    path.with_suffix(".mf4").rename(path)
