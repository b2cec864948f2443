"""Correct a record for gains and offsets, and leave out samples that depend on unknown motion."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping

import numpy as np

from bayesdrill.basics.errors import count_noun
from bayesdrill.config.building.parsed_numbers import (
    ParsedNumber,
    ends_of,
)
from bayesdrill.inference.priors import Prior
from bayesdrill.record.experiment import Experiment, frozen
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.simulators.sensors import ObservationModel


def without_sensors(
    experiment: Experiment, sensing: ObservationModel, numbers: Iterable[ParsedNumber]
) -> Experiment:
    """Correct an experiment for gains and offsets; unknown gains and offsets have start values."""
    values = {n.name: n.value if isinstance(n.value, float) else n.start for n in numbers}
    y = experiment.y.copy()
    for k, channel in enumerate(experiment.channels):
        offset = values.get(sensing.offsets.get(channel.name, ""))
        gain = values.get(sensing.gains.get(channel.name, ""))
        y[:, k] = (y[:, k] - (offset or 0.0)) / (gain or 1.0)
    return dataclasses.replace(experiment, y=frozen(y))


LAG_TAIL = 1e-6  # prior probability that a lag is longer than the omitted time
LAG_TAIL_BEYOND_RECORD = 0.025  # prior probability of each tail that `check_lag` disregards


def start_beyond_lags(
    experiment: Experiment,
    model: Model,
    sensing: ObservationModel,
    values: Mapping[str, float | Prior],
) -> Experiment:
    """Return the experiment without samples that depend on motion or inputs outside the record.

    If the rig moves at the start, the first samples of a sensor with a lag show earlier motion.
    If an input is recorded too late, the last samples depend on the input after the record's end.
    """
    y, notes = np.array(experiment.y), list(experiment.notes)
    late = sensing.shifts or bool(sensing.input_lags)
    moves, t = late and sensing.may_move(experiment.start, model.angles), experiment.t
    lag_ends = [ends_of(values[name], LAG_TAIL) for name in sensing.input_lags.values()]
    first = min([0.0, *(low for low, _ in lag_ends)])
    last = max([0.0, *(high for _, high in lag_ends)])
    if sensing.delay is not None:
        last += ends_of(values[sensing.delay], LAG_TAIL)[1]
    for k, channel in enumerate(experiment.channels):
        lag = sensing.lags.get(channel.name)
        lag_value = 0.0 if lag is None else values[lag]
        lowest_lag, highest_lag = ends_of(lag_value, LAG_TAIL)
        measured = ~np.isnan(y[:, k])
        before = measured & (t < experiment.t_start + last + highest_lag) & moves
        after = measured & (t > t[-1] + first + lowest_lag + 1e-9 * experiment.dt) & (first < 0.0)
        for undetermined, origin in (
            (before, "the motion before the start (lag)"),
            (after, "the effect of an input after the end of the record (lag)"),
        ):
            if undetermined.any():
                y[undetermined, k] = np.nan
                words = "sample is left out, as it", "samples are left out, as they"
                count = count_noun(int(undetermined.sum()), *words)
                notes.append(f"{channel.name}: {count} may show {origin}")
    if len(notes) == len(experiment.notes):
        return experiment
    return dataclasses.replace(experiment, y=frozen(y), notes=tuple(notes))


def check_lag(lag: ParsedNumber, experiment: Experiment) -> None:
    """Raise `ValueError` if the record is too short for a lag or a delay."""
    duration = float(experiment.t[-1] - experiment.t_start)
    low, high = ends_of(lag.value, LAG_TAIL_BEYOND_RECORD)
    if not max(abs(low), abs(high)) < duration:
        raise ValueError(
            f"lags from {low:.4g} to {high:.4g} s are allowed, and the record has "
            f"{duration:.4g} s: the channel would not respond to inputs of the record; check the "
            "unit, or narrow the prior"
        )
