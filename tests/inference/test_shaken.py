"""A posterior with a missing torque: its slopes, its limits, and what it hands on to all others.

Mutants killed: a slope that forgets what parameters do to the covariance, levels of the noise
exchanged with the torque's, a covariance that is not pinned where residuals of another rig are
held against it.
"""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
import pytest
from support.missing_torque_oracle import covariance, process
from support.scipy_oracles import NOMINAL, ORDER
from support.small_problems import STATES, experiment, posterior, unknown, vector

from bayesdrill.inference.laplace import LogDensity
from bayesdrill.inference.likelihood import LatentTorqueObservation
from bayesdrill.inference.noise.white import White
from bayesdrill.inference.posterior import Likelihood, Posterior
from bayesdrill.inference.priors import LogUniform
from bayesdrill.inference.residual_checks import residual_summaries
from bayesdrill.inference.unknowns import ParameterSpace, Unknown
from bayesdrill.rig.models.latent_torque import MissingTorque
from bayesdrill.rig.models.motor_shaft import MotorShaft
from bayesdrill.rig.simulators import simulator
from bayesdrill.rig.simulators.kalman import KalmanFilter
from bayesdrill.rig.simulators.linear import Response
from bayesdrill.rig.simulators.sensors import ObservationModel

FOUR = {name: {name: 1.0} for name in STATES[:4]}
SIZE, TIME = 0.05, 0.3


def level(name: str, low: float, high: float) -> Unknown:
    return dataclasses.replace(unknown(name, LogUniform(low, high)), role="noise")


@functools.cache
def target(*, gaps: bool = False) -> Posterior:
    """Nine parameters, one unknown sigma of two, size and time of the torque at rotor 1."""
    rng = np.random.default_rng(8)
    one = experiment(151, 0.03, measures={k: FOUR[k] for k in ("theta_1", "w_2")})
    found = KalmanFilter(MotorShaft(), MissingTorque(at="rotor_1"), one)
    row = np.append(vector(NOMINAL), [SIZE, TIME])[None]
    y = Response(MotorShaft(), one).signals(vector(NOMINAL)[None])[0]
    y = y + found.draw(row, np.array([[0.1, 0.2]]), rng)[1][0]
    if gaps:
        y[20:30, 1] = np.nan
    one = dataclasses.replace(one, y=y)
    base = posterior(one, np.array([0.1, 0.2]), priors={})
    sigma = level("sigma_w_2", 0.02, 2.0)
    within = White(n_samples=151, known={0: 0.1}, n_channels=2, unknowns=(sigma,))
    torque = {"s_d": level("s_d", 1e-3, 1.0), "tau_d": level("tau_d", 0.01, 10.0)}
    observed = LatentTorqueObservation(
        response=simulator(MotorShaft(), one, ObservationModel()),
        noise=within.with_counts(one.counts),
        kalman_filter=KalmanFilter(MotorShaft(), found.torque, one),
        process=torque,
        parameters=ORDER,
        noise_names=["sigma_w_2", "s_d", "tau_d"],
    )
    unknowns = (*base.space.unknowns, *observed.unknowns)
    space = ParameterSpace(model=ORDER, unknowns=unknowns, fixed={})
    likelihood = Likelihood.joint(space, [observed])
    return Posterior(space=space, likelihood=likelihood, coordinates=space.coordinates)


def points(n: int = 4) -> np.ndarray:
    middle = np.append(vector(NOMINAL), [0.2, SIZE, TIME])
    return middle * np.exp(0.05 * np.random.default_rng(3).standard_normal((n, len(middle))))


def test_slopes_are_those_of_differences() -> None:
    """Of parameters, which move the mean and the covariance, of a level, of size and time."""
    of = target()
    surface = LogDensity(of)
    u = of.coordinates.from_physical(points())
    every = np.eye(u.shape[1])
    found = surface.quadratic_model(u, every)
    step = 1e-5
    rises = [surface.value(u + step * d) - surface.value(u - step * d) for d in every]
    slopes = np.array(rises).T / (2 * step)
    sizes = np.sqrt(np.diagonal(found.curvature, axis1=1, axis2=2))
    assert (found.slope / sizes) == pytest.approx(slopes / sizes, abs=2e-5)
    assert np.isfinite(found.value).all()


