"""`docs/figures/architecture.svg`: the floors of the package and who imports whom, read off the code.

    python docs/architecture.py

A test compares the picture with what this would draw.
"""

from __future__ import annotations

import ast
import textwrap
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from html import escape
from pathlib import Path

DOCS = Path(__file__).parent
PACKAGE = DOCS.parent / "bayesdrill"
PICTURE = DOCS / "figures" / "architecture.svg"

ROW, TOP, LEFT, CELL, WIDTH = 58, 74, 20, 44, 620  # px
PER_LINE = 92  # letters
PAPER, INK, PALE, LINE = "#ffffff", "#1a1a1a", "#666666", "#c8c8c8"


@dataclass(frozen=True)
class Floor:
    """`modules`: names below the folder; `imports`: how many modules of each folder they import."""

    name: str
    purpose: str
    modules: tuple[str, ...]
    imports: Mapping[str, int]


def floors(order: Sequence[str]) -> list[Floor]:
    """Of the folders in `order`, from the ground up."""
    return [_floor(name) for name in order]


def _floor(name: str) -> Floor:
    single, folder = PACKAGE / f"{name}.py", PACKAGE / name
    files = [single] if single.exists() else sorted(folder.rglob("*.py"))
    about = single if single.exists() else folder / "__init__.py"
    modules = {file.relative_to(folder).parts[0] for file in files if file not in (single, about)}
    imports: Counter[str] = Counter()
    for file in files:
        imports.update(_folders(file) - {name})
    return Floor(
        name=name,
        purpose=(ast.get_docstring(ast.parse(about.read_text())) or "").splitlines()[0],
        modules=tuple(sorted(map(_title, modules))),
        imports=imports,
    )


def _title(module: str) -> str:
    return module.removesuffix(".py") + ("" if module.endswith(".py") else "/")


@cache
def _folders(file: Path) -> frozenset[str]:
    found = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("bayesdrill."):
            found.add((node.module or "").split(".")[1])
        elif isinstance(node, ast.ImportFrom) and node.module == "bayesdrill":
            found |= {alias.name for alias in node.names if not alias.name.startswith("_")}
    return frozenset(found)


def drawn(found: Sequence[Floor]) -> str:
    """The topmost floor first; in the grid, how many modules of a row import the column's folder."""
    order = list(reversed(found))
    heights = [ROW + 15 * (len(_lines(floor)) - 1) for floor in order]
    grid = LEFT + WIDTH + 16
    width, height = grid + CELL * len(order) + 16, TOP + sum(heights) + 16
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" '
        f'font-family="Helvetica, Arial, sans-serif" font-size="12" fill="{INK}">',
        f'<rect width="{width}" height="{height}" fill="{PAPER}"/>',
        _text(LEFT, 26, "A floor imports only floors below it", 15, bold=True),
        _text(grid, 18, "modules of the row that import from", 11, PALE),
    ]
    for column, floor in enumerate(order):
        x = grid + CELL * column + CELL // 2
        parts.append(
            f'<text x="{x}" y="{TOP - 6}" font-size="11" transform="rotate(-35 {x} {TOP - 6})">'
            f"{escape(floor.name)}</text>"
        )
    y = TOP
    for row, (floor, high) in enumerate(zip(order, heights, strict=True)):
        parts += _row(floor, y, high)
        for column, other in enumerate(order):
            parts.append(_cell(grid + CELL * column, y, high, floor, other, row == column))
        y += high
    return "\n".join([*parts, "</svg>"]) + "\n"


def _row(floor: Floor, y: int, high: int) -> list[str]:
    return [
        f'<rect x="{LEFT}" y="{y + 2}" width="{WIDTH}" height="{high - 4}" fill="none" '
        f'stroke="{LINE}" rx="4"/>',
        _text(LEFT + 10, y + 20, floor.name, 13, bold=True),
        _text(LEFT + 100, y + 20, floor.purpose, 11),
        *(
            _text(LEFT + 10, y + 39 + 15 * k, line, 11, PALE)
            for k, line in enumerate(_lines(floor))
        ),
    ]


def _lines(floor: Floor) -> list[str]:
    return textwrap.wrap(", ".join(floor.modules), PER_LINE) or [""]


def _cell(x: int, y: int, high: int, floor: Floor, other: Floor, own: bool) -> str:
    count = floor.imports.get(other.name, 0)
    shade = "#e8e8e8" if own else "#dbe7f3" if count else PAPER
    text = _text(x + CELL // 2, y + high // 2 + 4, str(count), 11, middle=True) if count else ""
    return (
        f'<rect x="{x}" y="{y + 2}" width="{CELL - 3}" height="{high - 4}" fill="{shade}" rx="3"/>'
        f"{text}"
    )


def _text(
    x: int,
    y: int,
    text: str,
    size: int,
    color: str = INK,
    *,
    bold: bool = False,
    middle: bool = False,
) -> str:
    style = (' font-weight="bold"' if bold else "") + (' text-anchor="middle"' if middle else "")
    place = f'x="{x}" y="{y}" font-size="{size}" fill="{color}"{style}'
    return f"<text {place}>{escape(text)}</text>"


def order() -> list[str]:
    """From the ground up: what imports nothing first, then by how many floors stand below."""
    single = {path.stem for path in PACKAGE.glob("*.py") if not path.stem.startswith("__")}
    names = single | {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    below = {floor.name: set(floor.imports) for floor in floors(sorted(names))}
    found: list[str] = []
    while below:
        ready = sorted(name for name, needs in below.items() if needs <= {*found})
        if not ready:
            raise ValueError(f"these import one another: {', '.join(sorted(below))}")
        found.append(ready[0])
        del below[ready[0]]
    return found


if __name__ == "__main__":
    PICTURE.write_text(drawn(floors(order())))
