"""A rig that is composed: each added physics against the balances of motor, gear, shaft and rotor."""

import math

import numpy as np
import pytest
from support.case_tables import run_cases
from support.scipy_oracles import NOMINAL, skewed
from support.small_problems import STATES

import bayesdrill as bd
from bayesdrill.rig.models import linear
from bayesdrill.rig.models.linear import dynamics
from bayesdrill.rig.models.motor_shaft import OFFERS, MotorShaft
from bayesdrill.rig.simulators.sensors import ObservationModel, observed_model

I_M = 0.2
MORE = {
    "c_s": 0.013, "j_2": 7.3e-3, "r_s": 0.21, "c_1": 4.1e-3, "t_cm": 0.07, "t_sm": 0.11, "w_sm": 1.9,
    "t_c1": 0.31, "t_s1": 0.52, "w_s1": 0.43, "v_d": 0.83, "eta": 0.87,
    "d_m": 0.013, "d_1": 0.19,
}  # fmt: skip
PUSHES = ("v", "t_1", "friction_m", "friction_1", "drop")
LINEAR = [(), ("c_s",), ("j_2",), ("r_s",), ("c_1",), ("c_s", "c_1"), ("c_s", "j_2", "r_s", "c_1")]


def balances(p: dict[str, float], x: np.ndarray, push: dict[str, float]) -> np.ndarray:
    """Rates (5,) of theta_1, theta_2, w_1, w_2, i from the balances of each body by itself.

    Unknown: w_1', w_2', w_3', i' and the torque t_2 that the gearbox puts on its output.  Frictions are
    efforts against the speeds of motor and rotor, and the current.
    """
    twist, turning = x[0] - x[1], x[2] - x[3]
    w_1, w_2, i = x[2:]
    w_3 = w_2 / I_M
    shaft = p["k_s"] * twist + p.get("c_s", 0.0) * turning
    masses = np.zeros((5, 5))
    masses[0, 0] = p["j_1"]
    masses[1, 1], masses[1, 4] = p.get("j_2", 0.0), -1.0
    masses[2, 2], masses[2, 4] = p["j_m"], I_M
    masses[3, 3] = p["l_m"]
    masses[4, 1], masses[4, 2] = 1.0, -I_M
    rest = [
        -shaft - p.get("c_1", 0.0) * w_1 - push.get("t_1", 0.0) - push.get("friction_1", 0.0),
        shaft,
        p["k_T"] * i - p["c_m"] * w_3 - p["t_f"] - push.get("friction_m", 0.0),
        push.get("v", 0.0)
        - (p["r_m"] + p.get("r_s", 0.0)) * i
        - p["k_e"] * w_3
        - push.get("drop", 0.0),
        0.0,
    ]
    w_1_dot, w_2_dot, _, i_dot, _ = np.linalg.solve(masses, rest)
    return np.array([w_1, w_2, w_1_dot, w_2_dot, i_dot])


def by_hand(p: dict[str, float]) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """A (5, 5), what is constant (5,), and the column of each push."""
    still = balances(p, np.zeros(5), {})
    a = np.array([balances(p, x, {}) - still for x in np.eye(5)]).T
    return a, still, {name: balances(p, np.zeros(5), {name: 1.0}) - still for name in PUSHES}


def parameters(added: tuple[str, ...]) -> dict[str, float]:
    return skewed() | {name: MORE[name] for name in added}


@run_cases("added", [*LINEAR, tuple(OFFERS)])
def test_the_matrices_are_those_of_the_balances_of_the_bodies(added: tuple[str, ...]) -> None:
    p, rig = parameters(added), MotorShaft(I_M, added=added)
    linear = rig.linear(p)
    a, still, columns = by_hand(p)
    assert dynamics(linear, STATES, 1)[0] == pytest.approx(a, rel=1e-12)
    assert [linear.c.get(name, 0.0) for name in STATES] == pytest.approx(still, rel=1e-12)
    assert {name for _, name in linear.B} == {*rig.inputs, *(one.name for one in rig.frictions)}
    for name in {name for _, name in linear.B}:
        own = [linear.B.get((state, name), 0.0) for state in STATES]
        assert own == pytest.approx(columns[name], rel=1e-12), name


