"""Composed rigs, motors and driven shafts against balances of their bodies, closed forms and SciPy."""

import itertools
import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from support.case_tables import run_cases
from support.scipy_oracles import NOMINAL, skewed
from support.small_problems import STATES, experiment

import bayesdrill as bd
from bayesdrill.record import anomalies
from bayesdrill.record.experiment import Experiment
from bayesdrill.rig.models import linear
from bayesdrill.rig.models.linear import constant_forcing, dynamics, with_named
from bayesdrill.rig.models.motor_shaft import OFFERS, DrivenShaft, Motor, MotorShaft
from bayesdrill.rig.simulators import simulator
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


def test_a_rotor_beyond_rotor_1_is_that_of_a_train() -> None:
    """Both rigs have the same equations."""
    p = NOMINAL | {"j_0": 0.005, "k_0": 0.3, "c_0": 1e-3}
    train = bd.Train(
        inertias=("m", "r", "e"),
        shafts={"s": ["m", "r"], "x": ["r", "e"]},
        drives={"m": "voltage"},
        added=("c_m", "t_f_m", "k_e_m", "l_m", "c_x"),
    )
    i_m = 1 / 8
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
    alike = {
        "theta_1": "theta_r", "theta_2": "theta_m", "theta_0": "theta_e",
        "w_1": "w_r", "w_2": "w_m", "w_0": "w_e", "i": "i_m",
    }  # fmt: skip
    ours, theirs = with_named(MotorShaft(), p).linear(p), train.linear(behind | far)
    expected = dynamics(theirs, (*alike.values(),), 1)[0]
    assert dynamics(ours, (*alike,), 1)[0] == pytest.approx(expected, rel=1e-12)
    forcing = constant_forcing(theirs, (*alike.values(),), 1, {"u_m": 8.0})
    assert constant_forcing(ours, (*alike,), 1, {"v": 8.0}) == pytest.approx(forcing, rel=1e-12)


def test_a_drag_is_referred_through_the_gear() -> None:
    """At the motor it is that at the load times the cube of the reduction."""
    rig = MotorShaft(i_m=0.1, added=("d_m",))
    assert linear.gear_factor(rig, rig.symbols["d_m"], "load") == pytest.approx(1e-3)


# A motor alone.


def test_a_torque_moves_the_motor_through_its_gear() -> None:
    """The oracle is the equation of motion behind a gear of 4:1, derived by hand.

    Mutants killed: the torque not seen through the gear, friction that helps.
    """
    p = {"j_m": 1.4e-4, "c_m": 9.3e-5, "t_f": 0.037}
    linear = with_named(Motor(i_m=0.25), p).linear(p)
    turns, decays = ("theta_2", "w_2"), ("w_2", "w_2")
    assert dict(linear.A) == {turns: 1.0, decays: pytest.approx(-p["c_m"] / p["j_m"])}
    assert dict(linear.B) == {("w_2", "t_m"): pytest.approx(0.25 / p["j_m"])}
    assert dict(linear.c) == {"w_2": pytest.approx(-0.25 * p["t_f"] / p["j_m"])}


def test_the_motor_is_the_papers_rig_without_shaft_and_rotor() -> None:
    """And with both it is that rig.  Mutants killed: a shaft at the wrong side of the gear; a rotor
    without the twist.
    """
    p, whole = parameters(("j_2", "r_s")), MotorShaft(added=("j_2", "r_s"))
    alone, full = with_named(Motor(1 / 8), {*p} - {"k_s", "j_1"}), with_named(Motor(1 / 8), p)
    for rig, states, k_s in ((alone, alone.states, 1e-300), (full, whole.states, p["k_s"])):
        own, at = ([x.states.index(name) for name in states] for x in (rig, whole))
        linear, paper = rig.linear(p), whole.linear(p | {"k_s": k_s})
        expected = dynamics(paper, whole.states, 1)[0][np.ix_(at, at)]
        assert dynamics(linear, rig.states, 1)[0][np.ix_(own, own)] == pytest.approx(
            expected, rel=1e-12
        )
        assert linear.c == paper.c
    assert dict(alone.linear(p).B) == {("i", "v"): whole.linear(p).B["i", "v"]}


# A shaft that is moved from above: SciPy's solver.

SHAFT = {"k_s": 4.3, "j_1": 8.1e-3, "c_s": 0.021, "c_1": 0.034}
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


def recorded(*, first_order: bool = False, **series: np.ndarray) -> Experiment:
    return experiment(
        N, DT, first=2.0, t_start=2.0, constant={}, series=series, first_order=first_order,
        start=START, measures=EACH,
    )  # fmt: skip


