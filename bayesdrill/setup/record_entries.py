"""What a config may say of columns as they come: their file, what is left out, what is undone."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Discriminator, Field, Tag

from bayesdrill.basics.entries import Count, Number, Positive, Strict, chosen
from bayesdrill.record.formats import FORMATS
from bayesdrill.setup.sensor_entries import Sensed

Array = NDArray[np.float64]

MOST_SPANS = 1000


def _word_or_mapping(value: Any) -> str:
    return "<word>" if isinstance(value, str) else "<mapping>"


def _flag_or_number(value: Any) -> str:
    return "<flag>" if isinstance(value, bool) else "<number>"


def _one_or_several(value: Any) -> str:
    several = isinstance(value, list) and any(isinstance(one, list) for one in value)
    return "<several>" if several else "<one>"


Window = Annotated[list[Number], Field(min_length=2, max_length=2)]
Rows = Annotated[list[Count], Field(min_length=2, max_length=2)]
Windows = Annotated[
    Annotated[Window, Tag("<one>")]
    | Annotated[list[Window], Field(min_length=1, max_length=MOST_SPANS), Tag("<several>")],
    Discriminator(_one_or_several),
]


class FileBase(Strict):
    """A file beside that of the record, and how it is written."""

    path: str = Field(description="Relative to the folder of the config.")
    format: str | None = Field(None, description="Default: by the file's ending.")


if TYPE_CHECKING:
    FileSpec = FileBase
else:
    _options = {name: one.options for name, one in FORMATS.usable().items()}
    FileSpec = chosen("FileSpec", FileBase, "format", _options)

FileEntry = Annotated[
    Annotated[str, Tag("<word>")] | Annotated[FileSpec, Tag("<mapping>")],
    Discriminator(_word_or_mapping),
]


class MaskSpec(Strict):
    """Samples of one column that are not used."""

    glitches: bool = Field(False, description="Spikes, as `check` lists them.")
    rows: Annotated[list[Rows], Field(max_length=MOST_SPANS)] = Field(
        default_factory=list, description="From and to: rows by the numbers that messages give."
    )
    times: Annotated[list[Window], Field(max_length=MOST_SPANS)] = Field(
        default_factory=list, description="From and to, both ends [s]."
    )


MaskEntry = Annotated[
    Annotated[Literal["glitches"], Tag("<word>")] | Annotated[MaskSpec, Tag("<mapping>")],
    Discriminator(_word_or_mapping),
]


def _time_shape(value: Any) -> str:
    """A time entry without `rate` is a column, however its keys are misspelt."""
    rate = "rate" in value if isinstance(value, dict) else isinstance(value, TimeRate)
    return "<mapping>" if rate else "<column>"


class Column(Strict):
    """Where numbers stand: a column or variable by name, or a column number from 1."""

    column: str | Count | None = None
    variable: str | None = Field(
        None, description="Of a file of arrays; dotted for fields, a path in HDF5."
    )
    unit: str


class TimeColumn(Column):
    offset: Number | None = Field(None, description="Is added to all times, in their unit.")


class TimeRate(Strict):
    rate: Positive = Field(description="Samples per second, for records without a time column.")
    offset: Number | None = Field(None, description="Time of the first sample [s].")


TimeSpec = Annotated[
    Annotated[TimeColumn, Tag("<column>")] | Annotated[TimeRate, Tag("<mapping>")],
    Discriminator(_time_shape),
]


class Series(Column, Sensed):
    """A column of the record's file, or of another one with times of its own."""

    file: FileEntry | None = Field(None, description="Default: that of the record.")
    time: TimeSpec | None = Field(None, description="Default: as for the record.")
    mask: MaskEntry | None = Field(None, description="Samples that are not used.")


WrapsEntry = Annotated[
    Annotated[bool, Tag("<flag>")] | Annotated[Positive, Tag("<number>")],
    Discriminator(_flag_or_number),
]


class InputColumn(Series):
    hold: Literal["zero", "first"] = Field(
        "zero", description="Between samples: constant (zero) or linear (first order)."
    )
    missing: Literal["hold"] | None = Field(
        None, description="`hold`: missing samples are bridged as `hold:` says; default: an error."
    )


class AngleColumn(InputColumn):
    """An angle that is imposed."""

    hold: Literal["first"] = Field("first", description="It is straight between samples.")
    wraps: WrapsEntry | None = Field(
        None, description="It begins again: `true` after a turn, or after so much [unit]."
    )


class DecimateSpec(Strict):
    """One sample of `factor`, after a filter that lets nothing alias, or as it is."""

    factor: Annotated[int, Field(ge=2, le=1000)]
    filter: bool = Field(
        True,
        description="`false`: samples as they are, for what a filter would smear, as kinks of friction; "
        "what is faster than half the new rate stays in as noise.",
    )


def between(t: Array, spans: list[tuple[float, float]]) -> NDArray[np.bool_]:
    """Which times `(T,)` lie in one of them, both ends among them."""
    slack = 1e-9 * max((abs(x) for span in spans for x in span), default=0.0)
    inside = np.zeros(len(t), dtype=bool)
    for begin, end in spans:
        inside |= (t >= begin - slack) & (t <= end + slack)
    return inside


def windows(given: list[float] | list[list[float]] | None) -> list[tuple[float, float]]:
    """From and to of each [s]; none where the whole record is used."""
    if not given:
        return []
    pairs: Any = given if isinstance(given[0], list) else [given]
    return [(float(one[0]), float(one[1])) for one in pairs]


def mask(given: MaskSpec | str | None) -> MaskSpec:
    if isinstance(given, str):
        return MaskSpec(glitches=True)
    return given or MaskSpec()
