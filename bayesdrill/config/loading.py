"""Load a YAML file as a `ResolvedCase`, or raise all of its errors at once."""

from __future__ import annotations

import copy
import dataclasses
import functools
import operator
import typing
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from bayesdrill.basics.entries import SMALLEST, build_member, members_by_entry, unknown_keys
from bayesdrill.basics.errors import InputError, Issue, did_you_mean, shortened
from bayesdrill.basics.registry import lookup
from bayesdrill.config.resolve import case, experiments, quantities, record, sensors, work
from bayesdrill.config.resolve.case import LocalNumbers, ResolvedCase, ResolvedExperiment
from bayesdrill.config.schema.config import Config, ModelSpec
from bayesdrill.config.schema.numbers import PriorSpec, families_of
from bayesdrill.config.schema.validation import EntryError, read_config, read_entry
from bayesdrill.config.schema.vocabulary import HOUSE, Vocabulary, described_rigs, vocabulary_of
from bayesdrill.config.yaml_source import IssueCollector, Location, Source, read
from bayesdrill.inference.priors import PRIORS
from bayesdrill.rig.models import MODELS
from bayesdrill.rig.models.linear import Model

_FILE = "x.csv"


def _stand_ins(words: Vocabulary) -> dict[Location, Any]:
    """Return substitutes for missing or invalid entries, so that the others can be checked."""
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


FRICTION_WALKERS = 96
WALKERS_PER_EXPERIMENT = 16  # additional ones, as each experiment may have unknowns of its own
NO_EXPERIMENT = (
    "no experiment stands here; name each, such as `slow: {record: {file: slow.csv}}`, or remove "
    "this entry"
)

NO_RECORD = "this experiment has no record; give `record: {file: ...}` in it"


def load(path: Path) -> ResolvedCase:
    """Load a config; raises `InputError` with every issue, in the order of their lines."""
    return validate(read(path))


def validate(source: Source, before: ResolvedCase | None = None) -> ResolvedCase:
    """Validate a config that has been read; see `load`.

    Entries that are the same in a case `before` it are not validated again.
    """
    words = load_vocabulary(source)
    known = {} if before is None else {each.label: each for each in before.experiments}
    if experiments.EXPERIMENTS in source.data:
        config, resolved = _load_several(source, words, known)
    else:
        alone = _load_single(source, words, known.get(""))
        config, resolved = alone.config, {"": alone}
    experiments_ = tuple(resolved.values())
    config = _with_walkers(config, experiments_[0].model)
    return ResolvedCase(config=config, source=source, experiments=experiments_)


