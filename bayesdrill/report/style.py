"""Set the style of figures: fonts and greys, ticks and axes, warnings, and saving.

Matplotlib takes a second to load, so it is imported where something is drawn.
"""

from __future__ import annotations

import io
import textwrap
import threading
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bayesdrill import output_files
from bayesdrill.basics.arrays import Array
from bayesdrill.report.scales import DOUBLE, DPI, SINGLE, Scale

if TYPE_CHECKING:
    from matplotlib.axes import Axes as Axes
    from matplotlib.axis import Axis as Axis
    from matplotlib.figure import Figure as Figure
else:  # annotations are never evaluated, so matplotlib need not load
    Axes = Axis = Figure = Any

Look = Mapping[str, Any]  # keyword arguments of matplotlib artists
NONE = np.empty(0)
SMALL = 0.83  # font size in figures of single width, relative to double width


def fix_look(**entries: Any) -> Look:
    """Return a look that cannot be changed."""
    return MappingProxyType(entries)


_LETTERS = {
    "font.size": 9.0,
    "axes.labelsize": 9.0,
    "axes.titlesize": 9.0,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "legend.fontsize": 8.0,
}
_TICKS = {"major.size": 3.0, "major.width": 0.6, "minor.size": 1.6, "minor.width": 0.4}
RC: Mapping[str, Any] = MappingProxyType(
    {
        **_LETTERS,
        "text.usetex": False,
        "font.family": ["STIXGeneral"],
        "mathtext.fontset": "stix",
        "axes.linewidth": 0.6,
        "axes.unicode_minus": True,
        "xtick.direction": "in",
        "ytick.direction": "in",
        **{f"{axis}tick.{name}": value for name, value in _TICKS.items() for axis in "xy"},
        "legend.frameon": False,
        "lines.linewidth": 1.0,
        "hatch.linewidth": 0.4,
        "pdf.fonttype": 42,
        "svg.hashsalt": "bayesdrill",
        "figure.dpi": DPI,  # equal to that of PNG files, so that layout and saving share cached texts
        "savefig.dpi": DPI,
        "figure.constrained_layout.use": False,
        "figure.autolayout": False,
    }
)
BLACK, DARK, MIDDLE, LIGHT, FAINT = "0.0", "0.3", "0.55", "0.8", "0.91"
# Two colours that print as different greys; their line styles and markers differ as well.
NOMINAL = fix_look(color="#2b6cb0", linestyle=(0, (4, 2)), linewidth=1.0)
MAP_COLOUR = "#b3261e"
MAP_LINE = fix_look(color=MAP_COLOUR, linestyle=(0, (1, 1.5)), linewidth=1.0)
BLACK_LINE = fix_look(color=BLACK, linewidth=0.9)
BAND = fix_look(facecolor=LIGHT, linewidth=0)
FAINT_BAND = fix_look(facecolor=FAINT, linewidth=0)
CROSS = fix_look(color=MAP_COLOUR, marker="+", markersize=8, markeredgewidth=1.2, linestyle="none")
AWAY = fix_look(color=NOMINAL["color"], markersize=5, linestyle="none")  # for values off the axis
# The looks of the band that chance allows, and of values outside it.
CHANCE = fix_look(facecolor=FAINT, edgecolor=MIDDLE, linewidth=0.5)
OUTSIDE = fix_look(color=MAP_COLOUR, linewidth=1.8)
FILLED = fix_look(facecolor=LIGHT, edgecolor=BLACK, linewidth=0.7)
HATCHED = fix_look(facecolor="none", edgecolor=MIDDLE, linewidth=0)
PRIOR_LINE = fix_look(color=MIDDLE, linestyle=(0, (6, 1, 1, 1)), linewidth=0.8)
_DOT = fix_look(marker="o", markersize=1.2, markeredgewidth=0, linestyle="none")
DOTS = fix_look(color=DARK, alpha=0.35, zorder=-1, rasterized=True, **_DOT)
WORDS = fix_look(linestyle="none")  # look of a legend entry that has only words
# Matplotlib has one style and one parser of formulas per process, so one thread draws at a time.
_ONE_AT_A_TIME = threading.RLock()


