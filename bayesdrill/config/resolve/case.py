"""What a config says, resolved once: the rig, each experiment with its channels and sensors, and the
nominal values.

Loading gives it, and nobody asks the YAML again: `consistency` builds it, and tells what is wrong.
The steps raise `ValueError` with a message for the user.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from bayesdrill.basics.entries import build_member
from bayesdrill.basics.formulas import Expression, resolve_relations
from bayesdrill.basics.registry import lookup
from bayesdrill.config.resolve import quantities
from bayesdrill.config.resolve.quantities import DeclaredNumber, ResolvedTable
from bayesdrill.config.resolve.sensors import NoiseSettings, SensorEntry
from bayesdrill.config.schema import numbers
from bayesdrill.config.schema.config import Config
from bayesdrill.config.yaml_source import Source
from bayesdrill.inference.posterior import Formula
from bayesdrill.inference.priors import Prior
from bayesdrill.inference.unknowns import ParameterSpace, Unknown, of_label
from bayesdrill.rig import models
from bayesdrill.rig.models import MODELS
from bayesdrill.rig.models.linear import Model, with_named
from bayesdrill.rig.simulators.sensors import ObservationModel


def model(config: Config, more: Collection[str] = ()) -> Model:
    """With the constants that the config gives, as far as the model has them, and with what it offers of
    the parameters that the config names, or that are `more`.
    """
    rig = build_member(lookup(MODELS, config.model.name, "model"), config.model)
    named = {name for name, spec in config.parameters.items() if spec is not None}
    return with_named(rig, {*named, *more})


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


@dataclass(frozen=True, slots=True, kw_only=True)
class RigNumbers:
    """Numbers of the rig's `parameters`, in the model's order, or by what they follow from others, of
    quantities, and what is derived of them.
    """

    parameters: Mapping[str, DeclaredNumber | Expression]
    quantities: Mapping[str, DeclaredNumber]
    derived: tuple[Formula, ...]

    def space(
        self,
        local: Sequence[str] = (),
        labels: Sequence[str] = (),
        sensors: Sequence[DeclaredNumber] = (),
        noise: Sequence[Unknown] = (),
    ) -> ParameterSpace:
        """Return the unknowns: free parameters, quantities, those of `sensors` and starts, then `noise`.

        A parameter that is `local` is there once for each of the `labels`.  Raises `RelationError`.
        """
        unknowns: list[Unknown] = []
        fixed: dict[str, float] = {}
        names: list[str] = []

        def add(number: DeclaredNumber, several: Sequence[str] = ("",)) -> None:
            if isinstance(number.value, float):
                fixed[number.name] = number.value
                return
            unknown = Unknown(
                symbol=number.symbol, role=number.role, prior=number.value, start=number.start
            )
            unknowns.extend(unknown.of(label) for label in several)

        for name, number in self.parameters.items():
            several = labels if name in local else [""]
            names += [of_label(name, label) for label in several]
            if isinstance(number, DeclaredNumber):
                add(number, several)
        for number in self.quantities.values():
            add(number)
        free = {unknown.name for unknown in unknowns}
        parameters = self.parameters.items()
        relations = resolve_relations(
            {name: x for name, x in parameters if isinstance(x, Expression)}
        )
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
class Beside:
    """What an experiment has beside the rig, by the names that it gives: numbers of its `sensors` and
    its start, held or with a prior, None where the record gives one or there is a mistake; unknown
    `levels` of its noise, None with a mistake; names of its `channels`.
    """

    sensors: Mapping[str, float | Prior | None]
    levels: Mapping[str, Unknown | None]
    channels: tuple[str, ...]

    @property
    def unknown(self) -> dict[str, tuple[Prior | None, object]]:
        """Without what is held: a prior, and with it what is the same where it is shared."""
        return {name: (x, what) for name, (x, what) in self.all.items() if not isinstance(x, float)}

    @property
    def all(self) -> dict[str, tuple[float | Prior | None, object]]:
        values: dict[str, tuple[float | Prior | None, object]] = {}
        for name, value in self.sensors.items():
            values[name] = value, value
        for name, level in self.levels.items():
            values[name] = (level.prior, (level.prior, level.start)) if level else (None, None)
        return values


@dataclass(frozen=True, slots=True, kw_only=True)
class ResolvedExperiment:
    """One experiment; `label` is its name, empty where there is only one.

    `config`: what it reads as if it were alone, whose paths start at `source`; `numbers`: of the rig,
    and the `space` that they alone make; `channels`: those that are evidence; `entries` of sensors and
    start, and what each is as `declared`; `free`: states of the start whose priors the record gives;
    `torque`: size and time of the missing one, where there is one.
    """

    label: str
    config: Config
    source: Source
    model: Model
    nominal: ResolvedTable
    numbers: RigNumbers
    space: ParameterSpace
    channels: tuple[NoiseSettings, ...]
    entries: tuple[SensorEntry, ...]
    declared: tuple[DeclaredNumber, ...]
    sensing: ObservationModel
    free: tuple[str, ...]
    torque: Mapping[str, float | Unknown]
    beside: Beside


@dataclass(frozen=True, slots=True, kw_only=True)
class ResolvedCase:
    """A config that is right: all that it says of the rig and of each experiment.

    `config`: that of the first experiment, which names them all; `source`: the file as it is written.
    """

    config: Config
    source: Source
    experiments: tuple[ResolvedExperiment, ...]

    @property
    def model(self) -> Model:
        """The rig, which all experiments share."""
        return self.experiments[0].model

    @property
    def nominal(self) -> ResolvedTable:
        return self.experiments[0].nominal

    @property
    def held_out(self) -> list[str]:
        """Names of experiments that are no evidence."""
        return [
            label for label, experiment in self.config.experiments.items() if experiment.held_out
        ]

    def experiment(self, label: str) -> ResolvedExperiment:
        return next(experiment for experiment in self.experiments if experiment.label == label)

    def with_settings(self, **changed: Any) -> ResolvedCase:
        """With other sections of what decides no posterior, such as `sampler`."""
        return dataclasses.replace(self, config=self.config.model_copy(update=changed))
