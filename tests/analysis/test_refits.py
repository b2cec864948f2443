"""Refits of candidates: their evidence, what they hide, where they start, what they cannot tell."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from scipy.stats import multivariate_normal
from support.case_tables import run_cases
from support.scipy_oracles import NOMINAL

import bayesdrill as bd
from bayesdrill.analysis.refits import RefitMaximum, measured_samples, refit_candidate
from bayesdrill.inference.posterior import Posterior

T = 0.01 * np.arange(200)
FREE = {"prior": "log_uniform", "low": 1e-3, "high": 10.0}


def refit(
    posterior: Posterior, start: Mapping[str, float] | None = None, *more: Any
) -> RefitMaximum:
    return refit_candidate(posterior, start or {}, -np.inf, *more)


def swing(**record: list[float]) -> Posterior:
    """Return that of a pendulum that is let go, which nothing drives."""
    rig = bd.Train(inertias=("arm",), gravity=("arm",), added=("c_arm",))
    p = {"j_arm": 0.02, "g_arm": 1.0, "c_arm": 0.01}
    y = bd.respond(rig, p, T, {}, ["theta_arm"], initial={"theta_arm": 0.8})["theta_arm"]
    y = y + 0.01 * np.random.default_rng(1).standard_normal(len(T))
    channels, unknowns = {"theta_arm": bd.Channel(y, "rad", 0.01)}, {"j_arm": FREE, "c_arm": FREE}
    case = bd.case(T, channels, {}, p | unknowns, rig=rig, initial="free", record=record)
    return case.job.problem.posterior


def hub(
    u: np.ndarray,
    p: dict[str, float],
    unknown: dict[str, Any],
    record: Mapping[str, Any] | None = None,
    unit: str = "rad/s",
    sigma: Any = 0.02,
    **offset: Any,
) -> Posterior:
    """Return that of a motor under the voltage `u`, whose offset or `sigma` may be unknown."""
    friction = tuple(name for name in p if name == "t_c_hub")
    rig = bd.Train(inertias=("hub",), drives={"hub": "voltage"}, added=("c_hub", *friction))
    y = bd.respond(rig, p, T, {"u_hub": u}, ["w_hub"])["w_hub"]
    y = y + 0.02 * np.random.default_rng(2).standard_normal(len(T))
    channels, inputs = {"w_hub": bd.Channel(y, unit, sigma)}, {"u_hub": bd.Input(u, "V", **offset)}
    case = bd.case(T, channels, inputs, p | unknown, rig=rig, record=record or {})
    return case.job.problem.posterior


HUB = {"j_hub": 0.05, "k_T_hub": 1.0, "r_hub": 1.0, "c_hub": 0.3}
UNKNOWN = {"j_hub": FREE, "c_hub": FREE}
OFFSET = {"prior": "normal", "mean": 0.0, "sd": 1.0}


def test_the_evidence_of_a_linear_model_is_exact() -> None:
    """Offsets of channels and of the supply act linearly: the record is Gaussian, and its covariance
    is written down."""
    n, rng = 120, np.random.default_rng(2)
    t, values, wanted = 0.01 * np.arange(n), NOMINAL | {"t_f": 0.0}, ["theta_2", "w_1"]
    v = 5.0 * np.sign(np.sin(5.0 * t + 0.4))
    sds = {"theta_2": 2e-3, "w_1": 0.01, "v": 0.01}  # as sure as the record

    def signals(volts: np.ndarray) -> np.ndarray:
        columns = bd.respond("motor_shaft", values, t, {"v": volts}, wanted)
        return np.concatenate([columns[name] for name in wanted])

    noise, clean = np.repeat([0.02, 0.1], n), signals(v)
    y = signals(v + 0.01) + noise * rng.standard_normal(2 * n)
    offsets = np.repeat(np.eye(2), n, axis=0)
    rows = np.column_stack([offsets, signals(v + 1.0) - clean]) * [*sds.values()]
    exact = multivariate_normal(clean, np.diag(noise**2) + rows @ rows.T).logpdf(y)
    offset = {name: {"prior": "normal", "mean": 0.0, "sd": sd} for name, sd in sds.items()}
    case = bd.case(
        t,
        channels={
            "theta_2": bd.Channel(y[:n], "rad", 0.02, offset=offset["theta_2"]),
            "w_1": bd.Channel(y[n:], "rad/s", 0.1, offset=offset["w_1"]),
        },
        inputs={"v": bd.Input(v, "V", offset=offset["v"])},
        parameters=values,
    )
    assert {*case.unknowns} == {f"offset_{name}" for name in sds}
    result = refit(case.job.problem.posterior)
    assert result.log_z == pytest.approx(exact, abs=0.01)
    assert not result.at_ends
    assert not result.has_rival


def test_samples_that_a_candidate_hides_count_as_unexplained() -> None:
    """In its evidence they are Gaussian about the mean of their channel; of their size all is left."""
    given, later = swing(), swing(window=[0.5, 2.0])
    records, start = measured_samples(given.likelihood), given.space.start
    plain, counted, whole = (
        refit(later, start),
        refit(later, start, {}, records),
        refit(given, start, {}, records),
    )
    assert (whole.omitted, plain.omitted) == (0.0, 0.0)
    assert counted.omitted == pytest.approx(0.25)
    y = given.likelihood.observations[0].experiment.y[:, 0]
    unseen = y[:50] - y.mean()
    density = -0.5 * np.sum(np.log(2 * np.pi * y.var()) + unseen**2 / y.var())
    assert counted.log_z - plain.log_z == pytest.approx(density, rel=1e-6)
    assert counted.log_posterior - plain.log_posterior == pytest.approx(density, rel=1e-6)
    theta = later.space.vector(counted.values)[None]
    residuals = y[50:] - later.likelihood.signals(theta)[0, :, 0]
    share = (np.sum(residuals**2) + np.sum(unseen**2)) / np.sum((y - y.mean()) ** 2)
    assert counted.residuals[0].share == pytest.approx(np.sqrt(share), rel=1e-3)
    assert counted.log_z < whole.log_z


def test_another_unit_of_a_channel_gains_no_evidence_by_itself() -> None:
    """The noise of a motor that stands still is as probable in rad/s as in rpm, by its numbers."""
    sigma, unknown = {"prior": "log_uniform", "low": 1e-4, "high": 1.0}, {"c_hub": FREE}
    units = ("rad/s", "rpm")
    first, other = (refit(hub(0.0 * T, HUB, unknown, unit=unit, sigma=sigma)) for unit in units)
    assert other.log_z == pytest.approx(first.log_z, abs=1e-6)


def test_hidden_samples_of_a_rig_at_rest_do_not_end_a_refit() -> None:
    """They are noise about one value, far less than the spread of the channel."""
    u = 5.0 * np.sign(np.sin(7.0 * T)) * (T > 0.5)
    given, later = (hub(u, HUB, UNKNOWN, record) for record in ({}, {"window": [0.4, 2.0]}))
    records, start = measured_samples(given.likelihood), given.space.start
    top = refit(later, start, {}, records)
    assert top.log_posterior == pytest.approx(refit(given, start).log_posterior, abs=10)
    again = refit_candidate(later, start, top.log_posterior - 3.0, {}, records)
    assert again is not None
    assert (again.is_finished, again.values) == (True, top.values)


def test_a_start_of_a_candidate_is_used() -> None:
    result = refit(swing(), {}, {}, {}, [{"j_arm": 0.02, "c_arm": 0.01}])
    assert result.values["j_arm"] == pytest.approx(0.02, rel=0.02)


@run_cases("above, finished", [(-1.0, True), (1.0, False)])
def test_a_refit_that_cannot_reach_its_rival_is_not_finished(above: float, finished: bool) -> None:
    """A rival that is a little less probable changes nothing."""
    posterior = hub(5.0 * np.sign(np.sin(7.0 * T)), HUB, UNKNOWN)
    alone = refit(posterior, posterior.space.start)
    result = refit(posterior, posterior.space.start, {}, {}, (), alone.log_z + above)
    assert (alone.is_finished, result.is_finished) == (True, finished)
    assert (result.values == alone.values) == finished
    assert result.log_z == pytest.approx(alone.log_z)


def test_a_start_at_which_friction_stops_the_rig_does_not_end_a_refit() -> None:
    """It is the middle of the prior; another start is better, and steps from there reach the rival."""
    wide = {"t_c_hub": {"prior": "uniform", "low": 0.0, "high": 100.0}}
    volts = 5.0 * np.sign(np.sin(8.0 * T + 0.3))
    posterior = hub(volts, HUB | {"t_c_hub": 0.5}, UNKNOWN | wide, offset=OFFSET)
    near, small = {name: HUB[name] for name in UNKNOWN}, {"t_c_hub": 0.2}
    best = refit(posterior, near | small)
    top = refit(posterior, near, near | {"t_c_hub": 60.0}, {}, [small], best.log_z - 1.0)
    assert top.is_finished
    assert top.log_z == pytest.approx(best.log_z, abs=1e-3)


@run_cases("high, at_end", [(0.1, True), (10.0, False)])
def test_a_maximum_at_the_end_of_a_prior_is_noticed(high: float, at_end: bool) -> None:
    unknown = UNKNOWN | {"c_hub": {"prior": "uniform", "low": 0.05, "high": high, "start": 0.09}}
    posterior = hub(5.0 * np.sign(np.sin(7.0 * T)), HUB, unknown)
    assert ("c_hub" in refit(posterior, posterior.space.start).at_ends) == at_end


@run_cases("turns", [False, True])
def test_unknowns_that_stand_for_each_other_are_named(turns: bool) -> None:
    """Dry friction and an offset of the voltage of a motor, unless it turns both ways."""
    u = 4.0 * np.sign(np.sin(9.0 * T)) if turns else 4.0 + np.sin(9.0 * T)
    friction = {"prior": "uniform", "low": 0, "high": 3}
    posterior = hub(u, HUB | {"t_c_hub": 0.5}, UNKNOWN | {"t_c_hub": friction}, offset=OFFSET)
    near = {name: posterior.space.start[name] for name in UNKNOWN}
    pairs = [{*pair} for pair in refit(posterior, near).exchangeable]
    assert pairs == ([] if turns else [{"t_c_hub", "offset_u_hub"}])


@run_cases("size, vague", [(0.0, ("j_hub", "c_hub")), (5.0, ())])
def test_an_unknown_of_which_the_record_says_nothing_is_vague(
    size: float, vague: tuple[str, ...]
) -> None:
    posterior = hub(size * np.sign(np.sin(7.0 * T)), HUB, UNKNOWN)
    assert refit(posterior, posterior.space.start).vague == vague
