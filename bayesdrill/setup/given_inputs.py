"""What a config gives of the rig's inputs: by which entry, in which unit, measured or constant."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from bayesdrill.basics import symbols
from bayesdrill.record import angles
from bayesdrill.record.experiment import Experiment
from bayesdrill.rig.models.linear import Model
from bayesdrill.setup.config import Config
from bayesdrill.setup.number_objects import si
from bayesdrill.setup.record_entries import InputColumn

Array = NDArray[np.float64]

# Inputs that are speeds, and the entries that give the angle instead.
IMPOSED: Mapping[str, str] = MappingProxyType({"w_2": "theta_2"})
ENTRIES = (*symbols.INPUTS, *IMPOSED.values())


def entry(config: Config, name: str) -> str:
    """That of `inputs:` which gives the input `name`."""
    angle = IMPOSED.get(name, name)
    return name if getattr(config.inputs, angle) is None else angle


def imposed(config: Config) -> list[str]:
    """Angles that are."""
    return [angle for angle in IMPOSED.values() if getattr(config.inputs, angle) is not None]


def unit(named: str) -> str:
    """SI, of an entry."""
    return symbols.INPUTS[named].unit if named in symbols.INPUTS else "rad"


def measured(config: Config) -> dict[str, InputColumn]:
    """By the names of inputs."""
    every = {name: getattr(config.inputs, entry(config, name)) for name in symbols.INPUTS}
    return {name: spec for name, spec in every.items() if isinstance(spec, InputColumn)}


def constant(config: Config, model: Model) -> dict[str, float]:
    """Those of the model, SI."""
    series, given = measured(config), config.inputs
    return {
        name: si(getattr(given, name), symbols.INPUTS[name].unit)
        for name in model.inputs
        if name not in series and getattr(given, name) is not None
    }


def as_given(config: Config, experiment: Experiment, name: str) -> Array:
    """A measured input `(T,)` as its entry has it, SI: itself, or the angle that was imposed."""
    own, series = entry(config, name), experiment.series[name]
    if own == name:
        return series
    return angles.turned(series, experiment.t, experiment.start[own])
