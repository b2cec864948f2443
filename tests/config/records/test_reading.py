"""A record is read into an experiment in SI: units, times, missing samples, windows."""

from pathlib import Path

import numpy as np
import pytest
from support.config_texts import RNG, SPEED, SUPPLY, T, load_measured, read_measured, refused, save

from bayesdrill.config import loading
from bayesdrill.config.assembly.problem import build_problem
from bayesdrill.config.records import reading
from bayesdrill.record.experiment import Experiment

HELD = ("j_m", "c_m", "k_T", "r_m", "l_m", "k_s", "j_1", "t_f")
PARAMETERS = (
    "parameters:\n  k_e: {prior: uniform, low: 0.5, high: 1.5, relative: true}\n"
    + "".join(f"  {name}: nominal\n" for name in HELD)
)
RECORD = """\
  file: r.csv
  time: {column: ms, unit: ms}
  channels:
    twist: {column: twist, unit: deg, measures: theta_1 - theta_2, sigma: 2}
    w_1: {column: w_1, unit: rpm, sigma: {prior: log_uniform, low: 0.1, high: 10}}
    motor: {column: 4, unit: rpm, measures: 8*w_2, sigma: 1.5}"""
HEAD = "ms;twist;w_1;speed 2;mV"


def read(folder: Path, record: str, inputs: str = "{v: 8}", rest: str = "") -> Experiment:
    path = folder / "mine.yaml"
    path.write_text(f"name: mine\nseed: 1\nrecord:\n{record}\ninputs: {inputs}\n{PARAMETERS}{rest}")
    return reading.read(loading.load(path).experiments[0])


def save_table(folder: Path, values: np.ndarray) -> None:
    np.savetxt(folder / "r.csv", values, "%.12g", ";", header=HEAD, comments="")


@pytest.fixture
def table(tmp_path: Path) -> np.ndarray:
    """Times in ms from 120 ms, an angle in degrees, two speeds in rpm, a voltage in mV; in `r.csv`."""
    rng, times = np.random.default_rng(2), 120 + 4.0 * np.arange(50)
    angle, speeds = rng.normal(30, 200, 50), rng.normal(100, 9, (50, 2))
    values = np.column_stack([times, angle, speeds, 8e3 + np.arange(50)])
    save_table(tmp_path, values)
    return values


def with_blanks(values: np.ndarray, *missing: int) -> list[str]:
    return ["" if k in missing else f"{x:.12g}" for k, x in enumerate(values)]


def test_all_columns_are_converted_to_si(tmp_path: Path, table: np.ndarray) -> None:
    inputs = "{v: {column: mV, unit: mV, hold: first}, t_1: {value: 20, unit: mN*m}}"
    experiment = read(tmp_path, RECORD, inputs)
    assert experiment.t == pytest.approx(table[:, 0] / 1000)
    assert experiment.dt == pytest.approx(0.004)
    assert experiment.y[:, 0] == pytest.approx(np.radians(table[:, 1]))
    assert experiment.y[:, 1:] == pytest.approx(table[:, 2:4] * 2 * np.pi / 60)
    assert experiment.series["v"] == pytest.approx(table[:, 4] / 1000)
    assert experiment.constant == {"t_1": pytest.approx(0.02)}
    assert experiment.first_order
    assert experiment.t_start == experiment.t[0]
    assert [channel.weights for channel in experiment.channels] == [
        {"theta_1": 1.0, "theta_2": -1.0},
        {"w_1": 1.0},
        {"w_2": 8.0},
    ]
    assert [channel.unit for channel in experiment.channels] == ["rad", "rad/s", "rad/s"]
    with pytest.raises(ValueError, match="read-only"):
        experiment.y[0, 0] = 1.0


@pytest.mark.usefixtures("table")
def test_sigma_and_its_prior_are_in_the_unit_of_the_column(tmp_path: Path) -> None:
    experiment = read(tmp_path, RECORD)
    problem = build_problem(loading.load(tmp_path / "mine.yaml"), [experiment])
    noise, space = problem.posterior.likelihood.only_observation.noise, problem.posterior.space
    assert noise.known == {0: pytest.approx(np.radians(2)), 2: pytest.approx(1.5 * np.pi / 30)}
    assert problem.names == ("k_e", "sigma_w_1")
    prior = space.priors["sigma_w_1"]
    assert (prior.low, prior.high) == (pytest.approx(np.pi / 300), pytest.approx(np.pi / 3))
    assert space.start["sigma_w_1"] == pytest.approx(np.pi / 30)
    assert problem.symbols[1].unit == "rad/s"


