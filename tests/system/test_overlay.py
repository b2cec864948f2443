"""`bayesdrill report RUN RUN ...`: runs of other seeds, priors and lengths laid over each other."""

from __future__ import annotations

import csv
import os
import shutil
from pathlib import Path

import pytest
from support import command_line, finished_runs, forked_command

import bayesdrill as bd
from bayesdrill.output_files import digest, dumps_checksummed, loads_checksummed

J_1 = "  j_1: {prior: uniform, low: 0.5, high: 1.5, relative: true}"
CHANGES = {
    "one": [],
    "seeded": [("seed: 7", "seed: 8")],
    "held": [
        (J_1, "  j_1: nominal"),
        ("k_s: nominal", "k_s: {prior: normal, mean: 0.26, sd: 0.01}"),
    ],
    "short": [("max_steps: 500", "max_steps: 100"), ("ess: 100", "ess: 100000")],
}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Runs of one small record."""
    place = tmp_path_factory.mktemp("runs")
    for name, changes in CHANGES.items():
        ran = finished_runs.posterior(tmp_path_factory, place, name, *changes)
        assert ran.status == (3 if name == "short" else 0), ran.text
    return place


@pytest.fixture
def runs(made: Path, tmp_path: Path) -> Path:
    shutil.copytree(made, tmp_path / "runs")
    return tmp_path / "runs"


def table(folder: Path) -> list[dict[str, str]]:
    with (folder / "overlay.csv").open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def summary(folder: Path) -> dict[str, dict[str, str]]:
    with (folder / "summary.csv").open(encoding="utf-8") as file:
        return {row["name"]: row for row in csv.DictReader(file)}


def test_the_table_is_that_of_the_runs(runs: Path) -> None:
    out = runs / "both"
    ran = command_line.cli("report", runs / "one", runs / "held", "-o", out)
    assert ran.status == 0, ran.text
    lines = {(row["name"], row["run"]): row for row in table(out)}
    assert set(lines) == {(name, run) for name in ("k_e", "k_s", "j_1") for run in ("one", "held")}
    for name, run in (("k_e", "one"), ("k_e", "held"), ("j_1", "one"), ("k_s", "held")):
        row, own = lines[name, run], summary(runs / run)[name]
        for column in ("mean", "sd", "hdi94_low", "hdi94_high", "nominal"):
            assert float(row[column]) == pytest.approx(float(own[column]), rel=1e-12), column
    for name, run in (("j_1", "held"), ("k_s", "one")):
        assert lines[name, run]["held"] == "yes"
        assert lines[name, run]["sd"] == lines[name, run]["apart"] == ""
    assert "not the same: what is believed of k_e, j_1, k_s" not in ran.out  # k_e is the same
    assert "not the same: what is believed of" in ran.out
    page = (out / "overlay.md").read_text(encoding="utf-8")
    assert "| k_s | held at 0.26 | normal 0.26 +- 0.01" in page
    assert "the record" not in page.split("## What differs")[1]
    for name in ("corner", "intervals"):
        for end in ("pdf", "png"):
            assert (out / "figures" / f"{name}.{end}").stat().st_size > 5000


def test_a_run_beside_itself_is_nowhere_apart(runs: Path) -> None:
    found = bd.overlay([runs / "one", bd.open(runs / "one")], names=["a", "a"])
    assert [row.distance for row in found.rows] == [0.0, 0.0]
    assert "record, noise, priors and seed are the same" in found.text
    assert "a (2)" in found._repr_markdown_()
    assert bd.overlay([runs / "one", runs / "seeded"]).rows[0].distance > 0.0


def test_a_run_that_did_not_converge_carries_its_warning(runs: Path) -> None:
    ran = command_line.cli("report", runs / "one", runs / "short", "-o", runs / "both")
    assert ran.status == 3
    assert "short: NOT CONVERGED" in ran.out
    assert "short: NOT CONVERGED" in (runs / "both" / "overlay.md").read_text(encoding="utf-8")
    found = bd.overlay([runs / "one", runs / "short"])
    texts = [text.get_text() for text in found.plot("intervals").legends[0].get_texts()]
    assert "short (NOT CONVERGED)" in texts
    assert all(reason.startswith("short: ") for reason in found.reasons)


def test_nothing_is_overwritten_unasked(runs: Path) -> None:
    out, two = runs / "both", (runs / "one", runs / "seeded")
    assert command_line.cli("report", *two, "-o", out).status == 0
    (out / "notes.md").write_text("mine")
    before = command_line.listing(runs)
    for wrong, says in (
        ([*two, "-o", out], "results exist already; make them anew with --force"),
        ([*two, "-o", runs / "one", "--force"], "is one of these runs"),
        ([*two, "-o", runs / "held", "--force"], "results of `bayesdrill posterior`"),
        ([runs / "one", runs / "none", "-o", runs / "new"], "none: no results here"),
        ([*(runs / "one" for _ in range(7)), "-o", runs / "new"], "7 given; 2 to 6 runs"),
        ([out, runs / "one", "-o", runs / "new"], "results of `bayesdrill report`"),
    ):
        ran = command_line.cli("report", *wrong)
        assert ran.status == 2, wrong
        assert says in ran.err, ran.err
        assert command_line.listing(runs) == before
    assert command_line.cli("report", runs / "one", runs / "held", "-o", out, "--force").status == 0
    assert (out / "notes.md").read_text() == "mine"
    assert {row["run"] for row in table(out)} == {"one", "held"}
    with pytest.raises(bd.InputError, match="1 given"):
        bd.overlay([runs / "one"])
    with pytest.raises(bd.InputError, match="give a Run or a path, not int"):
        bd.overlay([1, 2])  # type: ignore[list-item]
    with pytest.raises(bd.InputError, match="did you mean intervals"):
        bd.overlay(list(two)).plot("interval")


def forged(folder: Path) -> None:
    run = loads_checksummed((folder / "run.json").read_bytes())
    run["files"] = {name: digest(folder / name) for name in run["files"]}
    (folder / "run.json").write_text(dumps_checksummed(run))


def test_what_does_not_belong_to_an_overlay_is_named(runs: Path) -> None:
    out, figures = runs / "both", runs / "both" / "figures"
    assert command_line.cli("report", runs / "one", runs / "seeded", "-o", out).status == 0
    ran = command_line.cli("verify", out)
    assert (ran.status, ran.err) == (0, "")
    text = (out / "overlay.csv").read_text()
    (out / "overlay.csv").write_text(
        text.replace("k_e,V*s/rad,one,0.06016,0", "k_e,V*s/rad,one,0.06016,1")
    )
    assert "overlay.csv: was changed" in command_line.cli("verify", out).err
    (out / "overlay.csv").write_text(text)
    shutil.copy(figures / "corner.png", figures / "intervals.png")
    forged(out)
    assert "intervals.png: is another figure" in command_line.cli("verify", out).err
    shutil.rmtree(runs / "seeded")
    shutil.copytree(runs / "held", runs / "seeded")
    assert "seeded: is another run than" in command_line.cli("verify", out).err


def test_names_of_folders_that_are_no_text(runs: Path, tmp_path: Path) -> None:
    """Bytes that are not UTF-8 come as half characters, which no file and no figure takes."""
    odd = runs / os.fsdecode(b"dir_\xff") / "out"
    odd.parent.mkdir()
    (runs / "one").rename(odd)
    named = runs / os.fsdecode(b"seeded_\xfe")
    (runs / "seeded").rename(named)
    shutil.copy(runs / "small.csv", odd.parent)
    place = odd.parent / "laid"
    for command in (("report", runs / "held", named, "-o", place), ("verify", place)):
        ended = forked_command.ran(command, runs)
        assert ended.status == 0, ended.text
        assert r"dir_\udcff/laid" in ended.text
    assert r"seeded_\udcfe" in (place / "overlay.md").read_text(encoding="utf-8")
    shutil.copy(runs / "one.yaml", odd.parent)
    refused = command_line.cli("map", odd.parent / "one.yaml", "-o", tmp_path / "map")
    assert refused.status == 2
    assert "is not UTF-8, and no config can name it; rename the file or the folder" in refused.err
    refused = command_line.cli("init", odd.parent / "small.csv", "-o", tmp_path / "made.yaml")
    assert "is not UTF-8, and no config can name it" in refused.err
    assert not (tmp_path / "made.yaml").exists()
