"""Render sections as one self-contained page of HTML, and the summary as a LaTeX table."""

from __future__ import annotations

import base64
import hashlib
import math
import re
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import compress
from pathlib import Path
from typing import Any

from markupsafe import Markup

import bayesdrill
from bayesdrill.analysis.diagnostics import ParameterRow
from bayesdrill.basics.symbols import Symbol
from bayesdrill.inference.derived import HDI_PROBABILITY
from bayesdrill.report.scales import DPI, Typesetter, printed, unit_of
from bayesdrill.report.section import WORDS, Picture, Section, items

_PNG_SIZE = slice(16, 24)  # of a file: width and height, big endian
_SVG_SIZE = re.compile(rb'<svg[^>]*\bwidth="([\d.]+)pt" height="([\d.]+)pt"')


@dataclass(frozen=True, slots=True)
class EmbeddedPicture:
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
    """Render sections as a page of HTML.

    `what`: the kind of report; `figures`: where the PNG or SVG of pictures are; those without
    either are left out.
    """
    import jinja2  # late: templates are for pages alone

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
        "digest": digest,
        "kind": lambda block: type(block).__name__,
    }
    environment.filters |= helpers
    blocks = [block for section in sections for block in section.blocks]
    shown = {
        picture.stem: _embedded(figures / f"{picture.stem}.{picture.ending}")
        for picture in blocks
        if isinstance(picture, Picture)
    }
    return environment.get_template("report.html.j2").render(
        title=title,
        what=what,
        sections=sections,
        version=bayesdrill.__version__,
        shown={stem: picture for stem, picture in shown.items() if picture is not None},
        words=WORDS,
        style=Markup(environment.get_template("style.css").render()),
        script=Markup(environment.get_template("zoom.js").render()),
    )


def digest(text: str) -> str:
    """Return by what a browser knows a style or a script of the page."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


def _embedded(path: Path) -> EmbeddedPicture | None:
    if path.suffix not in (".png", ".svg") or not path.exists():
        return None
    data = path.read_bytes()
    if path.suffix == ".png":
        kind, width, height = "png", *struct.unpack(">II", data[_PNG_SIZE])
    else:  # as many pixels as a PNG of the same figure has by default
        points = (float(length) for length in _SVG_SIZE.findall(data)[0])
        kind, width, height = "svg+xml", *(round(length / 72 * DPI) for length in points)
    return EmbeddedPicture(
        f"data:image/{kind};base64,{base64.b64encode(data).decode()}", width, height
    )


def after(text: str, known: str) -> str:
    """Return what stands after a word that the title has said already."""
    remainder = text.removeprefix(known)
    return text if remainder == text else remainder[:1].upper() + remainder[1:]


def slug(text: str) -> str:
    """Return a name for a place in the page."""
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")


_HEADS = (
    *("", "unit", "nominal", "MAP", "mean (sd)"),
    rf"{100 * HDI_PROBABILITY:.0f}\,\% HDI",
    "the record says",
)
_NOMINAL = _HEADS.index("nominal")
_USUAL = range(-1, 3)  # powers of ten that are written out

_BEYOND = re.compile(r"[^\x00-\x7f]+")  # ASCII; in names, and in LaTeX outside of formulas alone


def latex_table(
    rows: Sequence[ParameterRow], symbols: Sequence[Symbol], *, believed: bool = True
) -> str:
    """Return a `tabular` for a table of one's own, with two digits of each sd.

    Without what the record says, where that must not be `believed`.
    """
    named = {symbol.name: symbol for symbol in symbols}
    shown = [True] * len(_HEADS)
    shown[_NOMINAL] = any(row.nominal is not None for row in rows)
    shown[-1] = believed
    lines_of_cells = (_HEADS, *(_cells(row, named[row.name]) for row in rows))
    lines = [" & ".join(compress(line, shown)) + r" \\" for line in lines_of_cells]
    columns = "".join(compress("llrrrrl", shown))
    table = (
        r"% needs \usepackage{booktabs,siunitx}",
        rf"\begin{{tabular}}{{@{{}}{columns}@{{}}}}",
        *(r"\toprule", lines[0], r"\midrule", *lines[1:]),
        *(r"\bottomrule", r"\end{tabular}"),
    )
    return "\n".join(table) + "\n"


def _cells(row: ParameterRow, symbol: Symbol) -> tuple[str, ...]:
    power = _exponent(max(abs(row.hdi_low), abs(row.hdi_high)))
    power = 0 if power in _USUAL else power
    sd = row.sd / 10.0**power
    places = max(0, 1 - _exponent(sd)) if sd > 0 else 3

    def number(x: float) -> str:
        return f"{x / 10.0**power:.{places}f}"

    return (
        f"${_BEYOND.sub(lambda beyond: rf'\text{{{beyond[0]}}}', symbol.latex)}$",
        unit_of(power, symbol.latex_unit),
        "--" if row.nominal is None else rf"\num{{{number(row.nominal)}}}",
        rf"\num{{{number(row.map)}}}",
        rf"\num{{{number(row.mean)} \pm {number(row.sd)}}}",
        rf"\numrange{{{number(row.hdi_low)}}}{{{number(row.hdi_high)}}}",
        row.word,
    )


def _exponent(x: float) -> int:
    return math.floor(math.log10(x)) if x > 0 else 0
