"""A shaft with an inertia of its own: against the exact wave equation, and the rig without it."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from support.scipy_oracles import NOMINAL
from support.small_problems import experiment

from bayesdrill.rig.models.linear import dynamics, with_named
from bayesdrill.rig.models.long_shaft import LongShaft
from bayesdrill.rig.models.motor_shaft import MotorShaft
from bayesdrill.rig.simulators import simulator
from bayesdrill.rig.simulators.sensors import ObservationModel

# The paper's shaft: steel, 2.4 m of 3 mm.
LENGTH, DIAMETER, MODULUS, DENSITY = 2.4, 3e-3, 80e9, 7850.0
POLAR = np.pi * DIAMETER**4 / 32
SHAFT = {"k_s": MODULUS * POLAR / LENGTH, "j_s": DENSITY * POLAR * LENGTH}
PAPER = NOMINAL | SHAFT
I_M = 1 / 8


def frequencies(rig: LongShaft | MotorShaft, p: dict[str, float]) -> np.ndarray:
    """Of all that oscillates, Hz, the slowest first."""
    poles = np.linalg.eigvals(dynamics(rig.linear(p), rig.states, 1)[0])
    swings = poles.imag > 1e-3 * np.maximum(np.abs(poles), 1.0)  # and does not turn as a whole
    return np.sort(poles.imag[swings]) / (2 * np.pi)


def exact(p: dict[str, float], count: int) -> np.ndarray:
    """Of j_s theta_tt = k_s L^2 theta_xx between discs of j_1 and j_m/i_m^2, Hz.

    With b = omega sqrt(j_s/k_s), and the discs over j_s: sin b (1 - b^2 m n) + b (m + n) cos b = 0.
    """
    m, n = p["j_1"] / p["j_s"], p["j_m"] / I_M**2 / p["j_s"]

    def left(b: float) -> float:
        return float(np.sin(b) * (1 - b**2 * m * n) + b * (m + n) * np.cos(b))

    tried = np.geomspace(1e-4, count * np.pi, 5000)
    turns = np.flatnonzero(np.diff(np.sign([left(b) for b in tried])))[:count]
    b = np.array([brentq(left, tried[k], tried[k + 1], xtol=1e-16, rtol=1e-14) for k in turns])
    return b * np.sqrt(p["k_s"] / p["j_s"]) / (2 * np.pi)


def test_the_error_of_frequencies_falls_as_the_square_of_the_number_of_elements() -> None:
    """Of a shaft that is as heavy as its ends.  Mutants killed: a share of the ends at the wrong node, a
    spring of a piece as soft as the whole shaft.
    """
    without_brake = {"c_m": 0.0, "k_T": 1e-30, "k_e": 1e-30}
    heavy = PAPER | without_brake | {"j_s": 0.02, "j_1": 0.015}
    true = exact(heavy, 3)
    off = {n: np.abs(frequencies(LongShaft(elements=n), heavy)[:2] / true[:2] - 1) for n in (2, 4)}
    assert (off[4] < 0.05).all()
    assert off[2] / off[4] == pytest.approx(4.0, rel=0.15)
    damped = with_named(LongShaft(elements=4), ("c_s",))
    p = heavy | {"c_s": 0.02 * heavy["k_s"]}
    found = np.linalg.eigvals(dynamics(damped.linear(p), damped.states, 1)[0])
    # Damping that goes with stiffness: x'' + 0.02 w^2 x' + w^2 x, mode by mode.
    for f in frequencies(LongShaft(elements=4), heavy):
        w2 = (2 * np.pi * f) ** 2
        for root in np.roots([1.0, 0.02 * w2, w2]):
            assert np.abs(found - root).min() < 1e-6 * abs(root)


def test_all_nodes_move_as_discs_on_springs() -> None:
    """All nodes typed in as discs on springs; friction, damping, a load, and a start that is twisted."""
    n, p = 3, {**PAPER, "j_s": 0.012, "c_s": 0.004, "c_1": 0.003, "j_2": 2e-3, "t_f": 0.03}
    rig = with_named(LongShaft(elements=n), p)
    k, c, j = n * p["k_s"], n * p["c_s"], p["j_s"] / n

    def rate(_: float, x: np.ndarray) -> np.ndarray:
        theta, w, i = x[: n + 1], x[n + 1 : 2 * n + 2], x[-1]  # from the gearbox to rotor 1
        passed = k * np.diff(theta) + c * np.diff(w)
        w_ = np.zeros(n + 1)
        w_[1:n] = np.diff(passed) / j
        w_[n] = (-passed[-1] - p["c_1"] * w[n] - 0.04) / (p["j_1"] + j / 2)
        torque = p["k_T"] * i - p["c_m"] * w[0] / I_M - p["t_f"]
        w_[0] = (torque / I_M + passed[0]) / (p["j_m"] / I_M**2 + p["j_2"] + j / 2)
        return np.array([*w, *w_, (8.0 - p["r_m"] * i - p["k_e"] * w[0] / I_M) / p["l_m"]])

    start = {"theta_1": 0.9, "theta_2": -0.3, "w_1": 2.0, "w_2": 5.0}
    along = np.linspace(0.0, 1.0, n + 1)
    theta, w = -0.3 + 1.2 * along, 5.0 - 3.0 * along
    t = 0.01 * np.arange(150)
    solved = solve_ivp(rate, (0, t[-1]), [*theta, *w, 0.0], "LSODA", t, rtol=1e-10, atol=1e-12).y
    measures = {name: {name: 1.0} for name in rig.states}
    one = experiment(150, 0.01, constant={"v": 8.0, "t_1": 0.04}, start=start, measures=measures)
    full = np.array([[p[name] for name in rig.parameters]])
    found = dict(
        zip(rig.states, simulator(rig, one, ObservationModel()).signals(full)[0].T, strict=True)
    )
    assert found["theta_2"] == pytest.approx(solved[0], abs=1e-6)
    assert found["theta_1"] == pytest.approx(solved[n], abs=1e-6)
    assert found["w_2"] == pytest.approx(solved[n + 1], abs=1e-5)
    assert found["w_1"] == pytest.approx(solved[2 * n + 1], abs=1e-5)
    assert found["i"] == pytest.approx(solved[-1], abs=1e-5)
    for node in (1, 2):
        straight = (1 - node / n) * solved[0] + node / n * solved[n]
        assert found[f"phi_{node}"] == pytest.approx(solved[node] - straight, abs=1e-6)


def test_a_shaft_of_one_element_makes_only_its_ends_heavier() -> None:
    half = PAPER | {"j_1": PAPER["j_1"] + 0.006, "j_m": PAPER["j_m"] + I_M**2 * 0.006}
    rig = LongShaft(elements=1)
    assert rig.states == MotorShaft.states
    found = rig.linear(PAPER | {"j_s": 0.012})
    assert found == MotorShaft().linear({name: half[name] for name in MotorShaft.parameters})
