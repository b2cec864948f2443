"""Several models of one record, one against the other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from bayesdrill.api import run as single
from bayesdrill.api.overlay import named_runs
from bayesdrill.api.pictures import for_notebooks
from bayesdrill.basics.checked import checked
from bayesdrill.basics.values import Value
from bayesdrill.commands import comparing, overlaying
from bayesdrill.insight.comparison import Contender, Decision
from bayesdrill.insight.overlay import Row
from bayesdrill.report.comparison_report import FIGURE, ComparisonReport
from bayesdrill.report.sections import as_markdown

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@checked
@dataclass(frozen=True, eq=False, repr=False)
class Comparison(Value):
    """What several models say of one record, and which is the more probable.

    `runs`: where each is, None where it is in no folder.
    """

    report: ComparisonReport
    runs: tuple[Path | None, ...]

    @property
    def models(self) -> tuple[Contender, ...]:
        """Of each run its `evidence`, what its fit leaves (`left`), `held_out` and `loo`."""
        return self.report.models

    @property
    def decision(self) -> Decision:
        """`word`: model, noise, both, either, priors or neither; `best`: which of the models."""
        return self.report.decision

    @property
    def best(self) -> str:
        return self.report.best.name

    @property
    def log_evidence(self) -> dict[str, float]:
        return {one.name: one.log_z for one in self.models}

    @property
    def rows(self) -> tuple[Row, ...]:
        """Of each unknown: where each run has it, SI, and how far apart they are, in sds."""
        return self.report.rows

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why the most probable model must not be believed; empty where it may be."""
        return self.report.reasons

    @property
    def text(self) -> str:
        return self.report.text

    def plot(self) -> Figure:
        """Log odds, what each leaves of each channel, and where it has each unknown."""
        return for_notebooks(self.report.figures[FIGURE].drawn())

    def place(self, folder: str | Path | None = None) -> Path:
        """Where `save` leaves its results: `results/compare-<name>-<name>` by default."""
        usual = comparing.usual_place([one.name for one in self.models])
        return usual if folder is None else Path(folder).expanduser()

    def save(self, folder: str | Path | None = None, *, force: bool = False) -> Path:
        """Table, page and figure.

        Raises `InputError` where something else is there, or a comparison and not `force`.
        """
        place = self.place(folder)
        comparing.publish(self.report, self.runs, place, force=force)
        return place

    def __str__(self) -> str:
        return self.text

    def _repr_markdown_(self) -> str:
        brief = [section for section in self.report.sections if section.brief]
        return as_markdown(self.report.title, brief)

    __repr__ = __str__


@checked
def compare(
    runs: Sequence[single.Run | str | Path], names: Sequence[str] | None = None
) -> Comparison:
    """Of two runs or more of one record: runs in memory, or folders of them.

    The first is what the others are held against.  `names`: by default those of the folders and cases.
    Raises `InputError`, also where records are not the same.
    """
    comparing.check_number(len(runs))
    own, opened, places = named_runs(runs, names)
    jobs = [one.job for one in opened]
    where = [name if place is None else str(place) for name, place in zip(own, places, strict=True)]
    comparing.check_same_record(where, [job.problem for job in jobs])
    units = overlaying.units(jobs)
    models = [
        comparing.contender(name, place, one.job, one.mode, one.sampled, units)
        for name, place, one in zip(own, where, opened, strict=True)
    ]
    return Comparison(ComparisonReport(tuple(models), units), tuple(places))


@checked
def check_place(
    folders: Sequence[str | Path], output: str | Path | None = None, *, force: bool = False
) -> Path:
    """Where the comparison of these would be saved; raises `InputError` where it cannot be."""
    comparing.check_number(len(folders))
    places = [Path(folder).expanduser() for folder in folders]
    names = overlaying.distinct([place.resolve().name for place in places])
    target = comparing.usual_place(names) if output is None else Path(output).expanduser()
    comparing.check_place(target, places, force=force)
    return target
