"""Build the nominal values from a table and from the entries of the config."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from bayesdrill.basics import symbols, units
from bayesdrill.basics.registry import lookup
from bayesdrill.config.building.parsed_numbers import is_relative
from bayesdrill.config.schema import numbers
from bayesdrill.config.schema.config import Config
from bayesdrill.config.yaml_source import IssueCollector
from bayesdrill.rig.models.linear import Model, gear_factor


@dataclass(frozen=True, slots=True, kw_only=True)
class NominalValues:
    """Nominal values come from a table, unless the config gives them.

    The verdict compares parameters with `compared`. A config that names no table uses the default
    table, which may describe another rig. All its values are compared only if the config uses some
    of them and gives no nominal value. Otherwise only used and given values are compared.
    """

    values: Mapping[str, float]
    compared: Mapping[str, float]
    published: tuple[str, ...]  # compared parameters whose nominal value comes from a table
    tolerance: Mapping[str, float]  # relative tolerances of all parameters
    name: str  # a noun phrase for these values in sentences


def check_nominal(errors: IssueCollector, config: Config, model: Model) -> dict[str, float]:
    """Return the config's nominal values in SI, each converted to its parameter's gear side."""
    values = {
        name: errors.run(("nominal", name), nominal_value, config, model, name)
        for name in config.vocabulary.parameters
        if config.nominal.get(name) is not None
    }
    return {name: value for name, value in values.items() if value is not None}


def nominal_value(config: Config, model: Model, name: str) -> float:
    """Return the config's nominal value in SI, converted to the parameter's side of the gear."""
    entry, symbol = config.nominal.get(name), model.symbols[name]
    if not isinstance(entry, numbers.NominalValue):
        return float(entry)
    value = entry.value * (1.0 if entry.unit is None else units.factor(entry.unit, symbol.unit))
    value *= 1.0 if entry.side is None else gear_factor(model, symbol, entry.side)
    if not value <= symbol.at_most:
        raise ValueError(f"{value:g} is too large: {name} is at most {symbol.at_most:g}")
    return value


def nominal_table(config: Config, config_values: Mapping[str, float]) -> NominalValues:
    """Return a table, updated with `config_values` (SI); raises `ValueError` for an unknown one."""
    given: Any = config.nominal
    table = given.table or symbols.DEFAULT_NOMINAL
    published_values = lookup(symbols.NOMINAL, table, "nominal table")
    known = config.vocabulary.parameters
    shared = {n: x for n, x in published_values.items() if known.get(n) == symbols.PARAMETERS[n]}
    if given.table is not None and not shared:
        raise ValueError(f"{table} is the table of another rig; remove this entry")
    values = {**shared, **config_values}
    given_parameters = config.parameters
    used = {n for n in values if (s := given_parameters.get(n)) == "nominal" or is_relative(s)}
    compared = values
    if given.table is None and (config_values or not used):
        compared = {n: x for n, x in values.items() if n in config_values or n in used}
    published = tuple(name for name in compared if name not in config_values)
    tolerance = given.tolerance  # one number, or numbers by symbol and `default`
    if isinstance(tolerance, float):
        tolerances = dict.fromkeys(known, tolerance)
    else:
        single = {name: tolerance.get(name) for name in known}
        tolerances = {name: tolerance.default if x is None else x for name, x in single.items()}
    amended = ", ".join(name for name in compared if name in config_values)
    shown = f"the nominal table ({table}{f', with {amended} as in the config' if amended else ''})"
    return NominalValues(
        values=values,
        compared=compared,
        published=published,
        tolerance=tolerances,
        name="the config's nominal values" if amended and not published else shown,
    )
