"""A table of the paper's studies: its records as CSV, and their cells for pages."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from bayesdrill.report import Table as Grid
from bayesdrill.report import markdown, records_as_csv


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """`stem` names its files; `says` is its caption."""

    stem: str
    title: str
    says: str
    csv: str
    grids: tuple[Grid, ...]

    @property
    def markdown(self) -> str:
        """Grids below each other."""
        return "\n".join(map(markdown, self.grids))


def table[T](
    stem: str,
    title: str,
    says: str,
    kind: type[T],
    rows: Sequence[T],
    cells: Callable[[T], Sequence[str]],
    heads: Sequence[str],
    leave: Sequence[str] = (),
) -> Table:
    return Table(
        stem=stem,
        title=title,
        says=says,
        csv=records_as_csv(kind, rows, {}, leave),
        grids=(grid(heads, map(cells, rows)),),
    )


def grid(heads: Sequence[str], lines: Iterable[Sequence[str]]) -> Grid:
    cells = tuple(map(tuple, lines))
    columns = zip(heads, *cells, strict=True) if cells else ()
    words = {head for head, *column in columns if any(_is_text(cell) for cell in column)}
    return Grid(tuple(heads), cells, frozenset({*heads[:1], *words}))


def _is_text(cell: str) -> bool:
    """Words, or a unit; an interval from one number to another is none."""
    return any(letter.isalpha() for letter in cell.replace(" to ", "").replace("e", ""))


def percent(x: float) -> str:
    return f"{x:.2g}" if x < 99.5 else f"{x:.0f}"


def digits(*values: float | None) -> tuple[str, ...]:
    """Empty where there is no number."""
    return tuple("" if value is None else f"{value:.4g}" for value in values)
