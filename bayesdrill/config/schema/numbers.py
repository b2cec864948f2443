"""What a config may say of one number: a value, a prior, a tie; of sensors and starts, a prior
below zero too.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Discriminator, Field, Tag

from bayesdrill.basics.entries import SMALLEST, Latex, NonNegative, Number, Positive, Strict
from bayesdrill.basics.symbols import Symbol


def shape(value: Any) -> str:
    """Which member of a union an entry is meant to be, before and after it is validated."""
    if isinstance(value, dict | BaseModel):
        return "<mapping>"
    return "<word>" if isinstance(value, str) else "<number>"


def _parameter_shape(value: Any) -> str:
    tied = "tie" in value if isinstance(value, dict) else isinstance(value, Tie)
    return "<tie>" if tied else shape(value)


def _quantity_shape(value: Any) -> str:
    held = "value" in value if isinstance(value, dict) else isinstance(value, Quantity)
    return "<held>" if held else shape(value)


class PriorBase(Strict):
    relative: bool = Field(
        False, description="Bounds and scales are multiples of the nominal value."
    )
    start: Positive | None = Field(
        None,
        description="Where the search for the MAP begins, in the unit of the column (sigma), in its "
        "`unit` (quantity) or in SI (parameter, also of a relative prior); default: the nominal value, "
        "else the median.",
    )


class UniformPrior(PriorBase):
    prior: Literal["uniform"]
    low: NonNegative
    high: Positive


class LogUniformPrior(PriorBase):
    prior: Literal["log_uniform"]
    low: Positive
    high: Positive


class NormalPrior(PriorBase):
    """Cut at zero and renormalised, as all unknowns are positive."""

    prior: Literal["normal"]
    mean: Number
    sd: Positive


class TruncatedNormalPrior(PriorBase):
    prior: Literal["truncated_normal"]
    mean: Number
    sd: Positive
    low: NonNegative
    high: Positive


class LogNormalPrior(PriorBase):
    prior: Literal["log_normal"]
    median: Positive
    sd_log: Annotated[float, Field(ge=SMALLEST, le=20)] = Field(
        description="Standard deviation of the natural logarithm."
    )


class HalfNormalPrior(PriorBase):
    prior: Literal["half_normal"]
    scale: Positive


PriorSpec = Annotated[
    UniformPrior
    | LogUniformPrior
    | NormalPrior
    | TruncatedNormalPrior
    | LogNormalPrior
    | HalfNormalPrior,
    Field(discriminator="prior"),
]


class Tie(Strict):
    tie: str = Field(description="The parameter, or quantity, that this one is equal to.")


def parameter_spec(number: Any) -> Any:
    """Of a parameter that may be held at any such `number`."""
    return Annotated[
        Annotated[number, Tag("<number>")]
        | Annotated[str, Tag("<word>")]
        | Annotated[Tie, Tag("<tie>")]
        | Annotated[PriorSpec, Tag("<mapping>")],
        Discriminator(_parameter_shape),
    ]


_HELD: Mapping[str, Any] = MappingProxyType(
    {"positive": Positive, "not negative": NonNegative, "any": Number}
)


def held(symbol: Symbol) -> Any:
    """What a parameter may be held at."""
    return ending(symbol, _HELD[symbol.held])


def ending(symbol: Symbol, number: Any) -> Any:
    """Such a `number` of a parameter, which may end somewhere."""
    if math.isinf(symbol.at_most):
        return number
    return Annotated[number, Field(le=symbol.at_most)]


SigmaSpec = Annotated[
    Annotated[Positive, Tag("<number>")] | Annotated[PriorSpec, Tag("<mapping>")],
    Discriminator(shape),
]


class Quantity(Strict):
    value: Number
    unit: str


class _OfQuantity(Strict):
    unit: str = Field(
        description="Of the prior's numbers, such as Pa or mm; 1 where there is none."
    )
    latex: Latex | None = Field(None, description="How figures write it, without dollars.")


class UniformOfQuantity(UniformPrior, _OfQuantity):
    pass


class LogUniformOfQuantity(LogUniformPrior, _OfQuantity):
    pass


class NormalOfQuantity(NormalPrior, _OfQuantity):
    pass


class TruncatedNormalOfQuantity(TruncatedNormalPrior, _OfQuantity):
    pass


class LogNormalOfQuantity(LogNormalPrior, _OfQuantity):
    pass


class HalfNormalOfQuantity(HalfNormalPrior, _OfQuantity):
    pass


QuantitySpec = Annotated[
    Annotated[Positive, Tag("<number>")]
    | Annotated[Quantity, Tag("<held>")]
    | Annotated[
        UniformOfQuantity
        | LogUniformOfQuantity
        | NormalOfQuantity
        | TruncatedNormalOfQuantity
        | LogNormalOfQuantity
        | HalfNormalOfQuantity,
        Field(discriminator="prior"),
        Tag("<mapping>"),
    ],
    Discriminator(_quantity_shape),
]


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
