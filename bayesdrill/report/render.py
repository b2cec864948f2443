"""Render sections as one self-contained page of HTML."""

from __future__ import annotations

import base64
import functools
import hashlib
import math
import re
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from markupsafe import Markup

import bayesdrill
from bayesdrill.basics.symbols import Symbol
from bayesdrill.report.scales import DOUBLE, DPI, Typesetter, printed
from bayesdrill.report.section import WORDS, Picture, Section, items

if TYPE_CHECKING:
    import jinja2

_PNG_SIZE = slice(16, 24)  # bytes of a PNG file with width and height, big endian
METRES_PER_INCH = 0.0254
_SVG_SIZE = re.compile(rb'<svg[^>]*\bwidth="([\d.]+)pt" height="([\d.]+)pt"')


@dataclass(frozen=True, slots=True)
class EmbeddedPicture:
    """The picture is part of the page, as a data URL with its size in pixels.

    Its largest width is `tenths` tenths of the page, so that all figures have letters of equal size.
    """

    url: str
    width: int
    height: int
    tenths: int


def as_html(
    title: str,
    what: str,
    sections: Sequence[Section],
    figures: Path,
    symbols: Sequence[Symbol] = (),
    parent: tuple[str, str] | None = None,
) -> str:
    """Render sections as a page of HTML.

    `what` is the kind of report.  Pictures without a PNG or SVG in the folder `figures` are left out.
    `parent` has title and address of the page to which the header links back.
    """
    environment = _environment()
    blocks = [block for section in sections for block in section.blocks]
    shown = {
        picture.stem: _embedded(figures / f"{picture.stem}.{picture.extension}")
        for picture in blocks
        if isinstance(picture, Picture)
    }
    return environment.get_template("report.html.j2").render(
        set_type=Typesetter(printed(symbols)),
        title=title,
        what=what,
        parent=parent,
        sections=sections,
        version=bayesdrill.__version__,
        shown={stem: picture for stem, picture in shown.items() if picture is not None},
        words=WORDS,
        style=Markup(environment.get_template("style.css").render()),
        script=Markup(environment.get_template("zoom.js").render()),
    )


@functools.cache
def _environment() -> jinja2.Environment:
    """Return the environment of all pages, whose templates are compiled once."""
    import jinja2  # late: only pages need templates

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("bayesdrill.report", "page"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        "names": jinja2.pass_context(lambda page, text: page["set_type"].plain(text)),
        "prose": jinja2.pass_context(lambda page, text: page["set_type"].prose(text)),
        "items": items,
        "slug": slug,
        "after": after,
        "digest": digest,
        "kind": lambda block: type(block).__name__,
    }
    return environment


def digest(text: str) -> str:
    """Return the hash by which a browser allows a style or a script of the page."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


def _embedded(path: Path) -> EmbeddedPicture | None:
    if path.suffix not in (".png", ".svg") or not path.exists():
        return None
    data = path.read_bytes()
    dpi = DPI
    if path.suffix == ".png":
        kind, width, height = "png", *struct.unpack(">II", data[_PNG_SIZE])
        if (place := data.find(b"pHYs")) > 0:
            dpi = round(int.from_bytes(data[place + 4 : place + 8]) * METRES_PER_INCH)
    else:  # as many pixels as a PNG of the same figure has by default
        points = (float(length) for length in _SVG_SIZE.findall(data)[0])
        kind, width, height = "svg+xml", *(round(length / 72 * DPI) for length in points)
    url = f"data:image/{kind};base64,{base64.b64encode(data).decode()}"
    return EmbeddedPicture(url, width, height, min(10, math.ceil(10 * width / dpi / DOUBLE)))


def after(text: str, prefix: str) -> str:
    """Return a text without its `prefix`, which the title contains already."""
    remainder = text.removeprefix(prefix)
    return text if remainder == text else remainder[:1].upper() + remainder[1:]


def slug(text: str) -> str:
    """Return the name of an anchor in the page."""
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")
