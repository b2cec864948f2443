"""Bring signals of a log, each with times of its own, into one table."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from operator import itemgetter
from pathlib import Path

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.basics.errors import InputError
from bayesdrill.output_files import LARGEST_FILE
from bayesdrill.record.formats.table import RecordTable

ONE_PASS = 0.05  # steps of the fastest signal, within which samples are of one pass of a loop
TIME = "log_time"  # name of the column with the union of all times


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
    """Return all times [s], where those of one pass of the logger's loop are one, the first of them."""
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
    wanted: Collection[str] | None,
    units: Mapping[str, str] | None = None,
) -> RecordTable:
    """Return the `wanted` signals at the union of their times [s], and NaN at the times of others."""
    used = {name: part for name, part in samples.items() if wanted is None or name in wanted}
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
        raise InputError.at(str(path), f"{size}; save those of the rig alone")
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
