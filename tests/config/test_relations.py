"""Ties and formulas of a config: the parameters they give, their slopes, and where they count."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.scipy_oracles import NOMINAL, ORDER, by_expm

from bayesdrill.config import job, loading
from bayesdrill.config.job import prepare
from bayesdrill.config.records import simulation
from bayesdrill.inference.posterior import Problem
from bayesdrill.inference.unknowns import ParameterSpace
from bayesdrill.record.formats.csv import CsvOptions, read
from bayesdrill.results import provenance

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "configs" / "example_ties.yaml"


@pytest.fixture(scope="module")
def problem() -> Problem:
    return job.prepare(EXAMPLE).problem


@pytest.fixture(scope="module")
def space(problem: Problem) -> ParameterSpace:
    return problem.posterior.space


def test_unknowns_are_parameters_then_quantities(space: ParameterSpace) -> None:
    assert space.free == ("j_m", "c_m", "k_e", "r_m", "l_m", "j_1", "t_f", "G", "d")
    assert space.fixed == {"L": 2.4}


def test_tied_parameters_follow(space: ParameterSpace) -> None:
    """Mutant killed: a relation ignored."""
    theta = space.draw(5, np.random.default_rng(1))
    p = dict(zip(ORDER, space.full(theta).T, strict=True))
    u = dict(zip(space.free, theta.T, strict=True))
    assert np.array_equal(p["k_T"], u["k_e"])
    assert p["k_s"] == pytest.approx(np.pi * u["G"] * u["d"] ** 4 / (32 * 2.4), rel=1e-14)
    assert np.array_equal(p["j_1"], u["j_1"])


def differenced(space: ParameterSpace, theta: np.ndarray) -> np.ndarray:
    """d parameter / d log unknown at `theta (D,)`."""
    h = 1e-6
    shifts = np.exp(h * np.eye(len(theta)))
    return (space.full(theta * shifts) - space.full(theta / shifts)) / (2 * h)


def test_slopes_are_those_of_differences(space: ParameterSpace) -> None:
    """Mutants killed: only the parameters that are unknown themselves have a slope; all points of a
    batch have that of the first."""
    theta = space.draw(4, np.random.default_rng(2))
    numeric = [differenced(space, row) for row in theta]
    assert space.slopes(theta) == pytest.approx(np.array(numeric), rel=1e-8, abs=1e-15)


def test_geometry_of_the_papers_shaft(space: ParameterSpace) -> None:
    """0.263 N m/rad, as the statistics say."""
    theta = np.array([[*[1.0] * 7, 79.3e9, 3e-3]])
    assert round(float(space.full(theta)[0, ORDER.index("k_s")]), 3) == 0.263


def test_units_of_quantities_are_si_inside(problem: Problem, space: ParameterSpace) -> None:
    assert space.start["G"] == pytest.approx(79.3e9)
    assert space.priors["d"].quantile(np.array([0.5])) == pytest.approx([3e-3])
    assert [s.unit for s in problem.symbols[-2:]] == ["Pa", "m"]


def test_truth_of_a_simulated_record_obeys_the_ties() -> None:
    """Against an independent response; and the bundled record is the one that the config makes."""
    case = loading.load(EXAMPLE)
    text = simulation.simulate(case, case.config.seed)
    assert text == (EXAMPLE.parent / "records" / "example_ties.csv").read_text()
    found = read(EXAMPLE.parent / "records" / "example_ties.csv", CsvOptions())
    k_s = np.pi * 79.6e9 * 3.005e-3**4 / (32 * 2.4)
    truth = {**NOMINAL, "k_e": 0.085, "k_T": 0.085, "k_s": k_s, "j_1": 0.0284, "t_f": 0.06}
    clean = by_expm(truth, found.pick("t")[::10], np.zeros(5), 8.0, 0.0)
    assert (found.pick("w_1")[::10] - clean[:, 2]).std() == pytest.approx(0.1, rel=0.2)


def changed(folder: Path, *changes: tuple[str, str]) -> job.Job:
    text = EXAMPLE.read_text().replace("records/", f"{EXAMPLE.parent}/records/")
    for old, new in changes:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    path = folder / "mine.yaml"
    path.write_text(text)
    return job.prepare(path)


def test_a_relation_is_in_the_fingerprint(tmp_path: Path) -> None:
    one, two = (
        provenance.fingerprint(job.config, job.problem)
        for job in (job.prepare(EXAMPLE), changed(tmp_path, ("tie: k_e", "tie: t_f")))
    )
    assert {"the relation of k_T"} == {k for k in one if one[k] != two[k]}


def test_a_tie_to_what_is_held_is_held(tmp_path: Path) -> None:
    space = changed(tmp_path, ("tie: k_e", "tie: L")).problem.posterior.space
    assert space.fixed["k_T"] == 2.4
    assert "k_T" not in space.relations


def test_a_chain_of_ties(tmp_path: Path) -> None:
    uniform = "r_m: {prior: uniform, low: 0.5, high: 1.5, relative: true}"
    space = changed(tmp_path, (uniform, "r_m: 4*k_T")).problem.posterior.space
    assert space.relations["r_m"].names == ("k_e",)


SUM = ("k_s: pi*G*d**4/(32*L)", "k_s: pi*G*d**4/(32*L) + G/1e12 - 0.07")


def test_a_relation_that_is_not_positive_ends_the_prior(tmp_path: Path) -> None:
    space = changed(tmp_path, SUM).problem.posterior.space
    theta = np.repeat(space.vector(space.start)[None], 3, axis=0)
    theta[1:, -1] = 1e-3  # a thin shaft: 0.003 + 0.079 - 0.07 is still positive, ...
    theta[2, -2] = 60e9  # ... but with a softer steel it is not
    log_p = space.log_prior(theta)
    assert np.isfinite(log_p[:2]).all()
    assert log_p[2] == -np.inf


def test_slopes_of_a_sum_are_exact(tmp_path: Path) -> None:
    """It is no product of powers; every search and every ridge counts on its slopes."""
    space = changed(tmp_path, SUM).problem.posterior.space
    theta = space.vector(space.start) * np.random.default_rng(5).uniform(0.95, 1.05, (4, 9))
    numeric = np.array([differenced(space, row) for row in theta])
    assert space.slopes(theta) == pytest.approx(numeric, rel=1e-7, abs=1e-12)


def test_resolved_config_means_the_same(tmp_path: Path) -> None:
    job = prepare(EXAMPLE)
    (tmp_path / "config.yaml").write_text(provenance.resolved(job.case, tmp_path))
    again = prepare(tmp_path / "config.yaml")
    one, two = (provenance.fingerprint(j.config, j.problem) for j in (job, again))
    assert one == two
    assert again.problem.derived == job.problem.derived
