"""Make `docs/paper.md` from its template and the published tables, so that no number is typed.

`python docs/render.py` renders the page, and copies the figures of `results/published/paper`.

In the template `{table_2[0.001,c_m].bound_percent:.2g}` is the cell of the line that has both keys,
and `{table:matrix}` a whole table.
"""

from __future__ import annotations

import csv
import re
from pathlib import Path

from PIL import Image

DOCS = Path(__file__).parent
TEMPLATE, PAGE = DOCS / "paper.template.md", DOCS / "paper.md"
TABLES, FIGURES = DOCS.parent / "results" / "published" / "paper", DOCS / "figures"
PREFIX = "paper_"  # of the names of figures in docs

CELL = re.compile(r"\{(\w+)\[([^\]]+)\]\.(\w+)(?::([^}]*))?\}")
WHOLE = re.compile(r"\{table:(\w+)\}")


def render(template: str, tables: Path) -> str:
    """Raises `LookupError` where a table has not exactly one such line, or no such column."""
    whole = WHOLE.sub(lambda m: (tables / f"{m[1]}.md").read_text().rstrip(), template)
    return CELL.sub(lambda m: _cell(tables, m[1], m[2], m[3], m[4]), whole)


def _cell(tables: Path, stem: str, keys: str, column: str, form: str | None) -> str:
    with (tables / f"{stem}.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    wanted = keys.split(",")
    found = [row for row in rows if all(_has(row, key) for key in wanted)]
    if len(found) != 1:
        raise LookupError(f"{stem}.csv has {len(found)} lines with {keys}")
    if column not in found[0]:
        raise LookupError(f"{stem}.csv has no column {column}, but {', '.join(found[0])}")
    text = found[0][column]
    return format(float(text), form) if form else text


def _has(row: dict[str, str], key: str) -> bool:
    return any(cell == key or _number(cell) == _number(key) for cell in row.values())


def _number(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text


def copy_figures(results: Path) -> None:
    """Copy the figures of a finished `make paper` as PNG in 32 greys."""
    for path in sorted((results / "figures").glob("*.png")):
        grey = Image.open(path).convert("L").quantize(32)
        grey.save(FIGURES / f"{PREFIX}{path.name}", optimize=True)


if __name__ == "__main__":
    copy_figures(TABLES)
    PAGE.write_text(render(TEMPLATE.read_text(), TABLES))
