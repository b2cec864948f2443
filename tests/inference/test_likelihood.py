"""Likelihoods of several experiments, of sensors and starts, and of rigs that lack a torque."""

from dataclasses import replace

import numpy as np
import pytest
from support import two_experiments
from support.case_tables import run_cases
from support.missing_torque_cases import SIZE, TIME, step_with_torque
from support.missing_torque_oracle import covariance, process
from support.scipy_oracles import NOMINAL
from support.small_problems import near_middle

from bayesdrill.inference.noise.white import White
from bayesdrill.inference.posterior import Posterior
from bayesdrill.inference.residual_checks import residual_summaries

# --- two experiments with sensors and starts of their own -------------------------------------------


def joint() -> Posterior:
    return two_experiments.rich_job().problem.posterior


def log_likelihood_by_names(theta: np.ndarray, label: str) -> float:
    """Return that of one experiment, whose numbers are found by their names alone."""
    posterior = joint()
    (one,) = [o for o in posterior.likelihood.observations if o.label == label]
    named = posterior.space.named(theta[None])

    def value(name: str) -> float:
        own = name if name in ("gain_twist", "sigma_twist") else f"{name}_{label}"
        return float(np.squeeze(named[own if own in named else name]))

    full = np.array([[value(name) for name in one.response.parameters]])
    residuals = one.experiment.y - one.response.signals(full)[0]
    w_2 = value("sigma_w_2") if label == "moving" else np.pi / 60  # 0.5 rpm
    sigmas = np.array([value("sigma_twist"), w_2])
    density = -0.5 * (residuals / sigmas) ** 2 - np.log(sigmas) - 0.5 * np.log(2 * np.pi)
    return float(np.nansum(density))


def test_the_joint_likelihood_is_the_sum_of_its_experiments() -> None:
    for theta in near_middle(joint().space):
        expected = sum(log_likelihood_by_names(theta, label) for label in ("late", "moving"))
        assert joint().likelihood(theta[None])[0] == pytest.approx(expected, rel=1e-10)


@run_cases("level, experiment", [("known", 0), ("unknown", 1)])
def test_missing_samples_count_as_if_they_were_never_measured(level: str, experiment: int) -> None:
    """Those of one channel, whose noise level is known or not."""
    posterior = joint()
    one, rows, k = posterior.likelihood.observations[experiment], np.array([5, 6, 30]), 1
    y = np.array(one.experiment.y)
    y[rows, k] = np.nan
    theta = near_middle(posterior.space, 2)
    full = posterior.space.full(theta)
    fewer = one.for_record(replace(one.experiment, y=y)).bind(posterior.space)
    difference = one.by_channel(full, theta)[:, k] - fewer.by_channel(full, theta)[:, k]
    residuals = (one.experiment.y - one.signals(full))[:, rows, k]
    sigma = one.scales(theta)[:, k, None]
    density = -0.5 * (residuals / sigma) ** 2 - np.log(sigma) - 0.5 * np.log(2 * np.pi)
    assert difference == pytest.approx(density.sum(axis=1), rel=1e-7)


# --- a missing torque -------------------------------------------------------------------------------


def near_truth(n: int) -> np.ndarray:
    theta = step_with_torque()[1]
    return theta * np.exp(0.05 * np.random.default_rng(3).standard_normal((n, len(theta))))


def test_a_torque_of_no_size_is_no_torque() -> None:
    target, theta = step_with_torque()[0], near_truth(3)
    theta[:, -2] = 1e-9
    observation = target.likelihood.only_observation
    known, unknowns = {0: 0.1, 1: 0.1, 2: 0.2}, observation.unknowns[:1]
    white = White(n_samples=151, known=known, n_channels=4, unknowns=unknowns)
    residuals = observation.residuals(target.space.full(theta))
    expected = white.log_likelihood(residuals, theta[:, 9:10]).sum(axis=1)
    assert target.likelihood(theta) == pytest.approx(expected, abs=1e-5)


def test_a_fixed_covariance_is_that_of_one_rig_whatever_rig_the_residuals_are_of() -> None:
    target, theta = step_with_torque()[0], near_truth(2)
    observation = target.likelihood.only_observation
    fixed = observation.with_fixed_covariance(theta[0])
    samples = observation.residuals(target.space.full(theta)).samples[[1, 1]]
    two_rigs = np.vstack([theta[0], np.append(theta[1, :9], theta[0, 9:])])
    own, same = observation.whiten(samples, two_rigs), fixed.whiten(samples, two_rigs)
    assert (same[0] == own[0]).all()
    assert (same[1] == same[0]).all()
    assert not np.allclose(own[1], own[0])
    first, second = fixed.innovations(samples, two_rigs)
    assert (first == second).all()


def test_predictions_one_step_ahead_are_those_of_the_covariance_of_all_samples() -> None:
    target, theta = step_with_torque()
    observation = target.likelihood.only_observation
    experiment = observation.experiment
    summaries = residual_summaries(target.likelihood, theta)
    residuals = experiment.y - observation.signals(target.space.full(theta[None]))[0]
    states = process(NOMINAL, "rotor_1", "3/2", SIZE, TIME)
    sigmas, weights = np.array([0.1, 0.1, 0.2, 0.2]), np.eye(4, len(states[0]))
    joint = covariance(states, weights, sigmas, experiment.t, experiment.t_start)
    lower = np.linalg.cholesky(joint)
    white = np.linalg.solve(lower, residuals.ravel())
    ahead = (white * np.diag(lower)).reshape(-1, 4)[:, 0]  # others know the first channel
    expected = np.sqrt(np.mean(ahead**2)) / experiment.y[:, 0].std()
    assert summaries[0].ahead == pytest.approx(expected, rel=1e-6)
    for channel in summaries:
        assert channel.ahead < channel.simulated
        assert channel.share < channel.ahead
