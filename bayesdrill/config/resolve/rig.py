"""The rig of a config: its model, its nominal values, and the space of its unknowns.

The steps raise `ValueError` with a message for the user.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from bayesdrill.basics import symbols
from bayesdrill.basics.entries import made
from bayesdrill.basics.formulas import Expression, resolved
from bayesdrill.basics.registry import lookup
from bayesdrill.config.resolve import quantities
from bayesdrill.config.resolve.quantities import prior, quantity, relation, start
from bayesdrill.config.resolve.sensors import Declared
from bayesdrill.config.schema import numbers
from bayesdrill.config.schema.config import Config
from bayesdrill.inference.unknowns import ParameterSpace, Unknown, of_label
from bayesdrill.rig import models
from bayesdrill.rig.models import MODELS
from bayesdrill.rig.models.composed import with_named
from bayesdrill.rig.models.linear import Model


def model(config: Config, more: Collection[str] = ()) -> Model:
    """With the constants that the config gives, as far as the model has them, and with what it offers of
    the parameters that the config names, or that are `more`.
    """
    rig = made(lookup(MODELS, config.model.name, "model"), config.model)
    given = config.parameters.items()
    named = [name for name, spec in given if spec is not None]
    return with_named(rig, {*named, *more})


@dataclass(frozen=True, slots=True, kw_only=True)
class NominalTable:
    """Nominal `values` of parameters: those of a table, unless the config says otherwise.

    `compared`: those that are this rig's, all of a table that the config names or relies on; where it
    has values of its own, or no use for a table, the table speaks of another rig.  `published`: names
    of these whose value is that of a table; `tolerance`: relative, of all parameters; `name`: what the
    values are called in sentences.
    """

    values: Mapping[str, float]
    compared: Mapping[str, float]
    published: tuple[str, ...]
    tolerance: Mapping[str, float]
    name: str


def nominal_table(config: Config) -> NominalTable:
    """Raises `ValueError` where there is no such table."""
    given: Any = config.nominal
    table = given.table or symbols.DEFAULT_NOMINAL
    own = {name: x for name in models.PARAMETERS if (x := getattr(given, name)) is not None}
    values = {**lookup(symbols.NOMINAL, table, "nominal table").values, **own}
    used = {name for name in values if quantities.is_nominal(config.parameters.get(name))}
    compared = values
    if given.table is None and (own or not used):
        compared = {name: value for name, value in values.items() if name in own.keys() | used}
    published = tuple(name for name in compared if name not in own)
    called = f"{table} ({', '.join(n for n in compared if n in own)} as in the config)"
    return NominalTable(
        values=values,
        compared=compared,
        published=published,
        tolerance=_tolerance(given.tolerance),
        name=(called if published else "the config's nominal values") if own else table,
    )


def _tolerance(given: Any) -> dict[str, float]:
    """`given`: one number, or by symbol and `default`."""
    if isinstance(given, float):
        return dict.fromkeys(models.PARAMETERS, given)
    own = {name: getattr(given, name) for name in models.PARAMETERS}
    return {name: given.default if value is None else value for name, value in own.items()}


def initial_state(config: Config, model: Model) -> dict[str, float]:
    """What is held of it, SI; of a steady start only what is named."""
    initial = config.initial
    given = {name: getattr(initial, name) for name in model.outer}
    return {
        name: quantities.si(value, models.STATES[name].unit)
        for name, value in given.items()
        if isinstance(value, float | int | numbers.Quantity)
        and (initial.state != "steady" or name in initial.model_fields_set)
    }


def space(
    config: Config,
    model: Model,
    table: NominalTable,
    noise: Sequence[Unknown] = (),
    told: Sequence[Declared] = (),
    labels: Sequence[str] = (),
) -> ParameterSpace:
    """The unknowns: free parameters in the model's order, quantities, sensors and starts as they are
    `told`, then those of the `noise`.  What is `own` is there once for each of the `labels`.
    """
    unknowns: list[Unknown] = []
    fixed: dict[str, float] = {}
    relations: dict[str, Expression] = {}
    for name in model.parameters:
        spec = config.parameters.get(name)
        related = relation(config, model, name)
        if related is not None:
            relations[name] = related
        elif isinstance(spec, numbers.ParameterPrior):
            built = prior(spec, table.values.get(name))
            begin = start(spec, built, table.compared.get(name))
            one = Unknown(symbol=models.PARAMETERS[name], role="rig", prior=built, start=begin)
            several = labels if name in config.own else [""]
            unknowns += [one.of(label) for label in several]
        elif isinstance(spec, float | int):
            fixed[name] = float(spec)
        elif name in table.values:
            fixed[name] = table.values[name]
        else:
            raise ValueError(f"no table has {name}")
    for name, given in ((n, quantity(n, spec)) for n, spec in config.quantities.items()):
        if isinstance(given.value, float):
            fixed[name] = given.value
        else:
            symbol, own = given.symbol, given.value
            unknowns.append(Unknown(symbol=symbol, role="quantity", prior=own, start=given.start))
    relations, free = resolved(relations), {unknown.name for unknown in unknowns}
    for name in [n for n, r in relations.items() if not set(r.names) & free]:
        fixed[name] = float(relations.pop(name).value(fixed))
    for each in told:
        if isinstance(each.value, float):
            fixed[each.name] = each.value
        else:
            unknowns.append(
                Unknown(symbol=each.symbol, role=each.role, prior=each.value, start=each.start)
            )
    rig = [n for n in dict.fromkeys(local_names(config, model, labels)) if n]
    return ParameterSpace(
        model=(*rig, *(each.name for each in told)),
        unknowns=(*unknowns, *noise),
        fixed=fixed,
        relations=relations,
    )


def local_names(config: Config, model: Model, labels: Sequence[str]) -> list[str]:
    """Of the rig's parameters, what is own once for each label."""
    return [
        of_label(name, label)
        for name in model.parameters
        for label in (labels if name in config.own else [""])
    ]
