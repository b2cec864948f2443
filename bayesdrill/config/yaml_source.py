"""Read YAML 1.2 as plain data with the line of every entry, and locate errors in it."""

from __future__ import annotations

import io
import warnings
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bayesdrill import output_files
from bayesdrill.basics.errors import InputError, Issue, did_you_mean

Location = tuple[str | int, ...]

# No config needs to exceed these limits. Longer files are mistakes, or take too long to read.
MAX_BYTES = 100_000
MAX_ENTRIES = 5000  # an alias counts as the entries that it repeats
MAX_KEY_LENGTH = 100  # in letters
MAX_VALUE_LENGTH = 2000
MAX_NUMBER_LENGTH = 40
RECORD_ENDINGS = (".csv", ".mat")  # endings of records that are given instead of a config


@dataclass(frozen=True, slots=True)
class Source:
    """A source holds the text of a config, its data, and the line of each entry."""

    path: Path
    text: str
    data: Any
    lines: Mapping[Location, int]  # line, from 1, of the key or list item at each location
    repeated: tuple[Issue, ...]  # one issue for each repeated key
    origins: Mapping[Location, Location] = field(default_factory=dict)  # original locations
    labels: tuple[str, ...] = ()  # labels of all experiments, if there are several

    def issue(self, location: Location, message: str) -> Issue:
        """Return an issue labelled `file:line: a.b.c`, with the line of the nearest existing entry."""
        nearest = location
        while nearest not in self.lines and nearest:
            nearest = nearest[:-1]
        stands = (*self.origins.get(nearest, nearest), *location[len(nearest) :])
        dotted = ".".join(str(part) for part in stands)
        label = f"{self.path}:{self.lines.get(nearest, 1)}" if self.lines else str(self.path)
        return Issue(f"{label}: {dotted}" if dotted else label, message)

    def error(self, location: Location, message: str) -> InputError:
        """Return an error with this single issue."""
        return InputError([self.issue(location, message)])


def read(path: Path) -> Source:
    """Read a YAML file; raises `InputError` if it cannot be read or is not YAML."""
    output_files.refuse_endless(path)
    try:
        with path.open("rb") as file:
            raw = file.read(MAX_BYTES + 1)
    except FileNotFoundError:
        message = "there is no such file; check the path (`bayesdrill example` writes some to copy)"
        raise InputError.at(str(path), message) from None
    except IsADirectoryError:
        raise InputError.at(str(path), "this is a folder; name the .yaml file in it") from None
    except (OSError, ValueError) as error:  # a NUL in the path raises ValueError
        reason = getattr(error, "strerror", None) or error
        raise InputError.at(str(path), f"cannot be read: {reason}") from None
    if path.suffix.lower() in RECORD_ENDINGS:
        message = "is a record, and no config; `bayesdrill init` writes a config for it"
        raise InputError.at(str(path), message)
    if len(raw) > MAX_BYTES:
        message = f"holds more than {MAX_BYTES // 1000} kB, which no config needs; name a config"
        raise InputError.at(str(path), message)
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError.at(str(path), "this is not a text file in UTF-8") from None
    return parse(path, io.StringIO(text, newline=None).read())


def parse(path: Path, text: str) -> Source:
    """Parse YAML text; raises `InputError` if it is not a mapping."""
    from ruamel.yaml import YAML
    from ruamel.yaml.error import MarkedYAMLError, ReusedAnchorWarning, YAMLError
    from ruamel.yaml.reader import ReaderError

    yaml = YAML(typ="safe", pure=True)
    yaml.allow_duplicate_keys = True
    walk = _NodeVisitor(path, yaml.constructor)
    try:
        with warnings.catch_warnings():
            # An anchor may be defined twice: each alias takes the last definition before it.
            warnings.simplefilter("ignore", ReusedAnchorWarning)
            root = YAML(typ="safe", pure=True).compose(text)
        if root is not None:
            walk.visit(root, ())
        data = None if root is None else yaml.constructor.construct_document(root)
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = mark.line + 1 if mark else 1
        raise InputError.at(f"{path}:{line}", _explain(error, text, line)) from None
    except ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        message = f"the character U+{error.character:04X} cannot stand in YAML; remove it"
        raise InputError.at(f"{path}:{line}", message) from None
    except RecursionError:
        message = "entries are nested too deeply, or an alias (`*`) stands inside its own anchor"
        raise InputError.at(str(path), f"{message} (`&`); write them out flat") from None
    except (YAMLError, ValueError) as error:
        raise InputError.at(str(path), f"this is not YAML: {str(error).splitlines()[0]}") from None
    if not isinstance(data, dict):
        message = "a config is a mapping such as `name: my_rig`; see `bayesdrill schema`"
        raise InputError.at(str(path), message)
    return Source(path, text, data, walk.lines, tuple(walk.repeated))


def as_yaml(data: Mapping[str, Any]) -> str:
    """Return the data as readable YAML."""
    from ruamel.yaml import YAML

    yaml, out = YAML(), io.StringIO()
    yaml.width = 120
    yaml.default_flow_style = None
    yaml.dump(dict(data), out)
    return out.getvalue()


