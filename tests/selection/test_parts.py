"""Parts of candidates: what may be tried of a job, and what its config says then."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ruamel.yaml import YAML
from support.case_tables import for_each
from support.unexplained_records import write

import bayesdrill as bd
from bayesdrill.config.job import Job, prepare
from bayesdrill.inference.step_error import with_steps
from bayesdrill.selection.candidates import CandidateModels

T = 0.01 * np.arange(80)
SWING = np.cos(9.0 * T)
DRIVEN = "inputs: {u_hub: {column: u, unit: V}}"
MOTOR = "model: {name: train, inertias: [hub], drives: {hub: voltage}}"
MOTOR_NUMBERS = "{j_hub: J, k_T_hub: 1.0, r_hub: 1.0, c_hub: 0.3}"
PENDULUM = "model: {name: train, inertias: [arm], gravity: [arm]}"
PENDULUM_NUMBERS = "{j_arm: J, g_arm: 1.0, c_arm: 0.01}"
J = "{prior: log_uniform, low: 1.0e-3, high: 1.0}"


def job(folder: Path, channels: dict[str, str], rest: str, parameters: str, more: str = "") -> Job:
    """`channels`: units by name, each of a column of its name."""
    folder.mkdir(parents=True, exist_ok=True)
    said = ", ".join(f"{n}: {{column: {n}, unit: {u}, sigma: 0.1}}" for n, u in channels.items())
    text = (
        "name: case\nseed: 1\n"
        f"record:\n  file: record.csv\n  time: {{column: t, unit: s}}\n  channels: {{{said}}}\n"
        f"{rest}\nparameters: {parameters.replace('J', J)}\n{more}"
    )
    columns = {"t": T, "u": SWING, **{name: SWING + 0.1 * k for k, name in enumerate(channels)}}
    return prepare(write(folder, text, columns))


def parts(of: Job) -> set[str]:
    return {rung.name for rung in CandidateModels.from_job(of, {}).singles()}


def test_no_lag_is_tried_where_nothing_fixes_time(tmp_path_factory: pytest.TempPathFactory) -> None:
    """An input that changes does, or one that is switched on at a known start, or another channel.

    Mutants killed: a lag of the only channel of a free swing; one beside a delay of all inputs.
    """
    free, given = "initial: free", "initial: {theta_arm: 0.5}"
    one, two = {"theta_arm": "rad"}, {"theta_arm": "rad", "w_arm": "rad/s"}
    hub, step = {"w_hub": "rad/s"}, "inputs: {u_hub: 3.0}"
    late = "inputs: {u_hub: {column: u, unit: V}, t_0: {prior: uniform, low: -0.1, high: 0.1}}"
    cases = {
        "free swing": (one, f"inputs: {{}}\n{free}\n{PENDULUM}", PENDULUM_NUMBERS, set()),
        "let go": (one, f"inputs: {{}}\n{given}\n{PENDULUM}", PENDULUM_NUMBERS, set()),
        "two channels": (
            two,
            f"inputs: {{}}\n{free}\n{PENDULUM}",
            PENDULUM_NUMBERS,
            {"lag_theta_arm", "lag_w_arm"},
        ),
        "driven": (hub, f"{DRIVEN}\n{MOTOR}", MOTOR_NUMBERS, {"lag_w_hub"}),
        "driven and free": (hub, f"{DRIVEN}\n{free}\n{MOTOR}", MOTOR_NUMBERS, {"lag_w_hub"}),
        "a step": (hub, f"{step}\n{MOTOR}", MOTOR_NUMBERS, {"lag_w_hub"}),
        "a step, free": (hub, f"{step}\n{free}\n{MOTOR}", MOTOR_NUMBERS, set()),
        "late already": (hub, f"{late}\n{MOTOR}", MOTOR_NUMBERS, set()),
    }

    def check(channels: dict[str, str], rest: str, parameters: str, lags: set[str]) -> None:
        of = job(tmp_path_factory.mktemp("lag"), channels, rest, parameters)
        assert {name for name in parts(of) if name.startswith("lag")} == lags

    for_each(cases, check)


def test_a_lag_is_sought_within_a_tenth_of_the_record(tmp_path: Path) -> None:
    made = CandidateModels.from_job(
        job(tmp_path, {"w_hub": "rad/s"}, f"{DRIVEN}\n{MOTOR}", MOTOR_NUMBERS), {}
    )
    (rung,) = made.rungs([("lag_w_hub",)])
    prior = rung.job().problem.posterior.space.priors["lag_w_hub"]
    assert (prior.low, prior.high) == pytest.approx((-0.079, 0.079))


def test_all_channels_are_not_late_together(tmp_path: Path) -> None:
    """Mutant killed: lags of all channels beside one of the inputs."""
    channels = {"w_hub": "rad/s", "theta_hub": "rad"}
    made = CandidateModels.from_job(
        job(tmp_path, channels, f"{DRIVEN}\n{MOTOR}", MOTOR_NUMBERS), {}
    )
    assert made.possible(("lag_w_hub", "lag_theta_hub"))
    assert made.possible(("lag_w_hub", "t_0"))
    assert not made.possible(("lag_w_hub", "lag_theta_hub", "t_0"))
    assert not made.possible(("sign_w_hub", "gain_w_hub"))


def test_another_gear_is_sought_where_a_shaft_is_behind_it(tmp_path: Path) -> None:
    from bayesdrill.analysis.refits import refit_candidate
    from bayesdrill.basics.progress import SILENT
    from bayesdrill.sampling.workers import WorkerPool
    from bayesdrill.tasks.ranking import Ranking

    def constants(of: Job) -> set[str]:
        start = of.problem.posterior.space.start
        given = refit_candidate(of.problem.posterior, start, -np.inf)
        assert given is not None
        with WorkerPool(of.problem.posterior, 1) as pool:
            return {
                n for n, _ in Ranking(of, start, given, pool.submit_function, SILENT)._constants()
            }

    alone = "inputs: {t_m: {column: u, unit: N*m}}\nmodel: {name: motor, i_m: 0.1}"
    assert constants(job(tmp_path / "motor", {"w_2": "rad/s"}, alone, "{j_m: J, c_m: 0.1}")) == {
        "later"
    }
    shaft = "inputs: {v: {column: u, unit: V}}\nmodel: {name: motor_shaft}\nnominal: tables_2_3"
    numbers = "{k_s: J, " + ", ".join(
        f"{name}: nominal" for name in ("j_m", "c_m", "k_e", "k_T", "r_m", "l_m", "j_1", "t_f")
    )
    assert constants(job(tmp_path / "shaft", {"w_2": "rad/s"}, shaft, numbers + "}")) == {
        "gear",
        "later",
    }


def changed(of: Job, name: str, **numbers: float) -> tuple[dict[str, Any], Job]:
    """The lines of a candidate, and its job."""
    made = CandidateModels.from_job(of, {}).with_numbers(**numbers)
    (rung,) = made.rungs([(name,)])
    return YAML(typ="safe").load(rung.lines), rung.job()


def test_a_sign_is_turned_and_columns_are_exchanged(tmp_path: Path) -> None:
    """Mutants killed: a gain of 1; the column of one alone; units that stay behind."""
    model = "model: {name: train, inertias: [hub, rim], shafts: {s: [hub, rim]}, drives: {hub: voltage}}"
    numbers = "{j_hub: J, j_rim: 0.1, k_s: 3.0, k_T_hub: 1.0, r_hub: 1.0}"
    of = job(tmp_path, {"w_hub": "rad/s", "w_rim": "rpm"}, f"{DRIVEN}\n{model}", numbers)
    y = of.problem.experiment.y
    lines, turned = changed(of, "sign_w_rim")
    assert lines == {"record": {"channels": {"w_rim": {"gain": -1.0}}}}
    theta = of.problem.posterior.space.vector(of.problem.posterior.space.start)[None]
    before, after = (each.problem.posterior.likelihood.signals(theta)[0] for each in (of, turned))
    np.testing.assert_allclose(after, before * [1.0, -1.0])
    lines, exchanged = changed(of, "exchange_w_hub_w_rim")
    channels = lines["record"]["channels"]
    assert channels["w_hub"] == {"column": "w_rim", "unit": "rpm"}
    assert channels["w_rim"] == {"column": "w_hub", "unit": "rad/s"}
    np.testing.assert_allclose(exchanged.problem.experiment.y, y[:, ::-1])


def test_a_clock_is_multiplied(tmp_path: Path) -> None:
    """Of a column of times and of a rate; where all have one clock there is nothing to try.

    Mutants killed: times that are divided; the clock of the input with that of the record.
    """
    own = "inputs: {u_hub: {column: u, unit: V, file: record.csv, time: {column: t, unit: s}}}"
    of = job(tmp_path, {"w_hub": "rad/s"}, f"{own}\n{MOTOR}", MOTOR_NUMBERS)
    assert CandidateModels.from_job(of, {}).clocks == ("clock",)
    lines, made = changed(of, "clock", clock=0.98)
    assert lines == {"record": {"time": {"scale": 0.98}}}
    record = made.problem.experiment
    seen = record.t[record.seen[:, 0]]
    np.testing.assert_allclose(seen, 0.98 * T)
    np.testing.assert_allclose(
        np.interp(T[:60], record.t, record.series["u_hub"]), SWING[:60], atol=0.1
    )
    data = of.source.data
    data["record"]["time"] = {"rate": 100.0}
    lines, made = changed(of, "clock", clock=0.98)
    assert lines == {"record": {"time": {"rate": pytest.approx(100.0 / 0.98, rel=1e-5)}}}
    alone = job(tmp_path / "one", {"w_hub": "rad/s"}, f"{DRIVEN}\n{MOTOR}", MOTOR_NUMBERS)
    assert CandidateModels.from_job(alone, {}).clocks == ()


def test_a_record_begins_later_from_an_unknown_state(tmp_path: Path) -> None:
    of = job(tmp_path, {"theta_arm": "rad"}, f"inputs: {{}}\n{PENDULUM}", PENDULUM_NUMBERS)
    lines, made = changed(of, "later", later=0.1)
    assert lines["initial"] == "free"
    assert made.problem.experiment.t[0] == pytest.approx(0.1)
    assert made.problem.experiment.t[-1] == pytest.approx(T[-1])
    assert "theta_arm_0" in made.problem.names


def test_a_prior_is_widened_at_the_end_that_is_reached(tmp_path: Path) -> None:
    """Mutants killed: the other end; an end beyond zero of what is positive."""
    inputs = "inputs: {u_hub: {column: u, unit: V}, t_0: {prior: uniform, low: -0.02, high: 0.03}}"
    numbers = "{j_hub: J, k_T_hub: 1.0, r_hub: {prior: uniform, low: 0.0, high: 2.0}}"
    of = job(tmp_path, {"w_hub": "rad/s"}, f"{inputs}\n{MOTOR}", numbers)
    assert changed(of, "prior_t_0", prior_t_0=1)[0] == {"inputs": {"t_0": {"high": 0.08}}}
    assert changed(of, "prior_t_0", prior_t_0=-1)[0] == {"inputs": {"t_0": {"low": -0.07}}}
    assert changed(of, "prior_j_hub", prior_j_hub=1)[0] == {"parameters": {"j_hub": {"high": 10.0}}}
    made = CandidateModels.from_job(of, {}).with_numbers(prior_r_hub=-1)
    assert made.rungs([("prior_r_hub",)]) == []


def test_a_train_gets_one_more_inertia_where_each_turns(tmp_path: Path) -> None:
    """It begins as the inertia beside it does.  Mutant killed: a spring that is twisted."""
    start = "initial: {theta_arm: 0.5}"
    of = job(tmp_path, {"theta_arm": "rad"}, f"inputs: {{}}\n{start}\n{PENDULUM}", PENDULUM_NUMBERS)
    lines, made = changed(of, "inertia_arm")
    assert lines["model"]["inertias"] == ["arm", "arm_end"]
    assert lines["initial"] == {"theta_arm_end": 0.5}
    assert {"j_arm_end", "k_arm_end_spring", "c_arm_end_spring"} <= {*made.problem.names}


def test_neutral_physics_changes_no_likelihood(tmp_path: Path) -> None:
    """Candidates of a kind share kernels: what each has beside its own does nothing.

    Mutants killed: an efficiency of zero, friction that is not zero.
    """
    model = (
        "model: {name: train, inertias: [hub, arm, rim], gears: {g: {between: [hub, arm], ratio: 0.2}}, "
        "shafts: {s: [arm, rim]}, drives: {hub: voltage}}"
    )
    numbers = "{j_hub: J, j_arm: 0.1, j_rim: 0.1, k_s: 3.0, k_T_hub: 1.0, r_hub: 1.0}"
    of = job(tmp_path, {"w_rim": "rad/s"}, f"{DRIVEN}\n{model}", numbers)
    made = CandidateModels.from_job(of, {})
    wanted = {"friction_hub", "drag_rim", "damping_rim", "load_friction_hub"}
    rungs = [rung for rung in made.singles() if rung.name in wanted]
    assert {rung.name for rung in rungs} == wanted
    for rung in rungs:
        assert rung.neutral
        posteriors = [each.problem.posterior for each in (rung.job(), rung.job(shared=True))]
        start = posteriors[0].space.vector(posteriors[0].space.start)
        fine = [
            with_steps(each, {"": (64, 4)}) for each in posteriors
        ]  # laws in the middle of steps
        alone, shared = (float(posterior.likelihood(start[None])[0]) for posterior in fine)
        assert shared == pytest.approx(alone, abs=1e-3), rung.name


def test_another_gear_is_other_numbers_at_the_motor() -> None:
    """The likelihood is that of a rig with that gear, friction and drag at the motor included.

    Mutants killed: a constant of the motor that stays; a power of the wrong sign.
    """
    from bayesdrill.analysis.edits import with_gear

    v = 6.0 * SWING
    given = bd.nominal() | {"t_cm": 0.02, "t_sm": 0.03, "w_sm": 5.0, "d_m": 1e-5}
    box = {"prior": "uniform", "low": 0.5, "high": 1.5, "relative": True}

    def case(i_m: float) -> bd.Case:
        return bd.case(
            T,
            {"w_1": bd.Channel(5.0 * SWING, "rad/s", 0.3)},
            {"v": bd.Input(v, "V")},
            {**given, "k_e": box, "j_m": box, "k_s": box},
            rig=bd.MotorShaft(i_m=i_m, added=("t_cm", "t_sm", "w_sm", "d_m")),
            nominal=given,
        )

    here, there = (case(i_m).job.problem.posterior for i_m in (0.125, 0.05))
    theta = here.space.vector(here.space.start)[None] * 1.1
    same = float(with_gear(here, 0.4).likelihood(theta)[0])
    assert same == pytest.approx(float(there.likelihood(theta)[0]), rel=1e-7)
    assert same != pytest.approx(float(here.likelihood(theta)[0]), rel=1e-3)
