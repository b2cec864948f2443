"""Whether config, record, tables and figures of a folder still belong together."""

from __future__ import annotations

import csv
import dataclasses
import io
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

from bayesdrill.basics import own_files
from bayesdrill.basics.errors import InputError, Problem
from bayesdrill.basics.own_files import COMPARE, MAP, OVERLAY, POSTERIOR, Kind
from bayesdrill.commands import comparing, mapping, overlaying, pipeline
from bayesdrill.commands.concluding import concluded
from bayesdrill.insight.comparison import Contender
from bayesdrill.insight.overlay import Layer
from bayesdrill.report import comparison_report, overlay_report, publish
from bayesdrill.report.comparison_report import ComparisonReport
from bayesdrill.report.overlay_report import OverlayReport
from bayesdrill.results import provenance, run_folder
from bayesdrill.setup import experiments, loading, rungs, sources, yaml_source
from bayesdrill.setup.config import Config
from bayesdrill.setup.own_units import SI

SAME = 1e-6  # relative: numbers that other versions of a library round otherwise


@dataclass(frozen=True, slots=True)
class Verified:
    """`problems`: each file that does not belong to the run, and why; `checked`: how many do;
    `what`: which things belong together, and what `follows` from them.
    """

    folder: Path
    checked: int
    problems: tuple[Problem, ...]
    what: str = "config, record, chain"
    follows: str = "the tables follow from the chain"

    @property
    def together(self) -> bool:
        return not self.problems

    @property
    def said(self) -> str:
        if self.together:
            files = f"{self.what} and {self.checked} files belong together"
            return f"{self.folder}: {files}; {self.follows}"
        return "\n".join(map(str, self.problems))

    def __str__(self) -> str:
        return self.said

    __repr__ = __str__


@dataclass(frozen=True, slots=True)
class _Way:
    """How the results of a job are looked at."""

    kind: Kind
    problems: Callable[[Path, Mapping[str, Any]], Iterator[Problem]]
    what: str
    follows: str


def verify(folder: Path) -> Verified:
    """Nothing is written.  Raises `InputError` where there is no finished run."""
    run = run_folder.read_run(folder)
    way = None if run is None else _WAYS.get(str(run.get("job")))
    if run is None or way is None:
        message = "no results of `bayesdrill posterior`, `map`, `compare`, `ladder` or an overlay"
        raise InputError.one(str(folder), message)
    files = run.get("files")
    if run.get("status") != "finished" or not isinstance(files, dict):
        message = (
            "this run is not finished, or of an older version; `bayesdrill report` makes it anew"
        )
        raise InputError.one(str(folder), message)
    found = tuple(dict.fromkeys([*_changed(folder, way.kind, files), *way.problems(folder, run)]))
    checked = len(files) - len({problem.place for problem in found})
    return Verified(folder, checked, found, way.what, way.follows)


def _of_posterior(folder: Path, _: Mapping[str, Any]) -> Iterator[Problem]:
    yield from _configs(folder)
    try:
        view = concluded(*pipeline.read(folder))
    except InputError as error:  # another record, a config of another run, a damaged chain
        yield from error.problems
        return
    texts = {name: table(view) or "" for name, table in publish.TABLES.items()}
    yield from _tables(folder, texts, "the chain")
    mark = view.marks[provenance.RUN_MARK]
    yield from _figures(folder, POSTERIOR, mark, view.config.name)


def _of_map(folder: Path, _: Mapping[str, Any]) -> Iterator[Problem]:
    yield from _configs(folder)
    try:
        job, found = mapping.read(folder)
    except InputError as error:
        yield from error.problems
        return
    yield from _tables(folder, mapping.report(job, found).numbers, pipeline.MAP_FILE)
    mark = mapping.mark(job)[provenance.RUN_MARK]
    yield from _figures(folder, MAP, mark, job.config.name)


@dataclass(frozen=True, slots=True)
class _Several:
    """How what is said of several runs is made again: of each by `read`, and of all by `text`."""

    kind: Kind
    title: str
    table: str
    done: str
    read: Callable[[str, Path], tuple[str, Any]]
    text: Callable[[Sequence[Any]], str]

    def problems(self, folder: Path, run: Mapping[str, Any]) -> Iterator[Problem]:
        """Of runs that were only in memory nothing can be computed again."""
        found, told = [], run.get("runs", [])
        if len(told) < 2:
            yield Problem(str(folder / own_files.RUN), "names no two runs")
            return
        for one in told:
            if one["folder"] is None:
                continue
            place = folder / one["folder"]
            try:
                mark, own = self.read(one["name"], place)
            except InputError as error:
                yield from error.problems
                continue
            if mark != one["run"]:
                yield Problem(str(place), f"is another run than the one that was {self.done}")
            else:
                found.append(own)
        if len(found) == len(told):
            yield from _tables(folder, {self.table: self.text(found)}, "the chains")
        mark = " ".join(one["run"] for one in told)
        yield from _figures(folder, self.kind, mark, self.title)


def _layer(name: str, place: Path) -> tuple[str, Layer]:
    job, found, sampled = pipeline.read(place)
    layer = overlaying.layer(name, job, found, sampled, job.units)
    return layer.mark, layer


