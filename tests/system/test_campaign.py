"""`bayesdrill campaign` and `watch`: the same draws however they are computed, and alarms once."""

import csv
import json
import os
import signal
import time
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from support import campaigns, command_line
from support.campaigns import Finished
from support.command_line import CONFIGS, assert_refused, cli, replace_text

from bayesdrill.campaigns import study
from bayesdrill.campaigns.draws import CampaignDraws
from bayesdrill.campaigns.fit import PopulationFit, fit_population
from bayesdrill.output_files import CAMPAIGN

parquet = pytest.importorskip("pyarrow.parquet")

PAGES = {"report.html", "summary.md", "population.csv", "runs.parquet", "campaign.json"}
FILES = {*PAGES, ".lock", "run.json", "reference.json", "campaign.yaml", "draws", "figures"}


@pytest.fixture
def finished(tmp_path_factory: pytest.TempPathFactory) -> Finished:
    """A finished campaign, not to be changed."""
    return campaigns.finished(tmp_path_factory.getbasetemp())


def finished_text(campaign: Finished) -> str:
    """Return the text that the command printed, with the folder of this copy."""
    return campaign.result.out.replace(
        campaign.result.out.split("results: ")[1].split(" (")[0], f"{campaign.folder}/"
    )


@pytest.fixture
def copy(finished: Finished, tmp_path: Path) -> Finished:
    """The same, to be changed."""
    return finished.copied(tmp_path / "copy")


def test_a_campaign_leaves_its_pages_tables_and_draws(finished: Finished) -> None:
    assert "Traceback" not in finished.result.text
    assert finished.result.out.splitlines()[-2].startswith("4 runs: fewer than 8 different times")
    listed = {*command_line.listing(finished.folder)}
    assert {name for name in listed if "/" not in name} == FILES
    assert all(CAMPAIGN.is_output(name) for name in listed - {".lock", "draws", "figures"})
    assert len(finished.draws) == 4
    table = parquet.read_table(finished.folder / "runs.parquet").to_pydict()
    assert table["name"] == [f"run_{k}" for k in range(1, 5)]
    assert table["time"] == [86400.0 * k for k in range(4)]


def test_each_run_and_the_population_are_those_that_were_simulated(finished: Finished) -> None:
    with (finished.path.parent / "runs" / "truth.csv").open() as file:
        truth = [*csv.DictReader(file)]
    table = parquet.read_table(finished.folder / "runs.parquet").to_pydict()
    names = finished.record["population"]["products"]
    assert {*names} == {"k_e", "j_1"}
    for name in names:
        true = np.log([float(row[name]) for row in truth])
        off = (np.array(table[f"{name} alone"]) - true) / np.array(table[f"{name} alone_sd"])
        assert np.all(np.abs(off) < 4.0)
        (known,) = (p for p in finished.record["population"]["populations"] if p["product"] == name)
        assert abs(known["centre"]["mean"] - true.mean()) < 3 * known["centre"]["sd"]


@pytest.mark.slow
def test_resuming_fits_only_missing_damaged_and_changed_runs(copy: Finished) -> None:
    """The missing one gets the same bytes, though it is now computed first."""
    before, times = copy.draws, copy.times
    missing, damaged = sorted(before)[:2]
    (copy.folder / "draws" / missing).unlink()
    (copy.folder / "draws" / damaged).write_bytes(before[damaged][:-20])
    assert "Traceback" not in copy.command("campaign", "--resume").text
    assert copy.draws == before
    assert {name for name in before if copy.times[name] != times[name]} == {missing, damaged}
    times = copy.times
    record = copy.path.parent / "runs" / "run_2.csv"
    record.write_text("\n".join(record.read_text().splitlines()[:-10]) + "\n")
    copy.command("campaign", "--resume")
    assert sum(copy.draws[name] != before[name] for name in before) == 1
    assert sum(copy.times[name] != times[name] for name in before) == 1


def test_a_population_is_sampled_again_only_when_something_that_decides_it_changes(
    copy: Finished, monkeypatch: pytest.MonkeyPatch
) -> None:
    sampled = list[int]()

    def count(draws: CampaignDraws, *rest: Any) -> PopulationFit:
        sampled.append(len(draws.runs))
        return fit_population(draws, *rest)

    monkeypatch.setattr(study, "fit_population", count)
    same = PAGES - {"report.html", "runs.parquet"}  # the page names the folder
    pages = {name: (copy.folder / name).read_bytes() for name in same}
    assert "Traceback" not in copy.command("watch", "--once").text
    assert copy.command("campaign", "--resume").out == finished_text(copy)
    assert sampled == []
    assert pages == {name: (copy.folder / name).read_bytes() for name in pages}
    record = copy.folder / "campaign.json"
    record.write_text(record.read_text().replace("k_e", "k_x", 1))
    copy.command("campaign", "--resume")
    assert record.read_bytes() == pages["campaign.json"]
    replace_text(copy.path.parent / "runs" / "runs.csv", "run_2,1.0", "run_2,1.5")
    copy.command("watch", "--once")
    assert sampled == [4, 4]
    assert copy.record["mark"] != json.loads(pages["campaign.json"])["mark"]
    replace_text(copy.path.parent / "runs" / "runs.csv", "run_2,1.5", "run_2,1.7")
    monkeypatch.setattr(study, "fit_population", Mock(side_effect=KeyboardInterrupt))
    assert "`bayesdrill watch` continues it" in copy.command("watch", "--once").text


