"""Turn an error of pydantic's validation into a message for users."""

from __future__ import annotations

import re
import typing
from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel

from bayesdrill.basics.entries import SMALLEST
from bayesdrill.basics.errors import count_noun, did_you_mean, shortened
from bayesdrill.config.schema.numbers import PriorSpec, families_of
from bayesdrill.config.schema.validation import EntryError
from bayesdrill.config.yaml_source import Location
from bayesdrill.inference.priors import PRIORS
from bayesdrill.rig.models.drive_parts import NAME, Drive
from bayesdrill.rig.models.train import BACKWARD, Train


def message_of(error: EntryError, location: Location) -> str:
    """Return the message for an error of the entry at `location`, with advice how to correct it."""
    kind, value, context = error["type"], error["input"], error.get("ctx", {})
    match kind:
        case "extra_forbidden":
            return _unknown_key(error, location)
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
            there = f"{count_noun(len(value), 'entry stands', 'entries stand')} here"
            return f"{there}, wanted are at least {context['min_length']}"
        case "too_long":
            max_length = context["max_length"]
            surplus = ", ".join(map(str, [*value][max_length:]))
            there = f"{count_noun(len(value), 'entry stands', 'entries stand')} here"
            return f"{there}, wanted are at most {max_length}; take out {surplus}"
        case "string_type":
            return f"{_shown(value)} is not text; put it in quotes if text is meant"
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


def _unknown_key(error: EntryError, location: Location) -> str:
    name = str(location[-1])
    word = "symbol" if location[0] == "parameters" and len(location) == 2 else "key"
    if error["input"] is None and name.isdigit():
        return f"unknown {word}; if these decimals follow a decimal comma, write a decimal point"
    if "<tie>" in error["loc"]:
        return "a tied parameter has no other entries; remove this entry, or the tie"
    suggestion = did_you_mean(name, _keys_at(error))
    other = "" if error.get("is_train", True) else _train_of(name)
    if location[0] == "inputs" and name.startswith("supply_") and not other:
        other = f"; write `{name[7:]}: {{servo: 12}}` in `drives:` if 12 V is its usual voltage"
    if (
        word == "symbol"
        and name.startswith("supply_")
        and "supply_" not in suggestion
        and not other
    ):
        suggestion, servo = "", f"`{name[7:]}: servo` in `drives:`"
        other = f"; a measured supply belongs in `inputs:`, and a constant one needs {servo}"
    suggestion = "" if other and suggestion.startswith("; known") else suggestion
    return f"unknown {word}{suggestion}{other}".replace("?; ", "? ")


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


def _train_of(name: str) -> str:
    """Return advice to use a train if `name` is a symbol of one, such as `goal_motor`, or else ''."""
    *_, part = name.removesuffix(BACKWARD).split("_")
    if len(part) < 3 or not re.fullmatch(NAME, part):
        return ""
    for kind in ("torque", "current", "voltage", "servo"):
        if name in Train(inertias=(part,), drives=(Drive(part, kind),), gravity=(part,)).symbols:
            model = f"{{name: train, inertias: [{part}], drives: {{{part}: {kind}}}}}"
            return f"; {name} is a symbol of a train: `model: {model}`"
    return ""


def _keys_at(error: EntryError) -> list[str]:
    """Return the keys that are allowed at the location of an unknown key."""
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
    """Return, for each kind of mapping that an annotation allows, the annotations of its keys."""
    if isinstance(annotation, type) and issubclass(annotation, PriorSpec):
        return [_entries(family) for family in families_of(annotation) or (annotation,)]
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [_entries(annotation)]
    return [mapping for inner in typing.get_args(annotation) for mapping in _sections(inner)]


def _entries(kind: type[BaseModel]) -> Mapping[str, Any]:
    return {name: field.annotation for name, field in kind.model_fields.items()}
