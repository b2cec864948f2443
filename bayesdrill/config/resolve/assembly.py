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
from bayesdrill.config.resolve.experiments import common_or_own
from bayesdrill.config.resolve.quantities import Declared
from bayesdrill.config.resolve.sensors import noise
from bayesdrill.config.schema.config import Config
from bayesdrill.config.yaml_source import Place
from bayesdrill.inference import step_error
from bayesdrill.inference.display_units import OwnUnits
from bayesdrill.inference.likelihood import Likelihood, Observation
from bayesdrill.inference.noise.mixed import of_record
from bayesdrill.inference.posterior import Posterior, Problem
from bayesdrill.inference.unknowns import Unknown, of_label
from bayesdrill.record.experiment import Experiment
from bayesdrill.rig.simulators import simulator
from bayesdrill.rig.simulators.contract import Simulator
from bayesdrill.sampling.optimisers import OPTIMISERS
from bayesdrill.sampling.optimisers.contract import Optimiser


def optimiser(config: Config) -> Optimiser:
    """How the MAP is searched."""
    return build_member(lookup(OPTIMISERS, config.map.method, "method"), config.map)


FEW = 4  # steps to a sample, for the search of the maximum: there they are chosen anew


def problem(case: ResolvedCase, records: Sequence[Experiment]) -> Problem:
    """Everything, for records already read (`reading.read`), one of each experiment.

    Raises `InputError` where records and what is said of them do not go together.
    """
    config, rig, nominal = case.config, case.model, case.nominal
    labels = [one.label for one in case.experiments]
    parts, told, levels = [], dict[str, Declared](), dict[str, Unknown]()
    pairs = zip(case.experiments, records, strict=True)
    made = collect_each(lambda pair: _told_and_observation(*pair), pairs)
    for label, (own, observed) in zip(labels, made, strict=True):
        renamed = {each.name: common_or_own(config, each.name, label) for each in own}
        for each in own:
            told.setdefault(renamed[each.name], each.of(label, renamed[each.name]))
        names = [common_or_own(config, unknown.name, label) for unknown in observed.unknowns]
        for name, unknown in zip(names, observed.unknowns, strict=True):
            levels.setdefault(name, unknown if name == unknown.name else unknown.of(label))
        of_rig = [of_label(n, label if n in config.own else "") for n in rig.parameters]
        of_sensors = [renamed[name] for name in observed.parameters[len(of_rig) :]]
        parts.append(replace(observed, parameters=[*of_rig, *of_sensors], levels=names))
    numbers, rest = case.experiments[0].numbers, ([*told.values()], [*levels.values()])
    unknowns = numbers.space(config.own, labels, *rest)
    posterior = Posterior(
        space=unknowns,
        likelihood=Likelihood.joint(unknowns, parts).without(case.held_out),
        coordinates=unknowns.coordinates(),
    )
    if config.model.pieces is None:
        posterior = step_error.chosen(posterior, unknowns.vector(unknowns.start), FEW)
    table, published, tolerance = {**nominal.compared}, [*nominal.published], {**nominal.tolerance}
    for name, label in itertools.product(config.own, labels):
        if name in table:
            table[of_label(name, label)] = table[name]
        if name in published:
            published.append(of_label(name, label))
        tolerance[of_label(name, label)] = tolerance[name]
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


def _display_units(case: ResolvedCase) -> OwnUnits:
    """Each as it was declared: noise and offsets in the unit of their column, quantities and formulas in
    that of their entry.
    """
    config, sensed = case.config, dict[str, Unit]()
    for one in (one for one in case.experiments if one.label not in case.held_out):
        own = {symbols.noise_name(c.channel.name): c.channel.shown for c in one.channels}
        for each in one.declared:
            if each.unit != each.symbol.unit:
                own[each.name] = units.display_unit(each.unit, each.symbol.unit)
        sensed |= {common_or_own(config, name, one.label): unit for name, unit in own.items()}
    entries = {**config.quantities, **config.derived}
    declared = {n: spec.unit for n, spec in entries.items() if not isinstance(spec, float | int)}
    return OwnUnits(sensed | {name: units.display_unit(unit) for name, unit in declared.items()})


