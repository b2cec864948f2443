"""What a config may say of a number: a value, a tie, a prior (of sensors below zero too)."""

from __future__ import annotations

import inspect
import math
import typing
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Union

from pydantic import BaseModel, BeforeValidator, Discriminator, Field, Tag, create_model

from bayesdrill.basics.entries import Latex, NonNegative, Number, Positive, Strict
from bayesdrill.basics.symbols import Symbol
from bayesdrill.inference.priors import PRIORS, SIGNED_PRIORS, Prior


def entry_shape(value: Any) -> str:
    """Return which member of a union an entry is meant to be, validated or not."""
    if isinstance(value, dict | BaseModel):
        return "<mapping>"
    return "<word>" if isinstance(value, str) else "<number>"


def shorthand(entry: str) -> BeforeValidator:
    """Return a validator that takes a text for a mapping with this `entry` alone."""
    return BeforeValidator(lambda value: {entry: value} if isinstance(value, str) else value)


def _parameter_shape(value: Any) -> str:
    tied = "tie" in value if isinstance(value, dict) else isinstance(value, Tie)
    return "<tie>" if tied else entry_shape(value)


def _fixed_shape(value: Any) -> str:
    fixed = "value" in value if isinstance(value, dict) else isinstance(value, Quantity)
    return "<held>" if fixed else entry_shape(value)


class PriorSpec(Strict):
    """A prior as a config has it: the numbers of its family, and what may stand beside them."""

    families: ClassVar[Mapping[str, Callable[..., Prior]]] = PRIORS

    if TYPE_CHECKING:  # each kind says what it may be, in its own order
        prior: str
        start: float | None

    @property
    def numbers(self) -> dict[str, float]:
        """Return the numbers of its family."""
        return {name: getattr(self, name) for name in _entries(self.families[self.prior])}


class ParameterPrior(PriorSpec):
    """The prior of a parameter, which may be relative to the nominal value."""

    relative: bool = False
    """Bounds and scales are multiples of the nominal value."""
    start: Positive | None = Field(
        None,
        description="Where the search for the MAP begins, in the unit of the column (sigma), in its "
        "`unit` (quantity) or in SI (parameter, also of a relative prior); default: the nominal value, "
        "else the median.",
    )


class QuantityPrior(ParameterPrior):
    """The prior of a quantity, in a unit of its own."""

    unit: str
    """Of the prior's numbers, such as Pa or mm; 1 where there is none."""
    latex: Latex | None = Field(None, description="How figures write it, without dollars.")


class SensorPrior(PriorSpec):
    """The prior of a sensor or a start, which may be negative."""

    families = SIGNED_PRIORS

    start: Number | None = None
    """Where the search for the MAP begins; default: the median."""
    unit: str | None = None
    """Of the numbers; default: the column's, s of times, SI of states."""


def _entries(family: Callable[..., Prior]) -> dict[str, Any]:
    """Numbers of a family that a config gives, as pydantic takes them."""
    signature = family if inspect.isroutine(family) else family.__init__
    hints = typing.get_type_hints(signature, include_extras=True)
    return {name: hint for name, hint in hints.items() if name != "return"}


_SIGNED: Mapping[str, Any] = {
    "low": Number,
    "high": Number,
    "sd_log": Annotated[float, Field(ge=1e-6, le=20)],
}


def _spec(base: type[PriorSpec], name: str) -> type[PriorSpec]:
    """Of a family of priors, with what such a `base` adds; each number has to be given."""
    family, other = base.families[name], _SIGNED if base is SensorPrior else {}
    fields: dict[str, Any] = {"prior": (Literal[name], ...)}
    fields |= {entry: (other.get(entry, hint), ...) for entry, hint in _entries(family).items()}
    title = f"{name.title().replace('_', '')}{base.__name__}"
    return create_model(title, __base__=base, __doc__=family.__doc__, __module__=__name__, **fields)


_SPECS: Mapping[str, type[PriorSpec]] = {
    model.__name__: model
    for base in (ParameterPrior, QuantityPrior, SensorPrior)
    for model in (_spec(base, name) for name in base.families)
}


