"""Frictions that a record can hardly tell from other parameters, or that it does not show at all."""

from collections.abc import Mapping
from typing import Any

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
from bayesdrill.analysis.identifiability.study import prior_spreads
from bayesdrill.inference.posterior import Posterior
from bayesdrill.inference.priors import Uniform
from bayesdrill.report.sections.friction import friction_sentences
from bayesdrill.rig.models.linear import with_named
from bayesdrill.rig.models.motor_shaft import DrivenShaft, MotorShaft
from bayesdrill.rig.simulators import simulator
from bayesdrill.rig.simulators.sensors import ObservationModel

# All records are of one rig, so that they share kernels.  With these values the rig is linear.
NEUTRAL = {"t_cm": 0.0, "t_sm": 0.0, "w_sm": 0.01, "v_d": 0.0, "c_s": 0.0, "c_1": 0.0, "eta": 1.0}
RIG = with_named(MotorShaft(), NEUTRAL)
SQUARE = np.where((T // 0.7) % 2 == 0, 5.0, -5.0)


def believed(
    free: tuple[str, ...],
    values: Mapping[str, float],
    v: np.ndarray | float,
    start: Mapping[str, float] | None = None,
    scale: float = 1.0,
) -> Posterior:
    """Return that of the rig with these `values` under a voltage, with `scale` times the noise."""
    at_rest = {"t_sm": values.get("t_cm", 0.0)}  # static friction is as large as sliding friction
    known = {**NOMINAL, "t_f": 0.0, **NEUTRAL, **at_rest, **values}
    series = {"v": v} if isinstance(v, np.ndarray) else {}
    constant = {"t_1": 0.0} | ({} if series else {"v": v})
    record = experiment(
        N, DT, series=series, constant=constant, measures=MEASURES, start=dict(start or {})
    )
    largest = {"eta": 1.0}
    priors = {
        name: Uniform(0.2 * known[name], min(3.0 * known[name], largest.get(name, np.inf)))
        for name in free
    }
    return posterior_of(simulator(RIG, record, ObservationModel(), 2), scale * SIGMA, priors, known)


def confounding(target: Posterior) -> FrictionConfounding:
    theta = target.space.vector(target.space.start)
    return distinguish(SensitivityStudy(target.likelihood), target, theta)


def turning(v: float, t_f: float = 0.0, drop: float = 0.0) -> dict[str, float]:
    """Return the speeds and the current of steady turning, by the balance of torques."""
    p = NOMINAL
    gain = p["k_T"] / p["r_m"]
    w_3 = (gain * (v - drop) - t_f) / (p["c_m"] + gain * p["k_e"])
    return {"w_1": w_3 / 8, "w_2": w_3 / 8, "i": (v - drop - p["k_e"] * w_3) / p["r_m"]}


# Parameters that are unknown, the values of a rig, a record that confounds them and what is said of
# it, and a voltage under which they are told from each other.
BOTH_FRICTIONS = ("t_cm", "t_f"), {"t_cm": 0.05, "t_f": 0.04}
CONFOUNDED: dict[str, tuple[Any, ...]] = {
    "one speed": (
        ("t_cm", "c_m", "k_e"), {"t_cm": 0.05}, (8.0, turning(8.0, 0.05)), {"c_m", "k_e"},
        f"the motor turns one way only, at {8 * turning(8.0, 0.05)['w_2']:.3g} to ",
        SQUARE * np.where(T > 1.5, 0.3, 1.0),
    ),
    "one way": (
        *BOTH_FRICTIONS, (8.0,), {"t_f"}, "the voltage turned round half-way (sd ", SQUARE
    ),
    "one voltage": (
        ("v_d", "k_e"), {"v_d": 0.5}, (8.0, turning(8.0, drop=0.5)), {"k_e"},
        "half the voltage (4 V)", np.where(T > 1.5, 2.0, 8.0),
    ),
    "a short swing": (
        ("c_s", "c_1"), {"c_s": 5e-3, "c_1": 5e-3},
        (0.02 * np.sin(3 * T), {"theta_1": 1.0}, 3.0), {"c_1"},
        "only c_1 brakes steady turning", SQUARE,
    ),
    "a loaded gear": (
        ("t_cm", "eta"), {"t_cm": 0.03, "eta": 0.85, "c_1": 0.1},
        (8.0, {"w_1": 13.0, "w_2": 13.0, "theta_1": -5.0, "i": 1.5}, 4.0), {"eta"},
        "what a gear loses grows with the torque that it passes on", SQUARE,
    ),
}  # fmt: skip


@run_cases("free, values, record, rivals, words, other", CONFOUNDED.values(), CONFOUNDED)
def test_a_friction_that_the_record_confounds_is_named_with_its_rivals(
    free: tuple[str, ...],
    values: dict[str, float],
    record: tuple[Any, ...],
    rivals: set[str],
    words: str,
    other: np.ndarray,
) -> None:
    """Another record of the same rig separates them."""
    result = confounding(believed(free, values, *record))
    (alike,) = result.alike
    assert alike.name == free[0]
    assert set(alike.rivals) <= rivals
    assert alike.fall > 5
    text = friction_sentences(result, RIG)
    assert f"{alike.name} can hardly be distinguished from {alike.rivals[0]}" in text
    assert words in text
    start = record[1] if free[0] == "v_d" else None
    assert confounding(believed(free, values, other, start)).alike == ()


def test_a_proposal_of_another_record_counts_beside_the_one_that_is_there() -> None:
    """Of a measured voltage one more record, turned: both together know what each knows."""
    records = [believed(*BOTH_FRICTIONS, np.full(N, volts)) for volts in (8.0, -8.0)]
    theta = records[0].space.vector(records[0].space.start)
    rows = [SensitivityStudy(one.likelihood).with_nuisances(theta) for one in records]
    prior = np.diag(prior_spreads(records[0]) ** -2.0)
    alone, both = (
        np.sqrt(np.linalg.inv(known.T @ known + prior)[0, 0])
        for known in (rows[0], np.vstack(rows))
    )
    (alike,) = confounding(records[0]).alike
    (turned,) = (proposal for proposal in alike.proposals if proposal.what == "turned")
    assert turned.shrink == pytest.approx(alone / both, rel=1e-3)


STATIC = ("t_sm", "w_sm", "k_e"), {"t_cm": 0.05, "t_sm": 0.1, "w_sm": 3.0}


def test_static_friction_of_a_rig_that_never_slows_down_is_left_to_the_prior() -> None:
    result = confounding(believed(*STATIC, 8.0))
    (unseen,) = result.unseen
    assert unseen.names == ("t_sm", "w_sm")
    assert unseen.deeds.stuck == 0
    assert unseen.deeds.slowest > 9.0
    text = friction_sentences(result, RIG)
    assert "static friction at the motor does not show" in text
    assert "fades over 3 rad/s. t_sm and w_sm are left to the prior" in text
    assert "so low a voltage half-way that it stops (" in text
    for amplitude in (1.2, 2.5):  # it sticks, or turns slowly
        assert confounding(believed(*STATIC, amplitude * np.sin(2 * T))).unseen == ()


@run_cases("added", [{"t_cm": 0.05}, {"t_cm": 0.03, "t_c1": 0.2, "v_d": 0.4}])
def test_the_stall_voltage_holds_all_friction(added: dict[str, float]) -> None:
    """v = r_m T / k_T + v_d, where T is the torque of all friction at the motor."""
    torque = 0.01 + added["t_cm"] + added.get("t_c1", 0.0) / 8
    volts = NOMINAL["r_m"] * torque / NOMINAL["k_T"] + added.get("v_d", 0.0)
    values = {**NOMINAL, "t_f": 0.01, **added}
    rig = with_named(MotorShaft(), added)
    assert stall_voltage(rig, values) == pytest.approx(volts, rel=1e-9)
    assert stall_voltage(MotorShaft(), {**NOMINAL, "t_f": 0.0}) == pytest.approx(0.0, abs=1e-12)
    assert stall_voltage(DrivenShaft(), {}) == 0.0
