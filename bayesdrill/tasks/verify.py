"""Verify that config, record, chain, tables and figures of a folder belong together.

Files must have the digests in `run.json`.  Chain, maximum and figures contain the mark of their
run, which must equal the mark that is computed from config and record.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from bayesdrill import output_files
from bayesdrill.basics.errors import InputError, Issue
from bayesdrill.config import loading
from bayesdrill.config.job import Job
from bayesdrill.output_files import COMPARE, LADDER, MAP, OVERLAY, POSTERIOR, Kind
from bayesdrill.report.comparison_report import COMPARED, OVERLAID, Form
from bayesdrill.results import provenance, run_folder
from bayesdrill.tasks import comparison, conclusions, find_map, pipeline


@dataclass(frozen=True, slots=True)
class Verified:
    """A verification shows which files of a folder belong together.

    `problems` has each file that does not belong to the run, with the reason.  `checked` is the
    number of files without problems.  `contents` names the contents, such as "config, record, chain".
    """

    folder: Path
    checked: int
    problems: tuple[Issue, ...]
    contents: str

    @property
    def together(self) -> bool:
        """Return whether all files belong together."""
        return not self.problems

    @property
    def summary(self) -> str:
        """Return the result as text."""
        if self.together:
            return f"{self.folder}: {self.contents} and {self.checked} files belong together"
        return "\n".join(map(str, self.problems))

    def __str__(self) -> str:
        return self.summary

    __repr__ = __str__


def verify(folder: Path) -> Verified:
    """Verify a folder without writing; raises `InputError` if there is no finished run."""
    run = run_folder.read_run(folder)
    way = next((way for way in _WAYS if run and way[0].job == run.get("job")), None)
    if run is None or way is None:
        message = "no results of `bayesdrill posterior`, `map`, `compare`, `ladder` or an overlay"
        raise InputError.at(str(folder), message)
    kind, problems_of, what = way
    if obstacles := output_files.misplaced_paths(folder, kind):
        raise InputError(obstacles)
    files = run.get("files")
    if run.get("status") != "finished" or not isinstance(files, dict):
        message = "this run is not finished, or of an older version; "
        raise InputError.at(str(folder), f"{message}`bayesdrill report` makes it again")
    problems = dict.fromkeys([*_changed(folder, kind, files), *problems_of(folder, run)])
    checked = len(files) - len({problem.place for problem in problems})
    return Verified(folder, checked, tuple(problems), what)


def _of_run(
    read: Callable[[Path], Job], kind: Kind, folder: Path, _: Mapping[str, Any]
) -> Iterator[Issue]:
    """Yield the problems of a posterior or a maximum, whose job is `read(folder)`."""
    try:
        job = read(folder)
    except InputError as error:  # the record or the config has changed, or the chain is damaged
        yield from (*_configs(folder), *error.problems)
        return
    yield from _configs(folder, job)
    mark = provenance.marks(job.config, job.problem)[provenance.RUN_MARK]
    yield from _figures(folder, kind, mark, job.config.name)


def _job_of_posterior(folder: Path) -> Job:
    return pipeline.read_result(folder).job


def _job_of_map(folder: Path) -> Job:
    return find_map.read(folder)[0]


def _of_several(
    form: Form, folder: Path, run: Mapping[str, Any], kind: Kind | None = None
) -> Iterator[Issue]:
    """Yield the problems of an overlay or a comparison; runs in memory are skipped."""
    compared = comparison.read_record(run, folder).runs
    if len(compared) < 2:
        yield Issue(str(folder / output_files.RUN), "names fewer than two runs")
        return
    for entry in compared:
        if entry.folder is None:
            continue
        place = folder / entry.folder
        try:
            if comparison.mark(pipeline.read_result(place)) != entry.run:
                done = "laid over" if form is OVERLAID else "compared with"
                yield Issue(str(place), f"is another run than the one that was {done} others")
        except InputError as error:
            yield from error.problems
    mark = " ".join(entry.run for entry in compared)
    yield from _figures(folder, kind or form.kind, mark, form.name)


def _of_ladder(folder: Path, run: Mapping[str, Any]) -> Iterator[Issue]:
    """Yield the problems of a ladder: those of each rung (a run), and of the comparison."""
    yield from _configs(folder)
    for entry in comparison.read_record(run, folder).runs:
        if entry.folder not in LADDER.nested:
            yield Issue(str(folder / output_files.RUN), f"{entry.folder} is not a rung of a ladder")
            continue
        try:
            yield from verify(folder / entry.folder).problems
        except InputError as error:  # the rung is not a finished run
            yield from error.problems
    yield from _of_several(COMPARED, folder, run, LADDER)


# Each kind of results has a function that yields problems, and a list of its contents in words.
_WAYS: tuple[tuple[Kind, Callable[[Path, Mapping[str, Any]], Iterator[Issue]], str], ...] = (
    (POSTERIOR, partial(_of_run, _job_of_posterior, POSTERIOR), "config, record, chain"),
    (MAP, partial(_of_run, _job_of_map, MAP), "config, record, maximum"),
    (COMPARE, partial(_of_several, COMPARED), "runs"),
    (LADDER, _of_ladder, "config, rungs"),
    (OVERLAY, partial(_of_several, OVERLAID), "runs"),
)


def _changed(folder: Path, kind: Kind, files: Mapping[str, str]) -> Iterator[Issue]:
    present = output_files.output_names(folder, kind)
    for name, digest in files.items():
        place = str(folder / name)
        if name not in present:
            yield Issue(place, f"is missing; {_way_back(kind, name)}")
        elif output_files.digest(folder / name) != digest:
            yield Issue(place, "was changed after this run had written it")
    for name in present:
        if name not in files and name != kind.mark:
            yield Issue(str(folder / name), "was not written by this run")


def _way_back(kind: Kind, name: str) -> str:
    """Say how to restore a file; `bayesdrill report` cannot restore the files that it reads."""
    if kind is not POSTERIOR:
        return f"`bayesdrill {kind.job} --force` makes it again"
    if output_files.REPORT_SOURCES.is_output(name) or name in output_files.CONFIGS:
        return "put it back, or `bayesdrill posterior CONFIG --resume` makes it again"
    return "`bayesdrill report` makes tables and figures again"


def _configs(folder: Path, job: Job | None = None) -> Iterator[Issue]:
    """Yield a problem if the given config differs from that of `job` (or the resolved config)."""
    place = folder / output_files.CONFIG_FILE
    given, resolved = _settings(place), folder / output_files.RESOLVED_FILE
    made = _settings(resolved) if job is None else conclusions.settings(job.case)
    if None not in (given, made) and given != made:
        yield Issue(str(place), f"is not the config of this run, which is {resolved.name}")


def _settings(path: Path) -> dict[str, Any] | None:
    """Return the settings of a config; None if unreadable, which is reported elsewhere."""
    try:
        return conclusions.settings(loading.load(path))
    except InputError:
        return None


def _figures(folder: Path, kind: Kind, mark: str, name: str) -> Iterator[Issue]:
    """Yield a problem for each figure whose metadata name another run or another figure."""
    names = output_files.output_names(folder, kind)
    for path in (folder / file for file in names if file.startswith(f"{output_files.FIGURES}/")):
        content = path.read_bytes()
        if mark.encode() not in content:
            yield Issue(str(path), "is a figure of another run")
        elif f"{name}: {path.stem}".encode() not in content:
            yield Issue(str(path), "is another figure than its name says")
