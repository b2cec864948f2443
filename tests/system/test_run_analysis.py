"""What is said of a run is evaluated once, kept in `run.json`, and shown from there."""

from __future__ import annotations

import dataclasses
import json
import pickle
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support import command_line, finished_runs
from support.case_tables import for_each

import bayesdrill as bd
from bayesdrill.analysis.run_analysis import RunAnalysis
from bayesdrill.basics.values import as_data, equal_content, from_data
from bayesdrill.inference import derived
from bayesdrill.inference.posterior import Posterior
from bayesdrill.output_files import dumps_checksummed, loads_checksummed
from bayesdrill.tasks import comparison, conclusions, pipeline

CHANGES = {
    "plain": [],
    "at_nominal": [("k_e: {prior: uniform, low: 0.5", "k_e: {prior: uniform, low: 1.0")],
    "rubs": [("t_f: nominal", "t_f: nominal\n  t_c1: {prior: uniform, low: 0.01, high: 1}")],
}


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("runs")
    for name, changes in CHANGES.items():
        ran = finished_runs.posterior(tmp_path_factory, place, name, *changes)
        assert ran.status == 0, ran.text
    return place


@pytest.fixture
def runs(done: Path, tmp_path: Path) -> Path:
    shutil.copytree(done, tmp_path / "runs")
    return tmp_path / "runs"


@pytest.fixture
def evaluations(monkeypatch: pytest.MonkeyPatch) -> dict[str, int]:
    """At how many points a posterior is evaluated, by samplers (`evaluate`) and by others."""
    counts = dict.fromkeys(("evaluate", "density"), 0)

    def counted(name: str) -> None:
        whole = getattr(Posterior, name)

        def count(self: Posterior, points: np.ndarray) -> Any:
            counts[name] += len(points)
            return whole(self, points)

        monkeypatch.setattr(Posterior, name, count)

    counted("evaluate")
    counted("density")
    return counts


