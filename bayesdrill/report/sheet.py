"""Draw on a page in inches: texts, boxes, wires, arrows."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, Rectangle
from matplotlib.path import Path as Route

from bayesdrill.report import style

Point = tuple[float, float]
LINE = 0.8
NOTE, SMALL = 8.0, 7.5  # fonts
SOLID: dict[str, Any] = {"facecolor": style.LIGHT, "edgecolor": style.BLACK, "linewidth": LINE}
HOLLOW: dict[str, Any] = SOLID | {"facecolor": "white"}


def blank_sheet(width: float, height: float) -> tuple[Figure, Axes]:
    """Return a page to draw on in inches, from its lower left corner."""
    figure = Figure(figsize=(width, height))
    sheet = figure.add_axes((0, 0, 1, 1), xlim=(0, width), ylim=(0, height))
    sheet.set_axis_off()
    return figure, sheet


def write(sheet: Axes, x: float, y: float, words: str, **look: Any) -> None:
    """Write words around a place, or as their `look` says."""
    sheet.text(x, y, words, **({"ha": "center", "va": "center"} | look))


def draw_box(sheet: Axes, x: float, y: float, wide: float, high: float, **look: Any) -> None:
    """Draw a rectangle around its middle."""
    sheet.add_patch(Rectangle((x - wide / 2, y - high / 2), wide, high, **look))


def draw_wire(sheet: Axes, *points: Point, color: str = style.BLACK, width: float = LINE) -> None:
    """Draw a line through some points."""
    x, y = zip(*points, strict=True)
    sheet.plot(x, y, color=color, linewidth=width, solid_capstyle="butt", zorder=1.5)


def draw_arrow(sheet: Axes, *points: Point) -> None:
    """Draw a line with a filled head at its end."""
    look: dict[str, Any] = {"facecolor": style.BLACK, "linewidth": LINE, "joinstyle": "miter"}
    head = "-|>,head_length=0.45,head_width=0.17"
    line = FancyArrowPatch(path=Route(points), arrowstyle=head, mutation_scale=10, zorder=2, **look)
    sheet.add_patch(line)


def draw_tag(
    sheet: Axes, x: float, y: float, words: str, look: dict[str, Any], **font: Any
) -> None:
    """Write words in a frame."""
    rounded = {"boxstyle": "round,pad=0.28,rounding_size=0.25"}
    write(sheet, x, y, words, bbox=look | rounded, **font)


def draw_ground(sheet: Axes, x: float, y: float, side: int) -> None:
    """Draw what fixes to the ground: a line on the shaft and strokes away from it."""
    draw_wire(sheet, (x - 0.11, y), (x + 0.11, y))
    for start in np.linspace(-0.11, 0.055, 4):
        draw_wire(sheet, (x + start, y + side * 0.055), (x + start + 0.055, y))
