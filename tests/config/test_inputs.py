"""Inputs of rigs that no voltage drives: as columns, as an imposed angle, each with its lag."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.case_tables import for_each
from support.config_mistakes import check_mistakes

import bayesdrill as bd
from bayesdrill.basics.errors import InputError
from bayesdrill.config import loading
from bayesdrill.config.job import Job, prepare
from bayesdrill.config.records import reading, simulation
from bayesdrill.rig.simulators.stepped import Stepped

SHAFT = """\
name: shaft
seed: 4
record:
  file: drill.csv
  time: {column: t, unit: s}
  channels:
    w_1: {column: bit, unit: rpm, sigma: 2}
inputs:
  w_2: {column: top, unit: rpm}
  t_1: {column: torque, unit: mN*m}
initial: {w_1: {prior: normal, mean: 90, sd: 20, unit: rpm}, theta_1: {prior: normal, mean: 0, sd: 1}}
model: {name: driven_shaft}
parameters:
  k_s: {prior: uniform, low: 1, high: 9}
  j_1: 8.0e-3
simulation: {truth: {w_1_0: 95, theta_1_0: -0.4}}
"""
T = 5.0 + 0.01 * np.arange(200)
SPEED = 9.0 + 3.0 * np.sin(18.0 * T)
ANGLE = 140.0 + 9.0 * (T - 5.0) - np.cos(18.0 * T) / 6.0
RPM, DEG = 2 * np.pi / 60, np.pi / 180
TORQUE = 1.9 + 0.8 * np.sin(18.0 * T + 1.0)
TOP = ("w_2: {column: top, unit: rpm}", "theta_2: {column: angle, unit: deg}")
LOAD = "t_1: {column: torque, unit: mN*m"
LAGGED = (LOAD, f"{LOAD}, lag: {{prior: uniform, low: -40, high: 60, unit: ms}}")
K_S, NO_LAW = "  k_s: {", "  b_0: 1.0e-3\n  b_1: 2\n  b_2: 5\n  b_3: 5\n"
LAW = (K_S, NO_LAW + K_S)


def save(folder: Path, name: str = "drill.csv", **columns: np.ndarray) -> None:
    rows = np.column_stack(list(columns.values()))
    head = ",".join(columns)
    np.savetxt(folder / name, rows, "%.12g", ",", header=head, comments="")


def write(folder: Path, *changes: tuple[str, str]) -> Path:
    bit = SPEED / RPM + np.random.default_rng(1).standard_normal(len(T))
    save(
        folder, t=T, top=SPEED / RPM, angle=ANGLE / DEG, turned=(ANGLE / DEG) % 360.0,
        torque=1e3 * TORQUE, weight=500 + T, bit=bit,
    )  # fmt: skip
    text = SHAFT
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new)
    (folder / "shaft.yaml").write_text(text, encoding="utf-8")
    return folder / "shaft.yaml"


def built(folder: Path, *changes: tuple[str, str]) -> Job:
    return prepare(write(folder, *changes))


def test_a_mistake_is_told_at_its_entry(tmp_path_factory: pytest.TempPathFactory) -> None:
    check_mistakes("inputs", tmp_path_factory, built)


MOTOR = """\
name: motor
seed: 4
record:
  {file: drill.csv, time: {column: t, unit: s}, channels: {w_2: {column: bit, unit: rpm, sigma: 2}}}
