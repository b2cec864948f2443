"""Define the results of a case: maximum, candidate models, sampled posterior, and its report."""

from __future__ import annotations

import io
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayesdrill.analysis.causes import Cause
from bayesdrill.analysis.run_analysis import RunAnalysis
from bayesdrill.analysis.verdict import Verdict
from bayesdrill.api import arguments
from bayesdrill.basics.arrays import Array
from bayesdrill.basics.equality import Value
from bayesdrill.basics.errors import InputError, short_repr
from bayesdrill.basics.progress import SILENT, Reporter
from bayesdrill.config import job
from bayesdrill.config.job import Job
from bayesdrill.report.map_report import MapReport
from bayesdrill.report.publish import FIGURES, drawings
from bayesdrill.report.run_report import sections
from bayesdrill.report.section import as_markdown, as_text
from bayesdrill.report.sections.causes import describe_causes
from bayesdrill.report.sections.convergence import describe_map
from bayesdrill.report.sections.parameters import as_record
from bayesdrill.report.view import Drawing, ReportContext
from bayesdrill.sampling.ensembles import SamplingResult
from bayesdrill.sampling.evidence import Evidence
from bayesdrill.sampling.mode_search import Mode
from bayesdrill.sampling.workers import WorkerPool
from bayesdrill.tasks import conclusions, find_map, pipeline
from bayesdrill.tasks.conclusions import SampledRun

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from xarray import DataTree


DPI = 200  # resolution of figures in notebooks, enough for most screens


def for_notebooks(figure: Figure) -> Figure:
    """Give a figure the method that shows it at the end of a notebook cell; return the figure."""
    # Notebooks show figures by themselves only if pyplot is loaded; this package never loads it.
    figure._repr_png_ = partial(_as_png, figure)  # type: ignore[attr-defined]
    return figure


def _as_png(figure: Figure) -> bytes:
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=DPI)
    return out.getvalue()


def _drawing(drawings: Sequence[Drawing], part: int, count: str, warning: str) -> Figure:
    """Return drawing number `part`, from 1; if there is none, the message ends with `count`."""
    from bayesdrill.report.style import warned  # late: matplotlib takes a second

    if not 1 <= part <= len(drawings):
        raise InputError.at("part", f"{short_repr(part)} given, and {count}")
    return for_notebooks(warned(drawings[part - 1].drawn(), warning))


@arguments.check_arguments
@dataclass(frozen=True, eq=False, repr=False)
class Best(Value):
    """A best fit is the maximum of the posterior (MAP); `case.find_map()` returns one.

    `print` shows its values and residuals.  Look at `reasons` and `plot()` before sampling: if
    the model does not fit, its posterior means nothing.

    Parameters
    ----------
    job : Job
        The config with its record.
    mode : Mode
        The highest maximum, lower maxima, and the searches that found them.
    columns : mapping of str to array, shape (T,), optional
        The record as arrays, if it is not in a file.

    Examples
    --------
    >>> best = case.find_map(quick=True)
    >>> bool(0.25 < best.values["k_s"] < 0.35)
    True
    >>> best.reasons
    ()
    """

    job: Job
    mode: Mode
    columns: Mapping[str, Array] | None = None

    @property
    def values(self) -> Mapping[str, float]:
        """Return the value of each unknown at the maximum, in SI."""
        return self.mode.values

    @property
    def table(self) -> str:
        """Return a text table of the values, the nominal values, and each channel's residuals."""
        return self._report.text

    @property
    def reasons(self) -> tuple[str, ...]:
        """Return the reasons not to believe the maximum, such as a bad fit; empty if none."""
        return self._report.reasons

    @cached_property
    def _report(self) -> MapReport:
        return find_map.report(self.job, self.mode)

    def candidates(
        self, *, processes: int | None = 1, report: Reporter | None = None
    ) -> Candidates:
        """Rank models that would explain the residuals; each model is fitted from this maximum.

        Parameters
        ----------
        processes, report
            See `Case.sample`.

        Returns
        -------
        Candidates
            The models, the recommended model first; empty if the residuals look like the noise.
        """
        workers, job = arguments.workers(processes), self.job.with_steps_at(self.mode)
        if not self._report.warning:
            workers = 1  # after a good fit few models are tried; to start workers would take longer
        with WorkerPool(self.job.problem.posterior, workers) as pool:
            how = job, self.mode, self._report.residuals, pool.submit_function, report or SILENT
            causes = conclusions.causes(*how)
        ranked, best = ((), None) if causes is None else (causes.ranked, causes.best)
        return Candidates(ranked, describe_causes(causes), best, self.job)

    def plot(self, part: int = 1) -> Figure:
        """Draw the record, the model at the maximum, and the residuals.

        Parameters
        ----------
        part : int
            The number of the experiment, counted from 1.

        Returns
        -------
        Figure
            A Matplotlib figure without a window: save it, or make it the last line of a cell.

        Raises
        ------
        InputError
            If the case has no experiment with this number.

        Examples
        --------
        >>> figure = case.find_map(quick=True).plot()
        >>> figure.savefig("fit.png")
        """
        drawings = list(self._report.figures.values())
        count = f"there are {len(drawings)} experiments"
        return _drawing(drawings, part, count, self._report.warning)

    @staticmethod
    def check_place(folder: str | Path, *, force: bool = False) -> None:
        """Raise `InputError` if a maximum cannot be saved in `folder`; call it before searches."""
        find_map.check_place(Path(folder).expanduser(), force=force)

    def save(self, folder: str | Path, *, force: bool = False) -> Path:
        """Save the values, predictions, fit and config, like the command `bayesdrill map --output`.

        Parameters
        ----------
        folder : str or path
            The folder, which is created if it does not exist.
        force : bool
            Whether to replace an earlier maximum.

        Returns
        -------
        path
            The folder.

        Raises
        ------
        InputError
            If the folder has other contents, or an earlier maximum and `force` is false.
        """
        path = Path(folder).expanduser()
        find_map.save(self.job, self.mode, path, _as_record(self.columns), force=force)
        return path

    def __str__(self) -> str:
        return f"{self.table}\n\n{describe_map(self.mode, self.job.problem.units)}"


