"""A shaft that is moved from above: against SciPy's solver on equations typed in here."""

import itertools
from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from support.small_problems import experiment

from bayesdrill.record import anomalies
from bayesdrill.record.experiment import Experiment
from bayesdrill.rig.models.linear import with_named
from bayesdrill.rig.models.motor_shaft import DrivenShaft
from bayesdrill.rig.simulators import simulator
from bayesdrill.rig.simulators.sensors import ObservationModel

P = {"k_s": 4.3, "j_1": 8.1e-3, "c_s": 0.021, "c_1": 0.034}
ROCK = {"b_0": 2.1e-3, "b_1": 1.7, "b_2": 5.5, "b_3": 3.9}
DT, N = 0.004, 300
T = 2.0 + DT * np.arange(N)
SPEED = 9.0 + 4.0 * np.sin(17.0 * T) + np.cos(5.0 * T) ** 3
LOAD = 1.8 + 0.9 * np.sin(18.3 * T + 0.4) + 0.2 * np.sin(61.0 * T)
WEIGHT = 560.0 + 80.0 * np.sin(18.0 * T + 1.1)
START = {"theta_1": -0.31, "theta_2": 0.12, "w_1": 7.5}
EACH = {name: {name: 1.0} for name in ("theta_1", "theta_2", "w_1")} | {
    "twist": {"theta_1": 1.0, "theta_2": -1.0}
}

type Course = Callable[[float, float], tuple[float, ...]]


def measured(*, first_order: bool = False, **series: np.ndarray) -> Experiment:
    return experiment(
        N, DT, first=2.0, t_start=2.0, constant={}, series=series, first_order=first_order,
        start=START, measures=EACH,
    )  # fmt: skip


def shaft(**more: float) -> tuple[DrivenShaft, np.ndarray]:
    values = P | more
    rig = with_named(DrivenShaft(), values)
    return rig, np.array([[values[name] for name in rig.parameters]])


def solved(inputs: Course, torque: Callable[[float, float], float] | None = None) -> np.ndarray:
    """States `(N, 3)`; `inputs(s, middle)`: speed and load, smooth within an interval of samples."""

    def rate(s: float, x: np.ndarray, middle: float) -> list[float]:
        speed, load, *weight = inputs(s, middle)
        theta_1, theta_2, w_1 = x
        pull = P["k_s"] * (theta_2 - theta_1) + P["c_s"] * (speed - w_1) - P["c_1"] * w_1
        rock = torque(w_1, weight[0]) if torque else 0.0
        return [w_1, speed, (pull - load - rock) / P["j_1"]]

    out = [np.array([START[name] for name in ("theta_1", "theta_2", "w_1")])]
    for begin, end in itertools.pairwise(T):
        middle = (0.5 * (begin + end),)
        there = solve_ivp(rate, (begin, end), out[-1], rtol=1e-10, atol=1e-12, args=middle)
        out.append(there.y[:, -1])
    return np.array(out)


def held(u: np.ndarray, middle: float) -> float:
    return float(u[np.searchsorted(T, middle) - 1])


def both(found: np.ndarray) -> np.ndarray:
    """With the twist."""
    return np.column_stack([found, found[:, 0] - found[:, 1]])


def test_measured_speed_and_torque_move_the_shaft_as_the_equations_say() -> None:
    """Mutants killed: the damping of the shaft against rotor 1 alone, its damping taken for c_1."""
    rig, theta = shaft()
    straight = solved(lambda s, _: (np.interp(s, T, SPEED), np.interp(s, T, LOAD)))
    one = measured(first_order=True, w_2=SPEED, t_1=LOAD)
    found = simulator(rig, one, ObservationModel()).signals(theta)[0]
    assert found == pytest.approx(both(straight), abs=2e-8)
    stays = solved(lambda _, middle: (held(SPEED, middle), held(LOAD, middle)))
    one = measured(w_2=SPEED, t_1=LOAD)
    found = simulator(rig, one, ObservationModel()).signals(theta)[0]
    assert found == pytest.approx(both(stays), abs=2e-8)
    assert np.abs(stays - straight).max() > 0.05


def test_an_angle_straight_between_samples_is_a_speed_that_is_held() -> None:
    """The top at an angle that SciPy interpolates, rotor 1 by Newton's law alone."""
    angle = START["theta_2"] + np.concatenate([[0.0], np.cumsum(np.diff(T) * SPEED[:-1] ** 1.1)])
    steps = np.diff(angle) / DT

    def rate(s: float, x: np.ndarray, middle: float) -> list[float]:
        speed = steps[np.searchsorted(T, middle) - 1]
        pull = P["k_s"] * (np.interp(s, T, angle) - x[0]) + P["c_s"] * (speed - x[1])
        return [x[1], (pull - P["c_1"] * x[1] - np.interp(middle, T, LOAD)) / P["j_1"]]

    out = [np.array([START["theta_1"], START["w_1"]])]
    for begin, end in itertools.pairwise(T):
        middle = (0.5 * (begin + end),)
        there = solve_ivp(rate, (begin, end), out[-1], rtol=1e-10, atol=1e-12, args=middle)
        out.append(there.y[:, -1])
    rig, theta = shaft()
    load = np.interp(T + 0.5 * DT, T, LOAD)
    one = measured(w_2=anomalies.held_speeds(angle, T), t_1=load)
    found = simulator(rig, one, ObservationModel()).signals(theta)[0]
    assert found[:, [0, 2]] == pytest.approx(np.array(out), abs=2e-8)
    assert found[:, 1] == pytest.approx(angle, rel=1e-12)


def test_rock_holds_the_bit_as_its_law_and_the_weight_say() -> None:
    """Mutants killed: the weight left out, the law of the size without the sign of the speed."""

    def torque(w_1: float, weight: float) -> float:
        b_0, b_1, b_2, b_3 = ROCK.values()
        return weight * b_0 * (np.tanh(b_1 * w_1) + b_2 * w_1 / (1 + b_3 * w_1**2))

    every = (3.0 * (SPEED - 9.0), 0.1 * LOAD, 0.3 * WEIGHT)
    exact = solved(lambda s, _: tuple(np.interp(s, T, u) for u in every), torque)
    assert exact[:, 2].min() < -1.0 < 1.0 < exact[:, 2].max()
    rig, theta = shaft(**ROCK)
    assert rig.inputs == ("w_2", "t_1", "wob")
    one = measured(first_order=True, **dict(zip(rig.inputs, every, strict=True)))
    apart = [
        np.abs(
            simulator(rig, one, ObservationModel(), pieces).signals(theta)[0] - both(exact)
        ).max()
        for pieces in (2, 4, 8)
    ]
    assert apart[2] < 5e-3
    assert apart[0] > 3 * apart[1] > 9 * apart[2]


def test_a_driven_shaft_without_rock_has_no_input_of_weight() -> None:
    assert shaft()[0].inputs == ("w_2", "t_1")
    assert DrivenShaft().parameters == ("k_s", "j_1")
