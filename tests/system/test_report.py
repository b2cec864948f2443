"""`bayesdrill report RUN [RUN ...]`: tables and figures made anew, and runs laid over each other.

What is said of a run is evaluated once, kept in `run.json`, and shown from there.
"""

import csv
import dataclasses
import json
import os
import pickle
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support import command_line, finished_runs, forked_command, injection_payloads
from support.case_tables import for_each
from support.command_line import cli, replace_text
from support.finished_runs import FIGURES, FILES, FinishedRun
from support.html_pages import Page

import bayesdrill as bd
from bayesdrill.analysis.run_analysis import RunAnalysis
from bayesdrill.basics.equality import equal_content
from bayesdrill.basics.json_records import as_data, from_data
from bayesdrill.inference import derived
from bayesdrill.inference.posterior import Posterior
from bayesdrill.output_files import dumps_checksummed, loads_checksummed
from bayesdrill.tasks import comparison, conclusions, pipeline


def report(*arguments: str | Path) -> command_line.CommandResult:
    return cli("report", *arguments, "--processes", "1")


BROKEN = {
    "figures/corner": "report.sections.corner.derived_shown",
    "figures/trace": "report.sections.convergence.trace_figure",
    "derived.csv": "report.sections.products.derived_csv",
    "verdict.csv": "report.sections.nominal.verdict_csv",
    "posterior.nc": "results.arviz_tree.make_tree",
    "figures/fit": "results.arviz_tree.make_tree",
}


