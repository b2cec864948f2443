"""Load a YAML file as a `ResolvedCase`, or raise all of its errors at once."""

from __future__ import annotations

import copy
import dataclasses
import functools
import operator
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bayesdrill.basics.entries import build_member, members_by_entry, unknown_keys
from bayesdrill.basics.errors import InputError, Issue
from bayesdrill.basics.registry import lookup
from bayesdrill.config.building.case import ResolvedCase, ResolvedExperiment
from bayesdrill.config.building.experiment import build_experiment
from bayesdrill.config.building.experiments import (
    EXPERIMENTS,
    SHARING_KEYS,
    check_experiments,
    experiment_source,
    join_experiments,
    split_experiments,
)
from bayesdrill.config.schema.config import Config, ModelSpec
from bayesdrill.config.schema.messages import message_of
from bayesdrill.config.schema.validation import EntryError, read_config, read_entry
from bayesdrill.config.schema.vocabulary import HOUSE, Vocabulary, described_rigs, vocabulary_of
from bayesdrill.config.yaml_source import IssueCollector, Location, Source, read
from bayesdrill.rig.models import MODELS
from bayesdrill.rig.models.linear import Model

_FILE = "x.csv"  # replaces the name of the record's file if it is missing


def _stand_ins(words: Vocabulary) -> dict[Location, Any]:
    """Return substitutes for missing or invalid entries, so that other entries can be checked."""
    state = next(iter(words.states.values()))
    return {
        ("name",): "x",
        ("seed",): 0,
        ("record",): {},
        ("record", "file"): _FILE,
        ("record", "time"): {"rate": 1.0},
        ("record", "channels"): {state.name: {"column": 1, "unit": state.unit, "sigma": 1.0}},
        ("inputs",): {},
        ("parameters",): {},
    }


FRICTION_WALKERS = 96  # default number for nonlinear rigs, whose likelihood is expensive
WALKERS_PER_EXPERIMENT = 16  # added for each experiment, which may have unknowns of its own
NO_EXPERIMENT = (
    "no experiment stands here; name each, such as `slow: {record: {file: slow.csv}}`, or remove "
    "this entry"
)

NO_RECORD = "this experiment has no record; give `record: {file: ...}` in it"


def load(path: Path) -> ResolvedCase:
    """Load a config; raises `InputError` with all issues, sorted by line."""
    return validate(read(path))


def validate(source: Source, previous: ResolvedCase | None = None) -> ResolvedCase:
    """Validate a config that has been read; raises `InputError` as `load` does.

    Entries that have not changed since the case `previous` are not validated again.
    """
    if {"base", "runs"} <= source.data.keys():
        message = "is the file of a campaign; `check`, `campaign`, `watch` and `simulate` take it"
        raise InputError.at(str(source.path), message)
    words = load_vocabulary(source)
    known = {} if previous is None else {each.label: each for each in previous.experiments}
    if EXPERIMENTS in source.data:
        config, resolved = _load_several(source, words, known)
    else:
        alone = _load_single(source, words, known.get(""))
        config, resolved = alone.config, {"": alone}
    experiments_ = tuple(resolved.values())
    config = _with_walkers(config, experiments_[0].model)
    return ResolvedCase(config=config, source=source, experiments=experiments_)


def read_document[T](kind: type[T], source: Source) -> T:
    """Return a file's content as a section of class `kind`; raises `InputError` with all issues."""
    section, errors = read_entry(kind, source.data, ())
    located = _by_location(errors, source).items()
    problems = [source.issue(location, message_of(item, location)) for location, item in located]
    if problems or source.repeated:
        raise InputError(sorted({*source.repeated, *problems}, key=_line))
    document: T = section
    return document


def load_vocabulary(source: Source) -> Vocabulary:
    """Return the vocabulary of a config's rig; raises `InputError` if `model:` has mistakes.

    If the rig's symbols do not depend on `model:`, all mistakes are reported later, together.
    """
    data, kinds = source.data, MODELS.usable()
    entry = data.get("model") if isinstance(data, Mapping) else None
    described = described_rigs()
    parts = {n for n, having in members_by_entry(kinds).items() if {*having} <= {*described}}
    if not isinstance(entry, Mapping) or not (entry.get("name") in described or parts & {*entry}):
        return HOUSE
    errors = IssueCollector(source, frozenset())
    section, wrong = read_entry(ModelSpec, entry, ("model",))
    if section is not None:
        kind = errors.run(("model", "name"), lookup, MODELS, section.name, "model")
        surplus = {} if kind is None else unknown_keys(("name", "model"), kinds, kind, section)
        errors.add_all(("model",), surplus)
        if kind is not None and not surplus:
            rig = errors.run(("model", "name"), build_member, kind, section)
            if words := rig and errors.run(("model", "name"), vocabulary_of, rig):
                return words
    for item in wrong:
        location = _location(item["loc"], data)
        errors.add(location, message_of(item, location))
    raise InputError(sorted({*source.repeated, *errors.issues}, key=_line))


def _with_walkers(config: Config, model: Model) -> Config:
    """Give a nonlinear rig fewer walkers by default, as its likelihood is expensive."""
    sampler = config.sampler
    if "walkers" in sampler.model_fields_set or model.smooth:
        return config
    walkers = FRICTION_WALKERS + WALKERS_PER_EXPERIMENT * len(config.experiments)
    fewer = sampler.model_copy(update={"walkers": min(sampler.walkers, walkers)})
    return config.model_copy(update={"sampler": fewer})


