"""The experiment config as validated records: what may stand in a YAML file, and its defaults.

Strict: unknown keys, wrong types and values out of range are errors.  What needs more than one
entry to be judged (a start inside its prior, symbols of the model, units) is in `consistency`.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Discriminator, Field, Tag, create_model

from bayesdrill import symbols


class Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Count = Annotated[int, Field(ge=1)]


def _shape(value: Any) -> str:
    """Which member of a union an entry is meant to be, before and after it is validated."""
    if isinstance(value, dict):
        return "<column>" if "column" in value or "variable" in value else "<mapping>"
    if isinstance(value, BaseModel):
        return "<column>" if isinstance(value, Column) else "<mapping>"
    return "<word>" if isinstance(value, str) else "<number>"


def _time_shape(value: Any) -> str:
    """A time entry without `rate` is a column, however its keys are misspelt."""
    rate = "rate" in value if isinstance(value, dict) else isinstance(value, TimeRate)
    return "<mapping>" if rate else "<column>"


class PriorBase(Strict):
    relative: bool = Field(
        False, description="Bounds and scales are multiples of the nominal value."
    )
    start: Positive | None = Field(
        None, description="Where the search for the MAP begins, SI; default: the nominal value."
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
    """Cut at zero and renormalised, as all parameters are positive."""

    prior: Literal["normal"]
    mean: Positive
    sd: Positive


class TruncatedNormalPrior(PriorBase):
    prior: Literal["truncated_normal"]
    mean: Positive
    sd: Positive
    low: NonNegative
    high: Positive


class LogNormalPrior(PriorBase):
    prior: Literal["log_normal"]
    median: Positive
    sd_log: Positive = Field(description="Standard deviation of the natural logarithm.")


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
ParameterSpec = Annotated[
    Annotated[Positive, Tag("<number>")]
    | Annotated[Literal["nominal"], Tag("<word>")]
    | Annotated[PriorSpec, Tag("<mapping>")],
    Discriminator(_shape),
]
SigmaSpec = Annotated[
    Annotated[Positive, Tag("<number>")] | Annotated[PriorSpec, Tag("<mapping>")],
    Discriminator(_shape),
]


class Quantity(Strict):
    value: float
    unit: str


class Column(Strict):
    """Where numbers stand: a CSV column or MAT variable by name, or a column number from 1."""

    column: str | Count | None = None
    variable: str | None = Field(None, description="MAT variable, dotted for struct fields.")
    unit: str


class TimeColumn(Column):
    pass


class TimeRate(Strict):
    rate: Positive = Field(description="Samples per second, for records without a time column.")


class InputColumn(Column):
    hold: Literal["zero", "first"] = Field(
        "zero", description="Between samples: constant (zero) or linear (first order)."
    )


Value = Annotated[
    Annotated[float, Tag("<number>")] | Annotated[Quantity, Tag("<mapping>")],
    Discriminator(_shape),
]
InputSpec = Annotated[
    Annotated[float, Tag("<number>")]
    | Annotated[Quantity, Tag("<mapping>")]
    | Annotated[InputColumn, Tag("<column>")],
    Discriminator(_shape),
]
TimeSpec = Annotated[
    Annotated[TimeColumn, Tag("<column>")] | Annotated[TimeRate, Tag("<mapping>")],
    Discriminator(_time_shape),
]


class ChannelSpec(Column):
    measures: str | None = Field(
        None,
        description="Linear combination of theta_1, theta_2, w_1, w_2, i; default: the channel's name.",
    )
    sigma: SigmaSpec = Field(
        description="Noise standard deviation in the column's unit, or its prior when unknown."
    )


class RecordSpec(Strict):
    file: str = Field(description="Relative to the folder of the config.")
    format: Literal["csv", "mat"] | None = Field(None, description="Default: by the file's ending.")
    delimiter: str | None = Field(None, description="CSV; default: found out.")
    decimal: Literal[".", ","] | None = Field(None, description="CSV; default: found out.")
    header: bool | None = Field(None, description="CSV; default: found out.")
    skip_rows: Annotated[int, Field(ge=0)] = 0
    time: TimeSpec
    window: Annotated[list[float], Field(min_length=2, max_length=2)] | None = Field(
        None, description="Use the samples from the first to the second time [s] only."
    )
    channels: Annotated[dict[str, ChannelSpec], Field(min_length=1)]


class ModelSpec(Strict):
    name: str = "motor_shaft"
    i_m: Positive = Field(0.125, description="Gear reduction factor (8:1 is 0.125).")


class Inputs(Strict):
    v: InputSpec
    t_1: InputSpec = 0.0


class Initial(Strict):
    """The state at `time`; what is not named is zero."""

    time: float | None = Field(
        None,
        description="[s] default: 0 with constant inputs, the first sample with measured ones.",
    )
    theta_1: Value = 0.0
    theta_2: Value = 0.0
    w_1: Value = 0.0
    w_2: Value = 0.0
    i: Value = 0.0


def _per_symbol(name: str, base: type[Strict], kind: Any, doc: str) -> type[Strict]:
    fields: dict[str, Any] = {
        symbol.name: (kind | None, Field(None, description=f"{symbol.meaning} [{symbol.unit}]"))
        for symbol in symbols.PARAMETERS.values()
    }
    model: type[Strict] = create_model(name, __base__=base, __doc__=doc, **fields)
    return model


class _NominalBase(Strict):
    table: str = symbols.DEFAULT_NOMINAL


class _SimulationBase(Strict):
    duration: Positive | None = Field(None, description="[s]; default: the times of the record.")
    rate: Positive | None = Field(None, description="[Hz]")
    sigma: Annotated[
        dict[str, Positive], Field(description="Of channels whose sigma is unknown.")
    ] = Field(default_factory=dict)


Parameters = _per_symbol("Parameters", Strict, ParameterSpec, "A prior, a number, or `nominal`.")
Nominal = _per_symbol("Nominal", _NominalBase, Positive, "A table and what differs from it.")
Simulation = _per_symbol(
    "Simulation", _SimulationBase, Positive, "Grid and true values of `bayesdrill simulate`."
)


def _named_table(value: Any) -> Any:
    return {"table": value} if isinstance(value, str) else value


class MapSpec(Strict):
    method: str = "nelder_mead"
    starts: Count = Field(
        4, description="The first is the configured one, the rest from the prior."
    )
    evaluations: Count = Field(8000, description="The most that one start may spend.")


class SamplerSpec(Strict):
    ensembles: Annotated[int, Field(ge=4)] = 4
    walkers: Annotated[int, Field(ge=4)] = 64
    moves: Annotated[dict[str, NonNegative], Field(min_length=1)] = Field(
        default_factory=lambda: {
            "differential_evolution": 0.45,
            "stretch": 0.05,
            "independence": 0.5,
        }
    )
    pilot: Annotated[int, Field(ge=20)] = Field(
        500, description="First steps, always dropped, which the independence move learns from."
    )
    r_hat: Annotated[float, Field(gt=1)] = 1.01
    n_tau: Positive = Field(50.0, description="Steps kept, in autocorrelation times.")
    ess: Positive = Field(4000.0, description="Bulk effective sample size of every unknown.")
    max_steps: Annotated[int, Field(ge=100)] = 50_000


class OutputSpec(Strict):
    predictive_draws: Annotated[int, Field(ge=10)] = Field(
        125, description="Per ensemble, with pointwise log likelihood and predictive samples."
    )


class Config(Strict):
    """An experiment: a record, a rig, what is believed of it, and how to find out more."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")]
    seed: Annotated[int, Field(ge=0)]
    record: RecordSpec
    inputs: Inputs
    initial: Initial = Initial()
    model: ModelSpec = ModelSpec()
    nominal: Annotated[Nominal, BeforeValidator(_named_table)] = Nominal()  # type: ignore[valid-type]
    parameters: Parameters  # type: ignore[valid-type]
    coordinates: Literal["auto", "physical", "log", "modal"] = "auto"
    map: MapSpec = MapSpec()
    sampler: SamplerSpec = SamplerSpec()
    output: OutputSpec = OutputSpec()
    simulation: Simulation | None = None  # type: ignore[valid-type]
