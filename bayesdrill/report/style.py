"""What all figures share: fonts and greys, numbers on axes, and files that appear whole."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Protocol

import matplotlib
import numpy as np
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedFormatter, FixedLocator, NullFormatter
from matplotlib.transforms import Bbox, ScaledTranslation
from numpy.typing import NDArray

from bayesdrill.basics.own_files import whole

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

SINGLE, DOUBLE = 3.4, 7.0  # widths of one and of two columns of a page, inches
TICKS_WIDTH = 0.43  # between an axis and its label, inches
PNG_DPI = 220
STRIP = 0.24  # of a warning above a figure, inches

RC: Mapping[str, Any] = MappingProxyType(
    {
        "text.usetex": False,
        "font.family": ["STIXGeneral"],
        "mathtext.fontset": "stix",
        "font.size": 9.0,
        "axes.labelsize": 9.0,
        "axes.titlesize": 9.0,
        "axes.linewidth": 0.6,
        "axes.unicode_minus": True,
        "xtick.labelsize": 8.0,
        "ytick.labelsize": 8.0,
        "xtick.direction": "in",
        "ytick.direction": "in",
        "xtick.major.size": 3.0,
        "ytick.major.size": 3.0,
        "xtick.major.width": 0.6,
        "ytick.major.width": 0.6,
        "legend.fontsize": 8.0,
        "legend.frameon": False,
        "lines.linewidth": 1.0,
        "hatch.linewidth": 0.4,
        "pdf.fonttype": 42,
        "savefig.dpi": PNG_DPI,
        "figure.constrained_layout.use": False,
        "figure.autolayout": False,
    }
)

BLACK, DARK, MIDDLE, LIGHT, FAINT = "0.0", "0.3", "0.55", "0.8", "0.91"
# Two colours that print as different greys and differ in line style and marker as well.
NOMINAL: Mapping[str, Any] = MappingProxyType(
    {"color": "#2b6cb0", "linestyle": (0, (4, 2)), "linewidth": 1.0}
)
MAP_COLOUR = "#b3261e"
MAP_LINE: Mapping[str, Any] = MappingProxyType(
    {"color": MAP_COLOUR, "linestyle": (0, (1, 1.5)), "linewidth": 1.0}
)

CROSS: Mapping[str, Any] = MappingProxyType(
    {
        "color": MAP_COLOUR,
        "marker": "+",
        "markersize": 8,
        "markeredgewidth": 1.2,
        "linestyle": "none",
    }
)
AWAY: Mapping[str, Any] = MappingProxyType(  # the nominal value is beyond the axis
    {"color": NOMINAL["color"], "markersize": 5, "linestyle": "none"}
)
PRIOR_LINE: Mapping[str, Any] = MappingProxyType(
    {"color": MIDDLE, "linestyle": (0, (6, 1, 1, 1)), "linewidth": 0.8}
)
DOTS: Mapping[str, Any] = MappingProxyType(
    {
        "color": DARK,
        "marker": "o",
        "markersize": 1.2,
        "markeredgewidth": 0,
        "linestyle": "none",
        "alpha": 0.35,
        "zorder": -1,
        "rasterized": True,
    }
)

NARROW = 1e-3  # an axis narrower than this, relative to its numbers, counts from an origin


def styled() -> AbstractContextManager[None]:
    """Figures are built and saved inside; what the caller had set comes back after it."""
    rc: Any = dict(RC)
    return matplotlib.rc_context(rc)


class Labelled(Protocol):
    """What a symbol and a channel have in common; LaTeX without dollars."""

    @property
    def latex(self) -> str: ...

    @property
    def latex_unit(self) -> str: ...


@dataclass(frozen=True, slots=True)
class Scale:
    """Numbers on an axis: (x - origin) / 10**power of the SI value x, shown from low to high."""

    origin: float
    power: int
    low: float
    high: float

    def __call__(self, x: Array | float) -> Array:
        return np.asarray((np.asarray(x) - self.origin) / 10.0**self.power, dtype=np.float64)

    def share(self, u: Array) -> Array:
        """0 at the low end of the axis, 1 at the high end, for numbers `u` on it."""
        return np.asarray((u - self.low) / (self.high - self.low), dtype=np.float64)

    def side(self, x: float | None) -> int:
        """-1, 0 or 1: the SI value x is below, on or above the axis; 0 when there is none."""
        if x is None:
            return 0
        u = float(self(x))
        return int(u > self.high) - int(u < self.low)

    def label(self, what: Labelled, separator: str = " ") -> str:
        return axis_label(what, self.power, self.origin, separator)


def scale(low: float, high: float) -> Scale:
    """A scale for the SI values from `low` to `high`, with few digits on its ticks."""
    if not high > low:
        half = 1e-9 * abs(low) or 1.0
        low, high = low - half, high + half
    origin = 0.0
    if high - low < NARROW * max(abs(low), abs(high)):
        origin = _round_number(0.5 * (low + high), high - low)
    power = math.floor(math.log10(max(abs(low - origin), abs(high - origin))))
    if origin == 0.0 and -1 <= power <= 2:
        power = 0
    unit = 10.0**power
    return Scale(origin, power, (low - origin) / unit, (high - origin) / unit)


def reaching(
    low: float, high: float, value: float | None, farthest: float = math.inf
) -> tuple[float, float]:
    """The ends, moved to show `value` where it is within `farthest` of them, in widths."""
    far = farthest * (high - low)
    if value is None or not low - far <= value <= high + far:
        return low, high
    return min(low, value), max(high, value)


def _round_number(x: float, width: float) -> float:
    """The number of fewest digits that is within `width` of x."""
    return next(
        near
        for near in (float(f"{x:.{digits}e}") for digits in range(18))
        if abs(near - x) <= width
    )


def axis_label(what: Labelled, power: int, origin: float = 0.0, separator: str = " ") -> str:
    r"""For example `$j_m$ [$10^{-4}\,\mathrm{kg\,m^2}$]`: axis values are divided by the power."""
    quantity = f"${what.latex}$" if origin == 0 else f"${what.latex} - {_latex_number(origin)}$"
    ten = rf"10^{{{power}}}" if power else ""
    unit = rf"\mathrm{{{what.latex_unit}}}" if what.latex_unit else ""
    inside = r"\,".join(part for part in (ten, unit) if part)
    return f"{quantity}{separator}[${inside}$]" if inside else quantity


def _latex_number(x: float) -> str:
    mantissa, exponent = f"{x:.15e}".split("e")
    digits = repr(float(mantissa)).removesuffix(".0")
    if -2 <= int(exponent) <= 2:
        return repr(x).removesuffix(".0")
    return rf"{digits}{{\cdot}}10^{{{int(exponent)}}}"


def with_spread(x: float, low: float, high: float) -> str:
    """LaTeX of x and its interval, with two digits of the interval's shorter side."""
    shorter = min(x - low, high - x)
    places = max(0, 1 - math.floor(math.log10(shorter))) if shorter > 0 else 3
    return f"{x:.{places}f}^{{+{high - x:.{places}f}}}_{{-{x - low:.{places}f}}}"


