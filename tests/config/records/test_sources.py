"""The files of a record: columns of several files and clocks, and records that are decimated."""

from pathlib import Path

import numpy as np
import pytest
from support.config_texts import ANGLE, RNG, SPEED, SUPPLY, T, read_measured, refused, save

from bayesdrill.record import clocks

MORE = "theta_1: {file: more.csv, column: phi, unit: rad, sigma: 1}"


def test_every_column_may_have_its_own_file_and_clock(tmp_path: Path) -> None:
    """Nothing is resampled: each sample stands at its own time, and there alone."""
    slow, late = np.arange(0.3, 2.69, 0.04), 0.005 + np.arange(60) * 0.03
    squares = np.arange(len(slow)) ** 2.0
    save(tmp_path, "r.csv", t=T, w=SPEED)
    save(tmp_path, "angle.csv", **{"time [ms]": 1000 * (slow - 0.1)}, phi=squares)
    save(tmp_path, "supply.csv", t=late, u=5.0 + np.arange(60) % 7)
    time = "time: {column: 'time [ms]', unit: ms, offset: 100}"
    angle = f"theta_1: {{file: angle.csv, {time}, column: phi, unit: deg, sigma: 1}}"
    supply = "{file: supply.csv, column: u, unit: V}"
    experiment = read_measured(tmp_path, "window: [0.35, 1.7]", channel=angle, v=supply)
    inside = [x[(x > 0.3499) & (x < 1.7001)] for x in (T, slow, late)]
    every = np.unique(np.round(np.concatenate(inside), 9))
    assert experiment.t == pytest.approx(every, abs=1e-9)
    for k, (times, values) in enumerate(((T, SPEED), (slow, np.radians(squares)))):
        used = (times > 0.3499) & (times < 1.7001)
        assert experiment.t[experiment.is_measured[:, k]] == pytest.approx(times[used])
        assert experiment.y[experiment.is_measured[:, k], k] == pytest.approx(values[used])
    last = np.searchsorted(late, experiment.t + 1e-9, side="right") - 1
    assert experiment.series["v"].tolist() == (5.0 + last % 7).tolist()
    assert experiment.input_steps == {"v": pytest.approx(0.03)}


def test_the_same_clock_in_two_files_is_one(tmp_path: Path) -> None:
    """Written with other digits it is suspected."""
    save(tmp_path, "r.csv", t=T, w=SPEED)
    save(tmp_path, "more.csv", t=T, phi=ANGLE)
    experiment = read_measured(tmp_path, channel=MORE)
    assert experiment.is_measured.all()
    assert experiment.uniform
    assert experiment.t.tolist() == [float(f"{x:.12g}") for x in T]
    save(tmp_path, "more.csv", t=T + 3e-7 * RNG.standard_normal(len(T)), phi=ANGLE)
    experiment = read_measured(tmp_path, channel=MORE)
    assert "give both columns the same `time:`" in experiment.anomalies[0].in_words(1)
    assert f"{len(experiment.t)} times of 2 clocks (240, 240 samples)" in experiment.notes[0]


def test_an_input_of_one_sample_is_held(tmp_path: Path) -> None:
    save(tmp_path, "r.csv", t=T, w=SPEED)
    save(tmp_path, "once.csv", t=T[:1], u=np.array([7.5]))
    experiment = read_measured(tmp_path, v="{file: once.csv, column: u, unit: V}")
    assert set(experiment.series["v"]) == {7.5}
    assert experiment.uniform


