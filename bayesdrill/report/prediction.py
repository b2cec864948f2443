"""The record beside what the model makes of it, in the units of the record."""

from __future__ import annotations

import csv
import io

import numpy as np
from numpy.typing import NDArray

from bayesdrill.inference.problem import Problem
from bayesdrill.setup import own_units
from bayesdrill.setup.config import Config

Array = NDArray[np.float64]

DIGITS = 12


def as_csv(problem: Problem, config: Config, theta: Array) -> str:
    """A line for each sample: time, each channel as measured and as predicted without noise at
    `theta (D,)`, and the inputs; the head of a column has its unit, as in `w_1 measured [rpm]`.
    """
    columns = {**_time(problem, config), **_channels(problem, config, theta)}
    columns |= _inputs(problem, config)
    head, body = io.StringIO(), io.StringIO()
    csv.writer(head, lineterminator="\n").writerow(columns)
    np.savetxt(body, np.stack([*columns.values()], axis=-1), f"%.{DIGITS}g", ",")
    return head.getvalue() + body.getvalue()


def _time(problem: Problem, config: Config) -> dict[str, Array]:
    unit = own_units.time(config)
    return {f"t [{unit.name}]": problem.experiment.t / unit.factor}


def _channels(problem: Problem, config: Config, theta: Array) -> dict[str, Array]:
    signals = problem.posterior.likelihood.signals(theta[None])[0]
    columns = {}
    for k, channel in enumerate(problem.experiment.channels):
        name, unit = channel.name, own_units.channel(config, channel)
        columns[f"{name} measured [{unit.name}]"] = problem.experiment.y[:, k] / unit.factor
        columns[f"{name} predicted [{unit.name}]"] = signals[:, k] / unit.factor
    return columns


def _inputs(problem: Problem, config: Config) -> dict[str, Array]:
    experiment = problem.experiment
    every = {name: np.full(len(experiment.t), x) for name, x in experiment.constant.items()}
    columns = {}
    for name, values in {**every, **experiment.series}.items():
        unit = own_units.given(config, name)
        columns[f"{name} [{unit.name}]"] = values / unit.factor
    return columns