def _contender(name: str, place: Path) -> tuple[str, Contender]:
    job, found, sampled = pipeline.read(place)
    model = comparing.contender(name, str(place), job, found, sampled, job.units)
    return model.layer.mark, model


_OVERLAY = _Several(
    kind=OVERLAY,
    title=overlaying.TITLE,
    table=overlay_report.TABLE,
    done="laid over others",
    read=_layer,
    text=lambda layers: OverlayReport(tuple(layers), SI).texts[overlay_report.TABLE],
)
_COMPARISON = _Several(
    kind=COMPARE,
    title=comparing.TITLE,
    table=comparison_report.TABLE,
    done="compared with others",
    read=_contender,
    text=lambda models: ComparisonReport(tuple(models), SI).texts[comparison_report.TABLE],
)
_LADDER = dataclasses.replace(_COMPARISON, kind=own_files.ladder(rungs.names()))


def _of_ladder(folder: Path, run: Mapping[str, Any]) -> Iterator[Problem]:
    """Its rungs, each a run of its own, and what is said of them together."""
    yield from _configs(folder)
    for one in run.get("runs", []):
        if one["folder"] not in _LADDER.kind.nested:
            yield Problem(str(folder / own_files.RUN), f"{one['folder']} is no rung of a ladder")
            continue
        try:
            yield from verify(folder / one["folder"]).problems
        except InputError as error:  # no finished run
            yield from error.problems
    yield from _LADDER.problems(folder, run)


_WAYS: Mapping[str, _Way] = MappingProxyType(
    {
        POSTERIOR.job: _Way(
            POSTERIOR, _of_posterior, "config, record, chain", "the tables follow from the chain"
        ),
        MAP.job: _Way(
            MAP, _of_map, "config, record, maximum", "table and prediction follow from the maximum"
        ),
        COMPARE.job: _Way(
            COMPARE, _COMPARISON.problems, "runs", "the table follows from their chains"
        ),
        _LADDER.kind.job: _Way(
            _LADDER.kind, _of_ladder, "config, rungs", "the table follows from their chains"
        ),
        OVERLAY.job: _Way(
            OVERLAY, _OVERLAY.problems, "runs", "the table follows from their chains"
        ),
    }
)


def _changed(folder: Path, kind: Kind, files: Mapping[str, str]) -> Iterator[Problem]:
    there = own_files.present(folder, kind)
    for name, digest in files.items():
        place = str(folder / name)
        if name not in there:
            yield Problem(place, "is missing; `bayesdrill report` makes tables and figures again")
        elif own_files.digest(folder / name) != digest:
            yield Problem(place, "was changed after this run had written it")
    for name in there:
        if name not in files and name != kind.mark:
            yield Problem(str(folder / name), "was not written by this run")


def _configs(folder: Path) -> Iterator[Problem]:
    """The config as given says what the one with all defaults does."""
    given, resolved = (
        _settings(folder / name) for name in (own_files.CONFIG_FILE, own_files.RESOLVED_FILE)
    )
    if None not in (given, resolved) and given != resolved:
        place = str(folder / own_files.CONFIG_FILE)
        yield Problem(place, f"is not the config of this run, which is {own_files.RESOLVED_FILE}")


def _settings(path: Path) -> dict[str, Any] | None:
    """All but where the record is; None where that cannot be read, which is said elsewhere."""
    try:
        source = yaml_source.read(path)
        config: Config = loading.validated(source)
    except InputError:
        return None
    own = (*experiments.SECTIONS, experiments.EXPERIMENTS)
    settings = config.model_dump(exclude_none=True, exclude=set(own))
    for view in experiments.views(config, source):
        alone = view.config.model_dump(exclude_none=True, include=set(experiments.SECTIONS))
        for section, key in sources.named_in(alone):
            del section[key]
        settings[f"experiment {view.label}"] = alone
    return settings | {"held out": experiments.held_out(config)}


def _tables(folder: Path, texts: Mapping[str, str], source: str) -> Iterator[Problem]:
    for name, text in texts.items():
        path = folder / name
        if path.exists() and not _same(path.read_text(encoding="utf-8", errors="replace"), text):
            yield Problem(str(path), f"does not follow from {source}")


def _same(found: str, expected: str) -> bool:
    """To the digits that other versions of a library leave."""
    try:
        one, other = (list(csv.reader(io.StringIO(text))) for text in (found, expected))
    except csv.Error:
        return False
    if [len(row) for row in one] != [len(row) for row in other]:
        return False
    pairs = ((a, b) for r, s in zip(one, other, strict=True) for a, b in zip(r, s, strict=True))
    return all(a == b or _near(a, b) for a, b in pairs)


def _near(one: str, other: str) -> bool:
    try:
        return math.isclose(float(one), float(other), rel_tol=SAME, abs_tol=1e-12)
    except ValueError:
        return False


def _figures(folder: Path, kind: Kind, mark: str, name: str) -> Iterator[Problem]:
    """Each says inside which run it is of, and what it shows."""
    for file in own_files.present(folder, kind):
        path = folder / file
        if not file.startswith(f"{own_files.FIGURES}/"):
            continue
        content = path.read_bytes()
        if mark.encode() not in content:
            yield Problem(str(path), "is a figure of another run")
        elif f"{name}: {path.stem}".encode() not in content:
            yield Problem(str(path), "is another figure than its name says")
