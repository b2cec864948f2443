"""How long the walkers remember: the autocorrelation of each unknown, its time and its window."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from bayesdrill.basics.symbols import Symbol
from bayesdrill.engines.convergence import WINDOW, Autocorrelation, autocorrelation
from bayesdrill.report import style
from bayesdrill.report.pages import SMALL_PANELS, legend_above
from bayesdrill.report.trace_plot import ensemble_line

Array = NDArray[np.float64]

BEYOND = 2.0  # windows, the longest of which are shown
TAU: dict[str, Any] = {"color": style.BLACK, "linestyle": (0, (4, 2)), "linewidth": 0.8}
SUMMED: dict[str, Any] = {"color": style.FAINT, "linewidth": 0}


def autocorrelation_figure(
    theta: Array, symbols: Sequence[Symbol], width: float = style.DOUBLE
) -> Figure:
    """Of chains after burn-in `(E, S, W, D)`: each ensemble, and all of them as `tau` is taken from."""
    every = autocorrelation(theta)
    lags = min(theta.shape[1], math.ceil(BEYOND * (int(every.window.max()) + 1)) + 1)
    each = [autocorrelation(chain[None]).rho[:lags] for chain in theta]
    low = min(0.0, float(min(rho.min() for rho in each)))
    wide = width >= style.DOUBLE
    with style.styled(width):
        handles = _handles(len(each))
        page = SMALL_PANELS.fitting(width, len(handles))
        figure, panels = page.build(len(symbols))
        for d, (panel, symbol) in enumerate(zip(panels, symbols, strict=True)):
            _lines(panel, every, [rho[:, d] for rho in each], d)
            _axes(panel, lags, low)
            page.frame(panel, d, len(symbols), "lag [steps]", "autocorrelation")
            where: dict[str, Any] = {"transform": panel.transAxes, "ha": "right", "va": "top"}
            said = rf"${symbol.latex}$: $\tau = {every.tau[d]:.3g}$" + " steps" * wide
            panel.text(0.97, 0.93, said, **where)
        legend_above(figure, handles, 6 if wide else 2)
    return figure


def _lines(panel: Axes, every: Autocorrelation, each: Sequence[Array], d: int) -> None:
    panel.axvspan(0, float(every.window[d]), zorder=0, **SUMMED)
    panel.axhline(0.0, color=style.MIDDLE, linewidth=0.5, zorder=1)
    panel.axvline(float(every.tau[d]), zorder=2, **TAU)
    for k, rho in enumerate(each):
        panel.plot(np.arange(len(rho)), rho, zorder=3, **ensemble_line(k) | {"linewidth": 0.8})


def _axes(panel: Axes, lags: int, low: float) -> None:
    panel.set_xlim(0, max(lags - 1, 1))
    panel.set_ylim(1.15 * low - 0.06, 1.3)
    panel.xaxis.set_major_locator(MaxNLocator(4, integer=True, prune="upper"))
    panel.xaxis.set_major_formatter(lambda step, _: f"{step:.0f}")
    style.set_ticks(panel.yaxis, np.array([0.0, 0.5, 1.0]), ["0", "0.5", "1"])


def _handles(n_ensembles: int) -> list[Any]:
    handles: list[Any] = [
        Line2D([], [], label=f"ensemble {k + 1}", **ensemble_line(k) | {"linewidth": 0.8})
        for k in range(n_ensembles)
    ]
    handles.append(Line2D([], [], label=r"time $\tau$", **TAU))
    summed = rf"lags summed up for $\tau$ ({WINDOW:g} $\tau$)"
    handles.append(Patch(label=summed, **SUMMED))
    return handles
