"""Where a record is studied before a search: at the start, or where the rig moves as its record does."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support import command_line
from support.case_tables import for_each, run_cases

import bayesdrill as bd
from bayesdrill.analysis.identifiability.information import SensitivityStudy
from bayesdrill.analysis.identifiability.study import study_point

SMALL = command_line.ROOT.parent / "shared" / "cases" / "small"
T = np.linspace(0.0, 3.0, 121)


def uniform(low: float, high: float, **more: float) -> dict[str, Any]:
    return {"prior": "uniform", "low": low, "high": high, **more}


def wide(low: float, high: float, **more: float) -> dict[str, Any]:
    return {"prior": "log_uniform", "low": low, "high": high, **more}


def made(
    rig: Any, p: dict[str, float], channel: str, believed: dict[str, Any], **more: Any
) -> bd.Case:
    """A case of a record that is simulated at `p`, with some noise."""
    inputs, initial = more.get("inputs", {}), more.get("initial", {})
    drives = {name: x.values if isinstance(x, bd.Input) else x for name, x in inputs.items()}
    clean = bd.respond(rig, p, T, drives, channel, initial=initial)[channel]
    sigma = 0.01 * float(np.ptp(clean))
    y = clean + sigma * np.random.default_rng(1).standard_normal(len(T))
    unit = rig.symbols[channel].unit
    given = {**p, **believed}
    return bd.case(
        T,
        {channel: bd.Channel(y, unit, sigma)},
        inputs,
        given,
        rig=rig,
        **{"initial": initial, **more.get("case", {})},
    )


def pendulum(start: float) -> bd.Case:
    """One that falls from rest, and whose friction may hold it: by 0.5 at a tilt of `start`."""
    rig = bd.Train(inertias=("arm",), gravity=("arm",), added=("t_c_arm", "a_arm"))
    p = {"j_arm": 0.1, "g_arm": 1.0, "t_c_arm": 0.1, "a_arm": 1.2}
    believed = {
        "j_arm": wide(1e-3, 10.0),
        "t_c_arm": uniform(0, 1.0),
        "a_arm": uniform(0, 6.2, start=start),
    }
    return made(rig, p, "theta_arm", believed)


def servo(torque: float) -> bd.Case:
    """A motor that turns both ways, driven by a torque, whose friction is believed to be `torque`."""
    rig = bd.Motor(added=("t_cm",))
    push = bd.Input(2.0 * np.sin(3.0 * T), "N*m")
    believed = {"j_m": wide(1e-3, 10.0), "t_cm": uniform(0.0, 8.0, start=torque)}
    return made(rig, {"j_m": 0.1, "c_m": 0.2, "t_cm": 0.3}, "w_2", believed, inputs={"t_m": push})


def cart(speed: float) -> bd.Case:
    """One that rolls out, of whose speed at the beginning no channel says much."""
    rig = bd.Train(motion="linear", inertias=("cart",), added=("c_cart",))
    start = {"prior": "normal", "mean": speed, "sd": 2.0}
    believed = {"c_cart": wide(0.01, 10.0)}
    more = {"initial": {"v_cart": 1.0}, "case": {"initial": {"v_cart": start}}}
    return made(rig, {"m_cart": 1.0, "c_cart": 1.0}, "x_cart", believed, **more)


RESTING = {
    "a pendulum": (pendulum(3.1), "theta_arm", ("j_arm", "a_arm")),
    "a servo": (servo(4.0), "w_2", ("j_m",)),
    "a cart": (cart(0.0), "x_cart", ("c_cart",)),
}
MOVING = {"a pendulum": (pendulum(1.5),), "a servo": (servo(0.5),), "a cart": (cart(0.7),)}


@run_cases("case, channel, determined", RESTING.values(), RESTING)
def test_a_rig_that_rests_at_the_start_is_studied_where_it_moves(
    case: bd.Case, channel: str, determined: tuple[str, ...]
) -> None:
    """Mutant killed: the start all the same, at which the record tells nothing of any parameter."""
    findings = case.identify()
    assert findings.point.still == (channel,)
    assert findings.text.startswith("AT REST: at the start values the rig does not move")
    assert f"in the record it does ({channel})" in findings.text
    names = findings.study.names
    words = dict(zip(names, (x.word for x in findings.study.parameters), strict=True))
    assert {words[name] for name in determined} == {"determined"}
    assert "the likeliest of 128 draws from the priors" in findings.text
    for name, value in zip(case.unknowns, findings.point.theta.tolist(), strict=True):
        assert f"{name} = {value:.4g}" in findings.text
    said = case.preview()
    assert (
        said.index("AT REST") < said.index("timing: ") if "timing: " in said else "AT REST" in said
    )
    assert findings.point.theta == pytest.approx(case.identify().point.theta)  # by the seed


def test_a_rig_that_moves_is_studied_at_the_start() -> None:
    def check(case: bd.Case) -> None:
        posterior = case.job.problem.posterior
        point = study_point(SensitivityStudy(posterior.likelihood), posterior, 0)
        assert (point.at, point.still) == ("the start", ())
        assert point.theta.tolist() == [*posterior.space.start.values()]
        assert "AT REST" not in case.identify().text

    for_each(MOVING, check)


def test_where_no_draw_moves_nothing_is_said_of_the_record() -> None:
    """Friction beyond the drive, wherever the priors lead."""
    held = servo(0.3).job.problem.posterior.likelihood.observations[0].experiment
    case = bd.case(
        T,
        {"w_2": bd.Channel(held.y[:, 0], "rad/s", 0.05)},
        {"t_m": bd.Input(2.0 * np.sin(3.0 * T), "N*m")},
        {"j_m": wide(1e-3, 10.0), "c_m": 0.2, "t_cm": uniform(3.0, 8.0)},
        rig=bd.Motor(added=("t_cm",)),
    )
    for said in (case.identify().text, case.preview()):
        assert "Nor does it at likely draws from the priors" in said
        assert "left to the prior" not in said
        assert "not at all" not in said


def test_a_record_that_rests_itself_is_no_reason() -> None:
    """Noise alone: nothing moves there that the model should move."""
    y = 0.01 * np.random.default_rng(2).standard_normal(len(T))
    case = bd.case(
        T,
        {"w_2": bd.Channel(y, "rad/s", 0.01)},
        {"t_m": 0.1},
        {"j_m": wide(1e-3, 10.0), "c_m": 0.2, "t_cm": uniform(0.0, 8.0)},
        rig=bd.Motor(added=("t_cm",)),
    )
    assert case.identify().point.still == ()


def drill() -> bd.Case:
    """A drive train with a bit in rock that is far stronger than its motor."""
    t, ends = np.arange(100) * 0.05, ("motor", "bit")
    drives, added = {"motor": "current"}, ("c_string",)
    rig = bd.Train(ends, {"string": ends}, drives=drives, rock=("bit",), added=added)
    inputs = {"i_motor": bd.Input(134.13125 * (t > 0.3), "A"), "wob_bit": 105.368323}
    channel = bd.Channel(0.01 * np.sin(t), "rad", wide(0.001, 1))
    believed = {
        "j_motor": wide(1.10709, 996.536),
        "k_string": wide(500.075, 43349),
        "c_string": wide(5.47821, 1212.9),
        "j_bit": 2.02478,
        "k_T_motor": 0.1,
        "b_0_bit": wide(0.659853, 49.4256),
        "b_1_bit": wide(2.17322, 21.9248),
        "b_2_bit": wide(3.19202, 8130.4),
        "b_3_bit": 0.0925623,
    }
    return bd.case(t, {"theta_bit": channel}, inputs, believed, rig=rig)


def test_slopes_that_overflow_tell_nothing_and_break_nothing() -> None:
    """Where rock all but holds the bit, slopes of what is behind a stiff string are no numbers at all.

    Mutant killed: such slopes as they are, of which no decomposition can be made.
    """
    case = drill()
    posterior = case.job.problem.posterior
    sensitivity = SensitivityStudy(posterior.likelihood)
    start = posterior.space.vector(posterior.space.start)
    assert np.isfinite(sensitivity.with_nuisances(start)).all()
    case.preview()
    assert np.isfinite(case.identify().study.information.root).all()


def test_an_unseen_angle_of_a_free_start_is_named() -> None:
    """Mutant killed: `the record determines every unknown`, whatever a start is left to."""
    rig = bd.Motor()
    push = bd.Input(2.0 * np.sin(3.0 * T), "N*m")
    w = bd.respond(rig, {"j_m": 0.1, "c_m": 0.2}, T, {"t_m": push.values}, "w_2")["w_2"]
    y = w + 0.01 * np.random.default_rng(3).standard_normal(len(T))
    believed = {"j_m": wide(1e-3, 10.0), "c_m": wide(1e-3, 10.0)}
    for initial, says in (
        (
            {"theta_2": "free", "w_2": "free"},
            "every parameter of the rig; of sensors and starts it leaves theta_2_0",
        ),
        ({"w_2": "free"}, "every unknown"),
    ):
        case = bd.case(
            T,
            {"w_2": bd.Channel(y, "rad/s", 0.01)},
            {"t_m": push},
            believed,
            rig=rig,
            initial=initial,
        )
        assert f"the record determines {says}" in case.preview()


@pytest.mark.skipif(not SMALL.is_dir(), reason="the records of others are not there")
def test_records_of_others_at_rest_and_with_unseen_angles(tmp_path: Path) -> None:
    for command in ("identify", "check"):
        ran = command_line.cli(command, SMALL / "identify_stuck" / "stuck.yaml")
        assert ran.status == 0, ran.text
        assert (
            "AT REST: at the start values the rig does not move, as friction may hold it" in ran.out
        )
        assert "left to the prior" not in ran.out
        assert "largely to the prior" not in ran.out
        moves = command_line.cli(command, SMALL / "identify_stuck" / "moves.yaml")
        assert moves.status == 0, moves.text
        assert "AT REST" not in moves.out
    ran = command_line.cli("check", SMALL / "every_unknown" / "config.yaml")
    assert ran.status == 0, ran.text
    assert "the record determines every parameter of the rig; of sensors" in ran.out
    assert "it leaves theta_motor_0 largely to the prior" in ran.out
