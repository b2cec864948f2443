"""Draw any rig from its roles: inertias, shafts, gears, ground and drives.

Inertias and fixed ends of shafts are parts; shafts and gears are links between parts. The longest
chain of parts is the first row; branches of the chain are rows below it.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from itertools import batched, count, pairwise
from pathlib import Path

import numpy as np

from bayesdrill.basics import software
from bayesdrill.report import scales, style
from bayesdrill.report.canvas import HOLLOW, SMALL, SOLID, Canvas, Point
from bayesdrill.report.section import build
from bayesdrill.report.style import Figure
from bayesdrill.report.view import Drawing, ReportContext, ReportPart
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.models.roles import GROUND, ROTARY, InertiaRoles, MotorRoles

# Lengths in inches.
PAD, LINE_HEIGHT, SPRING, DISC = 0.1, 0.19, 0.62, (0.16, 0.8)
CART = (0.62, 0.4)
BESIDE_EACH_OTHER = 1.0  # distance of parallel shafts between the same inertias
FOLDED = 1.1 * scales.DOUBLE  # width in inches beyond which a chain continues in another row
# Heights of the motor above its inertia, of its circuit, and of the symbols above the circuit.
MACHINE, MESH, SYMBOLS = 0.62, 0.66, 0.34
GOAL = 0.3  # length of the arrow from the goal to the controller of a servo


@dataclass(frozen=True, slots=True)
class _Link:
    """The link is a shaft, or a gear with its `ratio`; a shaft with `label_below` has a damper."""

    ends: tuple[str, str]
    label_above: str
    label_below: str
    name: str
    ratio: float | None = None


@dataclass(frozen=True, slots=True)
class _Part:
    """The part is an inertia or the ground; labels are listed from the nearest to the farthest."""

    name: str
    labels_above: tuple[str, ...] = ()
    labels_below: tuple[str, ...] = ()
    pushed: bool = False  # an arrow shows an input, whose symbol is the nearest label above
    driven: bool = False  # one of its inputs drives the rig
    is_grounded: bool = False  # damping or friction connects it to the ground
    circuit: MotorRoles | None = None  # circuit of a voltage or a servo, drawn above the part


@dataclass(slots=True)
class _Row:
    """The row has parts from left to right; it may be linked to a `parent` in a row above."""

    parent: str | None
    parts: list[str]
    folded: bool = False  # continues the chain of the row above
    y: float = 0.0


def rig_figure(rig: Model, channels: Collection[str] = ()) -> Figure:
    """Draw any rig; with `channels`, a note says which states are measured."""
    with style.styled():
        return _RigDrawing(rig).draw(channels)


def save_rig(rig: Model, path: Path) -> Path:
    """Draw any rig and save it at `path`, in the format of the file's ending."""
    note = {"Title": f"rig {rig.name}", "Creator": software.creator()}
    (written,) = style.save(
        rig_figure(rig), path.parent, path.stem, note, formats=(path.suffix[1:],)
    )
    return written


def _draw_rig(run: ReportContext) -> Drawing | None:
    says = "The rig: its inertias, with shafts, gears and drives."
    rig = run.problem.model
    return Drawing(rig_figure, (rig,), says) if rig.has_private_names else None


