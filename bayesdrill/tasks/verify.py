"""Whether config, record, chain, tables and figures of a folder still belong together.

Each file is as its run wrote it, by the digests in `run.json`.  The chain, the maximum and the
figures say of which run they are, and the config and the record are of that run.
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
    """Whether the files of a folder belong together.

    `problems`: each file that does not belong to the run, and why; `checked`: how many do; `what`:
    which things belong together with them.
    """

    folder: Path
    checked: int
    problems: tuple[Issue, ...]
    what: str

    @property
    def together(self) -> bool:
        """Whether all files belong together."""
        return not self.problems

    @property
    def said(self) -> str:
        """What was found, in words."""
        if self.together:
            return f"{self.folder}: {self.what} and {self.checked} files belong together"
        return "\n".join(map(str, self.problems))

    def __str__(self) -> str:
        return self.said

    __repr__ = __str__


def verify(folder: Path) -> Verified:
    """Nothing is written.  Raises `InputError` where there is no finished run."""
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
        raise InputError.at(str(folder), f"{message}`bayesdrill report` makes it anew")
    problems = dict.fromkeys([*_changed(folder, kind, files), *problems_of(folder, run)])
    checked = len(files) - len({problem.place for problem in problems})
    return Verified(folder, checked, tuple(problems), what)


def _of_run(
    read: Callable[[Path], Job], kind: Kind, folder: Path, _: Mapping[str, Any]
) -> Iterator[Issue]:
    """Of a posterior or a maximum, whose job is `read`."""
    try:
        job = read(folder)
    except InputError as error:  # another record, a config of another run, a damaged chain
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
    """Runs that were only in memory cannot be looked at again."""
    told = run.get("runs", [])
    if len(told) < 2:
        yield Issue(str(folder / output_files.RUN), "names no two runs")
        return
    for entry in told:
        if entry["folder"] is None:
            continue
        place = folder / entry["folder"]
        try:
            if comparison.mark(pipeline.read_result(place)) != entry["run"]:
                done = "laid over" if form is OVERLAID else "compared with"
                yield Issue(str(place), f"is another run than the one that was {done} others")
        except InputError as error:
            yield from error.problems
    mark = " ".join(entry["run"] for entry in told)
    yield from _figures(folder, kind or form.kind, mark, form.name)


def _of_ladder(folder: Path, run: Mapping[str, Any]) -> Iterator[Issue]:
    """Its rungs, each a run of its own, and what is said of them together."""
    yield from _configs(folder)
    for entry in run.get("runs", []):
        if entry["folder"] not in LADDER.nested:
            yield Issue(str(folder / output_files.RUN), f"{entry['folder']} is no rung of a ladder")
            continue
        try:
            yield from verify(folder / entry["folder"]).problems
        except InputError as error:  # no finished run
            yield from error.problems
    yield from _of_several(COMPARED, folder, run, LADDER)


# How the results of a job are looked at, and what that is.
_WAYS: tuple[tuple[Kind, Callable[[Path, Mapping[str, Any]], Iterator[Issue]], str], ...] = (
    (POSTERIOR, partial(_of_run, _job_of_posterior, POSTERIOR), "config, record, chain"),
    (MAP, partial(_of_run, _job_of_map, MAP), "config, record, maximum"),
    (COMPARE, partial(_of_several, COMPARED), "runs"),
    (LADDER, _of_ladder, "config, rungs"),
    (OVERLAY, partial(_of_several, OVERLAID), "runs"),
)


def _changed(folder: Path, kind: Kind, files: Mapping[str, str]) -> Iterator[Issue]:
    there = output_files.output_names(folder, kind)
    for name, digest in files.items():
        place = str(folder / name)
        if name not in there:
            yield Issue(place, f"is missing; {_way_back(kind, name)}")
        elif output_files.digest(folder / name) != digest:
            yield Issue(place, "was changed after this run had written it")
    for name in there:
        if name not in files and name != kind.mark:
            yield Issue(str(folder / name), "was not written by this run")


def _way_back(kind: Kind, name: str) -> str:
    """How a file of a run comes back: of a posterior, what a report is made from is not made by one."""
    if kind is not POSTERIOR:
        return f"`bayesdrill {kind.job} --force` makes it again"
    if output_files.REPORT_SOURCES.is_output(name) or name in output_files.CONFIGS:
        return "put it back, or `bayesdrill posterior CONFIG --resume` makes it again"
    return "`bayesdrill report` makes tables and figures again"


def _configs(folder: Path, job: Job | None = None) -> Iterator[Issue]:
    """The config as given says what the one with all defaults does, of which `job` is made."""
    place = folder / output_files.CONFIG_FILE
    given, resolved = _settings(place), folder / output_files.RESOLVED_FILE
    made = _settings(resolved) if job is None else conclusions.settings(job.case)
    if None not in (given, made) and given != made:
        yield Issue(str(place), f"is not the config of this run, which is {resolved.name}")


def _settings(path: Path) -> dict[str, Any] | None:
    """None where that cannot be read, which is said elsewhere."""
    try:
        return conclusions.settings(loading.load(path))
    except InputError:
        return None


def _figures(folder: Path, kind: Kind, mark: str, name: str) -> Iterator[Issue]:
    """Each says inside which run it is of, and what it shows."""
    names = output_files.output_names(folder, kind)
    for path in (folder / each for each in names if each.startswith(f"{output_files.FIGURES}/")):
        content = path.read_bytes()
        if mark.encode() not in content:
            yield Issue(str(path), "is a figure of another run")
        elif f"{name}: {path.stem}".encode() not in content:
            yield Issue(str(path), "is another figure than its name says")