@contextmanager
def styled(width: float = DOUBLE) -> Iterator[None]:
    """Set the style of figures within a `with` block, for one thread at a time, and restore it."""
    import matplotlib

    rc: Any = dict(RC)
    if width <= SINGLE:
        rc |= {name: SMALL * size for name, size in _LETTERS.items()}
    with _ONE_AT_A_TIME, matplotlib.rc_context(rc):
        yield


def new_figure(width: float, height: float, **options: Any) -> Figure:
    """Return an empty figure whose canvas keeps one renderer, which remembers the sizes of texts."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), **options)
    FigureCanvasAgg(figure)
    return figure


def letters(size: str) -> float:
    """Return the current font size in points of an rc entry, such as `legend.fontsize`."""
    import matplotlib

    now: Any = matplotlib.rcParams
    return float(now[size])


def set_numbers(axis: Axis, scale: Scale, max_count: int, **room: float) -> None:
    """Set at most `max_count` ticks with texts; a logarithmic axis has minor ticks too."""
    set_ticks(axis, *scale.ticks(max_count, **room), scale.minor_ticks)


def scale_axis(axis: Axis, scale: Scale, label: str, max_count: int = 4) -> None:
    """Set the ends of an axis, at most `max_count` numbers, and the label."""
    panel = axis.axes
    if axis.axis_name == "x":  # type: ignore[attr-defined]
        panel.set_xlim(scale.low, scale.high)
        panel.set_xlabel(label, labelpad=2)
    else:
        panel.set_ylim(scale.low, scale.high)
        panel.set_ylabel(label, linespacing=1.12)
    set_numbers(axis, scale, max_count)


def set_ticks(
    axis: Axis,
    positions: Iterable[float],
    texts: Sequence[str] | None = None,
    between: Array = NONE,
) -> None:
    """Set major ticks with fixed texts or none, and minor ticks `between`; hide the offset text."""
    from matplotlib.ticker import FixedFormatter, FixedLocator, NullFormatter

    axis.set_major_locator(FixedLocator([*positions]))
    axis.set_major_formatter(NullFormatter() if texts is None else FixedFormatter(texts))
    axis.set_minor_locator(FixedLocator(between.tolist()))
    axis.set_minor_formatter(NullFormatter())


def finer(look: Mapping[str, Any], factor: float) -> dict[str, Any]:
    """Return a look whose lines and marks are scaled by `factor`."""
    sizes = ("linewidth", "markersize", "markeredgewidth")
    return {**look, **{name: look[name] * factor for name in sizes if name in look}}


def mark_values(
    panel: Axes,
    scale: Scale,
    nominal: float | None,
    mode: float | None = None,
    *,
    vertical: bool = False,
    arrow: bool = True,
    zorder: float = 2.0,
    fine: float = 1.0,
) -> int:
    """Mark the nominal value and the MAP; return `Scale.side` of the nominal value."""
    line = panel.axhline if vertical else panel.axvline
    side = scale.side(nominal)
    if nominal is not None and side == 0:
        line(float(scale(nominal)), zorder=zorder, **finer(NOMINAL, fine))
    if side and arrow:
        end = 0.5 + 0.45 * side
        x, y, markers = (0.97, end, "v^") if vertical else (end, 0.5, "<>")
        look = finer(AWAY, fine)
        panel.plot([x], [y], transform=panel.transAxes, marker=markers[side > 0], **look)
    if mode is not None:
        line(float(scale(mode)), zorder=zorder, **finer(MAP_LINE, fine))
    return side


def corner_text(panel: Axes, text: str, side: str = "left", **look: Any) -> None:
    """Write a text at the top of a panel; `side` is "left" or "right"."""
    x = 0.03 if side == "left" else 0.97
    panel.text(x, 0.93, text, transform=panel.transAxes, ha=side, va="top", **look)


def nominal_looks(sides: Collection[int], marker: str = ">") -> dict[str, Look]:
    """Return entries of a legend for nominal values on the axes (side 0) and beyond them."""
    looks: dict[str, Look] = {"nominal value": NOMINAL} if 0 in sides else {}
    beyond = {"nominal value, off the axis": {"marker": marker, **AWAY}}
    return looks | (beyond if {*sides} - {0} else {})


def legend_handles(looks: Mapping[str, Look]) -> list[Any]:
    """Return handles of a legend: patches for looks with a `facecolor`, lines for the others."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    return [
        Patch(label=label, **look) if "facecolor" in look else Line2D([], [], label=label, **look)
        for label, look in looks.items()
    ]


