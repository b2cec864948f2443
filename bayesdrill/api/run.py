"""What comes out of a case: a maximum, a sampled posterior, a verdict, and figures for notebooks."""

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
from bayesdrill.basics.errors import InputError, short_repr
from bayesdrill.basics.progress import SILENT, Reporter
from bayesdrill.basics.values import Value, check_arguments
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


DPI = 200  # sharp on a screen


def for_notebooks(figure: Figure) -> Figure:
    """Let a figure show itself as the last line of a cell."""
    # A notebook asks a figure for its picture only once pyplot is loaded, which nothing here does.
    figure._repr_png_ = partial(_as_png, figure)  # type: ignore[attr-defined]
    return figure


def _as_png(figure: Figure) -> bytes:
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=DPI)
    return out.getvalue()


def _drawn(drawings: Sequence[Drawing], part: int, count: str, warning: str) -> Figure:
    """The one of this number, from 1; raises `InputError`, with the `count`, where there is none."""
    from bayesdrill.report.style import warned  # late: matplotlib takes a second

    if not 1 <= part <= len(drawings):
        raise InputError.at("part", f"{short_repr(part)} given, and {count}")
    return for_notebooks(warned(drawings[part - 1].drawn(), warning))


@check_arguments
@dataclass(frozen=True, eq=False)
class Best(Value):
    """The maximum of the posterior (MAP); made by `case.find_map()`, and shown by `print`.

    `columns`: the record `(T,)` each, where it is in no file.
    """

    job: Job
    mode: Mode
    columns: Mapping[str, Array] | None = None

    @property
    def values(self) -> Mapping[str, float]:
        """The value of each unknown at the maximum, SI."""
        return self.mode.values

    @property
    def table(self) -> str:
        """The values beside the nominal ones, and what the fit leaves, as text."""
        return self._report.text

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why it must not be believed: it does not fit; empty where it may be."""
        return self._report.reasons

    @cached_property
    def _report(self) -> MapReport:
        return find_map.report(self.job, self.mode)

    def candidates(
        self, *, processes: int | None = 1, report: Reporter | None = None
    ) -> Candidates:
        """Rank models that would explain what the fit leaves, each refitted from this maximum.

        `processes`, `report`: see `Case.sample`.
        """
        with WorkerPool(self.job.problem.posterior, arguments.workers(processes)) as pool:
            progress = report or SILENT
            job = self.job.with_steps_at(self.mode)
            left, submit = conclusions.residuals(job, self.mode), pool.submit_function
            causes = conclusions.causes(job, self.mode, left, submit, progress)
        ranked, best = ((), None) if causes is None else (causes.ranked, causes.best)
        return Candidates(ranked, describe_causes(causes), best, self.job)

    def plot(self, part: int = 1) -> Figure:
        """Draw the record, the model at the maximum, and what is left.

        `part`: which experiment, from 1; raises `InputError` where there is no such one.
        """
        drawings = list(self._report.figures.values())
        count = f"there are {len(drawings)} experiments"
        return _drawn(drawings, part, count, self._report.warning)

    @staticmethod
    def check_place(folder: str | Path, *, force: bool = False) -> None:
        """Raise `InputError` where a maximum could not be saved, before minutes of searches."""
        find_map.check_place(Path(folder).expanduser(), force=force)

    def save(self, folder: str | Path, *, force: bool = False) -> Path:
        """Save values, prediction, fit and config, as `bayesdrill map --output` does.

        Raises `InputError` where something else is there, or a maximum and not `force`.
        """
        path = Path(folder).expanduser()
        find_map.save(self.job, self.mode, path, _as_record(self.columns), force=force)
        return path

    def __str__(self) -> str:
        return f"{self.table}\n\n{describe_map(self.mode, self.job.problem.units)}"

    __repr__ = __str__


@check_arguments
@dataclass(frozen=True, eq=False, repr=False)
class Candidates(Value):
    """Models of a record beside the config as given, the recommended first; none where it fits.

    Of each: `parts`, `about`, the `lines` of a config that say so, `gain` of the log posterior, `bayes`,
    the log Bayes factor by Laplace's approximation, and the `fit` of each channel.  `table`: in words.
    `recommended`: the simplest that can be trusted; None where there is none.
    """

    ranked: tuple[Cause, ...]
    table: str
    recommended: Cause | None
    job: Job

    def apply(self, path: str | Path, *, force: bool = False) -> Path | None:
        """Write the config with the lines of the recommended candidate; None where there is none.

            case.candidates().apply("mine_2.yaml")

        Raises `InputError` where a file is there, unless by `force`, or the record is in no file.
        """
        target = Path(path).expanduser()
        if self.recommended is None:
            return None
        find_map.write_config(self.job, self.recommended, target, force=force)
        return target

    def __str__(self) -> str:
        return self.table or "the fit leaves what looks like the noise: nothing more is tried"

    __repr__ = __str__


@check_arguments
@dataclass(frozen=True, eq=False, repr=False)
class Run(SampledRun):
    """A sampled posterior: draws, what they say, and figures of them.

        run = bd.open("results/mine")
        run.draws["k_s"].mean(), run.plot_corner(), run.to_arviz()

    Made by `case.sample` or `bd.open`.  `columns`: the record `(T,)` each, where it is in no file;
    `kept`: its analysis, where its folder has it.
    """

    sampled: SamplingResult
    columns: Mapping[str, Array] | None = None

    @property
    def converged(self) -> bool:
        """Whether the ensembles agree, and there are as many effective draws as were asked for."""
        return self.sampled.convergence.converged

    @property
    def draws(self) -> dict[str, Array]:
        """Nearly independent draws of each unknown, `(ensembles, draws)`, SI."""
        return {name: self.sampled.draws[..., d] for d, name in enumerate(self.job.problem.names)}

    @property
    def evidence(self) -> Evidence | None:
        """How probable the record is under the model: `log_z` and its standard `error`."""
        return self.sampled.evidence

    @property
    def analysis(self) -> RunAnalysis:
        """Every number of the report by name; `describe` of `RunAnalysis` gives the unit of each.

        It is evaluated once, and read where the folder of the run has it.
        """
        return self._view.analysis

    def judge(self) -> RunReport:
        """Judge what fit and draws say of the nominal table; `print` shows the whole report."""
        return RunReport(self._view)

    @cached_property
    def _view(self) -> ReportContext:
        return conclusions.concluded(self)

    def to_arviz(self) -> DataTree:
        """Return the groups of the ArviZ schema, such as for `arviz.summary`; a chain is an ensemble."""
        return self._view.tree

    def plot(self, name: str, part: int = 1) -> Figure:
        """Draw `corner`, `trace`, `prior_posterior`, `fit`, or with a verdict `invariants`, `ridge`.

            run.plot("fit", part=2).savefig("fit.png")

        In no window: `figure.savefig(...)`, or the last line of a cell.  `part`: of which experiment,
        where there are several.  Raises `InputError` where this run has no such figure.
        """
        arguments.known(FIGURES, name, "plot", "figure")
        drawn = list(drawings(name, self._view).values())
        if not drawn:
            raise InputError.at("plot", f"there is nothing to draw in a figure {name} of this run")
        return _drawn(drawn, part, f"the figure {name} has {len(drawn)}", self._view.warning)

    def plot_corner(self) -> Figure:
        """Draw the corner plot: each unknown, and each pair of them."""
        return self.plot("corner")

    def save(self, folder: str | Path, *, force: bool = False) -> Path:
        """Save tables, figures, chain and config, as `bayesdrill posterior` does.

        Raises `InputError` where something else is there, or results and not `force`; warns of what
        could not be made.
        """
        path = Path(folder).expanduser()
        record = _as_record(self.columns)
        done = pipeline.write_result(self.job, self._view, path, record, force=force)
        if done.missing:
            message = f"could not be made: {'; '.join(done.missing)}; all else is in {path}"
            warnings.warn(message, stacklevel=3)
        return path

    def __str__(self) -> str:
        return self.judge().text

    def _repr_markdown_(self) -> str:
        return self.judge()._repr_markdown_()

    __repr__ = __str__


@check_arguments
@dataclass(frozen=True, eq=False)
class RunReport(Value):
    """The report of a run: what its fit and draws say of the nominal values."""

    view: ReportContext

    @property
    def verdict(self) -> Verdict | None:
        """The verdict; None where no unknown has a nominal value to be compared with."""
        judgement = self.view.analysis.judged
        return None if judgement is None else judgement.verdict

    @property
    def rows(self) -> list[dict[str, Any]]:
        """A record for each unknown, for a table of any kind."""
        return [as_record(row) for row in self.view.analysis.unknowns]

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why nothing of it must be believed: no convergence, or no fit; empty where it may be."""
        return self.view.reasons

    @property
    def text(self) -> str:
        """The whole report in words and tables."""
        return "\n\n".join(as_text(sections(self.view)))

    def __str__(self) -> str:
        return self.text

    def _repr_markdown_(self) -> str:
        brief = [section for section in sections(self.view) if section.brief]
        return as_markdown(self.view.config.name, brief)

    __repr__ = __str__


def _as_record(columns: Mapping[str, Array] | None) -> str | None:
    return None if columns is None else job.arrays_as_csv(columns)


@check_arguments
def open(folder: str | Path) -> Run:
    """Open the run that `save` or `bayesdrill posterior` left; raises `InputError` without one.

        run = bd.open("results/mine")

    Nothing is sampled again, and `print(run)` shows its report.
    """
    result = pipeline.read_result(Path(folder).expanduser())
    return Run(result.job, result.mode, result.sampled, kept=result.kept)
