"""Hold a resolved config: the rig, and each experiment with channels, sensors and nominal values.

After loading, nothing reads the YAML again. The numbers of the rig are built here, and mistakes in
them are reported at their entries.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayesdrill.basics.entries import LARGEST, SMALLEST, build_member
from bayesdrill.basics.formulas import Expression, RelationError, resolve_relations
from bayesdrill.basics.registry import lookup
from bayesdrill.config import latex
from bayesdrill.config.resolve import quantities, sensors
from bayesdrill.config.resolve.quantities import NominalValues, ParsedNumber
from bayesdrill.config.resolve.sensors import SensorEntry
from bayesdrill.config.schema import numbers
from bayesdrill.config.schema.config import Config
from bayesdrill.config.yaml_source import IssueCollector, Location, Source
from bayesdrill.inference.noise.contract import NoisyChannel
from bayesdrill.inference.posterior import Formula
from bayesdrill.inference.priors import Prior
from bayesdrill.inference.unknowns import ParameterSpace, Unknown, labelled_name
from bayesdrill.rig.models import MODELS
from bayesdrill.rig.models.friction import Named
from bayesdrill.rig.models.linear import (
    Model,
    missing_requirements,
    requirement_text,
    weak_statics,
    with_all,
    with_named,
)
from bayesdrill.rig.simulators.sensors import ObservationModel


def build_model(config: Config, extra_names: Collection[str] = ()) -> Model:
    """Return the rig of a config, with the optional physics in its parameters or `extra_names`."""
    rig = build_member(lookup(MODELS, config.model.name, "model"), config.model)
    names = config.vocabulary.parameters
    named = {name for name in names if config.parameters.get(name) is not None}
    return with_named(rig, {*named, *extra_names})


def initial_state(config: Config, model: Model) -> dict[str, float]:
    """Return the fixed initial states, in SI; with a steady start only those that are named."""
    initial = config.initial
    entries = {name: initial.get(name) for name in model.outer}
    return {
        name: quantities.to_si(value, model.symbols[name].unit)
        for name, value in entries.items()
        if isinstance(value, float | int | numbers.Quantity)
        and (initial.state != "steady" or name in initial.model_fields_set)
    }


@dataclass(frozen=True, slots=True, kw_only=True)
class RigNumbers:
    """The rig's numbers are parameters, or the expressions they follow from, quantities and formulas."""

    parameters: Mapping[str, ParsedNumber | Expression]
    quantities: Mapping[str, ParsedNumber]
    derived: tuple[Formula, ...]

    @property
    def related(self) -> Mapping[str, Expression]:
        """Return the expressions of related parameters in terms of others; raises `RelationError`."""
        related = {n: x for n, x in self.parameters.items() if isinstance(x, Expression)}
        return resolve_relations(related)

    def space(self) -> ParameterSpace:
        """Return the unknowns of one experiment alone; see `ResolvedCase.space`."""
        return _space([("", self, {name: name for name in self.parameters})])


def _space(
    experiments: Sequence[tuple[str, RigNumbers, Mapping[str, str]]],
    sensors: Sequence[ParsedNumber] = (),
    noise: Sequence[Unknown] = (),
) -> ParameterSpace:
    """Return the joint space of `experiments`: for each its label, numbers and names among all."""
    unknowns: list[Unknown] = []
    fixed: dict[str, float] = {}
    relations: dict[str, Expression] = {}
    names: list[str] = []

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
        unknowns=(*unknowns, *noise),
        fixed=fixed,
        relations=relations,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class LocalNumbers:
    """The local numbers of an experiment are those of sensors, start, noise and torque, by name."""

    # None stands for a prior that the record gives, and for a number with a mistake.
    numbers: Mapping[str, float | Prior | Unknown | None]
    channels: tuple[str, ...]

    @property
    def unknown(self) -> list[str]:
        """Return the names of the numbers that are not fixed."""
        return [name for name, number in self.numbers.items() if not isinstance(number, float)]


@dataclass(frozen=True, slots=True, kw_only=True)
class ResolvedExperiment:
    """A resolved experiment has a `label`, which is empty if it is the only one."""

    label: str
    config: Config  # its own, as if it were the only one
    source: Source  # its entries, and the path from which relative paths start
    model: Model
    nominal: NominalValues
    rig_numbers: RigNumbers
    channels: tuple[NoisyChannel, ...]  # those that are evidence
    sensor_numbers: Mapping[SensorEntry, ParsedNumber]  # those of the start too
    sensing: ObservationModel
    free_states: tuple[str, ...]  # their initial values have priors from the record
    torque: Mapping[str, float | Unknown]  # size and time of a missing torque
    local_numbers: LocalNumbers

    @property
    def validated(self) -> tuple[Any, Config]:
        """Return the plain data of its entries, and the config that was made of them."""
        return self.source.data, self.config


