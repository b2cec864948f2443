"""Read MDF4, the format of measurements in vehicles and on test benches, with `asammdf`."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

import numpy as np

from bayesdrill.basics.errors import InputError, report_damage
from bayesdrill.record.formats.arrays import CUT_SHORT
from bayesdrill.record.formats.samples import Samples, merged_table
from bayesdrill.record.formats.table import RecordTable, missing_package, read_bytes


def read(path: Path, wanted: Collection[str] | None = None) -> RecordTable:
    """Read the `wanted` channels of numbers at the union of their times [s]; None stands for all."""
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
    return merged_table(path, signals, ignored, wanted, units)
