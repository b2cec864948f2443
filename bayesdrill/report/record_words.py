"""What was read of a record, column by column, so that swapped columns and wrong units show."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from bayesdrill.basics import units
from bayesdrill.inference.likelihood import Observation
from bayesdrill.inference.problem import Problem
from bayesdrill.insight import suspicions as suspected
from bayesdrill.record import clocks
from bayesdrill.record.experiment import Experiment
from bayesdrill.report.sections import aligned
from bayesdrill.setup import build, experiments, given_inputs
from bayesdrill.setup.config import Config
from bayesdrill.setup.record_entries import Column, TimeColumn

Array = NDArray[np.float64]

FEW, ALL = 3, 50  # places of what is odd that a report names, and `check`

HEADERS = ("", "measures", "column", "unit", "first", "from", "to")


def columns(problem: Problem, config: Config) -> str:
    """Of each record: time, channels and measured inputs, in the units of their columns."""
    return "\n".join(
        _columns(one, problem, experiments.of(config, one.label)) for one in problem.every
    )


def _columns(one: Observation, problem: Problem, config: Config) -> str:
    experiment = one.experiment
    lines: list[tuple[str, ...]] = [HEADERS]
    time = config.record.time
    if isinstance(time, TimeColumn):
        lines.append(_line("time", "time", time, experiment.t / units.factor(time.unit, "s")))
    measured = build.channels(config, problem.model)
    for entry, values in zip(measured, experiment.y.T, strict=True):
        name = entry.channel.name
        channel = config.record.channels[name]
        lines.append(_line(name, channel.measures or name, channel, values / entry.factor))
    held = "first" if experiment.first_order else "zero"
    for name, given in given_inputs.measured(config).items():
        own = given_inputs.entry(config, name)
        factor = units.factor(given.unit, given_inputs.unit(own))
        values = given_inputs.as_given(config, experiment, name) / factor
        how = "angle" if own != name else f"hold: {held}"
        lines.append(_line(own, f"input, {how}", given, values))
    sampling = clocks.in_words(experiment.t)
    return f"{one.entitled('columns')} ({sampling}):\n{aligned(lines, left={0, 1, 2, 3})}"


def made(problem: Problem) -> tuple[str, ...]:
    """What times each record has, where its steps are not equal, and what was done to its numbers."""
    apart = problem.posterior.likelihood.apart
    return (
        *(
            f"{one.label}, {each}" if one.label else each
            for one in problem.observations
            for each in _made(one.experiment)
        ),
        *(
            f"{one.label}, its {one.numbers} samples are held out, and are no evidence"
            for one in apart
        ),
    )


def _made(experiment: Experiment) -> tuple[str, ...]:
    times = () if experiment.uniform else (f"times: {clocks.in_words(experiment.t)}",)
    seen = dict(zip(experiment.names, experiment.counts, strict=True))
    every = ", ".join(f"{count} of {name}" for name, count in seen.items())
    total = len(experiment.t)
    some = (f"measured: {every}, at {total} times",) if set(seen.values()) != {total} else ()
    return (*times, *some, *experiment.told)


def suspicions(problem: Problem, config: Config, most: int = FEW) -> tuple[str, ...]:
    """What a wrong column, unit, counter or sensor would look like, and this record does.

    `most`: how many places of each are named.
    """
    found: list[str] = []
    for one in problem.observations:
        odd = [each.in_words(most) for each in one.experiment.odd]
        measured = build.channels(experiments.of(config, one.label), problem.model)
        factors = [entry.factor for entry in measured]
        said = suspected.of_record(one.experiment, factors, problem.model)
        found += [f"{one.label}, {each}" if one.label else each for each in (*odd, *said)]
    return (*found, *suspected.of_start(problem))


def _line(name: str, measures: str, spec: Column, values: Array) -> tuple[str, ...]:
    where = [text for text in (spec.variable, spec.column) if text is not None]
    known = values[~np.isnan(values)]
    numbers = (known[0], known.min(), known.max())
    return (
        f"  {name}",
        measures,
        " ".join(map(str, where)),
        spec.unit,
        *(f"{x:.5g}" for x in numbers or (math.nan,) * 3),
    )
