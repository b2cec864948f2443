"""Read MCAP with the package `mcap`: topics with JSON messages, each at the time when it was logged."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

from bayesdrill.basics.errors import InputError, report_damage
from bayesdrill.record.formats.arrays import CUT_SHORT
from bayesdrill.record.formats.samples import Samples, add_sample, merged_table
from bayesdrill.record.formats.table import RecordTable, missing_package, read_bytes

CONVERSION = 'convert it by the two lines "MCAP with ROS 2 messages" of docs/record.md'
_MAGIC = b"\x89MCAP0\r\n"


def read(path: Path, wanted: Collection[str] | None = None) -> RecordTable:
    """Read the `wanted` numbers (`topic.key`), or all if None, at the union of their times [s]."""
    if read_bytes(path, len(_MAGIC)) != _MAGIC:
        raise InputError.at(str(path), "is not an MCAP file; rename it to match its format")
    try:
        from mcap.reader import make_reader
    except ImportError:
        raise missing_package(path, "an MCAP file", "mcap") from None
    signals: Samples = {}
    ignored, first = dict[str, str](), None
    with report_damage(str(path), f"the MCAP file {CUT_SHORT}"), path.open("rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages():
            first = message.log_time if first is None else first
            if channel.message_encoding != "json":
                encoding = f"has messages encoded as {channel.message_encoding}, not as JSON"
                ignored[channel.topic] = f"{encoding}; {CONVERSION}"
                continue
            for name, value in _leaves(channel.topic, json.loads(message.data)):
                add_sample(signals, name, 1e-9 * (message.log_time - first), value)
    return merged_table(path, signals, ignored, wanted)


def _leaves(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Yield the numbers, and lists of numbers, of a message by their dotted names."""
    if isinstance(value, dict):
        for key, item in value.items():
            yield from _leaves(f"{name}.{key}", item)
    elif isinstance(value, int | float) or (
        isinstance(value, list) and value and all(isinstance(x, int | float) for x in value)
    ):
        yield name, value
