"""Draw the rig of the paper, and its pairwise search for the nine parameters."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from bayesdrill.basics.symbols import INPUTS, PARAMETERS, STATES
from bayesdrill.report import scales, style
from bayesdrill.report.sheet import HOLLOW, NOTE, SMALL, SOLID, Canvas, Point

Pair = tuple[str, str]

LATEX = {name: s.latex for table in (PARAMETERS, STATES, INPUTS) for name, s in table.items()}
CELLS: dict[str, Any] = {"edgecolor": style.DARK, "linewidth": 0.6}
MEASURED: dict[str, Any] = SOLID
UNMEASURED: dict[str, Any] = HOLLOW | {"linestyle": (0, (3, 2)), "edgecolor": style.DARK}


def rig_figure() -> Figure:
    """Draw supply, DC motor, gearbox, shaft and rotors, with the paper's symbols."""
    with style.styled():
        sheet = Canvas(2.44)
        _circuit(sheet)
        _motor_side(sheet)
        _gearbox(sheet)
        _shaft_side(sheet)
        _names(sheet)
    return sheet.figure


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
    return "$" + r",\,".join(LATEX[name] for name in names) + "$"


# The rig. Places in inches; all shafts turn about the height AXIS.
AXIS, TOP_WIRE, LOW_WIRE = 1.34, 1.90, 0.78
SUPPLY, ARMATURE, INERTIA, BEARING = 0.36, 2.06, 2.72, 3.06
MOTOR, GEARS, ROTOR_2, ROTOR_1 = (0.84, 3.34), (3.72, 4.50), 4.86, 6.42
BESIDE, ABOVE, TAGS = AXIS + 0.36, AXIS + 0.53, 2.17  # rows of symbols


