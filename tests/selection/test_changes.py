"""Changes of a config: what may be tried of a job, and what its config says then."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ruamel.yaml import YAML
from support.command_line import small_config
from support.scipy_oracles import ORDER
from support.small_problems import starts_believed
from support.unexplained_records import write

import bayesdrill as bd
from bayesdrill.analysis.edits import with_gear
from bayesdrill.config.job import Job, prepare
from bayesdrill.inference import compression
from bayesdrill.inference.step_error import with_steps
from bayesdrill.selection.candidates import CandidateModels
from bayesdrill.tasks import ranking

T = 0.01 * np.arange(80)
SWING = np.cos(9.0 * T)
J = "{prior: log_uniform, low: 1.0e-3, high: 1.0}"
MOTOR_NUMBERS = "{j_hub: J, k_T_hub: 1.0, r_hub: 1.0, c_hub: 0.3}"
ARM = {"theta_arm": "rad"}
HUB = {"w_hub": "rad/s"}
DRIVEN = "inputs: {u_hub: {column: u, unit: V}}"


@starts_believed()
def job(folder: Path, channels: dict[str, str], rest: str, parameters: str) -> Job:
    """`channels`: units by name, each of a column of its name."""
    entries = ", ".join(f"{n}: {{column: {n}, unit: {u}, sigma: 0.1}}" for n, u in channels.items())
    text = (
        "name: case\nseed: 1\n"
        f"record:\n  file: record.csv\n  time: {{column: t, unit: s}}\n  channels: {{{entries}}}\n"
        f"{rest}\nparameters: {parameters.replace('J', J)}\n"
    )
    columns = {name: SWING + 0.1 * k for k, name in enumerate(channels)}
    folder.mkdir(parents=True, exist_ok=True)
    return prepare(write(folder, text, {"t": T, "u": SWING, **columns}))


def motor(
    folder: Path, inputs: str = DRIVEN, channels: dict[str, str] = HUB, numbers: str = MOTOR_NUMBERS
) -> Job:
    """A hub that a voltage drives."""
    model = "model: {name: train, inertias: [hub], drives: {hub: voltage}}"
    return job(folder, channels, f"{inputs}\n{model}", numbers)


def pendulum(folder: Path, start: str, channels: dict[str, str] = ARM) -> Job:
    """An arm that swings from its start."""
    model = "model: {name: train, inertias: [arm], gravity: [arm]}"
    rest = f"inputs: {{}}\ninitial: {start}\n{model}"
    return job(folder, channels, rest, "{j_arm: J, g_arm: 1.0, c_arm: 0.01}")


def models_of(job: Job) -> CandidateModels:
    """Return all candidates; a bare `CandidateModels` has those that need no motion of the rig."""
    return CandidateModels.from_job(job, {})


@starts_believed()
def changed(models: CandidateModels, name: str, **numbers: float) -> tuple[dict[str, Any], Job]:
    """Return the lines of a candidate, and its job."""
    (candidate,) = models.with_numbers(**numbers).rungs([(name,)])
    return YAML(typ="safe").load(candidate.config_lines), candidate.job()


def test_no_lag_is_tried_where_nothing_fixes_time(tmp_path: Path) -> None:
    """An input that changes does, or one that is switched on at a known start, or another channel."""
    late = f"{DRIVEN[:-1]}, t_0: {{prior: uniform, low: -0.1, high: 0.1}}}}"
    both = {"theta_arm": "rad", "w_arm": "rad/s"}
    step, free = "inputs: {u_hub: 3.0}", "\ninitial: free"
    for of, lags in (
        (pendulum(tmp_path, "free"), set()),
        (pendulum(tmp_path, "{theta_arm: 0.5}"), set()),
        (pendulum(tmp_path, "free", both), {"lag_theta_arm", "lag_w_arm"}),
        (motor(tmp_path), {"lag_w_hub"}),
        (motor(tmp_path, DRIVEN + free), {"lag_w_hub"}),
        (motor(tmp_path, step), {"lag_w_hub"}),
        (motor(tmp_path, step + free), set()),
        (motor(tmp_path, late), set()),
    ):
        names = {name for candidate in CandidateModels(of).singles() for name in candidate.names}
        assert {name for name in names if name.startswith("lag")} == lags, of.source.text


def test_a_lag_is_sought_within_a_tenth_of_the_record(tmp_path: Path) -> None:
    _, late = changed(CandidateModels(motor(tmp_path)), "lag_w_hub")
    prior = late.problem.posterior.space.priors["lag_w_hub"]
    assert (prior.low, prior.high) == pytest.approx((-0.079, 0.079))


def test_all_channels_are_not_late_together(tmp_path: Path) -> None:
    models = CandidateModels(motor(tmp_path, channels={**HUB, "theta_hub": "rad"}))
    assert models.possible(("lag_w_hub", "lag_theta_hub"))
    assert models.possible(("lag_w_hub", "t_0"))
    assert not models.possible(("lag_w_hub", "lag_theta_hub", "t_0"))
    assert not models.possible(("sign_w_hub", "gain_w_hub"))


def test_a_sign_is_turned_and_columns_are_exchanged(tmp_path: Path) -> None:
    numbers = ", ".join(f"{name}: nominal" for name in ORDER if name != "j_1")
    channels, inputs = {"w_1": "rad/s", "w_2": "rpm"}, "inputs: {v: 8.0}"
    of = job(tmp_path, channels, inputs, f"{{j_1: J, {numbers}}}")
    posterior, models = of.problem.posterior, CandidateModels(of)
    lines, turned = changed(models, "sign_w_2")
    assert lines == {"record": {"channels": {"w_2": {"gain": -1.0}}}}
    theta = posterior.space.vector(posterior.space.start)[None]
    after = turned.problem.posterior.likelihood.signals(theta)[0]
    np.testing.assert_allclose(after, posterior.likelihood.signals(theta)[0] * [1.0, -1.0])
    lines, exchanged = changed(models, "exchange_w_1_w_2")
    assert lines["record"]["channels"] == {
        "w_1": {"column": "w_2", "unit": "rpm"},
        "w_2": {"column": "w_1", "unit": "rad/s"},
    }
    y = of.problem.experiment.y
    np.testing.assert_allclose(exchanged.problem.experiment.y, y[:, ::-1])


def test_a_clock_is_multiplied(tmp_path: Path) -> None:
    """Of a column of times and of a rate; where all have one clock there is nothing to try."""
    own_clock = "V, file: record.csv, time: {column: t, unit: s}}"
    of = motor(tmp_path, DRIVEN.replace("V}", own_clock))
    models = CandidateModels(of)
    assert models.clocks == ("clock",)
    lines, slower = changed(models, "clock", clock=0.98)
    assert lines == {"record": {"time": {"scale": 0.98}}}
    record = slower.problem.experiment
    np.testing.assert_allclose(record.t[record.is_measured[:, 0]], 0.98 * T)
    supply = np.interp(T[:60], record.t, record.series["u_hub"])
    np.testing.assert_allclose(supply, SWING[:60], atol=0.1)
    of.source.data["record"]["time"] = {"rate": 100.0}
    lines, _ = changed(models, "clock", clock=0.98)
    assert lines == {"record": {"time": {"rate": pytest.approx(100.0 / 0.98, rel=1e-5)}}}
    assert CandidateModels(motor(tmp_path)).clocks == ()


def test_a_record_begins_later_from_an_unknown_state(tmp_path: Path) -> None:
    lines, later = changed(CandidateModels(pendulum(tmp_path, "{}")), "later", later=0.1)
    assert lines["initial"] == "free"
    assert later.problem.experiment.t[[0, -1]] == pytest.approx([0.1, T[-1]])
    assert "theta_arm_0" in later.problem.names


def test_a_prior_is_widened_at_the_end_that_is_reached(tmp_path: Path) -> None:
    inputs = f"{DRIVEN[:-1]}, t_0: {{prior: uniform, low: -0.02, high: 0.03}}}}"
    numbers = "{j_hub: J, k_T_hub: 1.0, r_hub: {prior: uniform, low: 0.0, high: 2.0}}"
    of = CandidateModels(motor(tmp_path, inputs, numbers=numbers))
    assert changed(of, "prior_t_0", prior_t_0=1)[0] == {"inputs": {"t_0": {"high": 0.08}}}
    assert changed(of, "prior_t_0", prior_t_0=-1)[0] == {"inputs": {"t_0": {"low": -0.07}}}
    assert changed(of, "prior_j_hub", prior_j_hub=1)[0] == {"parameters": {"j_hub": {"high": 10.0}}}
    assert of.with_numbers(prior_r_hub=-1).rungs([("prior_r_hub",)]) == []


@starts_believed()
def test_candidates_are_fitted_to_the_first_samples_of_a_long_record(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """40 samples count as enough here."""
    whole = motor(tmp_path)
    assert ranking.excerpt(whole) is whole
    monkeypatch.setattr(compression, "is_long", lambda observation: True)
    monkeypatch.setattr(compression, "EXCERPT", 40)
    (candidate,) = models_of(ranking.excerpt(whole)).rungs([("friction_hub",)])
    (observation,) = candidate.job().problem.observations
    assert observation.experiment.t == pytest.approx(T[:40])


def test_a_train_gets_one_more_inertia_at_each(tmp_path: Path) -> None:
    """It begins as the inertia beside it does."""
    lines, longer = changed(models_of(pendulum(tmp_path, "{theta_arm: 0.5}")), "inertia_arm")
    assert lines["model"]["inertias"] == ["arm", "arm_end"]
    assert lines["initial"] == {"theta_arm_end": 0.5}
    assert {"j_arm_end", "k_arm_end_spring", "c_arm_end_spring"} <= {*longer.problem.names}
    (candidate,) = models_of(pendulum(tmp_path, "free")).rungs([("inertia_arm",)])
    assert candidate.owner("theta_arm_end_0") == candidate.owner("j_arm_end") == "inertia_arm"
    assert candidate.owner("theta_arm_0") == "free_start"
    assert models_of(pendulum(tmp_path, "{}")).rungs([("gravity_arm",)]) == []  # has it already


def test_dry_friction_is_sought_beyond_the_largest_torque_of_the_motor(tmp_path: Path) -> None:
    """It is 1 N m here; a root mean square would end before a friction that nearly stops the motor."""
    lines, _ = changed(models_of(motor(tmp_path)), "friction_hub")
    assert lines["parameters"]["t_c_hub"]["high"] > 1.0


def test_a_train_gets_gravity_on_each_inertia_without_it(tmp_path: Path) -> None:
    lines, hanging = changed(models_of(motor(tmp_path)), "gravity_hub")
    assert lines["model"] == {"gravity": ["hub"]}
    assert hanging.problem.names == ("j_hub", "g_hub")


def test_friction_backwards_has_the_prior_of_that_forwards(tmp_path: Path) -> None:
    """Where the config has none, both are sought, each up to what acts as strongly as all else."""
    numbers = "{j_hub: J, k_T_hub: 1.0, r_hub: 1.0, c_hub: 0.3, t_c_hub: J}"
    models = models_of(motor(tmp_path, numbers=numbers))
    lines, other = changed(models, "direction_hub")
    prior = {"prior": "log_uniform", "low": 1.0e-3, "high": 1.0}
    assert lines["parameters"] == {"t_c_hub_backward": prior}
    assert "t_c_hub_backward" in other.problem.names
    damping = changed(models, "direction_damping_hub")[0]["parameters"]
    assert damping == {"c_hub_backward": {"prior": "log_uniform", "low": 0.03, "high": 3.0}}
    lines, _ = changed(models_of(motor(tmp_path)), "direction_hub")
    assert [*lines["parameters"]] == ["t_c_hub", "t_c_hub_backward"]
    first, second = lines["parameters"].values()
    assert first == second
    constant = "{j_hub: J, k_T_hub: 1.0, r_hub: 1.0, c_hub: 0.3, t_c_hub: J, t_f_hub: J}"
    surplus = replace(models, job=motor(tmp_path, numbers=constant))
    assert surplus.rungs([("direction_hub",)]) == []  # a third number for two sizes


def test_neutral_physics_changes_no_likelihood(tmp_path: Path) -> None:
    """Candidates of a kind share kernels: what each has beside its own does nothing."""
    noisy = (("rad, sigma: 0.05", "rad, sigma: 1"), ("rad/s, sigma: 0.05", "rad/s, sigma: 1"))
    with starts_believed():
        models = models_of(prepare(small_config(tmp_path, *noisy)))
    wanted = ("friction_motor", "drag_rotor_1", "damping_shaft", "load_friction_motor")
    for candidate in models.rungs((name,) for name in wanted):
        assert candidate.neutral
        with starts_believed():
            jobs = (candidate.job(), candidate.job(shared=True))
        # In fine steps, as laws act in the middle of each.
        alone, shared = (with_steps(each.problem.posterior, {"": (256, 4)}) for each in jobs)
        start = alone.space.vector(alone.space.start)[None]
        expected = pytest.approx(float(alone.likelihood(start)[0]), abs=1e-3)
        assert float(shared.likelihood(start)[0]) == expected, candidate.names


def test_another_gear_is_other_numbers_at_the_motor() -> None:
    """The likelihood is that of a rig with that gear, friction and drag at the motor included."""
    nominal = bd.nominal() | {"t_cm": 0.02, "t_sm": 0.03, "w_sm": 5.0, "d_m": 1e-5}
    box = {"prior": "uniform", "low": 0.5, "high": 1.5, "relative": True}
    channels = {"w_1": bd.Channel(5.0 * SWING, "rad/s", 0.3)}
    inputs = {"v": bd.Input(6.0 * SWING, "V")}
    parameters = {**nominal, **dict.fromkeys(("k_e", "j_m", "k_s"), box)}
    here, there = (
        bd.case(
            T,
            channels,
            inputs,
            parameters,
            rig=bd.MotorShaft(i_m=i_m, added=("t_cm", "t_sm", "w_sm", "d_m")),
            nominal=nominal,
        ).job.problem.posterior
        for i_m in (0.125, 0.05)
    )
    theta = here.space.vector(here.space.start)[None] * 1.1
    same = float(with_gear(here, 0.4).likelihood(theta)[0])
    assert same == pytest.approx(float(there.likelihood(theta)[0]), rel=1e-7)
    assert same != pytest.approx(float(here.likelihood(theta)[0]), rel=1e-3)


def test_a_servo_without_a_limit_is_tried_with_one(tmp_path: Path) -> None:
    model = "model: {name: train, inertias: [hub], drives: {hub: servo}}"
    inputs = "inputs: {goal_hub: {column: u, unit: rad}}"
    numbers = "{j_hub: J, k_T_hub: 1.0, r_hub: 1.0, supply_hub: 12.0, duty_hub: 0.5, c_hub: 0.3}"
    models = CandidateModels(job(tmp_path, HUB, f"{inputs}\n{model}", numbers))
    lines, limited = changed(models, "saturation_hub")
    assert lines["parameters"] == {"limit_hub": {"prior": "uniform", "low": 0.0, "high": 1.0}}
    assert limited.problem.model.saturation is not None
    lines, limited = changed(models, "goal_speed_hub")
    assert lines["parameters"]["w_goal_hub"]["prior"] == "log_uniform"
    assert limited.problem.model.saturation.speed == "w_goal_hub"
