"""The figure of the paper's Table 3: what the heuristic finds, and what the record can tell."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from bayesdrill.basics import PARAMETERS, own_symbol
from bayesdrill.insight import HDI_PROBABILITY, hdi
from bayesdrill.paper.pages.search_plots import LEFT, RIGHT
from bayesdrill.report import set_factors, style

Array = NDArray[np.float64]
Look = Mapping[str, Any]

LINE, FOOT = 0.34, 0.42  # inches
KEY, COLUMNS = 0.165, 3  # height of a row of the legend, and its columns
UP, DOWN = -0.13, 0.22  # rows: the posterior, and below it the heuristic
MIDDLE = (0.25, 0.75)  # quantiles: the thick bar
THIN: Look = {"color": style.DARK, "linewidth": 1.1, "solid_capstyle": "butt"}
THICK: Look = {"color": style.DARK, "linewidth": 4.0, "solid_capstyle": "butt"}
ESTIMATE: Look = {
    "color": style.MAP_COLOUR,
    "marker": "D",
    "markersize": 4.5,
    "linestyle": "none",
    "zorder": 4,
}
OTHERS: Look = {
    "color": style.MAP_COLOUR,
    "marker": "o",
    "markersize": 2.4,
    "markeredgewidth": 0,
    "alpha": 0.4,
    "linestyle": "none",
    "zorder": 3,
}
LEGEND: Look = {"loc": "upper center", "borderaxespad": 0.3, "labelspacing": 0.3}
GUESS: Look = {"color": style.MIDDLE, "linestyle": (0, (4, 2)), "linewidth": 0.8, "zorder": 0}
TICK: Look = {
    "color": style.NOMINAL["color"],
    "marker": "|",
    "markersize": 17,
    "markeredgewidth": 1.6,
    "linestyle": "none",
    "zorder": 5,
}
PAPER: Look = {
    "color": style.BLACK,
    "marker": "x",
    "markersize": 5.5,
    "markeredgewidth": 1.2,
    "linestyle": "none",
    "zorder": 6,
}


def table_3_figure(
    names: Sequence[str],
    guess: Array,
    estimate: Array,
    others: Array,
    truth: Array | None,
    draws: Array,
    paper: Array,
) -> Figure:
    """A row for each of `names`, over its guess: posterior above, the heuristic's estimates below.

    SI: guess, estimate and truth `(D,)`, others `(S, D)`, draws `(N, D)`; `paper (D,)`: what it
    prints, NaN where it has nothing, not drawn if it is the truth itself.
    """
    n = len(names)
    printed = np.isfinite(paper)
    other = bool(printed.any()) and (
        truth is None or not np.allclose(paper[printed], truth[printed])
    )
    keys = _keys(truth=truth is not None, others=len(others) > 0, paper=other)
    head = 0.13 + KEY * math.ceil(len(keys) / COLUMNS)
    width, height = style.DOUBLE * 0.72, head + n * LINE + FOOT
    ratios = draws / guess
    with style.styled():
        figure = Figure(figsize=(width, height))
        inside = (width - LEFT - RIGHT) / width
        panel = figure.add_axes((LEFT / width, FOOT / height, inside, n * LINE / height))
        ends: list[float] = []
        for row in range(n):
            whole = np.exp(hdi(np.log(ratios[:, row])))
            for interval, look in ((whole, THIN), (np.quantile(ratios[:, row], MIDDLE), THICK)):
                panel.plot(interval, [row + UP] * 2, **look)
            ends += whole.tolist()
            if row:
                panel.axhline(row - 0.5, color=style.FAINT, linewidth=0.6, zorder=-1)
        rows = np.arange(n)
        starts = (others / guess).reshape(-1, n)
        for start in starts:
            panel.plot(start, rows + DOWN, **OTHERS)
        panel.plot(estimate / guess, rows + DOWN, **ESTIMATE)
        shown = [np.array(ends), starts.ravel(), estimate / guess]
        if truth is not None:
            panel.plot(truth / guess, rows + 0.04, **TICK)
            shown.append(truth / guess)
        if other:
            panel.plot(paper / guess, rows + 0.04, **PAPER)
            shown.append((paper / guess)[printed])
        panel.axvline(1.0, **GUESS)
        set_factors(panel.xaxis, np.concatenate(shown))
        panel.set_yticks(rows, [f"${_latex(name)}$" for name in names])
        panel.tick_params(axis="y", length=0)
        panel.set_ylim(n - 0.5, -0.5)
        panel.set_xlabel("value over initial guess")
        figure.legend(handles=keys, ncols=COLUMNS, **LEGEND)
    return figure


def _keys(*, truth: bool, others: bool, paper: bool) -> list[Line2D]:
    percent = f"{100 * HDI_PROBABILITY:.0f}"
    handles = [
        Line2D([], [], label="posterior, middle half", **THICK),
        Line2D([], [], label=f"posterior, {percent} % HDI", **THIN),
        Line2D([], [], label="heuristic", **ESTIMATE),
    ]
    if others:
        handles.append(Line2D([], [], label="heuristic, other starts", **OTHERS))
    handles.append(Line2D([], [], label="initial guess", **GUESS))
    if paper:
        handles.append(Line2D([], [], label="the paper's estimate", **PAPER))
    if truth:
        handles.append(Line2D([], [], label="truth", **{**TICK, "markersize": 9}))
    return handles


def _latex(name: str) -> str:
    """Of a parameter, or of a noise level."""
    return PARAMETERS[name].latex if name in PARAMETERS else own_symbol(name, "", None, "").latex
