"""Ties and formulas of a config: the parameters they give, their slopes, and where they count."""

from pathlib import Path

import numpy as np
import pytest
from support.command_line import ROOT
from support.config_texts import write
from support.scipy_oracles import ORDER

from bayesdrill.config.job import Job, prepare
from bayesdrill.inference.posterior import Problem
from bayesdrill.inference.unknowns import ParameterSpace
from bayesdrill.results import provenance

EXAMPLE = ROOT / "configs" / "example_ties.yaml"
FORMULA = "k_s: pi*G*d**4/(32*L)"
SUM = (FORMULA, f"{FORMULA} + G/1e12 - 0.07")


@pytest.fixture(scope="module")
def problem() -> Problem:
    return prepare(EXAMPLE).problem


@pytest.fixture(scope="module")
def space(problem: Problem) -> ParameterSpace:
    return problem.posterior.space


def changed(folder: Path, *changes: tuple[str, str]) -> Job:
    text = EXAMPLE.read_text().replace("records/", f"{EXAMPLE.parent}/records/")
    return prepare(write(folder, text, *changes))


def differenced(space: ParameterSpace, theta: np.ndarray) -> np.ndarray:
    """d parameter / d log unknown at `theta (N, D)`, by central differences."""
    h = 1e-6
    shifts = np.exp(h * np.eye(theta.shape[1]))
    return np.array([(space.full(u * shifts) - space.full(u / shifts)) / (2 * h) for u in theta])


def test_tied_parameters_follow_from_parameters_and_quantities(space: ParameterSpace) -> None:
    assert space.free == ("j_m", "c_m", "k_e", "r_m", "l_m", "j_1", "t_f", "G", "d")
    assert space.fixed == {"L": 2.4}
    theta = space.draw(5, np.random.default_rng(1))
    parameters = dict(zip(ORDER, space.full(theta).T, strict=True))
    draws = dict(zip(space.free, theta.T, strict=True))
    assert np.array_equal(parameters["k_T"], draws["k_e"])
    stiffness = np.pi * draws["G"] * draws["d"] ** 4 / (32 * 2.4)
    assert parameters["k_s"] == pytest.approx(stiffness, rel=1e-14)
    assert np.array_equal(parameters["j_1"], draws["j_1"])
    paper = np.array([[*[1.0] * 7, 79.3e9, 3e-3]])
    assert round(float(space.full(paper)[0, ORDER.index("k_s")]), 3) == 0.263


def test_slopes_are_those_of_differences(space: ParameterSpace, tmp_path: Path) -> None:
    """Of products of powers, and of a sum, which is none."""
    theta = space.draw(4, np.random.default_rng(2))
    assert space.slopes(theta) == pytest.approx(differenced(space, theta), rel=1e-8, abs=1e-15)
    of_sum = changed(tmp_path, SUM).problem.posterior.space
    theta = of_sum.vector(of_sum.start) * np.random.default_rng(5).uniform(0.95, 1.05, (4, 9))
    assert of_sum.slopes(theta) == pytest.approx(differenced(of_sum, theta), rel=1e-7, abs=1e-12)


def test_quantities_are_in_si(problem: Problem, space: ParameterSpace) -> None:
    assert space.start["G"] == pytest.approx(79.3e9)
    assert space.priors["d"].quantile(np.array([0.5])) == pytest.approx([3e-3])
    assert [symbol.unit for symbol in problem.symbols[-2:]] == ["Pa", "m"]


def test_a_relation_is_in_the_fingerprint(tmp_path: Path) -> None:
    jobs = (prepare(EXAMPLE), changed(tmp_path, ("tie: k_e", "tie: t_f")))
    given, other = (provenance.fingerprint(job.config, job.problem) for job in jobs)
    assert {key for key in given if given[key] != other[key]} == {"the relation of k_T"}


def test_a_tie_to_a_held_number_is_held(tmp_path: Path) -> None:
    space = changed(tmp_path, ("tie: k_e", "tie: L")).problem.posterior.space
    assert space.fixed["k_T"] == 2.4
    assert "k_T" not in space.relations


def test_a_chain_of_ties_leads_to_unknowns(tmp_path: Path) -> None:
    uniform = "r_m: {prior: uniform, low: 0.5, high: 1.5, relative: true}"
    space = changed(tmp_path, (uniform, "r_m: 4*k_T")).problem.posterior.space
    assert space.relations["r_m"].names == ("k_e",)


def test_a_relation_that_is_not_positive_ends_the_prior(tmp_path: Path) -> None:
    space = changed(tmp_path, SUM).problem.posterior.space
    theta = np.repeat(space.vector(space.start)[None], 3, axis=0)
    theta[1:, -1] = 1e-3  # a thin shaft: 0.003 + 0.079 - 0.07 is still positive, ...
    theta[2, -2] = 60e9  # ... but with a softer steel it is not
    log_prior = space.log_prior(theta)
    assert np.isfinite(log_prior[:2]).all()
    assert log_prior[2] == -np.inf
