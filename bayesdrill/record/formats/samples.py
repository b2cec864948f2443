"""Bring signals of a log, each with times of its own, into one table."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.basics.errors import InputError
from bayesdrill.output_files import LARGEST_FILE
from bayesdrill.record.formats.table import RecordTable

ONE_PASS = 0.05  # steps of the fastest signal, within which samples are of one pass of a loop
TIME = "log_time"  # name of the column with the union of all times


class Samples:
    """The samples are those of signals that have times of their own, by name."""

    def __init__(self) -> None:
        self._parts: dict[str, list[tuple[Any, Any]]] = {}

    def add(self, name: str, time: float, value: float | Sequence[float]) -> None:
        """Add a sample at a time [s]; the values of a list are signals `name.0`, `name.1`, ..."""
        if isinstance(value, Sequence):
            for k, item in enumerate(value):
                self._parts.setdefault(f"{name}.{k}", []).append((time, item))
        else:
            self._parts.setdefault(name, []).append((time, value))

    def extend(self, name: str, times: Array, values: Array) -> None:
        """Add all samples of a signal, `(n,)`."""
        self._parts[name] = [*zip(times.tolist(), values.tolist(), strict=True)]

    def arrays(self, wanted: Collection[str] | None) -> dict[str, tuple[Array, Array]]:
        """Return times and values `(n,)` of the `wanted` signals, in the order of time."""
        pairs = {
            name: np.array(part, dtype=np.float64).reshape(-1, 2).T
            for name, part in self._parts.items()
            if wanted is None or name in wanted
        }
        ordered = {name: np.argsort(t, kind="stable") for name, (t, _) in pairs.items()}
        return {name: (t[ordered[name]], x[ordered[name]]) for name, (t, x) in pairs.items()}

    @property
    def names(self) -> list[str]:
        """Return the names of all signals."""
        return [*self._parts]


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
    signals = samples.arrays(wanted)
    if not samples.names:
        refusal = next((f", and {name} {why}" for name, why in ignored.items()), "")
        way_out = refusal or "; record again, or name another file"
        raise InputError.at(str(path), f"holds no numbers that can be read{way_out}")
    union = _union([t for t, _ in signals.values()])
    if 8.0 * len(union) * (len(signals) + 1) > LARGEST_FILE:
        size = f"has {len(signals)} signals at {len(union)} times, too many for one table"
        raise InputError.at(str(path), f"{size}; save those of the rig alone")
    variables = {TIME: union}
    for name, (t, x) in signals.items():
        column = np.full(len(union), np.nan)
        column[np.searchsorted(union, t, "right") - 1] = x
        variables[name] = column
    unread = [name for name in samples.names if name not in variables]
    return RecordTable(
        path=path,
        variables=variables,
        ignored=ignored,
        unread=unread,
        units={**(units or {}), TIME: "s"},
    )
