"""Where a record is studied before a search: at the start, or where the rig moves as its record does."""

from typing import Any

import numpy as np
import pytest
from support.case_tables import run_cases

import bayesdrill as bd

T = np.linspace(0.0, 3.0, 121)
PUSH = 2.0 * np.sin(3.0 * T)


def uniform(low: float, high: float, **start: float) -> dict[str, Any]:
    return {"prior": "uniform", "low": low, "high": high, **start}


def wide(low: float = 1e-3, high: float = 10.0) -> dict[str, Any]:
    return {"prior": "log_uniform", "low": low, "high": high}


def simulated(
    rig: Any,
    p: dict[str, float],
    channel: str,
    believed: dict[str, Any],
    t_m: np.ndarray | float | None = None,
    initial: dict[str, Any] | None = None,
) -> bd.Case:
    """Return the case of a record at `p` that begins at rest; `initial` is what is believed of it."""
    drives = {} if t_m is None else {"t_m": t_m}
    clean = bd.respond(rig, p, T, drives, channel)[channel]
    sigma = 0.01 * float(np.ptp(clean))
    y = clean + sigma * np.random.default_rng(1).standard_normal(len(T))
    channels = {channel: bd.Channel(y, rig.symbols[channel].unit, sigma)}
    inputs = {name: bd.Input(x, "N*m") for name, x in drives.items()}
    return bd.case(T, channels, inputs, {**p, **believed}, rig=rig, initial=initial or {})


def pendulum(start: float) -> bd.Case:
    """Return one that falls, and whose friction may hold it up to a tilt of about 0.1 from above."""
    rig = bd.Train(inertias=("arm",), gravity=("arm",), added=("t_c_arm", "a_arm"))
    p = {"j_arm": 0.1, "g_arm": 1.0, "t_c_arm": 0.1, "a_arm": 1.2}
    friction, tilt = uniform(0, 1.0), uniform(0, 6.2, start=start)
    believed = {"j_arm": wide(), "t_c_arm": friction, "a_arm": tilt}
    return simulated(rig, p, "theta_arm", believed)


def servo(friction: dict[str, Any]) -> bd.Case:
    """Return a motor that turns both ways, driven by a torque, with dry friction."""
    believed = {"j_m": wide(), "t_cm": friction}
    p = {"j_m": 0.1, "c_m": 0.2, "t_cm": 0.3}
    return simulated(bd.Motor(added=("t_cm",)), p, "w_2", believed, PUSH)


RESTING = {
    "a pendulum": (pendulum(3.1), "theta_arm", {"j_arm", "a_arm"}),
    "a servo": (servo(uniform(0.0, 8.0, start=4.0)), "w_2", {"j_m"}),
}


@run_cases("case, channel, determined", RESTING.values(), RESTING)
def test_a_rig_that_rests_at_the_start_is_studied_where_it_moves(
    case: bd.Case, channel: str, determined: set[str]
) -> None:
    findings = case.identify()
    assert findings.point.inert == (channel,)
    assert findings.text.startswith("AT REST: at the start values the rig does not move")
    assert f"in the record it does ({channel})" in findings.text
    words = zip(findings.study.names, (x.word for x in findings.study.parameters), strict=True)
    assert determined <= {name for name, word in words if word == "determined"}
    assert "the most probable draw with motion, of 128 draws from the priors" in findings.text
    for name, value in zip(case.unknowns, findings.point.theta.tolist(), strict=True):
        assert f"{name} = {value:.4g}" in findings.text
    before, _, _ = case.preview().partition("timing: ")
    assert "AT REST" in before
    assert findings.point.theta == pytest.approx(case.identify().point.theta)  # by the seed


def test_nothing_is_said_of_the_record_where_no_draw_moves_the_rig() -> None:
    """The friction is beyond the drive wherever the priors lead."""
    case = servo(uniform(3.0, 8.0))
    for text in (case.identify().text, case.preview()):
        assert "Nor does it at likely draws from the priors" in text
        assert "left to the prior" not in text
        assert "not at all" not in text


@run_cases(
    "initial, words",
    [
        (
            {"theta_2": "free", "w_2": "free"},
            "every unknown but theta_2_0, which it leaves largely to the prior",
        ),
        ({"w_2": "free"}, "every unknown"),
    ],
)
def test_an_angle_that_is_free_at_the_start_and_not_measured_is_named(
    initial: dict[str, str], words: str
) -> None:
    believed = {"j_m": wide(), "c_m": wide()}
    p = {"j_m": 0.1, "c_m": 0.2}
    case = simulated(bd.Motor(), p, "w_2", believed, PUSH, initial)
    assert f"the record determines {words}" in case.preview()