def thin(n: int, max_count: int) -> NDArray[np.intp]:
    """Return at most `max_count` indices of `n`, evenly spaced from the first to the last."""
    return np.unique(np.linspace(0, n - 1, min(n, max_count)).round().astype(np.intp))


# By format, the metadata entry that matplotlib sets to the date, unless the entry is None.
_DATES: Mapping[str, str] = MappingProxyType({"pdf": "CreationDate", "svg": "Date"})


def save(
    figure: Figure,
    folder: Path,
    stem: str,
    metadata: Mapping[str, str],
    *,
    formats: Sequence[str] = output_files.DEFAULT_FORMATS,
    dpi: int = DPI,
) -> list[Path]:
    """Save `<stem>.pdf`, ... with `metadata` but no date, so that equal figures have equal bytes."""
    written, engine = [], figure.get_layout_engine()
    with styled():
        if engine is not None:  # compute the layout once, instead of for each format
            figure.set_dpi(dpi)
            engine.execute(figure)
            figure.set_layout_engine(None)  # without an engine, savefig draws only once
        for kind in formats:
            image = io.BytesIO()
            figure.savefig(image, format=kind, dpi=dpi, metadata=_entries(kind, metadata))
            written.append(folder / f"{stem}.{kind}")
            output_files.write(written[-1], image.getvalue())
    return written


def _entries(kind: str, metadata: Mapping[str, str]) -> dict[str, str | None]:
    """Return the metadata that a format accepts; `Keywords` joins entries that it does not know."""
    if kind not in _DATES:
        return dict(metadata)
    known: dict[str, str | None] = {
        name: text for name, text in metadata.items() if name in ("Title", "Creator")
    }
    others = [f"{name}: {text}" for name, text in metadata.items() if name not in known]
    if others:
        known["Keywords"] = "; ".join(others)
    return known | {_DATES[kind]: None}


MARGIN, LINE, LETTER = 0.09, 0.16, 0.066  # inches: margin of the strip, line height, letter width


def warned(figure: Figure, warning: str) -> Figure:
    """Return the figure with a strip at its top that shows `warning`."""
    if not warning:
        return figure
    width, height = (float(inches) for inches in figure.get_size_inches())
    lines = textwrap.wrap(warning, max(8, int((width - 2 * MARGIN) / LETTER)))
    strip = 2 * MARGIN + LINE * len(lines)
    figure.set_size_inches(width, height + strip)
    shrink(figure, 1.0, height / (height + strip))
    with styled():
        look: dict[str, Any] = {"weight": "bold", "size": 9.0, "linespacing": 1.1}
        middle = 1.0 - 0.5 * strip / (height + strip)
        figure.text(0.5, middle, "\n".join(lines), ha="center", va="center", **look)
    return figure


def shrink(figure: Figure, across: float, up: float) -> None:
    """Shrink the drawing by the factors `across` and `up`, towards the page's lower left corner."""
    from matplotlib.transforms import Affine2D

    smaller = Affine2D().scale(across, up) + figure.transFigure
    engine = figure.get_layout_engine()
    if engine is not None:
        # The engine reserves no room for a legend that was moved, so the room is reserved here.
        heights = [legend.get_window_extent().height / figure.dpi for legend in figure.legends]
        room = sum(height + 2 * engine.get()["h_pad"] for height in heights)
        engine.set(rect=(0, 0, across, up - room / figure.get_figheight()))  # type: ignore[call-arg]
    else:
        for panel in figure.axes:
            x, y, w, h = panel.get_position(original=True).bounds
            panel.set_position((x * across, y * up, w * across, h * up))
    for artist in (*figure.artists, *figure.lines, *figure.patches, *figure.texts):
        artist.set_transform(smaller)
    for legend in figure.legends:
        box = legend.get_bbox_to_anchor().transformed(figure.transFigure.inverted())
        legend.set_bbox_to_anchor(box, transform=smaller)
