"""Turn numbers and priors of a config into SI; raise `ValueError` with a message for users."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from bayesdrill.basics import units
from bayesdrill.basics.symbols import Symbol
from bayesdrill.config.schema import numbers
from bayesdrill.config.schema.numbers import ParameterPrior, PriorSpec, SensorPrior
from bayesdrill.inference.priors import PRIORS, Prior
from bayesdrill.inference.unknowns import Role, labelled_symbol


@dataclass(frozen=True, slots=True, kw_only=True)
class ParsedNumber:
    """A number in SI is fixed, or unknown with a `start`; one `unit` is `factor` SI units."""

    symbol: Symbol
    role: Role
    value: float | Prior
    start: float
    factor: float = 1.0
    unit: str = ""

    @property
    def name(self) -> str:
        """Return the name of the number's symbol."""
        return self.symbol.name

    def for_experiment(self, label: str) -> ParsedNumber:
        """Return a copy whose symbol has the label of an experiment."""
        return dataclasses.replace(self, symbol=labelled_symbol(self.symbol, label))


_MAX_TRUNCATION = 5  # largest distance, in sds, of a truncated normal's mean below zero
MIN_RELATIVE_WIDTH = 1e-9  # least (1 to 99 % range) / median; a narrower prior is refused


def build_prior(
    spec: PriorSpec,
    nominal_value: float | None = None,
    families: Mapping[str, Callable[..., Prior]] | None = None,
) -> Prior:
    """Return the prior in its entry's unit; a `relative` prior is scaled by `nominal_value`.

    `families` are the prior families from which `spec` may choose.
    """
    families = spec.families if families is None else families
    values, positive = spec.numbers, families is PRIORS
    if "low" in values and not values["low"] < values["high"]:
        ends = f"low {values['low']:g} is not below high {values['high']:g}"
        raise ValueError(f"{ends}; exchange or correct them")
    if positive and "mean" in values and values["mean"] < -_MAX_TRUNCATION * values["sd"]:
        below = f"mean {values['mean']:g} lies more than {_MAX_TRUNCATION} sd below zero"
        nothing = "hardly any of the prior is positive, as the unknown has to be"
        raise ValueError(f"{below}, so that {nothing}")
    built = families[spec.family](**values)
    if is_relative(spec) and nominal_value is not None:
        built = built.scaled(nominal_value)
    with np.errstate(all="ignore"):
        low, middle, high = built.quantile(np.array([0.01, 0.5, 0.99]))
    if not high - low > MIN_RELATIVE_WIDTH * abs(middle):
        way_out = "hold the value as a number, or correct the prior"
        raise ValueError(f"{built.describe()}: nearly all of it is at {middle:.6g}; {way_out}")
    return built


def is_relative(spec: object) -> bool:
    """Return whether a prior is relative to the nominal value."""
    return isinstance(spec, ParameterPrior) and spec.relative


def is_tied(spec: object) -> bool:
    """Return whether an entry is a tie or a formula, from which its parameter is computed."""
    return isinstance(spec, numbers.Tie) or (isinstance(spec, str) and spec != "nominal")


def search_start(
    spec: ParameterPrior | SensorPrior, built: Prior, nominal_value: float | None = None
) -> float:
    """Return the start of the MAP search; raises `ValueError` if the prior excludes it."""
    default = nominal_value or float(built.quantile(np.array([0.5]))[0])
    value = default if spec.start is None else spec.start
    if not np.isfinite(built.logpdf(np.array([value]))[0]):
        outside = f"{value:g} is outside the prior ({built.describe()})"
        start_label = "the nominal value" if spec.start is None else "the start"
        way_out = "widen the prior, or give a `start:` inside it"
        raise ValueError(f"{start_label} {outside}; {way_out}")
    return value


def number_in_si(
    spec: float | numbers.Quantity | ParameterPrior | SensorPrior,
    factor: float,
    label: str = "it",
    unit: str = "",
) -> tuple[float | Prior, float]:
    """Return (value or prior, start) in SI; one unit of the entry is `factor` SI units.

    A relative prior is refused, as there is no nominal value; the message has `label` and `unit`.
    """
    if isinstance(spec, float | int | numbers.Quantity):
        value = (spec.value if isinstance(spec, numbers.Quantity) else float(spec)) * factor
        return value, value
    if is_relative(spec):
        raise ValueError(f"{label} has no nominal value; write its prior in {unit}")
    built = build_prior(spec)
    return built.scaled(factor), search_start(spec, built) * factor


def ends_of(value: float | Prior, tail: float) -> tuple[float, float]:
    """Return the quantiles `tail` and `1 - tail` of a number's prior, or a fixed value twice."""
    if isinstance(value, float):
        return value, value
    low, high = value.quantile(np.array([tail, 1 - tail]))
    return float(low), float(high)


def to_si(value: float | numbers.Quantity, unit: str) -> float:
    """Return a value in SI; a plain number is in SI already."""
    if isinstance(value, numbers.Quantity):
        return value.value * units.factor(value.unit, unit)
    return value
