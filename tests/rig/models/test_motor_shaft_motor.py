"""A motor alone: against closed forms and matrix exponentials typed in here, and the paper's rig."""

import numpy as np
import pytest
from scipy.linalg import expm
from support.scipy_oracles import NOMINAL
from support.small_problems import experiment

from bayesdrill.record.experiment import Experiment
from bayesdrill.rig.models.linear import dynamics, with_named
from bayesdrill.rig.models.motor_shaft import Motor, MotorShaft
from bayesdrill.rig.simulators import simulator
from bayesdrill.rig.simulators.sensors import ObservationModel

P = {"j_m": 1.4e-4, "c_m": 9.3e-5, "t_f": 0.037}
CIRCUIT = {"k_e": 0.061, "k_T": 0.057, "r_m": 0.41, "l_m": 9e-4}
DT, N = 0.02, 250
T = DT * np.arange(N)
TORQUE = np.where(T < 2.0, 0.05, 0.065)


def motor(i_m: float = 1.0, **values: float) -> tuple[Motor, np.ndarray]:
    rig = with_named(Motor(i_m), values)
    return rig, np.array([[values[name] for name in rig.parameters]])


def driven(rig: Motor, **inputs: float | np.ndarray) -> Experiment:
    constant = {name: u for name, u in inputs.items() if np.ndim(u) == 0}
    series = {name: u for name, u in inputs.items() if np.ndim(u)}
    measures = {name: {name: 1.0} for name in rig.states}
    start = {"theta_2": 0.7, "w_2": 12.0}
    return experiment(N, DT, constant=constant, series=series, start=start, measures=measures)


def test_a_torque_brings_the_motor_to_speed_as_an_exponential() -> None:
    """Speeds and angles in closed form, before and after a step of the torque, behind a gear of 4:1.

    Mutants killed: the torque not seen through the gear, friction that helps.
    """
    i_m = 0.25
    rig, theta = motor(i_m, **P)
    found = simulator(rig, driven(rig, t_m=TORQUE), ObservationModel()).signals(theta)[0]
    decay, before = P["c_m"] / P["j_m"], T < 2.0

    def course(t: np.ndarray, torque: float, begin: tuple[float, float]) -> np.ndarray:
        end = i_m * (torque - P["t_f"]) / P["c_m"]
        left = (begin[1] - end) * np.exp(-decay * t)
        angle = begin[0] + end * t + (begin[1] - end) * (1 - np.exp(-decay * t)) / decay
        return np.column_stack([angle, end + left])

    first = course(T[before], 0.05, (0.7, 12.0))
    at_step = course(np.array([2.0]), 0.05, (0.7, 12.0))[0]
    then = course(T[~before] - 2.0, 0.065, (at_step[0], at_step[1]))
    assert found == pytest.approx(np.vstack([first, then]), rel=1e-10)


def test_a_voltage_drives_the_motor_through_its_circuit() -> None:
    """Mutants killed: the gear twice in the current, the resistance in series left out."""
    i_m, r_s, j_2 = 0.2, 0.13, 3e-3
    rig, theta = motor(i_m, **P, **CIRCUIT, r_s=r_s, j_2=j_2)
    assert rig.inputs == ("v",)
    j = P["j_m"] + i_m**2 * j_2
    k_e, k_T, r_m, l_m = CIRCUIT.values()
    a = np.zeros((4, 4))
    a[0, 1] = 1.0
    a[1, 1:] = -P["c_m"] / j, i_m * k_T / j, -i_m * P["t_f"] / j
    a[2, 1:] = -k_e / i_m / l_m, -(r_m + r_s) / l_m, 9.0 / l_m
    start = np.array([0.7, 12.0, 0.0, 1.0])
    exact = np.array([(expm(a * t) @ start)[:3] for t in T])
    found = simulator(rig, driven(rig, v=9.0), ObservationModel()).signals(theta)[0]
    assert found == pytest.approx(exact, rel=1e-9, abs=1e-9)


def test_the_motor_is_the_papers_rig_without_shaft_and_rotor() -> None:
    """And with both it is that rig.  Mutants killed: a shaft at the wrong side of the gear; a rotor
    without the twist.
    """
    alone, whole = with_named(Motor(1 / 8), {*NOMINAL} - {"k_s", "j_1"}), MotorShaft()
    full = with_named(Motor(1 / 8), NOMINAL)
    for rig, states, k_s in ((alone, alone.states, 1e-300), (full, whole.states, NOMINAL["k_s"])):
        own, at = ([x.states.index(name) for name in states] for x in (rig, whole))
        linear, paper = rig.linear(NOMINAL), whole.linear(NOMINAL | {"k_s": k_s})
        expected = dynamics(paper, whole.states, 1)[0][np.ix_(at, at)]
        assert dynamics(linear, rig.states, 1)[0][np.ix_(own, own)] == pytest.approx(
            expected, rel=1e-12
        )
        assert linear.c == paper.c
    assert dict(alone.linear(NOMINAL).B) == {("i", "v"): whole.linear(NOMINAL).B["i", "v"]}
