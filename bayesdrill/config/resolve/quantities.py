"""Turn numbers and inputs of a config into objects; raise `ValueError` with a message for users."""

from __future__ import annotations

import dataclasses
import itertools
import keyword
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayesdrill.basics import symbols, units
from bayesdrill.basics.arrays import Array
from bayesdrill.basics.errors import did_you_mean
from bayesdrill.basics.formulas import RESERVED, Expression, expression
from bayesdrill.basics.registry import lookup
from bayesdrill.basics.symbols import Symbol
from bayesdrill.config.schema import numbers
from bayesdrill.config.schema.config import Config
from bayesdrill.config.schema.numbers import ParameterPrior, PriorSpec, QuantityPrior, SensorPrior
from bayesdrill.config.schema.records import InputColumn
from bayesdrill.inference.posterior import Formula
from bayesdrill.inference.priors import PRIORS, Prior
from bayesdrill.inference.unknowns import Role, labelled_name, labelled_symbol
from bayesdrill.record import anomalies
from bayesdrill.record.experiment import Experiment
from bayesdrill.rig.models.linear import Model, gear_factor


@dataclass(frozen=True, slots=True, kw_only=True)
class ParsedNumber:
    """A parsed number is fixed, or unknown with a `start`, in SI; one `unit` has `factor` SI units."""

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
        """Return a copy that belongs to the experiment `label`."""
        return dataclasses.replace(self, symbol=labelled_symbol(self.symbol, label))


_MAX_TRUNCATION = 5  # sds by which the mean of a normal, cut at zero, may lie below zero
MIN_RELATIVE_WIDTH = 1e-9  # a narrower prior holds hardly more than one floating-point number


def build_prior(spec: PriorSpec, nominal_value: float | None = None) -> Prior:
    """Return the prior in its entry's unit; a `relative` one is scaled by `nominal_value`."""
    values, positive = spec.numbers, spec.families is PRIORS
    if "low" in values and not values["low"] < values["high"]:
        ends = f"low {values['low']:g} is not below high {values['high']:g}"
        raise ValueError(f"{ends}; exchange or mend them")
    if positive and "mean" in values and values["mean"] < -_MAX_TRUNCATION * values["sd"]:
        below = f"mean {values['mean']:g} lies more than {_MAX_TRUNCATION} sd below zero"
        nothing = "nothing of the prior is left; all unknowns are positive"
        raise ValueError(f"{below}, so that {nothing}")
    built = spec.families[spec.family](**values)
    if is_relative(spec) and nominal_value is not None:
        built = built.scaled(nominal_value)
    with np.errstate(all="ignore"):
        low, middle, high = built.quantile(np.array([0.01, 0.5, 0.99]))
    if not high - low > MIN_RELATIVE_WIDTH * abs(middle):
        way_out = "hold the value as a number, or mend the prior"
        raise ValueError(f"{built.describe()}: nearly all of it is at {middle:.6g}; {way_out}")
    return built


def is_relative(spec: object) -> bool:
    """Return whether a prior is relative to the nominal value."""
    return isinstance(spec, ParameterPrior) and spec.relative


def is_tied(spec: object) -> bool:
    """Return whether a parameter follows from others."""
    return isinstance(spec, numbers.Tie) or (isinstance(spec, str) and spec != "nominal")


def search_start(
    spec: ParameterPrior | SensorPrior, built: Prior, nominal_value: float | None = None
) -> float:
    """Return where the MAP search begins; raises `ValueError` if the prior excludes it."""
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
    """Return a value or a prior, and its start, in SI; one unit of the entry has `factor` SI units.

    The number has no nominal value; messages call it `label` and ask for a prior in `unit`.
    """
    if isinstance(spec, float | int | numbers.Quantity):
        value = (spec.value if isinstance(spec, numbers.Quantity) else float(spec)) * factor
        return value, value
    if is_relative(spec):
        raise ValueError(f"{label} has no nominal value; write its prior in {unit}")
    built = build_prior(spec)
    return built.scaled(factor), search_start(spec, built) * factor


def ends_of(value: float | Prior, tail: float) -> tuple[float, float]:
    """Return lower and upper ends of a number, with the prior probability `tail` beyond each."""
    if isinstance(value, float):
        return value, value
    low, high = value.quantile(np.array([tail, 1 - tail]))
    return float(low), float(high)


def to_si(value: float | numbers.Quantity, unit: str) -> float:
    """Return a value in SI, in which a plain number is given already."""
    if isinstance(value, numbers.Quantity):
        return value.value * units.factor(value.unit, unit)
    return value


