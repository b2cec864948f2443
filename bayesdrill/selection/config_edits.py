"""Merge the entries of a candidate model into a config, and write the config as text."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from bayesdrill.analysis.causes import Cause
from bayesdrill.config.building.experiments import EXPERIMENTS
from bayesdrill.config.job import Job
from bayesdrill.config.records import sources
from bayesdrill.config.yaml_source import Source, as_yaml, parse

Entries = dict[str, Any]
Place = tuple[str, ...]
SHARED = "shared"


def rounded(value: float, digits: int = 3) -> float:
    """Return a value rounded to a few significant digits, since people read a config."""
    return float(f"{value:.{digits}g}")


def log_uniform(low: float, high: float) -> Entries:
    """Return a log-uniform prior as an entry of a config."""
    return {"prior": "log_uniform", "low": rounded(low), "high": rounded(high)}


def uniform(high: float, low: float = 0.0) -> Entries:
    """Return a uniform prior as an entry of a config."""
    return {"prior": "uniform", "low": rounded(low), "high": rounded(high)}


def nested(path: Place, value: Any) -> Entries:
    """Return nested mappings with `value` at a place, such as `{record: {window: [0, 1]}}`."""
    for key in reversed(path):
        value = {key: value}
    return dict(value)


def merged(first: Mapping[str, Any], *others: Mapping[str, Any]) -> Entries:
    """Merge `others` into `first`: later entries override earlier ones, lists `shared` are joined."""
    entries = copy.deepcopy(dict(first))
    for other in others:
        for key, value in other.items():
            before = entries.get(key)
            if key == SHARED and before:
                entries[key] = [*dict.fromkeys((*before, *value))]
            elif isinstance(value, Mapping) and isinstance(before, Mapping):
                entries[key] = merged(before, value)
            else:
                entries[key] = copy.deepcopy(value)
    return entries


def leaves(lines: Mapping[str, Any], path: Place = ()) -> Iterator[Place]:
    """Yield the place of each entry in `lines` except `shared`; a prior counts as one entry."""
    for key, value in lines.items():
        if isinstance(value, Mapping) and "prior" not in value:
            yield from leaves(value, (*path, key))
        elif key != SHARED:
            yield (*path, key)


def sections(data: Mapping[str, Any]) -> Iterator[tuple[Place, Entries]]:
    """Yield the place and entries of the top level of a config, then of each experiment."""
    yield (), dict(data)
    for label, entries in (data.get(EXPERIMENTS) or {}).items():
        yield (EXPERIMENTS, label), entries


def columns(data: Mapping[str, Any], name: str) -> Iterator[tuple[Place, Entries]]:
    """Yield place and entries of the channel or input `name`, at the top level and in experiments."""
    for place, section in sections(data):
        lines_within = {
            ("record", "channels"): (section.get("record") or {}).get("channels") or {},
            ("inputs",): section.get("inputs") or {},
        }
        for inner, entries in lines_within.items():
            entry = entries.get(name)
            if isinstance(entry, dict) and "derived_from" not in entry:
                yield (*place, *inner, name), entry


def amended(job: Job, cause: Cause) -> Entries:
    """Return the config of a job with the lines of a cause, and enough walkers for all unknowns."""
    data = merged(job.source.data, parse(job.source.path, cause.lines).data)
    walkers, unknowns = (data.get("sampler") or {}).get("walkers"), len(job.problem.names)
    if isinstance(walkers, int):
        wanted = max(walkers, 2 * (unknowns + len(cause.new)))
        data["sampler"] = {**data["sampler"], "walkers": wanted}
    return data


def as_file(
    data: Mapping[str, Any], base: Source, folder: Path, about: Sequence[str], name: str = ""
) -> str:
    """Return the text of a config file for `folder`; it begins with the comments `about`.

    Paths of records become relative to `folder`, and `output` is taken from the config `base`.
    A `name` replaces the config's name, under which results are stored.
    """
    written = copy.deepcopy({key: entry for key, entry in data.items() if key != "output"})
    written |= {"output": output} if (output := base.data.get("output")) else {}
    written |= {"name": name} if name else {}
    for _, section in sections(written):
        sources.rebase(section, base.path.parent, folder)
    lines = "".join(f"# {line}\n" for line in about)
    return f"{lines}{as_yaml(written)}"
