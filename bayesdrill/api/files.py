"""What is done with configs and folders as a whole: simulated, calibrated, reported again."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from bayesdrill.api import arguments
from bayesdrill.basics.checked import checked
from bayesdrill.basics.errors import InputError
from bayesdrill.basics.progress import SILENT, Reporter
from bayesdrill.basics.values import Value

if TYPE_CHECKING:
    from bayesdrill.commands.calibrate import Outcome as Calibrated
    from bayesdrill.commands.pipeline import Outcome
    from bayesdrill.commands.verify import Verified
    from bayesdrill.setup.job import Job


@dataclass(frozen=True, slots=True)
class Simulated:
    """`files`: how many samples each has."""

    files: Mapping[Path, int]

    @property
    def path(self) -> Path:
        """Of the first."""
        return next(iter(self.files))

    @property
    def samples(self) -> int:
        """Of all."""
        return sum(self.files.values())


@checked
def simulate(
    config: str | Path,
    output: str | Path | None = None,
    *,
    seed: int | None = None,
    force: bool = False,
) -> Simulated:
    """A record of the rig of a config, as CSV: exact response, and noise with a seed.

    `output`: the record that the config names, by default; of several experiments a folder, for a file
    of each.  `seed`: the config's.  Raises `InputError`, before anything is written.
    """
    from bayesdrill.setup import experiments, loading, reading, simulating

    read, source = loading.load(Path(config).expanduser())
    own = read.seed if seed is None else arguments.whole("seed", seed, 0)
    place = None if output is None else Path(output).expanduser()
    if place is not None and read.experiments and place.exists() and not place.is_dir():
        message = "is no folder; name one for the records of several experiments"
        raise InputError.one(str(place), message)
    texts = simulating.every(read, source, own, place)
    every = experiments.views(read, source)
    records = [reading.path_of(view.config, view.source) for view in every]
    for (target, text), record in zip(texts.items(), records, strict=True):
        simulating.check_place(text, target, record, force=force)
    files = {}
    for (target, text), record, view in zip(texts.items(), records, every, strict=True):
        if read.experiments:
            target.parent.mkdir(parents=True, exist_ok=True)
        simulating.save(text, target, record, force=force)
        skipped = reading.csv_options(view.config.record).skip_rows
        files[target] = len(text.splitlines()) - 1 - skipped
    return Simulated(files)


@checked
def publish(
    folder: str | Path,
    output: str | Path | None = None,
    *,
    force: bool = False,
    processes: int | None = 1,
    report: Reporter | None = None,
) -> Outcome:
    """Tables and figures again, from the chain in a folder; raises `InputError` where there is none.

    `output`: a folder that gets a copy of the run with them, where the first may only be read.
    """
    from bayesdrill.commands import pipeline

    source, workers = Path(folder).expanduser(), arguments.workers(processes)
    if output is None:
        if force:
            message = "goes with --output, or several folders; one is written again where it is"
            raise InputError.one("--force", message)
        return pipeline.republish(source, workers, report or SILENT)
    place = Path(output).expanduser()
    pipeline.copied(source, place, force=force)
    return pipeline.republish(place, workers, report or SILENT)


@checked
def verify(folder: str | Path) -> Verified:
    """Whether config, record, tables and figures of a run still belong together.

    The tables are computed again from the chain.  Raises `InputError` where there is no finished run.
    """
    from bayesdrill.commands import verify as verifying

    return verifying.verify(Path(folder).expanduser())


@checked
@dataclass(frozen=True, slots=True, eq=False)
class Calibration(Value):
    """Refits of simulated records, which say whether a posterior is as wide as it claims."""

    job: Job

    def place(self, folder: str | Path | None = None) -> Path:
        """Where `run` leaves its results."""
        usual = Path("results") / f"{self.job.config.name}-calibration"
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
    ) -> Calibrated:
        """`folder`: `results/<name>-calibration` by default; `scheduler`: address of a Dask cluster.

        Raises `InputError`, and `Interrupted` when asked to stop; refits that are done are kept.
        """
        from bayesdrill.commands import calibrate

        how, place = arguments.mode(resume=resume, force=force), self.place(folder)
        with arguments.crew(processes, scheduler) as crew:
            return calibrate.calibrate(self.job, place, how, crew, report or SILENT)


@checked
def calibration(config: str | Path) -> Calibration:
    """Of a config, whose record need not be there yet where `simulation:` gives its times.

    Raises `InputError` with all that is wrong with it.
    """
    from bayesdrill.commands.calibrate import prepare

    return Calibration(prepare(Path(config).expanduser()))


@checked
def schema() -> str:
    """The JSON schema of configs."""
    from bayesdrill.setup.schema import as_text

    return as_text()
