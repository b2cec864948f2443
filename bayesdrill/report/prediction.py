"""The record beside what the model makes of it, in the units of the record."""

from __future__ import annotations

import csv
import io

import numpy as np
from numpy.typing import NDArray

from bayesdrill.basics.own_files import numbered
from bayesdrill.inference.likelihood import Observation
from bayesdrill.inference.problem import Problem
from bayesdrill.setup import experiments, own_units
from bayesdrill.setup.config import Config

Array = NDArray[np.float64]

DIGITS = 12


def as_csv(problem: Problem, config: Config, theta: Array) -> dict[str, str]:
    """At `theta (D,)`, by the names of files: one, or one with a number for each experiment."""
    full, observations = problem.posterior.space.full(theta[None]), problem.observations
    texts = [_of(one, experiments.of(config, one.label), full) for one in observations]
    return {f"{stem}.csv": text for stem, text in numbered("prediction", texts).items()}


def _of(one: Observation, config: Config, full: Array) -> str:
    """A line for each sample: time, each channel as measured and as predicted without noise, and the
    inputs; the head of a column has its unit, as in `w_1 measured [rpm]`.
    """
    columns = {**_time(one, config), **_channels(one, config, full)}
    columns |= _inputs(one, config)
    head, body = io.StringIO(), io.StringIO()
    csv.writer(head, lineterminator="\n").writerow(columns)
    np.savetxt(body, np.stack([*columns.values()], axis=-1), f"%.{DIGITS}g", ",")
    return head.getvalue() + body.getvalue()


def _time(one: Observation, config: Config) -> dict[str, Array]:
    unit = own_units.time(config)
    return {f"t [{unit.name}]": one.experiment.t / unit.factor}


def _channels(one: Observation, config: Config, full: Array) -> dict[str, Array]:
    signals = one.signals(full)[0]
    columns = {}
    for k, channel in enumerate(one.experiment.channels):
        name, unit = channel.name, own_units.channel(config, channel)
        columns[f"{name} measured [{unit.name}]"] = one.experiment.y[:, k] / unit.factor
        columns[f"{name} predicted [{unit.name}]"] = signals[:, k] / unit.factor
    return columns


def _inputs(one: Observation, config: Config) -> dict[str, Array]:
    experiment = one.experiment
    every = {name: np.full(len(experiment.t), x) for name, x in experiment.constant.items()}
    columns = {}
    for name, values in {**every, **experiment.series}.items():
        unit = own_units.given(config, name)
        columns[f"{name} [{unit.name}]"] = values / unit.factor
    return columns
