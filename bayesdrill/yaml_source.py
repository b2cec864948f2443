"""YAML 1.2 text as plain data, with the line of every entry and every repeated key."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bayesdrill.errors import InputError, Problem

Place = tuple[str | int, ...]


@dataclass(frozen=True, slots=True)
class Source:
    """`lines`: 1-based line of the key (or list item) at each place; `repeated` keys as problems."""

    path: Path
    text: str
    data: Any
    lines: Mapping[Place, int]
    repeated: tuple[Problem, ...]

    def problem(self, place: Place, message: str) -> Problem:
        """Labelled `file:line: a.b.c`; the line is that of the nearest entry that exists."""
        known = place
        while known not in self.lines and known:
            known = known[:-1]
        dotted = ".".join(str(part) for part in place)
        label = f"{self.path}:{self.lines.get(known, 1)}"
        return Problem(f"{label}: {dotted}" if dotted else label, message)


def read(path: Path) -> Source:
    """Raises `InputError` where the file cannot be read or is not YAML."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise InputError.one(str(path), "there is no such file; check the path") from None
    except IsADirectoryError:
        raise InputError.one(str(path), "this is a folder; name the .yaml file in it") from None
    except UnicodeDecodeError:
        raise InputError.one(str(path), "this is not a text file in UTF-8") from None
    except OSError as error:
        raise InputError.one(str(path), f"cannot be read: {error.strerror}") from None
    return parse(path, text)


def parse(path: Path, text: str) -> Source:
    from ruamel.yaml import YAML
    from ruamel.yaml.error import MarkedYAMLError, YAMLError
    from ruamel.yaml.reader import ReaderError

    yaml = YAML(typ="safe", pure=True)
    yaml.allow_duplicate_keys = True
    lines: dict[Place, int] = {}
    repeated: list[Problem] = []
    try:
        root = YAML(typ="safe", pure=True).compose(text)
        if root is not None:
            _walk(root, (), lines, repeated, path)
        data = None if root is None else yaml.constructor.construct_document(root)
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = mark.line + 1 if mark else 1
        raise InputError.one(f"{path}:{line}", _explain(error, text, line)) from None
    except ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        message = f"the character U+{error.character:04X} cannot stand in YAML; remove it"
        raise InputError.one(f"{path}:{line}", message) from None
    except RecursionError:
        message = (
            "entries are nested too deeply, or an alias (`*`) stands inside its own anchor (`&`)"
        )
        raise InputError.one(str(path), f"{message}; write them out flat") from None
    except (YAMLError, ValueError) as error:
        raise InputError.one(str(path), f"this is not YAML: {str(error).splitlines()[0]}") from None
    if not isinstance(data, dict):
        raise InputError.one(
            str(path), "a config is a mapping such as `name: my_rig`; see `bayesdrill schema`"
        )
    return Source(path, text, data, lines, tuple(repeated))


def _walk(
    node: Any, place: Place, lines: dict[Place, int], repeated: list[Problem], path: Path
) -> None:
    """Note lines and repetitions; make every key text, as `5:` or `~:` is no number or null."""
    from ruamel.yaml.nodes import MappingNode, ScalarNode, SequenceNode

    if isinstance(node, MappingNode):
        for key, value in node.value:
            line = key.start_mark.line + 1
            if not isinstance(key, ScalarNode):
                message = "a list or mapping cannot be a key; write a word before the colon"
                raise InputError.one(f"{path}:{line}", message)
            if key.tag != "tag:yaml.org,2002:merge":
                key.tag = "tag:yaml.org,2002:str"
            here = (*place, key.value)
            if here in lines:
                dotted = ".".join(str(part) for part in here)
                message = f"this key stands already in line {lines[here]}; keep one of them"
                repeated.append(Problem(f"{path}:{line}: {dotted}", message))
            lines[here] = line
            _walk(value, here, lines, repeated, path)
    elif isinstance(node, SequenceNode):
        for index, value in enumerate(node.value):
            lines[(*place, index)] = value.start_mark.line + 1
            _walk(value, (*place, index), lines, repeated, path)


def _explain(error: Any, text: str, line: int) -> str:
    rows = text.splitlines()
    row = rows[line - 1] if line <= len(rows) else ""
    if "\t" in row[: len(row) - len(row.lstrip())]:
        return "a tab stands in the indentation; YAML wants spaces"
    problem = str(error.problem or error.context or "not YAML")
    if "mapping values are not allowed" in problem:
        return "a second `key:` on one line, or wrong indentation; put each key on its own line"
    return f"this is not YAML: {problem}; check indentation, quotes and the space after each colon"
