"""Draw the rig of the paper, and its pairwise search for the nine parameters."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyArrowPatch, Polygon, Rectangle
from matplotlib.path import Path as Route

from bayesdrill.basics.symbols import INPUTS, PARAMETERS, STATES
from bayesdrill.report import scales, style

Point = tuple[float, float]
Pair = tuple[str, str]

LATEX = {name: s.latex for table in (PARAMETERS, STATES, INPUTS) for name, s in table.items()}
LINE = 0.8
NOTE, SMALL = 8.0, 7.5  # fonts
SOLID: dict[str, Any] = {"facecolor": style.LIGHT, "edgecolor": style.BLACK, "linewidth": LINE}
HOLLOW: dict[str, Any] = SOLID | {"facecolor": "white"}
CELLS: dict[str, Any] = {"edgecolor": style.DARK, "linewidth": 0.6}
MEASURED: dict[str, Any] = SOLID
UNMEASURED: dict[str, Any] = HOLLOW | {"linestyle": (0, (3, 2)), "edgecolor": style.DARK}


def rig_figure() -> Figure:
    """Draw supply, DC motor, gearbox, shaft and rotors, with the paper's symbols."""
    with style.styled():
        figure, sheet = _sheet(scales.DOUBLE, 2.44)
        _circuit(sheet)
        _motor_side(sheet)
        _gearbox(sheet)
        _shaft_side(sheet)
        _names(sheet)
    return figure


def heuristic_figure(pairs: Sequence[Pair], iterations: int) -> Figure:
    """Draw the cycle of the nine `pairs`, each searched for `iterations`."""
    order = [first for first, _ in pairs]
    # There along the upper row and back along the lower one; the decision is last.
    along = [ENTRY + (k + 0.5) * PITCH for k in range(5)]
    places = [*((x, UPPER) for x in along), *((x, LOWER) for x in reversed(along))]
    with style.styled():
        figure, sheet = _sheet(scales.DOUBLE, UPPER + 0.5 * BOX + 0.1)
        for position, pair in zip(places, pairs, strict=False):
            _pair_box(sheet, position, pair, iterations, order)
        _cycle(sheet, places, pairs)
        _key(sheet, order)
    return figure


def _sheet(width: float, height: float) -> tuple[Figure, Axes]:
    """A page to draw on in inches, from its lower left corner."""
    figure = Figure(figsize=(width, height))
    sheet = figure.add_axes((0, 0, 1, 1), xlim=(0, width), ylim=(0, height))
    sheet.set_axis_off()
    return figure, sheet


def _math(*names: str) -> str:
    return "$" + r",\,".join(LATEX[name] for name in names) + "$"


def _text(sheet: Axes, x: float, y: float, words: str, **look: Any) -> None:
    sheet.text(x, y, words, **({"ha": "center", "va": "center"} | look))


def _box(sheet: Axes, x: float, y: float, wide: float, high: float, **look: Any) -> None:
    """A rectangle around its middle."""
    sheet.add_patch(Rectangle((x - wide / 2, y - high / 2), wide, high, **look))


def _wire(sheet: Axes, *points: Point, color: str = style.BLACK, width: float = LINE) -> None:
    x, y = zip(*points, strict=True)
    sheet.plot(x, y, color=color, linewidth=width, solid_capstyle="butt", zorder=1.5)


def _arrow(sheet: Axes, *points: Point) -> None:
    """A line with a filled head at its end."""
    look: dict[str, Any] = {"facecolor": style.BLACK, "linewidth": LINE, "joinstyle": "miter"}
    head = "-|>,head_length=0.45,head_width=0.17"
    line = FancyArrowPatch(path=Route(points), arrowstyle=head, mutation_scale=10, zorder=2, **look)
    sheet.add_patch(line)


def _tag(sheet: Axes, x: float, y: float, words: str, look: dict[str, Any], **font: Any) -> None:
    """Words in a frame."""
    rounded = {"boxstyle": "round,pad=0.28,rounding_size=0.25"}
    _text(sheet, x, y, words, bbox=look | rounded, **font)