@dataclass(frozen=True, slots=True, kw_only=True)
class NominalValues:
    """Nominal values come from a table, unless the config gives them.

    The verdict compares parameters with `compared`, which are values of this rig. A table's other values
    belong to another rig if the config gives its own values or uses no table.
    """

    values: Mapping[str, float]
    compared: Mapping[str, float]
    published: tuple[str, ...]  # names of compared parameters with the value of a table
    tolerance: Mapping[str, float]  # relative tolerances of all parameters
    name: str  # the table's name in sentences


def nominal_value(config: Config, model: Model, name: str) -> float:
    """Return the config's nominal value of a parameter, in SI and at its own side of the gear."""
    entry, symbol = config.nominal.get(name), model.symbols[name]
    if not isinstance(entry, numbers.NominalValue):
        return float(entry)
    value = entry.value * (1.0 if entry.unit is None else units.factor(entry.unit, symbol.unit))
    value *= 1.0 if entry.side is None else gear_factor(model, symbol, entry.side)
    if not value <= symbol.at_most:
        raise ValueError(f"{value:g} is too large: {name} is at most {symbol.at_most:g}")
    return value


def nominal_table(config: Config, config_values: Mapping[str, float]) -> NominalValues:
    """Return the named table with the config's own values, in SI; raises `ValueError` if unknown."""
    given: Any = config.nominal
    table = given.table or symbols.DEFAULT_NOMINAL
    published_values = lookup(symbols.NOMINAL, table, "nominal table")
    known = config.vocabulary.parameters
    shared = {n: x for n, x in published_values.items() if known.get(n) == symbols.PARAMETERS[n]}
    if given.table is not None and not shared:
        raise ValueError(f"{table} is a table of another rig; remove this entry")
    values = {**shared, **config_values}
    given_parameters = config.parameters
    used = {n for n in values if (s := given_parameters.get(n)) == "nominal" or is_relative(s)}
    compared = values
    if given.table is None and (config_values or not used):
        compared = {n: x for n, x in values.items() if n in config_values or n in used}
    published = tuple(name for name in compared if name not in config_values)
    tolerance = given.tolerance  # one number, or by symbol and `default`
    if isinstance(tolerance, float):
        tolerances = dict.fromkeys(known, tolerance)
    else:
        single = {name: tolerance.get(name) for name in known}
        tolerances = {name: tolerance.default if x is None else x for name, x in single.items()}
    amended = f"{table} ({', '.join(n for n in compared if n in config_values)} as in the config)"
    return NominalValues(
        values=values,
        compared=compared,
        published=published,
        tolerance=tolerances,
        name=(amended if published else "the config's nominal values") if config_values else table,
    )


def parse_parameter(
    config: Config, model: Model, table: NominalValues, name: str
) -> ParsedNumber | Expression:
    """Return the number of a parameter of the rig, or the expression from which it follows."""
    if (related := parse_relation(config, model, name)) is not None:
        return related
    spec, symbol, value = config.parameters.get(name), model.symbols[name], table.values.get(name)
    no_table = f"no table has {name}" + (f" ({symbol.typical})" if symbol.typical else "")
    if not isinstance(spec, ParameterPrior):
        fixed = float(spec) if isinstance(spec, float | int) else value
        if fixed is None:
            raise ValueError(f"{no_table}; give a number, or `nominal: {{{name}: ...}}`")
        return ParsedNumber(symbol=symbol, role="rig", value=fixed, start=fixed)
    if spec.relative and value is None:
        way_out = f"`nominal: {{{name}: ...}}`, or leave out `relative:`"
        raise ValueError(f"{no_table}, to be relative to; give {way_out}")
    built, upper_limit = build_prior(spec, value), symbol.at_most
    if built.high > upper_limit:
        reaches = "has no end" if math.isinf(built.high) else f"goes up to {built.high:.6g}"
        example = f"such as {{prior: uniform, low: {0.5 * upper_limit:g}, high: {upper_limit:g}}}"
        above = f"the prior {reaches}, and {name} is at most {upper_limit:g}"
        raise ValueError(f"{above}; let it end, {example}")
    begin = search_start(spec, built, table.compared.get(name))
    return ParsedNumber(symbol=symbol, role="rig", value=built, start=begin)


