"""Define the entries of one experiment: files, columns, inputs, start and output."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Discriminator, Field, Tag

from bayesdrill.basics.arrays import Array
from bayesdrill.basics.entries import (
    MAX_COUNT,
    Count,
    Number,
    Positive,
    Strict,
    with_member_entries,
)
from bayesdrill.config.schema.numbers import (
    NamedSection,
    Quantity,
    SensorFields,
    SensorSpec,
    SigmaSpec,
    StateSpec,
    entry_shape,
    shorthand,
)
from bayesdrill.config.schema.vocabulary import Vocabulary
from bayesdrill.inference.noise import NOISES
from bayesdrill.output_files import DEFAULT_FORMATS
from bayesdrill.record.formats import FORMATS

MAX_SPANS = 1000  # largest number of windows or masked spans in a list


def _word_or_mapping(value: Any) -> str:
    return "<word>" if isinstance(value, str) else "<mapping>"


def _flag_or_number(value: Any) -> str:
    return "<flag>" if isinstance(value, bool) else "<number>"


def _one_or_several(value: Any) -> str:
    several = isinstance(value, list) and any(isinstance(item, list) for item in value)
    return "<several>" if several else "<one>"


Window = Annotated[list[Number], Field(min_length=2, max_length=2)]
Rows = Annotated[list[Count], Field(min_length=2, max_length=2)]
Windows = Annotated[
    Annotated[Window, Tag("<one>")]
    | Annotated[list[Window], Field(min_length=1, max_length=MAX_SPANS), Tag("<several>")],
    Discriminator(_one_or_several),
]


_OPTIONS = {name: file_format.options for name, file_format in FORMATS.usable().items()}
_NOISES = {name: kind.Entries for name, kind in NOISES.usable().items()}


@with_member_entries("format", _OPTIONS)
class FileSpec(Strict):
    """A file entry names the file of a column that is not in the record's file."""

    path: str = Field(description="Relative to the folder of the config.")
    format: str | None = Field(None, description="Default: the format of the file name's ending.")


@with_member_entries("name", _NOISES)
class NoiseSpec(Strict):
    """The noise section sets the distribution of the measurement noise."""

    name: str = Field("white", description="Kind of noise.")


FileEntry = Annotated[
    Annotated[str, Tag("<word>")] | Annotated[FileSpec, Tag("<mapping>")],
    Discriminator(_word_or_mapping),
]


class MaskSpec(Strict):
    """A mask lists the samples of one column that are not used."""

    glitches: bool = Field(False, description="Leave out spikes, as reported by `check`.")
    rows: Annotated[list[Rows], Field(max_length=MAX_SPANS)] = Field(default_factory=list)
    """First and last row of each span, both included: lines of a text file, or rows from 1 of others."""
    times: Annotated[list[Window], Field(max_length=MAX_SPANS)] = Field(default_factory=list)
    """First and last time of each masked span [s], both included."""


MaskEntry = Annotated[
    Annotated[Literal["glitches"], Tag("<word>")] | Annotated[MaskSpec, Tag("<mapping>")],
    Discriminator(_word_or_mapping),
]


def _time_shape(value: Any) -> str:
    """Return the tag of a time entry; an entry without `rate` is a column."""
    rate = "rate" in value if isinstance(value, dict) else isinstance(value, TimeRate)
    return "<mapping>" if rate else "<column>"


class ColumnSpec(Strict):
    """A column is given by its name, by its number (from 1), or as a variable of an array file."""

    column: str | Count | None = None
    variable: str | None = None
    """Variable in a file of arrays: `rig.speed` is a field of a struct, `run7/speed` a path in HDF5."""
    unit: str


class TimeColumn(ColumnSpec):
    """The time section may name a column that contains the times."""

    scale: Positive | None = Field(
        None, description="Factor of all times, below 1 if the clock ran fast; default: 1."
    )
    offset: Number | None = Field(None, description="Added to all times, in the column's unit.")


class TimeRate(Strict):
    """The time section may give a constant sampling rate instead of a column."""

    rate: Positive = Field(description="Samples per second, for records without a time column.")
    offset: Number | None = Field(None, description="Time of the first sample [s]; default: 0.")


