"""A config, resolved once: the rig, each experiment with channels and sensors, nominal values.

Loading gives it, and nobody asks the YAML again. The numbers of the rig are built here; what is
wrong with one is filed at its entry.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

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
    """Return the rig of a config, with what it offers of names there or of `extra_names`."""
    rig = build_member(lookup(MODELS, config.model.name, "model"), config.model)
    named = {name for name, spec in config.parameters.items() if spec is not None}
    return with_named(rig, {*named, *extra_names})


def initial_state(config: Config, model: Model) -> dict[str, float]:
    """Return what is fixed of the initial state, SI; of a steady start only what is named."""
    initial = config.initial
    entries = {name: getattr(initial, name) for name in model.outer}
    return {
        name: quantities.to_si(value, model.symbols[name].unit)
        for name, value in entries.items()
        if isinstance(value, float | int | numbers.Quantity)
        and (initial.state != "steady" or name in initial.model_fields_set)
    }


@dataclass(frozen=True, slots=True, kw_only=True)
class RigNumbers:
    """Numbers of the rig: parameters in the model's order, expressions where others give them."""

    parameters: Mapping[str, ParsedNumber | Expression]
    quantities: Mapping[str, ParsedNumber]
    derived: tuple[Formula, ...]

    @property
    def related(self) -> Mapping[str, Expression]:
        """Return what parameters follow from, in names of others; raises `RelationError`."""
        related = {n: x for n, x in self.parameters.items() if isinstance(x, Expression)}
        return resolve_relations(related)

    def space(self) -> ParameterSpace:
        """Return the unknowns of one experiment alone; see `ResolvedCase.space`."""
        return _space([("", self, {name: name for name in self.parameters})])


def _space(
    each: Sequence[tuple[str, RigNumbers, Mapping[str, str]]],
    sensors: Sequence[ParsedNumber] = (),
    noise: Sequence[Unknown] = (),
) -> ParameterSpace:
    """`each`: label, numbers and what its parameters are called among all."""
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

    for name in each[0][1].parameters:
        for label, numbers_, called in each:
            if (joint := called[name]) in names:
                continue
            names.append(joint)
            number = numbers_.parameters[name]
            if isinstance(number, ParsedNumber):
                add(number if joint == name else number.for_experiment(label))
            else:
                relations[joint] = numbers_.related[name].renamed(called)
    for number in each[0][1].quantities.values():
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
    """What an experiment has beside the rig, by the names that it gives; None with a mistake."""

    # Of sensors and the start, None also of what records give; then unknowns of noise and torque.
    numbers: Mapping[str, float | Prior | Unknown | None]
    channels: tuple[str, ...]

    @property
    def unknown(self) -> list[str]:
        """Return the names of those that are not fixed."""
        return [name for name, number in self.numbers.items() if not isinstance(number, float)]


@dataclass(frozen=True, slots=True, kw_only=True)
class ResolvedExperiment:
    """One experiment; `label` is its name, empty where there is only one."""

    label: str
    config: Config  # what it reads as if it were alone
    source: Source  # at which its paths start
    model: Model
    nominal: NominalValues
    rig_numbers: RigNumbers
    channels: tuple[NoisyChannel, ...]  # those that are evidence
    sensor_numbers: Mapping[SensorEntry, ParsedNumber]  # of sensors and start
    sensing: ObservationModel
    free_states: tuple[str, ...]  # of the start, whose priors the record gives
    torque: Mapping[str, float | Unknown]  # size and time of the missing one, where there is one
    local_numbers: LocalNumbers


@dataclass(frozen=True, slots=True, kw_only=True)
class ResolvedCase:
    """A config that is right: all that it says of the rig and of each experiment."""

    config: Config  # that of the first experiment, which names them all
    source: Source  # the file as it is written
    experiments: tuple[ResolvedExperiment, ...]

    @property
    def model(self) -> Model:
        """Return the rig, which all experiments share."""
        return self.experiments[0].model

    @property
    def called(self) -> dict[str, dict[str, str]]:
        """Return by label what parameters of an experiment are called among those of all.

        What is its own, or held by it alone, and what follows from that, has its label.
        """
        called = {}
        for each in self.experiments:
            label, numbers_, spec = each.label, each.rig_numbers, self.config.experiments
            local = {*self.config.own, *(spec[label].parameters if label else ())}
            local |= {name for name, x in numbers_.related.items() if local & {*x.names}}
            names = {n: labelled_name(n, label if n in local else "") for n in numbers_.parameters}
            called[label] = names
        return called

    def space(
        self, sensors: Sequence[ParsedNumber] = (), noise: Sequence[Unknown] = ()
    ) -> ParameterSpace:
        """Return the unknowns: free parameters, quantities, those of `sensors` and starts, then `noise`.

        Raises `RelationError`.
        """
        called = self.called
        each = [(x.label, x.rig_numbers, called[x.label]) for x in self.experiments]
        return _space(each, sensors, noise)

    @property
    def held_out(self) -> list[str]:
        """Return the names of experiments that are no evidence."""
        return [label for label, spec in self.config.experiments.items() if spec.held_out]

    def experiment(self, label: str) -> ResolvedExperiment:
        """Return the experiment of this name."""
        return next(experiment for experiment in self.experiments if experiment.label == label)


# The numbers of the rig are built, and every mistake in them is filed at its entry.

TRIED_DRAWS = 4096  # from the priors, at which formulas are tried


def check_nominal(errors: IssueCollector, config: Config, model: Model) -> dict[str, float]:
    """Return the values of the config's own table, SI, at their own sides of the gear."""
    values = {
        name: errors.run(("nominal", name), quantities.nominal_value, config, model, name)
        for name in config.vocabulary.parameters
        if getattr(config.nominal, name) is not None
    }
    return {name: value for name, value in values.items() if value is not None}


def check_torque(
    errors: IssueCollector, config: Config, model: Model, sensing: ObservationModel | None
) -> dict[str, float | Unknown | None]:
    """Return size and time of the missing torque; it needs an inertia to act on."""
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
    """Return parameters, quantities and formulas; None with a mistake."""
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
    """Return what to do about a parameter that only other models have, or none."""
    rigs = {n: with_all(kind()) for n, kind in MODELS.usable().items()}
    having = [n for n, rig in rigs.items() if name in rig.parameters]
    return f"remove it, or take model.name: {' or '.join(having)}" if having else "remove it"


def _check_added(errors: IssueCollector, config: Config, model: Model) -> None:
    """Check that parts of the rig that are named are complete, and that no entry is of other parts."""
    reported: set[str] = set()
    for name, missing in missing_requirements(model).items():
        if name not in reported:
            errors.add(("parameters", name), requirement_text(name, missing))
        reported |= {*model.offers[name]}
    for section in ("nominal", "simulation"):
        section_spec = getattr(config, section)
        for name in config.vocabulary.parameters:
            if name not in model.parameters and getattr(section_spec, name, None) is not None:
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
    tied = [name for name in parsed_parameters if quantities.is_tied(config.parameters[name])]
    related = {name: x for name, x in parsed_parameters.items() if isinstance(x, Expression)}
    wrong = any(parsed_parameters[name] is None for name in tied) or len(errors.issues) > before
    if wrong or not {*model.parameters} <= {*parsed_parameters}:
        return None
    parameters = {n: x for n in model.parameters if (x := parsed_parameters[n]) is not None}
    if len(parameters) < len(model.parameters):  # a prior or a start, said already
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
    """Check that a formula names each quantity; return what formulas of parameters name."""
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
