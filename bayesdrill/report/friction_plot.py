"""Each friction against its speed: its law and band, where the record saw it, nominal values."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from bayesdrill.insight.diagnostics import HDI_PROBABILITY
from bayesdrill.report import style
from bayesdrill.report.pages import Page
from bayesdrill.report.rubbed import Law

Array = NDArray[np.float64]

PAGE = Page(
    columns=3,
    width=style.DOUBLE,
    row=1.6,
    left=0.84,
    right=0.1,
    gap_x=0.94,
    gap_y=0.6,
    top=0.36,
    bottom=0.42,
)
SMALL = dataclasses.replace(
    PAGE, columns=1, width=style.SINGLE, row=1.15, left=0.7, gap_y=0.5, top=0.5, bottom=0.4
)
BINS = 60
FOOT = 0.2  # of a panel: for the speeds of the record
HEAD = 1.12  # of the largest effort
BAND: dict[str, Any] = {"color": style.LIGHT, "linewidth": 0}
BEST: dict[str, Any] = {"color": style.BLACK, "linewidth": 1.0}
SEEN: dict[str, Any] = {"color": style.MIDDLE}


def friction_figure(laws: Sequence[Law], width: float = style.DOUBLE) -> Figure:
    """A panel for each."""
    page = PAGE if width >= style.DOUBLE else SMALL
    with style.styled(page.width):
        figure, panels = page.build(len(laws))
        for panel, law in zip(panels, laws, strict=True):
            _law(panel, law)
        _legend(figure, laws, page is not SMALL)
    return figure


def _law(panel: Axes, law: Law) -> None:
    every = [law.best, *([] if law.band is None else law.band)]
    every += [] if law.nominal is None else [law.nominal]
    far = HEAD * max(float(np.abs(one).max()) for one in every) or 1.0
    x = style.scale(float(law.speeds[0]), float(law.speeds[-1]))
    y = style.scale(-far, far)
    room = FOOT / (1.0 - FOOT) * (y.high - y.low)
    if law.band is not None:
        for side in (law.speeds <= 0, law.speeds >= 0):
            panel.fill_between(x(law.speeds[side]), *y(_at_rest(law.band, side)), zorder=1, **BAND)
    if law.nominal is not None:
        panel.plot(x(law.speeds), y(law.nominal), zorder=2, **style.NOMINAL)
    panel.plot(x(law.speeds), y(law.best), zorder=3, **BEST)
    _seen(panel, law, x, y.low - room, room)
    panel.set_xlim(x.low, x.high)
    panel.set_ylim(y.low - room, y.high)
    panel.axhline(y.low, color=style.MIDDLE, linewidth=0.5)
    style.set_ticks(panel.xaxis, *x.ticks(4))
    style.set_ticks(panel.yaxis, *y.ticks(4))
    panel.set_xlabel(f"{law.speed.meaning}, {x.label(law.speed)}")
    style.side_label(panel, y.label(law.effort, "\n"))


def _at_rest(band: Array, side: NDArray[np.bool_]) -> Array:
    """Of one side `(2, n)`: at rest, where a law has both signs, as it is just beside."""
    found = band[:, side].copy()
    rest, beside = (-1, -2) if not side[-1] else (0, 1)
    found[:, rest] = found[:, beside]
    return found


def _seen(panel: Axes, law: Law, x: style.Scale, low: float, room: float) -> None:
    """How often the record has these speeds, below the laws."""
    counts, edges = np.histogram(x(law.seen), np.linspace(x.low, x.high, BINS + 1))
    heights = low + 0.85 * room * counts / max(int(counts.max()), 1)
    panel.stairs(heights, edges, baseline=low, fill=True, zorder=1, **SEEN)


def _legend(figure: Figure, laws: Sequence[Law], broad: bool) -> None:
    handles: list[Line2D | Patch] = [Line2D([], [], label="MAP", **BEST)]
    if any(law.band is not None for law in laws):
        handles.append(Patch(label=f"{100 * HDI_PROBABILITY:.0f} % posterior", **BAND))
    if any(law.nominal is not None for law in laws):
        handles.append(Line2D([], [], label="nominal values", **style.NOMINAL))
    handles.append(Patch(label="speeds of the record", **SEEN))
    figure.legend(
        handles=handles,
        loc="upper center",
        ncols=len(handles) if broad else 2,
        borderaxespad=0.3,
        handlelength=2.4,
        columnspacing=1.6,
        labelspacing=0.3,
    )