inputs: {t_m: {column: torque, unit: mN*m}}
model: {name: motor}
parameters: {j_m: {prior: uniform, low: 1, high: 9}, c_m: 0.1}
"""


def test_what_drives_a_motor_follows_from_its_parameters(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    cases = [
        (
            "{t_m: {column: torque, unit: mN*m}}",
            "{v: 8}",
            [
                "inputs.t_m: missing: the model wants the torque that the motor is driven with",
                "inputs.v: the model motor has no such input; remove it (its own: t_m), or name k_e",
            ],
        ),
        (
            "j_m: {",
            "k_e: 0.1, r_m: 1, j_m: {",
            ["parameters.k_e: k_e means nothing without k_T and l_m"],
        ),
        (
            "j_m: {",
            "k_e: 0.1, k_T: 0.1, r_m: 1, l_m: 1, j_m: {",
            [
                "inputs.t_m: the model motor has no such input; remove it (its own: v)",
                "inputs.v: this entry is missing",
            ],
        ),
        ("mN*m}}", "mN*m}, t_1: 0.1}", ["inputs.t_1: the model motor has no such input"]),
        ("{name: motor}", "{name: motor, i_m: 8}", ["8:1 meant? Then write 0.125"]),
    ]

    def check(old: str, new: str, says: list[str]) -> None:
        tmp_path = tmp_path_factory.mktemp("case")
        write(tmp_path)
        assert old in MOTOR
        (tmp_path / "motor.yaml").write_text(MOTOR.replace(old, new))
        with pytest.raises(InputError) as caught:
            prepare(tmp_path / "motor.yaml")
        problems = sorted(str(one) for one in caught.value.problems)
        assert len(problems) == len(says), problems
        for problem, said in zip(problems, says, strict=True):
            assert said in problem

    for_each({str(case): case for case in cases}, check)


def test_units_are_those_of_the_columns(tmp_path: Path) -> None:
    found = built(tmp_path, LAW, ("inputs:\n", "inputs:\n  wob: {column: weight, unit: kN}\n"))
    one = found.problem.experiment
    assert [*one.series] == ["t_1", "w_2", "wob"]
    assert one.constant == {}
    assert one.series["w_2"] == pytest.approx(SPEED, rel=1e-9)
    assert one.series["t_1"] == pytest.approx(TORQUE, rel=1e-9)
    assert one.series["wob"] == pytest.approx(1e3 * (500 + T), rel=1e-9)
    assert isinstance(found.problem.observations[0].response, Stepped)


def test_an_imposed_angle_is_its_speed_between_samples(tmp_path: Path) -> None:
    """However it wraps.  Mutants killed: the angle for its speed, a start at zero."""
    rates = np.diff(ANGLE) / np.diff(T)
    for column in ("angle", "turned, wraps: true"):
        found = built(tmp_path, (TOP[0], TOP[1].replace("angle", column)))
        one = found.problem.experiment
        assert one.series["w_2"][:-1] == pytest.approx(rates, rel=1e-8)
        first = ANGLE[0] if column == "angle" else ANGLE[0] % (2 * np.pi)
        assert one.start == {"theta_2": pytest.approx(first, rel=1e-9)}
        assert not one.first_order
        assert "theta_2_0" not in found.problem.names


def test_an_imposed_angle_may_be_read_at_times_of_its_own(tmp_path: Path) -> None:
    """Every 70 ms; the bit every 10 ms, from somewhere between on."""
    slow = 4.97 + 0.07 * np.arange(32)
    course = 3.0 + 9.0 * (slow - 5.0) + np.sin(4.0 * slow)
    path = write(tmp_path, (TOP[0], "theta_2: {file: top.csv, column: x, unit: rad}"))
    save(tmp_path, "top.csv", t=slow, x=course)
    text = path.read_text().replace("  channels:", "  window: [5.0, 6.99]\n  channels:")
    path.write_text(text)
    one = prepare(path).problem.experiment
    rates = np.diff(course) / 0.07
    inside = one.t + 1e-6
    assert one.series["w_2"] == pytest.approx(rates[np.searchsorted(slow, inside) - 1], rel=1e-8)
    assert one.start["theta_2"] == pytest.approx(np.interp(one.t[0], slow, course))


def test_a_free_start_leaves_an_imposed_angle_alone(tmp_path: Path) -> None:
    start = ("initial: {", "initial: {state: free, ")
    assert "theta_2_0" in built(tmp_path, start).problem.names
    assert "theta_2_0" not in built(tmp_path, start, TOP).problem.names


def test_missing_samples_of_an_imposed_angle_are_bridged_straight(tmp_path: Path) -> None:
    path = write(tmp_path, (TOP[0], "theta_2: {column: angle, unit: deg, missing: hold}"))
    rows = (tmp_path / "drill.csv").read_text().splitlines()
    for k in (51, 52):
        cells = rows[k].split(",")
        rows[k] = ",".join([*cells[:2], "", *cells[3:]])
    (tmp_path / "drill.csv").write_text("\n".join(rows) + "\n")
    one = prepare(path).problem.experiment
    assert one.series["w_2"][49:52] == pytest.approx((ANGLE[52] - ANGLE[49]) / 0.03, rel=1e-8)
    assert any("theta_2: 2 samples are bridged" in said for said in one.told)


def test_a_simulated_record_reads_back(tmp_path_factory: pytest.TempPathFactory) -> None:
    """With what moved it, in the units of its columns."""

    def check(imposed: bool) -> None:
        tmp_path = tmp_path_factory.mktemp("case")
        path = write(tmp_path, *([TOP] if imposed else []))
        case = loading.load(path)
        before = reading.read(case.experiments[0])
        (tmp_path / "drill.csv").write_text(simulation.simulate(case, seed=1))
        after = reading.read(case.experiments[0])
        for name, series in before.series.items():
            assert after.series[name] == pytest.approx(series, rel=1e-5), name
        assert after.start == pytest.approx(before.start)
        head = (tmp_path / "drill.csv").read_text().splitlines()[0]
        assert head.split(",") == ["t", "bit", "torque", "angle" if imposed else "top"]

    for_each({str(imposed): (imposed,) for imposed in [False, True]}, check)


def test_one_measured_input_has_the_delay_of_all(tmp_path: Path) -> None:
    """As it was before several could be late; of several, each has its own.

    Mutant killed: the lag of one input for the delay of all.
    """
    alone = (TOP[0], "w_2: 9.0")
    sensing = built(tmp_path, alone, LAGGED).problem.observations[0].response.sensing
    assert (sensing.delay, sensing.input_lags) == ("lag_t_1", {})
    found = built(tmp_path, LAGGED).problem
    sensing = found.observations[0].response.sensing
    assert (sensing.delay, sensing.input_lags) == (None, {"t_1": "lag_t_1"})
    assert sensing.summary == "t_1: lag"
    prior = found.posterior.space.priors["lag_t_1"]
    assert (prior.low, prior.high) == pytest.approx((-0.04, 0.06))


def test_what_no_record_tells_of_a_late_input_is_left_out(tmp_path: Path) -> None:
    """A moving rig's first 60 ms, which a torque from before the record may have moved, and the last 40,
    whose torque may stand after its end.  Mutant killed: samples after the last that an input tells.
    """
    one = built(tmp_path, LAGGED).problem.experiment
    seen = one.t[one.seen[:, 0]]
    assert (seen[0], seen[-1]) == pytest.approx((5.06, 6.95))
    assert any("before the start (lag)" in said for said in one.told)
    assert any("after the end of the record (lag)" in said for said in one.told)
    at_rest = ("initial: {w_1: {prior: normal, mean: 90, sd: 20, unit: rpm}, theta_1: {prior: normal, "
               "mean: 0, sd: 1}}\n", "")  # fmt: skip
    still = ("simulation: {truth: {w_1_0: 95, theta_1_0: -0.4}}\n", "")
    one = built(tmp_path, LAGGED, at_rest, still).problem.experiment
    assert one.t[one.seen[:, 0]][[0, -1]] == pytest.approx((5.0, 6.95))


def test_init_says_what_else_may_move_a_rig_of_which_no_column_is_a_voltage(tmp_path: Path) -> None:
    columns = {"t [s]": T, "bit [rad/s]": SPEED[::-1], "load [N*m]": TORQUE}
    save(tmp_path, "bit.csv", **columns)
    save(tmp_path, "both.csv", **columns, **{"top [rad/s]": SPEED})
    said = []
    for name in ("both", "bit"):
        bd.init(tmp_path / f"{name}.csv")
        said.append((tmp_path / f"{name}.yaml").read_text())
    assert all("say `--rig driven_shaft`" in " ".join(t.replace("#", "").split()) for t in said)
