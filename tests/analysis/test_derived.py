"""Derived quantities against what the response itself does."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.case_tables import run_cases
from support.scipy_oracles import NOMINAL, by_expm, matrices, skewed

from bayesdrill.config import job
from bayesdrill.inference import derived
from bayesdrill.report.sections import physics_words
from bayesdrill.rig.models.motor_shaft import MotorShaft

ROOT = Path(__file__).parents[2]
RIG = MotorShaft()


def poles(p: dict[str, float]) -> dict[str, float]:
    found = derived.poles(RIG, RIG.linear(p), 1)
    return {name: float(x[0]) for name, x in found.items()}


@run_cases("p", [NOMINAL, skewed()])
def test_a_long_simulation_ends_at_the_steady_speed_and_current(p: dict[str, float]) -> None:
    """Under a load too. Mutant killed: the load left out of the steady state."""
    late = by_expm(p, np.array([200.0, 201.0]), np.zeros(5), 8.0, 0.3)
    found = derived.steady_values(RIG, RIG.linear(p), 1, {"v": 8.0, "t_1": 0.3})
    assert found["w_end"][0] == pytest.approx(late[-1, 3], rel=1e-7)
    assert found["w_end"][0] == pytest.approx(late[1, 0] - late[0, 0], rel=1e-7)
    assert found["i_end"][0] == pytest.approx(late[-1, 4], rel=1e-7)


def test_time_constants_are_those_of_a_motor_with_its_shaft_cut() -> None:
    """A shaft a million times softer: what is left is the motor alone, two poles in closed form."""
    p = {**NOMINAL, "k_s": 1e-6 * NOMINAL["k_s"]}
    found = poles(p)
    a, b = p["r_m"] / p["l_m"], p["c_m"] / p["j_m"]
    product = a * b + p["k_e"] * p["k_T"] / (p["j_m"] * p["l_m"])
    root = np.sqrt((a + b) ** 2 / 4 - product)
    assert found["tau_e"] == pytest.approx(1 / ((a + b) / 2 + root), rel=1e-5)
    assert found["tau_m"] == pytest.approx(1 / ((a + b) / 2 - root), rel=1e-5)


def test_what_a_draw_does_not_have_is_nan_and_no_error() -> None:
    """A motor that swings with its current has no time constants; a rotor held by it no frequency."""
    swinging = poles({**NOMINAL, "l_m": 1.0})
    assert np.isnan(swinging["tau_e"])
    assert np.isnan(swinging["tau_m"])
    creeping = poles({**NOMINAL, "j_m": 1.0, "l_m": 1e-4, "c_m": 50.0, "j_1": 1e-9, "k_s": 1e-13})
    assert np.isfinite(creeping["tau_e"])
    p = {name: np.array([x, np.nan]) for name, x in NOMINAL.items()}
    both = derived.poles(RIG, RIG.linear(p), 2)
    assert np.isfinite(both["omega_n"][0])
    assert np.isnan(both["omega_n"][1])


def test_an_overdamped_rig_has_no_frequency() -> None:
    """A light motor on a stiff shaft: the rotor is braked before it can swing."""
    p = {**NOMINAL, "j_m": 1e-9, "l_m": 1e-9, "k_s": 1e4}
    found = poles(p)
    a = matrices(p)[0]
    values = np.linalg.eigvals(a)
    values = values[np.argsort(np.abs(values))][1:]
    assert np.all(np.abs(values.imag) < 1e-6 * np.abs(values))
    assert np.isnan(found["omega_n"])
    assert np.isnan(found["zeta"])
    assert np.isfinite(found["tau_e"])


def test_every_draw_and_the_nominal_value_of_all_derived() -> None:
    problem = job.prepare(ROOT / "configs" / "example_ties.yaml").problem
    draws = problem.posterior.space.draw(30, np.random.default_rng(3)).reshape(2, 15, 9)
    found = derived.derive(problem, draws)
    names = [symbol.name for symbol in found.symbols]
    assert names == ["k_T", "k_s", "omega_n", "zeta", "tau_e", "tau_m", "w_end", "i_end", "omega_1"]
    values = dict(zip(names, np.moveaxis(found.values, -1, 0), strict=True))
    assert np.array_equal(values["k_T"], draws[..., 2])
    assert values["omega_1"] == pytest.approx(np.sqrt(values["k_s"] / draws[..., 5]))
    assert found.nominal["k_s"] == 0.26
    assert found.nominal["omega_1"] == pytest.approx(np.sqrt(0.26 / 28.3e-3))
    rows = derived.summarise(found)
    assert [row.name for row in rows] == names
    row = rows[-1]
    assert row.mean == pytest.approx(values["omega_1"].mean())
    assert row.hdi_low < row.mean < row.hdi_high
    assert (
        physics_words.derived_csv(rows)
        .splitlines()[0]
        .startswith("name,unit,nominal,mean,sd,hdi94_low")
    )


def test_a_corner_of_chosen_quantities() -> None:
    problem = job.prepare(ROOT / "configs" / "example_ties.yaml").problem
    space = problem.posterior.space
    draws = space.draw(30, np.random.default_rng(3)).reshape(2, 15, 9)
    found = derived.derive(problem, draws)
    theta = space.vector(space.start)[None]
    picked, shown = physics_words.derived_shown(
        problem, ["omega_n", "k_e", "k_s"], draws, found, theta
    )
    assert [symbol.name for symbol in shown.symbols] == ["omega_n", "k_e", "k_s"]
    assert np.array_equal(picked[:, 1], draws[..., 2].ravel())
    assert shown.mode["k_s"] == pytest.approx(0.2628, rel=1e-3)
    _, every = physics_words.derived_shown(problem, None, draws, found, theta)
    assert [symbol.name for symbol in every.symbols] == list(space.free)


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
    problem = job.prepare(ROOT / "configs" / "nominal_step.yaml").problem
    draws = problem.posterior.space.draw(10, np.random.default_rng(1))[None]
    exponents = [powers.get(unknown, 0) for unknown in problem.names]
    found = derived.with_products(
        derived.derive(problem, draws), problem, draws, [exponents, exponents]
    )
    first, second = (symbol.name for symbol in found.symbols[-2:])
    assert first == name
    assert second == f"{name}_"  # a name that is taken is not taken twice
    values = np.prod([draws[0, :, problem.names.index(n)] ** e for n, e in powers.items()], axis=0)
    np.testing.assert_allclose(found.values[0, :, -1], values)
    assert found.nominal[name] == pytest.approx(
        np.prod([NOMINAL[n] ** e for n, e in powers.items()])
    )
