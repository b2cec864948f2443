"""Several experiments in one config: what they share, what is their own, and that all names differ."""

from __future__ import annotations

from collections.abc import Mapping

from bayesdrill.basics import symbols
from bayesdrill.basics.errors import Issue
from bayesdrill.config.consistency import unknowns, work
from bayesdrill.config.resolve import quantities, sensors
from bayesdrill.config.resolve.case import Beside, ResolvedExperiment
from bayesdrill.config.resolve.experiments import common_or_own
from bayesdrill.config.schema import numbers
from bayesdrill.config.schema.config import Config
from bayesdrill.config.yaml_source import Collector, Source
from bayesdrill.inference.unknowns import of_label
from bayesdrill.rig import models
from bayesdrill.rig.models.linear import Model

Alone = Mapping[str, Beside]  # each experiment by its name, which is empty where there is only one


def check_experiments(
    config: Config, source: Source, resolved: Mapping[str, ResolvedExperiment]
) -> list[Issue]:
    """Of a config whose experiments are each valid."""
    found = Collector(source, frozenset())
    for label in config.experiments:
        if not label.isidentifier():
            place = ("experiments", label)
            found.add(place, f"'{label}' cannot name an experiment; use letters, digits and `_`")
    if found.problems:
        return found.problems
    model = next(iter(resolved.values())).model
    every = {label: one.beside for label, one in resolved.items()}
    _check_own(found, config, model)
    _check_shared(found, config, model, every)
    _check_held_out(found, config, every)
    _check_names(found, config, every)
    if not found.problems:
        unknown = names(config, model, every)
        work.check_counts(found, config, unknown)
        work.check_map(found, config, unknown)
        work.check_output(found, config, model, unknown)
        work.check_identify(found, config, [*every])
    channels = dict.fromkeys(name for one in every.values() for name in one.channels)
    work.check_truth(found, config, [*channels], told(config, every))
    return found.problems


def names(config: Config, model: Model, every: Alone) -> list[str]:
    """Of all unknowns."""
    rig = [n for n in unknowns.free_parameters(config, model.parameters) if n not in config.own]
    own = unknowns.free_parameters(config, config.own)
    rest = [
        common_or_own(config, name, label) for label, one in every.items() for name in one.unknown
    ]
    each = [of_label(name, label) for name in own for label in every]
    priors = numbers.ParameterPrior
    free_quantities = [name for name, q in config.quantities.items() if isinstance(q, priors)]
    return list(dict.fromkeys([*rig, *each, *free_quantities, *rest]))


def told(config: Config, every: Alone) -> list[str]:
    """What a true value can be given for beside the rig, held or not: of one experiment, or of all."""
    found = [(label, name) for label in every for name in config.own]
    if config.missing_torque is not None:
        found += [(label, name) for label in every for name in sensors.ENTRIES]
    for label, one in every.items():
        sizes = {symbols.noise_name(name) for name in one.channels}  # `simulation.sigma`
        found += [(label, name) for name in one.sensors]
        found += [(label, name) for name in one.levels if name not in sizes]
    own = [of_label(name, label) for label, name in found if name not in config.shared]
    return list(dict.fromkeys([*(name for _, name in found), *own]))


def _check_own(found: Collector, config: Config, model: Model) -> None:
    free = unknowns.free_parameters(config, model.parameters)
    used = {
        name
        for other in model.parameters
        if (related := quantities.relation(config, model, other)) is not None
        for name in related.names
    }
    for k, name in enumerate(config.own):
        found.expect(("own", k), name, free, f"{name} is no unknown parameter of the rig")
        if name in used:
            message = f"a formula or tie names {name}, so that all experiments share it; remove one"
            found.add(("own", k), message)


def _check_shared(found: Collector, config: Config, model: Model, every: Alone) -> None:
    """What is shared is unknown in several experiments, with one prior."""
    of = {label: one.all for label, one in every.items()}
    known = [name for each in of.values() for name in each]
    for k, name in enumerate(config.shared):
        place = ("shared", k)
        having = [label for label, each in of.items() if name in each]
        values = [of[label][name] for label in having]
        if not having:
            rig = " (parameters of the rig are shared unless they are `own:`)"
            message = f"{name} is no unknown of a sensor, a start or noise"
            message += rig if name in model.parameters else ""
            found.expect(place, name, list(dict.fromkeys(known)), message)
        elif any(isinstance(value, float) for value, _ in values):
            found.add(place, f"{name} is held, so that nothing is unknown of it; remove it here")
        elif len(having) == 1:
            message = f"only {having[0]} has {name}; give it to another one, or remove it here"
            found.add(place, message)
        elif any(value is None for value, _ in values):
            state = name.removesuffix("_0")
            message = (
                f"each record gives {name} a prior of its own; give one in all, such as `{state}: "
                "{prior: normal, mean: 0, sd: 1}`, or remove it here"
            )
            found.add(place, message)
        elif any(what != values[0][1] for _, what in values):
            other = next(
                n for n, (_, what) in zip(having, values, strict=True) if what != values[0][1]
            )
            message = (
                f"{name} has another prior in {other} than in {having[0]}; give it once, above "
                "`experiments:`, or remove it here"
            )
            found.add(place, message)


def _check_held_out(found: Collector, config: Config, every: Alone) -> None:
    """What is predicted of an experiment that is no evidence, others have to tell."""
    away = [label for label, one in config.experiments.items() if one.held_out]
    if away and len(away) == len(every):
        found.add(("experiments", away[0], "held_out"), "all are held out; leave one to be fitted")
        return
    told = {n for label, one in every.items() if label not in away for n in one.all}
    for label in away:
        place = ("experiments", label, "held_out")
        for k, name in enumerate(config.own):
            message = f"nothing tells {name} of {label}, which is held out; remove it here"
            found.add(("own", k), message)
        alone = [
            name for name in every[label].unknown if not (name in config.shared and name in told)
        ]
        if alone:
            names_of = ", ".join(alone)
            message = f"nothing tells {names_of} of {label}; give a number, or add it to `shared:`"
            found.add(place, message)


def _check_names(found: Collector, config: Config, every: Alone) -> None:
    """That no two unknowns, and no two columns of results, have one name."""
    taken = dict.fromkeys([*models.PARAMETERS, *config.quantities, *symbols.DERIVED], "")
    taken |= dict.fromkeys(config.derived, "")
    before = len(found.problems)
    for label, one in every.items():
        own = {of_label(name, label): f"{name} of {label}" for name in config.own}
        for name in one.all:
            if name not in config.shared:
                own[of_label(name, label)] = f"{name} of {label}"
        _no_clash(found, label, own, taken)
    columns = dict[str, str]()
    for label, one in every.items() if len(found.problems) == before else ():
        here = {of_label(n, label): f"{n} of {label}" for n in (*one.channels, *symbols.INPUTS)}
        _no_clash(found, label, here, columns)


def _no_clash(found: Collector, label: str, own: Mapping[str, str], taken: dict[str, str]) -> None:
    clashes = [name for name in own if name in taken]
    for name in clashes[:1]:
        other = f"that of {taken[name]}" if taken[name] else "another meaning already"
        message = f"the name {name} of {own[name]} is {other}; rename the experiment"
        found.add(("experiments", label), message)
    taken |= {name: said for name, said in own.items() if name not in clashes}
