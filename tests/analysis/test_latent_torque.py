"""A missing torque: draws of it, what it moves, the law that it follows, and what it can replace."""

import csv
import dataclasses
import io
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from support.case_tables import run_cases, slow_except
from support.missing_torque_cases import SIZE, posterior_with_torque
from support.scipy_oracles import NOMINAL

import bayesdrill as bd
from bayesdrill.analysis.latent_torque import TorqueEstimate, regress_torque, torque_estimates
from bayesdrill.analysis.run_analysis import torque_summary
from bayesdrill.basics.units import Unit
from bayesdrill.report.sections.torque import (
    law_sentences,
    stand_ins,
    torque_csv,
    torque_figure,
    torque_sentence,
)
from bayesdrill.rig import MotorShaft

Array = NDArray[np.float64]

SIGMA = 0.002
TIMES = 0.02 * np.arange(301)


@cache
def estimate(at: str) -> tuple[TorqueEstimate, Array]:
    """Return that of 200 draws by the motor's speed alone, and the true torque."""
    rng = np.random.default_rng(4)
    voltage = 8.0 * np.sin(1.3 * TIMES)
    smoothness = "3/2" if at == "motor" else "1/2"
    target, theta, torque = posterior_with_torque(
        TIMES, voltage, {"w_2": SIGMA}, rng, at=at, smoothness=smoothness
    )
    (result,) = torque_estimates(target, np.repeat(theta[None], 200, axis=0), rng)
    return result, torque


@pytest.mark.parametrize("at", slow_except(("rotor_1",), ("motor", "rotor_1")))
def test_the_torque_is_estimated_within_its_band(at: str) -> None:
    """The band should hold 94 % of 301 samples; they are correlated, so 85 % are enough."""
    result, truth = estimate(at)
    low, high = result.band
    assert np.mean((truth >= low) & (truth <= high)) > 0.85
    assert np.corrcoef(result.expected, truth)[0, 1] > 0.9
    error = np.sqrt(np.mean((result.expected - truth) ** 2))
    assert error < 0.6 * SIZE
    assert error == pytest.approx(np.sqrt(np.mean(result.draws.var(axis=0))), rel=0.35)


def test_the_torque_explains_all_residuals_but_the_noise_of_the_sensors() -> None:
    result, _ = estimate("rotor_1")
    for course in result.courses:
        assert course.left == pytest.approx(SIGMA, rel=0.15)
        assert course.moved == pytest.approx(np.sqrt(course.without**2 - SIGMA**2), rel=0.1)
    assert result.states["w_1"].shape == result.t.shape
    assert result.rig.roles.inertia("motor").reduction == 0.125


def test_the_torque_is_drawn_described_and_written() -> None:
    result, _ = estimate("rotor_1")
    figure = torque_figure(result, clock=Unit("s", 1.0, "s"))
    panels = sorted(figure.axes, key=lambda panel: panel.get_position().y1)
    labels = [panel.get_xlabel() for panel in panels]
    assert labels[-1].startswith("time")
    assert any("speed of rotor 1" in label for label in labels)
    assert any("voltage" in label for label in labels)
    assert "at rotor 1" in torque_sentence(torque_summary(result), result.rig)
    text = torque_csv([result])
    rows = list(csv.DictReader(io.StringIO(text)))
    assert len(rows) == 301
    assert float(rows[7]["torque"]) == result.expected[7]
    assert torque_csv([]) is None


T = np.linspace(0.0, 10.0, 2001)
W_1, W_2 = 5 * np.sin(2.0 * T) + 2 * np.sin(5.1 * T), 3 * np.cos(1.7 * T) + 1.0
THETA_1, THETA_2 = np.cumsum(W_1) * T[1], np.cumsum(W_2) * T[1]
V = 8 * np.sin(0.9 * T + 0.4)
RIG = MotorShaft(1 / 8)


def known(torque: Array, at: str = "rotor_1") -> TorqueEstimate:
    """Return an estimate of a torque that is known almost exactly."""
    noise = 0.01 * np.random.default_rng(3).standard_normal((50, len(T)))
    states = {"w_1": W_1, "w_2": W_2, "theta_1": THETA_1, "theta_2": THETA_2}
    return TorqueEstimate(
        label="",
        location=at,
        t=T,
        draws=torque + noise,
        expected=torque,
        states=states,
        inputs={"v": V},
        courses=(),
        rig=RIG,
    )


