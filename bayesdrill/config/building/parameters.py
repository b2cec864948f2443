"""Build the rig, with the optional physics that the config names, and its parameters."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bayesdrill.basics.entries import LARGEST, SMALLEST, build_member
from bayesdrill.basics.errors import did_you_mean
from bayesdrill.basics.formulas import Expression, RelationError, expression, resolve_relations
from bayesdrill.basics.registry import lookup
from bayesdrill.config import latex
from bayesdrill.config.building.nominal import NominalValues
from bayesdrill.config.building.parsed_numbers import (
    ParsedNumber,
    build_prior,
    is_tied,
    search_start,
)
from bayesdrill.config.building.quantities import formula_names, parse_formula, parse_quantity
from bayesdrill.config.schema import numbers
from bayesdrill.config.schema.config import Config
from bayesdrill.config.schema.numbers import ParameterPrior
from bayesdrill.config.yaml_source import IssueCollector, Location
from bayesdrill.inference.posterior import Formula
from bayesdrill.inference.priors import PRIORS
from bayesdrill.inference.unknowns import RIG_ROLES, ParameterSpace, Role, Unknown
from bayesdrill.rig.models import MODELS
from bayesdrill.rig.models.friction import Named
from bayesdrill.rig.models.linear import (
    Model,
    missing_requirements,
    requirement_text,
    surplus_frictions,
    weak_statics,
    with_all,
    with_named,
)


def build_model(config: Config, extra_names: Collection[str] = ()) -> Model:
    """Return the rig of a config; its parameters and `extra_names` select optional physics."""
    rig = build_member(lookup(MODELS, config.model.name, "model"), config.model)
    names = config.vocabulary.parameters
    named = {name for name in names if config.parameters.get(name) is not None}
    return with_named(rig, {*named, *extra_names})


@dataclass(frozen=True, slots=True, kw_only=True)
class RigNumbers:
    """The rig's numbers are parameters (or their expressions), quantities and derived formulas."""

    parameters: Mapping[str, ParsedNumber | Expression]
    quantities: Mapping[str, ParsedNumber]
    derived: tuple[Formula, ...]
    signed: frozenset[str]  # parameters that may be negative

    @property
    def related(self) -> Mapping[str, Expression]:
        """Return the expressions of parameters that follow from others; raises `RelationError`."""
        related = {n: x for n, x in self.parameters.items() if isinstance(x, Expression)}
        return resolve_relations(related)

    def space(self) -> ParameterSpace:
        """Return the parameter space of this experiment alone; see `ResolvedCase.space`."""
        return joint_space([("", self, {name: name for name in self.parameters})])


def joint_space(
    experiments: Sequence[tuple[str, RigNumbers, Mapping[str, str]]],
    sensors: Sequence[ParsedNumber] = (),
    noise: Sequence[Unknown] = (),
) -> ParameterSpace:
    """Return the joint space of `experiments`, each given as (label, numbers, joint names)."""
    unknowns: list[Unknown] = []
    fixed: dict[str, float] = {}
    relations: dict[str, Expression] = {}
    names: list[str] = []
    signed: set[str] = set()

    def add(number: ParsedNumber) -> None:
        if isinstance(number.value, float):
            fixed[number.name] = number.value
            return
        unknowns.append(
            Unknown(symbol=number.symbol, role=number.role, prior=number.value, start=number.start)
        )

    for name in experiments[0][1].parameters:
        for label, numbers_, joint_names in experiments:
            if (joint := joint_names[name]) in names:
                continue
            names.append(joint)
            signed |= {joint} if name in numbers_.signed else set()
            number = numbers_.parameters[name]
            if isinstance(number, ParsedNumber):
                add(number if joint == name else number.for_experiment(label))
            else:
                relations[joint] = numbers_.related[name].renamed(joint_names)
    for number in experiments[0][1].quantities.values():
        add(number)
    free = {unknown.name for unknown in unknowns}
    for name in [n for n, r in relations.items() if not set(r.names) & free]:
        fixed[name] = float(relations.pop(name).value(fixed))
    for number in sensors:
        add(number)
    return ParameterSpace(
        model=(*names, *(number.name for number in sensors)),
        unknowns=(*sorted(unknowns, key=lambda u: u.role not in RIG_ROLES), *noise),
        fixed=fixed,
        relations=relations,
        signed=frozenset(signed),
    )


