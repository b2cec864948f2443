"""The other models: the matrix as printed, and the rig with a second rotor; their constants."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import scipy.integrate
from oracles import NOMINAL, skewed
from rigs import STATES, experiment, vector
from together import for_each

from bayesdrill.basics.errors import InputError
from bayesdrill.config import loading
from bayesdrill.config.schema.config import Config
from bayesdrill.inference import derived
from bayesdrill.paper.forward import six_states
from bayesdrill.paper.plugins import AsPrinted
from bayesdrill.rig.models import MODELS
from bayesdrill.rig.models.linear import Linear, Model
from bayesdrill.rig.models.motor_shaft import MotorShaft, TwoRotors
from bayesdrill.rig.simulators.exact import Response

ROOT = Path(__file__).parents[2]
I_M, J_2, R_S = 0.2, 7.3e-3, 0.21

RIGHT = AsPrinted(i_n=8.0, a_51="j_m")
TURNED = AsPrinted(i_n=8.0, a_51="j_1")
SCALED = AsPrinted(a_51="j_m")


def test_the_right_reading_of_both_misprints_is_the_right_rig() -> None:
    p = skewed()
    right = MotorShaft(I_M).linear(p)
    read = AsPrinted(i_m=I_M, i_n=1 / I_M, a_51="j_m").linear(p)
    assert pytest.approx(right.A, rel=1e-14) == read.A
    assert (read.B, read.c) == (right.B, right.c)


def test_the_printed_matrix() -> None:
    """Typed in from the paper. Mutant killed: a misprint mended in silence."""

    def check(i_n: float | None, read_as: float) -> None:
        p = skewed()
        k, j1, jm, lm, g = p["k_s"], p["j_1"], p["j_m"], p["l_m"], I_M**2
        printed = np.array(
            [
                [0, 0, 0, 1, 0, 0],
                [0, 0, 0, 0, 1, 0],
                [0, 0, 0, 0, 0, 1],
                [-k / j1, k / j1, 0, 0, 0, 0],
                [g * k / j1, -g * k / jm, 0, 0, -p["c_m"] / jm, I_M * p["k_T"] / jm],
                [0, 0, 0, 0, -read_as * p["k_e"] / lm, -p["r_m"] / lm],
            ]
        )
        matrix, forcing = six_states(AsPrinted(i_m=I_M, i_n=i_n), p, {"v": 8.0})
        assert np.allclose(matrix, printed, rtol=1e-14)
        assert forcing == pytest.approx([0, 0, 0, 0, -I_M * p["t_f"] / jm, 8.0 / lm])

    for_each({str(case): case for case in [(None, I_M), (5.5, 5.5)]}, check)


def test_speeds_that_the_misprints_lead_to() -> None:
    """Those in the table of `as_printed`; the end both as told and as reached after three hours."""
    cases = {
        "right": (RIGHT, (13.4, 16.3), 15.90, 15.91),
        "A(5,1)": (TURNED, (-4.5, 2.6), 0.07, 0.0),
        "A(6,5)": (SCALED, (661.1, 658.1), 660.3, 660.3),
        "as printed": (AsPrinted(), (-244.3, 10.8), -0.4, 0.0),
    }

    def check(model: AsPrinted, at_10: tuple[float, float], at_30: float, end: float) -> None:
        found = Response(model, experiment(1001, 10.0)).signals(vector(NOMINAL)[None])[0]
        assert found[1, 2:4] == pytest.approx(at_10, abs=0.06)
        assert found[3, 3] == pytest.approx(at_30, abs=0.06 if abs(at_30) > 0.1 else 0.006)
        told = derived.steady_values(model, model.linear(NOMINAL), 1, {"v": 8.0})
        assert told["w_end"][0] == pytest.approx(end, abs=0.06)
        assert found[-1, 2:4] == pytest.approx(told["w_end"].repeat(2), abs=1e-4)
        assert found[-1, 4] == pytest.approx(told["i_end"][0], abs=1e-4)

    for_each(cases, check)


def test_poles_of_a_rig_that_its_angles_hold_are_all_of_them() -> None:
    """Mutant killed: a zero pole is taken out that is not there."""
    linear = AsPrinted().linear(NOMINAL)
    found = derived.poles(AsPrinted(), linear, 1)
    every = np.linalg.eigvals(
        np.delete(np.delete(six_states(AsPrinted(), NOMINAL, {})[0], 2, 0), 2, 1)
    )
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
    matrix, forcing = six_states(TwoRotors(I_M, J_2, R_S), p, {"v": v, "t_1": t_1})
    for x in np.random.default_rng(1).normal(0, 3, (20, 6)):
        rate = matrix @ x + forcing
        theta_1, theta_2, _, w_1, w_2, i = x
        w_3, w_3_dot = w_2 / I_M, rate[4] / I_M
        twist = p["k_s"] * (theta_1 - theta_2)
        rotors = p["j_1"] * w_1 * rate[3] + J_2 * w_2 * rate[4] + p["j_m"] * w_3 * w_3_dot
        stored = rotors + twist * (w_1 - w_2) + p["l_m"] * i * rate[5]
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
        ("{name: as_printed}", AsPrinted(0.125, None, "j_1")),
        ("{name: as_printed, i_n: 8, a_51: j_m}", AsPrinted(0.125, 8.0, "j_m")),
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
            "{name: two_rotors, a_51: j_m}",
            "model.a_51: the model two_rotors has no a_51; remove it, or name: as_printed",
        ),
        ("{name: two_rotors, r_s: -0.1}", "model.r_s: -0.1"),
        ("{name: as_printed, a_51: j_2}", "model.a_51: 'j_2' is not possible"),
        ("{name: as_print}", "model.name: 'as_print' is not a model; did you mean as_printed?"),
    ]

    def check(text: str, said: str) -> None:
        tmp_path = tmp_path_factory.mktemp("case")
        with pytest.raises(InputError) as caught:
            load(tmp_path, text)
        (problem,) = caught.value.problems
        assert str(problem).startswith(f"{tmp_path / 'config.yaml'}:24: {said}")

    for_each({case[0]: case for case in cases}, check)


def test_the_printed_matrix_is_never_the_default() -> None:
    assert next(iter(MODELS)) == "motor_shaft"
    assert Config.model_fields["model"].default.name == "motor_shaft"
