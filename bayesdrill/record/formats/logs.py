"""Read logs in which each signal has times of its own: WPILOG, MCAP and MDF4.

WPILOG is the log format of FRC robots (allwpilib, `wpiutil/doc/datalog.adoc`): a header, then
records. A record has the number of its entry, the size of its payload, its time in microseconds,
and the payload. Records of entry 0 give the names of other entries. MCAP is read with the package
`mcap`, and MDF4, the format of vehicles and test benches, with `asammdf`.
"""

from __future__ import annotations

import itertools
import json
import struct
from collections.abc import Collection, Iterator, Mapping, Sequence
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.basics.errors import InputError, report_damage
from bayesdrill.output_files import LARGEST_FILE
from bayesdrill.record.formats.arrays import CUT_SHORT
from bayesdrill.record.formats.table import RecordTable, missing_package, read_bytes

ONE_PASS = 0.05  # in steps of the fastest signal: samples closer than this have a common time
TIME = "log_time"  # name of the column with the union of all times
CONVERSION = 'convert it by the two lines "MCAP with ROS 2 messages" of docs/record.md'
_MCAP_MAGIC = b"\x89MCAP0\r\n"
_DTYPES = {"double": "<f8", "float": "<f4", "int64": "<i8", "boolean": "?"}
_START, _HEADER = 0, 12  # kind of a control record, and bytes before the text of the header

type Samples = dict[str, list[tuple[float, float]]]
"""Times [s] and values of each signal, by name."""


def add_sample(samples: Samples, name: str, time: float, value: float | Sequence[float]) -> None:
    """Add a sample at a time [s]; the values of a list are signals `name.0`, `name.1`, ..."""
    if isinstance(value, Sequence):
        for k, item in enumerate(value):
            add_sample(samples, f"{name}.{k}", time, item)
    else:
        samples.setdefault(name, []).append((time, value))


def _union(times: Sequence[Array]) -> Array:
    """Return all times [s]; of the times in one pass of the logger's loop, the first is kept."""
    union = np.unique(np.concatenate([np.zeros(0), *times]))
    steps = [float(np.median(np.diff(t))) for t in times if len(t) > 1]
    nearest = ONE_PASS * min((step for step in steps if step > 0), default=0.0)
    kept = list[float]()
    for time in union.tolist():
        if not kept or time > kept[-1] + nearest:
            kept.append(time)
    return np.array(kept, dtype=np.float64)


def merged_table(
    path: Path,
    samples: Samples,
    ignored: dict[str, str],
    selected: Collection[str] | None,
    units: Mapping[str, str] | None = None,
) -> RecordTable:
    """Return the `selected` signals at the union of all times [s]; NaN without a sample."""
    used = {name: part for name, part in samples.items() if selected is None or name in selected}
    signals = {
        name: np.array(sorted(part, key=itemgetter(0)), dtype=np.float64).reshape(-1, 2)
        for name, part in used.items()
    }
    if not samples:
        refusal = next((f", and {name} {why}" for name, why in ignored.items()), "")
        way_out = refusal or "; record again, or name another file"
        raise InputError.at(str(path), f"holds no numbers that can be read{way_out}")
    union = _union([signal[:, 0] for signal in signals.values()])
    if 8.0 * len(union) * (len(signals) + 1) > LARGEST_FILE:
        size = f"has {len(signals)} signals at {len(union)} times, too many for one table"
        raise InputError.at(str(path), f"{size}; save only the rig's signals")
    variables = {TIME: union}
    for name, signal in signals.items():
        column = np.full(len(union), np.nan)
        column[np.searchsorted(union, signal[:, 0], "right") - 1] = signal[:, 1]
        variables[name] = column
    unread = [name for name in samples if name not in variables]
    return RecordTable(
        path=path,
        variables=variables,
        ignored=ignored,
        unread=unread,
        units={**(units or {}), TIME: "s"},
    )


