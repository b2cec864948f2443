"""Servos: against the closed loop in closed form, and an integration from event to event."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import scipy.linalg
from support.case_tables import run_cases, slow_except
from support.document_blocks import ROOT
from support.servo_oracle import Servo
from support.small_problems import starts_believed
from support.state_records import record_of_states

import bayesdrill as bd
from bayesdrill.analysis.identifiability.information import SensitivityStudy
from bayesdrill.analysis.plausibility import plausibility_of_course
from bayesdrill.analysis.record_findings import findings_of_record
from bayesdrill.analysis.suspicions import find_reference, suspicions_of_problem
from bayesdrill.basics.arrays import Array
from bayesdrill.basics.errors import InputError
from bayesdrill.inference.posterior import Problem
from bayesdrill.report.findings import finding_sentences
from bayesdrill.rig.models.linear import with_named
from bayesdrill.rig.models.train import Train
from bayesdrill.rig.simulators import simulator
from bayesdrill.rig.simulators.contract import Simulator
from bayesdrill.rig.simulators.linear import Response
from bayesdrill.rig.simulators.sensors import ObservationModel

ARM = Train(inertias=("arm",), drives={"arm": "servo"})
MEASURED = Train(inertias=("arm",), drives={"arm": {"servo": 12.0}})
PENDULUM = Train(inertias=("arm",), drives={"arm": "servo"}, gravity=("arm",))
PLAIN = {"j_arm": 0.03, "k_T_arm": 2.4, "r_arm": 4.9, "k_e_arm": 2.4, "supply_arm": 12.0,
         "duty_arm": 0.16, "k_p_arm": 16.0, "k_d_arm": 0.05}  # fmt: skip
LIMITED = {**PLAIN, "limit_arm": 0.4}
RUBBING = {**LIMITED, "t_c_arm": 0.35, "t_c_arm_backward": 0.2}
# All physics; the goal jumps, as it may move at any speed.
ALL = {**RUBBING, "t_s_arm": 0.45, "w_s_arm": 0.3, "band_arm": 0.02, "c_arm": 0.05,
       "w_goal_arm": 1e12}  # fmt: skip
SERVOS = {
    "both": {**LIMITED, "band_arm": 0.03},
    "friction": RUBBING,
    "supply": {name: value for name, value in ALL.items() if name != "supply_arm"},
    "all": ALL,
}
FOLLOWING = {**ALL, "w_goal_arm": 3.0}
# Of no effect: no goal demands a hundred times the supply.
NEUTRAL = dict.fromkeys(ALL.keys() - PLAIN.keys(), 0.0) | {
    "supply_arm": 1200.0, "duty_arm": 0.0016, "limit_arm": 1.0, "w_s_arm": 1.0,
}  # fmt: skip
SHOWN = ["theta_arm", "w_arm"]
GOALS, TIME = (0.6, -0.3, 0.1, 1.2, 0.0, -0.9, -0.85, 0.4), 0.4
SUPPLIES = (12.0, 10.5, 13.0, 9.0, 11.8, 12.4, 10.0, 11.0)  # volts, between jumps of the goal


def response(
    train: Train, values: dict[str, float], samples: int, *, slope: float = 0.0
) -> tuple[Simulator, Array]:
    """A servo that is at rest at first, whose goal jumps, or rises; `samples` between two jumps.

    Where its supply is measured, this jumps too.
    """
    rig = with_named(train, [*values])
    t = np.linspace(0.0, TIME * len(GOALS), samples * len(GOALS) + 1)
    series = {"goal_arm": slope * t if slope else np.append(np.repeat(GOALS, samples), GOALS[-1])}
    if "supply_arm" in rig.inputs:
        series["supply_arm"] = np.append(np.repeat(SUPPLIES, samples), SUPPLIES[-1])
    record = record_of_states(rig, t, series, first_order=slope > 0.0)
    full = np.array([[values[name] for name in rig.parameters]])
    return simulator(rig, record, ObservationModel()), full


def oracle(values: dict[str, float]) -> Servo:
    def both(name: str) -> tuple[float, float]:
        forward = values.get(name, 0.0)
        return forward, values.get(f"{name}_backward", forward)

    def between_jumps(levels: tuple[float, ...]) -> Callable[[float], float]:
        return lambda t: levels[min(int((t + 1e-12) / TIME), len(levels) - 1)]

    supplies = (values["supply_arm"],) if "supply_arm" in values else SUPPLIES
    return Servo(
        j=values["j_arm"], k=values["k_T_arm"], r=values["r_arm"], k_e=values["k_e_arm"],
        g=values.get("g_arm", 0.0), c=both("c_arm"), t_c=both("t_c_arm"),
        t_s=both("t_s_arm") if "t_s_arm" in values else None, w_s=values.get("w_s_arm", 1.0),
        supply=between_jumps(supplies), gain=values["duty_arm"], k_p=values["k_p_arm"],
        k_d=values["k_d_arm"], limit=values.get("limit_arm", np.inf),
        band=values.get("band_arm", 0.0),
        goal=between_jumps(GOALS),
    )  # fmt: skip


def closed_loop() -> Array:
    """Return the rates of angle, speed, goal and slope of the goal, without a limit of the servo."""
    v = PLAIN  # J w' = (k/r) (supply duty (k_p (goal - theta) - k_d w) - k_e w)
    push = v["k_T_arm"] / v["r_arm"] / v["j_arm"]
    stiff = push * v["supply_arm"] * v["duty_arm"]
    brake = push * v["k_e_arm"] + stiff * v["k_d_arm"]
    rates = np.diag([1.0, 0.0, 1.0], 1)
    rates[1, :3] = -stiff * v["k_p_arm"], -brake, stiff * v["k_p_arm"]
    return rates


def test_a_servo_without_a_limit_is_a_linear_closed_loop() -> None:
    """Its response is that of exact steps."""
    assert Train(inertias=("a", "b"), drives={"a": "servo", "b": "servo"}).smooth
    made, full = response(ARM, PLAIN, 20)
    assert isinstance(made, Response)
    step = scipy.linalg.expm(closed_loop() * TIME / 20)
    x, expected = np.zeros(2), [np.zeros(2)]
    for goal in np.repeat(GOALS, 20):
        x = (step @ [*x, goal, 0.0])[:2]
        expected.append(x)
    assert made.signals(full)[0] == pytest.approx(np.array(expected), abs=1e-11)


@pytest.mark.parametrize("kind", slow_except(("supply", "all"), SERVOS))
def test_a_servo_that_saturates_moves_as_from_event_to_event(kind: str) -> None:
    """At one step to a sample: 1e-6 of the swing, and of second order in the step."""
    values, corners = SERVOS[kind], TIME * np.arange(1, len(GOALS))
    errors = []
    for samples in (100, 1000):
        made, full = response(ARM if "supply_arm" in values else MEASURED, values, samples)
        t, y = made.experiment.t, made.signals(full)[0]
        shown = slice(None, None, samples // 20)
        truth = oracle(values).simulate(t[shown], corners=corners)
        errors.append(np.abs(y[shown] - truth).max(axis=0) / np.ptp(truth, axis=0))
    (angle, speed), coarse = errors[1], errors[0]
    assert angle < 1e-6
    assert speed < 5e-6
    assert coarse[0] / angle > 50


@run_cases("speed, apart", [(4.0, 1e-6), (1e6, 2e-5)])
def test_a_servo_follows_a_goal_at_its_largest_speed(speed: float, apart: float) -> None:
    """A goal that jumps is a ramp of that speed, as a ramp of many small steps; or else the jump."""
    t, fine = np.linspace(0.0, 2.4, 481), 20
    goal = np.where(t < 0.5, 0.0, np.where(t < 1.3, 1.0, -0.5))
    followed, most = [0.0], speed * t[1] / fine
    for aim in np.repeat(goal[:-1], fine):
        followed.append(followed[-1] + np.clip(aim - followed[-1], -most, most))
    middle = np.array(followed) + np.append(np.diff(followed) / 2, 0.0)
    ramp = middle if most < 1.0 else np.append(np.repeat(goal[:-1], fine), goal[-1])
    many = np.linspace(0.0, t[-1], len(ramp))
    rig, limited = with_named(ARM, [*PLAIN]), {**PLAIN, **NEUTRAL, "w_goal_arm": speed}
    expected = bd.respond(rig, PLAIN, many, {"goal_arm": ramp}, SHOWN)["theta_arm"]
    rig = with_named(ARM, [*limited])
    reference = rig.saturation.reference(limited, t, goal)
    assert reference == pytest.approx(np.array(followed)[::fine], abs=1e-12)
    y = bd.respond(rig, limited, t, {"goal_arm": goal}, SHOWN)["theta_arm"]
    assert y == pytest.approx(expected[::fine], abs=apart)


def test_the_reference_of_a_straight_goal_is_straight_within_steps() -> None:
    """A ramp that is slower than the largest speed is followed without any delay."""
    made, full = response(ARM, {**PLAIN, "w_goal_arm": 3.0}, 20, slope=2.0)
    exact = [scipy.linalg.expm(closed_loop() * t)[:2, 3] * 2.0 for t in made.experiment.t]
    assert made.signals(full)[0] == pytest.approx(np.array(exact), abs=1e-10)


def test_slopes_of_a_servo_are_differences_of_its_signals() -> None:
    made, full = response(ARM, FOLLOWING, 50)
    names = with_named(ARM, [*FOLLOWING]).parameters
    for name in ("duty_arm", "supply_arm", "limit_arm", "j_arm", "k_e_arm", "w_goal_arm"):
        step = np.zeros_like(full)
        step[0, names.index(name)] = 1e-6 * FOLLOWING[name]
        _, slopes = made.course(full, step[:, None])
        later, before = (made.signals(full + way * step)[0] for way in (0.5, -0.5))
        assert slopes[0, 0] == pytest.approx(later - before, abs=1e-4 * np.ptp(later - before))


def test_a_channel_between_steps_is_the_servo_at_its_own_time() -> None:
    """It is read from the course between steps, with the rates of the loop as it is there."""
    late = ObservationModel(lags={"theta_arm": "lag_theta_arm"})

    def angle(samples: int, lag: float) -> Array:
        made, full = response(PENDULUM, {**SERVOS["both"], "g_arm": 1.2}, samples)
        told = np.append(full, [[lag * made.experiment.dt]], axis=1)
        return simulator(made.model, made.experiment, late).signals(told)[0][:, 0]

    assert angle(200, 0.3)[1:] == pytest.approx(angle(2000, 0.0)[7::10], abs=2e-5)


def test_gains_and_offsets_of_inputs_act_on_the_supply_and_on_the_speed_of_the_goal() -> None:
    made, full = response(MEASURED, {**SERVOS["supply"], "w_goal_arm": 3.0}, 20)
    sensing = ObservationModel(
        input_gains={"supply_arm": "a", "goal_arm": "b"}, input_offsets={"supply_arm": "c"}
    )
    supply, goal = (made.experiment.series[name] for name in ("supply_arm", "goal_arm"))

    def shown(a: float, b: float, c: float) -> Array:
        series = {"supply_arm": (supply - c) / a, "goal_arm": goal / b}
        rig = simulator(made.model, replace(made.experiment, series=series), sensing)
        own = [{"a": a, "b": b, "c": c}[name] for name in sensing.names]
        return rig.signals(np.array([[*full[0], *own]]))

    assert shown(0.8, -0.5, 0.5) == pytest.approx(shown(1.0, 1.0, 0.0), abs=1e-12)


def test_a_measured_supply_of_a_servo_without_a_usual_one_is_refused_with_its_entry(
    tmp_path: Path,
) -> None:
    text = (ROOT / "configs" / "example_servo.yaml").read_text()
    config = tmp_path / "servo.yaml"
    config.write_text(text.replace("{horn: {servo: 12}}", "{horn: servo}"))
    with pytest.raises(InputError, match=r"write `horn: \{servo: 12\}` in `drives:`"):
        bd.load(config)


def test_a_supply_that_stays_at_its_usual_value_is_no_input() -> None:
    t = 0.004 * np.arange(300)
    goal = {"goal_arm": np.where(t < 0.6, 0.6, 0.0)}
    rows = [
        bd.respond(with_named(train, [*own]), own, t, goal | more, SHOWN)
        for train, own, more in (
            (ARM, ALL, {}),
            (MEASURED, SERVOS["supply"], {"supply_arm": np.full(300, 12.0)}),
            (MEASURED, SERVOS["supply"], {"supply_arm": 12.0}),
        )
    ]
    for row in rows[1:]:
        assert row["theta_arm"] == pytest.approx(rows[0]["theta_arm"], abs=1e-12)


@starts_believed()
def following(t: Array, goal: Array, values: dict[str, float]) -> Problem:
    """Return that of an arm of unknown inertia, whose angle is recorded without noise."""
    rig = with_named(ARM, [*values])
    y = bd.respond(rig, values, t, {"goal_arm": goal}, SHOWN)["theta_arm"]
    channels = {"theta_arm": bd.Channel(y, "rad", sigma=0.01)}
    inputs = {"goal_arm": bd.Input(-goal, "rad", gain=-1.0)}
    unknown = {"j_arm": {"prior": "log_uniform", "low": 0.01, "high": 0.1}}
    return bd.case(t, channels, inputs, values | unknown, rig=rig).job.problem


@run_cases("limited", [True, False])
def test_check_says_how_often_a_servo_saturates(limited: bool) -> None:
    """Of a goal far away at first: half of the supply would be exceeded until it is near."""
    values = {**PLAIN, "k_d_arm": 0.0, **({"limit_arm": 0.5} if limited else {})}
    t = 0.004 * np.arange(401)
    goal = np.where(t < 0.8, 0.6, 0.0)
    problem = following(t, goal, values)
    duty = values["duty_arm"] * values["k_p_arm"] * (goal - problem.experiment.y[:, 0])
    share = 100.0 * float(np.mean(np.abs(duty) > (0.5 if limited else 1.0)))
    posterior = problem.posterior
    theta = posterior.space.vector({"j_arm": values["j_arm"]})
    (finding,) = plausibility_of_course(SensitivityStudy(posterior.likelihood), theta)
    assert finding.numbers["percent"] == pytest.approx(share, abs=0.3)
    assert 3.0 < share < 50.0
    assert [*suspicions_of_problem(problem)] == []
    said = "saturates in" if limited else "Name limit_arm"
    assert said in finding_sentences([finding])[0]


@run_cases(
    "factor, expected",
    [(1, []), (-1, ["opposite signs"]), (57.3, ["unit of a goal"]), (1 / 57.3, ["unit of a goal"])],
)
def test_an_angle_with_another_sign_or_unit_than_its_goal(factor: float, expected: list) -> None:
    t = 0.01 * np.arange(800)
    problem = following(t, np.where(np.sin(3 * t) > 0, -0.5, 0.2), {**PLAIN, "limit_arm": 0.4})
    of = problem.experiment
    of = replace(of, y=factor * of.y, series={"goal_arm": -of.series["goal_arm"]})
    gears = {"box": {"between": ("arm", "load"), "ratio": -1.0}}
    reversing = Train(inertias=("arm", "load"), gears=gears, drives={"arm": "servo"})
    turned = replace(of.channels[0], weights={"theta_load": -1.0})
    for record, rig in ((of, problem.model), (replace(of, channels=(turned,)), reversing)):
        assert [finding.kind for finding in findings_of_record(record, rig)] == expected


def test_a_goal_that_the_angle_follows_is_no_reference_in_place_of_a_voltage() -> None:
    """The advice to record a voltage instead would be wrong: the loop is in the model."""
    t = 0.01 * np.arange(401)
    goal = np.sin(2.0 * t)
    unexplained: Any = SimpleNamespace(experiment="", channel="theta_arm", share=1.0)
    assert find_reference(following(t, goal, PLAIN), [unexplained]) is None
