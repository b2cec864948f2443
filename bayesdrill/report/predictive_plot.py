"""The record against its own prediction: how its samples are distributed in it, against chance."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from scipy.special import ndtri
from scipy.stats import norm

from bayesdrill.insight.predictive import FALSE_ALARM, Check
from bayesdrill.report import style
from bayesdrill.report.pages import Page, legend_above

PAGE = Page(
    columns=2,
    width=style.DOUBLE,
    row=1.3,
    left=0.58,
    right=0.12,
    gap_x=0.66,
    gap_y=0.16,
    top=0.5,
    bottom=0.42,
)
FARTHEST = 4.5  # sds shown; what lies beyond stands in the last bin
BINS = 36
NAMES = 1.7  # of the farthest line: where a panel ends, above which names stand
INSIDE: dict[str, Any] = {"color": style.BLACK, "linewidth": 0.9}
EXPECTED: dict[str, Any] = {**style.NOMINAL}
FOUND: dict[str, Any] = {"facecolor": style.LIGHT, "edgecolor": style.BLACK, "linewidth": 0.7}


def predictive_figure(checks: Sequence[Check], width: float = style.DOUBLE) -> Figure:
    """A row for each channel: samples in standard deviations of their prediction, and their PIT."""
    most = max(float(np.abs(_away(one)).max()) for one in checks)
    wide = width >= style.DOUBLE
    with style.styled(width):
        handles = _handles(checks)
        page = PAGE.fitting(width, len(handles))
        figure, panels = page.build(2 * len(checks))
        for k, one in enumerate(checks):
            left, right = panels[2 * k : 2 * k + 2]
            _densities(left, one)
            _difference(right, one, most)
            for panel in (left, right):
                panel.tick_params(labelbottom=k == len(checks) - 1)
        panels[-2].set_xlabel("measured less predicted" + ", in sds of the prediction" * wide)
        panels[-1].set_xlabel("share of the prediction below (PIT)" if wide else "PIT")
        legend_above(figure, handles, 4 if wide else 2)
    return figure


def _away(one: Check) -> Any:
    """Lower and upper edge of the band and the record between, less the expected, in per cent."""
    counts = np.stack([one.band.low, one.band.high, one.band.counts(one.ranks)])
    return 100 * (counts / one.band.n - one.band.shares)


def _densities(panel: Axes, one: Check) -> None:
    edges = np.linspace(-FARTHEST, FARTHEST, BINS + 1)
    tail = norm.cdf(-FARTHEST)
    heights, _ = np.histogram(ndtri(np.clip(one.pit, tail, 1 - tail)), edges, density=True)
    panel.stairs(heights, edges, fill=True, color=FOUND["facecolor"], zorder=1)
    panel.stairs(heights, edges, color=FOUND["edgecolor"], linewidth=0.7, zorder=2)
    places = np.linspace(-FARTHEST, FARTHEST, 401)
    panel.plot(places, norm.pdf(places), zorder=3, **EXPECTED)
    panel.set_xlim(-FARTHEST, FARTHEST)
    panel.set_ylim(0, 1.25 * max(0.4, float(heights.max())))
    style.set_ticks(panel.xaxis, np.arange(-4.0, 5.0, 2.0), ["\u22124", "\u22122", "0", "2", "4"])
    style.set_ticks(panel.yaxis, np.array([]), None)
    panel.set_ylabel("density")
    panel.text(0.03, 0.93, f"${one.channel.latex}$", transform=panel.transAxes, va="top")


def _difference(panel: Axes, one: Check, most: float) -> None:
    places = np.concatenate([[0.0], one.band.shares, [1.0]])
    low, high, found = np.pad(_away(one), ((0, 0), (1, 1)))
    panel.fill_between(places, low, high, zorder=0, **style.CHANCE)
    panel.axhline(0.0, color=style.MIDDLE, linewidth=0.5, zorder=1)
    panel.plot(places, found, zorder=2, **(INSIDE if one.holds else style.OUTSIDE))
    panel.set_xlim(0, 1)
    panel.set_ylim(-1.12 * most, NAMES * most)
    style.set_ticks(panel.xaxis, np.array([0.0, 0.5, 1.0]), ["0", "0.5", "1"])
    style.set_ticks(panel.yaxis, *style.ticks(-1.12 * most, 1.12 * most, 5))
    panel.set_ylabel("ECDF difference [%]")
    if one.says:
        where: dict[str, Any] = {
            "transform": panel.transAxes,
            "va": "top",
            "ha": "right",
            "fontsize": style.letters("legend.fontsize"),
        }
        panel.text(0.97, 0.93, one.says, **where)


def _handles(checks: Sequence[Check]) -> list[Any]:
    chance = f"{100 * (1 - FALSE_ALARM):g} % of chance, together"
    handles: list[Any] = [
        Patch(label="record", **FOUND),
        Line2D([], [], label="as predicted", **EXPECTED),
        Patch(label=chance, **style.CHANCE),
    ]
    if any(one.holds for one in checks):
        handles.append(Line2D([], [], label="record", **INSIDE))
    if not all(one.holds for one in checks):
        handles.append(Line2D([], [], label="record, leaves the band", **style.OUTSIDE))
    return handles