def __getattr__(name: str) -> type[PriorSpec]:
    """By which records of them are pickled."""
    if name not in _SPECS:
        raise AttributeError(name)
    return _SPECS[name]


def _any_of(base: type[PriorSpec]) -> Any:
    """Of the families that such a prior may be of, the one that `prior:` names."""
    models = tuple(model for model in _SPECS.values() if model.__base__ is base)
    return Annotated[Union[models], Field(discriminator="prior")]  # noqa: UP007


if TYPE_CHECKING:
    _OfParameter = ParameterPrior
    _OfQuantity = QuantityPrior
    _OfSensor = SensorPrior
else:
    _OfParameter = _any_of(ParameterPrior)
    _OfQuantity = _any_of(QuantityPrior)
    _OfSensor = _any_of(SensorPrior)


class Tie(Strict):
    """A parameter that is equal to another one."""

    tie: str = Field(description="The parameter, or quantity, that this one is equal to.")


def parameter_spec(number: Any) -> Any:
    """Of a parameter that may be held at any such `number`."""
    return Annotated[
        Annotated[number, Tag("<number>")]
        | Annotated[str, Tag("<word>")]
        | Annotated[Tie, Tag("<tie>")]
        | Annotated[_OfParameter, Tag("<mapping>")],
        Discriminator(_parameter_shape),
    ]


ParameterSpec = float | str | Tie | ParameterPrior | None
_FIXED: Mapping[str, Any] = {"positive": Positive, "not negative": NonNegative, "any": Number}


def fixed_spec(symbol: Symbol) -> Any:
    """Return what a parameter may be fixed at."""
    return bounded_spec(symbol, _FIXED[symbol.held])


def bounded_spec(symbol: Symbol, number: Any) -> Any:
    """Return such a `number` of a parameter, with the end that the parameter has."""
    if math.isinf(symbol.at_most):
        return number
    return Annotated[number, Field(le=symbol.at_most)]


SigmaSpec = Annotated[
    Annotated[Positive, Tag("<number>")] | Annotated[_OfParameter, Tag("<mapping>")],
    Discriminator(entry_shape),
]


class Quantity(Strict):
    """A value with a unit."""

    value: Number
    unit: str


class NominalValue(Strict):
    """A line of a data sheet."""

    value: Positive
    unit: str | None = Field(None, description="Default: SI.")
    side: Literal["motor", "load"] | None = None
    """Of the gear, for which the sheet gives it; default: the symbol's own."""


def nominal_spec(symbol: Symbol) -> Any:
    """Return what a nominal value may be given as."""
    return Annotated[
        Annotated[bounded_spec(symbol, Positive), Tag("<number>")]
        | Annotated[NominalValue, Tag("<mapping>")],
        Discriminator(entry_shape),
    ]


QuantitySpec = Annotated[
    Annotated[Positive, Tag("<number>")]
    | Annotated[Quantity, Tag("<held>")]
    | Annotated[_OfQuantity, Tag("<mapping>")],
    Discriminator(_fixed_shape),
]


SensorSpec = Annotated[
    Annotated[Number, Tag("<number>")]
    | Annotated[Quantity, Tag("<held>")]
    | Annotated[_OfSensor, Tag("<mapping>")],
    Discriminator(_fixed_shape),
]
StateSpec = Annotated[
    Annotated[Number, Tag("<number>")]
    | Annotated[Literal["free"], Tag("<word>")]
    | Annotated[Quantity, Tag("<held>")]
    | Annotated[_OfSensor, Tag("<mapping>")],
    Discriminator(_fixed_shape),
]


class SensorFields(Strict):
    """Entries of a column that a sensor measured."""

    gain: SensorSpec | None = None
    """What the sensor multiplies with: a number or a prior."""
    offset: SensorSpec | None = None
    """What the sensor adds, in the column's unit: a number or a prior."""
    lag: SensorSpec | None = None
    """[s] by how much the sensor is late: a number or a prior."""
