"""Search for the MAP with the settings of a config, and write a maximum into a folder."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from bayesdrill import output_files
from bayesdrill.analysis.causes import Cause
from bayesdrill.basics.errors import InputError
from bayesdrill.basics.json_records import as_data
from bayesdrill.basics.progress import Reporter
from bayesdrill.basics.units import Unit
from bayesdrill.config.building.settings import optimiser
from bayesdrill.config.job import Job, prepare
from bayesdrill.inference.posterior import Problem
from bayesdrill.inference.residual_checks import ResidualSummary
from bayesdrill.output_files import MAP
from bayesdrill.report.doubts import residual_reasons, residual_sentences
from bayesdrill.report.map_report import MapReport
from bayesdrill.report.sections.convergence import describe_searches
from bayesdrill.results import provenance
from bayesdrill.results.provenance import begin, check_record
from bayesdrill.results.run_folder import COMPUTED_AGAIN, Folder, dump_record, load_record
from bayesdrill.rig.simulators import COMPRESSED_FROM
from bayesdrill.sampling.fit import (
    FitPlan,
    PendingSearches,
    begin_searches,
    end_searches,
    searching_processes,
)
from bayesdrill.sampling.mode_search import Mode
from bayesdrill.sampling.workers import WorkerPool
from bayesdrill.selection import config_edits
from bayesdrill.tasks.conclusions import plan


def check_place(output: Path, *, force: bool) -> None:
    """Raise the `InputError` that `save` would raise; called before the long search."""
    Folder(output, "force" if force else "fresh", {}, MAP).check()


def report(job: Job, mode: Mode) -> MapReport:
    """Return the report of a maximum."""
    return MapReport(job.with_steps_at(mode).problem, job.config, mode)


def save(job: Job, mode: Mode, output: Path, record: str | None, *, force: bool) -> None:
    """Write a maximum into a folder; `record` is the text of a record that has no file."""
    check_record(job, output, record)
    fingerprint, said = provenance.fingerprint(job.config, job.problem), report(job, mode)
    with Folder(output, "force" if force else "fresh", fingerprint, MAP) as folder:
        begin(job, folder, record)
        write_mode(folder, mode)
        for name, text in said.texts.items():
            folder.write_text(name, text)
        said.draw(output, job.config.name, **provenance.marks(job.config, job.problem))
        folder.write_text("report.html", said.page(output))
        folder.write_run(
            status="finished",
            reasons=list(said.reasons),
            fit=as_data(said.residuals),
            files=folder.digests(),
        )


def read(output: Path) -> tuple[Job, Mode]:
    """Read the files of `save`; raises `InputError` if config or record have changed."""
    job = prepare(output / output_files.RESOLVED_FILE)
    marks = provenance.fingerprint(job.config, job.problem)
    with Folder(output, "read", marks, MAP) as folder:
        mode = read_mode(folder, job.problem)
    if mode is None:
        raise InputError.at(str(output / MAP_FILE), "is missing; run `bayesdrill map` again")
    return job, mode


def find_mode(job: Job, processes: int, report: Reporter, *, quick: bool = False) -> Mode:
    """Find the MAP without writing files; `quick` searches only from the configured start."""
    if quick:
        job = job.with_settings(map=job.config.map.model_copy(update={"starts": 1}))
    posterior, wanted = job.problem.posterior, fit_plan(job)
    with WorkerPool(posterior, searching_processes(posterior, wanted, processes)) as pool:
        return end_search(pool, begin_searches(pool, wanted, report), report)


SHORTEST = {
    "auto": COMPRESSED_FROM,
    "exact": None,
    "compressed": 0,
}  # records with more samples than this are compressed; None: no record is compressed


def fit_plan(job: Job) -> FitPlan:
    """Return the settings of searches and sampling from the config of a job."""
    settings = job.config.map
    return FitPlan(
        optimiser=optimiser(job.config),
        starts=settings.starts,
        evaluations=settings.evaluations,
        chains=plan(job.config),
        max_exact=SHORTEST[job.config.sampler.likelihood],
    )


def end_search(pool: WorkerPool, under_way: PendingSearches, report: Reporter) -> Mode:
    """Wait for the searches, report how they ended, and return the maximum."""
    mode = end_searches(pool, under_way, report)
    report.say(describe_searches(mode))
    return mode


def misfit(residuals: Sequence[ResidualSummary], clock: Unit) -> str:
    """Describe the `residuals` if they are too large to believe a posterior; else empty."""
    return residual_sentences(residuals, clock) if residual_reasons(residuals) else ""


def check_new_config(job: Job, path: Path, *, force: bool) -> None:
    """Raise the `InputError` that `write_config` would raise; called before the long search."""
    place = str(path)
    if job.files.array_table is not None:
        raise InputError.at(
            place, "no file contains the record yet; save the case, then map its config"
        )
    if path.suffix not in (".yaml", ".yml"):
        raise InputError.at(place, "a config is a .yaml file; give a name with this ending")
    output_files.refuse_other_than_file(path)
    if path.resolve() == job.source.path.resolve():
        raise InputError.at(place, "is the given config; give another name")
    output_files.refuse_existing(path, force=force)


def write_config(job: Job, cause: Cause, path: Path, *, force: bool) -> None:
    """Write the config of a job, amended by the lines of a `cause`."""
    check_new_config(job, path, force=force)
    about = [f"{job.source.path.name} with {cause.about}, as `bayesdrill map` recommends it."]
    text = config_edits.as_file(config_edits.amended(job, cause), job.source, path.parent, about)
    output_files.write_text(path, text)


MAP_FILE, MODE_FORM = "map.json", 1


def write_mode(folder: Folder, mode: Mode) -> None:
    """Write `map.json`."""
    folder.write_text(MAP_FILE, dump_record(mode, MODE_FORM, run=folder.run))


def read_mode(folder: Folder, problem: Problem) -> Mode | None:
    """Read `map.json`, or return None; raises `InputError` if it is damaged or of another run."""
    path = folder.path / MAP_FILE
    if not path.exists():
        return None
    mode, data = load_record(path, Mode, MODE_FORM)
    folder.refuse_foreign(MAP_FILE, data.get("run"))
    if not _possible(mode, problem):
        raise InputError.at(str(path), COMPUTED_AGAIN)
    return mode


def _possible(mode: Mode, problem: Problem) -> bool:
    """Return whether names and values of a mode are possible for this posterior."""
    space, labels = problem.posterior.space, {each.label for each in problem.all_observations}
    maxima = [maximum.values for maximum in mode.maxima]
    points = (*maxima, *(search.end for search in mode.searches), mode.slope)
    names = {*mode.at_bound, *mode.steps} <= {*space.free} and {*mode.pieces} <= labels
    if not names or any(set(point) != {*space.free} for point in points):
        return False
    numbers = [value for point in points for value in point.values()]
    numbers += [mode.gain, *(maximum.log_posterior for maximum in mode.maxima)]
    numbers += list(space.log_prior(np.array([*map(space.vector, maxima)])))
    return bool(np.isfinite(numbers).all()) and min([1, *sum(mode.pieces.values(), ())]) > 0
