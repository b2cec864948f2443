"""Whether config, record, tables and figures of a folder still belong together."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bayesdrill.basics import own_files
from bayesdrill.basics.errors import InputError, Problem
from bayesdrill.basics.own_files import POSTERIOR
from bayesdrill.commands import pipeline
from bayesdrill.commands.concluding import concluded
from bayesdrill.report import publish
from bayesdrill.report.view import View
from bayesdrill.results import provenance, run_folder
from bayesdrill.setup import loading, yaml_source
from bayesdrill.setup.config import Config

SAME = 1e-6  # relative: numbers that other versions of a library round otherwise


@dataclass(frozen=True, slots=True)
class Verified:
    """`problems`: each file that does not belong to the run, and why; `checked`: how many do."""

    folder: Path
    checked: int
    problems: tuple[Problem, ...]

    @property
    def together(self) -> bool:
        return not self.problems

    @property
    def said(self) -> str:
        if self.together:
            return (
                f"{self.folder}: config, record, chain and {self.checked} files belong together; the "
                "tables follow from the chain"
            )
        return "\n".join(map(str, self.problems))

    def __str__(self) -> str:
        return self.said

    __repr__ = __str__


def verify(folder: Path) -> Verified:
    """Nothing is written.  Raises `InputError` where there is no finished run."""
    run = run_folder.read_run(folder)
    if run is None or run.get("job") != POSTERIOR.job:
        raise InputError.one(str(folder), "no results of `bayesdrill posterior` are here")
    files = run.get("files")
    if run.get("status") != "finished" or not isinstance(files, dict):
        message = (
            "this run is not finished, or of an older version; `bayesdrill report` makes it anew"
        )
        raise InputError.one(str(folder), message)
    problems = [*_changed(folder, files), *_configs(folder)]
    try:
        view = _viewed(folder)
    except InputError as error:  # another record, a config of another run, a damaged chain
        problems += error.problems
    else:
        problems += [*_tables(folder, view), *_figures(folder, view)]
    found = tuple(dict.fromkeys(problems))
    return Verified(folder, len(files) - len({problem.place for problem in found}), found)


def _changed(folder: Path, files: Mapping[str, str]) -> Iterator[Problem]:
    there = own_files.present(folder, POSTERIOR)
    for name, digest in files.items():
        place = str(folder / name)
        if name not in there:
            yield Problem(place, "is missing; `bayesdrill report` makes tables and figures again")
        elif own_files.digest(folder / name) != digest:
            yield Problem(place, "was changed after this run had written it")
    for name in there:
        if name not in files and name != POSTERIOR.mark:
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
        config: Config = loading.validated(yaml_source.read(path))
    except InputError:
        return None
    settings = config.model_dump(exclude_none=True)
    settings["record"].pop("file")
    return settings


def _viewed(folder: Path) -> View:
    """From the chain; raises `InputError` where record or config are not those of the chain."""
    job, found, sampled = pipeline.read(folder)
    return concluded(job, found, sampled)


def _tables(folder: Path, view: View) -> Iterator[Problem]:
    for name, table in publish.TABLES.items():
        path, text = folder / name, table(view) or ""
        if path.exists() and not _same(path.read_text(encoding="utf-8"), text):
            yield Problem(str(path), "does not follow from the chain")


def _same(found: str, expected: str) -> bool:
    """To the digits that other versions of a library leave."""
    one, other = (list(csv.reader(io.StringIO(text))) for text in (found, expected))
    if [len(row) for row in one] != [len(row) for row in other]:
        return False
    pairs = ((a, b) for r, s in zip(one, other, strict=True) for a, b in zip(r, s, strict=True))
    return all(a == b or _near(a, b) for a, b in pairs)


def _near(one: str, other: str) -> bool:
    try:
        return math.isclose(float(one), float(other), rel_tol=SAME, abs_tol=1e-12)
    except ValueError:
        return False


def _figures(folder: Path, view: View) -> Iterator[Problem]:
    """Each says inside which run it is of, and what it shows."""
    mark = view.marks[provenance.RUN_MARK]
    for name in own_files.present(folder, POSTERIOR):
        path = folder / name
        if not name.startswith(f"{own_files.FIGURES}/"):
            continue
        content = path.read_bytes()
        title = f"{view.config.name}: {path.stem}".encode()
        if mark.encode() not in content:
            yield Problem(str(path), "is a figure of another run")
        elif title not in content:
            yield Problem(str(path), "is another figure than its name says")
