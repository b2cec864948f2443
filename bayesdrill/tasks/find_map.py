"""The search for the MAP as a config asks for it, and the folder of a maximum: its values, what it
predicts of the record, and the fit.
"""

from __future__ import annotations

import dataclasses
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bayesdrill import output_files
from bayesdrill.analysis.causes import causes
from bayesdrill.basics import seeds, software
from bayesdrill.basics.errors import InputError
from bayesdrill.basics.progress import Reporter
from bayesdrill.config.job import Job, prepare
from bayesdrill.config.records import sources
from bayesdrill.config.resolve import assembly
from bayesdrill.inference import residual_checks
from bayesdrill.inference.posterior import Problem
from bayesdrill.output_files import (
    CONFIG_FILE,
    MAP,
    RESOLVED_FILE,
    dumps_checksummed,
    loads_checksummed,
    typed,
)
from bayesdrill.report import publish, words
from bayesdrill.report.map_report import MapReport
from bayesdrill.report.sections import fit_words
from bayesdrill.results import provenance
from bayesdrill.results.run_folder import COMPUTED_AGAIN, Folder
from bayesdrill.sampling import mode_search, multiple_modes
from bayesdrill.sampling.mode_search import Mode, Search
from bayesdrill.sampling.workers import Crew
from bayesdrill.tasks import run_entries


def check_place(output: Path, *, force: bool) -> None:
    """Raises `InputError` where `save` would, before minutes of searches."""
    Folder(output, "force" if force else "fresh", {}, MAP).check()


def report(job: Job, found: Mode) -> MapReport:
    return MapReport(job.at(found).problem, job.config, found)


def save(job: Job, found: Mode, output: Path, record: str | None, *, force: bool) -> None:
    """`record`: its text, where it has no file."""
    check_record(job, output, record)
    marks, said = provenance.fingerprint(job.config, job.problem), report(job, found)
    with Folder(output, "force" if force else "fresh", marks, MAP) as folder:
        folder.begin(status="running", seed=job.config.seed, versions=software.installed_versions())
        write_given(job, folder, record)
        write_mode(folder, found)
        for name, text in said.texts.items():
            folder.write_text(name, text)
        place = output / output_files.FIGURES
        place.mkdir(exist_ok=True)
        note = {"Title": job.config.name, "Creator": software.creator(), **mark(job)}
        look = (said.warning, tuple(job.config.output.formats), job.config.output.dpi)
        for stem, figure in said.figures.items():
            publish.draw(job.problem.posterior, stem, figure, place, note, *look)
        folder.write_text("report.html", said.page(output))
        files = {name: output_files.digest(output / name) for name in folder.made()}
        fit = run_entries.residual_data(said.left)
        folder.write_run(status="finished", reasons=list(said.reasons), fit=fit, files=files)


def read(output: Path) -> tuple[Job, Mode]:
    """What `save` left; raises `InputError` where config or record are not those of it."""
    job = prepare(output / output_files.RESOLVED_FILE)
    marks = provenance.fingerprint(job.config, job.problem)
    with Folder(output, "read", marks, MAP) as folder:
        found = read_mode(folder, job.problem)
    if found is None:
        raise InputError.one(str(output / MAP_FILE), "is not there; map it again")
    return job, found


def mark(job: Job) -> dict[str, str]:
    """For the inside of the figure."""
    every = provenance.marks(job.config, job.problem, "")
    return {name: text for name, text in every.items() if name != provenance.BURN_IN_MARK}


Array = NDArray[np.float64]

SEARCHING = "searching the MAP"


BAD_FIT = (
    "     no posterior of such a fit can be believed; Ctrl-C stops it here, and units, inputs, gear and "
    "columns are what to look at first"
)


def find_mode(job: Job, processes: int, report: Reporter) -> Mode:
    """The MAP alone; nothing is written."""
    with Crew(job.problem.posterior, processes) as crew:
        return end_search(crew, begin_search(job, crew, report), job, report)


@dataclass(frozen=True, slots=True)
class Hunt:
    """Searches for the MAP under way, and for maxima elsewhere."""

    searches: list[Future[Search]]
    scouts: list[Future[tuple[Array, Array]]]


