"""Define the table that every reader returns: named columns of numbers, to be picked."""

from __future__ import annotations

import codecs
import dataclasses
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from bayesdrill.basics.arrays import Array, Counts
from bayesdrill.basics.errors import InputError, count_noun, did_you_mean


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RecordTable:
    """A record table holds the numbers of one file.

    Columns of a table (text, Parquet) are variables `(T,)` in file order. A file of arrays (MATLAB,
    HDF5, NumPy) has variables `(T,)` or `(T, n)`, with dotted names for fields (`rig.theta`).
    Numbers may be NaN or infinite; `where` returns the row of a sample. `ignored` gives the reason
    why a name in the file cannot be picked, and `unread` lists names that were not requested.
    """

    path: Path
    variables: dict[str, Array] = field(default_factory=dict)
    lines: Counts | None = None
    """Row numbers `(T,)` of a table, or None for a file of arrays; `called` is the noun for a row."""
    called: str = "line"
    columns: tuple[str, ...] = ()
    """All columns in order, if some are not numbers; empty if all are `variables`."""
    ignored: dict[str, str] = field(default_factory=dict)
    unread: list[str] = field(default_factory=list)
    labels: dict[str, str] = field(default_factory=dict)
    """Title of a variable in the file, if it differs from the name."""
    units: dict[str, str] = field(default_factory=dict)
    """Text in the row between header and numbers, by column."""

    def where(self, index: int) -> str:
        """Return the position of the sample `index`, from 0: `line 18`, `row 18` or `sample 18`."""
        return f"sample {index + 1}" if self.lines is None else f"{self.called} {self.lines[index]}"

    @property
    def numbers(self) -> Counts:
        """Return the row numbers `(T,)` that messages give."""
        longest = max(map(len, self.variables.values()), default=0)
        return np.arange(1, longest + 1) if self.lines is None else self.lines

    def between(self, rows: Sequence[int] | None) -> RecordTable:
        """Return the table between two row `numbers`, both inclusive; None stands for all rows."""
        if rows is None:
            return self
        part = slice(*np.searchsorted(self.numbers, (rows[0], rows[1] + 1)).tolist())
        lines = None if self.lines is None else self.lines[part]
        values = {name: x[part] for name, x in self.variables.items()}
        if not any(map(len, values.values())):
            raise ValueError(f"has no rows from {rows[0]} to {rows[1]}; correct `rows:`")
        return dataclasses.replace(self, variables=values, lines=lines)

    def pick(
        self,
        column: str | int | None = None,
        variable: str | None = None,
        *,
        location: str | None = None,
    ) -> Array:
        """Return one column `(T,)`, by name or number (from 1); raises InputError at `location`."""
        try:
            if self.lines is not None:
                return self._pick_from_table(column, variable)
            return self._pick_from_arrays(column, variable)
        except LookupError as error:
            raise InputError.at(location or str(self.path), str(error.args[0])) from None

    def _pick_from_table(self, column: str | int | None, variable: str | None) -> Array:
        file = self.path.name
        if variable is not None:
            what = f"is a table of columns and has no variable {variable!r}"
            raise LookupError(f"{file} {what}; leave the variable out and give the column")
        if column is None:
            raise LookupError(f"no column of {file} is given; give a name, or a number from 1")
        if isinstance(column, str):
            return self._named(column, "column")
        columns = self.columns or tuple(self.variables)
        if not 1 <= column <= len(columns):
            known = f"it has the columns 1 to {len(columns)}: {', '.join(columns)}"
            raise LookupError(f"{file} has no column {column}; {known}")
        return self._named(columns[column - 1], "column")

    def _pick_from_arrays(self, column: str | int | None, variable: str | None) -> Array:
        variable = variable_name(column, variable) or self._only_variable()
        if isinstance(column, str):
            column = None
        values = self._named(variable, "variable")
        width = 1 if values.ndim == 1 else values.shape[1]
        size = f"{count_noun(len(values), 'row')} and {count_noun(width, 'column')}"
        size = f"{count_noun(len(values), 'sample')} in 1 column" if values.ndim == 1 else size
        shape = f"variable {variable!r} of {self.path.name} has {size}"
        if column is None and width > 1:
            raise LookupError(f"{shape}; say which column, from 1 to {width}")
        if column is not None and not 1 <= column <= width:
            raise LookupError(f"{shape}, so no column {column}; give one from 1 to {width}")
        return np.ascontiguousarray(values.reshape(len(values), -1)[:, (column or 1) - 1])

    def _only_variable(self) -> str:
        if len(self.variables) == 1:
            return next(iter(self.variables))
        which = f"say which one: {', '.join(self.variables)}"
        raise LookupError(f"{self.path.name} holds {len(self.variables)} variables; {which}")

    def _named(self, name: str, kind: str) -> Array:
        file, this = self.path.name, f"{kind} {name!r} of {self.path.name}"
        if name in self.variables and self.variables[name].size:
            return self.variables[name]
        if name in self.variables:
            raise LookupError(f"{this} is empty; record again")
        if name in self.ignored:
            raise LookupError(f"{this} {self.ignored[name]}")
        kinds = {".": "a struct; name one of its fields", "/": "a group; name one"}
        for mark, what in {**kinds, "(": "an array of structs; name a field of one"}.items():
            inside = [known for known in self._names if known.startswith(f"{name}{mark}")]
            if inside and kind == "variable":
                raise LookupError(f"{this} is {what}: {', '.join(inside)}")
        if kind == "column" and name.isdecimal() and 1 <= int(name) <= len(self.variables):
            way_out = f"for column number {name} write it without quotes"
            raise LookupError(f"{file} has no column named {name!r}; {way_out}")
        raise LookupError(f"{file} has no {kind} {name!r}{self._known(name)}")

    def _known(self, name: str) -> str:
        """Return the nearest name and all names, for an error message."""
        if not self._names:
            return "; the file holds no numeric array"
        hint, names = did_you_mean(name, self._names), ", ".join(self._names)
        return hint if hint == f"; known: {names}" else f"{hint} (the file has {names})"

    @property
    def _names(self) -> tuple[str, ...]:
        return (*self.variables, *self.unread)