def test_frictions_have_the_laws_of_their_parameters() -> None:
    """Sizes by hand, at a speed of the shaft of 0.3 rad/s; the motor turns five times as fast."""
    every = {one.name: one for one in MotorShaft(I_M, 2, tuple(OFFERS)).frictions}
    assert list(every) == ["friction_m", "friction_1", "drop"]
    assert [one.against for one in every.values()] == ["w_2", "w_1", "i"]
    assert [one.holds for one in every.values()] == ["theta_2", "theta_1", None]
    p, seen = parameters(tuple(OFFERS)), {"theta_1": 0.9, "theta_2": 0.2}
    lost = (1 / 0.87 - 1) * I_M * p["k_s"] * 0.7
    drag = 0.013 * (0.3 / I_M) ** 2
    rubs = 0.07 + 0.04 * math.exp(-((0.3 / I_M / 1.9) ** 2))
    assert every["friction_m"].law.size(p, 0.3, seen) == pytest.approx(
        rubs + lost + drag, rel=1e-12
    )
    back = {"theta_1": 0.2, "theta_2": 0.9}
    assert every["friction_m"].law.size(p, 0.3, back) == pytest.approx(
        rubs + lost + drag, rel=1e-12
    )
    slips = 0.19 * 0.3**2 + 0.31 + 0.21 * math.exp(-((0.3 / 0.43) ** 2))
    assert every["friction_1"].law.size(p, 0.3, {}) == pytest.approx(slips, rel=1e-12)
    assert every["drop"].law.size(p, 0.3, {}) == 0.83
    (one,) = MotorShaft(I_M, added=("t_cm", "t_sm", "w_sm")).frictions
    plain = 0.07 + 0.04 * math.exp(-0.3 / I_M / 1.9)
    assert one.law.size(p, 0.3, {}) == pytest.approx(plain, rel=1e-12)
    (one,) = MotorShaft(I_M, added=("t_cm",)).frictions
    assert (one.law.steady, one.law.size(p, 0.3, {})) == (True, 0.07)
    (one,) = MotorShaft(I_M, added=("eta",)).frictions
    assert one.law.size(p, 0.3, seen) == pytest.approx(lost, rel=1e-12)
    assert not MotorShaft(I_M, added=("c_s", "j_2", "r_s", "c_1")).frictions


def test_frictions_pass_through_the_sensors_of_inputs() -> None:
    rig = MotorShaft(I_M, added=("j_2", "t_cm", "v_d"))
    behind = observed_model(
        rig, ObservationModel(input_gains={"v": "gain_v"}, input_offsets={"v": "offset_v"})
    )
    assert behind.frictions == rig.frictions
    assert (
        observed_model(MotorShaft(), ObservationModel(input_gains={"v": "gain_v"})).frictions == ()
    )
    p = parameters(("j_2", "t_cm", "v_d")) | {"gain_v": 1.1, "offset_v": 0.3}
    plain, through = rig.linear(p), behind.linear(p)
    for column in (("w_2", "friction_m"), ("i", "drop")):
        assert through.B[column] == plain.B[column]
    assert through.c["i"] == pytest.approx(0.3 / p["l_m"])


# Responses: quadratic drag, and one more inertia on a spring.

DT, N = 0.01, 200
T = DT * np.arange(N)
V = 6.0 * np.sign(np.sin(3.0 * T))


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


def test_a_drag_is_referred_through_the_gear() -> None:
    """At the motor it is that at the load times the cube of the reduction."""
    rig = MotorShaft(i_m=0.1, added=("d_m",))
    assert linear.gear_factor(rig, rig.symbols["d_m"], "load") == pytest.approx(1e-3)
