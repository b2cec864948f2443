"""The exact response against independent solvers and against the laws of the rig."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
import scipy.linalg
from oracles import (
    NOMINAL,
    ORDER,
    by_expm,
    by_radau,
    by_trapezoid,
    matrices,
    power_balance,
    skewed,
    without_inductance,
)
from rigs import STATES, experiment, vector
from together import for_each

from bayesdrill.rig.models.linear import dynamics
from bayesdrill.rig.models.motor_shaft import MotorShaft
from bayesdrill.rig.simulators.exact import Response
from bayesdrill.rig.steady_state import equilibrium

START = {"theta_1": 0.7, "theta_2": -0.4, "w_1": 1.3, "w_2": -2.1, "i": 0.6}
X0 = np.array([START[name] for name in STATES])


def relative_error(found: np.ndarray, true: np.ndarray) -> float:
    return float(np.max(np.abs(found - true) / np.abs(true).max(axis=0)))


def batch(n: int, seed: int = 3) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return vector(NOMINAL) * rng.uniform(0.5, 1.5, (n, 9))


def signals(record, *parameters: dict[str, float]) -> np.ndarray:
    return Response(MotorShaft(), record).signals(np.array([vector(p) for p in parameters]))


def test_equals_scipys_expm_per_sample() -> None:
    def check(p: dict[str, float], dt: float) -> None:
        record = experiment(60, dt, constant={"v": 5.5, "t_1": 0.03}, start=START)
        true = by_expm(p, record.t, X0, 5.5, 0.03)
        assert relative_error(signals(record, p)[0], true) < 1e-11

    for_each(
        {f"{p} {dt}": (p, dt) for p in [NOMINAL, skewed()] for dt in [0.001, 0.01, 0.5]}, check
    )


def test_first_sample_later_than_the_start() -> None:
    record = experiment(40, 0.02, first=0.137, t_start=-0.05, start=START)
    true = by_expm(skewed(), record.t + 0.05, X0, 8.0, 0.0)
    assert relative_error(signals(record, skewed())[0], true) < 1e-11


def test_a_current_that_is_far_faster_than_all_else_costs_no_digits() -> None:
    """Many squarings.  Mutant killed: a one beside the increments that are squared (1e-2, 1e-4 off)."""

    def check(l_m: float) -> None:
        p = skewed() | {"l_m": l_m}
        record = experiment(60, 0.02, constant={"v": 5.5, "t_1": 0.0}, start=START)
        true = without_inductance(p, record.t, X0[:4], 5.5)
        assert relative_error(signals(record, p)[0, 1:, :4], true[1:]) < 1e-10

    for_each({str(l_m): (l_m,) for l_m in [1e-16, 1e-14]}, check)


def test_measured_inputs_against_radau() -> None:
    """Mutant killed: increments of a first-order hold taken from the wrong sample."""
    cases = {
        "zero-order": (False,),
        "first-order": (True,),
    }

    def check(first_order: bool) -> None:
        rng = np.random.default_rng(11)
        n, dt = 7, 0.013
        v, load = 6 + rng.standard_normal(n), 0.05 * rng.standard_normal(n)
        record = experiment(
            n, dt, first=2.0, t_start=2.0, constant={}, series={"v": v, "t_1": load},
            first_order=first_order, start=START,
        )  # fmt: skip

        def inputs(s: float, middle: float) -> tuple[float, float]:
            k = int((middle - 2.0) / dt)
            share = (s - record.t[k]) / dt if first_order else 0.0
            return tuple(u[k] + share * (u[k + 1] - u[k]) for u in (v, load))

        true = by_radau(skewed(), record.t, X0, inputs)
        assert relative_error(signals(record, skewed())[0], true) < 1e-8

    for_each(cases, check)


def test_one_measured_input_beside_a_constant_one() -> None:
    v = np.linspace(3.0, 9.0, 8)
    record = experiment(8, 0.01, constant={"t_1": 0.02}, series={"v": v}, start=START)
    true = by_radau(skewed(), record.t, X0, lambda s, m: (v[int(m / 0.01)], 0.02))
    assert relative_error(signals(record, skewed())[0], true) < 1e-8


def test_constant_step_against_radau() -> None:
    record = experiment(101, 0.05)
    true = by_radau(NOMINAL, record.t, np.zeros(5), lambda s, m: (8.0, 0.0))
    assert relative_error(signals(record, NOMINAL)[0], true) < 1e-8


def test_trapezoidal_rule_converges_to_it_with_order_two() -> None:
    exact = signals(experiment(2, 1.0, start=START), skewed())[0, -1]
    steps = np.array([400, 800, 1600, 3200])
    errors = [
        np.linalg.norm(by_trapezoid(skewed(), 1.0, n, X0, 8.0)[:4] - exact[:4]) for n in steps
    ]
    order = -np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert order == pytest.approx(2.0, abs=0.1)


def test_energy_is_balanced() -> None:
    """Mutants killed: wrong sign of friction, k_T exchanged with k_e."""
    p = skewed()
    x = signals(experiment(400, 0.003, start=START), p)[0]
    change = power_balance(p, x, 8.0)
    assert np.abs(change).max() < 1e-9
    # The oracle's rate is that of the response itself: fourth-order differences agree.
    fine = signals(experiment(9, 1e-5, start=START), p)[0]
    numeric = (fine[2] - 8 * fine[3] + 8 * fine[5] - fine[6]) / (12 * 1e-5)
    a, v, _, c = matrices(p)
    assert np.allclose(numeric, a @ fine[4] + 8 * v + c, rtol=1e-6)


def test_ends_at_the_equilibrium() -> None:
    """Steady speed: k_e w/i_m + r_m i = v and k_T i = c_m w/i_m + t_f; 15.91 rad/s nominally."""
    p = NOMINAL
    current = np.linalg.solve(
        [[8 * p["k_e"], p["r_m"]], [-8 * p["c_m"], p["k_T"]]], [8.0, p["t_f"]]
    )
    end = signals(experiment(2, 400.0), p)[0, -1]
    assert end[2:] == pytest.approx([current[0], current[0], current[1]], rel=1e-9)
    assert end[2] == pytest.approx(15.91, abs=0.005)


def test_an_equilibrium_is_refused_by_rank_alone() -> None:
    """Mutant killed: a small determinant taken for none."""
    stiff = scipy.linalg.hilbert(6)  # of full rank, and its determinant is 5e-18
    singular, unbounded = stiff.copy(), stiff.copy()
    singular[3], unbounded[0, 0] = singular[1] - singular[2], np.inf
    forcing = -np.sum(stiff, axis=1)
    found = equilibrium(np.array([stiff, singular, unbounded]), np.array([forcing] * 3))
    assert found[0] == pytest.approx(np.ones(6), rel=1e-6)
    assert np.isnan(found[1:]).all()


def test_rest_without_supply_and_friction_stays_at_rest() -> None:
    quiet = {**skewed(), "t_f": 0.0}
    assert np.all(signals(experiment(50, constant={"v": 0.0}), quiet) == 0.0)


def test_rigid_rotation_is_free_of_twist() -> None:
    """Turning the whole rig by an angle turns the answer by it: A annihilates that direction."""
    one = signals(experiment(80, start=START), skewed())[0]
    turned = {**START, "theta_1": START["theta_1"] + 2.0, "theta_2": START["theta_2"] + 2.0}
    two = signals(experiment(80, start=turned), skewed())[0]
    assert np.allclose(two - one, [2.0, 2.0, 0.0, 0.0, 0.0], atol=1e-10)


def test_the_two_scaling_symmetries() -> None:
    """(a) all torques and inertias; (b) impedances and torque per current, current unmeasured."""
    cases = {
        "torques": (("j_m", "c_m", "k_s", "j_1", "t_f", "k_T"), (0, 1, 2, 3, 4)),
        "currents": (("l_m", "r_m", "k_T"), (0, 1, 2, 3)),
    }

    def check(scaled: tuple[str, ...], unchanged: tuple[int, ...]) -> None:
        factor = 0.5 if scaled[0] == "l_m" else 2.0
        p = skewed()
        if scaled[0] == "l_m":
            q = {**p, "l_m": 0.5 * p["l_m"], "r_m": 0.5 * p["r_m"], "k_T": 0.5 * p["k_T"]}
        else:
            q = {name: value * factor if name in scaled else value for name, value in p.items()}
        one, two = signals(experiment(200), p, q)
        assert np.allclose(one[:, unchanged], two[:, unchanged], rtol=1e-10, atol=1e-12)
        other = {**p, scaled[0]: factor * p[scaled[0]]}
        assert not np.allclose(one[:, :4], signals(experiment(200), other)[0][:, :4], rtol=1e-4)

    for_each(cases, check)


def test_nominal_poles() -> None:
    linear = MotorShaft().linear({**NOMINAL, "k_s": 0.3})
    matrix = dynamics(linear, STATES, 1)[0]
    poles = np.sort_complex(np.linalg.eigvals(matrix))
    assert poles.real[:2] == pytest.approx([-227.9, -72.4], abs=0.06)
    assert np.abs(poles.imag).max() == pytest.approx(3.26, abs=0.005)


def test_misfit_is_the_sum_of_squared_residuals() -> None:
    """Mutants killed: channels exchanged, walkers transposed."""
    rng = np.random.default_rng(2)
    measures = {"twist": {"theta_1": 1.0, "theta_2": -1.0}, "motor": {"w_2": 8.0}, "i": {"i": 1.0}}
    record = experiment(123, y=rng.standard_normal((123, 3)) * [1, 20, 5], measures=measures)
    response = Response(MotorShaft(), record)
    theta = batch(21)
    residuals = record.y - response.signals(theta)
    assert np.allclose(response.squares(theta), (residuals**2).sum(axis=1), rtol=1e-12)
    states = Response(MotorShaft(), experiment(123)).signals(theta)
    combined = np.stack(
        [states[..., 0] - states[..., 1], 8 * states[..., 3], states[..., 4]], axis=-1
    )
    assert np.allclose(response.signals(theta), combined, rtol=1e-12, atol=1e-12)


def test_a_walker_does_not_depend_on_its_neighbours() -> None:
    response = Response(MotorShaft(), experiment(100))
    theta = batch(37)
    together = response.squares(theta)
    for n in (1, 7, 8, 9):
        assert np.array_equal(response.squares(theta[5 : 5 + n]), together[5 : 5 + n])


def test_an_overflowing_walker_leaves_its_neighbours_alone() -> None:
    response = Response(MotorShaft(), experiment(100))
    theta = batch(8)
    sick = theta.copy()
    sick[2, ORDER.index("l_m")] = 0.0
    sick[5, ORDER.index("j_m")] = 1e-300
    found, true = response.squares(sick), response.squares(theta)
    healthy = [0, 1, 3, 4, 6, 7]
    assert not np.isfinite(found[[2, 5]]).any()
    assert np.array_equal(found[healthy], true[healthy])


def test_inputs_are_not_changed_and_pickles_answer_alike() -> None:
    response = Response(MotorShaft(), experiment(50))
    theta = batch(9)
    before = theta.copy()
    first = response.squares(theta)
    assert np.array_equal(theta, before)
    again = pickle.loads(pickle.dumps(response))
    assert np.array_equal(again.squares(theta), first)
