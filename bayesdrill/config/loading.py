"""From a YAML file to a `Config`, or to all of its errors at once."""

from __future__ import annotations

import copy
import dataclasses
import functools
import operator
import typing
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from bayesdrill.basics.entries import SMALLEST
from bayesdrill.basics.errors import InputError, Issue, did_you_mean
from bayesdrill.config import consistency
from bayesdrill.config.consistency import several
from bayesdrill.config.resolve import assembly, experiments
from bayesdrill.config.schema.config import Config
from bayesdrill.config.yaml_source import Place, Source, read
from bayesdrill.inference.priors import PRIORS

# What a config cannot do without.  Of an entry that is missing or spoilt nothing more is said, but
# the others can be judged with these in its place; sections before what stands in them.
_STAND_INS: dict[Place, Any] = {
    ("name",): "x",
    ("seed",): 0,
    ("record",): {},
    ("record", "file"): "x.csv",
    ("record", "time"): {"rate": 1.0},
    ("record", "channels"): {"theta_1": {"column": 1, "unit": "rad", "sigma": 1.0}},
    ("inputs",): {},
    ("parameters",): {},
}

NONE = (
    "no experiment stands here; name each, such as `slow: {record: {file: slow.csv}}`, or remove "
    "this entry"
)


def load(path: Path) -> tuple[Config, Source]:
    """Raises `InputError` with every problem, in the order of the lines."""
    source = read(path)
    return validated(source), source


def validated(source: Source) -> Config:
    """See `load`; of several experiments the config of the first, which names them all."""
    return assembly.with_walkers(_validated(source))


def _validated(source: Source) -> Config:
    if experiments.EXPERIMENTS not in source.data:
        return _one(source, alone=True)
    alone = experiments.split(source)
    problems = [*source.repeated, *_without_record(source, alone)]
    for own in alone.values() or [experiments.bare(source)]:
        try:
            _one(_with_a_record(own), alone=False)
        except InputError as error:
            problems += error.problems
    if not alone and not source.data[experiments.EXPERIMENTS]:
        problems.append(source.problem((experiments.EXPERIMENTS,), NONE))
    elif not alone:
        problems += _complaints(experiments.join_experiments(source, {}), source)
    else:
        whole = experiments.join_experiments(source, alone)
        problems += _complaints(whole, source)
        if not problems:
            problems += several.check_experiments(Config.model_validate(whole), source)
    if problems:
        raise InputError(sorted(dict.fromkeys(problems), key=_line))
    return Config.model_validate(whole)


def _without_record(source: Source, alone: Mapping[str, Source]) -> list[Issue]:
    message = "this experiment has no record; give `record: {file: ...}` in it"
    return [
        source.problem((experiments.EXPERIMENTS, label, "record", "file"), message)
        for label, own in alone.items()
        if _lacks_record(own)
    ]


def _lacks_record(source: Source) -> bool:
    record = source.data.get("record", {})
    return isinstance(record, Mapping) and "file" not in record


def _with_a_record(source: Source) -> Source:
    """That it has none is said elsewhere, and once."""
    if not _lacks_record(source):
        return source
    record = {**source.data.get("record", {}), "file": _STAND_INS["record", "file"]}
    return dataclasses.replace(source, data={**source.data, "record": record})


def _complaints(data: Mapping[str, Any], source: Source) -> list[Issue]:
    """About experiments alone; the rest is told by each of them."""
    try:
        Config.model_validate(data)
    except ValidationError as error:
        found = {_place(item["loc"], source.data): dict(item) for item in error.errors()}
    else:
        return []
    return [
        source.problem(place, _message(item, place))
        for place, item in found.items()
        if place and place[0] in ("experiments", "shared", "own")
    ]


def _one(source: Source, *, alone: bool) -> Config:
    """`alone`: whether there is no other experiment."""
    problems = list(source.repeated)
    pruned = copy.deepcopy(source.data)
    try:
        config = Config.model_validate(source.data)
    except ValidationError as error:
        # One a place, the last: the members of a union each complain of the same entry.
        found = {_place(item["loc"], source.data): dict(item) for item in error.errors()}
        meant = {_meant(item, place) for place, item in found.items()} - {None, *source.lines}
        problems += [
            source.problem(place, _message(item, place))
            for place, item in found.items()
            if not (item["type"] == "missing" and place in meant)
        ]
        problems += _judge_rest(pruned, [*found, *filter(None, meant)], source, alone=alone)
    else:
        problems += consistency.check(config, source, frozenset(), alone=alone)
        if not problems:
            return config
    raise InputError(sorted(dict.fromkeys(problems), key=_line))


def _judge_rest(data: Any, spoilt: list[Place], source: Source, *, alone: bool) -> list[Issue]:
    """Checks across entries, for what is left after the spoilt entries are taken out."""
    for place in spoilt:
        _remove(data, place)
    for place, stand_in in _STAND_INS.items():
        parent = functools.reduce(operator.getitem, place[:-1], data)
        if not parent.get(place[-1]):
            parent[place[-1]] = copy.deepcopy(stand_in)
    try:
        config = Config.model_validate(data)
    except ValidationError:
        return []
    return consistency.check(config, source, frozenset(spoilt), alone=alone)


