"""Several runs in one corner and as rows of intervals, each run in a look of its own."""

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

from bayesdrill.analysis.comparison import Layer, Place, Row
from bayesdrill.inference.derived import HDI_PROBABILITY
from bayesdrill.inference.display_units import OwnUnits
from bayesdrill.report import scales, style
from bayesdrill.report.pages import LEVELS, Page, contours
from bayesdrill.report.sections.comparison_words import (
    elided,
    in_logs,
    overlay_shown,
    overlay_warnings,
)

LONGEST = 48  # letters of a name in a legend


@dataclass(frozen=True, slots=True)
class Look:
    """Colours that print as different greys."""

    color: str
    linestyle: Any
    marker: str
    linewidth: float = 1.0

    @property
    def line(self) -> dict[str, Any]:
        return {"color": self.color, "linestyle": self.linestyle, "linewidth": self.linewidth}

    @property
    def contour(self) -> dict[str, Any]:
        own = {"colors": self.color, "linestyles": [self.linestyle]}
        return {**own, "linewidths": 0.9 * self.linewidth}


# Thin and thick, dark and light in turn; none has the dashes of a nominal value.
LOOKS = (
    Look("0.0", "-", "o", 0.9),
    Look("#e0832b", "-", "s", 1.7),
    Look("#1d6b58", (0, (6, 1, 1, 1)), "^", 1.1),
    Look("#7b4fb0", (0, (1, 1)), "D", 1.5),
    Look("0.72", "-", "v", 2.2),
    Look("#6b3d1e", (0, (10, 2)), "P"),
)


def run_handles(layers: Sequence[Layer], *, marked: bool) -> list[Line2D]:
    """For a legend: the name of each run, with its warning."""
    return [
        Line2D([], [], label=legend_name(layer), marker=look.marker if marked else "", **look.line)
        for layer, look in zip(layers, LOOKS, strict=False)
    ]


def legend_name(layer: Layer) -> str:
    return elided(overlay_warnings(layer), LONGEST).replace("$", r"\$")


Array = NDArray[np.float64]

CENTRAL = 0.998  # of the draws of each run, inside an axis
CORNER_REACH = 0.5  # the axis grows by this share of its width at most to show the nominal value
BINS = 40  # across an axis
UNSEEN = 0.02  # of an axis that a run fills less of, its histogram would be a spike

# Inches; a corner of nine is printed at two thirds of its size.
PANEL_LARGEST, PANEL_SMALLEST, PANELS_WIDTH = 2.0, 1.03, 9.3
LEFT, BOTTOM, TOP, RIGHT = 0.88, 0.88, 0.2, 0.15
LEGEND_WIDTH, CORNER_LEGEND_LINE = 3.0, 0.21
GAP = 0.06
TICK_SIZE, LABEL_SIZE = 8.5, 10.0


@dataclass(frozen=True, slots=True)
class _Column:
    """An unknown on the axis that all runs share; `draws` of each run, None where it has none."""

    row: Row
    scale: scales.Scale
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
        figure, panels = _corner_page(n, len(layers) + 4)
        for i, row in enumerate(columns):
            _histograms(panels[i, i], row)
            for j, column in enumerate(columns[:i]):
                _contours(panels[i, j], column, row)
        _arrange(figure, panels, columns)
        _legend(figure, layers, columns)
    return figure


def _column(si: Row, layers: Sequence[Layer], own: OwnUnits) -> _Column:
    row, factor, log = overlay_shown(si, own), own.factor(si.symbol.name), in_logs(si, layers)
    every = [None if x is None else x / factor for x in (layer.of(si.symbol) for layer in layers)]
    tails = [0.5 - CENTRAL / 2, 0.5 + CENTRAL / 2]
    found = np.array([np.quantile(x, tails) for x in every if x is not None])
    low, high = float(found[:, 0].min()), float(found[:, 1].max())
    low, high = scales.reaching(low, high, row.agreed, CORNER_REACH, log=log)
    scale = scales.scale(low, high, log=log, margin=0.06)
    inside = row.agreed is not None and scale.side(row.agreed) == 0
    return _Column(
        row=row,
        scale=scale,
        draws=tuple(None if x is None else scale(x) for x in every),
        ends=tuple(_ends(layer, si, own, scale) for layer in layers),
        nominal=float(scale(row.agreed)) if inside and row.agreed is not None else None,
    )


