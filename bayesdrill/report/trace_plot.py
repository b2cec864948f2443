"""What the walkers did, step by step: a panel for each unknown, all ensembles in each."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from bayesdrill.basics.symbols import Symbol
from bayesdrill.report import style
from bayesdrill.report.pages import Page

Array = NDArray[np.float64]

STEPS = 300  # drawn at most
QUANTILES = (0.05, 0.5, 0.95)  # of the walkers
EXCURSION = 1.0  # how far burn-in may stretch an axis, in widths of what comes after it
REACH = 0.5  # and how far the nominal value may

# Inches.
ROW, LEFT, RIGHT, BOTTOM, GAP_X, GAP_Y = 1.25, 0.84, 0.12, 0.42, 0.9, 0.12
LEGEND_LINE, LEGEND_MARGIN = 0.165, 0.16

GREYS = ("0.0", "0.5", "0.28", "0.66")  # of the ensembles, with ...
DASHES: tuple[Any, ...] = ("-", (0, (4, 1)), (0, (1, 1)))  # ... the next dashes after each round


BURN_IN: dict[str, Any] = {
    "facecolor": "none",
    "edgecolor": style.MIDDLE,
    "hatch": "////",
    "linewidth": 0,
}
BANDS = 0.24  # opacity of all bands together


def trace_figure(
    theta: Array,
    symbols: Sequence[Symbol],
    burn_in: int,
    nominal: Mapping[str, float],
    mode: Mapping[str, float],
) -> Figure:
    """Medians and 5 to 95 % bands over the walkers of SI chains `(E, S, W, D)`, by step."""
    n_ensembles, n_steps = theta.shape[:2]
    steps = style.thin(n_steps, STEPS)
    bands = np.quantile(theta[:, steps], QUANTILES, axis=2)  # (3, E, steps, D)
    kept = steps >= min(burn_in, steps[-1])
    known = [nominal.get(symbol.name) for symbol in symbols]
    scales = [_scale(bands[..., d], kept, value) for d, value in enumerate(known)]
    sides = {s.side(value) for s, value in zip(scales, known, strict=True) if value is not None}
    with style.styled():
        handles = _handles(n_ensembles, burn_in, sides)
        figure, panels = _page(len(symbols), len(handles))
        for d, (panel, symbol) in enumerate(zip(panels, symbols, strict=True)):
            if burn_in > 0:
                panel.axvspan(0, burn_in, zorder=0, **BURN_IN)
            _ensembles(panel, steps, scales[d](bands[..., d]))
            _values(panel, scales[d], known[d], mode.get(symbol.name))
            _numbers(panel, scales[d], symbol, n_steps)
        _legend(figure, handles, len(symbols))
    return figure


def _scale(bands: Array, kept: NDArray[np.bool_], nominal: float | None) -> style.Scale:
    """An axis for bands `(3, E, steps)`: all after burn-in, and of burn-in what is not too far."""
    after = bands[..., kept]
    low, high = float(after.min()), float(after.max())
    width = high - low
    low = max(float(bands.min()), low - EXCURSION * width)
    high = min(float(bands.max()), high + EXCURSION * width)
    low, high = style.reaching(low, high, nominal, REACH)
    margin = 0.06 * (high - low)
    return style.scale(low - margin, high + margin)


def _columns(n: int) -> int:
    return 1 if n == 1 else 2 if n in (2, 4) else 3


def _page(n: int, n_handles: int) -> tuple[Figure, list[Axes]]:
    """Panels in rows, steps at the foot of each column, room for the legend above."""
    columns = _columns(n)
    page = Page(
        columns=columns,
        width=style.DOUBLE if n > 1 else 1.3 * style.SINGLE,
        row=ROW,
        left=LEFT,
        right=RIGHT,
        gap_x=GAP_X,
        gap_y=GAP_Y,
        top=LEGEND_MARGIN + LEGEND_LINE * math.ceil(n_handles / _legend_columns(n)),
        bottom=BOTTOM,
    )
    figure, panels = page.build(n)
    for k, panel in enumerate(panels):
        if k + columns < n:
            panel.tick_params(labelbottom=False)
        else:
            panel.set_xlabel("step")
    return figure, panels


def ensemble_line(ensemble: int) -> dict[str, Any]:
    """How the lines of an ensemble look."""
    rounds, grey = divmod(ensemble, len(GREYS))
    return {
        "color": GREYS[grey],
        "linestyle": DASHES[rounds % len(DASHES)],
        "linewidth": 0.6,
    }


def _ensembles(panel: Axes, steps: NDArray[np.intp], bands: Array) -> None:
    """Bands `(3, E, steps)` in the numbers of the axis."""
    for ensemble, (low, median, high) in enumerate(bands.swapaxes(0, 1)):
        look = ensemble_line(ensemble)
        alpha = BANDS / bands.shape[1]
        panel.fill_between(steps, low, high, color=style.BLACK, alpha=alpha, linewidth=0, zorder=1)
        panel.plot(steps, median, zorder=2.9 - float(look["color"]), **look)


def _values(panel: Axes, scale: style.Scale, nominal: float | None, mode: float | None) -> None:
    if mode is not None:
        panel.axhline(float(scale(mode)), zorder=3, **style.MAP_LINE)
    side = scale.side(nominal)
    if nominal is not None and side == 0:
        panel.axhline(float(scale(nominal)), zorder=3, **style.NOMINAL)
    if side:
        place, marker = (0.94, "^") if side > 0 else (0.06, "v")
        panel.plot([0.97], [place], transform=panel.transAxes, marker=marker, **style.AWAY)


def _numbers(panel: Axes, scale: style.Scale, symbol: Symbol, n_steps: int) -> None:
    panel.set_xlim(0, max(n_steps - 1, 1))
    panel.set_ylim(scale.low, scale.high)
    panel.xaxis.set_major_locator(MaxNLocator(3, integer=True, prune="upper"))
    panel.xaxis.set_major_formatter(lambda step, _: f"{step:.0f}")
    style.set_ticks(panel.yaxis, *style.ticks(scale.low, scale.high, 4))
    style.side_label(panel, scale.label(symbol, "\n"))


def _handles(n_ensembles: int, burn_in: int, sides: set[int]) -> list[Line2D | Patch]:
    handles: list[Line2D | Patch] = [
        Line2D([], [], label=f"ensemble {k + 1}, median", **ensemble_line(k))
        for k in range(n_ensembles)
    ]
    handles.append(Patch(color=style.LIGHT, linewidth=0, label="5 % to 95 % of the walkers"))
    handles.append(Patch(label=f"burn-in: {burn_in} steps dropped", **BURN_IN))
    handles += style.nominal_handles(sides, marker="^")
    handles.append(Line2D([], [], label="MAP", **style.MAP_LINE))
    return handles


def _legend_columns(n: int) -> int:
    return 2 if n == 1 else 3


def _legend(figure: Figure, handles: list[Line2D | Patch], n: int) -> None:
    figure.legend(
        handles=handles,
        loc="upper center",
        ncols=_legend_columns(n),
        borderaxespad=0.3,
        labelspacing=0.3,
        columnspacing=2.0,
        handlelength=2.4,
    )
