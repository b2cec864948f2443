"""What the figure of the fit shows: channels, model and inputs, in the units of the user."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesdrill.basics import symbols
from bayesdrill.basics.symbols import Symbol
from bayesdrill.inference.problem import Problem
from bayesdrill.inference.residual_checks import Left
from bayesdrill.setup import own_units
from bayesdrill.setup.config import Config

Array = NDArray[np.float64]

TIME = Symbol("t", "s", "t", "s", "time")


@dataclass(frozen=True, slots=True, kw_only=True)
class Signal:
    """A channel: measured and modelled `(T,)`, `predictive (N, T)` with noise, or None where
    there are no draws; `sigma` of the noise.

    `share`: what the model leaves, of the channel's spread; NaN where it has none.
    """

    label: Symbol
    y: Array
    model: Array
    predictive: Array | None
    sigma: float
    share: float = math.nan


@dataclass(frozen=True, slots=True, kw_only=True)
class Course:
    """A measured input `(T,)`; `straight` from one sample to the next, or held."""

    label: Symbol
    values: Array
    straight: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Fit:
    """At times `t (T,)`; each in the unit of its label.  `constant`: inputs that do not change."""

    t: Array
    time: Symbol
    signals: tuple[Signal, ...]
    courses: tuple[Course, ...] = ()
    constant: tuple[tuple[Symbol, float], ...] = ()


def fitted(
    problem: Problem,
    config: Config,
    best: Array,
    left: Sequence[Left],
    predictive: Mapping[str, Array] | None = None,
) -> Fit:
    """Of the MAP `(D,)` and what it leaves; `predictive`: `(..., T)` of each channel, SI."""
    experiment = problem.experiment
    clock = own_units.clock(config, experiment.t[-1])
    courses, constant = [], []
    for name, symbol in symbols.INPUTS.items():
        unit = own_units.given(config, name)
        label = dataclasses.replace(symbol, latex_unit=unit.latex)
        if name in experiment.series:
            values = experiment.series[name] / unit.factor
            courses.append(Course(label=label, values=values, straight=experiment.first_order))
        elif name == "v" or experiment.constant.get(name, 0.0):  # no load need not be said
            constant.append((label, experiment.constant[name] / unit.factor))
    return Fit(
        t=experiment.t / clock.factor,
        time=dataclasses.replace(TIME, latex_unit=clock.latex),
        signals=_signals(problem, config, best, left, predictive or {}),
        courses=tuple(courses),
        constant=tuple(constant),
    )


def _signals(
    problem: Problem,
    config: Config,
    best: Array,
    left: Sequence[Left],
    predictive: Mapping[str, Array],
) -> tuple[Signal, ...]:
    experiment, likelihood = problem.experiment, problem.posterior.likelihood
    models, sigmas = likelihood.signals(best[None])[0], likelihood.sigmas(best[None])[0]
    shares = {one.channel: one.share for one in left}
    found = []
    for k, channel in enumerate(experiment.channels):
        unit = own_units.channel(config, channel)
        draws = predictive.get(channel.name)
        found.append(
            Signal(
                label=Symbol(channel.name, channel.unit, channel.latex, unit.latex, "channel"),
                y=experiment.y[:, k] / unit.factor,
                model=models[:, k] / unit.factor,
                predictive=None
                if draws is None
                else draws.reshape(-1, draws.shape[-1]).astype(np.float64) / unit.factor,
                sigma=float(sigmas[k]) / unit.factor,
                share=shares[channel.name],
            )
        )
    return tuple(found)