TimeSpec = Annotated[
    Annotated[TimeColumn, Tag("<column>")] | Annotated[TimeRate, Tag("<mapping>")],
    Discriminator(_time_shape),
]


class Series(ColumnSpec, SensorFields):
    """A series is a column of the record's file, or of another file that may have its own times."""

    file: FileEntry | None = Field(None, description="Default: the file of the record.")
    time: TimeSpec | None = Field(None, description="Default: the `time:` entry of the record.")
    mask: MaskEntry | None = Field(None, description="Samples that are not used.")


WrapsEntry = Annotated[
    Annotated[bool, Tag("<flag>")] | Annotated[Positive, Tag("<number>")],
    Discriminator(_flag_or_number),
]


class InputColumn(Series):
    """An input may be a measured column."""

    hold: Literal["zero", "first"] = "zero"
    """Order of the hold between samples: `zero` (constant) or `first` (linear)."""
    missing: Literal["hold"] | None = None
    """`hold`: gaps are filled by the rule of `hold:`; default: a missing sample is an error."""


class AngleColumn(InputColumn):
    """An imposed angle is an input: the rig is driven by this measured angle."""

    hold: Literal["first"] = Field("first", description="The input is linear between samples.")
    wraps: WrapsEntry | None = None
    """Period after which the angle wraps: `true` for one turn, or a number in the column's unit."""


class DecimateSpec(Strict):
    """Decimation keeps one of every `factor` samples, by default after an anti-aliasing filter."""

    factor: Annotated[int, Field(ge=2, le=1000)]
    filter: bool = Field(
        True,
        description="`false` keeps samples as measured, so that kinks from friction stay sharp; "
        "motion above half the new sampling rate is then aliased and acts as noise.",
    )


def inside_spans(t: Array, spans: list[tuple[float, float]]) -> NDArray[np.bool_]:
    """Return a mask of the times `(T,)` that lie in one of the spans, both ends included."""
    slack = 1e-9 * max((abs(x) for span in spans for x in span), default=0.0)
    is_inside = np.zeros(len(t), dtype=bool)
    for begin, end in spans:
        is_inside |= (t >= begin - slack) & (t <= end + slack)
    return is_inside


def window_spans(given: list[float] | list[list[float]] | None) -> list[tuple[float, float]]:
    """Return the begin and end of each window [s]; an empty list stands for the whole record."""
    if not given:
        return []
    pairs: Any = given if isinstance(given[0], list) else [given]
    return [(float(pair[0]), float(pair[1])) for pair in pairs]


def as_mask_spec(given: MaskSpec | str | None) -> MaskSpec:
    """Return the mask of a column; without an entry, the mask is empty."""
    if isinstance(given, str):
        return MaskSpec(glitches=True)
    return given or MaskSpec()


MAX_NAMED = 50  # largest number of named entries in a section, and of names in a list
Format = Literal["pdf", "png", "svg"]


class OutputSpec(Strict):
    """The output section sets which figures are drawn and how many draws are predicted."""

    predictive_draws: Annotated[int, Field(ge=10, le=MAX_COUNT)] = 125
    """Number of draws per ensemble for predictive samples and pointwise log likelihoods."""
    figures: Annotated[list[str], Field(max_length=MAX_NAMED)] | None = None
    """Names of figures; default: all except those that are drawn only on request."""
    parameters: Annotated[list[str], Field(min_length=1, max_length=MAX_NAMED)] | None = None
    """Unknowns in the figures corner, trace and prior_posterior; default: all."""
    corner: Annotated[list[str], Field(min_length=1, max_length=MAX_NAMED)] | None = None
    """Unknowns and derived quantities of the corner plot; default: `parameters`."""
    size: Literal["single", "double"] = "double"
    """Width of figures: `single` is one text column (3.4 in), `double` is two (7 in)."""
    formats: Annotated[list[Format], Field(min_length=1, max_length=3)] | None = None
    """Figure formats; default: png; also pdf for corner plots, `map`, `identify`, `calibrate`."""
    dpi: Annotated[int, Field(ge=50, le=1200)] = 220
    """Resolution [pixels/inch] of png files, and of point clouds in pdf and svg files."""

    @property
    def formats_or_default(self) -> tuple[str, ...]:
        """Return the formats of figures outside posterior reports, by default PDF and PNG."""
        return tuple(self.formats or DEFAULT_FORMATS)


