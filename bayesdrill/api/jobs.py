"""Jobs of many fits, which are handed out: what each may be told, and where it leaves its results."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from bayesdrill.api import arguments
from bayesdrill.basics.progress import SILENT, Reporter
from bayesdrill.basics.values import Value, checked
from bayesdrill.config.job import Job

if TYPE_CHECKING:
    from bayesdrill.results.run_folder import Mode
    from bayesdrill.tasks.remote import RefitExecutor


@checked
@dataclass(frozen=True, slots=True, eq=False)
class ManyFits[T](Value):
    """`kind`: ends the name of its folder."""

    job: Job

    kind: ClassVar[str]

    def place(self, folder: str | Path | None = None) -> Path:
        """Where `run` leaves its results: `results/<name>-ladder` or `results/<name>-calibration` by
        default.
        """
        usual = Path("results") / f"{self.job.config.name}-{self.kind}"
        return arguments.results_folder(folder, usual)

    def run(
        self,
        folder: str | Path | None = None,
        *,
        resume: bool = False,
        force: bool = False,
        processes: int | None = 1,
        scheduler: str | None = None,
        report: Reporter | None = None,
    ) -> T:
        """`folder`: see `place`; `scheduler`: address of a Dask cluster; `processes`, `report`: see
        `Case.sample`.

        Raises `InputError`, and `Interrupted` when asked to stop; what is done is kept.
        """
        how, place = arguments.mode(resume=resume, force=force), self.place(folder)
        with arguments.crew(processes, scheduler) as crew:
            return self._run(place, how, crew, report or SILENT)

    @abstractmethod
    def _run(self, place: Path, how: Mode, crew: RefitExecutor, report: Reporter) -> T:
        """Do the job."""