def _circuit(sheet: Canvas) -> None:
    """The armature's mesh: supply, resistance, inductance, back-emf."""
    r, left, right = 0.17, SUPPLY, ARMATURE
    frame = {"facecolor": style.FAINT, "edgecolor": "none", "zorder": 0}
    sheet.box(sum(MOTOR) / 2, (0.56 + TAGS + 0.12) / 2, MOTOR[1] - MOTOR[0], TAGS - 0.44, **frame)
    zigzag = np.array([0, 1, 3, 5, 7, 9, 11, 12]) / 12
    teeth = 0.06 * np.array([0, 1, -1, 1, -1, 1, -1, 0])
    resistor = list(zip(1.02 + 0.36 * zigzag, TOP_WIRE + teeth, strict=True))
    turn = np.linspace(0, 4 * np.pi, 121)
    along = 1.56 + 0.045 * (2 * (turn // np.pi) + 1 - np.cos(turn % np.pi))
    coil = list(zip(along, TOP_WIRE + 0.07 * np.abs(np.sin(turn)), strict=True))
    sheet.wire((left, AXIS + r), (left, TOP_WIRE), *resistor)
    sheet.wire(resistor[-1], *coil, (right, TOP_WIRE), (right, AXIS + 0.24))
    sheet.wire((right, AXIS - 0.24), (right, LOW_WIRE), (left, LOW_WIRE), (left, AXIS - r))
    sheet.circle(left, AXIS, r, zorder=3, **HOLLOW)
    sheet.write(left, AXIS, _math("v"), zorder=4)
    for words, side in (("$+$", 1), ("$-$", -1)):
        sheet.write(left - 0.11, AXIS + 0.26 * side, words, fontsize=SMALL)
        sheet.write(right - 0.34, AXIS + 0.22 * side, words, fontsize=SMALL)
    sheet.arrow((0.5, TOP_WIRE), (0.73, TOP_WIRE))
    sheet.tag(0.6, TAGS, _math("i"), UNMEASURED)
    sheet.write(1.20, TAGS, _math("r_m"))
    sheet.write(1.74, TAGS, _math("l_m"))
    sheet.circle(right, AXIS, 0.24, zorder=3, **HOLLOW)
    for side in (-1, 1):
        sheet.box(right, AXIS + side * 0.27, 0.13, 0.06, facecolor=style.BLACK, zorder=4)
    sheet.write(right, AXIS, "M", zorder=4)
    sheet.write(right - 0.54, AXIS, rf"${LATEX['k_e']}\,\dot\theta_3$")


def _motor_side(sheet: Canvas) -> None:
    """From the armature to the gearbox, turning by theta_3."""
    _rod(sheet, ARMATURE + 0.24, GEARS[0])
    _turning(sheet, 2.48)
    sheet.write(2.47, BESIDE, rf"${LATEX['k_T']}\,\dot q$")
    sheet.box(INERTIA, AXIS, 0.13, 0.84, **SOLID)
    sheet.write(INERTIA, ABOVE, _math("j_m"))
    for side in (-1, 1):
        sheet.ground(BEARING, AXIS + side * 0.06, side)
    sheet.write(BEARING, BESIDE, _math("c_m", "t_f"))
    _turning(sheet, 3.5)
    sheet.write(3.5, BESIDE, r"$\theta_3$")


def _gearbox(sheet: Canvas) -> None:
    """Two equal stages on one axis, drawn to scale: the gears' heights are as 1 to sqrt(8)."""
    (left, right), small = GEARS, 0.13
    large, middle = small * np.sqrt(8), (GEARS[0] + GEARS[1]) / 2
    side = AXIS - (small + large) / 2
    sheet.box(middle, AXIS - 0.1, right - left, 0.98, **HOLLOW)
    _rod(sheet, left, middle - 0.14, AXIS, 0.05)
    _rod(sheet, middle + 0.14, right, AXIS, 0.05)
    _rod(sheet, middle - 0.27, middle + 0.27, side, 0.05)
    wheels = (-0.16, AXIS, small), (-0.16, side, large), (0.16, side, small), (0.16, AXIS, large)
    for x, y, high in wheels:
        sheet.box(middle + x, y, 0.13, high, **SOLID)
    sheet.write(middle, ABOVE, r"$i_m = 1/8$")


def _shaft_side(sheet: Canvas) -> None:
    """From the gearbox to rotor 1: two angles, and the shaft between them."""
    _rod(sheet, GEARS[1], ROTOR_2)
    _rod(sheet, ROTOR_1, 6.8)
    sheet.wire((ROTOR_2 + 0.045, AXIS), (ROTOR_1 - 0.08, AXIS), width=2.0)
    sheet.box(ROTOR_2, AXIS, 0.09, 0.70, **HOLLOW)
    sheet.box(ROTOR_1, AXIS, 0.16, 1.24, **SOLID)
    _turning(sheet, ROTOR_2 + 0.2)
    _turning(sheet, ROTOR_1 - 0.26)
    _turning(sheet, ROTOR_1 + 0.22, forwards=False)
    sheet.tag(ROTOR_2, TAGS, _math("theta_2", "w_2"), MEASURED)
    sheet.tag(ROTOR_1, TAGS, _math("theta_1", "w_1"), MEASURED)
    middle = (ROTOR_2 + ROTOR_1) / 2
    sheet.write(middle, AXIS + 0.17, _math("k_s"))
    sheet.write(middle, AXIS - 0.17, "2.4 m, \N{DIAMETER SIGN} 3 mm", fontsize=SMALL)
    sheet.write(ROTOR_1 - 0.2, ABOVE, _math("j_1"))
    sheet.write(ROTOR_1 + 0.24, BESIDE, _math("t_1"))


def _rod(sheet: Canvas, left: float, right: float, y: float = AXIS, thick: float = 0.07) -> None:
    sheet.box((left + right) / 2, y, right - left, thick, **HOLLOW)


def _turning(sheet: Canvas, x: float, *, forwards: bool = True) -> None:
    """An arrow around the front of the shaft, which is hidden behind it."""
    angles = np.radians([*range(-115, 36, 5), 72])  # the last piece carries the head
    high = 0.2 if forwards else -0.2
    points = zip(x - 0.03 + 0.075 * np.cos(angles), AXIS + high * np.sin(angles), strict=True)
    sheet.wire((x + 0.045, AXIS - 0.041), (x + 0.045, AXIS + 0.041), color="white", width=3.0)
    sheet.arrow(*points)


def _names(sheet: Canvas) -> None:
    middles = (sum(MOTOR) / 2, sum(GEARS) / 2, ROTOR_2, (ROTOR_2 + ROTOR_1) / 2, ROTOR_1)
    names = ("DC motor", "gearbox 8 : 1", "rotor 2", "steel shaft", "rotor 1")
    for x, name in zip((SUPPLY, *middles), ("supply", *names), strict=True):
        sheet.write(x, 0.39, name, va="baseline")
    sheet.tag(scales.DOUBLE / 2 - 0.45, 0.14, "measured", MEASURED, fontsize=NOTE)
    sheet.tag(scales.DOUBLE / 2 + 0.35, 0.14, "not measured", UNMEASURED, fontsize=NOTE)


# The heuristic. Places in inches, from the lower edge; ENTRY is left of the first column.
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