def load_vocabulary(source: Source) -> Vocabulary:
    """Return the names that a config may use; raises `InputError` if there is no such rig.

    Mistakes in a rig of fixed symbols are reported later, together with all others.
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
        vain = {} if kind is None else unknown_keys(("name", "model"), kinds, kind, section)
        errors.add_all(("model",), vain)
        if kind is not None and not vain:
            rig = errors.run(("model", "name"), build_member, kind, section)
            if words := rig and errors.run(("model", "name"), vocabulary_of, rig):
                return words
    for item in wrong:
        location = _location(item["loc"], data)
        errors.add(location, _message(item, location))
    raise InputError(sorted({*source.repeated, *errors.issues}, key=_line))


def _with_walkers(config: Config, model: Model) -> Config:
    """Give a rig with friction fewer walkers by default, as its steps are expensive."""
    sampler = config.sampler
    if "walkers" in sampler.model_fields_set or model.smooth:
        return config
    walkers = FRICTION_WALKERS + WALKERS_PER_EXPERIMENT * len(config.experiments)
    fewer = sampler.model_copy(update={"walkers": min(sampler.walkers, walkers)})
    return config.model_copy(update={"sampler": fewer})


def _load_several(
    source: Source, words: Vocabulary, known: Mapping[str, ResolvedExperiment]
) -> tuple[Config, dict[str, ResolvedExperiment]]:
    """Return the config of the first experiment, which lists them all, and all experiments by label."""
    alone, resolved = experiments.split_experiments(source), dict[str, ResolvedExperiment]()
    problems = [*source.repeated]
    local_sources = alone or {"": experiments.experiment_source(source, "", {})}
    for label, local_source in local_sources.items():
        record = local_source.data.get("record", {})
        if isinstance(record, Mapping) and "file" not in record:
            data = {**local_source.data, "record": {**record, "file": _FILE}}
            local_source = dataclasses.replace(local_source, data=data)
            location = (experiments.EXPERIMENTS, label, "record", "file")
            problems += [source.issue(location, NO_RECORD)] if alone else []
        try:
            resolved[label] = _load_single(local_source, words, known.get(label), label)
        except InputError as error:
            problems += error.problems
    whole, config = experiments.join_experiments(source, alone), None
    if alone or source.data[experiments.EXPERIMENTS]:
        first = next(iter(resolved.values()), None)
        config, errors = read_config(whole, words, first and first.validated)
        problems += [  # other mistakes are reported by the experiments
            source.issue(location, _message(item, location))
            for location, item in _by_location(errors, source).items()
            if location and location[0] in (experiments.EXPERIMENTS, *experiments.SHARING_KEYS)
        ]
    else:
        problems.append(source.issue((experiments.EXPERIMENTS,), NO_EXPERIMENT))
    if not problems and config is not None:
        problems += experiments.check_experiments(config, source, resolved)
    if problems or config is None:
        raise InputError(sorted(dict.fromkeys(problems), key=_line))
    return config, resolved


def _by_location(errors: list[EntryError], source: Source) -> dict[Location, EntryError]:
    """Keep the last error of each entry, as every member of a union reports the same entry."""
    return {_location(item["loc"], source.data): item for item in errors}


def _load_single(
    source: Source, words: Vocabulary, known: ResolvedExperiment | None, label: str = ""
) -> ResolvedExperiment:
    problems, resolved = list(source.repeated), None
    config, found = read_config(source.data, words, known and known.validated)
    if config is None:
        errors = _by_location(found, source)
        messages = {location: _message(item, location) for location, item in errors.items()}
        intended = {_intended_location(item, at, messages[at]) for at, item in errors.items()}
        meant = intended - {None, *source.lines}
        implied = {at for at, item in errors.items() if at in meant and item["type"] == "missing"}
        problems += [source.issue(at, messages[at]) for at in errors if at not in implied]
        spoilt = [*errors, *filter(None, meant)]
        problems += _check_remaining(copy.deepcopy(source.data), spoilt, source, words)
    elif known is not None and config is known.config and source.labels == known.source.labels:
        resolved = dataclasses.replace(known, source=source)
    else:
        broken, resolved = _resolve(config, source, frozenset(), label)
        problems += broken
    if not problems and resolved is not None:
        return resolved
    raise InputError(sorted(dict.fromkeys(problems), key=_line))


def _check_remaining(
    data: Any, spoilt: list[Location], source: Source, words: Vocabulary
) -> list[Issue]:
    """Check the remaining entries against each other, after the invalid ones are taken out."""
    for location in spoilt:
        _remove(data, location)
    for location, stand_in in _stand_ins(words).items():
        parent = functools.reduce(operator.getitem, location[:-1], data)
        if not parent.get(location[-1]):
            parent[location[-1]] = copy.deepcopy(stand_in)
    config, _ = read_config(data, words)
    return [] if config is None else _resolve(config, source, frozenset(spoilt))[0]


def _intended_location(error: EntryError, location: Location, hint: str) -> Location | None:
    """Return the location that a misspelt key was meant for, so that it is not reported as missing."""
    suggestion = hint.rpartition("did you mean ")[2].rstrip("?")
    misspelt = error["type"] == "extra_forbidden" and suggestion != hint
    return (*location[:-1], suggestion) if misspelt else None


def _resolve(
    config: Config, source: Source, spoilt: frozenset[Location], label: str = ""
) -> tuple[list[Issue], ResolvedExperiment | None]:
    """Build an experiment of a config with valid entries; return the issues and the experiment.

    Mistakes at `spoilt` locations were reported already.
    """
    errors, alone = IssueCollector(source, spoilt), not source.labels
    names = config.vocabulary.parameters
    spoilt_names = [name for name in names if errors.is_reported(("parameters", name))]
    model = errors.run(("model", "name"), case.build_model, config, spoilt_names)
    given_nominal = {} if model is None else case.check_nominal(errors, config, model)
    nominal = errors.run(("nominal", "table"), quantities.nominal_table, config, given_nominal)
    resolved = None
    if model is not None:
        vain = unknown_keys(("name", "model"), MODELS.usable(), type(model), config.model)
        errors.add_all(("model",), vain)
        rig = None if nominal is None else case.check_rig(errors, config, model, nominal)
        channels = record.check_channels(errors, config, model)
        free = sensors.free_states(config, model)
        sensor_numbers, sensing = record.check_sensors(errors, config, model, free)
        torque = case.check_torque(errors, config, model, sensing)
        local_numbers = record.local_numbers(config, channels, sensor_numbers, free, torque)
        _check_own_names(errors, config, local_numbers)
        work.check_settings(errors, config)
        if alone:
            unknown = experiments.unknown_names(config, model, local_numbers)
            tied = [name for name in names if quantities.is_tied(config.parameters.get(name))]
            work.check_unknown(errors, config, unknown, tied)
            experiments.check_truth(errors, config, {"": local_numbers})
        if nominal is not None and rig is not None and sensing is not None:
            resolved = ResolvedExperiment(
                label=label,
                config=config,
                source=source,
                model=model,
                nominal=nominal,
                rig_numbers=rig,
                channels=tuple(channel for channel in channels.values() if channel is not None),
                sensor_numbers={e: x for e, x in sensor_numbers.items() if x is not None},
                sensing=sensing,
                free_states=free,
                torque={name: x for name, x in torque.items() if x is not None},
                local_numbers=local_numbers,
            )
    message = "there is one experiment alone; remove this entry, or add `experiments:`"
    for key in ("shared", "own"):
        if getattr(config, key) and alone:
            errors.add((key,), message)
    record.check_record(errors, config)
    record.check_inputs(errors, config, model)
    work.check_simulation(errors, config)
    work.check_calibration(errors, config)
    if alone:
        work.check_identify(errors, config, case.free_parameters(config, names))
    return errors.issues, None if errors.issues else resolved


def _check_own_names(errors: IssueCollector, config: Config, local: LocalNumbers) -> None:
    """Check that no quantity or formula has the name of an unknown of sensors, noise or torque.

    With several experiments these names have a label, and formulas are checked against them later.
    """
    for section in ("quantities",) if errors.source.labels else ("quantities", "derived"):
        for name in getattr(config, section):
            if name in local.numbers and not name.startswith("sigma_"):  # refused for any quantity
                message = "a sensor's number, or one of noise or torque, has this name"
                errors.add((section, name), f"{message}; choose another one")


def _remove(data: Any, location: Location) -> None:
    """Remove the channel, or the entry of a section, that contains `location`."""
    entry = location[:3] if location[:2] == ("record", "channels") else location[:2]
    parent = data
    for part in entry[:-1]:
        parent = parent.get(part) if isinstance(parent, dict) else None
    if entry and isinstance(parent, dict):
        parent.pop(entry[-1], None)


def _location(loc: tuple[str | int, ...], data: Any) -> Location:
    """Return the path as the user wrote it, without the tags of pydantic's unions."""
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


