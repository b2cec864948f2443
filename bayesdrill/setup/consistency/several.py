"""Sensors and starts, and several experiments in one config: what they share and what is their own."""

from __future__ import annotations

from bayesdrill.basics.errors import Problem
from bayesdrill.inference.unknowns import of_label
from bayesdrill.rig import vocabulary
from bayesdrill.rig.models.linear import Model
from bayesdrill.setup import build, number_entries, number_objects, sensors
from bayesdrill.setup.config import Config
from bayesdrill.setup.consistency import unknowns
from bayesdrill.setup.consistency.collector import Collector
from bayesdrill.setup.experiments import split
from bayesdrill.setup.yaml_source import Source


def check_sensors(found: Collector, config: Config, model: Model) -> None:
    for entry in sensors.entries(config, model):
        found.run(entry.place, sensors.declared, entry)
    found.run(("inputs",), sensors.sensing, config, model)
    names = [entry.name for entry in sensors.entries(config, model)]
    names += [sensors.state_name(name) for name in sensors.free_states(config, model)]
    for name in config.quantities:
        if name in names:
            found.add(("quantities", name), "a sensor's number has this name; choose another one")
    if config.initial.state == "steady":
        _check_steady(found, config, model)


def _check_steady(found: Collector, config: Config, model: Model) -> None:
    """The inputs give all but where the angles begin."""
    named = [name for name in model.states if name in config.initial.model_fields_set]
    angles = [name for name in named if vocabulary.STATES[name].unit == "rad"]
    for name in named:
        if name not in angles:
            found.add(
                ("initial", name),
                "the steady state gives it; remove this entry, or `state: steady`",
            )
    for name in angles[1:]:
        message = (
            f"the steady state gives the twist, and {angles[0]} the rest; remove one of the two"
        )
        found.add(("initial", name), message)


def check_experiments(config: Config, source: Source) -> list[Problem]:
    """Of a config whose experiments are each valid."""
    found = Collector(source, frozenset())
    model = found.run(("model", "name"), build.model, config)
    for label in config.experiments:
        if not label.isidentifier():
            place = ("experiments", label)
            found.add(place, f"'{label}' cannot name an experiment; use letters, digits and `_`")
    if model is None or found.problems:
        return found.problems
    _check_own(found, config, model)
    known = _told(config, model, source)
    for k, name in enumerate(config.shared):
        message = f"{name} is no number of a sensor, start or noise (the rig's are shared anyway)"
        found.expect(("shared", k), name, known, message)
    _check_alike(found, config, model, source)
    return found.problems


def _check_own(found: Collector, config: Config, model: Model) -> None:
    free = unknowns.free_parameters(config, model.parameters)
    used = {
        name
        for other in model.parameters
        if (related := number_objects.relation(config, model, other)) is not None
        for name in related.names
    }
    for k, name in enumerate(config.own):
        found.expect(("own", k), name, free, f"{name} is no unknown parameter of the rig")
        if name in used:
            found.add(
                ("own", k), f"a formula or tie names {name}, so that all experiments share it"
            )
    every = [of_label(name, label) for name in config.own for label in config.experiments]
    for name in every:
        if name in vocabulary.PARAMETERS or name in config.quantities:
            found.add(("own",), f"{name} has another meaning already; rename the experiment")


def _told(config: Config, model: Model, source: Source) -> list[str]:
    names: list[str] = []
    for own in split(source).values():
        one = Config.model_validate(own.data)
        names += [entry.name for entry in sensors.entries(one, model)]
        names += [sensors.state_name(name) for name in sensors.free_states(one, model)]
        names += unknowns.scatter(one, model)
    return list(dict.fromkeys(names))


def _check_alike(found: Collector, config: Config, model: Model, source: Source) -> None:
    """What is shared has one value or prior."""
    given: dict[str, tuple[str, object]] = {}
    for label, own in split(source).items():
        one = Config.model_validate(own.data)
        specs: dict[str, object] = {e.name: e.spec for e in sensors.entries(one, model)}
        for name, channel in one.record.channels.items():
            if isinstance(channel.sigma, number_entries.PriorBase):
                specs[f"sigma_{name}"] = (channel.sigma, channel.unit)
        for name, spec in specs.items():
            first = given.setdefault(name, (label, spec))
            if name in config.shared and first[1] != spec:
                place = ("shared", config.shared.index(name))
                found.add(place, f"{name} is given otherwise in {label} than in {first[0]}")