LAWS = {
    "sign": (-0.2 * np.sign(W_1), "rotor_1", "w_1", -0.2),
    "speed": (-0.03 * 8 * W_2, "motor", "w_2", -0.03),  # over the speed of the motor
    "square": (-0.004 * W_1 * np.abs(W_1), "rotor_1", "w_1", -0.004),
    "turn": (0.1 * np.cos(THETA_1 + 0.7), "rotor_1", "theta_1", 0.1),
    "input": (0.05 * V, "rotor_1", "v", 0.05),
    "constant": (np.full(len(T), 0.3), "rotor_1", "", 0.3),
    "drift": (0.02 * (T - 5.0), "rotor_1", "", 0.02),
}


@run_cases("kind", LAWS)
def test_the_law_that_made_a_torque_is_recognised_with_its_size(kind: str) -> None:
    torque, at, of, size = LAWS[kind]
    laws = regress_torque(known(torque, at))
    assert [(law.kind, law.of) for law in laws if law.taken] == [(kind, of)]
    assert laws[0].size == pytest.approx(size, rel=0.02)
    assert laws[0].share == pytest.approx(1.0, abs=1e-6)
    assert all(law.share < 0.99 for law in laws[1:])
    if kind == "speed":
        text = law_sentences(torque_summary(known(torque, at)), RIG)
        assert "viscous damping at the motor of 0.03 N m s/rad" in text
        assert "c_m: {prior: log_uniform, low: 0.01, high: 0.09}" in text


def test_two_laws_are_recognised_one_after_the_other() -> None:
    noise = 0.02 * np.random.default_rng(1).standard_normal(len(T))
    laws = [law for law in regress_torque(known(-0.2 * np.sign(W_1) + 0.1 + noise)) if law.taken]
    assert [law.kind for law in laws] == ["sign", "constant"]
    assert [law.size for law in laws] == pytest.approx([-0.2, 0.1], rel=0.03)


def test_what_friction_does_at_rest_does_not_count_against_it() -> None:
    """There it may be anything."""
    rests = np.abs(np.sin(0.8 * T)) < 0.7
    moving = known(np.where(rests, 0.15 * np.sin(3.0 * T), -0.2 * np.sign(W_1)))
    w_1 = np.where(rests, 1e-3 * np.cos(9.0 * T), W_1)
    resting = dataclasses.replace(moving, states={**moving.states, "w_1": w_1})
    first, second, *_ = regress_torque(resting)
    assert (first.kind, first.of, first.taken) == ("sign", "w_1", True)
    assert first.size == pytest.approx(-0.2, rel=0.01)
    assert first.share > 0.99
    assert not second.taken
    text = law_sentences(torque_summary(resting), RIG)
    assert f"the {100 * resting.turning.mean():.0f} % of the samples in which it turns" in text
    assert resting.turning.mean() == pytest.approx(np.mean(~rests), abs=0.05)


def test_a_torque_that_follows_no_law_is_said_to() -> None:
    estimate = known(0.1 * np.sin(40.0 * T))
    assert not any(law.taken for law in regress_torque(estimate))
    text = law_sentences(torque_summary(estimate), RIG)
    assert "follows no speed" in text
    assert regress_torque(dataclasses.replace(estimate, expected=np.zeros(len(T)))) == ()


def test_identify_says_what_a_missing_torque_can_replace_and_what_would_help() -> None:
    """A torque at rotor 1 can replace the rotor's if the speed at the gearbox alone is measured."""
    t = 0.01 * np.arange(1001)
    volts = 6 * np.sin(0.5 * np.pi * t) + 4 * np.sin(1.24 * np.pi * t + 0.5)
    w_2 = bd.respond("motor_shaft", {**NOMINAL, "t_f": 0.0}, t, {"v": volts}, "w_2")["w_2"]
    box = {"prior": "uniform", "low": 0.5, "high": 1.5, "relative": True}
    free = dict.fromkeys(("j_m", "k_e", "k_s", "j_1"), box)
    time = {"prior": "log_uniform", "low": 0.01, "high": 10}
    identified = bd.case(
        t,
        {"w_2": bd.Channel(w_2, "rad/s", 0.1)},
        {"v": bd.Input(volts, "V")},
        {**dict.fromkeys(NOMINAL, "nominal"), **free, "t_f": 0.0},
        nominal="tables_2_3",
        missing_torque={"at": "rotor_1", "smoothness": "1/2", "size": 1, "time": time},
    ).identify()
    study = identified.study
    assert [stand_in.name for stand_in in study.stand_ins] == ["k_s", "j_1"]
    first = study.stand_ins[0]
    assert first.sd > 0.1
    assert first.alone < 0.02
    helps = {(way.kind, way.name) for way in first.helps}
    assert helps >= {("measure", "w_1"), ("hold", "j_1")}
    sentences = stand_ins(study, identified.job.problem.model)
    assert "at rotor 1 it can stand in for k_s" in sentences
    assert "a sensor of w_1" in sentences
