"""Whether the ensembles see the same: ranks of the draws of each among those of all, against chance."""

from __future__ import annotations

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
from bayesdrill.report.pages import SMALL_PANELS, legend_above
from bayesdrill.report.trace_plot import ensemble_line

NAMES = 1.7  # of the farthest line: where a panel ends, above which its name stands
PLACES = np.concatenate([[0.0], SHARES, [1.0]])


def rank_figure(
    ranks: Sequence[Ranks], symbols: Sequence[Symbol], width: float = style.DOUBLE
) -> Figure:
    """How many more of an ensemble's draws than expected are below each share of all, in per cent."""
    most = 100 * max(max(np.abs(one.away).max(), one.room.max()) / one.draws for one in ranks)
    wide = width >= style.DOUBLE
    with style.styled(width):
        handles = _handles(ranks)
        page = SMALL_PANELS.fitting(width, len(handles))
        figure, panels = page.build(len(ranks))
        for k, (panel, one, symbol) in enumerate(zip(panels, ranks, symbols, strict=True)):
            _lines(panel, one)
            _axes(panel, symbol, float(most))
            page.frame(panel, k, len(ranks), "rank, as a share", "ECDF difference [%]")
        legend_above(figure, handles, 5 if wide else 2)
    return figure


def _lines(panel: Axes, one: Ranks) -> None:
    room = np.concatenate([[0.0], 100 * one.room / one.draws, [0.0]])
    panel.fill_between(PLACES, -room, room, zorder=0, **style.CHANCE)
    panel.axhline(0.0, color=style.MIDDLE, linewidth=0.5, zorder=1)
    for k, (away, holds) in enumerate(zip(one.away, one.holds, strict=True)):
        look = {**ensemble_line(k), "linewidth": 0.8, **({} if holds else style.OUTSIDE)}
        line = np.concatenate([[0.0], 100 * away / one.draws, [0.0]])
        panel.plot(PLACES, line, zorder=2 if holds else 3, **look)


def _axes(panel: Axes, symbol: Symbol, most: float) -> None:
    panel.set_xlim(0, 1)
    panel.set_ylim(-1.12 * most, NAMES * most)
    style.set_ticks(panel.xaxis, np.array([0.0, 0.5, 1.0]), ["0", "0.5", "1"])
    style.set_ticks(panel.yaxis, *style.ticks(-1.12 * most, 1.12 * most, 5))
    panel.text(0.03, 0.94, f"${symbol.latex}$", transform=panel.transAxes, va="top")


def _handles(ranks: Sequence[Ranks]) -> list[Any]:
    holds = np.array([one.holds for one in ranks])  # (D, E)
    handles: list[Any] = [
        Line2D([], [], label=f"ensemble {k + 1}", **ensemble_line(k) | {"linewidth": 0.8})
        for k in range(holds.shape[1])
    ]
    chance = f"{100 * (1 - FALSE_ALARM):g} % of chance, together"
    handles.append(Patch(label=chance, **style.CHANCE))
    if not holds.all():
        handles.append(Line2D([], [], label="leaves the band", **style.OUTSIDE))
    return handles