@arguments.check_arguments
@dataclass(frozen=True, eq=False, repr=False)
class Candidates(Value):
    """Candidates are models that would explain the residuals; `case.candidates()` returns them.

    Parameters
    ----------
    ranked : tuple of Cause
        The models, the recommended model first; empty if the config fits.  Each has `parts`, a
        text `about` them, the `lines` to add to a config, and the `fit` of each channel.  `gain`
        is the increase of the log posterior, and `bayes` the log Bayes factor (Laplace's method).
    table : str
        A text table of the models.
    recommended : Cause or None
        The simplest of the most probable models; None if no model can be trusted.
    job : Job
        The config with its record.
    """

    ranked: tuple[Cause, ...]
    table: str
    recommended: Cause | None
    job: Job

    def apply(self, path: str | Path, *, force: bool = False) -> Path | None:
        """Write a copy of the config with the lines of the recommended model.

        Parameters
        ----------
        path : str or path
            The new config.
        force : bool
            Whether to replace an existing file.

        Returns
        -------
        path or None
            The new config; None if no model is recommended.

        Raises
        ------
        InputError
            If the file exists and `force` is false, or if no file contains the record.
        """
        target = Path(path).expanduser()
        if self.recommended is None:
            return None
        find_map.write_config(self.job, self.recommended, target, force=force)
        return target

    def __str__(self) -> str:
        return self.table or "the residuals look like the noise, so no other model is tried"


