"""Designs keep their limits, and batches of experiments complement each other."""

import csv
from pathlib import Path

import numpy as np
import pytest
import yaml
from support.array_cases import BOX, NOMINAL, two
from support.command_line import ROOT
from support.small_problems import starts_believed

import bayesdrill as bd
from bayesdrill.tasks.design import coming_config

PRODUCTS = ("k_s/j_1", "k_s/j_m", "c_m/j_m", "t_f/j_m", "k_e", "r_m/l_m", "k_T/(j_m*l_m)")


@pytest.mark.slow
def test_the_design_of_the_bundled_rig_is_far_sharper_than_its_step() -> None:
    """The figures are those of a search by exchange in plain NumPy, without code of the package."""
    case = bd.load("configs/nominal_step.yaml")
    designed = case.design(PRODUCTS, high=12.0, hold=0.25, limits="w_2=0:", draws=1)
    criteria = designed.design.criteria
    assert criteria["as recorded"] == pytest.approx(-75.1, abs=0.1)
    assert criteria["designed"] <= -97.5
    assert designed.design.targets[0].after["as recorded"] == pytest.approx(6.8e-5, rel=0.02)
    source = designed.design.request.source
    inputs = {"v": source.series(designed.levels), "t_1": 0.0}
    values = {**NOMINAL, **bd.nominal()}
    w_2 = bd.respond(bd.MotorShaft(i_m=1 / 8), values, source.t, inputs, ["w_2"])["w_2"]
    assert w_2.min() >= -1e-6 * 30.0
    assert designed.levels.min() >= 0.0
    assert designed.levels.max() <= 12.0


def test_limits_and_slew_are_kept() -> None:
    numbers = {"high": 12.0, "hold": 0.5, "slew": 10.0, "draws": 1, "duration": 4.0}
    limits = ["w_2=0:12", "theta_1 - theta_2=-1.5:3"]
    designed = two().design(limits=limits, **numbers)
    steps = np.diff(designed.levels, prepend=0.0)
    assert np.abs(steps).max() <= 10.0 * 0.5 + 1e-9
    assert designed.design.kept >= 0.99
    source, values = designed.design.request.source, {**NOMINAL, **bd.nominal()}
    inputs, names = {"v": source.series(designed.levels), "t_1": 0.0}, ["w_2", "theta_1", "theta_2"]
    states = bd.respond(bd.MotorShaft(i_m=1 / 8), values, source.t, inputs, names)
    twist = states["theta_1"] - states["theta_2"]
    assert states["w_2"].min() >= -1e-4
    assert states["w_2"].max() <= 12.001
    assert twist.min() >= -1.501
    assert twist.max() <= 3.001


@pytest.mark.slow
def test_the_heat_over_the_run_is_limited_and_used() -> None:
    """Heat in the winding, integrated on a finer grid of another solver, is what the limit allows."""
    case, allowed = two(), 10.0
    numbers = {"high": 12.0, "hold": 0.5, "draws": 1, "duration": 3.0}
    designed = case.design(limits=f"integral(r_m*i**2)=:{allowed}", **numbers)
    source, values = designed.design.request.source, {**NOMINAL, **bd.nominal()}
    t = np.linspace(0.0, source.t[-1], 100 * (len(source.t) - 1) + 1)
    held = np.minimum((t / source.interval + 1e-9).astype(int), source.count - 1)
    inputs = {"v": designed.levels[held], "t_1": 0.0}
    i = bd.respond(bd.MotorShaft(i_m=1 / 8), values, t, inputs, ["i"])["i"]
    assert np.trapezoid(values["r_m"] * i**2, t) == pytest.approx(allowed, rel=0.05)
    free = case.design(**numbers).design.criteria["designed"]
    assert designed.design.criteria["designed"] > free
    assert designed.design.kept >= 0.99


def test_the_coming_config_keeps_the_sensor_of_the_input() -> None:
    """The promise has one offset of the voltage in all records, and so has their fit."""
    offset = {"prior": "normal", "mean": 0.0, "sd": 100.0}
    start = {"prior": "normal", "mean": 0.0, "sd": 1.0}
    inputs = {"v": {"value": 5000.0, "unit": "mV", "offset": offset}}
    designed = two().design(family="step", hold=0.5, duration=2.0, draws=1, experiments=2)
    with starts_believed():
        text = coming_config(two(inputs=inputs, initial={"w_1": start}).job, designed.design)
    coming = yaml.safe_load(text)
    column = {"column": "v", "unit": "mV", "hold": "zero"}
    assert coming["inputs"]["v"] == column | {"offset": offset}
    assert coming["shared"] == ["offset_v"]
    assert "waveform.csv (v in V) at 40 Hz into record_1.csv, record_2.csv" in text