def missing_package(path: Path, what: str, extra: str) -> InputError:
    """Return the error for a format whose package is not installed; `extra` installs it."""
    way = f"install it with pip install 'bayesdrill[{extra}]', or save the record as CSV"
    return InputError.at(str(path), f"{what} needs a package that is missing; {way}")


def keys_of(names: Sequence[str]) -> tuple[list[str], dict[str, str]]:
    """Return a unique name per column, and why repeated names cannot be picked."""
    ignored = {}
    for name, count in Counter(names).items():
        if count > 1 and name:
            at = ", ".join(str(i) for i, other in enumerate(names, start=1) if other == name)
            ignored[name] = f"stands {count} times in the header (columns {at}); give the number"
    keys = [
        f"(column {i})" if not name or name in ignored or name.startswith("(column ") else name
        for i, name in enumerate(names, start=1)
    ]
    return keys, ignored


def variable_name(column: str | int | None, variable: str | None) -> str | None:
    """Return the name of a variable in a file of arrays, given as `column` or `variable`."""
    if not isinstance(column, str):
        return variable
    return column if variable is None else f"{variable}.{column}"


def read_bytes(path: Path, count: int = -1) -> bytes:
    """Return the first `count` bytes of a file, all by default; raises InputError if there are none."""
    location = str(path)
    try:
        with path.open("rb") as file:
            content = file.read(count)
    except FileNotFoundError:
        raise InputError.at(location, f"there is no such file{_neighbour(path)}") from None
    except IsADirectoryError:
        raise InputError.at(location, "is a folder; name a file in it") from None
    except (OSError, ValueError) as error:  # a NUL in the name raises ValueError
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError.at(location, f"cannot be opened: {reason}") from None
    if not content:
        raise InputError.at(location, "the file is empty; write it again from the rig's software")
    return content


def _neighbour(path: Path) -> str:
    """Return a hint: a similar file name in the folder, or that the folder does not exist."""
    if not path.parent.is_dir():
        return f": the folder {path.parent} does not exist"
    others = (other.name for other in path.parent.iterdir() if other.suffix not in CONFIGS)
    hint = did_you_mean(path.name, others)
    return hint if hint.startswith("; did") else "; check the name and the folder"


CONFIGS = (".yaml", ".yml")  # endings of configs, which are not records
_MAGIC = {
    b"PK\x03\x04": "is a spreadsheet or zip archive; export it as CSV",
    b"MATLAB": "is a MATLAB file; give it the ending .mat, or write format: mat",
    b"\x89HDF": "is an HDF5 file; give it the ending .h5, or .mat if MATLAB wrote it",
    b"PAR1": "is a Parquet file; give it the ending .parquet, or write format: parquet",
    b"\xd0\xcf\x11\xe0": "is a spreadsheet (.xls); export it as CSV",
    b"\x93NUMPY": "is a NumPy array; save it with numpy.savez('run.npz', t=t, w_1=w_1)",
    b"version https://git-lfs": "is a pointer of Git LFS, not the file; run git lfs pull",
    b"\x1f\x8b": "is compressed (gzip); unpack it first: gunzip, or 7-Zip",
}
_LINES_OF_TEXT = 2  # a file that begins with two lines of text is not binary


def decode(path: Path) -> str:
    """Return the text of a file in UTF-8, UTF-16 or Latin-1; raises InputError for other files."""
    raw = read_bytes(path)
    for magic, message in _MAGIC.items():
        if raw.startswith(magic):
            raise InputError.at(str(path), message)
    try:
        if raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
            return raw.decode("utf-16")
        if len(raw) > 2 and not raw[1:400:2].strip(b"\0"):  # UTF-16 without a byte order mark
            return raw.decode("utf-16-le")
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = raw.decode("latin-1")
    odd = re.search(r"[\x00-\x08\x0e-\x19\x1b-\x1f]", text)
    line = text.count("\n", 0, odd.start()) + 1 if odd else 0
    if line > _LINES_OF_TEXT:
        message = "holds bytes that are not text, as after an interrupted write; remove them"
        raise InputError.at(f"{path} line {line}", message)
    if odd:
        raise InputError.at(str(path), "is a binary file, not text; export it as CSV in UTF-8")
    return text