TRIED_DRAWS = 4096  # number of prior draws at which formulas are evaluated


def check_rig(
    errors: IssueCollector, config: Config, model: Model, table: NominalValues
) -> RigNumbers | None:
    """Return parameters, quantities and formulas; None if any of them has a mistake."""
    parsed_parameters = dict[str, ParsedNumber | Expression | None]()
    for name in config.vocabulary.parameters:
        location: Location = ("parameters", name)
        if config.parameters.get(name) is None:
            if name in model.parameters:
                nominal = table.values.get(name)
                also = "" if nominal is None else f"`{name}: nominal` ({nominal:g}) or "
                message = f"missing; to hold it write {also}a number"
                errors.add(location, message)
        elif name not in model.parameters:
            errors.add(location, f"the model {model.name} has no {name}; {_removal_hint(name)}")
        else:
            arguments = (config, model, table, name)
            parsed_parameters[name] = errors.run(location, parse_parameter, *arguments)
    _check_added(errors, config, model)
    return _check_relations(errors, config, model, parsed_parameters)


def parse_parameter(
    config: Config, model: Model, table: NominalValues, name: str
) -> ParsedNumber | Expression:
    """Return the number of a parameter, or the expression from which the parameter follows."""
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
        raise ValueError(f"{no_table}, so the prior cannot be relative; give {way_out}")
    keeps_sign = symbol.unit != "rad" and spec.numbers.get("mean", 0.0) > 0.0  # e.g. friction
    families = PRIORS if keeps_sign and spec.family == "normal" else spec.families
    built, upper_limit = build_prior(spec, value, families), symbol.at_most
    if built.high > upper_limit:
        reaches = "has no end" if math.isinf(built.high) else f"goes up to {built.high:.6g}"
        example = f"such as {{prior: uniform, low: {0.5 * upper_limit:g}, high: {upper_limit:g}}}"
        above = f"the prior {reaches}, and {name} is at most {upper_limit:g}"
        raise ValueError(f"{above}; let it end, {example}")
    begin = search_start(spec, built, table.compared.get(name))
    role: Role = "offset" if symbol.signed and built.low < 0 else "rig"
    return ParsedNumber(symbol=symbol, role=role, value=built, start=begin)


def parse_relation(config: Config, model: Model, name: str) -> Expression | None:
    """Return the expression that gives parameter `name`; None for a value or a prior."""
    entry, known_names = config.parameters.get(name), formula_names(config, model)
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


def _removal_hint(name: str) -> str:
    """Return advice on a parameter that the rig lacks: remove it, or take another rig."""
    rigs = {n: with_all(kind()) for n, kind in MODELS.usable().items()}
    having = [n for n, rig in rigs.items() if name in rig.parameters]
    return f"remove it, or take model.name: {' or '.join(having)}" if having else "remove it"


def _check_added(errors: IssueCollector, config: Config, model: Model) -> None:
    """Check that optional parts of the rig are complete, and that no entry names a missing part."""
    reported: set[str] = set()
    for name, missing in missing_requirements(model).items():
        if name not in reported:
            errors.add(("parameters", name), requirement_text(name, missing))
        reported |= {*model.offers[name]}
    for section in ("nominal", "simulation"):
        given = getattr(config, section) or {}
        for name in config.vocabulary.parameters:
            if name not in model.parameters and given.get(name) is not None:
                why = f"{name} is not of the model {model.name}; remove this"
                if name in model.offers:
                    why = f"{name} is not named in `parameters:`; name it there, or remove this"
                errors.add((section, name), why)


