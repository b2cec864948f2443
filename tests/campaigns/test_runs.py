"""Which runs a campaign has, and the mistakes of its file, its table and its records."""

import math
import re
from pathlib import Path

import numpy as np
import pytest
from support import campaigns
from support.command_line import assert_refused, cli

from bayesdrill.campaigns.records import overridden
from bayesdrill.campaigns.runs import describe_plan, natural_key, read_plan

DAY = 86400.0


def names(path: Path) -> list[str]:
    return [run.name for run in read_plan(path).runs]


def test_a_run_without_a_noted_number_is_kept_and_named(tmp_path: Path) -> None:
    path = campaigns.campaign(tmp_path)
    table = tmp_path / "runs" / "runs.csv"
    table.write_text(re.sub(r"(run_3,2.0,).*", r"\1", table.read_text()))
    plan = read_plan(path)
    assert math.isnan(plan.runs[2].noted["temperature"])
    assert plan.notes == ("temperature was not noted in 1 of 6 runs: run_3",)
    assert [run.time for run in plan.runs] == [DAY * k for k in range(6)]


def test_dates_become_seconds_since_the_first_run(tmp_path: Path) -> None:
    path = campaigns.campaign(tmp_path)
    table = tmp_path / "runs" / "runs.csv"
    text = table.read_text()
    for k in range(6):
        text = text.replace(f",{k}.0,", f",2026-03-{20 - 2 * k}T12:00,")
    table.write_text(text)
    plan = read_plan(path)
    assert [run.name for run in plan.runs] == [f"run_{k}" for k in range(6, 0, -1)]
    assert [run.time for run in plan.runs] == [2 * DAY * k for k in range(6)]


def test_a_glob_a_list_and_a_parquet_table_list_the_same_runs(tmp_path: Path) -> None:
    pyarrow = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    path = campaigns.campaign(tmp_path)
    wanted = names(path)
    plain = campaigns.CAMPAIGN.replace("noted: [temperature]", "by_name: true")
    path.write_text(plain.replace("runs/runs.csv", "runs/run_*.csv"))
    plan = read_plan(path)
    assert {run.name: run.time for run in plan.runs} == {n: DAY * k for k, n in enumerate(wanted)}
    assert "times: equal steps, in the order of names" in describe_plan(plan, ())
    listed = ", ".join(f"{{file: runs/{name}.csv}}" for name in wanted)
    path.write_text(plain.replace("runs/runs.csv", f"[{listed}]"))
    assert names(path) == wanted
    columns = {"file": [f"{name}.csv" for name in wanted], "rig": [0, 1] * 3, "time": [np.nan] * 6}
    parquet.write_table(pyarrow.table(columns), tmp_path / "runs" / "runs.parquet")
    path.write_text(plain.replace("runs.csv", "runs.parquet"))
    rigs = {run.name: run.rig for run in read_plan(path).runs}
    assert rigs == {f"run_{k + 1}": f"{k % 2}" for k in range(6)}


def test_numbers_in_names_are_counted() -> None:
    assert sorted(["run_10", "run_9", "run_1b"], key=natural_key) == ["run_1b", "run_9", "run_10"]


def test_all_bad_records_are_named_and_can_be_left_out(tmp_path: Path) -> None:
    path = campaigns.campaign(tmp_path)
    runs = tmp_path / "runs"
    (runs / "run_2.csv").unlink()
    (runs / "run_3.csv").write_text((runs / "run_3.csv").read_text().replace("w_1", "w_9"))
    (runs / "run_4.csv").write_text("")
    result = cli("check", path)
    assert_refused(result, "3 of 6 runs cannot be used", "run run_2 (", "there is no such file")
    assert_refused(result, "run run_3 (", "no column 'w_1'; did you mean w_9", "run run_4 (")
    path.write_text(campaigns.CAMPAIGN + "leave_out: [run_2, run_3, run_4]\n")
    result = cli("check", path)
    assert result.status == 0, result.err
    assert "campaign many: 3 runs" in result.out
    assert "left out by name: run_2, run_3, run_4" in result.out


def test_another_name_of_a_file_is_no_second_run(tmp_path: Path) -> None:
    path = campaigns.campaign(tmp_path)
    runs = tmp_path / "runs"
    (runs / "run_3.csv").unlink()
    (runs / "run_3.csv").symlink_to(runs / "run_2.csv")
    assert_refused(cli("check", path), "run run_3 (", "is another name of the file of run_2")


def test_a_channel_in_another_unit_is_named(tmp_path: Path) -> None:
    path = campaigns.campaign(tmp_path)
    change = "overrides: {run_5: {record: {channels: {w_1: {unit: rpm, sigma: 0.5}}}}}\n"
    path.write_text(campaigns.CAMPAIGN + change)
    assert "w_1 of run_5 is 0.10" in cli("check", path).out


def test_overrides_change_entries_as_an_experiment_does_and_null_removes_one() -> None:
    """An entry of another kind, such as a value for a prior, takes the place of the common one."""
    common = {"v": {"prior": "uniform", "low": 1}, "record": {"window": [0, 2], "unit": "s"}}
    changes = {"v": {"value": 3}, "record": {"window": None, "unit": "ms"}}
    assert overridden(common, changes) == {"v": {"value": 3}, "record": {"unit": "ms"}}
    assert common["record"] == {"window": [0, 2], "unit": "s"}
