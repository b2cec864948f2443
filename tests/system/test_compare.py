"""`bayesdrill compare RUN RUN ...`: models of one record, and the verdict that they come to."""

import json
from pathlib import Path

import pytest
from support import command_line, finished_runs
from support.command_line import assert_refused, cli, table

from bayesdrill.output_files import dumps_checksummed, loads_checksummed

HELD_OUT = ("  time: {column: t, unit: s}", "  time: {column: t, unit: s}\n  held_out: [3, 4]")
WRONG = ("  j_1: {prior: uniform, low: 0.5, high: 1.5, relative: true}", "  j_1: 0.02")
UNKNOWN_NOISE = (
    "theta_1, unit: rad, sigma: 0.05",
    "theta_1, unit: rad, sigma: {prior: log_uniform, low: 0.01, high: 1}",
)
CHANGES = {
    "given": [HELD_OUT],
    "wrong": [HELD_OUT, WRONG],
    "unsure": [HELD_OUT, UNKNOWN_NOISE],
    "whole": [],
}


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("models")
    for name, changes in CHANGES.items():
        result = finished_runs.posterior(
            tmp_path_factory, place, name, *changes, causes=name != "wrong"
        )
        assert result.status == (3 if name == "wrong" else 0), result.text
    return place


runs = pytest.fixture(finished_runs.copied, name="runs")


def evidence(folder: Path) -> float:
    return float(json.loads((folder / "run.json").read_text())["evidence"]["log_z"])


@pytest.mark.slow
def test_a_wrong_model_is_found_and_no_noise_makes_up_for_it(runs: Path) -> None:
    """A rotor that is held at the wrong inertia: table, verdict and figure."""
    out = runs / "out"
    result = cli("compare", runs / "wrong", runs / "given", runs / "unsure", "-o", out)
    assert result.status == 0, result.text
    rows = table(out / "comparison.csv", "model")
    assert list(rows) == ["wrong", "given", "unsure"]
    for name, row in rows.items():
        assert float(row["log_evidence"]) == evidence(runs / name)
        assert int(row["held_out_samples"]) == 2 * 21
    assert float(rows["given"]["log_odds"]) == 0.0
    assert float(rows["wrong"]["held_out"]) < float(rows["given"]["held_out"])
    assert rows["wrong"]["loo"] == ""
    assert "not white" in rows["wrong"]["loo_refused"]
    assert float(rows["given"]["loo"]) == pytest.approx(float(rows["unsure"]["loo"]), abs=10)
    assert rows["wrong"]["sigma_theta_1_mean"] == ""
    assert "verdict: MODEL: given is e^" in result.out
    assert "the residuals of given look like the noise" in result.out
    page = (out / "comparison.md").read_text(encoding="utf-8")
    assert page.index("## Verdict") < page.index("## Figures") < page.index("## Models")
    for end in ("pdf", "png"):
        assert (out / "figures" / f"comparison.{end}").stat().st_size > 5000
    run = json.loads((out / "run.json").read_text())
    assert (run["verdict"], run["best"]) == ("model", "given")
    assert cli("verify", out).status == 0


@pytest.mark.slow
def test_a_run_that_has_seen_what_another_holds_out_is_of_another_record(runs: Path) -> None:
    result = cli("compare", runs / "given", runs / "whole", "-o", runs / "out")
    message = "this run has another record, but odds compare models of one record"
    assert_refused(result, f"{runs / 'whole'}: {message}")
    assert_refused(result, "by `bayesdrill report`. The record is 101 samples")
    assert_refused(result, ", some samples held out in ")
    assert not (runs / "out").exists()
    assert evidence(runs / "whole") > evidence(runs / "given")


@pytest.mark.slow
def test_a_run_without_evidence_gets_it_by_resuming(runs: Path) -> None:
    path = runs / "given" / "run.json"
    run = loads_checksummed(path.read_bytes())
    before = run["evidence"]["log_z"]
    path.write_text(dumps_checksummed(run | {"evidence": None}))
    result = cli("compare", runs / "given", runs / "unsure", "-o", runs / "out")
    assert_refused(result, "has no log evidence")
    resumed = command_line.posterior(runs / "given.yaml", runs / "given", "--resume")
    assert resumed.status == 0
    assert evidence(runs / "given") == before
