"""Profile likelihoods: how fast the best fit gets worse as one parameter moves away."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from scipy.interpolate import PchipInterpolator

from bayesdrill.basics.symbols import Symbol
from bayesdrill.insight.identifiability.profile import THRESHOLD, Profile
from bayesdrill.report import style
from bayesdrill.report.pages import Page

PAGE = Page(
    columns=3,
    width=style.DOUBLE,
    row=1.15,
    left=0.5,
    right=0.12,
    gap_x=0.18,
    gap_y=0.62,
    top=0.34,
    bottom=0.5,
)
LEGEND = 3  # entries
LETTER, ROOMY = 0.062, 1.6  # inches: of a letter, and of a panel that has room for four ticks
HIGHEST = 8.0  # of the loss that is shown
MARGIN = 0.04  # of the width of a panel, so that walls can be seen


def profile_figure(
    profiles: Sequence[Profile],
    symbols: Mapping[str, Symbol],
    nominal: Mapping[str, float],
    logs: Collection[str] = (),
    width: float = style.DOUBLE,
) -> Figure:
    """A panel for each parameter: the loss against its value, in the units of the symbols, and where it
    passes 95 %; the axes of the parameters in `logs` are logarithmic.
    """
    alone = len(profiles) == 1
    with style.styled(width):
        page = PAGE.fitting(width, LEGEND) if not alone else replace(PAGE, width=style.SINGLE)
        figure, panels = page.build(len(profiles))
        sides = set()
        for k, (panel, profile) in enumerate(zip(panels, profiles, strict=True)):
            known, log = nominal.get(profile.name), profile.name in logs
            sides.add(_panel(panel, profile, symbols[profile.name], known, log=log))
            panel.tick_params(labelleft=k % page.columns == 0)
            if k % page.columns == 0:
                panel.set_ylabel(
                    "loss of log likelihood", fontsize=style.letters("legend.fontsize")
                )
        figure.legend(
            handles=_handles(sides),
            loc="upper center",
            ncols=4 if width >= style.DOUBLE else 2,
            borderaxespad=0.3,
            labelspacing=0.3,
        )
    return figure


def _panel(
    panel: Axes, profile: Profile, symbol: Symbol, nominal: float | None, *, log: bool
) -> int:
    """The side on which the nominal value is off the axis: -1, 0 or 1."""
    near = profile.loss <= HIGHEST
    first, last = (int(k) for k in np.flatnonzero(near)[[0, -1]])
    shown = slice(max(first - 1, 0), min(last + 2, len(near)))
    values, loss = profile.values[shown], profile.loss[shown]
    scale = style.scale(_edge(values, loss, 0), _edge(values, loss, -1), log=log, margin=MARGIN)
    fine = np.geomspace(values[0], values[-1], 400)
    line = PchipInterpolator(np.log(values), loss)(np.log(fine))
    panel.plot(scale(fine), line, color=style.BLACK)
    panel.plot(scale(values), loss, color=style.BLACK, marker="o", markersize=2, linestyle="none")
    panel.axhline(THRESHOLD, color=style.MIDDLE, linewidth=0.7, linestyle=(0, (1, 1)))
    left = profile.low if profile.low is not None else float(values[0])
    right = profile.high if profile.high is not None else float(values[-1])
    panel.axvspan(float(scale(left)), float(scale(right)), color=style.FAINT, zorder=-2)
    side = scale.side(nominal) if nominal is not None else 0
    if nominal is not None and side == 0:
        panel.axvline(float(scale(nominal)), **style.NOMINAL)
    panel.set_xlim(scale.low, scale.high)
    panel.set_ylim(-0.03 * HIGHEST, HIGHEST)
    style.set_ticks(panel.yaxis, np.array([0.0, 2.0, 4.0, 6.0]), ["0", "2", "4", "6"])
    panel.set_xlabel(scale.label(symbol), labelpad=1)
    inches = panel.get_window_extent().width / panel.figure.dpi
    most = 4 if inches > ROOMY else 3
    style.set_numbers(panel.xaxis, scale, most, clear=0.08, letter=LETTER / inches)
    where: dict[str, Any] = {"transform": panel.transAxes, "ha": "right", "va": "top"}
    panel.text(0.97, 0.93, profile.shape, fontsize=style.letters("legend.fontsize"), **where)
    return side


def _edge(values: np.ndarray, loss: np.ndarray, end: int) -> float:
    """Where the curve leaves the panel, or its end."""
    inner = 1 if end == 0 else -2
    if len(values) < 2 or loss[end] <= HIGHEST:
        return float(values[end])
    share = (HIGHEST - loss[inner]) / (loss[end] - loss[inner])
    return float(values[inner] + np.sqrt(max(share, 0.0)) * (values[end] - values[inner]))


def _handles(sides: set[int]) -> list[Line2D | Patch]:
    return [
        Patch(facecolor=style.FAINT, label="within 95 %"),
        *style.nominal_handles(sides),
    ]