def _meant(error: dict[str, Any], place: Place) -> Place | None:
    """The entry that a misspelt key was to be: that it is missing is no mistake of its own."""
    hint = _message(error, place)
    near = hint.rpartition("did you mean ")[2].rstrip("?")
    return (*place[:-1], near) if error["type"] == "extra_forbidden" and near != hint else None


def _remove(data: Any, place: Place) -> None:
    """Take out the entry that holds `place`: a channel, or what stands directly in a section."""
    keep = place[:3] if place[:2] == ("record", "channels") else place[:2]
    parent = data
    for part in keep[:-1]:
        parent = parent.get(part) if isinstance(parent, dict) else None
    if keep and isinstance(parent, dict):
        parent.pop(keep[-1], None)


def _place(loc: tuple[str | int, ...], data: Any) -> Place:
    """The path as the user wrote it: pydantic's union tags are left out."""
    place: list[str | int] = []
    here = data
    for index, part in enumerate(loc):
        if isinstance(here, dict) and part in here:
            place.append(part)
            here = here[part]
        elif isinstance(here, list) and isinstance(part, int):
            place.append(part)
            here = here[part] if part < len(here) else None
        elif index == len(loc) - 1 and isinstance(here, dict) and not str(part).startswith("<"):
            place.append(part)
    return tuple(place)


def _message(error: dict[str, Any], place: Place) -> str:
    kind, value, context = error["type"], error["input"], error.get("ctx", {})
    match kind:
        case "extra_forbidden":
            word = "symbol" if place[0] == "parameters" and len(place) == 2 else "key"
            if value is None and str(place[-1]).isdigit():
                return f"unknown {word}; if a decimal comma made it, write a point"
            if "<tie>" in error["loc"]:
                return "a tied parameter has nothing else; remove this entry, or the tie"
            return f"unknown {word}{did_you_mean(str(place[-1]), _keys_at(error['loc']))}"
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
            shown = context.get("tag", value)
            if kind == "literal_error" and place[0] == "parameters":
                hint = _hint(value)
                return f"{_shown(value)} is neither a number, nor `nominal`, nor a prior{hint}"
            return f"'{shown}' is not possible{did_you_mean(str(shown), _known(error))}"
        case "float_type" | "int_type" | "int_from_float":
            whole = "whole " if kind.startswith("int") else ""
            return f"{_shown(value)} is not a {whole}number{_hint(value)}"
        case "greater_than_equal" | "less_than_equal":
            least = context.get("ge")
            if least == SMALLEST and value <= 0:
                return f"{_shown(value)}: it should be greater than 0"
            bound = (
                f"greater than or equal to {least}"
                if least is not None
                else (f"less than or equal to {context['le']}")
            )
            return f"{_shown(value)}: it should be {bound}"
        case "bool_type":
            return f"{_shown(value)} is neither `true` nor `false`"
        case "too_short":
            return f"{len(value)} entries stand here, wanted are at least {context['min_length']}"
        case "too_long":
            most = context["max_length"]
            rest = ", ".join(map(str, [*value][most:]))
            return f"{len(value)} entries stand here, wanted are at most {most}; take out {rest}"
        case "string_type":
            return f"{_shown(value)} is not text; put it in quotes if it is meant"
        case "model_type" | "model_attributes_type" | "dict_type":
            return f"{_shown(value)} stands where `key: value` entries are wanted, indented below"
        case "value_error":
            return str(context["error"])
        case "string_pattern_mismatch":
            return f"{_shown(value)} may only have letters, digits, `_`, `-` and `.`"
    text = str(error["msg"]).replace("Input should", "it should")
    return f"{_shown(value)}: {text[0].lower()}{text[1:]}"


def _known(error: dict[str, Any]) -> list[str]:
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
    return text if len(text) <= 40 else text[:37] + "..."


def _hint(value: Any) -> str:
    if isinstance(value, str):
        if "/" in value:
            return "; fractions are not computed, write for example 0.125 for 1/8"
        if "," in value:
            return "; the decimal sign is a point"
        if any(letter.isdigit() for letter in value) and value[-1:].isalpha():
            return (
                "; leave out the unit (SI), or write {value: ..., unit: ...} where that is possible"
            )
    if isinstance(value, bool) or value is None:
        return "; write the value itself"
    return ""


def _keys_at(loc: tuple[str | int, ...]) -> list[str]:
    """The keys that may stand where the unknown key `loc[-1]` stands."""
    models: list[type[BaseModel]] = [Config]
    for part in loc[:-1]:
        annotations = [
            model.model_fields[str(part)].annotation
            for model in models
            if str(part) in model.model_fields
        ]
        if annotations:
            models = [found for annotation in annotations for found in _models(annotation)]
        tagged = [model for model in models if part in _literals(model)]
        models = tagged or models
    return sorted({key for model in models for key in model.model_fields} - {str(loc[-1])})


def _models(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [found for inner in typing.get_args(annotation) for found in _models(inner)]


def _literals(model: type[BaseModel]) -> tuple[Any, ...]:
    field = model.model_fields.get("prior")
    return typing.get_args(field.annotation) if field else ()


def _line(problem: Issue) -> tuple[int, str]:
    parts = problem.place.split(": ")[0].rsplit(":", 1)
    return (int(parts[1]) if len(parts) == 2 and parts[1].isdigit() else 0, problem.place)
