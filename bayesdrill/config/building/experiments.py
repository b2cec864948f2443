"""Split a config into one config for each experiment, and check what the experiments share."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Iterable, Mapping
from typing import Any

from bayesdrill.basics import symbols
from bayesdrill.basics.errors import Issue
from bayesdrill.config.building.case import LocalNumbers, ResolvedCase, ResolvedExperiment
from bayesdrill.config.building.missing_torque import TORQUE_ENTRIES
from bayesdrill.config.building.parameters import RigNumbers, check_used, free_parameters
from bayesdrill.config.building.settings import check_identify, check_unknown
from bayesdrill.config.schema import numbers
from bayesdrill.config.schema.config import Config
from bayesdrill.config.yaml_source import IssueCollector, Location, Source
from bayesdrill.inference.unknowns import ParameterSpace, Unknown, labelled_name
from bayesdrill.rig.models.linear import Model

SECTIONS = ("record", "inputs", "initial")  # sections whose entries an experiment may replace
PARAMETERS = "parameters"  # section whose entries an experiment may fix
EXPERIMENTS = "experiments"
SHARING_KEYS = ("shared", "own")  # unknowns with a common value in all experiments, or one in each


def split_experiments(source: Source) -> dict[str, Source]:
    """Return the source of each experiment, by name, as if it were the only one."""
    named = source.data.get(EXPERIMENTS)
    if not isinstance(named, Mapping):
        return {}
    return {
        label: experiment_source(source, label, entries)
        for label, entries in named.items()
        if isinstance(entries, Mapping)  # other entries are reported by the validation
    }


def join_experiments(source: Source, sources: Mapping[str, Source]) -> dict[str, Any]:
    """Return the config of the first experiment, with the sections of each under `experiments:`."""
    named = source.data[EXPERIMENTS]
    named = dict(named) if isinstance(named, Mapping) else named
    first = next(iter(sources.values()), source)
    for label, local in sources.items():
        named[label] = {**named[label], **{k: local.data[k] for k in SECTIONS if k in local.data}}
    common = {key: source.data[key] for key in SHARING_KEYS if key in source.data}
    common[PARAMETERS] = source.data.get(PARAMETERS, {})
    return {**first.data, EXPERIMENTS: named, **common}


def joint_name(config: Config, name: str, label: str) -> str:
    """Return an unknown's joint name, which has the experiment's label unless it is shared."""
    return name if name in config.shared else labelled_name(name, label)


def experiment_source(source: Source, label: str, local: Mapping[str, Any]) -> Source:
    """Return the source of one experiment, with `local` entries in place of common entries."""
    data = {k: v for k, v in source.data.items() if k not in (EXPERIMENTS, *SHARING_KEYS)}
    data = copy.deepcopy(data)
    for section in [name for name in (*SECTIONS, PARAMETERS) if name in local]:
        data[section] = merged_entries(data.get(section), local[section])
    lines, moved = dict(source.lines), dict[Location, Location]()
    prefix: Location = (EXPERIMENTS, label)
    for location, line in source.lines.items():
        if location[:2] == prefix and len(location) > 2:
            lines[location[2:]], moved[location[2:]] = line, location
    labels = tuple(map(str, source.data[EXPERIMENTS] or [label]))
    alone = dataclasses.replace(source, data=data, lines=lines, repeated=(), origins=moved)
    return dataclasses.replace(alone, labels=labels)


def merged_entries(common: Any, local: Any) -> Any:
    """Return the common entries, recursively replaced by the `local` entries."""
    if not (isinstance(common, Mapping) and isinstance(local, Mapping)):
        return copy.deepcopy(local)
    if _entry_kind(local) and _entry_kind(common) != _entry_kind(local):
        return copy.deepcopy(local)  # an entry of another kind is replaced as a whole
    merged = {key: value for key, value in common.items() if key not in local}
    return {
        **merged,
        **{key: merged_entries(common.get(key), value) for key, value in local.items()},
    }


def _entry_kind(entry: Mapping[str, Any]) -> str:
    """Return the key that identifies the kind of an entry, or an empty text."""
    return next((key for key in ("prior", "value", "rate") if key in entry), "")


# The key is an experiment's name, which is empty for a single experiment.
NumbersByLabel = Mapping[str, LocalNumbers]


def check_experiments(
    config: Config, source: Source, resolved: Mapping[str, ResolvedExperiment]
) -> list[Issue]:
    """Return the contradictions between experiments that are valid by themselves."""
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
        check_unknown(errors, config, unknown, space.relations)
        check_identify(errors, config, [x for x in space.free if x not in config.quantities])
    check_truth(errors, config, by_label)
    return errors.issues


def unknown_names(config: Config, model: Model, local: LocalNumbers) -> list[str]:
    """Return the names of all unknowns of a single experiment."""
    every = free_parameters(config, model.parameters)
    every += [n for n, q in config.quantities.items() if isinstance(q, numbers.QuantityPrior)]
    return list(dict.fromkeys([*every, *local.unknown]))


def _check_held(
    errors: IssueCollector, config: Config, resolved: Mapping[str, ResolvedExperiment]
) -> None:
    """Check that fixed parameters exist in the rigs of all experiments, and have no priors."""
    for label, experiment in resolved.items():
        for name in config.experiments[label].parameters:
            free = isinstance(experiment.config.parameters.get(name), numbers.ParameterPrior)
            without = [n for n, each in resolved.items() if name not in each.model.parameters]
            only = f"write a number or a formula here; for an unknown in each, `own: [{name}]`"
            both = f"{name} is `own:`, and so unknown in each; remove it here, or there"
            lacks = f"the rig of {' and '.join(without)} has no {name}; give it in all experiments"
            checks = ((free, only), (name in config.own, both), (without, lacks))
            if message := next((text for wrong, text in checks if wrong), ""):
                errors.add(("experiments", label, "parameters", name), message)


def _check_derived(errors: IssueCollector, joint: ResolvedCase, space: ParameterSpace) -> None:
    """Check that derived formulas contain only names of the joint problem."""
    known = {*space.free, *space.fixed, *space.relations, *symbols.DERIVED, *joint.config.derived}
    for formula in joint.experiments[0].rig_numbers.derived:
        for name in [name for name in formula.expression.names if name not in known]:
            others = dict.fromkeys(names.get(name, "") for names in joint.joint_names.values())
            way_out = f"name {' or '.join(others)}" if all(others) else "a shared name has no label"
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
        message = "no sensor, initial state, noise or experiment has such an unknown"
        known_names = _truth_names(config, by_label)
        errors.expect(("simulation", "truth", name), name, known_names, message)


def _truth_names(config: Config, by_label: NumbersByLabel) -> list[str]:
    """Return the names that `simulation.truth` may contain: `own` parameters, and local numbers."""
    pairs = [(label, name) for label in by_label for name in config.own]
    if config.missing_torque is not None:
        pairs += [(label, name) for label in by_label for name in TORQUE_ENTRIES]
    for label, local in by_label.items():
        sizes = {symbols.noise_name(name) for name in local.channels}  # given by `simulation.sigma`
        pairs += [(label, name) for name in local.numbers if name not in sizes]
    local_names = [labelled_name(name, label) for label, name in pairs if name not in config.shared]
    return list(dict.fromkeys([*(name for _, name in pairs), *local_names]))


def _check_local(
    errors: IssueCollector, config: Config, model: Model, each: Iterable[RigNumbers]
) -> None:
    free = free_parameters(config, model.parameters)
    related_names = check_used(errors, config, each)
    for k, name in enumerate(config.own):
        errors.expect(("own", k), name, free, f"{name} is no unknown parameter of the rig")
        if name in related_names:
            message = f"{name} is in a formula or tie, so all experiments share it; remove it here"
            errors.add(("own", k), message)


def _check_shared(
    errors: IssueCollector, config: Config, model: Model, by_label: NumbersByLabel
) -> None:
    """Check that a shared unknown is in several experiments, with the same prior."""
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
            message = f"{name} is held at a value, not unknown; remove it here"
            errors.add(location, message)
        elif len(having) == 1:
            message = f"only {having[0]} has {name}; give it in another one too, or remove it here"
            errors.add(location, message)
        elif any(value is None for value in values):
            state = name.removesuffix("_0")
            example = f"`{state}: {{prior: normal, mean: 0, sd: 1}}`"
            way_out = f"write one prior for all, such as {example}, or remove it here"
            errors.add(location, f"each record gives {name} a prior of its own; {way_out}")
        elif others := [n for n, x in zip(having, values, strict=True) if x != values[0]]:
            message = f"{name} has another prior in {others[0]} than in {having[0]}"
            way_out = "give it once, above `experiments:`, or remove it here"
            errors.add(location, f"{message}; {way_out}")


def _check_held_out(errors: IssueCollector, config: Config, by_label: NumbersByLabel) -> None:
    """Check that fitted experiments contain all unknowns of the held-out experiments."""
    held_out = [label for label, experiment in config.experiments.items() if experiment.held_out]
    if held_out and len(held_out) == len(by_label):
        message = "all are held out; at least one must be fitted"
        errors.add(("experiments", held_out[0], "held_out"), message)
        return
    fitted = [local for label, local in by_label.items() if label not in held_out]
    determined = {name for local in fitted for name in local.numbers if name in config.shared}
    for label in held_out:
        for k, name in enumerate(config.own):
            message = (
                f"no fitted record determines {name} of {label}, which is held out; remove it here"
            )
            errors.add(("own", k), message)
        if alone := ", ".join(n for n in by_label[label].unknown if n not in determined):
            undetermined = f"no fitted record determines {alone} of {label}"
            message = f"{undetermined}; give a number, or add it to `shared:`"
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
        other = used_names[name] or "something else"
        message = f"{name} could be {new_names[name]} or {other}; rename the experiment"
        errors.add(("experiments", label), message)
    used_names |= {name: meaning for name, meaning in new_names.items() if name not in clashes}
