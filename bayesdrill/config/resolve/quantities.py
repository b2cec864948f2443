"""Single numbers and inputs of a config as objects: priors, quantities, ties, formulas; what
drives the rig.

The steps raise `ValueError` with a message for the user.
"""

from __future__ import annotations

import keyword
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from bayesdrill.basics import symbols, units
from bayesdrill.basics.errors import did_you_mean
from bayesdrill.basics.formulas import RESERVED, Expression, expression
from bayesdrill.config.schema import numbers
from bayesdrill.config.schema.config import Config
from bayesdrill.config.schema.numbers import ParameterPrior, PriorSpec, QuantityPrior
from bayesdrill.config.schema.records import InputColumn
from bayesdrill.inference.posterior import Formula
from bayesdrill.inference.priors import PRIORS, Prior
from bayesdrill.record import anomalies
from bayesdrill.record.experiment import Experiment
from bayesdrill.rig import models
from bayesdrill.rig.models.linear import Model


@dataclass(frozen=True, slots=True)
class Given:
    """A quantity of the config in SI, held or with a prior, and how many SI its unit is."""

    symbol: symbols.Symbol
    factor: float
    value: float | Prior
    start: float


_FARTHEST = 5  # sd of a normal between its mean and zero, where it is cut
NARROWEST = 1e-9  # of a prior, relative: below it, numbers hold no more than one value


def prior(spec: PriorSpec, nominal_value: float | None = None) -> Prior:
    """The prior in the unit of its entry; one that is `relative` is of multiples of `nominal_value`."""
    values, positive = spec.numbers, spec.families is PRIORS
    if "low" in values and not values["low"] < values["high"]:
        raise ValueError(
            f"low {values['low']:g} is not below high {values['high']:g}; exchange or mend them"
        )
    if positive and "mean" in values and values["mean"] < -_FARTHEST * values["sd"]:
        raise ValueError(
            f"mean {values['mean']:g} lies more than {_FARTHEST} sd below zero, so that nothing of the "
            "prior is left; all unknowns are positive"
        )
    built = spec.families[spec.prior](**values)
    if is_relative(spec):
        if nominal_value is None:
            raise ValueError(
                "there is no nominal value to be relative to; give one in `nominal:`, or leave out "
                "`relative:`"
            )
        built = built.scaled(nominal_value)
    with np.errstate(all="ignore"):
        low, middle, high = built.quantile(np.array([0.01, 0.5, 0.99]))
    if not high - low > NARROWEST * abs(middle):
        raise ValueError(
            f"{built.describe()}: nearly all of it is at {middle:.6g}; hold the value as a number, or "
            "mend the prior"
        )
    return built


def is_relative(spec: object) -> bool:
    return isinstance(spec, ParameterPrior) and spec.relative


def is_nominal(spec: object) -> bool:
    """Whether it is the nominal value, or relative to it."""
    return spec == "nominal" or is_relative(spec)


def start(spec: PriorSpec, built: Prior, nominal_value: float | None = None) -> float:
    """Where the MAP search begins; raises where the prior excludes it.

    By default at the nominal value, or where there is none at the median.
    """
    default = nominal_value or float(built.quantile(np.array([0.5]))[0])
    value = default if spec.start is None else spec.start
    if not np.isfinite(built.logpdf(np.array([value]))[0]):
        what = "the nominal value" if spec.start is None else "the start"
        raise ValueError(
            f"{what} {value:g} is outside the prior ({built.describe()}); widen the prior, or give "
            "a `start:` inside it"
        )
    return value


def prior_in_si(spec: PriorSpec, factor: float) -> tuple[Prior, float]:
    """Of an entry whose unit is `factor` SI, with the start; its mistakes are told in that unit."""
    built = prior(spec)
    return built.scaled(factor), start(spec, built) * factor


def si(value: float | numbers.Quantity, unit: str) -> float:
    if isinstance(value, numbers.Quantity):
        return value.value * units.factor(value.unit, unit)
    return value


