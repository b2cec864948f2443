"""Make the job of each run, and check all records before anything is computed."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from bayesdrill.basics.errors import InputError, Issue
from bayesdrill.basics.progress import Reporter
from bayesdrill.campaigns.runs import CampaignPlan, CampaignRun
from bayesdrill.config import loading
from bayesdrill.config.building.case import ResolvedCase
from bayesdrill.config.building.experiments import merged_entries
from bayesdrill.config.job import Job, assemble
from bayesdrill.config.records import sources
from bayesdrill.results import provenance

# Ratios of units that are easily mistaken for each other; the keys are words of a message.
EXCHANGED: Mapping[str, float] = {
    "rpm and rad/s": 30.0 / math.pi,
    "degrees and radians": 180.0 / math.pi,
    "revolutions and radians": 2.0 * math.pi,
    "revolutions and degrees": 360.0,
    "a unit and a thousandth of it": 1000.0,
}
FACTOR_TOLERANCE = 0.05  # largest relative deviation from such a ratio that is reported


@dataclass(frozen=True, slots=True)
class KnownRecord:
    """A known record has the `stamp_of` its file, a digest, its unknowns, and sds of its channels."""

    stamp: tuple[int, ...]
    digest: str
    unknowns: tuple[str, ...]
    sds: Mapping[str, float]


KnownRecords = dict[str, KnownRecord]  # by the name of the run


def base_job(plan: CampaignPlan, digests: Mapping[str, str]) -> Job:
    """Return the job of the base config or, if its record is missing, of the first good run."""
    case = loading.validate(plan.base)
    if all(path.exists() for path in sources.paths(case.experiments[0])):
        return assemble(case)
    return run_job(plan, next(run for run in plan.runs if run.name in digests))


def run_case(plan: CampaignPlan, run: CampaignRun, previous: ResolvedCase | None) -> ResolvedCase:
    """Return the case of a run; entries that equal those of `previous` are not validated again."""
    data = overridden(plan.base.data, run.changes)
    folder = plan.base.path.parent.resolve()
    name = sources.relative_name(folder, run.path.resolve())
    record = data.get("record", {})
    if isinstance(record, Mapping):  # validation refuses other types, with their line
        data["record"] = {**record, "file": name}
    return loading.validate(replace(plan.base, data=data, text=""), previous)


def run_job(plan: CampaignPlan, run: CampaignRun, previous: ResolvedCase | None = None) -> Job:
    """Return the job of a run; raises `InputError` with all mistakes and the name of the run."""
    try:
        return assemble(run_case(plan, run, previous))
    except InputError as error:
        raise InputError([Issue(place_of(run), str(each)) for each in error.problems]) from None


def overridden(data: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return entries merged with `changes`, as in an experiment; None removes an entry."""

    def remove(entries: dict[str, Any], changes: Mapping[str, Any]) -> None:
        for key, value in changes.items():
            if value is None:
                del entries[key]
            elif isinstance(value, Mapping):
                remove(entries[key], value)

    entries: dict[str, Any] = merged_entries(data, changes)
    remove(entries, changes)
    return entries


def place_of(run: CampaignRun) -> str:
    """Return the place of mistakes in the record of a run."""
    return f"run {run.name} ({run.path})"


def check_runs(
    plan: CampaignPlan,
    report: Reporter,
    problems: list[Issue] | None = None,
    cached_records: KnownRecords | None = None,
) -> tuple[dict[str, str], tuple[str, ...]]:
    """Read and check all records; raises `InputError` with the mistakes of all runs.

    Return for each run a digest of all inputs that determine its draws, and notes.

    If `problems` is given, mistakes are added to this list and not raised.  Records in `cached_records`
    are read again only if their files have changed, and new records are added to `cached_records`.
    """
    issues = list[Issue]() if problems is None else problems
    records = KnownRecords() if cached_records is None else cached_records
    case, good = loading.validate(plan.base), list[str]()
    wanted = next((record.unknowns for record in records.values()), ())
    files = dict[tuple[int, ...], str]()
    for k, run in enumerate(plan.runs):
        stamp = stamp_of(run.path)
        if any(stamp) and (other := files.setdefault(stamp, run.name)) != run.name:
            message = f"is another name of the file of {other}; take out one of them"
            issues.append(Issue(place_of(run), message))
            continue
        if run.name not in records or records[run.name].stamp != stamp:
            report.update(k / len(plan.runs), f"reading record {k + 1} of {len(plan.runs)}")
            try:
                made = run_job(plan, run, case)
            except InputError as error:
                issues += error.problems
                continue
            wanted = wanted or made.problem.names
            if lacking := [name for name in wanted if name not in made.problem.names]:
                message = (
                    f"has no unknown {', '.join(lacking)}, unlike other runs; correct `overrides`"
                )
                issues.append(Issue(place_of(run), message))
                continue
            experiment = made.problem.experiment
            sds = dict(zip(experiment.names, np.nanstd(experiment.y, axis=0).tolist(), strict=True))
            digest, unknowns = run_digest(plan, made), made.problem.names
            records[run.name] = KnownRecord(stamp, digest, unknowns, sds)
        good.append(run.name)
    report.update(1.0, "")
    if issues and problems is None:
        bad = f"{len(plan.runs) - len(good)} of {len(plan.runs)} runs"
        message = (
            f"{bad} cannot be used; correct them, or leave them out by name: `leave_out: [...]`"
        )
        raise InputError([plan.source.issue(("leave_out",), message), *issues])
    digests, sds = ({name: getattr(records[name], x) for name in good} for x in ("digest", "sds"))
    return digests, (*plan.notes, *_exchanged_units(sds))


def stamp_of(path: Path) -> tuple[int, ...]:
    """Return size, modification time [ns], device and inode of a file; zeros if it is missing."""
    try:
        status = path.stat()
    except (OSError, ValueError):
        return 0, 0, 0, 0
    return status.st_size, status.st_mtime_ns, status.st_dev, status.st_ino


def run_digest(plan: CampaignPlan, job: Job) -> str:
    """Return a digest of all inputs that determine the draws of a run, except the reference."""
    marks = provenance.fingerprint(job.config, job.problem)
    return digest_of(repr((sorted(marks.items()), plan.spec.seed, plan.spec.effort)))


def digest_of(text: str) -> str:
    """Return a digest of 16 hexadecimal digits."""
    return hashlib.sha256(text.encode("utf-8", "replace")).hexdigest()[:16]


def _exchanged_units(spreads: Mapping[str, Mapping[str, float]]) -> Iterator[str]:
    """Yield a sentence for each channel whose unit in a run seems to differ from other runs."""
    for channel in dict.fromkeys(name for each in spreads.values() for name in each):
        sds = {run: x for run, each in spreads.items() if (x := each.get(channel, 0.0)) > 0.0}
        middle = float(np.median([*sds.values()])) if sds else 1.0
        for run, sd in sds.items():
            ratio = max(sd / middle, middle / sd)
            for words, factor in EXCHANGED.items():
                if abs(ratio / factor - 1.0) < FACTOR_TOLERANCE:
                    yield (
                        f"{channel} of {run} is {sd / middle:.3g} times as large as in other runs, as "
                        f"if {words} were exchanged; say its unit in `overrides`, or leave the run out"
                    )
