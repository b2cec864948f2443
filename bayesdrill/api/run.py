"""What comes out of a case: a maximum, a sampled posterior, a verdict; with figures as a notebook
gets them.
"""

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
from bayesdrill.basics.errors import InputError, shown
from bayesdrill.basics.progress import SILENT, Reporter
from bayesdrill.basics.values import Value, checked
from bayesdrill.config import job
from bayesdrill.config.job import Job
from bayesdrill.report import section, words
from bayesdrill.report.map_report import MapReport
from bayesdrill.report.publish import FIGURES, drawings
from bayesdrill.report.run_report import sections
from bayesdrill.report.section import as_markdown, as_text
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
    """It shows itself as the last line of a cell."""
    # A notebook asks a figure for its picture only once pyplot is loaded, which nothing here does.
    figure._repr_png_ = partial(_as_png, figure)  # type: ignore[attr-defined]
    return figure


def _as_png(figure: Figure) -> bytes:
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=DPI)
    return out.getvalue()


def _drawn(every: Sequence[Drawing], part: int, count: str, warning: str) -> Figure:
    """The one of this number, from 1; raises `InputError`, with the `count`, where there is none."""
    from bayesdrill.report.style import warned  # late: matplotlib takes a second

    if not 1 <= part <= len(every):
        raise InputError.one("part", f"{shown(part)} given, and {count}")
    return for_notebooks(warned(every[part - 1].drawn(), warning))


@checked
@dataclass(frozen=True, eq=False)
class Best(Value):
    """The maximum of the posterior (MAP) that searches found.

    `columns`: the record `(T,)` each, where it is in no file.
    """

    job: Job
    mode: Mode
    columns: Mapping[str, Array] | None = None

    @property
    def values(self) -> Mapping[str, float]:
        """SI."""
        return self.mode.values

    @property
    def table(self) -> str:
        """Beside the nominal values, and what the fit leaves."""
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
        """What would explain what the fit leaves: candidate models, each refitted from this maximum.

        `processes`, `report`: see `Case.sample`.
        """
        with WorkerPool(self.job.problem.posterior, arguments.workers(processes)) as pool:
            found, said = find_map.explain(
                self.job, self.mode, pool.submit_function, report or SILENT
            )
        return Candidates(found.ranked if found is not None else (), said)

    def plot(self, part: int = 1) -> Figure:
        """The record, the model at the maximum, and what is left; `part`: of which experiment."""
        every = list(self._report.figures.values())
        return _drawn(every, part, f"there are {len(every)} experiments", self._report.warning)

    @staticmethod
    def check_place(folder: str | Path, *, force: bool = False) -> None:
        """Raises `InputError` where a maximum could not be saved, before minutes of searches."""
        find_map.check_place(Path(folder).expanduser(), force=force)

    def save(self, folder: str | Path, *, force: bool = False) -> Path:
        """As `bayesdrill map --output` leaves it: values, prediction, fit and config.

        Raises `InputError` where something else is there, or a maximum and not `force`.
        """
        place = Path(folder).expanduser()
        find_map.save(self.job, self.mode, place, _as_record(self.columns), force=force)
        return place

    def __str__(self) -> str:
        return f"{self.table}\n\n{words.mode(self.mode, self.job.units)}"

    __repr__ = __str__


@checked
@dataclass(frozen=True, eq=False, repr=False)
class Candidates(Value):
    """Models of a record beside the config as given, the most probable first; none where it fits.

    Of each: `parts`, `about`, the `lines` of a config that say so, `gain` of the log posterior, `bayes`,
    the log Bayes factor by Laplace's approximation, and the `fit` of each channel.  `table`: in words.
    """

    ranked: tuple[Cause, ...]
    table: str

    def __str__(self) -> str:
        return self.table or "the fit leaves what looks like the noise: nothing more is tried"

    __repr__ = __str__


@checked
@dataclass(frozen=True, eq=False, repr=False)
class Run(SampledRun):
    """A sampled posterior: draws, what they say, and figures of them.

    `columns`: the record `(T,)` each, where it is in no file; `kept`: its analysis, where its folder has
    it.
    """

    sampled: SamplingResult
    columns: Mapping[str, Array] | None = None

    @property
    def converged(self) -> bool:
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
        """Every number of the report by name, evaluated once, and read where its folder has it: see
        `RunAnalysis`, whose `describe` gives the unit of each.
        """
        return self._view.analysis

    def judge(self) -> Judged:
        """What fit and draws say of the nominal table."""
        return Judged(self._view)

    @cached_property
    def _view(self) -> ReportContext:
        return conclusions.concluded(self.job, self.mode, self.sampled, kept=self.kept)

    def to_arviz(self) -> DataTree:
        """The groups of the ArviZ schema: `chain` is an ensemble."""
        return self._view.tree

    def plot(self, name: str, part: int = 1) -> Figure:
        """`corner`, `trace`, `prior_posterior`, `fit`, and with a verdict `invariants` and `ridge`.

        In no window: `figure.savefig(...)`, or the last line of a cell.  `part`: of which experiment,
        where there are several.  Raises `InputError` where this run has no such figure.
        """
        arguments.known(FIGURES, name, "plot", "figure")
        found = list(drawings(name, self._view).values())
        if not found:
            raise InputError.one("plot", f"there is nothing to draw in a figure {name} of this run")
        return _drawn(found, part, f"the figure {name} has {len(found)}", self._view.warning)

    def plot_corner(self) -> Figure:
        return self.plot("corner")

    def save(self, folder: str | Path, *, force: bool = False) -> Path:
        """As `bayesdrill posterior` leaves it: tables, figures, chain and config.

        Raises `InputError` where something else is there, or results and not `force`; warns of what
        could not be made.
        """
        place = Path(folder).expanduser()
        record = _as_record(self.columns)
        done = pipeline.write_result(self.job, self._view, place, record, force=force)
        if done.missing:
            said = f"could not be made: {'; '.join(done.missing)}; all else is in {place}"
            warnings.warn(said, stacklevel=3)
        return place

    def __str__(self) -> str:
        return self.judge().text

    def _repr_markdown_(self) -> str:
        return self.judge()._repr_markdown_()

    __repr__ = __str__


@checked
@dataclass(frozen=True, eq=False)
class Judged(Value):
    """`verdict`: None where no unknown has a nominal value to be compared with."""

    view: ReportContext

    @property
    def verdict(self) -> Verdict | None:
        judgement = self.view.analysis.judged
        return None if judgement is None else judgement.verdict

    @property
    def rows(self) -> list[dict[str, Any]]:
        """A record for each unknown, for a table of any kind."""
        return [section.as_record(row) for row in self.view.analysis.unknowns]

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why nothing of it must be believed: no convergence, or no fit; empty where it may be."""
        return self.view.reasons

    @property
    def text(self) -> str:
        return "\n\n".join(as_text(sections(self.view)))

    def __str__(self) -> str:
        return self.text

    def _repr_markdown_(self) -> str:
        brief = [section for section in sections(self.view) if section.brief]
        return as_markdown(self.view.config.name, brief)

    __repr__ = __str__


def _as_record(columns: Mapping[str, Array] | None) -> str | None:
    return None if columns is None else job.arrays_as_csv(columns)


@checked
def open(folder: str | Path) -> Run:
    """The run that `save` or `bayesdrill posterior` left; raises `InputError` where there is none."""
    found = pipeline.read_result(Path(folder).expanduser())
    return Run(found.job, found.mode, found.sampled, kept=found.kept)
