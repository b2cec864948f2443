"""Whether config, record, tables and figures of a folder still belong together."""

from __future__ import annotations

import csv
import dataclasses
import io
import itertools
import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from bayesdrill import output_files
from bayesdrill.analysis.causes import Causes
from bayesdrill.analysis.run_analysis import RunAnalysis
from bayesdrill.basics.errors import InputError, Issue
from bayesdrill.basics.values import from_data, leaves
from bayesdrill.config import loading
from bayesdrill.config.job import Job
from bayesdrill.output_files import COMPARE, LADDER, MAP, OVERLAY, POSTERIOR, Kind
from bayesdrill.report import publish
from bayesdrill.report.comparison_report import COMPARED, OVERLAID, Form
from bayesdrill.report.sections import verdict_words
from bayesdrill.results import provenance, run_folder
from bayesdrill.tasks import comparison, conclusions, find_map, pipeline, run_entries
from bayesdrill.tasks.comparison import NamedRun

SAME = 1e-6  # relative: numbers that other versions of a library round otherwise
MOST = 5  # numbers that are named
UP_TO_SIGNS = "judged.study.information.root"  # of its rows, which libraries choose


@dataclass(frozen=True, slots=True)
class Verified:
    """Whether the files of a folder belong together.

    `problems`: each file that does not belong to the run, and why; `checked`: how many do; `what`:
    which things belong together, and what `follows` from them.
    """

    folder: Path
    checked: int
    problems: tuple[Issue, ...]
    what: str
    follows: str
    numbers: int = 0  # of `run.json` that were computed again

    @property
    def together(self) -> bool:
        """Whether all files belong together."""
        return not self.problems

    @property
    def said(self) -> str:
        """What was found, in words."""
        if self.together:
            files = f"{self.what} and {self.checked} files belong together"
            numbers = f", and so do the {self.numbers} numbers of {output_files.RUN}"
            return f"{self.folder}: {files}; {self.follows}{numbers if self.numbers else ''}"
        return "\n".join(map(str, self.problems))

    def __str__(self) -> str:
        return self.said

    __repr__ = __str__


@dataclass(frozen=True, slots=True)
class _Way:
    """How the results of a job are looked at."""

    kind: Kind
    problems: Callable[[Path, Mapping[str, Any]], Iterator[Issue]]
    what: str
    follows: str


def verify(folder: Path) -> Verified:
    """Nothing is written.  Raises `InputError` where there is no finished run."""
    run = run_folder.read_run(folder)
    way = next((way for way in _WAYS if run and way.kind.job == run.get("job")), None)
    if run is None or way is None:
        message = "no results of `bayesdrill posterior`, `map`, `compare`, `ladder` or an overlay"
        raise InputError.at(str(folder), message)
    if obstacles := output_files.existing_outputs(folder, way.kind):
        raise InputError(obstacles)
    files = run.get("files")
    if run.get("status") != "finished" or not isinstance(files, dict):
        message = "this run is not finished, or of an older version; "
        raise InputError.at(str(folder), f"{message}`bayesdrill report` makes it anew")
    problems = dict.fromkeys([*_changed(folder, way.kind, files), *way.problems(folder, run)])
    checked = len(files) - len({problem.place for problem in problems})
    numbers = sum(1 for _ in leaves(run.get(run_entries.ANALYSIS) or []))
    return Verified(folder, checked, tuple(problems), way.what, way.follows, numbers)


def _of_posterior(folder: Path, run: Mapping[str, Any]) -> Iterator[Issue]:
    try:
        stored_run = pipeline.read_result(folder)
    except InputError as error:  # another record, a config of another run, a damaged chain
        yield from (*_configs(folder), *error.problems)
        return
    yield from _configs(folder, stored_run.job)
    kept, explained = run.get(run_entries.ANALYSIS, {}), None
    # Candidates follow from the config as it was written, which is no longer there.
    with suppress(ValueError):
        explained = from_data(Causes, kept["causes"]) if kept.get("causes") else None
    afresh = dataclasses.replace(stored_run, kept=None)
    view = conclusions.concluded(afresh, alone=kept.get("alone", True), explained=explained)
    beyond = view.sampled.extended
    if beyond is None or beyond.saved:
        texts = {name: table(view) or "" for name, table in publish.TABLES.items()}
        yield from _tables(folder, texts, "the chain")
        yield from _numbers(folder, run, view.analysis)
    else:
        yield Issue(str(folder / output_files.OPENED), verdict_words.NOT_KEPT)
    mark = view.marks[provenance.RUN_MARK]
    yield from _figures(folder, POSTERIOR, mark, view.config.name)