@pytest.mark.usefixtures("table")
def test_constant_inputs_start_at_zero_and_the_state_may_be_given(tmp_path: Path) -> None:
    rest = "initial: {time: -0.1, theta_1: {value: 90, unit: deg}, w_2: 3}\n"
    experiment = read(tmp_path, RECORD, rest=rest)
    assert experiment.t_start == -0.1
    assert (experiment.start["theta_1"], experiment.start["w_2"]) == pytest.approx((np.pi / 2, 3))
    assert read(tmp_path, RECORD).t_start == 0.0
    rate = read(tmp_path, RECORD.replace("{column: ms, unit: ms}", "{rate: 250}"))
    assert rate.t == pytest.approx(np.arange(50) / 250)


def test_even_and_jittered_times_are_those_of_the_file(tmp_path: Path) -> None:
    for times, even in (
        (np.round(np.arange(240) / 300, 6), True),
        (T + 0.002 * RNG.uniform(-1, 1, len(T)), False),
    ):
        save(tmp_path, "r.csv", t=times, w=SPEED)
        experiment = read_measured(tmp_path)
        assert experiment.t.tolist() == [float(f"{x:.12g}") for x in times]
        assert experiment.uniform or not even


def test_missing_samples_are_left_out_on_request(tmp_path: Path) -> None:
    save(tmp_path, "r.csv", t=T, w=with_blanks(SPEED, 0, 7, 8, 100))
    message = refused(tmp_path)
    assert "4 values without a number, at line 2, line 9, line 10, line 102" in message
    assert "leave them out (record.missing: drop)" in message
    experiment = read_measured(tmp_path, "missing: drop")
    assert experiment.uniform
    assert np.flatnonzero(~experiment.is_measured[:, 0]).tolist() == [0, 7, 8, 100]
    assert experiment.counts == (236,)
    assert "w_1: 4 missing samples are left out" in experiment.notes
    save(tmp_path, "r.csv", t=T, w=[*with_blanks(SPEED[:-1]), "Inf"])
    assert "1 infinite value, at line 241; correct, mask or cut" in refused(
        tmp_path, record="missing: drop"
    )


@pytest.mark.parametrize(
    ("hold", "bridged", "first", "last"),
    [("zero", [5.0, 5.0, 5.0, 11.0], 0, None), ("first", [5.0, 7.0, 9.0, 11.0], 0, 239)],
)
def test_missing_samples_of_an_input_are_bridged_as_it_is_held(
    hold: str, bridged: list[float], first: int, last: int | None, tmp_path: Path
) -> None:
    """Not at an end where nothing holds them."""
    supply = SUPPLY.copy()
    supply[[30, 33]] = 5.0, 11.0
    save(tmp_path, "r.csv", t=T, w=SPEED, u=with_blanks(supply, 31, 32))
    column = f"{{column: u, unit: V, hold: {hold}"
    message = refused(tmp_path, v=f"{column}}}")
    assert "column 'u' has 2 values without a number, at line 33, line 34" in message
    assert "bridge them (missing: hold)" in message
    experiment = read_measured(tmp_path, v=f"{column}, missing: hold}}")
    assert experiment.series["v"][30:34] == pytest.approx(bridged)
    assert np.isfinite(experiment.series["v"]).all()
    assert f"v: 2 samples are bridged (hold: {hold})" in experiment.notes
    for row in filter(lambda end: end is not None, (first, last)):
        save(tmp_path, "r.csv", t=T, w=SPEED, u=with_blanks(SUPPLY, row))
        message = refused(tmp_path, v=f"{column}, missing: hold}}")
        assert f"at line {row + 2}" in message
        assert "record.window" in message


def test_between_several_windows_the_rig_goes_on(tmp_path: Path) -> None:
    """Times and inputs stay, samples do not."""
    supply = ("inputs: {v: 8}", "inputs: {v: {column: u, unit: V}}")
    windows = "  window: [[0.5, 0.7], [1.2, 1.25], [2.0, 2.4]]\n"
    experiment = load_measured(tmp_path, ("  file: r.csv\n", f"  file: r.csv\n{windows}"), supply)
    assert experiment.t == pytest.approx(np.arange(50, 241) * 0.01)
    used = np.concatenate([np.arange(50, 71), np.arange(120, 126), np.arange(200, 241)]) / 100
    assert experiment.t[experiment.is_measured[:, 0]] == pytest.approx(used)
    assert experiment.series["v"] == pytest.approx(SUPPLY[20:211])
    assert experiment.t_start == experiment.t[0]
    assert experiment.uniform
    several, plain = (
        read_measured(tmp_path, f"window: {window}") for window in ("[[0.5, 0.7]]", "[0.5, 0.7]")
    )
    np.testing.assert_array_equal(several.t, plain.t)
    np.testing.assert_array_equal(several.y, plain.y)
