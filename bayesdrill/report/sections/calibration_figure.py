"""Draw ranks of a calibration against chance: a panel for each quantity, and one for intervals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from bayesdrill.analysis.calibration import CalibrationVerdict
from bayesdrill.basics.symbols import Symbol
from bayesdrill.report import scales, style
from bayesdrill.report.pages import (
    build_page,
    departures,
    label_outside,
    legend_above,
    ranks_panel,
)

MARKERS = ("o", "s", "^")  # of the levels


def calibration_figure(
    verdict: CalibrationVerdict, symbols: Sequence[Symbol], width: float = scales.DOUBLE
) -> Figure:
    """Draw rank distributions against uniform, above the coverage of credible intervals.

    `symbols` of the unknowns; the log likelihood is the last quantity.
    """
    labels = [*(symbol.latex for symbol in symbols), r"\log L"]
    away = [departures(verdict.band, quantity.ranks) for quantity in verdict.quantities]
    most = max(float(np.abs(each).max()) for each in away)
    with style.styled(width):
        figure, (*panels, covered) = build_page(len(labels), 4, 1.2, width, last=1.9)
        for panel, label, quantity, each in zip(
            panels, labels, verdict.quantities, away, strict=True
        ):
            shape = (quantity.shape or "leaves the band").removeprefix("posterior ")
            wrong = "" if quantity.holds else shape
            ranks_panel(panel, verdict.band, each, most, wrong, 3, style.BAND)
            style.corner_text(panel, f"${label}$")
        label_outside(panels, "normalised rank", "ECDF difference")
        _coverage(covered, verdict, labels[:-1])
        legend_above(figure, _handles(verdict))
    return figure


def _mark(marker: str, holds: bool) -> dict[str, Any]:
    face, edge = ("white", style.BLACK) if holds else (style.MAP_COLOUR, style.MAP_COLOUR)
    look = {"marker": marker, "markersize": 3.4, "markeredgewidth": 0.8}
    return {**look, "markerfacecolor": face, "markeredgecolor": edge}


def _coverage(panel: Axes, verdict: CalibrationVerdict, labels: Sequence[str]) -> None:
    n = max(verdict.band.n, 1)
    unknown = [quantity for quantity in verdict.quantities if quantity.intervals]
    shares = [interval.share for interval in unknown[0].intervals]
    for share in shares:
        panel.axhline(100 * share, color=style.MIDDLE, linewidth=0.5, zorder=0)
    width = 0.2 * min(1.0, len(unknown) / 6)
    for column, quantity in enumerate(unknown):
        for k, interval in enumerate(quantity.intervals):
            x = column + 1.1 * width * (k - 1)
            low, high = 100 * interval.low / n, 100 * interval.high / n
            panel.bar(x, high - low, width, bottom=low, zorder=1, **style.BAND)
            look = _mark(MARKERS[k], interval.holds)
            panel.plot([x], [100 * interval.inside / n], zorder=3, **look)
    panel.set_xlim(-0.6, len(unknown) - 0.4)
    floor = min(min(min(i.low, i.inside) for i in q.intervals) for q in unknown)
    panel.set_ylim(max(0.0, 100 * floor / n - 6.0), 102.0)
    style.set_ticks(panel.xaxis, np.arange(float(len(unknown))), [f"${label}$" for label in labels])
    panel.tick_params(axis="x", length=0)
    style.set_ticks(panel.yaxis, 100 * np.array(shares), [f"{100 * s:.3g}" for s in shares])
    panel.set_ylabel("truths inside [%]")


def _handles(verdict: CalibrationVerdict) -> list[Any]:
    quantities = verdict.quantities
    handles: list[Any] = [Patch(label="what chance allows", **style.BAND)]
    if any(q.holds for q in quantities):
        handles.append(Line2D([], [], label="ranks of the truth", **style.BLACK_LINE))
    if not all(q.holds for q in quantities):
        handles.append(Line2D([], [], label="ranks that leave the band", **style.OUTSIDE))
    intervals = next(q.intervals for q in quantities if q.intervals)
    for marker, interval in zip(MARKERS, intervals, strict=True):
        label = f"{100 * interval.share:.3g} % interval"
        handles.append(Line2D([], [], label=label, linestyle="none", **_mark(marker, True)))
    return handles