def _records(raw: bytes) -> Iterator[tuple[int, int, bytes]]:
    """Yield entry, time [us] and payload of each record, up to a record that is cut short."""
    at = _HEADER + struct.unpack_from("<I", raw, 8)[0]
    while at < len(raw):
        lengths = [(raw[at] & 3) + 1, (raw[at] >> 2 & 3) + 1, (raw[at] >> 4 & 7) + 1]
        ends = [at + 1 + sum(lengths[:k]) for k in range(4)]
        spans = itertools.pairwise(ends)
        entry, size, time = (int.from_bytes(raw[a:b], "little") for a, b in spans)
        at = ends[-1] + size
        if at <= len(raw):
            yield entry, time, raw[ends[-1] : at]


def _text(payload: bytes, at: int) -> tuple[str, int]:
    (size,) = struct.unpack_from("<I", payload, at)
    return payload[at + 4 : at + 4 + size].decode("utf-8", "replace"), at + 4 + size


def read_wpilog(path: Path, selected: Collection[str] | None = None) -> RecordTable:
    """Read the `selected` numeric entries at the union of their times [s]; None stands for all."""
    raw = read_bytes(path)
    if not raw.startswith(b"WPILOG") or len(raw) < _HEADER:
        raise InputError.at(str(path), "is not a WPILOG file; rename it to match its format")
    signals: Samples = {}
    names, ignored = dict[int, tuple[str, str]](), dict[str, str]()
    for entry, time, payload in _records(raw):
        if entry == 0 and payload[:1] == bytes([_START]) and len(payload) > 4:
            (number,) = struct.unpack_from("<I", payload, 1)
            name, at = _text(payload, 5)
            names[number] = name, _text(payload, at)[0]
        elif entry in names:
            name, kind = names[entry]
            dtype = _DTYPES.get(kind.removesuffix("[]"))
            if dtype is None or len(payload) % np.dtype(dtype).itemsize:
                ignored[name] = f"is of type {kind}, not numbers"
                continue
            values = np.frombuffer(payload, dtype).tolist()
            values = values if kind.endswith("[]") else values[0]
            add_sample(signals, name, 1e-6 * time, values)
    return merged_table(path, signals, ignored, selected)


def read_mcap(path: Path, selected: Collection[str] | None = None) -> RecordTable:
    """Read the `selected` numbers (`topic.key`), or all if None, at the union of their times [s]."""
    if read_bytes(path, len(_MCAP_MAGIC)) != _MCAP_MAGIC:
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
                if isinstance(value, int | float):
                    add_sample(signals, name, 1e-9 * (message.log_time - first), value)
                elif value is not None:
                    ignored[name] = "is text, not a number"
    return merged_table(path, signals, ignored, selected)


def _leaves(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Yield the values of a message with dotted names, such as `topic.joints.0.speed`."""
    if isinstance(value, dict | list):
        for key, item in value.items() if isinstance(value, dict) else enumerate(value):
            yield from _leaves(f"{name}.{key}", item)
    else:
        yield name, value


def read_mdf(path: Path, selected: Collection[str] | None = None) -> RecordTable:
    """Read the `selected` numeric channels at the union of their times [s]; None stands for all."""
    if not read_bytes(path, 3).startswith(b"MDF"):
        raise InputError.at(str(path), "is not an MDF file; rename it to match its format")
    try:
        from asammdf import MDF
    except ImportError:
        raise missing_package(path, "an MDF file", "mdf") from None
    signals: Samples = {}
    ignored, units = dict[str, str](), dict[str, str]()
    with report_damage(str(path), f"the MDF file {CUT_SHORT}"), MDF(str(path)) as file:
        masters = {(group, index) for group, index in file.masters_db.items()}
        for name, places in file.channels_db.items():
            for group, index in places[:1]:
                if (group, index) in masters:
                    continue
                signal = file.get(group=group, index=index)
                if signal.samples.ndim != 1 or signal.samples.dtype.kind not in "fiub":
                    ignored[name] = "is not a channel of numbers"
                    continue
                values = signal.samples.astype(np.float64).tolist()
                signals[name] = [*zip(signal.timestamps.tolist(), values, strict=True)]
                units[name] = str(signal.unit or "")
    return merged_table(path, signals, ignored, selected, units)