def test_the_curvature_is_on_average_the_fisher_information() -> None:
    """Of records drawn at one point; of 60 of them the mean of squared slopes is it to four sigma."""
    of, rng = target(), np.random.default_rng(9)
    one, theta = of.likelihood.only_observation, points(1)
    clean = one.signals(of.space.full(theta))
    slopes, curvatures = [], []
    for _ in range(60):
        record = one.draw(clean, theta, rng)[0]
        likelihood = dataclasses.replace(of.likelihood, observations=(one.with_record(record),))
        surface = LogDensity(dataclasses.replace(of, likelihood=likelihood))
        slope, curvature = surface.record_slopes(theta, np.eye(theta.shape[1]))
        slopes.append(slope[0])
        curvatures.append(np.diag(curvature[0]))
    ratio = np.mean(np.square(slopes), axis=0) / np.mean(curvatures, axis=0)
    assert ratio == pytest.approx(np.ones(len(ratio)), abs=4 * np.sqrt(2 / 60))


def test_a_torque_of_no_size_is_no_torque() -> None:
    of = target()
    theta = points(3)
    theta[:, -2] = 1e-9
    one = of.likelihood.only_observation
    plain = White(n_samples=151, known={0: 0.1}, n_channels=2, unknowns=one.unknowns[:1])
    values = plain.log_likelihood(one.residuals(of.space.full(theta)), theta[:, 9:10])
    assert of.likelihood(theta) == pytest.approx(values.sum(axis=1), abs=1e-5)


def test_gaps_take_the_way_of_all_samples() -> None:
    """And the same density where there is none."""
    whole, some = target(), target(gaps=True)
    theta = points(2)
    fast = whole.likelihood(theta)
    one = whole.likelihood.only_observation
    left = one.residuals(whole.space.full(theta)).samples
    each = one.pointwise(left, theta)
    assert fast == pytest.approx(each.sum(axis=(1, 2)), abs=1e-7)
    assert np.isfinite(some.likelihood(theta)).all()
    assert some.likelihood.n_measured == whole.likelihood.n_measured - 10


def test_pinned_the_covariance_is_that_of_one_rig() -> None:
    """Whatever rig the residuals are of; what is whitened is then linear in them."""
    of, theta = target(), points(2)
    one = of.likelihood.only_observation
    held = one.with_fixed_covariance(theta[0])
    left = one.residuals(of.space.full(theta)).samples
    there = np.vstack([theta[0], np.append(theta[1, :9], theta[0, 9:])])
    rows = one.whiten(left[[1, 1]], there)
    pinned = held.whiten(left[[1, 1]], there)
    assert (pinned[0] == rows[0]).all()
    assert (pinned[1] == pinned[0]).all()
    assert not np.allclose(rows[1], rows[0])


def test_one_step_ahead_of_a_missing_torque_is_what_its_filter_predicts() -> None:
    """By the covariance of all samples, typed in: each given those before it."""
    posterior = target()
    theta = np.append([NOMINAL[name] for name in ORDER], [0.2, 0.05, 0.3])
    (one,) = posterior.likelihood.observations
    found = residual_summaries(posterior.likelihood, theta)
    residuals = one.experiment.y - one.signals(posterior.space.full(theta[None]))[0]
    of = process(NOMINAL, "rotor_1", one.torque.kalman_filter.torque.smoothness, 0.05, 0.3)
    weights = np.zeros((2, len(of[0])))
    weights[0, 0] = weights[1, 3] = 1.0
    joint = covariance(of, weights, np.array([0.1, 0.2]), one.experiment.t, one.experiment.t_start)
    lower = np.linalg.cholesky(joint)
    white = np.linalg.solve(lower, residuals.ravel())
    ahead = (white * np.diag(lower)).reshape(-1, 2)  # the second channel is told the first
    assert found[0].ahead * one.experiment.y[:, 0].std() == pytest.approx(
        np.sqrt(np.mean(ahead[:, 0] ** 2)), rel=1e-6
    )
    for channel in found:
        assert channel.ahead < channel.simulated
        assert channel.share < channel.ahead