def quantity(name: str, spec: float | numbers.Quantity | QuantityPrior) -> Given:
    _check_name(name)
    if isinstance(spec, float | int):
        symbol = symbols.own_symbol(name, "", None, "held by the config")
        return Given(symbol, 1.0, float(spec), float(spec))
    unit, factor = units.coherent(spec.unit)
    if isinstance(spec, numbers.Quantity):
        if spec.value <= 0:
            raise ValueError(f"{spec.value:g} is not positive; all quantities are")
        symbol = symbols.own_symbol(name, unit, None, "held by the config")
        return Given(symbol, factor, spec.value * factor, spec.value * factor)
    if spec.relative:
        raise ValueError("a quantity has no nominal value; write its prior in its own unit")
    value, begin = prior_in_si(spec, factor)
    symbol = symbols.own_symbol(name, unit, spec.latex, "quantity of the config")
    return Given(symbol, factor, value, begin)


def _check_name(name: str) -> None:
    """Whether a config may give this name to a thing of its own."""
    if not name.isidentifier() or keyword.iskeyword(name):
        raise ValueError(f"'{name}' cannot be a name; use letters, digits and `_`")
    known = (models.PARAMETERS, models.STATES, symbols.INPUTS, symbols.DERIVED)
    if name in {*RESERVED, *symbols.AXES}.union(*known) or name.startswith("sigma_"):
        raise ValueError(f"{name} has a meaning of its own here; choose another name")


def _names(config: Config, model: Model) -> tuple[str, ...]:
    return (*model.parameters, *config.quantities)


def relation(config: Config, model: Model, name: str) -> Expression | None:
    """By which parameter `name` follows from others; None where it has a value or a prior."""
    given, known = config.parameters.get(name), _names(config, model)
    if isinstance(given, numbers.Tie):
        spec = given.tie
        if spec not in known:
            raise ValueError(f"'{spec}' is no parameter or quantity{did_you_mean(spec, known)}")
    elif isinstance(given, str) and given != "nominal":
        spec = given
    else:
        return None
    if spec.isidentifier() and spec not in known:
        hint = did_you_mean(spec, ("nominal", *known))
        raise ValueError(f"'{spec}' is neither `nominal` nor a parameter or quantity{hint}")
    found = expression(spec, known)
    if not found.names:
        value = f"write for example {found.value({}):g}"
        raise ValueError(f"'{spec}' names no parameter or quantity; to hold this value {value}")
    return found


def formula(config: Config, model: Model, name: str) -> Formula:
    """A derived quantity of the config; it may name those that stand before it."""
    _check_name(name)
    if name in config.quantities:
        raise ValueError(f"{name} is a quantity already; choose another name")
    own = list(config.derived)
    known = (*_names(config, model), *symbols.DERIVED, *own[: own.index(name)])
    spec = config.derived[name]
    unit, _ = units.coherent(spec.unit)  # values are SI, whatever the multiple
    symbol = symbols.own_symbol(name, unit, spec.latex, f"{name} = {spec.formula}")
    return Formula(symbol, expression(spec.formula, known))


Array = NDArray[np.float64]

# Inputs that are speeds, and the entries that give the angle instead.
IMPOSED: Mapping[str, str] = MappingProxyType({"w_2": "theta_2"})
ENTRIES = (*symbols.INPUTS, *IMPOSED.values())


def input_entry(config: Config, name: str) -> str:
    """That of `inputs:` which gives the input `name`."""
    angle = IMPOSED.get(name, name)
    return name if getattr(config.inputs, angle) is None else angle


def imposed_inputs(config: Config) -> list[str]:
    """Angles that are."""
    return [angle for angle in IMPOSED.values() if getattr(config.inputs, angle) is not None]


def input_unit(named: str) -> str:
    """SI, of an entry."""
    return symbols.INPUTS[named].unit if named in symbols.INPUTS else "rad"


def measured_input(config: Config) -> dict[str, InputColumn]:
    """By the names of inputs."""
    every = {name: getattr(config.inputs, input_entry(config, name)) for name in symbols.INPUTS}
    return {name: spec for name, spec in every.items() if isinstance(spec, InputColumn)}


def constant_input(config: Config, model: Model) -> dict[str, float]:
    """Those of the model, SI."""
    series, given = measured_input(config), config.inputs
    return {
        name: si(getattr(given, name), symbols.INPUTS[name].unit)
        for name in model.inputs
        if name not in series and getattr(given, name) is not None
    }


def inputs_as_given(config: Config, experiment: Experiment, name: str) -> Array:
    """A measured input `(T,)` as its entry has it, SI: itself, or the angle that was imposed."""
    own, series = input_entry(config, name), experiment.series[name]
    if own == name:
        return series
    return anomalies.turned(series, experiment.t, experiment.start[own])