def _message(error: EntryError, location: Location) -> str:
    kind, value, context = error["type"], error["input"], error.get("ctx", {})
    match kind:
        case "extra_forbidden":
            word = "symbol" if location[0] == "parameters" and len(location) == 2 else "key"
            if value is None and str(location[-1]).isdigit():
                return f"unknown {word}; if a decimal comma made it, write a point"
            if "<tie>" in error["loc"]:
                return "a tied parameter has nothing else; remove this entry, or the tie"
            near = did_you_mean(str(location[-1]), _keys_at(error))
            return f"unknown {word}{near}"
        case "missing":
            return "this entry is missing; see `bayesdrill schema` or configs/nominal_step.yaml"
        case "union_tag_not_found":
            return f"the entry `prior:` is missing{did_you_mean('', PRIORS)}"
        case "union_tag_invalid" if str(context["tag"]).startswith("<"):
            if "<number>" in context["expected_tags"]:
                way_out = _hint(value) or "; a number or `{key: value}` entries can stand here"
                return f"{_shown(value)} is not a number{way_out}"
            return f"{_shown(value)} stands where `key: value` entries are wanted"
        case "union_tag_invalid" | "literal_error":
            tag = context.get("tag", value)
            if kind == "literal_error" and location[0] == "parameters":
                hint = _hint(value)
                return f"{_shown(value)} is neither a number, nor `nominal`, nor a prior{hint}"
            return f"'{tag}' is not possible{did_you_mean(str(tag), _known(error))}"
        case "float_type" | "int_type" | "int_from_float":
            adjective = "whole " if kind.startswith("int") else ""
            return f"{_shown(value)} is not a {adjective}number{_hint(value)}"
        case "greater_than_equal" | "less_than_equal":
            lower_bound = context.get("ge")
            if lower_bound == SMALLEST and value <= 0:
                return f"{_shown(value)}: it should be greater than 0"
            side, bound = ("greater", lower_bound) if "ge" in context else ("less", context["le"])
            return f"{_shown(value)}: it should be {side} than or equal to {bound}"
        case "bool_type":
            return f"{_shown(value)} is neither `true` nor `false`"
        case "too_short":
            return f"{len(value)} entries stand here, wanted are at least {context['min_length']}"
        case "too_long":
            max_length = context["max_length"]
            surplus = ", ".join(map(str, [*value][max_length:]))
            there = f"{len(value)} entries stand here, wanted are at most {max_length}"
            return f"{there}; take out {surplus}"
        case "string_type":
            return f"{_shown(value)} is not text; put it in quotes if it is meant"
        case "model_type" | "model_attributes_type" | "dict_type":
            return f"{_shown(value)} stands where `key: value` entries are wanted, indented below"
        case "value_error":
            return str(context["error"])
        case "tuple_type":
            return f"{_shown(value)} stands where a list is wanted, such as [motor, load]"
        case "string_pattern_mismatch" if location[0] == "model":
            return f"{_shown(value)} is no name; write a letter, then letters, digits and `_`"
        case "string_pattern_mismatch":
            return f"{_shown(value)} may only have letters, digits, `_`, `-` and `.`"
    text = str(error["msg"]).replace("Input should", "it should")
    return f"{_shown(value)}: {text[0].lower()}{text[1:]}"


