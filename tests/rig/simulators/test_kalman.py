"""A missing torque against covariances of all samples, which `missing_torque_oracle` types in anew."""

import dataclasses
import pickle
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from support import missing_torque_oracle
from support.case_tables import run_cases
from support.linear_oracle import ExactMotion
from support.scipy_oracles import skewed
from support.small_problems import UnevenShaft, experiment, vector

from bayesdrill.record.experiment import Experiment
from bayesdrill.rig.models.latent_torque import (
    MissingTorque,
    Smoothness,
    TorqueLocation,
    torque_gain,
)
from bayesdrill.rig.models.motor_shaft import DrivenShaft, MotorShaft
from bayesdrill.rig.simulators.kalman import KalmanFilter, step_lengths
from bayesdrill.rig.simulators.linear import Response

Array = NDArray[np.float64]

BOTH = [("motor", "1/2"), ("rotor_1", "3/2")]  # each place and each smoothness
MEASURES = {name: {name: 1.0} for name in MotorShaft.states[:4]}
GEARED = {"speed": {"w_2": 8.0, "w_1": -0.5}, "angle": {"theta_2": 0.25}}
RELATIVE = {"twist": {"theta_1": 1.0, "theta_2": -1.0}, "motor": {"w_2": 8.0}}
MEASURED = [MEASURES, RELATIVE, GEARED]
START = {"theta_1": 0.7, "theta_2": -1.2, "w_1": 2.0, "w_2": -9.0, "i": 0.4}
LATE = {"first": 0.31, "t_start": 0.0, "start": START}
SIGMAS = np.array([0.05, 0.02, 0.3, 0.2])
SIZE, TIME = 0.08, 0.4
P = skewed()


def recorded(n: int, dt: float, measures: dict[str, dict[str, float]], **own: Any) -> Experiment:
    """A record of nothing under a voltage that is measured."""
    volts = {"v": 8.0 + np.sin(np.arange(n))}
    return experiment(n, dt, measures=measures, constant={"t_1": 0.0}, series=volts, **own)


def weights(one: Experiment, own: int) -> Array:
    return np.hstack([one.weights(MotorShaft.states), np.zeros((len(one.channels), own))])


def told(n: int = 1) -> tuple[Array, Array]:
    """Parameters and sigmas of n walkers, all alike."""
    row = np.append(vector(P), [SIZE, TIME])
    return np.repeat(row[None], n, axis=0), np.repeat(SIGMAS[None], n, axis=0)


def drawn(one: Experiment, seed: int = 3) -> Array:
    return np.cumsum(np.random.default_rng(seed).standard_normal(one.y.shape), axis=0) * 0.05


def made(
    at: TorqueLocation, smooth: Smoothness, one: Experiment
) -> tuple[KalmanFilter, missing_torque_oracle.Process, Array]:
    found = KalmanFilter(MotorShaft(), MissingTorque(at=at, smoothness=smooth), one)
    found = pickle.loads(pickle.dumps(found))  # as workers have it
    of = missing_torque_oracle.process(P, at, smooth, SIZE, TIME)
    return found, of, weights(one, len(found.torque.states))


def shown(one: Experiment, left: Array, rig: MotorShaft | None = None) -> Response:
    """A record of the rig that is off by what is `left`."""
    rig = rig or MotorShaft()
    clean = ExactMotion(rig, one, vector(P)).signals().astype(float)
    return Response(rig, dataclasses.replace(one, y=clean + left))


def density(found: KalmanFilter, left: Array) -> float:
    """By the filter of all samples."""
    white, variances = found.whiten(*told(), left[None])
    return float(np.nansum(-0.5 * (np.log(2 * np.pi * variances) + white**2)))


def true_density(
    of: missing_torque_oracle.Process, rows: Array, one: Experiment, left: Array
) -> float:
    """By the covariance of all samples together."""
    sigmas = SIGMAS[: len(one.channels)]
    covariance = missing_torque_oracle.covariance(of, rows, sigmas, one.t, one.t_start)
    return missing_torque_oracle.log_density(left, covariance)


