"""Further physics of the house's rigs: quadratic drag, and one more inertia on a spring."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from support.scipy_oracles import NOMINAL

import bayesdrill as bd
from bayesdrill.rig import MotorShaft
from bayesdrill.rig.models.linear import gear_factor
from bayesdrill.rig.models.motor_shaft import DrivenShaft, Motor

DT, N = 0.01, 200
T = DT * np.arange(N)
V = 6.0 * np.sign(np.sin(3.0 * T))


def test_quadratic_drag_is_that_of_an_integration_by_other_code() -> None:
    """Mutants killed: a drag that drives, one that is linear, the speed behind the gear at the motor."""
    i_m, p = 1 / 8, {**NOMINAL, "t_f": 0.0, "d_1": 0.02, "d_m": 2e-6}
    moved = bd.respond("motor_shaft", p, T, {"v": V}, ["w_1", "w_2"])

    def rates(_: float, x: np.ndarray, v: float) -> list[float]:
        theta_1, theta_2, w_1, w_2, i = x
        drag_1, drag_m = p["d_1"] * abs(w_1) * w_1, p["d_m"] * abs(w_2 / i_m) * w_2 / i_m
        twist = theta_1 - theta_2
        return [
            w_1,
            w_2,
            (-p["k_s"] * twist - drag_1) / p["j_1"],
            (i_m**2 * p["k_s"] * twist - p["c_m"] * w_2 + i_m * (p["k_T"] * i - drag_m)) / p["j_m"],
            (v - p["r_m"] * i - p["k_e"] * w_2 / i_m) / p["l_m"],
        ]

    x, found = np.zeros(5), []
    for v in V:
        found.append(x[2:4])
        step = solve_ivp(rates, (0.0, DT), x, args=(v,), rtol=1e-9, atol=1e-9, method="LSODA")
        x = step.y[:, -1]
    w_1, w_2 = np.array(found).T
    plain = bd.respond("motor_shaft", {**NOMINAL, "t_f": 0.0}, T, {"v": V}, ["w_1"])["w_1"]
    assert np.abs(moved["w_1"] - plain).max() > 0.5
    np.testing.assert_allclose(moved["w_1"], w_1, atol=2e-5 * np.ptp(w_1))
    np.testing.assert_allclose(moved["w_2"], w_2, atol=2e-5 * np.ptp(w_2))


def test_a_rotor_beyond_rotor_1_is_that_of_a_train() -> None:
    beyond = {"j_0": 0.005, "k_0": 0.3, "c_0": 1e-3}
    moved = bd.respond("motor_shaft", NOMINAL | beyond, T, {"v": V}, ["w_1", "w_2", "w_0"])
    train = bd.Train(
        inertias=("m", "r", "e"),
        shafts={"s": ["m", "r"], "x": ["r", "e"]},
        drives={"m": "voltage"},
        added=("c_m", "t_f_m", "k_e_m", "l_m", "c_x"),
    )
    i_m, p = 1 / 8, NOMINAL
    behind = {  # all of it as it is behind the gear
        "j_m": p["j_m"] / i_m**2,
        "c_m": p["c_m"] / i_m**2,
        "t_f_m": p["t_f"] / i_m,
        "k_T_m": p["k_T"] / i_m,
        "k_e_m": p["k_e"] / i_m,
        "r_m": p["r_m"],
        "l_m": p["l_m"],
    }
    far = {"j_r": p["j_1"], "k_s": p["k_s"], "j_e": 0.005, "k_x": 0.3, "c_x": 1e-3}
    same = bd.respond(train, behind | far, T, {"u_m": V}, ["w_r", "w_m", "w_e"])
    for ours, theirs in zip(("w_1", "w_2", "w_0"), same, strict=True):
        np.testing.assert_allclose(moved[ours], same[theirs], atol=1e-7)


def test_states_come_with_what_is_added() -> None:
    plain = ("theta_1", "theta_2", "w_1", "w_2", "i")
    assert MotorShaft.states == MotorShaft().states == plain
    assert MotorShaft(added=("k_0", "j_0")).states == (*plain, "theta_0", "w_0")
    assert MotorShaft(added=("k_0",)).states == plain
    assert "theta_0" in DrivenShaft(added=("k_0", "j_0")).states
    assert Motor().states == ("theta_2", "w_2")


def test_a_drag_is_referred_through_the_gear() -> None:
    """At the motor it is that at the load times the cube of the reduction."""
    rig = MotorShaft(i_m=0.1, added=("d_m",))
    assert gear_factor(rig, rig.symbols["d_m"], "load") == pytest.approx(1e-3)
