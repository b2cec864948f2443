"""Starts of searches by inverse dynamics, from configured starts that are far from the truth."""

import numpy as np
import pytest
from support.case_tables import slow_except
from support.scipy_oracles import NOMINAL
from support.small_problems import starts_believed

import bayesdrill as bd
from bayesdrill.inference.inverse_dynamics import regression_start
from bayesdrill.rig.models.motor_shaft import DrivenShaft, Motor

N = 4000
T = 0.005 * np.arange(N)
FAR = (12.0, 0.1, 5.0)  # times the truth: the configured starts


def steps(seed: int, samples: int) -> np.ndarray:
    """Return random levels, each of them for `samples` samples."""
    return np.repeat(np.random.default_rng(seed).standard_normal(N // samples), samples)


SHAFT = DrivenShaft(added=("c_s",)), {"k_s": 4.1, "j_1": 0.008, "c_s": 0.02}
DRIVEN = {"w_2": bd.Input(5.0 * steps(1, 20), "rad/s"), "t_1": bd.Input(0.5 * steps(6, 40), "N*m")}
RUBBING = Motor(added=("t_cm",)), {"j_m": 2e-3, "c_m": 5e-3, "t_cm": 0.02}
PUSHED = {"t_m": bd.Input(0.3 * steps(2, 50), "N*m")}
CASES = {
    "angle of a shaft": (*SHAFT, DRIVEN, "theta_1", "rad", 0.01, 0.03),
    "speed of a shaft": (*SHAFT, DRIVEN, "w_1", "rad/s", 0.05, 0.08),
    "motor with dry friction": (*RUBBING, PUSHED, "w_2", "rad/s", 0.05, 0.01),
}


@pytest.mark.parametrize(
    "name", slow_except(("angle of a shaft", "motor with dry friction"), CASES)
)
def test_the_start_is_near_the_truth(name: str) -> None:
    """It fits better than the configured start, and is where the search begins."""
    rig, truth, inputs, channel, unit, sigma, within = CASES[name]
    signals = bd.respond(rig, truth, T, {name: u.values for name, u in inputs.items()}, [channel])
    y = signals[channel] + sigma * np.random.default_rng(5).standard_normal(N)
    boxes = {
        name: {"prior": "log_uniform", "low": x / 1e3, "high": x * 1e3, "start": x * factor}
        for (name, x), factor in zip(truth.items(), FAR, strict=True)
    }
    case = bd.case(T, {channel: bd.Channel(y, unit, sigma)}, inputs, boxes, rig=rig)
    posterior = case.job.problem.posterior
    theta = regression_start(posterior)
    start = dict(zip(posterior.space.free, theta, strict=True))
    assert start == pytest.approx(truth, rel=within)
    configured = posterior.space.vector(posterior.space.start)
    assert np.diff(posterior.density(np.array([configured, theta]))) > 0
    (search,) = case.find_map(quick=True).mode.searches
    assert dict(search.start) == start


@starts_believed()
def test_a_state_that_no_channel_shows_leaves_the_configured_start() -> None:
    """The current of the motor is in no column."""
    noise = np.random.default_rng(3).standard_normal(N)
    prior = {"prior": "uniform", "low": 0.01, "high": 1.0}
    case = bd.case(
        T,
        {"w_1": bd.Channel(noise, "rad/s", 0.1)},
        {"v": bd.Input(steps(4, 50), "V")},
        {**NOMINAL, "t_f": 0.0, "k_s": prior},
    )
    assert regression_start(case.job.problem.posterior) is None
