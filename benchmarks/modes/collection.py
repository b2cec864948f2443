"""All puzzles."""

from __future__ import annotations

from collections.abc import Sequence

from benchmarks.modes import aliases, delays, friction, gaps, mixed, signs
from benchmarks.modes.puzzle import Puzzle


def every() -> tuple[Puzzle, ...]:
    return (
        *gaps.puzzles(),
        *delays.puzzles(),
        *aliases.puzzles(),
        *friction.puzzles(),
        *signs.puzzles(),
        *mixed.puzzles(),
    )


def chosen(names: Sequence[str] | None) -> tuple[Puzzle, ...]:
    """By their names or kinds; ValueError where there is none."""
    if not names:
        return every()
    found = tuple(one for one in every() if {one.name, one.kind} & set(names))
    if unknown := set(names) - {n for one in found for n in (one.name, one.kind)}:
        raise ValueError(f"no puzzle or kind is called {', '.join(sorted(unknown))}")
    return found