def _known(error: EntryError) -> list[str]:
    context = error.get("ctx", {})
    text = str(context.get("expected_tags") or context.get("expected") or "")
    return [word.strip(" '") for word in text.replace(" or ", ", ").split(",") if word.strip(" '<")]


def _shown(value: Any) -> str:
    if value is None:
        return "nothing"
    if isinstance(value, bool):
        return str(value).lower()
    plain = isinstance(value, str | int | float | list)
    text = "a mapping" if isinstance(value, dict) else repr(value) if plain else str(value)
    return shortened(text, 40)


def _hint(value: Any) -> str:
    if isinstance(value, str):
        if "/" in value:
            return "; fractions are not computed, write for example 0.125 for 1/8"
        if "," in value:
            return "; the decimal sign is a point"
        if any(letter.isdigit() for letter in value) and value[-1:].isalpha():
            other = "write {value: ..., unit: ...} where that is possible"
            return f"; leave out the unit (SI), or {other}"
    if isinstance(value, bool) or value is None:
        return "; write the value itself"
    return ""


def _keys_at(error: EntryError) -> list[str]:
    """Return the keys that are allowed where an unknown key stands."""
    *path, unknown = error["loc"]
    if "known" in error:
        return sorted(error["known"])
    sections = _sections(error["kind"])
    for part in path[error["depth"] :]:
        annotations = [section[str(part)] for section in sections if str(part) in section]
        if annotations:
            sections = [mapping for annotation in annotations for mapping in _sections(annotation)]
        tagged = [section for section in sections if part in typing.get_args(section.get("prior"))]
        sections = tagged or sections
    return sorted({key for section in sections for key in section} - {str(unknown)})


def _sections(annotation: Any) -> list[Mapping[str, Any]]:
    """Return the annotations, by key, of each mapping that the annotation allows."""
    if isinstance(annotation, type) and issubclass(annotation, PriorSpec):
        return [_entries(family) for family in families_of(annotation) or (annotation,)]
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [_entries(annotation)]
    return [mapping for inner in typing.get_args(annotation) for mapping in _sections(inner)]


def _entries(kind: type[BaseModel]) -> Mapping[str, Any]:
    return {name: field.annotation for name, field in kind.model_fields.items()}


def _line(problem: Issue) -> tuple[int, str]:
    parts = problem.place.split(": ")[0].rsplit(":", 1)
    return (int(parts[1]) if len(parts) == 2 and parts[1].isdigit() else 0, problem.place)
