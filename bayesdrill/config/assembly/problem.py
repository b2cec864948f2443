"""Build the `Problem` of a resolved case and its records: simulators, noises, unknowns, units."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

from bayesdrill.basics import symbols, units
from bayesdrill.basics.errors import collect_each
from bayesdrill.basics.units import SECOND, Unit
from bayesdrill.config.assembly.lags import check_lag, start_beyond_lags, without_sensors
from bayesdrill.config.assembly.starts import check_at_rest, free_start
from bayesdrill.config.building.case import ResolvedCase, ResolvedExperiment
from bayesdrill.config.building.channels import build_noise
from bayesdrill.config.building.experiments import joint_name
from bayesdrill.config.building.missing_torque import latent_torque
from bayesdrill.config.building.parsed_numbers import ParsedNumber
from bayesdrill.config.yaml_source import IssueCollector, Location
from bayesdrill.inference import step_error
from bayesdrill.inference.display_units import DisplayUnits
from bayesdrill.inference.likelihood import Observation, observe
from bayesdrill.inference.noise.mixed import noise_for_record
from bayesdrill.inference.posterior import Likelihood, Posterior, Problem
from bayesdrill.inference.unknowns import Unknown, labelled_name
from bayesdrill.record.experiment import Experiment, raise_if_any
from bayesdrill.rig.simulators import simulator
from bayesdrill.rig.simulators.contract import Simulator

MAX_SHOWN_TIME = 1e4  # largest time that is shown in the record's unit; longer times are shown in s
SEARCH_STEPS = 4  # upper limit of integration steps per sample in the MAP search


def build_problem(case: ResolvedCase, records: Sequence[Experiment]) -> Problem:
    """Build the problem of a case and its records; raises `InputError` if they do not fit together."""
    config, rig, nominal = case.config, case.model, case.experiments[0].nominal
    labels, names_of = [experiment.label for experiment in case.experiments], case.joint_names
    parts, sensor_numbers, noise_unknowns = [], dict[str, ParsedNumber](), dict[str, Unknown]()
    pairs = zip(case.experiments, records, strict=True)
    built = collect_each(lambda pair: _sensors_and_observation(*pair), pairs)
    for label, (parsed, observed) in zip(labels, built, strict=True):
        for number in parsed:
            joint = number if number.name in config.shared else number.for_experiment(label)
            sensor_numbers.setdefault(joint.name, joint)
        for unknown in observed.unknowns:
            level = unknown if unknown.name in config.shared else unknown.for_experiment(label)
            noise_unknowns.setdefault(level.name, level)
        parameters = [names_of[label][name] for name in rig.parameters]
        sensor_names = observed.parameters[len(parameters) :]
        parameters += [joint_name(config, name, label) for name in sensor_names]
        names = [joint_name(config, unknown.name, label) for unknown in observed.unknowns]
        parts.append(replace(observed, parameters=parameters, noise_names=names))
    unknowns = case.space([*sensor_numbers.values()], [*noise_unknowns.values()])
    if not unknowns.unknowns:
        message = "no parameter is unknown; give at least one of them a prior, or only simulate"
        raise case.source.error(("parameters",), message)
    posterior = Posterior(
        space=unknowns,
        likelihood=Likelihood.joint(unknowns, parts, case.held_out),
        coordinates=unknowns.coordinates,
    )
    if config.model.pieces is None:
        start = unknowns.vector(unknowns.start)
        posterior = step_error.choose_steps(posterior, start, SEARCH_STEPS)
    clock = records[0].written.time
    last = max(each.experiment.t[-1] for each in posterior.likelihood.observations)
    if last / clock.factor >= MAX_SHOWN_TIME:
        clock = SECOND
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
        derived=case.experiments[0].rig_numbers.derived,
        units=_display_units(case),
        clock=clock,
        compared_with=nominal.name,
    )


def _display_units(case: ResolvedCase) -> DisplayUnits:
    """Return the display units of numbers; noise and offsets have the unit of their column."""
    config, shown_units = case.config, dict[str, Unit]()
    for resolved in case.experiments:
        if resolved.label in case.held_out:
            continue
        channels = [measured.channel for measured in resolved.channels]
        local = {symbols.noise_name(channel.name): channel.display_unit for channel in channels}
        for number in resolved.sensor_numbers.values():
            if number.unit != number.symbol.unit:
                local[number.name] = units.display_unit(number.unit, number.symbol.unit)
        shown_units |= {joint_name(config, n, resolved.label): unit for n, unit in local.items()}
    for name, spec in {**config.quantities, **config.derived}.items():
        if not isinstance(spec, float | int):
            shown_units[name] = units.display_unit(spec.unit)
    return DisplayUnits(shown_units)


def _sensors_and_observation(
    resolved: ResolvedExperiment, experiment: Experiment
) -> tuple[list[ParsedNumber], Observation]:
    response, sensor_numbers = build_simulator(resolved, experiment)
    experiment = response.experiment
    noise_model, section = build_noise(resolved.channels, len(experiment.t)), "record"
    try:
        noise_model = noise_for_record(noise_model, experiment.t, experiment.is_measured)
        section = "missing_torque"
        acts = latent_torque(resolved.config)
        observed = observe(response, noise_model, resolved.label, acts, resolved.torque)
        return sensor_numbers, observed
    except ValueError as error:
        raise resolved.source.error((section,), str(error)) from None


def build_simulator(
    resolved: ResolvedExperiment, experiment: Experiment
) -> tuple[Simulator, list[ParsedNumber]]:
    """Return the simulator of one experiment, and the gains, offsets, lags and initial states."""
    model, sensing, free = resolved.model, resolved.sensing, resolved.free_states
    errors = IssueCollector(resolved.source, frozenset())
    late = {e: n for e, n in resolved.sensor_numbers.items() if e.kind in ("lag", "delay")}
    for entry, number in late.items():
        errors.run(entry.location, check_lag, number, experiment)
    sensor_numbers = [*resolved.sensor_numbers.values()]
    read = without_sensors(experiment, sensing, sensor_numbers) if free else experiment
    for name in free:
        arguments = (name, read, model, _at_start(resolved))
        if start := errors.run(("initial", name), free_start, *arguments):
            sensor_numbers.append(start)
    window, declared = resolved.config.record.window, resolved.config.initial.model_fields_set
    if window is not None and experiment.series and not declared - {"time"}:
        sigmas = [channel.start for channel in resolved.channels]
        errors.run(("record", "window"), check_at_rest, experiment, sigmas)
    raise_if_any(errors.issues)
    values = {number.name: number.value for number in sensor_numbers}
    visible = start_beyond_lags(experiment, model, sensing, values)
    delays = [entry.location for entry in late if entry.location[0] == "inputs"]
    _check_hidden(errors, visible, delays)
    raise_if_any(errors.issues)
    pieces = resolved.config.model.pieces or 1
    return simulator(model, visible, sensing, pieces), sensor_numbers


def _check_hidden(
    errors: IssueCollector, experiment: Experiment, delays: Sequence[Location]
) -> None:
    """Add an issue for each channel that keeps fewer than two samples because of the lags."""
    hidden: dict[Location, list[str]] = {}
    for name, count in zip(experiment.names, experiment.counts, strict=True):
        if count < 2:
            location = delays[0] if delays else ("record", "channels", name, "lag")
            hidden.setdefault(location, []).append(name)
    for location, names in hidden.items():
        lost = f"samples of {', '.join(names)} may all show motion before it, because of the lag"
        way_out = "Give the lag a prior with a smaller upper end"
        errors.add(location, f"the rig moves at the start, and {lost}. {way_out}")


def _at_start(resolved: ResolvedExperiment) -> dict[str, float]:
    """Return the parameters of the rig, in SI, at which the MAP search begins."""
    space = resolved.rig_numbers.space()
    values = {**space.fixed, **space.start}
    values |= {name: float(r.value(values)) for name, r in space.relations.items()}
    return {name: values[name] for name in resolved.model.parameters}
