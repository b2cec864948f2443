"""Runs take steps as fine as the noise asks for, by errors that agree with the oracle."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from support.case_tables import run_cases
from support.command_line import small_config
from support.friction_cases import CASES, moved
from support.friction_oracle import Rig, simulate
from support.scipy_oracles import NOMINAL
from support.small_problems import posterior_of
from support.stepped_friction import experiment_of, model_of, parameters

import bayesdrill as bd
from bayesdrill.config.job import Job
from bayesdrill.inference import step_error
from bayesdrill.inference.posterior import Posterior
from bayesdrill.inference.step_error import (
    CANDIDATE_STEPS,
    MAX_ERROR_OVER_NOISE,
    choose_steps,
    step_errors,
)
from bayesdrill.rig.simulators.contract import REVERSAL_SUBSTEPS
from bayesdrill.rig.simulators.sensors import ObservationModel
from bayesdrill.rig.simulators.stepped import Stepped

NAME = "falling"  # the friction falls with the speed
CASE = CASES[NAME]


def stepped(substeps: int, reversal_substeps: int = REVERSAL_SUBSTEPS) -> Stepped:
    experiment, sensing = experiment_of(CASE), ObservationModel()
    return Stepped(model_of(CASE), experiment, sensing, substeps, reversal_substeps)


def posterior(sigma: float, substeps: int = 1) -> Posterior:
    """Return one without unknowns."""
    rig = stepped(substeps)
    values = dict(zip(rig.model.parameters, parameters(CASE)[0], strict=True))
    return posterior_of(rig, [sigma] * len(rig.experiment.channels), {}, values)


def errors_from_oracle(rig: Stepped) -> np.ndarray:
    """Return the largest distance of each state from the oracle `(K,)`."""
    return np.asarray(np.abs(rig.signals(parameters(CASE))[0] - moved(NAME).states).max(axis=0))


@run_cases("substeps", [1, 4])
def test_errors_are_those_from_the_oracle_in_sds_of_the_noise(substeps: int) -> None:
    (result,) = step_errors(posterior(0.03, substeps).likelihood, np.zeros(0))
    assert result.pieces == substeps
    expected = errors_from_oracle(stepped(substeps)) / 0.03
    assert np.array(result.errors) == pytest.approx(expected, rel=0.05)


@run_cases("sigma", [0.5, 0.3, 0.01])
def test_the_fewest_steps_are_chosen_whose_error_is_small_beside_the_noise(sigma: float) -> None:
    response = choose_steps(posterior(sigma), np.zeros(0)).likelihood.only_observation.response
    chosen = response.pieces, response.turns
    limit = MAX_ERROR_OVER_NOISE * sigma
    assert errors_from_oracle(stepped(*chosen)).max() < limit
    for fewer in CANDIDATE_STEPS[: CANDIDATE_STEPS.index(chosen)]:
        assert errors_from_oracle(stepped(*fewer)).max() > 0.5 * limit


# --- steps of runs ----------------------------------------------------------------------------------

T = np.linspace(0.0, 4.0, 161)
STRIBECK = {"t_cm": 0.01, "t_sm": 0.03, "w_sm": 20.0}
NAMED = {**dict.fromkeys(NOMINAL, "nominal"), **STRIBECK}
BOX = {"prior": "uniform", "low": 0.5, "high": 1.5, "relative": True}
UNKNOWN = {"prior": "log_uniform", "low": 0.01, "high": 100.0, "start": 20.0}


@cache
def case(*, known: bool = False) -> bd.Case:
    """Return a case whose noise is a thousandth of its start, where any step would be fine enough.

    If `known`, all but an inertia is held.
    """
    v = np.where(np.arange(len(T)) // 40 % 2 == 0, 6.0, -6.0)
    inputs = {"v": bd.Input(v, "V", hold="zero")}
    exact = simulate(Rig(p={**NOMINAL, **STRIBECK}), T, v).states[:, 3]
    noise = 0.02 * np.random.default_rng(6).standard_normal(len(T))
    return bd.case(
        T,
        channels={"w_2": bd.Channel(exact + noise, "rad/s", 0.02 if known else UNKNOWN)},
        inputs=inputs,
        parameters={**NAMED, "j_1": BOX} if known else {**NAMED, "k_s": BOX, "j_1": BOX},
        map={"starts": 1},
        sampler={"ensembles": 4, "walkers": 16, "r_hat": 1.1, "n_tau": 5, "ess": 100},
        seed=3,
    )


@cache
def run(*, known: bool = False) -> bd.Run:
    return case(known=known).sample()


def steps_of(job: Job) -> dict[str, step_error.StepSizes]:
    return step_error.chosen_steps(job.problem.posterior)


def test_steps_are_as_fine_as_the_maximum_needs() -> None:
    best = case().find_map()
    start, end = steps_of(case().job), best.mode.pieces
    assert start[""][0] == 1
    assert end[""][0] > 1
    theta = case().job.problem.posterior.space.vector(best.values)
    (few,) = step_errors(case().job.problem.posterior.likelihood, theta)
    (enough,) = step_errors(case().job.with_steps_at(best.mode).problem.posterior.likelihood, theta)
    assert not few.fine
    assert enough.fine
    assert "TOO FEW" not in best.table
    assert best.mode.gain < 1e-6


@pytest.mark.slow
def test_all_processes_use_the_steps_of_the_maximum(tmp_path: Path) -> None:
    run().save(tmp_path / "out")
    bd.load(tmp_path / "out" / "config.yaml").run(tmp_path / "two", processes=2)
    other = bd.open(tmp_path / "two")
    assert steps_of(run().job) == steps_of(other.job) == run().mode.pieces
    for name, draws in run().draws.items():
        assert np.array_equal(draws, other.draws[name])


def test_the_evidence_is_that_of_the_rig_and_not_of_its_steps() -> None:
    """Oracle: the integral over its only unknown, in far finer steps than those of any run."""
    evidence, posterior = run(known=True).evidence, run(known=True).job.problem.posterior
    x = run(known=True).draws["j_1"]
    at = np.linspace(x.mean() - 8 * x.std(), x.mean() + 8 * x.std(), 400)
    prior = posterior.space.priors["j_1"]

    def log_z(steps: dict[str, step_error.StepSizes]) -> float:
        logs = step_error.with_steps(posterior, steps).likelihood(at[:, None])
        whole = np.trapezoid(np.exp(logs - logs.max()), at) / (prior.high - prior.low)
        return float(logs.max() + np.log(whole))

    true = log_z({"": (256, REVERSAL_SUBSTEPS)})
    assert abs(log_z(dict(run(known=True).mode.pieces)) - true) > 0.03
    assert abs(evidence.log_z - true) < 2 * evidence.error < 0.1
    assert "for the error of its steps" in str(run(known=True))


def test_steps_of_a_config_stay(tmp_path: Path) -> None:
    model = ("inputs:", "model: {name: motor_shaft, pieces: 2}\ninputs:")
    config = small_config(tmp_path, model, ("t_f: nominal", "t_f: nominal\n  t_cm: 0.01"))
    assert steps_of(bd.load(config).job) == {}