@dataclass(slots=True)
class _NodeVisitor:
    """The visitor records the lines and repeated keys of all nodes, and enforces the limits."""

    path: Path
    constructor: Any  # constructs single values, so that errors have a line
    lines: dict[Location, int] = field(default_factory=dict)
    repeated: list[Issue] = field(default_factory=list)
    entries: int = 0

    def visit(self, node: Any, location: Location) -> None:
        from ruamel.yaml.nodes import MappingNode, SequenceNode

        if isinstance(node, MappingNode):
            for key, value in node.value:
                self.visit(value, self._key(key, location))
        elif isinstance(node, SequenceNode):
            for index, value in enumerate(node.value):
                item_location = (*location, index)
                self._note(item_location, value)
                self.visit(value, item_location)
        else:
            self._value(node)

    def _note(self, location: Location, node: Any) -> None:
        self.lines[location] = node.start_mark.line + 1
        self.entries += 1
        if self.entries > MAX_ENTRIES:
            message = f"holds more than {MAX_ENTRIES} entries, each alias (`*`) written out"
            raise InputError.at(str(self.path), f"{message}; no config needs as many")

    def _key(self, key: Any, location: Location) -> Location:
        """Tag a key as text, so that `5:` and `~:` are texts too, and return the key's location."""
        from ruamel.yaml.nodes import ScalarNode

        if not isinstance(key, ScalarNode):
            message = "a list or mapping cannot be a key; write a word before the colon"
            raise self._refusal(key, message)
        if len(key.value) > MAX_KEY_LENGTH:
            message = f"this key has {len(key.value)} letters; write at most {MAX_KEY_LENGTH}"
            raise self._refusal(key, message)
        self._check_characters(key)
        if key.tag != "tag:yaml.org,2002:merge":
            key.tag = "tag:yaml.org,2002:str"
        key_location = (*location, key.value)
        if key_location in self.lines:
            dotted = ".".join(str(part) for part in key_location)
            before, line = self.lines[key_location], key.start_mark.line + 1
            message = f"this key stands already in line {before}; keep one of them"
            self.repeated.append(Issue(f"{self.path}:{line}: {dotted}", message))
        self._note(key_location, key)
        return key_location

    def _value(self, node: Any) -> None:
        from ruamel.yaml.error import YAMLError

        text, kind = node.value, str(node.tag).rpartition(":")[2]
        max_length = MAX_NUMBER_LENGTH if kind == "int" else MAX_VALUE_LENGTH
        if len(text) > max_length:
            what, signs = ("a number", "digits") if kind == "int" else ("a value", "letters")
            message = f"{what} of {len(text)} {signs}; write at most {max_length}"
            raise self._refusal(node, message)
        self._check_characters(node)
        try:
            self.constructor.construct_object(node)
        except YAMLError:
            raise
        except Exception:  # constructors raise many exceptions for text that does not fit its tag
            message = f"'{text[:MAX_NUMBER_LENGTH]}' cannot be read as {kind}; put text in quotes"
            raise self._refusal(node, message) from None

    def _check_characters(self, node: Any) -> None:
        """Refuse characters that no path, unit, formula or file can contain."""
        if "\0" in node.value or any("\ud800" <= letter <= "\udfff" for letter in node.value):
            raise self._refusal(node, "a NUL or half a character stands here; remove it")

    def _refusal(self, node: Any, message: str) -> InputError:
        return InputError.at(f"{self.path}:{node.start_mark.line + 1}", message)


def _explain(error: Any, text: str, line: int) -> str:
    rows = text.splitlines()
    row = rows[line - 1] if line <= len(rows) else ""
    if "\t" in row[: len(row) - len(row.lstrip())]:
        return "a tab stands in the indentation; YAML wants spaces"
    problem = str(error.problem or error.context or "not YAML")
    if "mapping values are not allowed" in problem:
        return "a second `key:` on one line, or wrong indentation; put each key on its own line"
    return f"this is not YAML: {problem}; check indentation, quotes and the space after each colon"


class IssueCollector:
    """Collect messages for the user by location, from steps that raise `ValueError`."""

    def __init__(self, source: Source, spoilt: frozenset[Location]) -> None:
        self.issues: list[Issue] = []
        self.source = source
        self._reported = spoilt

    def add(self, location: Location, message: str) -> None:
        """Add an issue, unless an issue at this entry was reported before."""
        if not self.is_reported(location):
            self.issues.append(self.source.issue(location, message))

    def add_all(self, location: Location, messages: Mapping[str, str]) -> None:
        """Add the messages of entries at `location`, by the entries' names."""
        for entry, message in messages.items():
            self.add((*location, entry), message)

    def is_reported(self, location: Location) -> bool:
        """Return whether an issue was reported for this entry, a part of it, or its section."""
        pairs = (zip(location, other, strict=False) for other in self._reported)
        return any(all(part == other for part, other in pair) for pair in pairs)

    def run[T](self, location: Location, step: Callable[..., T], *arguments: Any) -> T | None:
        """Return the result of a step; None, with an issue, if it raises `ValueError`.

        An `InputError` on contradictory parts of a rig gives issues at the entries of `model:`.
        """
        try:
            return step(*arguments)
        except InputError as error:
            if location[0] != "model":
                raise
            for issue in error.problems:
                self.add(("model", issue.place), issue.message)
        except ValueError as error:
            self.add(location, str(error))
        return None

    def expect(self, location: Location, name: str, known: Collection[str], message: str) -> None:
        """Add an issue that proposes the nearest name, unless `name` is one of `known`."""
        if name not in known:
            self.add(location, f"{message}{did_you_mean(name, known)}")
