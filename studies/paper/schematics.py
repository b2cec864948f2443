"""Draw the paper's pairwise search for the nine parameters."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from bayesdrill.basics import PARAMETERS
from bayesdrill.report import HOLLOW, SMALL, SOLID, Canvas, scales, style

Pair = tuple[str, str]
Point = tuple[float, float]

NOTE = 8.0  # size of a font

CELLS: dict[str, Any] = {"edgecolor": style.DARK, "linewidth": 0.6}


def heuristic_figure(pairs: Sequence[Pair], iterations: int) -> Figure:
    """Draw the cycle of the nine `pairs`, each searched for `iterations`."""
    order = [first for first, _ in pairs]
    # There along the upper row and back along the lower one; the decision is last.
    along = [ENTRY + (k + 0.5) * PITCH for k in range(5)]
    places = [*((x, UPPER) for x in along), *((x, LOWER) for x in reversed(along))]
    with style.styled():
        sheet = Canvas(UPPER + 0.5 * BOX + 0.1)
        for position, pair in zip(places, pairs, strict=False):
            _pair_box(sheet, position, pair, iterations, order)
        _cycle(sheet, places, pairs)
        _key(sheet, order)
    return sheet.figure


def _math(*names: str) -> str:
    return "$" + r",\,".join(PARAMETERS[name].latex for name in names) + "$"


# Places in inches, from the lower edge; ENTRY is left of the first column.
LOWER, UPPER, ENTRY, CELL = 1.12, 2.28, 0.74, 0.21
PITCH = (scales.DOUBLE - ENTRY) / 5
WIDE, BOX = 0.96, 0.78  # of a box


def _pair_box(
    sheet: Canvas, position: Point, pair: Pair, iterations: int, order: Sequence[str]
) -> None:
    """What one step of the cycle does; the strip below shows which parameters it moves."""
    x, y = position
    sheet.box(x, y, WIDE, BOX, **HOLLOW)
    sheet.write(x, y + 0.26, _math(*pair), fontsize=10.0)
    words = f"{iterations} iterations\nNelder\N{EN DASH}Mead"
    sheet.write(x, y + 0.01, words, fontsize=SMALL, linespacing=1.1)
    cell = (WIDE - 0.12) / len(order)
    for k, name in enumerate(order):
        middle = x + (k - (len(order) - 1) / 2) * cell
        fill = style.DARK if name in pair else "white"
        sheet.box(middle, y - 0.27, cell, 0.09, **CELLS | {"facecolor": fill})


def _cycle(sheet: Canvas, places: Sequence[Point], pairs: Sequence[Pair]) -> None:
    """Draw arrows from box to box, with what each hands to the next as its start.

    And the decision, round again or out, and the way in.
    """
    half, tall = WIDE / 2, BOX / 2
    passed = [
        _math(*(name for name in pair if name in following)) for pair, following in pairwise(pairs)
    ]
    for ((x, y), (u, v)), words in zip(pairwise(places), [*passed, ""], strict=True):
        if y == v:
            way = half if u > x else -half
            sheet.arrow((x + way, y), (u - way, y))
            sheet.write((x + u) / 2, y + 0.06, words, va="bottom", fontsize=NOTE)
        else:
            sheet.arrow((x, y - tall), (u, v + tall))
            sheet.write(x + 0.07, (y + v) / 2, words, ha="left", fontsize=NOTE)
    (x, upper), (_, y) = places[0], places[-1]
    corners = [(x - half, y), (x, y + tall), (x + half, y), (x, y - tall)]
    sheet.axes.add_patch(Polygon(corners, **SOLID))
    sheet.write(x, y, "misfit\nsteady?", fontsize=NOTE, linespacing=1.05)
    sheet.arrow((x, y + tall), (x, upper - tall))
    shared = _math(*(name for name in pairs[-1] if name in pairs[0]))
    sheet.write(x - 0.07, (y + upper) / 2, "no", ha="right", fontsize=NOTE)
    sheet.write(x + 0.07, (y + upper) / 2, shared, ha="left", fontsize=NOTE)
    edge = x - half
    sheet.arrow((edge - 0.28, upper), (edge, upper))
    sheet.arrow((edge, y), (edge - 0.28, y))
    sheet.write(edge - 0.14, y + 0.05, "yes", va="bottom", fontsize=NOTE)
    for height, words in ((upper, "first\nguess"), (y, "estimate")):
        sheet.write(edge - 0.33, height, words, ha="right", fontsize=NOTE, linespacing=1.05)


def _key(sheet: Canvas, order: Sequence[str]) -> None:
    """The order of the cells in a strip, and what they and the arrows mean."""
    left = (scales.DOUBLE - len(order) * CELL - 1.35) / 2
    for k, name in enumerate(order):
        sheet.box(left + (k + 0.5) * CELL, 0.32, CELL, 0.2, **CELLS | {"facecolor": "white"})
        sheet.write(left + (k + 0.5) * CELL, 0.32, _math(name), fontsize=NOTE)
    left += len(order) * CELL + 0.15
    sheet.box(left + 0.09, 0.48, 0.09, 0.09, **CELLS | {"facecolor": style.DARK})
    sheet.box(left + 0.09, 0.32, 0.09, 0.09, **CELLS | {"facecolor": "white"})
    sheet.arrow((left - 0.01, 0.16), (left + 0.19, 0.16))
    notes = "searched", "held at its last value", "starts the next search"
    for y, words in zip((0.48, 0.32, 0.16), notes, strict=True):
        sheet.write(left + 0.25, y, words, ha="left", fontsize=SMALL)
