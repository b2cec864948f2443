"""Build the quantities of a config and its derived formulas, which every draw evaluates."""

from __future__ import annotations

import itertools
import keyword
from collections.abc import Iterable

from bayesdrill.basics import symbols, units
from bayesdrill.basics.formulas import RESERVED, expression
from bayesdrill.config.building.parsed_numbers import ParsedNumber, number_in_si
from bayesdrill.config.schema import numbers
from bayesdrill.config.schema.config import Config
from bayesdrill.config.schema.numbers import QuantityPrior
from bayesdrill.inference.posterior import Formula
from bayesdrill.inference.unknowns import labelled_name
from bayesdrill.rig.models.linear import Model


def parse_quantity(
    config: Config, name: str, spec: float | numbers.Quantity | QuantityPrior
) -> ParsedNumber:
    """Return the number of a quantity, in SI."""
    _check_name(config, name)
    unit, factor = ("", 1.0) if isinstance(spec, float | int) else units.coherent(spec.unit)
    if isinstance(spec, numbers.Quantity) and spec.value <= 0:
        raise ValueError(f"{spec.value:g} is not positive; all quantities are")
    value, begin = number_in_si(spec, factor, "a quantity", "its own unit")
    meaning = "held by" if isinstance(value, float) else "quantity of"
    latex = getattr(spec, "latex", None)
    symbol = symbols.own_symbol(name, unit, latex, f"{meaning} the config")
    return ParsedNumber(symbol=symbol, role="quantity", value=value, start=begin, factor=factor)


def parse_formula(config: Config, model: Model, name: str, labels: Iterable[str] = ()) -> Formula:
    """Return a derived formula, which may name earlier formulas and parameters of `labels`."""
    _check_name(config, name)
    if name in config.quantities:
        raise ValueError(f"{name} is a quantity already; choose another name")
    names, local = list(config.derived), itertools.product(model.parameters, labels)
    known_names = (*formula_names(config, model), *itertools.starmap(labelled_name, local))
    known_names = (*known_names, *symbols.DERIVED, *names[: names.index(name)])
    spec = config.derived[name]
    unit, _ = units.coherent(spec.unit)  # values are in SI, so prefixes are dropped
    symbol = symbols.own_symbol(name, unit, spec.latex, f"{name} = {spec.formula}")
    return Formula(symbol, expression(spec.formula, known_names))


def _check_name(config: Config, name: str) -> None:
    """Raise `ValueError` unless a quantity or derived formula may have this name."""
    if not name.isidentifier() or keyword.iskeyword(name):
        raise ValueError(f"'{name}' cannot be a name; use letters, digits and `_`")
    words = config.vocabulary
    taken_names = (words.parameters, words.signals, words.inputs, symbols.DERIVED)
    if name in {*RESERVED, *symbols.AXES}.union(*taken_names) or name.startswith("sigma_"):
        raise ValueError(f"{name} is a reserved name; choose another one")


def formula_names(config: Config, model: Model) -> tuple[str, ...]:
    """Return the names that a formula may contain: those of parameters and quantities."""
    return (*model.parameters, *config.quantities)
