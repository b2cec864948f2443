"""The record beside what the model makes of it, in the units of the record."""

from __future__ import annotations

import csv
import io

import numpy as np
from numpy.typing import NDArray

from bayesdrill.basics import symbols, units
from bayesdrill.inference.problem import Problem
from bayesdrill.setup import build
from bayesdrill.setup.config import Config, TimeColumn
from bayesdrill.setup.number_entries import Quantity

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
    spec = config.record.time
    unit = spec.unit if isinstance(spec, TimeColumn) else "s"
    return {f"t [{unit}]": problem.experiment.t / units.factor(unit, "s")}


def _channels(problem: Problem, config: Config, theta: Array) -> dict[str, Array]:
    signals = problem.posterior.likelihood.signals(theta[None])[0]
    columns = {}
    for k, one in enumerate(build.channels(config, build.model(config))):
        name = one.channel.name
        unit = config.record.channels[name].unit
        columns[f"{name} measured [{unit}]"] = problem.experiment.y[:, k] / one.factor
        columns[f"{name} predicted [{unit}]"] = signals[:, k] / one.factor
    return columns


def _inputs(problem: Problem, config: Config) -> dict[str, Array]:
    experiment = problem.experiment
    every = {name: np.full(len(experiment.t), x) for name, x in experiment.constant.items()}
    every |= experiment.series
    columns = {}
    for name, values in every.items():
        spec, si = getattr(config.inputs, name), symbols.INPUTS[name].unit
        written = isinstance(spec, Quantity) or name in experiment.series
        unit = spec.unit if written else si
        columns[f"{name} [{unit}]"] = values / units.factor(unit, si)
    return columns
