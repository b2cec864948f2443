"""Pages of reference, made of the program itself whenever the site is built: they cannot go stale.

`commands()` is read off the command line, `entries()` off the JSON schema of configs.  A page has the
line `<!-- commands -->` or `<!-- entries -->` where they stand.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import typer.main

from bayesdrill.api.files import schema
from bayesdrill.cli import app

Schema = Mapping[str, Any]

MARK = re.compile(r"^<!-- (commands|entries) -->$", re.MULTILINE)


def fill(page: str) -> str:
    made: Mapping[str, Callable[[], str]] = {"commands": commands, "entries": entries}
    return MARK.sub(lambda mark: made[mark[1]](), page)


def commands() -> str:
    top = typer.main.get_command(app)
    every: Mapping[str, Any] = getattr(top, "commands", {})
    return "\n".join(line for name, one in every.items() for line in _command(name, one))


def _command(name: str, one: Any) -> Iterator[str]:
    said, _, example = str(one.help).partition("Example: ")
    example = example or str(one.epilog).removeprefix("Example: ")
    arguments = [p for p in one.params if p.param_type_name == "argument"]
    options = [p for p in one.params if p.param_type_name == "option"]
    usage = " ".join(p.metavar or p.name.upper() for p in arguments)
    yield from (f"## {name}", "", said.strip(), "")
    yield from ("```text", f"bayesdrill {name} {usage} [options]".replace("  ", " "), "```", "")
    rows = [(f"`{p.metavar or p.name.upper()}`", _escaped(p.help)) for p in arguments]
    rows += [(_flags(option), _escaped(option.help)) for option in options]
    yield from _table(("", "what"), rows)
    yield from (f"For example `{example.strip()}`.", "")


def _flags(option: Any) -> str:
    flags = ", ".join(f"`{flag}`" for flag in option.opts)
    return flags if option.is_flag else f"{flags} `{option.metavar or option.name.upper()}`"


def entries() -> str:
    whole = json.loads(schema())
    return "\n".join(line for place, one in _places(whole) for line in _section(whole, place, one))


def _places(whole: Schema) -> Iterator[tuple[str, Schema]]:
    """Each object of the schema once, at the first place where it stands; priors last."""
    waiting: list[tuple[str, Schema]] = [("", whole)]
    seen: set[str] = set()
    priors: list[tuple[str, Schema]] = []
    while waiting:
        place, one = waiting.pop(0)
        if "prior" in one["properties"]:
            priors.append((place, one))
        else:
            yield place, one
        for name, entry in one["properties"].items():
            under = f"{place}.{name if place != 'parameters' else '<symbol>'}".lstrip(".")
            if "additionalProperties" in entry and entry["additionalProperties"] is not False:
                under += ".<name>"
            for ref in _refs(entry):
                if ref not in seen:
                    seen.add(ref)
                    waiting.append((under, whole["$defs"][ref]))
    yield from priors


def _refs(entry: Any) -> Iterator[str]:
    if isinstance(entry, Mapping):
        if "$ref" in entry:
            yield entry["$ref"].rpartition("/")[2]
        for key, one in entry.items():
            if key != "mapping":
                yield from _refs(one)
    elif isinstance(entry, list):
        for one in entry:
            yield from _refs(one)


def _section(whole: Schema, place: str, one: Schema) -> Iterator[str]:
    own = {name: entry for name, entry in one["properties"].items() if name != "latex"}
    prior = one["properties"].get("prior")
    if prior:
        if "unit" in own:  # that of a quantity: the same, with a unit
            return
        title = f"`prior: {prior['const']}`"
    else:
        title = f"`{place}`" if place else "The whole"
    yield from (f"## {title}", "")
    if one.get("description") and place:
        yield from (_escaped(one["description"]), "")
    required = set(one.get("required", ()))
    rows: dict[tuple[str, str, str], list[str]] = {}
    for name, entry in own.items():
        if name == "prior":
            continue
        below = not place and "additionalProperties" not in entry and any(_refs(entry))
        what = f"[below](#{name})" if below else _what(whole, entry)
        said = _escaped(entry.get("description", ""))
        default = "required" if name in required else _default(entry)
        rows.setdefault((what, default, said), []).append(f"`{name}`")
    lines = [(", ".join(names), *rest) for rest, names in rows.items()]
    yield from _table(("entry", "is", "default", "meaning"), lines)


def _default(entry: Schema) -> str:
    value = entry.get("default")
    if value is None or "$ref" in entry or value in ({}, []):
        return ""
    return f"`{json.dumps(value).replace('"', '')}`"


def _what(whole: Schema, entry: Schema) -> str:
    """In words, each kind once."""
    return " or ".join(dict.fromkeys(_kinds(whole, entry)))


def _kinds(whole: Schema, entry: Schema) -> Iterator[str]:
    if "enum" in entry or "const" in entry:
        yield from (f"`{value}`" for value in entry.get("enum", [entry.get("const")]))
    elif "$ref" in entry:
        target = whole["$defs"][entry["$ref"].rpartition("/")[2]]
        yield "a prior" if "prior" in target["properties"] else _braces(target)
    elif "oneOf" in entry or "anyOf" in entry:
        for one in entry.get("oneOf") or entry["anyOf"]:
            if one.get("type") != "null":
                yield from _kinds(whole, one)
    elif entry.get("type") == "array":
        yield f"a list of {_what(whole, entry.get('items', {})) or 'anything'}"
    elif entry.get("type") == "object":
        more = entry.get("additionalProperties")
        inside = _what(whole, more) if isinstance(more, Mapping) else ""
        yield f"for each name: {inside}" if inside else _braces(entry)
    elif entry.get("type") in ("number", "integer"):
        yield _number(entry)
    elif "type" in entry:
        yield {"string": "text", "boolean": "`true` or `false`"}[entry["type"]]


def _braces(entry: Schema) -> str:
    return "`{" + ", ".join(entry.get("properties", {"...": 0})) + "}`"


def _number(entry: Schema) -> str:
    word = "whole number" if entry["type"] == "integer" else "number"
    low, high = entry.get("minimum"), entry.get("maximum")
    above, below = entry.get("exclusiveMinimum"), entry.get("exclusiveMaximum")
    if low == 1e-30:  # no number of a rig is smaller
        low, above = None, 0
    ends = [f"from {low:g}"] if low is not None and low > -1e30 else []
    ends += [f"above {above:g}"] if above is not None else []
    ends += [f"to {high:g}"] if high is not None and high < 1e30 else []
    ends += [f"below {below:g}"] if below is not None and below < 1e18 else []
    return " ".join([word, *ends])


def _escaped(text: str) -> str:
    return text.replace("|", "\\|").replace("<", "&lt;")


def _table(heads: tuple[str, ...], rows: list[tuple[str, ...]]) -> Iterator[str]:
    yield "| " + " | ".join(heads) + " |"
    yield "|" + " --- |" * len(heads)
    for row in rows:
        yield "| " + " | ".join(row) + " |"
    yield ""