def _ends(layer: Layer, si: Row, own: OwnUnits, scale: scales.Scale) -> tuple[float, float]:
    """Of the prior, on the axis."""
    prior = layer.problem.posterior.space.priors.get(si.symbol.name)
    if prior is None:
        return -math.inf, math.inf
    low, high = scale(np.array([prior.low, prior.high]) / own.factor(si.symbol.name))
    return float(low), float(high)


def _corner_page(n: int, lines: int) -> tuple[Figure, NDArray[np.object_]]:
    """`(n, n)` panels, those above the diagonal empty; few of them have their legend beside them."""
    panel = min(PANEL_LARGEST, max(PANEL_SMALLEST, PANELS_WIDTH / n))
    size = panel * (n + GAP * (n - 1))
    beside = LEGEND_WIDTH if n == 1 else max(0.0, LEGEND_WIDTH - (n - 1) * panel)
    above = max(0.0, lines * CORNER_LEGEND_LINE - (n - 1) * panel) if n > 1 else 0.0
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
    said: list[Any] = run_handles(layers, marked=False)
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


COLUMNS = 3
ROW, FRAME = 0.17, 0.2  # inches of a run and of the margins of a panel
HANDLE, LETTER = 0.55, 0.062  # of a legend: inches of a handle with its gaps, and of a letter
INTERVALS_LEGEND_LINE, LEGEND_MARGIN = 0.17, 0.2
INTERVALS_REACH = 1.0  # how far an axis may grow for the nominal value, in widths
BAR: dict[str, Any] = {"linewidth": 1.2, "marker": "|", "markersize": 5}
HELD: dict[str, Any] = {"marker": "x", "markersize": 5, "markeredgewidth": 1.2}
CREDIBLE = f"{100 * HDI_PROBABILITY:.0f} %"


def intervals_figure(layers: Sequence[Layer], rows: Sequence[Row], own: OwnUnits) -> Figure:
    """Of all unknowns of any run, `rows` in SI; a run that has not got one leaves a gap.

    Axes are logarithmic where the prior of the first run is flat in the log.
    """
    logs = [in_logs(row, layers) for row in rows]
    rows = [overlay_shown(row, own) for row in rows]
    with style.styled():
        scales = [_scale(row, log=log) for row, log in zip(rows, logs, strict=True)]
        said = _handles(layers, rows, scales)
        columns = _legend_columns(said)
        lines = -(-len(said) // columns)
        figure, panels = _intervals_page(len(layers), lines).build(len(rows))
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


def _intervals_page(n_runs: int, lines: int) -> Page:
    return Page(
        columns=COLUMNS,
        width=scales.DOUBLE,
        row=FRAME + n_runs * ROW,
        left=0.14,
        right=0.14,
        gap_x=0.2,
        gap_y=0.56,
        top=LEGEND_MARGIN + INTERVALS_LEGEND_LINE * lines,
        bottom=0.5,
    )


def _draw(panel: Axes, row: Row, scale: scales.Scale) -> None:
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


def _scale(row: Row, *, log: bool) -> scales.Scale:
    """All intervals, what is held, and the nominal value if it is not too far."""
    found = [place for place in row.places if place is not None]
    low, high = min(place.low for place in found), max(place.high for place in found)
    low, high = scales.reaching(low, high, row.agreed, INTERVALS_REACH, log=log)
    return scales.scale(low, high, log=log, margin=0.08)


def _away(panel: Axes, scale: scales.Scale, nominal: float | None) -> None:
    side = scale.side(nominal)
    if side:
        place, marker = (0.97, ">") if side > 0 else (0.03, "<")
        panel.plot([place], [0.5], transform=panel.transAxes, marker=marker, **style.AWAY)


def _handles(
    layers: Sequence[Layer], rows: Sequence[Row], scales: Sequence[scales.Scale]
) -> list[Line2D]:
    said = run_handles(layers, marked=True)
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
    return max(1, min(len(said), 4, int(scales.DOUBLE / (HANDLE + LETTER * longest))))
