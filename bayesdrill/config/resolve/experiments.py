"""Several experiments in one config: each as a config of its own, and how each begins."""

from __future__ import annotations

import copy
import dataclasses
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.basics.symbols import SPEED_UNITS, Symbol
from bayesdrill.config.resolve import quantities, sensors
from bayesdrill.config.resolve.quantities import ParsedNumber
from bayesdrill.config.schema.config import Config
from bayesdrill.config.yaml_source import Location, Source
from bayesdrill.inference.priors import Prior, TruncatedNormal
from bayesdrill.inference.unknowns import labelled_name
from bayesdrill.record.experiment import Experiment, frozen
from bayesdrill.rig.models.friction import Named
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.simulators.sensors import ObservationModel

SECTIONS = ("record", "inputs", "initial")  # which an experiment may have of its own
PARAMETERS = "parameters"  # of which it may hold numbers of its own
EXPERIMENTS = "experiments"
SHARING_KEYS = ("shared", "own")  # of what the experiments have in common, or each for itself


def split_experiments(source: Source) -> dict[str, Source]:
    """Return, by name, what each experiment of a config reads as if it were alone."""
    named = source.data.get(EXPERIMENTS)
    if not isinstance(named, Mapping):
        return {}
    return {
        label: experiment_source(source, label, entries)
        for label, entries in named.items()
        if isinstance(entries, Mapping)  # what is none is told of by its own entry
    }


def join_experiments(source: Source, sources: Mapping[str, Source]) -> dict[str, Any]:
    """Return the config of all: the first experiment at its top, local entries under each name."""
    named = source.data[EXPERIMENTS]
    named = dict(named) if isinstance(named, Mapping) else named
    first = next(iter(sources.values()), source)
    for label, local in sources.items():
        named[label] = {**named[label], **{k: local.data[k] for k in SECTIONS if k in local.data}}
    common = {key: source.data[key] for key in SHARING_KEYS if key in source.data}
    common[PARAMETERS] = source.data.get(PARAMETERS, {})
    return {**first.data, EXPERIMENTS: named, **common}


def joint_name(config: Config, name: str, label: str) -> str:
    """Return the name that an unknown of one experiment has among those of all."""
    return name if name in config.shared else labelled_name(name, label)


def experiment_source(source: Source, label: str, local: Mapping[str, Any]) -> Source:
    """Return the config of one experiment, with its `local` entries."""
    data = {k: v for k, v in source.data.items() if k not in (EXPERIMENTS, *SHARING_KEYS)}
    data = copy.deepcopy(data)
    for section in [name for name in (*SECTIONS, PARAMETERS) if name in local]:
        data[section] = _merged(data.get(section), local[section])
    lines, moved = dict(source.lines), dict[Location, Location]()
    prefix: Location = (EXPERIMENTS, label)
    for location, line in source.lines.items():
        if location[:2] == prefix and len(location) > 2:
            lines[location[2:]], moved[location[2:]] = line, location
    labels = tuple(map(str, source.data[EXPERIMENTS] or [label]))
    alone = dataclasses.replace(source, data=data, lines=lines, repeated=(), moved=moved)
    return dataclasses.replace(alone, labels=labels)


def _merged(common: Any, local: Any) -> Any:
    """`local` entries in the place of common ones, mapping by mapping."""
    if not (isinstance(common, Mapping) and isinstance(local, Mapping)):
        return copy.deepcopy(local)
    if _entry_kind(local) and _entry_kind(common) != _entry_kind(local):
        return copy.deepcopy(local)  # another kind of entry: nothing of the common one fits
    merged = {key: value for key, value in common.items() if key not in local}
    return {**merged, **{key: _merged(common.get(key), value) for key, value in local.items()}}


def _entry_kind(entry: Mapping[str, Any]) -> str:
    """Which kind a number or column is, where it says so."""
    return next((key for key in ("prior", "value", "rate") if key in entry), "")


