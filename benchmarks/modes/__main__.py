"""Run puzzles and print a table: `python -m benchmarks.modes [--only NAME ...] [--grid]`."""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from benchmarks.modes import collection, judge, report


def arguments(given: Sequence[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.modes", description=__doc__)
    parser.add_argument("--only", nargs="+", metavar="NAME", help="puzzles, or kinds of them")
    parser.add_argument("--grid", action="store_true", help="the true masses alone, without a run")
    parser.add_argument("--finer", type=int, default=1, help="times as many cells to begin with")
    parser.add_argument("--list", action="store_true", help="name the puzzles and stop")
    return parser.parse_args(given)


def main(given: Sequence[str] | None = None) -> int:
    options = arguments(given)
    chosen = collection.chosen(options.only)
    if options.list:
        print(*(f"{one.name:20} {one.kind:10} {one.shows}" for one in chosen), sep="\n")
        return 0
    failed = 0
    print(report.head(), flush=True)
    for puzzle in chosen:
        with tempfile.TemporaryDirectory() as folder:
            if options.grid:
                posterior = puzzle.load(Path(folder)).job.problem.posterior
                known = puzzle.modes(posterior, options.finer)
                print(report.of_grid(puzzle, posterior.space.free, known), flush=True)
                continue
            outcome = judge.run(puzzle, Path(folder), options.finer)
        failed += not outcome.passed
        print(report.line(outcome), flush=True)
    if not options.grid:
        print(f"{len(chosen) - failed} of {len(chosen)} did what they should")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
