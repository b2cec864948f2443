"""The rig with a second rotor, constants of rigs, and what a rig has no value for."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import scipy.integrate
from oracles import NOMINAL, skewed
from rigs import STATES, Held, experiment, vector
from together import for_each

from bayesdrill.basics.errors import InputError
from bayesdrill.config import loading
from bayesdrill.inference import derived
from bayesdrill.rig.models.linear import Linear, Model, constant_forcing, dynamics
from bayesdrill.rig.models.motor_shaft import MotorShaft, TwoRotors
from bayesdrill.rig.simulators.exact import Response

ROOT = Path(__file__).parents[2]
I_M, J_2, R_S = 0.2, 7.3e-3, 0.21


def test_poles_of_a_rig_that_its_angles_hold_are_all_of_them() -> None:
    """Mutant killed: a zero pole is taken out that is not there."""
    linear = Held().linear(NOMINAL)
    found = derived.poles(Held(), linear, 1)
    every = np.linalg.eigvals(dynamics(linear, STATES, 1)[0])
    pairs = every[every.imag > 0]
    least = pairs[np.argmin(-pairs.real / abs(pairs))]
    assert found["omega_n"][0] == pytest.approx(abs(least), rel=1e-9)
    assert found["zeta"][0] == pytest.approx(-least.real / abs(least), rel=1e-6)
    assert found["tau_e"][0] == pytest.approx(-1 / every.real.min(), rel=1e-9)
    assert np.isnan(found["tau_m"][0])  # the motor's speed has no pole of its own here


def test_a_rig_without_an_end_has_no_end() -> None:
    """Held by neither angle nor friction in one state: NaN, and no error."""
    a = {("theta_1", "w_1"): 1.0, ("w_1", "theta_1"): -1.0, ("theta_2", "w_2"): 1.0}
    linear = Linear(A={**a, ("i", "i"): -1.0}, B={}, c={"w_2": 1.0})
    found = derived.steady_values(MotorShaft(), linear, 2, {})
    assert np.isnan(found["w_end"]).all()
    assert np.isnan(found["i_end"]).all()


def balances(p: dict[str, float], x: np.ndarray, v: float, t_1: float) -> np.ndarray:
    """Rates (5,) of theta_1, theta_2, w_1, w_2, i from the balances of each body by itself.

    Unknown: w_1', w_2', w_3', i' and the torque t_2 that the gearbox puts on its output.
    """
    twist, w_1, w_2, i = x[0] - x[1], x[2], x[3], x[4]
    w_3 = w_2 / I_M
    masses = np.zeros((5, 5))
    masses[0, 0] = p["j_1"]
    masses[1, 1], masses[1, 4] = J_2, -1.0
    masses[2, 2], masses[2, 4] = p["j_m"], I_M
    masses[3, 3] = p["l_m"]
    masses[4, 1], masses[4, 2] = 1.0, -I_M
    rest = [
        -p["k_s"] * twist - t_1,
        p["k_s"] * twist,
        p["k_T"] * i - p["c_m"] * w_3 - p["t_f"],
        v - (p["r_m"] + R_S) * i - p["k_e"] * w_3,
        0.0,
    ]
    w_1_dot, w_2_dot, _, i_dot, _ = np.linalg.solve(masses, rest)
    return np.array([w_1, w_2, w_1_dot, w_2_dot, i_dot])


def test_two_rotors_against_radau_on_the_balances_of_each_body() -> None:
    """Mutants killed: i_m once or not at all at j_2; r_s left out."""
    p = skewed()
    start = {"theta_1": 0.7, "theta_2": -0.4, "w_1": 1.3, "w_2": -2.1, "i": 0.6}
    x0 = np.array([start[name] for name in STATES])
    record = experiment(101, 0.03, constant={"v": 5.5, "t_1": 0.03}, start=start)
    solved = scipy.integrate.solve_ivp(
        lambda _, x: balances(p, x, 5.5, 0.03),
        (0.0, record.t[-1]),
        x0,
        method="Radau",
        t_eval=record.t,
        rtol=1e-10,
        atol=1e-12,
        jac=np.array(
            [balances(p, x, 5.5, 0.03) - balances(p, 0 * x, 5.5, 0.03) for x in np.eye(5)]
        ).T,
    )
    true = solved.y.T
    found = Response(TwoRotors(I_M, J_2, R_S), record).signals(vector(p)[None])[0]
    assert np.max(np.abs(found - true) / np.abs(true).max(axis=0)) < 1e-6
    without = Response(MotorShaft(I_M), record).signals(vector(p)[None])[0]
    assert np.max(np.abs(without - true) / np.abs(true).max(axis=0)) > 0.1


def test_two_rotors_balance_their_energy() -> None:
    p, v, t_1 = skewed(), 5.5, 0.03
    linear = TwoRotors(I_M, J_2, R_S).linear(p)
    matrix = dynamics(linear, STATES, 1)[0]
    forcing = constant_forcing(linear, STATES, 1, {"v": v, "t_1": t_1})[0]
    for x in np.random.default_rng(1).normal(0, 3, (20, 5)):
        rate = matrix @ x + forcing
        theta_1, theta_2, w_1, w_2, i = x
        w_3, w_3_dot = w_2 / I_M, rate[3] / I_M
        twist = p["k_s"] * (theta_1 - theta_2)
        rotors = p["j_1"] * w_1 * rate[2] + J_2 * w_2 * rate[3] + p["j_m"] * w_3 * w_3_dot
        stored = rotors + twist * (w_1 - w_2) + p["l_m"] * i * rate[4]
        lost = (p["r_m"] + R_S) * i**2 + p["c_m"] * w_3**2 + p["t_f"] * w_3 + t_1 * w_1
        assert stored == pytest.approx(v * i - lost + (p["k_T"] - p["k_e"]) * i * w_3, rel=1e-9)


def test_a_second_rotor_of_nothing_is_the_rig() -> None:
    p = skewed()
    assert TwoRotors(I_M).linear(p) == MotorShaft(I_M).linear(p)


def load(tmp_path: Path, model: str) -> Model:
    text = (ROOT / "configs" / "nominal_step.yaml").read_text()
    old = "model:\n  name: motor_shaft\n  i_m: 0.125                # gear 8:1\n"
    assert text.count(old) == 1
    path = tmp_path / "config.yaml"
    path.write_text(text.replace(old, f"model: {model}\n"))
    return loading.load(path).model


def test_a_config_gives_a_model_its_constants(tmp_path_factory: pytest.TempPathFactory) -> None:
    cases = [
        ("{}", MotorShaft(0.125)),
        ("{name: two_rotors, i_m: 0.2, j_2: 7.0e-3}", TwoRotors(0.2, 7.0e-3, 0.0)),
        ("{name: two_rotors, r_s: 0.2, j_2: 0}", TwoRotors(0.125, 0.0, 0.2)),
    ]

    def check(text: str, model: Model) -> None:
        tmp_path = tmp_path_factory.mktemp("case")
        assert load(tmp_path, text) == model

    for_each({case[0]: case for case in cases}, check)


def test_a_constant_of_another_model_is_an_error_with_its_line(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    cases = [
        (
            "{name: motor_shaft, j_2: 7.0e-3}",
            "model.j_2: the model motor_shaft has no j_2; remove it, or name: two_rotors",
        ),
        (
            "{name: two_rotors, elements: 3}",
            "model.elements: the model two_rotors has no elements; remove it, or name: long_shaft",
        ),
        ("{name: two_rotors, r_s: -0.1}", "model.r_s: -0.1"),
        ("{name: motor_shaft, stribeck: 3}", "model.stribeck: '3' is not possible"),
        ("{name: two_rotor}", "model.name: 'two_rotor' is not a model; did you mean two_rotors?"),
    ]

    def check(text: str, said: str) -> None:
        tmp_path = tmp_path_factory.mktemp("case")
        with pytest.raises(InputError) as caught:
            load(tmp_path, text)
        (problem,) = caught.value.problems
        assert str(problem).startswith(f"{tmp_path / 'config.yaml'}:24: {said}")

    for_each({case[0]: case for case in cases}, check)
