"""Angles that begin again, and speeds that are differences."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter
from support.case_tables import for_each

from bayesdrill.record import anomalies

T = np.arange(1500) * 0.004
RNG = np.random.default_rng(8)
TURNING = 25.0 * T + 9.0 * np.sin(4.0 * T)  # forth and back again
NOISE = 0.002 * RNG.standard_normal(len(T))


def test_turns_are_taken_back() -> None:
    def check(period: float) -> None:
        x = TURNING * period / (2 * np.pi)
        wrapped = np.mod(x + 0.3 * period, period)
        straight, jumps = anomalies.unwrap(wrapped, period)
        np.testing.assert_allclose(straight - straight[0], x - x[0], atol=1e-9 * period)
        assert jumps == np.sum(np.abs(np.diff(wrapped)) > period / 2) > 10
        assert len(anomalies.ambiguous(wrapped, period)) == 0

    for_each({str(period): (period,) for period in [360.0, 2 * np.pi, 4096.0]}, check)


def test_half_a_turn_in_one_step_cannot_be_told() -> None:
    x = np.array([0.0, 10.0, 195.0, 200.0, 20.0])
    assert anomalies.ambiguous(x, 360.0).tolist() == [2, 4]


def test_nearest_quotients_are_told_apart() -> None:
    x = TURNING + NOISE
    for kind, w in anomalies.quotients(x, T).items():
        found, off = anomalies.nearest_quotient(x, np.concatenate([[0.0], w, [0.0]]), T)
        assert found == kind
        assert off < 1e-12


BACKWARD = np.diff(TURNING + NOISE, prepend=TURNING[0]) / 0.004


def test_differences_of_an_angle_have_its_noise() -> None:
    cases = {
        "backward": (BACKWARD,),
        "in another unit": (3.7 * BACKWARD,),
        "central": (np.gradient(TURNING + NOISE, T),),
        "filtered": (lfilter([0.2], [1.0, -0.8], BACKWARD),),
        "smoothed": (np.convolve(BACKWARD, np.ones(4) / 4, mode="same"),),
    }

    def check(speed: np.ndarray) -> None:
        assert anomalies.differenced(TURNING + NOISE, speed, 0.004)

    for_each(cases, check)


def test_a_speed_that_was_measured_has_noise_of_its_own() -> None:
    """Mutant killed: a speed that is only predictable taken for differences."""
    speed = 25.0 + 36.0 * np.cos(4.0 * T)
    own = 0.3 * RNG.standard_normal(len(T))
    assert not anomalies.differenced(TURNING + NOISE, speed + own, 0.004)
    assert not anomalies.differenced(TURNING, speed, 0.004)
    assert not anomalies.differenced(TURNING + NOISE, speed, 0.004)
    assert not anomalies.differenced(TURNING, speed + own, 0.004)
    assert not anomalies.differenced(np.round(TURNING, 2), np.round(speed, 1), 0.004)
    assert not anomalies.differenced(TURNING + NOISE, BACKWARD + 0.1 * own, 0.004)