@arguments.check_arguments
@dataclass(frozen=True, eq=False, repr=False)
class Run(arguments.ExperimentPlanner, SampledRun):
    """A run is a sampled posterior; `case.sample` and `bd.open` return one.

    `print` shows its report.  Look at `converged` and `judge()` before using `draws`.

    Parameters
    ----------
    job : Job
        The config with its record.
    mode : Mode
        The maxima at which the ensembles started.
    sampled : SamplingResult
        The chains and their convergence.
    columns : mapping of str to array, shape (T,), optional
        The record as arrays, if it is not in a file.
    stored : RunAnalysis, optional
        The analysis, if it was read from the folder of the run.

    Examples
    --------
    >>> run.converged
    True
    >>> sorted(run.draws)
    ['k_s', 't_f']
    >>> bool(0.29 < run.draws["k_s"].mean() < 0.33)
    True
    """

    sampled: SamplingResult
    columns: Mapping[str, Array] | None = None

    @property
    def converged(self) -> bool:
        """Return whether R-hat, effective sample size and chain length met their targets."""
        return self.sampled.convergence.converged

    @property
    def draws(self) -> dict[str, Array]:
        """Return the nearly independent draws of each unknown in SI, `(ensembles, draws)`."""
        return {name: self.sampled.draws[..., d] for d, name in enumerate(self.job.problem.names)}

    def _known_draws(self) -> Array:
        """Return all posterior draws of the D unknowns, `(N, D)`."""
        return self.sampled.draws.reshape(-1, self.sampled.draws.shape[-1])

    @property
    def evidence(self) -> Evidence | None:
        """Return the evidence: `log_z` (natural logarithm) with its standard `error`, or None."""
        return self.sampled.evidence

    @property
    def analysis(self) -> RunAnalysis:
        """Return all numbers of the report; `RunAnalysis.describe` gives their units."""
        return self._view.analysis

    def judge(self) -> RunReport:
        """Compare the posterior with the nominal values.

        Returns
        -------
        RunReport
            The verdict, the reasons not to believe the run, and the report, which `print` shows.

        Examples
        --------
        >>> run.judge().verdict.agrees
        False
        """
        return RunReport(self._view)

    @cached_property
    def _view(self) -> ReportContext:
        return conclusions.concluded(self)

    def to_arviz(self) -> DataTree:
        """Return the draws as an ArviZ data tree.

        Returns
        -------
        DataTree
            The groups of the ArviZ schema; each ensemble is a chain.

        Examples
        --------
        >>> run.to_arviz()["posterior"]["k_s"].dims
        ('chain', 'draw')
        """
        return self._view.tree

    def plot(self, name: str, part: int = 1) -> Figure:
        """Draw a figure of this run by its name.

        Parameters
        ----------
        name : str
            `corner`, `trace`, `prior_posterior`, `fit`; with a verdict also `invariants`, `ridge`.
        part : int
            The number of the experiment, counted from 1.

        Returns
        -------
        Figure
            A Matplotlib figure without a window: save it, or make it the last line of a cell.

        Raises
        ------
        InputError
            If this run has no such figure.

        Examples
        --------
        >>> run.plot("prior_posterior").savefig("prior_posterior.pdf")
        """
        arguments.known(FIGURES, name, "plot", "figure")
        drawn = list(drawings(name, self._view).values())
        if not drawn:
            raise InputError.at("plot", f"there is nothing to draw in a figure {name} of this run")
        return _drawing(drawn, part, f"the figure {name} has {len(drawn)}", self._view.warning)

    def plot_corner(self) -> Figure:
        """Draw the corner plot: a histogram of each unknown, and contours of each pair of unknowns.

        Returns
        -------
        Figure
            See `plot`.
        """
        return self.plot("corner")

    def save(self, folder: str | Path, *, force: bool = False) -> Path:
        """Save the tables, figures, chain and config, like the command `bayesdrill posterior`.

        If results could not be made, a Python warning names them.

        Parameters
        ----------
        folder : str or path
            The folder, which is created if it does not exist.
        force : bool
            Whether to replace earlier results.

        Returns
        -------
        path
            The folder.

        Raises
        ------
        InputError
            If the folder has other contents, or earlier results and `force` is false.
        """
        path = Path(folder).expanduser()
        record = _as_record(self.columns)
        done = pipeline.write_result(self.job, self._view, path, record, force=force)
        if done.missing:
            message = f"could not be made: {'; '.join(done.missing)}; other results are in {path}"
            warnings.warn(message, stacklevel=3)
        return path

    def __str__(self) -> str:
        return self.judge().text

    def _repr_markdown_(self) -> str:
        return self.judge()._repr_markdown_()

    __repr__ = __str__


@arguments.check_arguments
@dataclass(frozen=True, eq=False, repr=False)
class RunReport(Value):
    """A report has the tables and the verdict of a run; `run.judge()` returns one.

    Parameters
    ----------
    view : ReportContext
        The analysis, the draws and the config of the run.

    Examples
    --------
    >>> [row["name"] for row in run.judge().rows]
    ['k_s', 't_f']
    >>> run.judge().reasons
    ()
    """

    view: ReportContext

    @property
    def verdict(self) -> Verdict | None:
        """Return the verdict on the nominal values; None if no unknown has a nominal value."""
        judgement = self.view.analysis.judged
        return None if judgement is None else judgement.verdict

    @property
    def rows(self) -> list[dict[str, Any]]:
        """Return a mapping per unknown that summarises it, for example for a data frame."""
        return [as_record(row) for row in self.view.analysis.unknowns]

    @property
    def reasons(self) -> tuple[str, ...]:
        """Return the reasons not to believe the run, such as no convergence or a bad fit."""
        return self.view.reasons

    @property
    def text(self) -> str:
        """Return the whole report as text, with its tables."""
        return "\n\n".join(as_text(sections(self.view)))

    def __str__(self) -> str:
        return self.text

    def _repr_markdown_(self) -> str:
        brief = [section for section in sections(self.view) if section.brief]
        return as_markdown(self.view.config.name, brief)


def _as_record(columns: Mapping[str, Array] | None) -> str | None:
    return None if columns is None else job.arrays_as_csv(columns)


@arguments.check_arguments
def open(folder: str | Path) -> Run:
    """Open a run that `Run.save` or `bayesdrill posterior` saved; nothing is sampled again.

    Parameters
    ----------
    folder : str or path
        The folder of the run.

    Returns
    -------
    Run
        The run; `print` shows its report.

    Raises
    ------
    InputError
        If `folder` has no finished run.

    Examples
    --------
    >>> folder = run.save("results/mine")
    >>> sorted(bd.open(folder).draws)
    ['k_s', 't_f']
    """
    result = pipeline.read_result(Path(folder).expanduser())
    return Run(result.job, result.mode, result.sampled, stored=result.stored)
