"""Add new runs to a campaign as their files arrive, and raise each alarm once."""

from __future__ import annotations

import glob
import json
import time
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

from bayesdrill.basics.errors import InputError
from bayesdrill.basics.progress import Reporter, rest
from bayesdrill.campaigns.conclusion import Alarm
from bayesdrill.campaigns.records import KnownRecords, stamp_of
from bayesdrill.campaigns.runs import CampaignPlan, read_plan
from bayesdrill.campaigns.study import kept_record, run_campaign
from bayesdrill.output_files import RUN, refuse_unwritable
from bayesdrill.results.run_folder import WriteMode
from bayesdrill.tasks.remote import RefitExecutor

SETTLED = 2.0  # a file counts as complete after this time without a change [s]
State = dict[Path, frozenset[str] | tuple[int, ...]]  # files of a glob, and stamps of files


def watch(
    path: Path, output: Path, crew: RefitExecutor, report: Reporter, interval: float, *, once: bool
) -> Iterator[str]:
    """Yield new alarms as lines of JSON; `output` is updated whenever files arrive or change.

    Raises `InputError` at once if the output cannot be written.
    """
    refuse_unwritable(output)
    before = kept_record(output)  # if this record is unreadable, old alarms are raised again
    known, raised = KnownRecords(), {*map(_subject, before.alarms if before else ())}
    plan = read_plan(path)
    while True:
        unread = _unread(plan, known)
        seen = _state(plan, unread)  # no change from now on is lost
        newest = max((stamp_of(path)[1] for path in unread), default=0) / 1e9
        time.sleep(min(max(newest + SETTLED - time.time(), 0.0), SETTLED))
        how: WriteMode = "resume" if (output / RUN).exists() else "fresh"
        alarms = tuple[Alarm, ...]()
        try:
            alarms = run_campaign(plan, output, how, crew, report, known).record.alarms
        except InputError as error:  # too few runs are good so far
            if once:
                raise
            report.say(str(error))
        for alarm in alarms:
            if _subject(alarm) not in raised:
                raised.add(_subject(alarm))
                yield json.dumps({"campaign": plan.spec.name, **asdict(alarm)})
        if once:
            return
        report.say(f"watching {plan.source.path}; Ctrl-C stops")
        plan = _next_plan(path, plan, _unread(plan, known), seen, report, interval)


def _next_plan(
    path: Path, plan: CampaignPlan, bad: list[Path], seen: State, report: Reporter, interval: float
) -> CampaignPlan:
    """Wait until the state of `plan` differs from `seen`, and return the new plan."""
    while True:
        while (state := _state(plan, bad)).items() <= seen.items():
            rest(interval)
        try:
            return read_plan(path)
        except InputError as error:  # perhaps half of a file, so it is read again when it changes
            report.say(str(error))
            seen = state


def _unread(plan: CampaignPlan, cached_records: KnownRecords) -> list[Path]:
    """Return the records that are not read yet, or are bad."""
    return [run.path for run in plan.runs if run.name not in cached_records]


def _state(plan: CampaignPlan, unread: list[Path]) -> State:
    """Return stamps of the campaign's files and of `unread` records, and the files of a glob."""
    runs, path = plan.spec.runs, plan.source.path
    table = path.parent / runs if isinstance(runs, str) else path
    state: State = {file: stamp_of(file) for file in (path, table, *unread)}
    if isinstance(runs, str) and glob.has_magic(runs):
        state[table] = frozenset(glob.iglob(runs, root_dir=path.parent, recursive=True))
    return state


def _subject(alarm: Alarm) -> tuple[str, str, str]:
    """Return kind, run and product of an alarm; numbers in its sentence change with each run."""
    return alarm.kind, alarm.run, alarm.product