# The rig. Places in inches; all shafts turn about the height AXIS.
AXIS, TOP_WIRE, LOW_WIRE = 1.34, 1.90, 0.78
SUPPLY, ARMATURE, INERTIA, BEARING = 0.36, 2.06, 2.72, 3.06
MOTOR, GEARS, ROTOR_2, ROTOR_1 = (0.84, 3.34), (3.72, 4.50), 4.86, 6.42
BESIDE, ABOVE, TAGS = AXIS + 0.36, AXIS + 0.53, 2.17  # rows of symbols


def _circuit(sheet: Axes) -> None:
    """The armature's mesh: supply, resistance, inductance, back-emf."""
    r, left, right = 0.17, SUPPLY, ARMATURE
    frame = {"facecolor": style.FAINT, "edgecolor": "none", "zorder": 0}
    _box(sheet, sum(MOTOR) / 2, (0.56 + TAGS + 0.12) / 2, MOTOR[1] - MOTOR[0], TAGS - 0.44, **frame)
    zigzag = np.array([0, 1, 3, 5, 7, 9, 11, 12]) / 12
    teeth = 0.06 * np.array([0, 1, -1, 1, -1, 1, -1, 0])
    resistor = list(zip(1.02 + 0.36 * zigzag, TOP_WIRE + teeth, strict=True))
    turn = np.linspace(0, 4 * np.pi, 121)
    along = 1.56 + 0.045 * (2 * (turn // np.pi) + 1 - np.cos(turn % np.pi))
    coil = list(zip(along, TOP_WIRE + 0.07 * np.abs(np.sin(turn)), strict=True))
    _wire(sheet, (left, AXIS + r), (left, TOP_WIRE), *resistor)
    _wire(sheet, resistor[-1], *coil, (right, TOP_WIRE), (right, AXIS + 0.24))
    _wire(sheet, (right, AXIS - 0.24), (right, LOW_WIRE), (left, LOW_WIRE), (left, AXIS - r))
    sheet.add_patch(Circle((left, AXIS), r, zorder=3, **HOLLOW))
    _text(sheet, left, AXIS, _math("v"), zorder=4)
    for words, side in (("$+$", 1), ("$-$", -1)):
        _text(sheet, left - 0.11, AXIS + 0.26 * side, words, fontsize=SMALL)
        _text(sheet, right - 0.34, AXIS + 0.22 * side, words, fontsize=SMALL)
    _arrow(sheet, (0.5, TOP_WIRE), (0.73, TOP_WIRE))
    _tag(sheet, 0.6, TAGS, _math("i"), UNMEASURED)
    _text(sheet, 1.20, TAGS, _math("r_m"))
    _text(sheet, 1.74, TAGS, _math("l_m"))
    sheet.add_patch(Circle((right, AXIS), 0.24, zorder=3, **HOLLOW))
    for side in (-1, 1):
        _box(sheet, right, AXIS + side * 0.27, 0.13, 0.06, facecolor=style.BLACK, zorder=4)
    _text(sheet, right, AXIS, "M", zorder=4)
    _text(sheet, right - 0.54, AXIS, rf"${LATEX['k_e']}\,\dot\theta_3$")


def _motor_side(sheet: Axes) -> None:
    """From the armature to the gearbox, turning by theta_3."""
    _rod(sheet, ARMATURE + 0.24, GEARS[0])
    _turning(sheet, 2.48)
    _text(sheet, 2.47, BESIDE, rf"${LATEX['k_T']}\,\dot q$")
    _box(sheet, INERTIA, AXIS, 0.13, 0.84, **SOLID)
    _text(sheet, INERTIA, ABOVE, _math("j_m"))
    for side in (-1, 1):
        _ground(sheet, BEARING, AXIS + side * 0.06, side)
    _text(sheet, BEARING, BESIDE, _math("c_m", "t_f"))
    _turning(sheet, 3.5)
    _text(sheet, 3.5, BESIDE, r"$\theta_3$")


def _gearbox(sheet: Axes) -> None:
    """Two equal stages on one axis, drawn to scale: the gears' heights are as 1 to sqrt(8)."""
    (left, right), small = GEARS, 0.13
    large, middle = small * np.sqrt(8), (GEARS[0] + GEARS[1]) / 2
    side = AXIS - (small + large) / 2
    _box(sheet, middle, AXIS - 0.1, right - left, 0.98, **HOLLOW)
    _rod(sheet, left, middle - 0.14, AXIS, 0.05)
    _rod(sheet, middle + 0.14, right, AXIS, 0.05)
    _rod(sheet, middle - 0.27, middle + 0.27, side, 0.05)
    wheels = (-0.16, AXIS, small), (-0.16, side, large), (0.16, side, small), (0.16, AXIS, large)
    for x, y, high in wheels:
        _box(sheet, middle + x, y, 0.13, high, **SOLID)
    _text(sheet, middle, ABOVE, r"$i_m = 1/8$")


def _shaft_side(sheet: Axes) -> None:
    """From the gearbox to rotor 1: two angles, and the shaft between them."""
    _rod(sheet, GEARS[1], ROTOR_2)
    _rod(sheet, ROTOR_1, 6.8)
    _wire(sheet, (ROTOR_2 + 0.045, AXIS), (ROTOR_1 - 0.08, AXIS), width=2.0)
    _box(sheet, ROTOR_2, AXIS, 0.09, 0.70, **HOLLOW)
    _box(sheet, ROTOR_1, AXIS, 0.16, 1.24, **SOLID)
    _turning(sheet, ROTOR_2 + 0.2)
    _turning(sheet, ROTOR_1 - 0.26)
    _turning(sheet, ROTOR_1 + 0.22, forwards=False)
    _tag(sheet, ROTOR_2, TAGS, _math("theta_2", "w_2"), MEASURED)
    _tag(sheet, ROTOR_1, TAGS, _math("theta_1", "w_1"), MEASURED)
    middle = (ROTOR_2 + ROTOR_1) / 2
    _text(sheet, middle, AXIS + 0.17, _math("k_s"))
    _text(sheet, middle, AXIS - 0.17, "2.4 m, \N{DIAMETER SIGN} 3 mm", fontsize=SMALL)
    _text(sheet, ROTOR_1 - 0.2, ABOVE, _math("j_1"))
    _text(sheet, ROTOR_1 + 0.24, BESIDE, _math("t_1"))


def _rod(sheet: Axes, left: float, right: float, y: float = AXIS, thick: float = 0.07) -> None:
    _box(sheet, (left + right) / 2, y, right - left, thick, **HOLLOW)


def _turning(sheet: Axes, x: float, *, forwards: bool = True) -> None:
    """An arrow around the front of the shaft, which is hidden behind it."""
    angles = np.radians([*range(-115, 36, 5), 72])  # the last piece carries the head
    high = 0.2 if forwards else -0.2
    points = zip(x - 0.03 + 0.075 * np.cos(angles), AXIS + high * np.sin(angles), strict=True)
    _wire(sheet, (x + 0.045, AXIS - 0.041), (x + 0.045, AXIS + 0.041), color="white", width=3.0)
    _arrow(sheet, *points)


def _ground(sheet: Axes, x: float, y: float, side: int) -> None:
    """Fixed to the ground: a line on the shaft and strokes away from it."""
    _wire(sheet, (x - 0.11, y), (x + 0.11, y))
    for start in np.linspace(-0.11, 0.055, 4):
        _wire(sheet, (x + start, y + side * 0.055), (x + start + 0.055, y))


def _names(sheet: Axes) -> None:
    middles = (sum(MOTOR) / 2, sum(GEARS) / 2, ROTOR_2, (ROTOR_2 + ROTOR_1) / 2, ROTOR_1)
    names = ("DC motor", "gearbox 8 : 1", "rotor 2", "steel shaft", "rotor 1")
    for x, name in zip((SUPPLY, *middles), ("supply", *names), strict=True):
        _text(sheet, x, 0.39, name, va="baseline")
    _tag(sheet, scales.DOUBLE / 2 - 0.45, 0.14, "measured", MEASURED, fontsize=NOTE)
    _tag(sheet, scales.DOUBLE / 2 + 0.35, 0.14, "not measured", UNMEASURED, fontsize=NOTE)


# The heuristic. Places in inches, from the lower edge; ENTRY is left of the first column.
LOWER, UPPER, ENTRY, CELL = 1.12, 2.28, 0.74, 0.21
PITCH = (scales.DOUBLE - ENTRY) / 5
WIDE, BOX = 0.96, 0.78  # of a box


def _pair_box(
    sheet: Axes, position: Point, pair: Pair, iterations: int, order: Sequence[str]
) -> None:
    """What one step of the cycle does; the strip below shows which parameters it moves."""
    x, y = position
    _box(sheet, x, y, WIDE, BOX, **HOLLOW)
    _text(sheet, x, y + 0.26, _math(*pair), fontsize=10.0)
    words = f"{iterations} iterations\nNelder\N{EN DASH}Mead"
    _text(sheet, x, y + 0.01, words, fontsize=SMALL, linespacing=1.1)
    cell = (WIDE - 0.12) / len(order)
    for k, name in enumerate(order):
        middle = x + (k - (len(order) - 1) / 2) * cell
        fill = style.DARK if name in pair else "white"
        _box(sheet, middle, y - 0.27, cell, 0.09, **CELLS | {"facecolor": fill})


def _cycle(sheet: Axes, places: Sequence[Point], pairs: Sequence[Pair]) -> None:
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
            _arrow(sheet, (x + way, y), (u - way, y))
            _text(sheet, (x + u) / 2, y + 0.06, words, va="bottom", fontsize=NOTE)
        else:
            _arrow(sheet, (x, y - tall), (u, v + tall))
            _text(sheet, x + 0.07, (y + v) / 2, words, ha="left", fontsize=NOTE)
    (x, upper), (_, y) = places[0], places[-1]
    corners = [(x - half, y), (x, y + tall), (x + half, y), (x, y - tall)]
    sheet.add_patch(Polygon(corners, **SOLID))
    _text(sheet, x, y, "misfit\nsteady?", fontsize=NOTE, linespacing=1.05)
    _arrow(sheet, (x, y + tall), (x, upper - tall))
    shared = _math(*(name for name in pairs[-1] if name in pairs[0]))
    _text(sheet, x - 0.07, (y + upper) / 2, "no", ha="right", fontsize=NOTE)
    _text(sheet, x + 0.07, (y + upper) / 2, shared, ha="left", fontsize=NOTE)
    edge = x - half
    _arrow(sheet, (edge - 0.28, upper), (edge, upper))
    _arrow(sheet, (edge, y), (edge - 0.28, y))
    _text(sheet, edge - 0.14, y + 0.05, "yes", va="bottom", fontsize=NOTE)
    for height, words in ((upper, "first\nguess"), (y, "estimate")):
        _text(sheet, edge - 0.33, height, words, ha="right", fontsize=NOTE, linespacing=1.05)


def _key(sheet: Axes, order: Sequence[str]) -> None:
    """The order of the cells in a strip, and what they and the arrows mean."""
    left = (scales.DOUBLE - len(order) * CELL - 1.35) / 2
    for k, name in enumerate(order):
        _box(sheet, left + (k + 0.5) * CELL, 0.32, CELL, 0.2, **CELLS | {"facecolor": "white"})
        _text(sheet, left + (k + 0.5) * CELL, 0.32, _math(name), fontsize=NOTE)
    left += len(order) * CELL + 0.15
    _box(sheet, left + 0.09, 0.48, 0.09, 0.09, **CELLS | {"facecolor": style.DARK})
    _box(sheet, left + 0.09, 0.32, 0.09, 0.09, **CELLS | {"facecolor": "white"})
    _arrow(sheet, (left - 0.01, 0.16), (left + 0.19, 0.16))
    notes = "searched", "held at its last value", "starts the next search"
    for y, words in zip((0.48, 0.32, 0.16), notes, strict=True):
        _text(sheet, left + 0.25, y, words, ha="left", fontsize=SMALL)
