"""Whether the ensembles see the same: ranks of the draws of each among those of all, against chance."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from bayesdrill.basics.symbols import Symbol
from bayesdrill.insight.ensemble_ranks import FALSE_ALARM, SHARES, Ranks
from bayesdrill.report import style
from bayesdrill.report.pages import Page, legend_above
from bayesdrill.report.trace_plot import ensemble_line

PAGE = Page(
    columns=3,
    width=style.DOUBLE,
    row=1.15,
    left=0.58,
    right=0.12,
    gap_x=0.12,
    gap_y=0.12,
    top=0.52,
    bottom=0.42,
)
NAMES = 1.7  # of the farthest line: where a panel ends, above which its name stands
BAND: dict[str, Any] = {"facecolor": style.FAINT, "edgecolor": style.MIDDLE, "linewidth": 0.5}
OUTSIDE: dict[str, Any] = {"color": style.MAP_COLOUR, "linewidth": 1.8}
PLACES = np.concatenate([[0.0], SHARES, [1.0]])


def rank_figure(
    ranks: Sequence[Ranks], symbols: Sequence[Symbol], width: float = style.DOUBLE
) -> Figure:
    """How many more of an ensemble's draws than expected are below each share of all, in per cent."""
    most = 100 * max(max(np.abs(one.away).max(), one.room.max()) / one.draws for one in ranks)
    wide = width >= style.DOUBLE
    with style.styled(width):
        handles = _handles(ranks)
        page = PAGE if wide else PAGE.narrow(width, 2, math.ceil(len(handles) / 2))
        figure, panels = page.build(len(ranks))
        for k, (panel, one, symbol) in enumerate(zip(panels, ranks, symbols, strict=True)):
            _lines(panel, one)
            _frame(panel, symbol, float(most), (k, len(ranks), page.columns))
        legend_above(figure, handles, 5 if wide else 2)
    return figure


def _lines(panel: Axes, one: Ranks) -> None:
    room = np.concatenate([[0.0], 100 * one.room / one.draws, [0.0]])
    panel.fill_between(PLACES, -room, room, zorder=0, **BAND)
    panel.axhline(0.0, color=style.MIDDLE, linewidth=0.5, zorder=1)
    for k, (away, holds) in enumerate(zip(one.away, one.holds, strict=True)):
        look = ensemble_line(k) | {"linewidth": 0.8} | ({} if holds else OUTSIDE)
        line = np.concatenate([[0.0], 100 * away / one.draws, [0.0]])
        panel.plot(PLACES, line, zorder=2 if holds else 3, **look)


def _frame(panel: Axes, symbol: Symbol, most: float, place: tuple[int, int, int]) -> None:
    """`place`: which panel, of how many, in how many columns."""
    k, n, columns = place
    columns = min(n, columns)
    panel.set_xlim(0, 1)
    panel.set_ylim(-1.12 * most, NAMES * most)
    style.set_ticks(panel.xaxis, np.array([0.0, 0.5, 1.0]), ["0", "0.5", "1"])
    style.set_ticks(panel.yaxis, *style.ticks(-1.12 * most, 1.12 * most, 5))
    panel.tick_params(labelleft=k % columns == 0, labelbottom=k + columns >= n)
    panel.text(0.03, 0.94, f"${symbol.latex}$", transform=panel.transAxes, va="top")
    if k + columns >= n:
        panel.set_xlabel("rank, as a share", labelpad=2)
    if k % columns == 0:
        panel.set_ylabel("ECDF difference [%]")


def _handles(ranks: Sequence[Ranks]) -> list[Any]:
    holds = np.array([one.holds for one in ranks])  # (D, E)
    handles: list[Any] = [
        Line2D([], [], label=f"ensemble {k + 1}", **ensemble_line(k) | {"linewidth": 0.8})
        for k in range(holds.shape[1])
    ]
    chance = f"{100 * (1 - FALSE_ALARM):g} % of chance, together"
    handles.append(Patch(label=chance, **BAND))
    if not holds.all():
        handles.append(Line2D([], [], label="leaves the band", **OUTSIDE))
    return handles
