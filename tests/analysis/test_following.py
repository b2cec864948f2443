"""What a torque is said to follow is what it was made of, with its size in physical units.

Mutants killed: squares for their roots, a law that is taken though another has said it all, sizes
over the wrong speed at the motor.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from support.case_tables import run_cases

from bayesdrill.analysis.latent_torque import TorqueEstimate, regress_torque
from bayesdrill.analysis.run_analysis import torque_summary
from bayesdrill.report.sections import torque_words
from bayesdrill.rig import MotorShaft

T = np.linspace(0.0, 10.0, 2001)
W_1, W_2 = 5 * np.sin(2.0 * T) + 2 * np.sin(5.1 * T), 3 * np.cos(1.7 * T) + 1.0
V = 8 * np.sin(0.9 * T + 0.4)
RIG = MotorShaft(1 / 8)


def shaking(torque: np.ndarray, at: str = "rotor_1", noise: float = 0.01) -> TorqueEstimate:
    rng = np.random.default_rng(3)
    return TorqueEstimate(
        label="",
        at=at,
        t=T,
        draws=torque + noise * rng.standard_normal((50, len(T))),
        expected=torque,
        states={
            "w_1": W_1,
            "w_2": W_2,
            "theta_1": np.cumsum(W_1) * (T[1] - T[0]),
            "theta_2": np.cumsum(W_2) * (T[1] - T[0]),
        },
        inputs={"v": V},
        courses=(),
        rig=RIG,
    )


MADE = {
    "sign": (-0.2 * np.sign(W_1), "rotor_1", "w_1", -0.2),
    "speed": (-0.03 * 8 * W_2, "motor", "w_2", -0.03),
    "square": (-0.004 * W_1 * np.abs(W_1), "rotor_1", "w_1", -0.004),
    "turn": (0.1 * np.cos(np.cumsum(W_1) * (T[1] - T[0]) + 0.7), "rotor_1", "theta_1", 0.1),
    "input": (0.05 * V, "rotor_1", "v", 0.05),
    "constant": (np.full(len(T), 0.3), "rotor_1", "", 0.3),
    "drift": (0.02 * (T - 5.0), "rotor_1", "", 0.02),
}


@run_cases("kind", MADE)
def test_each_law_is_found_with_its_size(kind: str) -> None:
    torque, at, of, size = MADE[kind]
    found = regress_torque(shaking(torque, at))
    assert [(one.kind, one.of) for one in found if one.taken] == [(kind, of)]
    assert found[0].size == pytest.approx(size, rel=0.02)
    assert found[0].share == pytest.approx(1.0, abs=1e-6)
    assert all(one.share < 0.99 for one in found[1:])


def test_two_laws_are_found_one_after_the_other() -> None:
    torque = -0.2 * np.sign(W_1) + 0.1 + 0.02 * np.random.default_rng(1).standard_normal(len(T))
    found = [one for one in regress_torque(shaking(torque)) if one.taken]
    assert [one.kind for one in found] == ["sign", "constant"]
    assert found[0].size == pytest.approx(-0.2, rel=0.03)
    assert found[1].size == pytest.approx(0.1, rel=0.03)


def test_what_friction_does_at_rest_does_not_count_against_it() -> None:
    """There it may be anything.  Kills a law that is held against all samples."""
    rests = np.abs(np.sin(0.8 * T)) < 0.7
    held = np.where(rests, 0.15 * np.sin(3.0 * T), -0.2 * np.sign(W_1))
    still = shaking(held)
    resting = {**still.states, "w_1": np.where(rests, 1e-3 * np.cos(9.0 * T), W_1)}
    still = dataclasses.replace(still, states=resting)
    first, second, *_ = regress_torque(still)
    assert (first.kind, first.of, first.taken) == ("sign", "w_1", True)
    assert first.size == pytest.approx(-0.2, rel=0.01)
    assert first.share > 0.99
    assert not second.taken
    said = torque_words.law_sentences(torque_summary(still), RIG)
    assert f"the {100 * still.turning.mean():.0f} % of the samples in which it turns" in said
    assert still.turning.mean() == pytest.approx(np.mean(~rests), abs=0.05)


def test_what_follows_nothing_is_said_to() -> None:
    torque = 0.1 * np.sin(40.0 * T)
    found = regress_torque(shaking(torque))
    assert not any(one.taken for one in found)
    assert "follows no speed" in torque_words.law_sentences(torque_summary(shaking(torque)), RIG)
    assert regress_torque(dataclasses.replace(shaking(torque), expected=np.zeros(len(T)))) == ()


def test_the_line_of_the_config_is_said() -> None:
    torque, at, *_ = MADE["speed"]
    said = torque_words.law_sentences(torque_summary(shaking(torque, at)), RIG)
    assert "viscous damping at the motor of 0.03 N m s/rad" in said
    assert "c_m: {prior: log_uniform, low: 0.01, high: 0.09}" in said