def ticks(
    low: float, high: float, most: int = 3, *, clear: float = 0.05, letter: float = 0.0
) -> tuple[Array, list[str]]:
    """Two to `most` (3 or more) round numbers and their texts.

    Shares of the axis: `clear` stays free at both ends; `letter` is the room that a letter of a
    text needs, and where three texts have less, only the outer two stay.
    """
    length = high - low
    low, high = low + clear * length, high - clear * length
    values, places, step = _round_numbers(low, high, most)
    texts = [_text(value, places) for value in values]
    if len(values) == 3 and letter * max(map(len, texts)) * length > step:
        values, texts = values[::2], texts[::2]
    return np.array(values), texts


def _round_numbers(low: float, high: float, most: int) -> tuple[list[float], int, float]:
    """The multiples of the finest step that gives at most `most`, their decimals, the step."""
    exponent = math.floor(math.log10((high - low) / most)) - 1
    while True:
        for factor, decimals in ((1.0, 0), (2.0, 0), (2.5, 1), (5.0, 0)):
            step = factor * 10.0**exponent
            first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
            if last - first < most:
                places = max(0, decimals - exponent)
                return [round(k * step, places) for k in range(first, last + 1)], places, step
        exponent += 1


def _text(value: float, places: int) -> str:
    return f"{value + 0.0:.{places}f}".replace("-", "\N{MINUS SIGN}")