class _RigDrawing:
    """The drawing arranges the parts of a rig in rows: the longest chain first, then branches."""

    def __init__(self, rig: Model) -> None:
        self.rig, self.roles = rig, rig.roles
        self.linear = self.roles.motion != ROTARY
        self.body, self.height = CART if self.linear else DISC
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
        self.sheet = Canvas(1.0)
        self.between: dict[str, list[_Link]] = {}
        self.at: dict[str, Point] = {}

    def draw(self, channels: Collection[str]) -> Figure:
        """Lay out all parts, and draw them on a page that fits."""
        rows = self._rows()
        shown = [link for links in self.between.values() for link in links]
        notes = [
            f"{link.label_above} {link.label_below} ({link.name}) between {' and '.join(link.ends)}"
            for link in self.links
            if link not in shown
        ]
        if channels:
            measured = self._formula([n for n in self.rig.states if n in channels])
            others = self._formula([n for n in self.rig.states if n not in channels])
            notes.append(f"measured: {measured or 'none'}; not measured: {others or 'none'}")
        height, width = 0.1 + LINE_HEIGHT * len(notes), self._measure(*notes) + 0.2
        for row in reversed(rows):
            height += self._reach(row, "below")
            row.y = height
            height += self._reach(row, "above") + 0.12
        for row in rows:
            width = max(width, self._place(row))
        figure = self.sheet.figure
        figure.set_size_inches(max(width, 2.0), height)
        self.sheet.axes.set(xlim=(0, max(width, 2.0)), ylim=(0, height))
        for row in rows:
            self._draw_row(row)
        for k, note in enumerate(notes):
            y = 0.1 + k * LINE_HEIGHT
            self.sheet.write(0.1, y, note, ha="left", va="bottom", fontsize=SMALL)
        return figure

    # Parts of the drawing.

    def _formula(self, names: Sequence[str]) -> str:
        known = [self.rig.symbols[name].latex for name in names if name]
        return "$" + r",\,".join(known) + "$" if known else ""

    def _latex(self, *names: str) -> str:
        return self._formula([n for n in names if n in self.rig.parameters])

    def _links(self) -> Iterator[_Link]:
        grounds = count(1)
        for shaft in self.roles.shafts:
            first, second = (f"{n} {next(grounds)}" if n == GROUND else n for n in shaft.ends)
            above, below = self._latex(shaft.stiffness), self._latex(shaft.damping)
            if above:
                yield _Link((first, second), above, below, shaft.words.removeprefix("the "))
        for inertia in self.inertias:
            coupled = [i for i in self.inertias if i.speed == inertia.speed]
            root = next((i for i in coupled if i.reduction == 1.0), coupled[0])
            if inertia is not root:
                ratio = root.reduction / inertia.reduction
                turns = f"{ratio:.4g} : 1" if abs(ratio) >= 1 else f"1 : {1 / ratio:.4g}"
                below = self._latex(inertia.efficiency, inertia.efficiency_back)
                yield _Link((inertia.name, root.name), turns, below, "gear", ratio)

    def _part(self, inertia: InertiaRoles) -> _Part:
        rig, motor, inputs = self.rig, self.roles.motor(inertia.name), self._inputs(inertia)
        circuit = motor if motor and {motor.voltage, motor.goal} & {*inputs} else None
        sources = (circuit.voltage, circuit.goal, circuit.supply) if circuit else ()
        pushes = [name for name in inputs if name not in sources]
        constant = self._latex(motor.torque_constant) if motor and pushes and not circuit else ""
        angle = inertia.latex or rig.symbols[inertia.angle].latex
        turns = rf"${angle},\,\dot {angle}$"
        above = [self._formula(pushes), constant, self._latex(inertia.inertia), turns]
        rubs = (inertia.damping, inertia.friction, inertia.sliding, inertia.static, inertia.fading)
        backwards = (inertia.damping_back, inertia.sliding_back, inertia.static_back)
        others = (*backwards, inertia.drag, *inertia.cutting, inertia.weight, inertia.tilt)
        known = [name for name in (*rubs, *others) if name in rig.parameters]
        below = [self._latex(*pair) for pair in batched(known, 2)]
        if circuit:  # a circuit takes all the room above
            above, below = [], [*reversed(above), *below]
        return _Part(
            inertia.name,
            tuple(filter(None, above)),
            (*filter(None, below), inertia.words.removeprefix("the ")),
            pushed=bool(pushes) and not circuit,
            driven=any(rig.symbols[n].drives for n in inputs),
            is_grounded=any(name in rig.parameters for name in rubs),
            circuit=circuit,
        )

    def _inputs(self, inertia: InertiaRoles) -> list[str]:
        motor = self.roles.motor(inertia.name)
        inputs = [inertia.torque, inertia.load, inertia.bit_weight]
        inputs += [inertia.speed] * (not inertia.latex)  # an imposed speed is an input, not a state
        inputs += [motor.voltage, motor.current, motor.goal, motor.supply] if motor else []
        return [name for name in inputs if name in self.rig.inputs]

    def _series(self, motor: MotorRoles) -> list[str]:
        names = (motor.resistance, motor.series, motor.inductance, motor.drop)
        return [name for name in names if name in self.rig.parameters]

    def _law(self, motor: MotorRoles) -> list[str]:
        """Return the symbols of a servo's controller, two to a line."""
        law = (motor.duty, motor.proportional, motor.derivative)
        names = (*law, motor.limit, motor.band, motor.goal_speed)
        known = [name for name in names if name in self.rig.parameters]
        return [self._latex(*pair) for pair in batched(known, 2)]

    # Positions of the parts.

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
        """Return the longest of the shortest paths from the part `start` to the parts in `free`."""
        ways = {start: [start]}
        for name in (pending := [start]):
            for other in self._neighbours(name):
                if other in free and other not in ways:
                    ways[other] = [*ways[name], other]
                    pending.append(other)
        return max(ways.values(), key=len)

    def _branch(self, behind: str | None, path: list[str], free: set[str]) -> list[_Row]:
        """Return the row of a path, then the rows of its branches, those at the path's end first."""
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
        """Split a chain into pieces of about equal widths, as few as fit a page."""
        widths = np.array([self._slot(name) + self._width(name) for name in path])
        n = int(np.ceil(widths.sum() / FOLDED))
        pieces = (n * (np.cumsum(widths) - 0.5 * widths) / widths.sum()).astype(int)
        return [[p for p, k in zip(path, pieces, strict=True) if k == row] for row in range(n)]

    def _measure(self, *lines: str) -> float:
        texts = [self.sheet.axes.text(0, 0, line) for line in lines if line]
        widths = [text.get_window_extent().width / self.sheet.figure.dpi for text in texts]
        for text in texts:
            text.remove()
        return max(widths, default=0.0)

    def _width(self, name: str) -> float:
        part = self.parts[name]
        mesh = self._mesh(part.circuit) + 0.36 if part.circuit else 0.3
        if part.circuit and part.circuit.goal:
            # A part is centred in its width, so a text on one side of the part counts twice.
            goal = self._measure(self._formula([part.circuit.goal])) + GOAL
            mesh += 2 * max(goal, self._measure(*self._law(part.circuit)) - PAD)
        return max(self._measure(*part.labels_above, *part.labels_below), self.body, mesh) + 2 * PAD

    def _mesh(self, motor: MotorRoles) -> float:
        series = self._series(motor)
        inside = self._formula([motor.voltage or motor.supply, motor.current])
        each = max(0.42, self._measure(*map(self._latex, series)) + PAD)
        return max(1.2, len(series) * each, self._measure(inside) + 0.6)

    def _slot(self, name: str) -> float:
        links = self.between.get(name, [])
        texts = [text for link in links for text in (link.label_above, link.label_below, link.name)]
        return max(SPRING, self._measure(*texts) + 2 * PAD) if links else 0.0

    def _reach(self, row: _Row, side: str) -> float:
        parts = [self.parts[name] for name in row.parts]
        lines = [len(part.labels_above if side == "above" else part.labels_below) for part in parts]
        drives = side == "above" and any(part.pushed for part in parts)
        words = 0.18 + LINE_HEIGHT * max(lines) + 0.3 * drives
        if side == "above" and any(part.circuit for part in parts):
            words = max(words, MACHINE + MESH + SYMBOLS)
        stacked = max((len(self.between.get(n, [])) for n in row.parts), default=1)
        links = 0.5 * BESIDE_EACH_OTHER * stacked if stacked > 1 else 0.0
        return max(DISC[1] / 2 + words, links)

    def _place(self, row: _Row) -> float:
        x = 0.1
        if row.parent is not None and not row.folded:
            x = self.at[row.parent][0] + self._width(row.parent) / 2
        for name in row.parts:
            x += self._slot(name) + self._width(name) / 2
            self.at[name] = (x, row.y)
            x += self._width(name) / 2
        return x + 0.1

    # Shapes and lines of the parts.

    def _edge(self, name: str, side: int) -> Point:
        """Return the point where the body of a part ends at its left (-1) or right (1) side."""
        x, y = self.at[name]
        return (x + side * (0.0 if name.startswith(GROUND) else self.body / 2), y)

    def _draw_row(self, row: _Row) -> None:
        before = row.parent
        for name in row.parts:
            x, y = self.at[name]
            left = x - self._width(name) / 2
            if before is not None:
                begins = left - self._slot(name)
                self._join(before, row, (begins, y))
                self._draw_links(name, begins, left, y)
                self.sheet.wire((left, y), self._edge(name, -1))
            self._draw_part(self.parts[name], x, y, first=name == row.parts[0] and not before)
            before = name

    def _join(self, before: str, row: _Row, end: Point) -> None:
        x, y = self.at[before]
        out, turns = x + self._width(before) / 2, []
        if row.folded and y != end[1]:
            middle = end[1] + self._reach(row, "above") + 0.06
            turns = [(out, y), (out, middle), (end[0], middle)]
        elif y != end[1]:
            turns = [(out, y), (out, end[1])]
        self.sheet.wire(self._edge(before, 1), *turns, end)

    def _draw_links(self, name: str, left: float, right: float, y: float) -> None:
        links, middle = self.between.get(name, []), (left + right) / 2
        middles = np.arange(len(links)) - (len(links) - 1) / 2
        heights = [y + BESIDE_EACH_OTHER * float(x) for x in middles]
        for end in (left, right) if len(links) > 1 else ():
            self.sheet.wire((end, heights[0]), (end, heights[-1]))
        for link, height in zip(links, heights, strict=True):
            if link.ratio is None:
                _spring(self.sheet, left, right, height, damped=bool(link.label_below))
                away = 0.25 if link.label_below else 0.19
            else:
                times = 1 / link.ratio if link.ends[1] == name else link.ratio
                _wheels(self.sheet, abs(times), left, right, height)
                away = 0.34
            self.sheet.write(middle, height + away, link.label_above)
            lines = [(link.label_below, {}), (link.name, {"fontsize": SMALL})]
            for k, (text, font) in enumerate(lines if link.label_below else lines[1:]):
                self.sheet.write(middle, height - away - k * 0.17, text, **font)

    def _draw_part(self, part: _Part, x: float, y: float, *, first: bool) -> None:
        sheet = self.sheet
        if part.name.startswith(GROUND):
            _wall(sheet, x, y, -1 if first else 1)
            return
        top, bottom = self.height / 2, -self.height / 2 - 0.12 * self.linear
        sheet.box(x, y, self.body, self.height, **SOLID)
        for wheel in (-0.18, 0.18) if self.linear else ():
            sheet.circle(x + wheel, y + bottom + 0.06, 0.06, **HOLLOW)
        if part.is_grounded or self.linear:
            sheet.ground(x, y + bottom)
        if part.circuit:
            self._draw_circuit(part.circuit, x, y + top)
        height = y + top + 0.14
        if part.pushed:
            sheet.arrow((x, height + 0.2), (x, height - 0.1))
            height += 0.3
        for line in part.labels_above:
            sheet.write(x, height, line)
            height += LINE_HEIGHT
        height = y + bottom - 0.2
        for line in part.labels_below:
            sheet.write(x, height, line, fontsize=None if line.startswith("$") else SMALL)
            height -= LINE_HEIGHT

    def _draw_circuit(self, motor: MotorRoles, x: float, top: float) -> None:
        sheet, series, width = self.sheet, self._series(motor), self._mesh(motor)
        left, right, low, high = x - width / 2, x + width / 2, top + MACHINE, top + MACHINE + MESH
        middle, radius = (low + high) / 2, 0.17
        sheet.wire((left, high), (left, middle + radius))
        sheet.wire((left, middle - radius), (left, low), (x - radius, low))
        sheet.wire((x + radius, low), (right, low), (right, high))
        ends = np.linspace(left, right, len(series) + 1).tolist()
        for name, (begin, end) in zip(series, pairwise(ends), strict=True):
            if name in (motor.resistance, motor.series):
                _spring(sheet, begin, end, high, damped=False)
            else:
                sheet.wire((begin, high), (end, high))
                fill = {"facecolor": style.BLACK} if name == motor.inductance else {}
                sheet.box((begin + end) / 2, high, 0.22, 0.09, zorder=2, **HOLLOW | fill)
            sheet.write((begin + end) / 2, high + 0.19, self._latex(name))
        if motor.goal:
            sheet.box(left, middle, 2 * radius, 2 * radius, **HOLLOW)
            sheet.write(left, middle, "PD" if motor.derivative in self.rig.parameters else "P")
            sheet.arrow((left - radius - GOAL, middle), (left - radius, middle))
            goal = self._formula([motor.goal])
            sheet.write(left - radius - GOAL - 0.04, middle, goal, ha="right")
            for k, line in enumerate(self._law(motor)):
                sheet.write(left - 0.1, middle - 0.29 - k * LINE_HEIGHT, line, ha="right")
        else:
            sheet.circle(left, middle, radius, **HOLLOW)
            sheet.write(left, middle, "$+$\n$-$", linespacing=0.6)
        sheet.circle(x, low, radius, **HOLLOW)
        sheet.write(x, low, "M")
        sheet.arrow((right, high), (right, middle - 0.1))
        sheet.arrow((x, low - radius), (x, top + 0.04))
        source = self._formula([motor.voltage or motor.supply])
        sheet.write(left + 0.23, middle, source, ha="left")
        sheet.write(right - 0.1, middle, self._formula([motor.current]), ha="right")
        sheet.write(x - 0.1, low - 0.28, self._latex(motor.torque_constant), ha="right")
        sheet.write(x + 0.22, low - 0.13, self._latex(motor.back_emf), ha="left")


