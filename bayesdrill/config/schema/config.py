"""Define the config of an experiment as validated classes, from which the JSON schema is made.

Unknown keys, wrong types and values out of range are errors. Conditions between several entries (a
start inside its prior, symbols of the model, units) are checked in `building`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal, TypeVar

from pydantic import ConfigDict, Discriminator, Field, PrivateAttr, Tag

from bayesdrill.basics import symbols
from bayesdrill.basics.entries import (
    LARGEST,
    MAX_COUNT,
    Count,
    Latex,
    NonNegative,
    Number,
    Positive,
    Strict,
    with_member_entries,
)
from bayesdrill.config.schema.numbers import (
    NamedSection,
    NominalSpec,
    ParameterSpec,
    QuantitySpec,
    SigmaSpec,
    SignedSpec,
    entry_shape,
    shorthand,
)
from bayesdrill.config.schema.records import (
    MAX_NAMED,
    ExperimentSpec,
    Initial,
    InputColumn,
    Inputs,
    OutputSpec,
    RecordSpec,
)
from bayesdrill.config.schema.vocabulary import HOUSE, Vocabulary
from bayesdrill.rig.models import MODELS
from bayesdrill.sampling.optimisers import OPTIMISERS

Identification = Literal["determined", "weak", "left to the prior"]


class MissingTorqueSpec(Strict):
    """A missing torque is absent from the rig's equations and modelled as a Gaussian process."""

    at: str
    """The inertia on which the torque acts; with a gear, its size counts on that inertia's side."""
    smoothness: Literal["1/2", "3/2"] = "3/2"
    """Smoothness of the Matern process: 1/2 is rough, 3/2 is differentiable."""
    size: SigmaSpec = Field(
        description="Standard deviation of the torque [N m]: a number or a prior."
    )
    time: SigmaSpec = Field(description="Correlation time of the torque [s]: a number or a prior.")


Searches = Annotated[int, Field(ge=1, le=1000)]
MAX_PIECES = 1000  # largest number of integration steps per sample; the default is at most 64


class DerivedSpec(Strict):
    """A derived quantity is a formula of parameters and quantities, computed for every draw."""

    formula: str = Field(
        description="A formula of parameters and quantities, such as sqrt(k_s/j_1)."
    )
    unit: str = "1"
    latex: Latex | None = Field(
        None, description="The symbol in figures, in LaTeX without dollars."
    )


@with_member_entries("name", MODELS.usable())
class ModelSpec(Strict):
    """The model section names a rig and sets the constants that this rig has."""

    name: str = Field("motor_shaft", description="The model.")
    pieces: Annotated[int, Field(ge=1, le=MAX_PIECES)] | None = Field(
        None,
        description="Integration steps per sample, for nonlinear rigs; default: enough for errors "
        "below a tenth of the noise. ",
    )


T = TypeVar("T")
Named = Annotated[dict[str, T], Field(max_length=MAX_NAMED)]
NameList = Annotated[list[str], Field(max_length=MAX_NAMED)]


Tolerance = Annotated[float, Field(ge=0, lt=1)]


class Parameters(NamedSection):
    """The parameters section gives a prior or a value of each parameter of the rig."""

    __pydantic_extra__: dict[str, ParameterSpec | SignedSpec | None]

    model_config = ConfigDict(
        json_schema_extra={
            "description": "Each parameter has a prior, a number, `nominal`, a formula, or a tie to an "
            "equal parameter; optional physics is off unless its parameters are named. "
        }
    )

    @classmethod
    def defaults(cls, words: Vocabulary) -> Mapping[str, float | None]:
        """Return no defaults, since the config has to give each parameter of the rig."""
        return {}


class Tolerances(NamedSection):
    """Tolerances are given for single nominal values, and as `default` for all others."""

    __pydantic_extra__: dict[str, Tolerance | None]

    default: Tolerance = 0.0


ToleranceSpec = Annotated[
    Annotated[Tolerance, Tag("<number>")] | Annotated[Tolerances, Tag("<mapping>")],
    Discriminator(entry_shape),
]


class Nominal(NamedSection):
    """Nominal values come from a table, unless single ones are given here."""

    __pydantic_extra__: dict[str, NominalSpec | None]

    table: str | None = Field(
        None, description=f"Default: {symbols.DEFAULT_NOMINAL}, for values that the config lacks."
    )
    tolerance: ToleranceSpec = Field(
        0.0, description="Relative tolerances: one number, or numbers by symbol and `default`."
    )


class Simulation(NamedSection):
    """The simulation section sets the time grid and the true values of `bayesdrill simulate`."""

    __pydantic_extra__: dict[str, Number | None]

    duration: Positive | None = None
    """Duration of the record [s]; default: the times of the record."""
    rate: Positive | None = Field(None, description="Sampling rate [Hz].")
    sigma: dict[str, Positive] = Field(default_factory=dict)
    """True sigma of each channel whose sigma is unknown."""
    quantities: dict[str, Positive] = Field(default_factory=dict)
    """True values of quantities, in their units; default: the start values of their priors."""
    truth: dict[str, Number] = Field(
        default_factory=dict,
        description="True values of `own` parameters, and of unknowns of sensors, noise and initial "
        "states, by name, in their units; default: the start values of their priors.",
    )


