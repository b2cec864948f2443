"""Draw the rig of the paper, its pairwise search for the nine parameters, and any other rig."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import count, pairwise
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyArrowPatch, Polygon, Rectangle
from matplotlib.path import Path as Route

from bayesdrill.basics import software
from bayesdrill.basics.symbols import INPUTS, PARAMETERS, STATES
from bayesdrill.report import scales, style
from bayesdrill.report.view import Drawing, ReportContext
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.models.roles import GROUND, ROTARY, InertiaRoles

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


# Any rig, from its roles.  Places in inches: `x` of the middle of a part, `y` of the height of its row.
PAD, LINE_HEIGHT, SPRING, HALF_DISC = 0.1, 0.19, 0.62, 0.4
CART = (0.62, 0.4)
BESIDE_EACH_OTHER = 1.0  # of shafts between the same inertias
FOLDED = 1.1 * scales.DOUBLE  # a chain that is longer goes on in another row


@dataclass(frozen=True, slots=True)
class _Link:
    """A shaft, or a gear with its `ratio`, between two parts, with symbols above it and below."""

    ends: tuple[str, str]
    above: str
    below: str
    name: str
    ratio: float | None = None
    damped: bool = False


@dataclass(frozen=True, slots=True)
class _Part:
    """An inertia or the ground: lines of text above it and below, from the middle outwards."""

    name: str
    above: tuple[str, ...] = ()
    below: tuple[str, ...] = ()
    pushed: bool = False  # by an input that the lines nearest to it name
    driven: bool = False  # by one without which the rig would stand still
    held: bool = False


@dataclass(slots=True)
class _Row:
    """Parts beside each other, each with the links to the one before it, behind a part above."""

    behind: str | None
    parts: list[str]
    folded: bool = False
    y: float = 0.0


def train_figure(rig: Model) -> Figure:
    """Draw the inertias of any rig, with shafts, gears, ground and drives, from its roles."""
    with style.styled():
        picture = _TrainPicture(rig)
        return picture.draw()


def save_rig(rig: Model, path: Path) -> Path:
    """Draw any rig into a file, in the format that its name ends with."""
    note = {"Title": f"rig {rig.name}", "Creator": software.creator()}
    (written,) = style.save(
        train_figure(rig), path.parent, path.stem, note, formats=(path.suffix[1:],)
    )
    return written


SHOWN_RIG = "The rig: its inertias, with shafts, gears and drives."


def draw_rig(run: ReportContext) -> Drawing | None:
    """Return the drawing of a rig that a config describes."""
    rig = run.problem.model
    return Drawing(train_figure, (rig,), says=SHOWN_RIG) if rig.has_private_names else None


class _TrainPicture:
    """The parts of a rig, laid out in rows: the longest chain first, then what branches off."""

    def __init__(self, rig: Model) -> None:
        self.rig, self.roles = rig, rig.roles
        self.linear = self.roles.motion != ROTARY
        ends = {end for shaft in self.roles.shafts for end in shaft.ends}
        self.inertias = [
            inertia
            for inertia in self.roles.inertias
            if inertia.angle in rig.states
            and (inertia.inertia in ("", *rig.parameters) or inertia.name in ends)
        ]
        self.links = list(self._links())
        ground = [end for link in self.links for end in link.ends if end.startswith(GROUND)]
        parts = [*map(self._part, self.inertias), *map(_Part, ground)]
        self.parts = {part.name: part for part in parts}
        self.figure, self.sheet = _sheet(scales.DOUBLE, 1.0)
        self.between: dict[str, list[_Link]] = {}
        self.at: dict[str, Point] = {}

    def draw(self) -> Figure:
        """Lay all out, and draw it on a page that is as large as that."""
        rows = self._rows()
        shown = [link for links in self.between.values() for link in links]
        notes = [
            f"{link.above} ({link.name}) between {' and '.join(link.ends)}"
            for link in self.links
            if link not in shown
        ]
        height, width = 0.1 + LINE_HEIGHT * len(notes), self._measure(*notes) + 0.2
        for row in reversed(rows):
            height += self._reach(row, "below")
            row.y = height
            height += self._reach(row, "above") + 0.12
        for row in rows:
            width = max(width, self._place(row))
        self.figure.set_size_inches(max(width, 2.0), height)
        self.sheet.set(xlim=(0, max(width, 2.0)), ylim=(0, height))
        for row in rows:
            self._draw_row(row)
        for k, note in enumerate(notes):
            _text(
                self.sheet, 0.1, 0.1 + k * LINE_HEIGHT, note, ha="left", va="bottom", fontsize=SMALL
            )
        return self.figure

    # What there is.

    def _latex(self, *names: str) -> str:
        known = [self.rig.symbols[n].latex for n in names if n in self.rig.parameters]
        return "$" + r",\,".join(known) + "$" if known else ""

    def _links(self) -> Iterator[_Link]:
        grounds = count(1)
        for shaft in self.roles.shafts:
            first, second = (f"{n} {next(grounds)}" if n == GROUND else n for n in shaft.ends)
            above, below = self._latex(shaft.stiffness), self._latex(shaft.damping)
            if above:
                yield _Link((first, second), above, below, _plain(shaft.words), damped=bool(below))
        for inertia in self.inertias:
            alike = [i for i in self.inertias if i.speed == inertia.speed]
            root = next((i for i in alike if i.reduction == 1.0), alike[0])
            if inertia is not root:
                ratio = root.reduction / inertia.reduction
                turns = f"{ratio:.4g} : 1" if abs(ratio) >= 1 else f"1 : {1 / ratio:.4g}"
                below = self._latex(inertia.efficiency)
                yield _Link((inertia.name, root.name), turns, below, "gear", ratio)

    def _part(self, inertia: InertiaRoles) -> _Part:
        rig, symbols = self.rig, self.rig.symbols
        moves = [inertia.latex or symbols[inertia.angle].latex]
        moves.append(rf"\dot {moves[0]}")
        driven = list(self._drives(inertia))
        above = (*driven, self._latex(inertia.inertia), f"${moves[0]},\\,{moves[1]}$")
        rubs = (inertia.damping, inertia.friction, inertia.sliding, inertia.static, inertia.fading)
        named = [
            n
            for n in (*rubs, *inertia.cutting, inertia.weight, inertia.tilt)
            if n in rig.parameters
        ]
        below = [self._latex(*named[k : k + 2]) for k in range(0, len(named), 2)]
        return _Part(
            inertia.name,
            tuple(filter(None, above)),
            (*below, _plain(inertia.words)),
            pushed=bool(driven),
            driven=any(rig.symbols[n].drives for n in self._inputs(inertia)),
            held=any(name in rig.parameters for name in rubs),
        )

    def _inputs(self, inertia: InertiaRoles) -> list[str]:
        motor = self.roles.motor(inertia.name)
        inputs = [inertia.torque, inertia.load, inertia.bit_weight]
        inputs += [inertia.speed] * (inertia.reduction == 1.0)
        inputs += [motor.voltage, motor.current] if motor else []
        return [name for name in inputs if name in self.rig.inputs]

    def _drives(self, inertia: InertiaRoles) -> Iterator[str]:
        """Yield what drives an inertia, and what its circuit has."""
        rig, motor = self.rig, self.roles.motor(inertia.name)
        shown = [rig.symbols[name].latex for name in self._inputs(inertia)]
        if shown:
            yield "$" + r",\,".join(shown) + "$"
        if motor and shown:
            names = (motor.torque_constant, motor.back_emf, motor.resistance, motor.series)
            known = [n for n in (*names, motor.inductance, motor.drop) if n in rig.parameters]
            yield from (self._latex(*known[k : k + 3]) for k in range(0, len(known), 3))

    # Where it is.

    def _rows(self) -> list[_Row]:
        rows: list[_Row] = []
        remaining = list(self.parts)
        while remaining:
            reached = self._longest(remaining[0], set(remaining))
            path = self._longest(reached[-1], set(remaining))
            driven = [k for k, name in enumerate(path) if self.parts[name].driven]
            if driven and min(driven) > len(path) - 1 - max(driven):
                path = path[::-1]
            rows += self._branch(None, path, set(remaining))
            placed = {name for row in rows for name in row.parts}
            remaining = [name for name in remaining if name not in placed]
        return rows

    def _neighbours(self, name: str) -> list[str]:
        ends = [link.ends for link in self.links if name in link.ends]
        return list(dict.fromkeys(b if a == name else a for a, b in ends))

    def _longest(self, start: str, free: set[str]) -> list[str]:
        """Return the longest way from a part over others that are free, each by its shortest way."""
        ways = {start: [start]}
        for name in (pending := [start]):
            for other in self._neighbours(name):
                if other in free and other not in ways:
                    ways[other] = [*ways[name], other]
                    pending.append(other)
        return max(ways.values(), key=len)

    def _branch(self, behind: str | None, path: list[str], free: set[str]) -> list[_Row]:
        """Return the row of a path, and rows of what branches off, that from its end first."""
        for name, other in pairwise([*([behind] if behind else []), *path]):
            self.between[other] = [link for link in self.links if {*link.ends} == {name, other}]
        free -= {*path}
        others: list[_Row] = []
        for name in reversed(path):
            for other in self._neighbours(name):
                if other in free:
                    others += self._branch(name, self._longest(other, free - {name}), free)
        folded = [path] if others or behind else self._folded(path)
        first = [_Row(behind, folded[0])]
        first += [_Row(last[-1], more, folded=True) for last, more in pairwise(folded)]
        return [*first, *others]

    def _folded(self, path: list[str]) -> list[list[str]]:
        """Return a chain in pieces that are no wider than a page."""
        pieces: list[list[str]] = [[]]
        widths = [self._slot(name) + self._width(name) for name in path]
        limit, width = sum(widths) / np.ceil(sum(widths) / FOLDED) + 0.01, 0.0
        for name, more in zip(path, widths, strict=True):
            if pieces[-1] and width + 0.5 * more > limit:
                pieces.append([])
                width = 0.0
            pieces[-1].append(name)
            width += more
        return pieces

    def _measure(self, *lines: str) -> float:
        """Return the width of the widest of some texts."""
        texts = [self.sheet.text(0, 0, line) for line in lines if line]
        widths = [text.get_window_extent().width / self.figure.dpi for text in texts]
        for text in texts:
            text.remove()
        return max(widths, default=0.0)

    def _width(self, name: str) -> float:
        part, body = self.parts[name], CART[0] if self.linear else 0.16
        return max(self._measure(*part.above, *part.below), body, 0.3) + 2 * PAD

    def _slot(self, name: str) -> float:
        """Return the width of the links that lead to a part from the one before it."""
        links = self.between.get(name, [])
        texts = [text for link in links for text in (link.above, link.below, link.name)]
        return max(SPRING, self._measure(*texts) + 2 * PAD) if links else 0.0

    def _reach(self, row: _Row, side: str) -> float:
        """Return how far a row reaches from its height."""
        lines = [
            len(self.parts[n].above if side == "above" else self.parts[n].below) for n in row.parts
        ]
        drives = side == "above" and any(self.parts[name].pushed for name in row.parts)
        stacked = max((len(self.between.get(n, [])) for n in row.parts), default=1)
        links = 0.5 * BESIDE_EACH_OTHER * stacked if stacked > 1 else 0.0
        return max(HALF_DISC + 0.18 + LINE_HEIGHT * max(lines) + 0.3 * drives, links)

    def _place(self, row: _Row) -> float:
        """Place the parts of a row, and return where it ends."""
        x = 0.1
        if row.behind is not None and not row.folded:
            x = self.at[row.behind][0] + self._width(row.behind) / 2
        for name in row.parts:
            x += self._slot(name) + self._width(name) / 2
            self.at[name] = (x, row.y)
            x += self._width(name) / 2
        return x + 0.1

    # How it is drawn.

    def _body(self, name: str) -> float:
        """Return half of the width of what is drawn of a part."""
        if name.startswith(GROUND):
            return 0.0
        return CART[0] / 2 if self.linear else 0.08

    def _draw_row(self, row: _Row) -> None:
        before = row.behind
        for name in row.parts:
            x, y = self.at[name]
            left = x - self._width(name) / 2
            if before is not None:
                begins = left - self._slot(name)
                self._join(before, row, (begins, y))
                self._draw_links(name, begins, left, y)
                _wire(self.sheet, (left, y), (x - self._body(name), y))
            self._draw_part(self.parts[name], x, y, first=name == row.parts[0] and not before)
            before = name

    def _join(self, before: str, row: _Row, end: Point) -> None:
        """Draw the line from a part to the links that lead on from it."""
        x, y = self.at[before]
        begin = (x + self._body(before), y)
        if y == end[1]:
            _wire(self.sheet, begin, end)
            return
        out = x + self._width(before) / 2
        way = [begin, (out, y), (out, end[1]), end]
        if row.folded:
            middle = end[1] + self._reach(row, "above") + 0.06
            way = [begin, (out, y), (out, middle), (end[0], middle), end]
        _wire(self.sheet, *way)

    def _draw_links(self, name: str, left: float, right: float, y: float) -> None:
        links, middle = self.between.get(name, []), (left + right) / 2
        middles = np.arange(len(links)) - (len(links) - 1) / 2
        heights = [y + BESIDE_EACH_OTHER * float(x) for x in middles]
        for end in (left, right) if len(links) > 1 else ():
            _wire(self.sheet, (end, heights[0]), (end, heights[-1]))
        for link, height in zip(links, heights, strict=True):
            if link.ratio is None:
                _spring(self.sheet, left, right, height, damped=link.damped)
            else:
                times = 1 / link.ratio if link.ends[1] == name else link.ratio
                _wheels(self.sheet, abs(times), left, right, height)
            top, bottom = (0.25, -0.25) if link.damped else (0.19, -0.19)
            top, bottom = (0.34, -0.34) if link.ratio else (top, bottom)
            _text(self.sheet, middle, height + top, link.above)
            lines = [(link.below, {}), (link.name, {"fontsize": SMALL})]
            for k, (text, font) in enumerate(lines if link.below else lines[1:]):
                _text(self.sheet, middle, height + bottom - k * 0.17, text, **font)

    def _draw_part(self, part: _Part, x: float, y: float, *, first: bool) -> None:
        sheet = self.sheet
        if part.name.startswith(GROUND):
            _wall(sheet, x, y, -1 if first else 1)
            return
        top, bottom = HALF_DISC, -HALF_DISC
        if self.linear:
            top, bottom = CART[1] / 2, -CART[1] / 2 - 0.12
            _box(sheet, x, y, *CART, **SOLID)
            for side in (-1, 1):
                sheet.add_patch(Circle((x + side * 0.18, y + bottom + 0.06), 0.06, **HOLLOW))
        else:
            _box(sheet, x, y, 0.16, top - bottom, **SOLID)
        if part.held or self.linear:
            _ground(sheet, x, y + bottom, -1)
        height = y + top + 0.14
        if part.pushed:
            _arrow(sheet, (x, height + 0.2), (x, height - 0.1))
            height += 0.3
        for line in part.above:
            _text(sheet, x, height, line)
            height += LINE_HEIGHT
        height = y + bottom - 0.2
        for line in part.below:
            _text(sheet, x, height, line, fontsize=None if line.startswith("$") else SMALL)
            height -= LINE_HEIGHT


def _plain(words: str) -> str:
    return words.removeprefix("the ")


def _spring(sheet: Axes, left: float, right: float, y: float, *, damped: bool) -> None:
    """Draw a spring, and beside it a damper where it has one."""
    height = y + 0.08 if damped else y
    start, end = left + 0.08, right - 0.08
    along = np.array([0, 2, 3, 5, 7, 9, 11, 12, 14]) / 14
    teeth = 0.06 * np.array([0, 0, 1, -1, 1, -1, 1, 0, 0])
    _wire(sheet, *zip(start + (end - start) * along, height + teeth, strict=True))
    _wire(sheet, (left, y), (start, y))
    _wire(sheet, (end, y), (right, y))
    if damped:
        low, middle = y - 0.08, (start + end) / 2
        for x in (start, end):
            _wire(sheet, (x, low), (x, height))
        _wire(sheet, (start, low), (middle, low))
        _wire(sheet, (middle, low - 0.045), (middle, low + 0.045))
        _wire(sheet, (middle + 0.06, low), (end, low))
        cup = ((middle - 0.08, low + 0.06), (middle + 0.06, low + 0.06))
        _wire(sheet, *cup, (middle + 0.06, low - 0.06), (middle - 0.08, low - 0.06))


def _wheels(sheet: Axes, times: float, left: float, right: float, y: float) -> None:
    """Draw two wheels that mesh, the first `times` as large as the other, as far as can be seen."""
    times = float(np.clip(times, 1 / 3, 3.0))
    first, middle = 0.26 * times / (1 + times), (left + right) / 2
    second = 0.26 - first
    touch = middle - 0.26 + 2 * first
    for x, radius in ((touch - first, first), (touch + second, second)):
        sheet.add_patch(Circle((x, y), radius, **SOLID))
        sheet.add_patch(Circle((x, y), 0.025, **HOLLOW))
    _wire(sheet, (left, y), (touch - 2 * first, y))
    _wire(sheet, (touch + 2 * second, y), (right, y))


def _wall(sheet: Axes, x: float, y: float, side: int) -> None:
    """Draw what does not move: a line across, and strokes away from it."""
    _wire(sheet, (x, y - 0.2), (x, y + 0.2))
    for start in np.linspace(-0.2, 0.14, 6):
        _wire(sheet, (x, y + start), (x + side * 0.06, y + start + 0.06))
