"""Derived quantities against what the response does, closed forms, and rigs of other parts."""

from functools import cache

import numpy as np
import pytest
from support.case_tables import run_cases
from support.command_line import ROOT
from support.scipy_oracles import NOMINAL, by_expm, matrices, skewed
from support.small_problems import experiment

from bayesdrill.config import job
from bayesdrill.inference import derived
from bayesdrill.inference.posterior import Problem
from bayesdrill.record.experiment import typical_inputs
from bayesdrill.report.sections.products import derived_csv, derived_shown
from bayesdrill.rig.models.linear import Linear, Model, with_named
from bayesdrill.rig.models.long_shaft import LongShaft
from bayesdrill.rig.models.motor_shaft import DrivenShaft, Motor, MotorShaft


def quantities(rig: Model, p: dict[str, float], **inputs: float) -> dict[str, float]:
    linear = rig.linear(p)
    values = derived.poles(rig, linear, 1) | derived.steady_values(rig, linear, 1, inputs)
    return {name: float(x[0]) for name, x in values.items()}


def undefined(values: dict[str, float]) -> set[str]:
    return {name for name, x in values.items() if np.isnan(x)}


@run_cases("p", [NOMINAL, skewed()])
def test_a_long_simulation_ends_at_the_steady_speed_and_current(p: dict[str, float]) -> None:
    """Under a load, too."""
    late = by_expm(p, np.array([200.0, 201.0]), np.zeros(5), 8.0, 0.3)
    values = quantities(MotorShaft(), p, v=8.0, t_1=0.3)
    assert values["w_end"] == pytest.approx(late[-1, 3], rel=1e-7)
    assert values["w_end"] == pytest.approx(late[1, 0] - late[0, 0], rel=1e-7)
    assert values["i_end"] == pytest.approx(late[-1, 4], rel=1e-7)


def test_time_constants_are_those_of_the_motor_without_its_shaft() -> None:
    """A shaft that is a million times softer leaves two poles of the motor in closed form."""
    p = {**NOMINAL, "k_s": 1e-6 * NOMINAL["k_s"]}
    values = quantities(MotorShaft(), p)
    a, b = p["r_m"] / p["l_m"], p["c_m"] / p["j_m"]
    product = a * b + p["k_e"] * p["k_T"] / (p["j_m"] * p["l_m"])
    root = np.sqrt((a + b) ** 2 / 4 - product)
    expected = [1 / ((a + b) / 2 + root), 1 / ((a + b) / 2 - root)]
    assert [values["tau_e"], values["tau_m"]] == pytest.approx(expected, rel=1e-5)


SWINGING = {"l_m": 1.0}
CREEPING = {"j_m": 1.0, "l_m": 1e-4, "c_m": 50.0, "j_1": 1e-9, "k_s": 1e-13}
OVERDAMPED = {"j_m": 1e-9, "l_m": 1e-9, "k_s": 1e4}
MISSING = {
    "a motor that swings with its current": (SWINGING, {"tau_e", "tau_m"}),
    "a rotor that is braked before it can swing": (OVERDAMPED, {"omega_n", "zeta"}),
}


@run_cases("changes, expected", MISSING.values(), MISSING)
def test_a_quantity_that_a_rig_does_not_have_is_nan(
    changes: dict[str, float], expected: set[str]
) -> None:
    values = quantities(MotorShaft(), {**NOMINAL, **changes})
    assert expected <= undefined(values)
    assert np.isfinite(values["tau_e"]) == ("tau_e" not in expected)
    if "omega_n" in expected:  # then all poles are real but the one at zero
        poles = np.linalg.eigvals(matrices({**NOMINAL, **changes})[0])
        poles = poles[np.argsort(np.abs(poles))][1:]
        assert np.all(np.abs(poles.imag) < 1e-6 * np.abs(poles))


