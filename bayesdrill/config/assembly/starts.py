"""Derive priors of free initial states from the record, and check that a record begins at rest."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.basics.symbols import SPEED_UNITS, Symbol
from bayesdrill.config.building.initial import symbol_of_state
from bayesdrill.config.building.parsed_numbers import ParsedNumber
from bayesdrill.inference.priors import TruncatedNormal
from bayesdrill.record.experiment import Experiment
from bayesdrill.rig.models.friction import Named
from bayesdrill.rig.models.linear import Model

FREE_START_WIDTH = 2.0  # ratio of a free state's prior sd to the range of channels of its kind
SPEED_QUANTILE = 0.99  # quantile of an angle's difference quotients that counts as its speed


def free_start(name: str, experiment: Experiment, model: Model, values: Named) -> ParsedNumber:
    """Return a normal prior of a free initial state: the mean is the first sample, sd = 2 width.

    The width is the range (max - min) of the state's channel, or else of channels with its unit.
    Without such channels, it is the equilibrium at `values`. Raises `ValueError` for a zero width.
    """
    symbol = model.symbols[name]
    middle, width = _measured_start(symbol, experiment)
    if width is None:
        width = _span_of_unit(experiment, symbol.unit)
    if not width:
        width = _driven_width(name, experiment, model, values)
    if not (math.isfinite(width) and width > 0):
        way_out = f"give it a prior, such as `{name}: {{prior: normal, mean: 0, sd: 1}}`"
        silent = f"no channel shows how large {name} may be at the start"
        raise ValueError(f"{silent}; {way_out}")
    prior = TruncatedNormal(middle, FREE_START_WIDTH * width, -math.inf, math.inf)
    shown = symbol_of_state(model, name)
    return ParsedNumber(symbol=shown, role="start", value=prior, start=middle)


def _channels_of_unit(experiment: Experiment, unit: str) -> list[tuple[Mapping[str, float], Array]]:
    channels = zip(experiment.channels, experiment.y.T, strict=True)
    return [(c.weights, y[~np.isnan(y)]) for c, y in channels if c.unit == unit]


def _measured_start(state: Symbol, experiment: Experiment) -> tuple[float, float | None]:
    """Return the first value and range of the state's channel, or an estimated value and None."""
    middle, name = 0.0, state.name
    for weights, y in _channels_of_unit(experiment, state.unit):
        if set(weights) == {name}:
            return float(y[0] / weights[name]), float(np.ptp(y) / abs(weights[name]))
        if len(weights) == 1 and state.unit in (*SPEED_UNITS, *SPEED_UNITS.values()):
            middle = float(y[0] / next(iter(weights.values())))
    return middle, None


def _span_of_unit(experiment: Experiment, unit: str) -> float:
    """Return the range of states with this unit, also from channels of their speeds or angles."""
    if unit in SPEED_UNITS:
        if spans := [float(np.ptp(y)) for _, y in _channels_of_unit(experiment, unit)]:
            return max(spans)
        moving = _channels_of_unit(experiment, SPEED_UNITS[unit])
        speeds = [float(np.abs(y).max()) for _, y in moving]
        return float(experiment.t[-1] - experiment.t[0]) * max(speeds, default=0)
    sizes = [float(np.abs(y).max()) for _, y in _channels_of_unit(experiment, unit)]
    for k, channel in enumerate(experiment.channels):
        if unit == SPEED_UNITS.get(channel.unit):
            measured = ~np.isnan(experiment.y[:, k])
            steps = np.diff(experiment.y[measured, k]) / np.diff(experiment.t[measured])
            sizes.append(float(np.quantile(np.abs(steps), SPEED_QUANTILE)) if len(steps) else 0.0)
    return max(sizes, default=0.0)


def _driven_width(name: str, experiment: Experiment, model: Model, values: Named) -> float:
    """Return a state's equilibrium for the largest inputs or, if none acts, the largest speeds."""
    linear = model.linear(values)
    decay = abs(float(linear.A.get((name, name), 0.0)))
    largest = {n: abs(x) for n, x in experiment.constant.items()}
    largest |= {n: float(np.abs(u).max()) for n, u in experiment.series.items()}
    push = sum(
        abs(float(value)) * largest.get(column, 0.0)
        for (row, column), value in linear.B.items()
        if row == name
    )
    if push == 0:
        speed_states = [n for n in model.states if model.symbols[n].unit in SPEED_UNITS.values()]
        for state in speed_states:
            unit = model.symbols[state].unit
            channels = _channels_of_unit(experiment, unit)
            speeds = [float(np.abs(y / w[state]).max()) for w, y in channels if w.get(state)]
            speed = max(speeds, default=_span_of_unit(experiment, unit))
            push = max(push, abs(float(linear.A.get((name, state), 0.0))) * speed)
    return push / decay if decay > 0 else 0.0


N_FIRST_SAMPLES = 5  # number of samples that decide whether a record begins in motion
MIN_MOTION_OVER_NOISE = 12.0  # smallest ratio of initial motion to its standard error
MIN_MOTION_SHARE = 0.2  # smallest ratio of initial motion to the range of the channel


def check_at_rest(experiment: Experiment, sigmas: Sequence[float]) -> None:
    """Raise `ValueError` if a channel begins in motion; `sigmas (K,)` are the noise sds."""
    channels = zip(experiment.channels, experiment.y.T, sigmas, strict=True)
    for channel, y, sigma in channels:
        measured = ~np.isnan(y)
        first, t = y[measured][:N_FIRST_SAMPLES], experiment.t[measured][:N_FIRST_SAMPLES]
        if len(first) < N_FIRST_SAMPLES:
            continue
        width = float(np.ptp(y[measured]))
        if channel.unit in SPEED_UNITS.values():
            size, error = float(np.mean(first)), sigma / math.sqrt(N_FIRST_SAMPLES)
            unit = channel.unit
        elif channel.unit in SPEED_UNITS:
            spread = float(np.sqrt(((t - t.mean()) ** 2).sum()))
            slope = float(np.polyfit(t - t.mean(), first, 1)[0])
            size, error, unit = slope, sigma / spread, SPEED_UNITS[channel.unit]
            width = width / float(experiment.t[-1] - experiment.t[0])
        else:
            continue
        if abs(size) > MIN_MOTION_OVER_NOISE * error and abs(size) > MIN_MOTION_SHARE * width:
            raise ValueError(
                f"it begins in motion ({channel.name} starts with a speed of {size:.3g} {unit}), "
                "which `initial:` does not describe; write `initial: free`, `initial: steady`, or the "
                "states at this time"
            )
