"""A record with a missing torque in a few numbers: its densities against the exact filter's."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from oracles import NOMINAL
from rigs import experiment, vector

from bayesdrill.rig.models.latent_torque import MissingTorque, Smoothness
from bayesdrill.rig.models.motor_shaft import MotorShaft
from bayesdrill.rig.simulators import simulator
from bayesdrill.rig.simulators.compressed_filter import compress_filter, filter_obstacle
from bayesdrill.rig.simulators.contract import Simulator
from bayesdrill.rig.simulators.exact import Response
from bayesdrill.rig.simulators.kalman import KalmanFilter
from bayesdrill.rig.simulators.rational_basis import CompressionError
from bayesdrill.rig.simulators.sensors import ObservationModel

SIGMAS = {"theta_1": 0.02, "theta_2": 0.03, "w_1": 0.1, "w_2": 0.2}


def shaken(
    names: tuple[str, ...], smoothness: Smoothness, **changes: object
) -> tuple[KalmanFilter, Response]:
    """A rig under steps of voltage, and the torque that it has beside them."""
    rng, n = np.random.default_rng(4), 6001
    v = rng.choice([4.0, 12.0], n // 20 + 1).repeat(20)[:n]
    measures = {name: {name: 1.0} for name in names}
    record = experiment(n, 0.005, constant={"t_1": 0.1}, series={"v": v}, measures=measures)
    record = dataclasses.replace(record, **changes)
    filtered = KalmanFilter(MotorShaft(), MissingTorque(smoothness=smoothness), record)
    noise = filtered.draw(*walkers(names, 1), rng)[1][0]
    y = Response(MotorShaft(), record).signals(vector(NOMINAL)[None])[0] + noise
    record = dataclasses.replace(record, y=y)
    return dataclasses.replace(filtered, experiment=record), Response(MotorShaft(), record)


def walkers(names: tuple[str, ...], n: int, spread: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Rigs and torques `(n, P)` and noises `(n, K)` about the truth, which is the first."""
    rng, p = np.random.default_rng(5), len(NOMINAL)
    middle = np.concatenate([vector(NOMINAL), [0.05, 0.3], [SIGMAS[name] for name in names]])
    sds = np.concatenate([np.full(p, 2e-3), [0.02, 0.05], np.full(len(names), 0.01)])
    factors = np.exp(spread * sds * rng.standard_normal((n, len(middle))))
    factors[0] = 1.0
    return np.split(middle * factors, [p + 2], axis=1)[0], (middle * factors)[:, p + 2 :]


CASES = {
    "angles": (("theta_1", "theta_2", "w_1"), "3/2", {"start": {"theta_1": 3.0, "theta_2": 1.0}}),
    "speeds": (("w_1", "w_2"), "1/2", {"start": {"w_1": 2.0}, "first_order": True}),
    "one angle": (("theta_2",), "1/2", {}),
}


@pytest.mark.parametrize("name", CASES)
def test_densities_are_those_of_the_exact_filter(name: str) -> None:
    """Of starts of all kinds, inputs that are held or change straight, and rigs that turn freely.

    Mutants killed: innovations that show nothing of the start, an angle that a rig has turned by
    before the first sample.
    """
    names, smoothness, changes = CASES[name]
    filtered, response = shaken(names, smoothness, **changes)
    made = compress_filter(filtered, response, *walkers(names, 64))
    some = walkers(names, 21)
    terms, beyond = made.expanded(*some)[0], made.exceeds_bound(*some)
    assert beyond.sum() <= 2
    exact = filtered.log_density(*some, response.record)
    apart, below = np.abs(terms - exact).sum(axis=1), np.abs(exact - exact[0]).sum(axis=1)
    # Far below, of angles of hundreds of rad, the exact filter rounds more than this one.
    assert (apart <= 3e-8 + 3e-9 * below)[~beyond].all()
    assert made.functions < 600
    assert repr(made) == repr(filtered)
    assert made.by_samples.functions == 0


def test_filters_far_away_have_all_samples() -> None:
    names = ("w_1", "w_2")
    filtered, response = shaken(names, "3/2")
    made = compress_filter(filtered, response, *walkers(names, 64))
    some = walkers(names, 9, spread=40.0)
    beyond = made.exceeds_bound(*some)
    assert beyond[1:].any()
    assert not beyond[0]
    exact = filtered.log_density(*some, response.record)
    found = made.log_density(*some, response.record)
    assert np.allclose(found[beyond], exact[beyond], rtol=1e-12, atol=0, equal_nan=True)
    assert np.allclose(found, exact, rtol=1e-9, atol=0, equal_nan=True)


def test_nothing_is_beyond_its_bound() -> None:
    """Of filters ever further away; rounding aside, which no bound knows."""
    names = ("w_1", "w_2")
    filtered, response = shaken(names, "3/2")
    made = compress_filter(filtered, response, *walkers(names, 64))
    for spread in (1.0, 5.0, 10.0, 20.0):
        some = walkers(names, 24, spread)
        terms, errors, _ = made.expanded(*some)
        wrong = np.abs(terms - filtered.log_density(*some, response.record)).sum(axis=1)
        known = np.isfinite(errors)
        assert (wrong <= errors + 1e-11 * np.abs(terms).sum(axis=1) + 1e-7)[known].all()


def test_what_cannot_be_compressed_says_why() -> None:
    names = ("w_1", "w_2")
    filtered, response = shaken(names, "3/2")
    y = response.experiment.y.copy()
    y[7, 0] = np.nan
    record = dataclasses.replace(response.experiment, y=y)
    gaps: Simulator = simulator(MotorShaft(), record, ObservationModel())
    assert "torque is missing" in filter_obstacle(gaps)
    with pytest.raises(CompressionError, match="torque is missing"):
        compress_filter(filtered, gaps, *walkers(names, 4))
    with pytest.raises(CompressionError):
        compress_filter(filtered, response, *walkers(names, 64, spread=100.0))