def test_one_draw_without_a_quantity_leaves_the_others_alone() -> None:
    assert np.isfinite(quantities(MotorShaft(), {**NOMINAL, **CREEPING})["tau_e"])
    p = {name: np.array([x, np.nan]) for name, x in NOMINAL.items()}
    omega_n = derived.poles(MotorShaft(), MotorShaft().linear(p), 2)["omega_n"]
    assert list(np.isfinite(omega_n)) == [True, False]


def test_a_rig_that_never_settles_has_no_end_values() -> None:
    """Held by neither angle nor friction in one state: NaN, and no error."""
    a = {("theta_1", "w_1"): 1.0, ("w_1", "theta_1"): -1.0, ("theta_2", "w_2"): 1.0}
    linear = Linear(A={**a, ("i", "i"): -1.0}, B={}, c={"w_2": 1.0})
    values = derived.steady_values(MotorShaft(), linear, 1, {})
    assert undefined(values) == {"w_end", "i_end"}


SHAFT = {"k_s": 4.1, "j_1": 7.8e-3, "c_s": 0.017, "c_1": 0.011}
CIRCUIT = {"k_e": 0.061, "k_T": 0.057, "r_m": 0.41, "l_m": 9e-4}


def test_a_driven_shaft_swings_as_one_mass_on_a_spring_and_ends_at_the_imposed_speed() -> None:
    values = quantities(with_named(DrivenShaft(), SHAFT), SHAFT, w_2=9.0, t_1=1.7)
    omega = np.sqrt(4.1 / 7.8e-3)
    assert values["omega_n"] == pytest.approx(omega)
    assert values["zeta"] == pytest.approx((0.017 + 0.011) / (2 * 7.8e-3 * omega))
    assert values["w_end"] == pytest.approx(9.0)
    assert undefined(values) == {"tau_e", "tau_m", "i_end"}


def test_a_motor_has_the_time_constants_of_its_parts() -> None:
    """Without a circuit it has one of the inertia alone."""
    p = {"j_m": 1.4e-4, "c_m": 9.3e-5, "t_f": 0.037}
    values = quantities(with_named(Motor(), p), p, t_m=0.05)
    assert values["tau_m"] == pytest.approx(1.4e-4 / 9.3e-5)
    assert values["w_end"] == pytest.approx((0.05 - 0.037) / 9.3e-5)
    assert undefined(values) == {"tau_e", "omega_n", "zeta", "i_end"}
    values = quantities(with_named(Motor(), p | CIRCUIT), p | CIRCUIT, v=6.0)
    slow = p["c_m"] + CIRCUIT["k_T"] * CIRCUIT["k_e"] / CIRCUIT["r_m"]
    roots = np.roots([1.4e-4 * 9e-4, 1.4e-4 * 0.41 + 9.3e-5 * 9e-4, slow * CIRCUIT["r_m"]])
    assert [values["tau_m"], values["tau_e"]] == pytest.approx(np.sort(-1 / roots)[::-1])
    w_end = (CIRCUIT["k_T"] * 6.0 / CIRCUIT["r_m"] - 0.037) / slow
    assert values["w_end"] == pytest.approx(w_end)
    assert values["i_end"] == pytest.approx((6.0 - CIRCUIT["k_e"] * w_end) / CIRCUIT["r_m"])


def test_the_swing_of_a_long_shaft_is_not_one_within_it() -> None:
    """Though those within are damped less."""
    plain = quantities(MotorShaft(), NOMINAL, v=8.0)
    values = quantities(LongShaft(), NOMINAL | {"j_s": 1.5e-7}, v=8.0)
    assert {name: values[name] for name in plain} == pytest.approx(plain, rel=2e-5)


def test_the_typical_input_is_the_size_of_a_drive_and_the_mean_of_a_load() -> None:
    both_ways = np.array([3.0, -4.0, 3.0, -4.0])
    series = {"w_2": both_ways, "t_1": both_ways + 2.0}
    inputs = typical_inputs(experiment(4, constant={}, series=series))
    assert inputs == {"w_2": pytest.approx(np.sqrt(12.5)), "t_1": pytest.approx(1.5)}
    assert typical_inputs(experiment(4, constant={"t_m": -0.3})) == {"t_m": pytest.approx(0.3)}


