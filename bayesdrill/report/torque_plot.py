"""The missing torque: over time, and against what the rig did: speeds, an angle within a turn, an
input.
"""

from __future__ import annotations

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
from bayesdrill.report.torque_shown import Against, Shown

Array = NDArray[np.float64]

LEFT, RIGHT, TOP, BOTTOM, GAP_X, GAP_Y = 0.84, 0.1, 0.36, 0.42, 0.3, 0.56  # inches
ROW, HIGH = 1.5, 1.6
NARROW = {"left": 0.7, "row": 1.1}
POINTS = 1200  # of a line over time, and dots of a panel
BAND: dict[str, Any] = {"color": style.LIGHT, "linewidth": 0}
MEAN: dict[str, Any] = {"color": style.BLACK, "linewidth": 0.9}


def torque_figure(found: Shown, width: float = style.DOUBLE) -> Figure:
    """Above over time; below a panel for each thing that the torque may follow."""
    broad = width >= style.DOUBLE
    left, row = (LEFT, ROW) if broad else (NARROW["left"], NARROW["row"])
    columns, n = (2 if broad else 1), len(found.against)
    rows = -(-n // columns)
    height = TOP + ROW + rows * (GAP_Y + row) + BOTTOM
    with style.styled(width):
        figure = Figure(figsize=(width, height))
        y = _scale(found)
        wide = width - left - RIGHT
        first = height - TOP - ROW
        panel = _panel(figure, (left, first, wide, ROW))
        _over_time(panel, found, y)
        each = (wide - (columns - 1) * GAP_X) / columns
        for k, one in enumerate(found.against):
            line, column = divmod(k, columns)
            place = (left + column * (each + GAP_X), first - (line + 1) * (GAP_Y + row), each, row)
            _against(_panel(figure, place), one, found, y, labelled=column == 0)
        _legend(figure)
    return figure


def _panel(figure: Figure, place: tuple[float, float, float, float]) -> Axes:
    width, height = figure.get_size_inches()
    x, y, w, h = place
    return figure.add_axes((x / width, y / height, w / width, h / height))


def _scale(found: Shown) -> style.Scale:
    low, high = float(found.band[0].min()), float(found.band[1].max())
    return style.scale(low, high, margin=0.04)


def _over_time(panel: Axes, found: Shown, y: style.Scale) -> None:
    x = style.scale(float(found.t[0]), float(found.t[-1]))
    some = style.thin(len(found.t), POINTS)
    t = x(found.t[some])
    panel.fill_between(t, *y(found.band[:, some]), **BAND)
    panel.plot(t, y(found.expected[some]), **MEAN)
    _finish(panel, x, y)
    panel.set_xlabel(f"{found.time.meaning}, {x.label(found.time)}", labelpad=2)
    style.side_label(panel, y.label(found.torque, "\n"))


def _against(panel: Axes, one: Against, found: Shown, y: style.Scale, *, labelled: bool) -> None:
    x = style.scale(float(one.values.min()), float(one.values.max()), margin=0.02)
    some = style.thin(len(one.values), POINTS)
    panel.plot(x(one.values[some]), y(found.expected[some]), **style.DOTS)
    panel.fill_between(x(one.centres), *y(one.band), zorder=1, **BAND)
    panel.plot(x(one.centres), y(one.means), zorder=3, **MEAN)
    _finish(panel, x, y)
    panel.set_xlabel(f"{one.label.meaning}, {x.label(one.label)}", labelpad=2)
    if labelled:
        style.side_label(panel, y.label(found.torque, "\n"))
    else:
        style.set_ticks(panel.yaxis, y.ticks(4)[0], None)


def _finish(panel: Axes, x: style.Scale, y: style.Scale) -> None:
    panel.set_xlim(x.low, x.high)
    panel.set_ylim(y.low, y.high)
    if y.low < 0.0 < y.high:
        panel.axhline(float(y(0.0)), color=style.MIDDLE, linewidth=0.5, zorder=0)
    if x.low < 0.0 < x.high:
        panel.axvline(float(x(0.0)), color=style.MIDDLE, linewidth=0.5, zorder=0)
    style.set_ticks(panel.xaxis, *x.ticks(5))
    style.set_ticks(panel.yaxis, *y.ticks(4))


def _legend(figure: Figure) -> None:
    handles: Sequence[Line2D | Patch] = [
        Line2D([], [], label="mean", **MEAN),
        Patch(label=f"{100 * HDI_PROBABILITY:.0f} % posterior", **BAND),
        Line2D([], [], label="samples", **{**style.DOTS, "markersize": 3, "rasterized": False}),
    ]
    figure.legend(handles=handles, loc="upper center", ncols=3, borderaxespad=0.3, handlelength=2.0)
