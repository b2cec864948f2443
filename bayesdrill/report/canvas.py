"""Draw on a page in inches: texts, boxes, circles, wires, arrows."""

from __future__ import annotations

from typing import Any

import numpy as np

from bayesdrill.report import style
from bayesdrill.report.scales import DOUBLE

Point = tuple[float, float]
LINE = 0.8  # line width in points
SMALL = 7.5  # font size in points
SOLID: dict[str, Any] = {"facecolor": style.LIGHT, "edgecolor": style.BLACK, "linewidth": LINE}
HOLLOW: dict[str, Any] = SOLID | {"facecolor": "white"}


class Canvas:
    """The canvas is a page `DOUBLE` inches wide; x and y are inches from its lower left corner."""

    def __init__(self, height: float) -> None:
        self.figure = style.new_figure(DOUBLE, height)
        self.axes = self.figure.add_axes((0, 0, 1, 1), xlim=(0, DOUBLE), ylim=(0, height))
        self.axes.set_axis_off()

    def write(self, x: float, y: float, words: str, **look: Any) -> None:
        """Write `words` with their centre at (x, y), unless `look` sets another alignment."""
        self.axes.text(x, y, words, **({"ha": "center", "va": "center"} | look))

    def box(self, x: float, y: float, wide: float, high: float, **look: Any) -> None:
        """Draw a rectangle with its centre at (x, y)."""
        from matplotlib.patches import Rectangle

        self.axes.add_patch(Rectangle((x - wide / 2, y - high / 2), wide, high, **look))

    def circle(self, x: float, y: float, radius: float, **look: Any) -> None:
        """Draw a circle with its centre at (x, y)."""
        from matplotlib.patches import Circle

        self.axes.add_patch(Circle((x, y), radius, **look))

    def wire(self, *points: Point) -> None:
        """Draw a line through some points."""
        x, y = zip(*points, strict=True)
        self.axes.plot(x, y, color=style.BLACK, linewidth=LINE, solid_capstyle="butt", zorder=1.5)

    def arrow(self, *points: Point) -> None:
        """Draw a line with a filled head at its end."""
        from matplotlib.patches import FancyArrowPatch
        from matplotlib.path import Path

        look: dict[str, Any] = {"facecolor": style.BLACK, "linewidth": LINE, "joinstyle": "miter"}
        head = "-|>,head_length=0.45,head_width=0.17"
        line = FancyArrowPatch(
            path=Path(points), arrowstyle=head, mutation_scale=10, zorder=2, **look
        )
        self.axes.add_patch(line)

    def ground(self, x: float, y: float) -> None:
        """Draw the symbol of the ground: a line and strokes below it."""
        self.wire((x - 0.11, y), (x + 0.11, y))
        for start in np.linspace(-0.11, 0.055, 4):
            self.wire((x + start, y - 0.055), (x + start + 0.055, y))
