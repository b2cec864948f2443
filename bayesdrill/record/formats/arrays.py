"""What a walk through a file of named arrays gathers, whatever wrote it."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from bayesdrill.basics.sizes import LARGEST_FILE
from bayesdrill.record.formats.table import Array, Table

_NUMERIC = "fiub"
"""numpy dtype kinds of real numbers and logicals."""

MOST_TOLD = 120  # letters of a reader's own words: some quote half of the file
ITSELF = "save the numbers themselves in this file"


@dataclass(frozen=True, slots=True, kw_only=True)
class Found:
    """What a walk through a file has gathered so far; of `unread` only the names are looked at."""

    variables: dict[str, Array] = field(default_factory=dict)
    ignored: dict[str, str] = field(default_factory=dict)
    unread: list[str] = field(default_factory=list)
    structs: set[int] = field(default_factory=set)  # where they stand in the file

    def add(self, name: str, values: np.ndarray[Any, Any]) -> None:
        """Keep a real array up to 2-D, `(T, 1)` and `(1, T)` as `(T,)`; note others as ignored."""
        if values.dtype.kind == "c":
            self.ignored[name] = "is complex; save its real part"
        elif values.dtype.kind not in _NUMERIC:
            self.ignored[name] = "is not a numeric array; save it as a plain array of double"
        elif values.size == 0:
            self.ignored[name] = "is empty"
        elif values.ndim > 2:
            size = " x ".join(str(n) for n in values.shape)
            self.ignored[name] = f"has {values.ndim} dimensions ({size}); save a matrix or a vector"
        else:
            flat = values.ravel() if 1 in values.shape or values.ndim == 0 else values
            self.variables[name] = np.ascontiguousarray(flat, dtype=np.float64)

    def add_fields(self, name: str, values: np.ndarray[Any, Any]) -> None:
        """The same of an array of records, field by field, and with the longer side as time.

        A record has more samples than channels, and writers differ in what they call a row.
        """
        if values.dtype.names:
            for one in values.dtype.names:
                self.add_fields(f"{name}.{one}", values[one])
        elif values.ndim == 2 and values.shape[0] < values.shape[1]:
            self.add(name, values.T)
        else:
            self.add(name, values)

    def table(self, path: Path) -> Table:
        return Table(
            path=path,
            variables=self.variables,
            ignored=self.ignored,
            unread=tuple(self.unread),
        )


class Damaged(Exception):
    """A reader could not make sense of the bytes."""

    def __init__(self, cause: Exception) -> None:
        lines = str(cause).strip().splitlines()
        told = lines[0] if lines else type(cause).__name__
        super().__init__(told if len(told) <= MOST_TOLD else f"{told[: MOST_TOLD - 3]}...")


def too_large(shape: tuple[int, ...], itemsize: int) -> str:
    """Why an array is not read, foreseen before it takes up memory; empty where it may be."""
    size = itemsize * float(np.prod(np.array(shape, dtype=np.float64)))
    if size <= LARGEST_FILE:
        return ""
    most = f"at most {LARGEST_FILE / 1e6:.0f} MB are read"
    return f"takes {size / 1e6:.0f} MB; {most}: save fewer columns, or resample to a lower rate"
