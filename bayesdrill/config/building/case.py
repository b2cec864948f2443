"""Define a resolved config: the rig, and each experiment with channels, sensors, nominal values.

After loading, nothing reads the YAML again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from bayesdrill.basics.symbols import noise_name
from bayesdrill.config.building.channels import build_noise
from bayesdrill.config.building.initial import state_name
from bayesdrill.config.building.nominal import NominalValues
from bayesdrill.config.building.parameters import RigNumbers, joint_space
from bayesdrill.config.building.parsed_numbers import ParsedNumber
from bayesdrill.config.building.sensors import SensorEntry, SensorNumbers
from bayesdrill.config.schema import numbers
from bayesdrill.config.schema.config import Config
from bayesdrill.config.yaml_source import Source
from bayesdrill.inference.noise.contract import NoisyChannel
from bayesdrill.inference.priors import Prior
from bayesdrill.inference.unknowns import ParameterSpace, Unknown, labelled_name
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.simulators.sensors import ObservationModel


@dataclass(frozen=True, slots=True, kw_only=True)
class LocalNumbers:
    """The local numbers of an experiment define sensors, initial state, noise and torque."""

    # None stands for a prior from the record, and for a number with a mistake.
    numbers: Mapping[str, float | Prior | Unknown | None]
    channels: tuple[str, ...]

    @property
    def unknown(self) -> list[str]:
        """Return the names of the numbers that are not fixed."""
        return [name for name, number in self.numbers.items() if not isinstance(number, float)]


def local_numbers(
    config: Config,
    channels: Mapping[str, NoisyChannel | None],
    sensor_numbers: SensorNumbers,
    free: Sequence[str],
    torque: Mapping[str, float | Unknown | None],
) -> LocalNumbers:
    """Return the numbers of the experiment that are not parameters of the rig.

    If a channel has a mistake, only its sigma is listed, and only if the sigma has a prior.
    """
    numbers_: dict[str, float | Prior | Unknown | None]
    numbers_ = {e.symbol.name: None if x is None else x.value for e, x in sensor_numbers.items()}
    numbers_ |= dict.fromkeys(map(state_name, free))
    for name, channel in channels.items():
        if channel is not None:
            noise = build_noise([channel], n_samples=1)
            numbers_ |= {unknown.name: unknown for unknown in noise.unknowns}
        elif isinstance(config.record.channels[name].sigma, numbers.ParameterPrior):
            numbers_[noise_name(name)] = None
    if None not in torque.values():
        numbers_ |= {n: number for n, number in torque.items() if isinstance(number, Unknown)}
    return LocalNumbers(numbers=numbers_, channels=tuple(config.record.channels))


@dataclass(frozen=True, slots=True, kw_only=True)
class ResolvedExperiment:
    """A resolved experiment has a `label`, which is empty if it is the only one."""

    label: str
    config: Config  # as if this experiment were the only one
    source: Source  # the experiment's entries, and the path of the config
    model: Model
    nominal: NominalValues
    rig_numbers: RigNumbers
    channels: tuple[NoisyChannel, ...]  # channels that enter the likelihood
    sensor_numbers: Mapping[SensorEntry, ParsedNumber]  # includes initial states
    sensing: ObservationModel
    constant_inputs: Mapping[str, float]  # in SI
    initial_state: Mapping[str, float]  # the fixed states at the start, in SI
    free_states: tuple[str, ...]  # their initial values have priors from the record
    torque: Mapping[str, float | Unknown]  # size and correlation time of a missing torque
    local_numbers: LocalNumbers

    @property
    def validated(self) -> tuple[Any, Config]:
        """Return the plain data of the entries, and the config that was validated from them."""
        return self.source.data, self.config


@dataclass(frozen=True, slots=True, kw_only=True)
class ResolvedCase:
    """A resolved case is a valid config, with its rig and all its experiments."""

    config: Config  # the config of the first experiment, with the names of all experiments
    source: Source  # the whole file
    experiments: tuple[ResolvedExperiment, ...]

    @property
    def model(self) -> Model:
        """Return the rig, which all experiments share."""
        return self.experiments[0].model

    @property
    def joint_names(self) -> dict[str, dict[str, str]]:
        """Return the name of each parameter in the joint problem, by label and by name.

        The name has the label if the parameter is `own`, is fixed by this experiment, or is
        computed from such parameters.
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
        """Return the parameter space: parameters, quantities, `sensors` (with starts), then `noise`.

        Raises `RelationError`.
        """
        names = self.joint_names
        experiments = [(x.label, x.rig_numbers, names[x.label]) for x in self.experiments]
        return joint_space(experiments, sensors, noise)

    @property
    def held_out(self) -> list[str]:
        """Return the names of experiments that do not enter the likelihood."""
        return [label for label, spec in self.config.experiments.items() if spec.held_out]

    def experiment(self, label: str) -> ResolvedExperiment:
        """Return the experiment of this name."""
        return next(experiment for experiment in self.experiments if experiment.label == label)
