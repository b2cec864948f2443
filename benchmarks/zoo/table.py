"""What is kept of measured rows, `docs/figures/zoo.csv`: a line for each run, by the name of its row."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from bayesdrill.output_files import atomic_write
from benchmarks.zoo.judge import Agreement, Outcome

HEAD = (
    "row", "what", "expected", "run", "status", "passed", "complaints", "unknowns", "samples", "wall_s",
    "map_s", "sampling_s", "report_s", "converged", "steps", "tau", "tau_of", "acceptance_least",
    "acceptance_most", "ess_bulk", "ess_per_s", "seeds_distance", "seeds_of", "seeds_limit",
    "weights_draws", "weights_share", "weights_distance", "weights_of", "weights_limit", "maxima",
    "maxima_weights", "shares", "fit_worst_rms", "reasons",
)  # fmt: skip
SOUND = "sound"


@dataclass(frozen=True, slots=True)
class Measured:
    """A row of the zoo as it was measured: the lines of its runs."""

    runs: tuple[Mapping[str, str], ...]

    def said(self, what: str) -> str:
        """What all of its runs have alike."""
        return self.runs[0][what]

    def numbers(self, what: str) -> list[float]:
        """Of each run that has such a number."""
        return [float(run[what]) for run in self.runs if run[what] not in ("", "nan")]

    @property
    def name(self) -> str:
        return self.said("row")

    @property
    def passed(self) -> bool:
        return self.said("passed") == str(True)

    @property
    def sound(self) -> bool:
        return self.said("expected") == SOUND


def measured(outcome: Outcome) -> Measured:
    numbers = range(len(outcome.runs))
    lines = [map(str, _values(outcome, number)) for number in numbers]
    return Measured(tuple(dict(zip(HEAD, line, strict=True)) for line in lines))


def read(path: Path) -> list[Measured]:
    """In the order of the file; none where there is no such file."""
    if not path.exists():
        return []
    found = dict[str, list[Mapping[str, str]]]()
    with path.open(newline="", encoding="utf-8") as file:
        for line in csv.DictReader(file):
            found.setdefault(line["row"], []).append(line)
    return [Measured(tuple(lines)) for lines in found.values()]


def merged(
    before: Sequence[Measured], now: Sequence[Measured], names: Sequence[str]
) -> list[Measured]:
    """Of those `names`, in their order, what was measured last."""
    last = {one.name: one for one in (*before, *now)}
    return [last[name] for name in names if name in last]


def save(every: Sequence[Measured], path: Path) -> None:
    with atomic_write(path) as aside, aside.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, HEAD, lineterminator="\n")
        writer.writeheader()
        for one in every:
            writer.writerows(one.runs)


def _values(outcome: Outcome, number: int) -> list[object]:
    row, run = outcome.row, outcome.runs[number]
    slowest = max(run.tau, key=lambda name: run.tau[name], default="")
    own = run.importance
    return [
        row.name, row.shows, SOUND if row.sound else row.reason, number + 1,
        "" if run.status is None else run.status,
        outcome.passed, "; ".join(outcome.complaints), len(run.mean), outcome.samples,
        f"{run.wall:.2f}", *(run.seconds.get(name, "") for name in ("map", "sampling", "report")),
        run.converged, run.steps, run.tau.get(slowest, ""), slowest,
        min(run.acceptance, default=""), max(run.acceptance, default=""),
        run.ess, f"{run.rate:.1f}", *_parts(outcome.seeds),
        "" if own is None else own.draws, "" if own is None else own.share,
        *_parts(outcome.importance),
        len(run.maxima), " ".join(f"{one['weight']:.4f}" for one in run.maxima),
        " ".join(f"{share:.4f}" for share in outcome.shares[number]) if outcome.shares else "",
        max((one["rms"] for one in run.fit), default=""), "; ".join(run.reasons),
    ]  # fmt: skip


def _parts(agreement: Agreement | None) -> tuple[object, ...]:
    if agreement is None:
        return "", "", ""
    return f"{agreement.worst:.3f}", agreement.name, f"{agreement.limit:.3f}"