@dataclass(frozen=True, slots=True, kw_only=True)
class ResolvedCase:
    """A resolved case is a valid config, with its rig and all its experiments."""

    config: Config  # that of the first experiment, with the names of all
    source: Source  # the whole file
    experiments: tuple[ResolvedExperiment, ...]

    @property
    def model(self) -> Model:
        """Return the rig, which all experiments share."""
        return self.experiments[0].model

    @property
    def joint_names(self) -> dict[str, dict[str, str]]:
        """Return, by label, the joint name of each parameter of an experiment.

        A parameter has the label if it is `own`, held by this experiment, or follows from such ones.
        """
        names = {}
        for each in self.experiments:
            label, numbers_, spec = each.label, each.rig_numbers, self.config.experiments
            local = {*self.config.own, *(spec[label].parameters if label else ())}
            local |= {name for name, x in numbers_.related.items() if local & {*x.names}}
            parameters = numbers_.parameters
            names[label] = {n: labelled_name(n, label if n in local else "") for n in parameters}
        return names

    def space(
        self, sensors: Sequence[ParsedNumber] = (), noise: Sequence[Unknown] = ()
    ) -> ParameterSpace:
        """Return the unknowns: parameters, quantities, numbers of `sensors` and starts, then `noise`.

        Raises `RelationError`.
        """
        names = self.joint_names
        experiments = [(x.label, x.rig_numbers, names[x.label]) for x in self.experiments]
        return _space(experiments, sensors, noise)

    @property
    def held_out(self) -> list[str]:
        """Return the names of experiments that are no evidence."""
        return [label for label, spec in self.config.experiments.items() if spec.held_out]

    def experiment(self, label: str) -> ResolvedExperiment:
        """Return the experiment of this name."""
        return next(experiment for experiment in self.experiments if experiment.label == label)


TRIED_DRAWS = 4096  # draws from the priors at which formulas are evaluated


def check_nominal(errors: IssueCollector, config: Config, model: Model) -> dict[str, float]:
    """Return the nominal values in the config, in SI and at their own sides of the gear."""
    values = {
        name: errors.run(("nominal", name), quantities.nominal_value, config, model, name)
        for name in config.vocabulary.parameters
        if config.nominal.get(name) is not None
    }
    return {name: value for name, value in values.items() if value is not None}


def check_torque(
    errors: IssueCollector, config: Config, model: Model, sensing: ObservationModel | None
) -> dict[str, float | Unknown | None]:
    """Return size and time of the missing torque; the inertia on which it acts must exist."""
    acts = sensors.latent_torque(config)
    if acts is None:
        return {}
    if sensing is not None:
        errors.run(("missing_torque",), sensors.check_latent_torque, model, acts, sensing)
    return {
        name: errors.run(("missing_torque", entry), sensors.latent_torque_number, config, name)
        for name, entry in sensors.TORQUE_ENTRIES.items()
    }


def check_rig(
    errors: IssueCollector, config: Config, model: Model, table: NominalValues
) -> RigNumbers | None:
    """Return parameters, quantities and formulas; None if one has a mistake."""
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
            parsed_parameters[name] = errors.run(location, quantities.parse_parameter, *arguments)
    _check_added(errors, config, model)
    return _check_relations(errors, config, model, parsed_parameters)


def _removal_hint(name: str) -> str:
    """Return the advice for a parameter that the rig lacks: remove it, or take a rig that has it."""
    rigs = {n: with_all(kind()) for n, kind in MODELS.usable().items()}
    having = [n for n, rig in rigs.items() if name in rig.parameters]
    return f"remove it, or take model.name: {' or '.join(having)}" if having else "remove it"


def _check_added(errors: IssueCollector, config: Config, model: Model) -> None:
    """Check that optional parts of the rig are complete, and that no entry names parts it lacks."""
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
        number = errors.run(("quantities", name), quantities.parse_quantity, config, name, spec)
        if number is not None:
            quantities_[name] = number
            if getattr(spec, "latex", None) is not None:
                errors.run(("quantities", name, "latex"), latex.check, number.symbol)
    for name, formula in config.derived.items():
        arguments = (config, model, name, errors.source.labels)
        parsed = errors.run(("derived", name), quantities.parse_formula, *arguments)
        if parsed is not None:
            derived.append(parsed)
            if formula.latex is not None:
                errors.run(("derived", name, "latex"), latex.check, parsed.symbol)
    tied = [name for name in parsed_parameters if quantities.is_tied(config.parameters.get(name))]
    related = {name: x for name, x in parsed_parameters.items() if isinstance(x, Expression)}
    wrong = any(parsed_parameters[name] is None for name in tied) or len(errors.issues) > before
    if wrong or not {*model.parameters} <= {*parsed_parameters}:
        return None
    parameters = {n: x for n in model.parameters if (x := parsed_parameters[n]) is not None}
    if len(parameters) < len(model.parameters):  # a mistake that was reported already
        return None
    rig = RigNumbers(parameters=parameters, quantities=quantities_, derived=tuple(derived))
    try:
        if not errors.source.labels:
            check_used(errors, config, [rig])
        space = rig.space()
    except RelationError as error:
        errors.add(("parameters", error.name), str(error))
        return None
    named = _check_values(errors, config, space, related)
    errors.add_all(("parameters",), weak_statics(model, named))
    return rig


def check_used(errors: IssueCollector, config: Config, each: Iterable[RigNumbers]) -> set[str]:
    """Check that a formula uses each quantity; return the names in formulas of parameters."""
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
    """Check that computed parameters are positive wherever the priors lead; return all values."""
    theta = space.draw(TRIED_DRAWS, np.random.default_rng(0)) if space.free else np.ones((1, 0))
    named = space.named(theta)
    for name, relation in related.items():
        values = np.broadcast_to(named[name], len(theta))
        upper_limit = min(LARGEST, config.vocabulary.parameters[name].at_most)
        good = (values >= SMALLEST) & (values <= upper_limit)
        if not good.all():
            k = int(np.argmin(good))
            errors.add(
                ("parameters", name),
                f"'{relation.text}' is {values[k]:.3g} at {100 * np.mean(~good):.3g} % of what the "
                f"priors allow, and must be positive (and at most {upper_limit:g}); mend the "
                "formula or narrow the priors",
            )
    return named


def free_parameters(config: Config, names: Iterable[str]) -> list[str]:
    """Return those of `names` that have a prior."""
    parameters = config.parameters
    return [name for name in names if isinstance(parameters.get(name), numbers.ParameterPrior)]
