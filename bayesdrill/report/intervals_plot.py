"""Where several runs have each unknown: mean and interval, a row for each run."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from bayesdrill.insight.diagnostics import HDI_PROBABILITY
from bayesdrill.insight.overlay import Layer, Place, Row
from bayesdrill.report import style
from bayesdrill.report.overlay_looks import LOOKS, handles
from bayesdrill.report.overlay_shown import in_logs, shown
from bayesdrill.report.pages import Page
from bayesdrill.setup.own_units import OwnUnits

COLUMNS = 3
ROW, FRAME = 0.17, 0.2  # inches of a run and of the margins of a panel
HANDLE, LETTER = 0.55, 0.062  # of a legend: inches of a handle with its gaps, and of a letter
LEGEND_LINE, LEGEND_MARGIN = 0.17, 0.2
REACH = 1.0  # how far an axis may grow for the nominal value, in widths
BAR: dict[str, Any] = {"linewidth": 1.2, "marker": "|", "markersize": 5}
HELD: dict[str, Any] = {"marker": "x", "markersize": 5, "markeredgewidth": 1.2}
CREDIBLE = f"{100 * HDI_PROBABILITY:.0f} %"


def intervals_figure(layers: Sequence[Layer], rows: Sequence[Row], own: OwnUnits) -> Figure:
    """Of all unknowns of any run, `rows` in SI; a run that has not got one leaves a gap.

    Axes are logarithmic where the prior of the first run is flat in the log.
    """
    logs = [in_logs(row, layers) for row in rows]
    rows = [shown(row, own) for row in rows]
    with style.styled():
        scales = [_scale(row, log=log) for row, log in zip(rows, logs, strict=True)]
        said = _handles(layers, rows, scales)
        columns = _legend_columns(said)
        lines = -(-len(said) // columns)
        figure, panels = _page(len(layers), lines).build(len(rows))
        for panel, row, scale in zip(panels, rows, scales, strict=True):
            _draw(panel, row, scale)
        figure.legend(
            handles=said,
            loc="upper center",
            ncols=columns,
            borderaxespad=0.3,
            labelspacing=0.3,
            columnspacing=1.4,
            handlelength=2.6,
        )
    return figure


def _page(n_runs: int, lines: int) -> Page:
    return Page(
        columns=COLUMNS,
        width=style.DOUBLE,
        row=FRAME + n_runs * ROW,
        left=0.14,
        right=0.14,
        gap_x=0.2,
        gap_y=0.56,
        top=LEGEND_MARGIN + LEGEND_LINE * lines,
        bottom=0.5,
    )


def _draw(panel: Axes, row: Row, scale: style.Scale) -> None:
    n = len(row.places)
    agreed = row.agreed
    if agreed is not None and scale.side(agreed) == 0:
        panel.axvline(float(scale(agreed)), zorder=1, **style.NOMINAL)
    for k, (place, nominal) in enumerate(zip(row.places, row.nominal, strict=True)):
        y, look = n - 1 - k, LOOKS[k]
        if agreed is None and nominal is not None and scale.side(nominal) == 0:
            panel.plot([float(scale(nominal))] * 2, [y - 0.5, y + 0.5], zorder=1, **style.NOMINAL)
        if place is None:
            continue
        if place.held:
            panel.plot([float(scale(place.mean))], [y], zorder=3, color=look.color, **HELD)
            continue
        ends = scale(np.array([place.low, place.high]))
        panel.plot(ends, [y, y], zorder=2, color=look.color, **BAR)
        mark: dict[str, Any] = {"marker": look.marker, "color": look.color, "markersize": 4}
        panel.plot([float(scale(place.mean))], [y], zorder=3, linestyle="none", **mark)
    _away(panel, scale, agreed)
    panel.set_xlim(scale.low, scale.high)
    panel.set_ylim(-0.5 - 0.5 * FRAME / ROW, n - 0.5 + 0.5 * FRAME / ROW)
    style.set_numbers(panel.xaxis, scale, 4)
    style.set_ticks(panel.yaxis, np.array([]), None)
    panel.set_xlabel(scale.label(row.symbol), labelpad=2)


def _scale(row: Row, *, log: bool) -> style.Scale:
    """All intervals, what is held, and the nominal value if it is not too far."""
    found = [place for place in row.places if place is not None]
    low, high = min(place.low for place in found), max(place.high for place in found)
    low, high = style.reaching(low, high, row.agreed, REACH, log=log)
    return style.scale(low, high, log=log, margin=0.08)


def _away(panel: Axes, scale: style.Scale, nominal: float | None) -> None:
    side = scale.side(nominal)
    if side:
        place, marker = (0.97, ">") if side > 0 else (0.03, "<")
        panel.plot([place], [0.5], transform=panel.transAxes, marker=marker, **style.AWAY)


def _handles(
    layers: Sequence[Layer], rows: Sequence[Row], scales: Sequence[style.Scale]
) -> list[Line2D]:
    said = handles(layers, marked=True)
    for handle in said:
        handle.set(markersize=4, linestyle="-")
    pairs = zip(rows, scales, strict=True)
    sides = {scale.side(row.agreed) for row, scale in pairs if row.agreed is not None}
    different = any(row.agreed is None and any(v is not None for v in row.nominal) for row in rows)
    said += style.nominal_handles(sides | ({0} if different else set()))
    if any(isinstance(place, Place) and place.held for row in rows for place in row.places):
        said.append(Line2D([], [], label="held there", color="0.3", linestyle="none", **HELD))
    note = f"mean and narrowest {CREDIBLE} interval"
    return [*said, Line2D([], [], linestyle="none", label=note)]


def _legend_columns(said: Sequence[Line2D]) -> int:
    """As many as fit side by side."""
    longest = max(len(str(handle.get_label())) for handle in said)
    return max(1, min(len(said), 4, int(style.DOUBLE / (HANDLE + LETTER * longest))))