FREE_START_WIDTH = 2.0  # times what a channel of its kind spans: sd of the prior of a free state
LAG_TAIL = 1e-6  # of the prior of a lag lies beyond what is left out of the start
N_FIRST_SAMPLES = 5  # samples that show whether a record begins in motion
MIN_MOTION_OVER_NOISE = 12.0  # times the noise
MIN_MOTION_SHARE = 0.2  # of what the channel does later
LAG_TAIL_BEYOND_RECORD = 0.025  # of the prior of a lag, on either side, may lie beyond the record
SPEED_QUANTILE = 0.99  # of the steps of an angle are no faster than the speed that is taken of it


def free_start(name: str, experiment: Experiment, model: Model, values: Named) -> ParsedNumber:
    """Return a normal prior of a state around the first samples, as wide as the channels go.

    Where no channel measures it, it is as wide as the inputs would drive it at parameters `values`.
    Raises `ValueError` where neither tells a width.
    """
    symbol = model.symbols[name]
    middle, width = _measured_start(symbol, experiment)
    if width is None:
        width = _span_of_unit(experiment, symbol.unit)
    if not width:
        width = _driven_width(name, experiment, model, values)
    if not (math.isfinite(width) and width > 0):
        way_out = f"give it a prior, such as `{name}: {{prior: normal, mean: 0, sd: 1}}`"
        silent = f"no channel says how far {name} may be from zero at the start"
        raise ValueError(f"{silent}; {way_out}")
    prior = TruncatedNormal(middle, FREE_START_WIDTH * width, -math.inf, math.inf)
    shown = sensors.symbol_of_state(model, name)
    return ParsedNumber(symbol=shown, role="start", value=prior, start=middle)


def without_sensors(
    experiment: Experiment, sensing: ObservationModel, numbers: Iterable[ParsedNumber]
) -> Experiment:
    """Return the experiment as a rig shows it: without gains and offsets, known or where they start."""
    values = {n.name: n.value if isinstance(n.value, float) else n.start for n in numbers}
    y = experiment.y.copy()
    for k, channel in enumerate(experiment.channels):
        offset = values.get(sensing.offsets.get(channel.name, ""))
        gain = values.get(sensing.gains.get(channel.name, ""))
        y[:, k] = (y[:, k] - (offset or 0.0)) / (gain or 1.0)
    return dataclasses.replace(experiment, y=frozen(y))


def _channels_of_unit(experiment: Experiment, unit: str) -> list[tuple[Mapping[str, float], Array]]:
    channels = zip(experiment.channels, experiment.y.T, strict=True)
    return [(c.weights, y[~np.isnan(y)]) for c, y in channels if c.unit == unit]


def _measured_start(state: Symbol, experiment: Experiment) -> tuple[float, float | None]:
    """First value and span of a channel of this state alone, or the first of an angle beside it."""
    middle, name = 0.0, state.name
    for weights, y in _channels_of_unit(experiment, state.unit):
        if set(weights) == {name}:
            return float(y[0] / weights[name]), float(np.ptp(y) / abs(weights[name]))
        if len(weights) == 1 and state.unit in (*SPEED_UNITS, *SPEED_UNITS.values()):
            middle = float(y[0] / next(iter(weights.values())))
    return middle, None


def _span_of_unit(experiment: Experiment, unit: str) -> float:
    """How far states of this unit go, as channels tell; angles and speeds tell of each other."""
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
    """Where the inputs would hold it, if nothing else moved; where there are none, what turns would."""
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
        turning = [n for n in model.states if model.symbols[n].unit in SPEED_UNITS.values()]
        for turns in turning:
            unit = model.symbols[turns].unit
            channels = _channels_of_unit(experiment, unit)
            speeds = [float(np.abs(y / w[turns]).max()) for w, y in channels if w.get(turns)]
            speed = max(speeds, default=_span_of_unit(experiment, unit))
            push = max(push, abs(float(linear.A.get((name, turns), 0.0))) * speed)
    return push / decay if decay > 0 else 0.0