def _check_relations(
    errors: IssueCollector,
    config: Config,
    model: Model,
    parsed_parameters: Mapping[str, ParsedNumber | Expression | None],
) -> RigNumbers | None:
    before = len(errors.issues)
    quantities_, derived = dict[str, ParsedNumber](), list[Formula]()
    for name, spec in config.quantities.items():
        number = errors.run(("quantities", name), parse_quantity, config, name, spec)
        if number is not None:
            quantities_[name] = number
            if getattr(spec, "latex", None) is not None:
                errors.run(("quantities", name, "latex"), latex.check, number.symbol)
    for name, formula in config.derived.items():
        arguments = (config, model, name, errors.source.labels)
        parsed = errors.run(("derived", name), parse_formula, *arguments)
        if parsed is not None:
            derived.append(parsed)
            if formula.latex is not None:
                errors.run(("derived", name, "latex"), latex.check, parsed.symbol)
    tied = [name for name in parsed_parameters if is_tied(config.parameters.get(name))]
    related = {name: x for name, x in parsed_parameters.items() if isinstance(x, Expression)}
    wrong = any(parsed_parameters[name] is None for name in tied) or len(errors.issues) > before
    if wrong or not {*model.parameters} <= {*parsed_parameters}:
        return None
    parameters = {n: x for n in model.parameters if (x := parsed_parameters[n]) is not None}
    if len(parameters) < len(model.parameters):  # this mistake was reported before
        return None
    rig = RigNumbers(
        parameters=parameters,
        quantities=quantities_,
        derived=tuple(derived),
        signed=frozenset(n for n in parameters if model.symbols[n].signed),
    )
    try:
        if not errors.source.labels:
            check_used(errors, config, [rig])
        space = rig.space()
    except RelationError as error:
        errors.add(("parameters", error.name), str(error))
        return None
    named = _check_values(errors, config, space, related)
    errors.add_all(("parameters",), weak_statics(model, named))
    errors.add_all(("parameters",), surplus_frictions(model, free_parameters(config, parameters)))
    return rig


def check_used(errors: IssueCollector, config: Config, each: Iterable[RigNumbers]) -> set[str]:
    """Check that each quantity is in a formula; return the names in formulas of parameters."""
    every = [*each]
    used = {name for rig in every for x in rig.related.values() for name in x.names}
    others = {name for rig in every for formula in rig.derived for name in formula.expression.names}
    for name in [n for n in config.quantities if n not in used | others]:
        message = "no formula names it; use it in `parameters:` or `derived:`, or remove it"
        errors.add(("quantities", name), message)
    return used


def _check_values(
    errors: IssueCollector, config: Config, space: ParameterSpace, related: Mapping[str, Expression]
) -> Named:
    """Check the ranges of computed parameters at draws from the priors; return all values."""
    theta = space.draw(TRIED_DRAWS, np.random.default_rng(0)) if space.free else np.ones((1, 0))
    named = space.named(theta)
    for name, relation in related.items():
        values = np.broadcast_to(named[name], len(theta))
        upper_limit = min(LARGEST, config.vocabulary.parameters[name].at_most)
        good, wanted = (values >= SMALLEST) & (values <= upper_limit), "positive (and"
        if config.vocabulary.parameters[name].signed:
            good, wanted = np.abs(values) <= upper_limit, "finite (in size"
        if not good.all():
            k = int(np.argmin(good))
            errors.add(
                ("parameters", name),
                f"'{relation.text}' is {values[k]:.3g} at {100 * np.mean(~good):.3g} % of what the "
                f"priors allow, and must be {wanted} at most {upper_limit:g}); correct the "
                "formula or narrow the priors",
            )
    return named


def free_parameters(config: Config, names: Iterable[str]) -> list[str]:
    """Return the `names` of parameters that have a prior."""
    parameters = config.parameters
    return [name for name in names if isinstance(parameters.get(name), numbers.ParameterPrior)]
