"""When a watched campaign is computed again, and which alarms are raised."""

import json
import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
from support import campaigns

from bayesdrill.basics.errors import InputError
from bayesdrill.basics.progress import SILENT
from bayesdrill.campaigns import watch
from bayesdrill.campaigns.conclusion import Alarm
from bayesdrill.tasks.remote import RefitExecutor


def alarm(run: str, sentence: str) -> Alarm:
    return Alarm(kind="outlier", run=run, product="", sentence=sentence)


def _write_empty(path: Path) -> None:
    path.write_text("")
    os.utime(path, (1e9, 1e9))


def test_a_campaign_is_computed_again_only_when_files_come_or_change(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Too few good runs and half a file do not end it.  A record may change while it computes."""
    plain = campaigns.CAMPAIGN.replace("noted: [temperature]\n", "by_name: true\n", 1)
    path = campaigns.campaign(tmp_path, text=campaigns.CAMPAIGN)
    path.write_text(plain.replace("runs/runs.csv", "runs/run_*.csv"))
    runs, computed, sleeps = tmp_path / "runs", list[int](), list[float]()

    def compute(plan: Any, *_: object) -> Any:
        computed.append(len(plan.runs))
        if len(plan.runs) == 6:
            raise InputError.at("runs", "too few are good")
        if computed == [6, 7]:
            os.utime(runs / "run_1.csv", (1.1e9, 1.1e9))
        alarms = (alarm("run_1", f"{len(computed)}"), alarm(f"run_{len(plan.runs)}", "new"))
        return SimpleNamespace(record=SimpleNamespace(alarms=alarms))

    def sleep(seconds: float) -> None:
        sleeps.append(seconds)
        if sleeps.count(5.0) == 2:
            _write_empty(runs / "run_7.csv")
        if sleeps.count(5.0) == 4:
            _write_empty(runs / "run_8.csv")
        if sleeps.count(5.0) == 5:
            path.write_text("runs: [")
        if sleeps.count(5.0) == 6:
            raise KeyboardInterrupt

    monkeypatch.setattr(watch, "run_campaign", compute)
    monkeypatch.setattr(watch.time, "sleep", sleep)
    monkeypatch.setattr(watch, "rest", sleep)
    said = list[dict[str, str]]()
    lines = watch.watch(path, tmp_path / "o", cast("RefitExecutor", None), SILENT, 5.0, once=False)
    with pytest.raises(KeyboardInterrupt):
        said.extend(map(json.loads, lines))
    assert computed == [6, 7, 7, 8]
    assert [(each["run"], each["sentence"]) for each in said] == [
        ("run_1", "2"),
        ("run_7", "new"),
        ("run_8", "new"),
    ]


def test_new_files_are_awaited_until_they_are_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = campaigns.campaign(tmp_path)
    slept = list[float]()
    monkeypatch.setattr(watch.time, "sleep", slept.append)
    monkeypatch.setattr(watch, "run_campaign", lambda *_: SimpleNamespace(
        record=SimpleNamespace(alarms=())
    ))  # fmt: skip
    arguments = (path, tmp_path / "out", cast("RefitExecutor", None), SILENT, 5.0)
    assert list(watch.watch(*arguments, once=True)) == []
    assert 0.5 * watch.SETTLED < slept[0] <= watch.SETTLED