def begin_search(job: Job, crew: Crew, report: Reporter) -> Hunt:
    """All searches under way; of a crew that is alone they are done then."""
    settings, target = job.config.map, job.problem.posterior
    points = mode_search.starts(target, settings.starts, seeds.stream(job.config.seed, "map"))
    optimiser, most = assembly.optimiser(job.config), settings.evaluations
    searches, scouts = [], []
    for done, point in enumerate(points):
        report.update(done / len(points), SEARCHING)
        searches.append(crew.submit(mode_search.search, optimiser, most, point))
    if optimiser.polished:
        draws = target.space.draw(mode_search.SCOUTS, seeds.stream(job.config.seed, "scout"))
        scouts = [crew.submit(mode_search.scouts, some) for some in np.array_split(draws, 2)]
    return Hunt(searches, scouts)


def end_search(crew: Crew, hunt: Hunt, job: Job, report: Reporter) -> Mode:
    searches = []
    for done, task in enumerate(hunt.searches, 1):
        searches.append(task.result())
        report.update(done / (len(hunt.searches) + 1), SEARCHING)
    report.update(0.0, "looking for other maxima")
    scouted = (
        multiple_modes.together([task.result() for task in hunt.scouts]) if hunt.scouts else None
    )
    found = crew.submit(mode_search.summarise, tuple(searches), scouted).result()
    report.update(1.0, "")
    report.say(words.mode(found, job.units))
    posterior = job.at(found).problem.posterior
    report.update(0.0, "looking at what the best fit leaves")
    left = residual_checks.left(posterior.likelihood, posterior.space.vector(found.values))
    if fit_words.residual_reasons(left):
        said = fit_words.explained(
            causes(posterior, posterior.space.vector(found.values)), job.config
        )
        report.say("\n".join([fit_words.residual_sentences(left, job.clock), said, BAD_FIT]))
    report.update(1.0, "")
    return found


MAP_FILE = "map.json"


def check_record(job: Job, output: Path, record: str | None) -> None:
    """Raises `InputError` where the record itself lies in `output`."""
    places = [path.parent.resolve() for path in sources.paths(job.config, job.source)]
    if record is None and output.resolve() in places:
        raise InputError.one(str(output), "holds the record of this run; give another folder")


def write_given(job: Job, folder: Folder, record: str | None = None) -> None:
    """The config, as given and with all defaults; `record`: its text, where it has no file."""
    folder.write_text(CONFIG_FILE, job.source.text)
    source = job.source
    if record is not None:
        folder.write_text(output_files.RECORD, record)
        source = dataclasses.replace(source, path=folder.path / CONFIG_FILE)
    folder.write_text(RESOLVED_FILE, provenance.resolved(job.config, source, folder.path))


def write_mode(folder: Folder, found: Mode) -> None:
    folder.write_text(MAP_FILE, dumps_checksummed({"run": folder.run, **dataclasses.asdict(found)}))


def read_mode(folder: Folder, problem: Problem) -> Mode | None:
    """What `map.json` holds; None where no search has ended yet.

    Raises `InputError` where it is damaged, or of another run.
    """
    path = folder.path / MAP_FILE
    if not path.exists():
        return None
    try:
        data = loads_checksummed(path.read_bytes())
        folder.refuse_foreign(MAP_FILE, data.get("run"))
        found = typed(Mode, data)
        if not _possible(found, problem):
            raise ValueError("of other unknowns")
        return found
    except ValueError:
        raise InputError.one(str(path), COMPUTED_AGAIN) from None


def _possible(found: Mode, problem: Problem) -> bool:
    """Whether a mode may be one of this posterior."""
    space, labels = problem.posterior.space, {one.label for one in problem.every}
    maxima, ends = [one.values for one in found.maxima], [one.end for one in found.searches]
    names = {*found.at_bound, *found.steps} <= {*space.free} and {*found.pieces} <= labels
    if not names or any(set(one) != {*space.free} for one in (*maxima, *ends, found.slope)):
        return False
    numbers = [value for one in (*maxima, *ends, found.slope) for value in one.values()]
    numbers += [found.gain, *(one.log_posterior for one in found.maxima)]
    numbers += list(space.log_prior(np.array([*map(space.vector, maxima)])))
    return bool(np.isfinite(numbers).all()) and min([1, *sum(found.pieces.values(), ())]) > 0
