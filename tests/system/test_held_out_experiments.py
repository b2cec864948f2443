"""Experiments that are held out: no evidence, and predicted; refused where nothing tells of them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import norm
from support import command_line
from support.case_tables import run_cases

import bayesdrill as bd
from bayesdrill.analysis.prediction import held_out

SIGMA = 0.1
CONFIG = """\
name: held
seed: 7
record:
  time: {column: t, unit: s}
  channels:
    w_1: {column: w_1, unit: rad/s, sigma: 0.1, offset: OFFSET}
    w_2: {column: w_2, unit: rad/s, sigma: 0.1}
experiments:
  slow: {record: {file: slow.csv}, inputs: {v: 5.0}}
  fast: {record: {file: fast.csv}, inputs: {v: 9.0}AWAY}
shared: SHARED
parameters:
  {j_m: nominal, c_m: nominal, k_e: {prior: uniform, low: 0.5, high: 1.5, relative: true}, k_T: nominal,
   r_m: nominal, l_m: nominal, k_s: KS, j_1: nominal, t_f: nominal}
map: {starts: 1, evaluations: 300}
sampler: {walkers: 24, ess: 400, n_tau: 10}
output: {predictive_draws: 10, figures: [fit]}
simulation: {duration: 4.0, rate: 25}
"""
OFFSET = "{prior: normal, mean: 0, sd: 0.5}"
USUAL = {
    "OFFSET": OFFSET,
    "AWAY": ", held_out: true",
    "SHARED": "[offset_w_1]",
    "KS": "{prior: uniform, low: 0.5, high: 1.5, relative: true}",
}


def written(folder: Path, name: str = "held", **changes: str) -> Path:
    text = CONFIG
    for key, value in (USUAL | changes).items():
        text = text.replace(key, value)
    path = folder / f"{name}.yaml"
    path.write_text(text)
    return path


@pytest.fixture(scope="module")
def records(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("held")
    bd.simulate(written(folder, "made", AWAY=""), seed=3, output=folder)
    return folder


def test_it_is_no_evidence_and_is_predicted_by_the_draws(records: Path) -> None:
    """Against a config that has never heard of it, and densities by SciPy.

    Mutant killed: an experiment that is held out and counts.
    """
    problem = bd.load(written(records)).job.problem
    assert [one.label for one in problem.observations] == ["slow"]
    alone = written(records, "alone")
    lines = [line for line in alone.read_text().splitlines() if not line.startswith("  fast")]
    alone.write_text("\n".join(line for line in lines if not line.startswith("shared")))
    other = bd.load(alone).job.problem
    theta = problem.posterior.space.draw(40, np.random.default_rng(1))
    same = [problem.posterior.space.free.index(n.removesuffix("_slow")) for n in other.names]
    density = other.posterior.density(theta[:, same])
    assert problem.posterior.density(theta) == pytest.approx(density, rel=1e-12)
    near = problem.posterior.space.vector(problem.posterior.space.start) * (
        1.0 + 1e-3 * np.random.default_rng(2).standard_normal((40, theta.shape[1]))
    )
    (fast,) = problem.posterior.likelihood.held_out
    clean = fast.signals(problem.posterior.space.full(near))
    each = logsumexp(norm.logpdf(fast.experiment.y, clean, SIGMA), axis=0) - np.log(40)
    found = held_out(problem.posterior, near)
    assert found is not None
    assert found.samples == 2 * 101
    assert found.score == pytest.approx(each.sum(), rel=1e-9)


@pytest.mark.slow
def test_models_are_compared_by_what_they_predict_of_it(records: Path, tmp_path: Path) -> None:
    """A spring that is held wrong predicts worse; a run that has seen the record is another one's."""
    for name, changes in (
        ("given", {}),
        ("stiff", {"KS": "0.3"}),
        ("whole", {"AWAY": ""}),
    ):
        ran = command_line.cli(
            "posterior",
            written(records, name, **changes),
            "-o",
            tmp_path / name,
            "--processes",
            "1",
        )
        assert ran.status in (0, 3), ran.text
        if name == "given":
            assert "fast, its 202 samples are held out, and are no evidence" in ran.text
    runs = [tmp_path / name for name in ("stiff", "given")]
    ran = command_line.cli("compare", *runs, "-o", tmp_path / "out")
    assert ran.status == 0, ran.text
    assert "held out: 202 samples, which given predicts best" in ran.out
    assert json.loads((tmp_path / "out" / "run.json").read_text())["best"] == "given"
    assert command_line.cli("verify", tmp_path / "given").status == 0
    refused = command_line.cli(
        "compare", tmp_path / "given", tmp_path / "whole", "-o", tmp_path / "no"
    )
    assert refused.status == 2
    assert "held out as a whole" in refused.err


@run_cases(
    "changes, said",
    [
        (
            {"SHARED": "[]"},
            "nothing tells offset_w_1 of fast; give a number, or add it to `shared:`",
        ),
        ({"SHARED": "[offset_w_1]\nown: [k_s]"}, "nothing tells k_s of fast, which is held out"),
        ({"AWAY": ", held_out: true}\n  more: {held_out: 3"}, "experiments.more.held_out"),
    ],
)
def test_what_nothing_tells_of_is_refused(
    records: Path, changes: dict[str, str], said: str
) -> None:
    ran = command_line.cli("check", written(records, "wrong", **changes))
    assert ran.status == 2
    assert said in ran.err, ran.err


def test_one_is_left_to_be_fitted(records: Path) -> None:
    path = written(records, "none")
    path.write_text(path.read_text().replace("{v: 5.0}}", "{v: 5.0}, held_out: true}"))
    ran = command_line.cli("check", path)
    assert ran.status == 2
    assert "all are held out; leave one to be fitted" in ran.err
