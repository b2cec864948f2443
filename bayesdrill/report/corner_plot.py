"""The joint posterior: all marginals of one and of two unknowns."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from bayesdrill.basics.symbols import Symbol
from bayesdrill.inference.priors import Prior
from bayesdrill.insight.diagnostics import HDI_PROBABILITY, hdi
from bayesdrill.report import style
from bayesdrill.report.contours import BINS, CENTRAL, INNER, LEVELS, OUTER, central, contours

Array = NDArray[np.float64]


POINTS = 2000  # drawn in a panel; contours and histograms count all draws
REACH = 1.0  # the axis grows by this share of its width at most to show the nominal value

# The page, in inches and points; a corner of nine is printed at two thirds of its size.
PANEL_LARGEST, PANEL_SMALLEST, PANELS_WIDTH = 2.2, 1.03, 9.3
LEFT, BOTTOM, TOP, RIGHT = 0.88, 0.88, 0.38, 0.22
LEGEND_WIDTH = 1.9
GAP = 0.06  # between panels, in panels
TICK_SIZE, LABEL_SIZE = 8.5, 10.0
CLEAR, LETTER = 0.1, 0.055  # of an axis: without ticks at its ends, needed by a letter of a tick


@dataclass(frozen=True, slots=True)
class Column:
    """One unknown on its axis; all but `scale` are numbers on this axis, `x` is `(N,)`."""

    symbol: Symbol
    scale: style.Scale
    x: Array
    interval: tuple[float, float]
    nominal: float | None  # None also where it is beyond the axis, ...
    away: int  # ... -1 below and 1 above it
    mode: float | None
    prior: tuple[Array, Array] | None  # places and densities
    ends: tuple[float, float]  # of the prior, or infinite


def corner_figure(
    draws: Array,
    symbols: Sequence[Symbol],
    nominal: Mapping[str, float],
    mode: Mapping[str, float],
    priors: Mapping[str, Prior],
) -> Figure:
    """A D by D corner of SI draws `(N, D)`; nominal values and priors may miss some symbols."""
    columns = [
        _column(x, symbol, nominal.get(symbol.name), mode.get(symbol.name), priors.get(symbol.name))
        for x, symbol in zip(draws.T, symbols, strict=True)
    ]
    with style.styled():
        size = _panels_size(len(columns))
        extra = LEGEND_WIDTH if len(columns) == 1 else 0.0
        figure = Figure(figsize=(LEFT + size + RIGHT + extra, BOTTOM + size + TOP))
        panels = _panels(figure, len(columns))
        for i, row in enumerate(columns):
            _histogram(panels[i, i], row)
            _marginal(panels[i, i], row, len(draws))
            for j, column in enumerate(columns[:i]):
                contours(panels[i, j], (column.x, row.x), (column.ends, row.ends))
                _marks(panels[i, j], column, row)
        _arrange(figure, panels, columns)
        _points(figure, panels, columns)
        _legend(figure, columns)
    return figure


def _column(
    x: Array, symbol: Symbol, nominal: float | None, mode: float | None, prior: Prior | None
) -> Column:
    low, high = _ends(x, nominal, mode)
    scale = style.scale(low, high)
    density, ends = None, (-math.inf, math.inf)
    if prior is not None:
        ends = (float(scale(np.array(prior.low))), float(scale(np.array(prior.high))))
        places = np.linspace(low, high, 401)
        density = (scale(places), np.exp(prior.logpdf(places)) * 10.0**scale.power)
    near, far = (float(end) for end in scale(np.array(hdi(x))))
    away = scale.side(nominal)
    return Column(
        symbol=symbol,
        scale=scale,
        x=scale(x),
        interval=(near, far),
        nominal=None if nominal is None or away else float(scale(nominal)),
        away=away,
        mode=None if mode is None else float(scale(mode)),
        prior=density,
        ends=ends,
    )


def _ends(x: Array, nominal: float | None, mode: float | None) -> tuple[float, float]:
    """The axis, SI: nearly all draws, the mode, and the nominal value if it is not too far."""
    low, high = (float(q) for q in np.quantile(x, [0.5 - CENTRAL / 2, 0.5 + CENTRAL / 2]))
    low, high = style.reaching(low, high, mode)
    low, high = style.reaching(low, high, nominal, REACH)
    margin = 0.06 * (high - low) or 1e-9 * abs(low)
    return low - margin, high + margin


def _panels_size(n: int) -> float:
    """Inches that the n panels take, gaps included."""
    panel = min(PANEL_LARGEST, max(PANEL_SMALLEST, PANELS_WIDTH / n))
    return panel * (n + GAP * (n - 1))


def _panels(figure: Figure, n: int) -> NDArray[np.object_]:
    """`(n, n)`; those above the diagonal stay empty."""
    panels = figure.subplots(n, n, squeeze=False)
    for above in panels[np.triu_indices(n, 1)]:
        above.set_axis_off()
    return panels


def _histogram(panel: Axes, column: Column) -> None:
    """Of all draws, with bins that end where the prior does."""
    edges = _edges(column)
    counts, _ = np.histogram(column.x, edges)
    panel.stairs(counts, edges, color=style.BLACK, linewidth=0.8)
    panel.set_ylim(0, 1.1 * max(1.0, float(counts.max())))
    panel.set_yticks([])


def _points(figure: Figure, panels: NDArray[np.object_], columns: Sequence[Column]) -> None:
    """Some draws below all panels, as one artist: each rasterised one costs a page of pixels."""
    kept = style.thin(len(columns[0].x), POINTS)
    places = []
    for i, j in itertools.combinations(range(len(columns)), 2):
        panel = panels[j, i]
        panel.patch.set_visible(False)
        inside = np.stack([columns[k].scale.share(columns[k].x[kept]) for k in (i, j)], axis=-1)
        inside = inside[np.all((inside > 0) & (inside < 1), axis=-1)]
        box = panel.get_position()
        places.append(box.p0 + inside * box.size)
    if places:
        x, y = np.concatenate(places).T
        figure.add_artist(Line2D(x, y, transform=figure.transFigure, **style.DOTS))


def _edges(column: Column) -> Array:
    """Of bins, as many as give `BINS`, or fewer for few draws, across the draws."""
    low, high = central(column.x)
    across = min(float(BINS), 2.2 * math.cbrt(len(column.x)))
    first = max(column.scale.low, column.ends[0])
    last = min(column.scale.high, column.ends[1])
    n = round(across * (last - first) / (high - low))
    return np.linspace(first, last, max(1, min(n, 4 * BINS)) + 1)


def _marginal(panel: Axes, column: Column, n_draws: int) -> None:
    """Interval, prior on the scale of the histogram, nominal value and mode; the title."""
    panel.axvspan(*column.interval, color=style.FAINT, zorder=-2, linewidth=0)
    top = panel.get_ylim()[1]
    if column.prior is not None:
        places, density = column.prior
        bin_width = float(np.diff(_edges(column)[:2])[0])
        height = density * n_draws * bin_width
        panel.plot(places, height, **style.PRIOR_LINE)
        top = max(top, 1.1 * float(height.max()))
    panel.set_ylim(0, top)
    if column.nominal is not None:
        panel.axvline(column.nominal, **style.NOMINAL)
    if column.away:
        place, marker = (0.95, ">") if column.away > 0 else (0.05, "<")
        panel.plot([place], [0.5], transform=panel.transAxes, marker=marker, **style.AWAY)
    if column.mode is not None:
        panel.axvline(column.mode, **style.MAP_LINE)
    panel.set_title(_title(column), fontsize=LABEL_SIZE, loc="left", pad=6)


def _title(column: Column) -> str:
    """Median and interval."""
    name = ("" if column.scale.origin == 0 else r"\delta ") + column.symbol.latex
    return f"${name} = {style.with_spread(float(np.median(column.x)), *column.interval)}$"


def _marks(panel: Axes, column: Column, row: Column) -> None:
    """Nominal values as lines and the mode as a cross."""
    if column.nominal is not None:
        panel.axvline(column.nominal, **style.NOMINAL)
    if row.nominal is not None:
        panel.axhline(row.nominal, **style.NOMINAL)
    if column.mode is not None and row.mode is not None:
        panel.plot([column.mode], [row.mode], **style.CROSS)


def _arrange(figure: Figure, panels: NDArray[np.object_], columns: Sequence[Column]) -> None:
    """Ticks in every panel, their texts and the labels at the left and at the bottom only."""
    n = len(columns)
    for i in range(n):
        for j in range(i + 1):
            panels[i, j].set_xlim(columns[j].scale.low, columns[j].scale.high)
            _numbers(panels[i, j].xaxis, columns[j], outer=i == n - 1)
            if i > j:
                panels[i, j].set_ylim(columns[i].scale.low, columns[i].scale.high)
                _numbers(panels[i, j].yaxis, columns[i], outer=j == 0)
    if n == 1:
        panels[0, 0].set_ylabel("density", fontsize=LABEL_SIZE)
    width, height = figure.get_size_inches()
    size = _panels_size(n)
    figure.subplots_adjust(
        left=LEFT / width,
        right=(LEFT + size) / width,
        bottom=BOTTOM / height,
        top=(BOTTOM + size) / height,
        wspace=GAP,
        hspace=GAP,
    )
    figure.align_xlabels(list(panels[-1]))
    figure.align_ylabels(list(panels[1:, 0]))


def _numbers(axis: Axis, column: Column, *, outer: bool) -> None:
    low, high = column.scale.low, column.scale.high
    places, texts = style.ticks(low, high, clear=CLEAR, letter=LETTER)
    style.set_ticks(axis, places, texts if outer else None)
    if outer:
        axis.set_tick_params(labelsize=TICK_SIZE, pad=4)
        for text in axis.get_ticklabels():
            text.set(rotation=45, ha="right", va="center_baseline", rotation_mode="anchor")
        label = column.scale.label(column.symbol, "\n")
        axis.set_label_text(label, fontsize=LABEL_SIZE)
        axis.labelpad = 2


def _legend(figure: Figure, columns: Sequence[Column]) -> None:
    """In the empty upper right, or beside a single panel."""
    width, height = figure.get_size_inches()
    figure.legend(
        handles=_handles(columns),
        loc="upper right",
        bbox_to_anchor=(1 - 0.5 * RIGHT / width, 1 - 0.5 * TOP / height),
        fontsize=8.0 if len(columns) < 4 else 12.0,
        borderaxespad=0.0,
        handlelength=2.2,
    )


def _handles(columns: Sequence[Column]) -> list[Line2D | Patch]:
    """Says what each line, shade and number is."""
    credible = f"{100 * HDI_PROBABILITY:.0f} %"
    handles: list[Line2D | Patch] = [
        Line2D([], [], color=style.BLACK, linewidth=0.8, label="posterior"),
        Patch(color=style.FAINT, label=f"narrowest {credible} interval"),
    ]
    if any(column.prior is not None for column in columns):
        handles.append(Line2D([], [], label="prior", **style.PRIOR_LINE))
    sides = {column.away for column in columns if column.nominal is not None or column.away}
    handles += style.nominal_handles(sides)
    if any(column.mode is not None for column in columns):
        both = {**style.CROSS, "linestyle": style.MAP_LINE["linestyle"]}
        handles.append(Line2D([], [], label="MAP", **both))
    if len(columns) > 1:
        for grey, level, sds in zip((INNER, OUTER), LEVELS, (1, 2), strict=True):
            text = rf"{100 * level:.1f} % of the draws (${sds}\sigma$ in two dimensions)"
            handles.append(Patch(facecolor=grey, edgecolor="black", linewidth=0.7, label=text))
    notes = [f"titles: median and {credible} interval"]
    if len(columns) > 1:
        notes.append("no contour where the density is flat")
    if any(column.scale.origin for column in columns):
        notes.append(r"$\delta$: the difference that the axis shows")
    return handles + [Line2D([], [], linestyle="none", label=note) for note in notes]
