"""Resolve several experiments in one config: each as its own config, and how each begins."""

from __future__ import annotations

import copy
import dataclasses
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from bayesdrill.basics import symbols
from bayesdrill.basics.arrays import Array
from bayesdrill.basics.errors import Issue
from bayesdrill.basics.symbols import SPEED_UNITS, Symbol
from bayesdrill.config.resolve import case, quantities, sensors, work
from bayesdrill.config.resolve.case import (
    LocalNumbers,
    ResolvedCase,
    ResolvedExperiment,
    RigNumbers,
)
from bayesdrill.config.resolve.quantities import ParsedNumber
from bayesdrill.config.schema import numbers
from bayesdrill.config.schema.config import Config
from bayesdrill.config.yaml_source import IssueCollector, Location, Source
from bayesdrill.inference.priors import Prior, TruncatedNormal
from bayesdrill.inference.unknowns import ParameterSpace, Unknown, labelled_name
from bayesdrill.record.experiment import Experiment, frozen
from bayesdrill.rig.models.friction import Named
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.simulators.sensors import ObservationModel

SECTIONS = ("record", "inputs", "initial")  # those that an experiment may have for itself
PARAMETERS = "parameters"  # an experiment may fix some of them
EXPERIMENTS = "experiments"
SHARING_KEYS = ("shared", "own")  # unknowns that experiments have in common, or each for itself


def split_experiments(source: Source) -> dict[str, Source]:
    """Return, by name, the source of each experiment as if it were alone."""
    named = source.data.get(EXPERIMENTS)
    if not isinstance(named, Mapping):
        return {}
    return {
        label: experiment_source(source, label, entries)
        for label, entries in named.items()
        if isinstance(entries, Mapping)  # other entries are reported by the validation
    }


def join_experiments(source: Source, sources: Mapping[str, Source]) -> dict[str, Any]:
    """Return the joint config: the first experiment at its top, local entries below each name."""
    named = source.data[EXPERIMENTS]
    named = dict(named) if isinstance(named, Mapping) else named
    first = next(iter(sources.values()), source)
    for label, local in sources.items():
        named[label] = {**named[label], **{k: local.data[k] for k in SECTIONS if k in local.data}}
    common = {key: source.data[key] for key in SHARING_KEYS if key in source.data}
    common[PARAMETERS] = source.data.get(PARAMETERS, {})
    return {**first.data, EXPERIMENTS: named, **common}


def joint_name(config: Config, name: str, label: str) -> str:
    """Return the name of an experiment's unknown among those of all experiments."""
    return name if name in config.shared else labelled_name(name, label)


def experiment_source(source: Source, label: str, local: Mapping[str, Any]) -> Source:
    """Return the source of one experiment, with its `local` entries in place of the common ones."""
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
    """Return the common entries, recursively replaced by the `local` ones."""
    if not (isinstance(common, Mapping) and isinstance(local, Mapping)):
        return copy.deepcopy(local)
    if _entry_kind(local) and _entry_kind(common) != _entry_kind(local):
        return copy.deepcopy(local)  # keys of another kind of entry do not fit
    merged = {key: value for key, value in common.items() if key not in local}
    return {**merged, **{key: _merged(common.get(key), value) for key, value in local.items()}}


def _entry_kind(entry: Mapping[str, Any]) -> str:
    """Return the key that tells which kind of entry this is; empty if there is none."""
    return next((key for key in ("prior", "value", "rate") if key in entry), "")


FREE_START_WIDTH = 2.0  # prior sd of a free state, over the span of channels of its kind
LAG_TAIL = 1e-6  # prior probability that a lag is longer than the samples that are left out
N_FIRST_SAMPLES = 5  # they show whether a record begins in motion
MIN_MOTION_OVER_NOISE = 12.0  # initial motion over its standard error
MIN_MOTION_SHARE = 0.2  # initial motion over the range of the channel
LAG_TAIL_BEYOND_RECORD = 0.025  # prior probability, at either end, of a lag beyond the record
SPEED_QUANTILE = 0.99  # quantile of an angle's difference quotients that counts as its speed