def test_a_batch_of_experiments_is_sharper_than_a_repeated_one(tmp_path: Path) -> None:
    """Within short experiments one waveform cannot serve all targets, so that others complement it."""
    case = two()
    numbers = {"high": 12.0, "hold": 0.5, "duration": 2.0, "draws": 1, "limits": "w_1=:99"}
    designed = case.design(experiments=2, **numbers)
    single = case.design(**numbers).design
    criteria = designed.design.criteria
    assert designed.levels.shape == (2, 4)
    np.testing.assert_array_equal(designed.levels[0], single.levels[0])  # by the seed
    assert criteria["designed"] <= criteria["repeated"] + 1e-9
    # Twice the record has half the variance of each of both targets.
    once = single.criteria["designed"]
    assert criteria["repeated"] == pytest.approx(once - 2.0 * np.log(2.0), abs=0.01)
    designed.save(tmp_path)
    waveform = np.genfromtxt(tmp_path / "waveform.csv", delimiter=",", names=True)
    assert waveform.dtype.names == ("t", "v_1", "v_2")
    for number in (1, 2):
        rows = np.random.default_rng(number).standard_normal((81, 4))
        rows[:, 0] = np.arange(81) / 40.0
        path, header = tmp_path / f"record_{number}.csv", "t,v,theta_2,w_1"
        np.savetxt(path, rows, delimiter=",", header=header, comments="")
    with starts_believed():
        coming = bd.load(tmp_path / "coming.yaml").job.problem
    assert [x.label for x in coming.observations] == ["coming_1", "coming_2"]


def test_an_experiment_promises_at_least_the_present_knowledge() -> None:
    """The linear response is far off, as the damping may have any of six orders of magnitude."""
    c_m = {"prior": "log_uniform", "low": 1e-7, "high": 0.1}
    case = two(parameters=dict.fromkeys(NOMINAL, "nominal") | {"k_s": BOX, "c_m": c_m})
    numbers = {"high": 0.3, "hold": 0.5, "duration": 2.0, "draws": 1, "family": "prbs"}
    for target in case.design(("k_s", "c_m"), **numbers).design.targets:
        assert max(target.after.values()) <= target.now


def test_friction_wants_coasts_or_reversals_rather_than_a_step() -> None:
    """Viscous and dry friction differ in how they depend on the speed, which a step does not show."""
    priors = dict.fromkeys(NOMINAL, "nominal") | {"t_f": 1e-6, "k_s": BOX, "c_m": BOX}
    priors["t_cm"] = {"prior": "log_uniform", "low": 0.01, "high": 0.2}
    case = two(parameters=priors)
    numbers = {"low": -12.0, "high": 12.0, "hold": 0.1, "duration": 1.5, "draws": 1}
    designed = case.design(("t_cm", "c_m"), experiments=3, **numbers)
    assert designed.design.criteria["designed"] < -13.6  # -13.1 without starts at earlier designs
    for target in designed.design.targets:
        assert target.designed < 0.3 * target.after["step"], target.name
    assert designed.levels.min() <= 0.0
    assert np.ptp(designed.levels) >= 12.0


@pytest.mark.slow
def test_the_promise_for_the_bundled_record_is_what_its_published_run_has() -> None:
    """`k_e` depends by a curve on `c_m`, which stays between the ends of its prior."""
    published = {}
    for table in ("summary.csv", "derived.csv"):
        with (ROOT / "results/published/nominal_step" / table).open(encoding="utf-8") as file:
            rows = csv.DictReader(file)
            published |= {row["name"]: float(row["sd"]) / abs(float(row["mean"])) for row in rows}
    case = bd.load("configs/nominal_step.yaml")
    formulas = {"k_s_over_j_1": "k_s/j_1", "k_T_over_r_m_k_s": "k_T/(r_m*k_s)"}
    formulas |= {"j_m_over_k_s": "j_m/k_s", "k_e": "k_e"}
    designed = case.design([*formulas.values()], hold=1.0, family="step", draws=1)
    for (name, formula), target in zip(formulas.items(), designed.design.targets, strict=True):
        assert target.name == formula
        assert abs(target.after["as recorded"] / published[name] - 1.0) < 0.05, formula
