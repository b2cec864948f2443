"""Compare runs: overlays of any runs, evidences of models of one record, and ladders of models."""

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
from bayesdrill.basics.equality import Value
from bayesdrill.basics.errors import InputError, count_noun, short_repr
from bayesdrill.basics.progress import Reporter
from bayesdrill.config.job import Job
from bayesdrill.report.comparison_report import ComparisonReport
from bayesdrill.report.section import as_markdown
from bayesdrill.tasks import comparison

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from bayesdrill.results.run_folder import WriteMode
    from bayesdrill.tasks.ladder import LadderOutcome
    from bayesdrill.tasks.remote import RefitExecutor


MOST = 9  # largest number of models that a ladder may sample


@arguments.check_arguments
@dataclass(frozen=True, slots=True, eq=False)
class Ladder(ManyFits["LadderOutcome"], Value):
    """A ladder compares the model of a config with candidates that have more physics.

    `bd.ladder` makes one.  Candidates are ranked by the maxima of their posteriors, and the best
    candidates are sampled and compared.  The result of `run` has the `config` of the recommended
    model; its `report` has the `decision`.

    Parameters
    ----------
    job : Job
        The config with its record.
    sample : int
        The number of models to sample.
    """

    job: Job
    sample: int = 2

    kind: ClassVar[str] = "ladder"

    def _run(
        self, path: Path, how: WriteMode, crew: RefitExecutor, report: Reporter
    ) -> LadderOutcome:
        from bayesdrill.tasks import ladder

        return ladder.ladder(self.job, path, how, crew, report, self.sample)


@arguments.check_arguments
def ladder(config: str | Path, *, sample: int = 2) -> Ladder:
    """Prepare a ladder of models that begins with a config; `Ladder.run` does the work.

    Parameters
    ----------
    config : str or path
        The config.
    sample : int
        The number of models to sample, from 2 to 9.

    Returns
    -------
    Ladder
        The ladder, before any fit.

    Raises
    ------
    InputError
        With all mistakes in the config and its record.

    Examples
    --------
    >>> bd.ladder("configs/nominal_step.yaml", sample=3).sample
    3
    """
    if not 2 <= sample <= MOST:
        raise InputError.at("sample", f"{short_repr(sample)} is no whole number from 2 to {MOST}")
    return Ladder(load(Path(config).expanduser()).job, sample)


@arguments.check_arguments
@dataclass(frozen=True, eq=False, repr=False)
class Comparison(Value):
    """A comparison shows several runs side by side; `bd.overlay` and `bd.compare` return one.

    `print` shows its tables and, for models of one record, its decision.

    Parameters
    ----------
    report : ComparisonReport
        The compared numbers, tables and figures.
    runs : tuple of path or None
        The folder of each run; None for a run in memory.

    Examples
    --------
    >>> comparison = bd.overlay([run, run], ["a", "b"])
    >>> [round(place.mean, 1) for place in comparison.rows[0].places]  # k_s, N m/rad
    [0.3, 0.3]
    """

    report: ComparisonReport
    runs: tuple[Path | None, ...]

    @property
    def rows(self) -> tuple[OverlayRow, ...]:
        """Return a row per unknown: its estimates, and the largest difference of two estimates."""
        return self.report.rows

    @property
    def models(self) -> tuple[RunSummary, ...]:
        """Return each model with its `evidence`, `residuals`, `held_out` and `loo` scores."""
        return self.report.models

    @property
    def decision(self) -> ModelDecision | None:
        """Return the decision: `word` is its kind, and `best` the index of the best model."""
        return self.report.decision

    @property
    def best(self) -> str | None:
        """Return the name of the most probable model, or None for an overlay."""
        return None if self.report.best is None else self.report.best.name

    @property
    def log_evidence(self) -> dict[str, float]:
        """Return the natural logarithm of the evidence of each model, by the name of the model."""
        return {model.name: model.log_z for model in self.models}

    @property
    def reasons(self) -> tuple[str, ...]:
        """Return the reasons not to believe the runs of an overlay, or the best model."""
        return self.report.reasons

    @property
    def text(self) -> str:
        """Return the whole comparison as text, with its tables."""
        return self.report.text

    def plot(self, name: str | None = None) -> Figure:
        """Draw a figure that compares the runs.

        Parameters
        ----------
        name : str, optional
            For an overlay, `corner` or `intervals`.  For models, `comparison`, with log odds,
            residuals of each channel, and posteriors of each unknown.

        Returns
        -------
        Figure
            A Matplotlib figure without a window: save it, or make it the last line of a cell.

        Raises
        ------
        InputError
            If the comparison has no figure with this name.
        """
        wanted = self.report.form.figure if name is None else name
        figure = arguments.known(self.report.figures, wanted, "plot", "figure of these runs")
        return for_notebooks(figure.drawn())

    def place(self, folder: str | Path | None = None) -> Path:
        """Return the folder for `save`; by default, one in `results/`, named after all runs."""
        names = [layer.name for layer in self.report.layers]
        default = comparison.default_folder(self.report.form, names)
        return arguments.results_folder(folder, default)

    def save(self, folder: str | Path | None = None, *, force: bool = False) -> Path:
        """Save the table, the page and the figures.

        Parameters
        ----------
        folder : str or path, optional
            The folder; by default see `place`.
        force : bool
            Whether to replace an earlier comparison.

        Returns
        -------
        path
            The folder.

        Raises
        ------
        InputError
            If the folder has other contents, or an earlier comparison and `force` is false.
        """
        path = self.place(folder)
        comparison.publish(self.report, self.runs, path, force=force)
        return path

    def __str__(self) -> str:
        return self.text

    def _repr_markdown_(self) -> str:
        brief = [section for section in self.report.sections if section.brief]
        return as_markdown(self.report.title, brief)