def _spring(sheet: Canvas, left: float, right: float, y: float, *, damped: bool) -> None:
    height = y + 0.08 if damped else y
    start, end = left + 0.08, right - 0.08
    along = np.array([0, 2, 3, 5, 7, 9, 11, 12, 14]) / 14
    teeth = 0.06 * np.array([0, 0, 1, -1, 1, -1, 1, 0, 0])
    sheet.wire(*zip(start + (end - start) * along, height + teeth, strict=True))
    sheet.wire((left, y), (start, y))
    sheet.wire((end, y), (right, y))
    if damped:
        low, middle = y - 0.08, (start + end) / 2
        sheet.wire((start, height), (start, low), (middle, low))
        sheet.wire((middle, low - 0.045), (middle, low + 0.045))
        sheet.wire((middle + 0.06, low), (end, low), (end, height))
        cup = ((middle - 0.08, low + 0.06), (middle + 0.06, low + 0.06))
        sheet.wire(*cup, (middle + 0.06, low - 0.06), (middle - 0.08, low - 0.06))


def _wheels(sheet: Canvas, times: float, left: float, right: float, y: float) -> None:
    """Draw two meshing wheels; the first is `times` as large as the second, limited to 1/3 to 3."""
    times = float(np.clip(times, 1 / 3, 3.0))
    first, middle = 0.26 * times / (1 + times), (left + right) / 2
    second = 0.26 - first
    touch = middle - 0.26 + 2 * first
    for x, radius in ((touch - first, first), (touch + second, second)):
        sheet.circle(x, y, radius, **SOLID)
        sheet.circle(x, y, 0.025, **HOLLOW)
    sheet.wire((left, y), (touch - 2 * first, y))
    sheet.wire((touch + 2 * second, y), (right, y))


def _wall(sheet: Canvas, x: float, y: float, side: int) -> None:
    sheet.wire((x, y - 0.2), (x, y + 0.2))
    for start in np.linspace(-0.2, 0.14, 6):
        sheet.wire((x, y + start), (x + side * 0.06, y + start + 0.06))


PART = ReportPart(
    sections=lambda _, pictures: [build("The rig", *pictures, brief=False)],
    figures={"rig": _draw_rig},
)
