"""What all figures share: fonts and greys, ticks and labels, and files that appear whole."""

from __future__ import annotations

import io
import threading
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import matplotlib
import numpy as np
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedFormatter, FixedLocator, NullFormatter
from matplotlib.transforms import ScaledTranslation
from numpy.typing import NDArray

from bayesdrill.basics import own_files
from bayesdrill.report.scales import Labelled as Labelled
from bayesdrill.report.scales import Scale as Scale
from bayesdrill.report.scales import axis_label as axis_label
from bayesdrill.report.scales import reaching as reaching
from bayesdrill.report.scales import scale as scale
from bayesdrill.report.scales import ticks as ticks
from bayesdrill.report.widths import DOUBLE as DOUBLE
from bayesdrill.report.widths import DPI
from bayesdrill.report.widths import SINGLE as SINGLE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

TICKS_WIDTH = 0.43  # between an axis and its label, inches
SMALL = 0.83  # of the letters of a figure in one column, in those of one in two

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
        "xtick.minor.size": 1.6,
        "ytick.minor.size": 1.6,
        "xtick.minor.width": 0.4,
        "ytick.minor.width": 0.4,
        "legend.fontsize": 8.0,
        "legend.frameon": False,
        "lines.linewidth": 1.0,
        "hatch.linewidth": 0.4,
        "pdf.fonttype": 42,
        "svg.hashsalt": "bayesdrill",
        "savefig.dpi": DPI,
        "figure.constrained_layout.use": False,
        "figure.autolayout": False,
    }
)

_SIZES = (
    *("font.size", "axes.labelsize", "axes.titlesize"),
    *("xtick.labelsize", "ytick.labelsize", "legend.fontsize"),
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
CHANCE: Mapping[str, Any] = MappingProxyType(  # the band that chance allows, ...
    {"facecolor": FAINT, "edgecolor": MIDDLE, "linewidth": 0.5}
)
OUTSIDE: Mapping[str, Any] = MappingProxyType({"color": MAP_COLOUR, "linewidth": 1.8})  # ... left
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


# Matplotlib has one style for the whole process, and one parser of formulas.
_ONE_AT_A_TIME = threading.RLock()


@contextmanager
def styled(width: float = DOUBLE) -> Iterator[None]:
    """Figures are built and saved inside, of one thread; what the caller had set comes back after it.

    Letters are smaller in a figure of one column.
    """
    rc: Any = dict(RC)
    if width <= SINGLE:
        rc |= {name: SMALL * size for name, size in RC.items() if name in _SIZES}
    with _ONE_AT_A_TIME, matplotlib.rc_context(rc):
        yield


def letters(of: str) -> float:
    """Points, in the figure that is being built."""
    now: Any = matplotlib.rcParams
    return float(now[of])


def set_numbers(axis: Axis, scale: Scale, most: int, **room: float) -> None:
    """At most `most` ticks with texts; a logarithmic axis shows by small ones that it is one."""
    set_ticks(axis, *scale.ticks(most, **room))
    axis.set_minor_locator(FixedLocator(scale.between.tolist()))
    axis.set_minor_formatter(NullFormatter())


def set_ticks(axis: Axis, places: Array, texts: Sequence[str] | None) -> None:
    """Fixed ticks with fixed texts, or with none: no offset text appears on this axis."""
    axis.set_major_locator(FixedLocator(places.tolist()))
    axis.set_major_formatter(NullFormatter() if texts is None else FixedFormatter(texts))


def side_label(panel: Axes, text: str) -> None:
    """The label of a vertical axis, at the same distance in all panels."""
    width = TICKS_WIDTH * letters("ytick.labelsize") / RC["ytick.labelsize"]
    move = ScaledTranslation(-width, 0, panel.figure.dpi_scale_trans)
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


# What readers of a format know; other entries are joined in Keywords.
_KNOWN: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "pdf": ("Title", "Author", "Subject", "Keywords", "Creator", "Producer"),
        "svg": ("Title", "Creator", "Description", "Keywords"),
    }
)
_DATES: Mapping[str, str] = MappingProxyType({"pdf": "CreationDate", "svg": "Date"})


def save(
    figure: Figure,
    folder: Path,
    stem: str,
    metadata: Mapping[str, str],
    *,
    formats: Sequence[str] = own_files.USUAL,
    dpi: int = DPI,
) -> list[Path]:
    """`<stem>.pdf`, ... with `metadata` inside and no date: same figure, same bytes.

    `dpi`: of PNG, and of what is drawn as pixels in the other formats.
    """
    written = []
    with styled():
        for kind in formats:
            image = io.BytesIO()
            figure.savefig(image, format=kind, dpi=dpi, metadata=_entries(kind, metadata))
            written.append(folder / f"{stem}.{kind}")
            own_files.write(written[-1], image.getvalue())
    return written


def _entries(kind: str, metadata: Mapping[str, str]) -> dict[str, str | None]:
    """As the writer of this format takes them."""
    if kind not in _KNOWN:
        return dict(metadata)
    known: dict[str, str | None] = {k: v for k, v in metadata.items() if k in _KNOWN[kind]}
    others = [f"{key}: {value}" for key, value in metadata.items() if key not in _KNOWN[kind]]
    if others:
        first = [metadata["Keywords"]] if "Keywords" in metadata else []
        known["Keywords"] = "; ".join(first + others)
    return known | {_DATES[kind]: None}
