"""Read WPILOG, in which robots of the FRC log entries, each at its own times.

The format is described in allwpilib, `wpiutil/doc/datalog.adoc`: a header, then records. A record has
the number of its entry, the size of its payload, its time in microseconds, and the payload. Records
of entry 0 name the others.
"""

from __future__ import annotations

import itertools
import struct
from collections.abc import Collection, Iterator
from pathlib import Path

import numpy as np

from bayesdrill.basics.errors import InputError
from bayesdrill.record.formats.samples import Samples, add_sample, merged_table
from bayesdrill.record.formats.table import RecordTable, read_bytes

_DTYPES = {"double": "<f8", "float": "<f4", "int64": "<i8", "boolean": "?"}
_START, _HEADER = 0, 12  # kind of a control record, and bytes before the text of the header


def _records(raw: bytes) -> Iterator[tuple[int, int, bytes]]:
    """Yield entry, time [us] and payload of each record; one that is cut short is the end."""
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


def read(path: Path, wanted: Collection[str] | None = None) -> RecordTable:
    """Read the `wanted` entries of numbers at the union of their times [s]; None stands for all."""
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
    return merged_table(path, signals, ignored, wanted)