MANY = 1e4  # of the units of a record: nobody reads so many milliseconds


def _clock(unit: Unit, observations: Sequence[Observation]) -> Unit:
    """That of the time column of the first record, unless times in it are very many."""
    last = max(one.experiment.t[-1] for one in observations)
    return SECOND if last / unit.factor >= MANY else unit


def _told_and_observation(
    one: ResolvedExperiment, experiment: Experiment
) -> tuple[list[Declared], Observation]:
    response, told = simulated(one, experiment)
    experiment = response.experiment
    found, place = noise(one.channels, len(experiment.t)), "record"
    try:
        found = of_record(found, experiment.t, experiment.seen)
        place = "missing_torque"
        acts = sensors.latent_torque(one.config)
        return told, sensors.observation(acts, one.torque, response, found, one.label)
    except ValueError as error:
        raise one.source.error((place,), str(error)) from None


def _unsaid_motion(one: ResolvedExperiment, experiment: Experiment) -> str:
    """A window that begins in motion has to say how."""
    config = one.config
    if config.record.window is None or config.initial.model_fields_set - {"time"}:
        return ""
    sigmas = [channel.noisy.start for channel in one.channels]
    motion = experiments.unsaid_motion(experiment, sigmas)
    if not motion or not experiment.series:
        return ""
    return (
        f"it begins in motion ({motion}), and the config says nothing of it; write `initial: free`, "
        "`initial: steady`, or the states there"
    )


def simulated(one: ResolvedExperiment, experiment: Experiment) -> tuple[Simulator, list[Declared]]:
    """One experiment with its sensors and its start, and the numbers that are told of them."""
    told, wrong = [*one.declared], dict[Place, str]()
    for entry, each in zip(one.entries, one.declared, strict=True):
        if entry.kind in ("lag", "delay") and (
            said := experiments.start_too_late(each, experiment)
        ):
            wrong[entry.place] = said
    for name in one.free:
        try:
            told.append(experiments.free_start(name, experiment, one.model, _at_start(one)))
        except ValueError as error:
            wrong["initial", name] = str(error)
    if said := _unsaid_motion(one, experiment):
        wrong["record", "window"] = said
    seen = experiment
    if not wrong:
        values = {each.name: each.value for each in told}
        seen = experiments.start_beyond_lags(experiment, one.sensing, values)
        wrong = _unseen(one, seen)
    if wrong:
        raise InputError([one.source.problem(place, said) for place, said in wrong.items()])
    return simulator(one.model, seen, one.sensing, one.config.model.pieces or 1), told


def _unseen(one: ResolvedExperiment, experiment: Experiment) -> dict[Place, str]:
    """Channels of which the lags leave nothing."""
    late = [entry for entry in one.entries if entry.kind in ("lag", "delay")]
    delays = [entry.place for entry in late if entry.place[0] == "inputs"]
    hidden: dict[Place, list[str]] = {}
    for name, left in zip(experiment.names, experiment.counts, strict=True):
        if left < 2:
            own: Place = ("record", "channels", name, "lag")
            hidden.setdefault(delays[0] if delays else own, []).append(name)
    return {
        place: "the rig moves at the start, and with so large a lag no sample of "
        f"{', '.join(names)} is sure to be later; give the lag a prior with a smaller end"
        for place, names in hidden.items()
    }


def _at_start(one: ResolvedExperiment) -> dict[str, float]:
    """The rig's parameters where searches begin."""
    known = one.space
    values = {**known.fixed, **known.start}
    values |= {name: float(r.value(values)) for name, r in known.relations.items()}
    return {name: values[name] for name in one.model.parameters}