def _shape(value: Any) -> str:
    """Return the tag for the form of an entry, raw or validated: also a column; see `entry_shape`."""
    if isinstance(value, dict):
        return "<column>" if "column" in value or "variable" in value else "<mapping>"
    return "<column>" if isinstance(value, ColumnSpec) else entry_shape(value)


class InputQuantity(Quantity):
    """A constant input has a value, and may have a gain and an offset."""

    gain: SensorSpec | None = None
    offset: SensorSpec | None = Field(
        None, description="Constant that is added to the input, in its unit: a number or a prior."
    )


InputSpec = Annotated[
    Annotated[Number, Tag("<number>")]
    | Annotated[InputQuantity, Tag("<mapping>")]
    | Annotated[InputColumn, Tag("<column>")],
    Discriminator(_shape),
]


class ChannelSpec(Series):
    """A channel is a measured column."""

    measures: str | None = None
    """Linear combination of states, such as theta_1 - theta_2; default: the channel's name."""
    sigma: SigmaSpec
    """Noise standard deviation in the column's unit, or its prior when unknown."""
    noise: Annotated[NoiseSpec, shorthand("name")] = NoiseSpec()
    wraps: WrapsEntry | None = None
    """Period after which an angle wraps: `true` for one turn, or a number in the column's unit."""
    derived_from: str | None = None
    """The channel whose derivative this channel is; a derived channel is not fitted."""


@with_member_entries("format", _OPTIONS)
class RecordSpec(Strict):
    """The record section names a file, its times and its channels."""

    file: str = Field(description="Relative to the folder of the config.")
    format: str | None = Field(None, description="Default: by the file's ending.")
    rows: Rows | None = None
    """First and last used row: lines of a text file, or rows from 1 of other files; default: all."""
    time: TimeSpec
    window: Windows | None = None
    """First and last time that are used [s], or a list of such windows; default: all times."""
    held_out: Windows | None = Field(
        None,
        description="First and last time [s] of samples that are not fitted, or several windows; "
        "`compare` scores how well each model predicts these samples.",
    )
    missing: Literal["drop"] | None = None
    """`drop`: missing samples of a channel are left out; default: a missing sample is an error."""
    decimate: DecimateSpec | None = None
    channels: Annotated[dict[str, ChannelSpec], Field(min_length=1, max_length=MAX_NAMED)]


DELAY = "t_0"  # name of the entry for the common delay of all inputs


class Inputs(NamedSection):
    """The inputs section has an entry for each input; the model defines which are required."""

    __pydantic_extra__: dict[str, Any]

    @classmethod
    def defaults(cls, words: Vocabulary) -> Mapping[str, float | None]:
        """Return the default of each input: zero for loads that may be omitted, else None."""
        return {
            name: 0.0 if name in words.optional_inputs else None for name in (*words.entries, DELAY)
        }


class Initial(NamedSection):
    """The initial section gives the state at `time`: for each state a number, a prior or `free`."""

    __pydantic_extra__: dict[str, StateSpec]

    @classmethod
    def defaults(cls, words: Vocabulary) -> Mapping[str, float | None]:
        """Return zero for every state."""
        return dict.fromkeys(words.starts, 0.0)

    time: Number | None = None
    """Time [s]; default: 0, or the first sample if inputs are measured or `window:` is given."""
    state: Literal["given", "steady", "free"] = Field(
        "given",
        description="States that are not named. `given`: zero; `steady`: the rig turns steadily "
        "under the first inputs; `free`: unknown, with wide priors from the record.",
    )


class ExperimentSpec(Strict):
    """An experiment has its own entries here; entries of all experiments are at the top level."""

    record: dict[str, Any] = Field(default_factory=dict, description="Entries as in `record:`.")
    inputs: dict[str, Any] = Field(default_factory=dict, description="Entries as in `inputs:`.")
    initial: dict[str, Any] | str = Field(default_factory=dict)
    """Entries as in `initial:`."""
    parameters: dict[str, Any] = Field(
        default_factory=dict, description="Parameters fixed here, by numbers or formulas."
    )
    held_out: bool = False
    """Leave this experiment out of the fit; `compare` scores how well each model predicts it."""
