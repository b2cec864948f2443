"""What a config may say of a sensor or of a start: a number, or a prior that may reach below zero."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag

from bayesdrill.basics.entries import Number, Positive, Strict
from bayesdrill.setup.number_entries import Quantity, shape


class _Signed(Strict):
    start: Number | None = Field(
        None, description="Where the search for the MAP begins; default: the median."
    )
    unit: str | None = Field(
        None, description="Of the numbers; default: the column's, s of times, SI of states."
    )


class SignedUniform(_Signed):
    prior: Literal["uniform"]
    low: Number
    high: Number


class SignedNormal(_Signed):
    """Not cut anywhere."""

    prior: Literal["normal"]
    mean: Number
    sd: Positive


class SignedTruncatedNormal(_Signed):
    prior: Literal["truncated_normal"]
    mean: Number
    sd: Positive
    low: Number
    high: Number


class PositiveLogNormal(_Signed):
    prior: Literal["log_normal"]
    median: Positive
    sd_log: Annotated[float, Field(ge=1e-6, le=20)]


SignedPrior = SignedUniform | SignedNormal | SignedTruncatedNormal | PositiveLogNormal


def _shape(value: Any) -> str:
    held = "value" in value if isinstance(value, dict) else isinstance(value, Quantity)
    return "<held>" if held else shape(value)


_Prior = Annotated[SignedPrior, Field(discriminator="prior")]

SensorSpec = Annotated[
    Annotated[Number, Tag("<number>")]
    | Annotated[Quantity, Tag("<held>")]
    | Annotated[_Prior, Tag("<mapping>")],
    Discriminator(_shape),
]
StateSpec = Annotated[
    Annotated[Number, Tag("<number>")]
    | Annotated[Literal["free"], Tag("<word>")]
    | Annotated[Quantity, Tag("<held>")]
    | Annotated[_Prior, Tag("<mapping>")],
    Discriminator(_shape),
]


class Sensed(Strict):
    """Of a column that a sensor made."""

    gain: SensorSpec | None = Field(
        None, description="What the sensor multiplies with: a number or a prior."
    )
    offset: SensorSpec | None = Field(
        None, description="What the sensor adds, in the column's unit: a number or a prior."
    )
    lag: SensorSpec | None = Field(
        None, description="[s] by how much the sensor is late: a number or a prior."
    )