@run_cases(
    "at, smooth, n, measures, late",
    [
        *((at, smooth, 80, MEASURES, {}) for at, smooth in BOTH),
        *(("rotor_1", "3/2", n, MEASURES, {}) for n in (2, 3, 5, 8, 13, 64, 65, 127)),
        *(("rotor_1", "3/2", 60, measures, LATE) for measures in MEASURED),
    ],
)
def test_the_likelihood_is_that_of_all_samples_together(
    at: TorqueLocation,
    smooth: Smoothness,
    n: int,
    measures: dict[str, dict[str, float]],
    late: dict[str, Any],
) -> None:
    """With one gain and an exact start; of any number of samples, which are put together in twos; of
    a start before the first sample, where all states are something.
    """
    one = recorded(n, 0.02, measures, **late)
    left = drawn(one)
    found, of, rows = made(at, smooth, one)
    truth = true_density(of, rows, one, left)
    full, sigmas = told(9)
    seen = shown(one, left)  # owns the samples that its record points to
    ours = found.log_density(full, sigmas[:, : len(measures)], seen.record)
    assert ours.sum(axis=1) == pytest.approx(np.full(9, truth), abs=1e-8)
    if n == 80:
        assert density(found, left) == pytest.approx(truth, abs=1e-8)
        plain = missing_torque_oracle.filtered(of, rows, SIGMAS, left, 0.02)
        assert plain == pytest.approx(truth, abs=1e-8)


@run_cases("at, smooth", BOTH)
def test_the_likelihood_allows_gaps_uneven_times_and_an_early_start(
    at: TorqueLocation, smooth: Smoothness
) -> None:
    """What was not measured has no term, and every step has its own length."""
    steps = np.resize([0.01, 0.01, 0.03, 0.01, 0.2], 49)
    t = 0.3 + np.concatenate([[0.0], np.cumsum(steps)])
    one = experiment(50, 0.02, measures=MEASURES)
    y = np.zeros((50, 4))
    y[7:12, 1] = y[20, :] = y[:4, 2] = np.nan
    one = dataclasses.replace(one, t=t, y=y, t_start=0.05)
    left = np.where(np.isnan(y), np.nan, drawn(one))
    found, of, rows = made(at, smooth, one)
    assert density(found, left) == pytest.approx(true_density(of, rows, one, left), abs=1e-8)


@run_cases("measures", MEASURED)
def test_states_of_the_rig_are_those_that_channels_show(
    measures: dict[str, dict[str, float]],
) -> None:
    """Angles are relative ones inside; outside they are those of the rig, as far as any is told of."""
    one = recorded(20, 0.02, measures)
    found = KalmanFilter(MotorShaft(), MissingTorque(at="rotor_1", smoothness="3/2"), one)
    states, drawn_signals = found.draw(
        told(3)[0], 1e-9 * np.ones((3, len(measures))), np.random.default_rng(8)
    )
    named = found.augmented.to_rig_states(states)
    assert ("theta_1" in named) == ("theta_2" in named) == (measures != RELATIVE)
    assert states @ found.output_matrix.T == pytest.approx(drawn_signals, abs=1e-7)
    for k, weights in enumerate(measures.values()):
        if set(weights) <= set(named):
            ours = sum(weight * named[name] for name, weight in weights.items())
            assert ours == pytest.approx(drawn_signals[..., k], abs=1e-7)


def assert_one_gain_is_enough(found: KalmanFilter, row: Array, sigmas: Array, close: float) -> None:
    """The likelihood by one gain is that by the gain of each sample, for residuals that are drawn."""
    left = found.draw(row, sigmas, np.random.default_rng(1))[1][0]
    seen = shown(found.experiment, left, found.model)
    white, variances = found.whiten(row, sigmas, left[None])
    truth = -0.5 * (np.log(2 * np.pi * variances) + white**2).sum()
    assert found.log_density(row, sigmas, seen.record).sum() == pytest.approx(truth, abs=close)


@run_cases(
    "measures, size, time",
    [
        (measures, size, time)
        for measures in [MEASURES, RELATIVE]
        for size in [1e-7, 3e-3, 2.0]
        for time in [2e-3, 0.5, 60.0]
    ],
)
def test_one_gain_gives_the_likelihood_of_all_gains(
    measures: dict[str, dict[str, float]], size: float, time: float
) -> None:
    """However little a torque does and however long it stays; also where no angle is seen by itself."""
    one = recorded(1001, 0.01, measures)
    found = KalmanFilter(MotorShaft(), MissingTorque(at="rotor_1", smoothness="3/2"), one)
    row = np.append(vector(P), [size, time])[None]
    assert_one_gain_is_enough(found, row, np.full((1, len(measures)), 0.1), 1e-7)


