"""Sections as one page of HTML that needs nothing beside it: no network, no other file."""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup

import bayesdrill
from bayesdrill.basics.symbols import Symbol
from bayesdrill.report.sections import WORDS, Picture, Section, items
from bayesdrill.report.typeset import Typesetter, printed
from bayesdrill.report.widths import DPI

_PNG_SIZE = slice(16, 24)  # of a file: width and height, big endian
_SVG_SIZE = re.compile(rb'<svg[^>]*\bwidth="([\d.]+)pt" height="([\d.]+)pt"')


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
    """`what`: the kind of report; `figures`: where the PNG or SVG of pictures are; those without
    either are left out.
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
    shown = {
        picture.stem: _embedded(figures / f"{picture.stem}.{picture.ending}")
        for picture in _pictures(sections)
    }
    return environment.get_template("report.html.j2").render(
        title=title,
        what=what,
        sections=sections,
        version=bayesdrill.__version__,
        shown={stem: one for stem, one in shown.items() if one is not None},
        words=WORDS,
        style=_own(environment, "style.css"),
        script=_own(environment, "zoom.js"),
    )


@dataclass(frozen=True, slots=True)
class _Own:
    """A style or a script of the house: what stands in the page, and by what a browser knows it."""

    text: Markup
    digest: str


def _own(environment: jinja2.Environment, name: str) -> _Own:
    text = environment.get_template(name).render()
    digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
    return _Own(Markup(text), f"'sha256-{digest}'")


def _pictures(sections: Sequence[Section]) -> Iterator[Picture]:
    for section in sections:
        yield from (block for block in section.blocks if isinstance(block, Picture))


def _embedded(path: Path) -> Shown | None:
    kinds = {".png": ("png", _size_of_png), ".svg": ("svg+xml", _size_of_svg)}
    if path.suffix not in kinds or not path.exists():
        return None
    kind, size = kinds[path.suffix]
    data = path.read_bytes()
    url = f"data:image/{kind};base64,{base64.b64encode(data).decode()}"
    return Shown(url, *size(data))


def _size_of_png(data: bytes) -> tuple[int, int]:
    size = data[_PNG_SIZE]
    return int.from_bytes(size[:4]), int.from_bytes(size[4:8])


def _size_of_svg(data: bytes) -> tuple[int, int]:
    """As many pixels as a PNG of the same figure has by default."""
    width, height = (float(points) for points in _SVG_SIZE.findall(data)[0])
    return round(width / 72 * DPI), round(height / 72 * DPI)


def after(text: str, known: str) -> str:
    """What stands after a word that the title has said already."""
    rest = text.removeprefix(known)
    return text if rest == text else rest[:1].upper() + rest[1:]


def slug(text: str) -> str:
    """For names of places in the page."""
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")
