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
from bayesdrill.basics.errors import InputError, short_repr
from bayesdrill.basics.progress import Reporter
from bayesdrill.basics.values import Value, check_arguments
from bayesdrill.config.job import Job
from bayesdrill.report.comparison_report import ComparisonReport
from bayesdrill.report.section import as_markdown
from bayesdrill.tasks import comparison

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from bayesdrill.results.run_folder import WriteMode
    from bayesdrill.tasks.ladder import LadderOutcome
    from bayesdrill.tasks.remote import RefitExecutor


MOST = 9  # models that a ladder samples


@check_arguments
@dataclass(frozen=True, slots=True, eq=False)
class Ladder(ManyFits["LadderOutcome"]):
    """The model of a config, and candidates with more physics, of which the likeliest are sampled.

    Candidates are ranked at their maxima; the first `sample` are sampled and compared.  What `run`
    returns has the `decision` in its `report`, and its `config` is what to go on with; rungs that
    are done are kept where it is stopped.
    """

    job: Job
    sample: int = 2

    kind: ClassVar[str] = "ladder"

    def _run(
        self, path: Path, how: WriteMode, crew: RefitExecutor, report: Reporter
    ) -> LadderOutcome:
        from bayesdrill.tasks import ladder

        return ladder.ladder(self.job, path, how, crew, report, self.sample)


@check_arguments
def ladder(config: str | Path, *, sample: int = 2) -> Ladder:
    """Prepare a ladder of models of a config; raises `InputError` with all that is wrong with it.

        bd.ladder("my_rig.yaml").run()

    `sample`: how many models are sampled, 2 to 9.
    """
    if not 2 <= sample <= MOST:
        raise InputError.at("sample", f"{short_repr(sample)} is no whole number from 2 to {MOST}")
    return Ladder(load(Path(config).expanduser()).job, sample)


@check_arguments
@dataclass(frozen=True, eq=False, repr=False)
class Comparison(Value):
    """Several runs side by side; of models of one record, which is the more probable.

    Made by `bd.overlay` or `bd.compare`; `print` shows it.  `runs`: where each is, None where it
    is in no folder.
    """

    report: ComparisonReport
    runs: tuple[Path | None, ...]

    @property
    def rows(self) -> tuple[OverlayRow, ...]:
        """A row for each unknown: where each run has it, SI, and how far apart they are, in sds."""
        return self.report.rows

    @property
    def models(self) -> tuple[RunSummary, ...]:
        """For each run `evidence`, `left` (by its fit), `held_out` and `loo`; empty of an overlay."""
        return self.report.models

    @property
    def decision(self) -> ModelDecision | None:
        """The decision: a `word` (model, noise, both, either, priors, neither) and the `best` model."""
        return self.report.decision

    @property
    def best(self) -> str | None:
        """The name of the most probable model."""
        return None if self.report.best is None else self.report.best.name

    @property
    def log_evidence(self) -> dict[str, float]:
        """The log evidence by the names of models, without a unit."""
        return {model.name: model.log_z for model in self.models}

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why a run of an overlay, or the best model, must not be believed; empty where all may be."""
        return self.report.reasons

    @property
    def text(self) -> str:
        """The whole comparison in words and tables."""
        return self.report.text

    def plot(self, name: str | None = None) -> Figure:
        """Draw a figure: of an overlay `corner` or `intervals`, of models `comparison`.

        The last shows log odds, what each model leaves of each channel, and where it has each unknown.
        Raises `InputError` where there is no such figure.
        """
        wanted = self.report.form.figure if name is None else name
        figure = arguments.known(self.report.figures, wanted, "plot", "figure of these runs")
        return for_notebooks(figure.drawn())

    def place(self, folder: str | Path | None = None) -> Path:
        """Return where `save` leaves its results, by default a folder in `results/` with all names."""
        names = [layer.name for layer in self.report.layers]
        default = comparison.default_folder(self.report.form, names)
        return arguments.results_folder(folder, default)

    def save(self, folder: str | Path | None = None, *, force: bool = False) -> Path:
        """Save table, page and figures, and return their folder.

        Raises `InputError` where something else is there, or a comparison and not `force`.
        """
        path = self.place(folder)
        comparison.publish(self.report, self.runs, path, force=force)
        return path

    def __str__(self) -> str:
        return self.text

    def _repr_markdown_(self) -> str:
        brief = [section for section in self.report.sections if section.brief]
        return as_markdown(self.report.title, brief)

    __repr__ = __str__


Overlay = Comparison


@check_arguments
def overlay(
    runs: Sequence[single.Run | str | Path], names: Sequence[str] | None = None
) -> Comparison:
    """Lay two runs or more side by side, of any records, priors and rigs.

        bd.overlay(["results/slow", run]).plot()

    `runs`: in memory, or their folders.
    `names`: by default those of the folders and cases.  Raises `InputError`.
    """
    return _compared("overlay", runs, names)


@check_arguments
def compare(
    runs: Sequence[single.Run | str | Path], names: Sequence[str] | None = None
) -> Comparison:
    """Compare two runs or more of one record: which model is the more probable.

        bd.compare(["results/rigid", "results/elastic"]).decision

    `runs`: in memory, or their folders; the first is what the others are held against.  `names`:
    by default those of the folders and cases. Raises `InputError`, also where records are not the
    same.
    """
    return _compared("comparison", runs, names)


def _compared(
    form: str, runs: Sequence[single.Run | str | Path], names: Sequence[str] | None
) -> Comparison:
    places = [None if isinstance(run, single.Run) else Path(run).expanduser() for run in runs]
    given = [run if place is None else place for run, place in zip(runs, places, strict=True)]
    comparison.check_runs(comparison.FORMS[form], given)
    if names is not None and len(names) != len(runs):
        raise InputError.at("names", f"{len(names)} names of {len(runs)} runs")
    opened = [run if isinstance(run, single.Run) else single.open(run) for run in runs]
    defaults = [
        run.job.config.name if place is None else place.resolve().name
        for run, place in zip(opened, places, strict=True)
    ]
    distinct = comparison.distinct([str(name) for name in names or defaults])
    named = list(map(comparison.NamedRun, distinct, places, opened))
    return Comparison(comparison.report(comparison.FORMS[form], named), tuple(places))


@check_arguments
def check_folder(
    form: str,
    folders: Sequence[str | Path],
    output: str | Path | None = None,
    *,
    force: bool = False,
) -> Path:
    """Return where the `overlay` or `comparison` of these would be saved.

    Raises `InputError` where it cannot be.
    """
    places = [Path(folder).expanduser() for folder in folders]
    comparison.check_runs(comparison.FORMS[form], places)
    names = comparison.distinct([path.resolve().name for path in places])
    default = comparison.default_folder(comparison.FORMS[form], names)
    target = arguments.results_folder(output, default)
    comparison.check_folder(comparison.FORMS[form], target, places, force=force)
    return target
