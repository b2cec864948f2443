"""The folder of a maximum (MAP): its values, what it predicts of the record, and the fit."""

from __future__ import annotations

from pathlib import Path

from bayesdrill.basics import own_files, software
from bayesdrill.basics.errors import InputError
from bayesdrill.basics.own_files import MAP
from bayesdrill.commands import pipeline
from bayesdrill.engines.mode import Mode
from bayesdrill.report import publish, residual_words
from bayesdrill.report.map_report import MapReport
from bayesdrill.results import provenance
from bayesdrill.results.run_folder import Folder
from bayesdrill.setup.job import Job


def check_place(output: Path, *, force: bool) -> None:
    """Raises `InputError` where `save` would, before minutes of searches."""
    Folder(output, "force" if force else "fresh", {}, MAP).check()


def report(job: Job, found: Mode) -> MapReport:
    return MapReport(job.at(found).problem, job.config, found)


def save(job: Job, found: Mode, output: Path, record: str | None, *, force: bool) -> None:
    """`record`: its text, where it has no file."""
    pipeline.check_record(job, output, record)
    marks, said = provenance.fingerprint(job.config, job.problem), report(job, found)
    with Folder(output, "force" if force else "fresh", marks, MAP) as folder:
        folder.begin(status="running", seed=job.config.seed, versions=software.versions())
        pipeline.write_given(job, folder, record)
        pipeline.write_mode(folder, found)
        for name, text in said.texts.items():
            folder.write_text(name, text)
        place = output / own_files.FIGURES
        place.mkdir(exist_ok=True)
        note = {"Title": job.config.name, "Creator": software.creator(), **mark(job)}
        look = (said.warning, tuple(job.config.output.formats), job.config.output.dpi)
        for stem, figure in said.figures.items():
            publish.draw(job.problem.posterior, stem, figure, place, note, *look)
        folder.write_text("report.html", said.page(output))
        files = {name: own_files.digest(output / name) for name in folder.made()}
        fit = residual_words.as_data(said.left)
        folder.write_run(status="finished", reasons=list(said.reasons), fit=fit, files=files)


def read(output: Path) -> tuple[Job, Mode]:
    """What `save` left; raises `InputError` where config or record are not those of it."""
    job = pipeline.prepare(output / own_files.RESOLVED_FILE)
    marks = provenance.fingerprint(job.config, job.problem)
    with Folder(output, "read", marks, MAP) as folder:
        found = pipeline.read_mode(folder, job.problem)
    if found is None:
        raise InputError.one(str(output / pipeline.MAP_FILE), "is not there; map it again")
    return job, found


def mark(job: Job) -> dict[str, str]:
    """For the inside of the figure."""
    every = provenance.marks(job.config, job.problem, "")
    return {name: text for name, text in every.items() if name != provenance.BURN_IN_MARK}
