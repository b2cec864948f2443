"""The joint posteriors of several runs in one corner, each in a look of its own."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import NullFormatter
from numpy.typing import NDArray

from bayesdrill.insight.overlay import Layer, Row
from bayesdrill.report import style
from bayesdrill.report.contours import LEVELS, contours
from bayesdrill.report.overlay_looks import LOOKS, handles
from bayesdrill.report.overlay_shown import in_logs, shown
from bayesdrill.setup.own_units import OwnUnits

Array = NDArray[np.float64]

CENTRAL = 0.998  # of the draws of each run, inside an axis
REACH = 0.5  # the axis grows by this share of its width at most to show the nominal value
BINS = 40  # across an axis
UNSEEN = 0.02  # of an axis that a run fills less of, its histogram would be a spike

# Inches; a corner of nine is printed at two thirds of its size.
PANEL_LARGEST, PANEL_SMALLEST, PANELS_WIDTH = 2.0, 1.03, 9.3
LEFT, BOTTOM, TOP, RIGHT = 0.88, 0.88, 0.2, 0.15
LEGEND_WIDTH, LEGEND_LINE = 3.0, 0.21
GAP = 0.06
TICK_SIZE, LABEL_SIZE = 8.5, 10.0


@dataclass(frozen=True, slots=True)
class _Column:
    """An unknown on the axis that all runs share; `draws` of each run, None where it has none."""

    row: Row
    scale: style.Scale
    draws: tuple[Array | None, ...]
    ends: tuple[tuple[float, float], ...]
    nominal: float | None


def overlay_corner_figure(layers: Sequence[Layer], rows: Sequence[Row], own: OwnUnits) -> Figure:
    """Of the unknowns that two runs or more have, `rows` in SI.

    A run is left out of panels of what it has not.  Axes are logarithmic where the prior of the first
    run is flat in the log.
    """
    columns = [_column(row, layers, own) for row in rows if row.shared]
    n = len(columns)
    with style.styled():
        figure, panels = _page(n, len(layers) + 4)
        for i, row in enumerate(columns):
            _histograms(panels[i, i], row)
            for j, column in enumerate(columns[:i]):
                _contours(panels[i, j], column, row)
        _arrange(figure, panels, columns)
        _legend(figure, layers, columns)
    return figure


def _column(si: Row, layers: Sequence[Layer], own: OwnUnits) -> _Column:
    row, factor, log = shown(si, own), own.factor(si.symbol.name), in_logs(si, layers)
    every = [None if x is None else x / factor for x in (layer.of(si.symbol) for layer in layers)]
    tails = [0.5 - CENTRAL / 2, 0.5 + CENTRAL / 2]
    found = np.array([np.quantile(x, tails) for x in every if x is not None])
    low, high = float(found[:, 0].min()), float(found[:, 1].max())
    low, high = style.reaching(low, high, row.agreed, REACH, log=log)
    scale = style.scale(low, high, log=log, margin=0.06)
    inside = row.agreed is not None and scale.side(row.agreed) == 0
    return _Column(
        row=row,
        scale=scale,
        draws=tuple(None if x is None else scale(x) for x in every),
        ends=tuple(_ends(layer, si, own, scale) for layer in layers),
        nominal=float(scale(row.agreed)) if inside and row.agreed is not None else None,
    )


def _ends(layer: Layer, si: Row, own: OwnUnits, scale: style.Scale) -> tuple[float, float]:
    """Of the prior, on the axis."""
    prior = layer.problem.posterior.space.priors.get(si.symbol.name)
    if prior is None:
        return -math.inf, math.inf
    low, high = scale(np.array([prior.low, prior.high]) / own.factor(si.symbol.name))
    return float(low), float(high)


def _page(n: int, lines: int) -> tuple[Figure, NDArray[np.object_]]:
    """`(n, n)` panels, those above the diagonal empty; few of them have their legend beside them."""
    panel = min(PANEL_LARGEST, max(PANEL_SMALLEST, PANELS_WIDTH / n))
    size = panel * (n + GAP * (n - 1))
    beside = LEGEND_WIDTH if n == 1 else max(0.0, LEGEND_WIDTH - (n - 1) * panel)
    above = max(0.0, lines * LEGEND_LINE - (n - 1) * panel) if n > 1 else 0.0
    width, height = LEFT + size + RIGHT + beside, BOTTOM + size + TOP + above
    figure = Figure(figsize=(width, height))
    panels = figure.subplots(n, n, squeeze=False)
    for empty in panels[np.triu_indices(n, 1)]:
        empty.set_axis_off()
    figure.subplots_adjust(
        left=LEFT / width,
        right=(LEFT + size) / width,
        bottom=BOTTOM / height,
        top=(BOTTOM + size) / height,
        wspace=GAP,
        hspace=GAP,
    )
    return figure, panels


def _histograms(panel: Axes, column: _Column) -> None:
    """Each as high as its panel: a narrow posterior would dwarf a wide one."""
    for x, ends, look in zip(column.draws, column.ends, LOOKS, strict=False):
        if x is None:
            continue
        first, last = max(float(x.min()), ends[0]), min(float(x.max()), ends[1])
        share = max((last - first) / (column.scale.high - column.scale.low), UNSEEN)
        edges = np.linspace(first, last, max(12, round(BINS * share)) + 1)
        counts, _ = np.histogram(x, edges)
        panel.stairs(counts / counts.max(), edges, **look.line)
    if column.nominal is not None:
        panel.axvline(column.nominal, **style.NOMINAL)
    panel.set_ylim(0, 1.1)
    panel.set_yticks([])


def _contours(panel: Axes, column: _Column, row: _Column) -> None:
    pairs = zip(column.draws, row.draws, column.ends, row.ends, LOOKS, strict=False)
    for x, y, one, other, look in pairs:
        if x is not None and y is not None:
            contours(panel, (x, y), (one, other), lines=look.contour)
    if column.nominal is not None:
        panel.axvline(column.nominal, **style.NOMINAL)
    if row.nominal is not None:
        panel.axhline(row.nominal, **style.NOMINAL)


def _arrange(figure: Figure, panels: NDArray[np.object_], columns: Sequence[_Column]) -> None:
    n = len(columns)
    for i in range(n):
        for j in range(i + 1):
            panels[i, j].set_xlim(columns[j].scale.low, columns[j].scale.high)
            _numbers(panels[i, j].xaxis, columns[j], outer=i == n - 1)
            if i > j:
                panels[i, j].set_ylim(columns[i].scale.low, columns[i].scale.high)
                _numbers(panels[i, j].yaxis, columns[i], outer=j == 0)
    figure.align_xlabels(list(panels[-1]))
    figure.align_ylabels(list(panels[1:, 0]))


def _numbers(axis: Axis, column: _Column, *, outer: bool) -> None:
    style.set_numbers(axis, column.scale, 3, clear=0.1, letter=0.055)
    if not outer:
        axis.set_major_formatter(NullFormatter())
    else:
        axis.set_tick_params(labelsize=TICK_SIZE, pad=4)
        for text in axis.get_ticklabels():
            text.set(rotation=45, ha="right", va="center_baseline", rotation_mode="anchor")
        axis.set_label_text(column.scale.label(column.row.symbol, "\n"), fontsize=LABEL_SIZE)
        axis.labelpad = 2


def _legend(figure: Figure, layers: Sequence[Layer], columns: Sequence[_Column]) -> None:
    width, height = figure.get_size_inches()
    said: list[Any] = handles(layers, marked=False)
    if any(column.nominal is not None for column in columns):
        said.append(Line2D([], [], label="nominal value", **style.NOMINAL))
    notes = []
    if len(columns) > 1:
        one, two = (f"{100 * level:.1f} %" for level in LEVELS)
        notes = [
            f"contours: {one} and {two} of the draws of a run;",
            "none where the density is flat",
        ]
    notes.append("histograms: each as high as its panel")
    said += [Line2D([], [], linestyle="none", label=note) for note in notes]
    figure.legend(
        handles=said,
        loc="upper right",
        bbox_to_anchor=(1 - 0.5 * RIGHT / width, 1 - 0.5 * TOP / height),
        fontsize=8.0 if len(columns) < 5 else 12.0,
        borderaxespad=0.0,
        handlelength=2.6,
    )
