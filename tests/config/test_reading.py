"""From files to experiments: units, combinations, windows, inputs, real records."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import scipy.io

from bayesdrill.basics.errors import InputError
from bayesdrill.config import loading
from bayesdrill.config.records import reading
from bayesdrill.config.resolve import assembly
from bayesdrill.record.experiment import Experiment

DATA = Path(__file__).parents[3] / "shared" / "data"
PARAMETERS = (
    "parameters:\n  k_e: {prior: uniform, low: 0.5, high: 1.5, relative: true}\n"
    + "".join(
        f"  {name}: nominal\n" for name in ("j_m", "c_m", "k_T", "r_m", "l_m", "k_s", "j_1", "t_f")
    )
)


def read(folder: Path, record: str, inputs: str = "{v: 8}", rest: str = "") -> Experiment:
    path = folder / "mine.yaml"
    path.write_text(f"name: mine\nseed: 1\nrecord:\n{record}\ninputs: {inputs}\n{PARAMETERS}{rest}")
    return reading.read(loading.load(path).experiments[0])


def table(folder: Path, n: int = 50) -> np.ndarray:
    """Time in ms from 120 ms, an angle in degrees, two speeds in rpm, a voltage in mV."""
    rng = np.random.default_rng(2)
    values = np.column_stack(
        [
            120 + 4.0 * np.arange(n),
            rng.normal(30, 200, n),
            rng.normal(100, 9, (n, 2)),
            8e3 + np.arange(n),
        ]
    )
    header = "ms;twist;w_1;speed 2;mV"
    np.savetxt(folder / "r.csv", values, "%.12g", ";", header=header, comments="")
    return values


RECORD = """\
  file: r.csv
  time: {column: ms, unit: ms}
  channels:
    twist: {column: twist, unit: deg, measures: theta_1 - theta_2, sigma: 2}
    w_1: {column: w_1, unit: rpm, sigma: {prior: log_uniform, low: 0.1, high: 10}}
    motor: {column: 4, unit: rpm, measures: 8*w_2, sigma: 1.5}"""


def test_everything_arrives_in_si(tmp_path: Path) -> None:
    raw = table(tmp_path)
    found = read(
        tmp_path, RECORD, "{v: {column: mV, unit: mV, hold: first}, t_1: {value: 20, unit: mN*m}}"
    )
    assert found.t == pytest.approx(raw[:, 0] / 1000)
    assert found.dt == pytest.approx(0.004)
    assert found.y[:, 0] == pytest.approx(np.radians(raw[:, 1]))
    assert found.y[:, 1:] == pytest.approx(raw[:, 2:4] * 2 * np.pi / 60)
    assert found.series["v"] == pytest.approx(raw[:, 4] / 1000)
    assert found.constant == {"t_1": pytest.approx(0.02)}
    assert found.first_order
    assert found.t_start == found.t[0]
    assert [c.weights for c in found.channels] == [
        {"theta_1": 1.0, "theta_2": -1.0}, {"w_1": 1.0}, {"w_2": 8.0},
    ]  # fmt: skip
    assert [c.unit for c in found.channels] == ["rad", "rad/s", "rad/s"]
    with pytest.raises(ValueError, match="read-only"):
        found.y[0, 0] = 1.0


def test_sigma_and_its_prior_are_in_the_columns_unit(tmp_path: Path) -> None:
    table(tmp_path)
    experiment = read(tmp_path, RECORD)
    problem = assembly.build_problem(loading.load(tmp_path / "mine.yaml"), [experiment])
    noise = problem.posterior.likelihood.only_observation.noise
    assert noise.known == {0: pytest.approx(np.radians(2)), 2: pytest.approx(1.5 * np.pi / 30)}
    assert problem.names == ("k_e", "sigma_w_1")
    prior = problem.posterior.space.priors["sigma_w_1"]
    assert (prior.low, prior.high) == (pytest.approx(np.pi / 300), pytest.approx(np.pi / 3))
    assert problem.posterior.space.start["sigma_w_1"] == pytest.approx(np.pi / 30)
    assert problem.symbols[1].unit == "rad/s"


def test_a_window_keeps_its_samples_and_starts_there(tmp_path: Path) -> None:
    raw = table(tmp_path)
    found = read(tmp_path, RECORD + "\n  window: [0.16, 0.24]")
    assert found.t == pytest.approx(np.arange(0.16, 0.2401, 0.004))
    assert found.y[:, 0] == pytest.approx(np.radians(raw[10:31, 1]))
    assert found.t_start == found.t[0]


def test_constant_inputs_start_at_zero_and_the_state_may_be_given(tmp_path: Path) -> None:
    table(tmp_path)
    rest = "initial: {time: -0.1, theta_1: {value: 90, unit: deg}, w_2: 3}\n"
    found = read(tmp_path, RECORD, rest=rest)
    assert found.t_start == -0.1
    assert found.start["theta_1"] == pytest.approx(np.pi / 2)
    assert found.start["w_2"] == 3.0
    assert read(tmp_path, RECORD).t_start == 0.0


def test_records_without_a_time_column(tmp_path: Path) -> None:
    table(tmp_path)
    found = read(tmp_path, RECORD.replace("{column: ms, unit: ms}", "{rate: 250}"))
    assert found.t == pytest.approx(np.arange(50) / 250)


def test_mat_variables_and_columns(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    data = rng.normal(size=(40, 3))
    scipy.io.savemat(tmp_path / "r.mat", {"rig": {"w": data, "t": 0.02 * np.arange(40)}})
    record = """\
  file: r.mat
  time: {variable: rig.t, unit: s}
  channels:
    w_1: {variable: rig.w, column: 3, unit: deg/s, sigma: 1}"""
    found = read(tmp_path, record)
    assert found.y[:, 0] == pytest.approx(np.radians(data[:, 2]))


def test_all_problems_of_a_record_at_once_with_rows(tmp_path: Path) -> None:
    raw = table(tmp_path)
    raw[7, 1] = np.nan
    raw[9:20, 2] = np.inf
    raw[:, 3] = 5.0
    header = "ms;twist;w_1;speed 2;mV"
    np.savetxt(tmp_path / "r.csv", raw, "%.12g", ";", header=header, comments="")
    with pytest.raises(InputError) as caught:
        read(tmp_path, RECORD, "{v: {column: volt, unit: V}}")
    text = str(caught.value)
    assert "column 'twist' has 1 value without a number" in text
    assert "line 9" in text
    assert "and 6 more" in text
    assert "is 5 in every row" in text
    assert "no column 'volt'" in text
    assert len(caught.value.problems) == 4


@pytest.mark.skipif(not DATA.is_dir(), reason="the real records are not here")
def test_a_real_stick_slip_record(tmp_path: Path) -> None:
    """UFRJ rig: 59 s at 1 kHz, rpm; a window of four seconds of its bit and top speeds."""
    file = DATA / "ufrj_drillstring_rig" / "175_completo_1.mat"
    record = f"""\
  file: {file}
  time: {{variable: Time_Sample_175_complete, unit: s}}
  window: [37, 41]
  channels:
    w_1: {{variable: Bit_Speed_Sample_175_complete, unit: rpm, sigma: 5}}
    w_2: {{variable: Top_Speed_Sample_175_complete, unit: rpm, sigma: 5}}"""
    load = "{v: 8, t_1: {variable: Bit_Torque_Sample_175_complete, unit: N*m}}"
    found = read(tmp_path, record, load)
    assert found.y.shape == (4001, 2)
    assert found.dt == pytest.approx(1e-3)
    assert -0.5 < found.y[:, 0].min() < 0.0 < 15.0 < found.y[:, 0].max() < 22.0
    assert 0.4 < found.series["t_1"].min() < found.series["t_1"].max() < 4.0


@pytest.mark.skipif(not DATA.is_dir(), reason="the real records are not here")
def test_a_real_servo_record(tmp_path: Path) -> None:
    """HSM150: one variable with seven columns; position, velocity and current measured."""
    file = DATA / "hsm150_servo" / "idf_pos_0.06_1.mat"
    record = f"""\
  file: {file}
  time: {{variable: data, column: 1, unit: s}}
  channels:
    theta_2: {{variable: data, column: 3, unit: rad, sigma: 0.01}}
    w_2: {{variable: data, column: 4, unit: rad/s, sigma: 0.5}}
    i: {{variable: data, column: 7, unit: A, sigma: 0.05}}"""
    found = read(tmp_path, record)
    assert found.y.shape == (20000, 3)
    speed = np.gradient(found.y[:, 0], found.dt)
    assert np.corrcoef(speed[100:-100], found.y[100:-100, 1])[0, 1] > 0.9
