"""Several runs: side by side, as models of one record, and as a ladder of models."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from bayesdrill.analysis.comparison import ModelDecision, OverlayRow, RunSummary
from bayesdrill.api import arguments
from bayesdrill.api import run as single
from bayesdrill.api.arguments import ManyFits
from bayesdrill.api.case import load
from bayesdrill.api.run import for_notebooks
from bayesdrill.basics.errors import InputError, shown
from bayesdrill.basics.progress import Reporter
from bayesdrill.basics.values import Value, checked
from bayesdrill.config.job import Job
from bayesdrill.report.comparison_report import ComparisonReport
from bayesdrill.report.section import as_markdown
from bayesdrill.tasks import comparison

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from bayesdrill.results.run_folder import Mode
    from bayesdrill.tasks.ladder import Outcome
    from bayesdrill.tasks.remote import RefitExecutor


MOST = 9  # models that a ladder samples


@checked
@dataclass(frozen=True, slots=True, eq=False)
class Ladder(ManyFits["Outcome"]):
    """The config as given, and what may be missing from it: candidates ranked at their maxima, of which
    the first `sample` are sampled and compared.

    What `run` returns has the `decision` in its `report`, and its `config` is what to go on with; rungs
    that are done are kept where it is stopped.
    """

    job: Job
    sample: int = 2

    kind: ClassVar[str] = "ladder"

    def _run(self, place: Path, how: Mode, crew: RefitExecutor, report: Reporter) -> Outcome:
        from bayesdrill.tasks import ladder

        return ladder.ladder(self.job, place, how, crew, report, self.sample)


@checked
def ladder(config: str | Path, *, sample: int = 2) -> Ladder:
    """Of a config and its record; raises `InputError` with all that is wrong with them."""
    if not 2 <= sample <= MOST:
        raise InputError.one("sample", f"{shown(sample)} is no whole number from 2 to {MOST}")
    return Ladder(load(Path(config).expanduser()).job, sample)


@checked
@dataclass(frozen=True, eq=False, repr=False)
class Comparison(Value):
    """What several runs say of their unknowns, side by side; of models of one record, which is the more
    probable.

    `runs`: where each is, None where it is in no folder.
    """

    report: ComparisonReport
    runs: tuple[Path | None, ...]

    @property
    def rows(self) -> tuple[OverlayRow, ...]:
        """Of each unknown: where each run has it, SI, and how far apart they are, in sds."""
        return self.report.rows

    @property
    def models(self) -> tuple[RunSummary, ...]:
        """Of each run its `evidence`, what its fit leaves (`left`), `held_out` and `loo`; empty of an
        overlay.
        """
        return self.report.models

    @property
    def decision(self) -> ModelDecision | None:
        """`word`: model, noise, both, either, priors or neither; `best`: which of the models."""
        return self.report.decision

    @property
    def best(self) -> str | None:
        """The name of the most probable model."""
        return None if self.report.best is None else self.report.best.name

    @property
    def log_evidence(self) -> dict[str, float]:
        """By the names of models; a pure number."""
        return {one.name: one.log_z for one in self.models}

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why some run of an overlay, or the most probable model, must not be believed; empty where all
        may be.
        """
        return self.report.reasons

    @property
    def text(self) -> str:
        return self.report.text

    def plot(self, name: str | None = None) -> Figure:
        """Of an overlay its `corner`, or `intervals`; of models their `comparison`: log odds, what each
        leaves of each channel, and where it has each unknown.

        Raises `InputError` where there is no such figure.
        """
        wanted = self.report.form.figure if name is None else name
        found = arguments.known(self.report.figures, wanted, "plot", "figure of these runs")
        return for_notebooks(found.drawn())

    def place(self, folder: str | Path | None = None) -> Path:
        """Where `save` leaves its results: `results/<name>-<name>` by default, of models
        `results/compare-<name>-<name>`.
        """
        names = [layer.name for layer in self.report.layers]
        usual = comparison.default_folder(self.report.form, names)
        return arguments.results_folder(folder, usual)

    def save(self, folder: str | Path | None = None, *, force: bool = False) -> Path:
        """Table, page and figures.

        Raises `InputError` where something else is there, or a comparison and not `force`.
        """
        place = self.place(folder)
        comparison.publish(self.report, self.runs, place, force=force)
        return place

    def __str__(self) -> str:
        return self.text

    def _repr_markdown_(self) -> str:
        brief = [section for section in self.report.sections if section.brief]
        return as_markdown(self.report.title, brief)

    __repr__ = __str__


Overlay = Comparison


@checked
def overlay(
    runs: Sequence[single.Run | str | Path], names: Sequence[str] | None = None
) -> Comparison:
    """Of two runs or more, of any records, priors and rigs: runs in memory, or folders of them.

    `names`: by default those of the folders and cases.  Raises `InputError`.
    """
    return _compared("overlay", runs, names)


@checked
def compare(
    runs: Sequence[single.Run | str | Path], names: Sequence[str] | None = None
) -> Comparison:
    """Of two runs or more of one record: runs in memory, or folders of them.

    The first is what the others are held against.  `names`: by default those of the folders and cases.
    Raises `InputError`, also where records are not the same.
    """
    return _compared("comparison", runs, names)


def _compared(
    form: str, every: Sequence[single.Run | str | Path], names: Sequence[str] | None
) -> Comparison:
    comparison.check_number(comparison.FORMS[form], len(every))
    if names is not None and len(names) != len(every):
        raise InputError.one("names", f"{len(names)} names of {len(every)} runs")
    opened = [one if isinstance(one, single.Run) else single.open(one) for one in every]
    places = [None if isinstance(one, single.Run) else Path(one).expanduser() for one in every]
    usual = [
        run.job.config.name if place is None else place.resolve().name
        for run, place in zip(opened, places, strict=True)
    ]
    distinct = comparison.distinct([str(name) for name in names or usual])
    named = list(map(comparison.NamedRun, distinct, places, opened))
    return Comparison(comparison.report(comparison.FORMS[form], named), tuple(places))


@checked
def check_place(
    form: str,
    folders: Sequence[str | Path],
    output: str | Path | None = None,
    *,
    force: bool = False,
) -> Path:
    """Where the `overlay` or `comparison` of these would be saved.

    Raises `InputError` where it cannot be.
    """
    comparison.check_number(comparison.FORMS[form], len(folders))
    places = [Path(folder).expanduser() for folder in folders]
    names = comparison.distinct([place.resolve().name for place in places])
    usual = comparison.default_folder(comparison.FORMS[form], names)
    target = arguments.results_folder(output, usual)
    comparison.check_folder(comparison.FORMS[form], target, places, force=force)
    return target
