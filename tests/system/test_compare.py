"""`bayesdrill compare RUN RUN ...`: models of one record, and the verdict that they come to."""

from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path

import pytest
from support import command_line, finished_runs

import bayesdrill as bd
from bayesdrill.output_files import dumps_checksummed, loads_checksummed

AWAY = ("  time: {column: t, unit: s}", "  time: {column: t, unit: s}\n  held_out: [3, 4]")
HELD = ("  j_1: {prior: uniform, low: 0.5, high: 1.5, relative: true}", "  j_1: 0.02")
UNKNOWN = (
    "theta_1, unit: rad, sigma: 0.05",
    "theta_1, unit: rad, sigma: {prior: log_uniform, low: 0.01, high: 1}",
)
CHANGES = {
    "given": [AWAY],
    "wrong": [AWAY, HELD],
    "unsure": [AWAY, UNKNOWN],
    "whole": [],
    "seeded": [AWAY, ("seed: 7", "seed: 8")],
}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("models")
    for name, changes in CHANGES.items():
        ran = finished_runs.posterior(
            tmp_path_factory, place, name, *changes, causes=name != "wrong"
        )
        assert ran.status == (3 if name == "wrong" else 0), ran.text
    return place


@pytest.fixture
def runs(made: Path, tmp_path: Path) -> Path:
    shutil.copytree(made, tmp_path / "models")
    return tmp_path / "models"


def table(folder: Path) -> dict[str, dict[str, str]]:
    with (folder / "comparison.csv").open(encoding="utf-8") as file:
        return {row["model"]: row for row in csv.DictReader(file)}


def evidence(folder: Path) -> float:
    return float(json.loads((folder / "run.json").read_text())["log_evidence"])


@pytest.mark.slow
def test_table_verdict_and_figure(runs: Path) -> None:
    """A rotor that is held at the wrong inertia: the model, and no noise makes up for it."""
    out = runs / "out"
    ran = command_line.cli("compare", runs / "wrong", runs / "given", runs / "unsure", "-o", out)
    assert ran.status == 0, ran.text
    lines = table(out)
    assert list(lines) == ["wrong", "given", "unsure"]
    for name, line in lines.items():
        assert float(line["log_evidence"]) == evidence(runs / name)
        assert int(line["held_out_samples"]) == 2 * 21
    assert float(lines["given"]["log_odds"]) == 0.0
    assert float(lines["wrong"]["held_out"]) < float(lines["given"]["held_out"])
    assert lines["wrong"]["loo"] == ""
    assert "not white" in lines["wrong"]["loo_refused"]
    assert float(lines["given"]["loo"]) == pytest.approx(float(lines["unsure"]["loo"]), abs=10)
    assert lines["wrong"]["sigma_theta_1_mean"] == ""
    assert "verdict: MODEL: given is e^" in ran.out
    assert "the residuals of given look like the noise" in ran.out
    page = (out / "comparison.md").read_text(encoding="utf-8")
    assert page.index("## Verdict") < page.index("## Models") < page.index("## Figures")
    for end in ("pdf", "png"):
        assert (out / "figures" / f"comparison.{end}").stat().st_size > 5000
    run = json.loads((out / "run.json").read_text())
    assert (run["verdict"], run["best"]) == ("model", "given")
    assert command_line.cli("verify", out).status == 0


@pytest.mark.slow
def test_the_same_model_twice_is_neither(runs: Path) -> None:
    found = bd.compare([runs / "given", bd.open(runs / "seeded")], names=["a", "b"])
    assert found.decision.word == "neither"
    assert abs(found.log_evidence["a"] - found.log_evidence["b"]) < 0.1
    assert "NEITHER" in found._repr_markdown_()
    assert found.plot().axes


@pytest.mark.slow
def test_what_is_held_out_is_no_evidence_and_another_record(runs: Path) -> None:
    """Mutant killed: runs of which one has seen what the other has not."""
    whole = command_line.cli("compare", runs / "given", runs / "whole", "-o", runs / "out")
    assert whole.status == 2
    assert (
        f"{runs / 'whole'}: this run is of another record, and odds compare models of one record"
        in whole.err
    )
    assert "with `bayesdrill report`. The record is 101 samples" in whole.err
    assert not (runs / "out").exists()
    assert evidence(runs / "whole") > evidence(runs / "given")


@pytest.mark.slow
def test_a_run_without_evidence_says_how_to_get_it(runs: Path) -> None:
    path = runs / "given" / "run.json"
    run = loads_checksummed(path.read_bytes())
    before = run.pop("log_evidence")
    path.write_text(dumps_checksummed(run))
    ran = command_line.cli("compare", runs / "given", runs / "unsure", "-o", runs / "out")
    assert ran.status == 2
    assert "has no log evidence" in ran.err
    config = runs / "given.yaml"
    again = command_line.cli(
        "posterior", config, "-o", runs / "given", "--resume", "--processes", "1"
    )
    assert again.status == 0
    assert evidence(runs / "given") == before


@pytest.mark.slow
def test_nothing_is_overwritten_unasked(runs: Path) -> None:
    out, two = runs / "out", (runs / "given", runs / "unsure")
    assert command_line.cli("compare", *two, "-o", out).status == 0
    (out / "notes.md").write_text("mine")
    before = command_line.listing(runs)
    for wrong, says in (
        ([*two, "-o", out], "results exist already; make them anew with --force"),
        ([*two, "-o", runs / "given", "--force"], "is one of these runs"),
        ([runs / "given", "-o", runs / "new"], "1 given; 2 to 24 runs"),
        ([runs / "given", runs / "none", "-o", runs / "new"], "none: no results here"),
        ([out, runs / "given", "-o", runs / "new"], "results of `bayesdrill compare`"),
    ):
        ran = command_line.cli("compare", *wrong)
        assert ran.status == 2, wrong
        assert says in ran.err, ran.err
        assert command_line.listing(runs) == before
    assert command_line.cli("compare", *two, "-o", out, "--force").status == 0
    assert (out / "notes.md").read_text() == "mine"


def test_stretches_that_cannot_be_held_out_are_refused(tmp_path: Path) -> None:
    for entry, says in (
        ("[4, 3]", "4 s is not before 3 s"),
        ("[7, 8]", "no sample lies in it"),
        ("[0, 5]", "leaves nothing of a channel"),
    ):
        config = command_line.small_config(tmp_path, (AWAY[0], f"{AWAY[0]}\n  held_out: {entry}"))
        ran = command_line.cli("check", config)
        assert ran.status == 2, entry
        assert says in ran.err, ran.err
        assert "record.held_out" in ran.err
