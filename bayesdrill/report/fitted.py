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
from bayesdrill.inference.likelihood import Observation
from bayesdrill.inference.problem import Problem
from bayesdrill.inference.residual_checks import Left
from bayesdrill.inference.unknowns import of_label
from bayesdrill.insight.rubbing import Rubbing
from bayesdrill.report.rubbed import Rub, rubs
from bayesdrill.setup import experiments, own_units
from bayesdrill.setup.config import Config

Array = NDArray[np.float64]

TIME = Symbol("t", "s", "t", "s", "time")


@dataclass(frozen=True, slots=True, kw_only=True)
class Signal:
    """A channel: measured (NaN where it was not) and modelled `(T,)`, `predictive (N, T)` with noise,
    or None where there are no draws; `sigma` of the noise.

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
    """At times `t (T,)`; each in the unit of its label.  `constant`: inputs that do not change; `rubs`:
    frictions; `label`: of the experiment, where there are several.
    """

    t: Array
    time: Symbol
    signals: tuple[Signal, ...]
    courses: tuple[Course, ...] = ()
    constant: tuple[tuple[Symbol, float], ...] = ()
    rubs: tuple[Rub, ...] = ()
    label: str = ""


def every_fit(
    problem: Problem,
    config: Config,
    best: Array,
    left: Sequence[Left],
    predictive: Mapping[str, Array] | None = None,
    rubbing: Sequence[Sequence[Rubbing]] = (),
) -> tuple[Fit, ...]:
    """Of each experiment; see `fitted`.  `rubbing`: of each, or nothing."""
    clock, each = own_units.clock(config, problem), rubbing or [()] * len(problem.observations)
    return tuple(
        dataclasses.replace(
            fitted(one, problem, experiments.of(config, one.label), best, left, predictive),
            rubs=rubs(found, clock),
        )
        for one, found in zip(problem.observations, each, strict=True)
    )


def fitted(
    one: Observation,
    problem: Problem,
    config: Config,
    best: Array,
    left: Sequence[Left],
    predictive: Mapping[str, Array] | None = None,
) -> Fit:
    """Of the MAP `(D,)` and what it leaves; `predictive`: `(..., T)` of each channel, SI, by the name
    that it has among all.  `config`: of this experiment.
    """
    experiment = one.experiment
    clock = own_units.clock(config, problem)
    courses, constant = [], []
    for name in (n for n in symbols.INPUTS if n in {*experiment.series, *experiment.constant}):
        unit = own_units.given(config, name)
        label = dataclasses.replace(symbols.INPUTS[name], latex_unit=unit.latex)
        if name in experiment.series:
            values = experiment.series[name] / unit.factor
            courses.append(Course(label=label, values=values, straight=experiment.first_order))
        elif name != "t_1" or experiment.constant[name]:  # no load need not be said
            constant.append((label, experiment.constant[name] / unit.factor))
    return Fit(
        t=experiment.t / clock.factor,
        time=dataclasses.replace(TIME, latex_unit=clock.latex),
        signals=_signals(one, problem, config, best, left, predictive or {}),
        courses=tuple(courses),
        constant=tuple(constant),
        label=one.label,
    )


def _signals(
    one: Observation,
    problem: Problem,
    config: Config,
    best: Array,
    left: Sequence[Left],
    predictive: Mapping[str, Array],
) -> tuple[Signal, ...]:
    experiment = one.experiment
    models = one.followed(problem.posterior.space.full(best[None]), best[None])[0]
    sigmas = one.scales(best[None])[0]
    shares = {each.channel: each.share for each in left if each.experiment == one.label}
    found = []
    for k, channel in enumerate(experiment.channels):
        unit = own_units.channel(config, channel)
        draws = predictive.get(of_label(channel.name, one.label))
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