def shaft(**more: float) -> tuple[DrivenShaft, np.ndarray]:
    values = SHAFT | more
    rig = with_named(DrivenShaft(), values)
    return rig, np.array([[values[name] for name in rig.parameters]])


def integrated(rate: Callable[..., list[float]], states: tuple[str, ...]) -> np.ndarray:
    """Integrate `rate(time, x, middle of the interval)` from sample to sample by SciPy."""
    out = [np.array([START[name] for name in states])]
    for begin, end in itertools.pairwise(T):
        middle = (0.5 * (begin + end),)
        there = solve_ivp(rate, (begin, end), out[-1], rtol=1e-10, atol=1e-12, args=middle)
        out.append(there.y[:, -1])
    return np.array(out)


def solved(inputs: Course, torque: Callable[[float, float], float] | None = None) -> np.ndarray:
    """States `(N, 3)`; `inputs(s, middle)`: speed and load, smooth within an interval of samples."""

    def rate(s: float, x: np.ndarray, middle: float) -> list[float]:
        speed, load, *weight = inputs(s, middle)
        theta_1, theta_2, w_1 = x
        pull = (
            SHAFT["k_s"] * (theta_2 - theta_1) + SHAFT["c_s"] * (speed - w_1) - SHAFT["c_1"] * w_1
        )
        rock = torque(w_1, weight[0]) if torque else 0.0
        return [w_1, speed, (pull - load - rock) / SHAFT["j_1"]]

    return integrated(rate, ("theta_1", "theta_2", "w_1"))


def value_before(u: np.ndarray, time: float) -> float:
    return float(u[np.searchsorted(T, time) - 1])


def with_twist(found: np.ndarray) -> np.ndarray:
    """Return the two angles `(T, 2)` with their difference, the twist, as a third column."""
    return np.column_stack([found, found[:, 0] - found[:, 1]])


def test_measured_speed_and_torque_move_the_shaft_as_the_equations_say() -> None:
    """Mutants killed: the damping of the shaft against rotor 1 alone, its damping taken for c_1."""
    rig, theta = shaft()
    straight = solved(lambda s, _: (np.interp(s, T, SPEED), np.interp(s, T, LOAD)))
    one = recorded(first_order=True, w_2=SPEED, t_1=LOAD)
    found = simulator(rig, one, ObservationModel()).signals(theta)[0]
    assert found == pytest.approx(with_twist(straight), abs=2e-8)
    stays = solved(lambda _, middle: (value_before(SPEED, middle), value_before(LOAD, middle)))
    one = recorded(w_2=SPEED, t_1=LOAD)
    found = simulator(rig, one, ObservationModel()).signals(theta)[0]
    assert found == pytest.approx(with_twist(stays), abs=2e-8)
    assert np.abs(stays - straight).max() > 0.05


def test_an_angle_straight_between_samples_is_a_speed_that_is_held() -> None:
    """The top at an angle that SciPy interpolates, rotor 1 by Newton's law alone."""
    angle = START["theta_2"] + np.concatenate([[0.0], np.cumsum(np.diff(T) * SPEED[:-1] ** 1.1)])
    steps = np.diff(angle) / DT

    def rate(s: float, x: np.ndarray, middle: float) -> list[float]:
        speed = steps[np.searchsorted(T, middle) - 1]
        pull = SHAFT["k_s"] * (np.interp(s, T, angle) - x[0]) + SHAFT["c_s"] * (speed - x[1])
        return [x[1], (pull - SHAFT["c_1"] * x[1] - np.interp(middle, T, LOAD)) / SHAFT["j_1"]]

    solution = integrated(rate, ("theta_1", "w_1"))
    rig, theta = shaft()
    load = np.interp(T + 0.5 * DT, T, LOAD)
    one = recorded(w_2=anomalies.held_speeds(angle, T), t_1=load)
    found = simulator(rig, one, ObservationModel()).signals(theta)[0]
    assert found[:, [0, 2]] == pytest.approx(solution, abs=2e-8)
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
    one = recorded(first_order=True, **dict(zip(rig.inputs, every, strict=True)))
    apart = [
        np.abs(
            simulator(rig, one, ObservationModel(), pieces).signals(theta)[0] - with_twist(exact)
        ).max()
        for pieces in (2, 4, 8)
    ]
    assert apart[2] < 5e-3
    assert apart[0] > 3 * apart[1] > 9 * apart[2]
