"""A ladder of models of one record, run and compared."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from bayesdrill.api import arguments
from bayesdrill.api.case import load
from bayesdrill.basics.checked import checked
from bayesdrill.basics.progress import SILENT, Reporter
from bayesdrill.basics.values import Value
from bayesdrill.setup.job import Job

if TYPE_CHECKING:
    from bayesdrill.commands.laddering import Outcome


@checked
@dataclass(frozen=True, slots=True, eq=False)
class Ladder(Value):
    """The config as given, and what may be missing from it, one thing at a time."""

    job: Job

    def place(self, folder: str | Path | None = None) -> Path:
        """Where `run` leaves its results."""
        usual = Path("results") / f"{self.job.config.name}-ladder"
        return usual if folder is None else Path(folder).expanduser()

    def run(
        self,
        folder: str | Path | None = None,
        *,
        resume: bool = False,
        force: bool = False,
        processes: int | None = 1,
        scheduler: str | None = None,
        report: Reporter | None = None,
    ) -> Outcome:
        """`folder`: `results/<name>-ladder` by default; `scheduler`: address of a Dask cluster.

        Its `report` has the `decision`, its `config` is what to go on with.  Raises `InputError`, and
        `Interrupted` when asked to stop; rungs that are done are kept.
        """
        from bayesdrill.commands import laddering

        how, place = arguments.mode(resume=resume, force=force), self.place(folder)
        with arguments.crew(processes, scheduler) as crew:
            return laddering.ladder(self.job, place, how, crew, report or SILENT)


@checked
def ladder(config: str | Path) -> Ladder:
    """Of a config and its record; raises `InputError` with all that is wrong with them."""
    return Ladder(load(Path(config).expanduser()).job)
