"""The joint posterior: all marginals of one and of two unknowns."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, NullFormatter
from numpy.typing import NDArray

from bayesdrill.basics.symbols import Symbol
from bayesdrill.inference.priors import Prior, flat_in_logs
from bayesdrill.insight.diagnostics import hdi
from bayesdrill.report import round_numbers, style
from bayesdrill.report.contours import BINS, CENTRAL, central, contours
from bayesdrill.report.corner_legend import Handles, handles, legend
from bayesdrill.report.corner_page import GAP, CornerPage

Array = NDArray[np.float64]


POINTS = 2000  # drawn in a panel; contours and histograms count all draws
REACH = 1.0  # the axis grows by this share of its width at most to show the nominal value
CLEAR = 0.1  # of an axis, without ticks at its ends
SMALLEST = 5.2  # letters of ticks, points


@dataclass(frozen=True, slots=True)
class Column:
    """One unknown on its axis; what follows `title` are numbers on this axis, `x` is `(N,)`."""

    symbol: Symbol
    scale: style.Scale
    title: str
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
    width: float = style.DOUBLE,
) -> Figure:
    """A D by D corner of draws `(N, D)` in the units of the symbols, at most `width` inches wide.

    Nominal values and priors may miss some symbols.  An unknown whose prior is flat in its log has
    a logarithmic axis, and is counted there.
    """
    columns = [
        _column(x, symbol, nominal.get(symbol.name), mode.get(symbol.name), priors.get(symbol.name))
        for x, symbol in zip(draws.T, symbols, strict=True)
    ]
    with style.styled(width):
        first, second = _explained(columns)
        page = CornerPage.of(len(columns), width, len(first) + len(second))
        figure = Figure(figsize=(page.width, page.height))
        panels = _panels(figure, page)
        for i, row in enumerate(columns):
            _histogram(panels[i, i], row, page)
            _marginal(panels[i, i], row, len(draws), page)
            for j, column in enumerate(columns[:i]):
                contours(panels[i, j], (column.x, row.x), (column.ends, row.ends), page.fine)
                _marks(panels[i, j], column, row, page)
        _arrange(figure, panels, columns, page)
        _points(figure, panels, columns, page)
        legend(figure, first, second, page)
    return figure


def _column(
    x: Array, symbol: Symbol, nominal: float | None, mode: float | None, prior: Prior | None
) -> Column:
    scale = _scale(x, nominal, mode, log=flat_in_logs(prior))
    density, ends = None, (-math.inf, math.inf)
    if prior is not None:
        ends = (float(scale(np.array(prior.low))), float(scale(np.array(prior.high))))
        places = np.linspace(scale.low, scale.high, 401)
        density = (places, scale.density(prior, places))
    interval = np.array(hdi(x))
    near, far = (float(end) for end in scale(interval))
    away = scale.side(nominal)
    return Column(
        symbol=symbol,
        scale=scale,
        title=_title(symbol, scale, float(np.median(x)), interval),
        x=scale(x),
        interval=(near, far),
        nominal=None if nominal is None or away else float(scale(nominal)),
        away=away,
        mode=None if mode is None else float(scale(mode)),
        prior=density,
        ends=ends,
    )


def _scale(x: Array, nominal: float | None, mode: float | None, *, log: bool) -> style.Scale:
    """The axis: nearly all draws, the mode, and the nominal value if it is not too far."""
    low, high = (float(q) for q in np.quantile(x, [0.5 - CENTRAL / 2, 0.5 + CENTRAL / 2]))
    low, high = style.reaching(low, high, mode, log=log)
    low, high = style.reaching(low, high, nominal, REACH, log=log)
    return style.scale(low, high, log=log, margin=0.06)


def _title(symbol: Symbol, scale: style.Scale, median: float, interval: Array) -> str:
    """Median and interval, in the numbers of the axis."""
    name = ("" if scale.origin == 0 else r"\delta ") + symbol.latex
    middle, near, far = scale.number(np.array([median, *interval]))
    power = math.floor(math.log10(abs(middle))) if middle and not scale.origin else 0
    if not scale.log or -2 <= power <= 2:
        return f"${name} = {round_numbers.with_spread(middle, near, far)}$"
    spread = round_numbers.with_spread(*(x / 10.0**power for x in (middle, near, far)))
    return rf"${name} = ({spread})\,10^{{{power}}}$"


def _panels(figure: Figure, page: CornerPage) -> NDArray[np.object_]:
    """`(n, n)`; those above the diagonal stay empty."""
    n, width, height = page.n, page.width, page.height
    panels = figure.subplots(n, n, squeeze=False)
    for above in panels[np.triu_indices(n, 1)]:
        above.set_axis_off()
    for panel in panels[np.tril_indices(n)]:
        panel.tick_params(size=3.0 * page.fine, width=0.6 * page.fine)
        for spine in panel.spines.values():
            spine.set_linewidth(0.6 * page.fine)
    figure.subplots_adjust(
        left=page.left / width,
        right=(page.left + page.inside) / width,
        bottom=page.bottom / height,
        top=(page.bottom + page.inside) / height,
        wspace=GAP,
        hspace=GAP,
    )
    return panels


def _histogram(panel: Axes, column: Column, page: CornerPage) -> None:
    """Of all draws, with bins that end where the prior does."""
    edges = _edges(column)
    counts, _ = np.histogram(column.x, edges)
    panel.stairs(counts, edges, color=style.BLACK, linewidth=0.8 * page.fine)
    panel.set_ylim(0, 1.1 * max(1.0, float(counts.max())))
    panel.set_yticks([])


def _points(
    figure: Figure, panels: NDArray[np.object_], columns: Sequence[Column], page: CornerPage
) -> None:
    """Some draws below all panels, as one artist: each rasterised one costs a page of pixels."""
    kept = style.thin(len(columns[0].x), round(POINTS * page.fine**2))
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
        figure.add_artist(Line2D(x, y, transform=figure.transFigure, **_finer(style.DOTS, page)))


def _edges(column: Column) -> Array:
    """Of bins, as many as give `BINS`, or fewer for few draws, across the draws."""
    low, high = central(column.x)
    across = min(float(BINS), 2.2 * math.cbrt(len(column.x)))
    first = max(column.scale.low, column.ends[0])
    last = min(column.scale.high, column.ends[1])
    n = round(across * (last - first) / (high - low))
    return np.linspace(first, last, max(1, min(n, 4 * BINS)) + 1)


def _marginal(panel: Axes, column: Column, n_draws: int, page: CornerPage) -> None:
    """Interval, prior on the scale of the histogram, nominal value and mode; the title."""
    panel.axvspan(*column.interval, color=style.FAINT, zorder=-2, linewidth=0)
    top = panel.get_ylim()[1]
    if column.prior is not None:
        places, density = column.prior
        bin_width = float(np.diff(_edges(column)[:2])[0])
        height = density * n_draws * bin_width
        panel.plot(places, height, **_finer(style.PRIOR_LINE, page))
        top = max(top, 1.1 * float(height.max()))
    panel.set_ylim(0, top)
    if column.nominal is not None:
        panel.axvline(column.nominal, **_finer(style.NOMINAL, page))
    if column.away:
        place, marker = (0.95, ">") if column.away > 0 else (0.05, "<")
        look = _finer(style.AWAY, page)
        panel.plot([place], [0.5], transform=panel.transAxes, marker=marker, **look)
    if column.mode is not None:
        panel.axvline(column.mode, **_finer(style.MAP_LINE, page))
    panel.set_title(column.title, fontsize=page.letters, loc="left", pad=0.6 * page.letters - 1)


def _finer(look: Mapping[str, Any], page: CornerPage) -> dict[str, Any]:
    sizes = ("linewidth", "markersize", "markeredgewidth")
    return {**look, **{name: look[name] * page.fine for name in sizes if name in look}}


def _marks(panel: Axes, column: Column, row: Column, page: CornerPage) -> None:
    """Nominal values as lines and the mode as a cross."""
    nominal = _finer(style.NOMINAL, page)
    if column.nominal is not None:
        panel.axvline(column.nominal, **nominal)
    if row.nominal is not None:
        panel.axhline(row.nominal, **nominal)
    if column.mode is not None and row.mode is not None:
        panel.plot([column.mode], [row.mode], **_finer(style.CROSS, page))


def _arrange(
    figure: Figure, panels: NDArray[np.object_], columns: Sequence[Column], page: CornerPage
) -> None:
    """Ticks in every panel, their texts and the labels at the left and at the bottom only."""
    n = len(columns)
    for i in range(n):
        for j in range(i + 1):
            panel = panels[i, j]
            panel.set_xlim(columns[j].scale.low, columns[j].scale.high)
            _numbers(panel.xaxis, columns[j], page, outer=i == n - 1)
            if i > j:
                panel.set_ylim(columns[i].scale.low, columns[i].scale.high)
                _numbers(panel.yaxis, columns[i], page, outer=j == 0)
    if n == 1:
        panels[0, 0].set_ylabel("density", fontsize=page.letters)
    if page.compact:
        _upright(panels, columns, page)
        return
    figure.align_xlabels(list(panels[-1]))
    figure.align_ylabels(list(panels[1:, 0]))


def _numbers(axis: Axis, column: Column, page: CornerPage, *, outer: bool) -> None:
    places, texts = column.scale.ticks(clear=CLEAR, letter=page.letter)
    outer = outer and not page.compact
    style.set_ticks(axis, places, texts if outer else None)
    small = column.scale.between.tolist() if page.fine == 1.0 else []
    axis.set_minor_locator(FixedLocator(small))
    axis.set_minor_formatter(NullFormatter())
    if outer:
        axis.set_tick_params(labelsize=max(0.85 * page.letters, SMALLEST), pad=0.4 * page.letters)
        for text in axis.get_ticklabels():
            text.set(rotation=45, ha="right", va="center_baseline", rotation_mode="anchor")
        label = column.scale.label(column.symbol, "\n")
        axis.set_label_text(label, fontsize=page.letters)
        axis.labelpad = 0.2 * page.letters


def _upright(panels: NDArray[np.object_], columns: Sequence[Column], page: CornerPage) -> None:
    """Where panels are too small for ticks: the ends of each axis under its label."""
    for k, column in enumerate(columns):
        ends = [round_numbers.short(float(end)) for end in column.scale.shown_ends]
        text = f"{column.scale.label(column.symbol)}\n{ends[0]} to {ends[1]}"
        panels[-1, k].set_xlabel(
            text, fontsize=page.letters, rotation=90, va="top", linespacing=1.0, labelpad=2
        )
        if k:
            panels[k, 0].set_ylabel(
                f"${column.symbol.latex}$",
                fontsize=page.letters,
                rotation=0,
                ha="right",
                va="center",
                labelpad=2,
            )


def _explained(columns: Sequence[Column]) -> tuple[Handles, Handles]:
    return handles(
        sides={column.away for column in columns if column.nominal is not None or column.away},
        prior=any(column.prior is not None for column in columns),
        mode=any(column.mode is not None for column in columns),
        joint=len(columns) > 1,
        differences=any(column.scale.origin for column in columns),
    )