def parse_quantity(
    config: Config, name: str, spec: float | numbers.Quantity | QuantityPrior
) -> ParsedNumber:
    """Return a quantity of the config as a number."""
    _check_name(config, name)
    unit, factor = ("", 1.0) if isinstance(spec, float | int) else units.coherent(spec.unit)
    if isinstance(spec, numbers.Quantity) and spec.value <= 0:
        raise ValueError(f"{spec.value:g} is not positive; all quantities are")
    value, begin = number_in_si(spec, factor, "a quantity", "its own unit")
    meaning = "held by" if isinstance(value, float) else "quantity of"
    latex = getattr(spec, "latex", None)
    symbol = symbols.own_symbol(name, unit, latex, f"{meaning} the config")
    return ParsedNumber(symbol=symbol, role="quantity", value=value, start=begin, factor=factor)


def _check_name(config: Config, name: str) -> None:
    """Raise `ValueError` unless a quantity or derived formula may have this name."""
    if not name.isidentifier() or keyword.iskeyword(name):
        raise ValueError(f"'{name}' cannot be a name; use letters, digits and `_`")
    words = config.vocabulary
    taken_names = (words.parameters, words.signals, words.inputs, symbols.DERIVED)
    if name in {*RESERVED, *symbols.AXES}.union(*taken_names) or name.startswith("sigma_"):
        raise ValueError(f"{name} has a meaning of its own here; choose another name")


def _names(config: Config, model: Model) -> tuple[str, ...]:
    return (*model.parameters, *config.quantities)


def parse_relation(config: Config, model: Model, name: str) -> Expression | None:
    """Return the expression from which parameter `name` follows; None for a value or a prior."""
    entry, known_names = config.parameters.get(name), _names(config, model)
    if isinstance(entry, numbers.Tie):
        spec = entry.tie
        if spec not in known_names:
            hint = did_you_mean(spec, known_names)
            raise ValueError(f"'{spec}' is no parameter or quantity{hint}")
    elif isinstance(entry, str) and entry != "nominal":
        spec = entry
    else:
        return None
    if spec.isidentifier() and spec not in known_names:
        hint = did_you_mean(spec, ("nominal", *known_names))
        raise ValueError(f"'{spec}' is neither `nominal` nor a parameter or quantity{hint}")
    parsed = expression(spec, known_names)
    if not parsed.names:
        value = f"write for example {parsed.value({}):g}"
        raise ValueError(f"'{spec}' names no parameter or quantity; to hold this value {value}")
    return parsed


def parse_formula(config: Config, model: Model, name: str, labels: Iterable[str] = ()) -> Formula:
    """Return a derived formula, which may name earlier ones and parameters of experiments `labels`."""
    _check_name(config, name)
    if name in config.quantities:
        raise ValueError(f"{name} is a quantity already; choose another name")
    names, local = list(config.derived), itertools.product(model.parameters, labels)
    known_names = (*_names(config, model), *itertools.starmap(labelled_name, local))
    known_names = (*known_names, *symbols.DERIVED, *names[: names.index(name)])
    spec = config.derived[name]
    unit, _ = units.coherent(spec.unit)  # values are SI, whatever the multiple
    symbol = symbols.own_symbol(name, unit, spec.latex, f"{name} = {spec.formula}")
    return Formula(symbol, expression(spec.formula, known_names))


def input_entry(config: Config, name: str) -> str:
    """Return the entry of `inputs:` that gives the input `name`: itself, or an imposed angle."""
    angle = config.vocabulary.imposed.get(name, name)
    return name if config.inputs.get(angle) is None else angle


def measured_inputs(config: Config) -> dict[str, InputColumn]:
    """Return the measured inputs, by name."""
    names = config.vocabulary.inputs
    specs = {name: config.inputs.get(input_entry(config, name)) for name in names}
    return {name: spec for name, spec in specs.items() if isinstance(spec, InputColumn)}


def constant_inputs(config: Config, model: Model) -> dict[str, float]:
    """Return the constant inputs of the model, SI."""
    series, given = measured_inputs(config), config.inputs
    return {
        name: to_si(given.get(name), model.symbols[name].unit)
        for name in model.inputs
        if name not in series and given.get(name) is not None
    }


def inputs_as_given(
    config: Config, experiment: Experiment
) -> Iterator[tuple[str, InputColumn, Array]]:
    """Yield entry, column and values `(T,)`, in the column's unit, of each input or imposed angle."""
    for name, spec in measured_inputs(config).items():
        entry, values = input_entry(config, name), experiment.series[name]
        if entry != name:
            values = anomalies.integrate_speeds(values, experiment.t, experiment.start[entry])
        yield entry, spec, values / units.factor(spec.unit, config.vocabulary.entries[entry].unit)