def set_ticks(axis: Axis, places: Array, texts: Sequence[str] | None) -> None:
    """Fixed ticks with fixed texts, or with none: no offset text appears on this axis."""
    axis.set_major_locator(FixedLocator(places.tolist()))
    axis.set_major_formatter(NullFormatter() if texts is None else FixedFormatter(texts))


def side_label(panel: Axes, text: str) -> None:
    """The label of a vertical axis, at the same distance in all panels."""
    move = ScaledTranslation(-TICKS_WIDTH, 0, panel.figure.dpi_scale_trans)
    panel.set_ylabel(text, linespacing=1.12)
    panel.yaxis.set_label_coords(0, 0.5, transform=panel.transAxes + move)


def nominal_handles(sides: Collection[int], *, marker: str = ">") -> list[Line2D]:
    """For a legend: nominal values on the axes (side 0) and beyond them."""
    handles = []
    if 0 in sides:
        handles.append(Line2D([], [], label="nominal value", **NOMINAL))
    if set(sides) - {0}:
        handles.append(Line2D([], [], marker=marker, label="nominal value, off the axis", **AWAY))
    return handles


def thin(n: int, most: int) -> NDArray[np.intp]:
    """At most `most` indices of `n`, evenly spaced from the first to the last."""
    if n <= most:
        return np.arange(n)
    return np.unique(np.linspace(0, n - 1, most).round().astype(np.intp))


# What PDF readers know; other entries are joined in Keywords.
_PDF_KEYS = ("Title", "Author", "Subject", "Keywords", "Creator", "Producer")


def save(
    figure: Figure, folder: Path, stem: str, metadata: Mapping[str, str], warning: str = ""
) -> list[Path]:
    """`<stem>.pdf` and `<stem>.png`, with `metadata` inside and no date: same figure, same bytes.

    `warning` stands in a strip of its own above the figure.
    """
    written = []
    with styled():
        area = _with_strip(figure, warning) if warning else None
        for kind, entries in (("pdf", _pdf_entries(metadata)), ("png", dict(metadata))):
            path = folder / f"{stem}.{kind}"
            with whole(path) as aside:
                figure.savefig(aside, format=kind, dpi=PNG_DPI, metadata=entries, bbox_inches=area)
            written.append(path)
    return written


def _with_strip(figure: Figure, warning: str) -> Bbox:
    """Inches of the figure and of a strip above it, in which the warning stands."""
    width, height = figure.get_size_inches()
    middle = 1.0 + 0.5 * STRIP / height
    figure.text(0.5, middle, warning, ha="center", va="center", weight="bold")
    return Bbox([[0.0, 0.0], [width, height + STRIP]])


def _pdf_entries(metadata: Mapping[str, str]) -> dict[str, str | None]:
    known: dict[str, str | None] = {k: v for k, v in metadata.items() if k in _PDF_KEYS}
    others = [f"{key}: {value}" for key, value in metadata.items() if key not in _PDF_KEYS]
    if others:
        first = [metadata["Keywords"]] if "Keywords" in metadata else []
        known["Keywords"] = "; ".join(first + others)
    return known | {"CreationDate": None}
