"""What records can hardly tell of friction: each sentence where it is true, and where it is not said."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest
from support.case_tables import run_cases
from support.missing_physics import DT, MEASURES, SIGMA, N, T
from support.scipy_oracles import NOMINAL
from support.small_problems import experiment, posterior_of

from bayesdrill.analysis.identifiability.frictions import (
    FrictionConfounding,
    distinguish,
    stall_voltage,
)
from bayesdrill.analysis.identifiability.information import SensitivityStudy
from bayesdrill.analysis.identifiability.study import prior_spreads, study_of
from bayesdrill.config.schema.config import Asked
from bayesdrill.inference.posterior import Posterior
from bayesdrill.inference.priors import Uniform
from bayesdrill.report.sections import identify_words
from bayesdrill.report.sections.physics_words import friction_sentences
from bayesdrill.rig.models.linear import with_named
from bayesdrill.rig.models.motor_shaft import DrivenShaft, MotorShaft
from bayesdrill.rig.simulators import simulator
from bayesdrill.rig.simulators.sensors import ObservationModel

RIG = MotorShaft()

SQUARE = np.where((T // 0.7) % 2 == 0, 5.0, -5.0)
STATIC = {"t_cm": 0.05, "t_sm": 0.1, "w_sm": 3.0}


def believed(
    free: tuple[str, ...],
    values: Mapping[str, float],
    v: np.ndarray | float,
    start: Mapping[str, float] | None = None,
    scale: float = 1.0,
) -> Posterior:
    """A rig as it is believed to be, under such a voltage, with `scale` times the noise."""
    rig = with_named(MotorShaft(), values)
    whole = {**NOMINAL, "t_f": 0.0, **values}
    series = {"v": v} if isinstance(v, np.ndarray) else {}
    constant = {"t_1": 0.0} | ({} if series else {"v": float(v)})
    seen = experiment(
        N, DT, series=series, constant=constant, measures=MEASURES, start=dict(start or {})
    )
    most = {"eta": 1.0}
    priors = {
        name: Uniform(0.2 * whole[name], min(3.0 * whole[name], most.get(name, np.inf)))
        for name in free
    }
    response = simulator(rig, seen, ObservationModel(), 2)
    return posterior_of(response, scale * SIGMA, priors, whole)


def told(posterior: Posterior) -> FrictionConfounding:
    theta = posterior.space.vector(posterior.space.start)
    return distinguish(SensitivityStudy(posterior.likelihood), posterior, theta)


def turning(v: float, t_f: float) -> dict[str, float]:
    """Where a rig turns steadily, by the balance of its torques: t_f of all motor friction."""
    p = NOMINAL
    gain = p["k_T"] / p["r_m"]
    w_3 = (gain * v - t_f) / (p["c_m"] + gain * p["k_e"])
    return {"w_1": w_3 / 8, "w_2": w_3 / 8, "i": (v - p["k_e"] * w_3) / p["r_m"]}


def test_a_motor_that_turns_steadily_one_way_sees_only_a_sum() -> None:
    """Mutant killed: what is known beside friction."""
    steady = turning(8.0, 0.05)
    found = told(believed(("t_cm", "c_m", "k_e"), {"t_cm": 0.05}, 8.0, steady))
    (one,) = found.alike
    assert one.name == "t_cm"
    assert set(one.rivals) <= {"c_m", "k_e"}
    assert one.fall > 5
    assert one.deeds is not None
    assert one.deeds.one_way
    assert one.deeds.one_speed
    said = friction_sentences(found, RIG)
    assert "t_cm can hardly be told from " in said
    assert f"the motor turns one way only, at {8 * steady['w_2']:.3g} to " in said


def test_two_levels_and_both_ways_tell_it() -> None:
    two = SQUARE * np.where(T > 1.5, 0.3, 1.0)
    assert told(believed(("t_cm", "c_m", "k_e"), {"t_cm": 0.05}, two)).alike == ()


def test_constant_friction_is_like_friction_that_changes_its_sign_until_the_motor_turns_round() -> (
    None
):
    values = {"t_cm": 0.05, "t_f": 0.04}
    found = told(believed(("t_cm", "t_f"), values, 8.0))
    (one,) = found.alike
    assert (one.name, one.rivals) == ("t_cm", ("t_f",))
    proposed = {each.what: each.shrink for each in one.proposals}
    assert max(proposed, key=lambda what: proposed[what]) == "turned half-way"
    said = friction_sentences(found, RIG)
    assert "t_cm can hardly be told from t_f" in said
    assert "the voltage turned round half-way (sd " in said
    assert told(believed(("t_cm", "t_f"), values, SQUARE)).alike == ()


@pytest.mark.slow
def test_what_is_proposed_does_what_is_said() -> None:
    """Mutants killed: the sd of another unknown, an experiment instead of one more."""
    values = {"t_cm": 0.05, "t_f": 0.04}
    before = believed(("t_cm", "t_f"), values, 8.0)
    then = np.where(np.arange(N) >= N // 2, -8.0, 8.0)
    after = believed(("t_cm", "t_f"), values, then)
    sds = []
    for posterior in (before, after):
        theta = posterior.space.vector(posterior.space.start)
        found = study_of(SensitivityStudy(posterior.likelihood), posterior, theta, Asked())
        sds.append(found.parameters[0].sd)
    (one,) = told(before).alike
    (proposal,) = (p for p in one.proposals if p.what == "turned half-way")
    assert proposal.shrink == pytest.approx(sds[0] / sds[1], rel=1e-3)
    # Of a measured voltage one more record, turned: both together know what each knows.
    records = [believed(("t_cm", "t_f"), values, np.full(N, volts)) for volts in (8.0, -8.0)]
    rows = np.vstack(
        [SensitivityStudy(record.likelihood).with_nuisances(theta) for record in records]
    )
    prior = np.diag(prior_spreads(before) ** -2.0)
    alone, both = (
        np.sqrt(np.linalg.inv(known.T @ known + prior)[0, 0])
        for known in (rows[: len(rows) // 2], rows)
    )
    (turned,) = (p for p in told(records[0]).alike[0].proposals if p.what == "turned")
    assert turned.shrink == pytest.approx(alone / both, rel=1e-3)


def test_static_friction_of_a_rig_that_never_slows_down_is_left_to_the_prior() -> None:
    found = told(believed(("t_sm", "w_sm", "k_e"), STATIC, 8.0))
    (one,) = found.unseen
    assert one.names == ("t_sm", "w_sm")
    assert one.deeds.stuck == 0
    assert one.deeds.slowest > 3 * STATIC["w_sm"]
    said = friction_sentences(found, RIG)
    assert "static friction at the motor does not show" in said
    assert f"lost over {STATIC['w_sm']:.3g} rad/s. t_sm and w_sm are left to the prior" in said
    assert "so low a voltage half-way that it stops (" in said


@run_cases("slow", [1.2, 2.5])
def test_static_friction_shows_where_it_sticks_or_goes_slowly(slow: float) -> None:
    found = told(believed(("t_sm", "w_sm", "k_e"), STATIC, slow * np.sin(2 * T)))
    assert found.unseen == ()


@pytest.mark.slow
def test_a_drop_is_like_k_e_at_one_voltage() -> None:
    steady = turning(8.0 - 0.5, 0.0)
    steady["i"] = (8.0 - 0.5 - NOMINAL["k_e"] * 8 * steady["w_2"]) / NOMINAL["r_m"]
    found = told(believed(("v_d", "k_e"), {"v_d": 0.5}, 8.0, steady))
    (one,) = found.alike
    assert (one.name, one.rivals) == ("v_d", ("k_e",))
    said = friction_sentences(found, RIG)
    assert "the current flows one way only, at " in said
    assert "half the voltage (4 V)" in said
    levels = np.where(T > 1.5, 2.0, 8.0)
    assert told(believed(("v_d", "k_e"), {"v_d": 0.5}, levels, steady)).alike == ()


@pytest.mark.slow
def test_damping_of_the_shaft_is_like_that_at_rotor_1() -> None:
    """A short record of a swing; a rig that turns for long knows better."""
    values = {"c_s": 5e-3, "c_1": 5e-3}
    rest = 0.02 * np.sin(3 * T)
    found = told(believed(("c_s", "c_1"), values, rest, {"theta_1": 1.0}, scale=3.0))
    (one,) = found.alike
    assert (one.name, one.rivals) == ("c_s", ("c_1",))
    assert "only c_1 from steady turning" in friction_sentences(found, RIG)
    assert told(believed(("c_s", "c_1"), values, SQUARE)).alike == ()


@pytest.mark.slow
def test_what_a_gear_loses_is_like_friction_at_the_motor() -> None:
    values = {"t_cm": 0.03, "eta": 0.85, "c_1": 0.1}
    steady = {"w_1": 13.0, "w_2": 13.0, "theta_1": -5.0, "i": 1.5}
    found = told(believed(("t_cm", "eta"), values, 8.0, steady, scale=4.0))
    assert [(one.name, one.rivals) for one in found.alike] == [("t_cm", ("eta",))]
    assert "what a gear loses grows with the torque that it passes on" in friction_sentences(
        found, RIG
    )
    swinging = told(believed(("t_cm", "eta"), values, SQUARE))
    assert swinging.alike == ()


def test_a_rig_without_any_of_it_is_told_nothing() -> None:
    posterior = believed(("k_e", "k_s"), {}, 8.0)
    assert told(posterior) == FrictionConfounding()
    assert friction_sentences(FrictionConfounding(), RIG) == ""
    theta = posterior.space.vector(posterior.space.start)
    found = study_of(SensitivityStudy(posterior.likelihood), posterior, theta, Asked())
    assert "friction" not in identify_words.full(found, RIG)


def test_identify_says_it() -> None:
    posterior = believed(("t_cm", "t_f"), {"t_cm": 0.05, "t_f": 0.04}, 8.0)
    theta = posterior.space.vector(posterior.space.start)
    found = study_of(SensitivityStudy(posterior.likelihood), posterior, theta, Asked())
    assert "friction: t_cm can hardly be told from t_f" in identify_words.full(found, RIG)


@run_cases("added", [{"t_cm": 0.05}, {"t_cm": 0.03, "t_c1": 0.2, "v_d": 0.4}])
def test_the_voltage_that_holds_it_at_rest(added: dict[str, float]) -> None:
    """Of a motor that is held: v = r_m T / k_T + v_d, T all friction that has to be overcome."""
    rig = with_named(MotorShaft(), added)
    p = {**NOMINAL, "t_f": 0.01, **added}
    torque = 0.01 + added["t_cm"] + added.get("t_c1", 0.0) / 8
    volts = NOMINAL["r_m"] * torque / NOMINAL["k_T"] + added.get("v_d", 0.0)
    assert stall_voltage(rig, p) == pytest.approx(volts, rel=1e-9)
    assert stall_voltage(MotorShaft(), {**NOMINAL, "t_f": 0.0}) == pytest.approx(0.0, abs=1e-12)
    assert stall_voltage(DrivenShaft(), {}) == 0.0