@pytest.mark.slow
def test_a_run_has_a_page_on_demand_to_which_its_points_link(copy: Finished) -> None:
    """A page of other draws is none, so that its links go when a record changes."""
    assert 'class="links"' in (copy.folder / "report.html").read_text()
    assert "--page run_2 makes its page" in (copy.folder / "report.html").read_text()
    assert "Traceback" not in copy.command("campaign", "--page", "run_2").text
    (page,) = (copy.folder / "pages").glob("*.html")
    text = page.read_text()
    assert "In the campaign" in text
    assert "<h1>Run run_2</h1>" in text
    assert f'<a href="../report.html">Campaign {copy.record["name"]}</a>' in text
    assert "data:image/png" in text
    assert f'<a href="pages/{page.name}">' in (copy.folder / "report.html").read_text()
    assert copy.record["reasons"] == {"run_2": ""}
    assert_refused(copy.command("campaign", "--page", "run_9"), "--page: no run is called run_9")
    record = copy.path.parent / "runs" / "run_2.csv"
    record.write_text("\n".join(record.read_text().splitlines()[:-10]) + "\n")
    copy.command("campaign", "--resume")
    assert copy.record["reasons"] == {}
    assert "<a href" not in (copy.folder / "report.html").read_text().split("<main>")[1]


def test_watch_takes_up_new_runs_and_raises_each_alarm_once(copy: Finished) -> None:
    """A run that cannot be read is an alarm, and joins when it is mended."""
    before = copy.draws
    runs = copy.path.parent / "runs"
    replace_text(copy.path, "runs/runs.csv", "runs/run_*.csv")
    replace_text(copy.path, "noted: [temperature]\nsimulation", "by_name: true\nsimulation")
    good = (runs / "run_1.csv").read_text()
    (runs / "run_5.csv").write_text(good.replace("w_1", "w_9").replace("theta_1", "theta_9"))
    os.utime(runs / "run_5.csv", (1e9, 1e9))
    first = copy.command("watch", "--once")
    (alarm,) = [json.loads(line) for line in first.out.splitlines() if "run_5" in line]
    assert [alarm[k] for k in ("campaign", "kind", "run")] == ["many", "not used", "run_5"]
    assert all(f"no column '{name}'" in alarm["sentence"] for name in ("w_1", "theta_1"))
    assert copy.draws == before
    assert "run_5" not in copy.command("watch", "--once").out
    (runs / "run_5.csv").write_text(good)
    copy.command("watch", "--once")
    assert len(copy.draws) == 5
    assert [run["name"] for run in copy.record["population"]["runs"]][-1] == "run_5"
    assert copy.record["not_used"] == {}


def test_simulated_campaigns_have_drift_jump_and_foreign_runs(tmp_path: Path) -> None:
    text = (CONFIGS / "changing_campaign.yaml").read_text(encoding="utf-8")
    path = campaigns.campaign(tmp_path, text=text)
    with (tmp_path / "runs" / "truth.csv").open() as file:
        rows = [*csv.DictReader(file)]
    k_s, j_1, k_e = (np.array([float(row[n]) for row in rows]) for n in ("k_s", "j_1", "k_e"))
    assert k_s[1:] / k_s[0] == pytest.approx([1.01, 1.02, 1.03, 1.04], rel=1e-6)
    assert j_1 / j_1[0] == pytest.approx([1, 1, 1, 1.1, 1.1], rel=1e-6)
    assert sorted(k_e / k_e.min()) == pytest.approx([1, 1, 1, 1, 1.5], rel=1e-6)
    shown = cli("check", path).out
    assert "5 runs of 2 rigs" in shown
    assert shown.endswith("\nThe campaign has no mistakes and can run.\n")


@pytest.mark.slow
def test_two_workers_write_the_bytes_of_one_also_after_a_kill(
    finished: Finished, tmp_path: Path
) -> None:
    other = Finished(finished.path, tmp_path / "out", finished.result)
    options = ("campaign", finished.path, "-o", other.folder, "--processes", "2")
    process = command_line.start_process(*options, cwd=tmp_path)
    deadline = time.monotonic() + 120
    while not list(other.folder.glob("draws/*.parquet")) and time.monotonic() < deadline:
        time.sleep(0.01)
    os.killpg(process.pid, signal.SIGKILL)
    process.communicate()
    assert 0 < len(other.draws) < 4
    campaigns.run(*options, "--resume")
    assert other.draws == finished.draws
    assert other.record["population"] == finished.record["population"]
