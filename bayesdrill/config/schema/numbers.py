"""Define how a config gives a number: as a value, a tie, a formula or a prior."""

from __future__ import annotations

import inspect
import typing
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, Literal, Union

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    GetCoreSchemaHandler,
    Tag,
    create_model,
)

from bayesdrill.basics.entries import Latex, Number, Positive, Strict
from bayesdrill.config.schema.vocabulary import HOUSE, Vocabulary
from bayesdrill.inference.priors import PRIORS, SIGNED_PRIORS, LogUniform, Prior


def entry_shape(value: Any) -> str:
    """Return the tag for the form of an entry, raw or validated: a mapping, a word or a number."""
    if isinstance(value, dict | BaseModel):
        return "<mapping>"
    return "<word>" if isinstance(value, str) else "<number>"


def shorthand(entry: str) -> BeforeValidator:
    """Return a validator that reads a text as a mapping from the key `entry` to this text."""
    return BeforeValidator(lambda value: {entry: value} if isinstance(value, str) else value)


def _parameter_shape(value: Any) -> str:
    tied = "tie" in value if isinstance(value, dict) else isinstance(value, Tie)
    return "<tie>" if tied else entry_shape(value)


def _fixed_shape(value: Any) -> str:
    fixed = "value" in value if isinstance(value, dict) else isinstance(value, Quantity)
    return "<held>" if fixed else entry_shape(value)


class NamedSection(Strict):
    """A named section has the entries of its class, and one entry for each symbol of the rig."""

    model_config = ConfigDict(extra="allow")

    def model_post_init(self, context: Vocabulary | None, /) -> None:
        """Add the defaults of the rig's symbols; `context` is the rig's vocabulary."""
        entries: Any = self.__pydantic_extra__
        given = {**entries}
        entries.clear()
        entries.update({**self.defaults(context or HOUSE), **given})

    @classmethod
    def defaults(cls, words: Vocabulary) -> Mapping[str, float | None]:
        """Return the default values of names, in the order in which results list the names."""
        return dict.fromkeys(words.parameters)

    def get(self, name: str) -> Any:
        """Return the entry for a symbol of the rig; None if there is no such entry."""
        return (self.__pydantic_extra__ or {}).get(name)


class PriorSpec(Strict):
    """A prior is given by its family and the numbers that this family needs."""

    families: ClassVar[Mapping[str, Callable[..., Prior]]] = PRIORS
    family: ClassVar[str]  # the entry `prior` selects the class of a family

    @property
    def numbers(self) -> dict[str, float]:
        """Return the numbers that define the prior, by name."""
        return {name: getattr(self, name) for name in _entries(self.families[self.family])}


class ParameterPrior(PriorSpec):
    """The prior of a parameter may be relative to the nominal value."""

    relative: bool = False
    """Take the numbers of the prior as multiples of the nominal value."""
    start: Positive | None = Field(
        None,
        description="Start of the MAP search; default: the nominal value, else the prior median. "
        "A sigma has the unit of its column, a quantity its `unit`, and a parameter SI (even if its "
        "prior is relative).",
    )


class SignedPrior(ParameterPrior):
    """The prior of a parameter that may be negative, such as an angle, is not truncated at zero."""

    families = MappingProxyType({**PRIORS, **SIGNED_PRIORS})

    start: Number | None = None
    """Start of the MAP search; default: the nominal value, else the prior median."""


class QuantityPrior(ParameterPrior):
    """The prior of a quantity has a unit of its own."""

    unit: str
    """Unit of the prior's numbers, such as Pa or mm; 1 for a pure number."""
    latex: Latex | None = Field(
        None, description="The symbol in figures, in LaTeX without dollars."
    )


class SensorPrior(PriorSpec):
    """The prior of a sensor's number or of an initial state may include negative values."""

    families = SIGNED_PRIORS

    start: Number | None = None
    """Start of the MAP search; default: the prior median."""
    unit: str | None = None
    """Unit of the numbers; default: the column's unit for offsets, s for times, SI for states."""


def _entries(family: Callable[..., Prior]) -> dict[str, Any]:
    """Return pydantic annotations of the numbers that define a prior of this family."""
    signature = family if inspect.isroutine(family) else family.__init__
    hints = typing.get_type_hints(signature, include_extras=True)
    return {name: hint for name, hint in hints.items() if name != "return"}


_SIGNED: Mapping[str, Any] = {
    "low": Number,
    "high": Number,
    "sd_log": Annotated[float, Field(ge=1e-6, le=20)],
}


