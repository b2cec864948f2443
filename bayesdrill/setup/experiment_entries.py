"""What a config may say of one experiment: its record, its inputs, how it begins."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BeforeValidator, Discriminator, Field, Tag, create_model

from bayesdrill.basics import symbols
from bayesdrill.basics.entries import Number, Strict, chosen
from bayesdrill.inference.noise import NOISES
from bayesdrill.record.formats import FORMATS
from bayesdrill.rig import vocabulary
from bayesdrill.setup.number_entries import Quantity, SigmaSpec, shape
from bayesdrill.setup.output_entries import MOST_NAMED
from bayesdrill.setup.record_entries import (
    AngleColumn,
    Column,
    DecimateSpec,
    InputColumn,
    Series,
    TimeSpec,
    Windows,
    WrapsEntry,
)
from bayesdrill.setup.sensor_entries import SensorSpec, StateSpec


def _shape(value: Any) -> str:
    """Which member of a union an entry is meant to be, before and after it is validated."""
    if isinstance(value, dict):
        return "<column>" if "column" in value or "variable" in value else "<mapping>"
    return "<column>" if isinstance(value, Column) else shape(value)


class InputQuantity(Quantity):
    """A constant input, and how far it may be from what it is said to be."""

    gain: SensorSpec | None = None
    offset: SensorSpec | None = Field(None, description="In its unit: a number or a prior.")


InputSpec = Annotated[
    Annotated[Number, Tag("<number>")]
    | Annotated[InputQuantity, Tag("<mapping>")]
    | Annotated[InputColumn, Tag("<column>")],
    Discriminator(_shape),
]


def _said(name: str) -> str:
    """Of an input."""
    one = symbols.INPUTS[name]
    return f"{one.meaning} [{one.plain_unit}]"


class NoiseBase(Strict):
    """How what the rig does not explain is distributed."""

    name: str = Field("white", description="The kind.")


if TYPE_CHECKING:
    NoiseSpec = NoiseBase
else:
    _kinds = {name: kind.Entries for name, kind in NOISES.usable().items()}
    NoiseSpec = chosen("NoiseSpec", NoiseBase, "name", _kinds)


def _named_noise(value: Any) -> Any:
    return {"name": value} if isinstance(value, str) else value


class ChannelSpec(Series):
    measures: str | None = Field(
        None,
        description="Linear combination of theta_1, theta_2, w_1, w_2, i; default: the channel's name.",
    )
    sigma: SigmaSpec = Field(
        description="Noise standard deviation in the column's unit, or its prior when unknown."
    )
    noise: Annotated[NoiseSpec, BeforeValidator(_named_noise)] = NoiseSpec()
    wraps: WrapsEntry | None = Field(
        None,
        description="An angle that begins again: `true` after a turn, or after so much [unit].",
    )
    derived_from: str | None = Field(
        None, description="The channel of which this one is the derivative: it is no evidence."
    )


class RecordBase(Strict):
    """Where the numbers are, and what they are."""

    file: str = Field(description="Relative to the folder of the config.")
    format: str | None = Field(None, description="Default: by the file's ending.")
    time: TimeSpec
    window: Windows | None = Field(
        None, description="Use the samples from the first to the second time [s] only; or several."
    )
    held_out: Windows | None = Field(
        None,
        description="Samples from the first to the second time [s], or several such stretches, that are "
        "no evidence: `compare` says how well each model predicts them.",
    )
    missing: Literal["drop"] | None = Field(
        None, description="`drop`: of a channel, missing samples are left out; default: an error."
    )
    decimate: DecimateSpec | None = None
    channels: Annotated[dict[str, ChannelSpec], Field(min_length=1, max_length=MOST_NAMED)]


if TYPE_CHECKING:
    RecordSpec = RecordBase
else:
    _options = {name: one.options for name, one in FORMATS.usable().items()}
    RecordSpec = chosen("RecordSpec", RecordBase, "format", _options)


class Inputs(Strict):
    """Those of the rig: which it has, and wants, is for its model to say."""

    v: InputSpec | None = Field(None, description=_said("v"))
    t_1: InputSpec = Field(0.0, description=_said("t_1"))
    w_2: InputSpec | None = Field(None, description=_said("w_2"))
    theta_2: AngleColumn | None = Field(
        None,
        description="[rad] In the place of w_2: the angle that is imposed, as it was measured.",
    )
    t_m: InputSpec | None = Field(None, description=_said("t_m"))
    wob: InputSpec | None = Field(None, description=_said("wob"))
    t_0: SensorSpec | None = Field(
        None,
        description="[s] how much later than recorded all inputs act; of constant ones, the moment at "
        "which they are switched on.",
    )


class _InitialBase(Strict):
    time: Number | None = Field(
        None,
        description="[s] default: 0 with constant inputs, the first sample with measured ones.",
    )
    state: Literal["given", "steady", "free"] = Field(
        "given",
        description="given: what is not named is zero; steady: turning steadily under the first inputs; "
        "free: what is not named is unknown, with priors as wide as the channels.",
    )


_states: dict[str, Any] = {
    name: (StateSpec, 0.0) for name in vocabulary.STATES if name not in vocabulary.INNER
}
Initial: type[_InitialBase] = create_model(
    "Initial",
    __base__=_InitialBase,
    __doc__="The state at `time`: of each state a number, a prior or `free`.",
    **_states,
)


def named_state(value: Any) -> Any:
    return {"state": value} if isinstance(value, str) else value


class ExperimentSpec(Strict):
    """What is its own of one experiment of several; the rest is as at the top of the config."""

    record: dict[str, Any] = Field(default_factory=dict, description="Entries as in `record:`.")
    inputs: dict[str, Any] = Field(default_factory=dict, description="Entries as in `inputs:`.")
    initial: dict[str, Any] | str = Field(
        default_factory=dict, description="Entries as in `initial:`."
    )
    held_out: bool = Field(
        False,
        description="No sample of it is evidence: `compare` says how well each model predicts it.",
    )