# --- of the draws of a run ---------------------------------------------------------------------------


@cache
def with_ties() -> tuple[Problem, np.ndarray, derived.Derived]:
    """Return a problem with formulas, draws of it `(2, 15, 9)`, and what is derived from them."""
    problem = job.prepare(ROOT / "configs" / "example_ties.yaml").problem
    draws = problem.posterior.space.draw(30, np.random.default_rng(3)).reshape(2, 15, 9)
    return problem, draws, derived.derive(problem, draws)


def test_formulas_and_quantities_are_evaluated_at_every_draw_and_at_nominal_values() -> None:
    _, draws, result = with_ties()
    names = [symbol.name for symbol in result.symbols]
    assert names == ["k_T", "k_s", "omega_n", "zeta", "tau_e", "tau_m", "w_end", "i_end", "omega_1"]
    values = dict(zip(names, np.moveaxis(result.values, -1, 0), strict=True))
    assert np.array_equal(values["k_T"], draws[..., 2])
    assert values["omega_1"] == pytest.approx(np.sqrt(values["k_s"] / draws[..., 5]))
    assert result.nominal["k_s"] == 0.26
    assert result.nominal["omega_1"] == pytest.approx(np.sqrt(0.26 / 28.3e-3))
    rows = derived.summarise(result)
    assert [row.name for row in rows] == names
    assert rows[-1].mean == pytest.approx(values["omega_1"].mean())
    assert rows[-1].hdi_low < rows[-1].mean < rows[-1].hdi_high
    head = derived_csv(rows).splitlines()[0]
    assert head.startswith("name,unit,nominal,mean,sd,hdi94_low")


def test_a_corner_shows_the_quantities_that_are_asked_for() -> None:
    problem, draws, result = with_ties()
    space = problem.posterior.space
    theta = space.vector(space.start)[None]
    names = ["omega_n", "k_e", "k_s"]
    columns, shown = derived_shown(problem, names, draws, result, theta)
    assert [symbol.name for symbol in shown.symbols] == names
    assert np.array_equal(columns[:, 1], draws[..., 2].ravel())
    assert shown.mode["k_s"] == pytest.approx(0.2628, rel=1e-3)
    _, usual = derived_shown(problem, None, draws, result, theta)
    assert [symbol.name for symbol in usual.symbols] == list(space.free)


@run_cases(
    "powers, name",
    [
        ({"k_s": 1, "j_1": -1}, "k_s_over_j_1"),
        ({"r_m": 1, "t_f": 2, "k_s": -1}, "r_m_t_f_squared_over_k_s"),
        ({"k_e": -2, "k_T": -1}, "one_over_k_e_squared_k_T"),
        ({"k_e": 3, "k_T": -4}, "k_e_cubed_over_k_T_to_4"),
    ],
)
def test_the_name_of_a_product_says_its_powers(powers: dict[str, int], name: str) -> None:
    """A name that is taken is not taken twice."""
    problem = job.prepare(ROOT / "configs" / "nominal_step.yaml").problem
    draws = problem.posterior.space.draw(10, np.random.default_rng(1))[None]
    exponents = [powers.get(unknown, 0) for unknown in problem.names]
    plain = derived.derive(problem, draws)
    result = derived.with_products(plain, problem, draws, [exponents, exponents])
    assert [symbol.name for symbol in result.symbols[-2:]] == [name, f"{name}_"]
    values = np.prod([draws[0, :, problem.names.index(n)] ** e for n, e in powers.items()], axis=0)
    assert result.values[0, :, -1] == pytest.approx(values)
    nominal = np.prod([NOMINAL[n] ** e for n, e in powers.items()])
    assert result.nominal[name] == pytest.approx(nominal)
