"""Parameters that may be negative: the tilt of a pendulum, and friction of constant sign."""

from functools import cache
from typing import Any

import numpy as np
import pytest
from support.case_tables import run_cases

import bayesdrill as bd

T = 0.01 * np.arange(300)
TORQUE = 0.4 * np.sign(np.sin(2.1 * T)) + 0.2 * np.sin(5 * T)
TRUTH = {"g_arm": 1.0, "a_arm": -0.3, "j_arm": 0.05, "c_arm": 0.1, "t_f_arm": -0.05}
ANY = {"prior": "uniform", "low": -1, "high": 1}
AROUND_ZERO = {"prior": "normal", "mean": 0, "sd": 0.5}


@cache
def rig() -> bd.Train:
    return bd.Train(inertias=("arm",), gravity=("arm",), drives={"arm": "torque"})


def pendulum(quantities: dict[str, Any], **parameters: Any) -> bd.Case:
    units, rng = {"theta_arm": "rad", "w_arm": "rad/s"}, np.random.default_rng(3)
    exact = bd.respond(rig(), TRUTH, T, {"t_arm": TORQUE}, [*units])
    return bd.case(
        T,
        {
            name: bd.Channel(exact[name] + rng.normal(0, 0.001, T.shape), unit, sigma=0.001)
            for name, unit in units.items()
        },
        {"t_arm": bd.Input(TORQUE, "N*m")},
        {**TRUTH, **parameters},
        rig=rig(),
        quantities=quantities,
    )


@run_cases("prior", [ANY, AROUND_ZERO])
def test_an_angle_and_a_constant_friction_are_found_where_they_are_negative(
    prior: dict[str, Any],
) -> None:
    stiff = {"prior": "log_uniform", "low": 0.1, "high": 10}
    found = pendulum({}, a_arm=prior, t_f_arm=prior, g_arm=stiff).find_map(quick=True).values
    assert found == pytest.approx({n: TRUTH[n] for n in found}, abs=2e-3)


def test_identify_lists_a_negative_tilt_by_its_standard_deviation() -> None:
    """It has no relative one; the mutant that leaves it among logs has it as a product."""
    stiff = {"prior": "log_uniform", "low": 0.1, "high": 10}
    study = pendulum({}, a_arm=AROUND_ZERO, g_arm=stiff).identify().study
    assert study.names == ("g_arm",)
    (tilt,) = study.nuisances
    assert (tilt.name, tilt.prior_sd) == ("a_arm", pytest.approx(0.5, rel=0.01))
    assert tilt.sd < 1e-3


def test_a_formula_of_a_tilt_may_be_negative_and_one_of_a_weight_may_not() -> None:
    mounted = {"mounted": {"prior": "uniform", "low": 0.5, "high": 1.0, "unit": "rad"}}
    case = pendulum(mounted, a_arm="mounted - 1")
    assert case.find_map(quick=True).values["mounted"] == pytest.approx(0.7, abs=2e-3)
    with pytest.raises(bd.InputError, match=r"'mounted - 1' is -0\.\d+ .* must be positive"):
        pendulum(mounted, g_arm="mounted - 1")


def test_a_product_with_a_negative_tilt_is_excluded_from_the_prior() -> None:
    """The mutant that takes every name of a formula as positive gives a weight of less than zero."""
    space = pendulum({}, a_arm={**ANY, "low": 0.1}, g_arm="2*a_arm").job.problem.posterior.space
    assert space.bounding == ()
    with pytest.raises(bd.InputError, match="must be positive"):
        pendulum({}, a_arm=ANY, g_arm="2*a_arm")


def test_a_normal_prior_is_cut_at_zero_where_friction_keeps_its_sign() -> None:
    """Otherwise a symmetry that scales friction, too, would be lost."""
    near = {"prior": "normal", "mean": 0.05, "sd": 0.05}
    space = pendulum({}, a_arm=near, t_f_arm=near).job.problem.posterior.space
    roles = {unknown.name: (unknown.role, unknown.prior.low) for unknown in space.unknowns}
    assert roles == {"t_f_arm": ("rig", 0.0), "a_arm": ("offset", -np.inf)}
