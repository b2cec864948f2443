"""Refits of candidates: what they hide, from where they start, and what they cannot tell."""

from __future__ import annotations

import numpy as np
import pytest

import bayesdrill as bd
from bayesdrill.analysis.refits import measured_samples, refit_candidate
from bayesdrill.inference.posterior import Posterior

T = 0.01 * np.arange(200)
FREE = {"prior": "log_uniform", "low": 1e-3, "high": 10.0}


def swing(window: list[float] | None = None, *, noisy: bool = True) -> Posterior:
    """A pendulum that is let go; nothing drives it."""
    rig = bd.Train(inertias=("arm",), gravity=("arm",), added=("c_arm",))
    p = {"j_arm": 0.02, "g_arm": 1.0, "c_arm": 0.01}
    y = bd.respond(rig, p, T, {}, ["theta_arm"], initial={"theta_arm": 0.8})["theta_arm"]
    y = y + 0.01 * noisy * np.random.default_rng(1).standard_normal(len(T))
    case = bd.case(
        T,
        {"theta_arm": bd.Channel(y, "rad", 0.01)},
        {},
        {**p, "j_arm": FREE, "c_arm": FREE},
        rig=rig,
        initial="free",
        **({} if window is None else {"record": {"window": window}}),
    )
    return case.job.problem.posterior


def test_samples_that_a_candidate_hides_count_as_unexplained() -> None:
    """In its evidence they are Gaussian about the mean of their channel; in its share all is left.

    Mutants killed: hidden samples that count for nothing, or as if they were fitted.
    """
    given, later = swing(), swing([0.5, 2.0])
    records = measured_samples(given.likelihood)
    near = given.space.start
    plain, counted = (refit_candidate(later, near, -np.inf, {}, each) for each in ({}, records))
    whole = refit_candidate(given, near, -np.inf, {}, records)
    assert plain is not None
    assert counted is not None
    assert whole is not None
    assert (whole.hidden, plain.hidden) == (0.0, 0.0)
    assert counted.hidden == pytest.approx(0.25)
    y = given.likelihood.observations[0].experiment.y[:, 0]
    unseen = y[:50] - y.mean()
    density = -0.5 * np.sum(np.log(2 * np.pi * y.var()) + unseen**2 / y.var())
    assert counted.log_z - plain.log_z == pytest.approx(density, rel=1e-6)
    assert counted.log_posterior - plain.log_posterior == pytest.approx(density, rel=1e-6)
    theta = later.space.vector(counted.values)[None]
    left = y[50:] - later.likelihood.signals(theta)[0, :, 0]
    wanted = np.sqrt((np.sum(left**2) + np.sum(unseen**2)) / np.sum((y - y.mean()) ** 2))
    assert counted.fit[0].share == pytest.approx(wanted, rel=1e-3)
    assert counted.log_z < whole.log_z


def test_unknowns_that_stand_for_each_other_are_named() -> None:
    """A motor that turns one way: dry friction and an offset of its voltage.  Both ways they do not.

    Mutant killed: correlations of what was known before.
    """
    for turns, alike in ((False, True), (True, False)):
        u = 4.0 + np.sin(9.0 * T) if not turns else 4.0 * np.sign(np.sin(9.0 * T))
        rig = bd.Train(inertias=("hub",), drives={"hub": "voltage"}, added=("c_hub", "t_c_hub"))
        p = {"j_hub": 0.05, "k_T_hub": 1.0, "r_hub": 1.0, "c_hub": 0.3, "t_c_hub": 0.5}
        y = bd.respond(rig, p, T, {"u_hub": u}, ["w_hub"])["w_hub"]
        y = y + 0.02 * np.random.default_rng(2).standard_normal(len(T))
        case = bd.case(
            T,
            {"w_hub": bd.Channel(y, "rad/s", 0.02)},
            {"u_hub": bd.Input(u, "V", offset={"prior": "normal", "mean": 0.0, "sd": 1.0})},
            {
                **p,
                "j_hub": FREE,
                "c_hub": FREE,
                "t_c_hub": {"prior": "uniform", "low": 0, "high": 3},
            },
            rig=rig,
        )
        posterior = case.job.problem.posterior
        near = {name: posterior.space.start[name] for name in ("j_hub", "c_hub")}
        found = refit_candidate(posterior, near, -np.inf)
        assert found is not None
        assert [{*pair} for pair in found.alike] == [{"t_c_hub", "offset_u_hub"}] * alike


def test_an_unknown_of_which_a_record_says_nothing_is_vague() -> None:
    """Mutant killed: sds that are not those of the coordinate in which the prior is wide."""
    rig = bd.Train(inertias=("hub",), drives={"hub": "voltage"}, added=("c_hub",))
    free = {"j_hub": FREE, "c_hub": FREE, "k_T_hub": 1.0, "r_hub": 1.0}
    noise = 0.02 * np.random.default_rng(3).standard_normal(len(T))
    for size, vague in ((0.0, ("j_hub", "c_hub")), (5.0, ())):
        u = size * np.sign(np.sin(7.0 * T))
        p = {"j_hub": 0.05, "k_T_hub": 1.0, "r_hub": 1.0, "c_hub": 0.3}
        y = bd.respond(rig, p, T, {"u_hub": u}, ["w_hub"])["w_hub"] + noise
        case = bd.case(
            T, {"w_hub": bd.Channel(y, "rad/s", 0.02)}, {"u_hub": bd.Input(u, "V")}, free, rig=rig
        )
        posterior = case.job.problem.posterior
        found = refit_candidate(posterior, posterior.space.start, -np.inf)
        assert found is not None
        assert found.vague == vague


def test_starts_of_a_candidate_are_used() -> None:
    """Mutant killed: starts that are not read."""
    posterior = swing()
    start = {"j_arm": 0.02, "c_arm": 0.01}
    found = refit_candidate(posterior, {}, -np.inf, {}, {}, [start])
    assert found is not None
    assert found.values["j_arm"] == pytest.approx(0.02, rel=0.02)