def _load_several(
    source: Source, words: Vocabulary, previous: Mapping[str, ResolvedExperiment]
) -> tuple[Config, dict[str, ResolvedExperiment]]:
    """Return the joint config (see `join_experiments`), and each experiment by its label."""
    alone, resolved = split_experiments(source), dict[str, ResolvedExperiment]()
    problems = [*source.repeated]
    local_sources = alone or {"": experiment_source(source, "", {})}
    for label, local_source in local_sources.items():
        record = local_source.data.get("record", {})
        if isinstance(record, Mapping) and "file" not in record:
            data = {**local_source.data, "record": {**record, "file": _FILE}}
            local_source = dataclasses.replace(local_source, data=data)
            location = (EXPERIMENTS, label, "record", "file")
            problems += [source.issue(location, NO_RECORD)] if alone else []
        try:
            resolved[label] = _load_single(local_source, words, previous.get(label), label)
        except InputError as error:
            problems += error.problems
    whole, config = join_experiments(source, alone), None
    if alone or source.data[EXPERIMENTS]:
        first = next(iter(resolved.values()), None)
        config, errors = read_config(whole, words, None if first is None else first.validated)
        problems += [  # mistakes in other sections were reported for each experiment
            source.issue(location, message_of(item, location))
            for location, item in _by_location(errors, source).items()
            if location and location[0] in (EXPERIMENTS, *SHARING_KEYS)
        ]
    else:
        problems.append(source.issue((EXPERIMENTS,), NO_EXPERIMENT))
    if not problems and config is not None:
        problems += check_experiments(config, source, resolved)
    if problems or config is None:
        raise InputError(sorted(dict.fromkeys(problems), key=_line))
    return config, resolved


def _by_location(errors: list[EntryError], source: Source) -> dict[Location, EntryError]:
    """Return the last error of each entry; pydantic reports an error for each type of a union."""
    return {_location(item["loc"], source.data): item for item in errors}


def _load_single(
    source: Source, words: Vocabulary, previous: ResolvedExperiment | None, label: str = ""
) -> ResolvedExperiment:
    problems, resolved = list(source.repeated), None
    config, found = read_config(
        source.data, words, None if previous is None else previous.validated
    )
    if config is None:
        errors = _by_location(found, source)
        messages = {location: message_of(item, location) for location, item in errors.items()}
        intended = {_intended_location(item, at, messages[at]) for at, item in errors.items()}
        meant = intended - {None, *source.lines}
        implied = {at for at, item in errors.items() if at in meant and item["type"] == "missing"}
        problems += [source.issue(at, messages[at]) for at in errors if at not in implied]
        spoilt = [*errors, *filter(None, meant)]
        problems += _check_remaining(copy.deepcopy(source.data), spoilt, source, words)
    elif (
        previous is not None
        and config is previous.config
        and source.labels == previous.source.labels
    ):
        resolved = dataclasses.replace(previous, source=source)
    else:
        broken, resolved = build_experiment(config, source, frozenset(), label)
        problems += broken
    if not problems and resolved is not None:
        return resolved
    raise InputError(sorted(dict.fromkeys(problems), key=_line))


def _check_remaining(
    data: Any, spoilt: list[Location], source: Source, words: Vocabulary
) -> list[Issue]:
    """Remove the invalid entries, and check the remaining entries against each other."""
    for location in spoilt:
        _remove(data, location)
    for location, stand_in in _stand_ins(words).items():
        parent = functools.reduce(operator.getitem, location[:-1], data)
        if not parent.get(location[-1]):
            parent[location[-1]] = copy.deepcopy(stand_in)
    config, _ = read_config(data, words)
    return [] if config is None else build_experiment(config, source, frozenset(spoilt))[0]


def _intended_location(error: EntryError, location: Location, hint: str) -> Location | None:
    """Return the location of the correct key for a misspelt key; None for other errors."""
    suggestion = hint.rpartition("did you mean ")[2].rstrip("?")
    misspelt = error["type"] == "extra_forbidden" and suggestion != hint
    return (*location[:-1], suggestion) if misspelt else None


def _remove(data: Any, location: Location) -> None:
    """Remove the channel, or the entry of a section, that contains `location`."""
    entry = location[:3] if location[:2] == ("record", "channels") else location[:2]
    parent = data
    for part in entry[:-1]:
        parent = parent.get(part) if isinstance(parent, dict) else None
    if entry and isinstance(parent, dict):
        parent.pop(entry[-1], None)


def _location(loc: tuple[str | int, ...], data: Any) -> Location:
    """Return a location as the user wrote it, without the tags of pydantic's unions."""
    location: list[str | int] = []
    node = data
    for index, part in enumerate(loc):
        if isinstance(node, dict) and part in node:
            location.append(part)
            node = node[part]
        elif isinstance(node, list) and isinstance(part, int):
            location.append(part)
            node = node[part] if part < len(node) else None
        elif index == len(loc) - 1 and isinstance(node, dict) and not str(part).startswith("<"):
            location.append(part)
    return tuple(location)


def _line(problem: Issue) -> tuple[int, str]:
    parts = problem.place.split(": ")[0].rsplit(":", 1)
    return (int(parts[1]) if len(parts) == 2 and parts[1].isdigit() else 0, problem.place)