def test_tables_and_figures_that_fail_are_named_and_all_others_are_made(
    drawn: FinishedRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A later `report` makes all of them as before, and with `--pdf` every figure as PDF too."""
    run = drawn.copy(tmp_path / "rig")
    complete = command_line.listing(run.folder)
    for name in FIGURES | {"summary.md", "derived.csv", "verdict.csv", "posterior.nc"}:
        (run.folder / name).unlink()

    def fail(*_: object) -> None:
        raise ValueError("cannot do this\nnor that")

    with monkeypatch.context() as patch:
        for place in BROKEN.values():
            patch.setattr(f"bayesdrill.{place}", fail)
        result = report(run.folder)
    assert result.status == 2, result.text
    *messages, way_out = result.err.splitlines()
    messages = [line for line in messages if line.startswith("could not be made")]
    why = "(ValueError: cannot do this)"
    assert sorted(messages) == sorted(f"could not be made: {name} {why}" for name in BROKEN)
    assert f"`bayesdrill report {run.folder}` makes the rest" in way_out
    assert "sampling: converged after " in result.out
    failed = {"derived.csv", "verdict.csv", "posterior.nc"}
    failed |= {name for name in FIGURES if re.search("corner|trace|fit", name)}
    assert set(command_line.listing(run.folder)) == (FILES | FIGURES) - failed
    assert sorted(run.json["missing"]) == sorted(f"{name} {why}" for name in BROKEN)
    tables = ("summary.csv", "summary.md", "report.html", "table.tex")
    for name in tables:
        (run.folder / name).unlink()
    shutil.rmtree(run.folder / "figures")
    result = report(run.folder, "--pdf")
    assert result.status == 0, result.text
    after = command_line.listing(run.folder)
    pictures = {name for name in FIGURES if name.endswith("png")}
    pdf = {name.replace("png", "pdf") for name in pictures}
    assert set(after) == FILES | FIGURES | pdf
    assert all(after[name].startswith(b"%PDF") for name in pdf)
    assert run.json["missing"] == []
    for name in (*tables, *pictures, "chain.h5", "config.yaml", "map.json"):
        assert after[name] == complete[name], name
    assert result.out.splitlines()[-1].startswith(f"results: {run.folder}/")


J_1 = "  j_1: {prior: uniform, low: 0.5, high: 1.5, relative: true}"
HELD = [(J_1, "  j_1: nominal"), ("k_s: nominal", "k_s: {prior: normal, mean: 0.26, sd: 0.01}")]
CHANGES = {
    "plain": [],
    "held": HELD,
    "short": [("max_steps: 500", "max_steps: 100"), ("ess: 100", "ess: 100000")],
}
KEPT = ("plain", "held")


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Runs of one small record, and two of them laid over each other, not to be changed."""
    place = tmp_path_factory.mktemp("runs")
    for name, changes in CHANGES.items():
        result = finished_runs.posterior(tmp_path_factory, place, name, *changes)
        assert result.status == (3 if name == "short" else 0), result.text
    result = cli("report", place / "plain", place / "held", "-o", place / "both")
    assert result.status == 0, result.text
    (place / "both.txt").write_text(result.out, encoding="utf-8")
    return place


runs = pytest.fixture(finished_runs.copied, name="runs")


def run_json(folder: Path) -> dict[str, Any]:
    return loads_checksummed((folder / "run.json").read_bytes())


@pytest.fixture
def evaluations(monkeypatch: pytest.MonkeyPatch) -> dict[str, int]:
    """Counts at how many points samplers (`evaluate`) and others (`density`) evaluate a posterior."""
    counts = dict.fromkeys(("evaluate", "density"), 0)

    def count_calls(name: str) -> None:
        original = getattr(Posterior, name)

        def count(self: Posterior, points: np.ndarray) -> Any:
            counts[name] += len(points)
            return original(self, points)

        monkeypatch.setattr(Posterior, name, count)

    count_calls("evaluate")
    count_calls("density")
    return counts


def refuse(*_: object, **__: object) -> None:
    raise AssertionError("a run is analysed again")


def test_reports_show_what_the_run_has_kept(
    runs: Path, evaluations: dict[str, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(conclusions, "analyse", refuse)

    def check(name: str) -> None:
        folder = runs / name
        before = {path: path.read_bytes() for path in folder.glob("*.csv")}
        page, kept = (folder / "summary.md").read_text(), run_json(folder)
        result = report(folder)
        assert result.status == 0, result.text
        assert {path: path.read_bytes() for path in folder.glob("*.csv")} == before
        assert (folder / "summary.md").read_text() == page
        again = run_json(folder)
        for key in kept.keys() - {"seconds", "files", "checksum"}:
            assert again[key] == kept[key], key

    for_each({name: (name,) for name in KEPT}, check)
    # The start of each config, which is evaluated wherever it is read.
    assert evaluations == {"evaluate": 0, "density": len(KEPT)}


def test_opened_and_compared_runs_have_what_is_kept(
    runs: Path, evaluations: dict[str, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Except for its predictive scores, which no run keeps."""
    monkeypatch.setattr(conclusions, "analyse", refuse)
    monkeypatch.setattr(conclusions, "residuals", refuse)
    monkeypatch.setattr(comparison, "diffuse_priors", refuse)
    folders = [runs / name for name in KEPT]
    for folder in folders:
        kept = run_json(folder)["analysis"]
        run = bd.open(folder)
        assert as_data(run.analysis) == kept
        assert run == pickle.loads(pickle.dumps(run))
        models = bd.compare([run, dataclasses.replace(run)]).models
        assert as_data(models[0].residuals) == kept["fit"]
    assert [layer.name for layer in bd.overlay(folders).report.layers] == [*KEPT]
    # The start of each config, which is evaluated wherever it is read.
    assert evaluations == {"evaluate": 0, "density": 2 * len(KEPT)}


def test_another_config_or_chain_is_analysed_anew(runs: Path) -> None:
    """A chain that went on has another mark; a formula that is added to the config gets its row."""
    folder = runs / "plain"
    run = run_json(folder)
    (folder / "run.json").write_text(dumps_checksummed(run | {"analysis_of": "another"}))
    assert bd.open(folder).stored is None
    assert as_data(bd.open(folder).analysis) == run["analysis"]
    formula = "derived: {twice: {formula: 2*k_e, unit: V}}"
    replace_text(folder / "config.resolved.yaml", "derived: {}", formula)
    result = report(folder)
    assert result.status == 0, result.text
    assert "twice" in (folder / "derived.csv").read_text()
    assert "twice" in [row["name"] for row in run_json(folder)["analysis"]["derived"]]


def test_a_notebook_has_every_number_by_name(finished: Path) -> None:
    """With its unit; and what is written is read back unchanged."""
    for name in KEPT:
        analysis = bd.open(finished / name).analysis
        assert equal_content(from_data(RunAnalysis, as_data(analysis)), analysis)
        assert all(RunAnalysis.describe(field) for field in as_data(analysis))
        assert analysis.numbers["unknowns.k_e.mean"] == analysis.unknowns[0].mean
        assert RunAnalysis.describe("evidence.log_z") == (
            "log probability of the record under the model [natural log]"
        )
        assert run_json(finished / name)["analysis"] == as_data(analysis)


def test_a_derived_quantity_that_fails_is_tried_once(
    finished: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However many sections ask for it."""

    def fail(*_: object) -> None:
        raise ValueError("no product")

    run = pipeline.read_result(finished / "plain")
    monkeypatch.setattr(derived, "with_products", fail)
    view = conclusions.concluded(dataclasses.replace(run, stored=None))
    assert view.derived.symbols == ()
    assert view.chain.errors.missing == ["derived quantities (ValueError: no product)"]


def table(folder: Path) -> list[dict[str, str]]:
    with (folder / "overlay.csv").open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_the_table_of_an_overlay_is_that_of_its_runs(finished: Path) -> None:
    out, printed = finished / "both", (finished / "both.txt").read_text(encoding="utf-8")
    rows = {(row["name"], row["run"]): row for row in table(out)}
    assert set(rows) == {(name, run) for name in ("k_e", "k_s", "j_1") for run in ("plain", "held")}
    for name, run in (("k_e", "plain"), ("k_e", "held"), ("j_1", "plain"), ("k_s", "held")):
        own = command_line.table(finished / run / "summary.csv")[name]
        for column in ("mean", "sd", "hdi94_low", "hdi94_high", "nominal"):
            value = float(rows[name, run][column])
            assert value == pytest.approx(float(own[column]), rel=1e-12), column
    for name, run in (("j_1", "held"), ("k_s", "plain")):
        assert rows[name, run]["held"] == "yes"
        assert rows[name, run]["sd"] == rows[name, run]["apart"] == ""
    assert "not the same: priors or values of k_e, j_1, k_s" not in printed  # k_e is the same
    assert "not the same: priors or values of" in printed
    page = (out / "overlay.md").read_text(encoding="utf-8")
    assert "| k_s | held at 0.26 | normal 0.26 +- 0.01" in page
    assert "the record" not in page.split("## What differs")[1]
    for name in ("corner", "intervals"):
        for end in ("pdf", "png"):
            assert (out / "figures" / f"{name}.{end}").stat().st_size > 5000


def test_a_run_laid_over_itself_differs_nowhere(runs: Path) -> None:
    overlay = bd.overlay([runs / "plain", bd.open(runs / "plain")], names=["a", "a"])
    assert [row.distance for row in overlay.rows] == [0.0, 0.0]
    assert "record, noise, priors and seed are the same" in overlay.text
    assert "a (2)" in overlay._repr_markdown_()
    overlay = bd.overlay([runs / "plain", runs / "short"])
    assert overlay.rows[0].distance > 0.0
    texts = [text.get_text() for text in overlay.plot("intervals").legends[0].get_texts()]
    assert "short (NOT CONVERGED)" in texts
    assert all(reason.startswith("short: ") for reason in overlay.reasons)


def test_an_overlay_overwrites_nothing_unasked_and_carries_warnings_of_its_runs(runs: Path) -> None:
    out, two = runs / "both", (runs / "plain", runs / "held")
    (out / "notes.md").write_text("mine")
    before = command_line.listing(runs)
    for arguments, message in (
        ([*two, "-o", out], "results exist already; make them anew with --force"),
        ([*two, "-o", runs / "plain", "--force"], "is one of these runs"),
        ([*two, "-o", runs / "short", "--force"], "results of `bayesdrill posterior`"),
        ([runs / "plain", runs / "none", "-o", runs / "new"], "none: no results here"),
        ([*(runs / "plain" for _ in range(7)), "-o", runs / "new"], "7 given; 2 to 6 runs"),
        ([out, runs / "plain", "-o", runs / "new"], "results of `bayesdrill report`"),
    ):
        command_line.assert_refused(cli("report", *arguments), message)
        assert command_line.listing(runs) == before
    result = cli("report", runs / "plain", runs / "short", "-o", out, "--force")
    assert result.status == 3
    for text in (result.out, (out / "overlay.md").read_text(encoding="utf-8")):
        assert "short: NOT CONVERGED" in text
    assert (out / "notes.md").read_text() == "mine"
    assert {row["run"] for row in table(out)} == {"plain", "short"}
    with pytest.raises(bd.InputError, match="1 given"):
        bd.overlay([runs / "plain"])
    with pytest.raises(bd.InputError, match="give a Run or a path, not int"):
        bd.overlay([1, 2])  # type: ignore[list-item]
    with pytest.raises(bd.InputError, match="did you mean intervals"):
        bd.overlay(list(two)).plot("interval")


def test_verify_names_what_does_not_belong_to_an_overlay(runs: Path) -> None:
    out, drawings = runs / "both", runs / "both" / "figures"
    result = cli("verify", out)
    assert (result.status, result.err) == (0, "")
    text = (out / "overlay.csv").read_text()
    replace_text(out / "overlay.csv", "k_e,V*s/rad,plain,0.06016,0", "k_e,V*s/rad,plain,0.06016,1")
    assert "overlay.csv: was changed" in cli("verify", out).err
    (out / "overlay.csv").write_text(text)
    shutil.copy(drawings / "corner.png", drawings / "intervals.png")
    command_line.renew_digests(out)
    assert "intervals.png: is another figure" in cli("verify", out).err
    shutil.rmtree(runs / "held")
    shutil.copytree(runs / "short", runs / "held")
    assert "held: is another run than" in cli("verify", out).err


@pytest.mark.slow
def test_names_of_folders_need_not_be_utf_8(runs: Path, tmp_path: Path) -> None:
    """Reports show such bytes escaped; configs cannot name them."""
    odd = runs / os.fsdecode(b"dir_\xff") / "out"
    odd.parent.mkdir()
    (runs / "plain").rename(odd)
    named = runs / os.fsdecode(b"held_\xfe")
    (runs / "held").rename(named)
    for name in ("small.csv", "plain.yaml"):
        shutil.copy(runs / name, odd.parent)
    place = odd.parent / "laid"
    for command in (("report", odd, named, "-o", place), ("verify", place)):
        ended = forked_command.ran(command, runs)
        assert ended.status == 0, ended.text
        assert r"dir_\udcff/laid" in ended.text
    assert r"held_\udcfe" in (place / "overlay.md").read_text(encoding="utf-8")
    mapped = cli("map", odd.parent / "plain.yaml", "-o", tmp_path / "map")
    drafted = cli("init", odd.parent / "small.csv", "-o", tmp_path / "made.yaml")
    message = "is not UTF-8, and no config can name it"
    command_line.assert_refused(mapped, f"{message}; rename the file or the folder")
    command_line.assert_refused(drafted, message)
    assert not (tmp_path / "made.yaml").exists()


@pytest.fixture(scope="module")
def hostile(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A maximum in `out`, of a config and a record whose texts and places are hostile."""
    place = tmp_path_factory.mktemp("hostile") / injection_payloads.RUNS
    config = injection_payloads.small(place)
    result = cli("map", config, "-o", place / "out", "--processes", "1")
    assert result.status == 0, result.text
    return place


def test_a_page_has_no_elements_from_texts_of_users(hostile: Path) -> None:
    html = (hostile / "out" / "report.html").read_text(encoding="utf-8")
    page = Page(html)
    assert len(page.all("script")) == 1
    assert len(page.all("img")) == 2  # the fit, and where it is enlarged
    names = {name for _, attributes in page.found for name in attributes}
    assert not any(name.startswith("on") or name == "style" for name in names)
    assert html.count("owned=1") > 5
    assert not re.search("<[A-Za-z/!?]", (hostile / "out" / "map.md").read_text(encoding="utf-8"))


def test_a_terminal_shows_names_of_columns_and_obeys_none(hostile: Path) -> None:
    check = cli("check", hostile / "small.yaml")
    assert check.status == 0, check.text
    assert injection_payloads.COLUMNS["theta_1"] in check.out
    missing = cli(
        "map", hostile / "small.yaml", "-o", hostile / f"{injection_payloads.OBEYED}/none"
    )
    for text in (check.text, missing.text):
        assert text.replace("\n", "").isprintable()


def test_run_json_is_as_its_schema_says(finished: Path) -> None:
    """Every entry of every run; those of the analysis are read back by the types that made it."""
    schema = json.loads(cli("schema", "--of", "run").out)
    for name in KEPT:
        run = json.loads((finished / name / "run.json").read_text())
        assert run.keys() <= schema["properties"].keys(), run.keys() - schema["properties"].keys()
    assert all(entry.get("description") for entry in schema["properties"].values())
    assert cli("schema").out == bd.schema()
    assert json.loads(bd.schema())["properties"]["sampler"]