def test_reports_show_what_the_run_has_kept(
    runs: Path, evaluations: dict[str, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Mutant killed: it is evaluated again."""

    def refused(*_: object, **__: object) -> None:
        raise AssertionError("a run is analysed again")

    monkeypatch.setattr(conclusions, "analyse", refused)

    def check(name: str) -> None:
        folder = runs / name
        before = {path: path.read_bytes() for path in folder.glob("*.csv")}
        page = (folder / "summary.md").read_text()
        said = json.loads((folder / "run.json").read_text())
        ran = command_line.cli("report", folder, "--processes", "1")
        assert ran.status == 0, ran.text
        assert {path: path.read_bytes() for path in folder.glob("*.csv")} == before
        assert (folder / "summary.md").read_text() == page
        again = json.loads((folder / "run.json").read_text())
        for key in said.keys() - {"seconds", "files", "checksum"}:
            assert again[key] == said[key], key

    for_each({name: (name,) for name in CHANGES}, check)
    # The start of each config, which is looked at wherever it is read.
    assert evaluations == {"evaluate": 0, "density": len(CHANGES)}


def test_opened_and_compared_runs_have_what_is_kept(
    runs: Path, evaluations: dict[str, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """But for how it predicts, which no run keeps.  Mutant killed: it is evaluated again."""

    def refused(*_: object, **__: object) -> None:
        raise AssertionError("a run is analysed again")

    monkeypatch.setattr(conclusions, "analyse", refused)
    monkeypatch.setattr(conclusions, "residuals", refused)
    monkeypatch.setattr(comparison, "diffuse_priors", refused)
    folders = [runs / name for name in CHANGES]
    for folder in folders:
        kept = loads_checksummed((folder / "run.json").read_bytes())["analysis"]
        opened = bd.open(folder)
        assert as_data(opened.analysis) == kept
        assert opened == pickle.loads(pickle.dumps(opened))
        assert (
            as_data(bd.compare([opened, dataclasses.replace(opened)]).models[0].residuals)
            == kept["fit"]
        )
    layers = bd.overlay(folders).report.layers
    assert [layer.name for layer in layers] == [*CHANGES]
    # The start of each config, which is looked at wherever it is read.
    assert evaluations == {"evaluate": 0, "density": 2 * len(CHANGES)}


def test_a_chain_that_went_on_is_analysed_anew(runs: Path) -> None:
    """Mutant killed: what was kept is believed of another chain."""
    folder = runs / "plain"
    run = loads_checksummed((folder / "run.json").read_bytes())
    (folder / "run.json").write_text(dumps_checksummed(run | {"analysis_of": "another"}))
    assert bd.open(folder).kept is None
    assert as_data(bd.open(folder).analysis) == run["analysis"]


def test_another_config_or_chain_is_analysed_anew(runs: Path) -> None:
    """A formula that is added to the config has its row.  Mutant killed: what was kept is believed."""
    folder = runs / "plain"
    config = folder / "config.resolved.yaml"
    text = config.read_text()
    assert text.count("derived: {}") == 1
    config.write_text(text.replace("derived: {}", "derived: {twice: {formula: 2*k_e, unit: V}}"))
    ran = command_line.cli("report", folder, "--processes", "1")
    assert ran.status == 0, ran.text
    assert "twice" in (folder / "derived.csv").read_text()
    names = [
        row["name"] for row in json.loads((folder / "run.json").read_text())["analysis"]["derived"]
    ]
    assert "twice" in names


def test_a_notebook_has_every_number_by_name(done: Path) -> None:
    """With its unit; and what is written comes back as it was."""
    for name in CHANGES:
        analysis = bd.open(done / name).analysis
        assert equal_content(from_data(RunAnalysis, as_data(analysis)), analysis)
        assert all(RunAnalysis.describe(field) for field in as_data(analysis))
        numbers = analysis.numbers
        assert numbers["unknowns.k_e.mean"] == analysis.unknowns[0].mean
        assert RunAnalysis.describe("evidence.log_z") == (
            "how probable the record is under the model [natural log]"
        )
        kept = loads_checksummed((done / name / "run.json").read_bytes())["analysis"]
        assert kept == as_data(analysis)


def test_what_cannot_be_derived_is_tried_and_said_once(
    done: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However many look at it.  Mutant killed: it is derived whenever it is asked for."""

    def failing(*_: object) -> None:
        raise ValueError("no product")

    run = pipeline.read_result(done / "plain")
    monkeypatch.setattr(derived, "with_products", failing)
    view = conclusions.concluded(dataclasses.replace(run, kept=None))
    assert view.derived.symbols == ()
    assert view.chain.sparing.missing == ["derived quantities (ValueError: no product)"]


def test_run_json_is_as_its_schema_says(done: Path) -> None:
    """Every entry of every run, and of what the analysis holds every field."""
    schema = json.loads(command_line.cli("schema", "--of", "run").out)
    for name in CHANGES:
        run = json.loads((done / name / "run.json").read_text())
        assert run.keys() <= schema["properties"].keys(), run.keys() - schema["properties"].keys()
        assert list(_wrong(run["analysis"], schema["properties"]["analysis"], schema)) == []
    assert all(one.get("description") for one in schema["properties"].values())
    assert command_line.cli("schema").out == bd.schema()


KINDS: dict[str, Any] = {
    "object": dict,
    "array": list,
    "null": type(None),
    "number": int | float,
    "integer": int,
    "string": str,
    "boolean": bool,
}


def _wrong(data: Any, rule: dict[str, Any], schema: dict[str, Any]) -> Iterator[str]:
    """What of the data is not as the rule wants it, as far as this schema goes."""
    if "$ref" in rule:
        rule = schema["$defs"][rule["$ref"].rpartition("/")[2]]
    if "anyOf" in rule:
        ways = [list(_wrong(data, way, schema)) for way in rule["anyOf"]]
        yield from min(ways, key=len)
    elif "enum" in rule:
        yield from () if data in rule["enum"] else [f"{data} is none of {rule['enum']}"]
    elif not isinstance(data, KINDS[rule["type"]]):
        yield f"{data} is no {rule['type']}"
    elif rule["type"] == "object":
        inside = rule.get("properties") or dict.fromkeys(data, rule.get("additionalProperties"))
        if data.keys() != inside.keys():
            yield f"{data.keys()} are not {inside.keys()}"
        for key in data.keys() & inside.keys():
            yield from _wrong(data[key], inside[key], schema)
    elif rule["type"] == "array":
        rules = rule.get("prefixItems") or [rule["items"]] * len(data)
        for one, own in zip(data, rules, strict=True):
            yield from _wrong(one, own, schema)