def _spec(base: type[PriorSpec], name: str) -> type[PriorSpec]:
    """Return a class for the prior family `name`, with its required entries and those of `base`."""
    family = base.families[name]
    overrides = _SIGNED if base.families is not PRIORS and family is not LogUniform else {}
    fields: dict[str, Any] = {"prior": (Literal[name], ...)}
    fields |= {entry: (overrides.get(entry, hint), ...) for entry, hint in _entries(family).items()}
    title = f"{name.title().replace('_', '')}{base.__name__}"
    identity: Any = {"__doc__": family.__doc__, "__module__": __name__}
    spec = create_model(title, __base__=base, **identity, **fields)
    spec.family = name
    return spec


_SPECS: Mapping[str, type[PriorSpec]] = {
    model.__name__: model
    for base in (ParameterPrior, SignedPrior, QuantityPrior, SensorPrior)
    for model in (_spec(base, name) for name in base.families)
}
globals().update(_SPECS)  # pickle finds a class by its name in its module


def families_of(base: type[PriorSpec]) -> tuple[type[PriorSpec], ...]:
    """Return the class of each family for this kind of prior."""
    return tuple(model for model in _SPECS.values() if model.__base__ is base)


class _OfAnyFamily:
    """Annotate a kind of prior, so that `prior:` selects the class of its family."""

    @staticmethod
    def __get_pydantic_core_schema__(base: Any, handler: GetCoreSchemaHandler) -> Any:
        union: Any = Union[families_of(base)]  # noqa: UP007
        return handler.generate_schema(Annotated[union, Field(discriminator="prior")])


_ParameterPrior = Annotated[ParameterPrior, _OfAnyFamily]
_SignedPrior = Annotated[SignedPrior, _OfAnyFamily]
_QuantityPrior = Annotated[QuantityPrior, _OfAnyFamily]
_SensorPrior = Annotated[SensorPrior, _OfAnyFamily]


class Tie(Strict):
    """A tie makes a parameter equal to another one."""

    tie: str = Field(description="The parameter or quantity to which this parameter is equal.")


_P = typing.TypeVar("_P")
_SpecOf = Annotated[
    Annotated[Number, Tag("<number>")]
    | Annotated[str, Tag("<word>")]
    | Annotated[Tie, Tag("<tie>")]
    | Annotated[_P, Tag("<mapping>")],
    Discriminator(_parameter_shape),
]
ParameterSpec = _SpecOf[_ParameterPrior]
SignedSpec = _SpecOf[_SignedPrior]

SigmaSpec = Annotated[
    Annotated[Positive, Tag("<number>")] | Annotated[_ParameterPrior, Tag("<mapping>")],
    Discriminator(entry_shape),
]


class Quantity(Strict):
    """A quantity is a value with a unit."""

    value: Number
    unit: str


class NominalValue(Strict):
    """A nominal value may be given in the unit, and on the side of the gear, of its data sheet."""

    value: Positive
    unit: str | None = Field(None, description="Default: SI.")
    side: Literal["motor", "load"] | None = None
    """Side of the gear for which the data sheet gives the value; default: the parameter's own side."""


NominalSpec = Annotated[
    Annotated[Positive, Tag("<number>")] | Annotated[NominalValue, Tag("<mapping>")],
    Discriminator(entry_shape),
]


QuantitySpec = Annotated[
    Annotated[Positive, Tag("<number>")]
    | Annotated[Quantity, Tag("<held>")]
    | Annotated[_QuantityPrior, Tag("<mapping>")],
    Discriminator(_fixed_shape),
]


SensorSpec = Annotated[
    Annotated[Number, Tag("<number>")]
    | Annotated[Quantity, Tag("<held>")]
    | Annotated[_SensorPrior, Tag("<mapping>")],
    Discriminator(_fixed_shape),
]
DelaySpec = Annotated[
    SensorSpec | None,
    Field(description="Delay [s] of all inputs. Constant inputs are switched on at this time."),
]
StateSpec = Annotated[
    Annotated[Number, Tag("<number>")]
    | Annotated[Literal["free"], Tag("<word>")]
    | Annotated[Quantity, Tag("<held>")]
    | Annotated[_SensorPrior, Tag("<mapping>")],
    Discriminator(_fixed_shape),
]


class SensorFields(Strict):
    """A measured column may have the gain, offset and lag of its sensor."""

    gain: SensorSpec | None = None
    """Factor of the sensor: a number or a prior."""
    offset: SensorSpec | None = None
    """Constant that the sensor adds, in the column's unit: a number or a prior."""
    lag: SensorSpec | None = None
    """Delay of the sensor [s]: a number or a prior."""
