"""Convert frozen dataclasses to data for JSON, and back by the types of their fields (pydantic).

Floats keep all digits; infinities and NaN are the strings `Infinity`, `-Infinity` and `NaN`.
"""

from __future__ import annotations

import dataclasses
import inspect
import json
import re
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from typing import Any

from pydantic import TypeAdapter
from pydantic_core import to_jsonable_python

# Adapters are built at the first use of a class, since building is slow.
_adapter: Callable[[Any], TypeAdapter[Any]] = cache(TypeAdapter)


def as_data(value: Any) -> Any:
    """Convert a dataclass and its contents to mappings, lists, numbers and strings for JSON."""

    def plain(content: Any) -> Any:
        return dict(content) if isinstance(content, Mapping) else content.tolist()

    # Infinities and NaN become strings.  ASCII escapes lone surrogates of undecodable file names.
    text = json.dumps(to_jsonable_python(value, fallback=plain))
    return json.loads(text, parse_constant=str)


def from_data[T](kind: type[T], data: Any, *, strict: bool = False) -> T:
    """Convert data from `as_data` back to a dataclass or typed mapping of type `kind`.

    Raises `ValueError` for wrong names or types; if `strict`, also for numbers in strings.
    """
    # Pydantic rejects lone surrogates, which file names may contain, so they are replaced.
    text = json.dumps(data, ensure_ascii=False).encode("utf-8", "replace")
    record: T = _adapter(kind).validate_json(text, strict=strict)
    return record


FIELD_LINE = re.compile(r"(?P<name>\w+): (?P<description>.+?)(?: \[(?P<unit>.+)\])?")
LABEL_FIELDS = ("name", "channel", "label", "parameter")  # fields that identify an item of a list


def field_descriptions(kind: type) -> dict[str, dict[str, str]]:
    """Return descriptions and units from docstring lines such as `size: the diameter [m]`."""
    lines = map(FIELD_LINE.fullmatch, (inspect.getdoc(kind) or "").splitlines())
    described = [
        {key: text for key, text in line.groupdict().items() if text} for line in lines if line
    ]
    parts = {line.pop("name"): line for line in described}
    return {field.name: parts.get(field.name, {}) for field in dataclasses.fields(kind)}


def leaves(data: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the numbers, strings and Nones in nested data, with names like `unknowns.k_s.mean`."""
    if isinstance(data, list):
        labels = [_label(item) for item in data]
        named = all(labels) and len({*labels}) == len(labels)
        data = dict(zip(labels if named else range(len(data)), data, strict=True))
    if not isinstance(data, Mapping):
        yield name, data
        return
    for key, item in data.items():
        yield from leaves(item, f"{name}.{key}" if name else str(key))


def _label(item: Any) -> str:
    fields = LABEL_FIELDS if isinstance(item, Mapping) else ()
    return next((str(item[field]) for field in fields if item.get(field)), "")