@with_member_entries("method", OPTIMISERS.usable())
class MapSpec(Strict):
    """The map section sets how the maximum of the posterior is searched."""

    method: str = Field("nelder_mead", description="The optimiser.")
    starts: Searches = 4
    """Number of starts: the first is the configured start, the others are drawn from the prior."""
    evaluations: Count = Field(8000, description="Largest number of evaluations from one start.")


class SamplerSpec(Strict):
    """The sampler section sets how the posterior is sampled, and when sampling stops."""

    ensembles: Annotated[int, Field(ge=4, le=MAX_COUNT)] = 4
    walkers: Annotated[int, Field(ge=4, le=MAX_COUNT)] = 256
    """Walkers per ensemble; default for nonlinear rigs: 96, plus 16 per entry of `experiments:`."""
    moves: Annotated[dict[str, NonNegative], Field(min_length=1)] = Field(
        default_factory=lambda: {
            "differential_evolution": 0.09,
            "stretch": 0.01,
            "independence": 0.9,
        }
    )
    r_hat: Annotated[float, Field(gt=1, le=LARGEST)] = 1.01
    n_tau: Positive = Field(50.0, description="Smallest ratio: kept steps / autocorrelation time.")
    ess: Positive = Field(4000.0, description="Smallest bulk effective sample size of an unknown.")
    max_steps: Annotated[int, Field(ge=100, le=MAX_COUNT)] = 50_000
    likelihood: Literal["auto", "exact", "compressed"] = "auto"
    """Use all samples, or compressed ones (only for linear rigs); `auto`: whichever is faster."""


class CalibrationSpec(Strict):
    """The calibration section sets how many simulated records are refitted, and how."""

    refits: Annotated[int, Field(ge=10, le=100_000)] = 200
    """Number of simulated records; each is refitted."""
    draws: Annotated[int, Field(ge=19, le=100_000)] = 99
    """Number of nearly independent posterior draws among which a true value is ranked."""
    starts: Searches = Field(16, description="Largest number of MAP searches of a refit.")
    n_tau: Positive = Field(20.0, description="As in `sampler`, for a refit.")
    ess: Positive = Field(400.0, description="As in `sampler`, for a refit.")
    max_steps: Annotated[int, Field(ge=100, le=MAX_COUNT)] = 5000
    """As in `sampler`, for a refit."""


class IdentifySpec(Strict):
    """The identify section sets the thresholds of `identify` and how it ranks remedies."""

    of_interest: list[str] = Field(default_factory=list)
    """Remedies are ranked by the uncertainty of these parameters; default: all unknown ones."""
    determined: Annotated[float, Field(gt=0, lt=1)] = 0.5
    """A parameter is determined if posterior sd / prior sd of its logarithm is below this number."""
    left_to_prior: Annotated[float, Field(gt=0, le=1)] = 0.9
    """A parameter is left to the prior if posterior sd / prior sd is at least this number."""

    def classify(self, ratio: float) -> Identification:
        """Return the class of a ratio of posterior to prior sd, both of logarithms."""
        if ratio < self.determined:
            return "determined"
        return "weak" if ratio < self.left_to_prior else "left to the prior"


class Config(Strict):
    """A config describes a record, a rig, the priors of its parameters, and the inference."""

    _vocabulary: Vocabulary = PrivateAttr()

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$", max_length=100)]
    seed: Annotated[int, Field(ge=0, lt=2**64)]
    record: RecordSpec
    inputs: Inputs
    initial: Annotated[Initial, shorthand("state")] = Field({}, validate_default=True)
    experiments: Named[ExperimentSpec] = Field(default_factory=dict)
    """Several experiments with one rig, by name; each needs a record."""
    shared: NameList = Field(default_factory=list)
    """Unknowns of sensors, initial states and noise that have one value in all experiments."""
    own: NameList = Field(default_factory=list)
    """Parameters of the rig that have a separate unknown value in each experiment."""
    model: ModelSpec = ModelSpec()
    nominal: Annotated[Nominal, shorthand("table")] = Field({}, validate_default=True)
    parameters: Parameters
    quantities: Named[QuantitySpec] = Field(default_factory=dict)
    """Additional quantities that formulas of parameters may contain."""
    derived: Named[Annotated[DerivedSpec, shorthand("formula")]] = Field(default_factory=dict)
    """Formulas that are computed for every draw."""
    missing_torque: MissingTorqueSpec | None = None
    """A torque that varies with time and is absent from the rig's equations."""
    map: MapSpec = MapSpec()
    sampler: SamplerSpec = SamplerSpec()
    output: OutputSpec = OutputSpec()
    identify: IdentifySpec = IdentifySpec()
    calibration: CalibrationSpec = CalibrationSpec()
    simulation: Simulation | None = None

    def model_post_init(self, context: Vocabulary | None, /) -> None:
        """Store the vocabulary, which is passed as the context of the validation."""
        self._vocabulary = context or HOUSE

    @property
    def vocabulary(self) -> Vocabulary:
        """Return the vocabulary of the rig, whose names the config may use."""
        return self._vocabulary

    def input_entry(self, name: str) -> str:
        """Return the key in `inputs:` of input `name`: `name`, or the imposed angle of a speed."""
        angle = self.vocabulary.imposed.get(name, name)
        return name if self.inputs.get(angle) is None else angle

    @property
    def measured_inputs(self) -> dict[str, InputColumn]:
        """Return the measured inputs, by name."""
        specs = {n: self.inputs.get(self.input_entry(n)) for n in self.vocabulary.inputs}
        return {name: spec for name, spec in specs.items() if isinstance(spec, InputColumn)}
