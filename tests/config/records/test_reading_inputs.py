"""Inputs of rigs that no voltage drives: as columns, or as an angle that is imposed."""

from pathlib import Path

import numpy as np
import pytest
from support.case_tables import run_cases
from support.config_texts import DRILL_T, TOP_ANGLE, TOP_SPEED, TORQUE, save, write_shaft
from support.small_problems import starts_believed

from bayesdrill.config import loading
from bayesdrill.config.job import prepare
from bayesdrill.config.records import reading, simulation
from bayesdrill.rig.simulators.stepped import Stepped

TOP = "w_2: {column: top, unit: rpm}"
IMPOSED = (TOP, "theta_2: {column: angle, unit: deg}")


@starts_believed()
def test_measured_inputs_are_converted_to_si(tmp_path: Path) -> None:
    law = ("  k_s: {", "  b_0: 1.0e-3\n  b_1: 2\n  b_2: 5\n  b_3: 5\n  k_s: {")
    weight = ("inputs:\n", "inputs:\n  wob: {column: weight, unit: kN}\n")
    problem = prepare(write_shaft(tmp_path, law, weight)).problem
    series = problem.experiment.series
    assert [*series] == ["t_1", "w_2", "wob"]
    assert problem.experiment.constant == {}
    assert series["w_2"] == pytest.approx(TOP_SPEED, rel=1e-9)
    assert series["t_1"] == pytest.approx(TORQUE, rel=1e-9)
    assert series["wob"] == pytest.approx(1e3 * (500 + DRILL_T), rel=1e-9)
    assert isinstance(problem.observations[0].response, Stepped)


@run_cases("column, wraps", [("angle", ""), ("turned", ", wraps: true")])
@starts_believed()
def test_an_imposed_angle_is_its_speed_between_samples(
    column: str, wraps: str, tmp_path: Path
) -> None:
    entry = f"theta_2: {{column: {column}, unit: deg{wraps}}}"
    problem = prepare(write_shaft(tmp_path, (TOP, entry))).problem
    experiment, rates = problem.experiment, np.diff(TOP_ANGLE) / np.diff(DRILL_T)
    assert experiment.series["w_2"][:-1] == pytest.approx(rates, rel=1e-8)
    first = TOP_ANGLE[0] % (2 * np.pi) if wraps else TOP_ANGLE[0]
    assert experiment.start == {"theta_2": pytest.approx(first, rel=1e-9)}
    assert not experiment.first_order
    assert "theta_2_0" not in problem.names


@starts_believed()
def test_an_imposed_angle_may_have_times_of_its_own(tmp_path: Path) -> None:
    """Every 70 ms; the bit every 10 ms, from somewhere between on."""
    slow = 4.97 + 0.07 * np.arange(32)
    course = 3.0 + 9.0 * (slow - 5.0) + np.sin(4.0 * slow)
    save(tmp_path, "top.csv", t=slow, x=course)
    own = (TOP, "theta_2: {file: top.csv, column: x, unit: rad}")
    window = ("  channels:", "  window: [5.0, 6.99]\n  channels:")
    experiment = prepare(write_shaft(tmp_path, own, window)).problem.experiment
    last = np.searchsorted(slow, experiment.t + 1e-6) - 1
    assert experiment.series["w_2"] == pytest.approx((np.diff(course) / 0.07)[last], rel=1e-8)
    first = np.interp(experiment.t[0], slow, course)
    assert experiment.start["theta_2"] == pytest.approx(first)


@starts_believed()
def test_a_free_start_frees_no_imposed_angle(tmp_path: Path) -> None:
    start = ("initial: {", "initial: {state: free, ")
    assert "theta_2_0" in prepare(write_shaft(tmp_path, start)).problem.names
    assert "theta_2_0" not in prepare(write_shaft(tmp_path, start, IMPOSED)).problem.names


@run_cases("changes, moved", [((), "top"), ((IMPOSED,), "angle")])
def test_a_simulated_record_has_its_inputs_in_the_units_of_their_columns(
    changes: tuple[tuple[str, str], ...], moved: str, tmp_path: Path
) -> None:
    case = loading.load(write_shaft(tmp_path, *changes))
    before = reading.read(case.experiments[0])
    (tmp_path / "drill.csv").write_text(simulation.simulate(case, seed=1))
    after = reading.read(case.experiments[0])
    for name, series in before.series.items():
        assert after.series[name] == pytest.approx(series, rel=1e-5), name
    assert after.start == pytest.approx(before.start)
    head = (tmp_path / "drill.csv").read_text().splitlines()[0]
    assert head.split(",") == ["t", "bit", "torque", moved]
