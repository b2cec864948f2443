"""Add new runs to a campaign as their files arrive, and raise each alarm once."""

from __future__ import annotations

import glob
import json
import time
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

from bayesdrill.basics.errors import InputError
from bayesdrill.basics.progress import Reporter
from bayesdrill.campaigns.conclusion import Alarm
from bayesdrill.campaigns.fit import MIN_RUNS
from bayesdrill.campaigns.records import KnownRecords, stamp_of
from bayesdrill.campaigns.runs import CampaignPlan, read_plan
from bayesdrill.campaigns.study import kept_record, run_campaign
from bayesdrill.output_files import RUN, refuse_unwritable
from bayesdrill.results.run_folder import WriteMode
from bayesdrill.tasks.remote import RefitExecutor

SETTLED = 2.0  # a file counts as complete after this time without a change [s]


def watch(
    path: Path, output: Path, crew: RefitExecutor, report: Reporter, interval: float, *, once: bool
) -> Iterator[str]:
    """Yield new alarms as lines of JSON; `output` is updated whenever files arrive or change.

    Raises `InputError` at once if the output cannot be written.
    """
    refuse_unwritable(output)
    before = kept_record(output)  # if this record is unreadable, old alarms are raised again
    known, raised = KnownRecords(), {*map(_subject, before.alarms if before else ())}
    while True:
        plan = read_plan(path)
        _wait_until_written(plan, known)
        listing = _listing(plan)
        if len(plan.runs) >= MIN_RUNS:
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
        bad = [run.path for run in plan.runs if run.name not in known]
        seen = _state(plan, listing, bad)
        while _state(plan, _listing(plan), bad) == seen:
            time.sleep(interval)


def _listing(plan: CampaignPlan) -> frozenset[str]:
    """Return the names of all files of a glob; empty if the runs are listed in another way."""
    runs = plan.spec.runs
    if not isinstance(runs, str) or not glob.has_magic(runs):
        return frozenset()
    return frozenset(glob.iglob(runs, root_dir=plan.source.path.parent, recursive=True))


def _state(plan: CampaignPlan, listing: frozenset[str], bad: list[Path]) -> tuple[object, ...]:
    """Return a value that changes if the listing, the campaign's files or bad records change."""
    runs, path = plan.spec.runs, plan.source.path
    table = path.parent / runs if isinstance(runs, str) else path
    return (listing, *map(stamp_of, (path, table, *bad)))


def _wait_until_written(plan: CampaignPlan, cached_records: KnownRecords) -> None:
    """Wait until no new record has changed for `SETTLED` seconds."""
    new = [run.path for run in plan.runs if run.name not in cached_records]
    newest = max((stamp_of(path)[1] for path in new), default=0) / 1e9
    time.sleep(min(max(newest + SETTLED - time.time(), 0.0), SETTLED))


def _subject(alarm: Alarm) -> tuple[str, str, str]:
    """Return kind, run and product of an alarm; numbers in its sentence change with each run."""
    return alarm.kind, alarm.run, alarm.product