@run_cases("at, smooth", BOTH)
def test_slopes_are_those_of_differences(at: TorqueLocation, smooth: Smoothness) -> None:
    rng = np.random.default_rng(2)
    one = experiment(
        40, 0.02, measures=MEASURES, y=np.where(rng.random((40, 4)) < 0.1, np.nan, 0.0)
    )
    found, _, _ = made(at, smooth, one)
    (row, sigmas), left = told(), drawn(one)[None]
    turns = row * rng.standard_normal(row.shape), sigmas * rng.standard_normal(sigmas.shape)
    turn = rng.standard_normal(left.shape)
    step = 1e-6
    up, down = (
        found.whiten(row + s * turns[0], sigmas + s * turns[1], left + s * turn)
        for s in (step, -step)
    )
    white, change, variances, wider = found.slopes(
        (row, turns[0]), (sigmas, turns[1]), (left, turn)
    )
    seen = one.is_measured
    assert white[0, seen] == pytest.approx(found.whiten(row, sigmas, left)[0][0, seen], abs=1e-10)
    assert change[0, seen] == pytest.approx(
        ((up[0] - down[0]) / (2 * step))[0, seen], abs=1e-6 * np.abs(change).max()
    )
    assert (wider / variances)[0, seen] == pytest.approx(
        ((up[1] - down[1]) / (2 * step) / variances)[0, seen], abs=1e-6
    )


@run_cases("at, smooth", BOTH)
def test_draws_have_the_covariance_of_the_samples(at: TorqueLocation, smooth: Smoothness) -> None:
    """20000 of them: a standard error of 1 % of each variance, and of 0.7 % of what they are apart."""
    one = experiment(12, 0.1, first=0.2, measures=MEASURES)
    found, of, rows = made(at, smooth, one)
    draws = found.draw(*told(20000), np.random.default_rng(5))[1].reshape(20000, -1)
    truth = missing_torque_oracle.covariance(of, rows, SIGMAS, one.t, 0.0)
    sizes = np.sqrt(np.diag(truth))
    assert np.abs(np.cov(draws.T) - truth).max() < 0.06 * np.max(np.outer(sizes, sizes))
    assert np.diag(np.cov(draws.T)) == pytest.approx(np.diag(truth), rel=0.06)


@run_cases("at, smooth", BOTH)
def test_smoothing_gives_the_conditional_mean_of_the_torque(
    at: TorqueLocation, smooth: Smoothness
) -> None:
    """By covariances of torque and samples: that of a channel which shows the torque alone."""
    y = np.zeros((40, 4))
    y[9:14, 0] = np.nan
    one = experiment(40, 0.05, measures=MEASURES, y=y)
    left = np.where(np.isnan(y), np.nan, drawn(one))
    found, of, rows = made(at, smooth, one)
    both = np.vstack([rows, np.eye(len(of[0]))[5]])
    whole = missing_torque_oracle.covariance(of, both, np.append(SIGMAS, 0.0), one.t, 0.0)
    samples = np.tile([True, True, True, True, False], 40)
    samples[samples] &= ~np.isnan(left).ravel()
    torque = np.tile([False, False, False, False, True], 40)
    seen = left.ravel()[~np.isnan(left).ravel()]
    mean = whole[np.ix_(torque, samples)] @ np.linalg.solve(whole[np.ix_(samples, samples)], seen)
    states = found.smooth(*told(3), np.repeat(left[None], 3, axis=0))
    ours = SIZE * states[1, :, found.augmented.states.index("torque")]
    assert ours == pytest.approx(mean, abs=1e-9 * np.abs(mean).max() + 1e-10)


def test_one_gain_serves_a_rig_whose_angle_is_held() -> None:
    one = experiment(80, 0.02, measures={"w_2": {"w_2": 1.0}})
    found = KalmanFilter(UnevenShaft(), MissingTorque(at="motor"), one)
    assert_one_gain_is_enough(found, told()[0], SIGMAS[None, :1], 1e-8)


def test_a_shaft_that_is_driven_has_no_motor_to_push() -> None:
    rig, p = DrivenShaft(), {"k_s": 1.0, "j_1": 2.0}
    assert torque_gain(rig, MissingTorque(at="rotor_1"), p, rig.linear(p)) == 0.5
    with pytest.raises(ValueError, match="no inertia at motor"):
        torque_gain(rig, MissingTorque(at="motor"), p, rig.linear(p))


def test_times_of_too_many_steps_are_refused() -> None:
    one = experiment(200, measures=MEASURES)
    t = np.cumsum(np.random.default_rng(0).uniform(0.01, 0.02, 200))
    with pytest.raises(ValueError, match="199 different lengths"):
        step_lengths(dataclasses.replace(one, t=t))
