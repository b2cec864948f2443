"""All rows of the zoo, in the order of its table."""

from __future__ import annotations

from benchmarks.zoo import beliefs, driven, many, noises, rubs, sensors, steps, trains, unsound
from benchmarks.zoo.row import Row


def every() -> tuple[Row, ...]:
    moved = (*steps.rows(), *driven.rows(), *rubs.rows(), *trains.rows())
    seen = (*sensors.rows(), *noises.rows(), *beliefs.rows(), *many.rows())
    return (*moved, *seen, *unsound.rows())


def chosen(names: list[str] | None = None, *, quick: bool = False) -> tuple[Row, ...]:
    """Those of the names, or the quick ones, or all; ValueError for a name that no row has."""
    rows = every()
    unknown = set(names or ()) - {row.name for row in rows}
    if unknown:
        raise ValueError(f"no row is named {', '.join(sorted(unknown))}; see --list")
    return tuple(
        row for row in rows if (names is None or row.name in names) and (row.quick or not quick)
    )