def test_an_input_must_be_known_where_it_is_needed(tmp_path: Path) -> None:
    save(tmp_path, "r.csv", t=T, w=SPEED)
    save(tmp_path, "late.csv", t=T[5:], u=SUPPLY[5:])
    save(tmp_path, "short.csv", t=T[:-9], u=SUPPLY[:-9])
    late, short = (f"{{file: {name}.csv, column: u, unit: V}}" for name in ("late", "short"))
    message = refused(tmp_path, v=late)
    assert "v is known from 0.35 to 2.69 s, and the record goes from 0.3 to 2.69 s" in message
    assert "record.window inside both" in message
    assert "or `hold: zero`" in refused(tmp_path, v=short.replace("V}", "V, hold: first}"))
    held = read_measured(tmp_path, v=short)
    assert set(held.series["v"][-9:]) == {SUPPLY[-10]}
    assert "v: held after its last sample at 2.6 s" in held.notes
    cut = read_measured(tmp_path, "window: [0.355, 2]", v=late)
    assert cut.series["v"][0] == pytest.approx(SUPPLY[6])


# Decimation.

LONG = np.arange(3000) / 1000
SLOW = 9.0 + np.sin(11.0 * LONG)
FAST = 0.2 * np.sin(2500.0 * LONG)
STEP = np.where(LONG < 1.234, 3.0, 8.0)
GAP = np.r_[0:2000, 2005:3000]
FILTERED, PLAIN = "decimate: {factor: 10}", "decimate: {factor: 10, filter: false}"


def test_filtered_samples_stay_at_their_times(tmp_path: Path) -> None:
    save(tmp_path, "r.csv", t=LONG, w=SLOW + FAST)
    experiment = read_measured(tmp_path, FILTERED)
    assert experiment.uniform
    assert experiment.dt == pytest.approx(0.01)
    assert experiment.t[0] == pytest.approx(0.1)
    assert experiment.t_start == 0.0
    assert experiment.y[:, 0] == pytest.approx(9.0 + np.sin(11.0 * experiment.t), abs=1e-3)
    (note,) = experiment.notes
    taps = clocks.filter_length(10)
    assert f"zero-phase FIR of {taps} samples, half of the amplitude at 40 Hz" in note
    assert "removed (sd) 0.14" in note


def test_inputs_stay_at_every_time_when_channels_are_decimated(tmp_path: Path) -> None:
    save(tmp_path, "r.csv", t=LONG, w=SLOW, u=STEP)
    experiment = read_measured(tmp_path, FILTERED, v="{column: u, unit: V}")
    assert experiment.series["v"].tolist() == STEP.tolist()
    assert np.flatnonzero(experiment.is_measured[:, 0]).tolist() == list(range(100, 2900, 10))
    assert experiment.t_start == experiment.t[0] == 0.0


def test_without_a_filter_samples_are_left_as_measured(tmp_path: Path) -> None:
    noisy = SLOW + FAST
    save(tmp_path, "r.csv", t=LONG[GAP], w=noisy[GAP])
    experiment = read_measured(tmp_path, PLAIN)
    assert experiment.t == pytest.approx(LONG[GAP][::10], abs=1e-12)
    assert experiment.y[:, 0] == pytest.approx(noisy[GAP][::10], abs=1e-9)
    (note,) = experiment.notes
    assert "one sample in 10 is kept (300 of 2995 of w_1), as it was measured" in note
    assert "a filter needs equal time steps" in refused(tmp_path, record=FILTERED)


def test_without_a_filter_each_channel_is_thinned_by_itself(tmp_path: Path) -> None:
    """Where one has no sample, it has the next; inputs and what is held out stay whole."""
    angle = SLOW + LONG
    angle[:7] = np.nan
    save(tmp_path, "r.csv", t=LONG, w=SLOW, phi=angle, u=STEP)
    record = f"missing: drop\n  held_out: [1, 1.2]\n  {PLAIN}"
    channel = "theta_1: {column: phi, unit: rad, sigma: 1}"
    experiment = read_measured(tmp_path, record, channel=channel, v="{column: u, unit: V}")
    assert experiment.series["v"].tolist() == STEP.tolist()
    speeds, angles = (np.flatnonzero(experiment.is_measured[:, k]) for k in (0, 1))
    assert speeds.tolist() == [*range(0, 1000, 10), *range(1201, 3000, 10)]
    assert angles[:3].tolist() == [7, 17, 27]
    assert experiment.held_out is not None
    assert np.count_nonzero(~np.isnan(experiment.held_out[:, 0])) == 201
