"""Run the zoo: every row twice by the command line, each run judged and told as it ends.

`make zoo` writes configs and records to `results/zoo/`, runs all of them, and writes the table in
`docs/performance.md` and the figure; with `--only ... --keep` the other rows stay there as they
were measured.  Exit status 1 where a row did not do what it should.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from benchmarks import tables
from benchmarks.zoo import folder, plot, report, rows, runs, table
from benchmarks.zoo.judge import Outcome, judged
from benchmarks.zoo.makers import ROOT
from benchmarks.zoo.row import RANKED, Row
from benchmarks.zoo.table import Measured

SECONDS = 60.0  # that a run may take
PATIENCE = 120.0  # seconds before which no run is stopped


def arguments(given: Sequence[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.zoo", description=__doc__)
    parser.add_argument("--only", nargs="+", metavar="NAME", help="rows of these names")
    parser.add_argument("--quick", action="store_true", help="the quick rows only")
    parser.add_argument("--keep", action="store_true", help="of some rows too what is measured")
    parser.add_argument("--list", action="store_true", help="name the rows and stop")
    parser.add_argument("--write", action="store_true", help="write configs and records and stop")
    parser.add_argument("--seconds", type=float, default=SECONDS, help="that a run may take")
    parser.add_argument("--dry", action="store_true", help="print, but leave docs/ as it is")
    return parser.parse_args(given)


def run(row: Row, seconds: float, place: Path = folder.FOLDER) -> Outcome:
    """Both seeds of a row."""
    seconds = max(seconds, row.seconds, 0.0 if row.fits else RANKED)
    found, shares = [], list[tuple[float, ...]]()
    for number, config in enumerate(folder.write(row, place), start=1):
        output = place / "runs" / f"{row.name}-{number}"
        found.append(runs.start(config, output, max(PATIENCE, 2 * seconds)))
        if row.humps is not None:
            draws = runs.draws(output, found[-1].mean)
            shares.append(row.humps.shares(draws) if draws else ())
    with (place / "records" / f"{row.name}.csv").open(encoding="utf-8") as record:
        samples = sum(1 for _ in record) - 1
    outcome = judged(row, tuple(found), samples, seconds, tuple(shares))
    if outcome.passed:
        for number in (1, 2):
            runs.lighten(place / "runs" / f"{row.name}-{number}")
    return outcome


def outcomes(chosen: Sequence[Row], seconds: float) -> Iterator[Outcome]:
    for row in chosen:
        outcome = run(row, seconds)
        print(report.line(outcome), flush=True)
        yield outcome


def keep(now: Sequence[Measured], seconds: float) -> None:
    """In the table, the page and the figure; rows that were not run stay as they were measured."""
    path, every = tables.FIGURES / "zoo.csv", rows.every()
    told = table.merged(table.read(path), now, [row.name for row in every])
    table.save(told, path)
    names = {one.name for one in told}
    absent = [row for row in every if row.name not in names]
    tables.insert(tables.PAGE, "zoo", report.markdown(told, absent, seconds))
    plot.figure(told, seconds, tables.FIGURES)


def main(given: Sequence[str] | None = None) -> int:
    options = arguments(given)
    try:
        chosen = rows.chosen(options.only, quick=options.quick)
    except ValueError as error:
        print(error, file=sys.stderr)
        return 2
    if options.list:
        print(*report.listed(chosen), sep="\n")
        return 0
    there = [row for row in chosen if row.made.available]
    absent = [row for row in chosen if not row.made.available]
    if options.write:
        for row in there:
            folder.write(row, folder.FOLDER)
        print(f"{len(there)} configs and their records: {folder.FOLDER.relative_to(ROOT)}/")
        return 0
    for row in absent:
        print(f"{row.name}: left out, its record is not there")
    found = list(outcomes(there, options.seconds))
    if (options.keep or len(chosen) == len(rows.every())) and not options.dry:
        keep([table.measured(outcome) for outcome in found], options.seconds)
    failed = [outcome.row.name for outcome in found if not outcome.passed]
    print(f"{len(found) - len(failed)} of {len(found)} rows did what they should")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
