"""Configs: the bundled one, its schema, its record, and what a resolved config says."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from support.case_tables import for_each
from support.scipy_oracles import NOMINAL, by_expm

from bayesdrill.config import job, loading
from bayesdrill.config.job import prepare
from bayesdrill.config.records import simulation
from bayesdrill.config.schema.json_schema import json_schema
from bayesdrill.config.yaml_source import parse
from bayesdrill.record.formats.csv import CsvOptions, read
from bayesdrill.results import provenance

ROOT = Path(__file__).parents[2]
BUNDLED = ROOT / "configs" / "nominal_step.yaml"


def test_committed_schema_is_the_codes() -> None:
    """`make schema` writes it anew."""
    assert (ROOT / "configs" / "schema.json").read_text() == json_schema()


def test_schema_completes_symbols_with_unit_and_meaning() -> None:
    tree = json.loads(json_schema())
    entry = tree["$defs"]["Parameters"]["properties"]["t_f"]
    assert "not a time" in entry["description"]
    assert "N*m" in entry["description"]
    assert tree["additionalProperties"] is False


def test_bundled_config_says_what_the_documents_say() -> None:
    job = prepare(BUNDLED)
    experiment = job.problem.experiment
    assert experiment.y.shape == (1001, 4)
    assert experiment.dt == pytest.approx(0.01)
    assert experiment.constant == {"v": 8.0, "t_1": 0.0}
    assert job.problem.posterior.likelihood.only_observation.noise.known == dict.fromkeys(
        range(4), 0.1
    )
    priors = job.problem.posterior.space.priors
    assert tuple(priors) == tuple(NOMINAL)
    for name, prior in priors.items():
        assert (prior.low, prior.high) == pytest.approx((0.5 * NOMINAL[name], 1.5 * NOMINAL[name]))


def test_bundled_record_is_what_simulate_makes() -> None:
    case = loading.load(BUNDLED)
    made = simulation.simulate(case, case.config.seed)
    assert made == (ROOT / "configs" / "records" / "nominal_step.csv").read_text()


def test_bundled_record_is_the_nominal_response_with_noise_of_a_tenth() -> None:
    """Against an independent response: residuals are white, of the stated size, and alike."""
    found = read(ROOT / "configs" / "records" / "nominal_step.csv", CsvOptions())
    t = found.pick("t")
    clean = by_expm(NOMINAL, t, np.zeros(5), 8.0, 0.0)
    noise = np.column_stack(
        [found.pick(name) for name in ("theta_1", "theta_2", "w_1", "w_2")]
    ) - clean[:, :4]  # fmt: skip
    assert noise.std(axis=0) == pytest.approx([0.1] * 4, rel=0.08)
    assert np.abs(noise.mean(axis=0)).max() < 4 * 0.1 / np.sqrt(len(t))
    assert np.abs(np.corrcoef(noise.T) - np.eye(4)).max() < 0.12


def test_simulated_records_differ_by_seed_and_obey_the_truth(tmp_path: Path) -> None:
    text = BUNDLED.read_text().replace("rate: 100\n", "rate: 50\n  k_s: 0.31\n  j_1: 0.02\n")
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    case = loading.load(path)
    one, two = (simulation.simulate(case, seed) for seed in (1, 2))
    assert one != two
    assert one == simulation.simulate(case, 1)
    (tmp_path / "r.csv").write_text(one)
    found = read(tmp_path / "r.csv", CsvOptions())
    truth = {**NOMINAL, "k_s": 0.31, "j_1": 0.02}
    clean = by_expm(truth, found.pick("t"), np.zeros(5), 8.0, 0.0)
    assert (found.pick("w_1") - clean[:, 2]).std() == pytest.approx(0.1, rel=0.15)


def test_resolved_config_means_the_same(tmp_path: Path) -> None:
    """Mutant killed: a default that is not written out."""
    job = prepare(BUNDLED)
    (tmp_path / "config.yaml").write_text(provenance.resolved(job.case, tmp_path))
    again = prepare(tmp_path / "config.yaml")
    one, two = (provenance.fingerprint(j.config, j.problem) for j in (job, again))
    assert one == two
    assert again.config.sampler == job.config.sampler


def test_a_resolved_config_holds_no_state_that_nobody_held(tmp_path: Path) -> None:
    """Mutant killed: zeros written out as entries of a start that is steady, or free."""
    for start in ("steady", "free", "{state: free, w_1: 0.5}"):
        (tmp_path / "given.yaml").write_text(f"{BUNDLED.read_text()}\ninitial: {start}\n")
        shutil.copytree(BUNDLED.parent / "records", tmp_path / "records", dirs_exist_ok=True)
        job = prepare(tmp_path / "given.yaml")
        (tmp_path / "config.yaml").write_text(provenance.resolved(job.case, tmp_path))
        again = prepare(tmp_path / "config.yaml")
        one, two = (provenance.fingerprint(j.config, j.problem) for j in (job, again))
        assert one == two, start


def test_what_decides_a_chain_is_in_its_fingerprint(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    cases = [
        ("seed: 2013", "seed: 2014", "the seed"),
        ("v: 8.0", "v: 8.1", "the input v"),
        ("walkers: 256", "walkers: 66", "sampler.walkers"),
        ("i_m: 0.125", "i_m: 0.25", "the model"),
        (
            "unit: rad/s, sigma: 0.1}\n    w_2",
            "unit: rad/s, sigma: 0.2}\n    w_2",
            "the noise of w_1",
        ),
        ("t_f: {prior: uniform, low: 0.5", "t_f: {prior: uniform, low: 0.4", "the prior of t_f"),
    ]

    def check(old: str, new: str, name: str) -> None:
        tmp_path = tmp_path_factory.mktemp("case")
        text = BUNDLED.read_text()
        assert text.count(old) == 1
        record = BUNDLED.parent / "records"
        path = tmp_path / "mine.yaml"
        path.write_text(text.replace(old, new).replace("records/", f"{record}/"))
        one, two = (
            provenance.fingerprint(job.config, job.problem)
            for job in (job.prepare(BUNDLED), job.prepare(path))
        )
        changed = {key for key in {**one, **two} if one.get(key) != two.get(key)}
        assert changed == {name}

    for_each({case[0]: case for case in cases}, check)


def test_nominal_values_may_be_corrected(tmp_path: Path) -> None:
    text = BUNDLED.read_text().replace(
        "nominal: tables_2_3", "nominal: {table: table_1, j_1: 0.03}"
    )
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    found = loading.load(path).experiments[0].nominal.values
    assert (found["k_s"], found["j_1"], found["j_m"]) == (0.30, 0.03, 4e-4)


def test_an_anchor_may_be_given_anew() -> None:
    """As YAML has it: an alias means the last one before it."""
    text = "a: &x 1\nb: *x\nc: &x 2\nd: *x\n"
    assert parse(Path("a.yaml"), text).data == {"a": 1, "b": 1, "c": 2, "d": 2}


def test_yaml_is_version_1_2(tmp_path: Path) -> None:
    """`1e-4` is a number; PyYAML reads a text."""
    path = tmp_path / "mine.yaml"
    text = BUNDLED.read_text().replace("v: 8.0", "v: 8e0").replace("t_1: 0.0", "t_1: 1e-4")
    path.write_text(text)
    config = loading.load(path).config
    assert config.inputs.t_1 == 1e-4
    assert config.inputs.v == 8.0