def free_start(name: str, experiment: Experiment, model: Model, values: Named) -> ParsedNumber:
    """Return a normal prior of a state around the first samples, as wide as the channels' span.

    If no channel measures the state, the width is how far the inputs would drive it at the parameters
    `values`. Raises `ValueError` if neither gives a width.
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
    """Return the experiment with known or initial gains and offsets of its sensors removed."""
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
    """Return first value and span of the state's channel; without it, another's first value and None."""
    middle, name = 0.0, state.name
    for weights, y in _channels_of_unit(experiment, state.unit):
        if set(weights) == {name}:
            return float(y[0] / weights[name]), float(np.ptp(y) / abs(weights[name]))
        if len(weights) == 1 and state.unit in (*SPEED_UNITS, *SPEED_UNITS.values()):
            middle = float(y[0] / next(iter(weights.values())))
    return middle, None


def _span_of_unit(experiment: Experiment, unit: str) -> float:
    """Return the span of states with this unit; angles and speeds are derived from each other."""
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
    """Return the equilibrium to which the inputs, or else turning parts, would drive a state."""
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

    If the rig moves at the start, the first samples show motion before it. If the record shows an input
    late, the last samples depend on the input after its end.
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
    """Raise `ValueError` for a lag, or a delay, for which the record is too short."""
    duration = float(experiment.t[-1] - experiment.t_start)
    low, high = quantities.ends_of(lag.value, LAG_TAIL_BEYOND_RECORD)
    if not max(abs(low), abs(high)) < duration:
        raise ValueError(
            f"lags from {low:.4g} to {high:.4g} s are allowed, and the record has "
            f"{duration:.4g} s: what it shows would be no answer to its inputs; check the unit, or "
            "narrow the prior"
        )


def check_at_rest(experiment: Experiment, sigmas: Sequence[float]) -> None:
    """Raise `ValueError` if a channel begins in motion, given its noise sds `sigmas (K,)`."""
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


# The key is an experiment's name, which is empty if there is only one.
NumbersByLabel = Mapping[str, LocalNumbers]


def check_experiments(
    config: Config, source: Source, resolved: Mapping[str, ResolvedExperiment]
) -> list[Issue]:
    """Return the issues between experiments that are each valid."""
    errors = IssueCollector(source, frozenset())
    for label in config.experiments:
        if not label.isidentifier():
            message = f"'{label}' cannot name an experiment; use letters, digits and `_`"
            errors.add(("experiments", label), message)
    if errors.issues:
        return errors.issues
    model = next(iter(resolved.values())).model
    by_label = {label: experiment.local_numbers for label, experiment in resolved.items()}
    _check_held(errors, config, resolved)
    _check_local(errors, config, model, [each.rig_numbers for each in resolved.values()])
    _check_shared(errors, config, model, by_label)
    _check_held_out(errors, config, by_label)
    _check_names(errors, config, by_label)
    if not errors.issues:
        joint = ResolvedCase(config=config, source=source, experiments=(*resolved.values(),))
        space = joint.space()
        _check_derived(errors, joint, space)
        local = [joint_name(config, n, label) for label, x in by_label.items() for n in x.unknown]
        unknown = list(dict.fromkeys([*space.free, *local]))
        work.check_unknown(errors, config, unknown, space.relations)
        work.check_identify(errors, config, [x for x in space.free if x not in config.quantities])
    check_truth(errors, config, by_label)
    return errors.issues


def unknown_names(config: Config, model: Model, local: LocalNumbers) -> list[str]:
    """Return the names of all unknowns of a single experiment."""
    every = case.free_parameters(config, model.parameters)
    every += [n for n, q in config.quantities.items() if isinstance(q, numbers.QuantityPrior)]
    return list(dict.fromkeys([*every, *local.unknown]))


def _check_held(
    errors: IssueCollector, config: Config, resolved: Mapping[str, ResolvedExperiment]
) -> None:
    """Check that an experiment fixes only numbers and formulas, for parameters that all rigs have."""
    for label, experiment in resolved.items():
        for name in config.experiments[label].parameters:
            free = isinstance(experiment.config.parameters.get(name), numbers.ParameterPrior)
            without = [n for n, each in resolved.items() if name not in each.model.parameters]
            only = f"only a number or a formula can be held; `own: [{name}]` makes unknowns"
            both = f"{name} is `own:`, and so unknown in each; remove one of the two"
            lacks = f"{name} is not in the rig of {' and '.join(without)}; name it above"
            checks = ((free, only), (name in config.own, both), (without, lacks))
            if message := next((text for wrong, text in checks if wrong), ""):
                errors.add(("experiments", label, "parameters", name), message)


def _check_derived(errors: IssueCollector, joint: ResolvedCase, space: ParameterSpace) -> None:
    """Check that derived formulas name existing parameters of the joint problem."""
    known = {*space.free, *space.fixed, *space.relations, *symbols.DERIVED, *joint.config.derived}
    for formula in joint.experiments[0].rig_numbers.derived:
        for name in [name for name in formula.expression.names if name not in known]:
            others = dict.fromkeys(names.get(name, "") for names in joint.joint_names.values())
            way_out = f"name {' or '.join(others)}" if all(others) else "it is the same in all"
            message = f"there is no {name} among all experiments; {way_out}"
            errors.add(("derived", formula.symbol.name), message)


def check_truth(errors: IssueCollector, config: Config, by_label: NumbersByLabel) -> None:
    """Check the names of channels and unknowns to which `simulation:` gives true values."""
    simulation: Any = config.simulation
    channels = dict.fromkeys(name for local in by_label.values() for name in local.channels)
    for name in simulation.sigma if simulation else ():
        if not errors.is_reported(("record", "channels", name)):
            location: Location = ("simulation", "sigma", name)
            errors.expect(location, name, channels, "there is no such channel")
    for name in simulation.truth if simulation else ():
        message = "a sensor, a start, a noise or an experiment has no such unknown"
        known_names = _truth_names(config, by_label)
        errors.expect(("simulation", "truth", name), name, known_names, message)


def _truth_names(config: Config, by_label: NumbersByLabel) -> list[str]:
    """Return the names of unknowns, beside those of the rig, that `simulation.truth` may contain."""
    pairs = [(label, name) for label in by_label for name in config.own]
    if config.missing_torque is not None:
        pairs += [(label, name) for label in by_label for name in sensors.TORQUE_ENTRIES]
    for label, local in by_label.items():
        sizes = {symbols.noise_name(name) for name in local.channels}  # given by `simulation.sigma`
        pairs += [(label, name) for name in local.numbers if name not in sizes]
    local_names = [labelled_name(name, label) for label, name in pairs if name not in config.shared]
    return list(dict.fromkeys([*(name for _, name in pairs), *local_names]))


def _check_local(
    errors: IssueCollector, config: Config, model: Model, each: Iterable[RigNumbers]
) -> None:
    free = case.free_parameters(config, model.parameters)
    related_names = case.check_used(errors, config, each)
    for k, name in enumerate(config.own):
        errors.expect(("own", k), name, free, f"{name} is no unknown parameter of the rig")
        if name in related_names:
            message = f"a formula or tie names {name}, so that all experiments share it; remove one"
            errors.add(("own", k), message)


def _check_shared(
    errors: IssueCollector, config: Config, model: Model, by_label: NumbersByLabel
) -> None:
    """Check that shared unknowns belong to several experiments, with the same prior."""
    known_names = dict.fromkeys(name for local in by_label.values() for name in local.numbers)
    for k, name in enumerate(config.shared):
        location = ("shared", k)
        having = [label for label, local in by_label.items() if name in local.numbers]
        given = [by_label[label].numbers[name] for label in having]
        values = [(x.prior, x.start) if isinstance(x, Unknown) else x for x in given]
        if not having:
            rig = " (parameters of the rig are shared unless they are `own:`)"
            message = f"{name} is no unknown of a sensor, a start or noise"
            message += rig if name in model.parameters else ""
            errors.expect(location, name, known_names, message)
        elif any(isinstance(value, float) for value in values):
            message = f"{name} is held, so that nothing is unknown of it; remove it here"
            errors.add(location, message)
        elif len(having) == 1:
            message = f"only {having[0]} has {name}; give it to another one, or remove it here"
            errors.add(location, message)
        elif any(value is None for value in values):
            state = name.removesuffix("_0")
            example = f"`{state}: {{prior: normal, mean: 0, sd: 1}}`"
            way_out = f"give one in all, such as {example}, or remove it here"
            errors.add(location, f"each record gives {name} a prior of its own; {way_out}")
        elif others := [n for n, x in zip(having, values, strict=True) if x != values[0]]:
            message = f"{name} has another prior in {others[0]} than in {having[0]}"
            way_out = "give it once, above `experiments:`, or remove it here"
            errors.add(location, f"{message}; {way_out}")


def _check_held_out(errors: IssueCollector, config: Config, by_label: NumbersByLabel) -> None:
    """Check that fitted experiments determine the unknowns of those that are held out."""
    held_out = [label for label, experiment in config.experiments.items() if experiment.held_out]
    if held_out and len(held_out) == len(by_label):
        message = "all are held out; leave one to be fitted"
        errors.add(("experiments", held_out[0], "held_out"), message)
        return
    fitted = [local for label, local in by_label.items() if label not in held_out]
    determined = {name for local in fitted for name in local.numbers if name in config.shared}
    for label in held_out:
        for k, name in enumerate(config.own):
            message = f"nothing tells {name} of {label}, which is held out; remove it here"
            errors.add(("own", k), message)
        if alone := ", ".join(n for n in by_label[label].unknown if n not in determined):
            message = f"nothing tells {alone} of {label}; give a number, or add it to `shared:`"
            errors.add(("experiments", label, "held_out"), message)


def _check_names(errors: IssueCollector, config: Config, by_label: NumbersByLabel) -> None:
    """Check that no two unknowns, and no two columns of results, have the same name."""
    words = config.vocabulary
    used_names = dict.fromkeys([*words.parameters, *config.quantities, *symbols.DERIVED], "")
    used_names |= dict.fromkeys(config.derived, "")
    before = len(errors.issues)
    for label, local in by_label.items():
        local_names = [*config.own, *config.experiments[label].parameters]
        local_names += [name for name in local.numbers if name not in config.shared]
        _no_clash(errors, label, local_names, used_names)
    columns = dict[str, str]()
    for label, local in by_label.items() if len(errors.issues) == before else ():
        _no_clash(errors, label, [*local.channels, *words.inputs], columns)


def _no_clash(
    errors: IssueCollector, label: str, names: Iterable[str], used_names: dict[str, str]
) -> None:
    new_names = {labelled_name(name, label): f"{name} of {label}" for name in names}
    clashes = [name for name in new_names if name in used_names]
    for name in clashes[:1]:
        other = f"that of {used_names[name]}" if used_names[name] else "another meaning already"
        message = f"the name {name} of {new_names[name]} is {other}; rename the experiment"
        errors.add(("experiments", label), message)
    used_names |= {name: meaning for name, meaning in new_names.items() if name not in clashes}
