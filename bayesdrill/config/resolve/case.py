"""What a config says, resolved once: the rig, each experiment with its channels and sensors, and the
nominal values.

Loading gives it, and nobody asks the YAML again: `consistency` builds it, and tells what is wrong.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from bayesdrill.config.resolve.channel_noise import Measured
from bayesdrill.config.resolve.quantities import Declared, NominalTable
from bayesdrill.config.resolve.rig import RigNumbers
from bayesdrill.config.resolve.sensors import Entry
from bayesdrill.config.schema.config import Config
from bayesdrill.config.yaml_source import Source
from bayesdrill.inference.priors import Prior
from bayesdrill.inference.unknowns import ParameterSpace, Unknown
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.simulators.sensors import Sensing


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
        found: dict[str, tuple[float | Prior | None, object]] = {
            name: (value, value) for name, value in self.sensors.items()
        }
        for name, level in self.levels.items():
            found[name] = (
                (None, None) if level is None else (level.prior, (level.prior, level.start))
            )
        return found


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
    nominal: NominalTable
    numbers: RigNumbers
    space: ParameterSpace
    channels: tuple[Measured, ...]
    entries: tuple[Entry, ...]
    declared: tuple[Declared, ...]
    sensing: Sensing
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
    def nominal(self) -> NominalTable:
        return self.experiments[0].nominal

    @property
    def held_out(self) -> list[str]:
        """Names of experiments that are no evidence."""
        return [label for label, one in self.config.experiments.items() if one.held_out]

    def experiment(self, label: str) -> ResolvedExperiment:
        return next(one for one in self.experiments if one.label == label)

    def with_settings(self, **changed: Any) -> ResolvedCase:
        """With other sections of what decides no posterior, such as `sampler`."""
        return dataclasses.replace(self, config=self.config.model_copy(update=changed))
