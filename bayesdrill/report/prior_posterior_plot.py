"""Each unknown before and after the record: the prior's density and the posterior's histogram."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from bayesdrill.basics.symbols import Symbol
from bayesdrill.inference.priors import Prior, flat_in_logs
from bayesdrill.report import style
from bayesdrill.report.pages import Page

Array = NDArray[np.float64]

PAGE = Page(
    columns=3,
    width=style.DOUBLE,
    row=1.05,
    left=0.14,
    right=0.14,
    gap_x=0.2,
    gap_y=0.56,
    top=0.36,
    bottom=0.5,
)
SMALL = dataclasses.replace(
    PAGE, columns=2, width=style.SINGLE, row=0.66, gap_x=0.16, gap_y=0.43, top=0.42, bottom=0.44
)
TAIL = 0.001  # of a prior without an end: where its axis ends
BINS = 60
HEAD = 1.12  # of the highest density: where a panel ends


def prior_posterior_figure(
    draws: Array,
    symbols: Sequence[Symbol],
    priors: Mapping[str, Prior],
    nominal: Mapping[str, float],
    mode: Mapping[str, float],
    width: float = style.DOUBLE,
) -> Figure:
    """Of draws `(N, D)` in the units of the symbols, over the range of each prior.

    The axis is logarithmic where a prior is flat in the log.
    """
    page = PAGE if width >= style.DOUBLE and len(symbols) > 1 else SMALL
    with style.styled(page.width):
        figure, panels = page.build(len(symbols))
        sides = set()
        for panel, x, symbol in zip(panels, draws.T, symbols, strict=True):
            scale = _scale(priors[symbol.name], x)
            known = nominal.get(symbol.name)
            _densities(panel, scale, x, priors[symbol.name])
            _values(panel, scale, known, mode.get(symbol.name))
            _frame(panel, scale, symbol)
            if known is not None:
                sides.add(scale.side(known))
        _legend(figure, sides, page)
    return figure


def _scale(prior: Prior, x: Array) -> style.Scale:
    """All of a prior that has ends; nearly all of one that has none, and of the draws."""
    low, high = (float(q) for q in prior.quantile(np.array([TAIL, 1 - TAIL])))
    low = prior.low if math.isfinite(prior.low) and prior.low > 0 else min(low, float(x.min()))
    high = prior.high if math.isfinite(prior.high) else max(high, float(x.max()))
    return style.scale(low, high, log=flat_in_logs(prior), margin=0.04)


def _densities(panel: Axes, scale: style.Scale, x: Array, prior: Prior) -> None:
    """The posterior fills its panel; of a prior that it dwarfs the line lies low."""
    u = scale(x)
    near, far = float(u.min()), float(u.max())
    across = min(float(BINS), 2.2 * math.cbrt(len(x)))
    edges = np.linspace(near, far, max(2, round(across)))
    heights, edges = np.histogram(u, edges, density=True)
    panel.stairs(heights, edges, fill=True, color=style.LIGHT, zorder=1)
    panel.stairs(heights, edges, color=style.BLACK, linewidth=0.7, zorder=2)
    places = np.linspace(scale.low, scale.high, 801)
    density = scale.density(prior, places)
    panel.plot(places, density, zorder=3, **{**style.PRIOR_LINE, "color": style.DARK})
    sure = density[np.isfinite(density)]
    # A density may grow without bound towards zero; the panel ends at what nearly all of it is below.
    top = max(float(heights.max()), float(np.quantile(sure, 0.99)))
    panel.set_ylim(0, HEAD * top)


def _values(panel: Axes, scale: style.Scale, nominal: float | None, mode: float | None) -> None:
    side = scale.side(nominal)
    if nominal is not None and side == 0:
        panel.axvline(float(scale(nominal)), zorder=4, **style.NOMINAL)
    if side:
        place, marker = (0.96, ">") if side > 0 else (0.04, "<")
        panel.plot([place], [0.5], transform=panel.transAxes, marker=marker, **style.AWAY)
    if mode is not None:
        panel.axvline(float(scale(mode)), zorder=4, **style.MAP_LINE)


def _frame(panel: Axes, scale: style.Scale, symbol: Symbol) -> None:
    panel.set_xlim(scale.low, scale.high)
    style.set_numbers(panel.xaxis, scale, 4)
    style.set_ticks(panel.yaxis, np.array([]), None)
    panel.set_xlabel(scale.label(symbol), labelpad=2)


def _legend(figure: Figure, sides: set[int], page: Page) -> None:
    handles: list[Line2D | Patch] = [
        Line2D([], [], label="prior", **{**style.PRIOR_LINE, "color": style.DARK}),
        Patch(facecolor=style.LIGHT, edgecolor=style.BLACK, linewidth=0.7, label="posterior"),
        *style.nominal_handles(sides),
        Line2D([], [], label="MAP", **style.MAP_LINE),
    ]
    figure.legend(
        handles=handles,
        loc="upper center",
        ncols=len(handles) if page is PAGE or len(handles) <= 4 else 3,
        borderaxespad=0.3,
        handlelength=2.4,
        columnspacing=1.6 if page is PAGE else 1.2,
        labelspacing=0.3,
    )
