"""Draws of the first unknown, in the order in which they came."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from bayesdrill.report import Drawing, ReportContext

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def order(run: ReportContext) -> Drawing:
    return Drawing(_drawn, (run.draws[:, 0], run.problem.symbols[0].latex))


def _drawn(draws: NDArray[np.float64], latex: str) -> Figure:
    from matplotlib.figure import Figure

    figure = Figure()
    axes = figure.subplots()
    axes.plot(draws, ".", color="black", markersize=1)
    axes.set_xlabel("draw")
    axes.set_ylabel(f"${latex}$")
    return figure
