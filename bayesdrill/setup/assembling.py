"""Records and what a config says of them, put together: simulators, noises, unknowns, a `Problem`."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

from bayesdrill.basics.errors import InputError, of_each
from bayesdrill.inference import pieces
from bayesdrill.inference.likelihood import Likelihood, Observation
from bayesdrill.inference.noise.mixed import of_record
from bayesdrill.inference.posterior import Posterior
from bayesdrill.inference.problem import Problem
from bayesdrill.inference.unknowns import Unknown, of_label
from bayesdrill.record.experiment import Experiment
from bayesdrill.rig.choosing import simulator
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.simulator import Simulator
from bayesdrill.setup import beginning, build, missing_torque, sensors
from bayesdrill.setup.config import Config
from bayesdrill.setup.experiments import View, common_or_own, held_out
from bayesdrill.setup.number_objects import formula
from bayesdrill.setup.sensors import Declared
from bayesdrill.setup.yaml_source import Place

FEW = 4  # steps to a sample, for the search of the maximum: there they are chosen anew


def problem(config: Config, views: Sequence[View], experiments: Sequence[Experiment]) -> Problem:
    """Everything, for records already read (`reading.read`), one of each view of the config.

    Raises `InputError` where records and what is said of them do not go together.
    """
    rig = build.model(config)
    labels = [view.label for view in views]
    parts, told, levels = [], dict[str, Declared](), dict[str, Unknown]()
    pairs = zip(views, experiments, strict=True)
    made = of_each(lambda pair: _told_and_observation(pair[0], rig, pair[1]), pairs)
    for view, (own, observed) in zip(views, made, strict=True):
        renamed = {each.name: common_or_own(config, each.name, view.label) for each in own}
        for each in own:
            told.setdefault(renamed[each.name], each.of(view.label, renamed[each.name]))
        names = [common_or_own(config, unknown.name, view.label) for unknown in observed.unknowns]
        for name, unknown in zip(names, observed.unknowns, strict=True):
            levels.setdefault(name, unknown if name == unknown.name else unknown.of(view.label))
        of_rig = [of_label(n, view.label if n in config.own else "") for n in rig.parameters]
        of_sensors = [renamed[name] for name in observed.parameters[len(of_rig) :]]
        parts.append(replace(observed, parameters=[*of_rig, *of_sensors], levels=names))
    unknowns = build.space(config, rig, [*levels.values()], [*told.values()], labels)
    posterior = Posterior(
        space=unknowns,
        likelihood=Likelihood.joint(unknowns, parts).without(held_out(config)),
        coordinates=unknowns.coordinates(),
    )
    if config.model.pieces is None:
        posterior = pieces.chosen(posterior, unknowns.vector(unknowns.start), FEW)
    table, published = {**build.compared(config)}, build.published(config)
    tolerance = build.tolerance(config)
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
        derived=tuple(formula(config, rig, name) for name in config.derived),
    )


def _told_and_observation(
    view: View, model: Model, experiment: Experiment
) -> tuple[list[Declared], Observation]:
    response, told = simulated(view, model, experiment)
    return told, _observation(view, model, response)


def _observation(view: View, model: Model, response: Simulator) -> Observation:
    """One record with the noise of its channels, and what shakes it."""
    experiment = response.experiment
    found, place = build.noise(build.channels(view.config, model), len(experiment.t)), "record"
    try:
        found = of_record(found, experiment.t, experiment.seen)
        place = "missing_torque"
        return missing_torque.observation(view.config, response, found, view.label)
    except ValueError as error:
        raise InputError([view.source.problem((place,), str(error))]) from None


def _unsaid_motion(config: Config, model: Model, experiment: Experiment) -> str:
    """A window that begins in motion has to say how."""
    if config.record.window is None or config.initial.model_fields_set - {"time"}:
        return ""
    levels = [one.noisy for one in build.channels(config, model)]
    sigmas = [one.sigma if isinstance(one.sigma, float) else one.start for one in levels]
    motion = beginning.unsaid_motion(experiment, sigmas)
    if not motion or not experiment.series:
        return ""
    return (
        f"it begins in motion ({motion}), and the config says nothing of it; write `initial: free`, "
        "`initial: steady`, or the states there"
    )


def simulated(view: View, model: Model, experiment: Experiment) -> tuple[Simulator, list[Declared]]:
    """One experiment with its sensors and its start, and the numbers that are told of them."""
    entries = [*sensors.entries(view.config, model)]
    told = [sensors.declared(entry) for entry in entries]
    sensing, wrong = sensors.sensing(view.config, model), dict[Place, str]()
    for entry, each in zip(entries, told, strict=True):
        if entry.kind in ("lag", "delay") and (said := beginning.too_late(each, experiment)):
            wrong[entry.place] = said
    for name in sensors.free_states(view.config, model):
        try:
            told.append(beginning.free(name, experiment, model, _at_start(view.config, model)))
        except ValueError as error:
            wrong["initial", name] = str(error)
    if said := _unsaid_motion(view.config, model, experiment):
        wrong["record", "window"] = said
    seen = experiment
    if not wrong:
        values = {each.name: each.value for each in told}
        seen = beginning.beyond_lags(experiment, sensing, values)
        wrong = _unseen(view, model, seen)
    if wrong:
        raise InputError([view.source.problem(place, said) for place, said in wrong.items()])
    return simulator(model, seen, sensing, view.config.model.pieces or 1), told


def _unseen(view: View, model: Model, experiment: Experiment) -> dict[Place, str]:
    """Channels of which the lags leave nothing."""
    late = [e for e in sensors.entries(view.config, model) if e.kind in ("lag", "delay")]
    delays = [e.place for e in late if e.place[0] == "inputs"]
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


def _at_start(config: Config, model: Model) -> dict[str, float]:
    """The rig's parameters where searches begin."""
    known = build.space(config, model, [])
    values = {**known.fixed, **known.start}
    values |= {name: float(r.value(values)) for name, r in known.relations.items()}
    return {name: values[name] for name in model.parameters}
