"""A resolved case and its records become a `Problem`: simulators, noises, unknowns, units."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

from bayesdrill.basics import symbols, units
from bayesdrill.basics.entries import build_member
from bayesdrill.basics.errors import InputError, collect_each
from bayesdrill.basics.registry import lookup
from bayesdrill.basics.units import SECOND, Unit
from bayesdrill.config.resolve import experiments, sensors
from bayesdrill.config.resolve.case import ResolvedCase, ResolvedExperiment
from bayesdrill.config.resolve.experiments import joint_name
from bayesdrill.config.resolve.quantities import ParsedNumber
from bayesdrill.config.resolve.sensors import build_noise
from bayesdrill.config.schema.config import Config
from bayesdrill.config.yaml_source import Location
from bayesdrill.inference import step_error
from bayesdrill.inference.display_units import DisplayUnits
from bayesdrill.inference.likelihood import Likelihood, Observation
from bayesdrill.inference.noise.mixed import noise_for_record
from bayesdrill.inference.posterior import Posterior, Problem
from bayesdrill.inference.unknowns import Unknown, labelled_name
from bayesdrill.record.experiment import Experiment
from bayesdrill.rig.simulators import simulator
from bayesdrill.rig.simulators.contract import Simulator
from bayesdrill.sampling.optimisers import OPTIMISERS
from bayesdrill.sampling.optimisers.contract import Optimiser


def optimiser(config: Config) -> Optimiser:
    """Return the optimiser that searches the MAP."""
    return build_member(lookup(OPTIMISERS, config.map.method, "method"), config.map)


SEARCH_STEPS = 4  # steps to a sample, for the search of the maximum: there they are chosen anew


def build_problem(case: ResolvedCase, records: Sequence[Experiment]) -> Problem:
    """Build the problem from a case and its records, one for each experiment.

    Records are those of `reading.read`.  Raises `InputError` where records and config do not go
    together.
    """
    config, rig, nominal = case.config, case.model, case.nominal
    labels = [experiment.label for experiment in case.experiments]
    parts, sensor_numbers, noise_unknowns = [], dict[str, ParsedNumber](), dict[str, Unknown]()
    pairs = zip(case.experiments, records, strict=True)
    built = collect_each(lambda pair: _sensors_and_observation(*pair), pairs)
    for label, (parsed, observed) in zip(labels, built, strict=True):
        renamed = {number.name: joint_name(config, number.name, label) for number in parsed}
        for number in parsed:
            sensor_numbers.setdefault(
                renamed[number.name], number.for_experiment(label, renamed[number.name])
            )
        names = [joint_name(config, unknown.name, label) for unknown in observed.unknowns]
        for name, unknown in zip(names, observed.unknowns, strict=True):
            noise_unknowns.setdefault(
                name, unknown if name == unknown.name else unknown.for_experiment(label)
            )
        of_rig = [labelled_name(n, label if n in config.own else "") for n in rig.parameters]
        of_sensors = [renamed[name] for name in observed.parameters[len(of_rig) :]]
        parts.append(replace(observed, parameters=[*of_rig, *of_sensors], noise_names=names))
    numbers, other_numbers = (
        case.experiments[0].rig_numbers,
        ([*sensor_numbers.values()], [*noise_unknowns.values()]),
    )
    unknowns = numbers.space(config.own, labels, *other_numbers)
    posterior = Posterior(
        space=unknowns,
        likelihood=Likelihood.joint(unknowns, parts, case.held_out),
        coordinates=unknowns.coordinates(),
    )
    if config.model.pieces is None:
        posterior = step_error.choose_steps(
            posterior, unknowns.vector(unknowns.start), SEARCH_STEPS
        )
    table, published, tolerance = {**nominal.compared}, [*nominal.published], {**nominal.tolerance}
    for name, label in itertools.product(config.own, labels):
        if name in table:
            table[labelled_name(name, label)] = table[name]
        if name in published:
            published.append(labelled_name(name, label))
        tolerance[labelled_name(name, label)] = tolerance[name]
    return Problem(
        posterior=posterior,
        symbols=tuple(unknown.symbol for unknown in unknowns.unknowns),
        nominal=table,
        published=frozenset(published),
        tolerance=tolerance,
        derived=numbers.derived,
        units=_display_units(case),
        clock=_clock(records[0].written.time, posterior.likelihood.observations),
        compared_with=nominal.name,
    )


def _display_units(case: ResolvedCase) -> DisplayUnits:
    """Return the unit in which each number was declared.

    Noise and offsets have that of their column, quantities and formulas that of their entry.
    """
    config, sensed = case.config, dict[str, Unit]()
    for experiment in (
        experiment for experiment in case.experiments if experiment.label not in case.held_out
    ):
        shown_units = {
            symbols.noise_name(c.channel.name): c.channel.shown for c in experiment.channels
        }
        for number in experiment.sensor_numbers:
            if number.unit != number.symbol.unit:
                shown_units[number.name] = units.display_unit(number.unit, number.symbol.unit)
        sensed |= {
            joint_name(config, name, experiment.label): unit for name, unit in shown_units.items()
        }
    entries = {**config.quantities, **config.derived}
    declared = {n: spec.unit for n, spec in entries.items() if not isinstance(spec, float | int)}
    return DisplayUnits(
        sensed | {name: units.display_unit(unit) for name, unit in declared.items()}
    )


MAX_SHOWN_TIME = 1e4  # of the units of a record: nobody reads so many milliseconds


def _clock(unit: Unit, observations: Sequence[Observation]) -> Unit:
    """That of the time column of the first record, unless times in it are very many."""
    last = max(observation.experiment.t[-1] for observation in observations)
    return SECOND if last / unit.factor >= MAX_SHOWN_TIME else unit


def _sensors_and_observation(
    resolved: ResolvedExperiment, experiment: Experiment
) -> tuple[list[ParsedNumber], Observation]:
    response, sensor_numbers = build_simulator(resolved, experiment)
    experiment = response.experiment
    noise_model, section = build_noise(resolved.channels, len(experiment.t)), "record"
    try:
        noise_model = noise_for_record(noise_model, experiment.t, experiment.seen)
        section = "missing_torque"
        acts = sensors.latent_torque(resolved.config)
        return sensor_numbers, sensors.build_observation(
            acts, resolved.torque, response, noise_model, resolved.label
        )
    except ValueError as error:
        raise resolved.source.error((section,), str(error)) from None


def _undeclared_motion(resolved: ResolvedExperiment, experiment: Experiment) -> str:
    """A window that begins in motion has to say how."""
    config = resolved.config
    if config.record.window is None or config.initial.model_fields_set - {"time"}:
        return ""
    sigmas = [channel.noisy.start for channel in resolved.channels]
    motion = experiments.undeclared_motion(experiment, sigmas)
    if not motion or not experiment.series:
        return ""
    return (
        f"it begins in motion ({motion}), and the config says nothing of it; write `initial: free`, "
        "`initial: steady`, or the states there"
    )


def build_simulator(
    resolved: ResolvedExperiment, experiment: Experiment
) -> tuple[Simulator, list[ParsedNumber]]:
    """Return the simulator of one experiment, and the numbers of its sensors and its start."""
    sensor_numbers, wrong = [*resolved.sensor_numbers], dict[Location, str]()
    for entry, number in zip(resolved.sensor_entries, resolved.sensor_numbers, strict=True):
        if entry.kind in ("lag", "delay") and (
            message := experiments.start_too_late(number, experiment)
        ):
            wrong[entry.location] = message
    read = experiment
    if resolved.free_states:
        read = experiments.without_sensors(experiment, resolved.sensing, sensor_numbers)
    for name in resolved.free_states:
        try:
            sensor_numbers.append(
                experiments.free_start(name, read, resolved.model, _at_start(resolved))
            )
        except ValueError as error:
            wrong["initial", name] = str(error)
    if message := _undeclared_motion(resolved, experiment):
        wrong["record", "window"] = message
    visible = experiment
    if not wrong:
        values = {number.name: number.value for number in sensor_numbers}
        visible = experiments.start_beyond_lags(
            experiment, resolved.model, resolved.sensing, values
        )
        wrong = _hidden_channels(resolved, visible)
    if wrong:
        raise InputError(
            [resolved.source.issue(location, message) for location, message in wrong.items()]
        )
    return simulator(
        resolved.model, visible, resolved.sensing, resolved.config.model.pieces or 1
    ), sensor_numbers


def _hidden_channels(resolved: ResolvedExperiment, experiment: Experiment) -> dict[Location, str]:
    """Channels of which the lags leave nothing."""
    late = [entry for entry in resolved.sensor_entries if entry.kind in ("lag", "delay")]
    delays = [entry.location for entry in late if entry.location[0] == "inputs"]
    hidden: dict[Location, list[str]] = {}
    for name, count in zip(experiment.names, experiment.counts, strict=True):
        if count < 2:
            lag_location: Location = ("record", "channels", name, "lag")
            hidden.setdefault(delays[0] if delays else lag_location, []).append(name)
    return {
        location: "the rig moves at the start, and with so large a lag no sample of "
        f"{', '.join(names)} is sure to be later; give the lag a prior with a smaller end"
        for location, names in hidden.items()
    }


def _at_start(resolved: ResolvedExperiment) -> dict[str, float]:
    """The rig's parameters where searches begin."""
    space = resolved.space
    values = {**space.fixed, **space.start}
    values |= {name: float(r.value(values)) for name, r in space.relations.items()}
    return {name: values[name] for name in resolved.model.parameters}
