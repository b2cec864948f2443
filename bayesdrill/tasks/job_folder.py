"""The folder of a job: what is written as it begins, and what is said where it stops."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from bayesdrill.basics import software
from bayesdrill.basics.errors import InputError, Interrupted
from bayesdrill.config.job import Job
from bayesdrill.config.records import sources
from bayesdrill.output_files import CONFIG_FILE, RECORD, RESOLVED_FILE
from bayesdrill.results import provenance
from bayesdrill.results.run_folder import Folder


def check_record(job: Job, output: Path, record: str | None = None) -> None:
    """Raises `InputError` where the record itself lies in `output`; `record`: as of `begin`."""
    every = (path for one in job.case.experiments for path in sources.paths(one))
    places = [path.parent.resolve() for path in every]
    if record is None and output.resolve() in places:
        raise InputError.one(str(output), "holds the record of this run; give another folder")


def begin(job: Job, folder: Folder, record: str | None = None, **more: Any) -> None:
    """Write the config, as given and with all defaults; `record`: its text, where it has no file."""
    versions = software.installed_versions()
    folder.begin(status="running", seed=job.config.seed, versions=versions, **more)
    folder.write_text(CONFIG_FILE, job.source.text)
    case = job.case
    if record is not None:
        folder.write_text(RECORD, record)
        beside = dataclasses.replace(job.source, path=folder.path / CONFIG_FILE)
        case = dataclasses.replace(case, source=beside)
    folder.write_text(RESOLVED_FILE, provenance.resolved(case, folder.path))


@contextmanager
def interruptions(
    folder: Folder, kept: Callable[[], str], errors: tuple[type[Exception], ...] = ()
) -> Iterator[None]:
    """Write down what stops a job; Ctrl-C raises `Interrupted`, which says what is `kept`."""
    stops: tuple[type[Exception], ...] = (BrokenProcessPool, *errors)
    try:
        yield
    except KeyboardInterrupt:
        folder.write_run(status="interrupted")
        raise Interrupted(f"stopped; {kept()}; continue with --resume") from None
    except stops:
        folder.write_run(status="interrupted")
        raise
