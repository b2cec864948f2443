"""A config, resolved once: the rig, each experiment with channels and sensors, nominal values.

Loading gives it, and nobody asks the YAML again: `consistency` builds it, and reports what is
wrong. The steps raise `ValueError` with a message for the user.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from bayesdrill.basics.entries import build_member
from bayesdrill.basics.formulas import Expression, resolve_relations
from bayesdrill.basics.registry import lookup
from bayesdrill.config.resolve import quantities
from bayesdrill.config.resolve.quantities import NominalValues, ParsedNumber
from bayesdrill.config.resolve.sensors import SensorEntry
from bayesdrill.config.schema import numbers
from bayesdrill.config.schema.config import Config
from bayesdrill.config.yaml_source import Source
from bayesdrill.inference.noise.contract import NoisyChannel
from bayesdrill.inference.posterior import Formula
from bayesdrill.inference.priors import Prior
from bayesdrill.inference.unknowns import ParameterSpace, Unknown, labelled_name
from bayesdrill.rig.models import MODELS
from bayesdrill.rig.models.linear import Model, with_named
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