Overlay = Comparison


@arguments.check_arguments
def overlay(
    runs: Sequence[single.Run | str | Path], names: Sequence[str] | None = None
) -> Comparison:
    """Show two or more runs side by side; their records, priors and rigs may differ.

    Parameters
    ----------
    runs : sequence of Run, str or path
        The runs, or their folders.
    names : sequence of str, optional
        The names of the runs; by default the names of their folders or cases.

    Returns
    -------
    Comparison
        A row for each unknown, and figures.

    Raises
    ------
    InputError
        If there are fewer than two runs, or a run cannot be opened.

    Examples
    --------
    >>> [row.symbol.name for row in bd.overlay([run, run], ["a", "b"]).rows]
    ['k_s', 't_f']
    """
    return _compared("overlay", runs, names)


@arguments.check_arguments
def compare(
    runs: Sequence[single.Run | str | Path], names: Sequence[str] | None = None
) -> Comparison:
    """Compare models of one record by their evidence (bridge sampling, Meng and Wong 1996).

    The evidence of a model is the likelihood of the record, averaged over the model's priors.
    Wider priors therefore lower the evidence; see `docs/compare.md`.

    Parameters
    ----------
    runs : sequence of Run, str or path
        The runs, or their folders; the first run is the reference model.
    names : sequence of str, optional
        The names of the runs; by default the names of their folders or cases.

    Returns
    -------
    Comparison
        The evidence of each model and a decision.

    Raises
    ------
    InputError
        If there are fewer than two runs, a run cannot be opened, or the records differ.
    """
    return _compared("comparison", runs, names)


def _compared(
    form: str, runs: Sequence[single.Run | str | Path], names: Sequence[str] | None
) -> Comparison:
    places = [None if isinstance(run, single.Run) else Path(run).expanduser() for run in runs]
    given = [run if place is None else place for run, place in zip(runs, places, strict=True)]
    comparison.check_runs(comparison.FORMS[form], given)
    if names is not None and len(names) != len(runs):
        counts = f"{count_noun(len(names), 'name')} for {count_noun(len(runs), 'run')}"
        raise InputError.at("names", counts)
    opened = [run if isinstance(run, single.Run) else single.open(run) for run in runs]
    defaults = [
        run.job.config.name if place is None else place.resolve().name
        for run, place in zip(opened, places, strict=True)
    ]
    distinct = comparison.distinct([str(name) for name in names or defaults])
    named = list(map(comparison.NamedRun, distinct, places, opened))
    return Comparison(comparison.report(comparison.FORMS[form], named), tuple(places))


@arguments.check_arguments
def check_folder(
    form: str,
    folders: Sequence[str | Path],
    output: str | Path | None = None,
    *,
    force: bool = False,
) -> Path:
    """Return the folder in which a comparison of the runs in `folders` would be saved.

    `form` is "overlay" or "comparison".  Raises `InputError` if the folder cannot be used.
    """
    places = [Path(folder).expanduser() for folder in folders]
    comparison.check_runs(comparison.FORMS[form], places)
    names = comparison.distinct([path.resolve().name for path in places])
    default = comparison.default_folder(comparison.FORMS[form], names)
    target = arguments.results_folder(output, default)
    comparison.check_folder(comparison.FORMS[form], target, places, force=force)
    return target
