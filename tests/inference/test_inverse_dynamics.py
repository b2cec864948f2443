"""Starts by inverse dynamics: near the truth from far away, and none where a state is not told."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest
from support.scipy_oracles import NOMINAL

import bayesdrill as bd
from bayesdrill.inference.inverse_dynamics import regression_start
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.models.motor_shaft import DrivenShaft, Motor

DT, N = 0.005, 4000
T = DT * np.arange(N)
FAR = (12.0, 0.1, 5.0)  # times the truth: where searches begin


def held(rng: np.random.Generator, samples: int) -> np.ndarray:
    return np.repeat(rng.standard_normal(N // samples), samples)


def case(
    rig: Model,
    truth: Mapping[str, float],
    inputs: Mapping[str, bd.Input],
    channel: str,
    unit: str,
    sigma: float,
) -> bd.Case:
    shown = bd.respond(rig, truth, T, {name: u.values for name, u in inputs.items()}, [channel])
    y = shown[channel] + sigma * np.random.default_rng(5).standard_normal(N)
    boxes = {
        name: {"prior": "log_uniform", "low": x / 1e3, "high": x * 1e3, "start": x * off}
        for (name, x), off in zip(truth.items(), FAR, strict=True)
    }
    channels = {channel: bd.Channel(y, unit, sigma)}
    return bd.case(T, channels=channels, inputs=inputs, rig=rig, parameters=boxes)


def shaft(channel: str, unit: str, sigma: float) -> tuple[bd.Case, dict[str, float]]:
    rng = np.random.default_rng(1)
    truth = {"k_s": 4.1, "j_1": 0.008, "c_s": 0.02}
    inputs = {
        "w_2": bd.Input(5.0 * held(rng, 20), "rad/s"),
        "t_1": bd.Input(0.5 * held(rng, 40), "N*m"),
    }
    return case(DrivenShaft(added=("c_s",)), truth, inputs, channel, unit, sigma), truth


def motor() -> tuple[bd.Case, dict[str, float]]:
    """With a torque that is measured, and dry friction."""
    truth = {"j_m": 2e-3, "c_m": 5e-3, "t_cm": 0.02}
    inputs = {"t_m": bd.Input(0.3 * held(np.random.default_rng(2), 50), "N*m")}
    return case(Motor(added=("t_cm",)), truth, inputs, "w_2", "rad/s", 0.05), truth


@pytest.mark.parametrize(
    ("build", "within"),
    [
        pytest.param(lambda: shaft("theta_1", "rad", 0.01), 0.03, id="angle of a shaft"),
        pytest.param(lambda: shaft("w_1", "rad/s", 0.05), 0.08, id="speed of a shaft"),
        pytest.param(motor, 0.01, id="motor that rubs"),
    ],
)
def test_the_start_is_near_the_truth(build: object, within: float) -> None:
    """From configured starts that are wrong by factors of ten, without simulating anything.

    Mutants killed: the sign of an integral by parts; an input taken half a step late; friction that
    drives.
    """
    given, truth = build()  # type: ignore[operator]
    posterior = given.job.problem.posterior
    theta = regression_start(posterior)
    assert theta is not None
    found = dict(zip(posterior.space.free, theta, strict=True))
    assert found == pytest.approx(truth, rel=within)
    far = posterior.space.vector(posterior.space.start)
    assert np.diff(posterior.density(np.array([far, theta]))) > 0
    (search,) = given.find_map(quick=True).mode.searches
    assert dict(search.start) == found


def test_a_state_that_nothing_tells_leaves_the_configured_start() -> None:
    """The current of the motor is in no column."""
    y = np.random.default_rng(3).standard_normal((N, 1))
    given = bd.case(
        T,
        channels={"w_1": bd.Channel(y[:, 0], "rad/s", 0.1)},
        inputs={"v": bd.Input(held(np.random.default_rng(4), 50), "V")},
        parameters={**NOMINAL, "t_f": 0.0, "k_s": {"prior": "uniform", "low": 0.01, "high": 1.0}},
    )
    assert regression_start(given.job.problem.posterior) is None