def _numbers(folder: Path, run: Mapping[str, Any], analysis: RunAnalysis) -> Iterator[Issue]:
    """Of `run.json`, which older versions have not kept there."""
    given = dict(leaves(run.get(run_entries.ANALYSIS, {})))
    wrong = [
        f"{name} is {given.get(name, 'missing')}, and the chain gives {value}"
        for name, value in analysis.numbers.items()
        if given and not name.startswith(UP_TO_SIGNS) and not _near(given.get(name), value)
    ]
    more = f", and {len(wrong) - MOST} more" if len(wrong) > MOST else ""
    if wrong:
        yield Issue(str(folder / output_files.RUN), f"{'; '.join(wrong[:MOST])}{more}")


def _of_map(folder: Path, _: Mapping[str, Any]) -> Iterator[Issue]:
    try:
        job, mode = find_map.read(folder)
    except InputError as error:
        yield from (*_configs(folder), *error.problems)
        return
    yield from _configs(folder, job)
    yield from _tables(folder, find_map.report(job, mode).numbers, find_map.MAP_FILE)
    mark = provenance.marks(job.config, job.problem)[provenance.RUN_MARK]
    yield from _figures(folder, MAP, mark, job.config.name)


def _of_several(
    form: Form, folder: Path, run: Mapping[str, Any], kind: Kind | None = None
) -> Iterator[Issue]:
    """Runs that were only in memory cannot be looked at again."""
    problems, told = [], run.get("runs", [])
    if len(told) < 2:
        yield Issue(str(folder / output_files.RUN), "names no two runs")
        return
    for entry in told:
        if entry["folder"] is None:
            continue
        place = folder / entry["folder"]
        try:
            stored_run = dataclasses.replace(pipeline.read_result(place), kept=None)
        except InputError as error:
            yield from error.problems
            continue
        if comparison.mark(stored_run) != entry["run"]:
            done = "laid over" if form is OVERLAID else "compared with"
            yield Issue(str(place), f"is another run than the one that was {done} others")
        else:
            problems.append(NamedRun(entry["name"], place, stored_run))
    if len(problems) == len(told):
        try:
            text = comparison.report(form, problems).table
            yield from _tables(folder, {f"{form.name}.csv": text}, "the chains")
        except InputError as error:  # a run without evidence
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


_FROM_CHAINS = "the table follows from their chains"
_WAYS = (
    _Way(POSTERIOR, _of_posterior, "config, record, chain", "the tables follow from the chain"),
    _Way(MAP, _of_map, "config, record, maximum", "table and prediction follow from the maximum"),
    _Way(COMPARE, partial(_of_several, COMPARED), "runs", _FROM_CHAINS),
    _Way(LADDER, _of_ladder, "config, rungs", _FROM_CHAINS),
    _Way(OVERLAY, partial(_of_several, OVERLAID), "runs", _FROM_CHAINS),
)


def _changed(folder: Path, kind: Kind, files: Mapping[str, str]) -> Iterator[Issue]:
    there = output_files.present(folder, kind)
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
    if output_files.GROUND.is_output(name) or name in (*output_files.CONFIGS, output_files.OPENED):
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


def _tables(folder: Path, texts: Mapping[str, str], source: str) -> Iterator[Issue]:
    for name, text in texts.items():
        path = folder / name
        if path.exists() and not _same(path.read_text(encoding="utf-8", errors="replace"), text):
            yield Issue(str(path), f"does not follow from {source}")


def _same(text: str, expected: str) -> bool:
    """To the digits that other versions of a library leave."""
    try:
        first, other = (list(csv.reader(io.StringIO(text))) for text in (text, expected))
    except csv.Error:
        return False
    if [len(row) for row in first] != [len(row) for row in other]:
        return False
    return all(map(_near, itertools.chain(*first), itertools.chain(*other)))


def _near(value: Any, other: Any) -> bool:
    if value == other:
        return True
    try:
        return math.isclose(float(value), float(other), rel_tol=SAME, abs_tol=1e-12)
    except (TypeError, ValueError):
        return False


def _figures(folder: Path, kind: Kind, mark: str, name: str) -> Iterator[Issue]:
    """Each says inside which run it is of, and what it shows."""
    names = output_files.present(folder, kind)
    for path in (folder / each for each in names if each.startswith(f"{output_files.FIGURES}/")):
        content = path.read_bytes()
        if mark.encode() not in content:
            yield Issue(str(path), "is a figure of another run")
        elif f"{name}: {path.stem}".encode() not in content:
            yield Issue(str(path), "is another figure than its name says")