def start_beyond_lags(
    experiment: Experiment,
    model: Model,
    sensing: ObservationModel,
    values: Mapping[str, float | Prior],
) -> Experiment:
    """Return the experiment without the samples that lags leave undetermined.

    Of a rig that moves at the start these show what was before it; of an input that the record
    shows late, what came after its end.
    """
    y, notes = np.array(experiment.y), list(experiment.told)
    late = sensing.shifts or bool(sensing.input_lags)
    moves, t = late and sensing.moves(experiment.start, model.angles), experiment.t
    felt = [quantities.ends_of(values[name], LAG_TAIL) for name in sensing.input_lags.values()]
    first = min([0.0, *(low for low, _ in felt)])
    last = max([0.0, *(high for _, high in felt)])
    if sensing.delay is not None:
        last += quantities.ends_of(values[sensing.delay], LAG_TAIL)[1]
    for k, channel in enumerate(experiment.channels):
        lag = sensing.lags.get(channel.name)
        lag_value = 0.0 if lag is None else values[lag]
        lowest_lag, highest_lag = quantities.ends_of(lag_value, LAG_TAIL)
        measured = ~np.isnan(y[:, k])
        before = measured & (t < experiment.t_start + last + highest_lag) & moves
        after = measured & (t > t[-1] + first + lowest_lag + 1e-9 * experiment.dt) & (first < 0.0)
        for undetermined, origin in (
            (before, "was before the start (lag)"),
            (after, "an input did after the end of the record (lag)"),
        ):
            if undetermined.any():
                y[undetermined, k] = np.nan
                count = f"{channel.name}: {int(undetermined.sum())} samples"
                notes.append(f"{count} are left out, as they may show what {origin}")
    if len(notes) == len(experiment.told):
        return experiment
    return dataclasses.replace(experiment, y=frozen(y), told=tuple(notes))


def check_lag(lag: ParsedNumber, experiment: Experiment) -> None:
    """Raise `ValueError` for a lag, or a delay, that the record is too short for."""
    duration = float(experiment.t[-1] - experiment.t_start)
    low, high = quantities.ends_of(lag.value, LAG_TAIL_BEYOND_RECORD)
    if not max(abs(low), abs(high)) < duration:
        raise ValueError(
            f"lags from {low:.4g} to {high:.4g} s are allowed, and the record has "
            f"{duration:.4g} s: what it shows would be no answer to its inputs; check the unit, or "
            "narrow the prior"
        )


def check_at_rest(experiment: Experiment, sigmas: Sequence[float]) -> None:
    """Raise `ValueError` where a channel begins in motion, by its noise of the sd `sigmas (K,)`."""
    channels = zip(experiment.channels, experiment.y.T, sigmas, strict=True)
    for channel, y, sigma in channels:
        measured = ~np.isnan(y)
        first, t = y[measured][:N_FIRST_SAMPLES], experiment.t[measured][:N_FIRST_SAMPLES]
        if len(first) < N_FIRST_SAMPLES:
            continue
        reach = float(np.ptp(y[measured]))
        if channel.unit in SPEED_UNITS.values():
            size, error = float(np.mean(first)), sigma / math.sqrt(N_FIRST_SAMPLES)
            unit = f"{channel.unit} (its value there)"
        elif channel.unit in SPEED_UNITS:
            spread = float(np.sqrt(((t - t.mean()) ** 2).sum()))
            slope = float(np.polyfit(t - t.mean(), first, 1)[0])
            size, error, unit = slope, sigma / spread, SPEED_UNITS[channel.unit]
            reach = reach / float(experiment.t[-1] - experiment.t[0])
        else:
            continue
        if abs(size) > MIN_MOTION_OVER_NOISE * error and abs(size) > MIN_MOTION_SHARE * reach:
            raise ValueError(
                f"it begins in motion ({channel.name} changes by {size:.3g} {unit} at its beginning), "
                "and the config says nothing of it; write `initial: free`, `initial: steady`, or the "
                "states there"
            )
