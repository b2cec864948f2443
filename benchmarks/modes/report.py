"""What a run found beside what there is, a line for each puzzle."""

from __future__ import annotations

from benchmarks.modes.grid import Modes
from benchmarks.modes.judge import SHOWN, Outcome
from benchmarks.modes.puzzle import Puzzle


def head() -> str:
    return "name | kind | unknowns | modes | masses on the grid | found | status | CPU s | "


def of_grid(puzzle: Puzzle, unknowns: tuple[str, ...], known: Modes) -> str:
    some = known.above(SHOWN)
    masses = " ".join(f"{x:.3f}" for x in known.masses[some])
    tops = " ".join("/".join(f"{x:.4g}" for x in top) for top in known.tops[some])
    small = f"(+{known.masses[len(some) :].sum():.3f} in {len(known.masses) - len(some)})"
    return (
        f"{puzzle.name} | {puzzle.kind} | {', '.join(unknowns)} | {len(some)} | {masses} {small} | at "
        f"{tops} | {known.evaluations} evaluations"
    )


def line(outcome: Outcome) -> str:
    known, puzzle = outcome.modes, outcome.puzzle
    some = known.above(SHOWN)
    true, found = (" ".join(f"{x:.3f}" for x in of[some]) for of in (known.masses, outcome.found))
    wrong = f"wrong: {len(outcome.missed)} of {len(some)}" if outcome.missed else ""
    wrong += "" if outcome.weighed else " wrong evidence"
    texts = (wrong, *(reason[:90] for reason in outcome.reasons))
    said = ("" if outcome.passed else "FAILS ") + "; ".join(text for text in texts if text)
    names, seconds = ", ".join(outcome.unknowns), f"{outcome.seconds:.1f}"
    cells = (puzzle.name, puzzle.kind, names, str(len(some)), true, found, str(outcome.status))
    return " | ".join((*cells, seconds, said))
