"""Sections as one page of HTML that needs nothing beside it: no network, no other file."""

from __future__ import annotations

import base64
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jinja2

import bayesdrill
from bayesdrill.basics.symbols import Symbol
from bayesdrill.report.sections import Picture, Section, items
from bayesdrill.report.typeset import Typesetter, printed

_PNG_SIZE = slice(16, 24)  # of a file: width and height, big endian
_WORDS = frozenset(("verdict", "the record says"))  # heads of columns whose cells are coloured


@dataclass(frozen=True, slots=True)
class Shown:
    """A picture inside the page."""

    url: str
    width: int
    height: int


def as_html(
    title: str,
    what: str,
    sections: Sequence[Section],
    figures: Path,
    symbols: Sequence[Symbol] = (),
) -> str:
    """`what`: the kind of report; `figures`: where the PNG of pictures are; those without one are
    left out.
    """
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("bayesdrill.report", "page"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    set_type = Typesetter(printed(symbols))
    helpers: dict[str, Any] = {
        "names": set_type.plain,
        "prose": set_type.prose,
        "items": items,
        "slug": slug,
        "after": after,
        "kind": lambda block: type(block).__name__,
    }
    environment.filters |= helpers
    shown = {picture.stem: _embedded(figures, picture.stem) for picture in _pictures(sections)}
    return environment.get_template("report.html.j2").render(
        title=title,
        what=what,
        sections=sections,
        version=bayesdrill.__version__,
        shown={stem: one for stem, one in shown.items() if one is not None},
        words=_WORDS,
    )


def _pictures(sections: Sequence[Section]) -> Iterator[Picture]:
    for section in sections:
        yield from (block for block in section.blocks if isinstance(block, Picture))


def _embedded(figures: Path, stem: str) -> Shown | None:
    path = figures / f"{stem}.png"
    if not path.exists():
        return None
    data = path.read_bytes()
    size = data[_PNG_SIZE]
    width, height = (int.from_bytes(size[k : k + 4]) for k in (0, 4))
    url = f"data:image/png;base64,{base64.b64encode(data).decode()}"
    return Shown(url, width, height)


def after(text: str, known: str) -> str:
    """What stands after a word that the title has said already."""
    rest = text.removeprefix(known)
    return text if rest == text else rest[:1].upper() + rest[1:]


def slug(text: str) -> str:
    """For names of places in the page."""
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")
