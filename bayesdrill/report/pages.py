"""A page of equal panels in rows, measured in inches."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayesdrill.report.widths import DOUBLE

# Inches, of a figure in one column.
NARROW_ROW, NARROW_LEFT, LEGEND_LINE = 0.95, 0.48, 0.135
NARROW_GAP = 0.8


@dataclass(frozen=True, slots=True, kw_only=True)
class Page:
    """`row`: the height of a panel; `foot`: room for something else below all panels."""

    columns: int
    width: float
    row: float
    left: float
    right: float
    gap_x: float
    gap_y: float
    top: float
    bottom: float
    foot: float = 0.0

    def fitting(self, width: float, n_handles: int) -> Page:
        """As it is, or for one column of a page of text, below a legend of two columns."""
        if width >= self.width:
            return self
        return replace(
            self,
            width=width,
            columns=2,
            row=NARROW_ROW,
            left=NARROW_LEFT,
            gap_x=NARROW_GAP * self.gap_x,
            top=0.16 + LEGEND_LINE * math.ceil(n_handles / 2),
        )

    def frame(self, panel: Axes, k: int, n: int, x: str, y: str) -> None:
        """Numbers and labels at the foot of each column and beside each row, of panel `k` of `n`."""
        columns = min(n, self.columns)
        foot, side = k + columns >= n, k % columns == 0
        panel.tick_params(labelleft=side, labelbottom=foot)
        if foot:
            panel.set_xlabel(x, labelpad=2)
        if side:
            panel.set_ylabel(y)

    def build(self, n: int) -> tuple[Figure, list[Axes]]:
        """A figure and its `n` panels, row by row."""
        columns = min(n, self.columns)
        rows = math.ceil(n / columns)
        height = self.bottom + self.foot + rows * self.row + (rows - 1) * self.gap_y + self.top
        inside = self.width - self.left - self.right - (columns - 1) * self.gap_x
        width = inside / columns
        figure = Figure(figsize=(self.width, height))
        panels = []
        for k in range(n):
            row, column = divmod(k, columns)
            x = self.left + column * (width + self.gap_x)
            y = height - self.top - self.row - row * (self.row + self.gap_y)
            room = (x / self.width, y / height, width / self.width, self.row / height)
            panels.append(figure.add_axes(room))
        return figure, panels


SMALL_PANELS = Page(
    columns=3,
    width=DOUBLE,
    row=1.15,
    left=0.58,
    right=0.12,
    gap_x=0.12,
    gap_y=0.12,
    top=0.52,
    bottom=0.42,
)


def legend_above(figure: Figure, handles: Sequence[Any], most: int) -> None:
    """In at most so many columns."""
    figure.legend(
        handles=handles,
        loc="upper center",
        ncols=min(most, len(handles)),
        borderaxespad=0.3,
        labelspacing=0.3,
        columnspacing=1.2,
        handlelength=1.9,
    )
